//! The way that a user follows, by the length along it.

use std::f64::consts::{FRAC_PI_2, TAU};

use nalgebra::Vector2;

use super::super::drawn::{finite, positive};
use yieldwall_config::{Forbidden, Surface};
use yieldwall_motion::elementary;

/// A way at whose start the tool rests. Both go on beyond their end: a user who runs on is still guided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Track {
    /// Part of the paper's circle about the origin, counter-clockwise.
    Circle,
    /// A straight line.
    Line,
}

const CIRCLE_M: f64 = 0.12;
/// Angle in rad at which the way on the circle begins, and through which it goes.
const CIRCLE_FROM: f64 = 0.55;
const CIRCLE_BY: f64 = 1.4;
/// The line runs along the x axis through the origin.
const LINE_FROM_M: f64 = -0.1;
const LINE_M: f64 = 0.2;

/// A point of a way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Station {
    pub(super) point_m: Vector2<f64>,
    /// Unit vectors along the way, and across it, away from the circle's centre.
    pub(super) along: Vector2<f64>,
    pub(super) across: Vector2<f64>,
    /// 1/m, positive for a way that turns away from `across`.
    pub(super) curvature_per_m: f64,
}

impl Track {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Circle => "circle",
            Self::Line => "line",
        }
    }

    pub(super) fn length_m(self) -> f64 {
        match self {
            Self::Circle => CIRCLE_M * CIRCLE_BY,
            Self::Line => LINE_M,
        }
    }

    /// The way after `length_m` from its start.
    pub(super) fn at(self, length_m: f64) -> Station {
        match self {
            Self::Circle => {
                let (sin, cos) = elementary::sin_cos(CIRCLE_FROM + length_m / CIRCLE_M);
                let across = Vector2::new(cos, sin);
                let along = Vector2::new(-sin, cos);
                Station { point_m: across * CIRCLE_M, along, across, curvature_per_m: 1.0 / CIRCLE_M }
            }
            Self::Line => Station {
                point_m: Vector2::new(LINE_FROM_M + length_m, 0.0),
                along: Vector2::x(),
                across: Vector2::y(),
                curvature_per_m: 0.0,
            },
        }
    }

    /// How far along the way a point is, in m, and how far off it, positive away from the circle's centre.
    pub(super) fn place(self, point_m: Vector2<f64>) -> (f64, f64) {
        match self {
            Self::Circle => {
                let angle = elementary::atan2(point_m.y, point_m.x) - CIRCLE_FROM;
                // A long way goes beyond the half circle at which an angle jumps; behind its start a place is below zero.
                let angle = if angle < -FRAC_PI_2 { angle + TAU } else { angle };
                (CIRCLE_M * angle, elementary::hypot(point_m.x, point_m.y) - CIRCLE_M)
            }
            Self::Line => (point_m.x - LINE_FROM_M, point_m.y),
        }
    }

    /// Returns the surface of a fixture whose reference lies `beside_m` off the path.
    pub(super) fn surface(self, beside_m: f64) -> Surface {
        let origin = [0.0, 0.0].map(finite);
        match self {
            Self::Circle => {
                let radius_m = positive(CIRCLE_M + beside_m);
                Surface::Circle { center_m: origin, radius_m, forbidden: Forbidden::Inside }
            }
            Self::Line => Surface::Line { point_m: [0.0, beside_m].map(finite), normal: [0.0, 1.0].map(finite) },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_motion::fixture::Surface as _;

    #[test]
    fn a_point_is_where_the_way_says_and_the_reference_lies_beside_it() {
        for track in [Track::Circle, Track::Line] {
            for length_m in [0.0, 0.05, track.length_m(), 1.5 * track.length_m()] {
                let Station { point_m, along, across, .. } = track.at(length_m);
                let (found_m, off_m) = track.place(point_m + across * 0.003);
                assert!((found_m - length_m).abs() < 1e-12 && (off_m - 0.003).abs() < 1e-12, "{track:?}");
                assert!(along.dot(&across).abs() < 1e-15);
                let ahead = (track.at(length_m + 1e-7).point_m - point_m) / 1e-7;
                assert!((ahead - along).norm() < 1e-5, "{track:?}");
                let shape = track.surface(0.002).planar().unwrap().unwrap();
                let off_reference_m = shape.signed_distance_m(&(point_m + across * 0.002));
                assert!(off_reference_m.abs() < 1e-12, "{track:?}: {off_reference_m}");
            }
        }
    }
}
