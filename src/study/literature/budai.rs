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

/// What became of a swing.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Swing {
    stops: bool,
    turns: usize,
    time_s: f64,
    /// Least height of the envelope over the chord from its first turn to its last one, over the first turn.
    above_chord: f64,
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
    let (first, last) = (envelope[0], envelope[envelope.len() - 1]);
    let chord = |time_s: f64| first.1 + (last.1 - first.1) * time_s / last.0;
    let inner = &envelope[1..envelope.len() - 1];
    let above = inner.iter().map(|(time_s, swing_m)| swing_m - chord(*time_s)).fold(f64::INFINITY, f64::min);
    Swing { stops, turns: envelope.len() - 1, time_s: last.0, above_chord: above / first.1 }
}

/// A swing from each start.
pub(super) struct Swings;

impl Sweep for Swings {
    fn name(&self) -> &'static str {
        "budai"
    }

    fn columns(&self) -> &'static [&'static str] {
        &["start_share", "outcome", "turns", "time_s", "expected_s", "above_chord"]
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
            found.above_chord.into(),
        ]
    }
}

pub(super) fn report(table: &Table, report: &mut Report) {
    report.notes.push("Budai et al. 2019, a loop that swings up without dry friction:".to_owned());
    for row in table.rows() {
        report.notes.push(format!(
            "  started at {:.2} of the even swing: {} after {} turns, {:.3} s (first harmonic {:.3} s), envelope over its chord by {:+.3}",
            row.number("start_share"),
            row.word("outcome"),
            row.number("turns"),
            row.number("time_s"),
            row.number("expected_s"),
            row.number("above_chord"),
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
            if found.stops && start >= 0.5 {
                assert!(found.above_chord > 0.0, "{start} {found:?}");
                assert!((found.time_s / expected_s(start) - 1.0).abs() < 0.2, "{start} {found:?} {}", expected_s(start));
            }
        }
    }
}
