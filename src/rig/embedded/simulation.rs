//! The place of the embedded rig: virtual buses, simulated devices and the arm under one virtual clock, and a computer that is at times
//! late, stopped or dead.

use std::collections::VecDeque;
use std::panic::resume_unwind;
use std::time::Duration;

use super::buses::Buses;
use super::schedule::Schedule;
use super::trouble::Troubles;
use super::{DEVICES, MASTER, STRANGER};
use crate::bus::LinkEvent;
use crate::canopen::{Frame, Time, cob};
use crate::cycle::Outputs;
use crate::link::{Arrival, CanLink, ErrorFrame, Received, SendError};
use crate::quantity::{JointAngles, JointTorques};
use crate::record;
use crate::rig::error::RigError;
use crate::rig::far_end::FarEnd;
use crate::rig::silence::Silence;
use crate::rig::world;
use crate::run::{Place, Process, Tap};
use crate::sim::Drive;

/// Frames that wait for a process that is stopped, as in a socket's buffer; more are lost.
const WAITING_FRAMES: usize = 256;

/// The panic that an injection asks for.
pub(super) struct Injected;

/// The computer that runs the master.
#[derive(Debug, Default)]
pub(super) struct Computer {
    /// Whether the process does not run: frames wait.
    pub(super) is_asleep: bool,
    /// Whether it never runs again.
    pub(super) is_dead: bool,
    pub(super) stop_is_requested: bool,
    /// Whether the next cycle panics.
    pub(super) panics: bool,
    /// What waits for it.
    waiting: VecDeque<Received>,
    /// What it has not taken yet.
    inbox: VecDeque<Arrival>,
    /// Grid point of the cycle that it runs.
    grid: Time,
    /// By how much it wakes up too late for SYNC and for the computation, and how long that takes.
    sync_late: Duration,
    compute_late: Duration,
    compute_takes: Duration,
}

impl Computer {
    fn take(&mut self, time: Time, what: Received) {
        if !self.is_asleep {
            self.inbox.push_back(Arrival { time, bus: bus_of(&what), what });
        } else if self.waiting.len() < WAITING_FRAMES {
            self.waiting.push_back(what);
        }
    }

    /// The process runs again, and first takes what has waited.
    fn wake(&mut self, now: Time) {
        if std::mem::take(&mut self.is_asleep) {
            let waiting = self.waiting.drain(..).map(|what| Arrival { time: now, bus: bus_of(&what), what });
            self.inbox.extend(waiting);
        }
    }
}

fn bus_of(what: &Received) -> u8 {
    match what {
        Received::Frame(frame) | Received::Echo(frame) => frame.bus(),
        _ => 0,
    }
}

/// Buses, devices, machine, and whatever is broken.
pub(super) struct Simulation {
    pub(super) buses: Buses,
    pub(super) far: FarEnd,
    pub(super) tap: Option<Tap>,
    pub(super) schedule: Schedule,
    pub(super) troubles: Troubles,
    pub(super) computer: Computer,
    /// What a drill keeps from the devices.
    pub(super) silence: Option<Silence>,
    pub(super) period: Duration,
    pub(super) now: Time,
    /// What the last cycle asked of the joints: without an arm they are there one SYNC later.
    pub(super) target_angles: Option<JointAngles>,
    /// Why it cannot go on.
    pub(super) failure: Option<RigError>,
}

impl Simulation {
    pub(super) fn new(buses: Buses, far: FarEnd, troubles: Troubles, period: Duration) -> Self {
        Self {
            buses,
            far,
            tap: None,
            schedule: Schedule::default(),
            troubles,
            computer: Computer::default(),
            silence: None,
            period,
            now: Time::default(),
            target_angles: None,
            failure: None,
        }
    }

    /// The process is there to boot the network: what waited for it is from before.
    pub(super) fn begin_boot(&mut self) {
        self.computer.is_asleep = false;
        self.computer.waiting.clear();
        self.tell_link_events();
    }

    /// Has the master's interfaces tell what is wrong with them.
    pub(super) fn tell_link_events(&mut self) {
        let Self { troubles, computer, now, .. } = self;
        for (bus, event) in troubles.link_events() {
            let is_bus_off = event == LinkEvent::BusOff;
            let error = ErrorFrame { is_bus_off, is_error_passive: !is_bus_off, ..ErrorFrame::default() };
            computer.inbox.push_back(Arrival { time: *now, bus, what: Received::Error(error) });
        }
    }

    fn next_event(&self) -> Time {
        self.buses.next_event().min(self.far.next_deadline()).min(self.troubles.next_held())
    }

    /// Lets everything happen that is due up to `until`, in order of time; of one moment, frames come first. It ends before, where
    /// something has come for the master.
    fn run_until(&mut self, until: Time) {
        if self.failure.is_none() {
            let run = self.pump(until);
            self.failure = run.err();
        }
        if self.computer.inbox.is_empty() {
            self.now = self.now.max(until);
        }
    }

    fn pump(&mut self, until: Time) -> Result<(), RigError> {
        while self.computer.inbox.is_empty() {
            let next = self.next_event();
            if next > until {
                break;
            }
            self.now = self.now.max(next);
            if let Some(delivery) = self.buses.advance(next) {
                let passed = self.troubles.pass(next, delivery.from, delivery.frame);
                let passed = match &mut self.silence {
                    Some(silence) if delivery.from == MASTER => passed.and_then(|frame| silence.pass(next, frame)),
                    _ => passed,
                };
                match passed {
                    Some(frame) => self.arrive(delivery.time, delivery.from, &frame)?,
                    // Its own controller has sent it all the same.
                    None if delivery.from == MASTER => self.computer.take(next, Received::Echo(delivery.frame)),
                    None => {}
                }
            } else if let Some((from, frame)) = self.troubles.take_held(next) {
                match from {
                    STRANGER => self.buses.submit_foreign(next, frame),
                    _ => self.arrive(next, from, &frame)?,
                }
            } else {
                self.far.poll(next, &mut self.troubles, &mut self.buses)?;
            }
            if let Some(silence) = &mut self.silence {
                silence.look(next, self.far.drives.each_ref().map(Drive::state));
            }
        }
        Ok(())
    }

    fn arrive(&mut self, time: Time, from: usize, frame: &Frame) -> Result<(), RigError> {
        if let Some(tap) = &mut self.tap {
            tap(time, frame);
        }
        let now = self.now;
        // The joints follow together, at one SYNC of the cycle.
        let is_sync = frame.id() == cob::SYNC && frame.bus() == self.buses.of_device(0);
        if let (true, Some(targets)) = (is_sync, self.target_angles) {
            self.far.world.follow(now, targets)?;
        }
        let device = DEVICES.iter().position(|port| *port == from);
        self.far.on_frame(now, device, frame, &mut self.troubles, &mut self.buses)?;
        if from == MASTER {
            self.computer.take(now, Received::Echo(*frame));
        } else if self.troubles.hears(frame.bus()) {
            self.computer.take(now, Received::Frame(*frame));
        }
        Ok(())
    }
}

impl CanLink for Simulation {
    fn now(&self) -> Time {
        self.now
    }

    fn receive(&mut self) -> Option<Arrival> {
        self.computer.inbox.pop_front()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        if !self.troubles.sends(frame.bus()) {
            return Err(SendError::Down);
        }
        self.buses.submit_own(self.now, *frame);
        Ok(())
    }

    fn wait(&mut self, until: Time) -> bool {
        self.run_until(until);
        !self.computer.inbox.is_empty()
    }
}

impl Place for Simulation {
    const IS_VIRTUAL: bool = true;

    fn sleep_until(&mut self, moment: Time, deadline: Time) {
        let late = if moment <= self.computer.grid { self.computer.sync_late } else { self.computer.compute_late };
        self.run_until((moment + late).min(deadline));
    }

    fn begin_cycle(&mut self, grid: Time) -> Process {
        if self.failure.is_some() {
            return Process::Dead;
        }
        self.follow_injections(grid);
        self.troubles.begin_cycle(grid, self.period);
        let host = self.troubles.host();
        if host.is_stopped || self.computer.is_dead {
            self.computer.is_asleep = true;
            return match () {
                () if self.computer.is_dead => Process::Dead,
                () if host.is_suspended => Process::Suspended,
                () => Process::Stopped,
            };
        }
        self.computer.wake(self.now);
        self.tell_link_events();
        let computer = &mut self.computer;
        (computer.grid, computer.sync_late) = (grid, host.sync_late);
        (computer.compute_late, computer.compute_takes) = (host.compute_late, host.compute_takes);
        Process::Runs
    }

    fn takes_stop(&mut self) -> bool {
        std::mem::take(&mut self.computer.stop_is_requested)
    }

    fn suspended(&self) -> Duration {
        // A period in which it was is told by `begin_cycle`.
        Duration::ZERO
    }

    fn computed(&mut self, outputs: &Outputs) {
        self.target_angles = Some(outputs.signals.target_angles);
        let computer = &mut self.computer;
        (computer.sync_late, computer.compute_late) = (Duration::ZERO, Duration::ZERO);
        if std::mem::take(&mut computer.panics) {
            (computer.is_asleep, computer.is_dead) = (true, true);
            resume_unwind(Box::new(Injected));
        }
        let takes = std::mem::take(&mut computer.compute_takes);
        if !takes.is_zero() {
            computer.is_asleep = true;
            self.run_until(self.now + takes);
            self.computer.wake(self.now);
        }
    }

    fn drop_queue(&mut self) {
        self.buses.clear();
    }

    fn truth(&self) -> Option<record::Truth> {
        let world::Truth { tip, velocity, .. } = self.far.world.truth;
        let [left, right] = &self.far.drives;
        let torques = JointTorques::new(left.torque_n_m(), right.torque_n_m());
        Some(record::Truth { tool: tip, velocity, torques })
    }
}
