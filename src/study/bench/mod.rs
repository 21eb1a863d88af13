//! A rig without bus, encoders and guard: arm, hand, fixture and servo in one sampled loop.
//!
//! Studies of the loop alone run thousands of cases; this loop has what they ask about and nothing else. One cycle:
//! ```text
//! force of a sample -> low pass -> fixture -> proxy -> inverse kinematics -> reference -> servo -> torque limit
//!                                                              angles of the motors ---^              |
//!                                   arm, with gears if it has any, and hand for one period <--- delay <
//! ```
//! The servo is that of the cycle in torque mode ([`TorqueServo`](yieldwall_motion::cycle::TorqueServo)): joint or Cartesian gains, with or without feed-forward.
//! Angles, forces and torques are exact: no counts, no noise, and the proxy is not drawn back from a torque at its limit.
//! [`run_rig`](yieldwall_rig::report::run_rig) measures a whole rig.

mod computer;

pub use computer::{Command, Computer};

use nalgebra::Vector2;
use thiserror::Error;

use yieldwall_motion::control::ControlError;
use yieldwall_motion::cycle::TorqueServoParameters;
use yieldwall_motion::fixture::{Fixture, FixtureError, Shape2, Step};
use yieldwall_motion::linkage::{FiveBar, LinkageError};
use yieldwall_motion::quantity::{JointTorques, TipPoint, TipVelocity};
use yieldwall_motion::sensing::{LowPass, SensingError};
use yieldwall_sim::arm::{Arm, ArmError, ArmParameters};
use yieldwall_sim::hand::{HandError, HandLoad};

/// Longest age of a force sample and longest delay of a torque, in cycles.
pub const LONGEST_DELAY_CYCLES: usize = 31;
const RING: usize = LONGEST_DELAY_CYCLES + 1;

/// Why a bench cannot be built or cannot go on.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum BenchError {
    /// The arm, or where its motion took it.
    #[error(transparent)]
    Arm(#[from] ArmError),
    /// The start or the proxy lies where the linkage does not reach.
    #[error(transparent)]
    Linkage(#[from] LinkageError),
    /// A gain or a time of the servo.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// The fixture, or the start of its proxy.
    #[error(transparent)]
    Fixture(#[from] FixtureError),
    /// The low pass.
    #[error(transparent)]
    Sensing(#[from] SensingError),
    /// The hand that moves the tool.
    #[error(transparent)]
    Hand(#[from] HandError),
    /// A delay that the bench does not hold.
    #[error("a delay of {0} cycles; at most {LONGEST_DELAY_CYCLES}")]
    Delay(usize),
    /// The servo was given or gave a number that is not finite.
    #[error("the servo was given or gave a number that is not finite")]
    NotFinite,
}

/// Parameters of a bench, besides the fixture.
#[derive(Clone, Copy, Debug)]
pub struct BenchParameters {
    /// The arm, with the hand's mass as its `handle_kg`.
    pub arm: ArmParameters,
    /// Where the tool starts at rest, m.
    pub start_m: Vector2<f64>,
    /// `T` in s.
    pub period_s: f64,
    /// Longest step of the plant in s.
    pub plant_step_s: f64,
    /// The servo. PID without an integral is a PD law with velocity feed-forward: its rate is that of the error.
    pub servo: TorqueServoParameters,
    /// Cycles from measuring the angles to the change of torque, besides the hold; at most [`LONGEST_DELAY_CYCLES`].
    pub delay_cycles: usize,
    /// Cut-off of the first-order low pass of the force in Hz, and the interval of its samples in s; `None` for none.
    pub low_pass: Option<(f64, f64)>,
}

/// State at the begin of a cycle, and its result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleView {
    /// Time in s.
    pub time_s: f64,
    /// Tool in m.
    pub tool_m: Vector2<f64>,
    /// Its velocity in m/s.
    pub tool_velocity_m_per_s: Vector2<f64>,
    /// Force of the hand on the tool at this moment in N.
    pub force_n: Vector2<f64>,
    /// Step of the fixture under the given force.
    pub step: Step<2>,
    /// Torques computed in this cycle in N m; they act after the delay.
    pub torques: JointTorques,
}

/// A loop that runs.
#[derive(Clone, Debug)]
pub struct Bench {
    arm: Arm,
    linkage: FiveBar,
    hand_mass_kg: f64,
    computer: Computer,
    delay_cycles: usize,
    period_s: f64,
    plant_step_s: f64,
    low_pass: Option<LowPass>,
    cycle: u64,
    /// Forces at the begin of the last cycles, by cycle modulo the length.
    forces: [Vector2<f64>; RING],
    /// Torques computed in the last cycles, likewise.
    torques: [JointTorques; RING],
    /// Cycle whose force the fixture has; `None` before the first.
    sample: Option<u64>,
    given_n: Vector2<f64>,
}

impl Bench {
    /// A bench at rest with `fixture` reset to the tool.
    ///
    /// # Errors
    /// An arm, gain or delay out of range, or a start out of reach.
    pub fn new(parameters: &BenchParameters, fixture: Fixture<Shape2, 2>) -> Result<Self, BenchError> {
        let BenchParameters { arm, period_s, plant_step_s, delay_cycles, low_pass, .. } = parameters;
        if *delay_cycles > LONGEST_DELAY_CYCLES {
            return Err(BenchError::Delay(*delay_cycles));
        }
        let computer = Computer::new(parameters, fixture)?;
        Ok(Self {
            arm: Arm::new(arm, computer.target())?,
            linkage: arm.linkage,
            hand_mass_kg: arm.handle_kg,
            computer,
            delay_cycles: *delay_cycles,
            period_s: *period_s,
            plant_step_s: *plant_step_s,
            low_pass: low_pass.map(|(cut_off_hz, interval_s)| LowPass::new(cut_off_hz, interval_s)).transpose()?,
            cycle: 0,
            forces: [Vector2::zeros(); RING],
            torques: [JointTorques::default(); RING],
            sample: None,
            given_n: Vector2::zeros(),
        })
    }

    /// Gives arm and proxy a common velocity in m/s, as if they had come along so. Call it before the first cycle.
    ///
    /// # Errors
    /// Where the linkage cannot be.
    pub fn start_moving(&mut self, velocity_m_per_s: Vector2<f64>) -> Result<(), BenchError> {
        let posture = self.arm.posture()?;
        let rates = posture.joint_rates(TipVelocity(velocity_m_per_s))?;
        self.arm.set_rates(rates);
        self.computer.start_moving(posture.tip.0, velocity_m_per_s)
    }

    /// Runs one cycle under `hand`, which returns its load at a time in s and a tool point. The fixture gets the force that was
    /// measured in cycle `sample`, at most [`LONGEST_DELAY_CYCLES`] ago. While the number stays the same, the fixture keeps the
    /// last force, as with a slow sensor.
    ///
    /// # Errors
    /// Where the linkage cannot be, or if no finite motion results.
    pub fn run_cycle(
        &mut self,
        sample: u64,
        mut hand: impl FnMut(f64, TipPoint) -> HandLoad<2>,
    ) -> Result<CycleView, BenchError> {
        let time_s = self.cycle as f64 * self.period_s;
        let posture = self.arm.posture()?;
        let tip = self.arm.tip_in(&posture);
        let load = hand(time_s, tip.position);
        let acceleration = Vector2::from(tip.acceleration_m_per_s2);
        let force_n = load.force_n - tip.velocity.0 * load.damping_n_s_per_m - acceleration * self.hand_mass_kg;
        self.forces[slot(self.cycle)] = force_n;
        self.take(sample);
        // Behind gears encoders see another posture than the one that the tool is in.
        let measured = match self.arm.motor_angles() {
            angles if angles == posture.angles => posture,
            angles => self.linkage.forward(angles)?,
        };
        let Command { step, torques } = self.computer.step(&self.given_n, &measured)?;
        self.torques[slot(self.cycle)] = torques;
        let applied = match self.cycle.checked_sub(self.delay_cycles as u64) {
            Some(cycle) => self.torques[slot(cycle)],
            None => JointTorques::default(),
        };
        self.cycle += 1;
        let end_s = self.cycle as f64 * self.period_s;
        self.arm.advance_to(end_s, self.plant_step_s, applied, hand)?;
        let (tool_m, tool_velocity_m_per_s) = (tip.position.0, tip.velocity.0);
        Ok(CycleView { time_s, tool_m, tool_velocity_m_per_s, force_n, step, torques })
    }

    /// Passes a new sample through the low pass; the same one again changes nothing.
    fn take(&mut self, sample: u64) {
        if self.sample == Some(sample) || self.cycle.saturating_sub(sample) > LONGEST_DELAY_CYCLES as u64 {
            return;
        }
        let force_n = self.forces[slot(sample)];
        self.given_n = match (&self.low_pass, self.sample) {
            (Some(filter), Some(_)) => self.given_n.zip_map(&force_n, |output, input| filter.next(output, input)),
            _ => force_n,
        };
        self.sample = Some(sample);
    }
}

fn slot(cycle: u64) -> usize {
    (cycle % RING as u64) as usize
}
