//! The computer that runs the master: on request late, stopped or dead.

use std::collections::VecDeque;
use std::panic::resume_unwind;
use std::time::Duration;

use super::cable::Frames;
use yieldwall_config::injection::{Injection, Kind};
use yieldwall_fieldbus::canopen::BusId;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{Arrival, ErrorFrame, Received};
use yieldwall_run::Process;

/// Frames that wait for a process that is stopped, as in a socket's buffer; more are lost.
const WAITING_FRAMES: usize = 256;

/// The panic that an injection asks for.
pub(super) struct Injected;

/// The computer that runs the master.
#[derive(Debug, Default)]
pub(super) struct Computer {
    /// Whether the process does not run: frames wait.
    is_asleep: bool,
    /// Whether it never runs again.
    is_dead: bool,
    stop_is_requested: bool,
    /// Whether the next cycle panics.
    panics: bool,
    /// Frames that wait for the process.
    waiting: VecDeque<Received>,
    /// Frames that the process has not taken yet.
    inbox: VecDeque<Arrival>,
    /// Frames of a segment: those that wait for the process, and those that it has not taken.
    waiting_ethernet: Frames,
    ethernet: Frames,
    /// Grid point of the cycle that it runs.
    grid: Time,
    lateness: Lateness,
    active: Vec<Active>,
}

/// By how much it wakes up too late for SYNC and for the computation, and how long that takes.
#[derive(Clone, Copy, Debug, Default)]
struct Lateness {
    sync: Duration,
    compute: Duration,
    computing: Duration,
}

/// An injection that lasts.
#[derive(Clone, Copy, Debug)]
struct Active {
    injection: Injection,
    /// Cycles so far.
    count: u32,
}

impl Computer {
    /// Begins an injection, or ends it.
    pub(super) fn switch(&mut self, injection: Injection, is_on: bool) {
        match injection.kind {
            Kind::StopRequest => self.stop_is_requested = true,
            Kind::CyclePanic => self.panics = true,
            // Its end wakes nobody.
            Kind::MasterKilled => self.die(),
            _ if is_on => self.active.push(Active { injection, count: 0 }),
            _ => {
                if let Some(at) = self.active.iter().position(|active| active.injection == injection) {
                    self.active.remove(at);
                }
            }
        }
    }

    pub(super) fn clear(&mut self) {
        self.active.clear();
    }

    fn die(&mut self) {
        (self.is_asleep, self.is_dead) = (true, true);
    }

    pub(super) fn is_dead(&self) -> bool {
        self.is_dead
    }

    /// Begins a boot: frames that waited before are outdated.
    pub(super) fn begin_boot(&mut self) {
        self.is_asleep = false;
        self.waiting.clear();
        self.waiting_ethernet.clear();
    }

    /// Returns the behaviour of the process in the cycle that begins at a grid point.
    pub(super) fn begin_cycle(&mut self, now: Time, grid: Time) -> Process {
        let mut lateness = Lateness::default();
        let (mut is_stopped, mut is_suspended) = (false, false);
        for active in &mut self.active {
            active.count += 1;
            let time = Duration::from_secs_f64(active.injection.size.max(0.0));
            let is_second = active.count.is_multiple_of(2);
            match active.injection.kind {
                Kind::MasterStopped => is_stopped = true,
                Kind::Suspend => is_suspended = true,
                Kind::SyncLate if is_second => lateness.sync += time,
                Kind::ComputeLate if is_second => lateness.compute += time,
                Kind::CycleOverrun if is_second => lateness.computing += time,
                _ => {}
            }
        }
        if is_stopped || is_suspended || self.is_dead {
            self.is_asleep = true;
            return match () {
                () if self.is_dead => Process::Dead,
                () if is_suspended => Process::Suspended,
                () => Process::Stopped,
            };
        }
        self.wake(now);
        (self.grid, self.lateness) = (grid, lateness);
        Process::Runs
    }

    /// Returns how late the process wakes up for a moment of its cycle.
    pub(super) fn late(&self, moment: Time) -> Duration {
        if moment <= self.grid { self.lateness.sync } else { self.lateness.compute }
    }

    /// Ends the computation, after which the computer does nothing else for this time from now.
    pub(super) fn computed(&mut self) -> Duration {
        let Lateness { computing, .. } = std::mem::take(&mut self.lateness);
        if std::mem::take(&mut self.panics) {
            self.die();
            resume_unwind(Box::new(Injected));
        }
        computing
    }

    /// Suspends the process: it takes nothing until it wakes up.
    pub(super) fn fall_asleep(&mut self) {
        self.is_asleep = true;
    }

    /// Resumes the process, which first takes the frames that have waited.
    pub(super) fn wake(&mut self, now: Time) {
        if std::mem::take(&mut self.is_asleep) {
            let waiting = self.waiting.drain(..).map(|what| Arrival { time: now, bus: bus_of(&what), what });
            self.inbox.extend(waiting);
            let Self { waiting_ethernet, ethernet, .. } = self;
            while waiting_ethernet.take(now, |_, bytes| ethernet.push(now, bytes)).is_some() {}
        }
    }

    /// Whether a person has asked for the stop, once.
    pub(super) fn takes_stop(&mut self) -> bool {
        std::mem::take(&mut self.stop_is_requested)
    }

    /// Delivers a frame to the process.
    pub(super) fn take(&mut self, time: Time, what: Received) {
        if !self.is_asleep {
            self.inbox.push_back(Arrival { time, bus: bus_of(&what), what });
        } else if self.waiting.len() < WAITING_FRAMES {
            self.waiting.push_back(what);
        }
    }

    /// Delivers a frame of the segment to the process.
    pub(super) fn take_ethernet(&mut self, time: Time, bytes: &[u8]) {
        let inbox = if self.is_asleep { &mut self.waiting_ethernet } else { &mut self.ethernet };
        inbox.push(time, bytes);
    }

    /// Gives away the next frame of the segment that has come.
    pub(super) fn receive_ethernet<R>(&mut self, give: impl FnOnce(Time, &[u8]) -> Option<R>) -> Option<R> {
        self.ethernet.take(Time::NEVER, |time, bytes| give(time, bytes)).flatten()
    }

    /// Reports an error of an interface.
    pub(super) fn tell(&mut self, time: Time, bus: BusId, error: ErrorFrame) {
        self.inbox.push_back(Arrival { time, bus, what: Received::Error(error) });
    }

    /// Returns the next arrival.
    pub(super) fn receive(&mut self) -> Option<Arrival> {
        self.inbox.pop_front()
    }

    /// Whether nothing has come that it has not taken.
    pub(super) fn has_taken_all(&self) -> bool {
        self.inbox.is_empty() && self.ethernet.is_empty()
    }
}

fn bus_of(what: &Received) -> BusId {
    match what {
        Received::Frame(frame) | Received::Echo(frame) => frame.bus(),
        _ => BusId::FIRST,
    }
}
