//! The far end of the buses: the simulated devices and the machine that they are on.

use super::devices;
use super::error::RigError;
use super::line::Line;
use super::world::World;
use yieldwall_config as config;
use yieldwall_drives::cia402;
use yieldwall_fieldbus::canopen::{BusId, Frame, Outbox, cob};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::quantity::JointTorques;
use yieldwall_run::Pace;
use yieldwall_run::assembly::device_buses;
use yieldwall_sim::{AxisView, Drive, ForceSensor};

/// How many devices there are.
pub(super) const DEVICES: usize = 3;
/// Number of the sensor among the devices; the drives are 0 and 1.
pub(super) const SENSOR: usize = 2;

/// Takes what the devices send.
pub(super) trait Wire {
    /// Takes a frame of a device: 0 the left drive, 1 the right drive, 2 the sensor.
    fn submit(&mut self, device: usize, now: Time, frame: Frame);

    /// Takes a frame that can wait, and returns whether there was room for it.
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
    /// Returns the time of the next poll.
    fn next_deadline(&self) -> Time;
}

/// A drive on a joint.
pub(super) trait Actuator: Device {
    /// Sets the motion of the joint of an axis at this moment, in rad and rad/s.
    fn measure(&mut self, axis: usize, angle_rad: f64, rate_rad_per_s: f64);
    /// Returns state and torque of an axis at its joint.
    fn axis(&self, axis: usize) -> AxisView;
}

/// A force sensor at the handle.
pub(super) trait Transducer: Device {
    /// Sets the readings of the channels at this moment, in counts.
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
    fn measure(&mut self, axis: usize, angle_rad: f64, rate_rad_per_s: f64) {
        self.on_axis(axis, |drive| drive.measure(angle_rad, rate_rad_per_s));
    }

    fn axis(&self, axis: usize) -> AxisView {
        Drive::axis(self, axis)
    }
}

impl Transducer for ForceSensor {
    fn measure(&mut self, _now: Time, counts: [i32; 6]) {
        ForceSensor::measure(self, counts);
    }
}

/// A device that is not there.
impl<D: Device> Device for Option<D> {
    fn boot(&mut self, now: Time, out: &mut impl Outbox) {
        if let Some(device) = self {
            device.boot(now, out);
        }
    }

    fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        if let Some(device) = self {
            device.on_frame(now, frame, out);
        }
    }

    fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        if let Some(device) = self {
            device.poll(now, out);
        }
    }

    fn next_deadline(&self) -> Time {
        self.as_ref().map_or(Time::NEVER, Device::next_deadline)
    }
}

impl<D: Actuator> Actuator for Option<D> {
    fn measure(&mut self, axis: usize, angle_rad: f64, rate_rad_per_s: f64) {
        if let Some(drive) = self {
            drive.measure(axis, angle_rad, rate_rad_per_s);
        }
    }

    fn axis(&self, axis: usize) -> AxisView {
        self.as_ref().map(|drive| drive.axis(axis)).unwrap_or_default()
    }
}

impl<S: Transducer> Transducer for Option<S> {
    fn measure(&mut self, now: Time, counts: [i32; 6]) {
        if let Some(sensor) = self {
            sensor.measure(now, counts);
        }
    }
}

/// Two drives, the force sensor, and arm and hand: devices on CAN, and those on a segment.
///
/// The machine is integrated up to each moment at which a device samples it or changes its torque.
#[derive(Debug)]
pub(super) struct FarEnd<D = Option<Drive>, S = Option<ForceSensor>> {
    /// The drives on CAN; of drives that are axes of one device the first one, which is that device.
    pub(super) drives: [D; 2],
    /// The drive and the axis that turn the left and the right joint.
    pub(super) seats: [(usize, usize); 2],
    /// The sensor on CAN.
    pub(super) sensor: S,
    /// The devices on a segment.
    pub(super) line: Option<Line>,
    pub(super) world: World,
    /// The buses of the left drive, the right drive and the sensor.
    pub(super) buses: [BusId; DEVICES],
}

impl FarEnd {
    /// Creates everything switched off, with the arm where the scene's hand starts. Only the segment's devices that are `here` are
    /// on it. Their clocks drift unless a master in lockstep controls them.
    pub(super) fn new(
        rig: &config::Rig,
        scene: &config::Scene,
        seed: u64,
        (here, pace): ([bool; DEVICES], Pace),
    ) -> Result<Self, RigError> {
        let [left, right] = &rig.drives;
        let drive = |drive: &config::Drive, serial| {
            let is_on_can = drive.address.canopen().is_some();
            is_on_can.then(|| devices::drive(rig, scene, drive, serial)).transpose()
        };
        let world = devices::world(rig, scene, seed)?;
        let line = rig.is_on_ethercat().then(|| devices::segment(rig, scene, here, pace)).transpose()?;
        let is_one = rig.has_one_device();
        let [left_axis, right_axis] = devices::axes(rig);
        Ok(Self {
            drives: [drive(left, 1)?, if is_one { None } else { drive(right, 2)? }],
            seats: [(0, left_axis), (usize::from(!is_one), right_axis)],
            sensor: rig.sensor.protocol.position().is_none().then(|| devices::force_sensor(rig)).transpose()?,
            line: line.map(|line| Line::new(line, devices::axes(rig), world.calibration.clone())),
            world,
            buses: device_buses(rig)?,
        })
    }
}

impl<D: Actuator, S: Transducer> FarEnd<D, S> {
    /// Returns the time by which [`FarEnd::poll`] has to be called again.
    pub(super) fn next_deadline(&self) -> Time {
        let [left, right] = &self.drives;
        let on_can = left.next_deadline().min(right.next_deadline()).min(self.sensor.next_deadline());
        on_can.min(self.line.as_ref().map_or(Time::NEVER, Line::next_deadline))
    }

    /// Gives a device its supply, as if it had been off before.
    pub(super) fn switch_on(&mut self, device: usize, now: Time, wire: &mut impl Wire) {
        let plug = &mut Plug { wire, device, now };
        match self.drives.get_mut(device) {
            Some(drive) => drive.boot(now, plug),
            None => self.sensor.boot(now, plug),
        }
        self.line.iter_mut().for_each(|line| line.switch_on(device, now));
    }

    /// Delivers a frame to every device on its bus except its sender.
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

    /// Sends a frame through the segment; when it is back, if it comes back.
    pub(super) fn on_ethernet(&mut self, now: Time, bytes: &mut [u8]) -> Result<Option<Time>, RigError> {
        self.poll_line(now, true)?;
        let back = self.line.as_mut().and_then(|line| line.segment.process(now, bytes));
        self.take_torques(now)?;
        Ok(back)
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
        if self.line.as_ref().is_some_and(|line| line.next_deadline() <= now) {
            self.poll_line(now, false)?;
            self.take_torques(now)?;
        }
        Ok(())
    }

    /// Lets the devices on the segment measure what they have to by now, with a frame that comes or without, and do what is due.
    fn poll_line(&mut self, now: Time, has_frame: bool) -> Result<(), RigError> {
        let Some(line) = &mut self.line else { return Ok(()) };
        let feels = line.feels(now);
        if line.drives_sample(now, has_frame) {
            self.world.settle(now)?;
            self.measure_joints();
        }
        let Some(line) = &mut self.line else { return Ok(()) };
        if feels {
            self.world.settle(now)?;
            line.measure_force(now, self.world.feel(now)?);
        }
        let before = line.sync0_count();
        line.segment.poll(now);
        if line.sync0_count() != before {
            self.world.sample(now)?;
        }
        Ok(())
    }

    /// Makes the devices of a segment measure before anything else happens.
    pub(super) fn begin_segment(&mut self) -> Result<(), RigError> {
        self.measure_joints();
        if let Some(line) = &mut self.line {
            line.measure_force(Time(0), self.world.feel(Time(0))?);
        }
        self.take_torques(Time(0))
    }

    fn feel(&mut self, now: Time) -> Result<(), RigError> {
        let counts = self.world.feel(now)?;
        self.sensor.measure(now, counts);
        Ok(())
    }

    /// Passes the motion of each joint at this moment to its drive.
    pub(super) fn measure_joints(&mut self) {
        let (angles, rates) = self.world.joints();
        let ([left, right], [left_rate, right_rate]) = (angles.to_array(), rates.to_array());
        let motions = [(left, left_rate), (right, right_rate)];
        for ((place, axis), (angle, rate)) in self.seats.into_iter().zip(motions) {
            if let Some(drive) = self.drives.get_mut(place) {
                drive.measure(axis, angle, rate);
            }
        }
        self.line.iter_mut().for_each(|line| line.measure_joints(motions));
    }

    /// Returns state and torque of the drive of a joint: on a segment, or on CAN.
    fn at_joint(&self, joint: usize) -> AxisView {
        match &self.line {
            Some(line) if line.has(joint) => line.at_joint(joint),
            _ => {
                let (place, axis) = self.seats.get(joint).copied().unwrap_or_default();
                self.drives.get(place).map(|drive| drive.axis(axis)).unwrap_or_default()
            }
        }
    }

    /// States of the drives, left and right.
    pub(super) fn drive_states(&self) -> [cia402::State; 2] {
        [0, 1].map(|joint| self.at_joint(joint).state)
    }

    /// Torques of the drives on their joints in N m.
    pub(super) fn torques_n_m(&self) -> [f64; 2] {
        [0, 1].map(|joint| self.at_joint(joint).torque_n_m)
    }

    /// Applies new torques and brakes from now on; the time before is computed with the old ones.
    pub(super) fn take_torques(&mut self, now: Time) -> Result<(), RigError> {
        let [left, right] = [0, 1].map(|joint| self.at_joint(joint));
        let torques = self.world.made_of(JointTorques::new(left.torque_n_m, right.torque_n_m));
        let are_braked = [left.is_braked, right.is_braked];
        if torques != self.world.torques || are_braked != self.world.are_braked {
            self.world.settle(now)?;
            self.world.torques = torques;
            self.world.brake(are_braked);
        }
        Ok(())
    }
}
