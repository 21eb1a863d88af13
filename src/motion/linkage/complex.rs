//! Planar vectors as complex numbers: to turn and scale a vector is one product, which is what the tool's offset and
//! the triangles of the linkage need.

use crate::elementary;
use std::ops::{Add, Mul, Sub};

/// `re + i im`: the vector with x = `re` and y = `im`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Complex {
    pub(super) re: f64,
    pub(super) im: f64,
}

impl Complex {
    #[inline]
    pub(super) const fn new(re: f64, im: f64) -> Self {
        Self { re, im }
    }

    /// Returns the vector of the given length at the given angle.
    #[inline]
    pub(super) fn polar(length: f64, angle_rad: f64) -> Self {
        let (sine, cosine) = elementary::sin_cos(angle_rad);
        Self::new(length * cosine, length * sine)
    }

    /// The vector turned left by a quarter turn, `i z`.
    #[inline]
    pub(super) fn left(self) -> Self {
        Self::new(-self.im, self.re)
    }

    #[inline]
    pub(super) fn scale(self, factor: f64) -> Self {
        Self::new(self.re * factor, self.im * factor)
    }

    #[inline]
    pub(super) fn dot(self, other: Self) -> f64 {
        self.re * other.re + self.im * other.im
    }

    /// Positive if `other` lies to the left of `self`.
    #[inline]
    pub(super) fn cross(self, other: Self) -> f64 {
        self.re * other.im - self.im * other.re
    }

    #[inline]
    pub(super) fn square(self) -> f64 {
        self.dot(self)
    }

    /// Length, without overflow where the square would have one.
    pub(super) fn length(self) -> f64 {
        elementary::hypot(self.re, self.im)
    }

    pub(super) fn angle_rad(self) -> f64 {
        elementary::atan2(self.im, self.re)
    }

    /// Returns `1 / z`; the caller keeps `z` away from zero.
    pub(super) fn inverse(self) -> Self {
        let square = self.square();
        Self::new(self.re / square, -self.im / square)
    }

    #[inline]
    pub(super) fn to_array(self) -> [f64; 2] {
        [self.re, self.im]
    }
}

impl From<[f64; 2]> for Complex {
    #[inline]
    fn from([re, im]: [f64; 2]) -> Self {
        Self::new(re, im)
    }
}

impl Add for Complex {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        Self::new(self.re + other.re, self.im + other.im)
    }
}

impl Sub for Complex {
    type Output = Self;
    #[inline]
    fn sub(self, other: Self) -> Self {
        Self::new(self.re - other.re, self.im - other.im)
    }
}

impl Mul for Complex {
    type Output = Self;
    #[inline]
    fn mul(self, other: Self) -> Self {
        Self::new(self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re)
    }
}
