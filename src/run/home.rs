//! Homing: each drive finds its reference by itself, one after the other, while the other one holds.

use std::sync::atomic::{AtomicBool, Ordering};

use super::error::RunError;
use super::permit::{Ask, Permit};
use super::place::Place;
use super::runner::Runner;
use super::scene::Ended;
use crate::config;
use crate::guard::{Cause, State};
use crate::quantity::JointAngles;

/// How far a joint may go beyond its way, and one that holds from where it was, rad. An arm that is stopped still slides.
pub const HOMING_BEYOND_RAD: f64 = 0.05;
/// How far from home a joint may stand when it was found, rad, beside what it needs to come to rest.
const OFF_RAD: f64 = 5e-3;
/// How long a drive is watched that says that it is home, s.
const REST_S: f64 = 0.3;
/// How long a way may take beyond what its rate needs, s.
const PATIENCE_S: f64 = 3.0;
/// A joint comes up to its rate in so long, s.
const COMES_UP_S: f64 = 0.2;

/// What is asked of the drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomePlan {
    /// Which joints are homed, the left one first.
    pub joints: [bool; 2],
    /// How far each joint may go, rad.
    within_rad: [f64; 2],
    /// How fast each goes, rad/s.
    rate_rad_per_s: [f64; 2],
    /// Angle of each joint at home, rad.
    home: JointAngles,
    /// Greatest rate of a joint of the rig, rad/s: a faster one is a jump to the reference.
    fastest_rad_per_s: f64,
    /// Cycles of process data before the drives are enabled.
    settling: u32,
}

impl HomePlan {
    /// Homes these joints of a rig; `None` if it has no homing.
    pub fn of(rig: &config::Rig, joints: [bool; 2], settling: u32) -> Option<Self> {
        let [left, right] = rig.drives.each_ref().map(|drive| drive.homing);
        let homing = [left?, right?];
        Some(Self {
            joints,
            within_rad: homing.map(|homing| homing.within_rad.get()),
            rate_rad_per_s: homing.map(|homing| homing.rate_rad_per_s.get()),
            home: homing.map(|homing| homing.angle_rad.get()).into(),
            fastest_rad_per_s: rig.guard.joint_speed_limit_rad_per_s.get(),
            settling,
        })
    }

    /// The farthest that a joint may go, rad.
    pub fn bound_rad(&self) -> f64 {
        self.within_rad[0].max(self.within_rad[1]) + HOMING_BEYOND_RAD
    }
}

/// Why a drive did not find its reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NotHome {
    /// It has given up (statusword, bit 13).
    GaveUp,
    /// It took too long, s.
    TooLong(f64),
    /// It says that home was found, and not that its position refers to it.
    NotReferenced,
    /// It stands elsewhere than at home, by its position: by so much, rad.
    Elsewhere(f64),
    /// This joint, 0 the left one, went farther than it may, by so much, rad.
    TooFar(usize, f64),
}

/// What became of one joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointHomed {
    /// How far it went at most, either way, rad.
    pub farthest_rad: f64,
    /// Where it stands in the end by its position, rad.
    pub angle_rad: f64,
    /// Whether its drive says that its position refers to home.
    pub is_referenced: bool,
    /// Whether its drive has found home now.
    pub is_homed: bool,
}

/// What homing has shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homed {
    /// How it ended; [`Ended::Whole`] if all joints that were asked for are homed.
    pub ended: Ended,
    /// State of the supervisor before the rig was stopped.
    pub state: State,
    /// The fault that led to it.
    pub cause: Option<Cause>,
    /// Which joint did not find its reference, 0 the left one, and why.
    pub failed: Option<(usize, NotHome)>,
    /// Time from enabling to the end, s.
    pub time_s: f64,
    /// Both joints, the left one first.
    pub joints: [JointHomed; 2],
}

/// How far each joint has gone. A drive that finds its reference tells another angle of the same place; that is no way.
struct Ways {
    last: JointAngles,
    gone: [f64; 2],
    farthest: [f64; 2],
    were_referenced: [bool; 2],
}

impl Ways {
    fn step(&mut self, now: JointAngles, are_referenced: [bool; 2], jump_rad: f64) {
        let steps = (now - self.last).to_array();
        self.last = now;
        for (joint, step) in steps.into_iter().enumerate() {
            let is_jump = step.abs() > jump_rad || are_referenced.get(joint) != self.were_referenced.get(joint);
            if let (false, Some(gone), Some(farthest)) =
                (is_jump, self.gone.get_mut(joint), self.farthest.get_mut(joint))
            {
                *gone += step;
                *farthest = farthest.max(gone.abs());
            }
        }
        self.were_referenced = are_referenced;
    }
}

impl<P: Place> Runner<P> {
    /// Enables a rig that was booted for homing ([`Runner::prepare_homing`]), has each drive that is asked for find its reference, and stops
    /// it. The other drive holds its joint meanwhile. A joint that goes farther than it may, whatever holds the rig, and a fault at either
    /// drive quick-stop both.
    ///
    /// # Errors
    /// [`RunError::WayBlocked`], before anything is enabled, if the linkage does not go as far as a joint may; as [`Runner::enable`].
    pub fn home(&mut self, plan: &HomePlan, permit: &Permit, is_interrupted: &AtomicBool) -> Result<Homed, RunError> {
        self.check_permit(permit)?;
        self.watch_homing(true);
        let homed = self.home_all(plan, permit, is_interrupted);
        self.set_homing([false; 2]);
        self.watch_homing(false);
        homed
    }

    fn home_all(&mut self, plan: &HomePlan, permit: &Permit, is_interrupted: &AtomicBool) -> Result<Homed, RunError> {
        self.idle_before_lead(plan.settling.max(1), is_interrupted)?;
        self.check_homing_way(plan)?;
        self.enable(0, permit, is_interrupted)?;
        // Both are watched here: a drive that finds its reference tells another angle.
        self.unbind_motion();
        self.begin_scene();
        let are_referenced = |rig: &Self| rig.master().homing().map(|homing| homing.is_referenced);
        let mut ways =
            Ways { last: self.angles(), gone: [0.0; 2], farthest: [0.0; 2], were_referenced: are_referenced(self) };
        let (mut ended, mut failed, mut cycles, mut homed) = (Ended::Whole, None, 0, [false; 2]);
        for joint in (0..2).filter(|joint| plan.joints.get(*joint) == Some(&true)) {
            match self.home_one(joint, plan, &mut ways, &mut cycles, is_interrupted) {
                Ok(()) => homed.iter_mut().skip(joint).take(1).for_each(|homed| *homed = true),
                Err((end, why)) => {
                    (ended, failed) = (end, why.map(|why| (joint, why)));
                    break;
                }
            }
        }
        self.set_homing([false; 2]);
        let (state, cause) = (self.state(), self.cause());
        let (angles, referenced) = (self.angles().to_array(), are_referenced(self));
        let ended = self.end_lead(ended);
        let of = |joint: usize| JointHomed {
            farthest_rad: ways.farthest.get(joint).copied().unwrap_or_default(),
            angle_rad: angles.get(joint).copied().unwrap_or_default(),
            is_referenced: referenced.get(joint) == Some(&true),
            is_homed: homed.get(joint) == Some(&true),
        };
        let time_s = f64::from(cycles) * self.period().as_secs_f64();
        Ok(Homed { ended, state, cause, failed, time_s, joints: [of(0), of(1)] })
    }

    /// Whether the linkage goes as far as each joint may, from where a person has put the arm. A joint that is not homed may be as far
    /// from there.
    fn check_homing_way(&self, plan: &HomePlan) -> Result<(), RunError> {
        let from = self.angles();
        let homing = self.master().homing();
        let mut least = 1.0_f64;
        for joint in (0..2).filter(|joint| plan.joints.get(*joint) == Some(&true)) {
            let other = 1 - joint;
            let is_known = homing.get(other).is_some_and(|homing| homing.is_referenced);
            let off = if is_known { 0.0 } else { plan.within_rad.get(other).copied().unwrap_or_default() };
            let way = plan.within_rad.get(joint).copied().unwrap_or_default();
            for (way, off) in [(way, off), (way, -off), (-way, off), (-way, -off)] {
                let by = if joint == 0 { [way, off] } else { [off, way] };
                least = least.min(self.master().cycle().free_share(from + JointAngles::from(by)));
            }
        }
        if least < 1.0 { Err(RunError::WayBlocked { share: least }) } else { Ok(()) }
    }

    fn home_one(
        &mut self,
        joint: usize,
        plan: &HomePlan,
        ways: &mut Ways,
        cycles: &mut u32,
        is_interrupted: &AtomicBool,
    ) -> Result<(), (Ended, Option<NotHome>)> {
        let of = |values: [f64; 2]| values.get(joint).copied().unwrap_or_default();
        let (within, rate) = (of(plan.within_rad), of(plan.rate_rad_per_s).max(f64::MIN_POSITIVE));
        // To a switch, and off it again.
        let longest_s = 2.0 * within / rate + PATIENCE_S;
        let (limit, rest) = (self.cycles_in(longest_s), self.cycles_in(REST_S).max(1));
        let mut bounds = [HOMING_BEYOND_RAD; 2];
        bounds.iter_mut().skip(joint).take(1).for_each(|bound| *bound += within);
        // Ways are counted from where this one begins.
        (ways.gone, ways.last) = ([0.0; 2], self.angles());
        let jump_rad = 2.0 * plan.fastest_rad_per_s * self.period().as_secs_f64();
        self.set_homing([joint == 0, joint == 1]);
        let mut rested = 0;
        for _ in 0..limit {
            if is_interrupted.load(Ordering::Relaxed) {
                return Err((Ended::Interrupted, None));
            }
            self.run_cycle(Ask::Nothing);
            *cycles += 1;
            if self.has_panicked() {
                return Err((Ended::Panicked, None));
            }
            let homing = self.master().homing();
            ways.step(self.angles(), homing.map(|homing| homing.is_referenced), jump_rad);
            let off = of((self.angles() - plan.home).to_array());
            // A position that refers to elsewhere is no posture, which stops the rig in this cycle too.
            if homing.get(joint).is_some_and(|homing| homing.is_over && homing.is_referenced) && off.abs() > of(bounds)
            {
                return Err((Ended::Whole, Some(NotHome::Elsewhere(off))));
            }
            if self.state() != State::Running {
                return Err((Ended::Stopped, None));
            }
            let beyond = ways.gone.into_iter().zip(bounds).position(|(gone, bound)| gone.abs() > bound);
            if let Some(beyond) = beyond {
                let gone = ways.gone.get(beyond).copied().unwrap_or_default();
                return Err((Ended::Whole, Some(NotHome::TooFar(beyond, gone))));
            }
            let Some(now) = homing.get(joint) else { continue };
            if now.has_failed {
                return Err((Ended::Whole, Some(NotHome::GaveUp)));
            }
            rested = if now.is_over { rested + 1 } else { 0 };
            if rested >= rest {
                // A joint that was found on its way needs this far to come to rest.
                let slides = 0.5 * rate * COMES_UP_S;
                return match now.is_referenced {
                    false => Err((Ended::Whole, Some(NotHome::NotReferenced))),
                    true if off.abs() > slides + OFF_RAD => Err((Ended::Whole, Some(NotHome::Elsewhere(off)))),
                    true => Ok(()),
                };
            }
        }
        Err((Ended::Whole, Some(NotHome::TooLong(longest_s))))
    }
}
