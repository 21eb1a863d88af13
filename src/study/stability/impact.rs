//! Impacts on a wall: whether the proxy is captured, how deep it goes, and how far the tool overshoots.

use nalgebra::{Vector1, Vector2};
use serde_json::Value;

use super::held::{PERIOD_S, PLAIN, START_M, Setting};
use super::{STUDY, on_grid};
use crate::bench::Bench;
use crate::chart::{Axis, Chart, Color, Mark, Panel, Series};
use crate::sweep::{Clock, Report, Row, Sweep, Table};
use yieldwall_motion::fixture::prediction::{Impact, capture_probability, capture_speed_m_per_s};
use yieldwall_motion::fixture::{
    Admittance, Coupling, Curvature, Fixture, Limits, Line, Parameters, Plane, Rearm, Shape2, Side,
};
use yieldwall_sim::hand::HandLoad;

const MASS_KG: f64 = 2.0;
const YIELDS_N: [f64; 4] = [5.0, 10.0, 20.0, 40.0];
const SPEEDS: u64 = 40;
const SPEEDS_M_PER_S: [f64; 2] = [1e-3, 0.5];
const PHASES: u64 = 20;
/// Whole steps before the crossing.
const APPROACH_STEPS: f64 = 5.0;
const ON_SURFACE_M: f64 = 1e-9;
/// Limit for a run of the proxy: it would take that long to be stopped by 2.5 N from 0.5 m/s.
const LONGEST_STEPS: u32 = 1000;

fn parameters(yield_n: f64, hold_steps: u32) -> Parameters {
    Parameters {
        coupling: Coupling::Admittance(Admittance { mass_kg: MASS_KG }),
        limits: Limits { friction_n: 0.0, yield_n },
        side: Side::Unilateral,
        hold_steps,
        rearm: Rearm::OffSurface,
        curvature: Curvature::Tangent,
        period_s: PERIOD_S,
    }
}

/// A free proxy that meets a plane head on, at every speed and in every phase of the sampling.
pub(super) struct Proxy;

impl Sweep for Proxy {
    fn name(&self) -> &'static str {
        "impact"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["yield_n", "speed_m_per_s", "last_distance_m", "depth_m", "theory_depth_m"]
    }

    fn points(&self) -> u64 {
        YIELDS_N.len() as u64 * SPEEDS * PHASES
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (rest, phase) = (index / PHASES, index % PHASES);
        let yield_n = YIELDS_N[(rest / SPEEDS) as usize];
        let speed_m_per_s = on_grid(rest % SPEEDS, SPEEDS, SPEEDS_M_PER_S);
        let last_distance_m = speed_m_per_s * PERIOD_S * (phase as f64 + 0.5) / PHASES as f64;
        let impact =
            Impact { mass_kg: MASS_KG, yield_n, hand_force_n: 0.0, speed_m_per_s, last_distance_m, period_s: PERIOD_S };
        vec![
            yield_n.into(),
            speed_m_per_s.into(),
            last_distance_m.into(),
            proxy_depth_m(&impact).into(),
            impact.penetration_depth_m().into(),
        ]
    }
}

/// How deep a free proxy comes to rest.
fn proxy_depth_m(impact: &Impact) -> Option<f64> {
    let step_m = impact.speed_m_per_s * PERIOD_S;
    let start = Vector1::new(impact.last_distance_m + APPROACH_STEPS * step_m);
    let plane = Plane::new(Vector1::zeros(), Vector1::x()).ok()?;
    let mut fixture = Fixture::new(plane, parameters(impact.yield_n, 0)).ok()?;
    fixture.reset(&start.add_scalar(step_m)).ok()?;
    fixture.hold_back_to(&start).ok()?;
    let mut before = start.x;
    for _ in 0..LONGEST_STEPS {
        let here = fixture.step_admittance(&Vector1::zeros()).proxy.x;
        if here == before {
            return Some(-here);
        }
        before = here;
    }
    None
}

const HOLDS: [u32; 5] = [0, 2, 5, 15, 50];
const TOOL_YIELDS_N: [f64; 2] = [10.0, 20.0];
const TOOL_SPEEDS: u64 = 16;
const TOOL_SPEEDS_M_PER_S: [f64; 2] = [0.02, 0.5];
/// The hand presses on with this share of `R` once the proxy has met the wall.
const PRESS: f64 = 0.5;
/// Distance of the wall from the start.
const WALL_M: f64 = 0.01;
/// Cycles from the impact on.
const TOOL_CYCLES: u64 = 600;
const TORQUE_LIMIT_N_M: f64 = 60.0;
const COULOMB_N_M: f64 = 10.0;

/// The arm that comes along with a free proxy, pressed on by less than `R` at the wall, under several holds.
pub(super) struct Tool;

impl Sweep for Tool {
    fn name(&self) -> &'static str {
        "impact-tool"
    }

    fn columns(&self) -> Vec<&str> {
        vec!["yield_n", "hold_steps", "speed_m_per_s", "impact_m_per_s", "depth_m", "theory_depth_m", "tool_depth_m"]
    }

    fn points(&self) -> u64 {
        (TOOL_YIELDS_N.len() * HOLDS.len()) as u64 * TOOL_SPEEDS
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        let (rest, speed) = (index / TOOL_SPEEDS, index % TOOL_SPEEDS);
        let yield_n = TOOL_YIELDS_N[rest as usize / HOLDS.len()];
        let hold_steps = HOLDS[rest as usize % HOLDS.len()];
        let speed_m_per_s = on_grid(speed, TOOL_SPEEDS, TOOL_SPEEDS_M_PER_S);
        let run = with_arm(yield_n, hold_steps, speed_m_per_s);
        let found = |of: fn(&Overshoot) -> f64| run.as_ref().map(of);
        let theory = run.as_ref().filter(|_| hold_steps == 0).and_then(|run| {
            let impact = Impact {
                mass_kg: MASS_KG,
                yield_n,
                hand_force_n: PRESS * yield_n,
                speed_m_per_s: run.impact_m_per_s,
                last_distance_m: run.last_distance_m,
                period_s: PERIOD_S,
            };
            impact.penetration_depth_m()
        });
        vec![
            yield_n.into(),
            hold_steps.into(),
            speed_m_per_s.into(),
            found(|run| run.impact_m_per_s).into(),
            found(|run| run.depth_m).into(),
            theory.into(),
            found(|run| run.tool_depth_m).into(),
        ]
    }
}

struct Overshoot {
    /// Speed of the proxy before it met the wall.
    impact_m_per_s: f64,
    last_distance_m: f64,
    depth_m: f64,
    tool_depth_m: f64,
}

/// The arm of the maps with dry joints, moving along y towards a wall. The stiffer servo and the torque limit are those of
/// the rig of the paper.
fn with_arm(yield_n: f64, hold_steps: u32, speed_m_per_s: f64) -> Option<Overshoot> {
    let wall_y = START_M.y + WALL_M;
    let line = Line::new(Vector2::new(0.0, wall_y), -Vector2::y()).ok()?;
    let fixture = Fixture::new(Shape2::Line(line), parameters(yield_n, hold_steps)).ok()?;
    let stiffer = Setting { coulomb_n_m: COULOMB_N_M, servo_delay: 1, bandwidth: 2.0, ..PLAIN };
    let mut parameters = stiffer.parameters()?;
    parameters.servo.torque_limit_n_m = TORQUE_LIMIT_N_M;
    let mut bench = Bench::new(&parameters, fixture).ok()?;
    bench.start_moving(Vector2::y() * speed_m_per_s).ok()?;
    let press = Vector2::y() * (PRESS * yield_n);
    let mut found = Overshoot { impact_m_per_s: f64::NAN, last_distance_m: f64::NAN, depth_m: 0.0, tool_depth_m: 0.0 };
    let mut before = [START_M.y - speed_m_per_s * PERIOD_S, START_M.y];
    // The proxy comes along freely, so its crossing is known. The last force before it is that of the step that crosses.
    let crossing = (WALL_M / (speed_m_per_s * PERIOD_S)).ceil() as u64;
    for cycle in 0..crossing + TOOL_CYCLES {
        let force_n = if cycle + 1 >= crossing { press } else { Vector2::zeros() };
        let seen = bench.run_cycle(cycle, |_, _| HandLoad { force_n, ..HandLoad::default() }).ok()?;
        let here = seen.step.proxy.y;
        if found.impact_m_per_s.is_nan() && here >= wall_y - ON_SURFACE_M {
            found.impact_m_per_s = (before[1] - before[0]) / PERIOD_S;
            found.last_distance_m = wall_y - before[1];
        }
        found.depth_m = found.depth_m.max(here - wall_y);
        found.tool_depth_m = found.tool_depth_m.max(seen.tool_m.y - wall_y);
        before = [before[1], here];
    }
    Some(found)
}

pub(super) fn report(proxy: &Table, tool: &Table, report: &mut Report) {
    let mut notes = Vec::new();
    let chart = Chart {
        title: format!("Impacts of a proxy of {MASS_KG} kg on a wall, without a hold (N_wait 0) or with one"),
        panels: vec![capture_panel(proxy, &mut notes), depth_panel(proxy, &mut notes), tool_panel(tool, &mut notes)],
    };
    report.notes.extend(notes);
    report.charts.push(("study-stability-impact", chart));
}

/// Rows of one yield force and speed.
fn of_speed<'a>(proxy: &'a Table, yield_n: f64, speed: u64) -> impl Iterator<Item = Row<'a>> {
    let speed_m_per_s = on_grid(speed, SPEEDS, SPEEDS_M_PER_S);
    proxy.rows().filter(move |row| row.number("yield_n") == yield_n && row.number("speed_m_per_s") == speed_m_per_s)
}

fn capture_panel(proxy: &Table, notes: &mut Vec<String>) -> Panel {
    let mut series = Vec::new();
    let mut worst: f64 = 0.0;
    for (yield_n, color) in YIELDS_N.into_iter().zip(Color::LINES) {
        let capture_m_per_s = capture_speed_m_per_s(yield_n, MASS_KG, PERIOD_S);
        let points: Vec<_> = (0..SPEEDS)
            .map(|speed| {
                let stopped = of_speed(proxy, yield_n, speed).filter(|row| row.number("depth_m") <= ON_SURFACE_M);
                let speed_m_per_s = on_grid(speed, SPEEDS, SPEEDS_M_PER_S);
                let share = stopped.count() as f64 / PHASES as f64;
                worst = worst.max((share - capture_probability(speed_m_per_s, capture_m_per_s)).abs());
                (speed_m_per_s / capture_m_per_s, share)
            })
            .collect();
        series.push(Series { name: format!("R = {yield_n} N"), points, mark: Mark::Marks, color });
    }
    let theory = (0..=300).map(|i| f64::from(i) * 0.01).map(|ratio| (ratio, capture_probability(ratio, 1.0))).collect();
    series.push(Series {
        name: "theory, of the proxy".to_owned(),
        points: theory,
        mark: Mark::Line,
        color: Color::Black,
    });
    notes.push(format!(
        "impacts without a hold: the share that is captured is off the law by {worst:.3} at most, with steps of {:.3}",
        1.0 / PHASES as f64
    ));
    Panel {
        title: "captured, N_wait 0".to_owned(),
        x: Axis::linear("speed over R T / M").over(0.0, 3.0),
        y: Axis::linear("share of phases of the sampling").over(-0.03, 1.03),
        series,
    }
}

fn depth_panel(proxy: &Table, notes: &mut Vec<String>) -> Panel {
    let mut series = Vec::new();
    let mut off = Vec::new();
    let mut count = 0;
    for row in proxy.rows() {
        let tolerance_m = 0.25 * capture_speed_m_per_s(row.number("yield_n"), MASS_KG, PERIOD_S) * PERIOD_S;
        let error_m = (row.number("depth_m") - row.number("theory_depth_m")).abs();
        count += 1;
        if error_m.is_nan() || error_m > tolerance_m + ON_SURFACE_M {
            off.push((row.command(STUDY), row.number("depth_m"), row.number("theory_depth_m")));
        }
    }
    notes.push(format!(
        "depth of these impacts: {} of {count} within v_c T/4 of the formula{}",
        count - off.len(),
        off.first().map_or(String::new(), |(again, measured, computed)| {
            format!("; first other: {:.3} um against {:.3} um, {again}", measured * 1e6, computed * 1e6)
        })
    ));
    for (yield_n, color) in YIELDS_N.into_iter().zip(Color::LINES) {
        let mean = |speed, column: &str| {
            of_speed(proxy, yield_n, speed).map(|row| row.number(column)).sum::<f64>() / PHASES as f64 * 1e3
        };
        let line = |column: &'static str| {
            (0..SPEEDS).map(|speed| (1e3 * on_grid(speed, SPEEDS, SPEEDS_M_PER_S), mean(speed, column))).collect()
        };
        series.push(Series { name: format!("R = {yield_n} N"), points: line("depth_m"), mark: Mark::Marks, color });
        series.push(Series {
            name: "theory, of the proxy".to_owned(),
            points: line("theory_depth_m"),
            mark: Mark::Line,
            color: Color::Black,
        });
    }
    Panel {
        title: "depth of the proxy, N_wait 0".to_owned(),
        x: Axis::logarithmic("speed (mm/s)").over(1.0, 550.0),
        y: Axis::logarithmic("depth, mean over phases (mm)").over(1e-4, 100.0),
        series,
    }
}

fn tool_panel(tool: &Table, notes: &mut Vec<String>) -> Panel {
    const SHOWN_N: f64 = 20.0;
    let mut series = Vec::new();
    let mut drawn_holds: Vec<Vec<u32>> = Vec::new();
    let mut drawn: Vec<Vec<(f64, f64)>> = Vec::new();
    for hold_steps in HOLDS {
        let rows = || {
            tool.rows().filter(move |row| {
                row.number("yield_n") == SHOWN_N && row.number("hold_steps") == f64::from(hold_steps)
            })
        };
        let points = rows().map(|row| (row.number("impact_m_per_s") * 1e3, row.number("tool_depth_m") * 1e3)).collect();
        match drawn_holds.last_mut().filter(|_| drawn.last() == Some(&points)) {
            Some(holds) => holds.push(hold_steps),
            None => {
                drawn_holds.push(vec![hold_steps]);
                drawn.push(points);
            }
        }
        let deepest = rows().map(|row| row.number("depth_m")).fold(0.0, f64::max);
        let farthest = rows().map(|row| row.number("tool_depth_m")).fold(0.0, f64::max);
        notes.push(format!(
            "N_wait {hold_steps:2} with the arm, R = {SHOWN_N} N, a hand that presses with {PRESS} R, up to {} m/s: \
             proxy {:.6} mm deep, tool {:.2} mm",
            TOOL_SPEEDS_M_PER_S[1],
            deepest * 1e3,
            farthest * 1e3
        ));
    }
    for ((holds, points), color) in
        drawn_holds.into_iter().zip(drawn).zip([Color::Blue, Color::Orange, Color::Green, Color::Purple])
    {
        // Holds of the same depths are one series.
        let name = match holds.as_slice() {
            [first, .., last] => format!("tool, N_wait {first} to {last}"),
            [only] => format!("tool, N_wait {only}"),
            [] => String::new(),
        };
        series.push(Series { name, points, mark: Mark::MarkedDashes, color });
    }
    let theory = tool
        .rows()
        .filter(|row| row.number("yield_n") == SHOWN_N && row.number("hold_steps") == 0.0)
        .map(|row| (row.number("impact_m_per_s") * 1e3, row.number("theory_depth_m") * 1e3))
        .collect();
    series.push(Series {
        name: "theory, of the proxy".to_owned(),
        points: theory,
        mark: Mark::Line,
        color: Color::Black,
    });
    Panel {
        title: format!("depth of the tool, R = {SHOWN_N} N"),
        x: Axis::logarithmic("speed at the wall (mm/s)"),
        y: Axis::logarithmic("depth (mm)"),
        series,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hold_of_two_steps_stops_the_proxy_and_no_hold_follows_the_law() {
        let held = with_arm(20.0, 2, 0.3).unwrap();
        assert!(held.depth_m <= 1e-12, "{}", held.depth_m);
        assert!((0.2e-3..4e-3).contains(&held.tool_depth_m), "{}", held.tool_depth_m);
        let free = with_arm(20.0, 0, 0.3).unwrap();
        let impact = Impact {
            mass_kg: MASS_KG,
            yield_n: 20.0,
            hand_force_n: 10.0,
            speed_m_per_s: free.impact_m_per_s,
            last_distance_m: free.last_distance_m,
            period_s: PERIOD_S,
        };
        let expected = impact.penetration_depth_m().unwrap();
        assert!((free.depth_m / expected - 1.0).abs() < 0.02, "{} {expected}", free.depth_m);
    }
}
