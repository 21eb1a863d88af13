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
/// It is sans-I/O. CAN frames that it sends go to the outbox of a call, Ethernet frames wait for [`Network::drain`]. From
/// [`Network::on_packet`] on, the methods are real-time while the network is operational, but for the reports.
pub trait Network: Send + Sync {
    /// Where the network stands.
    fn phase(&self) -> &Phase;

    /// How long another master has to be listened for before anything is sent.
    fn listening(&self) -> Duration;

    /// Begins to listen for another master, with nothing sent until [`Network::announce`] or [`Network::start`]. One that is
    /// heard is [`Phase::Failed`] with [`BootFailure::OtherMaster`](crate::BootFailure::OtherMaster), and so it is from then on until the
    /// exchange of process data: in operation such frames are a fault of the cycle.
    fn listen(&mut self) {}

    /// Sends what disturbs nobody, before anything that does: two masters that begin at the same moment hear each other.
    fn announce(&mut self, _now: Time, _out: &mut dyn Outbox) {}

    /// Begins the boot. Nothing is remembered of what was before but the emergencies, and nothing is enabled.
    fn start(&mut self, now: Time, out: &mut dyn Outbox);

    /// When [`Network::poll`] has to be called again at the latest.
    fn next_deadline(&self) -> Time;

    /// Does what time asks for: heartbeat, watched devices, waits of the boot.
    fn poll(&mut self, now: Time, out: &mut dyn Outbox);

    /// What the boot waits for; of several devices the one that is given up first. Nothing when there is no boot.
    fn waiting(&self, now: Time) -> Option<Waiting<'_>>;

    /// Leaves the network: the devices go to Pre-operational, where nobody waits for set-points. For a rig that was stopped.
    fn leave(&mut self, out: &mut dyn Outbox);

    /// Takes a frame from a bus, if it is of this network; own CAN frames go to [`Network::on_echo`].
    fn on_packet(&mut self, now: Time, packet: Packet<'_>, out: &mut dyn Outbox);

    /// Takes an own frame that was seen on the bus. A link that cannot show own frames never calls this, and what is still
    /// on its way is then not watched.
    fn on_echo(&mut self, _frame: &Frame) {}

    /// Notes what the interface to a bus tells; the next cycle acts on it.
    fn on_link(&mut self, bus: BusId, event: LinkEvent);

    /// Gives away the Ethernet frames that are to be sent, in their order, after each call that may have made some.
    fn drain(&mut self, _send: &mut dyn FnMut(BusId, &[u8])) {}

    /// The begin of a cycle: SYNC, and behind it the request to a sensor that is polled; on a segment the input frame.
    ///
    /// At most one cycle is in flight: while set-points of an earlier cycle have not been seen on their bus, or SYNC on a bus
    /// without set-points, neither SYNC nor set-points are sent on any. At the second such cycle in a row the master falls
    /// silent ([`Network::is_silent`]).
    ///
    /// Drives act at SYNC on the last set-point that they heard. After one of somebody else SYNC therefore waits on all buses
    /// until own ones, which the cycle has computed as the answer to [`Fault::Intruder`](yieldwall_motion::guard::Fault::Intruder), were
    /// sent and seen. Sending them here already would gain nothing: the SYNC that makes the drives act on them is that of the next cycle.
    fn open(&mut self, out: &mut dyn Outbox);

    /// The devices of which something is missing that answers [`Network::open`].
    fn missing(&self, now: Time) -> DeviceSet;

    /// What has come by `now`, and what has happened since the last cycle.
    fn take(&mut self, now: Time) -> Arrived;

    /// Notes what the cycle has decided: the state of the rig, whether nothing is sent any more, whether the drives are being stopped.
    fn heed(&mut self, state: State, directive: &Directive);

    /// The end of a cycle: what the drives shall do, which the next SYNC makes them apply, and behind it what can wait.
    fn close(&mut self, now: Time, orders: &[DriveOrders; 2], out: &mut dyn Outbox);

    /// Has set-points leave whatever holds them back.
    fn unmute(&mut self) {}

    /// Whether nothing is sent any more, so that the drives' watchdogs act. A link then drops what its queue still holds,
    /// and sends nothing of it later.
    fn is_silent(&self) -> bool;

    /// Whether neither SYNC nor set-points are sent in this cycle.
    fn is_mute(&self) -> bool {
        self.is_silent()
    }

    /// Whether SYNC was held back in this cycle, since the set-points of an earlier one are still on their way, a drive may
    /// hold a set-point of somebody else, or nothing is sent at all: no process data can come.
    fn is_sync_held(&self) -> bool {
        self.is_silent()
    }

    /// Whether set-points, or SYNC where there are none, were sent that have not been seen on their bus yet, or a frame of a segment has
    /// not come back.
    fn is_in_flight(&self) -> bool;

    /// The bus whose frames are Ethernet frames, if it has one.
    fn ethernet_bus(&self) -> Option<BusId> {
        None
    }

    /// Has frames bear this source address where they bear one, as [`EthercatNetwork::set_source`].
    fn set_source(&mut self, _source: [u8; 6]) {}

    /// Has nothing count that has to be in time: in lockstep time stands still between the cycles, and no grid can be moved.
    fn set_lockstep(&mut self) {}

    /// How late the next [`Network::open`] is against its grid point. The reference clock of a segment is told of the grid, not of how late
    /// this computer has woken up.
    fn note_late(&mut self, _late: Duration) {}

    /// By how much the grid point after this cycle is moved, in ns, so that the cycles follow the reference clock of a segment: at most 1 % of
    /// a period.
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

    /// Sends the outputs of this cycle once more to the devices that act on them later, so that those which somebody else has sent since do
    /// not act.
    fn repeat(&mut self) {}

    /// What [`Network::open`] sends, outside of any cycle; nothing while a drive may hold a set-point of somebody else.
    fn repeat_sync(&mut self, out: &mut dyn Outbox);

    /// What drives shall do, outside of any cycle.
    fn repeat_set_points(&mut self, now: Time, orders: &[DriveOrders; 2], out: &mut dyn Outbox);

    /// A heartbeat if one is due; when the last one was sent. `None` where there is none.
    fn repeat_heartbeat(&mut self, _now: Time, _out: &mut dyn Outbox) -> Option<Time> {
        None
    }

    /// The heartbeat period that the drives watch.
    fn heartbeat_period(&self) -> Option<Duration> {
        None
    }

    /// Forgets when heartbeats came, which do not tell one device from two where they waited to be taken.
    fn forget_heartbeat_times(&mut self) {}

    /// Asks the devices to leave operation while they go on getting outputs, until they are booted again; for a watchdog drill.
    fn leave_op(&mut self) {}

    /// Outside of any cycle, the statuswords of the left and of the right drive that the inputs since [`Network::repeat_sync`] have
    /// brought; nothing where they do not come without outputs.
    fn take_statuswords(&mut self, _now: Time) -> Option<[Option<u16>; 2]> {
        None
    }

    /// Whether a device is on this network.
    fn has(&self, device: Device) -> bool;

    /// Begins to read or to write an object of a device; how that ends is told by [`Network::answer`]. A device is asked one thing at a time,
    /// and nothing while it is configured.
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

    /// How what was asked of a device last has ended.
    fn answer(&self, device: Device) -> ObjectAnswer<'_>;

    /// The node id of a device; `None` where devices have none.
    fn node_id(&self, _device: Device) -> Option<u8> {
        None
    }

    /// What the devices told last by emergency messages, the oldest first.
    fn told(&self) -> Vec<EmergencyReport>;

    /// Forgets what the devices have told, for a report of what comes.
    fn forget_told(&mut self);

    /// The objects that the boot writes, of each device.
    fn written(&self) -> Vec<Written>;

    /// All that the boot will send beside what is repeated, where that is known before.
    fn plan(&self) -> Option<BootPlan> {
        None
    }

    /// What is wrong with the devices since the network was started, a line each, beside what is in the record of each cycle.
    fn findings(&self) -> Vec<String> {
        Vec::new()
    }

    /// How often somebody else began to write to a device. While the rig is enabled that is a fault, until the network is started anew;
    /// otherwise it is only counted. Reading is nobody's harm.
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
    /// Those of a rig whose devices are on CAN, on an EtherCAT segment, or some here and some there.
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

/// Of several, what is said of one is joined: the one that is behind, the earliest moment, the first that knows.
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
