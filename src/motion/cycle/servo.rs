//! From the reference to a joint command, in the rig's command mode.

use nalgebra::Matrix2;

use super::Reference;
use crate::control::{
    Axis, AxisController, ControlError, EffortRange, FeedForward, FeedForwardParameters, Gains, InertiaTerm, Law,
    RateLaw,
};
use crate::guard::{Fault, JointCommand};
use crate::linkage::{FiveBar, MassModel, Posture};
use crate::quantity::{Force, JointAngles, JointRates, JointTorques, TipDisplacement};
use crate::setvalued::gsat;

/// Command mode of the joints.
#[derive(Clone, Debug)]
pub enum Servo {
    /// The drives close the position loop (CSP).
    Position,
    /// The drives close the velocity loop (CSV): the same law on both joints.
    Velocity(RateLaw),
    /// The loop closes here (CST).
    Torque(Box<TorqueServo>),
}

/// Parameters of a servo in torque mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueServoParameters {
    /// PID or PSMC.
    pub law: Law,
    /// Gains per joint, or per direction of the base frame if the servo is Cartesian; the same on both axes.
    pub gains: Gains,
    /// `H` of PSMC in s.
    pub sliding_time_s: f64,
    /// Whether the controllers act on the tool's position and not on the joints' angles.
    pub is_cartesian: bool,
    /// Greatest torque of a joint in N m, positive; infinity for no limit.
    pub torque_limit_n_m: f64,
    /// Friction feed-forward.
    pub feed_forward: FeedForwardParameters,
    /// Masses for the inertia feed-forward; `None` leaves it out.
    pub inertia: Option<MassModel>,
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
    /// Initial value of `effort_limit`.
    own_effort_limit: [f64; 2],
    /// Friction and inertia feed-forward.
    pub feed_forward: FeedForward,
    /// Masses for the inertia feed-forward; `None` leaves it out.
    pub inertia: Option<MassModel>,
}

impl Servo {
    /// Returns a command of this mode, for its kind only.
    pub(super) fn rest(&self) -> JointCommand {
        match self {
            Servo::Position => JointCommand::Position(JointAngles::default()),
            Servo::Velocity(_) => JointCommand::Velocity(JointRates::default()),
            Servo::Torque(_) => JointCommand::Torque(JointTorques::default()),
        }
    }

    /// Forgets the past: integrals are empty and the present error is no step.
    pub(super) fn reset(&mut self, reference: &Reference, posture: &Posture) {
        if let Servo::Torque(servo) = self {
            let error = servo.error(reference, posture);
            for (axis, error) in servo.axes.iter_mut().zip(error.to_array()) {
                axis.reset(error);
            }
            servo.feed_forward.reset();
        }
    }

    /// Returns the command that brings the measured joints to the reference, and what goes with it in torque mode.
    ///
    /// # Errors
    /// [`Fault::NotFinite`] if a law was given or gave something that is not finite.
    pub(super) fn command(
        &mut self,
        linkage: &FiveBar,
        reference: &Reference,
        posture: &Posture,
    ) -> Result<Effort, Fault> {
        match self {
            Servo::Position => Ok(Effort::of(JointCommand::Position(reference.angles()))),
            Servo::Velocity(law) => {
                let error = reference.angles() - posture.angles;
                let first = law.command(error.left(), reference.rates.left());
                let second = law.command(error.right(), reference.rates.right());
                if !(first.valid && second.valid) {
                    return Err(Fault::NotFinite);
                }
                Ok(Effort::of(JointCommand::Velocity(JointRates::new(first.rate, second.rate))))
            }
            Servo::Torque(servo) => {
                let TorqueStep { torques, needed, overreach } = servo.step(linkage, reference, posture)?;
                Ok(Effort { command: JointCommand::Torque(torques), needed, overreach })
            }
        }
    }

    /// Takes the reference of the last command to have been this one.
    pub(super) fn draw_back(&mut self, reference: &Reference, posture: &Posture) {
        if let Servo::Torque(servo) = self {
            let error = servo.error(reference, posture);
            for (axis, error) in servo.axes.iter_mut().zip(error.to_array()) {
                axis.draw_back(error);
            }
        }
    }
}

/// A command with what the cycle needs to know about it.
pub(super) struct Effort {
    pub(super) command: JointCommand,
    /// As in [`TorqueStep`].
    pub(super) needed: Option<JointTorques>,
    /// As in [`TorqueStep`].
    pub(super) overreach: Option<Deviation>,
}

impl Effort {
    fn of(command: JointCommand) -> Self {
        Self { command, needed: None, overreach: None }
    }
}

/// Result of a servo in torque mode in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueStep {
    /// The torques, not yet cut to what a joint may have.
    pub torques: JointTorques,
    /// Torques that the motion of the reference needs, with a model of the arm's inertia.
    pub needed: Option<JointTorques>,
    /// Distance by which the reference is too far for the controllers alone to keep within their limit; `None` if they do. A
    /// feed-forward does not count: the acceleration of a proxy that stops at once asks for any torque, for one cycle.
    pub overreach: Option<Deviation>,
}

/// Difference of two states of the arm, in the coordinates of the controllers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Deviation {
    /// Angles of the proximal links.
    Joints(JointAngles),
    /// Displacement of the tool.
    Tool(TipDisplacement),
}

impl Deviation {
    /// Returns one number for each controller: left and right in rad, or along x and y in m.
    fn to_array(self) -> [f64; 2] {
        match self {
            Self::Joints(by) => by.to_array(),
            Self::Tool(by) => by.to_array(),
        }
    }
}

/// Returns the effort of a controller that makes this torque of a joint, in N m: of a Cartesian one at the longer proximal link.
fn effort(torque_n_m: f64, is_cartesian: bool, linkage: &FiveBar) -> f64 {
    let [left_m, right_m] = linkage.geometry().proximal_m;
    if is_cartesian { torque_n_m / left_m.max(right_m) } else { torque_n_m }
}

impl TorqueServo {
    /// Creates a servo at rest for an arm with this linkage. The limit of a Cartesian controller is the force that makes the
    /// greatest torque at the longer proximal link.
    ///
    /// # Errors
    /// A gain, a time, a friction or the period out of range.
    pub fn new(parameters: &TorqueServoParameters, linkage: &FiveBar, period_s: f64) -> Result<Self, ControlError> {
        let TorqueServoParameters { law, gains, sliding_time_s, is_cartesian, torque_limit_n_m, feed_forward, inertia } =
            *parameters;
        let axis = law.controller(gains, sliding_time_s, period_s)?;
        // No limit is the largest effort that stays finite in sums.
        let torque_n_m = torque_limit_n_m.min(f64::MAX / 4.0);
        let limit = effort(torque_n_m, is_cartesian, linkage);
        Ok(Self {
            axes: [axis.clone(), axis],
            is_cartesian,
            effort_limit: [limit; 2],
            own_effort_limit: [limit; 2],
            feed_forward: FeedForward::new(feed_forward, period_s)?,
            inertia,
        })
    }

    /// Takes the limit with which it was made.
    pub(super) fn restore_torque(&mut self) {
        self.effort_limit = self.own_effort_limit;
    }

    /// Lowers the limit to what `torque_n_m` of each joint, in N m, makes of it. It is not raised until
    /// [`TorqueServo::restore_torque`].
    pub(super) fn lower_torque(&mut self, torque_n_m: f64, linkage: &FiveBar) {
        let limit = effort(torque_n_m.max(0.0), self.is_cartesian, linkage);
        self.effort_limit.iter_mut().for_each(|most| *most = most.min(limit));
    }

    /// Returns the torques that bring the arm in this posture to the reference.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// [`Fault::NotFinite`] if a law was given or gave something that is not finite.
    pub fn step(&mut self, linkage: &FiveBar, reference: &Reference, posture: &Posture) -> Result<TorqueStep, Fault> {
        let inertia = self.inertia_term(linkage, reference);
        let (torques, overreach) = self.torques(inertia.as_ref(), reference, posture)?;
        let needed = inertia.map(|term| JointTorques(term.mass_matrix * term.accelerations + term.bias_n_m));
        let overreach = Some(overreach).filter(|overreach| overreach.to_array() != [0.0; 2]);
        Ok(TorqueStep { torques, needed, overreach })
    }

    /// Returns the deviation of the reference from the measured arm.
    fn error(&self, reference: &Reference, posture: &Posture) -> Deviation {
        if self.is_cartesian {
            Deviation::Tool(reference.point - posture.tip)
        } else {
            Deviation::Joints(reference.angles() - posture.angles)
        }
    }

    fn torques(
        &mut self,
        inertia: Option<&InertiaTerm>,
        reference: &Reference,
        posture: &Posture,
    ) -> Result<(JointTorques, Deviation), Fault> {
        let forward = self.feed_forward.step(reference.rates, inertia);
        let error = self.error(reference, posture).to_array();
        let (mut effort, mut overreach) = ([0.0; 2], [0.0; 2]);
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
            overreach[axis] = (step.wanted - gsat(-limit, step.wanted, limit)) / law.step_stiffness();
        }
        if !is_valid {
            return Err(Fault::NotFinite);
        }
        if !self.is_cartesian {
            return Ok((JointTorques::from(effort), Deviation::Joints(overreach.into())));
        }
        let torques = posture.joint_torques(Force::from(effort)).map_err(|_| Fault::NotFinite)?;
        Ok((torques + forward.torques, Deviation::Tool(overreach.into())))
    }

    fn inertia_term(&self, linkage: &FiveBar, reference: &Reference) -> Option<InertiaTerm> {
        let model = self.inertia.as_ref()?;
        let dynamics = linkage.dynamics_of(model, &reference.closure, reference.rates).ok()?;
        let mass_matrix: Matrix2<f64> = dynamics.mass;
        Some(InertiaTerm { mass_matrix, accelerations: reference.accelerations, bias_n_m: dynamics.bias.0 })
    }
}
