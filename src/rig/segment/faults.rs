//! Injections on a segment that is served: in its frames, its cables and its devices.

use std::time::Duration;

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use super::super::error::RigError;
use super::super::far_end::{DEVICES, SENSOR};
use super::super::script::Script;
use crate::ethercat::AlStatusCode;
use crate::ethercat::coe::CoeEmergency;
use crate::ethercat::frame::{self, Command, FrameWriter};
use crate::injection::{Injection, Kind, Medium, Target};
use crate::sim::ethercat::{Controller, Segment, SimulatedDevice};
use crate::time::Time;

/// Slack of moments in s, far below a cycle.
const SLACK_S: f64 = 1e-9;
/// Who sends frames that the master has not sent, and the number of their datagram.
const STRANGER: [u8; 6] = [0x02, 0, 0, 0, 0, 0x99];
const STRANGE_INDEX: u8 = 0xee;
/// Voltage of a drive, hardware of a sensor, a warning: error codes of the emergencies of the catalogue.
const VOLTAGE: u16 = 0x3210;
const HARDWARE: u16 = 0x5000;
const WARNING: u16 = 0xff00;
/// Error register of an emergency that is none: a warning has no bit there.
const GENERIC_ERROR: u8 = 1;

/// What is broken on a segment, and what waits for its moment.
#[derive(Debug)]
pub(super) struct Faults {
    script: Script,
    /// What acts on frames.
    on_frames: Vec<Injection>,
    /// Frames that come back later.
    held: Vec<(Time, Vec<u8>)>,
    noise: Xoshiro256PlusPlus,
}

impl Faults {
    /// None. Whatever is random in what follows comes from `seed`.
    pub(super) fn new(seed: u64) -> Self {
        let noise = Xoshiro256PlusPlus::seed_from_u64(seed ^ 0xfa17_0000_0000_0003);
        Self { script: Script::default(), on_frames: Vec::new(), held: Vec::new(), noise }
    }

    pub(super) fn add(&mut self, injection: Injection, places: [Option<usize>; DEVICES]) -> Result<(), RigError> {
        injection.check_on(Medium::Ethercat)?;
        let is_device =
            matches!(injection.target, Target::LeftDrive | Target::RightDrive | Target::Drives | Target::Sensor);
        if is_device && targets(injection.target, places).next().is_none() {
            let (name, target) = (injection.kind.row().name, injection.target.name());
            return Err(RigError::Mismatch(format!("{name}: {target} is not on this segment")));
        }
        self.script.add(injection);
        Ok(())
    }

    /// When an injection begins or ends next.
    pub(super) fn next_change(&self) -> Time {
        let change_s = self.script.next_change_s();
        if change_s.is_finite() { Time((change_s * 1e9).ceil() as u64) } else { Time::NEVER }
    }

    /// When a frame comes back next that was held.
    pub(super) fn next_back(&self) -> Time {
        self.held.iter().map(|(due, _)| *due).min().unwrap_or(Time::NEVER)
    }

    /// Begins and ends what is due.
    pub(super) fn follow_script(
        &mut self,
        now: Time,
        places: [Option<usize>; DEVICES],
        segment: &mut Segment<SimulatedDevice>,
    ) {
        let time_s = now.as_secs_f64() + SLACK_S;
        while let Some(injection) = self.script.take_ending(time_s) {
            self.switch(now, injection, false, places, segment);
        }
        while let Some(injection) = self.script.take_beginning(time_s) {
            self.script.begin(injection);
            self.switch(now, injection, true, places, segment);
        }
    }

    /// Whether a frame reaches the first device.
    pub(super) fn lets_in(&self) -> bool {
        !self.on_frames.iter().any(|injection| injection.kind == Kind::FrameLost)
    }

    /// Hands the frames on that come back by now.
    pub(super) fn send_due(&mut self, now: Time, back: &mut impl FnMut(&[u8])) {
        self.held.retain(|(due, bytes)| {
            let waits = *due > now;
            if !waits {
                back(bytes);
            }
            waits
        });
    }

    /// Hands a frame on that comes back, as what acts on frames lets it.
    pub(super) fn hand_back(&mut self, now: Time, bytes: &mut [u8], back: &mut impl FnMut(&[u8])) {
        let (mut delay, mut is_twice, mut length) = (None, false, bytes.len());
        for injection in &self.on_frames {
            match injection.kind {
                Kind::FrameDelayed => delay = Some(Duration::from_secs_f64(injection.size)),
                Kind::FrameDuplicated => is_twice = true,
                Kind::FrameForeign => strange(back),
                Kind::FrameShort => length = frame::end(bytes).map_or(length, |end| end.saturating_sub(1)),
                Kind::FrameCorrupt => flip(bytes, injection.size as u32, &mut self.noise),
                _ => {}
            }
        }
        let bytes = bytes.get(..length).unwrap_or_default();
        for _ in 0..if is_twice { 2 } else { 1 } {
            match delay {
                Some(delay) => self.held.push((now + delay, bytes.to_vec())),
                None => back(bytes),
            }
        }
    }

    fn switch(
        &mut self,
        now: Time,
        injection: Injection,
        is_on: bool,
        places: [Option<usize>; DEVICES],
        segment: &mut Segment<SimulatedDevice>,
    ) {
        tracing::debug!(name = injection.kind.row().name, target = injection.target.name(), is_on, "injection");
        match (injection.kind, injection.target) {
            (Kind::CableOut, Target::Link) => segment.set_cable(0, !is_on),
            (_, Target::Bus) if is_on => self.on_frames.push(injection),
            (_, Target::Bus) => self.on_frames.retain(|active| *active != injection),
            _ => targets(injection.target, places).for_each(|(device, place)| {
                in_device(now, injection, is_on, (device, place), segment);
            }),
        }
    }
}

/// The devices of a target that are here: their numbers, and their places on the segment.
fn targets(target: Target, places: [Option<usize>; DEVICES]) -> impl Iterator<Item = (usize, usize)> {
    let is_meant = move |device: usize| target.has_joint(device) || target == Target::Sensor && device == SENSOR;
    places
        .into_iter()
        .enumerate()
        .filter_map(move |(device, place)| Some((device, place.filter(|_| is_meant(device))?)))
}

/// Begins an injection in a device, or ends it.
fn in_device(
    now: Time,
    injection: Injection,
    is_on: bool,
    (device, place): (usize, usize),
    segment: &mut Segment<SimulatedDevice>,
) {
    match injection.kind {
        Kind::CableOut => return segment.set_cable(place, !is_on),
        Kind::NodeSilent => return segment.set_power(now, place, !is_on),
        Kind::NodeReset => {
            segment.set_power(now, place, false);
            return segment.set_power(now, place, true);
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
        Kind::EmergencyInSdo => controller.interrupt_request(emergency(device, false)),
        kind => in_application(now, kind, injection.size, is_on, controller),
    }
}

/// The same in what is behind the controller.
fn in_application(now: Time, kind: Kind, size: f64, is_on: bool, controller: &mut Controller<SimulatedDevice>) {
    match controller.device_mut() {
        SimulatedDevice::Drive(drive) => match kind {
            Kind::DriveFault => drive.raise_fault(now, size as u16),
            Kind::DriveLeavesOperation => drive.leave_operation(now),
            Kind::DriveWarning => drive.set_warning(is_on),
            Kind::DriveIgnoresCommand => drive.set_ignores_targets(is_on),
            Kind::DriveNotEnabling => drive.set_ignores_controlword(is_on),
            Kind::VoltageOff => drive.set_voltage(now, !is_on),
            _ => {}
        },
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

/// A frame with the type of EtherCAT that the master has not sent.
fn strange(back: &mut impl FnMut(&[u8])) {
    let mut buffer = [0; frame::SHORTEST];
    let Ok(mut writer) = FrameWriter::new(&mut buffer, STRANGER) else { return };
    if writer.push(Command::Nop, STRANGE_INDEX, 0, &[0; 4]).is_ok() {
        back(writer.finish());
    }
}

/// Flips random bits of the datagrams.
fn flip(bytes: &mut [u8], bits: u32, noise: &mut Xoshiro256PlusPlus) {
    let end = frame::end(bytes).unwrap_or_default();
    let Some(datagrams) = bytes.get_mut(frame::HEADER..end).filter(|datagrams| !datagrams.is_empty()) else { return };
    for _ in 0..bits {
        let bit = noise.next_u64() % (8 * datagrams.len() as u64);
        if let Some(byte) = datagrams.get_mut((bit / 8) as usize) {
            *byte ^= 1 << (bit % 8);
        }
    }
}
