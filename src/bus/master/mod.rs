//! The master: boot, then two moments a cycle.

mod line;
mod network;
mod node;
mod phase;
mod waiting;

use std::time::Duration;

use super::boot::Boot;
use super::error::{BootError, BootFailure};
use super::image::{Image, SensorFrames, Taken};
use super::setup::{MasterSetup, SensorLink};
use super::signs::Signs;
use crate::canopen::nmt;
use crate::canopen::{self, Emergency, Frame, NodeId, Outbox, SyncProducer, Time, cob};
use crate::cycle::{Cycle, Inputs, LinkEvents, Outputs, Timing};
use crate::guard::{Allowed, Cause, DeviceSet, Directive, Fault, Request, State};
use crate::plain_can::Client;
use line::Line;
use node::Node;

pub use phase::{LinkEvent, Phase};
pub use waiting::Waiting;

/// Emergencies that are remembered.
const EMERGENCIES: usize = 8;

/// The master of one rig, on the buses that its devices are on.
///
/// Frames come with the number of their bus ([`Frame::bus`]) and leave with it. SYNC, NMT commands and the master's
/// heartbeat go to every bus where somebody hears them, and nothing is exchanged before the nodes of all buses are there.
#[derive(Clone)]
pub struct Master {
    id: NodeId,
    heartbeat: Duration,
    next_heartbeat: Time,
    phase: Phase,
    /// When the phase began.
    phase_since: Time,
    nodes: Vec<Node>,
    sensor_name: String,
    sensor_bus: u8,
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
    cycle: Cycle,
    inputs: Inputs,
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
    /// Whether the cycle failed and never runs again.
    has_failed: bool,
    last: Outputs,
    /// The last emergencies, a ring, and where the next one goes.
    emergencies: [Option<(Time, Emergency)>; EMERGENCIES],
    next_emergency: usize,
}

impl Master {
    /// A master that has sent nothing yet.
    ///
    /// # Errors
    /// If node identifiers are out of range or used twice, or if a profile lacks the process data of the command mode.
    pub fn new(setup: &MasterSetup, cycle: Cycle) -> Result<Self, BootError> {
        let id = node_id(setup.node_id, "master")?;
        let mut known = Vec::new();
        let mut fresh = |bus: u8, raw: u8, name: &str| -> Result<NodeId, BootError> {
            let fresh = node_id(raw, name)?;
            if fresh == id || known.contains(&(bus, fresh)) {
                let failure = BootFailure::DuplicateNodeId { node_id: raw };
                return Err(refuse(Some(raw), name, "check the node ids", failure));
            }
            known.push((bus, fresh));
            Ok(fresh)
        };
        let [left, right] = &setup.drives;
        let drives = [left, right].map(|drive| Ok((drive, fresh(drive.bus, drive.node_id, &drive.name)?)));
        let [left, right] = drives;
        let drives = [left?, right?];
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
        for (at, (drive, node)) in drives.into_iter().enumerate() {
            let boot = Boot::drive(setup, drive, node)
                .map_err(|failure| refuse(Some(drive.node_id), &drive.name, PLAN, failure))?;
            nodes.push(Node::new(drive.bus, DeviceSet::drive(at), &drive.name, drive.heartbeat, drive.waits, boot));
        }
        if let SensorFrames::Canopen(node, id) = sensor {
            let waits = setup.sensor.waits;
            let boot = Boot::sensor(node, id, waits.sdo).map_err(of_sensor)?;
            nodes.push(Node::new(sensor_bus, DeviceSet::SENSOR, &setup.sensor.name, node.heartbeat, waits, boot));
        }
        let lines: Vec<Line> = setup.buses().map(|bus| Line::new(setup, bus, &nodes)).collect();
        // What the drives' profiles lack was found above.
        let mut image = Image::new(setup.mode, drives, sensor_bus, sensor).map_err(of_sensor)?;
        for line in &lines {
            for own in [cob::NMT, cob::SYNC, cob::heartbeat(id)] {
                image.reserve(line.bus, own);
            }
        }
        image.claim_plain().map_err(of_sensor)?;
        let last = cycle.idle();
        let sync = SyncProducer::new(cob::SYNC, 0).map_err(|_| {
            refuse(Some(setup.node_id), "master", "prepare SYNC", BootFailure::NodeId { node_id: setup.node_id })
        })?;
        let nothing = image.arrivals(Time::default());
        let link = LinkEvents::default();
        let inputs = Inputs {
            drives: nothing.drives,
            sample: nothing.sample,
            link,
            timing: Timing::default(),
            request: Request::None,
        };
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
            cycle,
            inputs,
            events: LinkEvents::default(),
            is_silent: false,
            has_echo: false,
            held: DeviceSet::NONE,
            is_overwritten: false,
            is_sync_held: false,
            foreign_downloads: 0,
            has_failed: false,
            last,
            emergencies: [None; EMERGENCIES],
            next_emergency: 0,
        })
    }

    /// Where the network stands.
    pub fn phase(&self) -> &Phase {
        &self.phase
    }

    /// The rig's cycle, for reports.
    pub fn cycle(&self) -> &Cycle {
        &self.cycle
    }

    /// What entered the last cycle; before the first one, that nothing has arrived.
    ///
    /// Real-time: yes.
    pub fn last_inputs(&self) -> &Inputs {
        &self.inputs
    }

    /// State of the rig.
    pub fn state(&self) -> State {
        if self.has_failed { Directive::QUICK_STOP.state } else { self.cycle.state() }
    }

    /// The fault that led to the present state.
    pub fn cause(&self) -> Option<Cause> {
        if self.has_failed {
            return Some(Cause { fault: Fault::CyclePanicked, devices: DeviceSet::HOST });
        }
        self.cycle.cause()
    }

    /// Whether nothing is sent any more, so that the drives' watchdogs act. A link then drops what its queue still holds,
    /// and sends nothing of it later.
    pub fn is_silent(&self) -> bool {
        self.is_silent
    }

    /// How often somebody else began to write to a configured node by SDO. While the rig is enabled that is
    /// [`Fault::Intruder`], until the network is started anew; otherwise it is only counted. Reading is nobody's harm.
    pub fn foreign_downloads(&self) -> u32 {
        self.foreign_downloads
    }

    /// The last emergency message of any node.
    pub fn last_emergency(&self) -> Option<Emergency> {
        self.emergencies().last().map(|(_, emergency)| emergency)
    }

    /// The last emergency messages of all nodes with the moments at which they came, at most eight, the oldest first.
    pub fn emergencies(&self) -> impl Iterator<Item = (Time, Emergency)> {
        let (newer, older) = self.emergencies.split_at(self.next_emergency);
        older.iter().chain(newer).copied().flatten()
    }

    /// Takes a frame of another node from the bus; own ones go to [`Master::on_echo`].
    ///
    /// Real-time: yes, while operational.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
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
        let (has_echo, state) = (self.has_echo, self.state());
        for node in self.nodes.iter_mut().filter(|node| node.bus == frame.bus()) {
            node.on_sdo(frame, has_echo);
            if node.is_written_by(frame) {
                self.foreign_downloads = self.foreign_downloads.saturating_add(1);
                node.is_altered |= !(state == State::Idle || state.is_latched());
            }
        }
        if let Some((id, state)) = nmt::decode_heartbeat(frame)
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
                    self.events.emergency_warning |= node.device;
                } else {
                    self.events.emergency |= node.device;
                }
                if let Some(place) = self.emergencies.get_mut(self.next_emergency) {
                    *place = Some((now, emergency));
                }
                self.next_emergency = (self.next_emergency + 1) % EMERGENCIES;
            }
            return;
        }
        if self.phase == Phase::Configuring {
            self.configure(now, out, |node, now, out| match node.bus == frame.bus() {
                true => node.boot.on_frame(now, frame, &mut out.on(node.bus)),
                false => Ok(()),
            });
        }
    }

    /// Takes an own frame that was seen on the bus. A link that cannot show own frames never calls this, and what is still
    /// on its way is then not watched.
    ///
    /// Real-time: yes.
    pub fn on_echo(&mut self, frame: &Frame) {
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
    /// silent ([`Master::is_silent`]).
    ///
    /// Drives act at SYNC on the last set-point that they heard. After one of somebody else SYNC therefore waits on all buses
    /// until own ones, which the cycle has computed as the answer to [`Fault::Intruder`], were sent and seen.
    /// Sending them here already would gain nothing: the SYNC that makes the drives act on them is that of the next cycle.
    ///
    /// Real-time: yes.
    pub fn on_sync(&mut self, out: &mut impl Outbox) {
        self.image.begin_cycle();
        let waiting = self.lines.iter().filter(|line| self.has_echo && line.in_flight > 0);
        self.held = waiting.fold(DeviceSet::NONE, |held, line| held | DeviceSet::interface(line.bus));
        self.is_sync_held = self.is_mute() || self.is_overwritten;
        if !self.is_sync_held {
            self.send_sync(out);
            self.lines.iter_mut().for_each(Line::note_sync);
            if let Some(client) = self.image.plain_mut() {
                client.read(&mut out.on(self.sensor_bus));
            }
        }
    }

    /// Whether all that answers SYNC has arrived since [`Master::on_sync`]: the process data of all nodes, the sample of a
    /// sensor that was asked for one, and that of one which streams if its rate has it come by `now`.
    ///
    /// Real-time: yes.
    pub fn has_process_data(&self, now: Time) -> bool {
        self.missing(now).is_empty()
    }

    /// The devices of which something of that is missing.
    ///
    /// Real-time: yes.
    pub fn missing(&self, now: Time) -> DeviceSet {
        self.image.missing(now)
    }

    /// Forgets when the nodes' heartbeats came, which do not tell one device from two where they waited to be taken.
    ///
    /// Real-time: yes.
    pub fn forget_heartbeat_times(&mut self) {
        self.nodes.iter_mut().for_each(Node::forget_times);
    }

    /// Whether SYNC was held back in this cycle, since the set-points of an earlier one are still on their way, a drive may
    /// hold a set-point of somebody else, or nothing is sent at all: no process data can come.
    ///
    /// Real-time: yes.
    pub fn is_sync_held(&self) -> bool {
        self.is_sync_held
    }

    /// Whether neither SYNC nor set-points are sent in this cycle.
    fn is_mute(&self) -> bool {
        self.is_silent || !self.held.is_empty()
    }

    /// Whether set-points, or SYNC where there are none, were sent that have not been seen on their bus yet.
    ///
    /// Real-time: yes.
    pub fn is_in_flight(&self) -> bool {
        self.lines.iter().any(|line| line.in_flight > 0)
    }

    /// SYNC on every bus where somebody hears it, outside of any cycle; none while a drive may hold a set-point of somebody
    /// else.
    pub fn repeat_sync(&mut self, out: &mut impl Outbox) {
        if !self.is_overwritten {
            self.send_sync(out);
        }
    }

    fn send_sync(&mut self, out: &mut impl Outbox) {
        let sync = self.sync.next_frame();
        self.lines.iter().filter(|line| line.has_sync).for_each(|line| out.push(sync.on_bus(line.bus)));
    }

    /// The set-points of the last cycle once more, whatever has happened since: a drive that stops then stops by itself.
    pub fn repeat_set_points(&mut self, out: &mut impl Outbox) {
        self.image.send(self.last.directive.goal, &self.last.command, out);
    }

    /// A heartbeat if one is due; when the last one was sent.
    pub fn repeat_heartbeat(&mut self, now: Time, out: &mut impl Outbox) -> Time {
        self.send_heartbeat(now, out);
        Time(self.next_heartbeat.0.saturating_sub(self.heartbeat.as_nanos() as u64))
    }

    /// The heartbeat period that the drives watch.
    pub fn heartbeat_period(&self) -> Duration {
        self.heartbeat
    }

    /// The moment at which all process data are in: [`Master::step`], and then [`Master::send_set_points`].
    ///
    /// Real-time: yes.
    pub fn on_compute(&mut self, now: Time, request: Request, timing: Timing, out: &mut impl Outbox) -> Outputs {
        let outputs = self.step(now, request, timing);
        self.send_set_points(now, out);
        outputs
    }

    /// Decodes the process data and runs the cycle; nothing is sent. `timing` says how this cycle ran against its grid.
    ///
    /// Real-time: yes.
    pub fn step(&mut self, now: Time, request: Request, timing: Timing) -> Outputs {
        let arrivals = self.image.arrivals(now);
        if self.has_failed {
            return self.last;
        }
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
        self.inputs = Inputs { drives: arrivals.drives, sample: arrivals.sample, link, timing, request };
        self.last = self.cycle.step(&self.inputs);
        if self.last.directive.fault_reset {
            self.image.request_fault_reset();
        }
        if self.is_silent && !self.last.directive.is_silent {
            // A person has the exchange go on: what was on its way is gone.
            self.lines.iter_mut().for_each(|line| line.in_flight = 0);
        }
        self.is_silent = self.last.directive.is_silent;
        self.last
    }

    /// Sends both drives a quick stop without the cycle, which has panicked in the caller's hands. It never runs again:
    /// [`Master::send_set_points`] goes on to send the quick stop, the state is [`State::Disabled`] for good, and its cause
    /// [`Fault::CyclePanicked`].
    ///
    /// Real-time: yes.
    pub fn quick_stop_now(&mut self, now: Time, out: &mut impl Outbox) {
        self.has_failed = true;
        self.last.command = Allowed::rest(self.last.command.get(), self.last.signals.measured_angles);
        self.last.directive = Directive::QUICK_STOP;
        (self.is_silent, self.held) = (false, DeviceSet::NONE);
        self.send_set_points(now, out);
    }

    /// Sends the set-points of the last [`Master::step`], which the next SYNC makes the drives apply, and behind them a
    /// heartbeat that is due.
    ///
    /// Real-time: yes.
    pub fn send_set_points(&mut self, now: Time, out: &mut impl Outbox) {
        if self.is_mute() {
            return self.image.cancel_fault_reset();
        }
        self.image.send(self.last.directive.goal, &self.last.command, out);
        // What was heard up to the computation is the cycle's cause to stop both drives.
        self.is_overwritten = false;
        self.lines.iter_mut().for_each(Line::note_set_points);
        self.send_heartbeat(now, out);
    }

    /// Notes what the interface to a bus tells; the next cycle acts on it.
    ///
    /// Real-time: yes.
    pub fn on_link(&mut self, bus: u8, event: LinkEvent) {
        let events = match event {
            LinkEvent::SendFailed => &mut self.events.send_failed,
            LinkEvent::ErrorPassive => &mut self.events.error_passive,
            LinkEvent::BusOff => &mut self.events.bus_off,
        };
        *events |= DeviceSet::interface(bus);
    }
}

fn node_id(raw: u8, name: &str) -> Result<NodeId, BootError> {
    canopen::cob::node_id(raw)
        .map_err(|_| refuse(Some(raw), name, "check the node ids", BootFailure::NodeId { node_id: raw }))
}

fn refuse(node_id: Option<u8>, name: &str, step: &'static str, failure: BootFailure) -> BootError {
    BootError { node_id, name: name.to_owned(), step, failure }
}
