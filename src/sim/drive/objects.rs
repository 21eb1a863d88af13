//! The object dictionary of a drive.

use std::collections::BTreeMap;
use std::sync::Arc;

use yieldwall_drives::cia402::OptionCodes;
use yieldwall_drives::objects as cia;
use yieldwall_drives::profiles::{
    AxisOffset, DeviceProfile, Entry, Fieldbus, LimitSetter, Pdo, PdoMap, Quantity, Servo, SetPointWatch, Setting,
    SyncWatch, Unused,
};
use yieldwall_drives::scaling::AxisScaling;

use super::super::device::{DeviceError, commanded, declare, handle, holding, identity, mapping, mark, plain, shown};
use super::{DriveSettings, OddObject};
use yieldwall_fieldbus::canopen::{CanopenError, CommunicationProfile, NodeId, PdoParameters, cob, is_dummy};
use yieldwall_fieldbus::objects::{
    Access, Address, Builder, DictionaryError, Handle, Mappable, Object, ObjectDictionary, load_le,
};

/// Quick stop ramp in rad/s^2 unless the master sets one: from 6 rad/s to rest in 60 ms.
const QUICK_STOP_RAD_PER_S2: f64 = 100.0;
/// Slow-down ramp in rad/s^2 unless the master sets one.
const SLOW_DOWN_RAD_PER_S2: f64 = 20.0;
/// Following error window in rad unless the master sets one, and its time-out in ms.
const FOLLOWING_ERROR_RAD: f64 = 0.1;
const FOLLOWING_ERROR_MS: i64 = 10;
/// Homing unless the master says otherwise: by the present position, or at this speed in rad/s with this acceleration in rad/s^2.
const HOMING_METHOD: i64 = 37;
const HOMING_RAD_PER_S: f64 = 0.05;
const HOMING_RAD_PER_S2: f64 = 0.5;
/// Rated current of a drive that limits its current, and its limit at power-on, mA.
const RATED_CURRENT_MA: u16 = 5000;
/// Speed limit at power-on, r/min of the motor.
const MAX_MOTOR_RPM: i64 = 3000;

macro_rules! handles {
    ($($field:ident: $type:ty = $object:ident,)*) => {
        /// Access to the objects that the device works with.
        #[derive(Clone, Copy, Debug)]
        pub(super) struct Objects {
            $(pub(super) $field: Handle<$type>,)*
        }

        impl Objects {
            pub(super) fn of(od: &ObjectDictionary, offset: AxisOffset) -> Result<Self, DictionaryError> {
                Ok(Objects { $($field: handle(od, of_axis(cia::$object, offset))?,)* })
            }
        }
    };
}

handles! {
    lacks: u8 = SIMULATION_LACKS,
    clock: u8 = SIMULATION_CLOCK,
    abort_connection: i16 = ABORT_CONNECTION_OPTION,
    error_code: u16 = ERROR_CODE,
    controlword: u16 = CONTROLWORD,
    statusword: u16 = STATUSWORD,
    quick_stop: i16 = QUICK_STOP_OPTION,
    shutdown: i16 = SHUTDOWN_OPTION,
    disable_operation: i16 = DISABLE_OPERATION_OPTION,
    halt: i16 = HALT_OPTION,
    fault_reaction: i16 = FAULT_REACTION_OPTION,
    mode: i8 = MODE_OF_OPERATION,
    mode_display: i8 = MODE_DISPLAY,
    position: i32 = POSITION_ACTUAL,
    following_window: u32 = FOLLOWING_ERROR_WINDOW,
    following_timeout: u16 = FOLLOWING_ERROR_TIMEOUT,
    velocity: i32 = VELOCITY_ACTUAL,
    target_torque: i16 = TARGET_TORQUE,
    max_torque: u16 = MAX_TORQUE,
    torque: i16 = TORQUE_ACTUAL,
    target_position: i32 = TARGET_POSITION,
    home_offset: i32 = HOME_OFFSET,
    max_speed: u32 = MAX_MOTOR_SPEED,
    deceleration: u32 = PROFILE_DECELERATION,
    quick_deceleration: u32 = QUICK_STOP_DECELERATION,
    homing_method: i8 = HOMING_METHOD,
    homing_switch_speed: u32 = HOMING_SWITCH_SPEED,
    homing_zero_speed: u32 = HOMING_ZERO_SPEED,
    homing_acceleration: u32 = HOMING_ACCELERATION,
    position_offset: i32 = POSITION_OFFSET,
    velocity_offset: i32 = VELOCITY_OFFSET,
    torque_offset: i16 = TORQUE_OFFSET,
    interpolation_time: u8 = INTERPOLATION_TIME,
    interpolation_exponent: i8 = INTERPOLATION_EXPONENT,
    positive_torque_limit: u16 = POSITIVE_TORQUE_LIMIT,
    negative_torque_limit: u16 = NEGATIVE_TORQUE_LIMIT,
    following_error: i32 = FOLLOWING_ERROR_ACTUAL,
    digital_outputs: u32 = DIGITAL_OUTPUTS,
    digital_output_mask: u32 = DIGITAL_OUTPUT_MASK,
    target_velocity: i32 = TARGET_VELOCITY,
}

/// An object of CiA 402 as that of an axis; those of a simulated device are of all axes.
const fn of_axis(object: cia::Object, offset: AxisOffset) -> cia::Object {
    let is_of_all = object.index >= cia::SIMULATION_LACKS.index && object.index <= cia::SIMULATION_MARK.index;
    if is_of_all { object } else { cia::Object { index: offset.index(object.index), ..object } }
}

/// The dictionary at power-on, with the objects of a bus and of each axis.
pub(super) fn build<'a>(
    axes: impl IntoIterator<Item = (&'a AxisScaling, &'a Servo)>,
    communication: Vec<Object>,
    odd: &[OddObject],
) -> Result<ObjectDictionary, DeviceError> {
    let fixed = |object, value: i64| declare(object, value).access(Access::ReadOnly);
    let mut builder = ObjectDictionary::builder()
        .objects(communication)
        .objects(mark())
        .object(fixed(cia::SIMULATION_LACKS, 0))
        .object(fixed(cia::SIMULATION_CLOCK, 0));
    for (scaling, servo) in axes {
        builder = mapped(of_profile(of_current(with_axis(builder, scaling, servo), servo), servo), servo)?;
    }
    Ok(with_oddities(builder, odd)?.build()?)
}

/// The objects of CiA 402 of one axis.
fn with_axis(builder: Builder, scaling: &AxisScaling, servo: &Servo) -> Builder {
    let counts = |rad: f64| (rad * scaling.counts_per_rad()).round() as i64;
    let options = OptionCodes::default();
    let option = |object, value: i16, lo: i16, hi: i16| declare(object, value.into()).limits(lo, hi);
    let fixed = |object, value: i64| declare(object, value).access(Access::ReadOnly);
    let at = |object| of_axis(object, servo.offset());
    builder
        .object(option(at(cia::ABORT_CONNECTION_OPTION), options.abort_connection, 0, 3))
        .object(shown(at(cia::ERROR_CODE)))
        .object(commanded(at(cia::CONTROLWORD), 0))
        .object(shown(at(cia::STATUSWORD)))
        .object(option(at(cia::QUICK_STOP_OPTION), options.quick_stop, 0, 8))
        .object(option(at(cia::SHUTDOWN_OPTION), options.shutdown, 0, 1))
        .object(option(at(cia::DISABLE_OPERATION_OPTION), options.disable_operation, 0, 1))
        .object(option(at(cia::HALT_OPTION), options.halt, 1, 4))
        .object(option(at(cia::FAULT_REACTION_OPTION), options.fault_reaction, 0, 4))
        .object(commanded(at(cia::MODE_OF_OPERATION), 0))
        .object(shown(at(cia::MODE_DISPLAY)))
        .object(shown(at(cia::POSITION_ACTUAL)))
        .object(declare(at(cia::FOLLOWING_ERROR_WINDOW), counts(FOLLOWING_ERROR_RAD)))
        .object(declare(at(cia::FOLLOWING_ERROR_TIMEOUT), FOLLOWING_ERROR_MS))
        .object(shown(at(cia::VELOCITY_ACTUAL)))
        .object(commanded(at(cia::TARGET_TORQUE), 0))
        .object(commanded(at(cia::MAX_TORQUE), 1000))
        .object(fixed(at(cia::RATED_TORQUE), (scaling.rated_torque_n_m() * 1000.0).round() as i64))
        .object(shown(at(cia::TORQUE_ACTUAL)))
        .object(commanded(at(cia::TARGET_POSITION), 0))
        .object(declare(at(cia::HOME_OFFSET), 0))
        .object(declare(at(cia::MAX_MOTOR_SPEED), MAX_MOTOR_RPM))
        .object(declare(at(cia::PROFILE_DECELERATION), counts(SLOW_DOWN_RAD_PER_S2)))
        .object(declare(at(cia::QUICK_STOP_DECELERATION), counts(QUICK_STOP_RAD_PER_S2)))
        .highest_sub(at(cia::ENCODER_INCREMENTS).index, 2)
        .object(fixed(at(cia::ENCODER_INCREMENTS), counts(std::f64::consts::TAU)))
        .object(fixed(at(cia::ENCODER_REVOLUTIONS), 1))
        .object(declare(at(cia::HOMING_METHOD), HOMING_METHOD))
        .highest_sub(at(cia::HOMING_SWITCH_SPEED).index, 2)
        .object(declare(at(cia::HOMING_SWITCH_SPEED), counts(HOMING_RAD_PER_S)))
        .object(declare(at(cia::HOMING_ZERO_SPEED), counts(HOMING_RAD_PER_S)))
        .object(declare(at(cia::HOMING_ACCELERATION), counts(HOMING_RAD_PER_S2)))
        .object(commanded(at(cia::POSITION_OFFSET), 0))
        .object(commanded(at(cia::VELOCITY_OFFSET), 0))
        .object(commanded(at(cia::TORQUE_OFFSET), 0))
        .highest_sub(at(cia::INTERPOLATION_TIME).index, 2)
        .object(declare(at(cia::INTERPOLATION_TIME), 1).limits(1u8, u8::MAX))
        .object(declare(at(cia::INTERPOLATION_EXPONENT), -3).limits(-6i8, 0))
        .object(declare(at(cia::POSITIVE_TORQUE_LIMIT), 1000))
        .object(declare(at(cia::NEGATIVE_TORQUE_LIMIT), 1000))
        .object(shown(at(cia::FOLLOWING_ERROR_ACTUAL)))
        .highest_sub(at(cia::DIGITAL_OUTPUTS).index, 2)
        .object(commanded(at(cia::DIGITAL_OUTPUTS), 0))
        .object(commanded(at(cia::DIGITAL_OUTPUT_MASK), 0))
        .object(commanded(at(cia::TARGET_VELOCITY), 0))
        .object(fixed(at(cia::SUPPORTED_MODES), servo.supported_modes().into()))
}

/// Objects that the profile maps, and that are nothing to a rig.
fn mapped(mut builder: Builder, servo: &Servo) -> Result<Builder, DeviceError> {
    let maps = servo.process_data.modes().into_iter().filter_map(|mode| mode.3);
    let all = maps.flat_map(|map| map.rpdo.iter().chain(&map.tpdo)).flat_map(|pdo| &pdo.maps);
    let mut unused: Vec<Unused> = all
        .filter_map(|quantity| if let Quantity::Unused(unused) = quantity { Some(*unused) } else { None })
        .filter(|unused| !is_dummy(unused.index))
        .collect();
    unused.sort_by_key(|unused| (unused.index, unused.sub));
    unused.dedup_by_key(|unused| (unused.index, unused.sub));
    for (place, Unused { index, sub, bits, .. }) in unused.iter().copied().enumerate() {
        if builder.has(index, sub) {
            continue;
        }
        if sub > 0 && !builder.has(index, 0) {
            let highest = unused.iter().skip(place).take_while(|other| other.index == index).last();
            builder = builder.highest_sub(index, highest.map_or(sub, |last| last.sub));
        }
        let object = match bits {
            1 => Object::new(index, sub, false),
            8 => Object::new(index, sub, 0u8),
            16 => Object::new(index, sub, 0u16),
            32 => Object::new(index, sub, 0u32),
            64 => Object::new(index, sub, 0u64),
            _ => return Err(DeviceError::Lacks { at: Address::new(index, sub) }),
        };
        builder = builder.object(object.mappable(Mappable::Both));
    }
    Ok(builder)
}

/// The objects of a drive that limits its torque by its current.
fn of_current(builder: Builder, servo: &Servo) -> Builder {
    let Some(current) = &servo.limits.current else { return builder };
    let access = match current.set_by {
        LimitSetter::Master => Access::ReadWrite,
        LimitSetter::Drive => Access::ReadOnly,
    };
    let (limit, rated) = (&current.limit, &current.rated);
    // A record says how many entries it has.
    let highest = if limit.index == rated.index { limit.sub.max(rated.sub) } else { limit.sub };
    let builder = if highest > 0 { builder.highest_sub(limit.index, highest) } else { builder };
    let builder = match rated.sub {
        sub if sub > 0 && limit.index != rated.index => builder.highest_sub(rated.index, sub),
        _ => builder,
    };
    builder
        .object(holding(limit, RATED_CURRENT_MA).access(access))
        .object(holding(rated, RATED_CURRENT_MA).access(Access::ReadOnly))
}

/// Revises the objects that a drive declares otherwise than CiA 402.
fn with_oddities(mut builder: Builder, odd: &[OddObject]) -> Result<Builder, DeviceError> {
    for odd in odd {
        let revise = |object: Object| {
            let raw = odd.holds.map_or_else(|| load_le(object.value()), |value| value as u64);
            let object = object.holding(raw | u64::from(odd.needed_bits));
            let object = if odd.is_read_only { object.access(Access::ReadOnly) } else { object };
            (!odd.is_absent).then_some(object)
        };
        let subs = odd.sub.map_or_else(|| builder.subs(odd.index), |sub| vec![sub]);
        let is_declared = subs.iter().all(|sub| builder.revise(Address::new(odd.index, *sub), revise));
        if subs.is_empty() || !is_declared {
            return Err(DeviceError::Lacks { at: Address::new(odd.index, odd.sub.unwrap_or_default()) });
        }
    }
    Ok(builder)
}

/// The mappings of CANopen that the profile calls fixed.
pub(super) fn fixed_mappings(servo: &Servo) -> Vec<OddObject> {
    let maps = servo.process_data.modes().into_iter().filter_map(|mode| mode.3);
    let all = maps.flat_map(|map| [(0x1600, &map.rpdo), (0x1a00, &map.tpdo)]);
    let fixed =
        all.flat_map(|(first, pdos)| pdos.iter().filter(|pdo| pdo.fixed).map(move |pdo| first + pdo.number() - 1));
    fixed.map(|index: u16| OddObject { index, is_read_only: true, ..OddObject::default() }).collect()
}

/// Bits without which an object is not written.
pub(super) fn needed_bits(odd: &[OddObject]) -> Vec<(Address, u32)> {
    let needs = odd.iter().filter(|odd| odd.needed_bits != 0);
    needs.map(|odd| (Address::new(odd.index, odd.sub.unwrap_or_default()), odd.needed_bits)).collect()
}

/// Adds the objects of a profile beyond CiA 402: those that are set at each start, and those of its watchdogs.
fn of_profile(builder: Builder, servo: &Servo) -> Builder {
    let mut own: Vec<&Entry> = settings(servo).map(|setting| &setting.object).collect();
    if let SetPointWatch::Object(timed) = &servo.watchdogs.set_points {
        own.push(&timed.object);
    }
    if let SyncWatch::Object(timed) = &servo.watchdogs.sync {
        own.push(&timed.object);
    }
    own.sort_by_key(|entry| (entry.index, entry.sub));
    own.dedup_by_key(|entry| (entry.index, entry.sub));
    own.retain(|entry| !builder.has(entry.index, entry.sub));
    // A record says how many entries it has, whether the profile names that one or not.
    let mut highest: BTreeMap<u16, u8> = own.iter().map(|entry| (entry.index, entry.sub)).collect();
    highest
        .retain(|index, _| !builder.has(*index, 0) && !own.iter().any(|entry| (entry.index, entry.sub) == (*index, 0)));
    let named = |index: u16, object: Object| match index == cia::ERROR_BEHAVIOUR.index {
        true => object.named(cia::ERROR_BEHAVIOUR.name),
        false => object,
    };
    let counts = highest.into_iter().map(|(index, most)| named(index, Object::highest_sub(index, most)));
    builder.objects(counts).objects(own.into_iter().map(|entry| named(entry.index, plain(entry))))
}

/// All that is set at each start by the word of the profile.
fn settings(servo: &Servo) -> impl Iterator<Item = &Setting> {
    let options = &servo.option_codes;
    options.lost_master.iter().chain(&options.communication_error).chain(&options.quick_stop).chain(&servo.settings)
}

/// Whether the objects of CiA 402 lie where the simulated drive has them.
pub(super) fn check(servo: &Servo) -> Result<(), DeviceError> {
    let own = &servo.objects;
    let cycle_time = own.cycle_time.as_ref();
    let speed = servo.limits.motor_speed.as_ref();
    let homing = servo.homing.as_ref();
    let brake = servo.brake.of_master();
    let known = [
        (Some(&own.controlword), cia::CONTROLWORD),
        (Some(&own.statusword), cia::STATUSWORD),
        (Some(&own.mode_of_operation), cia::MODE_OF_OPERATION),
        (Some(&own.mode_display), cia::MODE_DISPLAY),
        (Some(&own.supported_modes), cia::SUPPORTED_MODES),
        (Some(&own.position_actual), cia::POSITION_ACTUAL),
        (own.target_position.as_ref(), cia::TARGET_POSITION),
        (own.target_velocity.as_ref(), cia::TARGET_VELOCITY),
        (own.target_torque.as_ref(), cia::TARGET_TORQUE),
        (cycle_time.map(|time| &time.value), cia::INTERPOLATION_TIME),
        (cycle_time.map(|time| &time.exponent), cia::INTERPOLATION_EXPONENT),
        (servo.limits.torque.as_ref(), cia::MAX_TORQUE),
        (servo.limits.following_error.as_ref(), cia::FOLLOWING_ERROR_WINDOW),
        (speed.map(|speed| &speed.limit), cia::MAX_MOTOR_SPEED),
        (speed.map(|speed| &speed.increments), cia::ENCODER_INCREMENTS),
        (speed.map(|speed| &speed.revolutions), cia::ENCODER_REVOLUTIONS),
        (homing.map(|homing| &homing.method), cia::HOMING_METHOD),
        (homing.map(|homing| &homing.switch_speed), cia::HOMING_SWITCH_SPEED),
        (homing.map(|homing| &homing.zero_speed), cia::HOMING_ZERO_SPEED),
        (homing.map(|homing| &homing.acceleration), cia::HOMING_ACCELERATION),
        (homing.map(|homing| &homing.offset), cia::HOME_OFFSET),
        (brake.map(|output| &output.value), cia::DIGITAL_OUTPUTS),
        (brake.map(|output| &output.mask), cia::DIGITAL_OUTPUT_MASK),
    ];
    for (entry, object) in known {
        let Some(&Entry { index, sub, bits, .. }) = entry else { continue };
        if (index, sub, bits) != (object.index, object.sub, object.bits()) {
            let wanted = format!("{:04X}h:{} with {} bits", object.index, object.sub, object.bits());
            let what = object.meaning.split([',', '(']).next().unwrap_or(object.meaning).trim();
            return Err(DeviceError::Elsewhere { what, wanted, index, sub, bits });
        }
    }
    Ok(())
}

/// Returns the CANopen declaration of the drive, with the default PDOs of CiA 402, event-driven. The first pair of the first axis
/// is in use; the others wait for a master.
pub(super) fn communication(
    settings: &DriveSettings,
    models: &[Arc<DeviceProfile>],
) -> Result<Vec<Object>, CanopenError> {
    let mut profile = CommunicationProfile::new(settings.node, &identity(&settings.profile, settings.serial));
    for (axis, model) in models.iter().enumerate() {
        profile = with_pdos(profile, settings.node, axis as u16, model)?;
    }
    profile.objects()
}

/// The default PDOs of an axis.
fn with_pdos(
    profile: CommunicationProfile,
    node: NodeId,
    axis: u16,
    model: &DeviceProfile,
) -> Result<CommunicationProfile, CanopenError> {
    let Some(servo) = model.servo() else { return Ok(profile) };
    let rpdos: [&[cia::Object]; 4] = [
        &[cia::CONTROLWORD],
        &[cia::CONTROLWORD, cia::MODE_OF_OPERATION],
        &[cia::CONTROLWORD, cia::TARGET_POSITION],
        &[cia::CONTROLWORD, cia::TARGET_VELOCITY],
    ];
    let tpdos: [&[cia::Object]; 4] = [
        &[cia::STATUSWORD],
        &[cia::STATUSWORD, cia::MODE_DISPLAY],
        &[cia::STATUSWORD, cia::POSITION_ACTUAL],
        &[cia::STATUSWORD, cia::VELOCITY_ACTUAL],
    ];
    let maps = || servo.process_data.modes().into_iter().filter_map(|mode| mode.3);
    let fixed = |number: u8, pdos: fn(&PdoMap) -> &Vec<Pdo>| {
        let pdo = maps().flat_map(pdos).find(|pdo| pdo.fixed && pdo.canopen_number() == number)?;
        Some(mapping(model, pdo))
    };
    let offset = servo.offset();
    let first = axis * servo.axes.as_ref().map_or(0, |axes| axes.pdo_step_on(Fieldbus::Canopen));
    let parameters = |number: u8, id: Option<u16>, own: Option<Vec<_>>, objects: &[cia::Object]| {
        let usual = || objects.iter().map(|object| (offset.index(object.index), object.sub, object.bits())).collect();
        let mapping = own.unwrap_or_else(usual);
        // Other axes have no default identifiers.
        let id = if axis == 0 { id.ok_or(CanopenError::PdoNumber(number))? } else { 0 };
        let event_driven = PdoParameters::event_driven(id, &mapping);
        Ok::<_, CanopenError>(if (axis, number) == (0, 1) { event_driven } else { event_driven.unused() })
    };
    let mut profile = profile
        .mapping_entries(servo.process_data.mapping_entries)
        // Who watches for set-points otherwise, or not at all, has no such timer.
        .rpdo_timers(matches!(servo.watchdogs.set_points, SetPointWatch::EventTimer { .. }));
    for (place, (rpdo, tpdo)) in (1u8..).zip(rpdos.into_iter().zip(tpdos)) {
        let number = u8::try_from(first + u16::from(place)).map_err(|_| CanopenError::PdoNumber(u8::MAX))?;
        let received = parameters(number, cob::rpdo(place, node), fixed(number, |map| &map.rpdo), rpdo)?;
        let sent = parameters(number, cob::tpdo(place, node), fixed(number, |map| &map.tpdo), tpdo)?;
        profile = profile.rpdo(number, &received).tpdo(number, &sent);
    }
    Ok(profile)
}
