//! Path that the simulated user traces: part of a circle about the origin on the rig, and part of a smaller circle on the
//! impedance device.

use yieldwall_motion::elementary;

use nalgebra::Vector2;

use super::super::drawn::{finite, positive};
use yieldwall_config::{ArcSpeed, Forbidden, PathSegment, Surface};
use yieldwall_sim::hand::{Leg, Speed};

/// A way along which the user traces, from the same angle on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    /// The circle of the paper.
    Circle,
    /// The circle of the impedance device.
    Ring,
}

const FROM_RAD: f64 = 0.55;

impl Way {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Circle => "circle",
            Self::Ring => "ring",
        }
    }

    fn radius_m(self) -> f64 {
        match self {
            Self::Circle => 0.12,
            Self::Ring => 0.04,
        }
    }

    /// The angle by which it is traced.
    fn by_rad(self) -> f64 {
        match self {
            Self::Circle => 1.4,
            Self::Ring => 4.2,
        }
    }

    pub(super) fn length_m(self) -> f64 {
        self.radius_m() * self.by_rad()
    }

    pub(super) fn start_m(self) -> [f64; 2] {
        let radius_m = self.radius_m();
        [radius_m * elementary::cos(FROM_RAD), radius_m * elementary::sin(FROM_RAD)]
    }

    /// Where the user aims in the end, `by_m` inward from the end of the way: outside of the circle the arm's reach ends.
    pub(super) fn beyond_m(self, by_m: f64) -> [f64; 2] {
        let (radius_m, end) = (self.radius_m() - by_m, FROM_RAD + self.by_rad());
        [radius_m * elementary::cos(end), radius_m * elementary::sin(end)]
    }

    /// Returns the segment of the aim along the path in `in_s`, at a steady speed except at its ends.
    pub(super) fn segment(self, in_s: f64) -> PathSegment {
        PathSegment::Arc {
            center_m: [0.0, 0.0].map(finite).to_vec(),
            by_rad: finite(self.by_rad()),
            in_s: positive(in_s),
            speed: ArcSpeed::Constant,
        }
    }

    /// Returns the leg for a hand of its own.
    pub(super) fn leg(self, in_s: f64) -> Leg<2> {
        Leg::Arc { center_m: [0.0, 0.0], by_rad: self.by_rad(), in_s, speed: Speed::Constant }
    }

    /// The way as the reference of a fixture.
    pub(super) fn surface(self) -> Surface {
        Surface::Circle {
            center_m: [0.0, 0.0].map(finite),
            radius_m: positive(self.radius_m()),
            forbidden: Forbidden::Inside,
        }
    }

    /// Unit vector across the way at a point, away from the circle's centre.
    pub(super) fn normal(self, [x, y]: [f64; 2]) -> [f64; 2] {
        let length = elementary::hypot(x, y).max(f64::MIN_POSITIVE);
        [x / length, y / length]
    }

    /// Distance of a point from the way taken without its ends, in m, positive away from the circle's centre.
    pub(super) fn height_m(self, [x, y]: [f64; 2]) -> f64 {
        elementary::hypot(x, y) - self.radius_m()
    }

    /// Distance from the path, without its sign.
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
    use yieldwall_motion::fixture::Surface as _;

    #[test]
    fn ways_lie_on_their_surfaces() {
        for way in [Way::Circle, Way::Ring] {
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
