//! A cycle with a five-bar, a sensor and a circle, as tests drive it.

use crate::control::{FeedForwardParameters, Gains, Law, RateLaw};
use crate::cycle::{Cycle, Servo, Settings, TorqueServo, TorqueServoParameters};
use crate::fixture::{
    Admittance, Circle, Coupling, Curvature, Fixture, Forbidden, Limits, Parameters, Rearm, Shape2, Side as Resists,
};
use crate::guard::{self, Gate};
use crate::linkage::{Chain, FiveBar, Geometry, MassModel, Side, Tool, WristSide};
use crate::sensing::{Calibration, MountedOn, Mounting, Sensing, SensingParameters};
use nalgebra::{Matrix6, Vector2};

pub(super) const PERIOD_S: f64 = 1e-3;
pub(super) const MASS_KG: f64 = 2.0;
pub(super) const FRICTION_N: f64 = 3.0;
pub(super) const COUNTS_PER_N: f64 = 100.0;
pub(super) const RANGE_COUNTS: i32 = 32_000;
pub(super) const TOOL_SPEED_LIMIT: f64 = 1.5;
pub(super) const JOINT_SPEED_LIMIT: f64 = 6.0;
pub(super) const FORCE_LIMIT_N: f64 = 150.0;
pub(super) const MARGIN_M: f64 = 0.02;
pub(super) const FOLLOWING_LIMIT_RAD: f64 = 0.05;
pub(super) const DECELERATION: f64 = 10.0;
pub(super) const FORCE_STEP_LIMIT_N: f64 = 40.0;
pub(super) const RESIDUAL_LIMIT_N_M: f64 = 20.0;
pub(super) const ENERGY_LIMIT_J: f64 = 0.2;

/// A symmetric five-bar that reaches a disc of 0.16 m about the origin.
pub(super) fn geometry() -> Geometry {
    Geometry {
        base_m: [[-0.10, -0.45], [0.10, -0.45]],
        proximal_m: [0.30; 2],
        distal_m: [0.40; 2],
        elbows: [Side::Left, Side::Right],
        wrist: WristSide::Forward,
        tool: Tool { fixed_to: Chain::Right, along_m: 0.0, across_m: 0.0 },
    }
}

pub(super) fn settings() -> Settings {
    Settings {
        period_s: PERIOD_S,
        singularity_margin_m: MARGIN_M,
        tool_speed_limit_m_per_s: TOOL_SPEED_LIMIT,
        joint_speed_limit_rad_per_s: JOINT_SPEED_LIMIT,
        force_limit_n: FORCE_LIMIT_N,
        following_error_limit_rad: FOLLOWING_LIMIT_RAD,
        stop_deceleration_m_per_s2: DECELERATION,
        residual_limit_n_m: Some(RESIDUAL_LIMIT_N_M),
        energy_limit_j: ENERGY_LIMIT_J,
        enabling_limit_s: [1.0; 2],
        brake_s: 0.0,
        compute_budget_s: 0.4 * PERIOD_S,
    }
}

pub(super) fn sensing() -> Sensing {
    sensing_with(1000.0, FORCE_STEP_LIMIT_N)
}

pub(super) fn sensing_with(sample_rate_hz: f64, force_step_limit_n: f64) -> Sensing {
    Sensing::new(SensingParameters {
        calibration: Calibration::new(Matrix6::identity() / COUNTS_PER_N, RANGE_COUNTS).unwrap(),
        mounting: Mounting::new(MountedOn::RightDistal, 0.3).unwrap(),
        handle_mass_kg: 0.0,
        low_pass_hz: None,
        sample_rate_hz,
        cycle_period_s: PERIOD_S,
        force_step_limit_n,
    })
    .unwrap()
}

/// A circle of 0.12 m about the origin.
pub(super) fn fixture(hold_steps: u32) -> Fixture<Shape2, 2> {
    let circle = Circle::new(Vector2::zeros(), 0.12, Forbidden::Inside).unwrap();
    let parameters = Parameters {
        coupling: Coupling::Admittance(Admittance { mass_kg: MASS_KG }),
        limits: Limits { friction_n: FRICTION_N, yield_n: 20.0 },
        side: Resists::Bilateral,
        hold_steps,
        rearm: Rearm::default(),
        curvature: Curvature::Tangent,
        period_s: PERIOD_S,
    };
    Fixture::new(Shape2::Circle(circle), parameters).unwrap()
}

pub(super) fn mass_model() -> MassModel {
    MassModel { motor_kg_m2: [0.25; 2], proximal_kg: [0.0; 2], distal_kg: [0.0; 2], tool_kg: 1.0 }
}

pub(super) fn torque_servo(law: Law, is_cartesian: bool) -> Servo {
    let gains = if is_cartesian {
        Gains { stiffness: 90_000.0, damping: 850.0, integral: 1_300_000.0 }
    } else {
        Gains { stiffness: 6_000.0, damping: 70.0, integral: 100_000.0 }
    };
    let parameters = TorqueServoParameters {
        law,
        gains,
        sliding_time_s: 0.02,
        is_cartesian,
        torque_limit_n_m: 60.0,
        feed_forward: FeedForwardParameters { viscous_n_m_s_per_rad: [0.5; 2], ..FeedForwardParameters::NONE },
        inertia: Some(mass_model()),
    };
    let linkage = FiveBar::new(geometry()).unwrap();
    Servo::Torque(Box::new(TorqueServo::new(&parameters, &linkage, PERIOD_S).unwrap()))
}

pub(super) fn velocity_servo() -> Servo {
    Servo::Velocity(RateLaw::new(100.0, JOINT_SPEED_LIMIT).unwrap())
}

pub(super) fn cycle_with(servo: Servo, fixture: Fixture<Shape2, 2>) -> Cycle {
    let linkage = FiveBar::new(geometry()).unwrap();
    let gate = Gate::new(guard::Limits {
        period_s: PERIOD_S,
        torque_n_m: [60.0; 2],
        joint_speed_rad_per_s: JOINT_SPEED_LIMIT,
    });
    Cycle::new(settings(), linkage, sensing(), fixture, servo, gate)
}
