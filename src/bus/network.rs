//! The seam between a rig and its networks: CAN buses, an EtherCAT segment, or others.

use std::time::Duration;

use crate::axis::{Arrived, DriveOrders};
use crate::can::{BootPlan, CanNetwork, Waiting};
use crate::emergency::EmergencyReport;
use crate::error::BootError;
use crate::ethercat::{EthercatNetwork, Segment, SegmentSetup};
use crate::phase::Phase;
use crate::script::Written;
use crate::setup::MasterSetup;
use yieldwall_fieldbus::canopen::{BusId, Frame, Outbox};
use yieldwall_fieldbus::objects::{ObjectAnswer, ObjectError, ObjectRequest};
use yieldwall_fieldbus::time::Time;
use yieldwall_fieldbus::{LinkEvent, Packet};
use yieldwall_motion::guard::{Device, DeviceSet, Directive, State};

/// A network: boot, then raw words that come and go twice a cycle.
///
/// A network is sans-I/O. Its CAN frames go to the outbox of a call; its Ethernet frames wait for [`Network::drain`]. From
/// [`Network::on_packet`] on, the methods are real-time while the network is operational, except for the reports.
pub trait Network: Send + Sync {
    /// The phase of the network.
    fn phase(&self) -> &Phase;

    /// Time for which the caller listens for another master before it sends anything.
    fn listening(&self) -> Duration;

    /// Begins to listen for another master. It sends nothing until [`Network::announce`] or [`Network::start`]. If it hears
    /// another master, the phase becomes [`Phase::Failed`] with [`BootFailure::OtherMaster`](crate::BootFailure::OtherMaster).
    /// This rule ends with the exchange of process data: in operation such frames are a fault of the cycle.
    fn listen(&mut self) {}

    /// Sends harmless frames before any others, so that two masters that start at the same moment hear each other.
    fn announce(&mut self, _now: Time, _out: &mut dyn Outbox) {}

    /// Begins the boot. Nothing is remembered of what was before but the emergencies, and nothing is enabled.
    fn start(&mut self, now: Time, out: &mut dyn Outbox);

    /// The latest moment for the next call of [`Network::poll`].
    fn next_deadline(&self) -> Time;

    /// Does what time asks for: heartbeat, watched devices, waits of the boot.
    fn poll(&mut self, now: Time, out: &mut dyn Outbox);

    /// The device that the boot waits for; of several, the one that it gives up first. `None` when no boot is under way.
    fn waiting(&self, now: Time) -> Option<Waiting<'_>>;

    /// Leaves the network: the devices go to Pre-operational, where no device waits for set-points. For a rig that was stopped.
    fn leave(&mut self, out: &mut dyn Outbox);

    /// Takes a frame from a bus, if it is of this network; own CAN frames go to [`Network::on_echo`].
    fn on_packet(&mut self, now: Time, packet: Packet<'_>, out: &mut dyn Outbox);

    /// Takes an own frame that was seen on the bus. A link that cannot show own frames never calls this, and what is still
    /// on its way is then not watched.
    fn on_echo(&mut self, _frame: &Frame) {}

    /// Notes an event of the interface to a bus; the next cycle acts on it.
    fn on_link(&mut self, bus: BusId, event: LinkEvent);

    /// Gives away the Ethernet frames that are to be sent, in their order, after each call that may have made some.
    fn drain(&mut self, _send: &mut dyn FnMut(BusId, &[u8])) {}

    /// Begins a cycle: sends SYNC, and after it the request to a polled sensor; on a segment the input frame.
    ///
    /// At most one cycle is in flight. While set-points of an earlier cycle (or SYNC, on a bus without set-points) have not been
    /// seen on their bus, the master sends neither SYNC nor set-points on any bus. At the second such cycle in a row the master
    /// falls silent ([`Network::is_silent`]).
    ///
    /// Drives act at SYNC on the last set-point that they heard. After a set-point of a foreign node SYNC therefore waits on all
    /// buses until own set-points were sent and seen; the cycle computes them as the answer to
    /// [`Fault::Intruder`](yieldwall_motion::guard::Fault::Intruder). To send them here already would gain nothing: the drives
    /// act on them at the SYNC of the next cycle.
    fn open(&mut self, out: &mut dyn Outbox);

    /// The devices of which something is missing that answers [`Network::open`].
    fn missing(&self, now: Time) -> DeviceSet;

    /// Returns the process data received by `now`, and the events since the last cycle.
    fn take(&mut self, now: Time) -> Arrived;

    /// Notes the decision of the cycle: the state of the rig, silence, a stop of the drives.
    fn heed(&mut self, state: State, directive: &Directive);

    /// Ends a cycle: sends set-points, which the drives apply at the next SYNC, and after them frames that can wait.
    fn close(&mut self, now: Time, orders: &[DriveOrders; 2], out: &mut dyn Outbox);

    /// Lets set-points leave, whatever holds them back.
    fn unmute(&mut self) {}

    /// The network sends nothing any more, so that the drives' watchdogs act. A link then drops its queue and sends nothing of it later.
    fn is_silent(&self) -> bool;

    /// The network sends neither SYNC nor set-points in this cycle.
    fn is_mute(&self) -> bool {
        self.is_silent()
    }

    /// The network held SYNC back in this cycle: set-points of an earlier cycle are still on their way, a drive may hold a foreign
    /// set-point, or the network is silent. No process data can come.
    fn is_sync_held(&self) -> bool {
        self.is_silent()
    }

    /// The bus has not shown the last set-points yet (SYNC, on a bus without set-points), or a frame of a segment has not come back.
    fn is_in_flight(&self) -> bool;

    /// The bus whose frames are Ethernet frames, if it has one.
    fn ethernet_bus(&self) -> Option<BusId> {
        None
    }

    /// Sets the source address of Ethernet frames, as [`EthercatNetwork::set_source`].
    fn set_source(&mut self, _source: [u8; 6]) {}

    /// Ignores lateness from now on: in lockstep time stands still between the cycles, and nothing can move the grid.
    fn set_lockstep(&mut self) {}

    /// Notes by how much the next [`Network::open`] comes after its grid point. The reference clock of a segment follows the grid, not the
    /// moment at which this computer woke up.
    fn note_late(&mut self, _late: Duration) {}

    /// Shift of the next grid point in ns, with which the cycles follow the reference clock of a segment: at most 1 % of a
    /// period.
    fn grid_shift_ns(&self) -> i64 {
        0
    }

    /// Takes over the cycles that it has run by itself since its bring-up: the grid point of the next one, which is the caller's.
    /// `None` where it runs none, between the two moments of a cycle, and when they were taken over before.
    fn take_over_cycles(&mut self) -> Option<Time> {
        None
    }

    /// Time before the next grid point at which [`Network::repeat`] is due; `None` where nothing is to be repeated.
    fn repeats_before(&self) -> Option<Duration> {
        None
    }

    /// Sends the outputs of this cycle once more to the devices that act on them later. They then replace outputs that a foreign
    /// master has sent since.
    fn repeat(&mut self) {}

    /// Sends the frames of [`Network::open`] outside of any cycle; none while a drive may hold a foreign set-point.
    fn repeat_sync(&mut self, out: &mut dyn Outbox);

    /// Sends set-points outside of any cycle.
    fn repeat_set_points(&mut self, now: Time, orders: &[DriveOrders; 2], out: &mut dyn Outbox);

    /// Sends a heartbeat that is due. Returns the moment of the last one; `None` where the network has no heartbeat.
    fn repeat_heartbeat(&mut self, _now: Time, _out: &mut dyn Outbox) -> Option<Time> {
        None
    }

    /// The heartbeat period that the drives watch.
    fn heartbeat_period(&self) -> Option<Duration> {
        None
    }

    /// Forgets when heartbeats came. If heartbeats waited to be taken, their times cannot show whether one device or two sent
    /// them.
    fn forget_heartbeat_times(&mut self) {}

    /// Asks the devices to leave operation while they go on getting outputs, until they are booted again; for a watchdog drill.
    fn leave_op(&mut self) {}

    /// Takes, outside of any cycle, the statuswords of the left and of the right drive that came since [`Network::repeat_sync`]. `None`
    /// where inputs do not come without outputs.
    fn take_statuswords(&mut self, _now: Time) -> Option<[Option<u16>; 2]> {
        None
    }

    /// The device is on this network.
    fn has(&self, device: Device) -> bool;

    /// Begins to read or to write an object of a device; [`Network::answer`] returns the outcome. A device takes one request at a time, and
    /// none during the boot. A drive that is an axis of a device names its objects as those of a first axis (6041h), and takes turns with the
    /// other one.
    ///
    /// # Errors
    /// If the network was not booted, the device has no objects or has not answered the last request, or the value is too long.
    fn ask(
        &mut self,
        now: Time,
        device: Device,
        request: ObjectRequest<'_>,
        out: &mut dyn Outbox,
    ) -> Result<(), ObjectError>;

    /// The outcome of the last request to a device.
    fn answer(&self, device: Device) -> ObjectAnswer<'_>;

    /// The node id of a device; `None` where devices have none.
    fn node_id(&self, _device: Device) -> Option<u8> {
        None
    }

    /// The last emergency messages of the devices, the oldest first.
    fn told(&self) -> Vec<EmergencyReport>;

    /// Forgets all emergency messages.
    fn forget_told(&mut self);

    /// The objects that the boot writes, of each device.
    fn written(&self) -> Vec<Written>;

    /// The frames and objects that the boot will send, except repetitions, where they are known before.
    fn plan(&self) -> Option<BootPlan> {
        None
    }

    /// Faults of the devices since the start of the network, a line each, beyond the record of each cycle.
    fn findings(&self) -> Vec<String> {
        Vec::new()
    }

    /// Number of foreign writes to devices that began. While the rig is enabled such a write is a fault, until the network
    /// restarts; otherwise the network counts it. A foreign read is harmless.
    fn foreign_downloads(&self) -> u32 {
        0
    }

    /// The EtherCAT segment, for reports, if it is one.
    fn segment(&self) -> Option<&EthercatNetwork> {
        None
    }

    /// A copy.
    fn boxed(&self) -> Box<dyn Network>;
}

impl Clone for Box<dyn Network> {
    fn clone(&self) -> Self {
        (**self).boxed()
    }
}

/// All networks of a rig as one. No device is on two of them.
#[derive(Clone)]
pub struct Networks(Vec<Box<dyn Network>>);

impl Networks {
    /// The networks of a rig with devices on CAN, on an EtherCAT segment, or on both.
    ///
    /// # Errors
    /// If node identifiers are out of range or used twice, if a profile lacks the process data of the command mode; as
    /// [`EthercatNetwork::new`].
    pub fn new(can: Option<&MasterSetup>, segment: Option<&SegmentSetup>) -> Result<Self, BootError> {
        let mut all: Vec<Box<dyn Network>> = Vec::new();
        if let Some(setup) = can {
            all.push(Box::new(CanNetwork::new(setup)?));
        }
        if let Some(setup) = segment {
            all.push(Box::new(Segment::new(setup)?));
        }
        Ok(Self(all))
    }

    /// These and another one.
    #[must_use]
    pub fn with(mut self, network: Box<dyn Network>) -> Self {
        self.0.push(network);
        self
    }

    fn each(&mut self, mut act: impl FnMut(&mut dyn Network)) {
        self.0.iter_mut().for_each(|network| act(&mut **network));
    }

    fn all(&self) -> impl Iterator<Item = &dyn Network> {
        self.0.iter().map(|network| &**network)
    }
}

/// Joins the answers of several networks: the phase of the slowest, the earliest moment, the first that knows.
impl Network for Networks {
    fn phase(&self) -> &Phase {
        let phases = || self.all().map(Network::phase);
        let has_ended = |phase: &&Phase| matches!(phase, Phase::Failed(_) | Phase::Off);
        let behind = phases().find(has_ended).or_else(|| phases().find(|phase| **phase != Phase::Operational));
        behind.or_else(|| phases().next()).unwrap_or(&Phase::Off)
    }

    fn listening(&self) -> Duration {
        self.all().map(Network::listening).max().unwrap_or_default()
    }

    fn listen(&mut self) {
        self.each(|network| network.listen());
    }

    fn announce(&mut self, now: Time, out: &mut dyn Outbox) {
        self.each(|network| network.announce(now, out));
    }

    fn start(&mut self, now: Time, out: &mut dyn Outbox) {
        self.each(|network| network.start(now, out));
    }

    fn next_deadline(&self) -> Time {
        self.all().map(Network::next_deadline).min().unwrap_or(Time::NEVER)
    }

    fn poll(&mut self, now: Time, out: &mut dyn Outbox) {
        self.each(|network| network.poll(now, out));
    }

    fn waiting(&self, now: Time) -> Option<Waiting<'_>> {
        self.all().filter_map(|network| network.waiting(now)).min_by_key(|waiting| waiting.left)
    }

    fn leave(&mut self, out: &mut dyn Outbox) {
        self.each(|network| network.leave(out));
    }

    fn on_packet(&mut self, now: Time, packet: Packet<'_>, out: &mut dyn Outbox) {
        self.each(|network| network.on_packet(now, packet, out));
    }

    fn on_echo(&mut self, frame: &Frame) {
        self.each(|network| network.on_echo(frame));
    }

    fn on_link(&mut self, bus: BusId, event: LinkEvent) {
        self.each(|network| network.on_link(bus, event));
    }

    fn drain(&mut self, send: &mut dyn FnMut(BusId, &[u8])) {
        self.each(|network| network.drain(send));
    }

    fn open(&mut self, out: &mut dyn Outbox) {
        self.each(|network| network.open(out));
    }

    fn missing(&self, now: Time) -> DeviceSet {
        self.all().fold(DeviceSet::NONE, |missing, network| missing | network.missing(now))
    }

    fn take(&mut self, now: Time) -> Arrived {
        let arrived = self.0.iter_mut().map(|network| network.take(now)).reduce(Arrived::with);
        arrived.unwrap_or_default()
    }

    fn heed(&mut self, state: State, directive: &Directive) {
        self.each(|network| network.heed(state, directive));
    }

    fn close(&mut self, now: Time, orders: &[DriveOrders; 2], out: &mut dyn Outbox) {
        self.each(|network| network.close(now, orders, out));
    }

    fn unmute(&mut self) {
        self.each(|network| network.unmute());
    }

    fn is_silent(&self) -> bool {
        self.all().any(Network::is_silent)
    }

    fn is_mute(&self) -> bool {
        self.all().any(Network::is_mute)
    }

    fn is_sync_held(&self) -> bool {
        self.all().any(Network::is_sync_held)
    }

    fn is_in_flight(&self) -> bool {
        self.all().any(Network::is_in_flight)
    }

    fn ethernet_bus(&self) -> Option<BusId> {
        self.all().find_map(Network::ethernet_bus)
    }

    fn set_source(&mut self, source: [u8; 6]) {
        self.each(|network| network.set_source(source));
    }

    fn set_lockstep(&mut self) {
        self.each(|network| network.set_lockstep());
    }

    fn note_late(&mut self, late: Duration) {
        self.each(|network| network.note_late(late));
    }

    fn grid_shift_ns(&self) -> i64 {
        self.all().map(Network::grid_shift_ns).find(|shift_ns| *shift_ns != 0).unwrap_or(0)
    }

    fn take_over_cycles(&mut self) -> Option<Time> {
        self.0.iter_mut().find_map(|network| network.take_over_cycles())
    }

    fn repeats_before(&self) -> Option<Duration> {
        self.all().find_map(Network::repeats_before)
    }

    fn repeat(&mut self) {
        self.each(|network| network.repeat());
    }

    fn repeat_sync(&mut self, out: &mut dyn Outbox) {
        self.each(|network| network.repeat_sync(out));
    }

    fn repeat_set_points(&mut self, now: Time, orders: &[DriveOrders; 2], out: &mut dyn Outbox) {
        self.each(|network| network.repeat_set_points(now, orders, out));
    }

    fn repeat_heartbeat(&mut self, now: Time, out: &mut dyn Outbox) -> Option<Time> {
        self.0.iter_mut().filter_map(|network| network.repeat_heartbeat(now, out)).min()
    }

    fn heartbeat_period(&self) -> Option<Duration> {
        self.all().filter_map(Network::heartbeat_period).min()
    }

    fn forget_heartbeat_times(&mut self) {
        self.each(|network| network.forget_heartbeat_times());
    }

    fn leave_op(&mut self) {
        self.each(|network| network.leave_op());
    }

    fn take_statuswords(&mut self, now: Time) -> Option<[Option<u16>; 2]> {
        self.0.iter_mut().find_map(|network| network.take_statuswords(now))
    }

    fn has(&self, device: Device) -> bool {
        self.all().any(|network| network.has(device))
    }

    fn ask(
        &mut self,
        now: Time,
        device: Device,
        request: ObjectRequest<'_>,
        out: &mut dyn Outbox,
    ) -> Result<(), ObjectError> {
        let network = self.0.iter_mut().find(|network| network.has(device)).ok_or(ObjectError::NoObjects)?;
        network.ask(now, device, request, out)
    }

    fn answer(&self, device: Device) -> ObjectAnswer<'_> {
        let network = self.all().find(|network| network.has(device));
        network.map_or(ObjectAnswer::Failed(ObjectError::NoObjects), |network| network.answer(device))
    }

    fn node_id(&self, device: Device) -> Option<u8> {
        self.all().find_map(|network| network.node_id(device))
    }

    fn told(&self) -> Vec<EmergencyReport> {
        let mut all: Vec<EmergencyReport> = self.all().flat_map(Network::told).collect();
        all.sort_by_key(|told| told.time);
        all
    }

    fn forget_told(&mut self) {
        self.each(|network| network.forget_told());
    }

    fn written(&self) -> Vec<Written> {
        self.all().flat_map(Network::written).filter(|written| !written.objects.is_empty()).collect()
    }

    fn plan(&self) -> Option<BootPlan> {
        self.all().find_map(Network::plan)
    }

    fn findings(&self) -> Vec<String> {
        self.all().flat_map(Network::findings).collect()
    }

    fn foreign_downloads(&self) -> u32 {
        self.all().map(Network::foreign_downloads).fold(0, u32::saturating_add)
    }

    fn segment(&self) -> Option<&EthercatNetwork> {
        self.all().find_map(Network::segment)
    }

    fn boxed(&self) -> Box<dyn Network> {
        Box::new(self.clone())
    }
}
