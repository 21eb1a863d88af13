//! The computer that runs the master, and its way to the bus: here virtual, and at times late, stopped or dead.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::time::Duration;

use super::buses::{Buses, MasterOutbox};
use super::trouble::{Host, Troubles};
use super::{EmbeddedRig, RigError};
use crate::bus::LinkEvent;
use crate::canopen::{Frame, Outbox, Time};
use crate::cycle::{Outputs, Timing};
use crate::guard::Request;

/// Frames that wait for a process that is stopped, as in a socket's buffer; more are lost.
const WAITING_FRAMES: usize = 256;

/// The computer between cycles.
#[derive(Debug, Default)]
pub(super) struct Computer {
    /// Whether the process does not run: frames wait.
    pub(super) is_asleep: bool,
    /// Whether it never runs again.
    pub(super) is_dead: bool,
    pub(super) stop_is_requested: bool,
    /// Whether the next cycle panics.
    pub(super) panics: bool,
    /// Frames with whether they are own ones.
    waiting: VecDeque<(Frame, bool)>,
    /// What the next cycle is told of its timing.
    timing: Timing,
}

impl Computer {
    pub(super) fn keep(&mut self, frame: Frame, is_own: bool) {
        if self.waiting.len() < WAITING_FRAMES {
            self.waiting.push_back((frame, is_own));
        }
    }
}

/// The panic that an injection asks for.
struct Injected;

/// The master's way to its ports.
pub(super) struct Exit<'a> {
    port: MasterOutbox<'a>,
    troubles: &'a Troubles,
    panics: bool,
    /// The buses on which a frame could not be handed over, a bit each.
    failed: u8,
}

impl<'a> Exit<'a> {
    pub(super) fn new(buses: &'a mut Buses, troubles: &'a Troubles, now: Time) -> Self {
        Self { port: buses.outbox(now), troubles, panics: false, failed: 0 }
    }
}

impl Outbox for Exit<'_> {
    fn push(&mut self, frame: Frame) {
        if self.panics {
            resume_unwind(Box::new(Injected));
        }
        if self.troubles.sends(frame.bus()) {
            self.port.push(frame);
        } else {
            self.failed |= 1_u8.checked_shl(frame.bus().into()).unwrap_or_default();
        }
    }
}

impl EmbeddedRig {
    /// Sends SYNC at `sync_at`, or throws away what still waits if the master has fallen silent.
    pub(super) fn send_sync(&mut self, sync_at: Time) {
        if self.master.is_silent() {
            self.buses.clear();
        }
        self.troubles.link_events().for_each(|(bus, event)| self.master.on_link(bus, event));
        let mut exit = Exit::new(&mut self.buses, &self.troubles, sync_at);
        self.master.on_sync(&mut exit);
        let failed = exit.failed;
        self.note_failed(failed);
    }

    fn note_failed(&mut self, buses: u8) {
        (0..8).filter(|bus| buses >> bus & 1 == 1).for_each(|bus| self.master.on_link(bus, LinkEvent::SendFailed));
    }

    /// Runs the cycle at `compute_at`; nothing if it panicked, after a last quick stop.
    pub(super) fn compute(
        &mut self,
        compute_at: Time,
        host: &Host,
        request: Request,
    ) -> Result<Option<Outputs>, RigError> {
        let asked = if std::mem::take(&mut self.host.stop_is_requested) { Request::Stop } else { request };
        let timing = Timing {
            sync_late_ns: nanos(host.sync_late),
            compute_late_ns: nanos(host.sync_late + host.compute_late),
            ..std::mem::take(&mut self.host.timing)
        };
        self.host.timing.last_compute_ns = nanos(host.compute_takes);
        if !host.compute_takes.is_zero() {
            let mut frames = Vec::new();
            let outputs = self.master.on_compute(compute_at, asked, timing, &mut frames);
            self.host.is_asleep = true;
            self.pump(compute_at + host.compute_takes)?;
            self.wake();
            let now = self.now;
            let mut exit = Exit::new(&mut self.buses, &self.troubles, now);
            frames.into_iter().for_each(|frame| exit.push(frame));
            let failed = exit.failed;
            self.note_failed(failed);
            return Ok(Some(outputs));
        }
        let mut exit = Exit::new(&mut self.buses, &self.troubles, compute_at);
        exit.panics = std::mem::take(&mut self.host.panics);
        let master = &mut self.master;
        let result = catch_unwind(AssertUnwindSafe(|| master.on_compute(compute_at, asked, timing, &mut exit)));
        let failed = exit.failed;
        self.note_failed(failed);
        match result {
            Ok(outputs) => Ok(Some(outputs)),
            Err(panic) => {
                self.master.quick_stop_now(compute_at, &mut Exit::new(&mut self.buses, &self.troubles, compute_at));
                (self.host.is_asleep, self.host.is_dead) = (true, true);
                if panic.is::<Injected>() { Ok(None) } else { resume_unwind(panic) }
            }
        }
    }

    /// One period in which the process does not run.
    pub(super) fn sleep(&mut self, grid: Time, host: &Host) -> Result<(), RigError> {
        self.host.is_asleep = true;
        if host.is_suspended {
            // The monotonic clock has stood still.
            self.host.timing.suspended = true;
        } else {
            self.host.timing.skipped = self.host.timing.skipped.saturating_add(1);
        }
        self.pump(grid + self.compute_at)
    }

    /// The process runs again, and first takes what has waited.
    pub(super) fn wake(&mut self) {
        if !std::mem::take(&mut self.host.is_asleep) {
            return;
        }
        let now = self.now;
        while let Some((frame, is_own)) = self.host.waiting.pop_front() {
            if is_own {
                self.master.on_echo(&frame);
            } else {
                self.master.on_frame(now, &frame, &mut Exit::new(&mut self.buses, &self.troubles, now));
            }
        }
    }

    /// The grid point of the next cycle: the first one that has not passed when this one ends.
    pub(super) fn next_grid(&mut self, grid: Time, end: Time) -> Time {
        let mut next = grid + self.period;
        while next < end {
            next = next + self.period;
            self.host.timing.skipped = self.host.timing.skipped.saturating_add(1);
        }
        next
    }
}

fn nanos(time: Duration) -> u32 {
    time.as_nanos().min(u128::from(u32::MAX)) as u32
}
