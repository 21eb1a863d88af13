//! The network: up to the exchange of process data, and left again.

use std::time::Duration;

use super::Runner;
use crate::error::RunError;
use crate::pace::Pace;
use crate::permit::Boot;
use crate::place::{Place, Process};
use yieldwall_bus::Phase;
use yieldwall_drives::objects;
use yieldwall_fieldbus::objects::Address;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::Device;

/// Longest time between two calls of a [`BootWatch`](super::BootWatch).
const LOOK_UP: Duration = Duration::from_millis(100);
/// How long the runner listens at the end of the run, in wall-clock time: its own last frames come back, and the devices answer.
const FAREWELL: Duration = Duration::from_millis(50);

/// Object and value that each drive gets when the master leaves the network: it then no longer watches the master's heartbeat
/// (1016h:1).
pub const END_OF_WATCH: (Address, u32) =
    (Address::new(objects::CONSUMER_HEARTBEAT.index, objects::CONSUMER_HEARTBEAT.sub), 0);

impl<P: Place + ?Sized> Runner<P> {
    /// Resets, configures and starts the rig's nodes, up to the exchange of process data. Nothing is enabled, and permits of
    /// earlier boots are void.
    ///
    /// The first time it listens before that, in wall-clock time in both paces, and sends nothing if there is another master.
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
        (self.motion_bound, self.process) = (None, Process::Runs);
        self.boot = Boot::another();
        self.forget_errors();
        if !self.is_virtual {
            self.make_sure_to_be_alone()?;
        }
        self.send_or_fail(|master, now, out| master.start(now, out))?;
        loop {
            let has_come = self.drain();
            if !(self.is_virtual && has_come) {
                self.send_or_fail(|master, now, out| master.networks_mut().poll(now, out))?;
            }
            match self.master.networks().phase() {
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
            let mut next = self.master.networks().next_deadline();
            if let Some(watch) = &mut self.boot_watch {
                if watch(self.master.networks().waiting(now)) {
                    return Err(RunError::Interrupted);
                }
                // In virtual time nobody waits, and who looks on changes nothing.
                next = if self.is_virtual { next } else { next.min(now + LOOK_UP) };
            }
            self.wait_until(self.started + next.since(Time(0)));
        }
        if self.pace == Pace::Lockstep {
            self.listen();
        }
        if self.is_virtual {
            self.begin(1);
        }
        Ok(())
    }

    /// Makes the cycles begin this number of grid points ahead.
    pub(super) fn begin(&mut self, ahead: u64) {
        let (now, period) = (self.now().0, self.period.as_nanos() as u64);
        // A segment has cycles since it was brought up, and they go on.
        self.next_sync = self.take_over_cycles().unwrap_or(Time((now / period + ahead) * period));
        self.lockstep_now = self.next_sync;
        self.looked_at = self.place.now();
        self.waits = self.pace == Pace::Lockstep;
        if self.waits {
            // The network's own last cycle is over before the first one of the loop.
            self.wait_for(FAREWELL, |master| !master.networks().is_in_flight());
        }
    }

    /// Takes the cycles of a segment over from the network, which runs them since the bring-up: the grid point of the next one. `None`
    /// without a segment.
    fn take_over_cycles(&mut self) -> Option<Time> {
        self.master.networks().segment()?;
        // It is known but between the two moments of a cycle.
        let limit = self.now() + self.period * 2;
        loop {
            if let Some(grid) = self.master.networks_mut().take_over_cycles() {
                return Some(grid);
            }
            if self.now() >= limit {
                return None;
            }
            let next = self.master.networks().next_deadline().min(limit);
            self.wait_until(self.started + next.since(Time(0)));
            if !(self.drain() && self.is_virtual) {
                self.send(|master, now, out| master.networks_mut().poll(now, out));
            }
        }
    }

    /// Leaves the network after the rig was stopped, so that no drive waits for set-points. A bus that could not be reached
    /// gets nothing. Whoever watches sees the last frames as well.
    pub fn leave(&mut self) {
        if !self.master.networks().is_silent() {
            let was_exchanging = *self.master.networks().phase() == Phase::Operational;
            self.send(|master, _, out| master.networks_mut().leave(out));
            if was_exchanging && !self.makes_torque() {
                self.end_watch();
            }
        }
        let until = self.place.now() + FAREWELL;
        while self.place.now() < until {
            self.wait_until(until);
            self.drain();
        }
    }

    /// Ends the drives' watch of the master's heartbeat before it stops; otherwise they would enter error 8130h. It writes only to
    /// drives without torque. Heartbeats go on until the drives have answered.
    fn end_watch(&mut self) {
        if self.waits {
            // Time follows the wall from here on.
            self.started = Time(self.place.now().0.saturating_sub(self.lockstep_now.0));
            self.waits = false;
        }
        let (heartbeat, never) = END_OF_WATCH;
        for drive in Device::DRIVES {
            // One that does not answer is left as it is.
            let _ = self.write(drive, heartbeat, &never.to_le_bytes());
        }
    }
}
