//! The master: boot, then two moments a cycle.

use std::time::Duration;

use super::axis::{self, Axis};
use super::can::{BootPlan, CanNetwork, Told, Waiting};
use super::error::BootError;
use super::phase::{LinkEvent, Phase};
use super::setup::MasterSetup;
use crate::canopen::{BusId, Frame, Outbox};
use crate::cycle::{Cycle, Inputs, LinkEvents, Outputs, Timing};
use crate::guard::{Allowed, Cause, Device, DeviceSet, Directive, Fault, Request, State};
use crate::objects::{ObjectAnswer, ObjectError, ObjectRequest};
use crate::time::Time;

/// The master of one rig: its networks, which carry raw words, the two axes that these words are of, and the cycle between them.
#[derive(Clone)]
pub struct Master {
    network: CanNetwork,
    axes: [Axis; 2],
    cycle: Cycle,
    inputs: Inputs,
    /// Whether the cycle failed and never runs again.
    has_failed: bool,
    last: Outputs,
}

impl Master {
    /// A master that has sent nothing yet.
    ///
    /// # Errors
    /// If node identifiers are out of range or used twice, or if a profile lacks the process data of the command mode.
    pub fn new(setup: &MasterSetup, cycle: Cycle) -> Result<Self, BootError> {
        let network = CanNetwork::new(setup)?;
        let axes = setup.drives.each_ref().map(|drive| Axis::new(drive.scaling, drive.expected_angle_rad));
        let inputs = Inputs {
            drives: axes.each_ref().map(Axis::unheard),
            sample: None,
            link: LinkEvents::default(),
            timing: Timing::default(),
            request: Request::None,
        };
        let last = cycle.idle();
        Ok(Self { network, axes, cycle, inputs, has_failed: false, last })
    }

    /// Has the second frame of a sample of a sensor on plain CAN come as late as this behind the first, whatever the setup says.
    pub fn set_pair_gap(&mut self, gap: Duration) {
        self.network.set_pair_gap(gap);
    }

    /// Where the network stands.
    pub fn phase(&self) -> &Phase {
        self.network.phase()
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
        self.network.is_silent()
    }

    /// How often somebody else began to write to a configured node by SDO. While the rig is enabled that is
    /// [`Fault::Intruder`], until the network is started anew; otherwise it is only counted. Reading is nobody's harm.
    pub fn foreign_downloads(&self) -> u32 {
        self.network.foreign_downloads()
    }

    /// What the devices told last by emergency messages, at most eight, the oldest first.
    pub fn told(&self) -> impl Iterator<Item = Told> {
        self.network.told()
    }

    /// All that the boot will send, beside what is repeated: told before anything is sent.
    pub fn plan(&self) -> BootPlan {
        self.network.plan()
    }

    /// Begins to listen for another master, with nothing sent until [`Master::announce`] or [`Master::start`]. One that is
    /// heard is [`Phase::Failed`] with [`BootFailure::OtherMaster`](super::BootFailure::OtherMaster), and so it is from then on until the
    /// exchange of process data: in operation such frames are a fault of the cycle.
    pub fn listen(&mut self) {
        self.network.listen();
    }

    /// Sends the first heartbeat, which disturbs nobody, before anything that does: two masters that begin at the same moment
    /// hear each other's.
    pub fn announce(&mut self, now: Time, out: &mut impl Outbox) {
        self.network.announce(now, out);
    }

    /// Resets the nodes of the rig, no others, and starts to watch them: the first time, and again when a person restarts it after a node
    /// was reset or lost. Nothing is remembered of what was before but the emergencies, and nothing is enabled.
    ///
    /// After [`Master::quick_stop_now`] it does nothing: only a new master can tell what the cycle does.
    pub fn start(&mut self, now: Time, out: &mut impl Outbox) {
        if self.has_failed {
            return;
        }
        self.cycle.restart();
        self.axes.iter_mut().for_each(Axis::restart);
        self.last = self.cycle.idle();
        self.network.start(now, out);
    }

    /// When [`Master::poll`] has to be called again at the latest.
    ///
    /// Real-time: yes.
    pub fn next_deadline(&self) -> Time {
        self.network.next_deadline()
    }

    /// Does what time asks for: heartbeat, watched nodes, waits of the boot.
    ///
    /// Real-time: yes, while operational.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        self.network.poll(now, out);
    }

    /// What the boot waits for; of several devices the one that is given up first. Nothing when there is no boot.
    pub fn waiting(&self, now: Time) -> Option<Waiting<'_>> {
        self.network.waiting(now)
    }

    /// Begins to read or to write an object of a device; how that ends is told by [`Master::answer`]. A device is asked one thing at a time,
    /// and nothing while it is configured.
    ///
    /// # Errors
    /// If the network was not booted, the device has no objects or has not answered the last request, or the value is too long.
    pub fn ask(
        &mut self,
        now: Time,
        device: Device,
        request: ObjectRequest<'_>,
        out: &mut impl Outbox,
    ) -> Result<(), ObjectError> {
        self.network.ask(now, device, request, out)
    }

    /// How what was asked of a device last has ended.
    ///
    /// Real-time: yes.
    pub fn answer(&self, device: Device) -> ObjectAnswer<'_> {
        self.network.answer(device)
    }

    /// The node id of a device; `None` for a sensor on plain CAN.
    pub fn node_id(&self, device: Device) -> Option<u8> {
        self.network.node_id(device)
    }

    /// Leaves the network: the nodes go to Pre-operational, where nobody waits for set-points. For a rig that was stopped.
    pub fn leave(&mut self, out: &mut impl Outbox) {
        self.network.leave(out);
    }

    /// Takes a frame of another node from the bus; own ones go to [`Master::on_echo`].
    ///
    /// Real-time: yes, while operational.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        let state = self.state();
        let is_enabled = !(state == State::Idle || state.is_latched());
        self.network.on_frame(now, frame, is_enabled, out);
    }

    /// Takes an own frame that was seen on the bus. A link that cannot show own frames never calls this, and what is still
    /// on its way is then not watched.
    ///
    /// Real-time: yes.
    pub fn on_echo(&mut self, frame: &Frame) {
        self.network.on_echo(frame);
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
        self.network.open(out);
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
        self.network.missing(now)
    }

    /// Forgets when the nodes' heartbeats came, which do not tell one device from two where they waited to be taken.
    ///
    /// Real-time: yes.
    pub fn forget_heartbeat_times(&mut self) {
        self.network.forget_heartbeat_times();
    }

    /// Whether SYNC was held back in this cycle, since the set-points of an earlier one are still on their way, a drive may
    /// hold a set-point of somebody else, or nothing is sent at all: no process data can come.
    ///
    /// Real-time: yes.
    pub fn is_sync_held(&self) -> bool {
        self.network.is_sync_held()
    }

    /// Whether set-points, or SYNC where there are none, were sent that have not been seen on their bus yet.
    ///
    /// Real-time: yes.
    pub fn is_in_flight(&self) -> bool {
        self.network.is_in_flight()
    }

    /// SYNC on every bus where somebody hears it, outside of any cycle; none while a drive may hold a set-point of somebody
    /// else.
    pub fn repeat_sync(&mut self, out: &mut impl Outbox) {
        self.network.repeat_sync(out);
    }

    /// The set-points of the last cycle once more, whatever has happened since: a drive that stops then stops by itself.
    pub fn repeat_set_points(&mut self, out: &mut impl Outbox) {
        let orders = axis::orders(&mut self.axes, self.last.directive.goal, &self.last.command);
        self.network.send(&orders, out);
    }

    /// A heartbeat if one is due; when the last one was sent.
    pub fn repeat_heartbeat(&mut self, now: Time, out: &mut impl Outbox) -> Time {
        self.network.repeat_heartbeat(now, out)
    }

    /// The heartbeat period that the drives watch.
    pub fn heartbeat_period(&self) -> Duration {
        self.network.heartbeat_period()
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
        let arrived = self.network.take(now);
        let [left, right] = &mut self.axes;
        let [left_words, right_words] = arrived.drives;
        let drives = [left.take(left_words), right.take(right_words)];
        if self.has_failed {
            return self.last;
        }
        self.inputs = Inputs { drives, sample: arrived.sample, link: arrived.link, timing, request };
        self.last = self.cycle.step(&self.inputs);
        if self.last.directive.fault_reset {
            self.axes.iter_mut().for_each(Axis::request_fault_reset);
        }
        self.network.set_silent(self.last.directive.is_silent);
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
        self.network.unmute();
        self.send_set_points(now, out);
    }

    /// Sends the set-points of the last [`Master::step`], which the next SYNC makes the drives apply, and behind them a
    /// heartbeat that is due.
    ///
    /// Real-time: yes.
    pub fn send_set_points(&mut self, now: Time, out: &mut impl Outbox) {
        if self.network.is_mute() {
            return self.axes.iter_mut().for_each(Axis::cancel_fault_reset);
        }
        let orders = axis::orders(&mut self.axes, self.last.directive.goal, &self.last.command);
        self.network.close(now, &orders, out);
    }

    /// Notes what the interface to a bus tells; the next cycle acts on it.
    ///
    /// Real-time: yes.
    pub fn on_link(&mut self, bus: BusId, event: LinkEvent) {
        self.network.on_link(bus, event);
    }
}
