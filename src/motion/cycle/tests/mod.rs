//! The cycle without a bus: a bench that feeds it what drives and sensor would report.

mod example;
mod faults;
mod motion;
mod plant;

use super::*;
use crate::control::{Gains, Law};
use crate::fixture::Shape2;
use crate::guard;
use crate::linkage::Side;
use crate::quantity::{JointRates, JointTorques, TipDisplacement, TipVelocity};
use example::*;
use nalgebra::Vector2;

/// A cycle with the world that it sees: drives that obey at once, joints that `joints` says, a sensor that reads `force`.
struct Bench {
    cycle: Cycle,
    drives: [cia402::State; 2],
    follows_command: bool,
    has_voltage: bool,
    has_warning: bool,
    timing: Timing,
    /// Angles of the encoders; `None` for no process data.
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

/// Asserts the conditions of every cycle: finite outputs, within the limits, and no motion while a drive is not enabled.
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
