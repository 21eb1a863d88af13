//! Participants in the traffic of a rig.

use std::time::Duration;

use crate::devices::node;
use crate::error::RigError;
use crate::far_end::DEVICES;
use yieldwall_config as config;
use yieldwall_config::injection::{Injection, Kind};
use yieldwall_drives::profiles::ForceSensor;
use yieldwall_fieldbus::canopen::{BusId, Frame, NodeId, cob};
use yieldwall_run::assembly::device_buses;

/// A device on its bus.
#[derive(Clone, Copy, Debug)]
pub(super) struct Participant {
    /// Number of its bus.
    pub(super) bus: BusId,
    pub(super) speaks: Speaks,
    /// Whether it can mark a sample as invalid.
    can_be_invalid: bool,
}

/// Protocol of a device.
#[derive(Clone, Copy, Debug)]
pub(super) enum Speaks {
    /// It is a CANopen node: its identifier and how often its heartbeat comes.
    Canopen { node: NodeId, heartbeat: Duration },
    /// It is a sensor on plain CAN.
    PlainCan,
    /// It is on an EtherCAT segment.
    Ethercat,
}

/// Returns the left drive, the right drive and the sensor of a rig.
///
/// # Errors
/// A node id or a bus that does not exist.
pub(super) fn participants(rig: &config::Rig) -> Result<Participants, RigError> {
    let speaks = |node_id: u8, heartbeat_ms: u16| {
        let heartbeat = Duration::from_millis(heartbeat_ms.into());
        Ok::<_, RigError>(Speaks::Canopen { node: node(node_id)?, heartbeat })
    };
    let drive = |drive: &config::Drive| match drive.address.canopen() {
        Some(own) => speaks(own.node_id, own.heartbeat_ms),
        None => Ok(Speaks::Ethercat),
    };
    let sensor = match rig.sensor.protocol {
        config::SensorProtocol::Canopen { node_id, heartbeat_ms, .. } => speaks(node_id, heartbeat_ms)?,
        config::SensorProtocol::Streaming { .. } | config::SensorProtocol::Polled { .. } => Speaks::PlainCan,
        config::SensorProtocol::Ethercat { .. } => Speaks::Ethercat,
    };
    let model = rig.sensor.protocol.profile().and_then(|profile| profile.get()?.force_sensor());
    let can_be_invalid = match rig.sensor.protocol {
        config::SensorProtocol::Polled { invalid_bits, .. } => invalid_bits != 0,
        _ => model.is_some_and(ForceSensor::shows_invalid),
    };
    let [left, right] = &rig.drives;
    let all = [drive(left)?, drive(right)?, sensor];
    let mut buses = device_buses(rig)?.into_iter();
    Ok(all.map(|speaks| Participant { bus: buses.next().unwrap_or_default(), speaks, can_be_invalid }))
}

/// The left drive, the right drive, the sensor.
pub(super) type Participants = [Participant; DEVICES];

impl Participant {
    pub(super) fn is_on_can(self) -> bool {
        !matches!(self.speaks, Speaks::Ethercat)
    }

    pub(super) fn node(self) -> Option<NodeId> {
        match self.speaks {
            Speaks::Canopen { node, .. } => Some(node),
            Speaks::PlainCan | Speaks::Ethercat => None,
        }
    }

    /// Whether a frame that it sent is process data.
    pub(super) fn is_data(self, frame: &Frame) -> bool {
        // Function codes of TPDO 1 to 4.
        match self.speaks {
            Speaks::Ethercat => false,
            Speaks::PlainCan => true,
            Speaks::Canopen { .. } => matches!(frame.id() >> 7, 3 | 5 | 7 | 9),
        }
    }

    /// Whether a frame that it sent is its heartbeat.
    pub(super) fn is_heartbeat(self, frame: &Frame) -> bool {
        self.node().is_some_and(|node| frame.id() == cob::heartbeat(node))
    }

    /// Whether a frame that the master sent on a bus is for it.
    pub(super) fn is_addressed(self, frame: &Frame) -> bool {
        self.bus == frame.bus() && self.node().is_some_and(|node| frame.id() & 0x7f == u16::from(node.raw()))
    }
}

/// Whether a frame of the master is a set-point: function codes of RPDO 1 to 4.
pub(super) fn is_set_point(frame: &Frame) -> bool {
    matches!(frame.id() >> 7, 4 | 6 | 8 | 10)
}

/// Returns the requirement of an injection that these devices do not meet.
pub(super) fn needed(participants: &Participants, injection: Injection) -> Option<&'static str> {
    let mut devices = participants.iter().enumerate().filter(|(at, _)| injection.target.has_device(*at));
    let is_plain = devices.clone().any(|(_, device)| matches!(device.speaks, Speaks::PlainCan));
    match injection.kind {
        Kind::SensorInvalid if devices.any(|(_, device)| !device.can_be_invalid) => {
            Some("a sensor with a bit of its status for it")
        }
        _ if !is_plain => None,
        Kind::HeartbeatSilent
        | Kind::DuplicateNode
        | Kind::IntruderNmt
        | Kind::ForeignDownload
        | Kind::Emergency
        | Kind::EmergencyWarning
        | Kind::IdentityMismatch
        | Kind::WrongNodeId => Some("a CANopen node, and the sensor speaks plain CAN"),
        _ => None,
    }
}
