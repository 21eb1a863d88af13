//! Vectors that must not be mixed: planar, SI, in the base frame or in joint space.
//!
//! The base frame is right-handed, fixed to the table, x to the right and y away from the base joints. Joint vectors
//! list the left arm (index 0) before the right arm (index 1); angles are measured from the base frame's x axis,
//! counter-clockwise positive.
//!
//! Sums and multiples are there where they mean something: two forces have a sum, two points have not. The way between two points is
//! a [`TipDisplacement`], and what is gone in a time is a [`TipVelocity`] or [`JointRates`]. The vector itself, the only field, is for linear
//! algebra: Jacobians, mass matrices and the surfaces of the fixture, which are the same in space.
//!
//! Real-time: yes, all of it.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use nalgebra::Vector2;

macro_rules! planar {
    ($(#[$doc:meta])* $name:ident, $first:ident $first_doc:literal, $second:ident $second_doc:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct $name(pub Vector2<f64>);

        impl $name {
            /// From its two components.
            pub const fn new(first: f64, second: f64) -> Self {
                Self(Vector2::new(first, second))
            }

            #[doc = $first_doc]
            pub fn $first(self) -> f64 {
                self.0.x
            }

            #[doc = $second_doc]
            pub fn $second(self) -> f64 {
                self.0.y
            }

            /// Whether both components are finite.
            pub fn is_finite(&self) -> bool {
                self.0.x.is_finite() && self.0.y.is_finite()
            }

            /// Returns the two components as an array.
            pub fn to_array(self) -> [f64; 2] {
                [self.0.x, self.0.y]
            }

            /// Euclidean norm; of a point its distance from the origin of the base frame.
            pub fn norm(self) -> f64 {
                self.0.norm()
            }
        }

        impl From<[f64; 2]> for $name {
            fn from([first, second]: [f64; 2]) -> Self {
                Self::new(first, second)
            }
        }
    };
}

/// A [`planar!`] whose values have sums and multiples.
macro_rules! linear {
    ($(#[$doc:meta])* $name:ident, $($component:tt)*) => {
        planar!($(#[$doc])* $name, $($component)*);

        impl $name {
            /// Returns the greater of the two components, both without their sign.
            pub fn max_abs(self) -> f64 {
                self.0.amax()
            }

            /// Each component by itself.
            #[must_use]
            pub fn map(self, of_each: impl FnMut(f64) -> f64) -> Self {
                Self(self.0.map(of_each))
            }

            /// Scalar product.
            pub fn dot(self, other: Self) -> f64 {
                self.0.dot(&other.0)
            }
        }

        impl Add for $name {
            type Output = Self;

            fn add(self, other: Self) -> Self {
                Self(self.0 + other.0)
            }
        }

        impl Sub for $name {
            type Output = Self;

            fn sub(self, other: Self) -> Self {
                Self(self.0 - other.0)
            }
        }

        impl Neg for $name {
            type Output = Self;

            fn neg(self) -> Self {
                Self(-self.0)
            }
        }

        impl Mul<f64> for $name {
            type Output = Self;

            fn mul(self, factor: f64) -> Self {
                Self(self.0 * factor)
            }
        }

        impl Div<f64> for $name {
            type Output = Self;

            fn div(self, divisor: f64) -> Self {
                Self(self.0 / divisor)
            }
        }

        impl AddAssign for $name {
            fn add_assign(&mut self, other: Self) {
                self.0 += other.0;
            }
        }

        impl SubAssign for $name {
            fn sub_assign(&mut self, other: Self) {
                self.0 -= other.0;
            }
        }
    };
}

linear!(
    /// Force on the tool in N, base frame. Unless said otherwise: from the hand on the tool (`h` of the paper).
    Force, x "Along x, to the right.", y "Along y, away from the base joints."
);
planar!(
    /// Position of a point of the tool or of the proxy in m, base frame.
    TipPoint, x "Along x, to the right.", y "Along y, away from the base joints."
);
linear!(
    /// The way from one [`TipPoint`] to another in m, base frame.
    TipDisplacement, x "Along x, to the right.", y "Along y, away from the base joints."
);
linear!(
    /// Velocity of the tool or of the proxy in m/s, base frame.
    TipVelocity, x "Along x, to the right.", y "Along y, away from the base joints."
);
linear!(
    /// Angles of the two proximal links in rad, or the way from such angles to others.
    JointAngles, left "At the left joint.", right "At the right joint."
);
linear!(
    /// Rates of the two proximal links in rad/s.
    JointRates, left "At the left joint.", right "At the right joint."
);
linear!(
    /// Torques on the two proximal links in N m, positive in the direction of the angle.
    JointTorques, left "At the left joint.", right "At the right joint."
);

impl Sub for TipPoint {
    type Output = TipDisplacement;

    fn sub(self, from: Self) -> TipDisplacement {
        TipDisplacement(self.0 - from.0)
    }
}

impl Add<TipDisplacement> for TipPoint {
    type Output = Self;

    fn add(self, by: TipDisplacement) -> Self {
        Self(self.0 + by.0)
    }
}

impl Sub<TipDisplacement> for TipPoint {
    type Output = Self;

    fn sub(self, by: TipDisplacement) -> Self {
        Self(self.0 - by.0)
    }
}

impl AddAssign<TipDisplacement> for TipPoint {
    fn add_assign(&mut self, by: TipDisplacement) {
        self.0 += by.0;
    }
}

impl TipDisplacement {
    /// Returns the mean velocity of what is displaced so in `time_s`.
    pub fn over_s(self, time_s: f64) -> TipVelocity {
        TipVelocity(self.0 / time_s)
    }
}

impl TipVelocity {
    /// Returns the displacement in `time_s`.
    pub fn for_s(self, time_s: f64) -> TipDisplacement {
        TipDisplacement(self.0 * time_s)
    }
}

impl JointAngles {
    /// Returns the mean rates of joints that turn so far in `time_s`.
    pub fn over_s(self, time_s: f64) -> JointRates {
        JointRates(self.0 / time_s)
    }
}

impl JointRates {
    /// Returns the angles through which they turn the joints in `time_s`.
    pub fn for_s(self, time_s: f64) -> JointAngles {
        JointAngles(self.0 * time_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pair() -> impl Strategy<Value = [f64; 2]> {
        [-1e3..1e3_f64, -1e3..1e3_f64]
    }

    proptest! {
        /// Whoever computed with the vectors themselves has the same bits now.
        #[test]
        fn operators_are_those_of_the_vectors(a in pair(), b in pair(), by in 1e-3..1e3_f64) {
            let (u, v) = (Vector2::from(a), Vector2::from(b));
            let (f, g) = (Force::from(a), Force::from(b));
            let (mut more, mut less) = (f, f);
            more += g;
            less -= g;
            let pairs = [(f + g, u + v), (f - g, u - v), (-f, -u), (f * by, u * by), (f / by, u / by), (more, u + v), (less, u - v)];
            for (typed, vector) in pairs {
                prop_assert_eq!(typed.to_array().map(f64::to_bits), <[f64; 2]>::from(vector).map(f64::to_bits));
            }
            prop_assert_eq!([f.norm(), f.max_abs(), f.dot(g)].map(f64::to_bits), [u.norm(), u.amax(), u.dot(&v)].map(f64::to_bits));
            let (p, q) = (TipPoint::from(a), TipPoint::from(b));
            prop_assert_eq!((p - q).over_s(by).0, (u - v) / by);
            prop_assert_eq!((p + TipVelocity::from(b).for_s(by)).0, u + v * by);
            prop_assert_eq!((JointAngles::from(a) - JointAngles::from(b)).over_s(by).0, (u - v) / by);
        }
    }

    #[test]
    fn components_have_the_names_of_their_frame() {
        assert_eq!((Force::new(1.0, 2.0).x(), TipVelocity::new(1.0, 2.0).y()), (1.0, 2.0));
        assert_eq!((JointAngles::new(1.0, 2.0).left(), JointTorques::new(1.0, 2.0).right()), (1.0, 2.0));
        assert_eq!(Force::new(1.0, 2.0).dot(Force::new(3.0, -4.0)), -5.0);
        assert_eq!(JointRates::new(1.5, -2.5).map(f64::trunc), JointRates::new(1.0, -2.0));
        let mut point = TipPoint::new(1.0, 2.0);
        point += TipDisplacement::new(0.5, 0.0);
        assert_eq!(point - TipDisplacement::new(0.5, 1.0), TipPoint::new(1.0, 1.0));
        assert_eq!(JointAngles::new(1.0, -1.0).over_s(0.5).for_s(2.0), JointAngles::new(4.0, -4.0));
    }
}
