//! The bound by which `run` judges the energy of a run: passive hands keep within it, and loops that swing pass it.

mod trial;

use serde_json::Value;

use self::trial::Trial;
use super::chart::{Axis, Chart, Color, Mark, Panel, Series};
use super::sweep::{Clock, Report, Row, Study, Sweep, Table};
use yieldwall_rig::report::RunReport;

/// Name of the study, as on the command line.
const STUDY: &str = "energy";
/// A tool that in the last second of a run is faster on average, m/s, long after the hand's aim came to rest, swings.
const SWINGS_M_PER_S: f64 = 0.01;
/// Lower edge of the chart.
const LEAST_SHARE: f64 = 1e-4;

/// The study `energy`.
pub(super) struct Energy([Box<dyn Sweep>; 2]);

impl Energy {
    pub(super) fn new() -> Self {
        Self([Box::new(CLEAN), Box::new(SWINGING)])
    }
}

impl Study for Energy {
    fn name(&self) -> &'static str {
        STUDY
    }

    fn about(&self) -> &'static str {
        "the bound of `run` on the energy given to the hand: runs by passive hands, and loops that swing"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let [clean, swinging] = tables else { return Report::default() };
        let still = swinging.rows().filter(|row| !swings(row)).count();
        let mut notes = vec![
            summary("clean", clean.rows(), WITHIN),
            summary("swinging", swinging.rows().filter(swings), ABOVE),
            format!("of {} rigs with too light a mass {still} do not swing in the last second", SWINGING.points),
        ];
        let wrong = clean.rows().filter(|row| row.word("verdict") != WITHIN);
        let wrong = wrong.chain(swinging.rows().filter(|row| swings(row) && row.word("verdict") != ABOVE));
        notes.extend(wrong.map(|row| format!("  {}: {}", row.word("verdict"), row.command(STUDY))));
        let share = |row: &Row<'_>| row.number("excess_mj") / row.number("bound_mj");
        let series = |name: &str, table: &Table, color| Series {
            name: name.to_owned(),
            points: table.rows().map(|row| (row.number("period_ms"), share(&row))).collect(),
            mark: Mark::Marks,
            color,
        };
        let bound = Series {
            name: "bound".to_owned(),
            points: vec![(0.4, 1.0), (12.0, 1.0)],
            mark: Mark::Dashed,
            color: Color::LINES[2],
        };
        let panel = Panel {
            title: "a mark is a run".to_owned(),
            x: Axis::logarithmic("cycle (ms)").over(0.4, 12.0),
            y: Axis::logarithmic("energy / bound").over(LEAST_SHARE, 100.0),
            series: vec![
                series("passive hands", clean, Color::LINES[0]),
                series("masses that are too light", swinging, Color::LINES[1]),
                bound,
            ],
        };
        let title = "Energy given in one go beyond what the rig held".to_owned();
        Report { notes, charts: vec![("study-energy", Chart { title, panels: vec![panel], columns: 1 })] }
    }
}

const WITHIN: &str = "within";
const ABOVE: &str = "above";

fn swings(row: &Row<'_>) -> bool {
    row.number("last_m_per_s") > SWINGS_M_PER_S
}

/// How many of the runs were judged as they have to be, and the least and greatest energy.
fn summary<'a>(name: &str, rows: impl Iterator<Item = Row<'a>>, verdict: &str) -> String {
    let rows: Vec<Row<'_>> = rows.collect();
    let right = rows.iter().filter(|row| row.word("verdict") == verdict).count();
    let energies = || rows.iter().map(|row| row.number("excess_mj")).filter(|energy| energy.is_finite());
    let (least, most) = (energies().fold(f64::INFINITY, f64::min), energies().fold(0.0, f64::max));
    format!("{name:10} {right} of {} {verdict} the bound; {least:.3} to {most:.3} mJ", rows.len())
}

const COLUMNS: [&str; 13] = [
    "case",
    "rig",
    "period_ms",
    "errand",
    "is_frictionless",
    "hand_kg",
    "hand_n_per_m",
    "virtual_kg",
    "least_kg",
    "excess_mj",
    "bound_mj",
    "last_m_per_s",
    "verdict",
];

/// Root of the mean square of the tool's speed in the last second.
fn last_m_per_s(report: &RunReport) -> f64 {
    let cycles = (1.0 / report.period_s) as usize;
    let rows = &report.trace.rows[report.trace.rows.len().saturating_sub(cycles)..];
    let square = |[x, y, z]: [f64; 3]| x * x + y * y + z * z;
    let sum: f64 = rows.iter().map(|row| square(row.tool_velocity_m_per_s)).sum();
    (sum / rows.len().max(1) as f64).sqrt()
}

fn cells(case: u64, trial: Result<Trial, String>) -> Vec<Value> {
    let run = trial.and_then(|trial| trial.run().map(|report| (trial, report)));
    let (trial, report) = match run {
        Ok(run) => run,
        Err(why) => return [vec![case.into()], vec![Value::Null; COLUMNS.len() - 2], vec![why.into()]].concat(),
    };
    let verdict = match report.cause.filter(|_| report.state.is_some_and(|state| state.is_latched())) {
        Some(cause) => cause.fault.row().name,
        None if report.measures.is_within_bound() => WITHIN,
        None => ABOVE,
    };
    let round = |value: f64| format!("{value:.3e}").parse::<f64>().unwrap_or(value);
    vec![
        case.into(),
        trial.rig.rig.name.clone().into(),
        round(1e3 * report.period_s).into(),
        trial.errand.into(),
        trial.is_frictionless.into(),
        round(trial.scene.hand.mass_kg.get()).into(),
        round(trial.scene.hand.stiffness_n_per_m.get()).into(),
        round(trial.virtual_kg).into(),
        round(trial.least_kg).into(),
        round(1e3 * report.measures.bounded_energy_j()).into(),
        round(1e3 * report.measures.energy_bound_j).into(),
        round(last_m_per_s(&report)).into(),
        verdict.into(),
    ]
}

/// The cases of one kind.
struct Cases {
    name: &'static str,
    points: u64,
    draw: fn(u64) -> Result<Trial, String>,
}

/// Passive hands.
const CLEAN: Cases = Cases { name: "clean", points: 210, draw: Trial::clean };
/// Rigs with a virtual mass below what their hand asks for.
const SWINGING: Cases = Cases { name: "swinging", points: 120, draw: Trial::swinging };

impl Sweep for Cases {
    fn name(&self) -> &'static str {
        self.name
    }

    fn columns(&self) -> &'static [&'static str] {
        &COLUMNS
    }

    fn points(&self) -> u64 {
        self.points
    }

    fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
        cells(index, (self.draw)(index))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::sample::share;

    fn rows_of(sweep: &dyn Sweep, indices: impl Iterator<Item = u64>) -> Table {
        let mut table = Table::new(sweep);
        indices.for_each(|index| table.insert(index, sweep.point(index, &|| Duration::ZERO)));
        table
    }

    /// A part of both tables: every rig, every errand, with friction and without.
    #[test]
    fn passive_hands_keep_within_the_bound_and_loops_that_swing_pass_it() {
        let clean = rows_of(&CLEAN, share((0..CLEAN.points).step_by(5), 10).into_iter());
        let verdicts: Vec<_> = clean.rows().map(|row| row.word("verdict").to_owned()).collect();
        assert!(verdicts.len() >= 10 && verdicts.iter().all(|verdict| verdict == WITHIN), "{verdicts:?}");
        // 1 ms by torque and by position, 2 ms.
        let swinging = rows_of(&SWINGING, (0..18).filter(|case| case % 6 < 3));
        let verdicts: Vec<_> = swinging.rows().filter(swings).map(|row| row.word("verdict").to_owned()).collect();
        // The guard stops some of them.
        let above = verdicts.iter().filter(|verdict| *verdict == ABOVE).count();
        assert!(above >= 6 && verdicts.iter().all(|verdict| verdict != WITHIN), "{verdicts:?}");
    }
}
