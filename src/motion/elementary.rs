//! Elementary functions with the same bits on every processor and with every C library.
//!
//! The functions of the standard library are those of the C library or of the compiler. Their last bits depend on the processor (with or
//! without fused multiply-add) and on the version. The functions here are compositions of additions, products, quotients and square roots,
//! which IEEE 754 fixes to the last bit: a recording replays elsewhere bit for bit. `clippy.toml` forbids the others everywhere in this
//! workspace. Functions that IEEE 754 fixes stay with the standard library: `sqrt`, `abs`, `floor`, `round`, `rem_euclid`, conversions, and
//! printing and reading of decimals.
//!
//! Angles are in rad. Errors are below 2 units in the last place unless a function says otherwise. A NaN gives NaN.
//!
//! Real-time: yes, all of them: no allocation, and loops with a bound.
//!
//! # Source
//! The crate `libm`, a translation of musl's functions.

/// Returns sine and cosine of an angle; NaN for an infinite one.
#[inline]
pub fn sin_cos(angle_rad: f64) -> (f64, f64) {
    libm::sincos(angle_rad)
}

/// Returns the sine of an angle; NaN for an infinite one.
#[inline]
pub fn sin(angle_rad: f64) -> f64 {
    libm::sin(angle_rad)
}

/// Returns the cosine of an angle; NaN for an infinite one.
#[inline]
pub fn cos(angle_rad: f64) -> f64 {
    libm::cos(angle_rad)
}

/// Returns the angle from -pi/2 to pi/2 with this sine; NaN outside -1 to 1.
#[inline]
pub fn asin(sine: f64) -> f64 {
    libm::asin(sine)
}

/// Returns the angle from 0 to pi with this cosine; NaN outside -1 to 1.
#[inline]
pub fn acos(cosine: f64) -> f64 {
    libm::acos(cosine)
}

/// Returns the angle of the vector `(x, y)` from the x axis, from -pi to pi; 0 or ±pi for a vector of zeros, by their signs.
#[inline]
pub fn atan2(y: f64, x: f64) -> f64 {
    libm::atan2(y, x)
}

/// Returns `sqrt(x^2 + y^2)`, without overflow or underflow where only the squares have one; infinite if either is infinite, be the
/// other NaN.
#[inline]
pub fn hypot(x: f64, y: f64) -> f64 {
    libm::hypot(x, y)
}

/// Returns `e^x`; infinite above 709.8, zero below -745.2.
#[inline]
pub fn exp(x: f64) -> f64 {
    libm::exp(x)
}

/// Returns `e^x - 1`, exact to the last places near zero as well.
#[inline]
pub fn exp_m1(x: f64) -> f64 {
    libm::expm1(x)
}

/// Returns the natural logarithm; minus infinity at zero, NaN below.
#[inline]
pub fn ln(x: f64) -> f64 {
    libm::log(x)
}

/// Returns the decimal logarithm; minus infinity at zero, NaN below.
#[inline]
pub fn log10(x: f64) -> f64 {
    libm::log10(x)
}

/// Returns the hyperbolic sine.
#[inline]
pub fn sinh(x: f64) -> f64 {
    libm::sinh(x)
}

/// Returns the hyperbolic cosine.
#[inline]
pub fn cosh(x: f64) -> f64 {
    libm::cosh(x)
}

/// Returns the hyperbolic tangent.
#[inline]
pub fn tanh(x: f64) -> f64 {
    libm::tanh(x)
}

/// Returns `base^exponent`; NaN for a negative base with an exponent that is no integer; 1 for an exponent of zero.
#[inline]
pub fn powf(base: f64, exponent: f64) -> f64 {
    libm::pow(base, exponent)
}

/// Returns `base^exponent` by squaring, with the products in this order; of a negative exponent the reciprocal of the power.
///
/// Each product rounds: with an exponent of `n` the error is below `n` units in the last place. At most 32 turns.
#[inline]
pub fn powi(base: f64, exponent: i32) -> f64 {
    let (mut power, mut square, mut left) = (1.0, base, exponent.unsigned_abs());
    while left > 1 {
        if left % 2 == 1 {
            power *= square;
        }
        square *= square;
        left /= 2;
    }
    if left == 1 {
        power *= square;
    }
    if exponent < 0 { 1.0 / power } else { power }
}
