//! Marks of their own: the forbidden side of a wall, and faults.

use super::curve::Point;
use super::page::{BLACK, GREY, Page, Stroke};
use yieldwall_motion::elementary;

/// The strokes on the forbidden side of a wall: thinner than its line, 1.6 mm long, 2.2 mm apart.
const HATCH: Stroke = Stroke { color: GREY, width: 1.5, dash: &[] };
const HATCH_LENGTH: f64 = 16.0;
const HATCH_SPACING: f64 = 22.0;
/// Half of the width of a fault's cross, on paper.
pub(super) const CROSS: f64 = 11.0;

/// Strokes to the right of a way on paper, and backward: the forbidden side of a wall.
pub(super) fn hatch(page: &mut Page, points: &[Point]) {
    for stroke in hatch_strokes(points) {
        page.chain(&stroke, HATCH);
    }
}

/// Returns their ends, first the end on the way.
pub(super) fn hatch_strokes(points: &[Point]) -> impl Iterator<Item = [Point; 2]> + '_ {
    let mut left = HATCH_SPACING / 2.0;
    points.windows(2).flat_map(move |pair| {
        let [(x0, y0), (x1, y1)] = [pair[0], pair[1]];
        let length = elementary::hypot(x1 - x0, y1 - y0);
        let count = if length > left { ((length - left) / HATCH_SPACING).floor() + 1.0 } else { 0.0 };
        let first = left;
        left += count * HATCH_SPACING - length;
        let (along, down) = if length > 0.0 { ((x1 - x0) / length, (y1 - y0) / length) } else { (0.0, 0.0) };
        (0..count as u32).map(move |stroke| {
            let way = first + f64::from(stroke) * HATCH_SPACING;
            let (x, y) = (x0 + along * way, y0 + down * way);
            let reach = HATCH_LENGTH * std::f64::consts::FRAC_1_SQRT_2;
            // On paper y points down, so that the right of (along, down) is (-down, along).
            [(x, y), (x + reach * (-down - along), y + reach * (along - down))]
        })
    })
}

/// Draws the mark of a fault.
pub(super) fn cross(page: &mut Page, (x, y): Point) {
    let stroke = Stroke { color: BLACK, width: 3.5, dash: &[] };
    for down in [1.0, -1.0] {
        page.chain(&[(x - CROSS, y - down * CROSS), (x + CROSS, y + down * CROSS)], stroke);
    }
}
