//! Set-valued signum and saturation, the mathematics that fixtures, controllers and simulated friction share.
//!
//! # Source
//! \[KTF08, eqs 2 to 11, 56\].

use nalgebra::SVector;

/// Saturation of `x` to `[a, b]`, `a <= b`.
///
/// A NaN `x` gives NaN; with `a > b` (an empty interval) the result is `b` clamped from below by `a`'s branch, finite.
///
/// Real-time: yes.
///
/// # Source
/// \[KTF08, eq. 6\].
#[inline]
pub fn gsat(a: f64, x: f64, b: f64) -> f64 {
    if x > b {
        b
    } else if x < a {
        a
    } else {
        x
    }
}

/// Returns the interval `gsgn(a, x, b)` as its two ends: `[b, b]` for `x > 0`, `[a, a]` for `x < 0`, `[a, b]` at zero.
///
/// Real-time: yes.
///
/// # Source
/// \[KTF08, eq. 2\].
#[inline]
pub fn gsgn(a: f64, x: f64, b: f64) -> (f64, f64) {
    if x > 0.0 {
        (b, b)
    } else if x < 0.0 {
        (a, a)
    } else {
        (a, b)
    }
}

/// Returns `x` shortened to the length `limit >= 0` if it is longer; its direction is kept. A zero limit gives zero.
///
/// Real-time: yes.
///
/// # Source
/// \[KTF08, eq. 56\].
#[inline]
pub fn sat<const N: usize>(x: SVector<f64, N>, limit: f64) -> SVector<f64, N> {
    // Well within the limit nobody waits for a root and a quotient.
    if x.norm_squared() < 0.999 * (limit * limit) && limit > 0.0 {
        return x;
    }
    let length = x.norm();
    if length > limit { x * (limit / length) } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::elementary;
    use nalgebra::{Vector2, Vector3};
    use proptest::prelude::*;

    /// Whether `y` is in the closed interval.
    fn is_in(y: f64, (low, high): (f64, f64)) -> bool {
        y >= low && y <= high
    }

    /// Eighths: sums and differences are exact, so that set membership can be tested without a tolerance.
    fn eighth() -> impl Strategy<Value = f64> {
        (-80_i32..=80).prop_map(|count| f64::from(count) / 8.0)
    }

    /// Four numbers in order.
    fn ordered() -> impl Strategy<Value = [f64; 4]> {
        [eighth(), eighth(), eighth(), eighth()].prop_map(|mut limits| {
            limits.sort_by(f64::total_cmp);
            limits
        })
    }

    #[test]
    fn gsat_and_gsgn_at_their_ends() {
        assert_eq!([-3.0, -2.0, 0.5, 4.0, 5.0].map(|x| gsat(-2.0, x, 4.0)), [-2.0, -2.0, 0.5, 4.0, 4.0]);
        assert_eq!(gsat(1.0, 7.0, 1.0), 1.0);
        assert_eq!(gsat(-1.0, f64::INFINITY, 2.0), 2.0);
        assert!(gsat(-1.0, f64::NAN, 2.0).is_nan());
        assert_eq!(gsgn(-2.0, 1e-300, 4.0), (4.0, 4.0));
        assert_eq!(gsgn(-2.0, -1e-300, 4.0), (-2.0, -2.0));
        assert_eq!(gsgn(-2.0, -0.0, 4.0), (-2.0, 4.0));
    }

    #[test]
    fn sat_shortens_and_keeps_the_direction() {
        assert_eq!(sat(Vector2::new(3.0, 4.0), 5.0), Vector2::new(3.0, 4.0));
        assert_eq!(sat(Vector2::new(3.0, 4.0), 2.5), Vector2::new(1.5, 2.0));
        assert_eq!(sat(Vector2::new(3.0, 4.0), 0.0), Vector2::zeros());
        assert_eq!(sat(Vector3::zeros(), 0.0), Vector3::<f64>::zeros());
    }

    proptest! {
        /// Rule (7): `y = gsgn(a, x - y, b)` exactly when `y = gsat(a, x, b)`.
        #[test]
        fn rule_7(x in eighth(), y in eighth(), [a, b, ..] in ordered()) {
            prop_assert_eq!(is_in(y, gsgn(a, x - y, b)), y == gsat(a, x, b));
            let solution = gsat(a, x, b);
            prop_assert!(is_in(solution, gsgn(a, x - solution, b)));
        }

        /// Rules (8) and (9): likewise with inequalities, read as in (4) and (5).
        #[test]
        fn rules_8_and_9(x in eighth(), y in eighth(), [a, b, ..] in ordered()) {
            let z = x - y;
            prop_assert_eq!((y > b && z >= 0.0) || (y > a && z < 0.0), y > gsat(a, x, b));
            prop_assert_eq!((y < b && z > 0.0) || (y < a && z <= 0.0), y < gsat(a, x, b));
        }

        /// Rule (10), with `k` a power of two to stay exact.
        #[test]
        fn rule_10(x in eighth(), y in eighth(), [a, b, ..] in ordered(), exponent in -3_i32..=3) {
            let k = elementary::powi(2.0, exponent);
            let z = y + gsat(a / k, x - y, b / k);
            prop_assert!(is_in(k * (z - y), gsgn(a, x - z, b)));
        }

        /// Rule (11): the nested form that a fixture on a line solves.
        #[test]
        fn rule_11(x in eighth(), y in eighth(), [a, b, c, d] in ordered(), exponent in -3_i32..=3) {
            let k = elementary::powi(2.0, exponent);
            let z = y + gsat(gsat(a / k, -y, b / k), x - y, gsat(c / k, -y, d / k));
            let (least, most) = if x > z {
                gsgn(c, -z, d)
            } else if x < z {
                gsgn(a, -z, b)
            } else {
                (gsgn(a, -z, b).0, gsgn(c, -z, d).1)
            };
            prop_assert!(is_in(k * (z - y), (least, most)), "{} not in {least} to {most}", k * (z - y));
        }

        /// `sat` is the nearest point of a ball: no longer than the limit, along the vector, unchanged inside.
        #[test]
        fn sat_is_the_nearest_point_of_a_ball(x in [-1e3_f64..1e3, -1e3..1e3, -1e3..1e3], limit in 0.0_f64..1e3) {
            let x = Vector3::from(x);
            let short = sat(x, limit);
            prop_assert!(short.norm() <= limit * (1.0 + 4.0 * f64::EPSILON) || short == x);
            prop_assert!((short.norm() - x.norm().min(limit)).abs() <= 1e-12 * x.norm());
            prop_assert!(short.cross(&x).norm() <= 1e-12 * x.norm_squared());
            prop_assert!(short.dot(&x) >= 0.0);
        }
    }
}
