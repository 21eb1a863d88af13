//! Between the sensor frame, which turns with a link, and the base frame.

use crate::elementary;
use nalgebra::Vector6;

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

/// How the sensor sits on its link: its x axis stands at `angle_rad`, counter-clockwise, from the link's direction; its z
/// axis points up as the base frame's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mounting {
    /// The link.
    pub link: MountedOn,
    /// Sensor x axis against the link, rad.
    pub angle_rad: f64,
}

impl Mounting {
    /// This mounting, if its angle is finite.
    ///
    /// # Errors
    /// [`SensingError::OutOfRange`].
    pub fn checked(self) -> Result<Self, SensingError> {
        if self.angle_rad.is_finite() {
            Ok(self)
        } else {
            let value = self.angle_rad;
            Err(SensingError::OutOfRange { name: "mounting angle", value, requirement: "finite" })
        }
    }

    /// The angle of the link it sits on, out of those of the left and right distal link in rad against the base frame's
    /// x axis; zero on the base.
    ///
    /// Real-time: yes.
    pub fn link_angle_rad(&self, distal_angles_rad: [f64; 2]) -> f64 {
        let [left, right] = distal_angles_rad;
        match self.link {
            MountedOn::Base => 0.0,
            MountedOn::LeftDistal => left,
            MountedOn::RightDistal => right,
        }
    }

    /// The planar force of a sensor-frame wrench in the base frame, N, with the link at `link_angle_rad`.
    ///
    /// Real-time: yes.
    #[inline]
    pub fn to_base(&self, wrench: &Wrench, link_angle_rad: f64) -> Force {
        let (sin, cos) = elementary::sin_cos(link_angle_rad + self.angle_rad);
        let (x, y) = (wrench.0.x, wrench.0.y);
        Force::new(cos * x - sin * y, sin * x + cos * y)
    }

    /// The sensor-frame wrench of a planar force in the base frame (N) and a torque about z (N m), with the link at
    /// `link_angle_rad`: the inverse of [`Mounting::to_base`], with nothing out of the plane.
    ///
    /// Real-time: yes.
    pub fn to_sensor(&self, force: Force, torque_z_n_m: f64, link_angle_rad: f64) -> Wrench {
        let (sin, cos) = elementary::sin_cos(link_angle_rad + self.angle_rad);
        let [x, y] = force.to_array();
        Wrench(Vector6::new(cos * x + sin * y, cos * y - sin * x, 0.0, 0.0, 0.0, torque_z_n_m))
    }
}
