//! The computer of a bench: it turns a force and a measured posture into torques.

use nalgebra::Vector2;

use super::{BenchError, BenchParameters};
use yieldwall_motion::cycle::{Reference, TorqueServo};
use yieldwall_motion::fixture::{Fixture, Shape2, Step};
use yieldwall_motion::linkage::{FiveBar, Posture};
use yieldwall_motion::quantity::{JointAngles, JointTorques, TipPoint};
use yieldwall_motion::setvalued::gsat;

/// Fixture, kinematics and servo of a bench.
#[derive(Clone, Debug)]
pub struct Computer {
    linkage: FiveBar,
    fixture: Fixture<Shape2, 2>,
    servo: TorqueServo,
    torque_limit_n_m: f64,
    reference: Reference,
    period_s: f64,
}

/// Command of a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Step of the fixture.
    pub step: Step<2>,
    /// The torques within their limit.
    pub torques: JointTorques,
}

impl Computer {
    /// At rest with `fixture` reset to the start of the bench.
    ///
    /// # Errors
    /// A gain or time out of range, or a start out of reach.
    pub fn new(parameters: &BenchParameters, mut fixture: Fixture<Shape2, 2>) -> Result<Self, BenchError> {
        let BenchParameters { arm, start_m, period_s, servo, .. } = parameters;
        fixture.reset(start_m)?;
        let start = TipPoint(*start_m);
        Ok(Self {
            linkage: arm.linkage,
            fixture,
            servo: TorqueServo::new(servo, &arm.linkage, *period_s)?,
            torque_limit_n_m: servo.torque_limit_n_m,
            reference: Reference::at_rest(start, arm.linkage.close(arm.linkage.inverse(start)?)?),
            period_s: *period_s,
        })
    }

    /// The angles at which the joints shall be.
    pub fn target(&self) -> JointAngles {
        self.reference.angles()
    }

    /// Lets the proxy come to the tool with this velocity.
    pub(super) fn start_moving(
        &mut self,
        tool_m: Vector2<f64>,
        velocity_m_per_s: Vector2<f64>,
    ) -> Result<(), BenchError> {
        self.fixture.reset(&(tool_m - velocity_m_per_s * self.period_s))?;
        Ok(self.fixture.hold_back_to(&tool_m)?)
    }

    /// One cycle of an arm that is measured to be in this posture.
    ///
    /// # Errors
    /// Where the linkage cannot be, and for numbers that are not finite.
    pub fn step(&mut self, force_n: &Vector2<f64>, measured: &Posture) -> Result<Command, BenchError> {
        let step = self.fixture.step_admittance(force_n);
        let proxy = TipPoint(step.proxy);
        let closure = self.linkage.close_near(proxy, self.reference.angles())?;
        self.reference = self.reference.moved(proxy, closure, self.period_s);
        let servo = self.servo.step(&self.linkage, &self.reference, measured).map_err(|_| BenchError::NotFinite)?;
        let limit = self.torque_limit_n_m;
        Ok(Command { step, torques: servo.torques.map(|torque| gsat(-limit, torque, limit)) })
    }
}
