//! The loop.

mod alone;
mod arrivals;

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use super::conduct::Enabling;
use super::drill::{DriveAddress, drive_addresses};
use super::error::RunError;
use super::metronome::Metronome;
use super::pace::Pace;
use super::permit::Ask;
use super::place::{OnLink, Place, Process};
use crate::assembly::{bus_plan, master};
use crate::bus::{LinkEvent, Master, Phase, Waiting};
use crate::canopen::{Frame, Time};
use crate::config;
use crate::cycle::{Outputs, Timing};
use crate::guard::{Cause, DeviceSet, Request, State};
use crate::link::{CanLink, LinkOutbox};
use crate::quantity::JointAngles;
use crate::record::{CycleRecord, Moment, Stages};
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

/// Gets every frame that went over a bus ([`Frame::bus`]), with the moment of its end.
pub type Tap = Box<dyn FnMut(Time, &Frame) + Send>;

/// Gets the record of every cycle, right after the cycle has run.
pub type Observer = Box<dyn FnMut(&CycleRecord) + Send>;

/// Is told what the boot waits for, ten times a second, and nothing when the boot is over. The boot ends when it says that a
/// person asked for the end.
pub type BootWatch = Box<dyn FnMut(Option<Waiting<'_>>) -> bool + Send>;

/// How far the joints may be led away from rest, rad.
const REST_RAD: f64 = 0.02;

/// A rig that has to rest.
#[derive(Clone, Copy, Debug, Default)]
struct Rest {
    /// What was asked of the joints when the rig came to run.
    at: Option<JointAngles>,
    is_left: bool,
}

impl Rest {
    fn look(&mut self, state: State, targets: JointAngles) {
        if state == State::Running {
            let [left, right] = self.at.get_or_insert(targets).to_array();
            let [is_left, is_right] = targets.to_array();
            self.is_left |= (is_left - left).abs().max((is_right - right).abs()) > REST_RAD;
        }
    }
}

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

/// A rig at a place.
///
/// [`Runner::boot`] brings the network up, and every [`Runner::run_cycle`] is one period. Under [`Pace::Free`] the
/// periods are those of the place's clock; under [`Pace::Lockstep`] a cycle waits for its process data, however long they take, and
/// time advances by one period: for simulated devices on a computer of any speed.
pub struct Runner<P> {
    master: Master,
    pub(super) place: P,
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
    /// Where the rig rests, if it was enabled for that alone.
    rests: Option<Rest>,
    /// What the process did at the last grid point.
    process: Process,
    has_panicked: bool,
    panic: Option<Box<dyn Any + Send>>,
    /// How long another master is listened for before anything is sent.
    listening: Duration,
    /// Whether that was done, and nobody was heard since.
    has_listened: bool,
}

impl<L: CanLink, M: Metronome> Runner<OnLink<L, M>> {
    /// A rig on a computer that has sent nothing yet.
    ///
    /// # Errors
    /// Where parts of the configuration do not fit together.
    pub fn on_link(rig: &config::Rig, link: L, metronome: M, pace: Pace) -> Result<Self, RunError> {
        Self::new(rig, &rig.fixture, OnLink { link, metronome }, pace)
    }
}

impl<P: Place> Runner<P> {
    /// A rig that has sent nothing yet. `fixture` stands in place of the rig's own.
    ///
    /// # Errors
    /// Where parts of the configuration do not fit together.
    pub fn new(rig: &config::Rig, fixture: &config::Fixture, place: P, pace: Pace) -> Result<Self, RunError> {
        let (started, suspended) = (place.now(), place.suspended());
        Ok(Self {
            master: master(rig, fixture)?,
            place,
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
            rests: None,
            process: Process::Runs,
            has_panicked: false,
            panic: None,
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

    /// State of the supervisor; [`State::Lost`] if its process never runs again, since the drives' watchdogs act.
    pub fn state(&self) -> State {
        match self.master.state() {
            state if state.is_latched() || self.process != Process::Dead => state,
            _ => State::Lost,
        }
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

    /// Where it runs.
    pub fn place(&self) -> &P {
        &self.place
    }

    /// Where it runs, to change it.
    pub fn place_mut(&mut self) -> &mut P {
        &mut self.place
    }

    /// Whether a cycle has panicked; none is run any more.
    pub fn has_panicked(&self) -> bool {
        self.has_panicked
    }

    /// With what the cycle has panicked, once.
    pub fn take_panic(&mut self) -> Option<Box<dyn Any + Send>> {
        self.panic.take()
    }

    /// Grid point of the next cycle, since switching on; [`Time::NEVER`] before the first one is known.
    pub fn next_sync(&self) -> Time {
        self.next_sync
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
    pub fn boot(&mut self) -> Result<(), RunError> {
        let booted = self.bring_up();
        if let Some(watch) = &mut self.boot_watch {
            watch(None);
        }
        booted
    }

    fn bring_up(&mut self) -> Result<(), RunError> {
        self.waits = false;
        self.next_sync = Time::NEVER;
        if !P::IS_VIRTUAL {
            self.make_sure_to_be_alone()?;
        }
        self.send_or_fail(|master, now, out| master.start(now, out))?;
        loop {
            let has_come = self.drain();
            if !(P::IS_VIRTUAL && has_come) {
                self.send_or_fail(|master, now, out| master.poll(now, out))?;
            }
            match self.master.phase() {
                Phase::Operational => break,
                Phase::Failed(error) => {
                    let error = error.clone();
                    self.check_alone()?;
                    return Err(error.into());
                }
                // A master whose cycle has panicked does not start.
                Phase::Off => return Err(RunError::NotBooted),
                // The master gives every other phase a bound.
                _ => {}
            }
            let now = self.now();
            let mut next = self.master.next_deadline();
            if let Some(watch) = &mut self.boot_watch {
                if watch(self.master.waiting(now)) {
                    return Err(RunError::Interrupted);
                }
                next = next.min(now + LOOK_UP);
            }
            self.place.wait(self.started + next.since(Time(0)));
        }
        if self.pace == Pace::Lockstep {
            self.listen();
        }
        if P::IS_VIRTUAL {
            self.begin(1);
        }
        Ok(())
    }

    /// Has the cycles begin so many grid points ahead.
    fn begin(&mut self, ahead: u64) {
        let (now, period) = (self.now().0, self.period.as_nanos() as u64);
        self.next_sync = Time((now / period + ahead) * period);
        self.lockstep_now = self.next_sync;
        self.looked_at = self.place.now();
        self.waits = self.pace == Pace::Lockstep;
    }

    /// One period: SYNC, process data, the cycle, set-points. Nothing comes of it once a cycle has panicked, and in a period in which
    /// the process does not run. A rig that was enabled to rest and is led away from where it was is stopped.
    ///
    /// Real-time: yes, if the observer and the tap are.
    pub fn run_cycle(&mut self, ask: Ask<'_>) -> Option<CycleRecord> {
        if let Ask::Enable(permit) = ask {
            self.rests = permit.is_for_rest().then_some(Rest::default());
        }
        let mut request = if self.rests.is_some_and(|rest| rest.is_left) { Request::Stop } else { ask.request() };
        if self.has_panicked && !P::IS_VIRTUAL {
            return None;
        }
        if self.next_sync == Time::NEVER {
            // The first one may be too near.
            self.begin(2);
        }
        if P::IS_VIRTUAL {
            self.attend_until(self.next_sync);
            self.process = self.place.begin_cycle(self.next_sync, &mut request);
            if self.process != Process::Runs {
                self.miss_cycle();
                return None;
            }
        }
        let grid = if self.waits { self.begin_in_lockstep() } else { self.begin_on_the_clock() };
        let begin = self.now();
        let planned = grid + self.compute_at;
        self.timing.compute_late_ns = nanos(begin.since(planned));
        let suspended = self.place.suspended();
        self.timing.suspended |=
            suspended.saturating_sub(std::mem::replace(&mut self.suspended, suspended)) > SUSPENDED;
        let timing = std::mem::take(&mut self.timing);
        let Some((outputs, stepped)) = self.compute(begin, request, timing) else {
            self.next_sync = grid + self.period;
            return None;
        };
        let end = if self.waits { begin } else { self.now() };
        self.timing.last_compute_ns = nanos(end.since(begin));
        self.stages.stepped_ns = nanos(stepped.since(planned));
        self.stages.sent_ns = nanos(end.since(planned));
        // The first grid point that has not passed; the next cycle is told of those before it, and they are never made up for.
        self.timing.skipped = self.periods_between(grid, end);
        self.next_sync = grid + self.period * (self.timing.skipped + 1);
        if self.waits {
            let patience = if self.absent.is_empty() { PATIENCE } else { IMPATIENCE };
            self.wait_for(patience, |master| !master.is_in_flight());
        }
        if let Some(rest) = &mut self.rests {
            rest.look(self.master.state(), outputs.signals.target_angles);
        }
        let moment = Moment {
            index: self.cycles,
            sync_ns: grid.0,
            compute_ns: planned.0,
            scene_time_s: self.scene_from.map_or(f64::NEG_INFINITY, |from| grid.as_secs_f64() - from.as_secs_f64()),
            stages: std::mem::take(&mut self.stages),
        };
        self.cycles += 1;
        let record =
            CycleRecord::new(moment, self.master.last_inputs(), &outputs, self.master.cause(), self.place.truth());
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
        let until = self.place.now() + FAREWELL;
        while self.place.now() < until {
            self.place.wait(until);
            self.drain();
        }
    }

    /// Has the drives no longer watch the master's heartbeat, which ends: they would enter that as an error (8130h). Only drives
    /// without torque are told; heartbeats go on until they have answered.
    fn end_watch(&mut self) {
        if self.waits {
            // Time follows the wall from here on.
            self.started = Time(self.place.now().0.saturating_sub(self.lockstep_now.0));
            self.waits = false;
        }
        for drive in self.drives {
            // One that does not answer is left as it is.
            let _ = self.write(drive, objects::CONSUMER_HEARTBEAT, 0);
        }
    }

    /// A period in which the process does not run.
    fn miss_cycle(&mut self) {
        let grid = self.next_sync;
        match self.process {
            Process::Suspended => self.timing.suspended = true,
            _ => self.timing.skipped = self.timing.skipped.saturating_add(1),
        }
        self.place.sleep_until(self.started + (grid + self.compute_at).since(Time(0)), Time::NEVER);
        self.next_sync = grid + self.period;
    }

    /// SYNC on its grid point, then sleeps until the computation; the grid point.
    fn begin_on_the_clock(&mut self) -> Time {
        let mut grid = self.next_sync;
        let mut woke = self.attend_until(grid);
        let missed = self.periods_between(grid, woke);
        if missed > 0 {
            // The first grid point ahead: the cycle that was missed is not made up for.
            self.timing.skipped = self.timing.skipped.saturating_add(missed + 1);
            grid = grid + self.period * (missed + 1);
            woke = self.attend_until(grid);
        }
        self.stages.sync_woke_ns = nanos(woke.since(grid));
        let sent = self.now();
        self.timing.sync_late_ns = nanos(sent.since(grid));
        self.send_sync();
        // Process data follow SYNC, however late that was.
        let woke = self.attend_until(sent + self.compute_at);
        self.stages.woke_ns = nanos(woke.since(grid + self.compute_at));
        grid
    }

    /// Lets time pass until a moment, and takes what has come; when the loop woke up.
    fn attend_until(&mut self, moment: Time) -> Time {
        loop {
            let on_clock = |time: Time| self.started + time.since(Time(0));
            let runs = self.process == Process::Runs;
            let deadline = if runs { self.master.next_deadline() } else { Time::NEVER };
            self.place.sleep_until(on_clock(moment), on_clock(deadline));
            let woke = self.now();
            let has_come = self.drain();
            if !P::IS_VIRTUAL {
                return woke;
            }
            if has_come {
                continue;
            }
            if deadline <= woke {
                self.send(|master, now, out| master.poll(now, out));
            } else if woke >= moment {
                return woke;
            }
        }
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
        if self.master.is_silent() {
            self.place.drop_queue();
        }
        self.send(|master, _, out| master.on_sync(out));
    }

    /// Runs the cycle, and when it was stepped; nothing if it panicked, after a last quick stop.
    fn compute(&mut self, begin: Time, request: Request, timing: Timing) -> Option<(Outputs, Time)> {
        if self.master.next_deadline() <= begin {
            self.send(|master, now, out| master.poll(now, out));
        }
        let result = catch_unwind(AssertUnwindSafe(|| {
            let outputs = self.master.step(begin, request, timing);
            self.place.computed(&outputs);
            let stepped = self.now();
            self.send(|master, now, out| master.send_set_points(now, out));
            (outputs, stepped)
        }));
        match result {
            Ok((outputs, stepped)) => {
                self.last = Some(outputs);
                Some((outputs, stepped))
            }
            Err(panic) => {
                (self.has_panicked, self.panic) = (true, Some(panic));
                self.send(|master, now, out| master.quick_stop_now(now, out));
                None
            }
        }
    }

    /// Time since switching on.
    pub(super) fn now(&self) -> Time {
        if self.waits { self.lockstep_now } else { Time(self.place.now().since(self.started).as_nanos() as u64) }
    }

    pub(super) fn sleep_until(&mut self, moment: Time) {
        self.place.sleep_until(self.started + moment.since(Time(0)), Time::NEVER);
    }

    /// How many grid points after `grid` have passed before a moment. One at that moment has not.
    pub(super) fn periods_between(&self, grid: Time, moment: Time) -> u32 {
        let periods = moment.since(grid).as_nanos().div_ceil(self.period.as_nanos().max(1));
        periods.saturating_sub(1).min(u128::from(u32::MAX / 2)) as u32
    }

    /// Has the master send; a frame that could not be sent is told to the next cycle.
    pub(super) fn send<R>(&mut self, act: impl FnOnce(&mut Master, Time, &mut LinkOutbox<'_, P>) -> R) -> R {
        let now = self.now();
        let mut out = LinkOutbox::new(&mut self.place);
        let result = act(&mut self.master, now, &mut out);
        let failed = out.failed_buses();
        self.counts.refused += u64::from(out.failure().is_some());
        failed.for_each(|bus| self.master.on_link(bus, LinkEvent::SendFailed));
        result
    }

    /// The same where nothing goes on without it.
    pub(super) fn send_or_fail(
        &mut self,
        act: impl FnOnce(&mut Master, Time, &mut LinkOutbox<'_, P>),
    ) -> Result<(), RunError> {
        let now = self.now();
        let mut out = LinkOutbox::new(&mut self.place);
        act(&mut self.master, now, &mut out);
        out.failure().map_or(Ok(()), |(bus, error)| Err(RunError::Send { bus, error }))
    }
}

fn nanos(time: Duration) -> u32 {
    time.as_nanos().min(u128::from(u32::MAX)) as u32
}
