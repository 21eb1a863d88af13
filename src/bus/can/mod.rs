//! The rig's CAN buses as one network: boot, then raw words that come and go twice a cycle.

mod access;
mod boot;
pub mod budget;
mod image;
mod line;
mod node;
mod plan;
mod states;
mod transfer;
mod waiting;

use std::time::Duration;

use super::LinkEvent;
use super::axis::{Arrived, DriveOrders};
use super::emergency::{EmergencyReport, LastTold};
use super::error::{BootError, BootFailure};
use super::phase::Phase;
use super::setup::{MasterSetup, SensorLink};
use super::signs::Signs;
use boot::Boot;
use image::{Image, SensorFrames, Taken};
use line::Line;
use node::Node;
use yieldwall_fieldbus::canopen::nmt;
use yieldwall_fieldbus::canopen::{self, BusId, Emergency, Frame, NodeId, Outbox, SyncProducer, cob};
use yieldwall_fieldbus::plain_can::Client;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::cycle::LinkEvents;
use yieldwall_motion::guard::{Device, DeviceSet};

pub use plan::{BootPlan, NodePlan, PlannedWrite};
pub use waiting::Waiting;

/// All CAN buses of a rig.
///
/// Frames come with their bus ([`Frame::bus`]) and leave with it. SYNC, NMT commands and the master's
/// heartbeat go to every bus where somebody hears them, and nothing is exchanged before the nodes of all buses are there.
#[derive(Clone)]
pub(super) struct CanNetwork {
    id: NodeId,
    heartbeat: Duration,
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
    /// What another master is known by, until process data are exchanged.
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
        let drives = setup.drives.iter().map(|drive| Ok((drive, fresh(drive.bus, drive.node_id, &drive.name)?)));
        let drives = drives.collect::<Result<Vec<_>, BootError>>()?;
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
        for (device, (drive, node)) in Device::DRIVES.into_iter().zip(drives.iter().copied()) {
            let boot = Boot::drive(setup, drive, node)
                .map_err(|failure| refuse(Some(drive.node_id), &drive.name, PLAN, failure))?;
            nodes.push(Node::new(drive.bus, node, device, &drive.name, drive.heartbeat, drive.waits, boot));
        }
        if let SensorFrames::Canopen(node, id) = sensor {
            let waits = setup.sensor.waits;
            let boot = Boot::sensor(node, id, waits.sdo).map_err(of_sensor)?;
            let name = &setup.sensor.name;
            nodes.push(Node::new(sensor_bus, id, Device::Sensor, name, node.heartbeat, waits, boot));
        }
        let lines: Vec<Line> = setup.buses().map(|bus| Line::new(setup, bus, &nodes)).collect();
        // What the drives' profiles lack was found above.
        let mut image = Image::new(setup.mode, &drives, sensor_bus, sensor).map_err(of_sensor)?;
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
            foreign_downloads: 0,
            told: LastTold::default(),
        })
    }

    /// Has the second frame of a sample on plain CAN come as late as this behind the first.
    pub(super) fn set_pair_gap(&mut self, gap: Duration) {
        self.image.plain_mut().into_iter().for_each(|client| client.set_pair_gap(gap));
    }

    /// Where the network stands.
    pub(super) fn phase(&self) -> &Phase {
        &self.phase
    }

    /// Whether nothing is sent any more, so that the drives' watchdogs act.
    pub(super) fn is_silent(&self) -> bool {
        self.is_silent
    }

    /// Falls silent, or goes on when a person has the exchange go on.
    pub(super) fn set_silent(&mut self, is_silent: bool) {
        if self.is_silent && !is_silent {
            // What was on its way is gone.
            self.lines.iter_mut().for_each(|line| line.in_flight = 0);
        }
        self.is_silent = is_silent;
    }

    /// Has set-points leave whatever holds them back.
    pub(super) fn unmute(&mut self) {
        (self.is_silent, self.held) = (false, DeviceSet::NONE);
    }

    /// How often somebody else began to write to a configured node by SDO.
    pub(super) fn foreign_downloads(&self) -> u32 {
        self.foreign_downloads
    }

    /// What the devices told last, at most eight, the oldest first.
    pub(super) fn told(&self) -> impl Iterator<Item = EmergencyReport> {
        self.told.iter()
    }

    /// Forgets what the devices told.
    pub(super) fn forget_told(&mut self) {
        self.told.forget();
    }

    /// Takes a frame of another node from the bus; own ones go to [`CanNetwork::on_echo`]. `is_enabled` says whether the
    /// rig is, or tries to be.
    ///
    /// Real-time: yes, while operational.
    pub(crate) fn on_frame(&mut self, now: Time, frame: &Frame, is_enabled: bool, out: &mut impl Outbox) {
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
                node.is_altered |= is_enabled;
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
            if !emergency.code.is_reset()
                && let Some(node) = self.nodes.iter_mut().find(|node| node.is(frame.bus(), emergency.node))
            {
                node.said.emergency = Some(emergency);
                if emergency.code.is_warning() {
                    self.events.emergency_warning |= node.device.set();
                } else {
                    self.events.emergency |= node.device.set();
                }
                let Emergency { code, register, vendor, .. } = emergency;
                self.told.note(EmergencyReport { time: now, device: node.device, code, register, vendor });
            }
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

    /// Takes an own frame that was seen on the bus. A link that cannot show own frames never calls this, and what is still
    /// on its way is then not watched.
    ///
    /// Real-time: yes.
    pub(crate) fn on_echo(&mut self, frame: &Frame) {
        self.has_echo = true;
        let is_set_point = self.image.is_set_point(frame);
        if let Some(line) = self.lines.iter_mut().find(|line| line.bus == frame.bus()) {
            line.on_echo(frame, is_set_point);
        }
        self.nodes.iter_mut().filter(|node| node.bus == frame.bus()).for_each(|node| node.on_echo(frame));
    }

    /// The begin of a cycle: SYNC, and behind it the request to a sensor that is polled.
    ///
    /// At most one cycle is in flight: while set-points of an earlier cycle have not been seen on their bus, or SYNC on a bus
    /// without set-points, neither SYNC nor set-points are sent on any. At the second such cycle in a row the master falls
    /// silent ([`CanNetwork::is_silent`]).
    ///
    /// Drives act at SYNC on the last set-point that they heard. After one of somebody else SYNC therefore waits on all buses
    /// until own ones, which the cycle has computed as the answer to [`Fault::Intruder`], were sent and seen.
    /// Sending them here already would gain nothing: the SYNC that makes the drives act on them is that of the next cycle.
    ///
    /// Real-time: yes.
    pub(crate) fn open(&mut self, out: &mut impl Outbox) {
        self.image.begin_cycle();
        let waiting = self.lines.iter().filter(|line| self.has_echo && line.in_flight > 0);
        self.held = waiting.fold(DeviceSet::NONE, |held, line| held | DeviceSet::interface(line.bus.index()));
        self.is_sync_held = self.is_mute() || self.is_overwritten;
        if !self.is_sync_held {
            self.send_sync(out);
            self.lines.iter_mut().for_each(Line::note_sync);
            if let Some(client) = self.image.plain_mut() {
                client.read(&mut out.on(self.sensor_bus));
            }
        }
    }

    /// The devices of which something of that is missing.
    ///
    /// Real-time: yes.
    pub(crate) fn missing(&self, now: Time) -> DeviceSet {
        self.image.missing(now)
    }

    /// Forgets when the nodes' heartbeats came, which do not tell one device from two where they waited to be taken.
    ///
    /// Real-time: yes.
    pub(crate) fn forget_heartbeat_times(&mut self) {
        self.nodes.iter_mut().for_each(Node::forget_times);
    }

    /// Whether SYNC was held back in this cycle, since the set-points of an earlier one are still on their way, a drive may
    /// hold a set-point of somebody else, or nothing is sent at all: no process data can come.
    ///
    /// Real-time: yes.
    pub(crate) fn is_sync_held(&self) -> bool {
        self.is_sync_held
    }

    /// Whether neither SYNC nor set-points are sent in this cycle.
    pub(crate) fn is_mute(&self) -> bool {
        self.is_silent || !self.held.is_empty()
    }

    /// Whether set-points, or SYNC where there are none, were sent that have not been seen on their bus yet.
    ///
    /// Real-time: yes.
    pub(crate) fn is_in_flight(&self) -> bool {
        self.lines.iter().any(|line| line.in_flight > 0)
    }

    /// SYNC on every bus where somebody hears it, outside of any cycle; none while a drive may hold a set-point of somebody
    /// else.
    pub(crate) fn repeat_sync(&mut self, out: &mut impl Outbox) {
        if !self.is_overwritten {
            self.send_sync(out);
        }
    }

    fn send_sync(&mut self, out: &mut impl Outbox) {
        let sync = self.sync.next_frame();
        self.lines.iter().filter(|line| line.has_sync).for_each(|line| out.push(sync.on_bus(line.bus)));
    }

    /// A heartbeat if one is due; when the last one was sent.
    pub(crate) fn repeat_heartbeat(&mut self, now: Time, out: &mut impl Outbox) -> Time {
        self.send_heartbeat(now, out);
        Time(self.next_heartbeat.0.saturating_sub(self.heartbeat.as_nanos() as u64))
    }

    /// The heartbeat period that the drives watch.
    pub(crate) fn heartbeat_period(&self) -> Duration {
        self.heartbeat
    }

    /// What has come by `now`, and what has happened since the last cycle.
    ///
    /// Real-time: yes.
    pub(crate) fn take(&mut self, now: Time) -> Arrived {
        let arrivals = self.image.arrivals(now);
        let mut link = std::mem::take(&mut self.events);
        link.bad_length = arrivals.irregular.bad_length;
        link.duplicated = arrivals.irregular.duplicated;
        link.late = arrivals.irregular.late;
        link.transmit_stalled = self.held;
        // A node that is not there stays a fault, so that the rig cannot be enabled again without it.
        for node in &self.nodes {
            link.intruder |= node.is_altered;
            link.node_reset |= node.device.only_if(node.has_restarted);
            link.duplicate_node |= node.device.only_if(node.is_double);
            link.heartbeat_lost |= node.device.only_if(!(node.is_operational || node.has_restarted));
        }
        if link.intruder {
            // What nodes do in the cycle of a stranger's command is its effect; if it stays, the next cycle shows it.
            (link.heartbeat_lost, link.node_reset) = (DeviceSet::NONE, DeviceSet::NONE);
        }
        Arrived { drives: arrivals.drives, sample: arrivals.sample, link }
    }

    /// Sends what the drives shall do, which the next SYNC makes them apply, and behind it a heartbeat that is due.
    ///
    /// Real-time: yes.
    pub(crate) fn close(&mut self, now: Time, orders: &[DriveOrders; 2], out: &mut impl Outbox) {
        self.send(orders, out);
        // What was heard up to the computation is the cycle's cause to stop both drives.
        self.is_overwritten = false;
        self.lines.iter_mut().for_each(Line::note_set_points);
        self.send_heartbeat(now, out);
    }

    /// Sends what the drives shall do, outside of any cycle.
    pub(crate) fn send(&self, orders: &[DriveOrders; 2], out: &mut impl Outbox) {
        self.image.send(orders, out);
    }

    /// Notes what the interface to a bus tells; the next cycle acts on it.
    ///
    /// Real-time: yes.
    pub(crate) fn on_link(&mut self, bus: BusId, event: LinkEvent) {
        let events = match event {
            LinkEvent::SendFailed => &mut self.events.send_failed,
            LinkEvent::ErrorPassive => &mut self.events.error_passive,
            LinkEvent::BusOff => &mut self.events.bus_off,
        };
        *events |= DeviceSet::interface(bus.index());
    }
}

fn node_id(raw: u8, name: &str) -> Result<NodeId, BootError> {
    canopen::cob::node_id(raw)
        .map_err(|_| refuse(Some(raw), name, "check the node ids", BootFailure::NodeId { node_id: raw }))
}

fn refuse(node_id: Option<u8>, name: &str, step: &'static str, failure: BootFailure) -> BootError {
    BootError { node_id, name: name.to_owned(), step, failure }
}
