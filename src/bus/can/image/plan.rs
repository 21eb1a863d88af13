//! The plan of the process image, made once from setup and profiles.

use super::{IDENTIFIERS, Incoming, NO_SLOT, Outgoing, Source, slot_index};
use crate::can::boot::layout_entries;
use crate::error::BootFailure;
use crate::script::{Step, lacking, mapped, mapping, servo, unused_value};
use crate::setup::{BrakeWords, DriveSetup, SensorNode};
use yieldwall_drives::cia402::CommandMode;
use yieldwall_drives::profiles::{DeviceProfile, Pdo, Quantity, StatusBits};
use yieldwall_fieldbus::canopen::pdo::Layout;
use yieldwall_fieldbus::canopen::{BusId, NodeId, cob};

/// The incoming frames while they are collected.
pub(super) struct Incomings {
    pub(super) slots: Box<[u8]>,
    pub(super) incoming: Vec<Incoming>,
}

impl Incomings {
    /// None yet, with room for those of the buses up to this one.
    pub(super) fn new(last_bus: BusId) -> Self {
        Self { slots: vec![NO_SLOT; slot_index(last_bus, 0) + IDENTIFIERS].into_boxed_slice(), incoming: Vec::new() }
    }

    /// The process data of a drive; the frame that it is sent.
    pub(super) fn drive(
        &mut self,
        mode: CommandMode,
        joint: usize,
        (setup, node): (&DriveSetup, NodeId),
        steps: &[Step],
    ) -> Result<Outgoing, BootFailure> {
        let profile = &*setup.profile;
        let map = mapping(profile, Some(mode.operation_mode()))?;
        for pdo in &map.tpdo {
            self.add(setup.bus, profile, node, pdo, Some(joint), &|quantity| match quantity {
                Quantity::Statusword => Some(Source::Status),
                Quantity::PositionActual => Some(Source::Position),
                _ => None,
            })?;
        }
        let set_point = mode.set_point();
        let pdo = map.rpdo.first().ok_or_else(|| lacking(profile, set_point.word()))?;
        let layout = layout(profile, pdo)?;
        let find = |quantity: Quantity| {
            let (index, sub, _) = mapped(profile, quantity)?;
            layout.field(index, sub).ok_or_else(|| lacking(profile, quantity.word()))
        };
        let mut word = 0;
        for (quantity, (_, field)) in pdo.maps.iter().zip(layout.entries()) {
            if let Quantity::Unused(unused) = *quantity {
                field.put_bits(&mut word, i64::from(unused_value(unused, steps)) as u64);
            }
        }
        Ok(Outgoing {
            bus: setup.bus,
            id: cob::rpdo(pdo.canopen_number(), node).ok_or_else(|| lacking(profile, set_point.word()))?,
            len: layout.len(),
            word,
            controlword: find(Quantity::Controlword)?,
            target: find(set_point)?,
            brake: match servo(profile).ok().and_then(BrakeWords::of) {
                Some(words) => Some((find(Quantity::DigitalOutputs)?, words)),
                None => None,
            },
        })
    }

    pub(super) fn sensor(&mut self, bus: BusId, setup: &SensorNode, node: NodeId) -> Result<StatusBits, BootFailure> {
        let profile = &*setup.profile;
        for pdo in &mapping(profile, None)?.tpdo {
            self.add(bus, profile, node, pdo, None, &|quantity| match quantity {
                Quantity::Status => Some(Source::SensorStatus),
                Quantity::SampleCounter => Some(Source::SampleCounter),
                _ => Quantity::CHANNELS.iter().position(|channel| *channel == quantity).map(Source::Count),
            })?;
        }
        let sensor = profile.force_sensor();
        let other = || BootFailure::Role { profile: profile.name().into(), wanted: "a force sensor" };
        sensor.map(|sensor| sensor.status_bits).ok_or_else(other)
    }

    fn add(
        &mut self,
        bus: BusId,
        profile: &DeviceProfile,
        node: NodeId,
        pdo: &Pdo,
        joint: Option<usize>,
        source: &dyn Fn(Quantity) -> Option<Source>,
    ) -> Result<(), BootFailure> {
        let layout = layout(profile, pdo)?;
        let mut fields = Vec::new();
        for (quantity, (_, field)) in pdo.maps.iter().zip(layout.entries()) {
            fields.extend(source(*quantity).map(|source| (source, *field)));
        }
        // An identifier of 0 would be a network command.
        let id = cob::tpdo(pdo.canopen_number(), node).ok_or_else(|| lacking(profile, "an identifier"))?;
        if let Some(slot) = self.slots.get_mut(slot_index(bus, id)) {
            *slot = self.incoming.len() as u8;
        }
        self.incoming.push(Incoming { len: layout.len(), joint, fields, word: 0, has_arrived: false, is_owed: false });
        Ok(())
    }
}

fn layout(profile: &DeviceProfile, pdo: &Pdo) -> Result<Layout, BootFailure> {
    let last = pdo.maps.last().map_or("an object", |quantity| quantity.word());
    Layout::new(&layout_entries(profile, pdo)?).map_err(|_| lacking(profile, last))
}
