//! One hand, one pair, one wall and what lies before it, in one dimension.

use nalgebra::Vector1;
use yieldwall_motion::elementary;

use super::machine::{Pair, PairParameters, PairServo, Placement, Surroundings};
use yieldwall_motion::fixture::{
    Admittance, Coupling, Curvature, Fixture, Limits, Parameters, Passivity, Plane, Rearm, Side, Surface as _,
};
use yieldwall_rig::RigError;
use yieldwall_sim::hand::{Hand, HandLoad, HandParameters, Leg, Path};
use yieldwall_sim::point_mass::PointMassParameters;

const PERIOD_S: f64 = 1e-3;
const PLANT_STEP_S: f64 = 1e-4;
const MASS_KG: f64 = 2.0;
const LIMITS: Limits = Limits { friction_n: 3.0, yield_n: 20.0 };
const HOLD_STEPS: u32 = 50;
/// Energy bound of the passivity controller.
const BOUND_J: f64 = 0.02;
/// Both devices: the tool of an arm, with the stiffness and damping of the rig of the paper as they are at the tool.
const DEVICE: PointMassParameters =
    PointMassParameters { mass_kg: 4.0, damping_n_s_per_m: 5.0, position_resolution_m: 0.0 };
const SERVO: PairServo = PairServo { stiffness_n_per_m: 111e3, damping_n_s_per_m: 1055.0, limit_n: 200.0 };
/// Where the hand starts and where the tissue begins; the wall is at 0.
const START_M: f64 = 0.04;
const TISSUE_M: f64 = 0.01;
/// Final force of the hand, below R.
const PRESS_N: f64 = 12.0;
const APPROACH_S: f64 = 0.8;
const END_S: f64 = 4.0;
/// The end of the run in which nothing shall move any more.
const REST_S: f64 = 0.5;

/// Where the fixture stands, and whether it has a passivity controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rule {
    placement: Placement,
    is_controlled: bool,
}

pub(super) const RULES: [Rule; 4] = [
    Rule { placement: Placement::Master, is_controlled: false },
    Rule { placement: Placement::Slave, is_controlled: false },
    Rule { placement: Placement::Master, is_controlled: true },
    Rule { placement: Placement::Slave, is_controlled: true },
];

impl Rule {
    pub(super) fn name(self) -> &'static str {
        match (self.placement, self.is_controlled) {
            (Placement::Master, false) => "master",
            (Placement::Slave, false) => "slave",
            (Placement::Master, true) => "master, with passivity",
            (Placement::Slave, true) => "slave, with passivity",
        }
    }
}

/// Parameters of a case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Case {
    pub(super) rule: Rule,
    /// One way.
    pub(super) delay_ms: u32,
    pub(super) hand_n_per_m: f64,
    /// Stiffness of the tissue 10 mm before the wall; zero for none.
    pub(super) tissue_n_per_m: f64,
}

/// Results of a case.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PairTrial {
    /// Greatest force that the hand felt.
    pub(super) peak_n: f64,
    /// Mean force of the hand at the end.
    pub(super) held_n: f64,
    /// Greatest depth of the proxy beyond the wall.
    pub(super) depth_m: f64,
    /// Greatest depth of the slave beyond the wall.
    pub(super) slave_depth_m: f64,
    /// RMS speed of the master at the end.
    pub(super) unrest_m_per_s: f64,
    /// The most work on the hand, net, between any two moments.
    pub(super) given_j: f64,
    /// Energy that the passivity controller dissipated.
    pub(super) dissipated_j: f64,
}

/// Runs one case.
pub(super) fn run(case: &Case) -> Result<PairTrial, RigError> {
    let mut pair = pair(case)?;
    let mut outcome = PairTrial::default();
    let (mut running_j, mut squares, mut forces, mut counted) = (0.0_f64, 0.0, 0.0, 0.0_f64);
    let mut last: Option<(f64, f64)> = None;
    for _ in 0..(END_S / PERIOD_S).round() as usize {
        let row = pair.run_cycle()?;
        let [master, slave] = row.tools_m.map(|tool| tool.x);
        let felt = -row.hand_n.x;
        outcome.peak_n = outcome.peak_n.max(felt);
        outcome.slave_depth_m = outcome.slave_depth_m.max(-slave);
        outcome.depth_m = outcome.depth_m.max(-pair.fixture().surface().signed_distance_m(&row.step.proxy));
        if let Some((master_before, felt_before)) = last {
            let moved = master - master_before;
            running_j = (running_j + 0.5 * (felt + felt_before) * moved).max(0.0);
            outcome.given_j = outcome.given_j.max(running_j);
            if row.time_s >= END_S - REST_S {
                squares += elementary::powi(moved / PERIOD_S, 2);
                forces += felt;
                counted += 1.0;
            }
        }
        last = Some((master, felt));
    }
    outcome.unrest_m_per_s = (squares / counted.max(1.0)).sqrt();
    outcome.held_n = forces / counted.max(1.0);
    [_, outcome.dissipated_j] = pair.fixture().excess_and_dissipated_j();
    Ok(outcome)
}

fn pair(case: &Case) -> Result<Pair<Plane<1>, 1>, RigError> {
    let parameters = Parameters {
        coupling: Coupling::Admittance(Admittance { mass_kg: MASS_KG }),
        limits: LIMITS,
        side: Side::Unilateral,
        hold_steps: HOLD_STEPS,
        rearm: Rearm::OffSurface,
        curvature: Curvature::Tangent,
        period_s: PERIOD_S,
    };
    let mut fixture = Fixture::new(Plane::new(Vector1::zeros(), Vector1::x())?, parameters)?;
    if case.rule.is_controlled {
        fixture = fixture.with_passivity(Passivity { bound_j: BOUND_J })?;
    }
    let grip = HandParameters {
        mass_kg: 0.5,
        stiffness_n_per_m: case.hand_n_per_m,
        // As much of the critical damping at every stiffness: 15 N s/m at 500 N/m.
        damping_n_s_per_m: 15.0 * (case.hand_n_per_m / 500.0).sqrt(),
        voluntary_force_limit_n: 40.0,
        tremor: None,
        aim_error: None,
    };
    let aim = Vector1::new(-PRESS_N / case.hand_n_per_m);
    let path = Path::new(Vector1::new(START_M), &[Leg::To { point_m: aim, in_s: APPROACH_S }])?;
    let parameters = PairParameters {
        placement: case.rule.placement,
        delay_steps: case.delay_ms,
        master: DEVICE,
        slave: DEVICE,
        servo: SERVO,
        plant_step_s: PLANT_STEP_S,
    };
    Pair::new(parameters, fixture, Hand::new(grip, path, 1)?, tissue(case.tissue_n_per_m))
}

/// A spring with damping that begins before the wall and pushes back.
fn tissue(stiffness_n_per_m: f64) -> Surroundings<1> {
    Box::new(move |_, slave: Vector1<f64>| {
        let pressed_m = TISSUE_M - slave.x;
        if pressed_m <= 0.0 || stiffness_n_per_m == 0.0 {
            return HandLoad::default();
        }
        HandLoad {
            force_n: Vector1::new(stiffness_n_per_m * pressed_m),
            damping_n_s_per_m: 0.005 * stiffness_n_per_m,
            stiffness_n_per_m,
        }
    })
}
