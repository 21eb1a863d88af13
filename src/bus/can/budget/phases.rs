//! Response times within the cycle of the rig: SYNC and measured values first, set-points from the control step on.
//!
//! Measured values and set-points do not compete as long as each half of the cycle ends in time. This module proves it in two
//! steps. If no set-point is under way at a SYNC, the measured values arrive before the control step. If no measured value is
//! under way at the control step, the set-points arrive before the next SYNC. If one of the two steps fails, the figures hold for
//! cycles that began in order.

use super::frames::{PlannedFrame, Use};
use super::response::{Stream, blocking_ns, response_among_ns, response_ns};

/// Rounds after which jitter that still grows is taken to have no bound.
const ROUNDS: usize = 200;
/// Jitter of a frame that has no bound, ns.
const UNBOUNDED_NS: u64 = 1 << 60;

/// Times in ns that the response times depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Timing {
    pub(super) bit: u64,
    pub(super) cycle: u64,
    /// When the control step runs, after SYNC.
    pub(super) compute: u64,
    /// Longest time from the end of SYNC to a measured value in its device's queue.
    pub(super) device_delay: u64,
    pub(super) has_release_jitter: bool,
    pub(super) has_fifo: bool,
    /// Whether a frame has the bits that it has with any identifier.
    pub(super) is_plain: bool,
}

/// The longest time of each frame from its moment (SYNC, control step, or its own release) to its end, ns; `None` where
/// there is no bound. The master's frames are in the order in which it queues them.
pub(super) fn responses_ns(frames: &[PlannedFrame], timing: Timing) -> Vec<Option<u64>> {
    let streams: Vec<Stream> = frames.iter().map(|frame| frame.stream(timing.bit, timing.is_plain)).collect();
    let mut found: Vec<Option<u64>> = streams.iter().map(|stream| Some(stream.transmission_ns)).collect();
    for _ in 0..ROUNDS {
        let round = Round { frames, streams: &streams, timing, found: &found };
        let next: Vec<Option<u64>> = (0..frames.len()).map(|at| round.response_ns(at)).collect();
        if next == found {
            return found;
        }
        found = next;
    }
    // What has settled does not depend on what grows on.
    let round = Round { frames, streams: &streams, timing, found: &found };
    (0..frames.len()).map(|at| round.response_ns(at).filter(|now| Some(*now) == found[at])).collect()
}

/// One round of a fixed point: how late a frame can go out depends on the response times of others.
struct Round<'a> {
    frames: &'a [PlannedFrame],
    streams: &'a [Stream],
    timing: Timing,
    found: &'a [Option<u64>],
}

impl Round<'_> {
    fn response_ns(&self, at: usize) -> Option<u64> {
        let (frame, stream) = (self.frames.get(at)?, self.streams.get(at)?);
        if !self.timing.has_release_jitter {
            return self.together_ns(at, frame, stream);
        }
        match frame.usage {
            Use::Sync => self.sync_ns(stream),
            Use::Request => self.request_ns(at, stream),
            Use::Measured => self.measured_ns(at, stream),
            Use::SetPoint => self.set_point_ns(at, stream),
            Use::Heartbeat | Use::Sdo if self.is_queued(frame) => self.set_point_ns(at, stream),
            _ => response_among_ns(stream, &self.released(at)?, self.timing.bit),
        }
    }

    /// Whether the frame waits in the master's FIFO.
    fn is_queued(&self, frame: &PlannedFrame) -> bool {
        frame.is_of_master && self.timing.has_fifo
    }

    /// Returns the worst response time of SYNC in ns. The frame on the wire and the last cycle's frames in the master's FIFO can
    /// delay SYNC. A sensor on plain CAN can delay it as well, if its identifiers have a higher priority. The FIFO's frames follow each
    /// other without a gap.
    fn sync_ns(&self, stream: &Stream) -> Option<u64> {
        let background = self.seen(|at| self.is_background(at));
        let mut wait = blocking_ns(&background, stream.cob_id);
        for (frame, found) in self.frames.iter().zip(self.found) {
            if self.is_queued(frame) && frame.usage > Use::SetPoint {
                wait = wait.max((self.timing.compute + (*found)?).saturating_sub(self.timing.cycle));
            }
        }
        let before: Vec<Stream> = background.into_iter().filter(|other| other.cob_id < stream.cob_id).collect();
        response_ns(stream, wait, &before, self.timing.bit)
    }

    /// A request waits behind SYNC: when that ends it is there for the next arbitration.
    fn request_ns(&self, at: usize, stream: &Stream) -> Option<u64> {
        let jitter_ns = self.sync_response_ns()?;
        let others = [self.of(Use::Measured, at), self.seen(|other| self.is_background(other))].concat();
        let before: Vec<Stream> = others.into_iter().filter(|other| other.cob_id < stream.cob_id).collect();
        response_ns(&Stream { jitter_ns, ..*stream }, 0, &before, self.timing.bit)
    }

    /// Longest time to the end of SYNC; on a bus without SYNC everything follows the begin of the cycle itself.
    fn sync_response_ns(&self) -> Option<u64> {
        match self.frames.iter().position(|frame| frame.usage == Use::Sync) {
            Some(sync) => self.found.get(sync).copied()?,
            None => Some(0),
        }
    }

    /// A measured value is released up to R(SYNC) and the device's delay late, and competes with the others of its cycle.
    ///
    /// The answer to a request waits for the request. If the device answers without delay, the bus has no pause from SYNC to the
    /// answer, and the request counts as one of the frames of higher priority. If the device has a delay, other frames may come
    /// between once more.
    fn measured_ns(&self, at: usize, stream: &Stream) -> Option<u64> {
        let request = self.frames.iter().position(|frame| frame.usage == Use::Request);
        let is_answer = self.frames.get(at).is_some_and(|frame| frame.is_answer);
        let from = match request.filter(|_| is_answer && self.timing.device_delay > 0) {
            Some(request) => self.found.get(request).copied()??,
            None => self.sync_response_ns()?,
        };
        let jitter_ns = from + self.timing.device_delay;
        let background = self.seen(|other| self.is_background(other));
        let others = [self.of(Use::Request, at), self.of(Use::Measured, at), background].concat();
        let before: Vec<Stream> = others.iter().copied().filter(|other| other.cob_id < stream.cob_id).collect();
        // Without delay it is there when SYNC ends, so that nothing comes between.
        let blocking = if self.timing.device_delay == 0 { 0 } else { blocking_ns(&others, stream.cob_id) };
        response_ns(&Stream { jitter_ns, ..*stream }, blocking, &before, self.timing.bit)
    }

    /// Set-points and what the master queues behind them; by priority, or through the FIFO in their order.
    fn set_point_ns(&self, at: usize, stream: &Stream) -> Option<u64> {
        let background = self.seen(|other| self.is_background(other));
        if !self.timing.has_fifo {
            let others = [self.of(Use::SetPoint, at), background].concat();
            return response_among_ns(stream, &others, self.timing.bit);
        }
        let queued = |other: usize| {
            let is_ahead = |frame: &PlannedFrame| self.is_queued(frame) && frame.usage > Use::Measured;
            other < at && self.frames.get(other).is_some_and(is_ahead)
        };
        let ahead: Vec<Stream> = self.select(queued).map(|(_, stream)| *stream).collect();
        self.behind_ns(stream, ahead, &background)
    }

    /// A frame behind others in a FIFO gets its turn when the one with the lowest priority of them has got it.
    fn behind_ns(&self, stream: &Stream, ahead: Vec<Stream>, others: &[Stream]) -> Option<u64> {
        let lowest = ahead.iter().map(|ahead| ahead.cob_id).fold(stream.cob_id, u16::max);
        let mut before = ahead;
        before.extend(others.iter().filter(|other| other.cob_id < lowest));
        response_ns(stream, blocking_ns(others, lowest), &before, self.timing.bit)
    }

    /// Without a plan of the cycle everything may be released at one moment.
    fn together_ns(&self, at: usize, frame: &PlannedFrame, stream: &Stream) -> Option<u64> {
        if !self.is_queued(frame) {
            return response_among_ns(stream, &self.seen(|other| other != at), self.timing.bit);
        }
        let is_ahead = |other: usize| self.frames.get(other).is_some_and(|frame| self.is_queued(frame));
        let ahead = self.select(|other| other != at && is_ahead(other)).map(|(_, stream)| *stream).collect();
        self.behind_ns(stream, ahead, &self.seen(|other| !is_ahead(other)))
    }

    /// Whether a frame can come at any moment, as seen from the process data.
    fn is_background(&self, at: usize) -> bool {
        self.frames.get(at).is_some_and(|frame| frame.usage > Use::SetPoint && !self.is_queued(frame))
    }

    /// The other frames of one half of the cycle: they come once in it.
    fn of(&self, usage: Use, at: usize) -> Vec<Stream> {
        let is_other = |other: usize| other != at && self.frames.get(other).is_some_and(|frame| frame.usage == usage);
        self.select(is_other).map(|(_, stream)| *stream).collect()
    }

    /// Frames as others see them: as late as they can have waited.
    fn seen(&self, is_wanted: impl Fn(usize) -> bool) -> Vec<Stream> {
        let late = |(at, stream): (usize, &Stream)| {
            let waits =
                self.timing.has_release_jitter || self.frames.get(at).is_some_and(|frame| self.is_queued(frame));
            let response = self.found.get(at).copied().flatten();
            let jitter_ns = match response {
                _ if !waits => 0,
                Some(response) => response.saturating_sub(stream.transmission_ns),
                None => UNBOUNDED_NS,
            };
            Stream { jitter_ns, ..*stream }
        };
        self.select(is_wanted).map(late).collect()
    }

    /// The other frames as a frame sees them that can come at any moment: by how much each can be released late. Whatever
    /// has waited longer belongs to the same busy period.
    fn released(&self, at: usize) -> Option<Vec<Stream>> {
        let sync = self.frames.iter().position(|frame| frame.usage == Use::Sync);
        let sync_ns = sync.and_then(|sync| self.streams.get(sync)).map_or(0, |sync| sync.transmission_ns);
        let sync_late = self.sync_response_ns()?.saturating_sub(sync_ns) + self.timing.device_delay;
        let mut others = Vec::new();
        for (other, stream) in self.select(|other| other != at) {
            let frame = self.frames.get(other)?;
            let waited = self.found.get(other).copied()?.map(|found| found.saturating_sub(stream.transmission_ns));
            let jitter_ns = match frame.usage {
                _ if self.is_queued(frame) => waited.unwrap_or(UNBOUNDED_NS),
                // From the end of a request that waits for nothing.
                Use::Measured if frame.is_answer => waited.unwrap_or(UNBOUNDED_NS),
                Use::Measured => sync_late,
                _ => 0,
            };
            others.push(Stream { jitter_ns, ..*stream });
        }
        Some(others)
    }

    fn select(&self, is_wanted: impl Fn(usize) -> bool) -> impl Iterator<Item = (usize, &Stream)> {
        self.streams.iter().enumerate().filter(move |(at, _)| is_wanted(*at))
    }
}
