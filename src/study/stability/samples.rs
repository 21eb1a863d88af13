//! Samples of the force that are lost or come late, against the energy that the rig gives back.

use nalgebra::Vector2;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::SeedableRng;
use serde_json::Value;
use yieldwall_motion::elementary;

use super::held::{PERIOD_S, PLAIN, START_M, Setting};
use crate::bench::Bench;
use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::sweep::{Clock, Report, Sweep, Table};
use yieldwall_motion::fixture::{
    Admittance, Coupling, Curvature, EnergyObserver, Fixture, Limits, Line, Parameters, Rearm, Shape2, Side,
};
use yieldwall_sim::hand::HandLoad;
use yieldwall_sim::share_of_one;

/// Disturbance of a share of the samples.
#[derive(Clone, Copy)]
struct Trouble {
    name: &'static str,
    /// Samples that are hit in a row.
    run: u64,
    /// How late they come in cycles; `None` for never.
    late: Option<u64>,
}

const TROUBLES: [Trouble; 4] = [
    Trouble { name: "lost, one at a time", run: 1, late: None },
    Trouble { name: "lost, 10 in a row", run: 10, late: None },
    Trouble { name: "1 cycle late", run: 1, late: Some(1) },
    Trouble { name: "5 cycles late", run: 1, late: Some(5) },
];
const SHARES: [f64; 8] = [0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7];
const HANDS_N_PER_M: [f64; 2] = [1000.0, 3000.0];
const MASSES_KG: [f64; 2] = [0.5, 2.0];
const SEEDS: u64 = 8;
const HAND_N_S_PER_M: f64 = 15.0;
const COULOMB_N_M: f64 = 10.0;
const DURATION_S: f64 = 4.0;
/// The hand's force would swing by this much on a tool at rest: beyond `R` and back.
const SWING_N: f64 = 30.0;
const SWING_HZ: f64 = 0.5;
const LIMITS: Limits = Limits { friction_n: 3.0, yield_n: 20.0 };
/// Oldest sample that the bench still has.
const OLDEST: u64 = 31;

/// A hand that swings across a guide which yields, dry joints, and samples that are lost or late.
pub(super) struct Samples;

impl Sweep for Samples {
    fn name(&self) -> &'static str {
        "samples"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["trouble", "hand_n_per_m", "virtual_mass_kg", "share", "seed", "given_j", "largest_return_j", "is_bounded"]
    }

    fn points(&self) -> u64 {
        (TROUBLES.len() * HANDS_N_PER_M.len() * MASSES_KG.len() * SHARES.len()) as u64 * SEEDS
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (rest, seed) = (index as usize / SEEDS as usize, index % SEEDS);
        let (rest, share) = (rest / SHARES.len(), SHARES[rest % SHARES.len()]);
        let (rest, mass_kg) = (rest / MASSES_KG.len(), MASSES_KG[rest % MASSES_KG.len()]);
        let (rest, hand_n_per_m) = (rest / HANDS_N_PER_M.len(), HANDS_N_PER_M[rest % HANDS_N_PER_M.len()]);
        let trouble = TROUBLES[rest];
        let energy = run(trouble, share, mass_kg, hand_n_per_m, seed);
        vec![
            trouble.name.into(),
            hand_n_per_m.into(),
            mass_kg.into(),
            share.into(),
            seed.into(),
            energy.map(|[given, _]| given).into(),
            energy.map(|[_, most]| most).into(),
            energy.is_some().into(),
        ]
    }
}

/// Energy given to the hand in all, and the most in one go, in J; `None` if the tool is thrown out of reach.
fn run(trouble: Trouble, share: f64, mass_kg: f64, hand_n_per_m: f64, seed: u64) -> Option<[f64; 2]> {
    let line = Line::new(START_M, Vector2::y()).ok()?;
    let parameters = Parameters {
        coupling: Coupling::Admittance(Admittance { mass_kg }),
        limits: LIMITS,
        side: Side::Bilateral,
        hold_steps: 0,
        rearm: Rearm::OffSurface,
        curvature: Curvature::Tangent,
        period_s: PERIOD_S,
    };
    let fixture = Fixture::new(Shape2::Line(line), parameters).ok()?;
    let dry = Setting { coulomb_n_m: COULOMB_N_M, servo_delay: 1, ..PLAIN };
    let mut bench = Bench::new(&dry.parameters()?, fixture).ok()?;
    let mut observer = EnergyObserver::<2>::new(PERIOD_S, mass_kg);
    let mut stream = SplitMix64::seed_from_u64(seed);
    let mut arrivals = [Some(0_u64); OLDEST as usize + 1];
    let mut hit_until = 0;
    let swing = |time_s: f64| {
        let (sin, cos) = elementary::sin_cos(std::f64::consts::TAU * SWING_HZ * time_s);
        (sin, std::f64::consts::TAU * SWING_HZ * cos)
    };
    // A little along the guide too.
    let way_m = Vector2::new(0.3, 1.0) * (SWING_N / hand_n_per_m);
    let mut newest = 0;
    for cycle in 0..(DURATION_S / PERIOD_S) as u64 {
        let chance = share_of_one(&mut stream);
        // The first sample always comes. Runs begin this often between runs so that they hit this share of all.
        let begins = share / (trouble.run as f64 * (1.0 - share) + share);
        if cycle > 0 && cycle >= hit_until && chance < begins {
            hit_until = cycle + trouble.run;
        }
        let arrival = if cycle < hit_until { trouble.late.map(|late| cycle + late) } else { Some(cycle) };
        arrivals[(cycle % (OLDEST + 1)) as usize] = arrival;
        let oldest = cycle.saturating_sub(OLDEST);
        let has_come = |sample: &u64| arrivals[(sample % (OLDEST + 1)) as usize].is_some_and(|at| at <= cycle);
        newest = (oldest..=cycle).rev().find(has_come).map_or(newest, |sample| sample.max(newest));
        let hand = |time_s: f64, tip: yieldwall_motion::quantity::TipPoint| {
            let (place, rate) = swing(time_s);
            HandLoad {
                force_n: (START_M + way_m * place - tip.0) * hand_n_per_m + way_m * (rate * HAND_N_S_PER_M),
                damping_n_s_per_m: HAND_N_S_PER_M,
                stiffness_n_per_m: hand_n_per_m,
            }
        };
        let seen = bench.run_cycle(newest, hand).ok()?;
        observer.observe(&seen.tool_m, &-seen.force_n, &seen.step);
    }
    Some([observer.energy().given_j, observer.energy().largest_return_j])
}

pub(super) fn report(table: &Table, report: &mut Report) {
    let mut panels = Vec::new();
    for hand_n_per_m in HANDS_N_PER_M {
        for mass_kg in MASSES_KG {
            let mut series = Vec::new();
            let mut line = format!(
                "energy given back in mJ, hand of {hand_n_per_m} N/m, M = {mass_kg} kg, 70 % of samples (none)"
            );
            for (trouble, color) in TROUBLES.into_iter().zip(Color::LINES) {
                let points: Vec<_> = SHARES
                    .into_iter()
                    .map(|share| {
                        let runs: Vec<f64> = table
                            .rows()
                            .filter(|row| {
                                row.word("trouble") == trouble.name
                                    && row.number("hand_n_per_m") == hand_n_per_m
                                    && row.number("virtual_mass_kg") == mass_kg
                                    && row.number("share") == share
                            })
                            .map(|row| row.number("given_j"))
                            .collect();
                        // One run that threw the tool away has no mean.
                        (100.0 * share, 1e3 * runs.iter().sum::<f64>() / runs.len() as f64)
                    })
                    .collect();
                if let (Some(none), Some(most)) = (points.first(), points.last()) {
                    line += &format!(", {} {:.4} ({:.4})", trouble.name, most.1, none.1);
                }
                series.push(Series { name: trouble.name.to_owned(), points, mark: Mark::MarkedLine, color });
            }
            report.notes.push(line);
            panels.push(Panel {
                title: format!("hand of {hand_n_per_m} N/m, M = {mass_kg} kg"),
                x: Axis::linear("samples hit (%)").over(0.0, 75.0),
                y: Axis::logarithmic("energy given to the hand (mJ)"),
                series,
            });
        }
    }
    let chart = Chart {
        title: "Energy given back in 4 s while samples of the force are lost or late; means of 8 runs".to_owned(),
        panels,
    };
    report.charts.push(("study-stability-samples", chart));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_guide_gives_nothing_back_until_samples_are_lost_in_rows() {
        let bursts = TROUBLES[1];
        let [none, lost] = [0.0, 0.7].map(|share| run(bursts, share, 0.5, 3000.0, 1).unwrap()[0]);
        assert!(none < 1e-6, "{none}");
        assert!(lost > 1e-3, "{lost}");
    }
}
