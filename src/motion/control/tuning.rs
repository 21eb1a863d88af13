//! Gains by the margins that they leave.

use super::{Gains, Margins, ServoLoop, worst_margins};
use crate::elementary;

/// Halvings of the search for the bandwidth.
const HALVINGS: u32 = 40;
/// Range of bandwidths in the search for gains, as multiples of that of the shape.
const BANDWIDTHS: [f64; 2] = [0.01, 100.0];

/// Gains with what they leave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuned {
    /// The gains.
    pub gains: Gains,
    /// Their bandwidth as a multiple of that of the shape that they were made from.
    pub bandwidth: f64,
    /// Their margins, the worst over all inertias.
    pub margins: Margins,
}

/// Returns gains of another bandwidth: stiffness by its square, damping by itself, integral by its cube, so that the shape of the loop
/// stays.
pub fn at_bandwidth(shape: Gains, factor: f64) -> Gains {
    Gains {
        stiffness: shape.stiffness * elementary::powi(factor, 2),
        damping: shape.damping * factor,
        integral: shape.integral * elementary::powi(factor, 3),
    }
}

/// Returns the gains of the greatest bandwidth that keep the wanted margins over all `inertias` (kg m^2 or kg) without viscous friction.
/// Returns `None` if no bandwidth from a hundredth to a hundred times that of `shape` does. Margins shrink as the bandwidth grows.
///
/// `period_s` and `delay_cycles` are those of a [`ServoLoop`].
pub fn stiffest(
    shape: Gains,
    period_s: f64,
    delay_cycles: f64,
    inertias: &[f64],
    is_wanted: impl Fn(&Margins) -> bool,
) -> Option<Tuned> {
    let at = |factor: f64| {
        let gains = at_bandwidth(shape, factor);
        let margins = worst_margins(&ServoLoop { gains, period_s, delay_cycles }, inertias, 0.0).ok()?;
        Some(Tuned { gains, bandwidth: factor, margins }).filter(|tuned| tuned.margins.stable && is_wanted(&margins))
    };
    let [mut low, mut high] = BANDWIDTHS;
    let mut best = at(low)?;
    for _ in 0..HALVINGS {
        let middle = f64::sqrt(low * high);
        match at(middle) {
            Some(tuned) => (low, best) = (middle, tuned),
            None => high = middle,
        }
    }
    Some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: Gains = Gains { stiffness: 10_000.0, damping: 95.0, integral: 150_000.0 };

    #[test]
    fn the_stiffest_gains_keep_what_is_wanted_and_a_little_more_do_not() {
        let is_wanted = |margins: &Margins| margins.gain_db >= 6.0 && margins.phase_deg >= 45.0;
        let inertias = [0.15, 0.4];
        for (period_s, delay_cycles) in [(1e-3, 1.0), (4e-3, 2.0)] {
            let tuned = stiffest(SHAPE, period_s, delay_cycles, &inertias, is_wanted).unwrap();
            assert!(is_wanted(&tuned.margins), "{tuned:?}");
            let gains = at_bandwidth(tuned.gains, 1.01);
            let more = worst_margins(&ServoLoop { gains, period_s, delay_cycles }, &inertias, 0.0).unwrap();
            assert!(!is_wanted(&more), "{more:?}");
        }
        let undamped = Gains { damping: 0.0, ..SHAPE };
        assert_eq!(stiffest(undamped, 1e-3, 1.0, &inertias, is_wanted), None);
    }
}
