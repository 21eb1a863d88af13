//! Vibrations of a sampled position loop that dry friction stops: their envelope.

use std::f64::consts::PI;

use serde_json::Value;

use super::quantised::{Coupling, Motion};
use super::zwidth::{MASS_KG, PERIOD_S, STIFFNESS_N_PER_M};
use crate::sweep::{Clock, Report, Sweep, Table};
use yieldwall_motion::elementary;

const DRY_N: f64 = 1.0;
/// Starts over the swing at which sampling gives what dry friction takes.
const STARTS: [f64; 7] = [0.25, 0.5, 0.75, 0.9, 0.97, 1.03, 1.1];
const CYCLES: u32 = 20_000;
const LOST: f64 = 3.0;

/// The end of a swing.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Swing {
    stops: bool,
    turns: usize,
    time_s: f64,
    /// Whether each turn loses more than the one before, the last one left out, which friction ends early; `None` with fewer than three.
    is_concave: Option<bool>,
}

/// Growth `sigma` in 1/s and the even swing `A*` in m, by the first harmonic: `dA/dt = sigma (A - A*)`, `sigma = K T/(4 m)`,
/// `A* = 8 f_c/(pi omega K T)`.
fn balance() -> (f64, f64) {
    let turn_per_s = elementary::powf(STIFFNESS_N_PER_M / MASS_KG, 0.5);
    let lead = STIFFNESS_N_PER_M * PERIOD_S;
    (lead / (4.0 * MASS_KG), 8.0 * DRY_N / (PI * turn_per_s * lead))
}

/// Time in which the envelope `A* + (A - A*) e^(sigma t)` falls to zero, s; infinity if it grows.
fn expected_s(start: f64) -> f64 {
    if start < 1.0 { -elementary::ln(1.0 - start) / balance().0 } else { f64::INFINITY }
}

fn swing(start: f64) -> Swing {
    let coupling = Coupling {
        mass_kg: MASS_KG,
        viscous_n_s_per_m: 0.0,
        dry_n: DRY_N,
        stiffness_n_per_m: STIFFNESS_N_PER_M,
        period_s: PERIOD_S,
        count_m: 0.0,
        push_n: 0.0,
    };
    let start_m = start * balance().1;
    let mut now = Motion { place_m: start_m, speed_m_per_s: 0.0 };
    let mut envelope = vec![(0.0, start_m)];
    let mut stops = false;
    for cycle in 0..CYCLES {
        let begun_s = f64::from(cycle) * PERIOD_S;
        let next = coupling.step(now, |place_m| envelope.push((begun_s, place_m.abs())));
        stops = next.speed_m_per_s == 0.0 && next == now;
        if stops || now.place_m.abs() > LOST * start_m {
            break;
        }
        now = next;
    }
    let losses: Vec<f64> = envelope.windows(2).map(|pair| pair[0].1 - pair[1].1).collect();
    let whole = &losses[..losses.len().saturating_sub(1)];
    let is_concave = (whole.len() >= 2).then(|| whole.windows(2).all(|pair| pair[1] > pair[0]));
    let time_s = envelope.last().map_or(0.0, |(time_s, _)| *time_s);
    Swing { stops, turns: losses.len(), time_s, is_concave }
}

/// A swing from each start.
pub(super) struct Swings;

impl Sweep for Swings {
    fn name(&self) -> &'static str {
        "budai"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["start_share", "outcome", "turns", "time_s", "expected_s", "is_concave"]
    }

    fn points(&self) -> u64 {
        STARTS.len() as u64
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let start = STARTS[index as usize];
        let found = swing(start);
        vec![
            start.into(),
            if found.stops { "stops" } else { "grows" }.into(),
            found.turns.into(),
            if found.stops { found.time_s.into() } else { Value::Null },
            expected_s(start).into(),
            found.is_concave.into(),
        ]
    }
}

pub(super) fn report(table: &Table, report: &mut Report) {
    report.notes.push("Budai et al. 2019, a loop that swings up without dry friction:".to_owned());
    for row in table.rows() {
        report.notes.push(format!(
            "  started at {:.2} of the even swing: {} after {} turns{}{}",
            row.number("start_share"),
            row.word("outcome"),
            row.number("turns"),
            if row.word("outcome") == "stops" {
                format!(", {:.3} s (first harmonic {:.3} s)", row.number("time_s"), row.number("expected_s"))
            } else {
                String::new()
            },
            if row.is("is_concave") { ", concave envelope" } else { "" },
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's three statements: friction stops what sampling makes unstable, with a concave envelope, from small starts alone.
    #[test]
    fn dry_friction_stops_small_swings_with_a_concave_envelope() {
        for start in STARTS {
            let found = swing(start);
            assert_eq!(found.stops, start < 1.0, "{start} {found:?}");
            if found.stops {
                assert_ne!(found.is_concave, Some(false), "{start} {found:?}");
                assert!(
                    (found.time_s / expected_s(start) - 1.0).abs() < 0.2,
                    "{start} {found:?} {}",
                    expected_s(start)
                );
            }
            assert_eq!(found.is_concave.is_some(), start > 0.3, "{start} {found:?}");
        }
    }
}
