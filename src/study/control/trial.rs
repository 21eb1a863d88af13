//! One rig that meets the circle, traces it and turns round.

use std::hint::black_box;

use nalgebra::Vector2;

use super::super::sweep::Clock;
use super::RADIUS_M;
use super::machine::Machine;
use crate::control::{
    Axis, AxisController, ControlError, EffortRange, FeedForward, FeedForwardParameters, Gains, InertiaTerm, Law,
};
use crate::fixture::{
    Admittance, AutomaticHold, Coupling, Curvature, Fixture, FixtureError, Forbidden, Limits, ON_SURFACE_TOLERANCE_M,
    Parameters, Rearm, Shape2, Side, Sphere,
};
use crate::linkage::LinkageError;
use crate::quantity::{Force, JointAngles, JointRates, JointTorques, TipPoint};
use crate::sim::arm::{Arm, ArmError};
use crate::sim::hand::{Hand, HandError, HandParameters, Leg, Path, Speed};

/// Longest step of the plant in s.
const PLANT_STEP_S: f64 = 1e-4;
/// Most cycles that a torque may be late.
pub(super) const MOST_DELAY: usize = 3;
/// Where the tool starts, on the x axis, and where the hand aims: 14 N beyond the circle.
const START_M: f64 = 0.075;
const AIM_M: f64 = 0.155;
/// The way to the circle, s: the tool meets it at some 0.2 m/s.
const APPROACH_S: f64 = 0.6;
const REST_S: f64 = 0.4;
/// Half of the tracing: along an arc and back.
const TRACE_S: f64 = 1.5;
const TRACE_RAD: f64 = 0.8;
/// After the impact's rest and after the turn, how long the error does not count as steady, s.
const SETTLING_S: f64 = 0.2;

/// Rounds of timing, and the cycles of one.
const ROUNDS: usize = 9;
const ROUND_CYCLES: u32 = 4000;

/// What is varied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Setting {
    pub period_s: f64,
    pub delay_cycles: usize,
    pub law: Law,
    pub is_cartesian: bool,
    pub feeds_forward: bool,
    pub is_elastic: bool,
}

/// What came out. Lengths in m.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Outcome {
    /// How far proxy and tool get beyond the circle at the impact, without a hold.
    pub proxy_depth_m: f64,
    pub tool_depth_m: f64,
    /// How far the tool gets with the automatic hold.
    pub held_tool_depth_m: f64,
    /// Distance of the tool from the circle while it traces steadily, and over the whole tracing with its turn.
    pub steady_rms_m: f64,
    pub whole_max_m: f64,
    /// Whether the proxy left the circle while it traced.
    pub is_released: bool,
    /// The greater joint's, while it traces.
    pub peak_torque_n_m: f64,
}

/// Why a trial could not be run to its end.
#[derive(Debug, thiserror::Error)]
pub(super) enum TrialError {
    #[error(transparent)]
    Arm(#[from] ArmError),
    #[error(transparent)]
    Linkage(#[from] LinkageError),
    #[error(transparent)]
    Control(#[from] ControlError),
    #[error(transparent)]
    Fixture(#[from] FixtureError),
    #[error(transparent)]
    Hand(#[from] HandError),
}

/// Two runs: one without a hold for the impact, and one with the automatic hold that traces, since a proxy that has
/// broken through at the impact would trace off the circle.
pub(super) fn run(machine: &Machine, setting: Setting, gains: Gains) -> Result<Outcome, TrialError> {
    let mut outcome = Outcome::default();
    let impact = fixture(setting.period_s)?;
    simulate(machine, setting, gains, impact, APPROACH_S + REST_S, |_, cycle| {
        outcome.proxy_depth_m = outcome.proxy_depth_m.max(cycle.proxy_beyond_m);
        outcome.tool_depth_m = outcome.tool_depth_m.max(cycle.tool_beyond_m);
    })?;
    let held = fixture(setting.period_s)?.with_automatic_hold(AutomaticHold::default())?;
    let (mut square, mut counted) = (0.0, 0u32);
    simulate(machine, setting, gains, held, APPROACH_S + REST_S + 2.0 * TRACE_S, |time_s, cycle| {
        let traced_s = time_s - (APPROACH_S + REST_S);
        if traced_s < 0.0 {
            outcome.held_tool_depth_m = outcome.held_tool_depth_m.max(cycle.tool_beyond_m);
            return;
        }
        outcome.peak_torque_n_m = outcome.peak_torque_n_m.max(cycle.torque_n_m);
        let error_m = cycle.tool_beyond_m.abs();
        outcome.whole_max_m = outcome.whole_max_m.max(error_m);
        outcome.is_released |= cycle.proxy_beyond_m.abs() > ON_SURFACE_TOLERANCE_M;
        if traced_s % TRACE_S > SETTLING_S {
            square += error_m * error_m;
            counted += 1;
        }
    })?;
    outcome.steady_rms_m = (square / f64::from(counted.max(1))).sqrt();
    Ok(outcome)
}

/// What one cycle shows: signed distances from the circle, outward, and the greater torque.
struct Cycle {
    proxy_beyond_m: f64,
    tool_beyond_m: f64,
    torque_n_m: f64,
}

fn simulate(
    machine: &Machine,
    setting: Setting,
    gains: Gains,
    mut fixture: Fixture<Shape2, 2>,
    for_s: f64,
    mut watch: impl FnMut(f64, Cycle),
) -> Result<(), TrialError> {
    let start = Vector2::new(START_M, 0.0);
    fixture.reset(&start)?;
    let mut hand = hand(machine, start)?;
    let mut target = machine.linkage.inverse(TipPoint(start))?;
    let mut arm = Arm::new(&machine.arm(setting.is_elastic), target)?;
    let mut controller = Controller::new(machine, setting, gains, target)?;
    // Before the first torque arrives there is none.
    let mut late = [Vector2::zeros(); MOST_DELAY + 1];
    let cycles = (for_s / setting.period_s).round() as u64;
    for cycle in 0..cycles {
        let time_s = cycle as f64 * setting.period_s;
        let tip = arm.tip()?;
        let load = hand.load(time_s, tip.position.0);
        let acceleration = Vector2::from(tip.acceleration_m_per_s2);
        let force_n = load.force_n - tip.velocity.0 * load.damping_n_s_per_m - acceleration * hand.mass_kg();
        let step = fixture.step_admittance(&force_n);
        target = machine.linkage.inverse_near(TipPoint(step.proxy), target)?;
        let torque = controller.step(machine, arm.motor_angles(), step.proxy, target)?;
        let beyond = |point: Vector2<f64>| point.norm() - RADIUS_M;
        watch(
            time_s,
            Cycle {
                proxy_beyond_m: beyond(step.proxy),
                tool_beyond_m: beyond(tip.position.0),
                torque_n_m: torque.amax(),
            },
        );
        let slot = cycle as usize % late.len();
        late[slot] = torque;
        let applied = late[(slot + late.len() - setting.delay_cycles) % late.len()];
        let end_s = (cycle + 1) as f64 * setting.period_s;
        arm.advance_to(end_s, PLANT_STEP_S, JointTorques(applied), |time_s, tip| hand.load(time_s, tip.0))?;
    }
    Ok(())
}

/// Time in s that a cycle's fixture, inverse kinematics and controllers take, in the median of several rounds.
pub(super) fn computing_s(
    machine: &Machine,
    setting: Setting,
    gains: Gains,
    clock: Clock<'_>,
) -> Result<f64, TrialError> {
    let start = Vector2::new(RADIUS_M, 0.0);
    let mut target = machine.linkage.inverse(TipPoint(start))?;
    let mut fixture = fixture(setting.period_s)?;
    fixture.reset(&start)?;
    let mut controller = Controller::new(machine, setting, gains, target)?;
    let mut rounds = [0.0; ROUNDS];
    for round_s in &mut rounds {
        let begin = clock();
        for cycle in 0..ROUND_CYCLES {
            // To and fro along the circle, so that nothing stays as it was.
            let force_n = Vector2::new(5.0, if cycle < ROUND_CYCLES / 2 { 4.0 } else { -4.0 });
            let proxy = fixture.step_admittance(black_box(&force_n)).proxy;
            let measured = target;
            target = machine.linkage.inverse_near(TipPoint(proxy), target)?;
            black_box(controller.step(machine, measured, proxy, target)?);
        }
        *round_s = (clock() - begin).as_secs_f64() / f64::from(ROUND_CYCLES);
    }
    rounds.sort_by(f64::total_cmp);
    Ok(rounds[ROUNDS / 2])
}

fn fixture(period_s: f64) -> Result<Fixture<Shape2, 2>, FixtureError> {
    let circle = Sphere::new(Vector2::zeros(), RADIUS_M, Forbidden::Inside)?;
    let parameters = Parameters {
        coupling: Coupling::Admittance(Admittance { mass_kg: 2.0 }),
        limits: Limits { friction_n: 3.0, yield_n: 20.0 },
        side: Side::Bilateral,
        hold_steps: 0,
        rearm: Rearm::OffSurface,
        curvature: Curvature::Tangent,
        period_s,
    };
    Fixture::new(Shape2::Circle(circle), parameters)
}

fn hand(machine: &Machine, start: Vector2<f64>) -> Result<Hand<2>, HandError> {
    let turn = |by_rad| Leg::Arc { center_m: [0.0; 2], by_rad, in_s: TRACE_S, speed: Speed::Constant };
    let legs = [
        Leg::To { point_m: Vector2::new(AIM_M, 0.0), in_s: APPROACH_S },
        Leg::Wait { for_s: REST_S },
        turn(TRACE_RAD),
        turn(-TRACE_RAD),
    ];
    let parameters = HandParameters {
        mass_kg: machine.hand_kg,
        stiffness_n_per_m: machine.hand_n_per_m,
        damping_n_s_per_m: machine.hand_n_s_per_m,
        voluntary_force_limit_n: f64::INFINITY,
        tremor: None,
        aim_error: None,
    };
    Hand::new(parameters, Path::new(start, &legs)?, 0)
}

/// The joint or Cartesian loop of a rig.
struct Controller {
    axes: [Axis; 2],
    feed_forward: Option<FeedForward>,
    is_cartesian: bool,
    period_s: f64,
    /// The desired angles and rates of the last cycle.
    target: JointAngles,
    rates: Vector2<f64>,
}

impl Controller {
    fn new(machine: &Machine, setting: Setting, gains: Gains, target: JointAngles) -> Result<Self, ControlError> {
        let axis = setting.law.controller(gains, machine.sliding_time_s, setting.period_s)?;
        let parameters = FeedForwardParameters {
            coulomb_n_m: machine.coulomb_n_m.map(|friction| machine.coulomb_share * friction),
            viscous_n_m_s_per_rad: machine.viscous_n_m_s_per_rad,
            coulomb_transition_rad: FeedForwardParameters::DEFAULT_TRANSITION_RAD,
        };
        let feed_forward = match setting.feeds_forward {
            true => Some(FeedForward::new(parameters, setting.period_s)?),
            false => None,
        };
        Ok(Self {
            axes: [axis.clone(), axis],
            feed_forward,
            is_cartesian: setting.is_cartesian,
            period_s: setting.period_s,
            target,
            rates: Vector2::zeros(),
        })
    }

    /// Torques for this cycle, N m, within the limit.
    fn step(
        &mut self,
        machine: &Machine,
        measured: JointAngles,
        proxy: Vector2<f64>,
        target: JointAngles,
    ) -> Result<Vector2<f64>, LinkageError> {
        let rates = (target.0 - self.target.0) / self.period_s;
        let accelerations = (rates - self.rates) / self.period_s;
        (self.target, self.rates) = (target, rates);
        let limit = machine.torque_limit_n_m;
        let forward = match &mut self.feed_forward {
            None => Vector2::zeros(),
            Some(feed_forward) => {
                let dynamics = machine.linkage.dynamics(&machine.model, target, JointRates(rates))?;
                let bias_n_m = dynamics.bias.0;
                let term = InertiaTerm { mass_matrix: dynamics.mass, accelerations, bias_n_m };
                feed_forward.step(JointRates(rates), Some(&term)).torques.0.map(|torque| torque.clamp(-limit, limit))
            }
        };
        let [first, second] = &mut self.axes;
        let feedback = if self.is_cartesian {
            let posture = machine.linkage.forward(measured)?;
            let error = proxy - posture.tip.0;
            // No force within reach needs more than this; the torques are cut below.
            let range = EffortRange::symmetric(limit / posture.smallest_singular_value().max(f64::MIN_POSITIVE));
            let force = Force::new(first.step(error.x, range).effort, second.step(error.y, range).effort);
            posture.joint_torques(force)?.0
        } else {
            let error = target.0 - measured.0;
            let effort = |axis: &mut Axis, error, forward| {
                let (_, range) = EffortRange::around(limit, forward);
                axis.step(error, range).effort
            };
            Vector2::new(effort(first, error.x, forward.x), effort(second, error.y, forward.y))
        };
        Ok((forward + feedback).map(|torque| torque.clamp(-limit, limit)))
    }
}
