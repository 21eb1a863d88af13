//! Fault detection of the cycle: it fills the fault counts.

use super::watch::Chatter;
use super::{Cycle, DriveSample, Inputs, LinkEvents, Timing};
use crate::fixture::Port;
use crate::guard::{DeviceSet, Fault, Measured, Request, State};
use crate::linkage::ANGLE_LIMIT_RAD;
use crate::quantity::{JointAngles, JointRates};
use crate::sensing::Reading;
use yieldwall_drives::cia402;

/// Share of the singularity margin below which the arm has left the workspace.
const LEFT_SHARE: f64 = 0.5;
/// Cycles for which a joint without process data is taken to go on at its last rate. At the fifth miss the drives
/// quick-stop (fault `pdo-missed`); after that the last prediction stays.
const PREDICTED_CYCLES: u16 = 5;
/// Missing samples, in the sensor's own interval, from which the sensor counts as lost.
const LOST_AFTER_MISSED_SAMPLES: u32 = 10;
/// Share of a period by which SYNC may leave late.
const JITTER_SHARE: f64 = 0.2;
/// Share of a period by which a computation may begin late.
const LATE_SHARE: f64 = 0.5;
/// Grid points without a cycle from which no cycle ran for more than three periods.
const STALLED_AFTER_SKIPPED: u32 = 3;

/// State of a joint in a cycle.
struct MeasuredJoint {
    angle_rad: f64,
    rate_rad_per_s: f64,
    /// Cycles without process data.
    missed: u16,
    /// Whether its encoder has gone farther than the joint can.
    has_jumped: bool,
}

impl Cycle {
    /// Takes the measured angles; a joint without new process data is predicted by its last rate, for a few cycles.
    pub(super) fn measure(&mut self, Inputs { drives: [left, right], timing, link, .. }: &Inputs) {
        let (left, right) = (self.measured_joint(0, left, timing), self.measured_joint(1, right, timing));
        self.missed = [left.missed, right.missed];
        self.measured = Measured {
            angles: JointAngles::new(left.angle_rad, right.angle_rad),
            rates: JointRates::new(left.rate_rad_per_s, right.rate_rad_per_s),
        };
        let jumped = DeviceSet::drives_where([left.has_jumped, right.has_jumped]);
        self.faults.observe_on(Fault::EncoderJump, jumped);
        // An intruder keeps SYNC from leaving, and with it the process data: what is missed then is no fault of its own.
        let missed = DeviceSet::drives_where(self.missed.map(|missed| missed > 0)) | link.outputs_missed;
        self.faults.observe_on(Fault::PdoMissed, missed.only_if(!link.intruder));
        let is_known = self.missed.iter().all(|missed| *missed != u16::MAX);
        // The closure alone does not report on which sides the elbows lie.
        let sides = self.linkage.geometry().elbows;
        self.posture = self.linkage.close(self.measured.angles).ok().map(|closure| self.linkage.posture(&closure));
        if !(is_known && self.posture.as_ref().is_some_and(|posture| posture.elbow_sides == sides)) {
            self.posture = None;
        }
        self.clearance_m = self.posture.as_ref().map_or(f64::NAN, |posture| self.clearance_of_m(posture));
        self.faults.observe(Fault::Posture, is_known && self.posture.is_none());
    }

    /// Returns the state of a joint, 0 the left one, in this cycle.
    fn measured_joint(&self, joint: usize, drive: &DriveSample, timing: &Timing) -> MeasuredJoint {
        let period = self.settings.period_s;
        let [left, right] = self.missed;
        let (angle_rad, rate_rad_per_s, missed) = match joint {
            0 => (self.measured.angles.left(), self.measured.rates.left(), left),
            _ => (self.measured.angles.right(), self.measured.rates.right(), right),
        };
        let last = MeasuredJoint { angle_rad, rate_rad_per_s, missed, has_jumped: false };
        // What no encoder can say, NaN included, counts as not arrived.
        match drive.angle_rad.filter(|angle| angle.abs() <= ANGLE_LIMIT_RAD) {
            Some(angle_rad) if missed == u16::MAX => {
                MeasuredJoint { angle_rad, rate_rad_per_s: 0.0, missed: 0, ..last }
            }
            Some(new) => {
                // A joint goes on turning while no cycle runs; how long a suspended computer was away, nobody knows.
                let cycles = f64::from(missed) + f64::from(timing.skipped) + 1.0;
                let predicted = f64::from(missed.min(PREDICTED_CYCLES));
                let step = new - (angle_rad - rate_rad_per_s * period * predicted);
                let is_far = step.abs() > 2.0 * self.settings.joint_speed_limit_rad_per_s * period * cycles;
                MeasuredJoint {
                    angle_rad: new,
                    rate_rad_per_s: step / (period * cycles),
                    missed: 0,
                    has_jumped: is_far && !timing.suspended,
                }
            }
            None if missed == u16::MAX => last,
            None => {
                let is_predicted = missed < PREDICTED_CYCLES;
                let angle_rad = if is_predicted { angle_rad + rate_rad_per_s * period } else { angle_rad };
                MeasuredJoint { angle_rad, missed: (missed + 1).min(u16::MAX - 1), ..last }
            }
        }
    }

    /// Counts every fault that shows before the supervisor decides.
    pub(super) fn observe(&mut self, inputs: &Inputs, reading: &Reading) {
        let is_stop = inputs.request == Request::Stop;
        self.faults.observe(Fault::StopRequested, is_stop);
        self.observe_sensing(reading);
        self.observe_link(&inputs.link);
        self.observe_drives(&inputs.drives);
        self.observe_arm();
        self.observe_motion(reading);
        self.observe_timing(&inputs.timing);
    }

    /// Observes the sensor. A fault in a sample is counted once for each sample; only a new sample shows whether it goes on.
    fn observe_sensing(&mut self, reading: &Reading) {
        let is_resting = matches!(self.supervisor.state(), State::Idle | State::Enabling);
        self.sensing.set_resting(is_resting);
        let limit = self.settings.force_limit_n;
        let faults = &mut self.faults;
        let mut see = |fault, is_present| faults.observe_on(fault, DeviceSet::SENSOR.only_if(is_present));
        if reading.new_sample {
            see(Fault::SensorInvalid, reading.refused_samples > 0);
            see(Fault::SensorSaturated, reading.saturated);
            see(Fault::SensorStuck, reading.stuck);
            see(Fault::ForceStep, reading.stepped);
            see(Fault::ForceLimit, reading.force.norm() > limit);
        }
        see(Fault::SensorStale, reading.stale);
        see(Fault::SensorLost, reading.missed_samples >= LOST_AFTER_MISSED_SAMPLES);
    }

    fn observe_link(&mut self, link: &LinkEvents) {
        let host = |is_present| DeviceSet::HOST.only_if(is_present);
        let faults = &mut self.faults;
        faults.observe_on(Fault::PdoLength, link.bad_length);
        faults.observe_on(Fault::PdoDuplicated, link.duplicated);
        faults.observe_on(Fault::PdoLate, link.late);
        faults.observe_on(Fault::NodeReset, link.node_reset);
        faults.observe_on(Fault::HeartbeatLost, link.heartbeat_lost);
        faults.observe_on(Fault::DuplicateNode, link.duplicate_node);
        faults.observe_on(Fault::Intruder, host(link.intruder));
        faults.observe_on(Fault::Emergency, link.emergency);
        faults.observe_on(Fault::EmergencyWarning, link.emergency_warning);
        faults.observe_on(Fault::TransmitStalled, link.transmit_stalled);
        faults.observe_on(Fault::ErrorPassive, link.error_passive);
        faults.observe_on(Fault::BusOff, link.bus_off);
        faults.observe_on(Fault::LinkDown, link.send_failed);
        // Somebody else may have brought it there.
        faults.observe_on(Fault::DeviceState, link.device_state.only_if(!link.intruder));
        faults.observe_on(Fault::ClockLost, link.clock_lost);
        faults.observe_on(Fault::PortErrors, link.port_errors);
    }

    fn observe_drives(&mut self, drives: &[DriveSample; 2]) {
        let state = self.supervisor.state();
        let (is_moving, is_enabling) = (is_moving(state), state == State::Enabling);
        let were_enabled = DeviceSet::drives_where(self.were_enabled);
        let are_enabled = drives.map(|drive| drive.state == cia402::State::OperationEnabled);
        self.were_enabled = are_enabled;
        let is_fault =
            |drive: DriveSample| matches!(drive.state, cia402::State::Fault | cia402::State::FaultReactionActive);
        // From Operation Enabled on a drive has to stay there and to have voltage; on the way there some have none.
        let shall_be_enabled = DeviceSet::DRIVES.only_if(is_moving) | were_enabled.only_if(is_enabling);
        let out = DeviceSet::drives_where(are_enabled.map(|is_enabled| !is_enabled));
        let dead = DeviceSet::drives_where(drives.map(|drive| !drive.has_voltage));
        let deaf = DeviceSet::drives_where(drives.map(|drive| !drive.follows_command));
        // In homing mode that bit tells something else.
        let follows = is_moving && !self.homes;
        self.enabling_cycles = if is_enabling { self.enabling_cycles.saturating_add(1) } else { 0 };
        let (enabling_cycles, period_s) = (self.enabling_cycles, self.settings.period_s);
        let is_late = |limit_s: f64| enabling_cycles > (limit_s / period_s) as u32;
        let late = DeviceSet::drives_where(self.settings.enabling_limit_s.map(is_late));
        let faults = &mut self.faults;
        faults.observe_on(Fault::DriveFault, DeviceSet::drives_where(drives.map(is_fault)));
        faults.observe_on(Fault::DriveVoltageOff, dead & shall_be_enabled);
        faults.observe_on(Fault::DriveLeftOperation, out & shall_be_enabled);
        faults.observe_on(Fault::DriveWarning, DeviceSet::drives_where(drives.map(|drive| drive.has_warning)));
        faults.observe_on(Fault::DriveIgnoresCommand, deaf.only_if(follows));
        faults.observe_on(Fault::EnablingTimeout, out & late);
    }

    fn observe_arm(&mut self) {
        let error = match self.track.now() {
            Some(reference) if is_moving(self.supervisor.state()) => reference.angles() - self.measured.angles,
            _ => JointAngles::default(),
        };
        let own = self.settings.following_error_limit_rad;
        let led = self.lead.map(|lead| lead.following_error_rad(self.settings.period_s));
        let limit = led.map_or(own, |led| led.min(own));
        let beyond = |limit: f64| DeviceSet::drives_where(error.to_array().map(|error| error.abs() > limit));
        self.faults.observe_on(Fault::FollowingError, beyond(limit) | self.blocked);
        self.faults.observe_on(Fault::Runaway, beyond(2.0 * limit));
        let is_left = self.clearance_m < LEFT_SHARE * self.settings.singularity_margin_m;
        self.faults.observe(Fault::WorkspaceLeft, is_left);
        let residual = self.balance.residual_n_m();
        let is_implausible = self.settings.residual_limit_n_m.is_some_and(|limit| residual.max_abs() > limit);
        self.faults.observe_on(Fault::ForceImplausible, DeviceSet::SENSOR.only_if(is_implausible));
    }

    /// Observes the effect of the rig on the hand: only while the fixture moves the reference, from the beginning each time.
    fn observe_motion(&mut self, reading: &Reading) {
        let period = self.settings.period_s;
        let is_running = self.supervisor.state() == State::Running;
        let running = self.track.now().filter(|_| is_running);
        if running.is_none() {
            self.excess.restart();
            self.chatter = Chatter::default();
        }
        let excess_j = match (running, &self.posture) {
            (Some(reference), Some(posture)) => self.excess.step(Port {
                tool: posture.tip.0,
                force_n: reading.force.0,
                proxy: reference.point.0,
                stored_j: self.fixture.stored_j(),
                brought_j: self.brought_j,
            }),
            _ => 0.0,
        };
        let is_chatter = running.is_some_and(|reference| self.chatter.step(reference.velocity, period));
        self.faults.observe(Fault::EnergyLimit, excess_j > self.settings.energy_limit_j);
        self.faults.observe(Fault::Chatter, is_chatter);
        self.faults.observe(Fault::OverSpeed, false);
        self.faults.observe(Fault::NotFinite, false);
    }

    fn observe_timing(&mut self, timing: &Timing) {
        let host = |is_present| DeviceSet::HOST.only_if(is_present);
        let period = self.settings.period_s;
        let seconds = |ns: u32| f64::from(ns) * 1e-9;
        let is_late = seconds(timing.compute_late_ns) > LATE_SHARE * period;
        let is_long = seconds(timing.last_compute_ns) > self.settings.compute_budget_s;
        let faults = &mut self.faults;
        faults.observe_on(Fault::SyncJitter, host(seconds(timing.sync_late_ns) > JITTER_SHARE * period));
        faults.observe_on(Fault::Overrun, host(is_late || is_long || timing.skipped > 0));
        // A computation that begins so late has let those grid points pass, and tells it before it sends what it computes.
        let is_stalled = seconds(timing.compute_late_ns) >= f64::from(STALLED_AFTER_SKIPPED) * period;
        faults.observe_on(Fault::Stalled, host(is_stalled || timing.skipped >= STALLED_AFTER_SKIPPED));
        faults.observe_on(Fault::Suspended, host(timing.suspended));
    }
}

fn is_moving(state: State) -> bool {
    matches!(state, State::Running | State::Holding | State::Stopping)
}
