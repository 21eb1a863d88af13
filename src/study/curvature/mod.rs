//! The fixture's step on a circle: the tangent in place of the curve against the exact curvature, error and time.
//!
//! All of it on the impedance device of \[KTF08\]: the reach `R/kappa` of its fixture is 1.2 mm, so that radii of the size of the
//! reach are ones that a user may draw.

mod truth;

#[cfg(test)]
mod tests;

use nalgebra::Vector2;
use serde_json::Value;
use std::f64::consts::{PI, TAU};
use std::sync::OnceLock;
use yieldwall_motion::elementary;

use self::truth::Annulus;
use super::chart::{Axis, Chart, Color, Mark, Panel, Series};
use super::sweep::{Clock, Report, Study, Sweep, Table, median};
use yieldwall_motion::fixture::{
    BallAndTube, Circle, Coupling, Curvature, Fixture, FixtureError, Forbidden, Impedance, Limits,
    ON_SURFACE_TOLERANCE_M, Parameters, Rearm, Side, Surface, YieldSet,
};

/// Period of the step in s.
const PERIOD_S: f64 = 1e-3;
/// `K`, `B`, `F` and `R` of the impedance device.
const DEVICE: Impedance = Impedance { stiffness_n_per_m: 1000.0, damping_n_s_per_m: 1.5 };
const LIMITS: Limits = Limits { friction_n: 0.5, yield_n: 3.0 };
/// `kappa` in N/m.
const STIFFNESS_N_PER_M: f64 = DEVICE.stiffness_n_per_m + DEVICE.damping_n_s_per_m / PERIOD_S;

/// Radii over `R/kappa`.
const RATIOS: [f64; 11] = [100.0, 50.0, 33.0, 20.0, 10.0, 7.0, 5.0, 3.0, 2.0, 1.5, 1.0];

/// Input positions: as many signed distances within the reach on both sides.
const DISTANCES: u32 = 61;
/// Last proxies: as many along each side of each of the two sets.
const PROXIES: u32 = 21;

/// Steps of the timed motion, and how often it is run in one stretch.
const STEPS: usize = 8192;
/// How far the motion goes off the circle, over `R/kappa`.
const SWING: f64 = 1.5;
const REPEATS: usize = 8;
/// Rounds of timing; tangent and exact in turn.
const ROUNDS: usize = 9;

/// The study `fixture`.
pub(super) struct TangentOrExact(Vec<Box<dyn Sweep>>);

impl TangentOrExact {
    pub(super) fn new() -> Self {
        Self(vec![Box::new(Ratios::default())])
    }
}

/// Error and time of both steps at each ratio.
#[derive(Default)]
struct Ratios {
    times: OnceLock<Vec<Times>>,
}

/// Nanoseconds for a step in each round, and the share of steps that end on the circle.
#[derive(Clone, Debug, Default)]
struct Times {
    tangent_ns: Vec<f64>,
    exact_ns: Vec<f64>,
    on_circle: f64,
}

impl Sweep for Ratios {
    fn name(&self) -> &'static str {
        "curvature"
    }

    fn columns(&self) -> &'static [&'static str] {
        &[
            "radius_ratio",
            "radius_m",
            "tangent_error_f_kappa",
            "exact_error_f_kappa",
            "tangent_step_ns",
            "exact_step_ns",
            "on_circle_share",
        ]
    }

    fn points(&self) -> u64 {
        RATIOS.len() as u64
    }

    fn is_timed(&self) -> bool {
        true
    }

    /// The first point times all: they are to be timed in turn.
    fn point(&self, index: u64, clock: Clock<'_>) -> Vec<Value> {
        let ratio = RATIOS[index as usize];
        let [tangent, exact] = errors(ratio);
        let all = self.times.get_or_init(|| times(clock).unwrap_or_default());
        let times = all.get(index as usize).cloned().unwrap_or_default();
        vec![
            ratio.into(),
            (ratio * LIMITS.yield_n / STIFFNESS_N_PER_M).into(),
            tangent.into(),
            exact.into(),
            median(times.tangent_ns).into(),
            median(times.exact_ns).into(),
            times.on_circle.into(),
        ]
    }
}

/// The farthest, over `F/kappa`, that the tangent and the exact step end from the nearest admissible point.
///
/// For input positions from which the surface can be reached, and for last proxies all over the two sets: whatever one set admits
/// and the other does not shows, and the corners are met. Last proxies far outside would say less: there disc and tube are
/// often as near as each other, and the least difference decides between points that are not.
fn errors(ratio: f64) -> [f64; 2] {
    let (friction_m, reach_m) = (LIMITS.friction_n / STIFFNESS_N_PER_M, LIMITS.yield_n / STIFFNESS_N_PER_M);
    let radius_m = ratio * reach_m;
    let Ok(circle) = Circle::new(Vector2::zeros(), radius_m, Forbidden::Inside) else { return [f64::NAN; 2] };
    let truth = Annulus { friction: friction_m, reach: reach_m, radius: radius_m };
    let sets = [Curvature::Tangent, Curvature::Exact]
        .map(|curvature| BallAndTube::new(LIMITS, STIFFNESS_N_PER_M, Side::Bilateral, curvature));
    let share = |index: u32, count: u32| f64::from(index) / f64::from(count - 1);
    let mut errors = [0.0; 2];
    for distance in 0..DISTANCES {
        let away_m = reach_m * (2.0 * share(distance, DISTANCES) - 1.0);
        let from_m = radius_m + away_m;
        // At the centre every direction is as good as another.
        if from_m <= 1e-9 * radius_m {
            continue;
        }
        let input = Vector2::new(from_m, 0.0);
        let foot = circle.foot(&input, &circle.own_foot());
        for along in 0..PROXIES {
            let height_m = from_m - away_m * share(along, PROXIES);
            for across in 0..PROXIES {
                let side_m = friction_m * (2.0 * share(across, PROXIES) - 1.0);
                let (sin, cos) = elementary::sin_cos((side_m / from_m).clamp(-PI, PI));
                for before in [Vector2::new(height_m, side_m), Vector2::new(cos, sin) * height_m] {
                    let right = truth.nearest(input, before);
                    for (set, error) in sets.iter().zip(&mut errors) {
                        let found = set.nearest(&circle, &foot, &input, &before).proxy;
                        let off = (found - right).norm() / friction_m;
                        *error = if off > *error || off.is_nan() { off } else { *error };
                    }
                }
            }
        }
    }
    errors
}

fn parameters(curvature: Curvature) -> Parameters {
    Parameters {
        coupling: Coupling::Impedance(DEVICE),
        limits: LIMITS,
        side: Side::Bilateral,
        hold_steps: 0,
        rearm: Rearm::default(),
        curvature,
        period_s: PERIOD_S,
    }
}

/// A tool that goes round while it swings across the circle by one and a half reaches.
fn motion(radius_m: f64) -> Vec<Vector2<f64>> {
    let reach_m = LIMITS.yield_n / STIFFNESS_N_PER_M;
    let at = |step: usize| {
        let turn = step as f64 / STEPS as f64 * TAU;
        let across_m = SWING * reach_m * elementary::sin(8.0 * turn);
        Vector2::new(elementary::cos(turn), elementary::sin(turn)) * (radius_m + across_m)
    };
    (0..STEPS).map(at).collect()
}

/// Both fixtures at every ratio, in turn.
fn times(clock: Clock<'_>) -> Result<Vec<Times>, FixtureError> {
    let mut all = vec![Times::default(); RATIOS.len()];
    for _ in 0..ROUNDS {
        for (ratio, times) in RATIOS.into_iter().zip(&mut all) {
            let radius_m = ratio * LIMITS.yield_n / STIFFNESS_N_PER_M;
            let tools = motion(radius_m);
            for curvature in [Curvature::Tangent, Curvature::Exact] {
                let circle = Circle::new(Vector2::zeros(), radius_m, Forbidden::Inside)?;
                let mut fixture = Fixture::new(circle, parameters(curvature))?;
                fixture.reset(&tools[0])?;
                // Once to warm up, and to know how much of the motion lies on the circle.
                let is_on = |distance_m: f64| distance_m.abs() <= ON_SURFACE_TOLERANCE_M;
                let on = tools.iter().filter(|tool| is_on(fixture.step_impedance(tool).signed_distance_m)).count();
                let before = clock();
                for _ in 0..REPEATS {
                    for tool in &tools {
                        std::hint::black_box(fixture.step_impedance(std::hint::black_box(tool)));
                    }
                }
                let nanoseconds = clock().saturating_sub(before).as_nanos() as f64 / (STEPS * REPEATS) as f64;
                match curvature {
                    Curvature::Tangent => times.tangent_ns.push(nanoseconds),
                    Curvature::Exact => times.exact_ns.push(nanoseconds),
                }
                times.on_circle = on as f64 / STEPS as f64;
            }
        }
    }
    Ok(all)
}

impl Study for TangentOrExact {
    fn name(&self) -> &'static str {
        "fixture"
    }

    fn about(&self) -> &'static str {
        "the fixture's step on a circle: tangent against exact curvature, error and time against the radius"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let [table] = tables else { return Report::default() };
        let curve = |column: &'static str| -> Vec<(f64, f64)> {
            table.rows().map(|row| (row.number("radius_ratio"), row.number(column))).collect()
        };
        let heads = ["radius kappa/R", "tangent error", "exact error", "tangent ns", "exact ns"];
        let mut notes = vec![format!(
            "{:>14} {:>14} {:>12} {:>11} {:>9}   greatest errors, in F/kappa",
            heads[0], heads[1], heads[2], heads[3], heads[4]
        )];
        for row in table.rows() {
            notes.push(format!(
                "{:>14} {:>14.4} {:>12.1e} {:>11.1} {:>9.1}",
                row.number("radius_ratio"),
                row.number("tangent_error_f_kappa"),
                row.number("exact_error_f_kappa"),
                row.number("tangent_step_ns"),
                row.number("exact_step_ns"),
            ));
        }
        let series = |name: &str, points, mark, color| Series { name: name.to_owned(), points, mark, color };
        let theory = RATIOS.iter().filter(|&&ratio| ratio > 1.0).map(|&ratio| (ratio, 1.0 / (ratio - 1.0))).collect();
        let ratio = || Axis::logarithmic("radius of the circle over R/kappa (-)").over(0.8, 125.0);
        let panels = vec![
            Panel {
                title: "greatest distance of a step's end from the nearest admissible point".to_owned(),
                x: ratio(),
                y: Axis::logarithmic("error over F/kappa (-)"),
                series: vec![
                    series("tangent", curve("tangent_error_f_kappa"), Mark::MarkedLine, Color::Vermilion),
                    series("exact", curve("exact_error_f_kappa"), Mark::MarkedLine, Color::Blue),
                    series("1/(ratio - 1)", theory, Mark::Dashed, Color::Black),
                ],
            },
            Panel {
                title: "time of a step, across the circle and back".to_owned(),
                x: ratio(),
                y: Axis::linear("time (ns)").over(0.0, 100.0),
                series: vec![
                    series("tangent", curve("tangent_step_ns"), Mark::MarkedLine, Color::Vermilion),
                    series("exact", curve("exact_step_ns"), Mark::MarkedLine, Color::Blue),
                ],
            },
        ];
        let title = "Tangent against exact curvature on a circle".to_owned();
        Report { notes, charts: vec![("study-fixture", Chart { title, panels, columns: 2 })] }
    }
}
