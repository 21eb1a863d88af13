//! Points of a study: computed, kept, and drawn when all of them are there.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::document::{self, Pace};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use crate::parts::{Array, Parts, interrupted, line, nothing_to_merge, threads};
use crate::progress::bar;
use yieldwall_rig::batch;
use yieldwall_study::sweep::{Store, StoreError, Study, Sweep, Table};

/// Name of the file of a table that is not computed in shards.
const WHOLE: &str = "whole";

/// The points to compute, their folder, and whether to draw them.
#[derive(Debug, clap::Args)]
pub(crate) struct Points {
    /// Folder of the results, with a subfolder for each study
    ///
    /// A subfolder holds each table as CSV, all of them as one JSON document, the charts as SVG and PNG, and every computed point
    /// (*.jsonl). An interrupted study continues from these points.
    #[arg(long, value_name = "DIR", default_value = "out/study")]
    pub(super) out: PathBuf,
    /// Threads; default: Slurm's processors for the task, otherwise the number of cores
    ///
    /// SLURM_CPUS_PER_TASK has the processors that Slurm allots. Measurements of time use one thread.
    #[arg(long, value_name = "J", value_parser = crate::usage::at_least_one::<NonZeroUsize>)]
    jobs: Option<NonZeroUsize>,
    #[command(flatten)]
    pub(super) parts: Parts,
    /// Compute only one point, print it, and keep nothing
    #[arg(long, value_name = "TABLE:INDEX", value_parser = parse_point, conflicts_with_all = ["shard", "merge", "slurm", "missing"])]
    pub(crate) point: Option<PointName>,
    /// Accept points that another build of this program computed
    #[arg(long)]
    any_build: bool,
    /// Delete the points in the folder, and compute all again
    #[arg(long, conflicts_with_all = ["merge", "any_build", "point", "shard", "slurm", "missing"])]
    fresh: bool,
}

/// The source of a study's points.
pub(crate) struct Origin {
    /// Words behind the name of the program that compute all of them, without options of [`Points`].
    pub(crate) words: Vec<String>,
    /// Subfolder in the folder of the results.
    pub(crate) folder: String,
    /// Whether points that are there are thrown away before any is computed.
    pub(crate) is_anew: bool,
    /// Further facts on which the points depend, besides the program's build and the study's name.
    pub(crate) hangs_on: String,
    /// Version of the MuJoCo that takes part, if one does.
    pub(crate) mujoco: Option<String>,
}

/// A point: its table, if one is named, and its number.
#[derive(Clone, Debug)]
pub(crate) struct PointName {
    table: Option<String>,
    index: u64,
}

fn parse_point(text: &str) -> Result<PointName, &'static str> {
    let (table, index) = text.rsplit_once(':').map_or((None, text), |(table, index)| (Some(table), index));
    let index = index.parse().map_err(|_| "write the table and the number of the point, such as mass:17")?;
    Ok(PointName { table: table.map(str::to_owned), index })
}

impl Origin {
    /// Returns the command that computes all points.
    pub(super) fn command(&self) -> String {
        format!("yieldwall {}", line(&self.words))
    }

    /// Returns the required build of the points, and the other facts on which they depend.
    fn edition(&self, build: &str) -> String {
        format!("build {build}{}", self.hangs_on)
    }
}

impl Points {
    /// Answers a question about parts of some studies, for which nothing is computed, and returns whether there was one. `words`
    /// are those after the name of the program that compute all of them.
    pub(crate) fn answer(
        &self,
        words: &[String],
        studies: &[(Box<dyn Study>, Origin)],
        output: &mut Output,
    ) -> Result<bool, Failure> {
        let is_timed = studies.iter().any(|(study, _)| study.sweeps().iter().any(|sweep| sweep.is_timed()));
        let any_build = self.any_build.then(|| "--any-build".to_owned());
        let command = words.first().map_or("study", String::as_str);
        let name = match studies {
            [(study, _)] if study.name() == command => command.to_owned(),
            [(study, _)] => format!("{command}-{}", study.name()),
            _ => format!("{command}-all"),
        };
        let array = Array {
            name: format!("yieldwall-{name}"),
            words: words.iter().cloned().chain(any_build).collect(),
            // The last job computes tables that measure time.
            last: if is_timed { Vec::new() } else { vec!["--merge".to_owned()] },
            out: &self.out,
            jobs: self.jobs,
        };
        if self.parts.print_script(&array, output)? {
            return Ok(true);
        }
        let missing = || {
            let mut missing = Vec::new();
            let build = build();
            for (study, origin) in studies {
                let folder = self.out.join(&origin.folder);
                for sweep in study.sweeps().iter().filter(|sweep| !sweep.is_timed()) {
                    let table = Store::read(&folder, sweep.as_ref(), &origin.edition(&build), self.any_build);
                    missing.extend(table.map_err(store_failure)?.missing());
                }
            }
            Ok(missing)
        };
        self.parts.print_missing(missing, output)
    }

    /// Computes and draws a study, and returns its JSON document, if that is requested and not printed yet. Once `is_interrupted`
    /// is set, the function finishes and keeps the points in progress, and begins no other.
    pub(crate) fn compute_or_draw(
        &self,
        study: &dyn Study,
        origin: &Origin,
        is_interrupted: &AtomicBool,
        output: &mut Output,
    ) -> Result<Option<Value>, Failure> {
        if let Some(name) = &self.point {
            let (sweep, one) = point(study, name)?;
            return print(sweep, &one, output).map(|()| None);
        }
        let timed: Vec<_> = study.sweeps().iter().filter(|sweep| sweep.is_timed()).map(|sweep| sweep.name()).collect();
        let folder = self.out.join(&origin.folder);
        let build = build();
        let edition = origin.edition(&build);
        let (mut tables, mut computed) = (Vec::new(), Vec::new());
        if self.fresh || (origin.is_anew && self.parts.computes()) {
            for sweep in study.sweeps() {
                Store::discard(&folder, sweep.as_ref()).map_err(store_failure)?;
            }
        }
        // Times of several runs are not to be compared.
        for sweep in study.sweeps().iter().filter(|sweep| self.parts.shard.is_none() || !sweep.is_timed()) {
            let (table, pace) =
                compute(self, &origin.words, sweep.as_ref(), &folder, &edition, is_interrupted, output)?;
            tables.push(table);
            computed.extend(pace);
        }
        if let Some(shard) = self.parts.shard {
            if output.is_json() {
                let paces: Value = computed.iter().map(Pace::json).collect();
                let document =
                    json!({ "study": study.name(), "shard": shard.to_string(), "folder": folder, "computed": paces });
                return Ok(Some(document));
            }
            let next = match timed.as_slice() {
                [] => "draw them with --merge".to_owned(),
                timed => format!("run without --shard, which measures {} in one go and draws", timed.join(" and ")),
            };
            output.news(&format!("kept in {}; when all parts are there, {next}", folder.display()))?;
            return Ok(None);
        }
        let report = study.report(&tables);
        let origin = document::Origin { origin, build: &build, computed: &computed };
        let document = document::document(study, &tables, &report, &origin);
        let files = document::write(&folder, study, &tables, &report, &document)?;
        if output.is_json() {
            return Ok(Some(document));
        }
        for line in &report.notes {
            output.news(line)?;
        }
        for file in files {
            output.news(&format!("  written to {}", file.display()))?;
        }
        Ok(None)
    }
}

/// Computes one point.
fn point<'a>(study: &'a dyn Study, name: &PointName) -> Result<(&'a dyn Sweep, Table), Failure> {
    let index = name.index;
    let found = study.sweeps().iter().find(|sweep| name.table.as_deref() == Some(sweep.name()));
    let Some(sweep) = found else {
        let names: Vec<_> = study.sweeps().iter().map(|sweep| sweep.name()).collect();
        let message = match &name.table {
            Some(table) => format!("{} has no table {table}", study.name()),
            None => format!("--point {index} names no table of {}", study.name()),
        };
        let first = names.first().copied().unwrap_or_default();
        let help =
            format!("write --point TABLE:INDEX, such as --point {first}:{index}; the tables are {}", names.join(", "));
        return Err(Failure::new(Exit::Usage, message, help));
    };
    let table = sweep.name();
    if index >= sweep.points() {
        let message = format!("{table} has no point {index}");
        let help = format!("its points are 0 to {}", sweep.points().saturating_sub(1));
        return Err(Failure::new(Exit::Usage, message, help));
    }
    let mut one = Table::new(sweep.as_ref());
    one.insert(index, sweep.point(index, &core_time));
    Ok((sweep.as_ref(), one))
}

fn print(sweep: &dyn Sweep, one: &Table, output: &mut Output) -> Result<(), Failure> {
    for row in one.rows() {
        if output.is_json() {
            output.json(&row.json())?;
        } else {
            for column in sweep.columns() {
                output.result(&format!("{column:32} {}\n", row.cell(column)))?;
            }
        }
    }
    Ok(())
}

/// Returns the points of a table: those in the folder, and the newly computed ones of its part, with the speed of the computation.
fn compute(
    arguments: &Points,
    words: &[String],
    sweep: &dyn Sweep,
    folder: &Path,
    edition: &str,
    is_interrupted: &AtomicBool,
    output: &mut Output,
) -> Result<(Table, Option<Pace>), Failure> {
    if arguments.parts.merge {
        let table = Store::read(folder, sweep, edition, arguments.any_build).map_err(store_failure)?;
        let missing = table.missing();
        return match missing.first() {
            None => Ok((table, None)),
            Some(_) if missing.len() as u64 == table.points => Err(nothing_to_merge(
                &format!("{} holds no points of the table {}", folder.display(), table.name),
                &line(words),
                &arguments.out,
                sweep.is_timed(),
            )),
            Some(first) => {
                let count = missing.len();
                let message =
                    format!("{}: {count} of {} points are missing, the first is {first}", table.name, table.points);
                let part = match sweep.is_timed() {
                    true => String::new(),
                    false => format!("of N parts, part 1 + {first} modulo N computes it; "),
                };
                let help = format!(
                    "{part}without --merge and --shard all that is missing in {} is computed",
                    folder.display()
                );
                Err(Failure::new(Exit::Usage, message, help))
            }
        };
    }
    let shard = arguments.parts.shard.map_or_else(|| WHOLE.to_owned(), |shard| shard.name());
    let (mut store, mut table) =
        Store::open(folder, sweep, edition, arguments.any_build, &shard).map_err(store_failure)?;
    let missing = table.missing();
    let is_of_part = |index: &u64| arguments.parts.shard.is_none_or(|shard| shard.holds(*index));
    let wanted: Vec<u64> = missing.into_iter().filter(is_of_part).collect();
    if wanted.is_empty() {
        return Ok((table, None));
    }
    let jobs = if sweep.is_timed() { 1 } else { threads(arguments.jobs) };
    let bar = bar(output, wanted.len() as u64, "{msg:16} {bar:40} {pos}/{len}  {elapsed}, {eta} left");
    let bar = bar.with_message(sweep.name().to_owned());
    let started = Instant::now();
    let mut spent = Duration::ZERO;
    let work = |index| {
        let before = core_time();
        let cells = sweep.point(index, &core_time);
        (cells, core_time().saturating_sub(before))
    };
    let mut left = wanted.len();
    batch::run(&wanted, jobs, is_interrupted, work, |index, (cells, time)| {
        store.add(index, &cells)?;
        table.insert(index, cells);
        spent += time;
        left -= 1;
        bar.inc(1);
        Ok::<_, StoreError>(())
    })
    .map_err(store_failure)?;
    bar.finish_and_clear();
    if left > 0 {
        // Times of two runs are not to be compared.
        let kept = (!sweep.is_timed()).then(|| format!("the others are kept in {}", folder.display()));
        return Err(interrupted(left, wanted.len(), &format!("points of {}", table.name), kept.as_deref()));
    }
    let wall_s = started.elapsed().as_secs_f64();
    let pace = Pace { table: table.name.clone(), runs: wanted.len(), wall_s, jobs, busy_s: spent.as_secs_f64() };
    output.news(&pace.line())?;
    Ok((table, Some(pace)))
}

/// Returns a checksum of the program's own file, which distinguishes one build from another.
fn build() -> String {
    let sum = std::env::current_exe().and_then(std::fs::read).map_or(0, |bytes| crc32fast::hash(&bytes));
    format!("{sum:08x}")
}

/// Returns the time that this thread has had on a core; on a system without such a clock, the wall-clock time.
fn core_time() -> Duration {
    #[cfg(target_os = "linux")]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        Duration::new(u64::try_from(time.tv_sec).unwrap_or(0), u32::try_from(time.tv_nsec).unwrap_or(0))
    }
    #[cfg(not(target_os = "linux"))]
    {
        static ORIGIN: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
        ORIGIN.get_or_init(Instant::now).elapsed()
    }
}

fn store_failure(error: StoreError) -> Failure {
    let help = match &error {
        StoreError::Lines(error) => return error.into(),
        StoreError::Other { .. } => {
            "throw them away with --fresh or choose another folder; --any-build takes them if the build alone differs"
        }
    };
    Failure::new(Exit::Usage, error.to_string(), help)
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
