//! The profile file of a drive that was tried out.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::eds::Eds;
use yieldwall_drives::esi::AxisSteps;
use yieldwall_drives::objects::{self as cia, Object};

use super::sheet::{contradictions, name as object_name, plain};
use super::{Carrier, MODES, Survey};

/// Longest time to an answer that is written at least, ms.
const LEAST_SDO_MS: u128 = 1000;
/// So many times the longest time that was seen.
const RESERVE: u128 = 10;

/// The profile of a drive as a file, and what it lacks or did not show, a line each.
///
/// The profile gets the name `name`: small letters, digits and dashes. It names the file of a data sheet that was used.
pub fn profile(survey: &Survey, sheet: Option<(&Eds, &str)>, name: &str, version: &str) -> (String, Vec<String>) {
    let missing = missing(survey, sheet.map(|(eds, _)| eds));
    let contradictions = contradictions(sheet.map(|(eds, _)| eds), survey);
    let mut text = String::new();
    let [vendor, product, revision, serial] = survey.identity.map(Option::unwrap_or_default);
    let mut put = |line: &str| {
        // A String takes whatever is written into it.
        let _ = writeln!(text, "{line}");
    };
    put(
        "# Written by `yieldwall drive adopt`: read from the drive and tested in Switch On Disabled, never in Operation Enabled.",
    );
    put("#");
    if missing.is_empty() {
        put("# Nothing is missing.");
    } else {
        put("# Missing, or not testable in that state:");
        missing.iter().for_each(|line| put(&format!("# - {line}")));
    }
    if !contradictions.is_empty() {
        put("# The data sheet differs from the drive here; the profile has the values of the drive:");
        contradictions.iter().for_each(|line| put(&format!("# - {line}")));
    }
    put("profile:");
    put(&format!("  name: {name}"));
    put("  tried: never");
    if survey.is_on_ethercat {
        put("  buses: [ethercat]");
    }
    put("  sources:");
    put(&format!("    device: read from the drive, serial number {serial:08X}h, by yieldwall {version}"));
    if let Some((eds, file)) = sheet {
        let [vendor, product, file] = [eds.device.vendor.as_str(), eds.device.product.as_str(), file].map(plain);
        put(&format!("    eds: \"data sheet {file} of {vendor} {product}, compared with the drive\""));
    }
    put("    cia402: CiA 402, the meaning of a value that the drive accepts");
    put("");
    put("identity:");
    put(&format!("  device_type: 0x{:08x}", survey.device_type));
    put(&format!("  vendor_id: 0x{vendor:08x}"));
    put(&format!("  product_codes: [0x{product:08x}]"));
    match survey.identity[2] {
        Some(_) => put(&format!("  revisions: {{range: {{from: 0x{revision:08x}, to: 0x{revision:08x}}}}}")),
        None => put("  revisions: any"),
    }
    put("");
    put("node:");
    put("  reset: node");
    put("  reset_loses_reference: unknown");
    put("  boot_up_ms: 10000             # not measured");
    let slowest_ms = survey.slowest.as_millis();
    let sdo_ms = (RESERVE * slowest_ms).clamp(LEAST_SDO_MS, 60_000);
    put(&format!("  sdo_ms: {sdo_ms}                  # the slowest answer took {slowest_ms} ms"));
    put("  start_ms: 5000");
    put("");
    put("device:");
    put("  servo:");
    if survey.axes > 1 {
        let steps = survey.axis_steps.map(|AxisSteps { objects, pdos, vendor_objects }| {
            format!(", object_step: 0x{objects:04x}, pdo_step: {pdos}, vendor_object_step: 0x{vendor_objects:04x}")
        });
        let source = if steps.is_some() { "the slots of the device description have" } else { "CiA 402 has" };
        put(&format!("    # Asked of the first axis; the others are taken to lie as {source} them."));
        put(&format!("    axes: {{count: {}{}}}", survey.axes, steps.unwrap_or_default()));
    }
    put("    objects:");
    for (key, object) in [
        ("controlword", cia::CONTROLWORD),
        ("statusword", cia::STATUSWORD),
        ("mode_of_operation", cia::MODE_OF_OPERATION),
        ("mode_display", cia::MODE_DISPLAY),
        ("supported_modes", cia::SUPPORTED_MODES),
        ("position_actual", cia::POSITION_ACTUAL),
    ] {
        put(&format!("      {key}: {}", entry(object)));
    }
    for (key, object, mode) in [
        ("target_position", cia::TARGET_POSITION, OperationMode::CyclicPosition),
        ("target_velocity", cia::TARGET_VELOCITY, OperationMode::CyclicVelocity),
        ("target_torque", cia::TARGET_TORQUE, OperationMode::CyclicTorque),
    ] {
        let has = survey.modes.contains(&mode);
        put(&format!("      {key}: {}", if has { entry(object) } else { "null".to_owned() }));
    }
    match survey.takes_cycle_time {
        true => {
            put("      cycle_time:");
            put(&format!("        value: {}", entry(cia::INTERPOLATION_TIME)));
            put(&format!("        exponent: {}", entry(cia::INTERPOLATION_EXPONENT)));
        }
        false => put("      cycle_time: null"),
    }
    put("    process_data:");
    put(&format!("      mapping_entries: {}", survey.mapping_entries.clamp(1, 64)));
    for ((mode, _), (word, target)) in MODES.into_iter().zip([
        ("torque", "target_torque"),
        ("velocity", "target_velocity"),
        ("position", "target_position"),
    ]) {
        match survey.modes.iter().zip(&survey.rpdos).find(|(known, _)| **known == mode) {
            Some((_, rpdos)) => {
                put(&format!("      {word}:"));
                put(&format!("        rpdo: [{}]", pdos(rpdos, ["controlword", target])));
                put(&format!("        tpdo: [{}]", pdos(&survey.tpdos, ["statusword", "position_actual"])));
            }
            None => put(&format!("      {word}: null")),
        }
    }
    put("    mode_changes_in: [switch_on_disabled]");
    put("    option_codes:");
    let setting = |object: Object, value: Option<i16>| match value {
        Some(value) => format!("{{object: {}, value: {value}}}", entry_of(object, "cia402")),
        None => "null".to_owned(),
    };
    put(&format!("      lost_master: {}", setting(cia::ABORT_CONNECTION_OPTION, survey.lost_master)));
    put(&format!("      communication_error: {}", setting(cia::ERROR_BEHAVIOUR, survey.stops_on_error.then_some(0))));
    put(&format!("      quick_stop: {}", setting(cia::QUICK_STOP_OPTION, survey.takes_quick_stop.then_some(2))));
    put("    settings: []");
    put("    limits:");
    let [has_torque, has_following_error, has_speed] = survey.limits;
    let limit = |has: bool, object: Object| if has { entry(object) } else { "null".to_owned() };
    put(&format!("      torque: {}", limit(has_torque, cia::MAX_TORQUE)));
    match has_speed {
        true => {
            put("      motor_speed:");
            put(&format!("        limit: {}", entry(cia::MAX_MOTOR_SPEED)));
            put(&format!("        increments: {}", entry(cia::ENCODER_INCREMENTS)));
            put(&format!("        revolutions: {}", entry(cia::ENCODER_REVOLUTIONS)));
        }
        false => put("      motor_speed: null"),
    }
    put(&format!("      following_error: {}", limit(has_following_error, cia::FOLLOWING_ERROR_WINDOW)));
    put("    watchdogs:");
    match survey.watches_heartbeat {
        true => {
            put("      heartbeat:");
            put(&format!("        consumer: {}", entry(cia::CONSUMER_HEARTBEAT)));
        }
        false => put("      heartbeat: none"),
    }
    match survey.has_rpdo_timer {
        true => {
            put("      set_points:");
            put(
                "        event_timer: {reaction: unknown, source: device}   # abort_connection (as 6007h says), fault or nothing, by the manual",
            );
        }
        false => put("      set_points: none            # none that shows in Switch On Disabled"),
    }
    put("      sync: none                  # none that shows in Switch On Disabled");
    if let Some(us) = survey.sync1_us {
        put(&format!("    sync1_us: {us}              # by its device description"));
    }
    put(
        "    encoder: {kind: unknown, side: unknown}   # kind: incremental, single_turn or multi_turn; side: motor or joint",
    );
    put("    brake: {held_by: unknown}   # none, drive or output");
    (text, missing)
}

/// PDOs that carry two words.
fn pdos(carriers: &[Carrier], words: [&str; 2]) -> String {
    carriers.iter().map(|carrier| pdo(carrier, words)).collect::<Vec<_>>().join(", ")
}

fn pdo(carrier: &Carrier, words: [&str; 2]) -> String {
    let [first, second] = words;
    match carrier {
        Carrier::Writable => format!("{{number: 1, transmission_type: 1, maps: [{first}, {second}]}}"),
        Carrier::Fixed(pdo) => {
            let maps: Vec<String> = pdo.entries.iter().map(|raw| mapped(*raw, words)).collect();
            format!("{{number: {}, fixed: true, transmission_type: 1, maps: [{}]}}", pdo.number, maps.join(", "))
        }
    }
}

/// An entry of a mapping: one of the words that the mode needs, or nothing to the rig.
fn mapped(raw: u32, words: [&str; 2]) -> String {
    let (index, sub, bits) = (raw >> 16, raw >> 8 & 0xff, raw & 0xff);
    let word = match index as u16 {
        0 => return format!("{{gap: {bits}}}"),
        index if index == cia::CONTROLWORD.index => "controlword",
        index if index == cia::STATUSWORD.index => "statusword",
        index if index == cia::POSITION_ACTUAL.index => "position_actual",
        index if index == cia::TARGET_POSITION.index => "target_position",
        index if index == cia::TARGET_VELOCITY.index => "target_velocity",
        index if index == cia::TARGET_TORQUE.index => "target_torque",
        _ => "",
    };
    match words.contains(&word) {
        true => word.to_owned(),
        false => format!("{{unused: {{index: 0x{index:04x}, sub: {sub}, bits: {bits}}}}}"),
    }
}

fn entry(object: Object) -> String {
    entry_of(object, "device")
}

fn entry_of(object: Object, source: &str) -> String {
    format!("{{index: 0x{:04x}, sub: {}, bits: {}, source: {source}}}", object.index, object.sub, object.bits())
}

/// Outputs that are mapped for good, and that neither the rig nor the boot has a value for: index and sub-index.
fn zeros(survey: &Survey) -> BTreeSet<(u32, u32)> {
    let fixed = survey.rpdos.iter().flatten().filter_map(|carrier| match carrier {
        Carrier::Fixed(pdo) => Some(&pdo.entries),
        Carrier::Writable => None,
    });
    let known = [
        cia::CONTROLWORD,
        cia::MODE_OF_OPERATION,
        cia::TARGET_POSITION,
        cia::TARGET_VELOCITY,
        cia::TARGET_TORQUE,
        cia::MAX_TORQUE,
        cia::FOLLOWING_ERROR_WINDOW,
        cia::INTERPOLATION_TIME,
        cia::INTERPOLATION_EXPONENT,
        cia::QUICK_STOP_OPTION,
        cia::ABORT_CONNECTION_OPTION,
    ];
    let known = known.map(|object| (u32::from(object.index), u32::from(object.sub)));
    let entries = fixed.flatten().map(|raw| (raw >> 16, raw >> 8 & 0xff));
    entries.filter(|entry| entry.0 != 0 && !known.contains(entry)).collect()
}

/// Lists the features that the drive lacks or does not show, and the consequences.
fn missing(survey: &Survey, sheet: Option<&Eds>) -> Vec<String> {
    let mut missing = Vec::new();
    let mut put = |is_missing: bool, text: &str| {
        if is_missing {
            missing.push(text.to_owned());
        }
    };
    let is_on_can = !survey.is_on_ethercat;
    put(is_on_can && !survey.watches_heartbeat, "it does not watch a heartbeat (1016h:1): `run` refuses it");
    put(
        is_on_can && !survey.has_rpdo_timer,
        "no event timer of RPDOs (1400h:5): the drive may notice missing set-points only when the heartbeat times out",
    );
    put(
        survey.has_rpdo_timer,
        "what the drive does when the event timer of an RPDO runs out (`reaction`): assumed nothing. Set abort_connection, fault or \
         nothing by the manual or by the result of `yieldwall drill`",
    );
    put(
        is_on_can,
        "whether it watches SYNC: not testable without process data; assumed no until `yieldwall drill` shows otherwise",
    );
    put(
        survey.lost_master.is_none(),
        "6007h takes none of 1, 2 and 3: this object cannot make it stop when the master is lost",
    );
    put(
        survey.lost_master.is_some_and(|value| value != 3),
        "6007h does not take 3: no quick stop when the master is lost",
    );
    put(
        is_on_can && !survey.stops_on_error,
        "1029h:1 does not take 0: it may stay Operational on a communication error",
    );
    put(!survey.takes_quick_stop, "605Ah does not take 2: the manual has the state after its quick stop");
    let [has_torque, has_following_error, has_speed] = survey.limits;
    put(
        !has_torque,
        "no torque limit (6072h): take the object of a current limit (`limits.current`) from the manual, or confirm the drive's own limit in `commission`",
    );
    put(!has_following_error, "no following error window (6065h)");
    put(!has_speed, "no limit of the motor's speed (6080h with 608Fh)");
    put(!survey.takes_cycle_time, "60C2h does not take 1 ms: see how the drive learns the cycle time");
    put(!survey.follows_sync[0], "its RPDO does not take type 1: set-points do not follow SYNC, which `run` needs");
    put(!survey.follows_sync[1], "its TPDO does not take type 1: positions do not follow SYNC, which `run` needs");
    put(is_on_can && !survey.has_dummies, "no bytes can be skipped in an RPDO; this program skips none");
    put(
        true,
        "whether the encoder keeps its position over power-off and reset: write `encoder: multi_turn` or `single_turn` at the drive in the rig",
    );
    put(true, "what controls the brake, if there is one: set `held_by` of `brake` to none, drive or output");
    for (index, sub) in zeros(survey) {
        missing.push(format!(
            "{index:04X}h:{sub} is mapped, and the rig has no value for it: each cycle sends 0; write its `value` by the manual, above all of a limit"
        ));
    }
    for (mode, reason) in &survey.refused_modes {
        missing.push(format!("{mode:?}: it says it has the mode, but {reason}"));
    }
    for (at, sent, meant) in &survey.lengths {
        missing.push(format!("{at} {} comes with {sent} bytes in place of {meant}", object_name(*at, sheet)));
    }
    missing
}
