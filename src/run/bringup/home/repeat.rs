//! Homing again and again: by how much the references of the drives shift from one homing to the next.

use std::sync::atomic::AtomicBool;

use super::{HomePlan, Homed, home_traced};
use crate::assembly::{HOMING_COMES_UP_S, scaling};
use crate::bringup::jog::{Jog, Jogged, jog};
use crate::bringup::tune_loop::Prove;
use crate::permit::Bounds;
use crate::place::Place;
use crate::proof::NotProven;
use crate::runner::Runner;
use crate::scene::Ended;
use yieldwall_config as config;
use yieldwall_motion::cycle::LeadLimits;
use yieldwall_motion::quantity::JointAngles;

/// Reason why the shift of a joint's reference is unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NoShift {
    /// The position did not jump when the drive took its reference for the first time, so the moment of taking is unknown.
    NoJump,
    /// The joint began so near to home, rad, that it does not come up to its rate.
    TooNear(f64),
    /// Positions are missing at the moment at which it took its reference.
    NoPositions,
}

/// Homing that was repeated.
#[derive(Clone, Debug, PartialEq)]
pub struct Repeated {
    /// Each homing, the first one first; the last one may have ended otherwise than well.
    pub homed: Vec<Homed>,
    /// Outcome of the way back, if it did not end well.
    pub stopped: Option<Jogged>,
    /// Joint with unknown shifts, 0 the left one, and the reason: the homing that showed it is the last.
    pub unknown: Option<(usize, NoShift)>,
    /// Shift of each joint's reference from one homing to the next, rad: the new home, in positions before the reference was taken,
    /// minus the previous home.
    pub shifts_rad: [Vec<f64>; 2],
}

/// Homes the joints of a plan `times` times as [`home`](fn@super::home). Between two homings it guides them back as
/// [`jog`](fn@jog), each as far as it had gone the first time, at its homing rate. The network is booted for each homing, and
/// `prove` gives the permit. `told` receives each homing when it is over. The first homing that does not end well is the last.
///
/// # Errors
/// As [`home`](fn@super::home) and [`jog`](fn@jog); if the rig cannot be booted, or may not be enabled.
#[expect(clippy::too_many_arguments, reason = "what is done, within what, and who is there")]
pub fn home_repeatedly(
    runner: &mut Runner<dyn Place>,
    rig: &config::Rig,
    plan: &HomePlan,
    times: u32,
    bounds: Bounds,
    prove: Prove<'_>,
    is_interrupted: &AtomicBool,
    mut told: impl FnMut(&Homed),
) -> Result<Repeated, NotProven> {
    let mut repeated = Repeated { homed: Vec::new(), stopped: None, unknown: None, shifts_rad: Default::default() };
    // Cycles from the jump of the reference to the report of it, for each drive, and the way of its joint.
    let mut leads = [None; 2];
    let mut way_rad = [0.0; 2];
    for time in 0..times {
        runner.prepare_homing(rig)?;
        runner.boot()?;
        let permit = prove(runner, rig, bounds)?;
        let (homed, traces) = home_traced(runner, rig, plan, &permit, is_interrupted)?;
        repeated.homed.push(homed);
        told(&homed);
        if homed.ended != Ended::Whole || homed.failed.is_some() {
            break;
        }
        let asked = (0..2).filter(|joint| plan.joints.get(*joint) == Some(&true));
        for (joint, trace) in asked.filter_map(|joint| Some((joint, traces.get(joint)?))) {
            let shift = match leads[joint] {
                None => {
                    way_rad[joint] = homed.joints[joint].way_rad;
                    leads[joint] = trace.lead();
                    check_first(plan, joint, way_rad[joint], leads[joint].is_some()).map(|()| None)
                }
                Some(lead) => trace.shift_counts(lead).map(Some).ok_or(NoShift::NoPositions),
            };
            match shift {
                Ok(shift) => repeated.shifts_rad[joint].extend(shift.map(|counts| shift_rad(rig, joint, counts))),
                Err(why) => repeated.unknown = repeated.unknown.or(Some((joint, why))),
            }
        }
        if repeated.unknown.is_some() || time + 1 >= times {
            break;
        }
        let jogged = lead_back(runner, rig, plan, way_rad.into(), bounds, &mut *prove, is_interrupted)?;
        if jogged.ended != Ended::Whole {
            repeated.stopped = Some(jogged);
            break;
        }
    }
    Ok(repeated)
}

/// Checks that the first homing of a joint shows the reference for the others.
fn check_first(plan: &HomePlan, joint: usize, way_rad: f64, has_jumped: bool) -> Result<(), NoShift> {
    // It comes up to its rate, and is seen at it.
    let least_rad = plan.rate_rad_per_s.get(joint).copied().unwrap_or_default() * HOMING_COMES_UP_S;
    if way_rad.abs() < least_rad {
        return Err(NoShift::TooNear(way_rad.abs()));
    }
    if has_jumped { Ok(()) } else { Err(NoShift::NoJump) }
}

/// Leads the joints back by what they went from where they began.
fn lead_back(
    runner: &mut Runner<dyn Place>,
    rig: &config::Rig,
    plan: &HomePlan,
    way_rad: JointAngles,
    bounds: Bounds,
    prove: Prove<'_>,
    is_interrupted: &AtomicBool,
) -> Result<Jogged, NotProven> {
    runner.leave();
    runner.prepare_leading(rig)?;
    runner.boot()?;
    let permit = prove(runner, rig, bounds)?;
    let [left, right] = plan.rate_rad_per_s;
    let rate_rad_per_s = left.min(right);
    let limits = LeadLimits { rate_rad_per_s, acceleration_rad_per_s2: rate_rad_per_s / HOMING_COMES_UP_S };
    let asked = Jog { by: -way_rad, keys: None, limits, settling: plan.settling, is_metered: false };
    let jogged = jog(runner, rig, &asked, &permit, is_interrupted, |_, _| ())?;
    runner.leave();
    Ok(jogged)
}

/// Counts of a drive as an angle of its joint, rad.
fn shift_rad(rig: &config::Rig, joint: usize, counts: f64) -> f64 {
    let scaling = rig.drives.get(joint).and_then(|drive| scaling(drive).ok());
    scaling.map_or(f64::NAN, |scaling| counts * (scaling.angle_rad(1) - scaling.angle_rad(0)))
}
