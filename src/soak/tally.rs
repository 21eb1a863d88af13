//! Combined results of many runs.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::checker::Peaks;
use super::invariant::Violation;
use super::session::End;
use super::verdict::{Followed, ObservedFault};
use yieldwall_config::injection::CATALOGUE;
use yieldwall_motion::guard::fault::TABLE;

/// Result of one seed, as in a line of the results file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeedResult {
    /// The seed.
    pub seed: u64,
    /// The rig that it was drawn from.
    pub rig: String,
    /// Cycles that were asked for.
    pub asked: u32,
    /// How the run ended.
    pub end: End,
    /// Cycles that were run.
    pub cycles: u32,
    /// Virtual time in s.
    pub simulated_s: f64,
    /// Mark of all that was seen.
    pub hash: u64,
    /// Whether several faults overlapped.
    pub is_tangle: bool,
    /// Times that the network was booted anew.
    pub restarts: u32,
    /// The injections and what followed.
    pub injections: Vec<Followed>,
    /// Faults with an effect.
    pub faults: Vec<ObservedFault>,
    /// How often each fault began to show.
    pub shown: BTreeMap<String, u32>,
    /// The greatest values.
    pub peaks: Peaks,
    /// How often what did not hold was excused, by `invariant reason`: the names of [`super::Excuse`].
    pub excused: BTreeMap<String, u64>,
    /// Violations.
    pub violations: Vec<Violation>,
    /// Arguments of `yieldwall soak` that replay the violations.
    pub replay: Option<String>,
}

/// How often an injection was met and what followed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct InjectionTally {
    /// Number of times that the injection was drawn.
    pub drawn: u64,
    /// Times that it met a rig that ran.
    pub hits: u64,
    /// Number of times that it was judged alone, with the usual duration and size.
    pub judged: u64,
    /// Times that what had to follow did.
    pub as_expected: u64,
}

/// How often a fault had an effect, and how soon.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FaultTally {
    /// Times that it began to show.
    pub shown: u64,
    /// Reactions by their name.
    pub reactions: BTreeMap<String, u64>,
    /// Latencies of each reaction with a known begin: how often it took how many cycles, and the greatest bound.
    pub measured: BTreeMap<String, Latency>,
}

/// Reaction times of one step of a fault.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Latency {
    /// How often the reaction took each number of cycles.
    pub cycles: BTreeMap<u32, u64>,
    /// Greatest bound in cycles over the rigs; rigs with other sample rates and periods have others.
    pub bound: u32,
}

impl Latency {
    /// Returns the median in cycles; 0 without any.
    pub fn median(&self) -> u32 {
        let total: u64 = self.cycles.values().sum();
        let mut seen = 0;
        for (cycles, times) in &self.cycles {
            seen += times;
            if 2 * seen >= total {
                return *cycles;
            }
        }
        0
    }

    /// Returns the greatest in cycles; 0 without any.
    pub fn most(&self) -> u32 {
        self.cycles.keys().next_back().copied().unwrap_or(0)
    }
}

/// Combined results of all runs, independent of the order in which they are added.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Tally {
    /// Seeds.
    pub seeds: u64,
    /// Cycles of all runs.
    pub cycles: u64,
    /// Virtual time in whole ms, so that the sum knows no order.
    pub simulated_ms: u64,
    /// Runs in which faults overlapped.
    pub tangles: u64,
    /// Times that the network was booted anew.
    pub restarts: u64,
    /// Marks of all runs together.
    pub hash: u64,
    /// Runs by their end.
    pub ends: BTreeMap<String, u64>,
    /// Injections by name.
    pub injections: BTreeMap<String, InjectionTally>,
    /// Faults by name.
    pub faults: BTreeMap<String, FaultTally>,
    /// The greatest values.
    pub peaks: Peaks,
    /// How often what did not hold was excused, by `invariant reason`: the names of [`super::Excuse`].
    pub excused: BTreeMap<String, u64>,
    /// Number of violations by invariant.
    pub violations: BTreeMap<String, u64>,
}

impl Tally {
    /// Adds one run.
    pub fn add(&mut self, outcome: &SeedResult) {
        self.seeds += 1;
        self.cycles += u64::from(outcome.cycles);
        self.simulated_ms += (outcome.simulated_s * 1e3).round() as u64;
        self.tangles += u64::from(outcome.is_tangle);
        self.restarts += u64::from(outcome.restarts);
        self.hash = self.hash.wrapping_add(outcome.hash.rotate_left((outcome.seed % 64) as u32));
        *self.ends.entry(format!("{:?}", outcome.end)).or_default() += 1;
        for followed in &outcome.injections {
            let tally = self.injections.entry(followed.name.clone()).or_default();
            tally.drawn += 1;
            tally.hits += u64::from(followed.met_running);
            tally.judged += u64::from(followed.as_expected.is_some());
            tally.as_expected += u64::from(followed.as_expected == Some(true));
        }
        for (name, times) in &outcome.shown {
            self.faults.entry(name.clone()).or_default().shown += u64::from(*times);
        }
        for seen in &outcome.faults {
            let tally = self.faults.entry(seen.name.clone()).or_default();
            *tally.reactions.entry(seen.reaction.clone()).or_default() += 1;
            if let (Some(cycles), Some(bound)) = (seen.cycles, seen.bound) {
                let latency = tally.measured.entry(seen.reaction.clone()).or_default();
                *latency.cycles.entry(cycles).or_default() += 1;
                latency.bound = latency.bound.max(bound);
            }
        }
        self.peaks.join(&outcome.peaks);
        for (name, times) in &outcome.excused {
            *self.excused.entry(name.clone()).or_default() += times;
        }
        for violation in &outcome.violations {
            *self.violations.entry(violation.invariant.name().to_owned()).or_default() += 1;
        }
    }

    /// Kinds of injection that never met a rig that ran.
    pub fn missed_injections(&self) -> Vec<&'static str> {
        let hit = |name: &str| self.injections.get(name).is_some_and(|tally| tally.hits > 0);
        CATALOGUE.iter().map(|row| row.name).filter(|name| !hit(name)).collect()
    }

    /// Faults that never showed, among those that an injection is known to bring about.
    pub fn missed_faults(&self) -> Vec<&'static str> {
        let is_injected = |fault| CATALOGUE.iter().any(|row| row.brings(fault));
        let has_shown =
            |name: &str| self.faults.get(name).is_some_and(|tally| tally.shown > 0 || !tally.reactions.is_empty());
        let rows = TABLE.iter().filter(|row| is_injected(row.fault));
        rows.map(|row| row.name).filter(|name| !has_shown(name)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_and_greatest() {
        let mut latency = Latency::default();
        assert_eq!((latency.median(), latency.most()), (0, 0));
        latency.cycles = [(1, 2), (3, 1), (9, 1)].into();
        assert_eq!((latency.median(), latency.most()), (1, 9));
        latency.cycles = [(1, 1), (3, 1), (9, 1)].into();
        assert_eq!(latency.median(), 3);
    }
}
