//! Whether a bus carries a rig: the longest time of every frame, and whether it is short enough.
//!
//! The module computes worst-case response times after \[DBBL07\] (see [`response_ns`]). It adds three facts about this master:
//! measured values follow SYNC, set-points follow the control step, and the frames of a Linux host leave through one FIFO.
//! `docs/bus-budget.md` has the method and its assumptions.

mod advice;
mod bits;
mod frames;
mod phases;
mod response;

pub(crate) use advice::PERIODS_US;
pub use advice::{Advice, advise};
pub use bits::{longest_bits, shortest_bits, worst_bits};
pub use frames::{PlannedFrame, Use};
pub use response::{Stream, blocking_ns, response_among_ns, response_ns};

use std::time::Duration;

use crate::error::BootError;
use crate::setup::MasterSetup;
use phases::{Timing, responses_ns};
use yieldwall_fieldbus::canopen::BusId;

/// Conditions of the response times, besides the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conditions {
    /// The bus; each is looked at by itself.
    pub bus: BusId,
    /// Bit rate in bit/s, above 0.
    pub bit_rate: u32,
    /// When the control step runs, after SYNC; below the period.
    pub compute_at: Duration,
    /// Longest time from the end of SYNC to a measured value in its device's queue. With 0 the device is ready for the
    /// arbitration that follows SYNC.
    pub device_delay: Duration,
    /// Whether measured values follow SYNC and set-points follow the control step; else everything may be released at
    /// one moment and has to be through within its period.
    pub has_release_jitter: bool,
    /// Whether the master's frames go out in the order in which they were queued; else by priority.
    pub has_fifo: bool,
}

impl Conditions {
    /// Whether nothing is known of plan and host: the analysis of \[DBBL07\] as it stands, its bits for any identifier
    /// included.
    pub fn is_plain(&self) -> bool {
        !self.has_release_jitter && !self.has_fifo
    }
}

/// The moment from which the time of a frame counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// When the master queues SYNC.
    Sync,
    /// When the control step runs.
    Compute,
    /// When the frame is queued by whoever sends it.
    Release,
}

/// The longest time of one frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameBudget {
    /// The frame.
    pub frame: PlannedFrame,
    /// Longest time to the end of the frame, in ns; `None` if there is no bound.
    pub response_ns: Option<u64>,
    /// Longest time that is short enough, in ns.
    pub deadline_ns: u64,
    /// From when both count.
    pub from: Moment,
}

impl FrameBudget {
    /// Whether the frame always arrives in time.
    pub fn is_in_time(&self) -> bool {
        self.response_ns.is_some_and(|response| response <= self.deadline_ns)
    }

    /// How much later than its deadline the frame can arrive, in ns; 0 if it is in time, `None` if there is no bound.
    pub fn late_ns(&self) -> Option<u64> {
        self.response_ns.map(|response| response.saturating_sub(self.deadline_ns))
    }

    /// Whether the frame is no part of undisturbed operation: SDO and emergency messages. Its own time counts with its
    /// kind under way, that of the regular frames without.
    pub fn is_occasional(&self) -> bool {
        self.frame.usage > Use::Heartbeat
    }
}

/// The frames of a bus and their longest times.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Conditions assumed.
    pub conditions: Conditions,
    /// Cycle time.
    pub cycle: Duration,
    /// All frames by identifier.
    pub frames: Vec<FrameBudget>,
    /// The regular frame that is latest while an SDO exchange is under way.
    pub latest_with_sdo: Option<FrameBudget>,
    /// The regular frame that is latest in the cycle of emergency messages of all nodes.
    pub latest_with_emergencies: Option<FrameBudget>,
}

impl Budget {
    /// The budget of one bus of a network in operation.
    ///
    /// # Errors
    /// If node identifiers are out of range, or if a profile lacks the process data of the command mode.
    pub fn new(setup: &MasterSetup, conditions: Conditions) -> Result<Self, BootError> {
        let plan = frames::frames(setup, conditions.bus)?;
        let timing = Timing {
            bit: 1_000_000_000_u64.div_ceil(u64::from(conditions.bit_rate).max(1)),
            cycle: nanoseconds(setup.period),
            compute: nanoseconds(conditions.compute_at),
            device_delay: nanoseconds(conditions.device_delay),
            has_release_jitter: conditions.has_release_jitter,
            has_fifo: conditions.has_fifo,
            is_plain: conditions.is_plain(),
        };
        let [regular, sdo, emergency] =
            [Use::Heartbeat, Use::Sdo, Use::Emergency].map(|with| traffic(&plan, with, timing));
        let of = |frames: &[FrameBudget], usage: Use| -> Vec<FrameBudget> {
            frames.iter().filter(|frame| frame.frame.usage == usage).cloned().collect()
        };
        let mut all = [regular, of(&sdo, Use::Sdo), of(&emergency, Use::Emergency)].concat();
        all.sort_by_key(|frame| frame.frame.cob_id);
        let (latest_with_sdo, latest_with_emergencies) = (latest(&sdo).cloned(), latest(&emergency).cloned());
        Ok(Self { conditions, cycle: setup.period, frames: all, latest_with_sdo, latest_with_emergencies })
    }

    /// Whether every regular frame always arrives in time.
    pub fn is_schedulable(&self) -> bool {
        self.regular().all(FrameBudget::is_in_time)
    }

    /// The regular frame that is latest, or nearest to be.
    pub fn latest(&self) -> Option<&FrameBudget> {
        latest(&self.frames)
    }

    /// The frames of undisturbed operation.
    pub fn regular(&self) -> impl Iterator<Item = &FrameBudget> {
        self.frames.iter().filter(|frame| !frame.is_occasional())
    }

    /// Greatest share of the time that the regular frames take, by [`worst_bits`]: 1 is all of it.
    pub fn load(&self) -> f64 {
        self.load_of(self.regular())
    }

    /// Greatest share of the time that SYNC and the process data take.
    pub fn cyclic_load(&self) -> f64 {
        self.load_of(self.regular().filter(|frame| frame.frame.usage < Use::Heartbeat))
    }

    fn load_of<'a>(&self, frames: impl Iterator<Item = &'a FrameBudget>) -> f64 {
        let each = frames.map(|FrameBudget { frame, .. }| f64::from(frame.bits_worst()) / frame.period.as_secs_f64());
        each.sum::<f64>() / f64::from(self.conditions.bit_rate)
    }
}

/// The regular frames and those of one occasional use, each with its longest time.
fn traffic(plan: &[PlannedFrame], with: Use, timing: Timing) -> Vec<FrameBudget> {
    let present = |frame: &&PlannedFrame| frame.usage <= Use::Heartbeat || frame.usage == with;
    let frames: Vec<PlannedFrame> = plan.iter().filter(present).cloned().collect();
    let responses = responses_ns(&frames, timing);
    let each = frames.into_iter().zip(responses).map(|(frame, response_ns)| {
        let period = nanoseconds(frame.period);
        let (from, deadline_ns) = match frame.usage {
            Use::Sync | Use::Request | Use::Measured if timing.has_release_jitter => (Moment::Sync, timing.compute),
            Use::SetPoint if timing.has_release_jitter => {
                (Moment::Compute, timing.cycle.saturating_sub(timing.compute))
            }
            Use::Heartbeat | Use::Sdo if frame.is_of_master && timing.has_release_jitter => (Moment::Compute, period),
            Use::Emergency => (Moment::Release, timing.cycle),
            _ => (Moment::Release, period),
        };
        FrameBudget { frame, response_ns, deadline_ns, from }
    });
    each.collect()
}

/// The regular frame with the least slack; one without a bound is the latest of all.
fn latest(frames: &[FrameBudget]) -> Option<&FrameBudget> {
    let slack = |frame: &FrameBudget| {
        let response = frame.response_ns.map_or(i128::MAX, i128::from);
        i128::from(frame.deadline_ns) - response
    };
    frames.iter().filter(|frame| !frame.is_occasional()).min_by_key(|frame| slack(frame))
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests;
