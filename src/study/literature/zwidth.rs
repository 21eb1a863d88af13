//! The passive stiffness of a virtual wall under sampling and counts, against a sampled coupling that is followed exactly.

use serde_json::Value;

use super::quantised::{Coupling, Motion};
use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::sweep::{Clock, Report, Row, Sweep, Table};
use yieldwall_motion::elementary;

pub(super) const MASS_KG: f64 = 0.1;
pub(super) const STIFFNESS_N_PER_M: f64 = 10_000.0;
pub(super) const PERIOD_S: f64 = 1e-3;
const COUNT_M: f64 = 1e-5;
/// The mass starts so many counts away from where its push and the spring are even.
const START_COUNTS: f64 = 10.0;
const CYCLES: u32 = 20_000;
/// Farther away the motion has grown without bound.
const LOST_COUNTS: f64 = 1e4;
/// Friction over the least that is passive: `2 b/(K T)` and `2 f_c/(K Delta)`.
const SHARES: [f64; 2] = [0.1, 10.0];
const CELLS: u64 = 28;
/// Width of a cell, thousandths of the panel.
const CELL: u32 = 39;
/// Columns of the map whose swings are drawn.
const DRAWN: [u64; 3] = [13, 16, 24];

/// The end of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Outcome {
    Rests,
    Swings { counts: f64 },
    Grows,
}

/// The motion with these shares of the least passive friction.
fn outcome(viscous_share: f64, dry_share: f64) -> Outcome {
    let force_of_count_n = STIFFNESS_N_PER_M * COUNT_M;
    let coupling = Coupling {
        mass_kg: MASS_KG,
        viscous_n_s_per_m: viscous_share * 0.5 * STIFFNESS_N_PER_M * PERIOD_S,
        dry_n: dry_share * 0.5 * force_of_count_n,
        stiffness_n_per_m: STIFFNESS_N_PER_M,
        period_s: PERIOD_S,
        count_m: COUNT_M,
        // Half way between two counts, where friction has most to hold.
        push_n: 0.5 * force_of_count_n,
    };
    let mut now = Motion { place_m: (1.0 + START_COUNTS) * COUNT_M, speed_m_per_s: 0.0 };
    let [mut least, mut most] = [f64::INFINITY, f64::NEG_INFINITY];
    for cycle in 0..CYCLES {
        let next = coupling.step(now, |place_m| {
            if cycle > CYCLES / 2 {
                (least, most) = (least.min(place_m), most.max(place_m));
            }
        });
        if next.speed_m_per_s == 0.0 && next == now {
            return Outcome::Rests;
        }
        now = next;
        if now.place_m.abs() > LOST_COUNTS * COUNT_M {
            return Outcome::Grows;
        }
    }
    Outcome::Swings { counts: (most - least) / COUNT_M }
}

/// The dry share from which on dry friction takes more energy of a swing of [`START_COUNTS`] than sampling gives, by the first harmonic:
/// `f_c = (pi/4) (K T/2 - b) omega A`.
fn energy_balance(viscous_share: f64) -> f64 {
    let turn = elementary::powf(STIFFNESS_N_PER_M / MASS_KG, 0.5) * PERIOD_S;
    0.25 * std::f64::consts::PI * (1.0 - viscous_share) * turn * START_COUNTS
}

fn share(index: u64) -> f64 {
    SHARES[0] * elementary::powf(SHARES[1] / SHARES[0], (index as f64 + 0.5) / CELLS as f64)
}

/// Every viscous friction with every dry one.
pub(super) struct Map;

impl Sweep for Map {
    fn name(&self) -> &'static str {
        "zwidth"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["viscous_share", "dry_share", "is_within_bound", "outcome", "swing_counts"]
    }

    fn points(&self) -> u64 {
        CELLS * CELLS
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let [viscous_share, dry_share] = [share(index / CELLS), share(index % CELLS)];
        let (word, counts) = match outcome(viscous_share, dry_share) {
            Outcome::Rests => ("rests", Value::from(0.0)),
            Outcome::Swings { counts } => ("swings", counts.into()),
            Outcome::Grows => ("grows", Value::Null),
        };
        let is_within = viscous_share >= 1.0 && dry_share >= 1.0;
        vec![viscous_share.into(), dry_share.into(), is_within.into(), word.into(), counts]
    }
}

pub(super) fn report(table: &Table, report: &mut Report) {
    let count = |meets: &dyn Fn(&Row<'_>) -> bool| table.rows().filter(meets).count();
    let [within, resting] =
        [true, false].map(|all| count(&|row| row.is("is_within_bound") && (all || row.word("outcome") == "rests")));
    let beyond = count(&|row| !row.is("is_within_bound") && row.word("outcome") == "rests");
    report.notes.push(format!(
        "Z-width: {resting} of {within} couplings within K <= min(2 b/T, 2 f_c/Delta) come to rest, and {beyond} of {} beyond it",
        table.points - within as u64
    ));
    let cells = |word: &str, name: &str, color| Series {
        name: name.to_owned(),
        points: table
            .rows()
            .filter(|row| row.word("outcome") == word)
            .map(|row| (row.number("viscous_share"), row.number("dry_share")))
            .collect(),
        mark: Mark::Cells(CELL),
        color,
    };
    let line = |name: &str, mark, color, points: Vec<(f64, f64)>| Series { name: name.to_owned(), points, mark, color };
    let [low, high] = SHARES;
    let swings = DRAWN.into_iter().zip([Color::Purple, Color::Green, Color::Sky]).map(|(column, color)| Series {
        name: format!("2 b/(K T) = {:.2}", share(column)),
        points: table
            .rows()
            .filter(|row| row.index / CELLS == column && row.word("outcome") == "swings")
            .map(|row| (row.number("dry_share"), row.number("swing_counts")))
            .collect(),
        mark: Mark::MarkedLine,
        color,
    });
    let balance = (0..200).map(|place| low * elementary::powf(high / low, f64::from(place) / 200.0));
    let chart = Chart {
        title: "Passive couplings rest; so do many that are not passive".to_owned(),
        panels: vec![
            Panel {
                title: "10 kN/m, 0.1 kg, 1 ms, counts of 10 um".to_owned(),
                x: Axis::logarithmic("viscous friction over the passive, 2 b/(K T)").over(low, high),
                y: Axis::logarithmic("dry friction over the passive, 2 f_c/(K Delta)").over(low, high),
                series: vec![
                    cells("rests", "rests", Color::Pale),
                    cells("swings", "swings for ever", Color::Orange),
                    cells("grows", "grows", Color::Vermilion),
                    line(
                        "K = min(2 b/T, 2 f_c/Delta)",
                        Mark::Line,
                        Color::Black,
                        vec![(1.0, high), (1.0, 1.0), (high, 1.0)],
                    ),
                    line(
                        "energy balance of 10 counts",
                        Mark::Dashed,
                        Color::Blue,
                        balance.map(|share| (share, energy_balance(share))).filter(|(_, dry)| *dry > 0.0).collect(),
                    ),
                ],
            },
            Panel {
                title: "size of what swings for ever".to_owned(),
                x: Axis::logarithmic("dry friction over the passive, 2 f_c/(K Delta)").over(low, 1.0),
                y: Axis::logarithmic("swing, end to end (counts)").over(1e-3, 100.0),
                series: swings.collect(),
            },
        ],
    };
    report.charts.push(("study-literature-zwidth", chart));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passive_couplings_rest_and_both_kinds_of_others_do_not() {
        for (viscous, dry) in [(1.05, 1.05), (1.05, 8.0), (8.0, 1.05), (3.0, 3.0)] {
            assert_eq!(outcome(viscous, dry), Outcome::Rests, "{viscous} {dry}");
        }
        // Too little dry friction: it swings between counts. Too little of both: it grows.
        for viscous in [1.5, 8.0] {
            let Outcome::Swings { counts } = outcome(viscous, 0.9) else { panic!("{viscous}") };
            assert!(counts > 0.0 && counts < 20.0, "{viscous} {counts}");
        }
        assert_eq!(outcome(0.3, 0.3), Outcome::Grows);
        // Not passive, and at rest: dry friction takes more than sampling gives at this size.
        assert_eq!(outcome(0.5, 2.0 * energy_balance(0.5)), Outcome::Rests);
        assert_eq!(outcome(0.5, 0.5 * energy_balance(0.5)), Outcome::Grows);
    }
}
