//! What the cycle watches: it fills the fault counts.

use super::{Cycle, DriveSample, Inputs};
use crate::guard::{DeviceSet, Fault, Measured, State};
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

impl Cycle {
    /// Takes the measured angles; a joint without new process data is predicted by its last rate, for a few cycles.
    pub(super) fn measure(&mut self, drives: &[DriveSample; 2]) {
        let period = self.settings.period_s;
        let last = self.measured;
        let mut angles = last.angles.to_array();
        let mut rates = last.rates.to_array();
        let mut jumped = false;
        for (joint, drive) in drives.iter().enumerate() {
            let (Some(angle), Some(rate), Some(missed)) =
                (angles.get_mut(joint), rates.get_mut(joint), self.missed.get_mut(joint))
            else {
                continue;
            };
            // What no encoder can say, NaN included, counts as not arrived.
            match drive.angle_rad.filter(|angle| angle.abs() <= ANGLE_LIMIT_RAD) {
                Some(new) if *missed == u16::MAX => {
                    (*angle, *rate, *missed) = (new, 0.0, 0);
                }
                Some(new) => {
                    let cycles = f64::from(*missed) + 1.0;
                    let predicted = f64::from((*missed).min(PREDICTED_CYCLES));
                    let step = new - (*angle - *rate * period * predicted);
                    jumped |= step.abs() > 2.0 * self.settings.joint_speed_limit_rad_per_s * period * cycles;
                    (*angle, *rate, *missed) = (new, step / (period * cycles), 0);
                }
                None if *missed == u16::MAX => {}
                None => {
                    if *missed < PREDICTED_CYCLES {
                        *angle += *rate * period;
                    }
                    *missed = (*missed + 1).min(u16::MAX - 1);
                }
            }
        }
        self.measured = Measured { angles: JointAngles::from(angles), rates: JointRates::from(rates) };
        self.faults.observe(Fault::EncoderJump, jumped);
        self.faults.observe(Fault::PdoMissed, self.missed.iter().any(|missed| *missed > 0));
        let is_known = self.missed.iter().all(|missed| *missed != u16::MAX);
        // The closure alone does not tell on which sides the elbows lie.
        let sides = self.linkage.geometry().elbows;
        let posture = self.linkage.forward(self.measured.angles).ok();
        self.posture = posture.filter(|posture| is_known && posture.elbow_sides == sides);
        self.clearance_m = self.posture.as_ref().map_or(f64::NAN, |posture| self.clearance_of_m(posture));
        self.faults.observe(Fault::Posture, is_known && self.posture.is_none());
    }

    /// Counts every fault that shows before the supervisor decides.
    pub(super) fn observe(&mut self, inputs: &Inputs, reading: &Reading) {
        let is_moving = matches!(self.supervisor.state(), State::Running | State::Holding | State::Stopping);
        let states = inputs.drives.map(|drive| drive.state);
        let is_fault =
            |state: cia402::State| matches!(state, cia402::State::Fault | cia402::State::FaultReactionActive);
        let are_enabled = states.map(|state| state == cia402::State::OperationEnabled);
        let has_left = self.were_enabled.iter().zip(are_enabled).any(|(was, is)| *was && !is);
        let is_enabling = self.supervisor.state() == State::Enabling;
        let left = (is_moving && are_enabled != [true; 2]) || (is_enabling && has_left);
        self.were_enabled = are_enabled;
        let ignored = is_moving && inputs.drives.iter().any(|drive| !drive.follows_command);
        let error = match &self.reference {
            Some(reference) if is_moving => (reference.angles.0 - self.measured.angles.0).amax(),
            _ => 0.0,
        };
        let limit = self.settings.following_error_limit_rad;
        let is_left = self.clearance_m < LEFT_SHARE * self.settings.singularity_margin_m;
        let faults = &mut self.faults;
        faults.observe(Fault::StopRequested, inputs.request == crate::guard::Request::Stop);
        faults.observe(Fault::SensorSaturated, reading.saturated);
        faults.observe(Fault::SensorStale, reading.stale);
        faults.observe(Fault::SensorLost, reading.missed_samples >= LOST_AFTER_MISSED_SAMPLES);
        faults.observe(Fault::ForceLimit, reading.force.0.norm() > self.settings.force_limit_n);
        faults.observe_on(Fault::PdoLength, inputs.link.bad_length);
        faults.observe_on(Fault::NodeReset, inputs.link.node_reset);
        faults.observe_on(Fault::HeartbeatLost, inputs.link.heartbeat_lost);
        faults.observe_on(Fault::Emergency, inputs.link.emergency);
        faults.observe_on(Fault::PdoDuplicated, inputs.link.duplicated);
        faults.observe_on(Fault::PdoLate, inputs.link.late);
        faults.observe_on(Fault::DuplicateNode, inputs.link.duplicate_node);
        faults.observe_on(Fault::EmergencyWarning, inputs.link.emergency_warning);
        faults.observe_on(Fault::Intruder, DeviceSet::HOST.only_if(inputs.link.intruder));
        faults.observe_on(Fault::TransmitStalled, DeviceSet::HOST.only_if(inputs.link.transmit_stalled));
        faults.observe_on(Fault::ErrorPassive, DeviceSet::HOST.only_if(inputs.link.error_passive));
        faults.observe_on(Fault::BusOff, DeviceSet::HOST.only_if(inputs.link.bus_off));
        faults.observe_on(Fault::LinkDown, DeviceSet::HOST.only_if(inputs.link.send_failed));
        faults.observe(Fault::DriveFault, states.into_iter().any(is_fault));
        faults.observe(Fault::DriveLeftOperation, left);
        faults.observe(Fault::DriveIgnoresCommand, ignored);
        faults.observe(Fault::FollowingError, error > limit);
        faults.observe(Fault::Runaway, error > 2.0 * limit);
        faults.observe(Fault::WorkspaceLeft, is_left);
        faults.observe(Fault::OverSpeed, false);
        faults.observe(Fault::NotFinite, false);
    }
}
