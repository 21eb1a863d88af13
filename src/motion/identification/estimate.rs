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
    /// Creates a value with its standard error, which was estimated with so many degrees of freedom, at least 1.
    pub fn new(value: f64, standard_error: f64, degrees: f64) -> Self {
        let half = student(degrees) * standard_error;
        Self { value, low: value - half, high: value + half }
    }

    /// Returns the standard deviation of what these values were drawn from, each apart from the others, beside a line through them: what
    /// changes steadily is no scatter. `None` of fewer than three.
    pub fn scatter(values: &[f64]) -> Option<Self> {
        let degrees = values.len().checked_sub(2).filter(|degrees| *degrees > 0)?;
        let many = values.len() as f64;
        let (middle, mean) = (0.5 * (many - 1.0), values.iter().sum::<f64>() / many);
        let beside = || values.iter().enumerate().map(|(at, value)| [at as f64 - middle, value - mean]);
        let (spread, together) =
            beside().fold((0.0, 0.0), |(spread, together), [at, value]| (spread + at * at, together + at * value));
        let slope = together / spread;
        let squares: f64 = beside().map(|[at, value]| value - slope * at).map(|rest| rest * rest).sum();
        let [low, high] = chi_square(degrees);
        Some(Self {
            value: (squares / degrees as f64).sqrt(),
            low: (squares / high).sqrt(),
            high: (squares / low).sqrt(),
        })
    }

    /// Returns the half of the interval's width.
    pub fn half_width(&self) -> f64 {
        0.5 * (self.high - self.low)
    }

    /// Whether a value lies in the interval.
    pub fn contains(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

/// Returns the 97.5 % quantile of Student's t distribution, to 0.5 % for whole degrees of freedom.
///
/// # Source
/// Abramowitz, Stegun, *Handbook of Mathematical Functions* (1964), 26.7.5; below four degrees of freedom from its table 26.10, between whole
/// ones by a straight line, which is above the curve.
fn student(degrees: f64) -> f64 {
    const TABLE: [f64; 4] = [12.706, 4.303, 3.182, 2.776];
    let degrees = degrees.max(1.0);
    let whole = degrees.floor() as usize;
    if let [low, high, ..] = TABLE[(whole - 1).min(TABLE.len())..] {
        return low + (high - low) * (degrees - whole as f64);
    }
    let n = degrees;
    let z = |power| elementary::powi(NORMAL, power);
    NORMAL
        + (z(3) + z(1)) / (4.0 * n)
        + (5.0 * z(5) + 16.0 * z(3) + 3.0 * z(1)) / (96.0 * n * n)
        + (3.0 * z(7) + 19.0 * z(5) + 17.0 * z(3) - 15.0 * z(1)) / (384.0 * n * n * n)
}

/// Returns the 2.5 % and the 97.5 % quantile of the chi-square distribution, to 5 %.
///
/// # Source
/// Abramowitz, Stegun, *Handbook of Mathematical Functions* (1964), 26.4.17; below five degrees of freedom from its table 26.8.
fn chi_square(degrees: usize) -> [f64; 2] {
    match degrees {
        0 | 1 => [0.000_982, 5.024],
        2 => [0.0506, 7.378],
        3 => [0.2158, 9.348],
        4 => [0.4844, 11.143],
        _ => {
            let n = degrees as f64;
            let part = 2.0 / (9.0 * n);
            [-NORMAL, NORMAL].map(|z| n * elementary::powi(1.0 - part + z * part.sqrt(), 3))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_a_sum_of_squares_are_those_of_the_tables() {
        let table =
            [(1, 0.000_982, 5.024), (4, 0.4844, 11.143), (5, 0.8312, 12.833), (9, 2.700, 19.023), (100, 74.22, 129.56)];
        for (degrees, low, high) in table {
            let found = chi_square(degrees);
            assert!(
                (found[0] / low - 1.0).abs() < 0.05 && (found[1] / high - 1.0).abs() < 0.01,
                "{degrees}: {found:?}"
            );
        }
    }

    #[test]
    fn a_scatter_of_a_few_values_is_known_badly_and_a_steady_change_is_none() {
        assert_eq!(Estimate::scatter(&[1.0, 3.0]), None);
        let three = Estimate::scatter(&[1.0, 3.0, 2.0]).unwrap();
        assert!(three.low < 0.7 * three.value && three.high > 20.0 * three.value, "{three:?}");
        let many: Vec<f64> = (0..101).map(|at| f64::from(at % 2) + 7.0 * f64::from(at)).collect();
        let many = Estimate::scatter(&many).unwrap();
        assert!(many.contains(0.5) && many.half_width() < 0.08, "{many:?}");
    }

    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (degrees, quantile) in [(1, 12.706), (3, 3.182), (4, 2.776), (9, 2.262), (30, 2.042), (1000, 1.962)] {
            let found = student(f64::from(degrees));
            assert!((found / quantile - 1.0).abs() < 5e-3, "{degrees}: {found}");
        }
        let between: Vec<f64> = (2..80).map(|tenth| student(0.5 * f64::from(tenth))).collect();
        assert!(between.is_sorted_by(|fewer, more| fewer > more), "{between:?}");
    }
}
