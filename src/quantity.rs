//! Vectors that must not be mixed: planar, SI, in the base frame or in joint space.
//!
//! The base frame is right-handed, fixed to the table, x to the right and y away from the base joints. Joint vectors
//! list the left arm (index 0) before the right arm (index 1); angles are measured from the base frame's x axis,
//! counter-clockwise positive.

use nalgebra::Vector2;

macro_rules! planar {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct $name(pub Vector2<f64>);

        impl $name {
            /// From its two components.
            pub const fn new(first: f64, second: f64) -> Self {
                Self(Vector2::new(first, second))
            }

            /// Whether both components are finite.
            pub fn is_finite(&self) -> bool {
                self.0.x.is_finite() && self.0.y.is_finite()
            }

            /// The two components as an array.
            pub fn to_array(self) -> [f64; 2] {
                [self.0.x, self.0.y]
            }
        }

        impl From<[f64; 2]> for $name {
            fn from([first, second]: [f64; 2]) -> Self {
                Self::new(first, second)
            }
        }
    };
}

planar!(
    /// Force on the tool in N, base frame. Unless said otherwise: from the hand on the tool (`h` of the paper).
    Force
);
planar!(
    /// Position of a point of the tool or of the proxy in m, base frame.
    TipPoint
);
planar!(
    /// Velocity of the tool or of the proxy in m/s, base frame.
    TipVelocity
);
planar!(
    /// Angles of the two proximal links in rad.
    JointAngles
);
planar!(
    /// Rates of the two proximal links in rad/s.
    JointRates
);
planar!(
    /// Torques on the two proximal links in N m, positive in the direction of the angle.
    JointTorques
);
