//! The loop.

mod alone;
mod arrivals;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use super::drill::{DriveAddress, drive_addresses};
use super::error::LiveError;
use super::metronome::Metronome;
use crate::bus::{LinkEvent, Master, Phase, Waiting};
use crate::canopen::Time;
use crate::config;
use crate::cycle::{Outputs, Timing};
use crate::guard::{Cause, DeviceSet, Request, State};
use crate::link::{CanLink, LinkOutbox};
use crate::record::{CycleRecord, Moment, Stages};
use crate::rig::{Enabling, Observer, Pace, Tap, bus_plan, master};
use yieldwall_drives::objects;

/// Longest time between two calls of a [`BootWatch`].
const LOOK_UP: Duration = Duration::from_millis(100);
/// How long the end of the run is listened to, on the wall: own last frames come back, and the devices answer.
const FAREWELL: Duration = Duration::from_millis(50);
/// How long lockstep waits for the process data of a cycle, on the wall ...
const PATIENCE: Duration = Duration::from_secs(1);
/// ... and for those of a device that already let it wait in vain.
const IMPATIENCE: Duration = Duration::from_millis(2);
/// Time by which the clock that counts suspended time has to have gained on the other since the last cycle. Less may be the
/// time that passed between reading the one and the other.
const SUSPENDED: Duration = Duration::from_millis(50);

/// Is told what the boot waits for, ten times a second, and nothing when the boot is over. The boot ends when it says that a
/// person asked for the end.
pub type BootWatch = Box<dyn FnMut(Option<Waiting<'_>>) -> bool + Send>;

/// What a link has told besides frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounts {
    /// Frames of others.
    pub received: u64,
    /// Own frames that were seen on the bus.
    pub echoed: u64,
    /// Frames that were lost because nobody took them in time.
    pub overflowed: u64,
    /// Frames that could not be sent.
    pub refused: u64,
}

/// A rig on a link.
///
/// [`LiveRig::boot`] brings the network up, and every [`LiveRig::run_cycle`] is one period. Under [`Pace::Free`] the
/// periods are those of the wall; under [`Pace::Lockstep`] a cycle waits for its process data, however long they take, and
/// time advances by one period: for simulated devices on a computer of any speed.
pub struct LiveRig<L, M> {
    master: Master,
    pub(super) link: L,
    metronome: M,
    pace: Pace,
    pub(super) period: Duration,
    pub(super) compute_at: Duration,
    pub(super) started: Time,
    /// Whether time waits for the process data.
    waits: bool,
    /// Time since switching on, where it waits.
    lockstep_now: Time,
    /// Grid point of the next cycle, since switching on.
    pub(super) next_sync: Time,
    cycles: u64,
    scene_from: Option<Time>,
    timing: Timing,
    /// Of the present cycle.
    stages: Stages,
    suspended: Duration,
    /// Devices that let lockstep wait in vain.
    absent: DeviceSet,
    /// When the link was looked at last, on its clock, where time waits.
    looked_at: Time,
    /// What has come before is from a time in which the process was stopped.
    back_since: Time,
    counts: LinkCounts,
    tap: Option<Tap>,
    observer: Option<Observer>,
    boot_watch: Option<BootWatch>,
    pub(super) enabling: Enabling,
    drives: [DriveAddress; 2],
    last: Option<Outputs>,
    has_panicked: bool,
    /// How long another master is listened for before anything is sent.
    listening: Duration,
    /// Whether that was done, and nobody was heard since.
    has_listened: bool,
}

impl<L: CanLink, M: Metronome> LiveRig<L, M> {
    /// A rig that has sent nothing yet.
    ///
    /// # Errors
    /// Where parts of the configuration do not fit together.
    pub fn new(rig: &config::Rig, link: L, metronome: M, pace: Pace) -> Result<Self, LiveError> {
        let (started, suspended) = (link.now(), metronome.suspended());
        Ok(Self {
            master: master(rig, &rig.fixture)?,
            link,
            metronome,
            pace,
            period: Duration::from_micros(rig.cycle.period_us.into()),
            compute_at: Duration::from_micros(rig.cycle.compute_at_us.into()),
            started,
            waits: false,
            lockstep_now: Time(0),
            next_sync: Time::NEVER,
            cycles: 0,
            scene_from: None,
            timing: Timing::default(),
            stages: Stages::default(),
            suspended,
            absent: DeviceSet::NONE,
            looked_at: started,
            back_since: Time(0),
            counts: LinkCounts::default(),
            tap: None,
            observer: None,
            boot_watch: None,
            enabling: Enabling::new(rig),
            drives: drive_addresses(rig)?,
            last: None,
            has_panicked: false,
            listening: bus_plan(rig)?.0.listening(),
            has_listened: false,
        })
    }

    /// Has `tap` get every frame from now on, own ones when they were seen on the bus.
    pub fn set_tap(&mut self, tap: Tap) {
        self.tap = Some(tap);
    }

    /// Has `observer` get the record of every cycle from now on.
    pub fn set_observer(&mut self, observer: Observer) {
        self.observer = Some(observer);
    }

    /// Has `watch` follow every boot from now on.
    pub fn set_boot_watch(&mut self, watch: BootWatch) {
        self.boot_watch = Some(watch);
    }

    /// State of the supervisor.
    pub fn state(&self) -> State {
        self.master.state()
    }

    /// The fault that led to the present state.
    pub fn cause(&self) -> Option<Cause> {
        self.master.cause()
    }

    /// The master, for reports.
    pub fn master(&self) -> &Master {
        &self.master
    }

    /// What the link has told.
    pub fn counts(&self) -> LinkCounts {
        self.counts
    }

    /// The link.
    pub fn link(&self) -> &L {
        &self.link
    }

    /// What it waits for.
    pub fn pace(&self) -> Pace {
        self.pace
    }

    /// The cycle time.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// What the last cycle gave.
    pub fn last_outputs(&self) -> Option<&Outputs> {
        self.last.as_ref()
    }

    /// Has the scene begin with the next cycle; records count their time from there.
    pub fn begin_scene(&mut self) {
        self.scene_from = Some(self.next_sync);
    }

    /// Resets, configures and starts the rig's nodes, up to the exchange of process data. Nothing is enabled.
    ///
    /// The first time it listens before that, on the wall in both paces, and sends nothing if there is another master.
    ///
    /// # Errors
    /// If there is another master, a node is missing or is not what it should be, nothing can be sent, or the watch asks for the
    /// end.
    pub fn boot(&mut self) -> Result<(), LiveError> {
        let booted = self.bring_up();
        if let Some(watch) = &mut self.boot_watch {
            watch(None);
        }
        booted
    }

    fn bring_up(&mut self) -> Result<(), LiveError> {
        self.waits = false;
        self.make_sure_to_be_alone()?;
        self.send_or_fail(|master, now, out| master.start(now, out))?;
        loop {
            self.drain();
            self.send_or_fail(|master, now, out| master.poll(now, out))?;
            match self.master.phase() {
                Phase::Operational => break,
                Phase::Failed(error) => {
                    let error = error.clone();
                    self.check_alone()?;
                    return Err(error.into());
                }
                // A master whose cycle has panicked does not start.
                Phase::Off => return Err(LiveError::NotBooted),
                // The master gives every other phase a bound.
                _ => {}
            }
            let now = self.now();
            let mut next = self.master.next_deadline();
            if let Some(watch) = &mut self.boot_watch {
                if watch(self.master.waiting(now)) {
                    return Err(LiveError::Interrupted);
                }
                next = next.min(now + LOOK_UP);
            }
            self.link.wait(self.started + next.since(Time(0)));
        }
        self.next_sync = Time::NEVER;
        if self.pace == Pace::Lockstep {
            self.listen();
        }
        Ok(())
    }

    /// Has the cycles begin at the grid point after the next one.
    fn begin(&mut self) {
        let (now, period) = (self.now().0, self.period.as_nanos() as u64);
        self.next_sync = Time((now / period + 2) * period);
        self.lockstep_now = self.next_sync;
        self.looked_at = self.link.now();
        self.waits = self.pace == Pace::Lockstep;
    }

    /// One period: SYNC, process data, the cycle, set-points. Nothing comes of it once a cycle has panicked.
    ///
    /// Real-time: yes, if the observer and the tap are.
    pub fn run_cycle(&mut self, request: Request) -> Option<CycleRecord> {
        if self.has_panicked {
            return None;
        }
        if self.next_sync == Time::NEVER {
            self.begin();
        }
        let grid = if self.waits { self.begin_in_lockstep() } else { self.begin_on_the_wall() };
        let begin = self.now();
        let planned = grid + self.compute_at;
        let behind = self.periods_between(grid, begin);
        self.timing.compute_late_ns = nanos(begin.since(planned));
        self.timing.skipped = self.timing.skipped.saturating_add(behind);
        let suspended = self.metronome.suspended();
        self.timing.suspended = suspended.saturating_sub(std::mem::replace(&mut self.suspended, suspended)) > SUSPENDED;
        let timing = std::mem::take(&mut self.timing);
        let (outputs, stepped) = self.compute(begin, request, timing)?;
        let end = if self.waits { begin } else { self.now() };
        self.timing.last_compute_ns = nanos(end.since(begin));
        self.stages.stepped_ns = nanos(stepped.since(planned));
        self.stages.sent_ns = nanos(end.since(planned));
        // The first grid point that has not passed; those before it are skipped, and never made up for.
        let ahead = self.periods_between(grid, end);
        self.timing.skipped = ahead.saturating_sub(behind);
        self.next_sync = grid + self.period * (ahead + 1);
        if self.waits {
            let patience = if self.absent.is_empty() { PATIENCE } else { IMPATIENCE };
            self.wait_for(patience, |master| !master.is_in_flight());
        }
        let moment = Moment {
            index: self.cycles,
            sync_ns: grid.0,
            compute_ns: planned.0,
            scene_time_s: self.scene_from.map_or(f64::NEG_INFINITY, |from| grid.as_secs_f64() - from.as_secs_f64()),
            stages: std::mem::take(&mut self.stages),
        };
        self.cycles += 1;
        let record = CycleRecord::new(moment, self.master.last_inputs(), &outputs, self.master.cause(), None);
        if let Some(observer) = &mut self.observer {
            observer(&record);
        }
        Some(record)
    }

    /// Leaves the network after the rig was stopped, so that no drive waits for set-points. A bus that could not be reached
    /// gets nothing. Whoever watches sees the last frames as well.
    pub fn leave(&mut self) {
        if !self.master.is_silent() {
            let was_exchanging = *self.master.phase() == Phase::Operational;
            self.send(|master, _, out| master.leave(out));
            if was_exchanging && !self.makes_torque() {
                self.end_watch();
            }
        }
        let until = self.link.now() + FAREWELL;
        while self.link.now() < until {
            self.link.wait(until);
            self.drain();
        }
    }

    /// Has the drives no longer watch the master's heartbeat, which ends: they would enter that as an error (8130h). Only drives
    /// without torque are told; heartbeats go on until they have answered.
    fn end_watch(&mut self) {
        if self.waits {
            // Time follows the wall from here on.
            self.started = Time(self.link.now().0.saturating_sub(self.lockstep_now.0));
            self.waits = false;
        }
        for drive in self.drives {
            // One that does not answer is left as it is.
            let _ = self.write(drive, objects::CONSUMER_HEARTBEAT, 0);
        }
    }

    /// SYNC on its grid point, then sleeps until the computation; the grid point.
    fn begin_on_the_wall(&mut self) -> Time {
        let mut grid = self.next_sync;
        self.sleep_until(grid);
        let mut woke = self.now();
        let missed = self.periods_between(grid, woke);
        if missed > 0 {
            // The first grid point ahead: the cycle that was missed is not made up for.
            self.timing.skipped = self.timing.skipped.saturating_add(missed + 1);
            grid = grid + self.period * (missed + 1);
            self.sleep_until(grid);
            woke = self.now();
        }
        self.stages.sync_woke_ns = nanos(woke.since(grid));
        self.drain();
        let sent = self.now();
        self.timing.sync_late_ns = nanos(sent.since(grid));
        self.send_sync();
        // Process data follow SYNC, however late that was.
        self.sleep_until(sent + self.compute_at);
        self.stages.woke_ns = nanos(self.now().since(grid + self.compute_at));
        self.drain();
        grid
    }

    /// SYNC, then waits for the process data; the grid point.
    fn begin_in_lockstep(&mut self) -> Time {
        let grid = self.next_sync;
        self.lockstep_now = grid;
        self.drain();
        self.send_sync();
        if !self.master.is_sync_held() {
            let absent = self.absent;
            self.wait_for(PATIENCE, |master| absent.contains(master.missing(grid)));
            self.wait_for(IMPATIENCE, |master| master.missing(grid).is_empty());
            self.absent = self.master.missing(grid);
        }
        self.lockstep_now = grid + self.compute_at;
        grid
    }

    fn send_sync(&mut self) {
        self.send(|master, _, out| master.on_sync(out));
    }

    /// Runs the cycle, and when it was stepped; nothing if it panicked, after a last quick stop.
    fn compute(&mut self, begin: Time, request: Request, timing: Timing) -> Option<(Outputs, Time)> {
        if self.master.next_deadline() <= begin {
            self.send(|master, now, out| master.poll(now, out));
        }
        let result = catch_unwind(AssertUnwindSafe(|| {
            let outputs = self.master.step(begin, request, timing);
            let stepped = self.now();
            self.send(|master, now, out| master.send_set_points(now, out));
            (outputs, stepped)
        }));
        match result {
            Ok((outputs, stepped)) => {
                self.last = Some(outputs);
                Some((outputs, stepped))
            }
            Err(_) => {
                self.has_panicked = true;
                self.send(|master, now, out| master.quick_stop_now(now, out));
                None
            }
        }
    }

    /// Time since switching on.
    pub(super) fn now(&self) -> Time {
        if self.waits { self.lockstep_now } else { Time(self.link.now().since(self.started).as_nanos() as u64) }
    }

    pub(super) fn sleep_until(&mut self, moment: Time) {
        self.metronome.sleep_until(self.started + moment.since(Time(0)));
    }

    /// Whole periods from a grid point to a moment.
    pub(super) fn periods_between(&self, grid: Time, moment: Time) -> u32 {
        (moment.since(grid).as_nanos() / self.period.as_nanos()).min(u128::from(u32::MAX / 2)) as u32
    }

    /// Has the master send; a frame that could not be sent is told to the next cycle.
    pub(super) fn send<R>(&mut self, act: impl FnOnce(&mut Master, Time, &mut LinkOutbox<'_, L>) -> R) -> R {
        let now = self.now();
        let mut out = LinkOutbox::new(&mut self.link);
        let result = act(&mut self.master, now, &mut out);
        let failed = out.failed_buses();
        self.counts.refused += u64::from(out.failure().is_some());
        failed.for_each(|bus| self.master.on_link(bus, LinkEvent::SendFailed));
        result
    }

    /// The same where nothing goes on without it.
    pub(super) fn send_or_fail(
        &mut self,
        act: impl FnOnce(&mut Master, Time, &mut LinkOutbox<'_, L>),
    ) -> Result<(), LiveError> {
        let now = self.now();
        let mut out = LinkOutbox::new(&mut self.link);
        act(&mut self.master, now, &mut out);
        out.failure().map_or(Ok(()), |(bus, error)| Err(LiveError::Send { bus, error }))
    }
}

fn nanos(time: Duration) -> u32 {
    time.as_nanos().min(u128::from(u32::MAX)) as u32
}
