//! The segment as the rig sees it.

use std::time::Duration;

use super::{EthercatNetwork, Outgoing, SegmentSetup};
use crate::axis::{Arrived, DriveOrders};
use crate::can::Waiting;
use crate::emergency::EmergencyReport;
use crate::error::BootError;
use crate::network::Network;
use crate::phase::Phase;
use crate::script::Written;
use yieldwall_drives::cia402::Goal;
use yieldwall_fieldbus::canopen::{BusId, Outbox};
use yieldwall_fieldbus::objects::{ObjectAnswer, ObjectError, ObjectRequest};
use yieldwall_fieldbus::time::Time;
use yieldwall_fieldbus::{LinkEvent, Packet};
use yieldwall_motion::guard::{Device, DeviceSet, Directive, State};

/// Time for which a segment listens for frames of another master: ten cycles of a slow one.
pub const SEGMENT_LISTENING: Duration = Duration::from_millis(100);

/// A segment, and the frames that it is to be sent.
#[derive(Clone)]
pub(crate) struct Segment {
    network: EthercatNetwork,
    outgoing: Outgoing,
}

impl Segment {
    /// A segment to which nothing was sent yet.
    ///
    /// # Errors
    /// As [`EthercatNetwork::new`].
    pub(crate) fn new(setup: &SegmentSetup) -> Result<Self, BootError> {
        Ok(Self { network: EthercatNetwork::new(setup)?, outgoing: Outgoing::default() })
    }
}

impl Network for Segment {
    fn phase(&self) -> &Phase {
        self.network.phase()
    }

    fn listening(&self) -> Duration {
        SEGMENT_LISTENING
    }

    fn start(&mut self, now: Time, _: &mut dyn Outbox) {
        self.network.start(now, &mut self.outgoing);
    }

    fn next_deadline(&self) -> Time {
        self.network.next_deadline()
    }

    fn poll(&mut self, now: Time, _: &mut dyn Outbox) {
        self.network.poll(now, &mut self.outgoing);
    }

    fn waiting(&self, now: Time) -> Option<Waiting<'_>> {
        self.network.waiting(now)
    }

    fn leave(&mut self, _: &mut dyn Outbox) {
        self.network.leave(&mut self.outgoing);
    }

    fn on_packet(&mut self, now: Time, packet: Packet<'_>, _: &mut dyn Outbox) {
        if let Packet::Ethernet { bus, bytes } = packet
            && bus == self.network.bus()
        {
            self.network.on_frame(now, bytes, &mut self.outgoing);
        }
    }

    fn on_link(&mut self, bus: BusId, event: LinkEvent) {
        if bus == self.network.bus() {
            self.network.on_link(event);
        }
    }

    fn drain(&mut self, send: &mut dyn FnMut(BusId, &[u8])) {
        let bus = self.network.bus();
        self.outgoing.drain(|bytes| send(bus, bytes));
    }

    fn open(&mut self, _: &mut dyn Outbox) {
        self.network.open(&mut self.outgoing);
    }

    fn missing(&self, _: Time) -> DeviceSet {
        self.network.missing()
    }

    fn take(&mut self, now: Time) -> Arrived {
        self.network.take(now)
    }

    fn heed(&mut self, _: State, directive: &Directive) {
        self.network.set_silent(directive.is_silent);
        self.network.set_stopping(matches!(directive.goal, Goal::QuickStop | Goal::SwitchOnDisabled));
    }

    fn close(&mut self, now: Time, orders: &[DriveOrders; 2], _: &mut dyn Outbox) {
        self.network.close(now, orders, &mut self.outgoing);
    }

    fn is_silent(&self) -> bool {
        self.network.is_silent()
    }

    fn is_in_flight(&self) -> bool {
        self.network.is_in_flight()
    }

    fn ethernet_bus(&self) -> Option<BusId> {
        Some(self.network.bus())
    }

    fn set_source(&mut self, source: [u8; 6]) {
        self.network.set_source(source);
    }

    fn set_lockstep(&mut self) {
        self.network.set_lockstep();
    }

    fn note_late(&mut self, late: Duration) {
        self.network.note_late(late);
    }

    fn grid_shift_ns(&self) -> i64 {
        self.network.grid_shift_ns()
    }

    fn take_over_cycles(&mut self) -> Option<Time> {
        self.network.take_over_cycles()
    }

    fn repeats_before(&self) -> Option<Duration> {
        self.network.repeats_before()
    }

    fn repeat(&mut self) {
        self.network.repeat(&mut self.outgoing);
    }

    fn repeat_sync(&mut self, _: &mut dyn Outbox) {
        self.network.open(&mut self.outgoing);
    }

    fn repeat_set_points(&mut self, now: Time, orders: &[DriveOrders; 2], _: &mut dyn Outbox) {
        self.network.close(now, orders, &mut self.outgoing);
    }

    fn leave_op(&mut self) {
        self.network.leave_op();
    }

    fn take_statuswords(&mut self, now: Time) -> Option<[Option<u16>; 2]> {
        Some(self.network.take(now).drives.map(|words| words.statusword))
    }

    fn has(&self, device: Device) -> bool {
        self.network.has(device)
    }

    fn ask(
        &mut self,
        now: Time,
        device: Device,
        request: ObjectRequest<'_>,
        _: &mut dyn Outbox,
    ) -> Result<(), ObjectError> {
        self.network.ask(now, device, request)
    }

    fn answer(&self, device: Device) -> ObjectAnswer<'_> {
        self.network.answer(device)
    }

    fn told(&self) -> Vec<EmergencyReport> {
        self.network.told().collect()
    }

    fn forget_told(&mut self) {
        self.network.forget_told();
    }

    fn written(&self) -> Vec<Written> {
        self.network.written().collect()
    }

    fn findings(&self) -> Vec<String> {
        self.network.findings()
    }

    fn segment(&self) -> Option<&EthercatNetwork> {
        Some(&self.network)
    }

    fn boxed(&self) -> Box<dyn Network> {
        Box::new(self.clone())
    }
}
