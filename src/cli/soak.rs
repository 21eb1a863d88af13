//! `yieldwall soak`: many rigs, hands and faults drawn from seeds, with an independent judgement of each cycle.

use std::collections::BTreeMap;
use std::num::{NonZeroU32, NonZeroUsize};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde_json::json;

use super::failure::{self, Exit, Failure};
use super::interrupt::on_interrupt;
use super::output::Output;
use super::parts::{Array, Parts, interrupted, nothing_to_merge, threads};
use super::progress::bar;
use super::replace::{Replace, Written, unwritten};
use super::usage::{at_least_one, whole};
use yieldwall_config::Report;
use yieldwall_rig::batch::Shard;
use yieldwall_soak::{self as soak, Campaign, Script, SeedResult, Shipped, Store, StoreError, Tally};

/// Largest number of violations that are printed in full.
const MOST_TOLD: usize = 20;
/// Seeds from which on every injection has to have been met.
const ALL_HIT_FROM: u64 = 200;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Range of seeds, from the first to before the last
    #[arg(long, value_name = "A..B", value_parser = parse_seeds, default_value = "0..200", conflicts_with = "seed")]
    seeds: Range<u64>,
    /// Run only this seed
    #[arg(long, value_name = "N", value_parser = whole::<u64>, conflicts_with_all = ["shard", "merge", "slurm", "missing"])]
    seed: Option<u64>,
    /// Cycles of each seed
    #[arg(long, value_name = "N", default_value = "10000", value_parser = at_least_one::<NonZeroU32>)]
    cycles: NonZeroU32,
    /// Faults instead of the seed's own, separated by commas: name:target@start+duration=size; empty for none
    #[arg(long, value_name = "FAULTS", requires = "seed", conflicts_with_all = ["out", "jobs"])]
    script: Option<Script>,
    /// Run the faults of --script together, and judge only invariants
    #[arg(long, requires = "script")]
    tangle: bool,
    /// Threads; default: Slurm's processors for the task, otherwise the number of cores
    ///
    /// SLURM_CPUS_PER_TASK has the processors that Slurm allots.
    #[arg(long, value_name = "N", value_parser = at_least_one::<NonZeroUsize>)]
    jobs: Option<NonZeroUsize>,
    /// Keep each outcome in this folder, and skip those it already holds
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    parts: Parts,
    /// Write the summary as Markdown tables
    #[arg(long, value_name = "FILE", conflicts_with = "shard")]
    markdown: Option<PathBuf>,
    #[command(flatten)]
    replace: Replace,
    /// Fail if an injection or a fault never occurred; always on from 200 seeds
    #[arg(long, conflicts_with = "shard")]
    require_hits: bool,
}

fn parse_seeds(text: &str) -> Result<Range<u64>, String> {
    let wanted = || "two numbers with two dots between, such as 0..200, the first below the second".to_owned();
    let (first, last) = text.split_once("..").ok_or_else(wanted)?;
    let number = |text: &str| text.parse::<u64>().map_err(|_| wanted());
    let seeds = number(first)?..number(last)?;
    if seeds.is_empty() { Err(wanted()) } else { Ok(seeds) }
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    if let Some(path) = &arguments.markdown {
        arguments.replace.check(path, Written::Tables)?;
    }
    let cycles = arguments.cycles.get();
    let campaign =
        Campaign { seeds: seeds(arguments), shard: arguments.parts.shard, cycles, jobs: threads(arguments.jobs) };
    let folder = arguments.out.as_deref();
    if folder.is_none() && arguments.parts.is_in_parts() {
        return Err(Failure::new(Exit::Usage, "parts need a folder", "name it with --out"));
    }
    let folder = folder.unwrap_or(Path::new("."));
    let missing = || Ok(campaign.missing(&Store::read(folder, cycles).map_err(store_failure)?));
    let parts = &arguments.parts;
    if parts.print_script(&array(arguments, folder), output)? || parts.print_missing(missing, output)? {
        return Ok(());
    }
    let shipped = Shipped::load()?;
    let started = Instant::now();
    let outcomes: Vec<SeedResult> = match (arguments.seed, &arguments.script) {
        (Some(seed), Some(script)) => {
            script.check(&shipped, seed).map_err(|error| {
                let help = format!(
                    "the rig of seed {seed} has another bus; `yieldwall faults NAME` prints the buses of a fault"
                );
                Failure::new(Exit::Usage, format!("--script {error}"), help)
            })?;
            let script = Script { is_tangle: arguments.tangle, ..script.clone() };
            vec![soak::run_seed(&shipped, seed, cycles, Some(&script))]
        }
        _ if parts.merge => merge(folder, &campaign)?,
        _ => {
            let Range { start, end } = &campaign.seeds;
            output.aside(&format!("seeds {start}..{end}: {} of {cycles} cycles each", end - start));
            let store = arguments.out.as_deref().map(|folder| Store::open(folder, cycles, campaign.shard)).transpose();
            let store = store.map_err(store_failure)?;
            let known =
                store.as_ref().map_or(0, |(_, known)| known.keys().filter(|seed| campaign.holds(**seed)).count());
            let missing =
                store.as_ref().map_or_else(|| campaign.missing(&BTreeMap::new()), |(_, known)| campaign.missing(known));
            let template = "{bar:40} {pos}/{len} seeds  {elapsed}, {eta} left  {msg}";
            let bar = bar(output, (known + missing.len()) as u64, template).with_position(known as u64);
            let is_interrupted = on_interrupt()?;
            let mut failed = 0u64;
            let outcomes = soak::run(&shipped, &campaign, store, &is_interrupted, |outcome| {
                failed += u64::from(!outcome.violations.is_empty());
                if failed > 0 {
                    bar.set_message(format!("{failed} seeds with violations"));
                }
                bar.inc(1);
            });
            bar.finish_and_clear();
            let outcomes = outcomes.map_err(store_failure)?;
            let missing = campaign.missing(&outcomes).len();
            if missing > 0 {
                let kept = arguments.out.as_ref().map(|_| format!("the other seeds are in {}", folder.display()));
                print_replays(outcomes.values(), output)?;
                return Err(interrupted(missing, missing + outcomes.len(), "seeds", kept.as_deref()));
            }
            if let Some(shard) = campaign.shard {
                return kept(folder, shard, &outcomes, output);
            }
            outcomes.into_values().collect()
        }
    };
    let wall_s = started.elapsed().as_secs_f64();
    let mut tally = Tally::default();
    outcomes.iter().for_each(|outcome| tally.add(outcome));
    if let Some(path) = &arguments.markdown {
        std::fs::write(path, soak::markdown(&tally)).map_err(|error| unwritten(path, &error))?;
    }
    let end = judge(arguments, &tally, &outcomes);
    if output.is_json() {
        let document = json!({
            "summary": tally,
            "wall_s": wall_s,
            "violations": outcomes.iter().filter(|outcome| !outcome.violations.is_empty()).collect::<Vec<_>>(),
            "missed_injections": tally.missed_injections(),
            "missed_faults": tally.missed_faults(),
        });
        return output.end(document, end);
    }
    output.news(&failure::verdict(&end, || match tally.seeds {
        1 => "no violation in 1 seed".to_owned(),
        seeds => format!("no violation in {seeds} seeds"),
    }))?;
    output.news(&soak::text(&tally))?;
    output.news(&format!("{:40} {wall_s:.1} s, {:.0} cycles/s", "run in", tally.cycles as f64 / wall_s))?;
    for (what, missed) in [("injections", tally.missed_injections()), ("faults", tally.missed_faults())] {
        if !missed.is_empty() && tally.seeds > 1 {
            output.news(&format!("{:40} {}", format!("{what} that never occurred"), missed.join(", ")))?;
        }
    }
    print_replays(&outcomes, output)?;
    end
}

/// Prints the commands that repeat the seeds with violations: one unwrapped line each, for copying.
fn print_replays<'a>(outcomes: impl IntoIterator<Item = &'a SeedResult>, output: &mut Output) -> Result<(), Failure> {
    let mut replays = outcomes.into_iter().filter_map(|outcome| outcome.replay.as_ref());
    replays.try_for_each(|replay| output.result(&format!("yieldwall soak {replay}\n")))
}

fn seeds(arguments: &Arguments) -> Range<u64> {
    arguments.seed.map_or(arguments.seeds.clone(), |seed| seed..seed.saturating_add(1))
}

/// Returns the campaign as a job array.
fn array<'a>(arguments: &Arguments, out: &'a Path) -> Array<'a> {
    let Range { start, end } = seeds(arguments);
    let words = ["soak", "--seeds", &format!("{start}..{end}"), "--cycles", &arguments.cycles.to_string()];
    let mut last = vec!["--merge".to_owned()];
    if let Some(path) = &arguments.markdown {
        last.extend(["--markdown".to_owned(), path.display().to_string()]);
    }
    last.extend(arguments.require_hits.then(|| "--require-hits".to_owned()));
    last.extend(arguments.replace.is_forced().then(|| "--force".to_owned()));
    Array {
        name: "yieldwall-soak".to_owned(),
        words: words.map(str::to_owned).to_vec(),
        last,
        out,
        jobs: arguments.jobs,
    }
}

/// Returns all outcomes of the campaign, from the parts that are kept.
fn merge(folder: &Path, campaign: &Campaign) -> Result<Vec<SeedResult>, Failure> {
    let mut known = Store::read(folder, campaign.cycles).map_err(store_failure)?;
    let missing = campaign.missing(&known);
    if known.is_empty() {
        let Range { start, end } = &campaign.seeds;
        let command = format!("soak --seeds {start}..{end} --cycles {}", campaign.cycles);
        return Err(nothing_to_merge(&format!("{} holds no seeds", folder.display()), &command, folder, false));
    }
    if let Some(first) = missing.first() {
        let message = format!("{} seeds are missing; the first is {first}", missing.len());
        let help = format!(
            "--missing prints their parts; without --merge and --shard the command runs all seeds that are missing in {}",
            folder.display()
        );
        return Err(Failure::new(Exit::Usage, message, help));
    }
    known.retain(|seed, _| campaign.holds(*seed));
    Ok(known.into_values().collect())
}

/// Reports the place of a part, which judges nothing.
fn kept(folder: &Path, shard: Shard, outcomes: &BTreeMap<u64, SeedResult>, output: &mut Output) -> Result<(), Failure> {
    let failed = outcomes.values().filter(|outcome| !outcome.violations.is_empty()).count();
    if output.is_json() {
        let document = json!({
            "shard": shard.to_string(), "folder": folder, "seeds": outcomes.len(), "seeds_with_violations": failed,
        });
        return output.report(document);
    }
    output.news(&format!(
        "{} seeds, {failed} with violations, saved in {}\njudge all parts with --merge when they are complete",
        outcomes.len(),
        folder.display()
    ))
}

/// Returns the invariants that did not hold, and how to reproduce each violation.
fn judge(arguments: &Arguments, tally: &Tally, outcomes: &[SeedResult]) -> Result<(), Failure> {
    let mut failed = outcomes.iter().filter(|outcome| !outcome.violations.is_empty());
    if let Some(first) = failed.next() {
        let told = std::iter::once(first).chain(failed).take(MOST_TOLD);
        let diagnostics = told.flat_map(|outcome| {
            let help = "run the `yieldwall soak` command above with this seed to repeat the violation".to_owned();
            outcome.violations.iter().take(1).flat_map(move |found| {
                let message = format!(
                    "seed {} ({}): {} violated in cycle {}, at {:.4} s: {}",
                    outcome.seed,
                    outcome.rig,
                    found.invariant.name(),
                    found.cycle,
                    found.time_s,
                    found.seen
                );
                Failure::new(Exit::OutOfTolerance, message, help.clone()).report.diagnostics
            })
        });
        return Err(Failure { exit: Exit::OutOfTolerance, report: Report { diagnostics: diagnostics.collect() } });
    }
    let missed = [tally.missed_injections(), tally.missed_faults()].concat();
    if (arguments.require_hits || tally.seeds >= ALL_HIT_FROM) && !missed.is_empty() {
        let message = format!("never occurred in {} seeds: {}", tally.seeds, missed.join(", "));
        return Err(Failure::new(Exit::OutOfTolerance, message, "run more seeds, or more cycles of each seed"));
    }
    Ok(())
}

fn store_failure(error: StoreError) -> Failure {
    let help = "choose another folder, or use the cycles of these results";
    match &error {
        StoreError::OtherLength { .. } => Failure::new(Exit::Usage, error.to_string(), help),
        StoreError::Lines(error) => error.into(),
    }
}
