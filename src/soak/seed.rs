//! One seed from the draw to its outcome.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::draw::{Machine, Shipped};
use super::invariant::{Invariant, Violation};
use super::script::Script;
use super::session::{Course, Play, play};
use super::shrink::shrink;
use super::tally::Outcome;
use super::verdict::{Verdict, judge};
use crate::guard::fault::TABLE;

/// One seed in so many is run twice.
const TWICE_EVERY: u64 = 16;

/// Runs `seed` for `cycles` cycles, with its own script unless another is given. A violation comes with the shortest
/// command that was found to show it again.
pub fn run_seed(shipped: &Shipped, seed: u64, cycles: u32, script: Option<&Script>) -> Outcome {
    let machine = Machine::draw(shipped, seed);
    let drawn = || Script::draw(&machine, seed, cycles);
    let script = script.cloned().unwrap_or_else(drawn);
    let (mut played, mut verdict) = run_script(&machine, &script, seed, cycles);
    if seed.is_multiple_of(TWICE_EVERY) {
        let (again, _) = run_script(&machine, &script, seed, cycles);
        if again.hash != played.hash {
            let seen = format!("two runs left the marks {:016x} and {:016x}", played.hash, again.hash);
            let (cycle, time_s) = (played.cycles, played.simulated_s);
            verdict.violations.push(Violation { invariant: Invariant::I15, cycle, time_s, seen });
        }
    }
    played.excused.join(&verdict.excused);
    let mut violations = played.violations;
    for found in verdict.violations {
        if violations.iter().all(|known| known.invariant != found.invariant) {
            violations.push(found);
        }
    }
    let replay = violations.first().map(|first| shrink(&machine, &script, seed, cycles, first));
    Outcome {
        seed,
        rig: machine.file.to_owned(),
        asked: cycles,
        end: played.end,
        cycles: played.cycles,
        simulated_s: played.simulated_s,
        hash: played.hash,
        is_tangle: script.is_tangle,
        restarts: played.restarts,
        injections: verdict.injections,
        faults: verdict.faults,
        shown: TABLE
            .iter()
            .zip(played.shown)
            .filter(|(_, times)| *times > 0)
            .map(|(row, times)| (row.name.to_owned(), times))
            .collect(),
        peaks: played.peaks,
        excused: played.excused.by_name(),
        violations,
        replay,
    }
}

/// Runs a script and judges it. A panic of the program is a violation like any other.
pub(super) fn run_script(machine: &Machine, script: &Script, seed: u64, cycles: u32) -> (Play, Verdict) {
    let course = Course { machine, script: &script.injections, seed, cycles };
    match catch_unwind(AssertUnwindSafe(|| play(&course))) {
        Ok(played) => {
            let verdict = judge(machine, script, &played);
            (played, verdict)
        }
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("without a message");
            let seen = format!("panic: {text}");
            let found = Violation { invariant: Invariant::Simulation, cycle: 0, time_s: 0.0, seen };
            let played = Play { violations: vec![found], ..Play::nothing() };
            (played, Verdict::default())
        }
    }
}
