//! Between the sensor frame, which turns with a link, and the base frame.

use crate::elementary;
use nalgebra::{UnitComplex, Vector6};

use super::Wrench;
use super::error::SensingError;
use crate::quantity::Force;

/// The link that the sensor turns with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MountedOn {
    /// Fixed to the table: does not turn.
    Base,
    /// The left arm's distal link.
    LeftDistal,
    /// The right arm's distal link.
    RightDistal,
}

/// Mounting of the sensor on its link. Its z axis points up as the base frame's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mounting {
    link: MountedOn,
    /// From the link's direction to the sensor's x axis.
    rotation: UnitComplex<f64>,
}

impl Mounting {
    /// Creates a sensor whose x axis stands at `angle_rad`, counter-clockwise, from the direction of this link.
    ///
    /// # Errors
    /// [`SensingError::OutOfRange`] if the angle is not finite.
    pub fn new(link: MountedOn, angle_rad: f64) -> Result<Self, SensingError> {
        if !angle_rad.is_finite() {
            return Err(SensingError::OutOfRange { name: "mounting angle", value: angle_rad, requirement: "finite" });
        }
        let (sin, cos) = elementary::sin_cos(angle_rad);
        Ok(Self { link, rotation: UnitComplex::from_cos_sin_unchecked(cos, sin) })
    }

    /// Returns the rotation of the link it sits on, out of those of the left and right distal link from the base frame's x axis;
    /// none on the base.
    ///
    /// Real-time: yes.
    pub fn link_rotation(&self, distal_rotations: [UnitComplex<f64>; 2]) -> UnitComplex<f64> {
        let [left, right] = distal_rotations;
        match self.link {
            MountedOn::Base => UnitComplex::identity(),
            MountedOn::LeftDistal => left,
            MountedOn::RightDistal => right,
        }
    }

    /// Returns the planar force of a sensor-frame wrench in the base frame, N, with the link turned by `link` from the base frame's
    /// x axis.
    ///
    /// Real-time: yes.
    #[inline]
    pub fn to_base(&self, wrench: &Wrench, link: UnitComplex<f64>) -> Force {
        Force(link * self.rotation * wrench.0.xy())
    }

    /// Returns the sensor-frame wrench of a planar force in the base frame (N) and a torque about z (N m), with the link turned by `link`.
    /// This is the inverse of [`Mounting::to_base`], with nothing out of the plane.
    ///
    /// Real-time: yes.
    pub fn to_sensor(&self, force: Force, torque_z_n_m: f64, link: UnitComplex<f64>) -> Wrench {
        let planar = (link * self.rotation).inverse_transform_vector(&force.0);
        Wrench(Vector6::new(planar.x, planar.y, 0.0, 0.0, 0.0, torque_z_n_m))
    }
}
