//! One seed from the draw to its outcome.

use super::attempt::run_script;
use super::draw::{Machine, Shipped};
use super::invariant::{Invariant, Violation};
use super::script::Script;
use super::shrink::shrink;
use super::tally::SeedResult;
use yieldwall_motion::guard::fault::TABLE;

/// One seed in this many is run twice.
const TWICE_EVERY: u64 = 16;

/// Runs `seed` for `cycles` cycles, with its own script unless another is given. A violation comes with the shortest
/// command that was found to show it again.
pub fn run_seed(shipped: &Shipped, seed: u64, cycles: u32, script: Option<&Script>) -> SeedResult {
    let machine = Machine::draw(shipped, seed);
    let drawn = || Script::draw(&machine, seed, cycles);
    let script = script.cloned().unwrap_or_else(drawn);
    let (mut played, mut verdict) = run_script(&machine, &script, seed, cycles);
    if seed.is_multiple_of(TWICE_EVERY) {
        let (again, _) = run_script(&machine, &script, seed, cycles);
        if again.hash != played.hash {
            let seen = format!("two runs left the marks {:016x} and {:016x}", played.hash, again.hash);
            let (cycle, time_s) = (played.cycles, played.simulated_s);
            verdict.violations.push(Violation { invariant: Invariant::Repeatable, cycle, time_s, seen });
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
    SeedResult {
        seed,
        rig: machine.title(),
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
