//! The master: its networks, the two axes that their words are of, and the cycle between them, side by side.

use super::axis::{self, Axis, AxisSetup, HomingState};
use super::error::BootError;
use super::ethercat::SegmentSetup;
use super::network::{Network, Networks};
use super::setup::MasterSetup;
use yieldwall_drives::cia402::Goal;
use yieldwall_fieldbus::canopen::Outbox;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::cycle::{Cycle, DriveSample, Inputs, LinkEvents, Outputs, Timing};
use yieldwall_motion::guard::{Allowed, Cause, DeviceSet, Directive, Fault, JointRest, Request, State};
use yieldwall_motion::quantity::JointAngles;

/// The master of one rig.
///
/// Frames and moments go to its networks ([`Master::networks_mut`]), and so do questions to devices. Twice a cycle it acts itself, after
/// [`Network::open`]: in [`Master::step`], when all process data are in, and in [`Master::send_set_points`].
#[derive(Clone)]
pub struct Master {
    networks: Networks,
    axes: [Axis; 2],
    cycle: Cycle,
    inputs: Inputs,
    /// Whether the cycle failed and never runs again.
    has_failed: bool,
    /// Rest of the joints since it failed.
    joint_rest: JointRest,
    last: Outputs,
}

impl Master {
    /// A master that has sent nothing yet, of a rig whose devices are on CAN, on an EtherCAT segment, or some here and some there.
    ///
    /// `axes` are those of the left and of the right drive.
    ///
    /// # Errors
    /// As [`Networks::new`].
    pub fn new(
        (can, segment): (Option<&MasterSetup>, Option<&SegmentSetup>),
        axes: [AxisSetup; 2],
        cycle: Cycle,
    ) -> Result<Self, BootError> {
        Ok(Self::on(Networks::new(can, segment)?, axes, cycle))
    }

    /// A master on these networks that has sent nothing yet. `axes` are those of the left and of the right drive.
    pub fn on(networks: Networks, axes: [AxisSetup; 2], cycle: Cycle) -> Self {
        let axes = axes.map(Axis::new);
        let inputs = Inputs {
            drives: axes.each_ref().map(Axis::unheard),
            sample: None,
            link: LinkEvents::default(),
            timing: Timing::default(),
            request: Request::None,
        };
        Self { networks, axes, inputs, has_failed: false, joint_rest: JointRest::default(), last: cycle.idle(), cycle }
    }

    /// Its networks.
    ///
    /// Real-time: yes.
    pub fn networks(&self) -> &dyn Network {
        &self.networks
    }

    /// Its networks, to bring them frames and moments.
    ///
    /// Real-time: yes.
    pub fn networks_mut(&mut self) -> &mut dyn Network {
        &mut self.networks
    }

    /// The rig's cycle.
    ///
    /// Real-time: yes.
    pub fn cycle(&self) -> &Cycle {
        &self.cycle
    }

    /// The rig's cycle, to set what it does. It is stepped by [`Master::step`] alone.
    ///
    /// Real-time: yes.
    pub fn cycle_mut(&mut self) -> &mut Cycle {
        &mut self.cycle
    }

    /// Watches the drives while they move by themselves, as [`Cycle::home`]. A change of an angle by more than this from cycle to
    /// cycle, rad, counts as a change of its reference. `None` ends the watch.
    pub fn home(&mut self, jump_rad: Option<f64>) {
        self.cycle.home(jump_rad.is_some());
        self.axes.iter_mut().for_each(|axis| axis.set_jump(jump_rad));
    }

    /// Angles of the joints by the references of their drives, rad, whatever they were taken to be at before homing.
    pub fn referenced_angles(&self) -> JointAngles {
        self.axes.each_ref().map(Axis::referenced_rad).into()
    }

    /// Last position that each drive has reported, in its counts without a wrap.
    ///
    /// Real-time: yes.
    pub fn positions(&self) -> [i64; 2] {
        self.axes.each_ref().map(Axis::position_counts)
    }

    /// Closes the brakes that it holds with the next set-points, until the next cycle.
    pub fn close_brakes(&mut self) {
        self.last.releases_brakes = false;
    }

    /// Requests homing from each drive in homing mode while it is enabled, or ends the request.
    ///
    /// Real-time: yes.
    pub fn set_homing(&mut self, are_homing: [bool; 2]) {
        self.axes.iter_mut().zip(are_homing).for_each(|(axis, is_homing)| axis.set_homing(is_homing));
    }

    /// Progress of each drive with homing, by its last statusword.
    ///
    /// Real-time: yes.
    pub fn homing(&self) -> [HomingState; 2] {
        self.axes.each_ref().map(Axis::homing)
    }

    /// Inputs of the last cycle; before the first one they say that nothing has arrived.
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

    /// Begins the boot, as [`Network::start`]: the first time, and again when a person restarts the network after a device was reset or
    /// lost. Nothing is enabled.
    ///
    /// After [`Master::quick_stop_now`] this does nothing: only a new master can know what the cycle does.
    pub fn start(&mut self, now: Time, out: &mut dyn Outbox) {
        if self.has_failed {
            return;
        }
        self.cycle.restart();
        self.axes.iter_mut().for_each(Axis::restart);
        self.last = self.cycle.idle();
        self.networks.start(now, out);
    }

    /// The moment at which all process data are in: [`Master::step`], and then [`Master::send_set_points`].
    ///
    /// Real-time: yes.
    pub fn on_compute(&mut self, now: Time, request: Request, timing: Timing, out: &mut dyn Outbox) -> Outputs {
        let outputs = self.step(now, request, timing);
        self.send_set_points(now, out);
        outputs
    }

    /// Decodes the process data and runs the cycle; nothing is sent. `timing` says how this cycle ran against its grid.
    ///
    /// Real-time: yes.
    pub fn step(&mut self, now: Time, request: Request, timing: Timing) -> Outputs {
        let arrived = self.networks.take(now);
        let [left, right] = &mut self.axes;
        let [left_words, right_words] = arrived.drives;
        let drives = [left.take(left_words), right.take(right_words)];
        if self.has_failed {
            return self.end_failed(drives);
        }
        // A drive that no longer knows where it is has lost its supply, or its encoder.
        let lost = DeviceSet::drives_where(self.axes.each_ref().map(Axis::has_lost_reference));
        let link = LinkEvents { node_reset: arrived.link.node_reset | lost, ..arrived.link };
        self.inputs = Inputs { drives, sample: arrived.sample, link, timing, request };
        self.last = self.cycle.step(&self.inputs);
        if self.last.directive.fault_reset {
            self.axes.iter_mut().for_each(Axis::request_fault_reset);
        }
        self.networks.heed(self.cycle.state(), &self.last.directive);
        self.last
    }

    /// Sends both drives a quick stop without the cycle, which has panicked in the caller's hands. It never runs again:
    /// [`Master::send_set_points`] goes on to send the quick stop, and torque off once the joints rest. The state is [`State::Disabled`] for
    /// good, and its cause [`Fault::CyclePanicked`].
    ///
    /// Real-time: yes.
    pub fn quick_stop_now(&mut self, now: Time, out: &mut dyn Outbox) {
        if std::mem::replace(&mut self.has_failed, true) {
            return self.send_set_points(now, out);
        }
        self.last.command = Allowed::rest(self.last.command.get(), self.last.signals.measured_angles);
        self.last.directive = Directive::QUICK_STOP;
        self.last.releases_brakes = false;
        self.networks.unmute();
        self.networks.heed(self.last.directive.state, &self.last.directive);
        self.send_set_points(now, out);
    }

    /// A cycle without the one that failed: drives that were stopped and still make torque take it off once the joints rest.
    fn end_failed(&mut self, drives: [DriveSample; 2]) -> Outputs {
        self.inputs.drives = drives;
        let [left, right] = drives.map(|drive| drive.angle_rad);
        let angles = left.zip(right).map(|(left, right)| JointAngles::new(left, right));
        let settings = self.cycle.settings();
        let torque_may_go = self.joint_rest.step(angles, settings.period_s, settings.brake_s);
        if torque_may_go && drives.iter().any(|drive| drive.state.has_torque()) {
            self.last.directive.goal = Goal::SwitchOnDisabled;
        }
        self.last
    }

    /// Sends the set-points of the last [`Master::step`], which the next SYNC makes the drives apply, and behind them a
    /// heartbeat that is due.
    ///
    /// Real-time: yes.
    pub fn send_set_points(&mut self, now: Time, out: &mut dyn Outbox) {
        if self.networks.is_mute() {
            return self.axes.iter_mut().for_each(Axis::cancel_fault_reset);
        }
        let orders = self.orders();
        self.networks.close(now, &orders, out);
    }

    /// The set-points of the last cycle once more, whatever has happened since: a drive that stops then stops by itself.
    pub fn repeat_set_points(&mut self, now: Time, out: &mut dyn Outbox) {
        let orders = self.orders();
        self.networks.repeat_set_points(now, &orders, out);
    }

    fn orders(&mut self) -> [axis::DriveOrders; 2] {
        axis::orders(&mut self.axes, self.last.directive.goal, &self.last.command, self.last.releases_brakes)
    }
}
