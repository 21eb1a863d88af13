//! Signs that a bus already has a master, or a device.
//!
//! Whoever wants to send listens first. A frame that only a master sends is a master. The heartbeat of a node that the rig does
//! not know is none: masters and devices send it alike, and a device alone disturbs nobody. The one exception is the
//! node id of the rig's own master.

use std::fmt;
use std::time::Duration;

use crate::setup::{MasterSetup, SensorLink};
use yieldwall_fieldbus::canopen::{BusId, Frame, NodeId, cob};
use yieldwall_motion::guard::DeviceSet;

/// How long is listened at least.
pub const LISTENING: Duration = Duration::from_secs(1);
/// So many heartbeats of the slowest node are waited for where they take longer.
const HEARTBEATS: u32 = 2;
/// PDOs of each direction that a node has by default.
const PDOS: std::ops::RangeInclusive<u8> = 1..=4;

/// Meaning of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sign {
    /// NMT command.
    Command,
    /// SYNC.
    Sync,
    /// A remote frame that asks for the state of a node.
    Guarding {
        /// The node.
        node_id: u8,
    },
    /// The heartbeat or boot-up message of a master with the node id of the rig's own.
    Master {
        /// The node id.
        node_id: u8,
    },
    /// Process data for a drive.
    SetPoints {
        /// Number of the RPDO, 1 to 4.
        number: u8,
        /// The drive.
        node_id: u8,
    },
    /// SDO request.
    Request {
        /// Node that the request is for.
        node_id: u8,
    },
    /// An order to a force sensor on plain CAN.
    Order,
    /// The heartbeat or boot-up message of a device.
    Heartbeat {
        /// The device.
        node_id: u8,
    },
    /// Process data of a device.
    ProcessData {
        /// Number of the TPDO, 1 to 4.
        number: u8,
        /// The device.
        node_id: u8,
    },
    /// Emergency message of a device.
    Emergency {
        /// The device.
        node_id: u8,
    },
    /// SDO answer of a device.
    Answer {
        /// The device.
        node_id: u8,
    },
    /// A sample of a force sensor on plain CAN.
    Sample,
}

impl fmt::Display for Sign {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Sign::Command => write!(f, "an NMT command"),
            Sign::Sync => write!(f, "SYNC"),
            Sign::Guarding { node_id } => write!(f, "node guarding of node {node_id}"),
            Sign::Master { node_id } => {
                write!(f, "the heartbeat of node {node_id}, the node id of the rig's own master")
            }
            Sign::SetPoints { number, node_id } => write!(f, "RPDO {number} of node {node_id}, which a master sends"),
            Sign::Request { node_id } => write!(f, "an SDO request to node {node_id}"),
            Sign::Order => write!(f, "an order to the force sensor"),
            Sign::Heartbeat { node_id } => write!(f, "a heartbeat or boot-up message of node {node_id}"),
            Sign::ProcessData { number, node_id } => write!(f, "TPDO {number} of node {node_id}"),
            Sign::Emergency { node_id } => write!(f, "an emergency message of node {node_id}"),
            Sign::Answer { node_id } => write!(f, "an SDO answer of node {node_id}"),
            Sign::Sample => write!(f, "a sample of the force sensor"),
        }
    }
}

/// A frame that was heard, and its meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeardFrame {
    /// The frame.
    pub frame: Frame,
    /// Meaning of the frame.
    pub sign: Sign,
}

impl fmt::Display for HeardFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let id = self.frame.id();
        write!(f, "{} (identifier {id:03X}h, frame {id:03X}#", self.sign)?;
        if self.frame.is_remote() {
            write!(f, "R")?;
        }
        self.frame.data().iter().try_for_each(|byte| write!(f, "{byte:02X}"))?;
        write!(f, ")")
    }
}

/// Frames that are signs of a master or a device.
#[derive(Clone, Debug)]
pub struct Signs {
    /// Whether NMT commands, SYNC and node guarding do, whatever the rig.
    of_masters: bool,
    /// Bus, identifier and meaning of data frames.
    known: Vec<(BusId, u16, Sign)>,
}

impl Signs {
    /// Frames of a master, for a rig: NMT commands, SYNC and node guarding of any node, the heartbeat of the rig's own master,
    /// and what a master sends to the rig's devices. A node id that is none is left out.
    pub fn of_masters(setup: &MasterSetup) -> Self {
        let mut known = Vec::new();
        for bus in setup.buses() {
            if let Ok(master) = cob::node_id(setup.node_id) {
                known.push((bus, cob::heartbeat(master), Sign::Master { node_id: master.raw() }));
            }
        }
        for (bus, node) in setup.nodes() {
            known.push((bus, cob::sdo_request(node), Sign::Request { node_id: node.raw() }));
        }
        // Where a force sensor on plain CAN has the identifier of an RPDO that nobody uses, it is the sensor's.
        let samples = setup.samples().map_or([None; 2], |(bus, ids)| ids.map(|id| Some((bus, id))));
        for drive in &setup.drives {
            let Ok(node) = cob::node_id(drive.node_id) else { continue };
            let pdos = PDOS.filter_map(|number| Some((number, cob::rpdo(number, node)?)));
            let pdos = pdos.filter(|(_, id)| !samples.contains(&Some((drive.bus, *id))));
            known.extend(pdos.map(|(number, id)| (drive.bus, id, Sign::SetPoints { number, node_id: node.raw() })));
        }
        if let SensorLink::PlainCan(link) = &setup.sensor.link {
            known.push((setup.sensor.bus, link.protocol.order_id(), Sign::Order));
        }
        Self { of_masters: true, known }
    }

    /// Frames of a master of any rig on the first bus: NMT commands, SYNC, node guarding and SDO requests.
    pub fn of_any_master() -> Self {
        let nodes = (1..=127).filter_map(|raw| cob::node_id(raw).ok());
        let known = nodes.map(|node| (BusId::FIRST, cob::sdo_request(node), Sign::Request { node_id: node.raw() }));
        Self { of_masters: true, known: known.collect() }
    }

    /// Frames of those of a rig's devices that are in `devices`.
    pub fn of_devices(setup: &MasterSetup, devices: DeviceSet) -> Self {
        let mut known = Vec::new();
        for (bus, node) in setup.nodes_of(devices) {
            let node_id = node.raw();
            known.push((bus, cob::heartbeat(node), Sign::Heartbeat { node_id }));
            known.push((bus, cob::emcy(node), Sign::Emergency { node_id }));
            known.push((bus, cob::sdo_response(node), Sign::Answer { node_id }));
            let pdos = PDOS.filter_map(|number| Some((number, cob::tpdo(number, node)?)));
            known.extend(pdos.map(|(number, id)| (bus, id, Sign::ProcessData { number, node_id })));
        }
        if let (Some((bus, ids)), true) = (setup.samples(), devices.contains(DeviceSet::SENSOR)) {
            known.extend(ids.map(|id| (bus, id, Sign::Sample)));
        }
        Self { of_masters: false, known }
    }

    /// Returns the meaning of a frame, if it is a sign. Its bus counts ([`Frame::bus`]).
    pub fn find(&self, frame: &Frame) -> Option<HeardFrame> {
        let id = frame.id();
        let sign = match id {
            _ if frame.is_remote() => {
                (self.of_masters && cob::is_heartbeat(id)).then_some(Sign::Guarding { node_id: (id & 0x7f) as u8 })
            }
            cob::NMT if self.of_masters => Some(Sign::Command),
            cob::SYNC if self.of_masters => Some(Sign::Sync),
            _ => {
                let mut known = self.known.iter();
                known.find(|(bus, known, _)| (*bus, *known) == (frame.bus(), id)).map(|(.., sign)| *sign)
            }
        }?;
        Some(HeardFrame { frame: *frame, sign })
    }
}

impl MasterSetup {
    /// How long is listened before anything is sent: [`LISTENING`], or two of the longest heartbeats of the rig if that
    /// is more.
    pub fn listening(&self) -> Duration {
        let sensor = match &self.sensor.link {
            SensorLink::Canopen(node) => node.heartbeat,
            SensorLink::PlainCan(_) => Duration::ZERO,
        };
        let slowest = self.drives.iter().map(|drive| drive.heartbeat).fold(self.heartbeat.max(sensor), Duration::max);
        LISTENING.max(slowest * HEARTBEATS)
    }

    /// Bus and node id of the CANopen devices.
    fn nodes(&self) -> impl Iterator<Item = (BusId, NodeId)> {
        self.nodes_of(DeviceSet::drive(0) | DeviceSet::drive(1) | DeviceSet::SENSOR)
    }

    /// Returns the nodes of these devices.
    fn nodes_of(&self, devices: DeviceSet) -> impl Iterator<Item = (BusId, NodeId)> {
        let drives = (0..).zip(&self.drives).map(|(at, drive)| (DeviceSet::drive(at), drive.bus, drive.node_id));
        let sensor = match &self.sensor.link {
            SensorLink::Canopen(node) => Some((DeviceSet::SENSOR, self.sensor.bus, node.node_id)),
            SensorLink::PlainCan(_) => None,
        };
        let wanted = drives.chain(sensor).filter(move |(device, ..)| devices.contains(*device));
        wanted.filter_map(|(_, bus, raw)| Some((bus, cob::node_id(raw).ok()?)))
    }

    /// Bus and identifiers of the samples of a force sensor on plain CAN.
    fn samples(&self) -> Option<(BusId, [u16; 2])> {
        match &self.sensor.link {
            SensorLink::Canopen(_) => None,
            SensorLink::PlainCan(link) => Some((self.sensor.bus, link.protocol.data_ids())),
        }
    }
}
