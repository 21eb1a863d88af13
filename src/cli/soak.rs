//! `yieldwall soak`: many rigs, hands and faults drawn from seeds, each cycle judged from outside.

use std::io::{self, IsTerminal};
use std::num::{NonZeroU32, NonZeroUsize};
use std::ops::Range;
use std::path::PathBuf;
use std::time::Instant;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::json;

use super::failure::{Exit, Failure};
use super::output::Output;
use super::replace::{Replace, Written, unwritten};
use yieldwall_config::Report;
use yieldwall_soak::{self as soak, Campaign, Script, SeedResult, Shipped, Store, StoreError, Tally};

/// Violations that are told in full.
const MOST_TOLD: usize = 20;
/// Seeds from which on every injection has to have been met.
const ALL_HIT_FROM: u64 = 200;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Seeds, from the first to before the last
    #[arg(long, value_name = "A..B", value_parser = parse_seeds, default_value = "0..200", conflicts_with = "seed")]
    seeds: Range<u64>,
    /// One seed alone
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Cycles of each seed
    #[arg(long, value_name = "N", default_value = "10000")]
    cycles: NonZeroU32,
    /// Faults in place of the seed's own: name:target@start+duration=size, with commas between; empty for none
    #[arg(long, value_name = "FAULTS", requires = "seed", conflicts_with_all = ["out", "jobs"])]
    script: Option<Script>,
    /// The faults of --script act together: only invariants are judged
    #[arg(long, requires = "script")]
    tangle: bool,
    /// Threads; as many as there are cores unless given
    #[arg(long, value_name = "N")]
    jobs: Option<NonZeroUsize>,
    /// Keep each outcome in this folder, and leave out what it holds already
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write the summary as Markdown tables
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    #[command(flatten)]
    replace: Replace,
    /// Fail if an injection or a fault was never met; always so from 200 seeds on
    #[arg(long)]
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
    let shipped = Shipped::load()?;
    let cycles = arguments.cycles.get();
    let started = Instant::now();
    let outcomes: Vec<SeedResult> = match (arguments.seed, &arguments.script) {
        (Some(seed), Some(script)) => {
            script.check(&shipped, seed).map_err(|error| {
                let help = format!(
                    "the rig of seed {seed} has another bus; `yieldwall faults NAME` says on which one a fault acts"
                );
                Failure::new(Exit::Usage, format!("--script {error}"), help)
            })?;
            let script = Script { is_tangle: arguments.tangle, ..script.clone() };
            vec![soak::run_seed(&shipped, seed, cycles, Some(&script))]
        }
        (seed, _) => {
            let seeds = seed.map_or(arguments.seeds.clone(), |seed| seed..seed.saturating_add(1));
            let cores = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
            let jobs = arguments.jobs.map_or(cores, NonZeroUsize::get);
            let campaign = Campaign { seeds, cycles, jobs };
            let store = arguments.out.as_deref().map(|folder| Store::open(folder, cycles)).transpose();
            let store = store.map_err(store_failure)?;
            let known = store
                .as_ref()
                .map_or(0, |(_, known)| known.keys().filter(|seed| campaign.seeds.contains(seed)).count() as u64);
            let bar = bar(output, campaign.seeds.end - campaign.seeds.start, known);
            let mut failed = 0u64;
            let outcomes = soak::run(&shipped, &campaign, store, |outcome| {
                failed += u64::from(!outcome.violations.is_empty());
                if failed > 0 {
                    bar.set_message(format!("{failed} seeds with violations"));
                }
                bar.inc(1);
            });
            bar.finish_and_clear();
            outcomes.map_err(store_failure)?.into_values().collect()
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
    output.news(&soak::text(&tally))?;
    output.news(&format!("{:34} {wall_s:.1} s, {:.0} cycles/s", "run in", tally.cycles as f64 / wall_s))?;
    for (what, missed) in [("injections", tally.missed_injections()), ("faults", tally.missed_faults())] {
        if !missed.is_empty() && tally.seeds > 1 {
            output.news(&format!("{:34} {}", format!("{what} never met"), missed.join(", ")))?;
        }
    }
    // One line each, as long as it is: to be copied.
    for outcome in &outcomes {
        if let Some(replay) = &outcome.replay {
            output.result(&format!("yieldwall soak {replay}\n"))?;
        }
    }
    end
}

/// What did not hold, and how to see it again.
fn judge(arguments: &Arguments, tally: &Tally, outcomes: &[SeedResult]) -> Result<(), Failure> {
    let mut failed = outcomes.iter().filter(|outcome| !outcome.violations.is_empty());
    if let Some(first) = failed.next() {
        let told = std::iter::once(first).chain(failed).take(MOST_TOLD);
        let diagnostics = told.flat_map(|outcome| {
            let help = "run the line above that begins with this seed: it shows the violation again".to_owned();
            outcome.violations.iter().take(1).flat_map(move |found| {
                let message = format!(
                    "seed {} ({}): {} did not hold in cycle {}, at {:.4} s: {}",
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
        let message = format!("never met in {} seeds: {}", tally.seeds, missed.join(", "));
        return Err(Failure::new(Exit::OutOfTolerance, message, "run more seeds, or more cycles of each"));
    }
    Ok(())
}

fn bar(output: &Output, seeds: u64, known: u64) -> ProgressBar {
    let bar = ProgressBar::new(seeds);
    if output.is_json() || output.is_quiet() || !io::stderr().is_terminal() {
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} seeds  {elapsed}, {eta} left  {msg}") {
        bar.set_style(style);
    }
    bar.with_position(known)
}

fn store_failure(error: StoreError) -> Failure {
    let help = "choose another folder, or the cycles of these results";
    match &error {
        StoreError::OtherLength { .. } => Failure::new(Exit::Usage, error.to_string(), help),
        StoreError::Lines(error) => error.into(),
    }
}
