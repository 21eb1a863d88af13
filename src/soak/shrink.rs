//! A violation made small: fewer faults, shorter ones, fewer cycles.

use super::attempt::run_script;
use super::draw::Machine;
use super::invariant::{Invariant, Violation};
use super::script::Script;
use yieldwall_config::injection::Injection;

/// Most runs that are spent on one violation.
const MOST_RUNS: u32 = 60;
/// Shortest duration in s that is tried.
const SHORTEST_S: f64 = 1e-3;

/// Shrinks the script as long as the same invariant is violated, and gives the arguments of `yieldwall soak` that show it.
pub(super) fn shrink(machine: &Machine, script: &Script, seed: u64, cycles: u32, first: &Violation) -> String {
    let mut search = Search { machine, seed, invariant: first.invariant, runs: 0 };
    let mut best = (script.clone(), cycles);
    // What is found at the end of a run may need all of it.
    if let Some(found) = search.holds(&best.0, first.cycle + 1) {
        best.1 = found;
    }
    let mut at = best.0.injections.len();
    while at > 0 {
        at -= 1;
        let mut fewer = best.0.clone();
        fewer.injections.remove(at);
        search.take_if_it_holds(&mut best, fewer);
    }
    for at in 0..best.0.injections.len() {
        while let Some(shorter) = shortened(&best.0.injections[at]) {
            let mut script = best.0.clone();
            script.injections[at] = shorter;
            if !search.take_if_it_holds(&mut best, script) {
                break;
            }
        }
    }
    let (script, cycles) = best;
    let tangle = if script.is_tangle { " --tangle" } else { "" };
    format!("--seed {seed} --cycles {cycles} --script '{script}'{tangle}")
}

fn shortened(injection: &Injection) -> Option<Injection> {
    let duration_s = injection.duration_s.filter(|duration_s| *duration_s > 2.0 * SHORTEST_S)?;
    Some(injection.lasting(Some(0.5 * duration_s)))
}

struct Search<'a> {
    machine: &'a Machine,
    seed: u64,
    invariant: Invariant,
    runs: u32,
}

impl Search<'_> {
    /// Returns the number of cycles that show the violation under `script`, if it shows within `cycles` and a run is left.
    fn holds(&mut self, script: &Script, cycles: u32) -> Option<u32> {
        if self.runs >= MOST_RUNS {
            return None;
        }
        self.runs += 1;
        let (played, verdict) = run_script(self.machine, script, self.seed, cycles);
        let mut all = played.violations.iter().chain(&verdict.violations);
        all.find(|found| found.invariant == self.invariant).map(|_| cycles)
    }

    fn take_if_it_holds(&mut self, best: &mut (Script, u32), script: Script) -> bool {
        match self.holds(&script, best.1) {
            Some(cycles) => {
                *best = (script, cycles);
                true
            }
            None => false,
        }
    }
}
