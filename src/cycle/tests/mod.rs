//! The cycle without a bus: a bench that feeds it what drives and sensor would report.

mod faults;
mod motion;
mod plant;

use super::*;
use crate::control::{FeedForwardParameters, Gains, Law, RateLaw};
use crate::fixture::{
    Admittance, Circle, Coupling, Curvature, Forbidden, Limits, Parameters, Rearm, Shape2, Side as Resists,
};
use crate::guard;
use crate::linkage::{Chain, Geometry, MassModel, Side, Tool, WristSide};
use crate::quantity::{JointRates, JointTorques, TipDisplacement, TipVelocity};
use crate::sensing::{Calibration, MountedOn, Mounting, SensingParameters};
use nalgebra::{Matrix6, Vector2};

const PERIOD_S: f64 = 1e-3;
const MASS_KG: f64 = 2.0;
const FRICTION_N: f64 = 3.0;
const COUNTS_PER_N: f64 = 100.0;
const RANGE_COUNTS: i32 = 32_000;
const TOOL_SPEED_LIMIT: f64 = 1.5;
const JOINT_SPEED_LIMIT: f64 = 6.0;
const FORCE_LIMIT_N: f64 = 150.0;
const MARGIN_M: f64 = 0.02;
const FOLLOWING_LIMIT_RAD: f64 = 0.05;
const DECELERATION: f64 = 10.0;
const FORCE_STEP_LIMIT_N: f64 = 40.0;
const RESIDUAL_LIMIT_N_M: f64 = 20.0;
const ENERGY_LIMIT_J: f64 = 0.2;

/// A symmetric five-bar that reaches a disc of 0.16 m about the origin.
fn geometry() -> Geometry {
    Geometry {
        base_m: [[-0.10, -0.45], [0.10, -0.45]],
        proximal_m: [0.30; 2],
        distal_m: [0.40; 2],
        elbows: [Side::Left, Side::Right],
        wrist: WristSide::Forward,
        tool: Tool { fixed_to: Chain::Right, along_m: 0.0, across_m: 0.0 },
    }
}

fn settings() -> Settings {
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

fn sensing() -> Sensing {
    sensing_with(1000.0, FORCE_STEP_LIMIT_N)
}

fn sensing_with(sample_rate_hz: f64, force_step_limit_n: f64) -> Sensing {
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
fn fixture(hold_steps: u32) -> Fixture<Shape2, 2> {
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

fn mass_model() -> MassModel {
    MassModel { motor_kg_m2: [0.25; 2], proximal_kg: [0.0; 2], distal_kg: [0.0; 2], tool_kg: 1.0 }
}

fn torque_servo(law: Law, is_cartesian: bool) -> Servo {
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

fn velocity_servo() -> Servo {
    Servo::Velocity(RateLaw::new(100.0, JOINT_SPEED_LIMIT).unwrap())
}

fn cycle_with(servo: Servo, fixture: Fixture<Shape2, 2>) -> Cycle {
    let linkage = FiveBar::new(geometry()).unwrap();
    let gate = Gate::new(guard::Limits {
        period_s: PERIOD_S,
        torque_n_m: [60.0; 2],
        joint_speed_rad_per_s: JOINT_SPEED_LIMIT,
    });
    Cycle::new(settings(), linkage, sensing(), fixture, servo, gate)
}

/// A cycle whose drives close the position loop (CSP), and the angles of its home in rad.
pub(crate) fn position_cycle() -> (Cycle, [f64; 2]) {
    at_home(Servo::Position)
}

/// A cycle that closes the loop itself (CST), and the angles of its home in rad.
pub(crate) fn torque_cycle() -> (Cycle, [f64; 2]) {
    at_home(torque_servo(Law::Psmc, false))
}

fn at_home(servo: Servo) -> (Cycle, [f64; 2]) {
    let cycle = cycle_with(servo, fixture(0));
    let home = cycle.linkage.inverse(TipPoint::new(0.02, 0.0)).unwrap().to_array();
    (cycle, home)
}

/// A cycle with the world that it sees: drives that obey at once, joints that `joints` says, a sensor that reads `force`.
struct Bench {
    cycle: Cycle,
    drives: [cia402::State; 2],
    follows_command: bool,
    has_voltage: bool,
    has_warning: bool,
    timing: Timing,
    /// What the encoders say; `None` for no process data.
    angles: [Option<f64>; 2],
    /// Force of the hand in N, base frame.
    force: [f64; 2],
    /// Whether samples arrive.
    samples: bool,
    overload: bool,
    invalid: bool,
    link: LinkEvents,
    sequence: u8,
}

impl Bench {
    fn new(servo: Servo, at: [f64; 2]) -> Self {
        Self::with_fixture(servo, at, fixture(0))
    }

    fn with_fixture(servo: Servo, at: [f64; 2], fixture: Fixture<Shape2, 2>) -> Self {
        let cycle = cycle_with(servo, fixture);
        let angles = cycle.linkage.inverse(TipPoint::from(at)).unwrap().to_array();
        Self {
            cycle,
            drives: [cia402::State::SwitchOnDisabled; 2],
            follows_command: true,
            has_voltage: true,
            has_warning: false,
            timing: Timing::default(),
            angles: angles.map(Some),
            force: [0.0; 2],
            samples: true,
            overload: false,
            invalid: false,
            link: LinkEvents::default(),
            sequence: 0,
        }
    }

    /// A bench in Running, at rest at `at`, in its first cycle there.
    fn running(servo: Servo, at: [f64; 2]) -> Self {
        let mut bench = Self::new(servo, at);
        bench.enable();
        bench
    }

    /// The fault that led to the present state.
    fn fault(&self) -> Option<Fault> {
        self.cycle.cause().map(|cause| cause.fault)
    }

    fn enable(&mut self) -> Outputs {
        self.step(Request::None);
        self.step(Request::Enable);
        for _ in 0..5 {
            let outputs = self.step(Request::None);
            if outputs.directive.state == State::Running {
                return outputs;
            }
        }
        panic!("not enabled: {:?} {:?}", self.cycle.state(), self.cycle.cause());
    }

    fn sample(&mut self) -> Option<RawSample> {
        if !self.samples {
            return None;
        }
        self.sequence = self.sequence.wrapping_add(1);
        let angles = JointAngles::from(self.angles.map(Option::unwrap_or_default));
        let mounting = self.cycle.sensing.mounting();
        let link = self.cycle.linkage.forward(angles).map(|posture| mounting.link_rotation(posture.distal_rotation));
        let wrench = mounting.to_sensor(Force::from(self.force), 0.0, link.unwrap_or_default());
        let counts = <[f64; 6]>::from(wrench.0 * COUNTS_PER_N).map(|count| count.round() as i32);
        let (overload, invalid) = (self.overload, self.invalid);
        Some(RawSample { counts, sequence: Some(self.sequence), overload, invalid, age_ns: 0 })
    }

    fn inputs(&mut self, request: Request) -> Inputs {
        let drive = |joint: usize| DriveSample {
            angle_rad: self.angles[joint],
            state: self.drives[joint],
            follows_command: self.follows_command,
            has_voltage: self.has_voltage,
            has_warning: self.has_warning,
        };
        let drives = [drive(0), drive(1)];
        Inputs {
            drives,
            sample: self.sample(),
            link: std::mem::take(&mut self.link),
            timing: std::mem::take(&mut self.timing),
            request,
        }
    }

    /// One cycle; the drives then go where they were sent, unless they are in Fault.
    fn step(&mut self, request: Request) -> Outputs {
        let inputs = self.inputs(request);
        let outputs = self.cycle.step(&inputs);
        assert_is_safe(&inputs, &outputs);
        for drive in &mut self.drives {
            *drive = match (outputs.directive.goal, *drive) {
                (_, cia402::State::Fault) => cia402::State::Fault,
                (cia402::Goal::OperationEnabled, _) => cia402::State::OperationEnabled,
                (cia402::Goal::QuickStop, _) => cia402::State::QuickStopActive,
                (cia402::Goal::SwitchedOn, _) => cia402::State::SwitchedOn,
                (cia402::Goal::ReadyToSwitchOn, _) => cia402::State::ReadyToSwitchOn,
                (cia402::Goal::SwitchOnDisabled, _) => cia402::State::SwitchOnDisabled,
            };
        }
        outputs
    }

    /// One cycle without a request, after which the joints are where the reference is.
    fn follow(&mut self) -> Outputs {
        let outputs = self.step(Request::None);
        self.angles = outputs.signals.target_angles.to_array().map(Some);
        outputs
    }

    fn reference(&self) -> Reference {
        *self.cycle.track.now().expect("a reference while the rig moves")
    }
}

/// What holds in every cycle whatever happens: finite outputs, within the limits, and nothing moves while a drive is not
/// enabled.
fn assert_is_safe(inputs: &Inputs, outputs: &Outputs) {
    let signals = &outputs.signals;
    let values = match outputs.command.get() {
        JointCommand::Position(angles) => angles.to_array(),
        JointCommand::Velocity(rates) => rates.to_array(),
        JointCommand::Torque(torques) => torques.to_array(),
    };
    let planar = [signals.force.to_array(), signals.tool.to_array(), signals.proxy.to_array()];
    let joints = [signals.target_angles.to_array(), signals.measured_angles.to_array()];
    let all = values.into_iter().chain(planar.into_iter().chain(joints).flatten()).chain([signals.signed_distance_m]);
    for value in all {
        assert!(value.is_finite(), "finite: {outputs:?} of {inputs:?}");
    }
    let all_enabled = inputs.drives.iter().all(|drive| drive.state == cia402::State::OperationEnabled);
    assert!(outputs.directive.motion == Motion::Rest || all_enabled, "moves-enabled: {outputs:?}");
    let moves = match outputs.command.get() {
        JointCommand::Position(angles) => *angles != signals.measured_angles,
        JointCommand::Velocity(_) | JointCommand::Torque(_) => values != [0.0; 2],
    };
    assert!(!moves || (all_enabled && outputs.directive.motion != Motion::Rest), "moves-enabled: {outputs:?}");
    if let JointCommand::Torque(torques) = outputs.command.get() {
        assert!(torques.max_abs() <= 60.0, "bounded-effort: {outputs:?}");
    }
}
