//! The place of the embedded rig: virtual buses and the cable of a segment, simulated devices and the arm under one virtual clock, and the
//! computer that runs the master.

use std::time::Duration;

use super::buses::{DEVICES, MASTER};
use super::cable::Cable;
use super::computer::Computer;
use super::injectable::{InjectableBuses, InjectableDrive, InjectableSensor};
use crate::error::RigError;
use crate::far_end::FarEnd;
use crate::line::Line;
use crate::script::Script;
use crate::silence::Silence;
use crate::world;
use yieldwall_bus::LinkEvent;
use yieldwall_fieldbus::canopen::{BusId, Frame, cob};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{
    Arrival, CanLink, ErrorFrame, EthernetArrival, EthernetReceived, Packet, Received, SendError, Wires,
};
use yieldwall_motion::cycle::Outputs;
use yieldwall_motion::quantity::{JointAngles, JointTorques};
use yieldwall_record as record;
use yieldwall_run::{Place, Process, Tap, Task, VirtualPlace};
use yieldwall_sim::can::Passage;

/// Buses, devices, machine and computer, and what is broken of them.
pub(super) struct Simulation {
    pub(super) wires: InjectableBuses,
    /// Cable of the segment, with the segment's bus.
    pub(super) cable: Option<(BusId, Cable)>,
    pub(super) far: FarEnd<Option<InjectableDrive>, Option<InjectableSensor>>,
    pub(super) computer: Computer,
    pub(super) script: Script,
    pub(super) tap: Option<Tap>,
    /// Frames that a drill keeps from the devices.
    pub(super) silence: Option<Silence>,
    /// True state when the drives on a segment sampled the values that the present cycle reads.
    sampled: Option<world::Truth>,
    period: Duration,
    /// How long before a cycle begins the drives sample what it reads.
    sampled_before: Duration,
    pub(super) now: Time,
    /// Angles that the last cycle commanded: without an arm the joints are there one SYNC later.
    target_angles: Option<JointAngles>,
    /// Why it cannot go on.
    pub(super) failure: Option<RigError>,
}

impl Simulation {
    pub(super) fn new(
        wires: InjectableBuses,
        cable: Option<(BusId, Cable)>,
        far: FarEnd,
        (period, sampled_before): (Duration, Duration),
    ) -> Self {
        let FarEnd { drives, seats, sensor, line, world, buses } = far;
        let drives = drives.map(|drive| drive.map(InjectableDrive::new));
        let sensor = sensor.map(|sensor| InjectableSensor::new(sensor, world.calibration.clone()));
        Self {
            wires,
            cable,
            far: FarEnd { drives, seats, sensor, line, world, buses },
            computer: Computer::default(),
            script: Script::default(),
            tap: None,
            silence: None,
            sampled: None,
            period,
            sampled_before,
            now: Time::default(),
            target_angles: None,
            failure: None,
        }
    }

    /// Returns the time at which the drives sample the values for the cycle that begins at this moment.
    pub(super) fn sampled_for(&self, grid: Time) -> Time {
        let before = self.sampled_before.as_nanos() as u64;
        Time(grid.0.saturating_sub(before))
    }

    /// Returns the next time at which the drives sample the values for the cycle at `grid`: at SYNC0 by their own clock.
    pub(super) fn next_sample(&self, grid: Time) -> Time {
        let sync0 = self.far.line.as_ref().map_or(Time::NEVER, Line::next_sync0);
        if sync0 <= grid { sync0 } else { self.sampled_for(grid) }
    }

    /// Torques in N m that the drives mean to make, which those of drives that run away are not.
    pub(super) fn drive_torques_n_m(&self) -> [f64; 2] {
        let FarEnd { drives, seats, line, .. } = &self.far;
        let torque_n_m = |joint: usize| {
            let (place, axis) = seats.get(joint).copied().unwrap_or_default();
            let on_can = drives.get(place).and_then(Option::as_ref).map(|on_can| on_can.drive.axis(axis));
            let on_segment = || line.as_ref().and_then(|line| line.drive(joint));
            on_can.or_else(on_segment).unwrap_or_default().torque_n_m
        };
        [0, 1].map(torque_n_m)
    }

    /// Begins a boot of the network by the process.
    pub(super) fn begin_boot(&mut self) {
        self.computer.begin_boot();
        self.tell_link_events();
    }

    /// Reports the faults of the master's interfaces.
    fn tell_link_events(&mut self) {
        let Self { wires, computer, now, .. } = self;
        for (bus, event) in wires.link_events() {
            let is_bus_off = event == LinkEvent::BusOff;
            computer.tell(*now, bus, ErrorFrame { is_bus_off, is_error_passive: !is_bus_off, ..ErrorFrame::default() });
        }
    }

    /// Notes what was true of the machine when the drives on a segment sampled it; as the cycle begins, where no SYNC0 has come.
    fn note_sampled(&mut self) {
        let world = &mut self.far.world;
        if world.sampled.is_none() && self.failure.is_none() {
            self.failure = world.settle(self.now).and_then(|()| world.sample(self.now)).err();
        }
        self.sampled = world.sampled.take();
    }

    fn next_event(&self) -> Time {
        let on_cable = self.cable.as_ref().map_or(Time::NEVER, |(_, cable)| cable.next_event());
        self.wires.next_event().min(on_cable).min(self.far.next_deadline())
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
                None if self.pass_cable(next)? => {}
                None => self.far.poll(next, &mut self.wires)?,
            }
            if let Some(silence) = &mut self.silence {
                silence.look(next, self.far.drive_states());
            }
        }
        Ok(())
    }

    /// Passes the next frame that is due on the cable on, and returns whether there was one.
    fn pass_cable(&mut self, now: Time) -> Result<bool, RigError> {
        let Self { cable, far, computer, silence, tap, .. } = self;
        let Some((bus, cable)) = cable else { return Ok(false) };
        let (bus, hears) = (*bus, cable.hears());
        let Cable { outward, inward, faults, .. } = cable;
        faults.send_due(now, &mut |bytes| inward.push(now, bytes));
        let through = outward.take(now, |_, bytes| -> Result<(), RigError> {
            if let Some(tap) = tap {
                tap(now, Packet::Ethernet { bus, bytes });
            }
            if !silence.as_mut().is_none_or(|silence| silence.passes(now, bytes)) {
                return Ok(());
            }
            faults.pass(bytes, |bytes| far.on_ethernet(now, bytes), &mut |back, bytes| inward.push(back, bytes))
        });
        if let Some(through) = through {
            return through.map(|()| true);
        }
        let returned = inward.take(now, |_, bytes| {
            if hears {
                if let Some(tap) = tap {
                    tap(now, Packet::Ethernet { bus, bytes });
                }
                computer.take_ethernet(now, bytes);
            }
        });
        Ok(returned.is_some())
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

impl Wires for Simulation {
    fn receive_ethernet(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
        self.computer.receive_ethernet(|time, bytes| {
            let length = bytes.len().min(buffer.len());
            buffer.get_mut(..length)?.copy_from_slice(bytes.get(..length)?);
            Some(EthernetArrival { time, what: EthernetReceived::Frame { length } })
        })
    }

    fn send_ethernet(&mut self, bytes: &[u8]) -> Result<(), SendError> {
        let Some((_, cable)) = &mut self.cable else { return Err(SendError::Gone) };
        if cable.send(self.now, bytes) { Ok(()) } else { Err(SendError::Down) }
    }
}

impl VirtualPlace for Simulation {}

impl Place for Simulation {
    fn sleep_until(&mut self, moment: Time, deadline: Time) {
        self.run_until((moment + self.computer.late(moment)).min(deadline));
    }

    fn begin_cycle(&mut self, grid: Time) -> Process {
        if self.failure.is_some() {
            return Process::Dead;
        }
        self.follow_script(grid);
        self.wires.begin_cycle(grid, self.period);
        if self.cable.is_some() {
            self.note_sampled();
        }
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
        self.cable.iter_mut().for_each(|(_, cable)| cable.outward.clear());
    }

    fn attend(&mut self, task: Task) -> bool {
        let led = match task {
            Task::Pull(force) => {
                self.far.world.weight = force;
                Ok(())
            }
            Task::LeadTo(_, point) => self.far.world.put(point),
        };
        self.failure = self.failure.take().or(led.err());
        self.failure.is_none()
    }

    fn power_cycle(&mut self) -> bool {
        for drive in 0..2 {
            self.far.switch_on(drive, self.now, &mut self.wires);
        }
        true
    }

    fn seen_angles(&self) -> Option<JointAngles> {
        Some(self.far.world.seen_angles())
    }

    fn truth(&self) -> Option<record::Truth> {
        let world::Truth { tip, velocity, .. } = self.sampled.unwrap_or(self.far.world.truth);
        let [left, right] = self.drive_torques_n_m();
        Some(record::Truth { tool: tip, velocity, torques: JointTorques::new(left, right) })
    }
}
