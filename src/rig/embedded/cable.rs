//! The cable of a segment, both ways.

use std::collections::VecDeque;
use std::time::Duration;

use crate::frame_faults::FrameFaults;
use yieldwall_config::injection::{Injection, Kind, Target};
use yieldwall_fieldbus::ethercat::frame::{BYTE_NS, LONGEST, SHORTEST};
use yieldwall_fieldbus::time::Time;
use yieldwall_sim::can::BusCounters;

/// Preamble, check sequence and gap around a frame, in bytes.
const AROUND_FRAME: u64 = 8 + 4 + 12;
/// Frames that may wait; more are lost.
const FRAMES: usize = 256;
const BITS: u64 = 8;

/// Frames with the moments at which they are somewhere. Buffers of removed frames are used again, so that nothing is allocated.
#[derive(Debug, Default)]
pub(super) struct Frames {
    waiting: VecDeque<(Time, Vec<u8>)>,
    spare: Vec<Vec<u8>>,
}

impl Frames {
    pub(super) fn push(&mut self, time: Time, bytes: &[u8]) {
        if self.waiting.len() < FRAMES {
            let mut frame = self.spare.pop().unwrap_or_else(|| Vec::with_capacity(LONGEST));
            frame.clear();
            frame.extend_from_slice(bytes);
            self.waiting.push_back((time, frame));
        }
    }

    /// Returns the time at which the next frame is there.
    pub(super) fn next(&self) -> Time {
        self.waiting.iter().map(|(time, _)| *time).min().unwrap_or(Time::NEVER)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Passes on the next frame that is there by a moment; of frames at one moment, the first one.
    pub(super) fn take<R>(&mut self, by: Time, give: impl FnOnce(Time, &mut [u8]) -> R) -> Option<R> {
        let due = self.waiting.iter().enumerate().filter(|(_, (time, _))| *time <= by);
        let (at, _) = due.min_by_key(|(at, (time, _))| (*time, *at))?;
        let (time, mut frame) = self.waiting.remove(at)?;
        let given = give(time, &mut frame);
        self.spare.push(frame);
        Some(given)
    }

    pub(super) fn clear(&mut self) {
        self.spare.extend(self.waiting.drain(..).map(|(_, frame)| frame));
    }
}

/// The cable between the master and the first device of a segment. Frames leave one behind the other.
#[derive(Debug)]
pub(super) struct Cable {
    /// Frames that have not begun to leave.
    pub(super) outward: Frames,
    /// Frames on their way back, and injected frames.
    pub(super) inward: Frames,
    free_at: Time,
    pub(super) faults: FrameFaults,
    counters: BusCounters,
    /// Faults of the master's interface.
    broken: Vec<Injection>,
}

impl Cable {
    /// Creates an idle cable. Random values of its faults come from `seed`.
    pub(super) fn new(seed: u64) -> Self {
        Self {
            outward: Frames::default(),
            inward: Frames::default(),
            free_at: Time(0),
            faults: FrameFaults::new(seed),
            counters: BusCounters::default(),
            broken: Vec::new(),
        }
    }

    /// Lets the master send a frame, and returns whether its interface accepts it.
    pub(super) fn send(&mut self, now: Time, bytes: &[u8]) -> bool {
        if self.broken.iter().any(|active| matches!(active.kind, Kind::SendFailed | Kind::InterfaceDown)) {
            return false;
        }
        let begin = now.max(self.free_at);
        let on_wire = AROUND_FRAME + bytes.len().max(SHORTEST) as u64;
        self.free_at = begin + Duration::from_nanos(on_wire * BYTE_NS);
        self.counters.frames += 1;
        self.counters.bits += on_wire * BITS;
        self.outward.push(begin, bytes);
        true
    }

    /// Whether frames reach the master.
    pub(super) fn hears(&self) -> bool {
        !self.broken.iter().any(|active| active.kind == Kind::InterfaceDown)
    }

    /// Returns the time of the next event on the cable.
    pub(super) fn next_event(&self) -> Time {
        self.outward.next().min(self.inward.next()).min(self.faults.next_back())
    }

    /// Returns the counters of the cable; bits stand for the time that a frame takes.
    pub(super) fn counters(&self) -> &BusCounters {
        &self.counters
    }

    /// Begins an injection on the way or in the master's interface, or ends it.
    pub(super) fn switch(&mut self, injection: Injection, is_on: bool) {
        match injection.target {
            Target::Bus => self.faults.switch(injection, is_on),
            _ if is_on => self.broken.push(injection),
            _ => self.broken.retain(|active| *active != injection),
        }
    }

    pub(super) fn clear(&mut self) {
        self.faults.clear();
        self.broken.clear();
    }
}
