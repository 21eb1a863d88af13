//! The master: boot, then two moments a cycle.

use std::time::Duration;

use super::boot::{Boot, HEARTBEAT_PERIODS};
use super::error::{BootError, BootFailure};
use super::image::{Image, SensorFrames, Taken};
use super::setup::{MasterSetup, SensorLink};
use crate::canopen::nmt::{self, HeartbeatChange, HeartbeatConsumer};
use crate::canopen::{self, Emergency, Frame, NmtCommand, NmtState, NodeId, Outbox, SyncProducer, Time, cob};
use crate::cycle::{Cycle, Inputs, LinkEvents, Outputs, Timing};
use crate::guard::{Allowed, Cause, DeviceSet, Directive, Fault, Request, State};
use crate::plain_can::Client;

/// How long a node may take from the reset to its boot-up message.
const BOOT_UP_WAIT: Duration = Duration::from_millis(500);
/// How long the nodes may take from the start command to the first heartbeat in Operational.
const START_WAIT: Duration = Duration::from_millis(500);

/// Emergencies that are remembered.
const EMERGENCIES: usize = 8;
/// So many heartbeats of one node ...
const HEARTBEATS_OF_TWO: usize = 4;
/// ... within so many of its periods are those of two nodes. A node of its own takes at least three periods less the delay
/// of the first; a delay of one and a quarter periods, with every later one in time, does not occur: on a bus that was
/// blocked for that long the process data are missing too.
const PERIODS_OF_TWO: f64 = 1.75;

/// Where the network stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Nothing was sent yet.
    Off,
    /// The nodes were reset and have to announce themselves.
    Resetting,
    /// The nodes are configured.
    Configuring,
    /// The nodes were started.
    Starting,
    /// Process data are exchanged; `on_sync` and `on_compute` are called every cycle.
    Operational,
    /// A node is missing or is not what it should be. Final: nothing is enabled.
    Failed(BootError),
}

/// What the caller's interface to the bus tells of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkEvent {
    /// Own frames could not be sent, or the interface is down.
    SendFailed,
    /// The controller is error-passive.
    ErrorPassive,
    /// The controller is bus-off.
    BusOff,
}

#[derive(Clone)]
struct Node {
    id: NodeId,
    device: DeviceSet,
    name: String,
    boot: Boot,
    has_booted: bool,
    /// Whether its last heartbeat said Operational and is not too old.
    is_operational: bool,
    /// Whether it restarted after it was configured: its watchdogs and limits are gone until the master starts anew.
    has_restarted: bool,
    /// Shortest time in which one node sends [`HEARTBEATS_OF_TWO`] heartbeats.
    shortest: Duration,
    /// When its last heartbeats came, the oldest first.
    heard: [Option<Time>; HEARTBEATS_OF_TWO - 1],
    /// Whether another device uses its identifier.
    is_double: bool,
}

impl Node {
    fn new(id: NodeId, device: DeviceSet, name: &str, heartbeat: Duration, boot: Boot) -> Self {
        Self {
            id,
            device,
            name: name.to_owned(),
            boot,
            has_booted: false,
            is_operational: false,
            has_restarted: false,
            shortest: heartbeat.mul_f64(PERIODS_OF_TWO),
            heard: [None; HEARTBEATS_OF_TWO - 1],
            is_double: false,
        }
    }

    /// Forgets all that was heard of it.
    fn restart(&mut self) {
        self.boot.reset();
        (self.has_booted, self.is_operational, self.has_restarted) = (false, false, false);
        (self.heard, self.is_double) = (Default::default(), false);
    }

    /// Notes a heartbeat, and whether it is one too many.
    fn on_heartbeat(&mut self, now: Time, state: NmtState) {
        if state == NmtState::Initialising {
            self.heard = Default::default();
            return;
        }
        // A node that restarted waits for its start command; one that goes on is another one.
        self.is_double |= self.has_restarted && state == NmtState::Operational;
        let [oldest, later @ ..] = self.heard;
        self.is_double |= oldest.is_some_and(|oldest| now.since(oldest) <= self.shortest);
        let [second, third] = later;
        self.heard = [second, third, Some(now)];
    }
}

/// The master of one bus with one rig on it.
#[derive(Clone)]
pub struct Master {
    id: NodeId,
    heartbeat: Duration,
    next_heartbeat: Time,
    phase: Phase,
    phase_deadline: Time,
    nodes: Vec<Node>,
    sensor_name: String,
    watch: HeartbeatConsumer,
    sync: SyncProducer,
    image: Image,
    cycle: Cycle,
    inputs: Inputs,
    events: LinkEvents,
    /// Whether nothing is sent: the bus could not be reached, and the drives' watchdogs shall act.
    is_silent: bool,
    /// Set-points that were sent and not seen on the bus yet.
    in_flight: u8,
    /// Whether the link shows own frames; without that nothing is known of what is still on its way.
    has_echo: bool,
    /// Whether SYNC and set-points of this cycle are held back.
    is_held: bool,
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
        let mut known = vec![id];
        let mut fresh = |raw: u8, name: &str| -> Result<NodeId, BootError> {
            let fresh = node_id(raw, name)?;
            if known.contains(&fresh) {
                let failure = BootFailure::DuplicateNodeId { node_id: raw };
                return Err(refuse(Some(raw), name, "check the node ids", failure));
            }
            known.push(fresh);
            Ok(fresh)
        };
        let [left, right] = &setup.drives;
        let drives = [(left, fresh(left.node_id, &left.name)?), (right, fresh(right.node_id, &right.name)?)];
        let (sensor, sensor_id) = match &setup.sensor.link {
            SensorLink::Canopen(node) => {
                (SensorFrames::Canopen(node, fresh(node.node_id, &setup.sensor.name)?), Some(node.node_id))
            }
            SensorLink::PlainCan(link) => (SensorFrames::PlainCan(Client::new(*link)), None),
        };
        const PLAN: &str = "plan the process data";
        let of_sensor = |failure| refuse(sensor_id, &setup.sensor.name, PLAN, failure);
        let mut watch = HeartbeatConsumer::new();
        let mut nodes = Vec::new();
        for (at, (drive, node)) in drives.into_iter().enumerate() {
            watch.watch(node, drive.heartbeat * HEARTBEAT_PERIODS);
            let boot = Boot::drive(setup, drive, node)
                .map_err(|failure| refuse(Some(drive.node_id), &drive.name, PLAN, failure))?;
            nodes.push(Node::new(node, DeviceSet::drive(at), &drive.name, drive.heartbeat, boot));
        }
        if let SensorFrames::Canopen(setup_of_node, node) = sensor {
            watch.watch(node, setup_of_node.heartbeat * HEARTBEAT_PERIODS);
            let boot = Boot::sensor(setup_of_node, node).map_err(of_sensor)?;
            nodes.push(Node::new(node, DeviceSet::SENSOR, &setup.sensor.name, setup_of_node.heartbeat, boot));
        }
        // What the drives' profiles lack was found above.
        let mut image = Image::new(setup.mode, drives, sensor).map_err(of_sensor)?;
        for own in [cob::NMT, cob::SYNC, cob::heartbeat(id)] {
            image.reserve(own);
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
            phase_deadline: Time::NEVER,
            nodes,
            sensor_name: setup.sensor.name.clone(),
            watch,
            sync,
            image,
            cycle,
            inputs,
            events: LinkEvents::default(),
            is_silent: false,
            in_flight: 0,
            has_echo: false,
            is_held: false,
            has_failed: false,
            last,
            emergencies: [None; EMERGENCIES],
            next_emergency: 0,
        })
    }

    /// Resets the network and starts to watch it: the first time, and again when a person restarts the rig after a node
    /// was reset or lost. Nothing is remembered of what was before but the emergencies, and nothing is enabled.
    ///
    /// After [`Master::quick_stop_now`] it does nothing: only a new master can tell what the cycle does.
    pub fn start(&mut self, now: Time, out: &mut impl Outbox) {
        if self.has_failed {
            return;
        }
        self.cycle.restart();
        self.image.restart();
        self.watch.restart();
        self.nodes.iter_mut().for_each(Node::restart);
        self.events = LinkEvents::default();
        (self.is_silent, self.is_held, self.in_flight, self.has_echo) = (false, false, 0, false);
        self.last = self.cycle.idle();
        self.enter(Phase::Resetting);
        self.phase_deadline = now + BOOT_UP_WAIT;
        out.push(nmt::command(NmtCommand::ResetNode, None));
        self.next_heartbeat = now;
        self.send_heartbeat(now, out);
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

    /// The last emergency message of any node.
    pub fn last_emergency(&self) -> Option<Emergency> {
        self.emergencies().last().map(|(_, emergency)| emergency)
    }

    /// The last emergency messages of all nodes with the moments at which they came, at most eight, the oldest first.
    pub fn emergencies(&self) -> impl Iterator<Item = (Time, Emergency)> {
        let (newer, older) = self.emergencies.split_at(self.next_emergency);
        older.iter().chain(newer).copied().flatten()
    }

    /// When [`Master::poll`] has to be called again at the latest.
    ///
    /// Real-time: yes.
    pub fn next_deadline(&self) -> Time {
        // In operation the heartbeat follows the set-points, where it is in nobody's way.
        let heartbeat = if self.phase == Phase::Operational { Time::NEVER } else { self.next_heartbeat };
        let base = heartbeat.min(self.watch.next_deadline()).min(self.phase_deadline);
        if self.phase == Phase::Starting {
            return self.image.plain().map_or(base, |client| base.min(client.next_deadline()));
        }
        if self.phase != Phase::Configuring {
            return base;
        }
        self.nodes.iter().map(|node| node.boot.next_deadline()).fold(base, Time::min)
    }

    /// Takes a frame of another node from the bus; own ones go to [`Master::on_echo`].
    ///
    /// Real-time: yes, while operational.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        match self.image.on_frame(now, frame) {
            Taken::Image => return self.go_on_if_started(),
            Taken::Own => {
                self.events.intruder = true;
                return;
            }
            Taken::Other => {}
        }
        if self.phase == Phase::Operational
            && let Some((id, state)) = nmt::decode_heartbeat(frame)
            && let Some(node) = self.nodes.iter_mut().find(|node| node.id == id)
        {
            node.on_heartbeat(now, state);
        }
        if let Some(event) = self.watch.on_frame(now, frame) {
            return self.on_node(now, event.node, event.change, out);
        }
        if let Some(emergency) = Emergency::decode(frame) {
            if !emergency.code.is_reset()
                && let Some(node) = self.nodes.iter().find(|node| node.id == emergency.node)
            {
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
            self.configure(now, out, |boot, now, out| boot.on_frame(now, frame, out));
        }
    }

    /// Does what time asks for: heartbeat, watched nodes, waits of the boot.
    ///
    /// Real-time: yes, while operational.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        if self.phase != Phase::Operational {
            self.send_heartbeat(now, out);
        }
        while let Some(event) = self.watch.poll(now) {
            self.on_node(now, event.node, event.change, out);
        }
        match self.phase {
            Phase::Configuring => self.configure(now, out, |boot, now, out| boot.poll(now, out)),
            Phase::Resetting if now >= self.phase_deadline => {
                self.fail_where(|node| !node.has_booted, "wait for the boot-up message", BOOT_UP_WAIT);
            }
            Phase::Starting if now >= self.phase_deadline => {
                self.fail_where(|node| !node.is_operational, "start the node", START_WAIT);
                self.fail_without_sample();
            }
            Phase::Starting => {
                if let Some(client) = self.image.plain_mut() {
                    client.poll(now, out);
                }
            }
            _ => {}
        }
    }

    /// Takes an own frame that was seen on the bus. A link that cannot show own frames never calls this, and what is still
    /// on its way is then not watched.
    ///
    /// Real-time: yes.
    pub fn on_echo(&mut self, frame: &Frame) {
        self.has_echo = true;
        if self.image.is_set_point(frame.id()) {
            self.in_flight = self.in_flight.saturating_sub(1);
        }
    }

    /// The begin of a cycle: SYNC, and behind it the request to a sensor that is polled.
    ///
    /// At most one cycle is in flight: while set-points of an earlier cycle have not been seen on the bus, neither SYNC nor
    /// set-points are sent. At the second such cycle in a row the master falls silent ([`Master::is_silent`]).
    ///
    /// Real-time: yes.
    pub fn on_sync(&mut self, out: &mut impl Outbox) {
        self.image.begin_cycle();
        self.is_held = self.has_echo && self.in_flight > 0;
        if !(self.is_silent || self.is_held) {
            out.push(self.sync.next_frame());
            if let Some(client) = self.image.plain() {
                client.read(out);
            }
        }
    }

    /// Whether the process data of all nodes have arrived since [`Master::on_sync`].
    ///
    /// Real-time: yes.
    pub fn has_process_data(&self) -> bool {
        self.image.is_complete()
    }

    /// Whether SYNC was held back in this cycle, since the set-points of an earlier one are still on their way or nothing
    /// is sent at all: no process data can come.
    ///
    /// Real-time: yes.
    pub fn is_sync_held(&self) -> bool {
        self.is_held || self.is_silent
    }

    /// Whether set-points were sent that have not been seen on the bus yet.
    ///
    /// Real-time: yes.
    pub fn is_in_flight(&self) -> bool {
        self.in_flight > 0
    }

    /// SYNC once more, outside of any cycle.
    pub fn repeat_sync(&mut self, out: &mut impl Outbox) {
        out.push(self.sync.next_frame());
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

    /// Leaves the network: the nodes go to Pre-operational, where nobody waits for set-points. For a rig that was stopped.
    pub fn leave(&mut self, out: &mut impl Outbox) {
        self.enter(Phase::Off);
        out.push(nmt::command(NmtCommand::EnterPreOperational, None));
    }

    /// The moment at which all process data are in: runs the cycle and sends the set-points that the next SYNC makes
    /// the drives apply. A heartbeat that is due goes out behind them. `timing` says how this cycle ran against its
    /// grid.
    ///
    /// Real-time: yes.
    pub fn on_compute(&mut self, now: Time, request: Request, timing: Timing, out: &mut impl Outbox) -> Outputs {
        let arrivals = self.image.arrivals(now);
        if self.has_failed {
            self.send(now, out);
            return self.last;
        }
        let mut link = std::mem::take(&mut self.events);
        link.bad_length = arrivals.irregular.bad_length;
        link.duplicated = arrivals.irregular.duplicated;
        link.late = arrivals.irregular.late;
        link.transmit_stalled = self.is_held;
        // A node that is not there stays a fault, so that the rig cannot be enabled again without it.
        for node in &self.nodes {
            link.node_reset |= node.device.only_if(node.has_restarted);
            link.duplicate_node |= node.device.only_if(node.is_double);
            link.heartbeat_lost |= node.device.only_if(!(node.is_operational || node.has_restarted));
        }
        self.inputs = Inputs { drives: arrivals.drives, sample: arrivals.sample, link, timing, request };
        self.last = self.cycle.step(&self.inputs);
        if self.last.directive.fault_reset {
            self.image.request_fault_reset();
        }
        if self.is_silent && !self.last.directive.is_silent {
            // A person has the exchange go on: what was on its way is gone.
            self.in_flight = 0;
        }
        self.is_silent = self.last.directive.is_silent;
        self.send(now, out);
        self.last
    }

    /// Sends both drives a quick stop without the cycle, which has panicked in the caller's hands. It never runs again:
    /// [`Master::on_compute`] goes on to send the quick stop, the state is [`State::Disabled`] for good, and its cause
    /// [`Fault::CyclePanicked`].
    ///
    /// Real-time: yes.
    pub fn quick_stop_now(&mut self, now: Time, out: &mut impl Outbox) {
        self.has_failed = true;
        self.last.command = Allowed::rest(self.last.command.get(), self.last.signals.measured_angles);
        self.last.directive = Directive::QUICK_STOP;
        (self.is_silent, self.is_held) = (false, false);
        self.send(now, out);
    }

    /// Sends the set-points of this cycle, and a heartbeat that is due.
    fn send(&mut self, now: Time, out: &mut impl Outbox) {
        if self.is_silent || self.is_held {
            return self.image.cancel_fault_reset();
        }
        self.image.send(self.last.directive.goal, &self.last.command, out);
        self.in_flight = 2;
        self.send_heartbeat(now, out);
    }

    /// Notes what the interface tells; the next cycle acts on it.
    ///
    /// Real-time: yes.
    pub fn on_link(&mut self, event: LinkEvent) {
        match event {
            LinkEvent::SendFailed => self.events.send_failed = true,
            LinkEvent::ErrorPassive => self.events.error_passive = true,
            LinkEvent::BusOff => self.events.bus_off = true,
        }
    }

    fn enter(&mut self, phase: Phase) {
        tracing::debug!(?phase, "network");
        self.phase = phase;
        // What the old phase waited for is over.
        self.phase_deadline = Time::NEVER;
    }

    fn send_heartbeat(&mut self, now: Time, out: &mut impl Outbox) {
        if now < self.next_heartbeat {
            return;
        }
        let state = if self.phase == Phase::Operational { NmtState::Operational } else { NmtState::PreOperational };
        out.push(nmt::heartbeat(self.id, state));
        self.next_heartbeat = now + self.heartbeat;
    }

    fn on_node(&mut self, now: Time, id: NodeId, change: HeartbeatChange, out: &mut impl Outbox) {
        let Some(node) = self.nodes.iter_mut().find(|node| node.id == id) else { return };
        node.is_operational = matches!(
            change,
            HeartbeatChange::Present(NmtState::Operational) | HeartbeatChange::State(NmtState::Operational)
        );
        match (change, &self.phase) {
            (HeartbeatChange::BootUp, Phase::Resetting) => {
                node.has_booted = true;
                if self.nodes.iter().all(|node| node.has_booted) {
                    self.enter(Phase::Configuring);
                    self.configure(now, out, |boot, now, out| boot.start(now, out));
                }
            }
            (HeartbeatChange::BootUp, Phase::Configuring) => {
                let step = node.boot.doing();
                if let Err(failure) = node.boot.restart(now, out) {
                    let error = refuse(Some(id.raw()), &node.name, step, failure);
                    self.enter(Phase::Failed(error));
                }
            }
            (HeartbeatChange::BootUp, Phase::Starting) => {
                let failure = BootFailure::Restarted { times: 1 };
                let error = refuse(Some(id.raw()), &node.name, "start the node", failure);
                self.enter(Phase::Failed(error));
            }
            (HeartbeatChange::BootUp, Phase::Operational) => node.has_restarted = true,
            (HeartbeatChange::BootUp, _) => {}
            // Seen in the cycle even if the node comes back before it.
            (HeartbeatChange::Lost, _) => self.events.heartbeat_lost |= node.device,
            (HeartbeatChange::Present(_) | HeartbeatChange::State(_), _) => {
                self.events.heartbeat_lost |= node.device.only_if(!node.is_operational);
                self.go_on_if_started();
            }
        }
    }

    /// From Starting to Operational when all nodes and the sensor's samples are there.
    fn go_on_if_started(&mut self) {
        let is_there = || {
            let has_samples = self.image.plain().is_none_or(Client::has_begun);
            has_samples && self.nodes.iter().all(|node| node.is_operational)
        };
        if self.phase == Phase::Starting && is_there() {
            self.enter(Phase::Operational);
            self.events = LinkEvents::default();
        }
    }

    /// Lets every node's boot do something, and goes on when all are done.
    fn configure<O: Outbox>(
        &mut self,
        now: Time,
        out: &mut O,
        mut act: impl FnMut(&mut Boot, Time, &mut O) -> Result<(), BootFailure>,
    ) {
        for node in &mut self.nodes {
            if node.boot.is_done() {
                continue;
            }
            let step = node.boot.doing();
            if let Err(failure) = act(&mut node.boot, now, out) {
                let error = refuse(Some(node.id.raw()), &node.name, step, failure);
                self.enter(Phase::Failed(error));
                return;
            }
        }
        if self.nodes.iter().all(|node| node.boot.is_done()) {
            self.enter(Phase::Starting);
            self.phase_deadline = now + START_WAIT;
            for node in &self.nodes {
                self.watch.start(now, node.id);
            }
            out.push(nmt::command(NmtCommand::StartRemoteNode, None));
            if let Some(client) = self.image.plain_mut() {
                client.start(now, out);
            }
            // Nodes that have started by themselves do not say so again.
            self.go_on_if_started();
        }
    }

    fn fail_where(&mut self, is_late: impl Fn(&Node) -> bool, step: &'static str, waited: Duration) {
        if let Some(node) = self.nodes.iter().find(|node| is_late(node)) {
            let failure = BootFailure::Missing { waited_ms: waited.as_millis() as u64 };
            let error = refuse(Some(node.id.raw()), &node.name, step, failure);
            self.enter(Phase::Failed(error));
        }
        self.phase_deadline = Time::NEVER;
    }

    fn fail_without_sample(&mut self) {
        if self.phase == Phase::Starting && !self.image.plain().is_none_or(Client::has_begun) {
            let failure = BootFailure::NoSample { waited_ms: START_WAIT.as_millis() as u64 };
            let error = refuse(None, &self.sensor_name, "wait for samples", failure);
            self.enter(Phase::Failed(error));
        }
    }
}

fn node_id(raw: u8, name: &str) -> Result<NodeId, BootError> {
    canopen::cob::node_id(raw)
        .map_err(|_| refuse(Some(raw), name, "check the node ids", BootFailure::NodeId { node_id: raw }))
}

fn refuse(node_id: Option<u8>, name: &str, step: &'static str, failure: BootFailure) -> BootError {
    BootError { node_id, name: name.to_owned(), step, failure }
}
