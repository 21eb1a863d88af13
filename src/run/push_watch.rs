//! Whether drives that move their joints by themselves push and do not move them: what blocks a joint looks so, and an encoder that stands
//! still. Position tells neither from a drive that rests.

use super::error::RunError;
use super::home::NotHome;
use super::place::Place;
use super::runner::Runner;
use super::torque_meter::{Metered, TorqueMeter};
use crate::config;
use crate::guard::Device;
use yieldwall_drives::objects::TORQUE_ACTUAL;

/// Of its torque limit: a drive that makes so much pushes.
const PUSHES: f64 = 0.9;
/// How long it may push without moving its joint, s.
const PUSH_S: f64 = 0.01;
/// Of what it took to move the joint: a drive that makes so much while the joint rests pushes too.
const RESTS_AND_PUSHES: f64 = 1.2;
/// How long it may do so, s: a controller comes to rest.
const REST_PUSH_S: f64 = 0.05;
/// Of its way at its rate: a joint that goes less does not move.
const MOVES: f64 = 0.5;
/// How long a drive may be silent about its torque, s.
const SILENT_S: f64 = 0.5;

/// Looks at both joints, whose drives are asked for their torque by turns: a bus may have no room for both.
pub(super) struct PushWatch {
    joints: [Watched; 2],
    /// Which one is asked.
    turn: usize,
}

struct Watched {
    meter: TorqueMeter,
    /// When it last told its torque, s.
    told_s: f64,
    limit_n_m: f64,
    rate_rad_per_s: f64,
    /// Since when it pushes, s, and where the joint was then, rad.
    since: Option<(f64, f64)>,
    /// When it told its torque before, s, and where the joint was, rad.
    before: Option<(f64, f64)>,
    /// Sum of what it made while the joint moved, N m, and how often that was seen.
    moving_n_m: f64,
    moved: u32,
}

impl PushWatch {
    /// A watch of joints that go at these rates, rad/s. Reads each drive's torque and torque limit.
    pub(super) fn new<P: Place>(
        runner: &mut Runner<P>,
        rig: &config::Rig,
        rates_rad_per_s: [f64; 2],
    ) -> Result<Self, RunError> {
        let mut of = |joint: usize, device, rate_rad_per_s| -> Result<Watched, RunError> {
            let meter = TorqueMeter::new(rig, joint, 0)?;
            runner.read(device, TORQUE_ACTUAL.index, TORQUE_ACTUAL.sub)?;
            let limit = runner.torque_limit(rig, device)?;
            let limit_n_m = meter.torque_n_m(i16::try_from(limit).unwrap_or(i16::MAX)).abs();
            Ok(Watched {
                meter,
                told_s: 0.0,
                limit_n_m,
                rate_rad_per_s,
                since: None,
                before: None,
                moving_n_m: 0.0,
                moved: 0,
            })
        };
        let [left, right] = rates_rad_per_s;
        Ok(Self { joints: [of(0, Device::LeftDrive, left)?, of(1, Device::RightDrive, right)?], turn: 0 })
    }

    /// Why neither joint may go on, `time_s` after the first one began: one is blocked, or nobody knows. `rests` tells which ones are to
    /// rest.
    ///
    /// Real-time: yes.
    pub(super) fn step<P: Place>(&mut self, runner: &mut Runner<P>, time_s: f64, rests: [bool; 2]) -> Option<NotHome> {
        let angles = runner.angles().to_array();
        let (joint, angle_rad) = (self.turn, angles.get(self.turn).copied().unwrap_or_default());
        if let Some(asked) = self.joints.get_mut(joint) {
            let told = asked.meter.take(runner);
            if let Metered::Torque(torque_n_m) = told {
                asked.told_s = time_s;
                if asked.is_blocked(time_s, angle_rad, torque_n_m, rests.get(joint) == Some(&true)) {
                    return Some(NotHome::Blocked(joint, torque_n_m));
                }
            }
            if told != Metered::Pending {
                self.turn = 1 - joint;
                self.joints.iter_mut().skip(self.turn).take(1).for_each(|next| next.meter.ask(runner, None));
            }
        }
        let silent = self.joints.iter().position(|joint| time_s - joint.told_s > SILENT_S);
        silent.map(NotHome::Silent)
    }

    /// Waits for what was asked last.
    pub(super) fn finish<P: Place>(&mut self, runner: &mut Runner<P>) {
        self.joints.iter_mut().for_each(|joint| joint.meter.finish(runner));
    }
}

impl Watched {
    /// Whether it has pushed for a while and has not moved, with the joint at this angle.
    ///
    /// Real-time: yes.
    fn is_blocked(&mut self, time_s: f64, angle_rad: f64, torque_n_m: f64, rests: bool) -> bool {
        let torque_n_m = torque_n_m.abs();
        let is_still = |(since_s, from_rad): (f64, f64)| {
            (angle_rad - from_rad).abs() < MOVES * self.rate_rad_per_s * (time_s - since_s)
        };
        let (is_moving, stands) = (self.before.is_some_and(|it| !is_still(it)), self.since.is_some_and(is_still));
        if is_moving {
            (self.moving_n_m, self.moved) = (self.moving_n_m + torque_n_m, self.moved.saturating_add(1));
        }
        self.before = Some((time_s, angle_rad));
        let (mut most_n_m, mut most_s) = (PUSHES * self.limit_n_m, PUSH_S);
        let rest_n_m = RESTS_AND_PUSHES * self.moving_n_m / f64::from(self.moved.max(1));
        if rests && self.moved > 0 && rest_n_m < most_n_m && torque_n_m < most_n_m {
            (most_n_m, most_s) = (rest_n_m, REST_PUSH_S);
        }
        if torque_n_m < most_n_m {
            self.since = None;
            return false;
        }
        let (since_s, _) = *self.since.get_or_insert((time_s, angle_rad));
        if time_s - since_s < most_s {
            return false;
        }
        if !stands {
            self.since = Some((time_s, angle_rad));
        }
        stands
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watched() -> Watched {
        let rig = config::load_rig(config::builtin("paper-incremental.yaml")).unwrap().value;
        Watched {
            meter: TorqueMeter::new(&rig, 0, 0).unwrap(),
            told_s: 0.0,
            limit_n_m: 15.0,
            rate_rad_per_s: 0.05,
            since: None,
            before: None,
            moving_n_m: 0.0,
            moved: 0,
        }
    }

    /// When a joint is found blocked that goes at its rate until it stands, and whose torque is this from then on; asked every 4 ms.
    fn blocked_at(stands_s: f64, rests: bool, torque: impl Fn(f64) -> f64) -> Option<f64> {
        let mut watched = watched();
        let times = (0..500).map(|at| 0.004 * f64::from(at));
        let mut times = times.map(|time_s| (time_s, 0.05 * f64::min(time_s, stands_s)));
        let found = times.find(|(time_s, angle_rad)| {
            let torque = if *time_s < stands_s { 10.0 } else { torque(*time_s) };
            watched.is_blocked(*time_s, *angle_rad, torque, rests && *time_s > stands_s)
        });
        found.map(|(time_s, _)| time_s)
    }

    #[test]
    fn a_joint_that_stands_while_its_drive_pushes_is_found_soon() {
        for sign in [1.0, -1.0] {
            let at_s = blocked_at(1.0, false, |_| sign * 14.0).unwrap();
            assert!((1.0..1.02).contains(&at_s), "{at_s}");
            let at_s = blocked_at(1.0, true, |_| sign * 12.1).unwrap();
            assert!((1.05..1.07).contains(&at_s), "{at_s}");
        }
    }

    #[test]
    fn friction_and_a_push_that_moves_are_none() {
        // What moved it holds it too.
        assert_eq!(blocked_at(1.0, true, |_| 10.0), None);
        // Before it moves again it may have to break loose.
        assert_eq!(blocked_at(1.0, false, |_| 13.0), None);
        // It moves with all that its drive may make.
        assert_eq!(blocked_at(9.0, false, |_| 0.0), None);
        let mut watched = watched();
        for at in 0..200 {
            let time_s = 0.004 * f64::from(at);
            assert!(!watched.is_blocked(time_s, 0.05 * time_s, 15.0, false));
        }
        // A peak is none, however high.
        assert_eq!(blocked_at(1.0, true, |time_s| if time_s < 1.009 { 15.0 } else { 10.0 }), None);
    }
}
