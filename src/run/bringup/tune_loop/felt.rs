//! Readings of the force sensor while the tool is shaken.

use super::course::Shows;
use super::parts::{Sample, Trace};
use yieldwall_motion::cycle::Cycle;
use yieldwall_motion::identification::{BEHIND, Handle, MOST_SHIFTS, NotIdentified, Shaken, handle, lead_in};

/// Place of the tool in a cycle, and the force that the cycle had.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Felt {
    /// By the measured angles, m.
    tip_m: [f64; 2],
    /// Force of the last sample in N, in the base frame: before any filter of this program, with all that the handle adds.
    force_n: [f64; 2],
    /// Whether the sensor marks its sample as good.
    is_good: bool,
}

/// Returns the readings along a course; not a number if the linkage cannot be at the angles.
pub(super) fn felt(samples: &[Sample], cycle: &Cycle) -> Vec<Felt> {
    let (linkage, sensing) = (cycle.linkage(), cycle.sensing());
    let calibration = sensing.calibration();
    let mut last = ([0.0; 2], false);
    let each = |sample: &Sample| {
        let Ok(posture) = linkage.forward(sample.angles) else {
            return Felt { tip_m: [f64::NAN; 2], force_n: last.0, is_good: false };
        };
        if let Some(raw) = &sample.force {
            let link = sensing.mounting().link_rotation(posture.distal_rotation);
            let force = sensing.mounting().to_base(&calibration.wrench(raw), link);
            last = (force.to_array(), !(raw.invalid || calibration.is_saturated(raw)));
        }
        Felt { tip_m: posture.tip.to_array(), force_n: last.0, is_good: last.1 }
    };
    samples.iter().map(each).collect()
}

impl Trace<'_> {
    /// Mass of the handle and age of the force.
    pub(super) fn handle(&self) -> Result<Handle, NotIdentified> {
        let before = lead_in(self.period_s);
        let parts = self.course.parts.iter().filter(|part| part.shows == Shows::Excited);
        let passages: Vec<Shaken> = parts
            .filter_map(|part| {
                let (first, end) = (part.from + MOST_SHIFTS, part.from + part.count - 1);
                let range = first.checked_sub(before)?..end + BEHIND;
                let is_whole = !self.skipped.iter().any(|at| range.contains(at));
                let felt = self.felt.get(range).filter(|felt| is_whole && felt.iter().all(|felt| felt.is_good))?;
                let tips_m = felt.iter().map(|felt| felt.tip_m).collect();
                Some(Shaken { tips_m, forces_n: felt.iter().map(|felt| felt.force_n).collect() })
            })
            .collect();
        handle(&passages, &self.course.excitation, self.period_s)
    }
}
