//! Whether all roots of a polynomial lie inside the unit circle.

/// Returns the product of two polynomials, coefficients from the constant term up.
pub(super) fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; (a.len() + b.len()).saturating_sub(1)];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            out[i + j] += x * y;
        }
    }
    out
}

/// Returns `a + factor b`, coefficients from the constant term up.
pub(super) fn sum(a: &[f64], factor: f64, b: &[f64]) -> Vec<f64> {
    let at = |p: &[f64], i: usize| p.get(i).copied().unwrap_or(0.0);
    (0..a.len().max(b.len())).map(|i| at(a, i) + factor * at(b, i)).collect()
}

/// Whether every root `z` of a polynomial in `d = z - 1` lies strictly inside the unit circle. Coefficients from the
/// constant term up; a constant has no roots and is stable. A coefficient that is not finite is not stable.
///
/// A sampled servo has all its slow poles close to `z = 1`. In powers of `z` their distances from it drown in rounding;
/// in powers of `d` they are the coefficients. `w = d/(2 + d)` takes the disc to the left half plane for Routh's test.
///
/// # Source
/// Routh's test; the bilinear map as in Åström, Wittenmark, *Computer-Controlled Systems* (1997), section 3.2.
pub(super) fn is_stable_about_one(coefficients: &[f64]) -> bool {
    let mut p = coefficients.to_vec();
    while p.len() > 1 && p.last() == Some(&0.0) {
        p.pop();
    }
    // p(2 w/(1 - w)) (1 - w)^n, by Horner's scheme.
    let mut mapped: Vec<f64> = vec![];
    let mut power = vec![1.0];
    for coefficient in p.iter().rev() {
        mapped = sum(&product(&mapped, &[0.0, 2.0]), *coefficient, &power);
        power = product(&power, &[1.0, -1.0]);
    }
    is_hurwitz(&mapped)
}

/// Whether every root has a negative real part, by Routh's test: all leading coefficients of its rows have one sign.
fn is_hurwitz(coefficients: &[f64]) -> bool {
    let every_second = |from: usize| coefficients.iter().rev().skip(from).step_by(2).copied().collect::<Vec<f64>>();
    let (mut above, mut row) = (every_second(0), every_second(1));
    // Each round uses up one row of at most degree + 1.
    for _ in 1..coefficients.len() {
        // Zero and NaN fail this comparison, as they must.
        let factor = above[0] / row[0];
        if !(factor > 0.0 && factor.is_finite()) {
            return false;
        }
        let at = |row: &[f64], i: usize| row.get(i).copied().unwrap_or(0.0);
        let below = (1..above.len()).map(|i| above[i] - factor * at(&row, i)).collect();
        (above, row) = (row, below);
    }
    coefficients.iter().all(|c| c.is_finite())
}
