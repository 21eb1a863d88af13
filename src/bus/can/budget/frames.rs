//! The frames of a network in operation.

use std::time::Duration;

use super::bits::{longest_bits, shortest_bits, worst_bits};
use super::response::Stream;
use crate::error::{BootError, BootFailure};
use crate::script::{lacking, pdos};
use crate::setup::{MasterSetup, SensorLink, SensorSetup};
use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::profiles::{DeviceProfile, MappedPdo};
use yieldwall_fieldbus::canopen::{BusId, NodeId, cob};
use yieldwall_fieldbus::plain_can::{Link, Order, Protocol};

/// Least time from one SDO exchange to the next.
const SDO_PERIOD: Duration = Duration::from_millis(5);
/// Least time from one emergency message of a node to its next.
const EMERGENCY_PERIOD: Duration = Duration::from_millis(100);
/// Data bytes of an SDO and of an emergency message.
const FULL: u8 = 8;

/// Use of a frame, in the order in which the master queues its own frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Use {
    /// The begin of a cycle, from the master.
    Sync,
    /// A request to a sensor that is polled, from the master behind SYNC.
    Request,
    /// Measured values of a device, sent after SYNC.
    Measured,
    /// Set-points, from the master when the control step has run.
    SetPoint,
    /// Measured values of a device with a clock of its own, at any moment.
    Streamed,
    /// A heartbeat; the master's goes out behind the set-points.
    Heartbeat,
    /// Request or answer of an SDO; the master's request goes out behind everything else.
    Sdo,
    /// An emergency message.
    Emergency,
}

/// One frame that comes again and again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedFrame {
    /// Sender and kind of the frame, such as `left TPDO1`.
    pub name: String,
    /// Use of the frame.
    pub usage: Use,
    /// Whether the master sends it.
    pub is_of_master: bool,
    /// Whether it is sent when the master's request has come, and not at SYNC.
    pub is_answer: bool,
    /// Identifier.
    pub cob_id: u16,
    /// Data bytes.
    pub bytes: u8,
    /// Time from one to the next, or the least time if it does not come regularly.
    pub period: Duration,
}

impl PlannedFrame {
    /// The most bits of a frame of this length, whatever its identifier.
    pub fn bits_worst(&self) -> u32 {
        worst_bits(self.bytes)
    }

    /// The most bits of a frame of this length with this identifier.
    pub fn bits_longest(&self) -> u32 {
        longest_bits(self.cob_id, self.bytes)
    }

    /// The bits of a frame of this length without any stuff bit.
    pub fn bits_shortest(&self) -> u32 {
        shortest_bits(self.bytes)
    }

    /// The bits that times are computed from: the most with this identifier, or with any (`is_plain`).
    pub fn bits(&self, is_plain: bool) -> u32 {
        if is_plain { self.bits_worst() } else { self.bits_longest() }
    }

    /// As a stream without jitter on a bus whose bits last `bit_ns`.
    pub(super) fn stream(&self, bit_ns: u64, is_plain: bool) -> Stream {
        Stream {
            cob_id: self.cob_id,
            transmission_ns: u64::from(self.bits(is_plain)) * bit_ns,
            period_ns: u64::try_from(self.period.as_nanos()).unwrap_or(u64::MAX).max(1),
            jitter_ns: 0,
        }
    }
}

/// The frames of one bus of a network in operation, in the order in which the master queues its own.
///
/// # Errors
/// If node identifiers are out of range, or if a profile lacks the process data of the command mode.
pub(super) fn frames(setup: &MasterSetup, bus: BusId) -> Result<Vec<PlannedFrame>, BootError> {
    let mode = Some(setup.mode.operation_mode());
    let sensor = &setup.sensor;
    let mut devices = Vec::new();
    for drive in setup.drives.iter().filter(|drive| drive.bus == bus) {
        devices.push(Device::new(&drive.name, drive.node_id, &drive.profile, mode, drive.heartbeat)?);
    }
    if let (SensorLink::Canopen(node), true) = (&sensor.link, sensor.bus == bus) {
        devices.push(Device::new(&sensor.name, node.node_id, &node.profile, None, node.heartbeat)?);
    }
    let master = node(setup.node_id, "master")?;
    let period = setup.period;
    let mut all = Vec::new();
    if setup.has_sync(bus) {
        all.push(PlannedFrame {
            name: "SYNC".to_owned(),
            usage: Use::Sync,
            is_of_master: true,
            is_answer: false,
            cob_id: cob::SYNC,
            bytes: 0,
            period,
        });
    }
    for device in &devices {
        device.process_data(&mut all, period)?;
    }
    if let (SensorLink::PlainCan(link), true) = (&sensor.link, sensor.bus == bus) {
        plain_can(&mut all, sensor, link, period);
    }
    if setup.has_nodes(bus) {
        all.push(heartbeat("master", master, setup.heartbeat, true));
    }
    let nodes = nodes(&devices);
    all.extend(nodes.iter().map(|(name, node, beat)| heartbeat(name, *node, *beat, false)));
    // One exchange at a time; that with the highest node id waits longest.
    if let Some((device, node, _)) = nodes.iter().max_by_key(|(_, node, _)| node.raw()) {
        let each = [("request", cob::sdo_request(*node), true), ("response", cob::sdo_response(*node), false)];
        all.extend(each.map(|(what, cob_id, is_of_master)| PlannedFrame {
            name: format!("{device} SDO {what}"),
            usage: Use::Sdo,
            is_of_master,
            is_answer: false,
            cob_id,
            bytes: FULL,
            period: SDO_PERIOD.max(period),
        }));
    }
    all.extend(nodes.iter().map(|(device, node, _)| PlannedFrame {
        name: format!("{device} EMCY"),
        usage: Use::Emergency,
        is_of_master: false,
        is_answer: false,
        cob_id: cob::emcy(*node),
        bytes: FULL,
        period: EMERGENCY_PERIOD.max(period),
    }));
    all.sort_by_key(|frame| frame.usage);
    Ok(all)
}

/// The nodes with their heartbeats, one for all axes of a device.
fn nodes(devices: &[Device<'_>]) -> Vec<(String, NodeId, Duration)> {
    let mut nodes: Vec<(String, NodeId, Duration)> = Vec::new();
    for device in devices {
        match nodes.iter_mut().find(|(_, node, _)| *node == device.node) {
            Some((name, ..)) => *name = format!("{name} and {}", device.name),
            None => nodes.push((device.name.to_owned(), device.node, device.heartbeat)),
        }
    }
    nodes
}

/// The frames of a sensor on plain CAN. Both of a sample are queued at once.
fn plain_can(all: &mut Vec<PlannedFrame>, sensor: &SensorSetup, link: &Link, period: Duration) {
    let (usage, data_period) = match link.protocol {
        Protocol::Streaming(_) => (Use::Streamed, sensor.sample_period),
        Protocol::Polled(_) => (Use::Measured, period),
    };
    let of_sensor = |what: &str, usage, cob_id, bytes, period| PlannedFrame {
        name: format!("{} {what}", sensor.name),
        usage,
        is_of_master: usage == Use::Request,
        is_answer: usage == Use::Measured,
        cob_id,
        bytes,
        period,
    };
    all.extend(
        link.protocol
            .order(Order::Read)
            .map(|frame| of_sensor("request", Use::Request, frame.id(), frame.len(), period)),
    );
    let data = ["sample 1", "sample 2"].into_iter().zip(link.protocol.data_ids());
    all.extend(data.map(|(what, id)| of_sensor(what, usage, id, FULL, data_period)));
}

fn heartbeat(name: &str, node: NodeId, period: Duration, is_of_master: bool) -> PlannedFrame {
    PlannedFrame {
        name: format!("{name} heartbeat"),
        usage: Use::Heartbeat,
        is_of_master,
        is_answer: false,
        cob_id: cob::heartbeat(node),
        bytes: 1,
        period,
    }
}

struct Device<'a> {
    name: &'a str,
    node: NodeId,
    profile: &'a DeviceProfile,
    mode: Option<OperationMode>,
    heartbeat: Duration,
}

impl<'a> Device<'a> {
    fn new(
        name: &'a str,
        node_id: u8,
        profile: &'a DeviceProfile,
        mode: Option<OperationMode>,
        heartbeat: Duration,
    ) -> Result<Self, BootError> {
        Ok(Self { name, node: node(node_id, name)?, profile, mode, heartbeat })
    }

    fn process_data(&self, all: &mut Vec<PlannedFrame>, period: Duration) -> Result<(), BootError> {
        let mapped = pdos(self.profile, self.mode).map_err(|failure| refuse(self.node.raw(), self.name, failure));
        let [rpdo, tpdo] = mapped?;
        let plan = |pdo: &MappedPdo, usage, cob_id: Option<u16>| {
            let cob_id =
                cob_id.ok_or_else(|| refuse(self.node.raw(), self.name, lacking(self.profile, "an identifier")))?;
            Ok::<_, BootError>(PlannedFrame {
                name: format!("{} {}{}", self.name, if usage == Use::SetPoint { "RPDO" } else { "TPDO" }, pdo.number),
                usage,
                is_of_master: usage == Use::SetPoint,
                is_answer: false,
                cob_id,
                bytes: pdo.bytes() as u8,
                // Every n-th SYNC; the master sends its own in every cycle, and the rest is taken as if it did.
                period: match pdo.transmission_type {
                    every @ 1..=240 if usage == Use::Measured => period * u32::from(every),
                    _ => period,
                },
            })
        };
        for pdo in &tpdo {
            all.push(plan(pdo, Use::Measured, cob::tpdo(pdo.identifier, self.node))?);
        }
        for pdo in &rpdo {
            all.push(plan(pdo, Use::SetPoint, cob::rpdo(pdo.identifier, self.node))?);
        }
        Ok(())
    }
}

fn node(raw: u8, name: &str) -> Result<NodeId, BootError> {
    cob::node_id(raw).map_err(|_| refuse(raw, name, BootFailure::NodeId { node_id: raw }))
}

fn refuse(node_id: u8, name: &str, failure: BootFailure) -> BootError {
    BootError { node_id: Some(node_id), name: name.to_owned(), step: "plan the bus", failure }
}
