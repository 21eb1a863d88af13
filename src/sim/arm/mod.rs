//! The simulated arm: a five-bar with dry friction in its joints, pulled by motors and by a hand.
//!
//! Two coordinates, no constraint to drift, and dry friction that truly holds: a joint that sticks keeps its angle to
//! the last bit.

mod flexible;
mod friction;
mod rigid;
#[cfg(test)]
mod tests;

pub use friction::{slip_rate, slip_rates};

use nalgebra::{Matrix2, Vector2};
use thiserror::Error;

use self::flexible::Gear;
use super::hand::HandLoad;
use super::substeps::equal_steps;
use yieldwall_motion::linkage::{Dynamics, FiveBar, GeometryError, LinkageError, MassModel, Posture};
use yieldwall_motion::quantity::{JointAngles, JointRates, JointTorques, TipPoint, TipVelocity};

/// Largest ratio of the tool's speed to the elbows' speed; the simulation stops there. An arm reaches it about 1/30 rad
/// before the distal links lie on one line (type 2). On that line the motors lose the tool, and steps of any length overshoot.
const TRANSMISSION_LIMIT: f64 = 30.0;

/// Dry friction of a blocked joint in N m, far beyond any motor.
const BLOCKING_N_M: f64 = 1e6;

/// Error in an arm's parameters or in its motion. After an error in the motion the arm keeps the state from before the step.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ArmError {
    /// A quantity of the arm is out of its range.
    #[error("the arm has a {name} of {value}")]
    BadParameter {
        /// Name of the quantity, with its unit and range.
        name: &'static str,
        /// Value that was given.
        value: f64,
    },
    /// The mass model is not that of a machine.
    #[error("the arm's masses: {0}")]
    BadMass(GeometryError),
    /// The linkage cannot be where the motion takes it.
    #[error("the arm stops at {time_s:.4} s: {source}")]
    Linkage {
        /// Beginning of the step that failed, in s.
        time_s: f64,
        /// Error that the linkage reports.
        source: LinkageError,
    },
    /// The distal links are almost on one line or on each other, so that the motors hardly hold the tool.
    #[error(
        "the arm stops at {time_s:.4} s: the tool moves {transmission:.1} times as fast as the elbows, at most {limit} \
         (distal links almost in line or folded)"
    )]
    NearSingularity {
        /// Beginning of the step that failed, in s.
        time_s: f64,
        /// Size of the Jacobian over the length of the longer proximal link.
        transmission: f64,
        /// How large it may be.
        limit: f64,
    },
    /// A torque or a load is not finite, or it threw the arm to infinity.
    #[error("the arm has no finite motion after {time_s:.4} s")]
    NotFinite {
        /// Beginning of the step that failed, in s.
        time_s: f64,
    },
    /// A step that is not above zero, or a time that is not finite or needs too many steps.
    #[error("the arm cannot be moved on from {time_s:.6} s to {end_s:.6} s in steps of {step_s} s")]
    BadStep {
        /// Present time in s.
        time_s: f64,
        /// Time wanted in s.
        end_s: f64,
        /// Step wanted in s.
        step_s: f64,
    },
}

/// Elasticity between each motor and its proximal link, as harmonic gears have it. Friction acts on the motor's side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointElasticity {
    /// Spring of each joint in N m/rad.
    pub stiffness_n_m_per_rad: f64,
    /// Damper of each joint in N m s/rad.
    pub damping_n_m_s_per_rad: f64,
    /// Share of the motor's inertia that lies before the spring, above 0 and below 1; the rest turns with the link.
    pub motor_share: f64,
}

/// Geometry, masses, friction and elasticity of an arm.
#[derive(Clone, Copy, Debug)]
pub struct ArmParameters {
    /// Geometry.
    pub linkage: FiveBar,
    /// Masses of the arm alone.
    pub mass: MassModel,
    /// Mass that is attached to the tool for good, such as the hand's, in kg.
    pub handle_kg: f64,
    /// Dry friction of each joint in N m.
    pub coulomb_n_m: [f64; 2],
    /// Viscous friction of each joint in N m s/rad.
    pub viscous_n_m_s_per_rad: [f64; 2],
    /// Elasticity of the joints; `None` for rigid ones.
    pub joint_elasticity: Option<JointElasticity>,
}

/// Motion of the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipMotion {
    /// Position.
    pub position: TipPoint,
    /// Velocity.
    pub velocity: TipVelocity,
    /// Mean acceleration over the last step in m/s^2; what an attached mass takes is this times the mass.
    pub acceleration_m_per_s2: [f64; 2],
}

/// The arm and its state.
///
/// As a real arm does, it may pass a posture in which a chain is stretched or folded (type 1). The simulation stops near a
/// posture in which the distal links lie on one line (type 2). The arm has no stops at the ends of a joint's range.
#[derive(Clone, Debug)]
pub struct Arm {
    linkage: FiveBar,
    /// Masses with the load attached to the tool, without the inertia that lies before the springs.
    mass: MassModel,
    coulomb_n_m: Vector2<f64>,
    /// Dry friction of the joints while nothing blocks them.
    free_coulomb_n_m: Vector2<f64>,
    are_blocked: [bool; 2],
    are_braked: [bool; 2],
    viscous_n_m_s_per_rad: Vector2<f64>,
    /// Greatest squared Frobenius norm of the Jacobian.
    jacobian_limit_m2: f64,
    time_s: f64,
    angles: Vector2<f64>,
    rates: Vector2<f64>,
    /// Change of the rates per second over the last step, which extrapolates them to the next midpoint.
    slope: Vector2<f64>,
    tip_acceleration: Vector2<f64>,
    gear: Option<Gear>,
}

impl Arm {
    /// An arm at rest at time zero.
    ///
    /// # Errors
    /// Masses, friction or elasticity out of range; a start where the linkage cannot be.
    pub fn new(parameters: &ArmParameters, start: JointAngles) -> Result<Self, ArmError> {
        let ArmParameters { linkage, mass, handle_kg, coulomb_n_m, viscous_n_m_s_per_rad, joint_elasticity } =
            parameters;
        mass.check().map_err(ArmError::BadMass)?;
        check_not_negative("handle mass in kg (must not be negative)", *handle_kg)?;
        for joint in 0..2 {
            check_not_negative("dry friction in N m (must not be negative)", coulomb_n_m[joint])?;
            check_not_negative("viscous friction in N m s/rad (must not be negative)", viscous_n_m_s_per_rad[joint])?;
        }
        let mut link_mass = MassModel { tool_kg: mass.tool_kg + handle_kg, ..*mass };
        let gear = match joint_elasticity {
            None => None,
            Some(elasticity) => Some(Gear::split(elasticity, &mut link_mass, start)?),
        };
        let [left_m, right_m] = linkage.geometry().proximal_m;
        let jacobian_limit_m = TRANSMISSION_LIMIT * left_m.max(right_m);
        let arm = Self {
            linkage: *linkage,
            mass: link_mass,
            coulomb_n_m: Vector2::from(*coulomb_n_m),
            free_coulomb_n_m: Vector2::from(*coulomb_n_m),
            are_blocked: [false; 2],
            are_braked: [false; 2],
            viscous_n_m_s_per_rad: Vector2::from(*viscous_n_m_s_per_rad),
            jacobian_limit_m2: jacobian_limit_m * jacobian_limit_m,
            time_s: 0.0,
            angles: start.0,
            rates: Vector2::zeros(),
            slope: Vector2::zeros(),
            tip_acceleration: Vector2::zeros(),
            gear,
        };
        arm.dynamics(arm.angles, arm.rates)?;
        Ok(arm)
    }

    /// Its linkage.
    pub fn linkage(&self) -> &FiveBar {
        &self.linkage
    }

    /// Present time in s.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Angles of the proximal links.
    pub fn angles(&self) -> JointAngles {
        JointAngles(self.angles)
    }

    /// Rates of the proximal links.
    pub fn rates(&self) -> JointRates {
        JointRates(self.rates)
    }

    /// Angles on the motors' side of the joints, which encoders see; those of the links if the joints are rigid.
    pub fn motor_angles(&self) -> JointAngles {
        JointAngles(self.gear.as_ref().map_or(self.angles, |gear| gear.angles))
    }

    /// Rates on the motors' side of the joints.
    pub fn motor_rates(&self) -> JointRates {
        JointRates(self.gear.as_ref().map_or(self.rates, |gear| gear.rates))
    }

    /// Motion of the tool at the present time.
    ///
    /// # Errors
    /// If the last step ended where the linkage cannot be.
    pub fn tip(&self) -> Result<TipMotion, ArmError> {
        self.posture().map(|posture| self.tip_in(&posture))
    }

    /// Posture of the linkage at the present time.
    ///
    /// # Errors
    /// If the last step ended where the linkage cannot be.
    pub fn posture(&self) -> Result<Posture, ArmError> {
        let posture = self.linkage.forward(self.angles());
        let posture = posture.map_err(|source| ArmError::Linkage { time_s: self.time_s, source })?;
        self.check_transmission(&posture.jacobian).map(|()| posture)
    }

    /// Motion of the tool in the present posture, for those who have it at hand.
    pub fn tip_in(&self, posture: &Posture) -> TipMotion {
        TipMotion {
            position: posture.tip,
            velocity: TipVelocity(posture.jacobian * self.rates),
            acceleration_m_per_s2: [self.tip_acceleration.x, self.tip_acceleration.y],
        }
    }

    /// Kinetic energy of arm and attached mass, with the energy of the joints' springs, in J.
    ///
    /// # Errors
    /// If the last step ended where the linkage cannot be.
    pub fn energy_j(&self) -> Result<f64, ArmError> {
        let Dynamics { mass, .. } = self.dynamics(self.angles, self.rates)?;
        let links = 0.5 * self.rates.dot(&(mass * self.rates));
        Ok(links + self.gear.as_ref().map_or(0.0, |gear| gear.energy_j(self.angles)))
    }

    /// Starts from other rates, such as a push leaves them. Elastic joints start relaxed.
    pub fn set_rates(&mut self, rates: JointRates) {
        self.rates = rates.0;
        self.slope = Vector2::zeros();
        self.tip_acceleration = Vector2::zeros();
        if let Some(gear) = &mut self.gear {
            gear.relax(self.angles, self.rates);
        }
    }

    /// Puts the arm at other angles, at rest, as a person does who leads it by hand. Elastic joints are relaxed.
    pub fn put(&mut self, angles: JointAngles) {
        self.angles = angles.0;
        self.set_rates(JointRates::default());
    }

    /// Blocks joint 0 (left) or 1 (right) by a dry friction that no motor overcomes, or frees it; any other number does
    /// nothing.
    pub fn set_blocked(&mut self, joint: usize, is_blocked: bool) {
        self.are_blocked.iter_mut().skip(joint).take(1).for_each(|blocked| *blocked = is_blocked);
        self.hold();
    }

    /// Closes the brakes of joints that no motor overcomes, or opens them; one that is blocked stays so.
    pub fn set_braked(&mut self, are_braked: [bool; 2]) {
        self.are_braked = are_braked;
        self.hold();
    }

    fn hold(&mut self) {
        for joint in 0..2 {
            let is_held = self.are_blocked[joint] || self.are_braked[joint];
            self.coulomb_n_m[joint] = if is_held { BLOCKING_N_M } else { self.free_coulomb_n_m[joint] };
        }
    }

    /// Moves on by `step_s` under held motor torques and a load on the tool that is asked for at the step's midpoint,
    /// given time in s and tool point.
    ///
    /// The step is of second order apart from the moments at which a joint stops or breaks away. The load's damping is
    /// taken implicitly, its stiffness explicitly, so a spring of stiffness K on a mass m at the tool needs
    /// `step_s` well below `2 sqrt(m / K)`.
    ///
    /// # Errors
    /// Where the linkage cannot be or nearly locks, or if no finite motion results. The state is then the one before.
    ///
    /// # Source
    /// Moreau, "Unilateral contact and dry friction in finite freedom dynamics" (1988), the midpoint form; friction as
    /// in \[KTF08, eqs 7 and 8\].
    // From here to the linkage in one piece: else each step copies its equations of motion from place to place.
    #[inline(always)]
    pub fn advance(
        &mut self,
        step_s: f64,
        torques: JointTorques,
        load: impl FnOnce(f64, TipPoint) -> HandLoad<2>,
    ) -> Result<(), ArmError> {
        if !(step_s > 0.0 && step_s.is_finite()) {
            return Err(ArmError::BadStep { time_s: self.time_s, end_s: self.time_s + step_s, step_s });
        }
        if self.gear.is_none() {
            self.advance_rigid(step_s, torques.0, load)
        } else {
            self.advance_flexible(step_s, torques.0, load)
        }
    }

    /// Moves on to `end_s` in equal steps, none longer than `longest_step_s`; nothing happens if `end_s` is not later.
    ///
    /// # Errors
    /// As [`Arm::advance`], and for times or steps that make no sense.
    pub fn advance_to(
        &mut self,
        end_s: f64,
        longest_step_s: f64,
        torques: JointTorques,
        mut load: impl FnMut(f64, TipPoint) -> HandLoad<2>,
    ) -> Result<(), ArmError> {
        let start_s = self.time_s;
        let (count, step_s) = equal_steps(start_s, end_s, longest_step_s).ok_or(ArmError::BadStep {
            time_s: start_s,
            end_s,
            step_s: longest_step_s,
        })?;
        for index in 1..=count {
            self.advance(step_s, torques, &mut load)?;
            self.time_s = if index == count { end_s } else { start_s + f64::from(index) * step_s };
        }
        Ok(())
    }

    /// Equations of motion at a state, refused near a type 2 singularity.
    #[inline(always)]
    fn dynamics(&self, angles: Vector2<f64>, rates: Vector2<f64>) -> Result<Dynamics, ArmError> {
        let dynamics = self.linkage.dynamics(&self.mass, JointAngles(angles), JointRates(rates));
        let dynamics = dynamics.map_err(|source| ArmError::Linkage { time_s: self.time_s, source })?;
        self.check_transmission(&dynamics.jacobian).map(|()| dynamics)
    }

    #[inline]
    fn check_transmission(&self, jacobian: &Matrix2<f64>) -> Result<(), ArmError> {
        if jacobian.norm_squared() <= self.jacobian_limit_m2 { Ok(()) } else { Err(self.near_singularity(jacobian)) }
    }

    #[cold]
    fn near_singularity(&self, jacobian: &Matrix2<f64>) -> ArmError {
        let longer_m = self.jacobian_limit_m2.sqrt() / TRANSMISSION_LIMIT;
        let transmission = jacobian.norm() / longer_m;
        ArmError::NearSingularity { time_s: self.time_s, transmission, limit: TRANSMISSION_LIMIT }
    }

    /// The state after a step whose middle was `middle`, once its end rates are known.
    #[inline]
    fn finish(&mut self, step_s: f64, middle: &Middle, rates: Vector2<f64>) {
        self.slope = (rates - self.rates) / step_s;
        self.tip_acceleration =
            middle.dynamics.jacobian * self.slope + Vector2::from(middle.dynamics.tip_bias_m_per_s2);
        self.angles = middle.angles + rates * (0.5 * step_s);
        self.rates = rates;
        self.time_s += step_s;
    }
}

/// Quantities at the middle of a step, computed before the rates at its end.
struct Middle {
    angles: Vector2<f64>,
    dynamics: Dynamics,
    /// Joint torques of load and Coriolis forces, without the load's damping.
    torque: Vector2<f64>,
    /// Damping of the load as the joints feel it, in N m s/rad.
    damping: Matrix2<f64>,
}

impl Middle {
    #[inline(always)]
    fn of(arm: &Arm, step_s: f64, load: impl FnOnce(f64, TipPoint) -> HandLoad<2>) -> Result<Self, ArmError> {
        let half_s = 0.5 * step_s;
        let angles = arm.angles + arm.rates * half_s;
        let dynamics = arm.dynamics(angles, arm.rates + arm.slope * half_s)?;
        let load = load(arm.time_s + half_s, dynamics.tip);
        let jacobian = &dynamics.jacobian;
        let torque = jacobian.tr_mul(&load.force_n) - dynamics.bias.0;
        let damping = jacobian.tr_mul(jacobian) * load.damping_n_s_per_m;
        Ok(Self { angles, dynamics, torque, damping })
    }
}

fn check_not_negative(name: &'static str, value: f64) -> Result<(), ArmError> {
    if value.is_finite() && value >= 0.0 { Ok(()) } else { Err(ArmError::BadParameter { name, value }) }
}
