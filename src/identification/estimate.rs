//! A value with its interval.

use crate::elementary;

/// 97.5 % of the standard normal distribution lie below.
const NORMAL: f64 = 1.959_963_984_540_054;

/// A value, and between what it lies with 95 % confidence if the errors are independent and normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Estimate {
    /// A value with its standard error, which was estimated with so many degrees of freedom, at least 1.
    pub fn new(value: f64, standard_error: f64, degrees: usize) -> Self {
        let half = student(degrees) * standard_error;
        Self { value, low: value - half, high: value + half }
    }

    /// Half of the interval's width.
    pub fn half_width(&self) -> f64 {
        0.5 * (self.high - self.low)
    }

    /// Whether a value lies in the interval.
    pub fn contains(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

/// The 97.5 % quantile of Student's t distribution, to 0.5 %.
///
/// # Source
/// Abramowitz, Stegun, *Handbook of Mathematical Functions* (1964), 26.7.5; below four degrees of freedom from its table 26.10.
fn student(degrees: usize) -> f64 {
    match degrees {
        0 | 1 => 12.706,
        2 => 4.303,
        3 => 3.182,
        _ => {
            let (n, z) = (degrees as f64, NORMAL);
            let z = |power| elementary::powi(z, power);
            NORMAL
                + (z(3) + z(1)) / (4.0 * n)
                + (5.0 * z(5) + 16.0 * z(3) + 3.0 * z(1)) / (96.0 * n * n)
                + (3.0 * z(7) + 19.0 * z(5) + 17.0 * z(3) - 15.0 * z(1)) / (384.0 * n * n * n)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (degrees, quantile) in [(1, 12.706), (3, 3.182), (4, 2.776), (9, 2.262), (30, 2.042), (1000, 1.962)] {
            assert!((student(degrees) / quantile - 1.0).abs() < 5e-3, "{degrees}: {}", student(degrees));
        }
    }
}
