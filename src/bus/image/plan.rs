//! The plan of the process image, made once from setup and profiles.

use super::{Drive, IDENTIFIERS, Incoming, NO_SLOT, Outgoing, Source, slot_index};
use crate::bus::boot::{layout_entries, mapping};
use crate::bus::error::BootFailure;
use crate::bus::setup::{CommandMode, DriveSetup, SensorNode};
use crate::canopen::pdo::Layout;
use crate::canopen::{NodeId, cob};
use yieldwall_drives::cia402::{StateWalk, Statusword};
use yieldwall_drives::objects::{self, Object};
use yieldwall_drives::profiles::{DeviceProfile, PdoMapping};
use yieldwall_drives::scaling::CountUnwrapper;

/// The incoming frames while they are collected.
pub(super) struct Incomings {
    pub(super) slots: Box<[u8]>,
    pub(super) incoming: Vec<Incoming>,
}

impl Incomings {
    /// None yet, with room for those of the buses up to this one.
    pub(super) fn new(last_bus: u8) -> Self {
        Self { slots: vec![NO_SLOT; slot_index(last_bus, 0) + IDENTIFIERS].into_boxed_slice(), incoming: Vec::new() }
    }

    pub(super) fn drive(
        &mut self,
        mode: CommandMode,
        joint: usize,
        (setup, node): (&DriveSetup, NodeId),
    ) -> Result<Drive, BootFailure> {
        let profile = setup.profile;
        let map = mapping(profile, Some(mode.operation_mode()))?;
        for pdo in map.tpdo {
            self.add(setup.bus, profile, node, pdo, Some(joint), &|object| match object {
                objects::STATUSWORD => Some(Source::Status(joint)),
                objects::POSITION_ACTUAL => Some(Source::Position(joint)),
                _ => None,
            })?;
        }
        let set_point = match mode {
            CommandMode::Position => objects::TARGET_POSITION,
            CommandMode::Velocity => objects::TARGET_VELOCITY,
            CommandMode::Torque => objects::TARGET_TORQUE,
        };
        let pdo = map.rpdo.first().ok_or_else(|| lacking(profile, set_point))?;
        let layout = layout(profile, pdo)?;
        let find = |object: Object| layout.field(object.index, object.sub).ok_or_else(|| lacking(profile, object));
        let outgoing = Outgoing {
            bus: setup.bus,
            id: cob::rpdo(pdo.number, node).ok_or_else(|| lacking(profile, set_point))?,
            len: layout.len(),
            controlword: find(objects::CONTROLWORD)?,
            set_point: find(set_point)?,
        };
        // The drive counts modulo 2^32: the expected angle says which turn it is.
        let expected = setup.scaling.counts(setup.expected_angle_rad).unwrap_or_default();
        Ok(Drive {
            scaling: setup.scaling,
            expected_counts: expected,
            unwrapper: CountUnwrapper::near(expected),
            walk: StateWalk::new(),
            statusword: Statusword::default(),
            outgoing,
        })
    }

    pub(super) fn sensor(&mut self, bus: u8, setup: &SensorNode, node: NodeId) -> Result<(), BootFailure> {
        let map = mapping(setup.profile, None)?;
        for pdo in map.tpdo {
            self.add(bus, setup.profile, node, pdo, None, &|object| match object {
                objects::SENSOR_STATUS => Some(Source::SensorStatus),
                objects::SENSOR_SAMPLE_COUNTER => Some(Source::SampleCounter),
                channel if channel.index == objects::PROCESS_VALUE.index && (1..=6).contains(&channel.sub) => {
                    Some(Source::Count(usize::from(channel.sub) - 1))
                }
                _ => None,
            })?;
        }
        Ok(())
    }

    fn add(
        &mut self,
        bus: u8,
        profile: &'static DeviceProfile,
        node: NodeId,
        pdo: &PdoMapping,
        joint: Option<usize>,
        source: &dyn Fn(Object) -> Option<Source>,
    ) -> Result<(), BootFailure> {
        let layout = layout(profile, pdo)?;
        let mut fields = Vec::new();
        for entry in pdo.entries {
            let object =
                objects::ALL.iter().find(|object| object.index == entry.index).map(|object| object.at(entry.sub));
            if let (Some(source), Some(field)) = (object.and_then(source), layout.field(entry.index, entry.sub)) {
                fields.push((source, field));
            }
        }
        let id = cob::tpdo(pdo.number, node).unwrap_or_default();
        if let Some(slot) = self.slots.get_mut(slot_index(bus, id)) {
            *slot = self.incoming.len() as u8;
        }
        self.incoming.push(Incoming { len: layout.len(), joint, fields, word: 0, has_arrived: false, is_owed: false });
        Ok(())
    }
}

fn layout(profile: &'static DeviceProfile, pdo: &PdoMapping) -> Result<Layout, BootFailure> {
    Layout::new(&layout_entries(pdo)).map_err(|_| {
        let entry = pdo.entries.last();
        BootFailure::Layout {
            profile: profile.name,
            index: entry.map_or(0, |entry| entry.index),
            sub: entry.map_or(0, |entry| entry.sub),
        }
    })
}

fn lacking(profile: &'static DeviceProfile, object: Object) -> BootFailure {
    BootFailure::Layout { profile: profile.name, index: object.index, sub: object.sub }
}
