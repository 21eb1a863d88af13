//! What happens between the two moments of a cycle, in order of virtual time.

use super::host::Exit;
use super::{DEVICES, EmbeddedRig, MASTER, RigError, STRANGER};
use crate::canopen::{Frame, Time, cob};
use crate::sim::Drive;

impl EmbeddedRig {
    pub(super) fn next_event(&self) -> Time {
        let master = if self.host.is_asleep { Time::NEVER } else { self.master.next_deadline() };
        self.buses.next_event().min(self.far.next_deadline()).min(master).min(self.troubles.next_held())
    }

    /// Lets everything happen that is due up to `until`, in order of time; of one moment, frames come first.
    pub(super) fn pump(&mut self, until: Time) -> Result<(), RigError> {
        loop {
            let next = self.next_event();
            if next > until {
                break;
            }
            self.now = next;
            while let Some(delivery) = self.buses.advance(next) {
                let passed = self.troubles.pass(next, delivery.from, delivery.frame);
                let passed = match &mut self.silence {
                    Some(silence) if delivery.from == MASTER => passed.and_then(|frame| silence.pass(next, frame)),
                    _ => passed,
                };
                match passed {
                    Some(frame) => self.arrive(delivery.time, delivery.from, &frame)?,
                    // Its own controller has sent it all the same.
                    None if delivery.from == MASTER => self.echo(&delivery.frame),
                    None => {}
                }
            }
            while let Some((from, frame)) = self.troubles.take_held(next) {
                match from {
                    STRANGER => self.buses.submit_foreign(next, frame),
                    _ => self.arrive(next, from, &frame)?,
                }
            }
            self.far.poll(next, &mut self.troubles, &mut self.buses)?;
            if let Some(silence) = &mut self.silence {
                silence.look(next, self.far.drives.each_ref().map(Drive::state));
            }
            if !self.host.is_asleep && self.master.next_deadline() <= next {
                self.master.poll(next, &mut Exit::new(&mut self.buses, &self.troubles, next));
            }
        }
        self.now = until;
        Ok(())
    }

    fn arrive(&mut self, time: Time, from: usize, frame: &Frame) -> Result<(), RigError> {
        if let Some(tap) = &mut self.tap {
            tap(time, frame);
        }
        self.deliver(from, frame)
    }

    fn echo(&mut self, frame: &Frame) {
        if self.host.is_asleep {
            self.host.keep(*frame, true);
        } else {
            self.master.on_echo(frame);
        }
    }

    fn deliver(&mut self, from: usize, frame: &Frame) -> Result<(), RigError> {
        let now = self.now;
        // The joints follow together, at one SYNC of the cycle.
        let is_sync = frame.id() == cob::SYNC && frame.bus() == self.buses.of_device(0);
        if let (true, Some(outputs)) = (is_sync, &self.last) {
            self.far.world.follow(now, outputs.signals.target_angles)?;
        }
        let device = DEVICES.iter().position(|port| *port == from);
        self.far.on_frame(now, device, frame, &mut self.troubles, &mut self.buses)?;
        if from == MASTER {
            self.echo(frame);
        } else if self.troubles.hears(frame.bus()) {
            if self.host.is_asleep {
                self.host.keep(*frame, false);
            } else {
                self.master.on_frame(now, frame, &mut Exit::new(&mut self.buses, &self.troubles, now));
            }
        }
        Ok(())
    }
}
