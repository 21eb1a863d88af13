//! What the simulated user traces: a line, part of a circle, a curve that turns both ways.

use crate::elementary;
use std::f64::consts::PI;
use std::ops::RangeInclusive;

use crate::config::{ArcSpeed, Finite, Forbidden, PathSegment, Positive, Surface};

/// A way along which the user traces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    Line,
    Circle,
    Curve,
}

pub(super) const WAYS: [Way; 3] = [Way::Line, Way::Circle, Way::Curve];

/// The line runs from minus to plus this x, at y = 0, in m.
const LINE_M: f64 = 0.08;
/// The circle about the origin is that of the paper; traced from this angle by that one.
const CIRCLE_M: f64 = 0.12;
const CIRCLE_FROM: f64 = 0.55;
const CIRCLE_BY: f64 = 1.4;
/// The curve: half a circle over the x axis to the origin, half a circle under it onward.
const BEND_M: f64 = 0.05;
/// Points of the curve's spline on each half circle; between them it leaves the arcs by less than a micrometre.
const POINTS: i32 = 24;
/// Points by which the reference goes on beyond both ends: a user who runs on is still guided.
const BEYOND: i32 = 4;

impl Way {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Line => "line",
            Self::Circle => "circle",
            Self::Curve => "curve",
        }
    }

    pub(super) fn length_m(self) -> f64 {
        match self {
            Self::Line => 2.0 * LINE_M,
            Self::Circle => CIRCLE_M * CIRCLE_BY,
            Self::Curve => 2.0 * PI * BEND_M,
        }
    }

    pub(super) fn start_m(self) -> [f64; 2] {
        match self {
            Self::Line => [-LINE_M, 0.0],
            Self::Circle => [CIRCLE_M * elementary::cos(CIRCLE_FROM), CIRCLE_M * elementary::sin(CIRCLE_FROM)],
            Self::Curve => [-2.0 * BEND_M, 0.0],
        }
    }

    /// Where the user aims in the end, `by_m` away from the end of the way, across it.
    pub(super) fn beyond_m(self, by_m: f64) -> [f64; 2] {
        let end = CIRCLE_FROM + CIRCLE_BY;
        match self {
            Self::Line => [LINE_M, by_m],
            // Inward: outside of the circle the arm's reach ends.
            Self::Circle => [(CIRCLE_M - by_m) * elementary::cos(end), (CIRCLE_M - by_m) * elementary::sin(end)],
            Self::Curve => [2.0 * BEND_M - by_m, 0.0],
        }
    }

    /// The aim along the way in `in_s`, at a steady speed but for its ends.
    pub(super) fn segments(self, in_s: f64) -> Vec<PathSegment> {
        let arc = |center_m: [f64; 2], by_rad, in_s| PathSegment::Arc {
            center_m: center_m.map(finite).to_vec(),
            by_rad: finite(by_rad),
            in_s: positive(in_s),
            speed: ArcSpeed::Constant,
        };
        match self {
            Self::Line => {
                vec![PathSegment::To { point_m: [LINE_M, 0.0].map(finite).to_vec(), in_s: positive(in_s) }]
            }
            Self::Circle => vec![arc([0.0, 0.0], CIRCLE_BY, in_s)],
            Self::Curve => vec![arc([-BEND_M, 0.0], -PI, 0.5 * in_s), arc([BEND_M, 0.0], PI, 0.5 * in_s)],
        }
    }

    /// The way as the reference of a fixture.
    pub(super) fn surface(self) -> Surface {
        let forbidden = Forbidden::Inside;
        match self {
            Self::Line => Surface::Line { point_m: [0.0, 0.0].map(finite), normal: [0.0, 1.0].map(finite) },
            Self::Circle => {
                Surface::Circle { center_m: [0.0, 0.0].map(finite), radius_m: positive(CIRCLE_M), forbidden }
            }
            Self::Curve => {
                let half = |center: f64, turn: f64, places: RangeInclusive<i32>| {
                    places.map(move |place| {
                        let angle = PI - PI * f64::from(place) / f64::from(POINTS);
                        [center + BEND_M * elementary::cos(angle), turn * BEND_M * elementary::sin(angle)].map(finite)
                    })
                };
                let first = half(-BEND_M, 1.0, -BEYOND..=POINTS);
                let points_m = first.chain(half(BEND_M, -1.0, 1..=POINTS + BEYOND)).collect();
                Surface::OpenCurve { points_m }
            }
        }
    }

    /// Unit vector across the way at a point.
    pub(super) fn normal(self, [x, y]: [f64; 2]) -> [f64; 2] {
        let center_x = match self {
            Self::Line => return [0.0, 1.0],
            Self::Circle => 0.0,
            Self::Curve => BEND_M.copysign(x),
        };
        let radius = elementary::hypot(x - center_x, y).max(f64::MIN_POSITIVE);
        [(x - center_x) / radius, y / radius]
    }

    /// Distance of a point from the way taken without its ends, in m.
    pub(super) fn distance_m(self, [x, y]: [f64; 2]) -> f64 {
        match self {
            Self::Line => y.abs(),
            Self::Circle => (elementary::hypot(x, y) - CIRCLE_M).abs(),
            Self::Curve => (elementary::hypot(x - BEND_M.copysign(x), y) - BEND_M).abs(),
        }
    }
}

pub(super) fn finite(value: f64) -> Finite {
    Finite::new(value).unwrap_or_else(|| unreachable!("{value} is finite"))
}

pub(super) fn positive(value: f64) -> Positive {
    Positive::new(value).unwrap_or_else(|| unreachable!("{value} is above zero"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Surface as _;

    #[test]
    fn ways_lie_on_their_surfaces() {
        for way in WAYS {
            let shape = way.surface().planar().unwrap().unwrap();
            assert!(way.distance_m(way.start_m()) < 1e-12);
            assert!((way.distance_m(way.beyond_m(0.03)) - 0.03).abs() < 1e-12, "{way:?}");
            let mut inner = way.start_m();
            inner[0] += 0.013;
            inner[1] += 0.021;
            let surface = shape.signed_distance_m(&inner.into()).abs();
            assert!((surface - way.distance_m(inner)).abs() < 1e-6, "{way:?}: {surface}");
        }
    }
}
