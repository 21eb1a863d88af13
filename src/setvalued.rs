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

/// The interval `gsgn(a, x, b)` as its two ends: `[b, b]` for `x > 0`, `[a, a]` for `x < 0`, `[a, b]` at zero.
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

/// `x` shortened to the length `limit >= 0` if it is longer; its direction is kept. A zero limit gives zero.
///
/// Real-time: yes.
///
/// # Source
/// \[KTF08, eq. 56\].
#[inline]
pub fn sat<const N: usize>(x: SVector<f64, N>, limit: f64) -> SVector<f64, N> {
    let length = x.norm();
    if length > limit { x * (limit / length) } else { x }
}
