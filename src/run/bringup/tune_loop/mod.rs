//! One joint guided to and fro, to identify its loop.
//!
//! ```text
//! boot, permit with bounds -> Course -> lead_to() in each cycle -> reference, angle, torque, force -> Parts -> identification -> JointLoop
//! ```
//! The course is one enabling: slow travels at five rates, travels with an excitation on top, travels with a step. The other joint
//! is held. In torque mode the torque is the one that this program commands. In the other modes the drive closes the loop, and the
//! runner asks it for its torque (6077h) beside the cycles: that shows friction. It does not show inertia. A drive that draws
//! straight lines between set-points makes a torque that rises and falls within each cycle, and reports one moment of it. If a
//! joint does not follow, it is tried again with more torque, after another boot.

mod course;
mod felt;
mod parts;
mod record;

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::Complex;

pub use self::course::STEP_RISE_S;
pub use self::record::{ForceFound, JointFound, LoopUnreadable, MeasuredLoop};

use self::course::{Course, RATES, WAY_RAD};
use self::felt::felt;
use self::parts::{Sample, Trace};
use super::jog::idle_before_lead;
use super::push::{Push, Stand};
use super::torque_meter::{Metered, TorqueMeter};
use crate::assembly::scaling;
use crate::conduct::settling_on_bus;
use crate::error::RunError;
use crate::permit::{Ask, Bounds, Permit};
use crate::place::Place;
use crate::proof::NotProven;
use crate::runner::Runner;
use crate::scene::Ended;
use yieldwall_config::{self as config, CommandMode, Positive};
use yieldwall_motion::cycle::LeadLimits;
use yieldwall_motion::guard::{Cause, DeviceSet, Fault, JointCommand, State};
use yieldwall_motion::identification::{Dynamics, Friction, Handle, NotIdentified};
use yieldwall_motion::quantity::JointAngles;
use yieldwall_record::CycleRecord;

/// Shares of the rated torque that are tried one after the other, unless a torque is asked for: with little torque nothing runs away far.
const TORQUE_SHARES: [f64; 3] = [0.25, 0.35, 0.5];
/// Greatest motion of a joint beyond its way before the rig stops, rad.
const BEYOND_RAD: f64 = 0.02;
/// A joint that has gone so far the other way runs away, rad.
const AWAY_RAD: f64 = 2e-3;
/// Greatest acceleration of the reference, rad/s^2: any will do, since the course is smooth and its rate has a bound.
const ACCELERATION: f64 = 1e6;
/// Greatest rate of the reference, rad/s: that of the fastest travel, and room for a step.
const MOST_RATE: f64 = 1.25 * RATES[0];
/// From this share of its limit a torque counts as cut.
const CUT_SHARE: f64 = 0.98;
/// Cycles of process data in which the angles are read before the direction is chosen.
const LOOK_CYCLES: u32 = 20;

/// Request for one joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopPlan {
    /// Index of the joint, 0 the left one.
    pub joint: usize,
    /// Largest torque of each drive, N m; by default as little as needed.
    pub torque_n_m: Option<Positive>,
}

/// Greatest motion of any joint from where it was enabled, rad.
pub const LOOP_BOUND_RAD: f64 = WAY_RAD + BEYOND_RAD;

/// Response of a joint to its reference at one frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Follows {
    /// The frequency, Hz.
    pub frequency_hz: f64,
    /// Measured angle over reference, of the same cycle.
    pub ratio: Complex<f64>,
}

/// The answer to a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepAnswer {
    /// Time since the step in s; reference and measured angle as shares of the step, without the travel beneath it.
    pub samples: Vec<[f64; 3]>,
    /// By how much the angle goes beyond the step, as a share of it.
    pub overshoot: f64,
    /// Time from a tenth of the step to nine tenths, s.
    pub rise_s: Option<f64>,
}

/// Identified properties of a joint and its loop.
#[derive(Clone, Debug, PartialEq)]
pub struct JointLoop {
    /// Index of the joint, 0 the left one.
    pub joint: usize,
    /// Angles of both joints in the middle of the way, where the inertia was identified.
    pub pose: JointAngles,
    /// Dry and viscous friction.
    pub friction: Result<Friction, NotIdentified>,
    /// Inertia at that pose and the delay, in torque mode.
    pub dynamics: Result<Dynamics, NotIdentified>,
    /// Mass beyond the force sensor, and the age of the force, in every mode.
    pub handle: Result<Handle, NotIdentified>,
    /// The drive closes the loop, and reports the torques.
    pub is_told: bool,
    /// Responses of the joint to its reference.
    pub follows: Vec<Follows>,
    /// Time by which the angle is behind the reference at the lowest frequencies, s.
    pub lag_s: Option<f64>,
    /// The mean answer to a step.
    pub step: Option<StepAnswer>,
    /// Torque limit that it took, N m.
    pub torque_n_m: f64,
    /// Parts of the course of which cycles are missing; they were left out.
    pub left_out: usize,
}

/// Outcome of an identification.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopTraced {
    /// The end; [`Ended::Whole`] if the joint went its whole course.
    pub ended: Ended,
    /// State of the supervisor before the rig was stopped.
    pub state: State,
    /// Fault that caused it.
    pub cause: Option<Cause>,
    /// Time from enabling to the end, s.
    pub time_s: f64,
    /// The torque limit, N m.
    pub torque_n_m: f64,
    /// The joint ran against its reference.
    pub ran_away: bool,
    /// The torque was at its limit within the evaluated parts.
    pub is_cut: bool,
    /// Identified properties, if the joint went its whole course without either.
    pub found: Option<JointLoop>,
}

/// Gives the permit to move a booted rig within bounds.
pub type Prove<'a> = &'a mut dyn FnMut(&mut Runner<dyn Place>, &config::Rig, Bounds) -> Result<Permit, NotProven>;

/// Boots, guides a joint along its course, stops the rig, and identifies the joint. If the joint does not follow, it tries again
/// with more torque. A fault at either drive takes the torque off both in the same cycle. The torque limits stay lowered until the
/// next boot.
///
/// # Errors
/// If the rig cannot be booted, or cannot or may not be enabled. If a person asks for the end before the joint moves.
/// [`RunError::WayBlocked`] if the joint is not free in both directions.
pub fn tune_loop(
    runner: &mut Runner<dyn Place>,
    rig: &config::Rig,
    plan: &LoopPlan,
    prove: Prove<'_>,
    is_interrupted: &AtomicBool,
) -> Result<LoopTraced, NotProven> {
    let rated = rig.drives.iter().map(|drive| drive.rated_torque_n_m.get()).fold(f64::INFINITY, f64::min);
    let most = rig.guard.torque_limit_n_m.get();
    let torques: Vec<f64> = match plan.torque_n_m {
        Some(torque) => vec![torque.get().min(most)],
        None => TORQUE_SHARES.map(|share| (share * rated).min(most)).into(),
    };
    let mut last = None;
    for torque_n_m in torques {
        if last.as_ref().is_some_and(|last: &LoopTraced| last.torque_n_m == torque_n_m) {
            break;
        }
        let traced = traced(runner, rig, plan.joint, torque_n_m, &mut *prove, is_interrupted)?;
        // One that was held and did not stay has another reason.
        let only = DeviceSet::drive(plan.joint);
        let follows_not = traced
            .cause
            .is_some_and(|cause| cause.fault == Fault::FollowingError && cause.devices & DeviceSet::DRIVES == only);
        let is_too_weak = !traced.ran_away && (traced.is_cut || (traced.ended == Ended::Stopped && follows_not));
        last = Some(traced);
        if !is_too_weak {
            break;
        }
    }
    last.ok_or(NotProven::Run(RunError::Interrupted))
}

/// Runs one boot and one course.
fn traced(
    runner: &mut Runner<dyn Place>,
    rig: &config::Rig,
    joint: usize,
    torque_n_m: f64,
    prove: Prove<'_>,
    is_interrupted: &AtomicBool,
) -> Result<LoopTraced, NotProven> {
    runner.boot()?;
    let bound = |value: f64| Positive::new(value).ok_or(RunError::WayBlocked { share: 0.0 });
    let bounds = Bounds { motion_rad: bound(LOOP_BOUND_RAD)?, torque_n_m: bound(torque_n_m)? };
    let permit = prove(runner, rig, bounds)?;
    runner.check_permit(&permit)?;
    runner.lead(Some(LeadLimits { rate_rad_per_s: MOST_RATE, acceleration_rad_per_s2: ACCELERATION }));
    let traced = led_along(runner, rig, joint, torque_n_m, &permit, is_interrupted);
    runner.lead(None);
    Ok(traced?)
}

fn led_along(
    runner: &mut Runner<dyn Place>,
    rig: &config::Rig,
    joint: usize,
    torque_n_m: f64,
    permit: &Permit,
    is_interrupted: &AtomicBool,
) -> Result<LoopTraced, RunError> {
    idle_before_lead(runner, LOOK_CYCLES, is_interrupted)?;
    let sign = free_direction(runner, joint)?;
    let period_s = runner.period().as_secs_f64();
    let course = Course::new(period_s, sign);
    let cycles = course.offsets_rad.len();
    let is_told = rig.rig.command_mode != CommandMode::Torque;
    let mut meter = if is_told { Some(TorqueMeter::new(rig, joint, cycles as u32)?) } else { None };
    let drive = rig.drives.get(joint).ok_or(RunError::WayBlocked { share: 0.0 })?;
    let scaling = scaling(drive)?;
    // The drive gets whole parts of a thousand.
    let sent = |torque: f64| scaling.torque_per_mille(torque).map_or(torque, |raw| scaling.torque_n_m(raw.value));
    let mut samples: Vec<Sample> = Vec::with_capacity(cycles);
    let (mut skipped, mut ran_away) = (Vec::with_capacity(cycles), false);
    let mut push = Push::new(torque_n_m);
    runner.enable(settling_on_bus(rig), permit, is_interrupted)?;
    runner.begin_scene();
    let start = runner.led_angles();
    let start_rad = start.to_array().get(joint).copied().unwrap_or_default();
    let mut ended = Ended::Whole;
    for offset in &course.offsets_rad {
        if is_interrupted.load(Ordering::Relaxed) {
            ended = Ended::Interrupted;
            break;
        }
        let mut by = [0.0; 2];
        by.iter_mut().skip(joint).take(1).for_each(|by| *by = *offset);
        runner.master.cycle_mut().lead_to(start + JointAngles::from(by));
        let record = runner.run_cycle(Ask::Nothing);
        if runner.has_panicked() {
            ended = Ended::Panicked;
            break;
        }
        let is_late = |it: &CycleRecord| it.inputs.timing.skipped > 0 || it.inputs.timing.suspended;
        if record.as_ref().is_none_or(is_late) {
            skipped.push(samples.len());
        }
        let Some(record) = record else {
            // Its place in the course is kept.
            samples.push(samples.last().copied().map_or_else(Sample::default, |last| Sample { force: None, ..last }));
            continue;
        };
        let of = |angles: JointAngles| angles.to_array().get(joint).copied().unwrap_or_default();
        let torque = match record.command {
            JointCommand::Torque(torques) => sent(torques.to_array().get(joint).copied().unwrap_or_default()),
            _ => 0.0,
        };
        samples.push(Sample {
            reference_rad: of(record.signals.target_angles),
            angle_rad: of(record.signals.measured_angles),
            torque_n_m: torque,
            is_cut: record.signals.is_saturated,
            angles: record.signals.measured_angles,
            force: record.inputs.sample,
        });
        let at = samples.len() - 1;
        let made = meter.as_mut().map_or(Metered::Torque(torque), |meter| meter.step(runner, Some(at as f64)));
        let [angle_rad, led_rad] = [record.signals.measured_angles, record.signals.target_angles].map(of);
        let now = Stand { time_s: at as f64 * period_s, angle_rad, led_rad };
        if let Metered::Torque(made_n_m) = made
            && push.is_blocked_while_led(now, made_n_m)
        {
            runner.master.cycle_mut().report_blocked(joint);
        }
        if runner.state() != State::Running {
            ended = Ended::Stopped;
            // The reference is where the joint is, now that it is stopped.
            let gone = samples.last().map_or(0.0, |last| last.angle_rad - start_rad);
            ran_away = *offset * gone < 0.0 && gone.abs() > AWAY_RAD;
            break;
        }
    }
    let time_s = samples.len() as f64 * period_s;
    let (state, cause) = (runner.state(), runner.cause());
    let ended = runner.end(ended);
    let told = meter.map_or_else(Vec::new, |mut meter| {
        meter.finish(runner);
        meter.into_samples()
    });
    let felt = felt(&samples, runner.master().cycle());
    let trace = Trace { course: &course, samples: &samples, felt: &felt, skipped: &skipped, told: &told, period_s };
    let is_cut = trace.is_cut(CUT_SHARE * torque_n_m);
    let found = (ended == Ended::Whole && !is_cut).then(|| {
        let mut middle = [0.0; 2];
        middle.iter_mut().skip(joint).take(1).for_each(|by| *by = 0.5 * sign * WAY_RAD);
        trace.identified(joint, start + JointAngles::from(middle), is_told, torque_n_m)
    });
    Ok(LoopTraced { ended, state, cause, time_s, torque_n_m, ran_away, is_cut, found })
}

/// Returns the direction in which a joint is free for the whole course: 1 counter-clockwise, else -1.
fn free_direction(runner: &Runner<dyn Place>, joint: usize) -> Result<f64, RunError> {
    let share = |sign: f64| {
        let mut by = [0.0; 2];
        by.iter_mut().skip(joint).take(1).for_each(|by| *by = sign * WAY_RAD);
        let from = runner.last_outputs().map_or(JointAngles::default(), |it| it.signals.measured_angles);
        runner.master().cycle().free_share(from + JointAngles::from(by))
    };
    let shares = [1.0, -1.0].map(share);
    match shares {
        [free, _] if free >= 1.0 => Ok(1.0),
        [_, free] if free >= 1.0 => Ok(-1.0),
        [one, other] => Err(RunError::WayBlocked { share: one.max(other) }),
    }
}
