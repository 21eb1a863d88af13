//! The network from the reset to the exchange of process data, and what its nodes say of themselves.

use std::time::Duration;

use super::line::Line;
use super::node::Node;
use super::{CanNetwork, refuse};
use crate::error::{BootFailure, Others};
use crate::phase::Phase;
use crate::signs::HeardFrame;
use yieldwall_fieldbus::canopen::nmt::{self, HeartbeatChange, HeartbeatEvent};
use yieldwall_fieldbus::canopen::{BusId, Frame, NmtCommand, NmtState, NodeSet, Outbox};
use yieldwall_fieldbus::plain_can::Client;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::cycle::LinkEvents;
use yieldwall_motion::guard::DeviceSet;

impl CanNetwork {
    /// Leaves the network to another master: nothing more is sent until the network is started anew.
    pub(super) fn give_way(&mut self, heard: HeardFrame) {
        if matches!(self.phase, Phase::Failed(_)) {
            return;
        }
        let has_sent = self.has_sent;
        let step = if has_sent { "boot the network" } else { "listen" };
        let error = refuse(Some(self.id.raw()), "master", step, BootFailure::OtherMaster { heard, has_sent });
        self.enter(Phase::Failed(error));
        // Nothing that was asked is repeated.
        self.nodes.iter_mut().for_each(|node| node.transfer.restart());
        (self.is_silent, self.next_heartbeat) = (true, Time::NEVER);
    }

    /// Resets the nodes of the rig, no others, and starts to watch them. Nothing is remembered of what was before but the emergencies.
    pub(super) fn reset(&mut self, now: Time, out: &mut impl Outbox) {
        self.image.restart();
        self.lines.iter_mut().for_each(Line::restart);
        self.nodes.iter_mut().for_each(Node::restart);
        self.events = LinkEvents::default();
        self.is_enabled = false;
        (self.is_silent, self.held, self.has_echo) = (false, DeviceSet::NONE, false);
        (self.is_overwritten, self.is_sync_held) = (false, false);
        self.enter(Phase::Resetting);
        self.phase_since = now;
        self.has_sent = true;
        for node in &self.nodes {
            out.push(nmt::command(node.boot.reset_command(), Some(node.id)).on_bus(node.bus));
        }
        self.next_heartbeat = now;
        self.send_heartbeat(now, out);
    }

    /// The latest moment for the next call of [`CanNetwork::on_time`].
    ///
    /// Real-time: yes.
    pub(super) fn deadline(&self) -> Time {
        let watched = self.lines.iter().map(|line| line.watch.next_deadline()).fold(Time::NEVER, Time::min);
        let asked = self.nodes.iter().map(|node| node.transfer.deadline()).fold(Time::NEVER, Time::min);
        if self.phase == Phase::Operational {
            // The heartbeat follows the set-points, where it is in nobody's way.
            return watched.min(asked);
        }
        let base = self.next_heartbeat.min(watched).min(asked).min(self.phase_deadline());
        if self.phase == Phase::Starting {
            return self.image.plain().map_or(base, |client| base.min(client.next_deadline()));
        }
        if self.phase != Phase::Configuring {
            return base;
        }
        self.nodes.iter().map(|node| node.boot_deadline()).fold(base, Time::min)
    }

    /// Does what time asks for: heartbeat, watched nodes, waits of the boot.
    ///
    /// Real-time: yes, while operational.
    pub(super) fn on_time(&mut self, now: Time, out: &mut impl Outbox) {
        if self.phase != Phase::Operational {
            self.send_heartbeat(now, out);
        }
        while let Some((bus, event)) = self.lines.iter_mut().find_map(|line| Some((line.bus, line.watch.poll(now)?))) {
            self.on_node(now, bus, event, out);
        }
        self.nodes.iter_mut().for_each(|node| node.transfer.poll(now, &mut out.on(node.bus)));
        match self.phase {
            Phase::Configuring => self.configure(now, out, Node::poll_boot),
            Phase::Resetting | Phase::Starting if now >= self.phase_deadline() => self.give_up(now),
            Phase::Starting => {
                if let Some(client) = self.image.plain_mut() {
                    client.poll(now, &mut out.on(self.sensor_bus));
                }
            }
            _ => {}
        }
    }

    pub(super) fn enter(&mut self, phase: Phase) {
        tracing::debug!(?phase, "network");
        self.phase = phase;
    }

    /// Commands each node of the rig, and no other that may be on its bus.
    pub(super) fn command(&self, command: NmtCommand, out: &mut impl Outbox) {
        self.nodes.iter().for_each(|node| out.push(nmt::command(command, Some(node.id)).on_bus(node.bus)));
    }

    /// Sends a frame to every bus that has nodes.
    fn tell_nodes(&self, frame: Frame, out: &mut impl Outbox) {
        self.lines.iter().filter(|line| line.has_nodes).for_each(|line| out.push(frame.on_bus(line.bus)));
    }

    pub(super) fn send_heartbeat(&mut self, now: Time, out: &mut impl Outbox) {
        if now < self.next_heartbeat {
            return;
        }
        let state = if self.phase == Phase::Operational { NmtState::Operational } else { NmtState::PreOperational };
        self.tell_nodes(nmt::heartbeat(self.id, state), out);
        self.next_heartbeat = now + self.heartbeat;
    }

    pub(super) fn on_node(&mut self, now: Time, bus: BusId, event: HeartbeatEvent, out: &mut impl Outbox) {
        let HeartbeatEvent { node: id, change } = event;
        let Some(node) = self.nodes.iter_mut().find(|node| node.is(bus, id)) else { return };
        node.is_operational = matches!(
            change,
            HeartbeatChange::Present(NmtState::Operational) | HeartbeatChange::State(NmtState::Operational)
        );
        match (change, &self.phase) {
            (HeartbeatChange::BootUp, Phase::Resetting) => {
                node.has_booted = true;
                if self.nodes.iter().all(|node| node.has_booted) {
                    self.enter(Phase::Configuring);
                    self.phase_since = now;
                    self.configure(now, out, Node::start_boot);
                }
            }
            (HeartbeatChange::BootUp, Phase::Configuring) => {
                let step = node.boot.doing();
                if let Err(failure) = node.restart_boot(now, out) {
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
            (HeartbeatChange::Lost, _) => self.events.heartbeat_lost |= node.devices,
            (HeartbeatChange::Present(_) | HeartbeatChange::State(_), _) => {
                self.events.heartbeat_lost |= node.devices.only_if(!node.is_operational);
                self.go_on_if_started();
            }
        }
    }

    /// From Starting to Operational when all nodes and the sensor's samples are there.
    pub(super) fn go_on_if_started(&mut self) {
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
    pub(super) fn configure<O: Outbox>(
        &mut self,
        now: Time,
        out: &mut O,
        mut act: impl FnMut(&mut Node, Time, &mut O) -> Result<(), BootFailure>,
    ) {
        for node in &mut self.nodes {
            if node.boot.is_done() {
                continue;
            }
            let step = node.boot.doing();
            if let Err(failure) = act(node, now, out) {
                let error = refuse(Some(node.id.raw()), &node.name, step, failure);
                self.enter(Phase::Failed(error));
                return;
            }
        }
        if self.nodes.iter().all(|node| node.boot.is_done()) {
            self.enter(Phase::Starting);
            self.phase_since = now;
            for line in &mut self.lines {
                self.nodes.iter().filter(|node| node.bus == line.bus).for_each(|node| line.watch.start(now, node.id));
            }
            self.command(NmtCommand::StartRemoteNode, out);
            if let Some(client) = self.image.plain_mut() {
                client.start(now, &mut out.on(self.sensor_bus));
            }
            // Nodes that have started by themselves do not say so again.
            self.go_on_if_started();
        }
    }

    /// When the first of those that are waited for in this phase is given up.
    fn phase_deadline(&self) -> Time {
        let nodes = self.nodes.iter().filter_map(|node| node.owes(&self.phase));
        let waits = nodes.chain(self.owes_samples()).map(|(_, wait)| self.phase_since + wait);
        waits.fold(Time::NEVER, Time::min)
    }

    /// Returns the step for which a sensor on plain CAN is waited for, and its time limit since the phase began.
    pub(super) fn owes_samples(&self) -> Option<(&'static str, Duration)> {
        let has_samples = self.image.plain().is_none_or(Client::has_begun);
        (self.phase == Phase::Starting && !has_samples).then_some(("wait for samples", self.sample_wait))
    }

    /// Returns the other nodes that were heard on the bus of a silent node.
    fn others(&self, silent: &Node) -> Others {
        let here = self.nodes.iter().filter(|node| node.bus == silent.bus);
        let own: NodeSet = here.clone().map(|node| node.id).collect();
        let heard = self.lines.iter().find(|line| line.bus == silent.bus).map(|line| line.heard).unwrap_or_default();
        let answered = here.filter(|node| node.has_booted && node.id != silent.id).map(|node| node.id).collect();
        Others { answered, strangers: heard.without(own) }
    }

    /// Fails because of the first that is too late.
    fn give_up(&mut self, now: Time) {
        let is_over = |wait: &(&'static str, Duration)| now >= self.phase_since + wait.1;
        let waited_ms = |wait: Duration| wait.as_millis() as u64;
        let late = self.nodes.iter().find_map(|node| Some((node, node.owes(&self.phase).filter(is_over)?)));
        let error = match (late, self.owes_samples().filter(is_over)) {
            (Some((node, (step, wait))), _) => {
                let errors = self.events.error_passive | self.events.bus_off;
                let is_unheard = errors.contains(DeviceSet::interface(node.bus.index()));
                let (waited_ms, said) = (waited_ms(wait), node.said);
                let failure = match self.phase {
                    Phase::Starting => BootFailure::NotStarted { waited_ms, said },
                    _ => BootFailure::Missing { waited_ms, is_unheard, said, others: Box::new(self.others(node)) },
                };
                refuse(Some(node.id.raw()), &node.name, step, failure)
            }
            (None, Some((step, wait))) => {
                refuse(None, &self.sensor_name, step, BootFailure::NoSample { waited_ms: waited_ms(wait) })
            }
            (None, None) => return,
        };
        self.enter(Phase::Failed(error));
    }
}
