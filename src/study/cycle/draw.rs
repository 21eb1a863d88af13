//! The chart of the study.

use super::super::chart::{Axis, Chart, Color, Mark, Panel, Series};
use super::super::sweep::{Row, Table};
use super::machine::{Mode, PERIODS_US, WIRES, Wire};
use super::of;

/// The modes of rigs as they are shipped.
const DRAWN: [Mode; 3] = [Mode::Torque, Mode::Velocity, Mode::Position];

fn look(wire: Wire, mode: Mode) -> (Color, Mark) {
    let color = match mode {
        Mode::Torque => Color::Blue,
        Mode::Velocity => Color::Orange,
        Mode::Position | Mode::StiffPosition => Color::Vermilion,
    };
    (color, if wire == Wire::Can { Mark::MarkedDashes } else { Mark::MarkedLine })
}

/// A line for each bus and mode, of those rigs that have the number.
fn lines(table: &Table, number: impl Fn(&Row<'_>) -> f64) -> Vec<Series> {
    let mut all = Vec::new();
    for mode in DRAWN {
        for wire in WIRES {
            let (color, mark) = look(wire, mode);
            let points = of(table, wire, mode).map(|row| (row.number("period_ms"), number(&row))).collect();
            all.push(Series { name: format!("{}, {}", mode.name(), wire.name()), points, mark, color });
        }
    }
    all
}

fn panel(title: &str, y: Axis, series: Vec<Series>) -> Panel {
    Panel { title: title.to_owned(), x: Axis::logarithmic("cycle (ms)").over(0.2, 13.0), y, series }
}

/// One panel for each question.
pub(super) fn chart(rigs: &Table, computing: &Table) -> Chart {
    let step_ns = |wire: Wire, mode: Mode| of(computing, wire, mode).next().map(|row| row.number("step_ns"));
    let mut shares = Vec::new();
    for mode in DRAWN {
        for wire in WIRES {
            let (color, mark) = look(wire, mode);
            let at = |period_us: u32| {
                let share = step_ns(wire, mode)? * 1e-3 / f64::from(period_us);
                Some((1e-3 * f64::from(period_us), 100.0 * share))
            };
            let points = PERIODS_US.into_iter().filter_map(at).collect();
            shares.push(Series { name: format!("{}, {}", mode.name(), wire.name()), points, mark, color });
        }
    }
    let mut loads = lines(rigs, |row| 100.0 * row.number("bus_load"));
    loads.push(Series {
        name: "all that a bus carries".to_owned(),
        points: vec![(0.2, 100.0), (13.0, 100.0)],
        mark: Mark::Dashed,
        color: Color::Black,
    });
    Chart {
        title: "The whole rig over its cycle, with tuned gains; CAN ends where its budget refuses".into(),
        panels: vec![
            panel(
                "tracing the circle",
                Axis::logarithmic("path error, RMS (um)"),
                lines(rigs, |row| 1e6 * row.number("error_rms_m")),
            ),
            panel(
                "impact at 0.39 m/s with a hold",
                Axis::logarithmic("depth of the tool (mm)"),
                lines(rigs, |row| 1e3 * row.number("held_tool_depth_m")),
            ),
            panel(
                "stability, soft hand",
                Axis::logarithmic("least virtual mass, runs (kg)"),
                lines(rigs, |row| row.number("run_least_kg")),
            ),
            panel(
                "impact at 0.39 m/s without a hold",
                Axis::linear("depth of the proxy (mm)"),
                lines(rigs, |row| 1e3 * row.number("proxy_depth_m")),
            ),
            panel("bus", Axis::logarithmic("load, at most (%)"), loads),
            panel("computer (measured at 1 ms)", Axis::logarithmic("control step (% of a cycle)"), shares),
        ],
    }
}
