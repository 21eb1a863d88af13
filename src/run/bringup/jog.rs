//! Moving the joints of a rig by an angle, or while keys are pressed, with no hand on it.

use std::sync::atomic::{AtomicBool, Ordering};

use super::keys::{Keys, Led};
use super::lead_watch::{LeadWatch, ToldTorque};
use crate::error::RunError;
use crate::permit::{Ask, Permit};
use crate::place::Place;
use crate::runner::Runner;
use crate::scene::Ended;
use yieldwall_config::{self as config, CommandMode};
use yieldwall_motion::cycle::LeadLimits;
use yieldwall_motion::guard::{Cause, State};
use yieldwall_motion::quantity::JointAngles;
use yieldwall_record::CycleRecord;

/// Time at the targets, s. If an encoder freezes just short of its target, the controller pushes the joint more and more meanwhile.
const REST_S: f64 = 0.05;
/// Time that a travel may take beyond its rate and its acceleration, s.
const PATIENCE_S: f64 = 1.0;
/// Distance in periods by which the target is ahead of the way to rest while a key holds.
const AHEAD_PERIODS: f64 = 2.0;

/// Request to the joints.
#[derive(Clone, Copy, Debug)]
pub struct Jog<'a> {
    /// Travel of each joint from where it is, rad; with keys the greatest, to either side. A joint with a travel of zero holds.
    pub by: JointAngles,
    /// Keys of a person who guides the joints; a joint rests [`Keys::HOLDS_S`] after the last key.
    pub keys: Option<&'a Keys>,
    /// Rate and acceleration.
    pub limits: LeadLimits,
    /// Cycles of process data before the rig is enabled, as of [`Play::settling`](crate::Play::settling).
    pub settling: u32,
    /// The loop asks the drives of guided joints for their torque (6077h) in torque mode too.
    pub is_metered: bool,
}

/// Outcome of a jog.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jogged {
    /// The end; [`Ended::Whole`] if the joints came to their targets.
    pub ended: Ended,
    /// State of the supervisor before the rig was stopped.
    pub state: State,
    /// Fault that caused it.
    pub cause: Option<Cause>,
    /// Time from enabling to the end, s.
    pub time_s: f64,
    /// Angles measured before, rad.
    pub from: JointAngles,
    /// Angles measured at the end, rad.
    pub to: JointAngles,
    /// Greatest distance of each measured angle from the commanded one, rad.
    pub deviation: JointAngles,
}

/// Way of the joints.
enum Way<'a> {
    /// To these targets, then the end.
    To(JointAngles),
    /// By keys, at most [`Jog::by`] to either side.
    Keys { led: Led<'a>, from: JointAngles, is_over: bool },
}

impl Way<'_> {
    /// Targets of the next cycle, from the present targets.
    fn targets(&mut self, now: JointAngles, jog: &Jog<'_>, period_s: f64) -> Option<JointAngles> {
        let (led, from, is_over) = match self {
            Way::To(_) => return None,
            Way::Keys { led, from, is_over } => (led, from, is_over),
        };
        let Some(way) = led.way() else {
            *is_over = true;
            return None;
        };
        let LeadLimits { rate_rad_per_s: rate, acceleration_rad_per_s2: most } = jog.limits;
        // Without a key the joint comes to rest where it was led last.
        (way != 0.0).then(|| {
            let ahead = rate * rate / (2.0 * most) + AHEAD_PERIODS * period_s * rate;
            let mut targets = now.to_array();
            for ((target, from), by) in targets.iter_mut().zip(from.to_array()).zip(jog.by.to_array()) {
                if by != 0.0 {
                    *target = (*target + way * ahead).clamp(from - by.abs(), from + by.abs());
                }
            }
            targets.into()
        })
    }

    /// Joints that rest have come to their end.
    fn is_over(&self) -> bool {
        match self {
            Way::To(_) => true,
            Way::Keys { is_over, .. } => *is_over,
        }
    }
}

/// Enables a booted rig, guides its joints to other angles, both at once or by keys, watches them there and stops the rig. A fault
/// at either drive stops both, and so does anything that holds the rig: it does not resume by itself. If a joint is pushed and does
/// not move, both drives lose their torque, as after a following error. `each` gets the record of every cycle in which the joints
/// are guided, and the torque that a drive reported. In torque mode the drives are asked for it only if `is_metered`.
///
/// # Errors
/// [`RunError::WayBlocked`], before anything is enabled, if the linkage does not go that far, with keys in both directions; as
/// [`Runner::enable`].
pub fn jog(
    runner: &mut Runner<dyn Place>,
    rig: &config::Rig,
    jog: &Jog<'_>,
    permit: &Permit,
    is_interrupted: &AtomicBool,
    each: impl FnMut(&CycleRecord, Option<ToldTorque>),
) -> Result<Jogged, RunError> {
    runner.check_permit(permit)?;
    let is_asked = jog.is_metered || rig.rig.command_mode != CommandMode::Torque;
    let are_asked = jog.by.to_array().map(|by| is_asked && by != 0.0);
    let mut watch = LeadWatch::new(runner, rig, permit, jog.limits, are_asked)?;
    runner.lead(Some(jog.limits));
    let jogged = led(runner, jog, permit, &mut watch, is_interrupted, each);
    watch.finish(runner);
    runner.lead(None);
    jogged
}

fn led(
    runner: &mut Runner<dyn Place>,
    jog: &Jog<'_>,
    permit: &Permit,
    watch: &mut LeadWatch,
    is_interrupted: &AtomicBool,
    mut each: impl FnMut(&CycleRecord, Option<ToldTorque>),
) -> Result<Jogged, RunError> {
    idle_before_lead(runner, jog.settling.max(1), is_interrupted)?;
    let measured =
        |rig: &Runner<dyn Place>| rig.last_outputs().map_or(JointAngles::default(), |it| it.signals.measured_angles);
    let from = measured(runner);
    let ways = [Some(jog.by), jog.keys.map(|_| -jog.by)];
    let share = ways.into_iter().flatten().map(|by| runner.master().cycle().free_share(from + by));
    let share = share.fold(1.0, f64::min);
    if share < 1.0 {
        return Err(RunError::WayBlocked { share });
    }
    if jog.keys.is_some_and(Keys::has_ended) {
        return Err(RunError::Interrupted);
    }
    let holds = runner.cycles_in(Keys::HOLDS_S);
    runner.enable(0, permit, is_interrupted)?;
    runner.begin_scene();
    let mut way = match jog.keys {
        Some(keys) => Way::Keys { led: Led::new(keys, holds), from: runner.led_angles(), is_over: false },
        None => Way::To(runner.led_angles() + jog.by),
    };
    if let Way::To(targets) = way {
        runner.master.cycle_mut().lead_to(targets);
    }
    let LeadLimits { rate_rad_per_s, acceleration_rad_per_s2 } = jog.limits;
    let [left, right] = jog.by.to_array();
    let longest_s = left.abs().max(right.abs()) / rate_rad_per_s + rate_rad_per_s / acceleration_rad_per_s2;
    let limit = match way {
        Way::To(_) => runner.cycles_in(longest_s + PATIENCE_S + REST_S),
        Way::Keys { .. } => u32::MAX,
    };
    let period_s = runner.period().as_secs_f64();
    let rest = runner.cycles_in(REST_S);
    let (mut ended, mut cycles, mut rested) = (Ended::Stopped, 0, 0);
    let mut deviation = [0.0_f64; 2];
    while cycles < limit {
        if is_interrupted.load(Ordering::Relaxed) {
            ended = Ended::Interrupted;
            break;
        }
        if let Some(targets) = way.targets(runner.led_angles(), jog, period_s) {
            runner.master.cycle_mut().lead_to(targets);
        }
        let record = runner.run_cycle(Ask::Nothing);
        cycles += 1;
        if runner.has_panicked() {
            ended = Ended::Panicked;
            break;
        }
        if let Some(record) = &record {
            let told = watch.step(runner, record, cycles);
            each(record, told);
        }
        if runner.state() != State::Running {
            break;
        }
        if let Some(joint) = watch.blocked() {
            runner.master.cycle_mut().report_blocked(joint);
            continue;
        }
        let now = (measured(runner) - runner.led_angles()).to_array();
        deviation.iter_mut().zip(now).for_each(|(most, now)| *most = most.max(now.abs()));
        rested = if runner.master().cycle().is_there() { rested + 1 } else { 0 };
        if rested >= rest && way.is_over() {
            ended = Ended::Whole;
            break;
        }
    }
    let (state, cause, to) = (runner.state(), runner.cause(), measured(runner));
    let ended = runner.end(ended);
    let time_s = f64::from(cycles) * runner.period().as_secs_f64();
    Ok(Jogged { ended, state, cause, time_s, from, to, deviation: deviation.into() })
}

/// Runs cycles of process data before joints are guided, so that their positions are known.
pub(super) fn idle_before_lead(
    runner: &mut Runner<dyn Place>,
    cycles: u32,
    is_interrupted: &AtomicBool,
) -> Result<(), RunError> {
    for _ in 0..cycles {
        if is_interrupted.load(Ordering::Relaxed) {
            return Err(RunError::Interrupted);
        }
        runner.run_cycle(Ask::Nothing);
    }
    Ok(())
}
