//! Results of a study: tables, charts, and one document that names the program and computer behind them.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use crate::failure::{Exit, Failure};
use crate::replace::unwritten;
use yieldwall_figures::chart;
use yieldwall_study::sweep::{Report, Study, Table};

/// Speed of the computation of a table's points in this run.
#[derive(Clone, Debug)]
pub(super) struct Pace {
    pub(super) table: String,
    /// Number of points, each of which is a run of the table's subject.
    pub(super) runs: usize,
    pub(super) wall_s: f64,
    pub(super) jobs: usize,
    /// Time that all threads together had a core.
    pub(super) busy_s: f64,
}

impl Pace {
    fn runs_per_s(&self) -> f64 {
        self.runs as f64 / self.wall_s
    }

    /// Returns the share of the wall clock for which a thread had a core. It is below one if the computer has other work, or if the
    /// last points keep few threads busy. It is no comparison with another number of jobs.
    fn busy_share(&self) -> f64 {
        self.busy_s / (self.wall_s * self.jobs as f64)
    }

    /// Returns a line for people.
    pub(super) fn line(&self) -> String {
        let Self { table, runs, wall_s, jobs, .. } = self;
        let (rate, busy) = (self.runs_per_s(), 100.0 * self.busy_share());
        let threads = if *jobs == 1 { "1 thread".to_owned() } else { format!("{jobs} threads") };
        format!("{table}: {runs} in {wall_s:.1} s ({rate:.1}/s), {threads}, {busy:.0} % busy")
    }

    pub(super) fn json(&self) -> Value {
        json!({
            "table": self.table,
            "runs": self.runs,
            "wall_s": self.wall_s,
            "runs_per_s": self.runs_per_s(),
            "jobs": self.jobs,
            "busy_share": self.busy_share(),
        })
    }
}

/// Content of the document besides the tables.
pub(super) struct Origin<'a> {
    pub(super) origin: &'a super::Origin,
    pub(super) build: &'a str,
    /// Points that this run computed, without the points that existed before.
    pub(super) computed: &'a [Pace],
}

/// Writes tables, document and charts to disk.
pub(super) fn write(
    folder: &Path,
    study: &dyn Study,
    tables: &[Table],
    report: &Report,
    document: &Value,
) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    let mut put = |name: String, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).map_err(|error| unwritten(&path, &error))?;
        files.push(path);
        Ok::<_, Failure>(())
    };
    for table in tables {
        put(format!("{}.csv", table.name), table.csv().as_bytes())?;
    }
    let document = serde_json::to_string_pretty(document).unwrap_or_default();
    put(format!("{}.json", study.name()), document.as_bytes())?;
    for (name, chart) in &report.charts {
        put(format!("{name}.svg"), chart::svg(chart).as_bytes())?;
        let picture = chart::png(chart).map_err(|error| Failure::new(Exit::Internal, error.to_string(), ""))?;
        put(format!("{name}.png"), &picture)?;
    }
    Ok(files)
}

/// Returns the study as one document.
pub(super) fn document(study: &dyn Study, tables: &[Table], report: &Report, origin: &Origin<'_>) -> Value {
    let others: Map<_, _> = tables.iter().skip(1).map(|table| (table.name.clone(), table.json())).collect();
    json!({
        "study": study.name(),
        "command": origin.origin.command(),
        "machine": machine(origin),
        "computed": origin.computed.iter().map(Pace::json).collect::<Value>(),
        "rows": tables.first().map(Table::json),
        "tables": others,
        "notes": report.notes,
    })
}

/// Returns the machine that computed the results.
fn machine(origin: &Origin<'_>) -> Value {
    let processors = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model =
        processors.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": ").map(|pair| pair.1));
    json!({
        "processor": model,
        "cores": std::thread::available_parallelism().map_or(1, NonZeroUsize::get),
        "system": std::env::consts::OS,
        "architecture": std::env::consts::ARCH,
        "version": env!("CARGO_PKG_VERSION"),
        "build": origin.build,
        "rustc": yieldwall_run::built::RUSTC,
        "profile": yieldwall_run::built::PROFILE,
        "opt_level": yieldwall_run::built::OPT_LEVEL,
        "debug_assertions": cfg!(debug_assertions),
        "mujoco": origin.origin.mujoco,
    })
}
