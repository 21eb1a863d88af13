//! The devices of a rig on an EtherCAT segment.

use std::time::Duration;

use super::far_end::{DEVICES, SENSOR};
use super::frame_faults::register_write;
use super::misread::{ForceMisread, JointMisread};
use yieldwall_config::injection::{Injection, Kind};
use yieldwall_drives::watchdog::Clock;
use yieldwall_fieldbus::ethercat::AlStatusCode;
use yieldwall_fieldbus::ethercat::coe::CoeEmergency;
use yieldwall_fieldbus::ethercat::frame::SOURCE;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::sensing::Calibration;
use yieldwall_sim::ethercat::{Controller, EthercatApplication, Segment, SimulatedDevice};
use yieldwall_sim::{AxisView, EthercatDrive, ForceTorqueSensor};

/// Voltage of a drive, hardware of a sensor, a warning: error codes of the emergencies of the catalogue.
const VOLTAGE: u16 = 0x3210;
const HARDWARE: u16 = 0x5000;
const WARNING: u16 = 0x8110;
/// Error register of an emergency that is none: a warning has no bit there.
const GENERIC_ERROR: u8 = 1;

/// A segment with the devices of a rig that are on it, and what is broken in them.
#[derive(Debug)]
pub(super) struct Line {
    pub(super) segment: Segment<SimulatedDevice>,
    /// Places of the left drive, the right drive and the sensor, where they are here.
    places: [Option<usize>; DEVICES],
    /// Axes of their devices that the left and the right drive are.
    axes: [usize; 2],
    joints: [JointMisread; 2],
    force: ForceMisread,
}

impl Line {
    /// Creates a line from a segment, the places of the left drive, the right drive and the sensor on it, the sensor's calibration,
    /// and the drives' axes in their devices.
    pub(super) fn new(
        (segment, places): (Segment<SimulatedDevice>, [Option<usize>; DEVICES]),
        axes: [usize; 2],
        calibration: Calibration,
    ) -> Self {
        Self { segment, places, axes, joints: Default::default(), force: ForceMisread::none(calibration) }
    }

    /// Returns the time of the next poll.
    pub(super) fn next_deadline(&self) -> Time {
        self.segment.next_deadline()
    }

    /// Whether a device is on the segment.
    pub(super) fn has(&self, device: usize) -> bool {
        self.places.get(device).is_some_and(Option::is_some)
    }

    /// Gives a device its supply, as if it had been off before.
    pub(super) fn switch_on(&mut self, device: usize, now: Time) {
        if let Some(place) = self.places.get(device).copied().flatten() {
            self.segment.set_power(now, place, true);
        }
    }

    /// Sets the motion of each joint at this moment, in rad and rad/s.
    pub(super) fn measure_joints(&mut self, motions: [(f64, f64); 2]) {
        let Self { segment, places, axes, joints, .. } = self;
        for (((place, axis), misread), (angle, rate)) in places.iter().zip(axes).zip(joints).zip(motions) {
            if let Some(drive) = device(segment, *place).and_then(SimulatedDevice::drive_mut) {
                let (angle, rate) = misread.motion(angle, rate);
                drive.on_axis(*axis, |drive| drive.measure(angle, rate));
            }
        }
    }

    /// Returns the number of SYNC0 pulses of the left drive.
    pub(super) fn sync0_count(&self) -> u64 {
        self.left().map_or(0, Controller::sync0_count)
    }

    /// Returns the time of the left drive's next SYNC0.
    pub(super) fn next_sync0(&self) -> Time {
        self.left().map_or(Time::NEVER, Controller::next_sync0)
    }

    fn left(&self) -> Option<&Controller<SimulatedDevice>> {
        let [left, ..] = self.places;
        self.segment.controller(left?)
    }

    /// Whether a drive may sample by `now`: what it does is due, or it has no SYNC0 and samples as frames come.
    pub(super) fn drives_sample(&self, now: Time, has_frame: bool) -> bool {
        self.places.iter().take(SENSOR).flatten().filter_map(|place| self.segment.controller(*place)).any(
            |controller| controller.next_deadline() <= now || (has_frame && controller.next_sync0() == Time::NEVER),
        )
    }

    /// Whether the sensor takes a sample by `now`.
    pub(super) fn feels(&mut self, now: Time) -> bool {
        self.sensor_mut().is_some_and(|sensor| sensor.next_deadline() <= now)
    }

    /// Sets the readings of the sensor's channels at this moment, in counts.
    pub(super) fn measure_force(&mut self, now: Time, counts: [i32; 6]) {
        let counts = self.force.counts(now, counts);
        if let Some(sensor) = self.sensor_mut() {
            sensor.measure(counts);
        }
    }

    /// Returns state and torque of a drive at its joint; as of a drive that is switched off if it is not here.
    pub(super) fn at_joint(&self, drive: usize) -> AxisView {
        let controller = self.places.get(drive).copied().flatten().and_then(|place| self.segment.controller(place));
        let device = controller.and_then(|controller| controller.device().drive());
        let is_braked = device.zip(self.axes.get(drive)).is_some_and(|(device, axis)| device.axis(*axis).is_braked);
        let view = self.drive(drive).unwrap_or_default();
        let misread = self.joints.get(drive);
        let torque_n_m = misread.map_or(0.0, |misread| misread.torque_n_m(view.torque_n_m, view.state));
        // One that is switched off makes none, whatever is wrong with it.
        let torque_n_m = if self.drive(drive).is_some() { torque_n_m } else { 0.0 };
        AxisView { torque_n_m, is_braked, ..view }
    }

    /// Sets the time base that the drives report.
    pub(super) fn set_clock(&mut self, clock: Clock) {
        let Self { segment, places, .. } = self;
        for place in places {
            if let Some(drive) = device(segment, *place).and_then(SimulatedDevice::drive_mut) {
                drive.set_clock(clock);
            }
        }
    }

    /// Marks both drives as homed, if their encoders are incremental.
    pub(super) fn refer(&mut self) {
        let Self { segment, places, axes, .. } = self;
        for (place, axis) in places.iter().zip(axes) {
            if let Some(drive) = device(segment, *place).and_then(SimulatedDevice::drive_mut) {
                drive.on_axis(*axis, EthercatDrive::refer);
            }
        }
    }

    /// Stops the drift of all device clocks from now on.
    pub(super) fn stop_drift(&mut self, now: Time) {
        self.segment.controllers_mut().for_each(|controller| controller.set_drift(now, 0));
    }

    /// Takes the drives from OP to SAFE-OP.
    pub(super) fn leave_op(&mut self, now: Time) {
        for place in self.places.into_iter().take(SENSOR).flatten() {
            if let Some(controller) = self.segment.controller_mut(place) {
                controller.fail(now, AlStatusCode(0));
            }
        }
    }

    /// Makes the sensor take its next sample at `next`, and the others at this period.
    pub(super) fn align_sensor(&mut self, next: Time, period: Duration) {
        if let Some(sensor) = self.sensor_mut() {
            sensor.set_clock(next, period);
        }
    }

    /// Sets the time that the drives take to answer a mailbox request.
    pub(super) fn set_mailbox_time(&mut self, time: Duration) {
        for place in self.places.into_iter().take(SENSOR).flatten() {
            if let Some(controller) = self.segment.controller_mut(place) {
                controller.set_mailbox_time(time);
            }
        }
    }

    /// Ends what acts on what devices measure.
    pub(super) fn clear(&mut self) {
        self.joints.iter_mut().for_each(JointMisread::clear);
        self.force.clear();
    }

    /// Begins an injection in the devices of its target, or ends it.
    pub(super) fn switch(&mut self, now: Time, scene_from_s: f64, injection: Injection, is_on: bool) {
        for device in 0..DEVICES {
            let is_meant = injection.target.has_device(device);
            if let Some(place) = self.places.get(device).copied().flatten().filter(|_| is_meant) {
                self.switch_device(now, scene_from_s, injection, is_on, (device, place));
            }
        }
    }

    fn switch_device(
        &mut self,
        now: Time,
        scene_from_s: f64,
        injection: Injection,
        is_on: bool,
        (device, place): (usize, usize),
    ) {
        let (segment, axis) = (&mut self.segment, self.axes.get(device).copied().unwrap_or_default());
        match injection.kind {
            Kind::CableOut => return segment.set_cable(place, !is_on),
            Kind::NodeSilent => return segment.set_power(now, place, !is_on),
            Kind::NodeReset => {
                segment.set_power(now, place, false);
                return segment.set_power(now, place, true);
            }
            Kind::HiddenRegisterWrite => {
                segment.process(now, &mut register_write(SOURCE, place as u16, injection.size));
                return;
            }
            Kind::EncoderJump | Kind::EncoderOffset | Kind::EncoderStuck | Kind::DriveRunaway => {
                return self.joints.iter_mut().skip(device).take(1).for_each(|joint| joint.switch(injection, is_on));
            }
            Kind::SensorStuck | Kind::SensorSaturated | Kind::SensorJump | Kind::SensorDrift => {
                return self.force.switch(scene_from_s, injection, is_on);
            }
            _ => {}
        }
        let Some(controller) = segment.controller_mut(place) else { return };
        match injection.kind {
            Kind::DeviceBypassed => controller.set_silent(is_on),
            Kind::MailboxStuck => controller.set_mailbox_stuck(is_on),
            Kind::DeviceState => controller.fail(now, AlStatusCode(injection.size as u16)),
            Kind::ClockJump => controller.jump_clock(now, injection.size as i64),
            Kind::Emergency => controller.send_emergency(emergency(device, false)),
            Kind::EmergencyWarning => controller.send_emergency(emergency(device, true)),
            Kind::EmergencyInSdo => controller.interrupt_request(is_on.then(|| emergency(device, false))),
            kind => in_application(now, kind, (injection.size, is_on), (controller, axis)),
        }
    }

    /// Returns a drive, if it is here and switched on: 0 the left, 1 the right.
    pub(super) fn drive(&self, drive: usize) -> Option<AxisView> {
        let controller = self.segment.controller(self.places.get(drive).copied().flatten()?)?;
        let device = controller.is_powered().then(|| controller.device().drive())??;
        Some(device.axis(*self.axes.get(drive)?))
    }

    fn sensor_mut(&mut self) -> Option<&mut ForceTorqueSensor> {
        device(&mut self.segment, self.places[SENSOR])?.force_torque_mut()
    }
}

fn device(segment: &mut Segment<SimulatedDevice>, place: Option<usize>) -> Option<&mut SimulatedDevice> {
    Some(segment.controller_mut(place?)?.device_mut())
}

/// Begins an injection in what is behind a controller, or ends it.
fn in_application(
    now: Time,
    kind: Kind,
    (size, is_on): (f64, bool),
    (controller, axis): (&mut Controller<SimulatedDevice>, usize),
) {
    match controller.device_mut() {
        SimulatedDevice::Drive(drive) => drive.on_axis(axis, |drive| match kind {
            Kind::DriveFault => drive.raise_fault(now, size as u16),
            Kind::DriveLeavesOperation => drive.leave_operation(now),
            Kind::DriveWarning => drive.set_warning(is_on),
            Kind::DriveIgnoresCommand => drive.set_ignores_targets(is_on),
            Kind::DriveNotEnabling => drive.set_ignores_controlword(is_on),
            Kind::VoltageOff => drive.set_voltage(now, !is_on),
            _ => {}
        }),
        SimulatedDevice::ForceTorque(sensor) => match kind {
            Kind::SensorInvalid => sensor.set_invalid(is_on),
            Kind::SensorStale => sensor.set_clock_rate(if is_on { 0.0 } else { 1.0 }),
            Kind::SensorClockDrift => sensor.set_clock_rate(if is_on { size } else { 1.0 }),
            _ => {}
        },
        SimulatedDevice::Objects(_) => {}
    }
}

fn emergency(device: usize, is_warning: bool) -> CoeEmergency {
    let (code, register) = match device {
        _ if is_warning => (WARNING, 0),
        SENSOR => (HARDWARE, GENERIC_ERROR),
        _ => (VOLTAGE, GENERIC_ERROR),
    };
    CoeEmergency { code, register, vendor: [0; 5] }
}
