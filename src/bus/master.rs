//! The master: boot, then two moments a cycle.

use std::time::Duration;

use super::boot::{Boot, HEARTBEAT_PERIODS};
use super::error::{BootError, BootFailure};
use super::image::Image;
use super::setup::MasterSetup;
use crate::canopen::nmt::{self, HeartbeatChange, HeartbeatConsumer};
use crate::canopen::{self, Emergency, Frame, NmtCommand, NmtState, NodeId, Outbox, SyncProducer, Time, cob};
use crate::cycle::{Cycle, Inputs, LinkEvents, Outputs, Timing};
use crate::guard::{DeviceSet, Request};

/// How long a node may take from the reset to its boot-up message.
const BOOT_UP_WAIT: Duration = Duration::from_millis(500);
/// How long the nodes may take from the start command to the first heartbeat in Operational.
const START_WAIT: Duration = Duration::from_millis(500);

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
}

impl Node {
    fn new(id: NodeId, device: DeviceSet, name: &str, boot: Boot) -> Self {
        Self { id, device, name: name.to_owned(), boot, has_booted: false, is_operational: false, has_restarted: false }
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
    watch: HeartbeatConsumer,
    sync: SyncProducer,
    image: Image,
    cycle: Cycle,
    inputs: Inputs,
    events: LinkEvents,
    last_emergency: Option<Emergency>,
}

impl Master {
    /// A master that has sent nothing yet.
    ///
    /// # Errors
    /// If node identifiers are out of range or used twice, or if a profile lacks the process data of the command mode.
    pub fn new(setup: &MasterSetup, cycle: Cycle) -> Result<Self, BootError> {
        let id = node_id(setup.node_id, "master")?;
        let names = [&setup.drives[0].name, &setup.drives[1].name, &setup.sensor.name];
        let raw = [setup.drives[0].node_id, setup.drives[1].node_id, setup.sensor.node_id];
        let mut ids = [id; 3];
        for (at, (raw, name)) in raw.into_iter().zip(names).enumerate() {
            let fresh = node_id(raw, name)?;
            if fresh == id || ids.iter().take(at).any(|known| *known == fresh) {
                return Err(refuse(raw, name, "check the node ids", BootFailure::DuplicateNodeId { node_id: raw }));
            }
            ids[at] = fresh;
        }
        let [left, right, sensor] = ids;
        let drives = [(&setup.drives[0], left), (&setup.drives[1], right)];
        let fail = |at: usize| move |failure| refuse(raw[at], names[at], "plan the process data", failure);
        let mut image = Image::new(setup.mode, drives, (&setup.sensor, sensor)).map_err(fail(0))?;
        let mut watch = HeartbeatConsumer::new();
        let mut nodes = Vec::new();
        for (at, (drive, node)) in drives.into_iter().enumerate() {
            watch.watch(node, drive.heartbeat * HEARTBEAT_PERIODS);
            let boot = Boot::drive(setup, drive, node).map_err(fail(at))?;
            nodes.push(Node::new(node, DeviceSet::drive(at), &drive.name, boot));
        }
        watch.watch(sensor, setup.sensor.heartbeat * HEARTBEAT_PERIODS);
        let boot = Boot::sensor(&setup.sensor, sensor).map_err(fail(2))?;
        nodes.push(Node::new(sensor, DeviceSet::SENSOR, &setup.sensor.name, boot));
        let sync = SyncProducer::new(cob::SYNC, 0).map_err(|_| {
            refuse(setup.node_id, "master", "prepare SYNC", BootFailure::NodeId { node_id: setup.node_id })
        })?;
        let nothing = image.arrivals();
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
            watch,
            sync,
            image,
            cycle,
            inputs,
            events: LinkEvents::default(),
            last_emergency: None,
        })
    }

    /// Resets the network and starts to watch it.
    pub fn start(&mut self, now: Time, out: &mut impl Outbox) {
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

    /// The last emergency message of any node.
    pub fn last_emergency(&self) -> Option<Emergency> {
        self.last_emergency
    }

    /// When [`Master::poll`] has to be called again at the latest.
    ///
    /// Real-time: yes.
    pub fn next_deadline(&self) -> Time {
        // In operation the heartbeat follows the set-points, where it is in nobody's way.
        let heartbeat = if self.phase == Phase::Operational { Time::NEVER } else { self.next_heartbeat };
        let base = heartbeat.min(self.watch.next_deadline()).min(self.phase_deadline);
        if self.phase != Phase::Configuring {
            return base;
        }
        self.nodes.iter().map(|node| node.boot.next_deadline()).fold(base, Time::min)
    }

    /// Takes a frame from the bus.
    ///
    /// Real-time: yes, while operational.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        if self.image.on_frame(frame) {
            return;
        }
        if let Some(event) = self.watch.on_frame(now, frame) {
            return self.on_node(now, event.node, event.change, out);
        }
        if let Some(emergency) = Emergency::decode(frame) {
            if !emergency.code.is_reset()
                && let Some(node) = self.nodes.iter().find(|node| node.id == emergency.node)
            {
                self.last_emergency = Some(emergency);
                self.events.emergency |= node.device;
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
            }
            _ => {}
        }
    }

    /// The begin of a cycle: SYNC alone.
    ///
    /// Real-time: yes.
    pub fn on_sync(&mut self, out: &mut impl Outbox) {
        self.image.begin_cycle();
        out.push(self.sync.next_frame());
    }

    /// The moment at which all process data are in: runs the cycle and sends the set-points that the next SYNC makes
    /// the drives apply. A heartbeat that is due goes out behind them. `timing` says how this cycle ran against its
    /// grid.
    ///
    /// Real-time: yes.
    pub fn on_compute(&mut self, now: Time, request: Request, timing: Timing, out: &mut impl Outbox) -> Outputs {
        let arrivals = self.image.arrivals();
        let mut link = std::mem::take(&mut self.events);
        link.bad_length |= arrivals.bad_length;
        // A node that is not there stays a fault, so that the rig cannot be enabled again without it.
        for node in &self.nodes {
            link.node_reset |= node.device.only_if(node.has_restarted);
            link.heartbeat_lost |= node.device.only_if(!node.is_operational);
        }
        self.inputs = Inputs { drives: arrivals.drives, sample: arrivals.sample, link, timing, request };
        let outputs = self.cycle.step(&self.inputs);
        if outputs.directive.fault_reset {
            self.image.request_fault_reset();
        }
        self.image.send(outputs.directive.goal, &outputs.command, out);
        self.send_heartbeat(now, out);
        outputs
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
                    let error = refuse(id.raw(), &node.name, step, failure);
                    self.enter(Phase::Failed(error));
                }
            }
            (HeartbeatChange::BootUp, Phase::Starting) => {
                let failure = BootFailure::Restarted { times: 1 };
                let error = refuse(id.raw(), &node.name, "start the node", failure);
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

    /// From Starting to Operational when all nodes are there.
    fn go_on_if_started(&mut self) {
        if self.phase == Phase::Starting && self.nodes.iter().all(|node| node.is_operational) {
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
                let error = refuse(node.id.raw(), &node.name, step, failure);
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
            // Nodes that have started by themselves do not say so again.
            self.go_on_if_started();
        }
    }

    fn fail_where(&mut self, is_late: impl Fn(&Node) -> bool, step: &'static str, waited: Duration) {
        if let Some(node) = self.nodes.iter().find(|node| is_late(node)) {
            let failure = BootFailure::Missing { waited_ms: waited.as_millis() as u64 };
            let error = refuse(node.id.raw(), &node.name, step, failure);
            self.enter(Phase::Failed(error));
        }
        self.phase_deadline = Time::NEVER;
    }
}

fn node_id(raw: u8, name: &str) -> Result<NodeId, BootError> {
    canopen::cob::node_id(raw)
        .map_err(|_| refuse(raw, name, "check the node ids", BootFailure::NodeId { node_id: raw }))
}

fn refuse(node_id: u8, name: &str, step: &'static str, failure: BootFailure) -> BootError {
    BootError { node_id, name: name.to_owned(), step, failure }
}
