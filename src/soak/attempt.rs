//! One run of a script, and what is thought of it.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::draw::Machine;
use super::invariant::{Invariant, Violation};
use super::script::Script;
use super::session::{Course, Play, play};
use super::verdict::{Verdict, judge};

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
