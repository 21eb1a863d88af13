//! The configuration of one device by its objects, as a list of steps: the same on every bus that carries objects.

mod engine;
mod plan;
#[cfg(test)]
mod tests;

use crate::error::BootFailure;
use crate::setup::{HomingOrder, SensorStart};
use yieldwall_drives::cia402::{CommandMode, OperationMode};
use yieldwall_drives::objects::{self, Object};
use yieldwall_drives::profiles::{
    CurrentLimit, DeviceProfile, Entry, Identity, LimitSetter, MappedObject, MappedPdo, Revisions, Scaling, Servo,
    Setting, TorqueLimit,
};
use yieldwall_fieldbus::canopen::BusId;
use yieldwall_fieldbus::objects::Address;

pub(super) use engine::Script;
pub use plan::{PlannedRefusal, PlannedWrite, ScriptPlan};

/// One step of a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// The object has to have this value under the mask.
    Expect { value: u32, mask: u32 },
    /// The product has to be one that the profile is for.
    Product,
    /// The revision has to be one that the profile is for.
    Revision,
    /// A state: the object has to hold this value, except the bits of `kept`. These bits stay as the device has them; if it refuses the
    /// value without them, they are set. The object is written if it holds another value.
    State { value: u32, kept: u32 },
    /// A command: the object is written whatever it holds, since the write itself has an effect, or since the device changes the object by
    /// itself.
    Command { value: u32, is_verified: bool },
    /// The next steps are one state: they are passed if each object holds already what it has in the end.
    Unit { steps: usize },
    /// Within a unit: the object gets this value for the time being, so that others can be written.
    Off { value: u32, kept: u32 },
    /// The object gets this speed in r/min of the motor, by the resolution of its encoder that was read before.
    LimitSpeed { counts_per_s: u32 },
    /// The resolution of the encoder: increments in so many revolutions.
    Resolution { part: usize },
    /// The value of a limit in another unit at which the motor makes its rated torque.
    RatedCurrent,
    /// The object gets a limit of the torque in per mille of rated, in the unit of that value.
    LimitCurrent { per_mille: u16 },
    /// The object, which the drive keeps, allows no more than a torque in per mille of rated.
    KeepsCurrent { per_mille: u16 },
    /// The power of ten of the cycle time, as the drive has it.
    Exponent,
    /// A part of the cycle time, said with that power of ten where it can be.
    CycleTime { period_us: u32, part: CyclePart },
    /// These bits have to be so; a device may lack the object.
    Bits { mask: u32, value: u32 },
    /// The type of synchronisation; a device may lack the object, or set it by itself.
    SyncType { value: u32 },
    /// The object has to come to this value within the time that an answer may take.
    Await { value: u32 },
    /// As [`Action::Await`], for the type of synchronisation, which a device may lack.
    Synchronised { value: u32 },
    /// Time in ns that the device takes to copy its outputs before SYNC0; a device may lack it.
    CopyTime,
    /// Counts per unit of a force sensor, which have to be about those of the rig.
    Scaling { counts: u32 },
}

/// A part of the cycle time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CyclePart {
    /// 60C2h:1.
    Value,
    /// 60C2h:2.
    Exponent,
}

impl Action {
    /// Whether the object may get a value, which a person may want to have put back.
    pub(super) fn writes(self) -> bool {
        let is_computed =
            matches!(self, Action::LimitSpeed { .. } | Action::LimitCurrent { .. } | Action::CycleTime { .. });
        is_computed || self.value().is_some()
    }

    /// Whether the object is looked at in SAFE-OP.
    pub(super) fn is_late(self) -> bool {
        matches!(self, Action::Await { .. } | Action::Synchronised { .. } | Action::CopyTime)
    }

    /// The value that the object gets, if it is known beforehand.
    pub(super) fn value(self) -> Option<u32> {
        match self {
            Action::State { value, .. }
            | Action::Off { value, .. }
            | Action::Command { value, .. }
            | Action::SyncType { value } => Some(value),
            _ => None,
        }
    }

    /// Whether the object is left alone if it holds the value already.
    pub(super) fn is_state(self) -> bool {
        matches!(
            self,
            Action::State { .. }
                | Action::SyncType { .. }
                | Action::LimitSpeed { .. }
                | Action::LimitCurrent { .. }
                | Action::CycleTime { .. }
        )
    }

    /// Bits that stay as the device has them.
    pub(super) fn kept(self) -> u32 {
        match self {
            Action::State { kept, .. } | Action::Off { kept, .. } => kept,
            _ => 0,
        }
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

impl Step {
    /// Its object.
    pub(super) fn at(&self) -> Address {
        Address::new(self.index, self.sub)
    }

    /// Whether the step says what an object of its unit holds in the end.
    pub(super) fn is_part(&self) -> bool {
        matches!(self.action, Action::State { .. } | Action::Expect { .. })
    }

    /// Whether an object that holds this is as the step wants it. Some devices send more bytes than the object has; its value is in the first
    /// ones.
    pub(super) fn is_held(&self, received: u32) -> bool {
        let differs = |value: u32| (received ^ value) & width_mask(self.bytes);
        match self.action {
            Action::Expect { value, mask } => (received ^ value) & mask == 0,
            Action::State { value, kept } => differs(value) & !kept == 0,
            Action::Bits { mask, value } => (received ^ value) & mask == 0,
            Action::Command { value, .. }
            | Action::SyncType { value }
            | Action::Await { value }
            | Action::Synchronised { value } => differs(value) == 0,
            _ => true,
        }
    }
}

/// Objects of a device that its boot may write, except those that keep the boot's value. The exceptions are the objects of a brake,
/// the home offset, the zero of a sensor, and bits that would make a node a producer.
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

/// Steps whose result stays in a device: a brake is closed, a position refers to home by its offset, and a sensor keeps its zero.
const STAYS: [&str; 3] = [CLOSE_THE_BRAKE, SET_HOME, ZERO];
const ZERO: &str = "zero the sensor";
const CLOSE_THE_BRAKE: &str = "close the brake";
const SET_HOME: &str = "set the home offset";

impl Written {
    pub(super) fn new(bus: BusId, number: u16, name: &str, steps: &[Step]) -> Self {
        let mut objects = Vec::new();
        let is_written = |action: Action| action.writes() || matches!(action, Action::Bits { value: 1.., .. });
        for step in steps.iter().filter(|step| is_written(step.action) && !STAYS.contains(&step.doing)) {
            let at = step.at();
            if !objects.contains(&at) {
                objects.push(at);
            }
        }
        Self { bus, number, name: name.to_owned(), objects }
    }
}

pub(super) fn check(step: &Step, received: u32, identity: &Identity) -> Result<(), BootFailure> {
    let Step { index, sub, .. } = *step;
    let other = |expected: String| Err(BootFailure::Identity { index, sub, expected: expected.into(), received });
    match step.action {
        Action::Expect { value, .. } if !step.is_held(received) => other(format!("{value:#x}")),
        Action::Product if !identity.product_codes.contains(&received) => {
            other(identity.product_codes.iter().map(|code| format!("{code:#x}")).collect::<Vec<_>>().join(" or "))
        }
        Action::Revision if !identity.revisions.includes(received) => other(identity.revisions.to_string()),
        Action::Scaling { counts: wanted } => {
            let counts = received & width_mask(step.bytes);
            let agrees = Scaling::agrees(counts, wanted.into());
            if agrees { Ok(()) } else { Err(BootFailure::Scaling { index, sub, counts, wanted }) }
        }
        Action::Await { value: wanted } if !step.is_held(received) => Err(BootFailure::Mode { wanted, received }),
        Action::Synchronised { value: wanted } if !step.is_held(received) => {
            Err(BootFailure::Synchronisation { index, sub, wanted, received })
        }
        _ => Ok(()),
    }
}

/// A torque limit in another unit: its rated value is not 0, and one that the drive keeps allows no more than the rig.
pub(super) fn check_current(step: &Step, received: u32, rated: u32) -> Result<(), BootFailure> {
    let Step { index, sub, .. } = *step;
    let held = received & width_mask(step.bytes);
    match step.action {
        Action::RatedCurrent if held == 0 => Err(BootFailure::NoRating { index, sub }),
        Action::KeepsCurrent { per_mille } if held > CurrentLimit::value(per_mille, rated) => {
            Err(BootFailure::KeepsMore { index, sub, held, most: CurrentLimit::value(per_mille, rated) })
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

fn no_mapping(profile: &DeviceProfile, mode: Option<OperationMode>) -> BootFailure {
    let mode = match mode {
        Some(OperationMode::CyclicPosition) => "cyclic synchronous position",
        Some(OperationMode::CyclicVelocity) => "cyclic synchronous velocity",
        Some(OperationMode::CyclicTorque) => "cyclic synchronous torque",
        _ => "a sensor",
    };
    BootFailure::NoMapping { profile: profile.name().into(), mode }
}

/// The PDOs that a drive in `mode`, or a sensor (`None`), receives and sends.
pub(super) fn pdos(profile: &DeviceProfile, mode: Option<OperationMode>) -> Result<[Vec<MappedPdo>; 2], BootFailure> {
    let map = profile.pdos(mode).ok_or_else(|| no_mapping(profile, mode))?;
    // An object that is left out would have the others at other places.
    let all = map.rpdo.iter().chain(&map.tpdo).flat_map(|pdo| &pdo.maps);
    if let Some(absent) = all.copied().find(|quantity| !profile.maps(*quantity)) {
        return Err(lacking(profile, absent.word()));
    }
    profile.mapped(mode).ok_or_else(|| no_mapping(profile, mode))
}

/// Steps of the boot for a force sensor beside its process data: its counts per unit are those of the rig, and it zeroes itself if it is
/// to.
pub(super) fn sensor(profile: &DeviceProfile, start: &SensorStart) -> Result<Vec<Step>, BootFailure> {
    let wanted = || BootFailure::Role { profile: profile.name().into(), wanted: "a force sensor" };
    let sensor = profile.force_sensor().ok_or_else(wanted)?;
    let mut steps = Vec::new();
    if let Some(Scaling::Objects { per_n, per_n_m }) = &sensor.scaling {
        for (entry, counts) in [per_n, per_n_m].into_iter().zip(start.counts_per_unit) {
            let action = Action::Scaling { counts: counts.round() as u32 };
            steps.push(step("compare its counts per unit", entry, action));
        }
    }
    for setting in sensor.zero.iter().filter(|_| start.zeroes) {
        steps.push(step(ZERO, &setting.object, Action::Command { value: setting.raw(), is_verified: false }));
    }
    Ok(steps)
}

pub(super) fn servo(profile: &DeviceProfile) -> Result<&Servo, BootFailure> {
    profile.servo().ok_or_else(|| BootFailure::Role { profile: profile.name().into(), wanted: "a drive" })
}

pub(super) fn step(doing: &'static str, entry: &Entry, action: Action) -> Step {
    Step { doing, index: entry.index, sub: entry.sub, bytes: entry.bytes(), action }
}

/// A step by which an object comes to hold a value.
pub(super) fn state(doing: &'static str, entry: &Entry, value: u32) -> Step {
    step(doing, entry, Action::State { value, kept: 0 })
}

/// A step that writes an object whatever it holds, and reads it back.
pub(super) fn command(doing: &'static str, entry: &Entry, value: u32) -> Step {
    step(doing, entry, Action::Command { value, is_verified: true })
}

/// Puts what stands before the steps of a unit: they are passed if all their objects hold already what they have in the end.
pub(super) fn unit(steps: Vec<Step>) -> impl Iterator<Item = Step> {
    let first = steps.last().map(|last| Step { action: Action::Unit { steps: steps.len() }, ..*last });
    first.into_iter().chain(steps)
}

const MAP: &str = "map the process data";

/// The steps by which the mapping at an index comes to hold these entries: a unit, so that one that is right stays; a fixed one is compared.
pub(super) fn mapping_steps(index: u16, is_fixed: bool, entries: &[u32]) -> Vec<Step> {
    let step = |sub: u8, action| Step { doing: MAP, index, sub, bytes: if sub == 0 { 1 } else { 4 }, action };
    let wanted = |value| match is_fixed {
        true => Action::Expect { value, mask: u32::MAX },
        false => Action::State { value, kept: 0 },
    };
    let count = step(0, wanted(entries.len() as u32));
    let entries = (1..=u8::MAX).zip(entries).map(|(sub, raw)| step(sub, wanted(*raw)));
    if is_fixed {
        return std::iter::once(count).chain(entries).collect();
    }
    let off = step(0, Action::Off { value: 0, kept: 0 });
    unit(std::iter::once(off).chain(entries).chain([count]).collect()).collect()
}

/// A step with an object that every device has at the same place.
pub(super) fn common(doing: &'static str, object: Object, action: Action) -> Step {
    Step { doing, index: object.index, sub: object.sub, bytes: object.bits() / 8, action }
}

pub(super) fn identity(profile: &DeviceProfile) -> Vec<Step> {
    let expect = |value: u32| Action::Expect { value, mask: u32::MAX };
    let device_type = profile.identity.device_type;
    let mut steps: Vec<Step> = device_type
        .map(|device_type| common("check the device type", objects::DEVICE_TYPE, expect(device_type)))
        .into_iter()
        .collect();
    steps.push(common("check the vendor", objects::VENDOR_ID, expect(profile.identity.vendor_id)));
    steps.push(common("check the product code", objects::PRODUCT_CODE, Action::Product));
    if profile.identity.revisions != Revisions::Any {
        steps.push(common("check the revision", objects::REVISION, Action::Revision));
    }
    steps
}

/// The limits that the drive heeds: torque in per mille of its rated torque, speed in counts/s, following error in counts.
pub(super) fn limits(servo: &Servo, torque_per_mille: u16, counts_per_s: u32, window: u32, steps: &mut Vec<Step>) {
    const TORQUE: &str = "set the torque limit";
    match servo.limits.of_torque() {
        None => {}
        Some(TorqueLimit::PerMille(torque)) => steps.push(state(TORQUE, torque, u32::from(torque_per_mille))),
        Some(TorqueLimit::Current(current)) => {
            let per_mille = torque_per_mille;
            let (doing, action) = match current.set_by {
                LimitSetter::Master => (TORQUE, Action::LimitCurrent { per_mille }),
                LimitSetter::Drive => ("compare its own torque limit", Action::KeepsCurrent { per_mille }),
            };
            steps.push(step(doing, &current.rated, Action::RatedCurrent));
            steps.push(step(doing, &current.limit, action));
        }
    }
    if let Some(speed) = &servo.limits.motor_speed {
        const DOING: &str = "set the speed limit";
        steps.push(step(DOING, &speed.increments, Action::Resolution { part: 0 }));
        steps.push(step(DOING, &speed.revolutions, Action::Resolution { part: 1 }));
        steps.push(step(DOING, &speed.limit, Action::LimitSpeed { counts_per_s }));
    }
    if let Some(object) = &servo.limits.following_error {
        steps.push(state("set the following error window", object, window));
    }
}

/// Adds the steps of another axis of a device. Steps that do the same with an object of the device are there already.
pub(super) fn add_axis(steps: &mut Vec<Step>, axis: Vec<Step>) {
    let new: Vec<Step> = axis.into_iter().filter(|step| !steps.contains(step)).collect();
    steps.extend(new);
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

/// Adds the steps that prepare a drive for homing; without an order it adds none.
pub(super) fn homing(
    profile: &DeviceProfile,
    servo: &Servo,
    order: Option<HomingOrder>,
    steps: &mut Vec<Step>,
) -> Result<(), BootFailure> {
    let Some(order) = order else { return Ok(()) };
    let homing = servo.homing.as_ref().ok_or_else(|| lacking(profile, "homing"))?;
    steps.push(state(SET_HOME, &homing.offset, homing.offset_for(order.position_at_home) as u32));
    let mut set = |entry, value| steps.push(state("set how it homes", entry, value));
    set(&homing.method, u32::from(order.method as u8));
    set(&homing.switch_speed, order.speed_counts_per_s);
    set(&homing.zero_speed, order.speed_counts_per_s);
    set(&homing.acceleration, order.acceleration_counts_per_s2);
    Ok(())
}

/// Adds the steps that set the reaction to a lost master, the quick stop, and the other settings of the profile.
pub(super) fn settings<'a>(
    servo: &'a Servo,
    lost_master: impl IntoIterator<Item = &'a Setting>,
    steps: &mut Vec<Step>,
) {
    let mut set = |doing, setting: &Setting| steps.push(state(doing, &setting.object, setting.raw()));
    lost_master.into_iter().for_each(|setting| set("set the reaction to a lost master", setting));
    servo.option_codes.quick_stop.iter().for_each(|setting| set("set the quick stop", setting));
    servo.settings.iter().for_each(|setting| set("set what the profile says", setting));
}

/// The brake that the master holds, closed.
pub(super) fn brake(servo: &Servo, steps: &mut Vec<Step>) {
    if let Some(output) = servo.brake.of_master() {
        steps.push(command(CLOSE_THE_BRAKE, &output.value, output.word(false)));
        steps.push(command(CLOSE_THE_BRAKE, &output.mask, output.mask_word()));
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
        const DOING: &str = "set the cycle time";
        interpolation_time(period_us).ok_or(BootFailure::CycleTime { period_us })?;
        let part = |part| Action::CycleTime { period_us, part };
        steps.push(step(DOING, &cycle_time.exponent, Action::Exponent));
        steps.push(step(DOING, &cycle_time.value, part(CyclePart::Value)));
        steps.push(step(DOING, &cycle_time.exponent, part(CyclePart::Exponent)));
    }
    let mode_code = mode.code() as u8 as u32;
    let order = Action::Command { value: mode_code, is_verified: false };
    steps.push(step("set the command mode", &own.mode_of_operation, order));
    // A mode may be taken over some time after it was asked for.
    steps.push(step("check the command mode in force", &own.mode_display, Action::Await { value: mode_code }));
    Ok(())
}

/// Returns one part of the cycle time, its value or its exponent, for a drive with this power of ten. If the drive's own exponent can
/// express the period, that exponent stays, and the function returns `None` for it.
pub(super) fn cycle_time(period_us: u32, exponent: Option<i8>, part: CyclePart) -> Result<Option<u32>, BootFailure> {
    if let Some(value) = exponent.and_then(|exponent| in_units(period_us, exponent)) {
        return Ok((part == CyclePart::Value).then_some(value));
    }
    let (value, exponent) = interpolation_time(period_us).ok_or(BootFailure::CycleTime { period_us })?;
    Ok(Some(if part == CyclePart::Value { value } else { exponent }))
}

/// A period in units of this power of ten of a second; `None` if it is no whole number from 1 to 255 of them.
fn in_units(period_us: u32, exponent: i8) -> Option<u32> {
    let (numerator, unit_us) = match i32::from(exponent) + 6 {
        power @ 0.. => (period_us, 10u32.checked_pow(power as u32)?),
        power => (period_us.checked_mul(10u32.checked_pow(power.unsigned_abs())?)?, 1),
    };
    let value = numerator / unit_us;
    (numerator.is_multiple_of(unit_us) && (1..=u32::from(u8::MAX)).contains(&value)).then_some(value)
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

/// The value of an output that is nothing to the rig: the one of the profile, otherwise the one that the boot writes to the object; 0 of any other.
pub(super) fn constant(object: &MappedObject, steps: &[Step]) -> i32 {
    let at = Address::new(object.index, object.sub);
    let written = || steps.iter().rev().filter(|step| step.at() == at).find_map(|step| step.action.value());
    match object.quantity {
        Some(_) => 0,
        None => object.value.or_else(|| written().map(|value| value as i32)).unwrap_or_default(),
    }
}

pub(super) fn lacking(profile: &DeviceProfile, what: &'static str) -> BootFailure {
    BootFailure::Layout { profile: profile.name().into(), lacking: what }
}
