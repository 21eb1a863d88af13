//! The configuration of one device by its objects, as a list of steps: the same on every bus that carries objects.

use crate::error::BootFailure;
use crate::setup::HomingOrder;
use std::time::Duration;
use yieldwall_drives::cia402::{CommandMode, OperationMode};
use yieldwall_drives::objects::{self, Object};
use yieldwall_drives::profiles::{DeviceProfile, Entry, Identity, PdoMap, Quantity, Revisions, Servo, Setting};
use yieldwall_fieldbus::canopen::BusId;
use yieldwall_fieldbus::objects::{AbortCode, Address, ObjectError, ObjectRequest};
use yieldwall_fieldbus::time::Time;

/// Time between two looks at an object that has not come to its value.
const READ_AGAIN: Duration = Duration::from_millis(10);
/// Bytes of the largest object that is read.
const LONGEST: usize = 8;

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
    /// Time in ns that the device takes to copy its outputs before SYNC0; a device may lack it.
    CopyTime,
}

impl Action {
    /// Whether the object gets a value.
    pub(super) fn writes(self) -> bool {
        matches!(self, Action::Write { .. } | Action::WriteAndVerify { .. } | Action::LimitSpeed { .. })
    }

    /// Whether the object is looked at in SAFE-OP.
    pub(super) fn is_late(self) -> bool {
        matches!(self, Action::Await { .. } | Action::CopyTime)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Step {
    pub(super) doing: &'static str,
    pub(super) index: u16,
    pub(super) sub: u8,
    pub(super) bytes: u8,
    pub(super) action: Action,
}

/// The objects of a device that its boot writes, but those that stay as it writes them: of a brake, and the home offset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// The bus that it is on.
    pub bus: BusId,
    /// Its node id, or its position on a segment.
    pub number: u16,
    /// Its name in the rig.
    pub name: String,
    /// Each object once, in the order in which they are first written.
    pub objects: Vec<Address>,
}

/// What stays in a device as the boot has written it: a brake is closed, and a position refers to home by its offset.
const STAYS: [&str; 2] = [CLOSE_THE_BRAKE, SET_HOME];
const CLOSE_THE_BRAKE: &str = "close the brake";
const SET_HOME: &str = "set the home offset";

impl Written {
    pub(super) fn new(bus: BusId, number: u16, name: &str, steps: &[Step]) -> Self {
        let mut objects = Vec::new();
        for step in steps.iter().filter(|step| step.action.writes() && !STAYS.contains(&step.doing)) {
            let at = Address::new(step.index, step.sub);
            if !objects.contains(&at) {
                objects.push(at);
            }
        }
        Self { bus, number, name: name.to_owned(), objects }
    }
}

/// The steps of one device, and how far they have come. What is asked goes to the device by whatever its bus has for that.
#[derive(Clone, Debug)]
pub(super) struct Script {
    /// How long the device may take to answer one request.
    timeout: Duration,
    identity: Identity,
    steps: Vec<Step>,
    next: usize,
    verifying: bool,
    /// Increments and revolutions of the encoder, as the drive tells them.
    resolution: [u32; 2],
    /// Time that it takes to copy its outputs, as the device reports it, in ns.
    copy_ns: u32,
    /// When the object is read again that has not come to its value yet, and when it is given up.
    pub(super) again_at: Time,
    given_up_at: Time,
}

/// What is asked of the device next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    at: Address,
    /// Little-endian bytes to write, and how many of them; none to read.
    written: Option<([u8; 4], u8)>,
}

impl Wanted {
    /// The request.
    pub(super) fn request(&self) -> ObjectRequest<'_> {
        match &self.written {
            Some((bytes, len)) => ObjectRequest::Write(self.at, bytes.get(..usize::from(*len)).unwrap_or(bytes)),
            None => ObjectRequest::Read(self.at),
        }
    }
}

impl Script {
    /// Steps that were not begun.
    pub(super) fn new(identity: Identity, timeout: Duration, steps: Vec<Step>) -> Self {
        Self {
            timeout,
            identity,
            steps,
            next: 0,
            verifying: false,
            resolution: [0; 2],
            copy_ns: 0,
            again_at: Time::NEVER,
            given_up_at: Time::NEVER,
        }
    }

    /// Begins anew.
    pub(super) fn restart(&mut self) {
        (self.next, self.verifying, self.copy_ns) = (0, false, 0);
        (self.again_at, self.given_up_at) = (Time::NEVER, Time::NEVER);
    }

    /// All that it does, in its order, and the identity that it looks for.
    pub(super) fn steps(&self) -> (&[Step], &Identity) {
        (&self.steps, &self.identity)
    }

    /// What is being done now.
    pub(super) fn doing(&self) -> &'static str {
        self.steps.get(self.next).map_or("start", |step| step.doing)
    }

    /// Whether what comes next is to be seen once the device exchanges process data: some show their mode only then.
    pub(super) fn is_late(&self) -> bool {
        self.steps.get(self.next).is_some_and(|step| step.action.is_late())
    }

    /// Time that the device takes to copy its outputs before SYNC0; 0 for one that does not tell it.
    ///
    /// Real-time: yes.
    pub(super) fn copy_time(&self) -> Duration {
        Duration::from_nanos(self.copy_ns.into())
    }

    pub(super) fn is_done(&self) -> bool {
        self.next >= self.steps.len()
    }

    /// What is asked next; nothing when all is done.
    ///
    /// # Errors
    /// If what the device said before does not let the next step be made.
    pub(super) fn wanted(&mut self) -> Result<Option<Wanted>, BootFailure> {
        let Some(step) = self.steps.get_mut(self.next) else { return Ok(None) };
        if let Action::LimitSpeed { counts_per_s } = step.action {
            step.action = Action::WriteAndVerify { value: motor_speed(counts_per_s, self.resolution)? };
        }
        let at = Address::new(step.index, step.sub);
        let written = match step.action {
            Action::Write { value } | Action::WriteAndVerify { value } if !self.verifying => {
                Some((value.to_le_bytes(), step.bytes))
            }
            _ => None,
        };
        Ok(Some(Wanted { at, written }))
    }

    /// Takes the answer to what was asked last: the bytes that were read, none after a write. Afterwards [`Script::wanted`] says what comes
    /// next, unless `again_at` lies ahead.
    ///
    /// # Errors
    /// Why the device cannot be used.
    pub(super) fn on_answer(&mut self, now: Time, answer: Result<&[u8], ObjectError>) -> Result<(), BootFailure> {
        let Some(step) = self.steps.get(self.next).copied() else { return Ok(()) };
        let Step { index, sub, .. } = step;
        let is_write = matches!(step.action, Action::Write { .. } | Action::WriteAndVerify { .. }) && !self.verifying;
        match answer {
            Err(ObjectError::Aborted(_)) if step.action == Action::CopyTime => {}
            Err(ObjectError::Aborted(code)) => return Err(BootFailure::Refused { index, sub, code }),
            Err(_) => return Err(BootFailure::NoAnswer { index, sub }),
            Ok(_) if is_write => self.verifying = matches!(step.action, Action::WriteAndVerify { .. }),
            Ok(data) if data.len() > LONGEST => {
                return Err(BootFailure::Refused { index, sub, code: AbortCode::LENGTH });
            }
            Ok(data) if self.has_to_wait(now, &step, data) => {
                self.again_at = now + READ_AGAIN;
                return Ok(());
            }
            Ok(data) => {
                let received = little_endian(data);
                check(&step, received, &self.identity)?;
                if let Action::Resolution { part } = step.action
                    && let Some(known) = self.resolution.get_mut(part)
                {
                    *known = received;
                }
                if step.action == Action::CopyTime {
                    self.copy_ns = received;
                }
                self.verifying = false;
            }
        }
        if !self.verifying {
            tracing::debug!(object = %Address::new(index, sub), "{}: done", step.doing);
            self.next += 1;
            self.given_up_at = Time::NEVER;
        }
        Ok(())
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

pub(super) fn width_mask(bytes: u8) -> u32 {
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

pub(super) fn servo(profile: &DeviceProfile) -> Result<&Servo, BootFailure> {
    profile.servo().ok_or_else(|| BootFailure::Role { profile: profile.name().into(), wanted: "a drive" })
}

pub(super) fn step(doing: &'static str, entry: &Entry, action: Action) -> Step {
    Step { doing, index: entry.index, sub: entry.sub, bytes: entry.bytes(), action }
}

pub(super) fn verify(doing: &'static str, entry: &Entry, value: u32) -> Step {
    step(doing, entry, Action::WriteAndVerify { value })
}

/// A step with an object that every device has at the same place.
pub(super) fn common(doing: &'static str, object: Object, action: Action) -> Step {
    Step { doing, index: object.index, sub: object.sub, bytes: object.bits() / 8, action }
}

pub(super) fn identity(profile: &DeviceProfile) -> Vec<Step> {
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

/// The limits that the drive heeds: torque in per mille of its rated torque, speed in counts/s, following error in counts.
pub(super) fn limits(servo: &Servo, torque_per_mille: u16, counts_per_s: u32, window: u32, steps: &mut Vec<Step>) {
    if let Some(torque) = &servo.limits.torque {
        steps.push(verify("set the torque limit", torque, u32::from(torque_per_mille)));
    }
    if let Some(speed) = &servo.limits.motor_speed {
        const DOING: &str = "set the speed limit";
        steps.push(step(DOING, &speed.increments, Action::Resolution { part: 0 }));
        steps.push(step(DOING, &speed.revolutions, Action::Resolution { part: 1 }));
        steps.push(step(DOING, &speed.limit, Action::LimitSpeed { counts_per_s }));
    }
    if let Some(object) = &servo.limits.following_error {
        steps.push(verify("set the following error window", object, window));
    }
}

/// That the drive has the mode.
pub(super) fn has_mode(servo: &Servo, mode: OperationMode) -> Step {
    let mode_bit = Action::Expect { value: mode.supported_bit(), mask: mode.supported_bit() };
    step("check the command mode", &servo.objects.supported_modes, mode_bit)
}

/// The mode that a drive is brought up in.
pub(super) fn operation(mode: CommandMode, homing: Option<HomingOrder>) -> OperationMode {
    homing.map_or(mode.operation_mode(), |_| OperationMode::Homing)
}

/// What a drive is told that is to home.
pub(super) fn homing(
    profile: &DeviceProfile,
    servo: &Servo,
    order: Option<HomingOrder>,
    steps: &mut Vec<Step>,
) -> Result<(), BootFailure> {
    let Some(order) = order else { return Ok(()) };
    let homing = servo.homing.as_ref().ok_or_else(|| lacking(profile, "homing"))?;
    steps.push(verify(SET_HOME, &homing.offset, homing.offset_for(order.position_at_home) as u32));
    let mut set = |entry, value| steps.push(verify("set how it homes", entry, value));
    set(&homing.method, u32::from(order.method as u8));
    set(&homing.switch_speed, order.speed_counts_per_s);
    set(&homing.zero_speed, order.speed_counts_per_s);
    set(&homing.acceleration, order.acceleration_counts_per_s2);
    Ok(())
}

/// What the drive does when something is wrong, as far as `reactions` say it, and what else its profile sets.
pub(super) fn settings<'a>(
    servo: &'a Servo,
    lost_master: impl IntoIterator<Item = &'a Setting>,
    steps: &mut Vec<Step>,
) {
    let mut set = |doing, setting: &Setting| steps.push(verify(doing, &setting.object, setting.raw()));
    lost_master.into_iter().for_each(|setting| set("set the reaction to a lost master", setting));
    servo.option_codes.quick_stop.iter().for_each(|setting| set("set the quick stop", setting));
    servo.settings.iter().for_each(|setting| set("set what the profile says", setting));
}

/// The brake that the master holds, closed.
pub(super) fn brake(servo: &Servo, steps: &mut Vec<Step>) {
    if let Some(output) = servo.brake.of_master() {
        steps.push(verify(CLOSE_THE_BRAKE, &output.value, output.word(false)));
        steps.push(verify(CLOSE_THE_BRAKE, &output.mask, output.mask_word()));
    }
}

/// Cycle time and command mode.
pub(super) fn mode(
    servo: &Servo,
    mode: OperationMode,
    period_us: u32,
    steps: &mut Vec<Step>,
) -> Result<(), BootFailure> {
    let own = &servo.objects;
    if let Some(cycle_time) = &own.cycle_time {
        let (value, exponent) = interpolation_time(period_us).ok_or(BootFailure::CycleTime { period_us })?;
        steps.push(verify("set the cycle time", &cycle_time.value, value));
        steps.push(verify("set the cycle time", &cycle_time.exponent, exponent));
    }
    let mode_code = mode.code() as u8 as u32;
    steps.push(step("set the command mode", &own.mode_of_operation, Action::Write { value: mode_code }));
    // A mode may be taken over some time after it was asked for.
    steps.push(step("check the command mode in force", &own.mode_display, Action::Await { value: mode_code }));
    Ok(())
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

/// The object of the device that is meant.
pub(super) fn mapped(profile: &DeviceProfile, quantity: Quantity) -> Result<&Entry, BootFailure> {
    profile.object(quantity).ok_or_else(|| lacking(profile, quantity.word()))
}

pub(super) fn lacking(profile: &DeviceProfile, what: &'static str) -> BootFailure {
    BootFailure::Layout { profile: profile.name().into(), lacking: what }
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
}
