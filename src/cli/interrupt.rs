//! Requests to end the program.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use super::failure::{Exit, Failure};

/// Set by Ctrl-C, by the wish of a service manager that the program ends, and by a terminal that goes away, unless the program
/// was started to outlive it (`nohup`).
pub(super) fn on_interrupt() -> Result<Arc<AtomicBool>, Failure> {
    let flag = Arc::new(AtomicBool::new(false));
    // If the system does not report it, a closed terminal stops the rig.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let hangup = Some(SIGHUP).filter(|signal| !is_ignored(*signal, &status));
    for signal in [SIGINT, SIGTERM].into_iter().chain(hangup) {
        signal_hook::flag::register(signal, Arc::clone(&flag))
            .map_err(|error| Failure::new(Exit::Internal, format!("signal {signal}: {error}"), ""))?;
    }
    Ok(flag)
}

/// Whether a simulated run continues.
pub(super) fn unless(is_interrupted: &AtomicBool) -> ControlFlow<()> {
    if is_interrupted.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

/// Returns the failure of an interrupted run.
pub(super) fn interrupted(time_s: f64) -> Failure {
    Failure::new(Exit::Interrupted, format!("interrupted after {time_s:.3} s; the rig was stopped"), "")
}

/// Whether a process with this `/proc/PID/status` ignores a signal.
fn is_ignored(signal: i32, status: &str) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or_default();
    mask >> (signal - 1) & 1 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signal_that_was_ignored_when_the_program_began_stays_ignored() {
        let status = |mask: &str| format!("Name:\tyieldwall\nSigBlk:\t0000000000000000\nSigIgn:\t{mask}\nSigCgt:\t0\n");
        for (mask, signal, expected) in [
            ("0000000000000001", SIGHUP, true),
            ("0000000000001000", SIGHUP, false),
            ("0000000000004002", SIGINT, true),
            ("0000000000004000", SIGTERM, true),
        ] {
            assert_eq!(is_ignored(signal, &status(mask)), expected, "{mask} {signal}");
        }
        assert!(!is_ignored(SIGHUP, ""), "a system that does not report");
    }
}
