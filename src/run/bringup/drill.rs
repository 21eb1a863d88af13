//! The watchdog drill over the bus.
//!
//! Without SYNC the drives on CAN send no process data, so they are asked for their statusword (6041h) over SDO, once a cycle. Inputs of a
//! segment come without outputs too, and have it. A device that is asked for SAFE-OP goes on getting outputs, which it does not take there.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use crate::drilled::{CYCLES_BEFORE_SILENCE, DRILL_LIMIT, Drilled, Finding};
use crate::error::RunError;
use crate::permit::{Ask, Permit};
use crate::place::Place;
use crate::runner::Runner;
use yieldwall_bus::Master;
use yieldwall_drives::cia402::{self, Statusword};
use yieldwall_drives::objects;
use yieldwall_drives::watchdog::Watchdog;
use yieldwall_fieldbus::canopen::Outbox;
use yieldwall_fieldbus::objects::{Address, ObjectAnswer, ObjectRequest};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::cycle::LeadLimits;
use yieldwall_motion::guard::{Device, State};

/// Cycles in which everything is sent before something stays away, so that its last moment is known.
const CYCLES_REPEATED: u32 = 20;

/// Limits of the guidance that holds the joints in place.
const HOLDS: LeadLimits = LeadLimits { rate_rad_per_s: 0.1, acceleration_rad_per_s2: 1.0 };

/// Requests to one drive, and its answers.
struct Watched {
    drive: Device,
    is_asked: bool,
    asked_at: Time,
    answered_at: Time,
    /// Moment of the request that it answered last.
    told_of: Time,
    longest_gap: Duration,
    stopped_at: Option<Time>,
    /// State in which it was then.
    stopped_in: Option<cia402::State>,
}

impl Watched {
    fn new(drive: Device) -> Self {
        let (asked_at, answered_at, told_of) = Default::default();
        let longest_gap = Duration::ZERO;
        Self { drive, is_asked: false, asked_at, answered_at, told_of, longest_gap, stopped_at: None, stopped_in: None }
    }

    /// Takes the answer if there is one.
    fn take(&mut self, master: &Master, time: Time) {
        if !self.is_asked {
            return;
        }
        let data = match master.networks().answer(self.drive) {
            ObjectAnswer::Pending => return,
            ObjectAnswer::Done(data) => data,
            ObjectAnswer::NotAsked | ObjectAnswer::Failed(_) => {
                self.is_asked = false;
                return;
            }
        };
        self.is_asked = false;
        let word = if let &[low, high, ..] = data { Some(u16::from_le_bytes([low, high])) } else { None };
        self.see(word, self.asked_at, time);
    }

    /// Takes a statusword of one moment that came at another.
    fn see(&mut self, word: Option<u16>, of: Time, time: Time) {
        if self.answered_at > Time(0) && self.stopped_at.is_none() {
            self.longest_gap = self.longest_gap.max(time.since(self.answered_at));
        }
        (self.answered_at, self.told_of) = (time, of);
        let Some(word) = word else { return };
        let state = Statusword(word).state();
        if state != Some(cia402::State::OperationEnabled) && self.stopped_at.is_none() {
            (self.stopped_at, self.stopped_in) = (Some(time), state);
        }
    }

    /// Asks again, if the last question was answered or has timed out.
    fn ask(&mut self, master: &mut Master, now: Time, out: &mut impl Outbox) {
        master.networks_mut().poll(now, out);
        self.take(master, now);
        if !self.is_asked {
            let status = ObjectRequest::Read(Address::new(objects::STATUSWORD.index, objects::STATUSWORD.sub));
            self.is_asked = master.networks_mut().ask(now, self.drive, status, out).is_ok();
            self.asked_at = now;
        }
    }

    /// Whether the drive has stopped, reported a state of `limit` or later, or does not report.
    fn is_known(&self, now: Time, limit: Time, patience: Duration) -> bool {
        let is_mute = now.since(limit) >= patience;
        now >= limit && (self.told_of >= limit || is_mute) || self.stopped_at.is_some()
    }

    /// Returns the time from `last` to the drive's stop, if it was within [`DRILL_LIMIT`], at the resolution of the drive's
    /// answers.
    fn stopped_after(&self, last: Time) -> Option<Duration> {
        let after = self.stopped_at?.since(last);
        (after <= DRILL_LIMIT + self.longest_gap).then_some(after)
    }
}

/// Drills all watchdogs of the drives. For each watchdog the network is booted and the rig enabled, with its joints held in place
/// whatever the fixture would do. Then one signal stays away while all others are repeated. The rig is stopped in the end. Nobody
/// may hold the handle. `found` receives each finding once the rig has been stopped after it.
///
/// # Errors
/// If the rig cannot be booted or enabled, is stopped by something else, or a person asks for the end.
pub fn drill(
    runner: &mut Runner<dyn Place>,
    settling: u32,
    is_interrupted: &AtomicBool,
    found: impl FnMut(&Finding),
) -> Result<Drilled, RunError> {
    runner.lead(Some(HOLDS));
    let drilled = drill_held(runner, settling, is_interrupted, found);
    runner.lead(None);
    drilled
}

fn drill_held(
    runner: &mut Runner<dyn Place>,
    settling: u32,
    is_interrupted: &AtomicBool,
    mut found: impl FnMut(&Finding),
) -> Result<Drilled, RunError> {
    let mut findings = Vec::new();
    let mut resolution = Duration::ZERO;
    for &watchdog in runner.watchdogs {
        runner.boot()?;
        runner.enable(settling, &Permit::at_rest(runner), is_interrupted)?;
        for _ in 0..CYCLES_BEFORE_SILENCE {
            runner.run_cycle(Ask::Nothing);
        }
        let mut drives = Device::DRIVES.map(Watched::new);
        if !matches!(runner.state(), State::Running | State::Holding) {
            let cause = runner.cause();
            runner.stop();
            runner.hear_errors();
            return Err(RunError::NotTried { watchdog, cause });
        }
        let last = fall_silent(runner, watchdog, &mut drives);
        let stopped_after = drives.each_ref().map(|drive| drive.stopped_after(last));
        let stopped_in = drives.each_ref().map(|drive| drive.stopped_in);
        let finding = Finding { watchdog, stopped_after, stopped_in };
        findings.push(finding);
        resolution = drives.iter().map(|drive| drive.longest_gap).fold(resolution, Duration::max);
        // A drive that goes on is stopped by what it does hear.
        runner.stop();
        runner.leave();
        found(&finding);
    }
    Ok(Drilled { findings, resolution })
}

/// Repeats what the last cycle sent, and then all but what `watchdog` waits for, until both drives have stopped; when that
/// was sent for the last time.
fn fall_silent(runner: &mut Runner<dyn Place>, watchdog: Watchdog, drives: &mut [Watched; 2]) -> Time {
    let mut last = Time(0);
    let mut cycle = 0;
    let mut limit = Time::NEVER;
    loop {
        let is_silent = cycle >= CYCLES_REPEATED;
        let sends = |what: Watchdog| !(is_silent && what == watchdog);
        let grid = runner.next_sync;
        watch_until(runner, grid, drives);
        let now = runner.now();
        if !sends(Watchdog::Operational) && last == Time(0) {
            runner.send(|master, _, _| master.networks_mut().leave_op());
            last = now;
        }
        if sends(Watchdog::Sync) {
            runner.send(|master, _, out| master.networks_mut().repeat_sync(out));
            last = if watchdog == Watchdog::Sync { now } else { last };
        }
        let compute_at = grid + runner.compute_at;
        watch_until(runner, compute_at, drives);
        let now = runner.now();
        let inputs = runner.master.networks_mut().take_statuswords(now);
        if drives.iter().any(|drive| drive.stopped_at.is_some()) {
            runner.master.close_brakes();
        }
        if sends(Watchdog::SetPoints) && sends(Watchdog::Outputs) {
            runner.send(|master, now, out| master.repeat_set_points(now, out));
            last = if matches!(watchdog, Watchdog::SetPoints | Watchdog::Outputs) { now } else { last };
        }
        if sends(Watchdog::Heartbeat) {
            let sent = runner.send(|master, now, out| master.networks_mut().repeat_heartbeat(now, out).unwrap_or(now));
            last = if watchdog == Watchdog::Heartbeat { sent } else { last };
        }
        for (at, drive) in drives.iter_mut().enumerate() {
            match inputs {
                Some(words) => drive.see(words.get(at).copied().flatten(), now, now),
                None => runner.send(|master, now, out| drive.ask(master, now, out)),
            }
        }
        runner.next_sync = runner.after(grid, runner.periods_between(grid, runner.now()) + 1);
        cycle += 1;
        if cycle == CYCLES_REPEATED {
            limit = now + DRILL_LIMIT;
        }
        if drives.iter().zip(runner.patience).all(|(drive, patience)| drive.is_known(now, limit, patience)) {
            return last;
        }
    }
}

/// Takes what comes up to a moment. In virtual time each arrival ends a sleep.
fn watch_until(runner: &mut Runner<dyn Place>, moment: Time, drives: &mut [Watched; 2]) {
    loop {
        runner.sleep_until(moment);
        watch(runner, drives);
        if !runner.is_virtual || runner.now() >= moment {
            return;
        }
    }
}

/// Takes the frames of the link, and the answers of the drives that are asked.
fn watch(runner: &mut Runner<dyn Place>, drives: &mut [Watched; 2]) {
    while let Some(arrival) = runner.place.receive() {
        let time = runner.time_of(&arrival);
        runner.take(&arrival);
        drives.iter_mut().for_each(|drive| drive.take(runner.master(), time));
    }
    runner.drain_ethernet();
}
