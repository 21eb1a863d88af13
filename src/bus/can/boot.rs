//! The configuration of one node by SDO, as a list of steps.

use crate::bus::error::BootFailure;
use crate::bus::setup::{DriveSetup, MasterSetup, SensorNode};
use crate::canopen::{Frame, NmtCommand, NodeId, Outbox, SdoClient, SdoOutcome, cob};
use crate::objects::AbortCode;
use crate::time::Time;
use std::time::Duration;
use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::objects::{self, Object};
use yieldwall_drives::profiles::{
    DeviceProfile, Entry, HeartbeatWatch, Identity, Pdo, PdoMap, Quantity, Reset, Revisions, Servo, SetPointWatch,
    Setting, SyncWatch, TimeUnit, TimedObject,
};
use yieldwall_drives::watchdog::{HEARTBEAT_PERIODS, WATCHED_CYCLES};

/// Time between two looks at an object that has not come to its value.
const READ_AGAIN: Duration = Duration::from_millis(10);
/// Bytes of the largest object that the boot reads.
const LONGEST: usize = 8;
/// How often a node may restart while it is configured: a node that was switched on together with the master
/// announces itself once more after the reset command.
const RESTARTS: u8 = 3;
/// PDOs of each direction that the master knows of; those that the profile does not name stay as the device has them.
const PDO_COUNT: u8 = 4;

/// One access to one object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// The object has to have this value under the mask.
    Expect { value: u32, mask: u32 },
    /// The product has to be one that the profile is for.
    Product,
    /// The revision has to be one that the profile is for.
    Revision,
    /// The object gets this value.
    Write { value: u32 },
    /// The object gets this value and has to hold it.
    WriteAndVerify { value: u32 },
    /// The object gets this speed in r/min of the motor, by the resolution of its encoder that was read before.
    LimitSpeed { counts_per_s: u32 },
    /// The resolution of the encoder: increments in so many revolutions.
    Resolution { part: usize },
    /// The object has to come to this value within the time that an answer may take.
    Await { value: u32 },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Step {
    pub(super) doing: &'static str,
    pub(super) index: u16,
    pub(super) sub: u8,
    pub(super) bytes: u8,
    pub(super) action: Action,
}

/// The configuration of one node, step by step.
#[derive(Clone, Debug)]
pub(super) struct Boot {
    /// How long the node may take to answer one request.
    timeout: Duration,
    identity: Identity,
    reset: Reset,
    steps: Vec<Step>,
    next: usize,
    verifying: bool,
    /// Increments and revolutions of the encoder, as the drive tells them.
    resolution: [u32; 2],
    /// When the object is read again that has not come to its value yet, and when it is given up.
    again_at: Time,
    given_up_at: Time,
    started: bool,
    restarts: u8,
}

impl Boot {
    pub(super) fn drive(master: &MasterSetup, drive: &DriveSetup, node: NodeId) -> Result<Self, BootFailure> {
        let mode = master.mode.operation_mode();
        let profile = &*drive.profile;
        let (map, servo) = (mapping(profile, Some(mode))?, servo(profile)?);
        let own = &servo.objects;
        let mut steps = identity(profile);
        let mode_bit = Action::Expect { value: mode.supported_bit(), mask: mode.supported_bit() };
        steps.push(step("check the command mode", &own.supported_modes, mode_bit));
        steps.push(heartbeat(drive.heartbeat.as_millis() as u32));
        if let HeartbeatWatch::Consumer(consumer) = &servo.watchdogs.heartbeat {
            let watch_ms = master.heartbeat.as_millis() as u32 * HEARTBEAT_PERIODS;
            let value = u32::from(master.node_id) << 16 | watch_ms;
            steps.push(verify("let the drive watch the master", consumer, value));
        }
        let options = &servo.option_codes;
        let mut set = |doing, settings: &[Setting]| {
            steps.extend(settings.iter().map(|setting| verify(doing, &setting.object, setting.raw())));
        };
        set("set the reaction to a lost master", options.lost_master.as_slice());
        set("set the reaction to a lost master", options.communication_error.as_slice());
        set("set the quick stop", options.quick_stop.as_slice());
        set("set what the profile says", &servo.settings);
        let period_us = master.period.as_micros() as u32;
        if let Some(cycle_time) = &own.cycle_time {
            let (value, exponent) = interpolation_time(period_us).ok_or(BootFailure::CycleTime { period_us })?;
            steps.push(verify("set the cycle time", &cycle_time.value, value));
            steps.push(verify("set the cycle time", &cycle_time.exponent, exponent));
        }
        let mode_code = mode.code() as u8 as u32;
        steps.push(step("set the command mode", &own.mode_of_operation, Action::Write { value: mode_code }));
        // A mode may be taken over some time after it was asked for.
        steps.push(step("check the command mode in force", &own.mode_display, Action::Await { value: mode_code }));
        limits(drive, servo, &mut steps);
        watches(servo, period_us, &mut steps)?;
        let deadline_ms = match servo.watchdogs.set_points {
            SetPointWatch::EventTimer { .. } => rpdo_deadline_ms(period_us),
            SetPointWatch::None | SetPointWatch::BuiltIn(_) | SetPointWatch::Object(_) => 0,
        };
        steps.extend(pdos(profile, map, node, deadline_ms)?);
        Ok(Self::new(profile, drive.waits.sdo, steps))
    }

    pub(super) fn sensor(sensor: &SensorNode, node: NodeId, timeout: Duration) -> Result<Self, BootFailure> {
        let profile = &*sensor.profile;
        let mut steps = identity(profile);
        steps.push(heartbeat(sensor.heartbeat.as_millis() as u32));
        steps.extend(pdos(profile, mapping(profile, None)?, node, 0)?);
        Ok(Self::new(profile, timeout, steps))
    }

    fn new(profile: &DeviceProfile, timeout: Duration, steps: Vec<Step>) -> Self {
        Self {
            timeout,
            identity: profile.identity.clone(),
            reset: profile.node.reset,
            steps,
            next: 0,
            verifying: false,
            resolution: [0; 2],
            again_at: Time::NEVER,
            given_up_at: Time::NEVER,
            started: false,
            restarts: 0,
        }
    }

    /// As it was before anything was sent.
    pub(super) fn reset(&mut self) {
        (self.next, self.verifying, self.started, self.restarts) = (0, false, false, 0);
        (self.again_at, self.given_up_at) = (Time::NEVER, Time::NEVER);
    }

    /// All that it does, in its order, and the identity that it looks for.
    pub(super) fn steps(&self) -> (&[Step], &Identity) {
        (&self.steps, &self.identity)
    }

    /// The command by which the node comes to its power-on values.
    pub(super) fn reset_command(&self) -> NmtCommand {
        match self.reset {
            Reset::Node => NmtCommand::ResetNode,
            Reset::Communication => NmtCommand::ResetCommunication,
        }
    }

    /// What is being done now.
    pub(super) fn doing(&self) -> &'static str {
        self.steps.get(self.next).map_or("start", |step| step.doing)
    }

    pub(super) fn is_done(&self) -> bool {
        self.next >= self.steps.len()
    }

    pub(super) fn next_deadline(&self, client: &SdoClient) -> Time {
        let due = client.next_deadline().min(self.again_at);
        if self.is_done() || !self.started { Time::NEVER } else { due }
    }

    /// Sends the first request.
    pub(super) fn start(
        &mut self,
        now: Time,
        client: &mut SdoClient,
        out: &mut impl Outbox,
    ) -> Result<(), BootFailure> {
        self.started = true;
        self.request(now, client, out)
    }

    /// Begins anew with a node that has restarted: what was written to it is gone.
    pub(super) fn restart(
        &mut self,
        now: Time,
        client: &mut SdoClient,
        out: &mut impl Outbox,
    ) -> Result<(), BootFailure> {
        self.restarts += 1;
        if self.restarts > RESTARTS {
            return Err(BootFailure::Restarted { times: self.restarts });
        }
        client.cancel(out);
        (self.next, self.verifying) = (0, false);
        (self.again_at, self.given_up_at) = (Time::NEVER, Time::NEVER);
        self.start(now, client, out)
    }

    pub(super) fn on_frame(
        &mut self,
        now: Time,
        frame: &Frame,
        client: &mut SdoClient,
        out: &mut impl Outbox,
    ) -> Result<(), BootFailure> {
        match client.on_frame(now, frame, out) {
            Some(outcome) => self.on_outcome(now, outcome, client, out),
            None => Ok(()),
        }
    }

    pub(super) fn poll(&mut self, now: Time, client: &mut SdoClient, out: &mut impl Outbox) -> Result<(), BootFailure> {
        if now >= self.again_at {
            self.again_at = Time::NEVER;
            return self.request(now, client, out);
        }
        match client.poll(now, out) {
            Some(outcome) => self.on_outcome(now, outcome, client, out),
            None => Ok(()),
        }
    }

    fn request(&mut self, now: Time, client: &mut SdoClient, out: &mut impl Outbox) -> Result<(), BootFailure> {
        let Some(step) = self.steps.get_mut(self.next) else { return Ok(()) };
        if let Action::LimitSpeed { counts_per_s } = step.action {
            step.action = Action::WriteAndVerify { value: motor_speed(counts_per_s, self.resolution)? };
        }
        let started = match step.action {
            Action::Write { value } | Action::WriteAndVerify { value } if !self.verifying => {
                let bytes = value.to_le_bytes();
                let data = bytes.get(..usize::from(step.bytes)).unwrap_or(&bytes);
                client.start_download(now, step.index, step.sub, data, out)
            }
            _ => client.start_upload(now, step.index, step.sub, out),
        };
        started.map_err(|_| BootFailure::NoAnswer { index: step.index, sub: step.sub })
    }

    fn on_outcome(
        &mut self,
        now: Time,
        outcome: SdoOutcome,
        client: &mut SdoClient,
        out: &mut impl Outbox,
    ) -> Result<(), BootFailure> {
        let Some(step) = self.steps.get(self.next).copied() else { return Ok(()) };
        let Step { index, sub, .. } = step;
        match outcome {
            SdoOutcome::Aborted { code, .. } => return Err(BootFailure::Refused { index, sub, code }),
            SdoOutcome::TimedOut { .. } => return Err(BootFailure::NoAnswer { index, sub }),
            SdoOutcome::Downloaded { .. } => {
                self.verifying = matches!(step.action, Action::WriteAndVerify { .. });
            }
            SdoOutcome::Uploaded { len, .. } if len > LONGEST => {
                return Err(BootFailure::Refused { index, sub, code: AbortCode::LENGTH });
            }
            SdoOutcome::Uploaded { .. } if self.has_to_wait(now, &step, client.data()) => {
                self.again_at = now + READ_AGAIN;
                return Ok(());
            }
            SdoOutcome::Uploaded { .. } => {
                let received = little_endian(client.data());
                check(&step, received, &self.identity)?;
                if let Action::Resolution { part } = step.action
                    && let Some(known) = self.resolution.get_mut(part)
                {
                    *known = received;
                }
                self.verifying = false;
            }
        }
        if !self.verifying {
            let node = client.node().raw();
            tracing::debug!(node, object = %format_args!("{index:04X}h:{sub}"), "{}: done", step.doing);
            self.next += 1;
            self.given_up_at = Time::NEVER;
        }
        self.request(now, client, out)
    }

    /// Whether the object has not come to its value yet and has time to.
    fn has_to_wait(&mut self, now: Time, step: &Step, data: &[u8]) -> bool {
        let Action::Await { value } = step.action else { return false };
        self.given_up_at = self.given_up_at.min(now + self.timeout);
        little_endian(data) & width_mask(step.bytes) != value && now < self.given_up_at
    }
}

pub(super) fn check(step: &Step, received: u32, identity: &Identity) -> Result<(), BootFailure> {
    let Step { index, sub, .. } = *step;
    let other = |expected: String| {
        Err(BootFailure::Identity { what: step.doing, index, sub, expected: expected.into(), received })
    };
    match step.action {
        Action::Expect { value, mask } if received & mask != value & mask => other(format!("{value:#x}")),
        Action::Product if !identity.product_codes.contains(&received) => {
            other(identity.product_codes.iter().map(|code| format!("{code:#x}")).collect::<Vec<_>>().join(" or "))
        }
        Action::Revision if !identity.revisions.includes(received) => match identity.revisions {
            Revisions::Any => Ok(()),
            Revisions::Range { from, to } => other(format!("{from:#x} to {to:#x}")),
        },
        Action::Await { value: wanted } if received & width_mask(step.bytes) != wanted => {
            Err(BootFailure::Mode { wanted, received })
        }
        // Some devices send more bytes than the object has; its value is in the first ones.
        Action::WriteAndVerify { value: written } if (received ^ written) & width_mask(step.bytes) != 0 => {
            Err(BootFailure::ReadBack { index, sub, written, received })
        }
        _ => Ok(()),
    }
}

/// `counts_per_s` in r/min of the motor, at least 1, for an encoder with that many increments in that many revolutions.
pub(super) fn motor_speed(counts_per_s: u32, resolution: [u32; 2]) -> Result<u32, BootFailure> {
    let [increments, revolutions] = resolution;
    if increments == 0 || revolutions == 0 {
        return Err(BootFailure::Resolution { increments, revolutions });
    }
    let per_minute = 60 * u128::from(counts_per_s) * u128::from(revolutions) / u128::from(increments);
    Ok(u32::try_from(per_minute).unwrap_or(u32::MAX).max(1))
}

fn width_mask(bytes: u8) -> u32 {
    if bytes >= 4 { u32::MAX } else { (1u32 << (8 * bytes)) - 1 }
}

pub(super) fn little_endian(data: &[u8]) -> u32 {
    data.iter().take(4).rev().fold(0, |value, byte| value << 8 | u32::from(*byte))
}

pub(super) fn mapping(profile: &DeviceProfile, mode: Option<OperationMode>) -> Result<&PdoMap, BootFailure> {
    let name = match mode {
        Some(OperationMode::CyclicPosition) => "cyclic synchronous position",
        Some(OperationMode::CyclicVelocity) => "cyclic synchronous velocity",
        Some(OperationMode::CyclicTorque) => "cyclic synchronous torque",
        _ => "a sensor",
    };
    profile.pdos(mode).ok_or_else(|| BootFailure::NoMapping { profile: profile.name().into(), mode: name })
}

fn servo(profile: &DeviceProfile) -> Result<&Servo, BootFailure> {
    profile.servo().ok_or_else(|| BootFailure::Role { profile: profile.name().into(), wanted: "a drive" })
}

fn step(doing: &'static str, entry: &Entry, action: Action) -> Step {
    Step { doing, index: entry.index, sub: entry.sub, bytes: entry.bytes(), action }
}

fn verify(doing: &'static str, entry: &Entry, value: u32) -> Step {
    step(doing, entry, Action::WriteAndVerify { value })
}

/// A step with an object that every device has at the same place.
fn common(doing: &'static str, object: Object, action: Action) -> Step {
    Step { doing, index: object.index, sub: object.sub, bytes: object.bits() / 8, action }
}

fn identity(profile: &DeviceProfile) -> Vec<Step> {
    let expect = |value: u32| Action::Expect { value, mask: u32::MAX };
    let mut steps = vec![
        common("check the device type", objects::DEVICE_TYPE, expect(profile.identity.device_type)),
        common("check the vendor", objects::VENDOR_ID, expect(profile.identity.vendor_id)),
        common("check the product code", objects::PRODUCT_CODE, Action::Product),
    ];
    if profile.identity.revisions != Revisions::Any {
        steps.push(common("check the revision", objects::REVISION, Action::Revision));
    }
    steps
}

fn heartbeat(period_ms: u32) -> Step {
    common("set the heartbeat", objects::PRODUCER_HEARTBEAT, Action::WriteAndVerify { value: period_ms })
}

/// The limits that the drive heeds.
fn limits(drive: &DriveSetup, servo: &Servo, steps: &mut Vec<Step>) {
    if let Some(torque) = &servo.limits.torque {
        steps.push(verify("set the torque limit", torque, u32::from(drive.torque_limit_per_mille)));
    }
    if let Some(speed) = &servo.limits.motor_speed {
        const DOING: &str = "set the speed limit";
        steps.push(step(DOING, &speed.increments, Action::Resolution { part: 0 }));
        steps.push(step(DOING, &speed.revolutions, Action::Resolution { part: 1 }));
        let counts_per_s = drive.speed_limit_counts_per_s;
        steps.push(step(DOING, &speed.limit, Action::LimitSpeed { counts_per_s }));
    }
    if let Some(window) = &servo.limits.following_error {
        steps.push(verify("set the following error window", window, drive.following_error_counts));
    }
}

/// The watchdogs that are set by objects of their own.
fn watches(servo: &Servo, period_us: u32, steps: &mut Vec<Step>) -> Result<(), BootFailure> {
    let after_us = period_us.saturating_mul(WATCHED_CYCLES);
    let mut watch = |doing, timed: &TimedObject| {
        let Entry { index, sub, .. } = timed.object;
        let value = match timed.unit {
            TimeUnit::Us(unit) => after_us.div_ceil(unit.max(1)),
            TimeUnit::Cycles => WATCHED_CYCLES,
        };
        if value > width_mask(timed.object.bytes()) {
            return Err(BootFailure::WatchTime { index, sub, after_us });
        }
        steps.push(verify(doing, &timed.object, value));
        Ok(())
    };
    if let SetPointWatch::Object(timed) = &servo.watchdogs.set_points {
        watch("let the drive watch for set-points", timed)?;
    }
    if let SyncWatch::Object(timed) = &servo.watchdogs.sync {
        watch("let the drive watch for SYNC", timed)?;
    }
    Ok(())
}

/// Milliseconds (14xxh:5) in which at least [`WATCHED_CYCLES`] cycles of `period_us` fit.
fn rpdo_deadline_ms(period_us: u32) -> u32 {
    period_us.saturating_mul(WATCHED_CYCLES).div_ceil(1000)
}

/// 60C2h:1 and :2 for a period: the largest power of ten of a second that divides it. `None` if that leaves more than the
/// one byte of 60C2h:1 holds.
fn interpolation_time(period_us: u32) -> Option<(u32, u32)> {
    let (mut value, mut exponent) = (period_us, -6i8);
    while value % 10 == 0 && value > 0 && exponent < 0 {
        value /= 10;
        exponent += 1;
    }
    (value <= u32::from(u8::MAX)).then_some((value, u32::from(exponent as u8)))
}

/// The remap order of CiA 301: switch the PDO off, clear the mapping, write it, set the type, switch it on.
fn pdos(profile: &DeviceProfile, map: &PdoMap, node: NodeId, rpdo_deadline_ms: u32) -> Result<Vec<Step>, BootFailure> {
    const DOING: &str = "map the process data";
    let mut steps = Vec::new();
    let directions = [(0x1400, 0x1600, &map.rpdo, true), (0x1800, 0x1a00, &map.tpdo, false)];
    for (communication, mapping, used, is_rpdo) in directions {
        let access = |index: u16, sub: u8, bytes: u8, action: Action| Step { doing: DOING, index, sub, bytes, action };
        for number in 1..=PDO_COUNT {
            let Some(pdo) = used.iter().find(|pdo| pdo.number == number) else { continue };
            let offset = u16::from(number) - 1;
            let id = if is_rpdo { cob::rpdo(number, node) } else { cob::tpdo(number, node) };
            // An identifier of 0 would be a network command.
            let id = id.ok_or_else(|| lacking(profile, "an identifier"))?;
            let id = u32::from(id);
            let (comm, map) = (communication + offset, mapping + offset);
            steps.push(access(comm, 1, 4, Action::Write { value: id | cob::INVALID }));
            steps.push(access(map, 0, 1, Action::Write { value: 0 }));
            for (sub, quantity) in (1..).zip(&pdo.maps) {
                let value = mapped(profile, *quantity)?.to_u32();
                steps.push(access(map, sub, 4, Action::WriteAndVerify { value }));
            }
            let entries = pdo.maps.len() as u32;
            steps.push(access(map, 0, 1, Action::WriteAndVerify { value: entries }));
            let transmission = u32::from(pdo.transmission_type);
            steps.push(access(comm, 2, 1, Action::WriteAndVerify { value: transmission }));
            if is_rpdo && rpdo_deadline_ms > 0 {
                steps.push(access(comm, 5, 2, Action::WriteAndVerify { value: rpdo_deadline_ms }));
            }
            steps.push(access(comm, 1, 4, Action::WriteAndVerify { value: id }));
        }
    }
    Ok(steps)
}

/// The object of the device that is meant.
pub(super) fn mapped(profile: &DeviceProfile, quantity: Quantity) -> Result<&Entry, BootFailure> {
    profile.object(quantity).ok_or_else(|| lacking(profile, quantity.word()))
}

pub(super) fn lacking(profile: &DeviceProfile, what: &'static str) -> BootFailure {
    BootFailure::Layout { profile: profile.name().into(), lacking: what }
}

/// The objects of one PDO as the compiled layout wants them.
pub(super) fn layout_entries(profile: &DeviceProfile, pdo: &Pdo) -> Result<Vec<(u16, u8, u8)>, BootFailure> {
    let entry = |quantity: &Quantity| mapped(profile, *quantity).map(|entry| (entry.index, entry.sub, entry.bits));
    pdo.maps.iter().map(entry).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cycle_time_is_written_in_the_largest_fitting_unit() {
        for (period_us, value, exponent) in
            [(1000, 1, -3i8), (4000, 4, -3), (500, 5, -4), (125, 125, -6), (10_000, 1, -2)]
        {
            assert_eq!(interpolation_time(period_us), Some((value, u32::from(exponent as u8))), "{period_us} us");
        }
        // 113 would be its low byte.
        assert_eq!(interpolation_time(625), None);
    }

    #[test]
    fn a_speed_limit_is_told_in_turns_of_the_motor() {
        // 10 000 counts a turn, and 2 500 in 3 turns.
        assert_eq!(motor_speed(10_000, [10_000, 1]), Ok(60));
        assert_eq!(motor_speed(1_000, [2_500, 3]), Ok(72));
        assert_eq!(motor_speed(0, [10_000, 1]), Ok(1));
        assert_eq!(motor_speed(u32::MAX, [1, u32::MAX]), Ok(u32::MAX));
        for resolution in [[0, 1], [10_000, 0]] {
            let failure = motor_speed(10_000, resolution).unwrap_err();
            assert!(failure.to_string().contains("608Fh"), "{failure}");
        }
    }

    #[test]
    fn set_points_may_stay_away_for_five_cycles_whatever_the_cycle() {
        for (period_us, deadline_ms) in [(1000, 5), (2000, 10), (4000, 20), (500, 3), (900, 5), (1900, 10), (100, 1)] {
            assert_eq!(rpdo_deadline_ms(period_us), deadline_ms, "{period_us} us");
        }
    }

    #[test]
    fn remapping_switches_the_pdo_off_first_and_on_last() {
        let node = cob::node_id(1).unwrap();
        let profile = crate::config::shipped_profile("simulated-servo");
        let steps = pdos(&profile, profile.pdos(Some(OperationMode::CyclicTorque)).unwrap(), node, 5).unwrap();
        assert_eq!((steps[0].index, steps[0].sub, steps[0].action), (0x1400, 1, Action::Write { value: 0x8000_0201 }));
        assert_eq!((steps[1].index, steps[1].sub, steps[1].action), (0x1600, 0, Action::Write { value: 0 }));
        assert_eq!(steps[2].action, Action::WriteAndVerify { value: 0x6040_0010 });
        assert_eq!(steps[3].action, Action::WriteAndVerify { value: 0x6071_0010 });
        let last = steps.iter().rposition(|step| step.index == 0x1400).unwrap();
        assert_eq!(steps[last].action, Action::WriteAndVerify { value: 0x201 });
    }
}
