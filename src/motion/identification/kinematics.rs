//! Link lengths and encoder zeros of a five-bar, from points at which its tool was while its joints had known angles.

use nalgebra::{SMatrix, SVector};

use super::{Estimate, NotIdentified};
use crate::linkage::{FiveBar, Geometry};
use crate::quantity::{JointAngles, TipPoint};

/// Parameters: proximal and distal links of both chains, and zeros of both encoders.
const PARAMETERS: usize = 6;
/// Steps of the difference quotients: m and rad.
const STEP: f64 = 1e-6;
/// Iterations at most, and the change of any parameter below which they end.
const ITERATIONS: usize = 100;
const SETTLED: f64 = 1e-12;
/// Number of increases of the damping before an iteration is abandoned.
const TRIES: usize = 12;
/// Greatest half width of an interval, as a share of a link: beyond it the points do not determine the parameters.
const WIDEST: f64 = 0.05;

/// Largest number of points with a search for exchanged pairs.
const MOST_EXCHANGED: usize = 24;

/// A point of the tool in the base frame, and the joint angles there, rad.
pub type Visited = (TipPoint, JointAngles);

/// Kinematics of a five-bar, from its points.
#[derive(Clone, Debug, PartialEq)]
pub struct Kinematics {
    /// The geometry with the link lengths that fit.
    pub geometry: Geometry,
    /// Lengths of the proximal links, left then right, m.
    pub proximal_m: [Estimate; 2],
    /// Lengths of the distal links, left then right, m.
    pub distal_m: [Estimate; 2],
    /// Corrections to add to the angles, left then right, rad.
    pub zero_rad: [Estimate; 2],
    /// Root mean square of the distances of the points from where the tool is by the angles, m: before and after.
    pub residual_m: [f64; 2],
    /// The greatest of these distances after, m, and at which point.
    pub worst: (usize, f64),
}

/// A geometry with other links, and the angles that are added to those of the encoders.
#[derive(Clone, Copy)]
struct Candidate(SVector<f64, PARAMETERS>);

impl Candidate {
    fn of(geometry: &Geometry) -> Self {
        let ([a, b], [c, d]) = (geometry.proximal_m, geometry.distal_m);
        Self(SVector::from([a, b, c, d, 0.0, 0.0]))
    }

    fn geometry(&self, like: &Geometry) -> Geometry {
        let [a, b, c, d, ..]: [f64; PARAMETERS] = self.0.into();
        Geometry { proximal_m: [a, b], distal_m: [c, d], ..*like }
    }

    /// Returns the offset of the tool from each point, m; nothing where the linkage does not close.
    fn residuals(&self, like: &Geometry, visited: &[Visited]) -> Option<Vec<f64>> {
        let [.., left, right]: [f64; PARAMETERS] = self.0.into();
        let linkage = FiveBar::new(self.geometry(like)).ok()?;
        let mut all = Vec::with_capacity(2 * visited.len());
        for (point, angles) in visited {
            let off = linkage.forward(*angles + JointAngles::new(left, right)).ok()?.tip - *point;
            all.extend(off.to_array());
        }
        Some(all)
    }
}

fn squares(residuals: &[f64]) -> f64 {
    residuals.iter().map(|off| off * off).sum()
}

/// Fits link lengths and encoder zeros to points that the tool has visited. Base joints and tool are those of `geometry`, whose lengths are the
/// first guess.
///
/// Levenberg and Marquardt's damped least squares over the distances at the tool; intervals are those of independent normal errors.
///
/// # Errors
/// - [`NotIdentified::TooFew`] with less than four points;
/// - [`NotIdentified::NotFinite`];
/// - [`NotIdentified::Apart`] if the points do not determine the parameters, or if the linkage cannot be at them.
pub fn kinematics(geometry: &Geometry, visited: &[Visited]) -> Result<Kinematics, NotIdentified> {
    if 2 * visited.len() < PARAMETERS + 2 {
        return Err(NotIdentified::TooFew);
    }
    if !visited.iter().all(|(point, angles)| point.is_finite() && angles.is_finite()) {
        return Err(NotIdentified::NotFinite);
    }
    let mut best = Candidate::of(geometry);
    let mut residuals = best.residuals(geometry, visited).ok_or(NotIdentified::Apart)?;
    let rms = |residuals: &[f64]| (squares(residuals) / visited.len() as f64).sqrt();
    let before = rms(&residuals);
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        let (normal, slope) = equations(&best, geometry, visited, &residuals)?;
        let mut step = None;
        for _ in 0..TRIES {
            let mut damped = normal;
            for at in 0..PARAMETERS {
                damped[(at, at)] *= 1.0 + damping;
            }
            let change = damped.cholesky().map(|solver| solver.solve(&slope));
            let tried = change.map(|change| (change, Candidate(best.0 - change)));
            let closed = tried.and_then(|(change, tried)| {
                let residuals = tried.residuals(geometry, visited)?;
                Some((change, tried, residuals))
            });
            if let Some((change, tried, new)) = closed.filter(|(.., new)| squares(new) <= squares(&residuals)) {
                (best, residuals, step) = (tried, new, Some(change));
                damping = (damping * 0.1).max(1e-12);
                break;
            }
            damping *= 10.0;
        }
        if step.is_none_or(|step| step.amax() < SETTLED) {
            break;
        }
    }
    let (normal, _) = equations(&best, geometry, visited, &residuals)?;
    let covariance = normal.cholesky().ok_or(NotIdentified::Apart)?.inverse();
    let degrees = 2 * visited.len() - PARAMETERS;
    let variance = squares(&residuals) / degrees as f64;
    let estimate = |at: usize| Estimate::new(best.0[at], (variance * covariance[(at, at)]).sqrt(), degrees as f64);
    let found = Kinematics {
        geometry: best.geometry(geometry),
        proximal_m: [estimate(0), estimate(1)],
        distal_m: [estimate(2), estimate(3)],
        zero_rad: [estimate(4), estimate(5)],
        residual_m: [before, rms(&residuals)],
        worst: worst(&residuals),
    };
    let links = found.proximal_m.iter().chain(&found.distal_m);
    let is_apart = links.into_iter().all(|link| link.half_width() <= WIDEST * link.value);
    if is_apart { Ok(found) } else { Err(NotIdentified::Apart) }
}

/// Mistake in points that fit no arm as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mistaken {
    /// This point: the others fit without it.
    Point(usize),
    /// The tool visited these two in the other order.
    Exchanged(usize, usize),
}

/// Returns the change with which points that [`kinematics`] cannot fit are within `within_m` in the mean. The change leaves out one point
/// or exchanges two; the result is `None` if no such change is enough. If both kinds do, the one with the smaller residual is taken,
/// exchanged points first. With more than 24 points, exchanged points are not searched for: there are too many pairs.
pub fn mistaken(geometry: &Geometry, visited: &[Visited], within_m: f64) -> Option<Mistaken> {
    let left_m = |visited: &[Visited]| {
        let found = kinematics(geometry, visited).ok()?;
        Some(found.residual_m[1]).filter(|left_m| *left_m <= within_m)
    };
    let count = visited.len();
    let some = if count <= MOST_EXCHANGED { count } else { 0 };
    let pairs = (0..some).flat_map(|one| (one + 1..some).map(move |other| (one, other)));
    let exchanged = pairs.filter_map(|(one, other)| {
        let mut tried = visited.to_vec();
        let angles = tried.get(one)?.1;
        tried.get_mut(one)?.1 = visited.get(other)?.1;
        tried.get_mut(other)?.1 = angles;
        Some((left_m(&tried)?, Mistaken::Exchanged(one, other)))
    });
    let without = (0..count).filter_map(|at| {
        let others: Vec<Visited> =
            (0..).zip(visited).filter(|(other, _)| *other != at).map(|(_, point)| *point).collect();
        Some((left_m(&others)?, Mistaken::Point(at)))
    });
    exchanged.chain(without).min_by(|(one, _), (other, _)| one.total_cmp(other)).map(|(_, mistaken)| mistaken)
}

/// Returns the normal equations at a candidate: `J^T J` and `J^T r`.
fn equations(
    candidate: &Candidate,
    geometry: &Geometry,
    visited: &[Visited],
    residuals: &[f64],
) -> Result<(SMatrix<f64, PARAMETERS, PARAMETERS>, SVector<f64, PARAMETERS>), NotIdentified> {
    let mut columns: [Vec<f64>; PARAMETERS] = Default::default();
    for (at, column) in columns.iter_mut().enumerate() {
        let beside = |by: f64| {
            let mut moved = *candidate;
            moved.0[at] += by;
            moved.residuals(geometry, visited).ok_or(NotIdentified::Apart)
        };
        let (above, below) = (beside(STEP)?, beside(-STEP)?);
        *column = above.iter().zip(&below).map(|(above, below)| (above - below) / (2.0 * STEP)).collect();
    }
    let dot = |one: &[f64], other: &[f64]| one.iter().zip(other).map(|(one, other)| one * other).sum::<f64>();
    let normal = SMatrix::from_fn(|row, column| dot(&columns[row], &columns[column]));
    let slope = SVector::from_fn(|row, _| dot(&columns[row], residuals));
    Ok((normal, slope))
}

/// Returns the point that is farthest from where the tool is, and how far, m.
fn worst(residuals: &[f64]) -> (usize, f64) {
    let distances = residuals.chunks(2).map(|off| squares(off).sqrt());
    distances.enumerate().fold((0, 0.0), |worst, (at, off)| if off > worst.1 { (at, off) } else { worst })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linkage::{Chain, Side, Tool, WristSide};
    use crate::quantity::TipDisplacement;
    use proptest::prelude::*;

    /// Returns an arm as a drawing has it, and the same as it was built.
    fn drawn() -> Geometry {
        Geometry {
            base_m: [[-0.10, -0.45], [0.10, -0.45]],
            proximal_m: [0.30; 2],
            distal_m: [0.40; 2],
            elbows: [Side::Left, Side::Right],
            wrist: WristSide::Forward,
            tool: Tool { fixed_to: Chain::Right, along_m: 0.0, across_m: 0.0 },
        }
    }

    /// Returns the points on two circles about the task's origin, and the angles at which a built arm is there, by encoders with these
    /// zeros.
    fn visited(built: &Geometry, zero_rad: [f64; 2], off_m: impl Fn(usize) -> f64) -> Vec<Visited> {
        let linkage = FiveBar::new(*built).unwrap();
        let of = |at: usize| {
            let (radius, angle) = ([0.05, 0.11][at % 2], at as f64 * std::f64::consts::TAU / 16.0);
            let (sin, cos) = crate::elementary::sin_cos(angle);
            let point = TipPoint::new(radius * cos, radius * sin);
            let angles = linkage.inverse(point).unwrap() - JointAngles::from(zero_rad);
            let [x, y] = point.to_array();
            (TipPoint::new(x + off_m(2 * at), y + off_m(2 * at + 1)), angles)
        };
        (0..16).map(of).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

        #[test]
        fn lengths_and_zeros_are_found_as_they_are(
            links in prop::array::uniform4(-0.004..0.004f64), zero_rad in prop::array::uniform2(-0.03..0.03f64),
        ) {
            let mut built = drawn();
            for (at, by) in links.into_iter().enumerate() {
                if at < 2 { built.proximal_m[at] += by } else { built.distal_m[at - 2] += by }
            }
            let found = kinematics(&drawn(), &visited(&built, zero_rad, |_| 0.0)).unwrap();
            let all = [found.proximal_m, found.distal_m, found.zero_rad].concat();
            let truth = [built.proximal_m, built.distal_m, zero_rad].concat();
            prop_assert!(all.iter().zip(truth).all(|(found, truth)| (found.value - truth).abs() < 1e-7), "{found:?}");
            prop_assert!(found.residual_m[1] < 1e-9 && found.residual_m[0] >= found.residual_m[1]);
        }
    }

    #[test]
    fn intervals_hold_what_noise_makes_of_it() {
        let mut built = drawn();
        (built.proximal_m[0], built.distal_m[1]) = (built.proximal_m[0] + 1e-3, built.distal_m[1] - 1e-3);
        let truth = [built.proximal_m[0], built.proximal_m[1], built.distal_m[0], built.distal_m[1], 0.01, -0.02];
        let mut held = 0;
        let runs = 60;
        for seed in 0..runs {
            // 0.1 mm, by a hash of seed and place.
            let noise = |at: usize| {
                let unit = |salt: u64| {
                    let hash = (seed * 7919 + at as u64 * 104_729 + salt).wrapping_mul(0x9e37_79b9_7f4a_7c15);
                    ((hash ^ hash >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 11) as f64 / (1u64 << 53) as f64
                };
                1e-4 * ((0..12).map(|salt| unit(salt + 1)).sum::<f64>() - 6.0)
            };
            let found = kinematics(&drawn(), &visited(&built, [0.01, -0.02], noise)).unwrap();
            assert!((0.5e-4..2e-4).contains(&found.residual_m[1]), "{found:?}");
            let all = [found.proximal_m, found.distal_m, found.zero_rad].concat();
            held += all.iter().zip(truth).filter(|(estimate, truth)| estimate.contains(*truth)).count();
        }
        let share = held as f64 / (6 * runs) as f64;
        assert!((0.88..=1.0).contains(&share), "{share}");
    }

    #[test]
    fn points_that_tell_nothing_are_refused() {
        let all = visited(&drawn(), [0.0; 2], |_| 0.0);
        assert_eq!(kinematics(&drawn(), &all[..3]), Err(NotIdentified::TooFew));
        let one: Vec<Visited> = std::iter::repeat_n(all[0], 12).collect();
        assert_eq!(kinematics(&drawn(), &one), Err(NotIdentified::Apart));
        let mut bad = all;
        bad[3].0 = TipPoint::new(f64::NAN, 0.0);
        assert_eq!(kinematics(&drawn(), &bad), Err(NotIdentified::NotFinite));
    }

    #[test]
    fn what_was_mistaken_grossly_is_found() {
        let good = visited(&drawn(), [0.0; 2], |at| if at % 3 == 0 { 1e-5 } else { -1e-5 });
        let off = |at: usize, by_m: f64| {
            let mut bad = good.clone();
            bad[at].0 += TipDisplacement::new(by_m, 0.0);
            bad
        };
        for (at, by_m) in [(3, 0.015), (0, 0.02), (5, -0.05)] {
            assert_eq!(mistaken(&drawn(), &off(at, by_m), 5e-4), Some(Mistaken::Point(at)));
        }
        let mut exchanged = good.clone();
        (exchanged[2].1, exchanged[6].1) = (good[6].1, good[2].1);
        assert_eq!(mistaken(&drawn(), &exchanged, 5e-4), Some(Mistaken::Exchanged(2, 6)));
        let mut two = off(1, 0.03);
        two[4].0 += TipDisplacement::new(0.0, -0.04);
        assert_eq!(mistaken(&drawn(), &two, 5e-4), None);
    }

    #[test]
    fn a_point_that_was_mistaken_is_named() {
        let found = kinematics(&drawn(), &visited(&drawn(), [0.0; 2], |at| if at == 10 { 5e-3 } else { 0.0 })).unwrap();
        assert_eq!(found.worst.0, 5);
        assert!(found.worst.1 > 2e-3);
    }
}
