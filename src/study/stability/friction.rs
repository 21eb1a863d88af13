//! Friction of the fixture by its proxy against friction that is computed from the last velocity.

use nalgebra::Vector2;
use serde_json::Value;
use yieldwall_motion::elementary;

use super::held::{PERIOD_S, free_space};
use super::on_grid;
use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::sweep::{Clock, Report, Sweep, Table};

const FRICTION_N: f64 = 3.0;
const MASSES_KG: [f64; 3] = [0.1, 0.5, 2.0];
const PUSHES: u64 = 30;
/// Pushes as shares of `F`.
const PUSH_SHARES: [f64; 2] = [0.1, 3.0];
const DURATION_S: f64 = 2.0;

#[derive(Clone, Copy, PartialEq)]
enum Law {
    /// The fixture's step.
    Proxy,
    /// `-F sgn(v)` of the last velocity.
    Sign,
    /// `-F tanh(v / v_s)` of the last velocity.
    Smooth(f64),
}

const LAWS: [(Law, &str); 4] = [
    (Law::Proxy, "proxy"),
    (Law::Sign, "sign of the last velocity"),
    (Law::Smooth(1e-3), "tanh over 1 mm/s"),
    (Law::Smooth(1e-2), "tanh over 10 mm/s"),
];

/// A constant push on an admittance at rest in free space.
pub(super) struct Push;

impl Sweep for Push {
    fn name(&self) -> &'static str {
        "friction"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["law", "virtual_mass_kg", "push_over_friction", "moved_m", "chatter_m_per_s", "gained_j"]
    }

    fn points(&self) -> u64 {
        (LAWS.len() * MASSES_KG.len()) as u64 * PUSHES
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (rest, push) = ((index / PUSHES) as usize, index % PUSHES);
        let (law, name) = LAWS[rest / MASSES_KG.len()];
        let mass_kg = MASSES_KG[rest % MASSES_KG.len()];
        let share = on_grid(push, PUSHES, PUSH_SHARES);
        let found = run(law, mass_kg, share * FRICTION_N);
        let cell = |of: fn(&Found) -> f64| found.as_ref().map(of);
        vec![
            name.into(),
            mass_kg.into(),
            share.into(),
            cell(|found| found.moved_m).into(),
            cell(|found| found.chatter_m_per_s).into(),
            cell(|found| found.gained_j).into(),
        ]
    }
}

#[derive(Default)]
struct Found {
    /// Way in the second half of the run.
    moved_m: f64,
    /// Root mean square of the change of velocity from step to step, less that of the push, in the second half.
    chatter_m_per_s: f64,
    /// Energy that friction gave to the mass in the steps in which it pushed.
    gained_j: f64,
}

fn run(law: Law, mass_kg: f64, push_n: f64) -> Option<Found> {
    let mut fixture = free_space(mass_kg, FRICTION_N, 0.0)?;
    fixture.reset(&Vector2::zeros()).ok()?;
    let (mut place, mut velocity) = (0.0, 0.0_f64);
    let steps = (DURATION_S / PERIOD_S) as u32;
    let mut found = Found::default();
    let (mut half_m, mut squares) = (0.0, 0.0);
    for index in 0..steps {
        let before: (f64, f64) = (place, velocity);
        match law {
            Law::Proxy => {
                place = fixture.step_admittance(&Vector2::new(push_n, 0.0)).proxy.x;
                velocity = (place - before.0) / PERIOD_S;
            }
            Law::Sign | Law::Smooth(_) => {
                let share = match law {
                    Law::Smooth(width) => elementary::tanh(velocity / width),
                    _ if velocity == 0.0 => 0.0,
                    _ => velocity.signum(),
                };
                velocity += PERIOD_S / mass_kg * (push_n - FRICTION_N * share);
                place += velocity * PERIOD_S;
            }
        }
        let friction_n = mass_kg * (velocity - before.1) / PERIOD_S - push_n;
        found.gained_j += (friction_n * (place - before.0)).max(0.0);
        if index == steps / 2 {
            half_m = place;
        }
        if index > steps / 2 {
            let even = (push_n - FRICTION_N).max(0.0) * PERIOD_S / mass_kg;
            squares += elementary::powi(velocity - before.1 - even, 2);
        }
    }
    found.moved_m = place - half_m;
    found.chatter_m_per_s = (squares / f64::from(steps / 2 - 1)).sqrt();
    Some(found)
}

pub(super) fn report(table: &Table, report: &mut Report) {
    let mut panels = Vec::new();
    for (column, title, factor, range) in [
        ("moved_m", "way within 1 s", 1e3, [1e-4, 1e5]),
        ("chatter_m_per_s", "chatter of the velocity", 1e3, [1e-4, 1e2]),
        ("gained_j", "energy that friction adds", 1e3, [1e-6, 1e2]),
    ] {
        let unit = match column {
            "moved_m" => "mm",
            "gained_j" => "mJ",
            _ => "mm/s",
        };
        let series = LAWS.into_iter().zip(Color::LINES).map(|((_, name), color)| Series {
            name: name.to_owned(),
            points: table
                .rows()
                .filter(|row| row.word("law") == name && row.number("virtual_mass_kg") == MASSES_KG[1])
                .map(|row| (row.number("push_over_friction"), factor * row.number(column)))
                .collect(),
            mark: Mark::MarkedLine,
            color,
        });
        panels.push(Panel {
            title: title.to_owned(),
            x: Axis::logarithmic("push over F").over(PUSH_SHARES[0], PUSH_SHARES[1]),
            y: Axis::logarithmic(&format!("{title} ({unit})")).over(range[0], range[1]),
            series: series.collect(),
        });
    }
    for (_, name) in LAWS {
        let held = || table.rows().filter(move |row| row.word("law") == name && row.number("push_over_friction") < 1.0);
        let most = |column| held().map(|row| row.number(column).abs()).fold(0.0, f64::max);
        report.notes.push(format!(
            "friction, pushes below F, {name}: creeps {:.4} mm/s, chatters {:.4} mm/s, adds {:.4} mJ in 2 s at most",
            1e3 * most("moved_m"),
            1e3 * most("chatter_m_per_s"),
            1e3 * most("gained_j")
        ));
    }
    let chart = Chart {
        title: format!("A constant push on an admittance of {} kg with F = {FRICTION_N} N, from rest", MASSES_KG[1]),
        panels,
    };
    report.charts.push(("study-stability-friction", chart));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_proxy_holds_below_f_and_the_others_creep() {
        let at = |law| run(law, 0.5, 0.9 * FRICTION_N).unwrap();
        let held = at(Law::Proxy);
        assert_eq!((held.moved_m, held.chatter_m_per_s, held.gained_j), (0.0, 0.0, 0.0));
        assert!(at(Law::Sign).chatter_m_per_s > 1e-3);
        assert!(at(Law::Smooth(1e-2)).moved_m > 1e-3);
        // Above F all slide alike: (h - F)/M, over the second of 2 s.
        let expected = 0.5 * FRICTION_N / 0.5 * 1.5;
        for (law, name) in LAWS {
            let moved = run(law, 0.5, 1.5 * FRICTION_N).unwrap().moved_m;
            assert!((moved / expected - 1.0).abs() < 0.02, "{name}: {moved} {expected}");
        }
    }
}
