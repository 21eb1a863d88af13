//! Exponential of a matrix, with the same bits everywhere.

use nalgebra::SMatrix;

/// Terms of the series: with a norm of at most 1/2 the next one is below 1e-19.
const TERMS: u32 = 15;

/// Returns `e^A` by scaling and squaring: `(e^(A / 2^s))^(2^s)` with the least `s` that brings the greatest column sum to 1/2.
///
/// Relative to the greatest entry the error is about `2^s` roundings. Entries that are not finite give no finite matrix.
pub(super) fn exponential<const N: usize>(matrix: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    let sums = matrix.column_iter().map(|column| column.iter().map(|entry| entry.abs()).sum());
    let (mut norm, mut scaled, mut squarings) = (sums.fold(0.0, f64::max), *matrix, 0);
    while norm > 0.5 && norm.is_finite() {
        norm *= 0.5;
        scaled *= 0.5;
        squarings += 1;
    }
    // Horner's scheme: 1 + A (1 + A/2 (1 + A/3 (...))).
    let mut power = SMatrix::identity();
    for term in (1..=TERMS).rev() {
        power = SMatrix::identity() + scaled * power / f64::from(term);
    }
    (0..squarings).fold(power, |power, _| power * power)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Matrix3};
    use proptest::prelude::*;

    use super::*;
    use crate::elementary;

    proptest! {
        /// A damped turn, and the steady push of a decay, both known in closed form.
        #[test]
        fn is_that_of_turns_and_decays(decay in -3.0..30.0_f64, turn in -30.0..30.0_f64, push in -10.0..10.0_f64) {
            let (sin, cos) = elementary::sin_cos(turn);
            let found = exponential(&Matrix2::new(-decay, -turn, turn, -decay));
            let expected = elementary::exp(-decay) * Matrix2::new(cos, -sin, sin, cos);
            prop_assert!((found - expected).norm() < 1e-13 * elementary::exp(decay.abs()).min(1e3), "{found} {expected}");
            let found = exponential(&Matrix3::new(-decay, 0.0, push, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0));
            let reached = if decay == 0.0 { push } else { -elementary::exp_m1(-decay) / decay * push };
            prop_assert!((found.m13 - reached).abs() < 1e-13 * elementary::exp((-decay).max(0.0)) * push.abs().max(1.0));
            prop_assert!(found.m33 == 1.0 && found.m31 == 0.0);
        }
    }

    #[test]
    fn what_is_not_finite_gives_nothing_finite() {
        for entry in [f64::NAN, f64::INFINITY] {
            assert!(!exponential(&Matrix2::new(entry, 0.0, 0.0, 0.0)).m11.is_finite());
        }
    }
}
