//! What happens between the two moments of a cycle, in order of virtual time.

use super::host::Exit;
use super::{DRIVES, EmbeddedRig, MASTER, RigError, SENSOR};
use crate::canopen::{Frame, Time, cob};
use crate::quantity::JointTorques;

impl EmbeddedRig {
    pub(super) fn next_event(&self) -> Time {
        let [left, right] = &self.drives;
        let devices = left.next_deadline().min(right.next_deadline()).min(self.sensor.next_deadline());
        let master = if self.host.is_asleep { Time::NEVER } else { self.master.next_deadline() };
        self.bus.next_event().min(devices).min(master).min(self.troubles.next_held())
    }

    /// Lets everything happen that is due up to `until`, in order of time; of one moment, frames come first.
    pub(super) fn pump(&mut self, until: Time) -> Result<(), RigError> {
        loop {
            let next = self.next_event();
            if next > until {
                break;
            }
            self.now = next;
            while let Some(delivery) = self.bus.advance(next) {
                match self.troubles.pass(next, delivery.from, delivery.frame) {
                    Some(frame) => self.arrive(delivery.time, delivery.from, &frame)?,
                    // Its own controller has sent it all the same.
                    None if delivery.from == MASTER => self.echo(&delivery.frame),
                    None => {}
                }
            }
            while let Some((from, frame)) = self.troubles.take_held(next) {
                self.arrive(next, from, &frame)?;
            }
            self.poll_devices()?;
            if !self.host.is_asleep && self.master.next_deadline() <= next {
                self.master.poll(next, &mut Exit::new(&mut self.bus, &self.troubles, next));
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
        if frame.id() == cob::SYNC {
            self.sample()?;
        }
        for (drive, port) in self.drives.iter_mut().zip(DRIVES) {
            if port != from {
                drive.on_frame(now, frame, &mut self.bus.outbox(port, now));
            }
        }
        if from != SENSOR {
            self.sensor.on_frame(now, frame, &mut self.bus.outbox(SENSOR, now));
        }
        if from == MASTER {
            self.echo(frame);
        } else if self.troubles.hears() {
            if self.host.is_asleep {
                self.host.keep(*frame, false);
            } else {
                self.master.on_frame(now, frame, &mut Exit::new(&mut self.bus, &self.troubles, now));
            }
        }
        self.take_torques()
    }

    /// Gives every device the state of the machine at this moment.
    fn sample(&mut self) -> Result<(), RigError> {
        if let Some(outputs) = &self.last {
            self.world.follow(self.now, outputs.signals.target_angles)?;
        }
        self.world.settle(self.now)?;
        self.feel()?;
        self.measure_joints();
        Ok(())
    }

    fn feel(&mut self) -> Result<(), RigError> {
        let counts = self.world.feel(self.now)?;
        let time_s = self.now.as_secs_f64() - self.world.hand_from_s;
        self.sensor.measure(self.troubles.counts(time_s, counts, &self.world.calibration));
        Ok(())
    }

    fn measure_joints(&mut self) {
        let (angles, rates) = self.world.joints();
        let motions = angles.to_array().into_iter().zip(rates.to_array());
        for (joint, (drive, (angle, rate))) in self.drives.iter_mut().zip(motions).enumerate() {
            let (angle, rate) = self.troubles.encoder(joint, angle, rate);
            drive.measure(angle, rate);
        }
    }

    fn poll_devices(&mut self) -> Result<(), RigError> {
        let now = self.now;
        let [left, right] = &self.drives;
        if left.next_deadline().min(right.next_deadline()) <= now {
            self.world.settle(now)?;
            self.measure_joints();
            for (drive, port) in self.drives.iter_mut().zip(DRIVES) {
                if drive.next_deadline() <= now {
                    drive.poll(now, &mut self.bus.outbox(port, now));
                }
            }
            self.take_torques()?;
        }
        if self.sensor.next_deadline() <= now {
            self.world.settle(now)?;
            self.feel()?;
            self.sensor.poll(now, &mut self.bus.outbox(SENSOR, now));
        }
        Ok(())
    }

    /// New torques act from now on; what was before is settled under the old ones.
    fn take_torques(&mut self) -> Result<(), RigError> {
        let [left, right] = &self.drives;
        let torques = JointTorques::new(
            self.troubles.torque_n_m(0, left.state(), left.torque_n_m()),
            self.troubles.torque_n_m(1, right.state(), right.torque_n_m()),
        );
        if torques != self.world.torques {
            self.world.settle(self.now)?;
            self.world.torques = torques;
        }
        Ok(())
    }
}
