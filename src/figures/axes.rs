//! A frame with scales: from values to places on the page, ticks and their numbers.

use super::curve::{self, Frame, Point};
use super::page::{Anchor, BLACK, GREY, LETTER, Page, Stroke};
use yieldwall_motion::elementary;

/// Ticks wished for per tenth of a millimetre of axis: one every 11 mm upright, one every 15 mm across and where both
/// directions have one scale.
const TICKS_UPRIGHT: f64 = 1.0 / 110.0;
const TICKS_ACROSS: f64 = 1.0 / 150.0;
/// Room for a digit and for the gap between two numbers.
const DIGIT: f64 = 0.64 * LETTER as f64;
const GAP: f64 = 14.0;
const TICK: f64 = 9.0;
/// Height of an upright axis's name above its frame.
const NAME_OFFSET: f64 = 15.0;

/// A frame on the page and the values at its edges.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axes {
    pub frame: Frame,
    pub x: [f64; 2],
    pub y: [f64; 2],
}

/// Method by which a curve is thinned.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    /// A way in the plane.
    Way,
    /// Values over time.
    History,
}

impl Axes {
    /// With one scale for both directions: the range in which the frame has room is widened about its middle.
    pub(super) fn with_equal_scales(frame: Frame, x: [f64; 2], y: [f64; 2]) -> Self {
        let (width, height) = (frame.right - frame.left, frame.bottom - frame.top);
        let per_length = ((x[1] - x[0]) / width).max((y[1] - y[0]) / height);
        let about = |range: [f64; 2], length: f64| {
            let (middle, half) = ((range[0] + range[1]) / 2.0, per_length * length / 2.0);
            [middle - half, middle + half]
        };
        Self { frame, x: about(x, width), y: about(y, height) }
    }

    /// Returns the place of a pair of values on the page.
    pub(super) fn place(&self, x: f64, y: f64) -> Point {
        let Frame { left, top, right, bottom } = self.frame;
        let across = (x - self.x[0]) / (self.x[1] - self.x[0]);
        let upward = (y - self.y[0]) / (self.y[1] - self.y[0]);
        (left + across * (right - left), bottom - upward * (bottom - top))
    }

    fn has_equal_scales(&self) -> bool {
        let upright = (self.frame.bottom - self.frame.top) / (self.y[1] - self.y[0]);
        (upright / self.length_per_unit() - 1.0).abs() < 1e-6
    }

    /// Returns the length on the page of one unit of x.
    pub(super) fn length_per_unit(&self) -> f64 {
        (self.frame.right - self.frame.left) / (self.x[1] - self.x[0])
    }

    /// Draws a curve, cut to the frame and thinned, and says whether anything of it lies within.
    pub(super) fn curve(
        &self,
        page: &mut Page,
        values: impl Iterator<Item = (f64, f64)>,
        kind: Kind,
        stroke: Stroke,
    ) -> bool {
        let points: Vec<Point> = values.map(|(x, y)| self.place(x, y)).collect();
        let points = match kind {
            Kind::Way => points,
            Kind::History => curve::thin_history(&points),
        };
        let pieces = curve::clip(&points, self.frame);
        let is_seen = !pieces.is_empty();
        page.within(self.frame, |page| {
            for piece in pieces {
                page.chain(&curve::thin(&piece), stroke);
            }
        });
        is_seen
    }

    /// Draws a level across the frame, if it lies within.
    pub(super) fn level(&self, page: &mut Page, y: f64, stroke: Stroke) {
        self.curve(page, self.x.map(|x| (x, y)).into_iter(), Kind::Way, stroke);
    }

    /// Draws frame, ticks and numbers, and the axes' names, that of y above its upper end; without a name for x the numbers below are left out too.
    pub(super) fn draw(&self, page: &mut Page, x_name: Option<&str>, y_name: &str) {
        let Frame { left, top, right, bottom } = self.frame;
        let stroke = Stroke { color: BLACK, width: 2.0, dash: &[] };
        page.chain(&[(left, top), (right, top), (right, bottom), (left, bottom), (left, top)], stroke);
        let ticks = Ticks::new(self.x, (right - left) * TICKS_ACROSS);
        let every = ticks.numbered(self.length_per_unit());
        for (count, value, number) in ticks.iter() {
            let (x, _) = self.place(value, self.y[0]);
            page.chain(&[(x, bottom), (x, bottom - TICK)], stroke);
            page.chain(&[(x, top), (x, top + TICK)], stroke);
            if x_name.is_some() && count % every == 0 {
                page.text((x, bottom + 34.0), Anchor::Middle, &number);
            }
        }
        let per_length = if self.has_equal_scales() { TICKS_ACROSS } else { TICKS_UPRIGHT };
        for (_, value, number) in Ticks::new(self.y, (bottom - top) * per_length).iter() {
            let (_, y) = self.place(self.x[0], value);
            page.chain(&[(left, y), (left + TICK, y)], stroke);
            page.chain(&[(right, y), (right - TICK, y)], stroke);
            page.text((left - 10.0, y + 0.36 * f64::from(LETTER)), Anchor::End, &number);
        }
        if let Some(name) = x_name {
            page.text(((left + right) / 2.0, bottom + 72.0), Anchor::Middle, name);
        }
        page.text((left, top - NAME_OFFSET), Anchor::Start, y_name);
    }

    /// Draws a thin line at zero.
    pub(super) fn zero_line(&self, page: &mut Page) {
        self.level(page, 0.0, Stroke { color: GREY, width: 1.5, dash: &[] });
    }
}

/// Round values within a range.
struct Ticks {
    step: f64,
    first: i64,
    last: i64,
    decimals: usize,
}

impl Ticks {
    /// With steps of 1, 2 or 5 times a power of ten, as near to the wished number as these come, three at least.
    fn new(range: [f64; 2], wished: f64) -> Self {
        let rough = (range[1] - range[0]) / wished.max(3.0);
        let power = elementary::powf(10.0, elementary::log10(rough).floor());
        // Each step serves up to its geometric mean with the next.
        let serves = |digit: &f64| rough <= power * digit * if *digit == 2.0 { 2.5f64 } else { 2.0 }.sqrt();
        let step = power * [1.0, 2.0, 5.0].into_iter().find(serves).unwrap_or(10.0);
        // Half a thousandth of a step of slack, so that rounding does not cost the tick at the very edge.
        let first = (range[0] / step - 5e-4).ceil() as i64;
        let last = (range[1] / step + 5e-4).floor() as i64;
        Self { step, first, last, decimals: (-elementary::log10(step * 1.001).floor()).max(0.0) as usize }
    }

    /// Returns count, value and number of each tick.
    fn iter(&self) -> impl Iterator<Item = (i64, f64, String)> {
        (self.first..=self.last).map(|count| {
            let value = count as f64 * self.step;
            (count, value, number(value, self.decimals))
        })
    }

    /// Returns the number of ticks for which one number has room.
    fn numbered(&self, length_per_unit: f64) -> i64 {
        let longest = self.iter().map(|(_, _, number)| number.chars().count()).max().unwrap_or(1);
        let every = (longest as f64 * DIGIT + GAP) / (self.step * length_per_unit);
        every.ceil().clamp(1.0, 100.0) as i64
    }
}

/// Returns a number with a true minus sign, which a zero has not.
pub(super) fn number(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.chars().all(|digit| matches!(digit, '0' | '.')) => zero.to_owned(),
        Some(digits) => format!("\u{2212}{digits}"),
        None => text,
    }
}

/// Returns the least range that holds all values; widened to `least` about its middle, and by a part of itself on both sides.
pub(super) fn range_of(values: impl Iterator<Item = f64>, least: f64, margin: f64) -> [f64; 2] {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return [-least / 2.0, least / 2.0];
    }
    let half = (high - low).max(least).max(1e-9 * high.abs().max(low.abs())) / 2.0;
    let middle = (low + high) / 2.0;
    [middle - half * (1.0 + 2.0 * margin), middle + half * (1.0 + 2.0 * margin)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_reach_the_edges() {
        let numbers = |range, wished| Ticks::new(range, wished).iter().map(|(_, _, number)| number).collect::<Vec<_>>();
        assert_eq!(numbers([-0.2, 0.2], 4.0), ["\u{2212}0.2", "\u{2212}0.1", "0.0", "0.1", "0.2"]);
        assert_eq!(numbers([0.0, 12.0], 5.0), ["0", "2", "4", "6", "8", "10", "12"]);
        assert_eq!(numbers([0.0, 16.0], 5.0), ["0", "5", "10", "15"]);
        assert_eq!(numbers([99.98, 100.02], 4.0), ["99.98", "99.99", "100.00", "100.01", "100.02"]);
    }

    #[test]
    fn numbers_are_plain() {
        let texts =
            [(-0.04, 1), (0.0, 0), (-0.0, 2), (-12.5, 1), (2e6, 0)].map(|(value, decimals)| number(value, decimals));
        assert_eq!(texts, ["0.0", "0", "0.00", "\u{2212}12.5", "2000000"]);
    }

    #[test]
    fn long_numbers_leave_out_their_neighbours() {
        let ticks = Ticks::new([-115.25, -115.15], 5.0);
        assert_eq!(ticks.iter().map(|(_, _, number)| number).next().as_deref(), Some("\u{2212}115.24"));
        assert_eq!(ticks.numbered(150.0 / 0.02), 1);
        assert_eq!(ticks.numbered(100.0 / 0.02), 2);
    }

    #[test]
    fn equal_scales_keep_the_middle() {
        let frame = Frame { left: 0.0, top: 0.0, right: 200.0, bottom: 100.0 };
        let axes = Axes::with_equal_scales(frame, [0.0, 1.0], [0.0, 1.0]);
        assert_eq!((axes.x, axes.y), ([-0.5, 1.5], [0.0, 1.0]));
        assert_eq!(axes.place(0.5, 0.5), (100.0, 50.0));
        assert_eq!(axes.length_per_unit(), 100.0);
    }

    #[test]
    fn range_of_nothing_or_of_one_value_is_not_empty() {
        assert_eq!(range_of(std::iter::empty(), 2.0, 0.0), [-1.0, 1.0]);
        let [low, high] = range_of([1e9, 1e9].into_iter(), 1e-3, 0.1);
        assert!(low < 1e9 && high > 1e9);
    }
}
