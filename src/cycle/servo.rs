//! From the reference to a joint command, in the rig's command mode.

use nalgebra::Matrix2;

use super::Reference;
use crate::control::{Axis, AxisController, EffortRange, FeedForward, InertiaTerm, RateLaw};
use crate::guard::{Fault, JointCommand, Measured};
use crate::linkage::{FiveBar, MassModel, Posture};
use crate::quantity::{Force, JointAngles, JointRates, JointTorques};
use crate::setvalued::gsat;

/// The inertia part of the feed-forward.
pub type Inertia = Option<MassModel>;

/// How the rig commands its joints.
#[derive(Clone, Debug)]
pub enum Servo {
    /// The drives close the position loop (CSP).
    Position,
    /// The drives close the velocity loop (CSV): the same law on both joints.
    Velocity(RateLaw),
    /// The loop closes here (CST).
    Torque(Box<TorqueServo>),
}

/// Two controllers with feed-forward.
#[derive(Clone, Debug)]
pub struct TorqueServo {
    /// One controller per joint, or per direction of the base frame.
    pub axes: [Axis; 2],
    /// Whether the controllers act on the tool's position (IV-B of the paper) and not on the joints' angles.
    pub is_cartesian: bool,
    /// Greatest effort of a controller: torque per joint in N m, or force per direction in N.
    pub effort_limit: [f64; 2],
    /// Friction and inertia feed-forward.
    pub feed_forward: FeedForward,
    /// Masses for the inertia feed-forward; `None` leaves it out.
    pub inertia: Inertia,
}

impl Servo {
    /// A command of this mode, for its kind only.
    pub(super) fn rest(&self) -> JointCommand {
        match self {
            Servo::Position => JointCommand::Position(JointAngles::default()),
            Servo::Velocity(_) => JointCommand::Velocity(JointRates::default()),
            Servo::Torque(_) => JointCommand::Torque(JointTorques::default()),
        }
    }

    /// Forgets the past: integrals are empty and the present error is no step.
    pub(super) fn reset(&mut self, reference: &Reference, measured: &Measured, posture: &Posture) {
        if let Servo::Torque(servo) = self {
            let error = servo.error(reference, measured, posture);
            for (axis, error) in servo.axes.iter_mut().zip(error) {
                axis.reset(error);
            }
            servo.feed_forward.reset();
        }
    }

    /// The command that brings the measured joints to the reference, and what goes with it in torque mode.
    ///
    /// # Errors
    /// [`Fault::NotFinite`] if a law was given or gave something that is not finite.
    pub(super) fn command(
        &mut self,
        linkage: &FiveBar,
        reference: &Reference,
        measured: &Measured,
        posture: &Posture,
    ) -> Result<Effort, Fault> {
        match self {
            Servo::Position => Ok(Effort::of(JointCommand::Position(reference.angles))),
            Servo::Velocity(law) => {
                let error = reference.angles.0 - measured.angles.0;
                let first = law.command(error.x, reference.rates.0.x);
                let second = law.command(error.y, reference.rates.0.y);
                if !(first.valid && second.valid) {
                    return Err(Fault::NotFinite);
                }
                Ok(Effort::of(JointCommand::Velocity(JointRates::new(first.rate, second.rate))))
            }
            Servo::Torque(servo) => {
                let inertia = servo.inertia_term(linkage, reference);
                let (torques, excess) = servo.torques(inertia.as_ref(), reference, measured, posture)?;
                let needed = inertia.map(|term| JointTorques(term.mass_matrix * term.accelerations + term.bias_n_m));
                let excess = (excess != [0.0; 2]).then_some(excess);
                Ok(Effort { command: JointCommand::Torque(torques), needed, excess })
            }
        }
    }

    /// Takes the reference of the last command to have been this one.
    pub(super) fn draw_back(&mut self, reference: &Reference, measured: &Measured, posture: &Posture) {
        if let Servo::Torque(servo) = self {
            let error = servo.error(reference, measured, posture);
            for (axis, error) in servo.axes.iter_mut().zip(error) {
                axis.draw_back(error);
            }
        }
    }
}

/// A command with what the cycle needs to know about it.
pub(super) struct Effort {
    pub(super) command: JointCommand,
    /// Torques that the motion of the reference needs, with a model of the arm's inertia.
    pub(super) needed: Option<JointTorques>,
    /// How much nearer the reference would have to be for the controllers alone to keep within their limit, per joint in
    /// rad or per direction in m; `None` if they do. A feed-forward does not count: the acceleration of a proxy that stops
    /// at once asks for any torque, for one cycle.
    pub(super) excess: Option<[f64; 2]>,
}

impl Effort {
    fn of(command: JointCommand) -> Self {
        Self { command, needed: None, excess: None }
    }
}

impl TorqueServo {
    fn error(&self, reference: &Reference, measured: &Measured, posture: &Posture) -> [f64; 2] {
        if self.is_cartesian {
            (reference.point.0 - posture.tip.0).into()
        } else {
            (reference.angles.0 - measured.angles.0).into()
        }
    }

    fn torques(
        &mut self,
        inertia: Option<&InertiaTerm>,
        reference: &Reference,
        measured: &Measured,
        posture: &Posture,
    ) -> Result<(JointTorques, [f64; 2]), Fault> {
        let forward = self.feed_forward.step(reference.rates, inertia);
        let error = self.error(reference, measured, posture);
        let (mut effort, mut excess) = ([0.0; 2], [0.0; 2]);
        let mut is_valid = forward.valid;
        for axis in 0..2 {
            let (law, limit) = (&mut self.axes[axis], self.effort_limit[axis]);
            let (base, range) = if self.is_cartesian {
                (0.0, EffortRange::symmetric(limit))
            } else {
                EffortRange::around(limit, forward.torques.to_array()[axis])
            };
            let step = law.step(error[axis], range);
            is_valid &= step.valid;
            effort[axis] = base + step.effort;
            excess[axis] = (step.wanted - gsat(-limit, step.wanted, limit)) / law.step_stiffness();
        }
        if !is_valid {
            return Err(Fault::NotFinite);
        }
        if !self.is_cartesian {
            return Ok((JointTorques::from(effort), excess));
        }
        let torques = posture.joint_torques(Force::from(effort)).map_err(|_| Fault::NotFinite)?;
        Ok((JointTorques(torques.0 + forward.torques.0), excess))
    }

    fn inertia_term(&self, linkage: &FiveBar, reference: &Reference) -> Option<InertiaTerm> {
        let model = self.inertia.as_ref()?;
        let dynamics = linkage.dynamics(model, reference.angles, reference.rates).ok()?;
        let mass_matrix: Matrix2<f64> = dynamics.mass;
        Some(InertiaTerm { mass_matrix, accelerations: reference.accelerations, bias_n_m: dynamics.bias.0 })
    }
}
