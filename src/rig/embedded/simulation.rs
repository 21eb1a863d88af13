//! The place of the embedded rig: virtual buses, simulated devices and the arm under one virtual clock, and the computer that runs the
//! master.

use std::time::Duration;

use super::buses::{DEVICES, MASTER};
use super::computer::Computer;
use super::injectable::{InjectableBuses, InjectableDrive, InjectableSensor};
use crate::bus::LinkEvent;
use crate::canopen::{Frame, cob};
use crate::cycle::Outputs;
use crate::link::{Arrival, CanLink, ErrorFrame, Packet, Received, SendError, Wires};
use crate::quantity::{JointAngles, JointTorques};
use crate::record;
use crate::rig::error::RigError;
use crate::rig::far_end::{Actuator, FarEnd};
use crate::rig::script::Script;
use crate::rig::silence::Silence;
use crate::rig::world;
use crate::run::{Place, Process, Tap};
use crate::sim::can::Passage;
use crate::time::Time;

/// Buses, devices, machine and computer, and what is broken of them.
pub(super) struct Simulation {
    pub(super) wires: InjectableBuses,
    pub(super) far: FarEnd<InjectableDrive, InjectableSensor>,
    pub(super) computer: Computer,
    pub(super) script: Script,
    pub(super) tap: Option<Tap>,
    /// What a drill keeps from the devices.
    pub(super) silence: Option<Silence>,
    period: Duration,
    pub(super) now: Time,
    /// What the last cycle asked of the joints: without an arm they are there one SYNC later.
    target_angles: Option<JointAngles>,
    /// Why it cannot go on.
    pub(super) failure: Option<RigError>,
}

impl Simulation {
    pub(super) fn new(wires: InjectableBuses, far: FarEnd, period: Duration) -> Self {
        let FarEnd { drives, sensor, world, buses } = far;
        let sensor = InjectableSensor::new(sensor, world.calibration.clone());
        Self {
            wires,
            far: FarEnd { drives: drives.map(InjectableDrive::new), sensor, world, buses },
            computer: Computer::default(),
            script: Script::default(),
            tap: None,
            silence: None,
            period,
            now: Time::default(),
            target_angles: None,
            failure: None,
        }
    }

    /// The process is there to boot the network.
    pub(super) fn begin_boot(&mut self) {
        self.computer.begin_boot();
        self.tell_link_events();
    }

    /// Has the master's interfaces tell what is wrong with them.
    fn tell_link_events(&mut self) {
        let Self { wires, computer, now, .. } = self;
        for (bus, event) in wires.link_events() {
            let is_bus_off = event == LinkEvent::BusOff;
            computer.tell(*now, bus, ErrorFrame { is_bus_off, is_error_passive: !is_bus_off, ..ErrorFrame::default() });
        }
    }

    fn next_event(&self) -> Time {
        self.wires.next_event().min(self.far.next_deadline())
    }

    /// Lets everything happen that is due up to `until`, in order of time; of one moment, frames come first. It ends before, where
    /// something has come for the master.
    fn run_until(&mut self, until: Time) {
        if self.failure.is_none() {
            let run = self.pump(until);
            self.failure = run.err();
        }
        if self.computer.has_taken_all() {
            self.now = self.now.max(until);
        }
    }

    fn pump(&mut self, until: Time) -> Result<(), RigError> {
        while self.computer.has_taken_all() {
            let next = self.next_event();
            if next > until {
                break;
            }
            self.now = self.now.max(next);
            match self.wires.advance(next) {
                Some(passage) => self.deliver(next, passage)?,
                None => self.far.poll(next, &mut self.wires)?,
            }
            if let Some(silence) = &mut self.silence {
                silence.look(next, self.far.drives.each_ref().map(Actuator::state));
            }
        }
        Ok(())
    }

    fn deliver(&mut self, now: Time, passage: Passage) -> Result<(), RigError> {
        let Passage { time, from, sent, received } = passage;
        let received = match &mut self.silence {
            Some(silence) if from == MASTER => received.and_then(|frame| silence.pass(now, frame)),
            _ => received,
        };
        match received {
            Some(frame) => self.arrive(time, from, &frame)?,
            // Its own controller has sent it all the same.
            None if from == MASTER => self.computer.take(now, Received::Echo(sent)),
            None => {}
        }
        Ok(())
    }

    fn arrive(&mut self, time: Time, from: usize, frame: &Frame) -> Result<(), RigError> {
        if let Some(tap) = &mut self.tap {
            tap(time, Packet::Can(frame));
        }
        let now = self.now;
        // The joints follow together, at one SYNC of the cycle.
        let is_sync = frame.id() == cob::SYNC && frame.bus() == self.wires.buses.of_device(0);
        if let (true, Some(targets)) = (is_sync, self.target_angles) {
            self.far.world.follow(now, targets)?;
        }
        let device = DEVICES.iter().position(|port| *port == from);
        self.far.on_frame(now, device, frame, &mut self.wires)?;
        if from == MASTER {
            self.computer.take(now, Received::Echo(*frame));
        } else if self.wires.hears(frame) {
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
        self.computer.receive()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.wires.submit_own(self.now, *frame)
    }

    fn wait(&mut self, until: Time) -> bool {
        self.run_until(until);
        !self.computer.has_taken_all()
    }
}

impl Wires for Simulation {}

impl Place for Simulation {
    const IS_VIRTUAL: bool = true;

    fn sleep_until(&mut self, moment: Time, deadline: Time) {
        self.run_until((moment + self.computer.late(moment)).min(deadline));
    }

    fn begin_cycle(&mut self, grid: Time) -> Process {
        if self.failure.is_some() {
            return Process::Dead;
        }
        self.follow_script(grid);
        self.wires.begin_cycle(grid, self.period);
        let process = self.computer.begin_cycle(self.now, grid);
        if process == Process::Runs {
            self.tell_link_events();
        }
        process
    }

    fn takes_stop(&mut self) -> bool {
        self.computer.takes_stop()
    }

    fn suspended(&self) -> Duration {
        // A period in which it was is told by `begin_cycle`.
        Duration::ZERO
    }

    fn computed(&mut self, outputs: &Outputs) {
        self.target_angles = Some(outputs.signals.target_angles);
        let takes = self.computer.computed();
        if !takes.is_zero() {
            self.computer.fall_asleep();
            self.run_until(self.now + takes);
            self.computer.wake(self.now);
        }
    }

    fn drop_queue(&mut self) {
        self.wires.buses.clear();
    }

    fn truth(&self) -> Option<record::Truth> {
        let world::Truth { tip, velocity, .. } = self.far.world.truth;
        let [left, right] = self.far.drives.each_ref().map(|drive| drive.drive.torque_n_m());
        Some(record::Truth { tool: tip, velocity, torques: JointTorques::new(left, right) })
    }
}
