use super::complex::Complex;
use super::error::LinkageError;
use super::five_bar::{Closure, FiveBar, Transmission};
use super::geometry::GeometryError;
use super::posture::{finite_vector, matrix};
use crate::quantity::{JointAngles, JointRates, JointTorques, TipPoint, TipVelocity};
use nalgebra::{Matrix2, Vector2};

/// Joint rates beyond this are refused: no machine turns so fast, and the squares stay finite.
pub const RATE_LIMIT_RAD_PER_S: f64 = 1e6;

/// Masses of the linkage. It lies in a horizontal plane, so gravity does no work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassModel {
    /// Inertia of each motor with its gear, reflected to the joint.
    pub motor_kg_m2: [f64; 2],
    /// Mass of each proximal link, a uniform rod.
    pub proximal_kg: [f64; 2],
    /// Mass of each distal link, a uniform rod from elbow to wrist.
    pub distal_kg: [f64; 2],
    /// Mass at the tool point.
    pub tool_kg: f64,
}

impl MassModel {
    /// Checks, when a rig is loaded, that this is a machine. No value is negative or not finite, and every motor has an inertia, so that
    /// the mass matrix is positive definite in every posture.
    ///
    /// # Errors
    /// The first parameter that fails.
    pub fn check(&self) -> Result<(), GeometryError> {
        let both = [
            ("proximal_kg", self.proximal_kg),
            ("distal_kg", self.distal_kg),
            ("tool_kg", [self.tool_kg; 2]),
            ("motor_kg_m2", self.motor_kg_m2),
        ];
        for (what, values) in both {
            for value in values {
                let least = if what == "motor_kg_m2" { f64::MIN_POSITIVE } else { 0.0 };
                if !(value >= least && value.is_finite()) {
                    return Err(GeometryError::Mass { what, value });
                }
            }
        }
        Ok(())
    }
}

/// The equations of motion at one state: `mass * joint acceleration + bias = joint torques`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dynamics {
    /// Tool point.
    pub tip: TipPoint,
    /// Its velocity.
    pub tip_velocity: TipVelocity,
    /// Its acceleration in m/s^2 while the joint accelerations are zero, `dJ/dt` times joint rates.
    pub tip_bias_m_per_s2: [f64; 2],
    /// Tool velocity per joint rate, in m/rad: row x, y; column left, right joint.
    pub jacobian: Matrix2<f64>,
    /// Mass matrix in kg m^2, symmetric and positive definite.
    pub mass: Matrix2<f64>,
    /// Coriolis and centrifugal torques.
    pub bias: JointTorques,
}

impl Dynamics {
    /// Joint torques that cause these joint accelerations at this state.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// If the result is not finite.
    pub fn torque_for(&self, acceleration_rad_per_s2: [f64; 2]) -> Result<JointTorques, LinkageError> {
        let torque = self.mass * Vector2::from(acceleration_rad_per_s2) + self.bias.0;
        finite_vector("joint torques in N m", torque).map(JointTorques)
    }
}

impl FiveBar {
    /// Returns the equations of motion at a state, exact for any links, masses and tool offset.
    ///
    /// A uniform rod between points with velocities a and b has the kinetic energy `m / 6 (a.a + a.b + b.b)`, so the
    /// rods need no angular velocities. Cost: that of closing the loop and some 150 products; rods without mass cost
    /// nothing.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// As [`forward`](Self::forward); joint rates that are not within [`RATE_LIMIT_RAD_PER_S`]; a mass model that
    /// [`MassModel::check`] refuses and that makes the result not finite or the mass matrix not positive definite.
    #[inline(always)]
    pub fn dynamics(
        &self,
        model: &MassModel,
        angles: JointAngles,
        rates: JointRates,
    ) -> Result<Dynamics, LinkageError> {
        self.dynamics_of(model, &self.close(angles)?, rates)
    }

    /// [`dynamics`](Self::dynamics) of a loop that is closed already.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// As [`dynamics`](Self::dynamics), but those of the angles.
    #[inline(always)]
    pub fn dynamics_of(
        &self,
        model: &MassModel,
        closure: &Closure,
        rates: JointRates,
    ) -> Result<Dynamics, LinkageError> {
        let [w0, w1] = rates.to_array();
        if !(w0.abs() <= RATE_LIMIT_RAD_PER_S && w1.abs() <= RATE_LIMIT_RAD_PER_S) {
            return Err(LinkageError::NotFinite { what: "joint rates in rad/s", values: [w0, w1] });
        }
        let transmission = closure.transmission();
        let tip_column = self.tip_columns(closure, &transmission);
        let tip_velocity = tip_column[0].scale(w0) + tip_column[1].scale(w1);
        let elbow_bias = [closure.proximal[0].scale(-w0 * w0), closure.proximal[1].scale(-w1 * w1)];
        let wrist_bias = wrist_bias(closure, &transmission, [w0, w1], elbow_bias);
        let tip_bias = self.at_tip(wrist_bias, elbow_bias[self.carrier.index()]);

        let mut sum = Sum::new(self.geometry.proximal_m, model);
        sum.add_point(model.tool_kg, tip_column, tip_bias);
        if model.distal_kg != [0.0; 2] {
            sum.add_distal_rods(model.distal_kg, closure, transmission.wrist_column, elbow_bias, wrist_bias);
        }
        let [[m00, m01], [_, m11]] = sum.mass;
        let determinant = m00 * m11 - m01 * m01;
        if !(determinant > 0.0 && m00 > 0.0 && determinant.is_finite()) {
            return Err(LinkageError::MassNotPositive { determinant });
        }
        let bias = finite_vector("Coriolis torques in N m", Vector2::from(sum.bias))?;
        Ok(Dynamics {
            tip: self.tip(closure).to_array().into(),
            tip_velocity: tip_velocity.to_array().into(),
            tip_bias_m_per_s2: tip_bias.to_array(),
            jacobian: matrix(tip_column),
            mass: Matrix2::new(m00, m01, m01, m11),
            bias: JointTorques(bias),
        })
    }

    /// Joint torques that cause these joint accelerations at a state: inverse dynamics for feed-forward.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// As [`dynamics`](Self::dynamics) and [`Dynamics::torque_for`].
    pub fn torque_for(
        &self,
        model: &MassModel,
        angles: JointAngles,
        rates: JointRates,
        acceleration_rad_per_s2: [f64; 2],
    ) -> Result<JointTorques, LinkageError> {
        self.dynamics(model, angles, rates)?.torque_for(acceleration_rad_per_s2)
    }
}

/// Acceleration of the wrist without joint accelerations. A distal link keeps its length, so along it the wrist's
/// acceleration is that of the elbow less the square of their relative velocity.
#[inline]
fn wrist_bias(closure: &Closure, transmission: &Transmission, rates: [f64; 2], elbow_bias: [Complex; 2]) -> Complex {
    let Transmission { dual, wrist_column } = transmission;
    let velocity = wrist_column[0].scale(rates[0]) + wrist_column[1].scale(rates[1]);
    let along = |i: usize| {
        let relative = velocity - closure.proximal[i].left().scale(rates[i]);
        closure.distal[i].dot(elbow_bias[i]) - relative.square()
    };
    dual[0].scale(along(0)) + dual[1].scale(along(1))
}

/// Mass matrix (its upper half) and bias, summed over the bodies.
struct Sum {
    mass: [[f64; 2]; 2],
    bias: [f64; 2],
}

impl Sum {
    /// Sums the parts that turn about a base joint: motor, proximal rod.
    #[inline]
    fn new(proximal_m: [f64; 2], model: &MassModel) -> Self {
        let about = |i: usize| model.motor_kg_m2[i] + model.proximal_kg[i] * proximal_m[i] * proximal_m[i] / 3.0;
        Self { mass: [[about(0), 0.0], [0.0, about(1)]], bias: [0.0; 2] }
    }

    /// A mass at a point with this Jacobian and this acceleration without joint accelerations.
    #[inline]
    fn add_point(&mut self, mass: f64, column: [Complex; 2], bias: Complex) {
        let weighed = [column[0].scale(mass), column[1].scale(mass)];
        self.mass[0][0] += weighed[0].dot(column[0]);
        self.mass[0][1] += weighed[0].dot(column[1]);
        self.mass[1][1] += weighed[1].dot(column[1]);
        self.bias[0] += weighed[0].dot(bias);
        self.bias[1] += weighed[1].dot(bias);
    }

    /// Both distal rods: a third of their masses at the wrist, a third at the elbows, a sixth between the two.
    #[inline]
    fn add_distal_rods(
        &mut self,
        mass: [f64; 2],
        closure: &Closure,
        column: [Complex; 2],
        elbow_bias: [Complex; 2],
        wrist_bias: Complex,
    ) {
        self.add_point((mass[0] + mass[1]) / 3.0, column, wrist_bias);
        // The elbows' accelerations towards the base joints do no work on the elbows themselves.
        self.mass[0][0] += mass[0] / 3.0 * closure.proximal[0].square();
        self.mass[1][1] += mass[1] / 3.0 * closure.proximal[1].square();
        let elbow = [closure.proximal[0].left().scale(mass[0] / 6.0), closure.proximal[1].left().scale(mass[1] / 6.0)];
        self.mass[0][0] += 2.0 * elbow[0].dot(column[0]);
        self.mass[0][1] += elbow[0].dot(column[1]) + elbow[1].dot(column[0]);
        self.mass[1][1] += 2.0 * elbow[1].dot(column[1]);
        let pull = elbow_bias[0].scale(mass[0] / 6.0) + elbow_bias[1].scale(mass[1] / 6.0);
        self.bias[0] += elbow[0].dot(wrist_bias) + column[0].dot(pull);
        self.bias[1] += elbow[1].dot(wrist_bias) + column[1].dot(pull);
    }
}
