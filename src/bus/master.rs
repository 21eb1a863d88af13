//! The master: boot, then two moments a cycle.

use std::time::Duration;

use super::LinkEvent;
use super::axis::{self, Axis, AxisSetup, HomingState};
use super::can::{BootPlan, CanNetwork, Waiting};
use super::emergency::EmergencyReport;
use super::error::BootError;
use super::ethercat::{EthercatNetwork, Outgoing, SegmentSetup};
use super::phase::Phase;
use super::script::Written;
use super::setup::MasterSetup;
use yieldwall_drives::cia402::Goal;
use yieldwall_fieldbus::canopen::{BusId, Frame, Outbox};
use yieldwall_fieldbus::objects::{ObjectAnswer, ObjectError, ObjectRequest};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::cycle::{Cycle, Inputs, LeadLimits, LinkEvents, Outputs, Timing};
use yieldwall_motion::guard::{Allowed, Cause, Device, DeviceSet, Directive, Fault, Request, State};
use yieldwall_motion::quantity::JointAngles;
use yieldwall_motion::sensing::{SensingError, TareParameters, Wrench};

/// How long frames of another master are listened for on a segment: ten cycles of a slow one.
pub const SEGMENT_LISTENING: Duration = Duration::from_millis(100);

/// The master of one rig: its networks, which carry raw words, the two axes that these words are of, and the cycle between them.
#[derive(Clone)]
pub struct Master {
    /// The CAN buses, if the rig is on any.
    can: Option<CanNetwork>,
    /// The EtherCAT segment, if the rig is on one.
    segment: Option<EthercatNetwork>,
    /// What the segment is to be sent.
    outgoing: Outgoing,
    /// How long another master is listened for.
    listening: Duration,
    axes: [Axis; 2],
    cycle: Cycle,
    inputs: Inputs,
    /// Whether the cycle failed and never runs again.
    has_failed: bool,
    last: Outputs,
}

impl Master {
    /// A master that has sent nothing yet, of a rig whose devices are on CAN, on an EtherCAT segment, or some here and some there. Frames of
    /// the segment come by [`Master::on_ethernet`] and leave by [`Master::drain_ethernet`].
    ///
    /// `axes` are those of the left and of the right drive.
    ///
    /// # Errors
    /// If node identifiers are out of range or used twice, if a profile lacks the process data of the command mode; as
    /// [`EthercatNetwork::new`].
    pub fn new(
        (can, segment): (Option<&MasterSetup>, Option<&SegmentSetup>),
        axes: [AxisSetup; 2],
        cycle: Cycle,
    ) -> Result<Self, BootError> {
        let axes = axes.map(Axis::new);
        let inputs = Inputs {
            drives: axes.each_ref().map(Axis::unheard),
            sample: None,
            link: LinkEvents::default(),
            timing: Timing::default(),
            request: Request::None,
        };
        let of_can = can.map_or(Duration::ZERO, MasterSetup::listening);
        let of_segment = segment.map_or(Duration::ZERO, |_| SEGMENT_LISTENING);
        Ok(Self {
            can: can.map(CanNetwork::new).transpose()?,
            segment: segment.map(EthercatNetwork::new).transpose()?,
            outgoing: Outgoing::default(),
            listening: of_can.max(of_segment),
            axes,
            inputs,
            has_failed: false,
            last: cycle.idle(),
            cycle,
        })
    }

    /// Has the second frame of a sample of a sensor on plain CAN come as late as this behind the first, whatever the setup says.
    pub fn set_pair_gap(&mut self, gap: Duration) {
        self.can.iter_mut().for_each(|can| can.set_pair_gap(gap));
    }

    /// Has the frames of a segment bear this source address, as [`EthercatNetwork::set_source`].
    pub fn set_source(&mut self, source: [u8; 6]) {
        self.segment.iter_mut().for_each(|segment| segment.set_source(source));
    }

    /// Has a segment take its clocks as they are: in lockstep time stands still between the cycles, and no grid can be moved.
    pub fn set_lockstep(&mut self) {
        self.segment.iter_mut().for_each(EthercatNetwork::set_lockstep);
    }

    /// How long another master is to be listened for before anything is sent.
    pub fn listening(&self) -> Duration {
        self.listening
    }

    /// The bus that is an EtherCAT segment, if one is.
    ///
    /// Real-time: yes.
    pub fn segment_bus(&self) -> Option<BusId> {
        self.segment.as_ref().map(EthercatNetwork::bus)
    }

    /// Where the network stands; of two, where the one that is behind stands, or has failed.
    pub fn phase(&self) -> &Phase {
        match (self.can.as_ref().map(CanNetwork::phase), self.segment.as_ref().map(EthercatNetwork::phase)) {
            (Some(can), Some(segment)) => match (can, segment) {
                (Phase::Failed(_), _) | (Phase::Off, _) => can,
                (_, Phase::Failed(_) | Phase::Off) => segment,
                (Phase::Operational, _) => segment,
                _ => can,
            },
            (can, segment) => can.or(segment).unwrap_or(&Phase::Off),
        }
    }

    /// The EtherCAT segment, for reports.
    pub fn segment(&self) -> Option<&EthercatNetwork> {
        self.segment.as_ref()
    }

    /// The rig's cycle, for reports.
    pub fn cycle(&self) -> &Cycle {
        &self.cycle
    }

    /// Guides the joints in place of the fixture, as [`Cycle::lead`].
    pub fn lead(&mut self, limits: Option<LeadLimits>) {
        self.cycle.lead(limits);
    }

    /// Starts a tare of the force sensor, as [`Cycle::start_tare`].
    ///
    /// # Errors
    /// As [`Cycle::start_tare`].
    pub fn start_tare(&mut self, parameters: TareParameters) -> Result<(), SensingError> {
        self.cycle.start_tare(parameters)
    }

    /// Takes a wrench for the zero of the force sensor, as [`Cycle::set_bias`].
    pub fn set_bias(&mut self, bias: Wrench) {
        self.cycle.set_bias(bias);
    }

    /// Lowers the greatest torque of each joint, as [`Cycle::lower_torque`].
    pub fn lower_torque(&mut self, torque_n_m: f64) {
        self.cycle.lower_torque(torque_n_m);
    }

    /// Leads the joints to these angles, as [`Cycle::lead_to`].
    ///
    /// Real-time: yes.
    pub fn lead_to(&mut self, targets: JointAngles) {
        self.cycle.lead_to(targets);
    }

    /// Has the drives be watched while they move by themselves, as [`Cycle::home`]: a change of an angle from cycle to cycle that is
    /// greater than this, rad, is one of its reference. `None` ends that.
    pub fn home(&mut self, jump_rad: Option<f64>) {
        self.cycle.home(jump_rad.is_some());
        self.axes.iter_mut().for_each(|axis| axis.set_jump(jump_rad));
    }

    /// As [`Cycle::report_blocked`].
    ///
    /// Real-time: yes.
    pub fn report_blocked(&mut self, joint: usize) {
        self.cycle.report_blocked(joint);
    }

    /// Angles of the joints by the references of their drives, rad, whatever they were taken to be at before homing.
    pub fn referenced_angles(&self) -> JointAngles {
        self.axes.each_ref().map(Axis::referenced_rad).into()
    }

    /// The last position of each drive as it has told it, in its counts without a wrap.
    ///
    /// Real-time: yes.
    pub fn positions(&self) -> [i64; 2] {
        self.axes.each_ref().map(Axis::position_counts)
    }

    /// Closes the brakes that it holds with the next set-points, until the next cycle.
    pub fn close_brakes(&mut self) {
        self.last.releases_brakes = false;
    }

    /// Asks each drive in homing mode to home as long as it is enabled, or no more.
    ///
    /// Real-time: yes.
    pub fn set_homing(&mut self, are_homing: [bool; 2]) {
        self.axes.iter_mut().zip(are_homing).for_each(|(axis, is_homing)| axis.set_homing(is_homing));
    }

    /// How far each drive is with homing, by its last statusword.
    ///
    /// Real-time: yes.
    pub fn homing(&self) -> [HomingState; 2] {
        self.axes.each_ref().map(Axis::homing)
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
        self.can.as_ref().is_some_and(CanNetwork::is_silent)
            || self.segment.as_ref().is_some_and(EthercatNetwork::is_silent)
    }

    /// How often somebody else began to write to a configured node by SDO. While the rig is enabled that is
    /// [`Fault::Intruder`], until the network is started anew; otherwise it is only counted. Reading is nobody's harm.
    pub fn foreign_downloads(&self) -> u32 {
        self.can.as_ref().map_or(0, CanNetwork::foreign_downloads)
    }

    /// What the devices told last by emergency messages, at most eight over CAN and eight over the segment, the oldest first.
    pub fn told(&self) -> impl Iterator<Item = EmergencyReport> {
        let segment = self.segment.iter().flat_map(EthercatNetwork::told);
        let mut all: Vec<EmergencyReport> = self.can.iter().flat_map(CanNetwork::told).chain(segment).collect();
        all.sort_by_key(|told| told.time);
        all.into_iter()
    }

    /// Forgets what the devices have told, for a report of what comes.
    pub fn forget_told(&mut self) {
        self.can.iter_mut().for_each(CanNetwork::forget_told);
        self.segment.iter_mut().for_each(EthercatNetwork::forget_told);
    }

    /// What is wrong with the devices of a segment since it was started, a line each: states, clocks, ports. Nothing on CAN.
    pub fn segment_findings(&self) -> Vec<String> {
        self.segment.as_ref().map_or_else(Vec::new, EthercatNetwork::findings)
    }

    /// All that the boot will send on CAN, beside what is repeated: told before anything is sent.
    pub fn plan(&self) -> BootPlan {
        self.can.as_ref().map_or_else(BootPlan::default, CanNetwork::plan)
    }

    /// The objects that the boot writes, of each device that has any, on CAN and on a segment.
    pub fn written(&self) -> Vec<Written> {
        let segment = self.segment.iter().flat_map(EthercatNetwork::written);
        let all = self.can.iter().flat_map(CanNetwork::written).chain(segment);
        all.filter(|written| !written.objects.is_empty()).collect()
    }

    /// Begins to listen for another master, with nothing sent until [`Master::announce`] or [`Master::start`]. One that is
    /// heard is [`Phase::Failed`] with [`BootFailure::OtherMaster`](super::BootFailure::OtherMaster), and so it is from then on until the
    /// exchange of process data: in operation such frames are a fault of the cycle.
    pub fn listen(&mut self) {
        self.can.iter_mut().for_each(CanNetwork::listen);
    }

    /// Sends the first heartbeat, which disturbs nobody, before anything that does: two masters that begin at the same moment
    /// hear each other's.
    pub fn announce(&mut self, now: Time, out: &mut impl Outbox) {
        self.can.iter_mut().for_each(|can| can.announce(now, out));
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
        self.can.iter_mut().for_each(|can| can.start(now, out));
        self.segment.iter_mut().for_each(|segment| segment.start(now, &mut self.outgoing));
    }

    /// When [`Master::poll`] has to be called again at the latest.
    ///
    /// Real-time: yes.
    pub fn next_deadline(&self) -> Time {
        let can = self.can.as_ref().map_or(Time::NEVER, CanNetwork::next_deadline);
        can.min(self.segment.as_ref().map_or(Time::NEVER, EthercatNetwork::next_deadline))
    }

    /// Does what time asks for: heartbeat, watched nodes, waits of the boot.
    ///
    /// Real-time: yes, while operational.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        self.can.iter_mut().for_each(|can| can.poll(now, out));
        self.segment.iter_mut().for_each(|segment| segment.poll(now, &mut self.outgoing));
    }

    /// What the boot waits for; of several devices the one that is given up first. Nothing when there is no boot.
    pub fn waiting(&self, now: Time) -> Option<Waiting<'_>> {
        let can = self.can.as_ref().and_then(|can| can.waiting(now));
        let segment = self.segment.as_ref().and_then(|segment| segment.waiting(now));
        can.into_iter().chain(segment).min_by_key(|waiting| waiting.left)
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
        match (&mut self.can, &mut self.segment) {
            (_, Some(segment)) if segment.has(device) => segment.ask(now, device, request),
            (Some(can), _) => can.ask(now, device, request, out),
            (None, Some(_)) => Err(ObjectError::NoObjects),
            (None, None) => Err(ObjectError::NotBooted),
        }
    }

    /// How what was asked of a device last has ended.
    ///
    /// Real-time: yes.
    pub fn answer(&self, device: Device) -> ObjectAnswer<'_> {
        match (&self.can, &self.segment) {
            (_, Some(segment)) if segment.has(device) => segment.answer(device),
            (Some(can), _) => can.answer(device),
            (None, Some(_)) => ObjectAnswer::Failed(ObjectError::NoObjects),
            (None, None) => ObjectAnswer::NotAsked,
        }
    }

    /// The node id of a device; `None` for a sensor on plain CAN and for devices of a segment.
    pub fn node_id(&self, device: Device) -> Option<u8> {
        self.can.as_ref()?.node_id(device)
    }

    /// Leaves the network: the devices go to Pre-operational, where nobody waits for set-points. For a rig that was stopped.
    pub fn leave(&mut self, out: &mut impl Outbox) {
        self.can.iter_mut().for_each(|can| can.leave(out));
        self.segment.iter_mut().for_each(|segment| segment.leave(&mut self.outgoing));
    }

    /// Takes a frame of another node from the bus; own ones go to [`Master::on_echo`].
    ///
    /// Real-time: yes, while operational.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        let state = self.state();
        let is_enabled = !(state == State::Idle || state.is_latched());
        self.can.iter_mut().for_each(|can| can.on_frame(now, frame, is_enabled, out));
    }

    /// Takes a frame from the segment.
    ///
    /// Real-time: yes, while operational.
    pub fn on_ethernet(&mut self, now: Time, bytes: &[u8]) {
        self.segment.iter_mut().for_each(|segment| segment.on_frame(now, bytes, &mut self.outgoing));
    }

    /// Gives away the frames that the segment is to be sent, in their order, after each call that may have made some.
    ///
    /// Real-time: yes.
    pub fn drain_ethernet(&mut self, send: impl FnMut(&[u8])) {
        self.outgoing.drain(send);
    }

    /// By how much the grid point after this cycle is moved, in ns, so that the cycles follow the reference clock of a segment: at most 1 % of
    /// a period. 0 on CAN.
    ///
    /// Real-time: yes.
    pub fn grid_shift_ns(&self) -> i64 {
        self.segment.as_ref().map_or(0, EthercatNetwork::grid_shift_ns)
    }

    /// Takes over the cycles that a segment has run by itself since its bring-up: the grid point of the next one, which is the caller's.
    /// `None` without a segment, between the two moments of a cycle, and when they were taken over before.
    pub fn take_over_cycles(&mut self) -> Option<Time> {
        self.segment.as_mut()?.take_over_cycles()
    }

    /// Takes an own frame that was seen on the bus. A link that cannot show own frames never calls this, and what is still
    /// on its way is then not watched.
    ///
    /// Real-time: yes.
    pub fn on_echo(&mut self, frame: &Frame) {
        self.can.iter_mut().for_each(|can| can.on_echo(frame));
    }

    /// How late the next [`Master::on_sync`] is against its grid point. The reference clock of a segment is told of the grid, not of how late
    /// this computer has woken up.
    ///
    /// Real-time: yes.
    pub fn note_late(&mut self, late: Duration) {
        self.segment.iter_mut().for_each(|segment| segment.note_late(late));
    }

    /// The begin of a cycle: SYNC, and behind it the request to a sensor that is polled; on a segment the input frame.
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
        self.can.iter_mut().for_each(|can| can.open(out));
        self.segment.iter_mut().for_each(|segment| segment.open(&mut self.outgoing));
    }

    /// Time before the next grid point at which [`Master::repeat_outputs`] is due; `None` where nothing is to be repeated, as on CAN.
    ///
    /// Real-time: yes.
    pub fn repeats_before(&self) -> Option<Duration> {
        self.segment.as_ref()?.repeats_before()
    }

    /// Sends the outputs of this cycle once more to the devices of a segment that act at SYNC0, so that those which somebody else has sent since do
    /// not act.
    ///
    /// Real-time: yes.
    pub fn repeat_outputs(&mut self) {
        self.segment.iter_mut().for_each(|segment| segment.repeat(&mut self.outgoing));
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
        let can = self.can.as_ref().map_or(DeviceSet::NONE, |can| can.missing(now));
        can | self.segment.as_ref().map_or(DeviceSet::NONE, EthercatNetwork::missing)
    }

    /// Forgets when the nodes' heartbeats came, which do not tell one device from two where they waited to be taken.
    ///
    /// Real-time: yes.
    pub fn forget_heartbeat_times(&mut self) {
        self.can.iter_mut().for_each(CanNetwork::forget_heartbeat_times);
    }

    /// Whether SYNC was held back in this cycle, since the set-points of an earlier one are still on their way, a drive may
    /// hold a set-point of somebody else, or nothing is sent at all: no process data can come.
    ///
    /// Real-time: yes.
    pub fn is_sync_held(&self) -> bool {
        self.can.as_ref().is_some_and(CanNetwork::is_sync_held)
            || self.segment.as_ref().is_some_and(EthercatNetwork::is_silent)
    }

    /// Whether set-points, or SYNC where there are none, were sent that have not been seen on their bus yet, or a frame of a segment has
    /// not come back.
    ///
    /// Real-time: yes.
    pub fn is_in_flight(&self) -> bool {
        self.can.as_ref().is_some_and(CanNetwork::is_in_flight)
            || self.segment.as_ref().is_some_and(EthercatNetwork::is_in_flight)
    }

    /// SYNC on every bus where somebody hears it, and the input frame of a segment, outside of any cycle; none while a drive may hold a set-point of somebody
    /// else.
    pub fn repeat_sync(&mut self, out: &mut impl Outbox) {
        self.can.iter_mut().for_each(|can| can.repeat_sync(out));
        self.segment.iter_mut().for_each(|segment| segment.open(&mut self.outgoing));
    }

    /// The set-points of the last cycle once more, whatever has happened since: a drive that stops then stops by itself.
    pub fn repeat_set_points(&mut self, now: Time, out: &mut impl Outbox) {
        let orders =
            axis::orders(&mut self.axes, self.last.directive.goal, &self.last.command, self.last.releases_brakes);
        self.can.iter_mut().for_each(|can| can.send(&orders, out));
        self.segment.iter_mut().for_each(|segment| segment.close(now, &orders, &mut self.outgoing));
    }

    /// Asks the devices of a segment for SAFE-OP, until it is booted again.
    pub fn leave_op(&mut self) {
        self.segment.iter_mut().for_each(EthercatNetwork::leave_op);
    }

    /// Outside of any cycle, the statuswords of the left and of the right drive that the inputs since [`Master::repeat_sync`] have
    /// brought; nothing where drives are on CAN.
    pub fn take_statuswords(&mut self, now: Time) -> Option<[Option<u16>; 2]> {
        Some(self.segment.as_mut()?.take(now).drives.map(|words| words.statusword))
    }

    /// A heartbeat if one is due; when the last one was sent, `now` where there is none.
    pub fn repeat_heartbeat(&mut self, now: Time, out: &mut impl Outbox) -> Time {
        self.can.as_mut().map_or(now, |can| can.repeat_heartbeat(now, out))
    }

    /// The heartbeat period that the drives watch; `None` without CAN.
    pub fn heartbeat_period(&self) -> Option<Duration> {
        self.can.as_ref().map(CanNetwork::heartbeat_period)
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
        let of_can = self.can.as_mut().map(|can| can.take(now));
        let of_segment = self.segment.as_mut().map(|segment| segment.take(now));
        let arrived = match (of_can, of_segment) {
            (Some(can), Some(segment)) => can.with(segment),
            (can, segment) => match can.or(segment) {
                Some(arrived) => arrived,
                None => return self.last,
            },
        };
        let [left, right] = &mut self.axes;
        let [left_words, right_words] = arrived.drives;
        let drives = [left.take(left_words), right.take(right_words)];
        if self.has_failed {
            return self.last;
        }
        // A drive that no longer knows where it is has lost its supply, or its encoder.
        let lost = DeviceSet::drives_where(self.axes.each_ref().map(Axis::has_lost_reference));
        let link = LinkEvents { node_reset: arrived.link.node_reset | lost, ..arrived.link };
        self.inputs = Inputs { drives, sample: arrived.sample, link, timing, request };
        self.last = self.cycle.step(&self.inputs);
        if self.last.directive.fault_reset {
            self.axes.iter_mut().for_each(Axis::request_fault_reset);
        }
        self.set_silent(self.last.directive.is_silent);
        self.set_stopping(self.last.directive.goal);
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
        self.last.releases_brakes = false;
        self.can.iter_mut().for_each(CanNetwork::unmute);
        self.segment.iter_mut().for_each(|segment| segment.set_silent(false));
        self.set_stopping(self.last.directive.goal);
        self.send_set_points(now, out);
    }

    fn set_stopping(&mut self, goal: Goal) {
        let is_stopping = matches!(goal, Goal::QuickStop | Goal::SwitchOnDisabled);
        self.segment.iter_mut().for_each(|segment| segment.set_stopping(is_stopping));
    }

    fn set_silent(&mut self, is_silent: bool) {
        self.can.iter_mut().for_each(|can| can.set_silent(is_silent));
        self.segment.iter_mut().for_each(|segment| segment.set_silent(is_silent));
    }

    /// Sends the set-points of the last [`Master::step`], which the next SYNC makes the drives apply, and behind them a
    /// heartbeat that is due.
    ///
    /// Real-time: yes.
    pub fn send_set_points(&mut self, now: Time, out: &mut impl Outbox) {
        let is_mute = self.can.as_ref().is_some_and(CanNetwork::is_mute)
            || self.segment.as_ref().is_some_and(EthercatNetwork::is_silent);
        if is_mute {
            return self.axes.iter_mut().for_each(Axis::cancel_fault_reset);
        }
        let orders =
            axis::orders(&mut self.axes, self.last.directive.goal, &self.last.command, self.last.releases_brakes);
        self.can.iter_mut().for_each(|can| can.close(now, &orders, out));
        self.segment.iter_mut().for_each(|segment| segment.close(now, &orders, &mut self.outgoing));
    }

    /// Notes what the interface to a bus tells; the next cycle acts on it.
    ///
    /// Real-time: yes.
    pub fn on_link(&mut self, bus: BusId, event: LinkEvent) {
        self.can.iter_mut().for_each(|can| can.on_link(bus, event));
        self.segment.iter_mut().filter(|segment| segment.bus() == bus).for_each(|segment| segment.on_link(event));
    }
}
