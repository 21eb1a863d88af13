//! Error against speed on the scene of the study: the table that answers.

use std::path::PathBuf;
use std::sync::OnceLock;

use serde_json::Value;

use super::contestant::{Contestant, MUJOCO, OURS, distances};
use super::method::Method;
use super::scene::{CYCLE_S, STUDY};
use crate::sweep::{Clock, Sweep};

/// Steps in s.
pub(super) const STEPS_S: [f64; 7] = [1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5];
/// Step of the reference in s. It agrees with itself at other steps to some 1e-12 m, which the table shows.
pub(super) const REFERENCE_STEP_S: f64 = 1e-4;
/// How often each is timed at most. All are timed once before one is timed again, so that a slow spell of the machine meets all.
const ROUNDS: usize = 7;
/// After how many seconds in all that is enough.
const ENOUGH_S: f64 = 1.0;

/// All contestants at all steps, timed.
pub(super) struct Speed {
    program: Option<PathBuf>,
    entries: Vec<(Contestant, f64)>,
    measured: OnceLock<Vec<Measured>>,
}

/// Measurements of one entry.
#[derive(Debug)]
struct Measured {
    seconds: Vec<f64>,
    most_m: f64,
    mean_m: f64,
    loop_gap_m: f64,
    stopped: Option<String>,
}

impl Measured {
    fn is_enough(&self) -> bool {
        self.seconds.iter().sum::<f64>() > ENOUGH_S
    }
}

impl Speed {
    pub(super) fn new(program: Option<PathBuf>) -> Self {
        let peers = if program.is_some() { &MUJOCO[..] } else { &[] };
        let contestants = OURS.iter().chain(peers);
        let entries = contestants.flat_map(|&contestant| STEPS_S.map(|step_s| (contestant, step_s))).collect();
        Self { program, entries, measured: OnceLock::new() }
    }

    fn measure(&self, clock: Clock<'_>) -> Vec<Measured> {
        let program = self.program.as_deref();
        let reference = Contestant::Ours(Method::Events).run(None, &STUDY, REFERENCE_STEP_S).tips;
        let mut all: Vec<Measured> = Vec::new();
        for round in 0..ROUNDS {
            for (index, (contestant, step_s)) in self.entries.iter().enumerate() {
                if all.get(index).is_some_and(Measured::is_enough) {
                    continue;
                }
                let outcome = contestant.measured(program, &STUDY, *step_s, clock);
                if round == 0 {
                    let (most_m, mean_m) = distances(&outcome.tips, &reference);
                    let loop_gap_m = outcome.loop_gap_m;
                    let stopped = outcome.stopped;
                    all.push(Measured { seconds: Vec::new(), most_m, mean_m, loop_gap_m, stopped });
                }
                if let Some(measured) = all.get_mut(index) {
                    measured.seconds.push(outcome.seconds);
                }
            }
        }
        for measured in &mut all {
            measured.seconds.sort_by(f64::total_cmp);
        }
        all
    }
}

impl Sweep for Speed {
    fn name(&self) -> &'static str {
        "plant"
    }

    fn columns(&self) -> Vec<&str> {
        vec![
            "engine",
            "method",
            "step_s",
            "realtime_factor",
            "realtime_factor_least",
            "realtime_factor_most",
            "max_error_m",
            "rms_error_m",
            "loop_gap_m",
            "stopped",
        ]
    }

    fn points(&self) -> u64 {
        self.entries.len() as u64
    }

    fn is_timed(&self) -> bool {
        true
    }

    /// The first point times all: they are to be timed in turn.
    fn point(&self, index: u64, clock: Clock<'_>) -> Vec<Value> {
        let all = self.measured.get_or_init(|| self.measure(clock));
        let (contestant, step_s) = self.entries[index as usize];
        let measured = &all[index as usize];
        let factor = |place: usize| STUDY.cycles as f64 * CYCLE_S / measured.seconds[place];
        let last = measured.seconds.len() - 1;
        vec![
            contestant.engine().into(),
            contestant.method().into(),
            step_s.into(),
            factor(last / 2).into(),
            factor(last).into(),
            factor(0).into(),
            measured.most_m.into(),
            measured.mean_m.into(),
            measured.loop_gap_m.into(),
            measured.stopped.clone().into(),
        ]
    }
}
