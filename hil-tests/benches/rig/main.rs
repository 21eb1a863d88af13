//! Speed of the whole rig in virtual time, and what its time goes into.
//!
//! `cargo bench -p hil-tests --bench rig` prints both. It measures and does not judge; the hash of the rows tells
//! whether a change of the program changed a run.

mod breakdown;
mod speed;

use std::process::ExitCode;

use yieldwall::rig::RigError;

fn main() -> ExitCode {
    // `cargo bench` adds this flag. Without it, as under `cargo test --benches`, one short pass shows that all runs.
    let (flags, wanted): (Vec<_>, Vec<_>) = std::env::args().skip(1).partition(|word| word.starts_with('-'));
    let is_full = flags.iter().any(|flag| flag == "--bench");
    let (runs, cycles) = if is_full { (21, usize::MAX) } else { (1, 200) };
    let effort = Effort { runs, cycles, wanted };
    match measure(&effort) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn measure(effort: &Effort) -> Result<(), RigError> {
    speed::measure(effort)?;
    breakdown::measure(effort)
}

/// How much is measured.
struct Effort {
    /// Runs of each scene.
    runs: usize,
    /// Cycles of each run at most.
    cycles: usize,
    /// Parts of the labels that are wanted; all if there are none.
    wanted: Vec<String>,
}

impl Effort {
    fn is_wanted(&self, label: &str) -> bool {
        self.wanted.is_empty() || self.wanted.iter().any(|part| label.contains(part.as_str()))
    }
}
