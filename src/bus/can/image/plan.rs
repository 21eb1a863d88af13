//! The plan of the process image, made once from setup and profiles.

use super::{IDENTIFIERS, Incoming, NO_SLOT, Outgoing, Source, slot_index};
use crate::can::boot::layout_entries;
use crate::error::BootFailure;
use crate::sample::SampleCodec;
use crate::script::{Step, constant, lacking, pdos, servo};
use crate::setup::{BrakeWords, DriveSetup, SensorNode};
use yieldwall_drives::cia402::CommandMode;
use yieldwall_drives::profiles::{DeviceProfile, MappedPdo, Quantity};
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
        let [rpdo, tpdo] = pdos(profile, Some(mode.operation_mode()))?;
        for pdo in &tpdo {
            self.add(setup.bus, profile, node, pdo, Some(joint), &|quantity| match quantity {
                Quantity::Statusword => Some(Source::Status),
                Quantity::PositionActual => Some(Source::Position),
                _ => None,
            })?;
        }
        let set_point = mode.set_point();
        let pdo = rpdo.first().ok_or_else(|| lacking(profile, set_point.word()))?;
        let layout = layout(profile, pdo)?;
        let find = |quantity: Quantity| {
            let place = pdo.position(quantity).and_then(|place| layout.entries().get(place));
            place.map(|(_, field)| *field).ok_or_else(|| lacking(profile, quantity.word()))
        };
        let mut word = 0;
        for (object, (_, field)) in pdo.objects.iter().zip(layout.entries()) {
            field.put_bits(&mut word, i64::from(constant(object, steps)) as u64);
        }
        Ok(Outgoing {
            bus: setup.bus,
            id: cob::rpdo(pdo.identifier, node).ok_or_else(|| lacking(profile, set_point.word()))?,
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

    pub(super) fn sensor(&mut self, bus: BusId, setup: &SensorNode, node: NodeId) -> Result<SampleCodec, BootFailure> {
        let profile = &*setup.profile;
        for pdo in &pdos(profile, None)?[1] {
            self.add(bus, profile, node, pdo, None, &|quantity| Some(Source::Sample(quantity)))?;
        }
        Ok(SampleCodec::new(profile))
    }

    fn add(
        &mut self,
        bus: BusId,
        profile: &DeviceProfile,
        node: NodeId,
        pdo: &MappedPdo,
        joint: Option<usize>,
        source: &dyn Fn(Quantity) -> Option<Source>,
    ) -> Result<(), BootFailure> {
        let layout = layout(profile, pdo)?;
        let fields = pdo.objects.iter().zip(layout.entries());
        let fields = fields.filter_map(|(object, (_, field))| Some((source(object.quantity?)?, *field))).collect();
        // An identifier of 0 would be a network command.
        let id = cob::tpdo(pdo.identifier, node).ok_or_else(|| lacking(profile, "an identifier"))?;
        if let Some(slot) = self.slots.get_mut(slot_index(bus, id)) {
            *slot = self.incoming.len() as u8;
        }
        self.incoming.push(Incoming { len: layout.len(), joint, fields, word: 0, has_arrived: false, is_owed: false });
        Ok(())
    }
}

fn layout(profile: &DeviceProfile, pdo: &MappedPdo) -> Result<Layout, BootFailure> {
    let last = pdo.objects.last().and_then(|object| object.quantity).map_or("an object", Quantity::word);
    Layout::new(&layout_entries(pdo)).map_err(|_| lacking(profile, last))
}
