//! What the simulated user traces: part of a circle, a curve that turns both ways, and the smaller circle of the impedance device.

use crate::elementary;
use std::f64::consts::PI;
use std::ops::RangeInclusive;

use nalgebra::Vector2;

use super::super::drawn::{finite, positive};
use crate::config::{ArcSpeed, Forbidden, PathSegment, Surface};
use crate::sim::hand::{Leg, Speed};

/// A way along which the user traces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    Circle,
    Curve,
    /// The circle of the impedance device.
    Ring,
}

/// What the rig traces.
pub(super) const WAYS: [Way; 2] = [Way::Circle, Way::Curve];

/// The circle about the origin is that of the paper; traced from this angle by that one.
const CIRCLE_M: f64 = 0.12;
const CIRCLE_FROM: f64 = 0.55;
const CIRCLE_BY: f64 = 1.4;
/// The circle of the impedance device about the origin, and how much of it is traced.
const RING_M: f64 = 0.04;
const RING_BY: f64 = 4.2;
/// The curve: half a circle over the x axis to the origin, half a circle under it onward.
const BEND_M: f64 = 0.05;
/// Points of the curve's spline on each half circle; between them it leaves the arcs by less than a micrometre.
const POINTS: i32 = 24;
/// Points by which the reference goes on beyond both ends: a user who runs on is still guided.
const BEYOND: i32 = 4;

impl Way {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Circle => "circle",
            Self::Curve => "curve",
            Self::Ring => "ring",
        }
    }

    pub(super) fn length_m(self) -> f64 {
        match self {
            Self::Circle => CIRCLE_M * CIRCLE_BY,
            Self::Curve => 2.0 * PI * BEND_M,
            Self::Ring => RING_M * RING_BY,
        }
    }

    /// Radius in m of the circle about the origin, and the angle by which it is traced; `None` for the curve.
    fn circle(self) -> Option<(f64, f64)> {
        match self {
            Self::Circle => Some((CIRCLE_M, CIRCLE_BY)),
            Self::Ring => Some((RING_M, RING_BY)),
            Self::Curve => None,
        }
    }

    pub(super) fn start_m(self) -> [f64; 2] {
        match self.circle() {
            Some((radius_m, _)) => [radius_m * elementary::cos(CIRCLE_FROM), radius_m * elementary::sin(CIRCLE_FROM)],
            None => [-2.0 * BEND_M, 0.0],
        }
    }

    /// Where the user aims in the end, `by_m` away from the end of the way, across it.
    pub(super) fn beyond_m(self, by_m: f64) -> [f64; 2] {
        match self.circle() {
            // Inward: outside of the circle the arm's reach ends.
            Some((radius_m, by_rad)) => {
                let end = CIRCLE_FROM + by_rad;
                [(radius_m - by_m) * elementary::cos(end), (radius_m - by_m) * elementary::sin(end)]
            }
            None => [2.0 * BEND_M - by_m, 0.0],
        }
    }

    /// The arcs of the way: centre in m, angle in rad, share of the time.
    fn arcs(self) -> Vec<([f64; 2], f64, f64)> {
        match self.circle() {
            Some((_, by_rad)) => vec![([0.0, 0.0], by_rad, 1.0)],
            None => vec![([-BEND_M, 0.0], -PI, 0.5), ([BEND_M, 0.0], PI, 0.5)],
        }
    }

    /// The aim along the way in `in_s`, at a steady speed but for its ends.
    pub(super) fn segments(self, in_s: f64) -> Vec<PathSegment> {
        let segment = |(center_m, by_rad, share): ([f64; 2], f64, f64)| PathSegment::Arc {
            center_m: center_m.map(finite).to_vec(),
            by_rad: finite(by_rad),
            in_s: positive(share * in_s),
            speed: ArcSpeed::Constant,
        };
        self.arcs().into_iter().map(segment).collect()
    }

    /// The same for a hand of its own.
    pub(super) fn legs(self, in_s: f64) -> Vec<Leg<2>> {
        let leg = |(center_m, by_rad, share): ([f64; 2], f64, f64)| Leg::Arc {
            center_m,
            by_rad,
            in_s: share * in_s,
            speed: Speed::Constant,
        };
        self.arcs().into_iter().map(leg).collect()
    }

    /// The way as the reference of a fixture.
    pub(super) fn surface(self) -> Surface {
        let forbidden = Forbidden::Inside;
        match self {
            Self::Circle | Self::Ring => {
                let radius_m = positive(self.circle().map_or(CIRCLE_M, |(radius_m, _)| radius_m));
                Surface::Circle { center_m: [0.0, 0.0].map(finite), radius_m, forbidden }
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

    /// Centre and radius, in m, of the arc that a point belongs to.
    fn arc_of(self, [x, _]: [f64; 2]) -> (f64, f64) {
        match self.circle() {
            Some((radius_m, _)) => (0.0, radius_m),
            None => (BEND_M.copysign(x), BEND_M),
        }
    }

    /// Unit vector across the way at a point, away from the arc's centre.
    pub(super) fn normal(self, point: [f64; 2]) -> [f64; 2] {
        let [x, y] = point;
        let (center_x, _) = self.arc_of(point);
        let length = elementary::hypot(x - center_x, y).max(f64::MIN_POSITIVE);
        [(x - center_x) / length, y / length]
    }

    /// Distance of a point from the way taken without its ends, in m, positive away from the arc's centre.
    pub(super) fn height_m(self, point: [f64; 2]) -> f64 {
        let [x, y] = point;
        let (center_x, radius_m) = self.arc_of(point);
        elementary::hypot(x - center_x, y) - radius_m
    }

    /// The same without its sign.
    pub(super) fn distance_m(self, point: [f64; 2]) -> f64 {
        self.height_m(point).abs()
    }
}

pub(super) fn vector([x, y]: [f64; 2]) -> Vector2<f64> {
    Vector2::new(x, y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Surface as _;

    #[test]
    fn ways_lie_on_their_surfaces() {
        for way in [Way::Circle, Way::Curve, Way::Ring] {
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
