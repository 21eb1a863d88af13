//! Names of ticks, and ranges of axes that end at a tick.

use std::sync::Arc;
use yieldwall_motion::elementary;

use kuva::render::layout::TickFormat;

/// Between these an axis has decimals at its ticks.
const LEAST_PLAIN: f64 = 0.001;
const MOST_PLAIN: f64 = 100_000.0;
/// Digits of a tick at most, on an axis of powers and on one of even steps: more are rounding.
const DIGITS: [usize; 2] = [1, 6];
/// Decades up to which the plotting crate has ticks at 2 and 5 between powers of ten.
const NARROW: i32 = 3;
/// Room for rounding of a logarithm.
const ROUNDING: f64 = 1e-9;

/// Width of a digit, and of the gap between two names, in pixels of the SVG.
const DIGIT_WIDTH: f64 = 7.0;
const GAP: f64 = 3.0;

/// Returns how a logarithmic axis names its ticks: all as decimals, or, where decimals are long, all as powers. Across `pixels` a tick between
/// two powers of ten has no name if it would touch the name of one of them.
pub(super) fn of_powers((low, high): (f64, f64), pixels: Option<f64>) -> TickFormat {
    let is_plain = low >= LEAST_PLAIN && high <= MOST_PLAIN;
    let name = move |value| if is_plain { decimal(value, DIGITS[0]) } else { power(value, DIGITS[0]) };
    let touches = move |value: f64, other: f64, pixels: f64| {
        let is_shown = (low * (1.0 - ROUNDING)..=high * (1.0 + ROUNDING)).contains(&other);
        let width = 0.5 * DIGIT_WIDTH * (name(value).chars().count() + name(other).chars().count()) as f64 + GAP;
        let apart = elementary::log10(value / other).abs() / elementary::log10(high / low) * pixels;
        is_shown && apart < width
    };
    TickFormat::Custom(Arc::new(move |value| {
        let below = elementary::powi(10.0, (elementary::log10(value) + ROUNDING).floor() as i32);
        let is_power = value < below * (1.0 + ROUNDING);
        let is_touching =
            pixels.is_some_and(|pixels| [below, 10.0 * below].iter().any(|it| touches(value, *it, pixels)));
        if is_touching && !is_power { String::new() } else { name(value) }
    }))
}

/// Returns how an axis of even steps names its ticks.
pub(super) fn of_steps((low, high): (f64, f64)) -> TickFormat {
    let greatest = low.abs().max(high.abs());
    let is_plain = (LEAST_PLAIN..=MOST_PLAIN).contains(&greatest);
    TickFormat::Custom(Arc::new(move |value| match value {
        _ if value.abs() < ROUNDING * greatest => "0".to_owned(),
        _ if is_plain => decimal(value, DIGITS[1]),
        _ => power(value, DIGITS[1]),
    }))
}

fn decimal(value: f64, digits: usize) -> String {
    let rounded = format!("{value:.*e}", digits - 1);
    rounded.parse::<f64>().map_or_else(|_| rounded.clone(), |value| value.to_string())
}

/// Returns a value as a power of ten, with a factor unless that is 1.
fn power(value: f64, digits: usize) -> String {
    let rounded = format!("{value:.*e}", digits - 1);
    let Some((factor, exponent)) = rounded.split_once('e') else { return rounded };
    let factor = if factor.contains('.') { factor.trim_end_matches('0').trim_end_matches('.') } else { factor };
    let exponent: String = exponent.chars().map(superscript).collect();
    if factor == "1" { format!("10{exponent}") } else { format!("{factor}×10{exponent}") }
}

fn superscript(letter: char) -> char {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    letter.to_digit(10).and_then(|digit| DIGITS.get(digit as usize).copied()).unwrap_or('⁻')
}

/// Returns the range between two ticks of a logarithmic axis that holds these values.
pub(super) fn around_powers(low: f64, high: f64) -> (f64, f64) {
    let [least, most] = [elementary::log10(low), elementary::log10(high)];
    let ends = [(least + ROUNDING).floor() as i32, (most - ROUNDING).ceil() as i32];
    let steps: &[f64] = if ends[1] - ends[0] <= NARROW { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let ticks = || (ends[0]..=ends[1]).flat_map(|end| steps.iter().map(move |step| step * elementary::powi(10.0, end)));
    let from = ticks().filter(|tick| *tick <= low * (1.0 + ROUNDING)).fold(f64::NEG_INFINITY, f64::max);
    let to = ticks().filter(|tick| *tick >= high * (1.0 - ROUNDING)).fold(f64::INFINITY, f64::min);
    (if from.is_finite() { from } else { low }, if to.is_finite() { to } else { high })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(format: TickFormat, ticks: &[f64]) -> Vec<String> {
        let TickFormat::Custom(name) = format else { panic!("numbers alone") };
        ticks.iter().map(|&tick| name(tick)).collect()
    }

    #[test]
    fn the_ticks_of_an_axis_are_of_one_kind() {
        let powers = |low: f64, high: f64, ticks: &[f64]| names(of_powers((low, high), None), ticks);
        assert_eq!(powers(0.001, 10.0, &[0.001, 0.02, 0.5, 10.0]), ["0.001", "0.02", "0.5", "10"]);
        assert_eq!(powers(1e-4, 10.0, &[1e-4, 0.02, 1.0, 10.0]), ["10⁻⁴", "2×10⁻²", "10⁰", "10¹"]);
        assert_eq!(powers(0.01, 1.0, &[3.0 * 0.1]), ["0.3"]);
        let across = names(of_powers((0.01, 10.0), Some(245.0)), &[0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0]);
        assert_eq!(across, ["0.01", "", "", "0.1", "0.2", "0.5", "1"], "names that would touch those of powers");
        let steps = |low: f64, high: f64, ticks: &[f64]| names(of_steps((low, high)), ticks);
        assert_eq!(steps(-1.0, 25.0, &[1e-17, 0.1 + 0.2, 12.5, -5.0]), ["0", "0.3", "12.5", "-5"]);
        assert_eq!(steps(0.0, 2.5e-4, &[0.0, 2.5e-4, 1e-4]), ["0", "2.5×10⁻⁴", "10⁻⁴"]);
    }

    #[test]
    fn an_axis_of_powers_ends_at_its_ticks() {
        let near = |(low, high): (f64, f64), ends: [f64; 2]| {
            assert!((low / ends[0] - 1.0).abs() < 1e-9 && (high / ends[1] - 1.0).abs() < 1e-9, "{low} {high} {ends:?}");
        };
        near(around_powers(0.03, 8.0), [0.02, 10.0]);
        near(around_powers(0.003, 80.0), [1e-3, 100.0]);
        near(around_powers(1e-3, 1e3), [1e-3, 1e3]);
        near(around_powers(3.0, 3.5), [2.0, 5.0]);
    }
}
