//! One hand and one wall in one dimension.

use crate::elementary;
use nalgebra::Vector1;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use crate::fixture::{
    Admittance, AutomaticHold, Coupling, Curvature, Fixture, Limits, Motion, Parameters, Plane, Rearm, Side,
};
use crate::sim::share_of_one;

const PERIOD_S: f64 = 1e-3;
const SUBSTEPS: u32 = 10;
pub(super) const YIELD_N: f64 = 20.0;
const FRICTION_N: f64 = 3.0;
const TOOL_KG: f64 = 4.0;
const SERVO_N_PER_M: f64 = 111e3;
const SERVO_N_S_PER_M: f64 = 1055.0;
const SERVO_LIMIT_N: f64 = 200.0;
/// The proxy starts here and has the way up to the wall at 0 to come to speed.
const START_M: f64 = 0.25;
/// Duration of one swing of a wall that moves, s: its speed changes by less than a tenth within half a second about the middle
/// of its way.
const SWING_S: f64 = 8.0;
/// How long a wall has been on its way when the hand starts, s, and how far away from it.
const WALL_AHEAD_S: f64 = 1.7;
const WALL_START_M: f64 = 0.1;
/// Seed of all hands.
const SEED: u64 = 2026;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Rule {
    /// N_wait.
    Fixed(u32),
    Automatic,
}

pub(super) const RULES: [Rule; 6] =
    [Rule::Fixed(0), Rule::Fixed(15), Rule::Fixed(50), Rule::Fixed(100), Rule::Fixed(300), Rule::Automatic];

impl Rule {
    pub(super) fn name(self) -> String {
        match self {
            Self::Fixed(steps) => format!("N_wait {steps}"),
            Self::Automatic => "automatic".into(),
        }
    }

    fn fixture(self) -> Fixture<Plane<1>, 1> {
        let parameters = Parameters {
            coupling: Coupling::Admittance(Admittance { mass_kg: 2.0 }),
            limits: Limits { friction_n: FRICTION_N, yield_n: YIELD_N },
            side: Side::Unilateral,
            hold_steps: if let Self::Fixed(steps) = self { steps } else { 0 },
            rearm: Rearm::OffSurface,
            curvature: Curvature::Tangent,
            period_s: PERIOD_S,
        };
        let wall = Plane::new(Vector1::zeros(), Vector1::x()).expect("a unit normal");
        let fixture = Fixture::new(wall, parameters).expect("a wall above friction");
        match self {
            Self::Fixed(_) => fixture,
            Self::Automatic => {
                fixture.with_automatic_hold(AutomaticHold::default()).expect("the default, in an admittance")
            }
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Hand {
    pub(super) mass_kg: f64,
    /// Speed towards the wall that it aims at.
    pub(super) speed_m_per_s: f64,
    /// Its greatest voluntary force.
    pub(super) limit_n: f64,
    /// Force per error of speed, N s/m.
    pub(super) gain: f64,
    /// Stiffness of the grip, N/m.
    pub(super) grip_n_per_m: f64,
    /// Damping of the grip as a share of the critical one.
    pub(super) grip_damping: f64,
}

impl Hand {
    /// The hand of a case, drawn from its number: 0.5 to 1.5 kg, up to 0.5 m/s, below 0.9 R, from a soft grip to a braced one.
    pub(super) fn of_case(case: u64) -> Self {
        let mut stream = SplitMix64::seed_from_u64(SEED);
        (0..6 * case).for_each(|_| _ = stream.next_u64());
        let mut uniform = |low: f64, high: f64| low + (high - low) * share_of_one(&mut stream);
        Self {
            mass_kg: uniform(0.5, 1.5),
            speed_m_per_s: uniform(0.05, 0.5),
            limit_n: uniform(0.4, 0.9) * YIELD_N,
            gain: uniform(20.0, 80.0),
            grip_n_per_m: 1e3 * elementary::powf(30.0, uniform(0.0, 1.0)),
            grip_damping: uniform(0.3, 0.7),
        }
    }
}

/// The speed of the wall of a case where it is greatest, towards the hand, in m/s: 0.05 to 0.25, receding in every other
/// case, and no faster than the hand follows; and the hand of that case.
pub(super) fn wall_of_case(case: u64) -> (f64, Hand) {
    let mut stream = SplitMix64::seed_from_u64(SEED ^ 0x57a1);
    (0..2 * case).for_each(|_| _ = stream.next_u64());
    let mut uniform = |low: f64, high: f64| low + (high - low) * share_of_one(&mut stream);
    let (speed, faster) = (uniform(0.05, 0.25), uniform(0.05, 0.5));
    let hand = Hand::of_case(case);
    if case.is_multiple_of(2) {
        (speed, hand)
    } else {
        (-speed, Hand { speed_m_per_s: hand.speed_m_per_s.max(speed + faster), ..hand })
    }
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Outcome {
    /// Of the tool against the wall.
    pub(super) impact_speed_m_per_s: f64,
    /// Of the wall towards the hand, at the impact.
    pub(super) wall_m_per_s: f64,
    /// Greatest depth of the proxy behind the wall, where it then is, before the deliberate push, in m.
    pub(super) depth_m: f64,
    pub(super) tool_depth_m: f64,
    /// Greatest force that the sensor read after the impact.
    pub(super) peak_n: f64,
    /// From the onset of the push to the first motion of the proxy beyond the wall.
    pub(super) delay_s: Option<f64>,
    pub(super) is_early: bool,
}

/// Runs until 1 s after the impact. With an onset the hand pushes with 1.5 R from then on.
pub(super) fn run(rule: Rule, hand: Hand, onset_s: Option<f64>) -> Outcome {
    strike(rule.fixture(), rule, START_M, hand, onset_s)
}

/// The same against a wall that goes towards the hand at up to `wall_m_per_s`, or away from it.
pub(super) fn run_moving(rule: Rule, hand: Hand, wall_m_per_s: f64) -> Outcome {
    let amplitude_m = Vector1::new(wall_m_per_s * SWING_S / std::f64::consts::PI);
    let motion = Motion { amplitude_m, swing_s: SWING_S };
    let mut fixture = rule.fixture().with_motion(motion).expect("no faster than a surface may be");
    // Far ahead of the wall, where nothing meets it.
    fixture.reset(&Vector1::new(10.0)).expect("a finite start");
    for _ in 0..(WALL_AHEAD_S / PERIOD_S) as u32 {
        fixture.step_admittance(&Vector1::zeros());
    }
    let start_m = fixture.origin().x + WALL_START_M;
    strike(fixture, rule, start_m, hand, None)
}

fn strike(mut fixture: Fixture<Plane<1>, 1>, rule: Rule, start_m: f64, hand: Hand, onset_s: Option<f64>) -> Outcome {
    fixture.reset(&Vector1::new(start_m)).expect("a finite start");
    let (mut x, mut v, mut sensed) = (start_m, 0.0_f64, 0.0);
    let (mut hand_x, mut hand_v) = (start_m, 0.0_f64);
    let grip_n_s_per_m = 2.0 * hand.grip_damping * (hand.grip_n_per_m * hand.mass_kg).sqrt();
    let mut targets = [(start_m, 0.0); 2];
    let mut impact_s: Option<f64> = None;
    let mut outcome = Outcome::default();
    let mut before = start_m;
    for cycle in 0..8000 {
        let time = f64::from(cycle) * PERIOD_S;
        let since = impact_s.map_or(0.0, |impact| time - impact);
        if since > 1.0 {
            break;
        }
        let is_pushing = impact_s.is_some() && onset_s.is_some_and(|onset| since >= onset);
        let wall_before = fixture.origin().x;
        let step = fixture.step_admittance(&Vector1::new(sensed));
        let wall = fixture.origin().x;
        let wall_m_per_s = (wall - wall_before) / PERIOD_S;
        if step.is_impact && impact_s.is_none() {
            impact_s = Some(time);
            outcome.impact_speed_m_per_s = (before - step.proxy.x).max(-v * PERIOD_S) / PERIOD_S + wall_m_per_s;
            outcome.wall_m_per_s = wall_m_per_s;
        }
        let depth = wall - step.proxy.x;
        if rule == Rule::Fixed(0) && impact_s.is_none() && depth > 0.0 {
            impact_s = Some(time);
            outcome.impact_speed_m_per_s = wall_m_per_s - v;
            outcome.wall_m_per_s = wall_m_per_s;
        }
        if impact_s.is_some() {
            outcome.peak_n = outcome.peak_n.max(-sensed);
            outcome.tool_depth_m = if is_pushing { outcome.tool_depth_m } else { outcome.tool_depth_m.max(wall - x) };
            if !is_pushing {
                outcome.depth_m = outcome.depth_m.max(depth);
                outcome.is_early = outcome.depth_m > 1e-9;
            } else if depth > outcome.depth_m.max(1e-9) && outcome.delay_s.is_none() {
                outcome.delay_s = Some(since - onset_s.unwrap_or(since));
            }
        }
        targets = [targets[1], (step.proxy.x, (step.proxy.x - before) / PERIOD_S)];
        before = step.proxy.x;
        let (aim, aim_rate) = targets[0];
        let dt = PERIOD_S / f64::from(SUBSTEPS);
        // Stiffness and damping with the torque limit, held over the cycle as a drive holds its torque.
        let servo = (SERVO_N_PER_M * (aim - x) + SERVO_N_S_PER_M * (aim_rate - v)).clamp(-SERVO_LIMIT_N, SERVO_LIMIT_N);
        for _ in 0..SUBSTEPS {
            let voluntary = if is_pushing {
                -1.5 * YIELD_N
            } else {
                // Friction is paid for.
                (hand.gain * (-hand.speed_m_per_s - hand_v) - FRICTION_N).clamp(-hand.limit_n, hand.limit_n)
            };
            sensed = hand.grip_n_per_m * (hand_x - x) + grip_n_s_per_m * (hand_v - v);
            v += (servo + sensed) / TOOL_KG * dt;
            hand_v += (voluntary - sensed) / hand.mass_kg * dt;
            x += v * dt;
            hand_x += hand_v * dt;
        }
    }
    outcome
}
