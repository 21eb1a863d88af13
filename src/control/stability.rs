//! Whether all roots of a polynomial lie inside the unit circle.

/// Product of two polynomials, coefficients from the constant term up.
pub(super) fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; (a.len() + b.len()).saturating_sub(1)];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            out[i + j] += x * y;
        }
    }
    out
}

/// `a + factor b`, coefficients from the constant term up.
pub(super) fn sum(a: &[f64], factor: f64, b: &[f64]) -> Vec<f64> {
    let at = |p: &[f64], i: usize| p.get(i).copied().unwrap_or(0.0);
    (0..a.len().max(b.len())).map(|i| at(a, i) + factor * at(b, i)).collect()
}

/// Whether every root lies strictly inside the unit circle, by the Schur-Cohn recursion (Jury's test). Coefficients
/// from the constant term up; a constant has no roots and is stable. A coefficient that is not finite is unstable.
///
/// # Source
/// Jury, *Theory and Application of the z-Transform Method* (1964), chapter 3.
pub(super) fn is_schur_stable(coefficients: &[f64]) -> bool {
    let mut p = coefficients.to_vec();
    while p.len() > 1 && p.last() == Some(&0.0) {
        p.pop();
    }
    // One degree less in each round.
    while p.len() > 1 {
        let reflection = p[0] / p[p.len() - 1];
        // NaN fails this comparison, as it must.
        if !(reflection.abs() < 1.0) {
            return false;
        }
        p = p.iter().zip(p.iter().rev()).skip(1).map(|(low, high)| low - reflection * high).collect();
    }
    true
}
