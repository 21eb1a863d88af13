//! Division of a stretch of time into equal steps.

/// Steps are allowed to be longer than asked for by this share, so that rounding does not add one.
const ROUNDING: f64 = 1e-6;

/// The number of equal steps from `from_s` to `to_s`, none longer than `longest_s`, and their length in s.
///
/// No steps if `to_s` is not later. `None` if a time is not finite, if `longest_s` is not above zero, or if there would
/// be more steps than a `u32` counts.
pub(super) fn equal_steps(from_s: f64, to_s: f64, longest_s: f64) -> Option<(u32, f64)> {
    if !from_s.is_finite() || !to_s.is_finite() || longest_s.is_nan() || longest_s <= 0.0 {
        return None;
    }
    if to_s <= from_s {
        return Some((0, 0.0));
    }
    let count = ((to_s - from_s) / longest_s - ROUNDING).ceil().max(1.0);
    (count < f64::from(u32::MAX)).then(|| (count as u32, (to_s - from_s) / count))
}

#[cfg(test)]
mod tests {
    use super::equal_steps;

    #[test]
    fn steps_are_equal_and_short_enough() {
        assert_eq!(equal_steps(0.0, 1e-3, 1e-4).unwrap().0, 10);
        assert_eq!(equal_steps(0.1, 0.1 + 1e-3, 1e-4).unwrap().0, 10);
        assert_eq!(equal_steps(0.0, 1e-3, 3e-4), Some((4, 0.25e-3)));
        assert_eq!(equal_steps(0.0, 1e-5, 1e-4), Some((1, 1e-5)));
        assert_eq!(equal_steps(0.0, 1e-5, f64::INFINITY), Some((1, 1e-5)));
        assert_eq!(equal_steps(1.0, 1.0, 1e-4), Some((0, 0.0)));
        assert_eq!(equal_steps(1.0, 0.5, 1e-4), Some((0, 0.0)));
    }

    #[test]
    fn nonsense_is_refused() {
        for (from_s, to_s, longest_s) in
            [(0.0, f64::NAN, 1e-4), (0.0, f64::INFINITY, 1e-4), (0.0, 1.0, 0.0), (0.0, 1.0, f64::NAN), (0.0, 1e9, 1e-4)]
        {
            assert_eq!(equal_steps(from_s, to_s, longest_s), None);
        }
    }
}
