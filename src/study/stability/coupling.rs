//! The virtual coupling of the impedance type: stiffness against damping.

use nalgebra::Vector1;
use serde_json::Value;

use super::{Agreement, STUDY, cell, cells_below, on_grid};
use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::sweep::{Clock, Report, Row, Sweep, Table};
use yieldwall_motion::control::{Gains, ServoLoop, damping_needed_n_s_per_m, greatest_stiffness_n_per_m};
use yieldwall_motion::fixture::{Coupling, Curvature, Fixture, Impedance, Limits, Parameters, Plane, Rearm, Side};
use yieldwall_sim::hand::HandLoad;
use yieldwall_sim::point_mass::{PointMass, PointMassParameters};

const STIFFNESSES: u64 = 30;
const DAMPINGS: u64 = 40;
const STIFFNESSES_N_PER_M: [f64; 2] = [100.0, 100_000.0];
const DAMPINGS_N_S_PER_M: [f64; 2] = [0.1, 100.0];
const DEVICE_KG: f64 = 0.1;
/// The device starts so far off the wall and is caught by the coupling.
const START_M: f64 = 1e-4;
/// Never reached: the wall does not yield here.
const YIELD_N: f64 = 1e9;
const LOST_M: f64 = 1.0;
/// The longer of these.
const CYCLES: u32 = 2000;
const DURATION_S: f64 = 2.0;
const CELL: u32 = 25;
/// The rule of thumb is for small `B T/m`; beyond this it is drawn and not counted.
const SMALL: f64 = 0.1;

struct Setting {
    name: &'static str,
    period_s: f64,
    delay: usize,
    device_n_s_per_m: f64,
}

const SETTINGS: [Setting; 6] = [
    Setting { name: "T 1 ms, b 0.5 N s/m", period_s: 1e-3, delay: 0, device_n_s_per_m: 0.5 },
    Setting { name: "T 1 ms, b 0.5 N s/m, 1 cycle", period_s: 1e-3, delay: 1, device_n_s_per_m: 0.5 },
    Setting { name: "T 1 ms, b 0.5 N s/m, 2 cycles", period_s: 1e-3, delay: 2, device_n_s_per_m: 0.5 },
    Setting { name: "T 1 ms, b 2 N s/m", period_s: 1e-3, delay: 0, device_n_s_per_m: 2.0 },
    Setting { name: "T 0.25 ms, b 0.5 N s/m", period_s: 0.25e-3, delay: 0, device_n_s_per_m: 0.5 },
    Setting { name: "T 4 ms, b 0.5 N s/m", period_s: 4e-3, delay: 0, device_n_s_per_m: 0.5 },
];

impl Setting {
    /// Whether a device that starts off a wall which never yields comes to rest.
    fn dies(&self, stiffness_n_per_m: f64, damping_n_s_per_m: f64) -> Option<bool> {
        let parameters = Parameters {
            coupling: Coupling::Impedance(Impedance { stiffness_n_per_m, damping_n_s_per_m }),
            limits: Limits { friction_n: 0.0, yield_n: YIELD_N },
            side: Side::Bilateral,
            hold_steps: 0,
            rearm: Rearm::OffSurface,
            curvature: Curvature::Tangent,
            period_s: self.period_s,
        };
        let mut fixture = Fixture::new(Plane::new(Vector1::zeros(), Vector1::x()).ok()?, parameters).ok()?;
        fixture.reset(&Vector1::zeros()).ok()?;
        let device = PointMassParameters {
            mass_kg: DEVICE_KG,
            damping_n_s_per_m: self.device_n_s_per_m,
            position_resolution_m: 0.0,
        };
        let mut device = PointMass::new(device, 0.0, Vector1::new(START_M)).ok()?;
        let mut forces = vec![Vector1::zeros(); self.delay + 1];
        let mut energies = [0.0_f64; 8];
        let cycles = CYCLES.max((DURATION_S / self.period_s) as u32);
        for cycle in 0..cycles {
            forces.rotate_right(1);
            forces[0] = fixture.step_impedance(&device.position_m()).force_n;
            let end_s = f64::from(cycle + 1) * self.period_s;
            let applied = forces[self.delay];
            device.advance_to(end_s, 0.1 * self.period_s, applied, |_, _| HandLoad::default()).ok()?;
            let [place, speed] = [device.position_m().x, device.velocity_m_per_s().x];
            if place.abs() > LOST_M {
                return Some(false);
            }
            let energy = 0.5 * (stiffness_n_per_m * place * place + DEVICE_KG * speed * speed);
            let window = (cycle * 8 / cycles) as usize;
            energies[window] = energies[window].max(energy);
        }
        let [first, .., a, b, c, d] = energies;
        // Far below where it began it is at rest but for rounding.
        Some(c.max(d) < 0.9 * a.max(b) || c.max(d) < 1e-15 * first)
    }

    fn coupling(&self, damping_n_s_per_m: f64) -> ServoLoop {
        let gains = Gains { stiffness: 1.0, damping: damping_n_s_per_m, integral: 0.0 };
        ServoLoop { gains, period_s: self.period_s, delay_cycles: self.delay as f64 }
    }

    /// Greatest stiffness by the exact loop; zero if none is stable.
    fn greatest_n_per_m(&self, damping_n_s_per_m: f64) -> f64 {
        let servo = self.coupling(damping_n_s_per_m);
        greatest_stiffness_n_per_m(&servo, DEVICE_KG, self.device_n_s_per_m, 1.0).ok().flatten().unwrap_or(0.0)
    }

    /// Greatest stiffness by the rule `b + B >= K (T/2 + d T)`.
    fn rule_n_per_m(&self, damping_n_s_per_m: f64) -> f64 {
        let needed = damping_needed_n_s_per_m(1.0, self.period_s, self.delay as f64);
        (self.device_n_s_per_m + damping_n_s_per_m) / needed
    }
}

/// Every stiffness with every damping in every setting.
pub(super) struct Map;

impl Sweep for Map {
    fn name(&self) -> &'static str {
        "coupling"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["setting", "damping_n_s_per_m", "stiffness_n_per_m", "dies_away"]
    }

    fn points(&self) -> u64 {
        SETTINGS.len() as u64 * DAMPINGS * STIFFNESSES
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (rest, stiffness) = (index / STIFFNESSES, index % STIFFNESSES);
        let setting = &SETTINGS[(rest / DAMPINGS) as usize];
        let damping_n_s_per_m = cell(rest % DAMPINGS, DAMPINGS, DAMPINGS_N_S_PER_M);
        let stiffness_n_per_m = cell(stiffness, STIFFNESSES, STIFFNESSES_N_PER_M);
        let dies = setting.dies(stiffness_n_per_m, damping_n_s_per_m);
        vec![setting.name.into(), damping_n_s_per_m.into(), stiffness_n_per_m.into(), dies.into()]
    }
}

pub(super) fn report(map: &Table, report: &mut Report) {
    let mut panels = Vec::new();
    report.notes.push("greatest stiffness of the impedance type, by damping:".to_owned());
    for setting in &SETTINGS {
        let points: Vec<_> = map.rows().filter(|row| row.word("setting") == setting.name).collect();
        let [mut exact, mut rule] = [Agreement::default(), Agreement::default()];
        for index in 0..DAMPINGS {
            let damping = cell(index, DAMPINGS, DAMPINGS_N_S_PER_M);
            let column: Vec<_> = points.iter().filter(|row| row.number("damping_n_s_per_m") == damping).collect();
            let measured = column.iter().rposition(|row| row.is("dies_away")).map_or(0, |last| last as u64 + 1);
            let place = |stiffness: f64| cells_below(stiffness, STIFFNESSES, STIFFNESSES_N_PER_M);
            let what = |computed: f64| {
                let row = column.get((measured as usize).min(column.len().saturating_sub(1)));
                let again = row.map_or(String::new(), |row| row.command(STUDY));
                format!("B {damping:.3} N s/m: {measured} stiffnesses stable, theory {computed:.0} N/m: {again}")
            };
            let computed = setting.greatest_n_per_m(damping);
            exact.add(measured, place(computed), || what(computed));
            if damping * setting.period_s / DEVICE_KG <= SMALL {
                let computed = setting.rule_n_per_m(damping);
                rule.add(measured, place(computed), || what(computed));
            }
        }
        for (name, agreement) in [("exact loop", exact), ("rule, B T/m up to 0.1", rule)] {
            report.notes.push(format!("  {}", agreement.line(&format!("{}, {name}", setting.name))));
            report.notes.extend(agreement.beyond.iter().map(|line| format!("    {line}")));
        }
        panels.push(panel(setting, &points));
    }
    let chart = Chart {
        title: format!(
            "An impedance device of {DEVICE_KG} kg at a wall, virtual spring and damper: does a touch die away?"
        ),
        panels,
    };
    report.charts.push(("study-stability-coupling", chart));
}

fn panel(setting: &Setting, points: &[Row<'_>]) -> Panel {
    let cells = |dies: bool, name: &str, color| Series {
        name: name.to_owned(),
        points: points
            .iter()
            .filter(|row| row.is("dies_away") == dies)
            .map(|row| (row.number("damping_n_s_per_m"), row.number("stiffness_n_per_m")))
            .collect(),
        mark: Mark::Cells(CELL),
        color,
    };
    let line = |name: &str, mark, color, of: &dyn Fn(f64) -> f64| Series {
        name: name.to_owned(),
        points: (0..200)
            .map(|index| on_grid(index, 200, DAMPINGS_N_S_PER_M))
            .map(|damping| (damping, of(damping)))
            .collect(),
        mark,
        color,
    };
    Panel {
        title: setting.name.to_owned(),
        x: Axis::logarithmic("virtual damping B (N s/m)").over(DAMPINGS_N_S_PER_M[0], DAMPINGS_N_S_PER_M[1]),
        y: Axis::logarithmic("virtual stiffness K (N/m)").over(STIFFNESSES_N_PER_M[0], STIFFNESSES_N_PER_M[1]),
        series: vec![
            cells(true, "dies away", Color::Pale),
            cells(false, "does not die away", Color::Vermilion),
            line("b + B = K (T/2 + d T)", Mark::Dashed, Color::Blue, &|damping| setting.rule_n_per_m(damping)),
            line("exact sampled loop", Mark::Line, Color::Black, &|damping| setting.greatest_n_per_m(damping)),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_boundary_is_where_theory_says() {
        for setting in &SETTINGS {
            for damping in [0.1, 1.0, 5.0] {
                let greatest = setting.greatest_n_per_m(damping);
                assert_eq!(setting.dies(0.9 * greatest, damping), Some(true), "{} {damping}", setting.name);
                assert_eq!(setting.dies(1.1 * greatest, damping), Some(false), "{} {damping}", setting.name);
            }
        }
    }
}
