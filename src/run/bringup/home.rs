//! Homing: each drive finds its reference by itself, one after the other, while the other one holds.

mod push_watch;
mod repeat;
mod trace;

use std::sync::atomic::{AtomicBool, Ordering};

use super::jog::idle_before_lead;
use crate::assembly::HOMING_COMES_UP_S;
use crate::error::RunError;
use crate::permit::{Ask, Permit};
use crate::place::Place;
use crate::runner::Runner;
use crate::scene::Ended;
use push_watch::PushWatch;
pub use repeat::{NoShift, Repeated, home_repeatedly};
use trace::HomingTrace;
use yieldwall_bus::HomingState;
use yieldwall_config as config;
use yieldwall_motion::guard::{Cause, Device, State};
use yieldwall_motion::quantity::JointAngles;

/// Greatest motion of a joint beyond its travel, and of a joint that holds, rad. An arm still slides after the stop.
pub const HOMING_BEYOND_RAD: f64 = 0.05;
/// Greatest distance of a joint from home when the drive has found it, rad, beyond its travel to rest.
const OFF_RAD: f64 = 2e-3;
/// Time for which the loop watches a drive that reports home, s.
const REST_S: f64 = 0.3;
/// Time that a travel may take beyond the time at its rate, s.
const PATIENCE_S: f64 = 3.0;
/// Time in which a drive that still reports an earlier homing has to begin, s.
const BEGINS_S: f64 = 2.0;

/// Request to the drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomePlan {
    /// Joints to home, the left one first.
    pub joints: [bool; 2],
    /// Greatest travel of each joint, rad.
    within_rad: [f64; 2],
    /// Rate of each joint, rad/s.
    rate_rad_per_s: [f64; 2],
    /// Angle of each joint at home, rad.
    home: JointAngles,
    /// 1 for a joint that finds home on its way and comes to rest behind it, 0 for a joint that does not move.
    slides: [f64; 2],
    /// Direction in which each joint looks for home, if its method looks one way alone: 1 or -1.
    one_way: [Option<f64>; 2],
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
            slides: homing.map(|homing| if matches!(homing.method, 35 | 37) { 0.0 } else { 1.0 }),
            one_way: rig.drives.each_ref().map(one_way),
            fastest_rad_per_s: rig.guard.joint_speed_limit_rad_per_s.get(),
            settling,
        })
    }

    /// Returns the farthest that a joint may go, rad.
    pub fn bound_rad(&self) -> f64 {
        self.within_rad[0].max(self.within_rad[1]) + HOMING_BEYOND_RAD
    }

    /// Returns the longest that each joint may take, s: to a switch, and off it again.
    fn longest_s(&self) -> [f64; 2] {
        let [left, right] = self.within_rad;
        let [left_rate, right_rate] = self.rate_rad_per_s;
        [2.0 * left / left_rate + PATIENCE_S, 2.0 * right / right_rate + PATIENCE_S]
    }
}

/// Returns the only direction in which a drive looks for the index: method 33 against its counts, 34 with them (CiA 402).
fn one_way(drive: &config::Drive) -> Option<f64> {
    let with_counts = f64::from(drive.direction);
    match drive.homing?.method {
        33 => Some(-with_counts),
        34 => Some(with_counts),
        _ => None,
    }
}

/// Reason why a drive did not find its reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NotHome {
    /// The drive has given up (statusword, bit 13).
    GaveUp,
    /// The drive has not begun: it still reports the result of its previous homing.
    NotBegun,
    /// The drive took too long, s.
    TooLong(f64),
    /// The drive reports that home was found, but not that its position refers to it.
    NotReferenced,
    /// By its position, the joint is not at home; distance in rad.
    Elsewhere(f64),
    /// This joint, 0 the left one, went this much farther than it may, rad.
    TooFar(usize, f64),
    /// The drive of this joint pushes with this torque, N m, and its position does not change.
    Blocked(usize, f64),
    /// The drive of this joint no longer reports its torque (6077h).
    Silent(usize),
    /// The position of the joint that holds has jumped.
    Jumped(usize),
}

/// Outcome for one joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointHomed {
    /// Greatest distance from its start, either way, rad.
    pub farthest_rad: f64,
    /// Distance from its start in the end, rad.
    pub way_rad: f64,
    /// Final angle by its position, rad.
    pub angle_rad: f64,
    /// Its drive reports that its position refers to home.
    pub is_referenced: bool,
    /// Its drive has found home now.
    pub is_homed: bool,
}

/// Outcome of homing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homed {
    /// The end; [`Ended::Whole`] if all requested joints are homed.
    pub ended: Ended,
    /// State of the supervisor before the rig was stopped.
    pub state: State,
    /// Fault that caused it.
    pub cause: Option<Cause>,
    /// The joint that did not find its reference, 0 the left one, and the reason.
    pub failed: Option<(usize, NotHome)>,
    /// Time from enabling to the end, s.
    pub time_s: f64,
    /// Both joints, the left one first.
    pub joints: [JointHomed; 2],
}

/// Measurements of a joint while it homes.
struct HomingProgress<'a> {
    /// Greatest distance of each joint from its start, rad.
    farthest: &'a mut [f64; 2],
    /// Cycles since the rig was enabled.
    cycles: &'a mut u32,
    trace: &'a mut HomingTrace,
}

/// Enables a rig that was booted for homing ([`Runner::prepare_homing`]), lets each selected drive find its reference, and stops
/// the rig. The other drive holds its joint meanwhile. Both drives quick-stop if a joint goes farther than it may, if anything
/// holds the rig, or if either drive has a fault. If a drive pushes against its torque limit and does not move, both drives lose
/// their torque. For this the runner asks for the torque (6077h) beside the cycles.
///
/// # Errors
/// Before anything is enabled:
/// - [`RunError::WayBlocked`] if the linkage does not go as far as a joint may;
/// - [`RunError::BehindHome`] if a drive that still knows its reference would look for it the wrong way;
/// - if a drive does not report its torque or its limit.
///
/// Then as [`Runner::enable`].
pub fn home(
    runner: &mut Runner<dyn Place>,
    rig: &config::Rig,
    plan: &HomePlan,
    permit: &Permit,
    is_interrupted: &AtomicBool,
) -> Result<Homed, RunError> {
    home_traced(runner, rig, plan, permit, is_interrupted).map(|(homed, _)| homed)
}

/// Homes as [`home`], and returns the positions that each requested drive reported.
fn home_traced(
    runner: &mut Runner<dyn Place>,
    rig: &config::Rig,
    plan: &HomePlan,
    permit: &Permit,
    is_interrupted: &AtomicBool,
) -> Result<(Homed, [HomingTrace; 2]), RunError> {
    runner.check_permit(permit)?;
    runner.watch_homing(Some(2.0 * plan.fastest_rad_per_s * runner.period().as_secs_f64()));
    let mut traces = plan.longest_s().map(|longest_s| HomingTrace::with_room(runner.cycles_in(longest_s)));
    let homed = home_all(runner, rig, plan, permit, &mut traces, is_interrupted);
    runner.master.set_homing([false; 2]);
    runner.watch_homing(None);
    Ok((homed?, traces))
}

fn home_all(
    runner: &mut Runner<dyn Place>,
    rig: &config::Rig,
    plan: &HomePlan,
    permit: &Permit,
    traces: &mut [HomingTrace; 2],
    is_interrupted: &AtomicBool,
) -> Result<Homed, RunError> {
    // Objects are read while no cycles run yet.
    let mut watch = PushWatch::new(runner, rig, plan.rate_rad_per_s)?;
    idle_before_lead(runner, plan.settling.max(1), is_interrupted)?;
    check_homing_way(runner, plan)?;
    check_home_ahead(runner, plan)?;
    runner.enable(0, permit, is_interrupted)?;
    // Both are watched here, each within a bound of its own.
    runner.unbind_motion();
    runner.begin_scene();
    let start = runner.angles();
    let mut farthest = [0.0_f64; 2];
    let (mut ended, mut failed, mut cycles, mut homed) = (Ended::Whole, None, 0, [false; 2]);
    let traced = traces.iter_mut().enumerate().filter(|(joint, _)| plan.joints.get(*joint) == Some(&true));
    for (joint, trace) in traced {
        let seen = HomingProgress { farthest: &mut farthest, cycles: &mut cycles, trace };
        match home_one(runner, joint, plan, &mut watch, seen, is_interrupted) {
            Ok(()) => homed.iter_mut().skip(joint).take(1).for_each(|homed| *homed = true),
            Err((end, why)) => {
                (ended, failed) = (end, why.map(|why| (joint, why)));
                break;
            }
        }
    }
    runner.master.set_homing([false; 2]);
    let (state, cause) = (runner.state(), runner.cause());
    let referenced = runner.master().homing().map(|homing| homing.is_referenced);
    let (taken, by_reference) = (runner.angles().to_array(), runner.master().referenced_angles().to_array());
    let way = (runner.angles() - start).to_array();
    let ended = runner.end(ended);
    watch.finish(runner);
    let of = |joint: usize| JointHomed {
        farthest_rad: farthest.get(joint).copied().unwrap_or_default(),
        way_rad: way.get(joint).copied().unwrap_or_default(),
        angle_rad: *if referenced[joint] { &by_reference } else { &taken }.get(joint).unwrap_or(&0.0),
        is_referenced: referenced[joint],
        is_homed: homed.get(joint) == Some(&true),
    };
    let time_s = f64::from(cycles) * runner.period().as_secs_f64();
    Ok(Homed { ended, state, cause, failed, time_s, joints: [of(0), of(1)] })
}

/// Checks that the linkage allows the greatest travel of each joint, from the assumed pose of the arm. A joint that is not homed
/// may be as far from that pose as a person may have moved it.
fn check_homing_way(runner: &Runner<dyn Place>, plan: &HomePlan) -> Result<(), RunError> {
    let from = runner.angles();
    let within = |joint: usize| plan.within_rad.get(joint).copied().unwrap_or_default();
    let off = runner.master().homing().map(|homing| homing.is_referenced);
    let off = [0, 1].map(|joint| if off.get(joint) == Some(&true) { 0.0 } else { within(joint) });
    let mut least = 1.0_f64;
    for joint in (0..2).filter(|joint| plan.joints.get(*joint) == Some(&true)) {
        let way = off[joint] + within(joint) + HOMING_BEYOND_RAD;
        let beside = off[1 - joint] + HOMING_BEYOND_RAD;
        for (way, beside) in [way, -way].into_iter().flat_map(|way| [0.0, beside, -beside].map(|beside| (way, beside)))
        {
            let by = if joint == 0 { [way, beside] } else { [beside, way] };
            least = least.min(runner.master().cycle().free_share(from + JointAngles::from(by)));
        }
    }
    if least < 1.0 { Err(RunError::WayBlocked { share: least }) } else { Ok(()) }
}

/// Checks that home lies ahead of each joint whose drive still knows its position and looks for home in one direction only.
fn check_home_ahead(runner: &Runner<dyn Place>, plan: &HomePlan) -> Result<(), RunError> {
    let ahead = (plan.home - runner.master().referenced_angles()).to_array();
    let states = runner.master().homing();
    for (joint, (device, ahead)) in Device::DRIVES.into_iter().zip(ahead).enumerate() {
        let of = |values: [bool; 2]| values.get(joint) == Some(&true);
        let is_known = of(plan.joints) && of(states.map(|state| state.is_referenced));
        let Some(way) = plan.one_way.get(joint).copied().flatten().filter(|_| is_known) else { continue };
        if ahead * way < 0.0 {
            return Err(RunError::BehindHome { which: runner.which(device), by_rad: -ahead });
        }
    }
    Ok(())
}

/// Returns the position that a drive reported in the last cycle, counts.
fn told_position(runner: &Runner<dyn Place>, joint: usize) -> Option<i64> {
    let has_come = runner.master().last_inputs().drives.get(joint).is_some_and(|drive| drive.angle_rad.is_some());
    runner.master().positions().get(joint).copied().filter(|_| has_come)
}

fn home_one(
    runner: &mut Runner<dyn Place>,
    joint: usize,
    plan: &HomePlan,
    watch: &mut PushWatch,
    HomingProgress { farthest, cycles, trace }: HomingProgress<'_>,
    is_interrupted: &AtomicBool,
) -> Result<(), (Ended, Option<NotHome>)> {
    let of = |values: [f64; 2]| values.get(joint).copied().unwrap_or_default();
    let failed = |why| Err((Ended::Whole, Some(why)));
    let (within, rate) = (of(plan.within_rad), of(plan.rate_rad_per_s));
    let longest_s = of(plan.longest_s());
    let (limit, rest) = (runner.cycles_in(longest_s), runner.cycles_in(REST_S).max(1));
    let mut bounds = [HOMING_BEYOND_RAD; 2];
    bounds.iter_mut().skip(joint).take(1).for_each(|bound| *bound += within);
    let from = runner.angles();
    // A report from before the request is no answer to it.
    let is_silent = |homing: HomingState| !homing.is_over && !homing.has_failed;
    let mut has_begun = runner.master().homing().get(joint).is_some_and(|homing| is_silent(*homing));
    let (mut rested, mut is_referenced) = (0, false);
    // A joint that was found on its way needs this far to come to rest.
    let slides = if of(plan.slides) > 0.0 { 0.5 * rate * HOMING_COMES_UP_S } else { 0.0 };
    let period_s = runner.period().as_secs_f64();
    runner.master.set_homing([joint == 0, joint == 1]);
    for cycle in 0..limit {
        if is_interrupted.load(Ordering::Relaxed) {
            return Err((Ended::Interrupted, None));
        }
        let missed = runner.run_cycle(Ask::Nothing).map_or(0, |record| record.inputs.timing.skipped);
        *cycles += 1;
        if runner.has_panicked() {
            return Err((Ended::Panicked, None));
        }
        let gone = (runner.angles() - from).to_array();
        for (farthest, gone) in farthest.iter_mut().zip(gone) {
            *farthest = farthest.max(gone.abs());
        }
        if runner.state() != State::Running {
            return Err((Ended::Stopped, None));
        }
        if let Some((beyond, (gone, _))) =
            gone.into_iter().zip(bounds).enumerate().find(|(_, (gone, bound))| gone.abs() > *bound)
        {
            return failed(NotHome::TooFar(beyond, gone));
        }
        let states = runner.master().homing();
        let is_over = has_begun && states.get(joint).is_some_and(|state| state.is_over);
        let rests = [0, 1].map(|one| one != joint || is_over);
        if let Some(why) = watch.step(runner, f64::from(*cycles) * period_s, rests) {
            if let NotHome::Blocked(blocked, _) = why {
                runner.master.cycle_mut().report_blocked(blocked);
                runner.run_cycle(Ask::Nothing);
            }
            return Err((if runner.state() == State::Running { Ended::Whole } else { Ended::Stopped }, Some(why)));
        }
        if let Some((jumped, _)) = states.iter().enumerate().find(|(one, state)| *one != joint && state.has_jumped) {
            return failed(NotHome::Jumped(jumped));
        }
        let Some(now) = states.get(joint).copied() else { continue };
        has_begun |= is_silent(now);
        let is_found = has_begun && now.is_found;
        trace.take(told_position(runner, joint), missed, is_found, now.has_jumped);
        if !has_begun {
            if cycle >= runner.cycles_in(BEGINS_S) {
                return failed(NotHome::NotBegun);
            }
            continue;
        }
        if now.has_failed {
            return failed(NotHome::GaveUp);
        }
        let off = of((runner.master().referenced_angles() - plan.home).to_array());
        if now.has_jumped && off.abs() > slides + OFF_RAD {
            return failed(NotHome::Elsewhere(off));
        }
        is_referenced = now.is_referenced;
        rested = if now.is_over { rested + 1 } else { 0 };
        if rested >= rest && is_referenced {
            return if off.abs() > slides + OFF_RAD { failed(NotHome::Elsewhere(off)) } else { Ok(()) };
        }
    }
    if rested >= rest && !is_referenced { failed(NotHome::NotReferenced) } else { failed(NotHome::TooLong(longest_s)) }
}
