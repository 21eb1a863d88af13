//! How long the stages of the cycle take.

use std::time::Duration;

use super::histogram::Histogram;
use yieldwall_motion::cycle::Timing;
use yieldwall_record::Stages;

/// The stages in their order: a name, and what its time is.
const STAGES: [(&str, &str); 6] = [
    ("woken_for_sync", "woken for SYNC, late by"),
    ("sync_sent", "frames taken, SYNC sent in"),
    ("woken_to_compute", "woken to compute, late by"),
    ("frames_taken", "frames taken in"),
    ("stepped", "decoded and stepped in"),
    ("set_points_sent", "set-points sent in"),
];

/// The times of each stage over many cycles.
///
/// Real-time: yes; it is of fixed size.
#[derive(Clone, Debug, Default)]
pub struct StageTimes([Histogram; STAGES.len()]);

impl StageTimes {
    /// Counts the stages of one cycle.
    ///
    /// Real-time: yes.
    pub fn add(&mut self, stages: &Stages, timing: &Timing) {
        let times = [
            stages.sync_woke_ns,
            timing.sync_late_ns.saturating_sub(stages.sync_woke_ns),
            stages.woke_ns,
            timing.compute_late_ns.saturating_sub(stages.woke_ns),
            stages.stepped_ns.saturating_sub(timing.compute_late_ns),
            stages.sent_ns.saturating_sub(stages.stepped_ns),
        ];
        for (histogram, ns) in self.0.iter_mut().zip(times) {
            histogram.add(Duration::from_nanos(ns.into()));
        }
    }

    /// Returns each stage: its name, the meaning of its time for a person, and its times.
    pub fn each(&self) -> impl Iterator<Item = (&'static str, &'static str, &Histogram)> {
        STAGES.iter().zip(&self.0).map(|((name, text), times)| (*name, *text, times))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_lasts_from_the_end_of_the_one_before() {
        let stages = Stages { sync_woke_ns: 1000, woke_ns: 4000, stepped_ns: 15_000, sent_ns: 31_000 };
        let timing = Timing { sync_late_ns: 3000, compute_late_ns: 9000, ..Timing::default() };
        let mut times = StageTimes::default();
        times.add(&stages, &timing);
        let lasted: Vec<_> = times.each().map(|(name, _, times)| (name, times.max().as_micros())).collect();
        assert_eq!(
            lasted,
            [
                ("woken_for_sync", 1),
                ("sync_sent", 2),
                ("woken_to_compute", 4),
                ("frames_taken", 5),
                ("stepped", 6),
                ("set_points_sent", 16),
            ]
        );
    }
}
