//! Watch for guided joints that are pushed and do not move. A blocked joint looks so, and so does a frozen encoder. Near the target
//! a following error detects neither.

use super::push::{Push, Stand};
use super::torque_meter::{Metered, TorqueMeter};
use crate::error::RunError;
use crate::permit::Permit;
use crate::place::Place;
use crate::runner::Runner;
use yieldwall_config as config;
use yieldwall_motion::cycle::LeadLimits;
use yieldwall_motion::guard::JointCommand;
use yieldwall_record::CycleRecord;

/// Largest deviation from a joint's rate that still counts as steady, as a share of that rate.
const STEADY: f64 = 0.01;

/// Torque (6077h) that a drive reported while its joint was guided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToldTorque {
    /// The joint, 0 the left one.
    pub joint: usize,
    /// Its angle when the drive was asked, rad.
    pub angle_rad: f64,
    /// The torque, N m.
    pub torque_n_m: f64,
    /// Whether the joint was guided at its full rate then.
    pub is_steady: bool,
}

/// Watch of both joints. In torque mode the torque is the one that this program commands. In the other modes it asks the drives of
/// guided joints for their torque over SDO, alternately; a drive that does not report it is not watched.
pub(super) struct LeadWatch {
    joints: [Watched; 2],
    limits: LeadLimits,
    /// Joint whose drive is asked.
    turn: usize,
    period_s: f64,
    blocked: Option<usize>,
}

struct Watched {
    push: Push,
    /// Meter of a drive that is asked.
    meter: Option<TorqueMeter>,
    /// Angle of the joint when its drive was asked, rad, and whether the joint was guided at its full rate.
    asked: (f64, bool),
    /// Last commanded angle, rad.
    led_rad: Option<f64>,
}

impl LeadWatch {
    /// Creates a watch of joints that are guided within limits, by a permit. `are_asked` marks the drives that are asked for their
    /// torque.
    pub(super) fn new(
        runner: &Runner<dyn Place>,
        rig: &config::Rig,
        permit: &Permit,
        limits: LeadLimits,
        are_asked: [bool; 2],
    ) -> Result<Self, RunError> {
        let most_n_m = rig.guard.torque_limit_n_m.get().min(permit.torque_bound_n_m().unwrap_or(f64::INFINITY));
        let of = |joint: usize| -> Result<Watched, RunError> {
            let is_asked = are_asked.get(joint) == Some(&true);
            let meter = is_asked.then(|| TorqueMeter::new(rig, joint, 0)).transpose()?;
            Ok(Watched { push: Push::new(most_n_m), meter, asked: (0.0, false), led_rad: None })
        };
        let period_s = runner.period().as_secs_f64();
        Ok(Self { joints: [of(0)?, of(1)?], limits, turn: 0, period_s, blocked: None })
    }

    /// Evaluates a cycle, whose time began `cycles` periods after the first one. Returns the torque that a drive has reported.
    ///
    /// Real-time: yes.
    pub(super) fn step(
        &mut self,
        runner: &mut Runner<dyn Place>,
        record: &CycleRecord,
        cycles: u32,
    ) -> Option<ToldTorque> {
        let time_s = f64::from(cycles) * self.period_s;
        let led = record.signals.target_angles.to_array();
        let [left, right] = record.signals.measured_angles.to_array();
        let [left_led, right_led] = led;
        let stands = [(left, left_led), (right, right_led)];
        let stands = stands.map(|(angle_rad, led_rad)| Stand { time_s, angle_rad, led_rad });
        if let JointCommand::Torque(torques) = record.command {
            for (joint, (now, torque_n_m)) in stands.into_iter().zip(torques.to_array()).enumerate() {
                self.look(joint, now, torque_n_m);
            }
        }
        let mut are_steady = [false; 2];
        for ((is_steady, watched), led_rad) in are_steady.iter_mut().zip(&mut self.joints).zip(led) {
            let last_rad = watched.led_rad.replace(led_rad).unwrap_or(led_rad);
            let (rate, full) = ((led_rad - last_rad) / self.period_s, self.limits.rate_rad_per_s);
            *is_steady = (rate.abs() - full).abs() < STEADY * full;
        }
        let is_told = !matches!(record.command, JointCommand::Torque(_));
        self.hear(runner, stands, are_steady, is_told)
    }

    fn look(&mut self, joint: usize, now: Stand, torque_n_m: f64) {
        let Some(Watched { push, .. }) = self.joints.get_mut(joint) else { return };
        if push.is_blocked_while_led(now, torque_n_m) {
            self.blocked = Some(joint);
        }
    }

    /// Takes the report of the drive that was asked, and asks the next one. If `counts`, the torque is not known otherwise.
    fn hear(
        &mut self,
        runner: &mut Runner<dyn Place>,
        stands: [Stand; 2],
        are_steady: [bool; 2],
        counts: bool,
    ) -> Option<ToldTorque> {
        let joint = self.turn;
        let now = |joint: usize| Some((*stands.get(joint)?, *are_steady.get(joint)?));
        let watched = self.joints.get_mut(joint)?;
        let told = watched.meter.as_mut().map_or(Metered::Nothing, |meter| meter.take(runner));
        if told == Metered::Pending {
            return None;
        }
        let (angle_rad, is_steady) = watched.asked;
        let told = match told {
            Metered::Torque(torque_n_m) => Some(ToldTorque { joint, angle_rad, torque_n_m, is_steady }),
            _ => None,
        };
        if let Some((told, (now, _))) = told.zip(now(joint)).filter(|_| counts) {
            self.look(joint, now, told.torque_n_m);
        }
        let is_asked = |joint: usize| self.joints.get(joint).is_some_and(|joint| joint.meter.is_some());
        self.turn = if is_asked(1 - joint) { 1 - joint } else { joint };
        if let Some((next, now)) = self.joints.get_mut(self.turn).zip(now(self.turn)) {
            next.asked = (now.0.angle_rad, now.1);
            next.meter.iter_mut().for_each(|meter| meter.ask(runner, None));
        }
        told
    }

    /// Returns the joint that is pushed and does not move.
    pub(super) fn blocked(&self) -> Option<usize> {
        self.blocked
    }

    /// Waits for what was asked last.
    pub(super) fn finish(&mut self, runner: &mut Runner<dyn Place>) {
        self.joints.iter_mut().filter_map(|joint| joint.meter.as_mut()).for_each(|meter| meter.finish(runner));
    }
}
