use super::complex::Complex;
use super::error::LinkageError;
use super::geometry::Side;
use crate::elementary;
use crate::quantity::{Force, JointAngles, JointRates, JointTorques, TipPoint, TipVelocity};
use nalgebra::{Matrix2, UnitComplex, Vector2};

/// Condition number at which a Jacobian counts as singular; [`Posture::condition`] is never larger.
pub const CONDITION_LIMIT: f64 = 1e9;

/// The linkage at one pair of joint angles: where its points are and how the tool moves with the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// The joint angles.
    pub angles: JointAngles,
    /// Tool point.
    pub tip: TipPoint,
    /// Wrist in m, base frame.
    pub wrist_m: [f64; 2],
    /// Elbows, left then right, in m, base frame.
    pub elbows_m: [[f64; 2]; 2],
    /// Rotations from the base frame's x axis to the distal links, elbow to wrist, left then right.
    pub distal_rotation: [UnitComplex<f64>; 2],
    /// The sides on which the elbows lie, by the rule of [`Side`].
    pub elbow_sides: [Side; 2],
    /// Tool velocity per joint rate, in m/rad: row x, y; column left, right joint.
    pub jacobian: Matrix2<f64>,
}

impl Posture {
    /// Tool velocity at these joint rates.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// If the result is not finite.
    pub fn tip_velocity(&self, rates: JointRates) -> Result<TipVelocity, LinkageError> {
        finite_vector("tool velocity in m/s", self.jacobian * rates.0).map(TipVelocity)
    }

    /// Joint torques that do the same work as a force on the tool point, `J^T f`.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// If the result is not finite.
    pub fn joint_torques(&self, force: Force) -> Result<JointTorques, LinkageError> {
        finite_vector("joint torques in N m", self.jacobian.tr_mul(&force.0)).map(JointTorques)
    }

    /// Joint rates that move the tool with this velocity.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// Where the condition number reaches [`CONDITION_LIMIT`] (type 1), or if the result is not finite.
    pub fn joint_rates(&self, velocity: TipVelocity) -> Result<JointRates, LinkageError> {
        let (largest_m, smallest_m) = self.singular_values_m();
        if smallest_m * CONDITION_LIMIT <= largest_m {
            return Err(LinkageError::JacobianSingular { smallest_m, largest_m });
        }
        let j = &self.jacobian;
        let adjugate = Matrix2::new(j.m22, -j.m12, -j.m21, j.m11);
        finite_vector("joint rates in rad/s", adjugate * velocity.0 / j.determinant()).map(JointRates)
    }

    /// Returns the smallest singular value of the Jacobian in m: the tool speed in its slowest direction at a joint rate of
    /// 1 rad/s. Zero at type 1.
    ///
    /// Real-time: yes.
    pub fn smallest_singular_value(&self) -> f64 {
        self.singular_values_m().1
    }

    /// Returns the largest over smallest singular value of the Jacobian, from 1 to [`CONDITION_LIMIT`].
    ///
    /// Real-time: yes.
    pub fn condition(&self) -> f64 {
        let (largest, smallest) = self.singular_values_m();
        if smallest * CONDITION_LIMIT <= largest { CONDITION_LIMIT } else { largest / smallest }
    }

    /// Returns the largest and smallest singular value. The smallest comes from the determinant, since the difference of two
    /// nearly equal numbers would lose it near a singularity.
    fn singular_values_m(&self) -> (f64, f64) {
        let j = &self.jacobian;
        let turn = elementary::hypot(j.m11 + j.m22, j.m21 - j.m12);
        let flip = elementary::hypot(j.m11 - j.m22, j.m12 + j.m21);
        let largest = 0.5 * (turn + flip);
        if largest > 0.0 { (largest, j.determinant().abs() / largest) } else { (0.0, 0.0) }
    }
}

/// Matrix of two columns.
#[inline]
pub(super) fn matrix([left, right]: [Complex; 2]) -> Matrix2<f64> {
    Matrix2::new(left.re, right.re, left.im, right.im)
}

/// Returns the vector, or an error that names it if a component is not finite.
#[inline]
pub(super) fn finite_vector(what: &'static str, vector: Vector2<f64>) -> Result<Vector2<f64>, LinkageError> {
    if vector.x.is_finite() && vector.y.is_finite() {
        Ok(vector)
    } else {
        Err(LinkageError::NotFinite { what, values: [vector.x, vector.y] })
    }
}
