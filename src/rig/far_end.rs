//! The far end of the bus: the simulated devices and the machine that they are on.

use super::devices;
use super::error::RigError;
use super::world::World;
use crate::assembly::device_buses;
use crate::canopen::{BusId, Frame, Outbox, cob};
use crate::config;
use crate::quantity::JointTorques;
use crate::sim::{Drive, ForceSensor};
use crate::time::Time;
use yieldwall_drives::cia402;

/// How many devices there are.
pub(super) const DEVICES: usize = 3;
/// Number of the sensor among the devices; the drives are 0 and 1.
pub(super) const SENSOR: usize = 2;

/// Takes what the devices send.
pub(super) trait Wire {
    /// Takes a frame of a device: 0 the left drive, 1 the right drive, 2 the sensor.
    fn submit(&mut self, device: usize, now: Time, frame: Frame);

    /// The same for a frame that can wait; whether there was room for it.
    fn offer(&mut self, device: usize, now: Time, frame: Frame) -> bool;
}

/// One device's way to the wire.
pub(super) struct Plug<'a, W> {
    pub(super) wire: &'a mut W,
    pub(super) device: usize,
    pub(super) now: Time,
}

impl<W: Wire> Outbox for Plug<'_, W> {
    fn push(&mut self, frame: Frame) {
        self.wire.submit(self.device, self.now, frame);
    }

    fn offer(&mut self, frame: Frame) -> bool {
        self.wire.offer(self.device, self.now, frame)
    }
}

/// A device between bus and machine.
pub(super) trait Device {
    /// Gives it its supply, as if it had been off before.
    fn boot(&mut self, now: Time, out: &mut impl Outbox);
    /// Takes a frame from the bus.
    fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox);
    /// Does what is due.
    fn poll(&mut self, now: Time, out: &mut impl Outbox);
    /// When to poll next.
    fn next_deadline(&self) -> Time;
}

/// A drive on a joint.
pub(super) trait Actuator: Device {
    /// The joint's motion at this moment, in rad and rad/s.
    fn measure(&mut self, angle_rad: f64, rate_rad_per_s: f64);
    /// Torque on the joint, N m.
    fn torque_n_m(&self) -> f64;
    /// State of the state machine.
    fn state(&self) -> cia402::State;
}

/// A force sensor at the handle.
pub(super) trait Transducer: Device {
    /// What the channels read at this moment, in counts.
    fn measure(&mut self, now: Time, counts: [i32; 6]);
}

macro_rules! simulated {
    ($device:ty) => {
        impl Device for $device {
            fn boot(&mut self, now: Time, out: &mut impl Outbox) {
                <$device>::boot(self, now, out);
            }

            fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
                <$device>::on_frame(self, now, frame, out);
            }

            fn poll(&mut self, now: Time, out: &mut impl Outbox) {
                <$device>::poll(self, now, out);
            }

            fn next_deadline(&self) -> Time {
                <$device>::next_deadline(self)
            }
        }
    };
}

simulated!(Drive);
simulated!(ForceSensor);

impl Actuator for Drive {
    fn measure(&mut self, angle_rad: f64, rate_rad_per_s: f64) {
        Drive::measure(self, angle_rad, rate_rad_per_s);
    }

    fn torque_n_m(&self) -> f64 {
        Drive::torque_n_m(self)
    }

    fn state(&self) -> cia402::State {
        Drive::state(self)
    }
}

impl Transducer for ForceSensor {
    fn measure(&mut self, _now: Time, counts: [i32; 6]) {
        ForceSensor::measure(self, counts);
    }
}

/// Two drives, the force sensor, and arm and hand.
///
/// The machine is integrated up to each moment at which a device samples it or changes its torque.
#[derive(Debug)]
pub(super) struct FarEnd<D = Drive, S = ForceSensor> {
    pub(super) drives: [D; 2],
    pub(super) sensor: S,
    pub(super) world: World,
    /// The buses of the left drive, the right drive and the sensor.
    pub(super) buses: [BusId; DEVICES],
}

impl FarEnd {
    /// Everything switched off, the arm where the scene's hand starts.
    pub(super) fn new(rig: &config::Rig, scene: &config::Scene, seed: u64) -> Result<Self, RigError> {
        let [left, right] = &rig.drives;
        Ok(Self {
            drives: [devices::drive(rig, scene, left, 1)?, devices::drive(rig, scene, right, 2)?],
            sensor: devices::force_sensor(rig)?,
            world: devices::world(rig, scene, seed)?,
            buses: device_buses(rig)?,
        })
    }
}

impl<D: Actuator, S: Transducer> FarEnd<D, S> {
    /// When [`FarEnd::poll`] has to be called again at the latest.
    pub(super) fn next_deadline(&self) -> Time {
        let [left, right] = &self.drives;
        left.next_deadline().min(right.next_deadline()).min(self.sensor.next_deadline())
    }

    /// Gives a device its supply, as if it had been off before.
    pub(super) fn switch_on(&mut self, device: usize, now: Time, wire: &mut impl Wire) {
        let plug = &mut Plug { wire, device, now };
        match self.drives.get_mut(device) {
            Some(drive) => drive.boot(now, plug),
            None => self.sensor.boot(now, plug),
        }
    }

    /// Brings a frame to every device on its bus but the one that sent it.
    pub(super) fn on_frame(
        &mut self,
        now: Time,
        from: Option<usize>,
        frame: &Frame,
        wire: &mut impl Wire,
    ) -> Result<(), RigError> {
        if frame.id() == cob::SYNC {
            self.world.settle(now)?;
            self.feel(now)?;
            self.measure_joints();
        }
        let buses = self.buses;
        let hears = |device: usize| from != Some(device) && buses.get(device) == Some(&frame.bus());
        for (device, drive) in self.drives.iter_mut().enumerate().filter(|(device, _)| hears(*device)) {
            drive.on_frame(now, frame, &mut Plug { wire: &mut *wire, device, now });
        }
        if hears(SENSOR) {
            self.sensor.on_frame(now, frame, &mut Plug { wire, device: SENSOR, now });
        }
        self.take_torques(now)
    }

    /// Lets the devices do what is due.
    pub(super) fn poll(&mut self, now: Time, wire: &mut impl Wire) -> Result<(), RigError> {
        let [left, right] = &self.drives;
        if left.next_deadline().min(right.next_deadline()) <= now {
            self.world.settle(now)?;
            self.measure_joints();
            for (device, drive) in self.drives.iter_mut().enumerate() {
                if drive.next_deadline() <= now {
                    drive.poll(now, &mut Plug { wire: &mut *wire, device, now });
                }
            }
            self.take_torques(now)?;
        }
        if self.sensor.next_deadline() <= now {
            self.world.settle(now)?;
            self.feel(now)?;
            self.sensor.poll(now, &mut Plug { wire, device: SENSOR, now });
        }
        Ok(())
    }

    fn feel(&mut self, now: Time) -> Result<(), RigError> {
        let counts = self.world.feel(now)?;
        self.sensor.measure(now, counts);
        Ok(())
    }

    fn measure_joints(&mut self) {
        let (angles, rates) = self.world.joints();
        let motions = angles.to_array().into_iter().zip(rates.to_array());
        for (drive, (angle, rate)) in self.drives.iter_mut().zip(motions) {
            drive.measure(angle, rate);
        }
    }

    /// New torques act from now on; what was before is settled under the old ones.
    fn take_torques(&mut self, now: Time) -> Result<(), RigError> {
        let [left, right] = self.drives.each_ref().map(Actuator::torque_n_m);
        let torques = JointTorques::new(left, right);
        if torques != self.world.torques {
            self.world.settle(now)?;
            self.world.torques = torques;
        }
        Ok(())
    }
}
