//! The watchdog drill over the bus.
//!
//! Without SYNC the drives send no process data, so they are asked for their statusword (6041h) over SDO, once a cycle.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::drilled::{CYCLES_BEFORE_SILENCE, DRILL_LIMIT, Drilled, Finding};
use super::error::RunError;
use super::permit::{Ask, Permit};
use super::place::Place;
use super::proof::DriveIdentity;
use super::runner::Runner;
use crate::assembly::{AssemblyError, bus_plan};
use crate::bus::DriveSetup;
use crate::canopen::{NodeId, OnBus, Outbox, SdoClient, SdoOutcome, Time, cob};
use crate::config;
use crate::guard::State;
use crate::link::{Arrival, LinkOutbox, Received};
use yieldwall_drives::cia402::{self, Statusword};
use yieldwall_drives::objects::{self, Object};
use yieldwall_drives::profiles::Tried;
use yieldwall_drives::watchdog::Watchdog;

/// Cycles in which everything is sent before something stays away, so that its last moment is known.
const CYCLES_REPEATED: u32 = 20;

/// Where a drive is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveAddress {
    /// Number of its bus.
    pub bus: u8,
    /// Its node id.
    pub node: NodeId,
    /// How long it may take to answer an SDO request.
    pub sdo_wait: Duration,
    /// Whether its profile is one of simulated drives.
    pub has_simulated_profile: bool,
}

/// What is asked of one drive, and what it said.
struct Watched {
    bus: u8,
    client: SdoClient,
    sdo_wait: Duration,
    asked_at: Time,
    answered_at: Time,
    /// When the question was asked that it answered last.
    told_of: Time,
    longest_gap: Duration,
    stopped_at: Option<Time>,
}

impl Watched {
    fn new(DriveAddress { bus, node, sdo_wait, .. }: DriveAddress) -> Self {
        let client = SdoClient::new(node, sdo_wait, 4);
        let (asked_at, answered_at, told_of) = Default::default();
        Self { bus, client, sdo_wait, asked_at, answered_at, told_of, longest_gap: Duration::ZERO, stopped_at: None }
    }

    fn take(&mut self, arrival: &Arrival, time: Time, out: &mut impl Outbox) {
        let Received::Frame(frame) = arrival.what else { return };
        let out = &mut out.on(self.bus);
        if frame.bus() != self.bus
            || !matches!(self.client.on_frame(time, &frame, out), Some(SdoOutcome::Uploaded { .. }))
        {
            return;
        }
        if self.answered_at > Time(0) && self.stopped_at.is_none() {
            self.longest_gap = self.longest_gap.max(time.since(self.answered_at));
        }
        (self.answered_at, self.told_of) = (time, self.asked_at);
        if let &[low, high, ..] = self.client.data()
            && Statusword(u16::from_le_bytes([low, high])).state() != Some(cia402::State::OperationEnabled)
        {
            self.stopped_at.get_or_insert(time);
        }
    }

    /// Asks again, if the last question was answered or has timed out.
    fn ask(&mut self, now: Time, out: &mut impl Outbox) {
        let out = &mut out.on(self.bus);
        self.client.poll(now, out);
        if !self.client.is_busy() {
            let status = objects::STATUSWORD;
            // It is not busy, which is the only reason to refuse.
            let _ = self.client.start_upload(now, status.index, status.sub, out);
            self.asked_at = now;
        }
    }

    /// Whether it has stopped, or has told of its state at `limit` or later, or does not tell.
    fn is_known(&self, now: Time, limit: Time) -> bool {
        let is_mute = now.since(limit) >= self.sdo_wait * 2;
        now >= limit && (self.told_of >= limit || is_mute) || self.stopped_at.is_some()
    }

    /// Time from `last` to its stop, if that was within [`DRILL_LIMIT`] as finely as its answers tell.
    fn stopped_after(&self, last: Time) -> Option<Duration> {
        let after = self.stopped_at?.since(last);
        (after <= DRILL_LIMIT + self.longest_gap).then_some(after)
    }
}

impl<P: Place> Runner<P> {
    /// Drills all watchdogs of the drives: for each the network is booted, the rig enabled at rest, and then one thing stays
    /// away while all others are repeated. The rig is stopped in the end. Nobody may hold the handle.
    ///
    /// # Errors
    /// If the rig cannot be booted or enabled, is stopped by something else, or a person asks for the end.
    pub fn drill(
        &mut self,
        drives: [DriveAddress; 2],
        settling: u32,
        is_interrupted: &AtomicBool,
    ) -> Result<Drilled, RunError> {
        let mut findings = Vec::new();
        let mut resolution = Duration::ZERO;
        for watchdog in Watchdog::ALL {
            self.boot()?;
            self.enable(settling, &Permit::for_drill(self), is_interrupted)?;
            for _ in 0..CYCLES_BEFORE_SILENCE {
                self.run_cycle(Ask::Nothing);
            }
            let mut drives = drives.map(Watched::new);
            if self.is_led_away() {
                self.stop();
                return Err(RunError::LedAway { watchdog });
            }
            if !matches!(self.state(), State::Running | State::Holding) {
                let cause = self.cause();
                self.stop();
                return Err(RunError::NotTried { watchdog, cause });
            }
            let last = self.fall_silent(watchdog, &mut drives);
            let stopped_after = drives.each_ref().map(|drive| drive.stopped_after(last));
            findings.push(Finding { watchdog, stopped_after });
            resolution = drives.iter().map(|drive| drive.longest_gap).fold(resolution, Duration::max);
            // A drive that goes on is stopped by what it does hear.
            self.stop();
            self.leave();
        }
        Ok(Drilled { findings, resolution })
    }

    /// Repeats what the last cycle sent, and then all but what `watchdog` waits for, until both drives have stopped; when that
    /// was sent for the last time.
    fn fall_silent(&mut self, watchdog: Watchdog, drives: &mut [Watched; 2]) -> Time {
        let mut last = Time(0);
        let mut cycle = 0;
        let mut limit = Time::NEVER;
        loop {
            let is_silent = cycle >= CYCLES_REPEATED;
            let sends = |what: Watchdog| !(is_silent && what == watchdog);
            let grid = self.next_sync;
            self.sleep_until(grid);
            self.watch(drives);
            let now = self.now();
            if sends(Watchdog::Sync) {
                self.send(|master, _, out| master.repeat_sync(out));
                last = if watchdog == Watchdog::Sync { now } else { last };
            }
            self.sleep_until(grid + self.compute_at);
            self.watch(drives);
            let now = self.now();
            if sends(Watchdog::SetPoints) {
                self.send(|master, _, out| master.repeat_set_points(out));
                last = if watchdog == Watchdog::SetPoints { now } else { last };
            }
            if sends(Watchdog::Heartbeat) {
                let sent = self.send(|master, now, out| master.repeat_heartbeat(now, out));
                last = if watchdog == Watchdog::Heartbeat { sent } else { last };
            }
            for drive in drives.iter_mut() {
                self.send(|_, now, out| drive.ask(now, out));
            }
            self.next_sync = grid + self.period * (self.periods_between(grid, self.now()) + 1);
            cycle += 1;
            if cycle == CYCLES_REPEATED {
                limit = now + DRILL_LIMIT;
            }
            if drives.iter().all(|drive| drive.is_known(now, limit)) {
                return last;
            }
        }
    }

    /// Takes what the link holds, for the drives that are asked and for the master.
    fn watch(&mut self, drives: &mut [Watched; 2]) {
        while let Some(arrival) = self.place.receive() {
            let time = self.time_of(&arrival);
            for drive in drives.iter_mut() {
                let mut out = LinkOutbox::new(&mut self.place);
                drive.take(&arrival, time, &mut out);
            }
            self.take(&arrival);
        }
    }

    /// Reads an unsigned object of a drive of a booted network.
    ///
    /// # Errors
    /// [`RunError::Unread`] if it does not answer or refuses.
    pub fn read(&mut self, drive: DriveAddress, index: u16, sub: u8) -> Result<u32, RunError> {
        let client =
            self.transfer(drive, (index, sub), |client, now, out| client.start_upload(now, index, sub, out))?;
        Ok(client.data().iter().take(4).rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
    }

    /// Writes an unsigned object of a drive of a booted network.
    ///
    /// # Errors
    /// As [`Runner::read`].
    pub(super) fn write(&mut self, drive: DriveAddress, object: Object, value: u32) -> Result<(), RunError> {
        let bytes = value.to_le_bytes();
        let data = bytes.get(..usize::from(object.bits() / 8)).unwrap_or(&bytes);
        let Object { index, sub, .. } = object;
        self.transfer(drive, (index, sub), |client, now, out| client.start_download(now, index, sub, data, out))?;
        Ok(())
    }

    /// One SDO transfer; the client that has what came.
    fn transfer<E>(
        &mut self,
        drive: DriveAddress,
        (index, sub): (u16, u8),
        start: impl FnOnce(&mut SdoClient, Time, &mut OnBus<'_, LinkOutbox<'_, P>>) -> Result<(), E>,
    ) -> Result<SdoClient, RunError> {
        let DriveAddress { bus, node, sdo_wait, .. } = drive;
        let unread = RunError::Unread { node_id: node.raw(), index, sub };
        let mut client = SdoClient::new(node, sdo_wait, 4);
        let now = self.now();
        let mut out = LinkOutbox::new(&mut self.place);
        start(&mut client, now, &mut out.on(bus)).map_err(|_| unread.clone())?;
        let mut outcome = None;
        while outcome.is_none() {
            // The drives already wait for heartbeats.
            let sent = self.send(|master, now, out| master.repeat_heartbeat(now, out));
            let next = client.next_deadline().min(sent + self.master().heartbeat_period());
            self.place.wait(self.started + next.since(Time(0)));
            while let Some(arrival) = self.place.receive() {
                let time = self.time_of(&arrival);
                if let Received::Frame(frame) = arrival.what
                    && frame.bus() == bus
                {
                    let mut out = LinkOutbox::new(&mut self.place);
                    outcome = outcome.or(client.on_frame(time, &frame, &mut out.on(bus)));
                }
                self.take(&arrival);
            }
            let now = self.now();
            outcome = outcome.or_else(|| client.poll(now, &mut LinkOutbox::new(&mut self.place).on(bus)));
        }
        match outcome {
            Some(SdoOutcome::Uploaded { .. } | SdoOutcome::Downloaded { .. }) => Ok(client),
            _ => Err(unread),
        }
    }

    /// What both drives of a booted network say that they are.
    ///
    /// # Errors
    /// As [`Runner::read`].
    pub fn identities(&mut self, drives: [DriveAddress; 2]) -> Result<[DriveIdentity; 2], RunError> {
        let [left, right] = drives;
        Ok([self.identity(left)?, self.identity(right)?])
    }

    fn identity(&mut self, drive: DriveAddress) -> Result<DriveIdentity, RunError> {
        let mut read = |sub| self.read(drive, objects::VENDOR_ID.index, sub);
        Ok(DriveIdentity {
            node_id: drive.node.raw(),
            vendor_id: read(1)?,
            product_code: read(2)?,
            revision: read(3)?,
            serial_number: read(4)?,
        })
    }
}

/// Where both drives are.
///
/// # Errors
/// If a node id is out of range or a bus has no entry, which no checked configuration has.
pub fn drive_addresses(rig: &config::Rig) -> Result<[DriveAddress; 2], AssemblyError> {
    let [left, right] = bus_plan(rig)?.0.drives;
    let address = |drive: &DriveSetup| -> Result<DriveAddress, AssemblyError> {
        let node = cob::node_id(drive.node_id).map_err(|error| AssemblyError::Device(error.to_string()))?;
        let has_simulated_profile = drive.profile.profile.tried == Tried::Simulation;
        Ok(DriveAddress { bus: drive.bus, node, sdo_wait: drive.waits.sdo, has_simulated_profile })
    };
    Ok([address(&left)?, address(&right)?])
}
