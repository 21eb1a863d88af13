//! The buses as the rig sees them.

use std::time::Duration;

use super::line::Line;
use super::node::Node;
use super::{BootPlan, CanNetwork, Waiting};
use crate::axis::{Arrived, DriveOrders};
use crate::emergency::EmergencyReport;
use crate::network::Network;
use crate::phase::Phase;
use crate::script::Written;
use yieldwall_fieldbus::canopen::{BusId, Frame, NmtCommand, Outbox};
use yieldwall_fieldbus::objects::{ObjectAnswer, ObjectError, ObjectRequest};
use yieldwall_fieldbus::time::Time;
use yieldwall_fieldbus::{LinkEvent, Packet};
use yieldwall_motion::guard::{Device, DeviceSet, Directive, State};

/// Greatest time between both frames of a sample on plain CAN, in lockstep.
const PAIR_GAP: Duration = Duration::from_secs(1);

impl Network for CanNetwork {
    fn phase(&self) -> &Phase {
        &self.phase
    }

    fn listening(&self) -> Duration {
        self.listening
    }

    fn listen(&mut self) {
        self.enter(Phase::Off);
    }

    /// The first heartbeat.
    fn announce(&mut self, now: Time, mut out: &mut dyn Outbox) {
        self.has_sent = true;
        self.next_heartbeat = now;
        self.send_heartbeat(now, &mut out);
    }

    fn start(&mut self, now: Time, mut out: &mut dyn Outbox) {
        self.reset(now, &mut out);
    }

    fn next_deadline(&self) -> Time {
        self.deadline()
    }

    fn poll(&mut self, now: Time, mut out: &mut dyn Outbox) {
        self.on_time(now, &mut out);
    }

    fn waiting(&self, now: Time) -> Option<Waiting<'_>> {
        self.awaited(now)
    }

    fn leave(&mut self, mut out: &mut dyn Outbox) {
        self.enter(Phase::Off);
        self.command(NmtCommand::EnterPreOperational, &mut out);
    }

    fn on_packet(&mut self, now: Time, packet: Packet<'_>, mut out: &mut dyn Outbox) {
        if let Packet::Can(frame) = packet {
            self.on_frame(now, frame, &mut out);
        }
    }

    fn on_echo(&mut self, frame: &Frame) {
        self.has_echo = true;
        let is_set_point = self.image.is_set_point(frame);
        if let Some(line) = self.lines.iter_mut().find(|line| line.bus == frame.bus()) {
            line.on_echo(frame, is_set_point);
        }
        self.nodes.iter_mut().filter(|node| node.bus == frame.bus()).for_each(|node| node.on_echo(frame));
    }

    fn on_link(&mut self, bus: BusId, event: LinkEvent) {
        let events = match event {
            LinkEvent::SendFailed => &mut self.events.send_failed,
            LinkEvent::ErrorPassive => &mut self.events.error_passive,
            LinkEvent::BusOff => &mut self.events.bus_off,
        };
        *events |= DeviceSet::interface(bus.index());
    }

    fn open(&mut self, mut out: &mut dyn Outbox) {
        self.image.begin_cycle();
        let waiting = self.lines.iter().filter(|line| self.has_echo && line.in_flight > 0);
        self.held = waiting.fold(DeviceSet::NONE, |held, line| held | DeviceSet::interface(line.bus.index()));
        self.is_sync_held = self.is_mute() || self.is_overwritten;
        if !self.is_sync_held {
            self.send_sync(&mut out);
            self.lines.iter_mut().for_each(Line::note_sync);
            if let Some(client) = self.image.plain_mut() {
                client.read(&mut (&mut out).on(self.sensor_bus));
            }
        }
    }

    fn missing(&self, now: Time) -> DeviceSet {
        self.image.missing(now)
    }

    fn take(&mut self, now: Time) -> Arrived {
        let arrivals = self.image.arrivals(now);
        let mut link = std::mem::take(&mut self.events);
        link.bad_length = arrivals.irregular.bad_length;
        link.duplicated = arrivals.irregular.duplicated;
        link.late = arrivals.irregular.late;
        link.transmit_stalled = self.held;
        // A node that is not there stays a fault, so that the rig cannot be enabled again without it.
        for node in &self.nodes {
            link.intruder |= node.is_altered;
            link.node_reset |= node.devices.only_if(node.has_restarted);
            link.duplicate_node |= node.devices.only_if(node.is_double);
            link.heartbeat_lost |= node.devices.only_if(!(node.is_operational || node.has_restarted));
        }
        if link.intruder {
            // A foreign command explains what nodes do in its cycle; if that stays, the next cycle shows it.
            (link.heartbeat_lost, link.node_reset) = (DeviceSet::NONE, DeviceSet::NONE);
        }
        Arrived { drives: arrivals.drives, sample: arrivals.sample, link }
    }

    fn heed(&mut self, state: State, directive: &Directive) {
        self.is_enabled = !(state == State::Idle || state.is_latched());
        if self.is_silent && !directive.is_silent {
            // A person lets the exchange go on: frames that were on their way are gone.
            self.lines.iter_mut().for_each(|line| line.in_flight = 0);
        }
        self.is_silent = directive.is_silent;
    }

    fn close(&mut self, now: Time, orders: &[DriveOrders; 2], mut out: &mut dyn Outbox) {
        self.image.send(orders, &mut out);
        // The cycle has answered a foreign set-point that came before the computation: it stops both drives.
        self.is_overwritten = false;
        self.lines.iter_mut().for_each(Line::note_set_points);
        self.send_heartbeat(now, &mut out);
    }

    fn unmute(&mut self) {
        (self.is_silent, self.held) = (false, DeviceSet::NONE);
    }

    fn is_silent(&self) -> bool {
        self.is_silent
    }

    fn is_mute(&self) -> bool {
        self.is_silent || !self.held.is_empty()
    }

    fn is_sync_held(&self) -> bool {
        self.is_sync_held
    }

    fn is_in_flight(&self) -> bool {
        self.lines.iter().any(|line| line.in_flight > 0)
    }

    fn set_lockstep(&mut self) {
        self.image.plain_mut().into_iter().for_each(|client| client.set_pair_gap(PAIR_GAP));
    }

    /// SYNC on every bus where somebody hears it.
    fn repeat_sync(&mut self, mut out: &mut dyn Outbox) {
        if !self.is_overwritten {
            self.send_sync(&mut out);
        }
    }

    fn repeat_set_points(&mut self, _: Time, orders: &[DriveOrders; 2], mut out: &mut dyn Outbox) {
        self.image.send(orders, &mut out);
    }

    fn repeat_heartbeat(&mut self, now: Time, mut out: &mut dyn Outbox) -> Option<Time> {
        self.send_heartbeat(now, &mut out);
        Some(Time(self.next_heartbeat.0.saturating_sub(self.heartbeat.as_nanos() as u64)))
    }

    fn heartbeat_period(&self) -> Option<Duration> {
        Some(self.heartbeat)
    }

    fn forget_heartbeat_times(&mut self) {
        self.nodes.iter_mut().for_each(Node::forget_times);
    }

    fn has(&self, device: Device) -> bool {
        let is_plain = device == Device::Sensor && self.image.plain().is_some();
        is_plain || self.nodes.iter().any(|node| node.devices.contains(device.set()))
    }

    fn ask(
        &mut self,
        now: Time,
        device: Device,
        request: ObjectRequest<'_>,
        mut out: &mut dyn Outbox,
    ) -> Result<(), ObjectError> {
        match self.phase {
            Phase::Configuring => return Err(ObjectError::Busy),
            Phase::Failed(_) => return Err(ObjectError::NotBooted),
            _ if !self.has_sent => return Err(ObjectError::NotBooted),
            _ => {}
        }
        let node = self.nodes.iter_mut().find(|node| node.devices.contains(device.set()));
        let Node { turns, transfer, bus, .. } = node.ok_or(ObjectError::NoObjects)?;
        turns.begin(device, transfer.answer())?;
        transfer.ask(now, turns.moved(device, request), &mut (&mut out).on(*bus))?;
        turns.note_asked(device);
        Ok(())
    }

    fn answer(&self, device: Device) -> ObjectAnswer<'_> {
        match self.nodes.iter().find(|node| node.devices.contains(device.set())) {
            Some(node) => node.turns.answer(device, node.transfer.answer()),
            None => ObjectAnswer::Failed(ObjectError::NoObjects),
        }
    }

    fn node_id(&self, device: Device) -> Option<u8> {
        self.nodes.iter().find(|node| node.devices.contains(device.set())).map(|node| node.id.raw())
    }

    fn told(&self) -> Vec<EmergencyReport> {
        self.told.iter().collect()
    }

    fn forget_told(&mut self) {
        self.told.forget();
    }

    fn written(&self) -> Vec<Written> {
        let of = |node: &Node| Written::new(node.bus, node.id.raw().into(), &node.name, node.boot.steps().0);
        self.nodes.iter().map(of).collect()
    }

    fn plan(&self) -> Option<BootPlan> {
        Some(self.boot_plan())
    }

    fn foreign_downloads(&self) -> u32 {
        self.foreign_downloads
    }

    fn boxed(&self) -> Box<dyn Network> {
        Box::new(self.clone())
    }
}

impl CanNetwork {
    fn send_sync(&mut self, out: &mut impl Outbox) {
        let sync = self.sync.next_frame();
        self.lines.iter().filter(|line| line.has_sync).for_each(|line| out.push(sync.on_bus(line.bus)));
    }
}
