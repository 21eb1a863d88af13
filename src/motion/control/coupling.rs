//! Stability of the virtual coupling of an impedance fixture: the stiffest spring and the strongest damper.
//!
//! While the fixture holds its proxy, tool and proxy are joined by `K` and `B` as sampled: the loop of a position servo
//! with the device as its inertia. So [`ServoLoop`] describes it, with [`Gains`] in N/m and N s/m and no integral.

use super::error::positive;
use super::{ControlError, Gains, ServoLoop, is_stable};
use crate::elementary;

/// Stiffnesses (N/m) and dampings (N s/m) in the search for the greatest.
const RANGE: [f64; 2] = [1e-6, 1e9];
/// Points of the search, evenly in the logarithm.
const SEARCH_POINTS: u32 = 150;
/// Halvings of the interval that the search ends with.
const BISECTIONS: usize = 50;

/// Returns `K (T/2 + d T)` in N s/m: the sum of device damping and virtual damping that a virtual spring needs. Good for a
/// damper with small `B T/m`; [`greatest_stiffness_n_per_m`] is exact.
///
/// `stiffness_n_per_m` is `K`, `delay_cycles` is `d`, the delay besides the hold.
///
/// # Source
/// Colgate, Schenkel, *Passivity of a class of sampled-data systems: application to haptic interfaces* (1997), for the
/// half cycle of the hold; the delay adds its own.
pub fn damping_needed_n_s_per_m(stiffness_n_per_m: f64, period_s: f64, delay_cycles: f64) -> f64 {
    stiffness_n_per_m * period_s * (0.5 + delay_cycles)
}

/// Returns the greatest virtual stiffness in N/m of a stable coupling on a free device of `mass_kg` with `viscous_n_s_per_m`. The coupling
/// is that of `servo`, whose own stiffness is ignored, and keeps a factor of `reserve >= 1`. Returns `None` if no stiffness is stable.
///
/// # Errors
/// [`ControlError::OutOfRange`] for a number that is not finite or out of its range.
pub fn greatest_stiffness_n_per_m(
    servo: &ServoLoop,
    mass_kg: f64,
    viscous_n_s_per_m: f64,
    reserve: f64,
) -> Result<Option<f64>, ControlError> {
    greatest(reserve, |stiffness| {
        let gains = Gains { stiffness, ..servo.gains };
        is_stable(&ServoLoop { gains, ..*servo }, mass_kg, viscous_n_s_per_m)
    })
}

/// Returns the greatest virtual damping in N s/m with which the coupling of `servo`, whose own damping is ignored, is
/// stable with a factor of `reserve >= 1` to spare. `None` if none is.
///
/// # Errors
/// As [`greatest_stiffness_n_per_m`].
pub fn greatest_damping_n_s_per_m(
    servo: &ServoLoop,
    mass_kg: f64,
    viscous_n_s_per_m: f64,
    reserve: f64,
) -> Result<Option<f64>, ControlError> {
    greatest(reserve, |damping| {
        let gains = Gains { damping, ..servo.gains };
        is_stable(&ServoLoop { gains, ..*servo }, mass_kg, viscous_n_s_per_m)
    })
}

/// Returns the greatest value that is stable when `reserve` times as large.
fn greatest(reserve: f64, is_stable: impl Fn(f64) -> Result<bool, ControlError>) -> Result<Option<f64>, ControlError> {
    let reserve = positive("reserve", reserve)?;
    let [least, most] = RANGE;
    let at = |i: u32| least * elementary::powf(most / least, f64::from(i) / f64::from(SEARCH_POINTS));
    for i in (0..=SEARCH_POINTS).rev() {
        if !is_stable(at(i))? {
            continue;
        }
        let (mut low, mut high) = (at(i), at((i + 1).min(SEARCH_POINTS)));
        for _ in 0..BISECTIONS {
            let middle = (low * high).sqrt();
            if is_stable(middle)? { low = middle } else { high = middle }
        }
        return Ok(Some(low / reserve));
    }
    Ok(None)
}
