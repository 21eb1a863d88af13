//! Curves on paper: cut to a frame, thinned, dashed. Lengths in tenths of a millimetre.

use std::f64::consts::{FRAC_PI_2, PI};
use yieldwall_motion::elementary;

/// Half of the greatest distance by which thinning may move a line: 0.02 mm.
const TOLERANCE: f64 = 0.2;
/// Width of the strips of [`thin_history`]: 0.05 mm.
const STRIP: f64 = 0.5;

/// A point of the paper, from the upper left corner.
pub(super) type Point = (f64, f64);

/// A frame: left, top, right, bottom.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub left: f64,
    pub top: f64,
    pub right: f64,
    pub bottom: f64,
}

impl Frame {
    pub(super) fn contains(&self, (x, y): Point) -> bool {
        (self.left..=self.right).contains(&x) && (self.top..=self.bottom).contains(&y)
    }

    /// Returns the part of a straight line that lies inside.
    ///
    /// # Source
    /// Liang and Barsky, A New Concept and Method for Line Clipping, ACM TOG 3(1), 1984.
    fn cut(&self, from: Point, to: Point) -> Option<(Point, Point)> {
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let mut enter = 0.0f64;
        let mut leave = 1.0f64;
        let edges = [
            (-dx, from.0 - self.left),
            (dx, self.right - from.0),
            (-dy, from.1 - self.top),
            (dy, self.bottom - from.1),
        ];
        for (outward, room) in edges {
            if outward == 0.0 {
                if room < 0.0 {
                    return None;
                }
            } else if outward < 0.0 {
                enter = enter.max(room / outward);
            } else {
                leave = leave.min(room / outward);
            }
        }
        let at = |part: f64| (from.0 + part * dx, from.1 + part * dy);
        (enter <= leave).then(|| {
            let start = if enter == 0.0 { from } else { at(enter) };
            let end = if leave == 1.0 { to } else { at(leave) };
            (start, end)
        })
    }
}

/// Returns the pieces of a chain that lie inside a frame.
pub(super) fn clip(points: &[Point], frame: Frame) -> Vec<Vec<Point>> {
    let mut pieces: Vec<Vec<Point>> = Vec::new();
    for pair in points.windows(2) {
        let Some((start, end)) = frame.cut(pair[0], pair[1]) else { continue };
        match pieces.last_mut() {
            Some(piece) if piece.last() == Some(&start) => piece.push(end),
            _ => pieces.push(vec![start, end]),
        }
    }
    pieces
}

/// Leaves out corners of a chain so that no corner left out lies further than twice [`TOLERANCE`] from the chain kept. The function makes
/// one pass over the points. From the last corner kept, every further point narrows the directions in which a straight line passes close
/// enough to it. A point outside these directions, or one on the way back, ends the line.
///
/// # Source
/// Sklansky and Gonzalez, Fast Polygonal Approximation of Digitized Curves, Pattern Recognition 12(5), 1980.
pub(super) fn thin(points: &[Point]) -> Vec<Point> {
    let (Some(&first), Some(&last)) = (points.first(), points.last()) else { return Vec::new() };
    let mut kept = vec![first];
    let mut anchor = first;
    let mut before = first;
    let mut cone = Cone::default();
    for &point in &points[1..] {
        if !cone.take(point.0 - anchor.0, point.1 - anchor.1) {
            kept.push(before);
            anchor = before;
            cone = Cone::default();
            // The line from the point before has nothing on it yet, so that this one always fits.
            cone.take(point.0 - anchor.0, point.1 - anchor.1);
        }
        before = point;
    }
    kept.push(last);
    kept
}

/// The directions that are still open, as angles about a middle direction, and how far the line has come.
#[derive(Default)]
struct Cone {
    middle: Option<f64>,
    low: f64,
    high: f64,
    reach: f64,
}

impl Cone {
    /// Whether a point at this offset can be the end of the line; if so, the cone narrows to it.
    fn take(&mut self, dx: f64, dy: f64) -> bool {
        let distance = elementary::hypot(dx, dy);
        if distance < self.reach - TOLERANCE {
            return false;
        }
        self.reach = self.reach.max(distance);
        if distance <= TOLERANCE {
            return true;
        }
        let angle = elementary::atan2(dy, dx);
        let opening = elementary::asin(TOLERANCE / distance);
        let Some(middle) = self.middle else {
            (self.middle, self.low, self.high) = (Some(angle), -opening, opening);
            return true;
        };
        let turn = (angle - middle + PI).rem_euclid(2.0 * PI) - PI;
        if turn < self.low || turn > self.high || turn.abs() > FRAC_PI_2 {
            return false;
        }
        self.low = self.low.max(turn - opening);
        self.high = self.high.min(turn + opening);
        true
    }
}

/// Leaves out points of a curve over time: of every strip across it stay the first, lowest, highest and last point.
pub(super) fn thin_history(points: &[Point]) -> Vec<Point> {
    let mut kept = Vec::new();
    for strip in points.chunk_by(|a, b| (a.0 / STRIP).floor() == (b.0 / STRIP).floor()) {
        let by_height = |a: &usize, b: &usize| strip[*a].1.total_cmp(&strip[*b].1);
        let lowest = (0..strip.len()).min_by(by_height).unwrap_or(0);
        let highest = (0..strip.len()).max_by(by_height).unwrap_or(0);
        let mut stay = [0, lowest, highest, strip.len() - 1];
        stay.sort_unstable();
        let mut previous = None;
        for index in stay {
            if previous != Some(index) {
                kept.push(strip[index]);
            }
            previous = Some(index);
        }
    }
    kept
}

/// Returns the strokes of a dashed chain; the pattern runs on around corners. An empty pattern returns the chain itself.
pub(super) fn dashes(points: &[Point], pattern: &[f64]) -> Vec<Vec<Point>> {
    let Some(&first) = points.first() else { return Vec::new() };
    if pattern.is_empty() {
        return vec![points.to_vec()];
    }
    let mut strokes = Vec::new();
    let mut stroke = vec![first];
    let mut phase = 0;
    let mut left = pattern[0];
    for pair in points.windows(2) {
        let ((x, y), length) = (pair[0], elementary::hypot(pair[1].0 - pair[0].0, pair[1].1 - pair[0].1));
        let mut done = 0.0;
        while length - done > left {
            done += left;
            let part = done / length;
            let at = (x + part * (pair[1].0 - x), y + part * (pair[1].1 - y));
            if phase % 2 == 0 {
                stroke.push(at);
                strokes.push(std::mem::take(&mut stroke));
            } else {
                stroke = vec![at];
            }
            phase = (phase + 1) % pattern.len();
            left = pattern[phase];
        }
        left -= length - done;
        if phase % 2 == 0 {
            stroke.push(pair[1]);
        }
    }
    if stroke.len() > 1 {
        strokes.push(stroke);
    }
    strokes
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FRAME: Frame = Frame { left: 0.0, top: 0.0, right: 10.0, bottom: 10.0 };

    fn distance_to_piece(point: Point, from: Point, to: Point) -> f64 {
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let length_squared = dx * dx + dy * dy;
        let along = ((point.0 - from.0) * dx + (point.1 - from.1) * dy) / length_squared.max(1e-300);
        let part = along.clamp(0.0, 1.0);
        elementary::hypot(point.0 - from.0 - part * dx, point.1 - from.1 - part * dy)
    }

    #[test]
    fn clip_cuts_at_the_frame_and_joins_what_runs_on() {
        let pieces = clip(&[(-5.0, 5.0), (5.0, 5.0), (5.0, 15.0), (8.0, 15.0), (8.0, 2.0)], FRAME);
        assert_eq!(pieces, vec![vec![(0.0, 5.0), (5.0, 5.0), (5.0, 10.0)], vec![(8.0, 10.0), (8.0, 2.0)]]);
        assert!(clip(&[(11.0, 0.0), (11.0, 5.0), (20.0, 9.0)], FRAME).is_empty());
    }

    #[test]
    fn thin_keeps_the_turning_point_of_a_way_there_and_back() {
        let there: Vec<Point> = (0..100).map(|i| (f64::from(i), 0.0)).collect();
        let back = there.iter().rev().skip(1).copied();
        let way: Vec<Point> = there.iter().copied().chain(back).collect();
        assert_eq!(thin(&way), vec![(0.0, 0.0), (99.0, 0.0), (0.0, 0.0)]);
    }

    #[test]
    fn thin_history_keeps_a_single_peak() {
        let mut flat: Vec<Point> = (0..1000).map(|i| (f64::from(i) * 0.01, 0.0)).collect();
        flat[517].1 = 80.0;
        let kept = thin_history(&flat);
        assert!(kept.contains(&(5.17, 80.0)));
        assert!(kept.len() <= 80, "{}", kept.len());
    }

    #[test]
    fn dashes_run_on_around_a_corner() {
        let strokes = dashes(&[(0.0, 0.0), (3.0, 0.0), (3.0, 4.0)], &[4.0, 2.0]);
        assert_eq!(strokes, vec![vec![(0.0, 0.0), (3.0, 0.0), (3.0, 1.0)], vec![(3.0, 3.0), (3.0, 4.0)]]);
    }

    proptest! {
        #[test]
        fn thin_stays_within_its_tolerance(
            steps in prop::collection::vec((-3.0..3.0f64, -3.0..3.0f64, 0.01..1.0f64), 2..200),
        ) {
            let mut at = (0.0, 0.0);
            let way: Vec<Point> = steps
                .into_iter()
                .map(|(dx, dy, size)| {
                    at = (at.0 + dx * size, at.1 + dy * size);
                    at
                })
                .collect();
            let kept = thin(&way);
            prop_assert!(kept.len() <= way.len() + 1);
            for point in way {
                let nearest = kept.windows(2).map(|pair| distance_to_piece(point, pair[0], pair[1]));
                prop_assert!(nearest.fold(f64::INFINITY, f64::min) <= 2.0 * TOLERANCE + 1e-9);
            }
        }

        #[test]
        fn clipped_points_lie_in_the_frame(
            way in prop::collection::vec((-30.0..30.0f64, -30.0..30.0f64), 2..50),
        ) {
            for (x, y) in clip(&way, FRAME).into_iter().flatten() {
                prop_assert!((-1e-9..=10.0 + 1e-9).contains(&x) && (-1e-9..=10.0 + 1e-9).contains(&y));
            }
        }
    }
}
