//! The rig's CAN buses as one network: boot, then raw words that come and go twice a cycle.

mod boot;
pub mod budget;
mod image;
mod line;
mod network;
mod node;
mod plan;
mod states;
mod transfer;
mod waiting;

use std::time::Duration;

use super::emergency::{EmergencyReport, LastTold};
use super::error::{BootError, BootFailure};
use super::phase::Phase;
use super::setup::{DriveSetup, MasterSetup, SensorLink};
use super::signs::Signs;
use super::turns::Turns;
use boot::Boot;
use image::{Image, SensorFrames, Taken};
use line::Line;
use node::Node;
use yieldwall_drives::profiles::AxisOffset;
use yieldwall_fieldbus::canopen::nmt;
use yieldwall_fieldbus::canopen::{self, BusId, Emergency, Frame, NodeId, Outbox, SyncProducer, cob};
use yieldwall_fieldbus::plain_can::Client;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::cycle::LinkEvents;
use yieldwall_motion::guard::{Device, DeviceSet};

pub use plan::{BootPlan, NodePlan};
pub use waiting::Waiting;

/// All CAN buses of a rig.
///
/// Frames come with their bus ([`Frame::bus`]) and leave with it. SYNC, NMT commands and the master's
/// heartbeat go to every bus where somebody hears them, and nothing is exchanged before the nodes of all buses are there.
#[derive(Clone)]
pub(super) struct CanNetwork {
    id: NodeId,
    heartbeat: Duration,
    /// Time for which it listens for another master.
    listening: Duration,
    next_heartbeat: Time,
    phase: Phase,
    /// When the phase began.
    phase_since: Time,
    nodes: Vec<Node>,
    sensor_name: String,
    sensor_bus: BusId,
    /// How long the samples of a sensor on plain CAN are waited for.
    sample_wait: Duration,
    /// The buses.
    lines: Vec<Line>,
    /// Signs of another master, used until the exchange of process data.
    signs: Signs,
    /// Whether anything was ever sent.
    has_sent: bool,
    sync: SyncProducer,
    image: Image,
    events: LinkEvents,
    /// Whether nothing is sent: the bus could not be reached, and the drives' watchdogs shall act.
    is_silent: bool,
    /// Whether the link shows own frames; without that nothing is known of what is still on its way.
    has_echo: bool,
    /// The interfaces because of which SYNC and set-points of this cycle are held back.
    held: DeviceSet,
    /// Whether somebody else's set-point was heard and no own ones have been sent since: SYNC might make a drive act on it.
    is_overwritten: bool,
    /// Whether SYNC of this cycle is held back.
    is_sync_held: bool,
    /// The rig is enabled, or tries to be.
    is_enabled: bool,
    /// SDO downloads of somebody else to configured nodes.
    foreign_downloads: u32,
    told: LastTold,
}

impl CanNetwork {
    /// A network to which nothing was sent yet.
    ///
    /// # Errors
    /// If node identifiers are out of range or used twice, or if a profile lacks the process data of the command mode.
    pub(super) fn new(setup: &MasterSetup) -> Result<Self, BootError> {
        let id = node_id(setup.node_id, "master")?;
        let mut known = Vec::new();
        let mut fresh = |bus: BusId, raw: u8, name: &str| -> Result<NodeId, BootError> {
            let fresh = node_id(raw, name)?;
            if fresh == id || known.contains(&(bus, fresh)) {
                let failure = BootFailure::DuplicateNodeId { node_id: raw };
                return Err(refuse(Some(raw), name, "check the node ids", failure));
            }
            known.push((bus, fresh));
            Ok(fresh)
        };
        let mut drives: Vec<(&DriveSetup, NodeId)> = Vec::new();
        for drive in &setup.drives {
            let shared = drives.iter().find(|(other, _)| other.shares_device(drive)).map(|(_, id)| *id);
            let id = shared.map_or_else(|| fresh(drive.bus, drive.node_id, &drive.name), Ok)?;
            drives.push((drive, id));
        }
        let sensor_bus = setup.sensor.bus;
        let (sensor, sensor_id) = match &setup.sensor.link {
            SensorLink::Canopen(node) => {
                let fresh = fresh(sensor_bus, node.node_id, &setup.sensor.name)?;
                (SensorFrames::Canopen(node, fresh), Some(node.node_id))
            }
            SensorLink::PlainCan(link) => (SensorFrames::PlainCan(Client::new(*link)), None),
        };
        const PLAN: &str = "plan the process data";
        let of_sensor = |failure| refuse(sensor_id, &setup.sensor.name, PLAN, failure);
        let mut nodes = Vec::new();
        for (drive, id) in drives.iter().copied() {
            if nodes.iter().any(|node: &Node| node.is(drive.bus, id)) {
                continue;
            }
            let is_own = |(_, other): &(Device, &DriveSetup)| std::ptr::eq(*other, drive) || other.shares_device(drive);
            let (devices, axes): (Vec<Device>, Vec<&DriveSetup>) =
                Device::DRIVES.into_iter().zip(&setup.drives).filter(is_own).unzip();
            let name = axes.iter().map(|axis| axis.name.as_str()).collect::<Vec<_>>().join(" and ");
            let boot =
                Boot::drives(setup, &axes, id).map_err(|failure| refuse(Some(drive.node_id), &name, PLAN, failure))?;
            let devices = devices.iter().fold(DeviceSet::NONE, |all, device| all | device.set());
            let offset = |device: Device| axes_offset(&setup.drives, device);
            let turns = Turns::new(Device::DRIVES.map(offset));
            nodes.push(Node::new(drive.bus, id, (devices, turns), &name, drive.heartbeat, drive.waits, boot));
        }
        if let SensorFrames::Canopen(node, id) = sensor {
            let waits = setup.sensor.waits;
            let boot = Boot::sensor(node, id, waits.sdo).map_err(of_sensor)?;
            let name = &setup.sensor.name;
            let own = (DeviceSet::SENSOR, Turns::default());
            nodes.push(Node::new(sensor_bus, id, own, name, node.heartbeat, waits, boot));
        }
        let lines: Vec<Line> = setup.buses().map(|bus| Line::new(setup, bus, &nodes)).collect();
        // What the drives' profiles lack was found above.
        let mut image = Image::new(setup.mode, &drives, &nodes, sensor_bus, sensor).map_err(of_sensor)?;
        for line in &lines {
            for own in [cob::NMT, cob::SYNC, cob::heartbeat(id)] {
                image.reserve(line.bus, own);
            }
        }
        image.claim_plain().map_err(of_sensor)?;
        let sync = SyncProducer::new(cob::SYNC, 0).map_err(|_| {
            refuse(Some(setup.node_id), "master", "prepare SYNC", BootFailure::NodeId { node_id: setup.node_id })
        })?;
        Ok(Self {
            id,
            heartbeat: setup.heartbeat,
            listening: setup.listening(),
            next_heartbeat: Time::NEVER,
            phase: Phase::Off,
            phase_since: Time::default(),
            nodes,
            sensor_name: setup.sensor.name.clone(),
            sensor_bus,
            sample_wait: setup.sensor.waits.start,
            lines,
            signs: Signs::of_masters(setup),
            has_sent: false,
            sync,
            image,
            events: LinkEvents::default(),
            is_silent: false,
            has_echo: false,
            held: DeviceSet::NONE,
            is_overwritten: false,
            is_sync_held: false,
            is_enabled: false,
            foreign_downloads: 0,
            told: LastTold::default(),
        })
    }

    /// Takes a frame of another node from the bus.
    ///
    /// Real-time: yes, while operational.
    fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        if self.phase != Phase::Operational {
            if let Some(heard) = self.signs.find(frame) {
                return self.give_way(heard);
            }
            if !self.has_sent {
                return;
            }
        }
        match self.image.on_frame(now, frame) {
            Taken::Image => return self.go_on_if_started(),
            taken @ (Taken::Own | Taken::SetPoint) => {
                self.events.intruder = true;
                self.is_overwritten |= taken == Taken::SetPoint;
                return;
            }
            Taken::Other => {}
        }
        let has_echo = self.has_echo;
        for node in self.nodes.iter_mut().filter(|node| node.bus == frame.bus()) {
            node.on_sdo(frame, has_echo);
            if node.is_written_by(frame) {
                self.foreign_downloads = self.foreign_downloads.saturating_add(1);
                node.is_altered |= self.is_enabled;
            }
        }
        let said = nmt::decode_heartbeat(frame);
        let line = self.lines.iter_mut().find(|line| line.bus == frame.bus());
        if let (Some((id, _)), Some(line)) = (said, line) {
            line.heard.insert(id);
        }
        if let Some((id, state)) = said
            && let Some(node) = self.nodes.iter_mut().find(|node| node.is(frame.bus(), id))
        {
            node.said.state = Some(state);
            if self.phase == Phase::Operational {
                node.on_heartbeat(now, state);
            }
        }
        let line = self.lines.iter_mut().find(|line| line.bus == frame.bus());
        if let Some(event) = line.and_then(|line| line.watch.on_frame(now, frame)) {
            return self.on_node(now, frame.bus(), event, out);
        }
        if let Some(emergency) = Emergency::decode(frame) {
            self.on_emergency(now, frame.bus(), emergency);
            return;
        }
        if self.phase == Phase::Configuring {
            self.configure(now, out, |node, now, out| match node.bus == frame.bus() {
                true => node.hear_boot(now, frame, out),
                false => Ok(()),
            });
        } else {
            let here = self.nodes.iter_mut().filter(|node| node.bus == frame.bus());
            here.for_each(|node| node.transfer.on_frame(now, frame, &mut out.on(node.bus)));
        }
    }

    /// Notes an emergency of a node, or that its errors have gone.
    fn on_emergency(&mut self, now: Time, bus: BusId, emergency: Emergency) {
        let Some(node) = self.nodes.iter_mut().find(|node| node.is(bus, emergency.node)) else { return };
        // It does not say which axis it is of, and stands for the whole device under the first one.
        let devices = node.devices;
        let Some(device) = Device::ALL.into_iter().find(|device| devices.contains(device.set())) else { return };
        let Emergency { code, register, vendor, .. } = emergency;
        let told = EmergencyReport { time: now, device, code, register, vendor, is_withdrawn: false };
        if self.told.hear(told) {
            node.said.emergency = Some(emergency);
            let events =
                if code.is_warning() { &mut self.events.emergency_warning } else { &mut self.events.emergency };
            *events |= devices;
        } else if register.0 == 0 {
            node.said.emergency = None;
        }
    }
}

/// Distances of the objects of a drive.
fn axes_offset(drives: &[DriveSetup], device: Device) -> AxisOffset {
    let drive = Device::DRIVES.into_iter().zip(drives).find(|(own, _)| *own == device);
    drive.map(|(_, drive)| drive.profile.offset()).unwrap_or_default()
}

fn node_id(raw: u8, name: &str) -> Result<NodeId, BootError> {
    canopen::cob::node_id(raw)
        .map_err(|_| refuse(Some(raw), name, "check the node ids", BootFailure::NodeId { node_id: raw }))
}

fn refuse(node_id: Option<u8>, name: &str, step: &'static str, failure: BootFailure) -> BootError {
    BootError { node_id, name: name.to_owned(), step, failure }
}
