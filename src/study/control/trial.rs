//! One rig that meets the circle, traces it and turns round.

use std::hint::black_box;

use nalgebra::Vector2;

use super::super::sweep::Clock;
use super::RADIUS_M;
use super::machine::Machine;
use crate::bench::{Bench, BenchError, BenchParameters, Computer, CycleView};
use yieldwall_motion::control::{FeedForwardParameters, Gains, Law};
use yieldwall_motion::cycle::TorqueServoParameters;
use yieldwall_motion::fixture::{
    Admittance, AutomaticHold, Coupling, Curvature, Fixture, FixtureError, Forbidden, Limits, ON_SURFACE_TOLERANCE_M,
    Parameters, Rearm, Shape2, Side, Sphere,
};
use yieldwall_sim::arm::ArmParameters;
use yieldwall_sim::hand::{Hand, HandError, HandParameters, Leg, Path, Speed};

/// Longest hold after an impact, s.
const HOLD_S: f64 = 0.1;
/// Longest step of the plant in s.
const PLANT_STEP_S: f64 = 1e-4;
/// Most cycles that a torque may be late.
pub(super) const MOST_DELAY: usize = 3;
/// Where the tool starts, on the x axis, and where the hand aims: 14 N beyond the circle.
const START_M: f64 = 0.075;
const AIM_M: f64 = 0.155;
/// The way to the circle, s: the tool meets it at some 0.4 m/s.
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

/// Parameters that vary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Setting {
    pub period_s: f64,
    pub delay_cycles: usize,
    pub law: Law,
    pub is_cartesian: bool,
    pub feeds_forward: bool,
    pub is_elastic: bool,
}

impl Setting {
    /// The machine with this loop and these gains, its tool at rest at `start_m`.
    fn bench(&self, machine: &Machine, gains: Gains, start_m: Vector2<f64>) -> BenchParameters {
        let &Self { period_s, delay_cycles, law, is_cartesian, feeds_forward, is_elastic } = self;
        let mut servo = TorqueServoParameters { law, gains, is_cartesian, ..machine.servo };
        if !feeds_forward {
            (servo.feed_forward, servo.inertia) = (FeedForwardParameters::NONE, None);
        }
        BenchParameters {
            arm: ArmParameters { joint_elasticity: is_elastic.then_some(machine.gears), ..machine.arm },
            start_m,
            period_s,
            plant_step_s: PLANT_STEP_S,
            servo,
            delay_cycles,
            low_pass: None,
        }
    }
}

/// Results of a trial. Lengths in m.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CircleTrial {
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

/// Makes two runs: one without a hold for the impact, and one with the automatic hold for the trace. Without the hold, a proxy
/// that has broken through at the impact would trace off the circle.
pub(super) fn run(machine: &Machine, setting: Setting, gains: Gains) -> Result<CircleTrial, BenchError> {
    let mut outcome = CircleTrial::default();
    let impact = fixture(setting.period_s)?;
    simulate(machine, setting, gains, impact, APPROACH_S + REST_S, |seen| {
        outcome.proxy_depth_m = outcome.proxy_depth_m.max(beyond_m(seen.step.proxy));
        outcome.tool_depth_m = outcome.tool_depth_m.max(beyond_m(seen.tool_m));
    })?;
    let hold = AutomaticHold { longest_s: HOLD_S, ..AutomaticHold::default() };
    let held = fixture(setting.period_s)?.with_automatic_hold(hold)?;
    let (mut square, mut counted) = (0.0, 0u32);
    simulate(machine, setting, gains, held, APPROACH_S + REST_S + 2.0 * TRACE_S, |seen| {
        let traced_s = seen.time_s - (APPROACH_S + REST_S);
        if traced_s < 0.0 {
            outcome.held_tool_depth_m = outcome.held_tool_depth_m.max(beyond_m(seen.tool_m));
            return;
        }
        outcome.peak_torque_n_m = outcome.peak_torque_n_m.max(seen.torques.max_abs());
        let error_m = beyond_m(seen.tool_m).abs();
        outcome.whole_max_m = outcome.whole_max_m.max(error_m);
        outcome.is_released |= beyond_m(seen.step.proxy).abs() > ON_SURFACE_TOLERANCE_M;
        if traced_s % TRACE_S > SETTLING_S {
            square += error_m * error_m;
            counted += 1;
        }
    })?;
    outcome.steady_rms_m = (square / f64::from(counted.max(1))).sqrt();
    Ok(outcome)
}

fn simulate(
    machine: &Machine,
    setting: Setting,
    gains: Gains,
    fixture: Fixture<Shape2, 2>,
    for_s: f64,
    mut watch: impl FnMut(&CycleView),
) -> Result<(), BenchError> {
    let start = Vector2::new(START_M, 0.0);
    let mut hand = hand(machine, start)?;
    let mut bench = Bench::new(&setting.bench(machine, gains, start), fixture)?;
    for cycle in 0..(for_s / setting.period_s).round() as u64 {
        watch(&bench.run_cycle(cycle, |time_s, tip| hand.load(time_s, tip.0))?);
    }
    Ok(())
}

/// Signed distance from the circle, outward.
fn beyond_m(point: Vector2<f64>) -> f64 {
    point.norm() - RADIUS_M
}

/// Time in s that a cycle's fixture, kinematics and servo take, in the median of several rounds.
pub(super) fn computing_s(
    machine: &Machine,
    setting: Setting,
    gains: Gains,
    clock: Clock<'_>,
) -> Result<f64, BenchError> {
    let parameters = setting.bench(machine, gains, Vector2::new(RADIUS_M, 0.0));
    let mut computer = Computer::new(&parameters, fixture(setting.period_s)?)?;
    let mut rounds = [0.0; ROUNDS];
    for round_s in &mut rounds {
        let begin = clock();
        for cycle in 0..ROUND_CYCLES {
            // To and fro along the circle, so that nothing stays as it was.
            let force_n = Vector2::new(5.0, if cycle < ROUND_CYCLES / 2 { 4.0 } else { -4.0 });
            let measured = machine.arm.linkage.forward(black_box(computer.target()))?;
            black_box(computer.step(&force_n, &measured)?);
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
        mass_kg: machine.hand.mass_kg,
        stiffness_n_per_m: machine.hand.stiffness_n_per_m,
        damping_n_s_per_m: machine.hand.damping_n_s_per_m,
        voluntary_force_limit_n: f64::INFINITY,
        tremor: None,
        aim_error: None,
    };
    Hand::new(parameters, Path::new(start, &legs)?, 0)
}
