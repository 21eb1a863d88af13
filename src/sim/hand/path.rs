//! The path of the point that a hand aims at.

use nalgebra::SVector;
use yieldwall_motion::elementary;

use super::HandError;

/// The share of a leg of [`Speed::Constant`] that is spent on speeding up, and again on slowing down.
const RAMP_SHARE: f64 = 0.1;

/// Below this radius in m an arc is taken as one without radius.
const SMALLEST_RADIUS_M: f64 = 1e-9;

/// How the speed along an arc changes with time. Each starts and ends at rest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Speed {
    /// Minimum jerk: the bell-shaped speed of an unhurried reach.
    #[default]
    Smooth,
    /// Constant, apart from a ramp over the first and the last tenth of the time.
    Constant,
}

/// One leg of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leg<const N: usize> {
    /// Straight to a point, with minimum jerk.
    To {
        /// Where the leg ends, in m.
        point_m: SVector<f64, N>,
        /// How long it takes, in s.
        in_s: f64,
    },
    /// About a centre in the x-y plane, at the distance where the leg starts; further coordinates stay.
    Arc {
        /// The centre's x and y in m.
        center_m: [f64; 2],
        /// Angle in rad, counter-clockwise positive.
        by_rad: f64,
        /// How long it takes, in s.
        in_s: f64,
        /// How the speed changes.
        speed: Speed,
    },
    /// Rest.
    Wait {
        /// Duration, in s.
        for_s: f64,
    },
    /// Rest, without a hand on the handle. The mass of the hand stays at it.
    LetGo {
        /// Duration, in s.
        for_s: f64,
    },
}

/// Position and velocity of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint<const N: usize> {
    /// Position in m.
    pub position_m: SVector<f64, N>,
    /// Velocity in m/s.
    pub velocity_m_per_s: SVector<f64, N>,
}

/// Legs one after the other from time zero. Position and velocity are continuous; before the start and after the end
/// the target rests.
///
/// # Source
/// Minimum jerk: Flash and Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985).
#[derive(Clone, Debug)]
pub struct Path<const N: usize> {
    pieces: Vec<Piece<N>>,
    end_m: SVector<f64, N>,
    end_s: f64,
    /// The piece of the last call, where the search for the next begins.
    current: usize,
}

#[derive(Clone, Copy, Debug)]
struct Piece<const N: usize> {
    from_s: f64,
    in_s: f64,
    from_m: SVector<f64, N>,
    shape: Shape<N>,
}

#[derive(Clone, Copy, Debug)]
enum Shape<const N: usize> {
    Line { by_m: SVector<f64, N> },
    Arc { center_m: [f64; 2], by_rad: f64, speed: Speed },
    Rest,
    LetGo,
}

impl<const N: usize> Path<N> {
    /// A path from `start_m` along `legs`; without legs the target rests at the start.
    ///
    /// # Errors
    /// A coordinate, angle or time that is not finite, a leg that takes no time, an arc that starts at its centre or
    /// has no plane (`N` below 2). Legs are numbered from 1.
    pub fn new(start_m: SVector<f64, N>, legs: &[Leg<N>]) -> Result<Self, HandError> {
        if !start_m.iter().all(|coordinate| coordinate.is_finite()) {
            return Err(HandError::NotFinite { leg: 0 });
        }
        let mut path = Self { pieces: Vec::with_capacity(legs.len()), end_m: start_m, end_s: 0.0, current: 0 };
        for (index, leg) in legs.iter().enumerate() {
            let (shape, in_s) = checked_shape(index + 1, leg, &path.end_m)?;
            let piece = Piece { from_s: path.end_s, in_s, from_m: path.end_m, shape };
            path.end_m = piece.at(in_s).position_m;
            path.end_s += in_s;
            path.pieces.push(piece);
        }
        Ok(path)
    }

    /// The target at `time_s`; a time that is NaN counts as one after the end.
    ///
    /// Constant time on average while times grow by less than a leg; no allocation.
    #[inline]
    pub fn at(&mut self, time_s: f64) -> PathPoint<N> {
        let time_s = if time_s.is_nan() { f64::INFINITY } else { time_s };
        // Bounded: each loop runs over the legs at most once, and only one of them moves.
        while self.pieces.get(self.current).is_some_and(|piece| time_s >= piece.from_s + piece.in_s) {
            self.current += 1;
        }
        while let Some(before) = self.current.checked_sub(1).and_then(|before| self.pieces.get(before))
            && time_s < before.from_s + before.in_s
        {
            self.current -= 1;
        }
        match self.pieces.get(self.current) {
            Some(piece) => piece.at(time_s - piece.from_s),
            None => PathPoint { position_m: self.end_m, velocity_m_per_s: SVector::zeros() },
        }
    }
}

impl<const N: usize> Path<N> {
    /// Whether the hand holds the handle at the time of the last call of [`Path::at`].
    #[inline]
    pub fn holds(&self) -> bool {
        self.pieces.get(self.current).is_none_or(|piece| !matches!(piece.shape, Shape::LetGo))
    }
}

fn checked_shape<const N: usize>(
    leg: usize,
    given: &Leg<N>,
    from_m: &SVector<f64, N>,
) -> Result<(Shape<N>, f64), HandError> {
    let (shape, in_s) = match *given {
        Leg::To { point_m, in_s } => {
            if !point_m.iter().all(|coordinate| coordinate.is_finite()) {
                return Err(HandError::NotFinite { leg });
            }
            (Shape::Line { by_m: point_m - from_m }, in_s)
        }
        Leg::Arc { center_m, by_rad, in_s, speed } => {
            if !by_rad.is_finite() || !center_m.iter().all(|coordinate| coordinate.is_finite()) {
                return Err(HandError::NotFinite { leg });
            }
            let Some([x, y]) = plane(from_m) else { return Err(HandError::NoPlane { leg }) };
            let radius_m = elementary::hypot(x - center_m[0], y - center_m[1]);
            if radius_m < SMALLEST_RADIUS_M {
                return Err(HandError::NoRadius { leg, radius_m });
            }
            (Shape::Arc { center_m, by_rad, speed }, in_s)
        }
        Leg::Wait { for_s } => (Shape::Rest, for_s),
        Leg::LetGo { for_s } => (Shape::LetGo, for_s),
    };
    if in_s.is_finite() && in_s > 0.0 { Ok((shape, in_s)) } else { Err(HandError::BadDuration { leg, in_s }) }
}

/// The x and y of a point, if it has both.
fn plane<const N: usize>(point_m: &SVector<f64, N>) -> Option<[f64; 2]> {
    match point_m.as_slice() {
        [x, y, ..] => Some([*x, *y]),
        _ => None,
    }
}

impl<const N: usize> Piece<N> {
    /// The target `since_s` after the leg began; clamped to the leg.
    fn at(&self, since_s: f64) -> PathPoint<N> {
        let share = (since_s / self.in_s).clamp(0.0, 1.0);
        match self.shape {
            Shape::Rest | Shape::LetGo => PathPoint { position_m: self.from_m, velocity_m_per_s: SVector::zeros() },
            Shape::Line { by_m } => {
                let (done, rate) = minimum_jerk(share);
                PathPoint { position_m: self.from_m + by_m * done, velocity_m_per_s: by_m * (rate / self.in_s) }
            }
            Shape::Arc { center_m, by_rad, speed } => {
                let (done, rate) = match speed {
                    Speed::Smooth => minimum_jerk(share),
                    Speed::Constant => trapezoid(share),
                };
                self.turned(center_m, by_rad * done, by_rad * rate / self.in_s)
            }
        }
    }

    fn turned(&self, center_m: [f64; 2], angle_rad: f64, rate_rad_per_s: f64) -> PathPoint<N> {
        let mut point = PathPoint { position_m: self.from_m, velocity_m_per_s: SVector::zeros() };
        let [center_x, center_y] = center_m;
        let (sin, cos) = elementary::sin_cos(angle_rad);
        if let ([x, y, ..], [velocity_x, velocity_y, ..]) =
            (point.position_m.as_mut_slice(), point.velocity_m_per_s.as_mut_slice())
        {
            let (from_x, from_y) = (*x - center_x, *y - center_y);
            let (to_x, to_y) = (cos * from_x - sin * from_y, sin * from_x + cos * from_y);
            (*x, *y) = (center_x + to_x, center_y + to_y);
            (*velocity_x, *velocity_y) = (-rate_rad_per_s * to_y, rate_rad_per_s * to_x);
        }
        point
    }
}

/// Share of the way and its derivative at a share of the time, for minimum jerk.
fn minimum_jerk(share: f64) -> (f64, f64) {
    let rest = share * (1.0 - share);
    (share * share * share * (10.0 - share * (15.0 - 6.0 * share)), 30.0 * rest * rest)
}

/// Share of the path and its derivative at a share of the time, for a trapezoid of speed with ramps of [`RAMP_SHARE`].
fn trapezoid(share: f64) -> (f64, f64) {
    const TOP: f64 = 1.0 / (1.0 - RAMP_SHARE);
    if share < RAMP_SHARE {
        let rate = TOP * share / RAMP_SHARE;
        (0.5 * rate * share, rate)
    } else if share <= 1.0 - RAMP_SHARE {
        (TOP * (share - 0.5 * RAMP_SHARE), TOP)
    } else {
        let left = 1.0 - share;
        let rate = TOP * left / RAMP_SHARE;
        (1.0 - 0.5 * rate * left, rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector1, Vector2, Vector3};
    use proptest::prelude::*;

    fn tour() -> Path<2> {
        Path::new(
            Vector2::new(0.05, 0.03),
            &[
                Leg::To { point_m: Vector2::new(0.10, 0.06), in_s: 1.0 },
                Leg::Arc { center_m: [0.0, 0.0], by_rad: 1.2, in_s: 2.0, speed: Speed::Smooth },
                Leg::Wait { for_s: 0.5 },
                Leg::Arc { center_m: [0.02, -0.01], by_rad: -2.5, in_s: 1.5, speed: Speed::Constant },
                Leg::To { point_m: Vector2::new(-0.04, 0.0), in_s: 0.3 },
            ],
        )
        .unwrap()
    }

    #[test]
    fn the_target_is_where_each_leg_ends() {
        let mut path = tour();
        assert_eq!(path.end_s, 5.3);
        assert_eq!(path.at(0.0).position_m, Vector2::new(0.05, 0.03));
        assert!((path.at(1.0).position_m - Vector2::new(0.10, 0.06)).norm() < 1e-15);
        let turned = nalgebra::Rotation2::new(1.2) * Vector2::new(0.10, 0.06);
        assert!((path.at(3.0).position_m - turned).norm() < 1e-15);
        assert_eq!(path.at(3.25).velocity_m_per_s, Vector2::zeros());
        assert!((path.at(3.5).position_m - turned).norm() < 1e-15);
        assert!((path.at(9.0).position_m - Vector2::new(-0.04, 0.0)).norm() < 1e-15);
        assert_eq!(path.at(9.0).velocity_m_per_s, Vector2::zeros());
    }

    #[test]
    fn going_back_in_time_finds_the_earlier_leg() {
        let (mut forward, mut backward) = (tour(), tour());
        backward.at(10.0);
        for index in (0..560).rev() {
            let time_s = f64::from(index) * 0.01 - 0.1;
            let there = backward.at(time_s);
            let mut fresh = forward.clone();
            assert_eq!(there, fresh.at(time_s));
        }
        assert_eq!(forward.at(f64::NAN).velocity_m_per_s, Vector2::zeros());
    }

    #[test]
    fn position_and_velocity_are_continuous_and_fit_each_other() {
        let mut path = tour();
        let step = 1e-4;
        let mut before = path.at(-step);
        for index in 0..=54_000 {
            let now = path.at(f64::from(index) * step);
            let moved = now.position_m - before.position_m;
            let mean = (now.velocity_m_per_s + before.velocity_m_per_s) * 0.5;
            // Acceleration is below 20 m/s^2 everywhere on this tour, so the trapezoid rule is good to step^2.
            assert!((moved - mean * step).norm() < 20.0 * step * step, "at {index}");
            assert!((now.velocity_m_per_s - before.velocity_m_per_s).norm() < 20.0 * step, "at {index}");
            before = now;
        }
    }

    #[test]
    fn a_constant_arc_has_constant_speed_between_its_ramps() {
        let leg = Leg::Arc { center_m: [0.0, 0.0], by_rad: 3.0, in_s: 2.0, speed: Speed::Constant };
        let mut path = Path::new(Vector2::new(0.1, 0.0), &[leg]).unwrap();
        for share in [0.1, 0.3, 0.5, 0.77, 0.9] {
            let speed = path.at(2.0 * share).velocity_m_per_s.norm();
            assert!((speed - 0.1 * 3.0 / 2.0 / 0.9).abs() < 1e-12);
        }
    }

    #[test]
    fn an_arc_in_space_keeps_its_height() {
        let leg = Leg::Arc { center_m: [0.0, 0.0], by_rad: 2.0, in_s: 1.0, speed: Speed::Smooth };
        let mut path = Path::new(Vector3::new(0.03, 0.0, 0.07), &[leg]).unwrap();
        for index in 0..=10 {
            let point = path.at(f64::from(index) * 0.1);
            assert_eq!(point.position_m.z, 0.07);
            assert_eq!(point.velocity_m_per_s.z, 0.0);
            assert!((point.position_m.xy().norm() - 0.03).abs() < 1e-15);
        }
    }

    #[test]
    fn bad_legs_are_refused_by_number() {
        let start = Vector2::new(0.1, 0.0);
        let wait = Leg::Wait { for_s: 1.0 };
        let arc = |center_m, by_rad| Leg::Arc { center_m, by_rad, in_s: 1.0, speed: Speed::Smooth };
        let refused = |leg| Path::new(start, &[wait, leg]).unwrap_err();
        assert_eq!(refused(Leg::Wait { for_s: 0.0 }), HandError::BadDuration { leg: 2, in_s: 0.0 });
        assert_eq!(refused(Leg::To { point_m: start, in_s: -1.0 }), HandError::BadDuration { leg: 2, in_s: -1.0 });
        assert!(matches!(refused(Leg::Wait { for_s: f64::NAN }), HandError::BadDuration { leg: 2, .. }));
        let nowhere = Vector2::new(f64::INFINITY, 0.0);
        assert_eq!(refused(Leg::To { point_m: nowhere, in_s: 1.0 }), HandError::NotFinite { leg: 2 });
        assert_eq!(refused(arc([0.0, f64::NAN], 1.0)), HandError::NotFinite { leg: 2 });
        assert_eq!(refused(arc([0.0, 0.0], f64::NAN)), HandError::NotFinite { leg: 2 });
        assert_eq!(refused(arc([0.1, 0.0], 1.0)), HandError::NoRadius { leg: 2, radius_m: 0.0 });
        assert_eq!(Path::<2>::new(nowhere, &[]).unwrap_err(), HandError::NotFinite { leg: 0 });
        let line = Leg::Arc { center_m: [0.0, 0.0], by_rad: 1.0, in_s: 1.0, speed: Speed::Smooth };
        assert_eq!(Path::new(Vector1::new(0.1), &[line]).unwrap_err(), HandError::NoPlane { leg: 1 });
    }

    proptest! {
        #[test]
        fn every_profile_rises_from_zero_to_one(share in 0.0..1.0, further in 0.0..0.1) {
            let further = f64::min(share + further, 1.0);
            for profile in [minimum_jerk, trapezoid] {
                let (done, rate) = profile(share);
                prop_assert!((0.0..=1.0).contains(&done) && rate >= 0.0);
                prop_assert!(profile(further).0 >= done - 1e-15);
                let (mirrored, same) = profile(1.0 - share);
                prop_assert!((mirrored + done - 1.0).abs() < 1e-14 && (same - rate).abs() < 1e-12);
            }
        }
    }
}
