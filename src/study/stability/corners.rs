//! Corners, centres and bisectors, where the nearest point of the surface jumps: how far the proxy jumps.

use nalgebra::Vector2;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::SeedableRng;
use serde_json::Value;
use yieldwall_motion::elementary;

use super::STUDY;
use super::held::PERIOD_S;
use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::sweep::{Clock, Report, Sweep, Table};
use yieldwall_motion::fixture::{
    Chain, Circle, Coupling, Curvature, Fixture, Forbidden, Impedance, Limits, Line, Parameters, Rearm, Several,
    Shape2, Side,
};
use yieldwall_sim::share_of_one;

const LIMITS: Limits = Limits { friction_n: 0.5, yield_n: 3.0 };
const STIFFNESS_N_PER_M: f64 = 1000.0;
/// `R/kappa`.
const REACH_M: f64 = LIMITS.yield_n / STIFFNESS_N_PER_M;
const SPEEDS: u64 = 6;
const SPEEDS_M_PER_S: [f64; 2] = [0.005, 0.5];
const SEEDS: u64 = 25;
const STEPS: u32 = 4000;
/// Tones of a path in each direction.
const TONES: usize = 4;
/// The tool roams so far about the place.
const ROAM_M: f64 = 2.5 * REACH_M;
/// Length by which the step may exceed the step of the input position, by the rule of the fixture.
const RULE: f64 = 0.1;

#[derive(Clone, Copy)]
enum Region {
    Center,
    GuideCorner,
    WallCorner,
    WallEdge,
    TwoWalls,
    TwoGuides,
}

const PLACES: [(Region, &str); 6] = [
    (Region::Center, "centre of a small circle"),
    (Region::GuideCorner, "corner of a guide"),
    (Region::WallCorner, "inner corner of a wall"),
    (Region::WallEdge, "outer corner of a wall"),
    (Region::TwoWalls, "two walls that cross"),
    (Region::TwoGuides, "two guides that cross"),
];

impl Region {
    fn shape(self) -> Option<Shape2> {
        let square = |forbidden| {
            let corners = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]].map(Vector2::from);
            Chain::polygon(&corners, forbidden).ok().map(Shape2::Chain)
        };
        let crossing = |are_walls| {
            let lines = [Vector2::x(), Vector2::y()].map(|normal| Line::new(Vector2::zeros(), normal));
            let lines = lines.into_iter().map(|line| line.ok().map(Shape2::Line)).collect::<Option<Vec<_>>>()?;
            Several::new(lines, are_walls).ok().map(Shape2::Several)
        };
        match self {
            Self::Center => Circle::new(Vector2::zeros(), 1.2 * REACH_M, Forbidden::Inside).ok().map(Shape2::Circle),
            Self::GuideCorner | Self::WallCorner => square(Forbidden::Outside),
            Self::WallEdge => square(Forbidden::Inside),
            Self::TwoWalls => crossing(true),
            Self::TwoGuides => crossing(false),
        }
    }

    fn side(self) -> Side {
        match self {
            Self::WallCorner | Self::WallEdge | Self::TwoWalls => Side::Unilateral,
            Self::Center | Self::GuideCorner | Self::TwoGuides => Side::Bilateral,
        }
    }
}

/// A tool that roams about such a place under an impedance fixture.
pub(super) struct Jumps;

impl Sweep for Jumps {
    fn name(&self) -> &'static str {
        "corners"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["place", "speed_m_per_s", "seed", "jumps", "longest_step_over_reach", "longest_excess_over_reach"]
    }

    fn points(&self) -> u64 {
        PLACES.len() as u64 * SPEEDS * SEEDS
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (rest, seed) = (index / SEEDS, index % SEEDS);
        let (place, name) = PLACES[(rest / SPEEDS) as usize];
        let speed_m_per_s = on_speed(rest % SPEEDS);
        let found = roam(place, speed_m_per_s, seed);
        vec![
            name.into(),
            speed_m_per_s.into(),
            seed.into(),
            found.map(|(jumps, _, _)| jumps).into(),
            found.map(|(_, longest, _)| longest / REACH_M).into(),
            found.map(|(_, _, excess)| excess / REACH_M).into(),
        ]
    }
}

fn on_speed(index: u64) -> f64 {
    super::on_grid(index, SPEEDS, SPEEDS_M_PER_S)
}

/// How often the proxy was kept from a jump, its longest step, and by how much a step was longer than that of the input
/// position, at most.
fn roam(place: Region, speed_m_per_s: f64, seed: u64) -> Option<(u32, f64, f64)> {
    let parameters = Parameters {
        coupling: Coupling::Impedance(Impedance { stiffness_n_per_m: STIFFNESS_N_PER_M, damping_n_s_per_m: 0.0 }),
        limits: LIMITS,
        side: place.side(),
        hold_steps: 0,
        rearm: Rearm::OffSurface,
        curvature: Curvature::Tangent,
        period_s: PERIOD_S,
    };
    let mut fixture = Fixture::new(place.shape()?, parameters).ok()?;
    let mut stream = SplitMix64::seed_from_u64(seed);
    let mut uniform = || share_of_one(&mut stream);
    // Tones within an octave; their amplitudes add up to the range.
    let turn_rad_per_s = speed_m_per_s / ROAM_M;
    let tones: Vec<[f64; 4]> = (0..TONES).map(|_| [0.5 + uniform(), uniform(), 0.5 + uniform(), uniform()]).collect();
    let at = |time_s: f64| {
        let wave = |rate: f64, phase: f64| {
            elementary::sin(2.0 * rate * turn_rad_per_s * time_s + std::f64::consts::TAU * phase)
        };
        let sum = tones
            .iter()
            .fold(Vector2::zeros(), |sum, tone| sum + Vector2::new(wave(tone[0], tone[1]), wave(tone[2], tone[3])));
        sum * (ROAM_M / TONES as f64)
    };
    fixture.reset(&at(0.0)).ok()?;
    let (mut proxy, mut input) = (at(0.0), at(0.0));
    let (mut jumps, mut longest, mut excess) = (0, 0.0_f64, 0.0_f64);
    for index in 1..=STEPS {
        let step = fixture.step_impedance(&at(f64::from(index) * PERIOD_S));
        let [moved, offered] = [(step.proxy - proxy).norm(), (step.input - input).norm()];
        jumps += u32::from(step.is_step_limited);
        longest = longest.max(moved);
        excess = excess.max(moved - offered);
        (proxy, input) = (step.proxy, step.input);
    }
    Some((jumps, longest, excess))
}

pub(super) fn report(table: &Table, report: &mut Report) {
    let mut series = Vec::new();
    for ((_, name), color) in PLACES.into_iter().zip(Color::LINES) {
        let rows = || table.rows().filter(move |row| row.word("place") == name);
        let points = rows().map(|row| (row.number("speed_m_per_s"), row.number("longest_excess_over_reach"))).collect();
        series.push(Series { name: name.to_owned(), points, mark: Mark::Marks, color });
        let worst = rows()
            .max_by(|a, b| a.number("longest_excess_over_reach").total_cmp(&b.number("longest_excess_over_reach")));
        let beyond = rows().filter(|row| row.number("longest_excess_over_reach") > RULE * (1.0 + 1e-6)).count();
        let kept: f64 = rows().map(|row| row.number("jumps")).sum();
        if let Some(worst) = worst {
            report.notes.push(format!(
                "{name}: {kept} steps kept from a jump; a step is longer than that of the input position by {:.3} R/kappa at most \
                 ({}); {beyond} of {} runs beyond {RULE}",
                worst.number("longest_excess_over_reach"),
                worst.command(STUDY),
                SPEEDS * SEEDS
            ));
        }
    }
    series.push(Series {
        name: "rule, 0.1 R/kappa".to_owned(),
        points: vec![(SPEEDS_M_PER_S[0], RULE), (SPEEDS_M_PER_S[1], RULE)],
        mark: Mark::Line,
        color: Color::Black,
    });
    series.push(Series {
        name: "a jump without the rule, (R - F)/kappa".to_owned(),
        points: [0, 1].map(|end| (SPEEDS_M_PER_S[end], (LIMITS.yield_n - LIMITS.friction_n) / LIMITS.yield_n)).to_vec(),
        mark: Mark::Dashed,
        color: Color::Black,
    });
    let panel = Panel {
        title: "each run's worst step".to_owned(),
        x: Axis::logarithmic("greatest speed of the tool (m/s), about").over(4e-3, 0.6),
        y: Axis::linear("longer than the input's step by (R/kappa)").over(-0.05, 1.5),
        series,
    };
    let chart = Chart { title: "Steps of the proxy where the nearest point jumps".to_owned(), panels: vec![panel] };
    report.charts.push(("study-stability-corners", chart));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inner_corner_of_a_wall_makes_no_jump() {
        for place in [Region::WallCorner, Region::TwoWalls] {
            for seed in 0..5 {
                let (_, longest, excess) = roam(place, 0.1, seed).unwrap();
                assert!(excess <= RULE * REACH_M && longest > 0.0, "{excess} {longest}");
            }
        }
    }

    /// Guides that jumped by 1.4 R/kappa before the proxy stayed with its own edge.
    #[test]
    fn guides_keep_the_rule_to_a_tenth_of_it() {
        for place in [Region::Center, Region::GuideCorner, Region::TwoGuides] {
            for seed in 0..5 {
                for speed in [0.02, 0.5] {
                    let (jumps, _, excess) = roam(place, speed, seed).unwrap();
                    assert!(excess <= 1.1 * RULE * REACH_M, "{excess} at {speed}, {seed}");
                    assert!(jumps > 0 || speed < 0.1);
                }
            }
        }
    }
}
