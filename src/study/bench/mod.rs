//! A rig without bus, encoders and guard: arm, hand, fixture and joint controllers in one sampled loop.
//!
//! Studies of the loop alone run thousands of cases; this loop has what they ask about and nothing else. One cycle:
//! ```text
//! force of a sample -> low pass -> fixture -> inverse kinematics -> controllers -> delay -> arm and hand for one period
//! ```
//! Angles, forces and torques are exact: no counts, no noise. What a whole rig does besides is the business of
//! [`run_rig`](super::run_rig).

mod study_arm;

pub use study_arm::{STUDY_DISTAL_M, STUDY_GAINS, STUDY_START_M, study_arm};

use nalgebra::Vector2;
use thiserror::Error;

use crate::control::{Axis, AxisController, ControlError, EffortRange, Gains, Law};
use crate::fixture::{Fixture, FixtureError, Shape2, Step};
use crate::linkage::{FiveBar, LinkageError};
use crate::quantity::{JointAngles, JointTorques, TipPoint};
use crate::sensing::{LowPass, SensingError};
use crate::sim::arm::{Arm, ArmError, ArmParameters};
use crate::sim::hand::HandLoad;

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
    /// A gain or a time of the controllers.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// The start of the proxy.
    #[error(transparent)]
    Fixture(#[from] FixtureError),
    /// The low pass.
    #[error(transparent)]
    Sensing(#[from] SensingError),
    /// A delay that the bench does not hold.
    #[error("a delay of {0} cycles; at most {LONGEST_DELAY_CYCLES}")]
    Delay(usize),
}

/// The joint controllers of a bench: the same on both joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joints {
    /// PID or PSMC. PID without an integral is a PD law with velocity feed-forward: its rate is that of the error.
    pub law: Law,
    /// Gains per joint.
    pub gains: Gains,
    /// `H` of PSMC in s.
    pub sliding_time_s: f64,
    /// Greatest torque of a joint in N m; infinity for no limit.
    pub torque_limit_n_m: f64,
    /// Cycles from measuring the angles to the change of torque, besides the hold; at most [`LONGEST_DELAY_CYCLES`].
    pub delay_cycles: usize,
}

/// What a bench is made of, besides the fixture.
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
    /// The controllers.
    pub joints: Joints,
    /// Cut-off of the first-order low pass of the force in Hz, and the interval of its samples in s; `None` for none.
    pub low_pass: Option<(f64, f64)>,
}

/// What a cycle saw at its begin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Time in s.
    pub time_s: f64,
    /// Tool in m.
    pub tool_m: Vector2<f64>,
    /// Its velocity in m/s.
    pub tool_velocity_m_per_s: Vector2<f64>,
    /// Force of the hand on the tool at this moment in N.
    pub force_n: Vector2<f64>,
    /// What the fixture made of the force that it was given.
    pub step: Step<2>,
}

/// A loop that runs.
#[derive(Clone, Debug)]
pub struct Bench {
    arm: Arm,
    hand_mass_kg: f64,
    linkage: FiveBar,
    fixture: Fixture<Shape2, 2>,
    axes: [Axis; 2],
    range: EffortRange,
    delay_cycles: usize,
    period_s: f64,
    plant_step_s: f64,
    low_pass: Option<LowPass>,
    cycle: u64,
    /// Forces at the begin of the last cycles, by cycle modulo the length.
    forces: [Vector2<f64>; RING],
    /// Torques computed in the last cycles, likewise.
    torques: [Vector2<f64>; RING],
    /// Of which cycle the force is that the fixture has; `None` before the first.
    sample: Option<u64>,
    given_n: Vector2<f64>,
    target: JointAngles,
}

impl Bench {
    /// A bench at rest with `fixture` reset to the tool.
    ///
    /// # Errors
    /// An arm, gain or delay out of range, or a start out of reach.
    pub fn new(parameters: &BenchParameters, mut fixture: Fixture<Shape2, 2>) -> Result<Self, BenchError> {
        let BenchParameters { arm, start_m, period_s, plant_step_s, joints, low_pass } = parameters;
        if joints.delay_cycles > LONGEST_DELAY_CYCLES {
            return Err(BenchError::Delay(joints.delay_cycles));
        }
        let target = arm.linkage.inverse(TipPoint(*start_m))?;
        fixture.reset(start_m)?;
        let axis = joints.law.controller(joints.gains, joints.sliding_time_s, *period_s)?;
        let range = match joints.torque_limit_n_m {
            // The largest torque that stays finite in sums.
            limit if limit == f64::INFINITY => EffortRange::symmetric(f64::MAX / 4.0),
            limit => EffortRange::symmetric(limit),
        };
        Ok(Self {
            arm: Arm::new(arm, target)?,
            hand_mass_kg: arm.handle_kg,
            linkage: arm.linkage,
            fixture,
            axes: [axis.clone(), axis],
            range,
            delay_cycles: joints.delay_cycles,
            period_s: *period_s,
            plant_step_s: *plant_step_s,
            low_pass: low_pass.map(|(cut_off_hz, interval_s)| LowPass::new(cut_off_hz, interval_s)).transpose()?,
            cycle: 0,
            forces: [Vector2::zeros(); RING],
            torques: [Vector2::zeros(); RING],
            sample: None,
            given_n: Vector2::zeros(),
            target,
        })
    }

    /// Number of the next cycle, from 0.
    pub fn cycle(&self) -> u64 {
        self.cycle
    }

    /// The arm, for those who look at more than a cycle shows.
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// Gives arm and proxy a common velocity in m/s, as if they had come along so. Call it before the first cycle.
    ///
    /// # Errors
    /// Where the linkage cannot be.
    pub fn start_moving(&mut self, velocity_m_per_s: Vector2<f64>) -> Result<(), BenchError> {
        let posture = self.arm.posture()?;
        let rates = posture.joint_rates(crate::quantity::TipVelocity(velocity_m_per_s))?;
        self.arm.set_rates(rates);
        let here = posture.tip.0;
        self.fixture.reset(&(here - velocity_m_per_s * self.period_s))?;
        self.fixture.hold_back_to(&here)?;
        Ok(())
    }

    /// One cycle under `hand`, which is asked for its load at a time in s and a tool point. The fixture is given the
    /// force that was measured in cycle `sample`, at most [`LONGEST_DELAY_CYCLES`] ago; while the number stays the same
    /// the last force is held, as with a slow sensor.
    ///
    /// # Errors
    /// Where the linkage cannot be, or if no finite motion results.
    pub fn run_cycle(
        &mut self,
        sample: u64,
        mut hand: impl FnMut(f64, TipPoint) -> HandLoad<2>,
    ) -> Result<Seen, BenchError> {
        let time_s = self.cycle as f64 * self.period_s;
        let tip = self.arm.tip()?;
        let load = hand(time_s, tip.position);
        let acceleration = Vector2::from(tip.acceleration_m_per_s2);
        let force_n = load.force_n - tip.velocity.0 * load.damping_n_s_per_m - acceleration * self.hand_mass_kg;
        self.forces[slot(self.cycle)] = force_n;
        self.take(sample);
        let step = self.fixture.step_admittance(&self.given_n);
        self.target = self.linkage.inverse_near(TipPoint(step.proxy), self.target)?;
        let error = self.target.0 - self.arm.angles().0;
        let [left, right] = &mut self.axes;
        let torque = Vector2::new(left.step(error.x, self.range).effort, right.step(error.y, self.range).effort);
        self.torques[slot(self.cycle)] = torque;
        let applied = match self.cycle.checked_sub(self.delay_cycles as u64) {
            Some(cycle) => self.torques[slot(cycle)],
            None => Vector2::zeros(),
        };
        self.cycle += 1;
        let end_s = self.cycle as f64 * self.period_s;
        self.arm.advance_to(end_s, self.plant_step_s, JointTorques(applied), hand)?;
        Ok(Seen { time_s, tool_m: tip.position.0, tool_velocity_m_per_s: tip.velocity.0, force_n, step })
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
