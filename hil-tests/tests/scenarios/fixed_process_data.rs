//! Drives on EtherCAT with process data of their own: what they carry beside the words of the rig, gaps, single bits, several PDOs, and SYNC1. Each is
//! booted and run by its profile alone.

use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;

use yieldwall::bus::BootFailure;
use yieldwall::config::{Loaded, Rig, Source, load_rig};
use yieldwall::guard::{Request, State};
use yieldwall::rig::{EmbeddedRig, RigError};

const RIG: &str = include_str!("../../../config/vendors/ethercat-fixed-assignment.yaml");
const PROFILE: &str = include_str!("../../../config/vendors/profiles/ethercat-fixed-assignment.yaml");

/// A drive: the mode of the rig, its RPDOs and TPDOs, and what its clock makes beside SYNC0.
struct Drive {
    mode: &'static str,
    rpdo: &'static str,
    tpdo: &'static str,
    clock: &'static str,
}

const fn drive(mode: &'static str, rpdo: &'static str, tpdo: &'static str, clock: &'static str) -> Drive {
    Drive { mode, rpdo, tpdo, clock }
}

const PLAIN_INPUTS: &str = "{number: 1, fixed: true, transmission_type: 1, maps: [statusword, position_actual]}";
const LONG_INPUTS: &str = "{number: 0x102, fixed: true, transmission_type: 1, maps: [{unused: {index: 0x603f, sub: 0, bits: 16}}, statusword, \
                           position_actual, {unused: {index: 0x6077, sub: 0, bits: 16}}, {unused: {index: 0x60f4, sub: 0, bits: 32}}, {unused: \
                           {index: 0x60b9, sub: 0, bits: 16}}, {unused: {index: 0x60ba, sub: 0, bits: 32}}, {unused: {index: 0x60fd, sub: 0, \
                           bits: 32}}]}";
const ALL_TARGETS: &str = "{unused: {index: 0x6060, sub: 0, bits: 8}}, {unused: {index: 0x60b8, sub: 0, bits: 16}}, {unused: {index: 0x2101, sub: \
                           0, bits: 32, value: -7}}";

fn drives() -> Vec<Drive> {
    let all = |set_point: &str, others: [&str; 2]| -> &'static str {
        let others = others.map(|object| format!("{{unused: {{index: {object}}}}}")).join(", ");
        format!("{{number: 0x103, fixed: true, transmission_type: 1, maps: [controlword, {others}, {set_point}, {ALL_TARGETS}]}}").leak()
    };
    let (position, velocity, torque) =
        ("0x607a, sub: 0, bits: 32", "0x60ff, sub: 0, bits: 32", "0x6071, sub: 0, bits: 16");
    vec![
        drive(
            "position",
            "{number: 1, fixed: true, transmission_type: 1, maps: [controlword, target_position]}",
            PLAIN_INPUTS,
            "",
        ),
        drive(
            "position",
            "{number: 0x102, fixed: true, transmission_type: 1, maps: [controlword, target_position, {unused: {index: 0x60b8, sub: 0, bits: 16}}, \
             {unused: {index: 0x60fe, sub: 1, bits: 32}}]}",
            LONG_INPUTS,
            "",
        ),
        drive("position", all("target_position", [velocity, torque]), LONG_INPUTS, ""),
        drive("velocity", all("target_velocity", [position, torque]), LONG_INPUTS, ""),
        drive("torque", all("target_torque", [position, velocity]), PLAIN_INPUTS, ""),
        // A byte and its filling in front of the target.
        drive(
            "position",
            "{number: 1, fixed: true, transmission_type: 1, maps: [controlword, {unused: {index: 0x6060, sub: 0, bits: 8}}, {gap: 8}, \
             target_position]}",
            "{number: 1, fixed: true, transmission_type: 1, maps: [statusword, {unused: {index: 0x6061, sub: 0, bits: 8}}, {gap: 8}, \
             position_actual]}",
            "",
        ),
        // Controlword and target in PDOs of their own.
        drive(
            "position",
            "{number: 1, fixed: true, transmission_type: 1, maps: [controlword]}, {number: 6, fixed: true, transmission_type: 1, maps: \
             [target_position]}",
            "{number: 1, fixed: true, transmission_type: 1, maps: [statusword]}, {number: 5, fixed: true, transmission_type: 1, maps: \
             [position_actual]}",
            "",
        ),
        // No word begins with a byte.
        drive(
            "position",
            "{number: 1, fixed: true, transmission_type: 1, maps: [{gap: 5}, controlword, {gap: 1}, target_position, {gap: 10}]}",
            "{number: 1, fixed: true, transmission_type: 1, maps: [{unused: {index: 0x2102, sub: 1, bits: 1}}, statusword, {gap: 6}, \
             position_actual, {gap: 201}]}",
            "",
        ),
        // The mapping can be changed, and carries more than is needed.
        drive(
            "velocity",
            "{number: 1, transmission_type: 1, maps: [{unused: {index: 0x6072, sub: 0, bits: 16}}, controlword, {gap: 16}, target_velocity]}",
            "{number: 1, transmission_type: 1, maps: [{gap: 8}, position_actual, statusword]}",
            "",
        ),
        drive("position", all("target_position", [velocity, torque]), LONG_INPUTS, "    sync1_us: 0\n"),
        drive("torque", all("target_torque", [position, velocity]), LONG_INPUTS, "    sync1_us: 250\n"),
        drive(
            "velocity",
            "{number: 0x140, fixed: true, transmission_type: 1, maps: [{unused: {index: 0x2103, sub: 2, bits: 64}}, target_velocity, controlword]}",
            "{number: 0x1ff, fixed: true, transmission_type: 1, maps: [{unused: {index: 0x2104, sub: 0, bits: 64}}, position_actual, statusword]}",
            "    sync1_us: 999\n",
        ),
    ]
}

/// The profile of a drive.
fn profile(drive: &Drive) -> String {
    let (from, to) = (PROFILE.find("      torque:").unwrap(), PROFILE.find("    mode_changes_in").unwrap());
    let modes = ["torque", "velocity", "position"].map(|mode| match mode == drive.mode {
        true => format!("      {mode}:\n        rpdo: [{}]\n        tpdo: [{}]\n", drive.rpdo, drive.tpdo),
        false => format!("      {mode}: null\n"),
    });
    let text = format!("{}{}{}", &PROFILE[..from], modes.concat(), &PROFILE[to..]);
    assert_eq!(text.matches("    sync1_us: 250\n").count(), 1);
    text.replace("    sync1_us: 250\n", drive.clock)
}

/// A rig whose drives are taken for `told`, and are `simulated`.
fn load(mode: &str, told: String, simulated: String) -> Loaded<Rig> {
    let rig = RIG.replace("../paper-admittance.yaml", "builtin:paper-admittance.yaml");
    let mut rig = rig.replace("command_mode: position", &format!("command_mode: {mode}"));
    if mode == "velocity" {
        rig.push_str("control:\n  gains: {rate: {gain_per_s: 60.0}}\n");
    }
    let (devices, simulation) = rig.split_once("simulation:").unwrap();
    let devices = devices.replace("profiles/ethercat-fixed-assignment.yaml", "told.yaml");
    let simulation = simulation.replace("profiles/ethercat-fixed-assignment.yaml", "simulated.yaml");
    let texts =
        [("rig.yaml", format!("{devices}simulation:{simulation}")), ("told.yaml", told), ("simulated.yaml", simulated)];
    let texts = texts.map(|(name, text)| (PathBuf::from(name), Arc::from(text)));
    load_rig(Source::among("rig.yaml", texts)).unwrap_or_else(|report| panic!("{report}"))
}

fn boot(rig: &Loaded<Rig>) -> Result<EmbeddedRig, BootFailure> {
    let scene = rig.scene().unwrap().value;
    let mut machine = EmbeddedRig::new(&rig.value, &scene, &rig.value.fixture, 1).unwrap();
    match machine.enable() {
        Ok(_) => Ok(machine),
        Err(RigError::Boot(error)) => Err(error.failure),
        Err(other) => panic!("{other}"),
    }
}

#[test]
fn twelve_drives_run_by_their_profiles_alone() {
    for (place, drive) in drives().iter().enumerate() {
        let text = profile(drive);
        let rig = load(drive.mode, text.clone(), text);
        let mut machine = boot(&rig).unwrap_or_else(|failure| panic!("drive {place}: {failure}"));
        for cycle in 0..500 {
            machine.run_cycle(Request::None).unwrap();
            assert_eq!(machine.state(), State::Running, "drive {place}, cycle {cycle}: {:?}", machine.cause());
        }
    }
}

#[test]
fn a_fixed_mapping_of_another_drive_is_refused_by_name() {
    let all = drives();
    for (told, simulated) in [(0, 5), (5, 0), (9, 2)] {
        let (told, simulated) = (&all[told], &all[simulated]);
        let failure = boot(&load(told.mode, profile(told), profile(simulated)));
        match failure.map(|_| ()) {
            Err(BootFailure::Identity { index: 0x1600.., .. } | BootFailure::Keeps { .. }) => {}
            // Told to want SYNC1, a drive that does not ask for it takes both.
            other => assert!(other.is_ok() && told.clock != simulated.clock, "{other:?}"),
        }
    }
}

#[test]
fn a_drive_that_wants_sync1_and_gets_none_points_to_the_key() {
    let with = &drives()[9];
    let text = profile(with);
    let rig = load(with.mode, text.replace("    sync1_us: 0\n", ""), text);
    let scene = rig.scene().unwrap().value;
    let error = EmbeddedRig::new(&rig.value, &scene, &rig.value.fixture, 1)
        .unwrap()
        .enable()
        .map(|_| ())
        .unwrap_err()
        .to_string();
    assert!(error.contains("0030h") && error.contains("sync1_us"), "{error}");
}

#[test]
fn a_rig_of_a_vendor_is_checked_run_and_shown() {
    let folder = std::env::temp_dir().join(format!("yieldwall-assigned-{}", std::process::id()));
    for (line, exit) in [
        ("config check builtin:vendors/ethercat-fixed-assignment.yaml", 0),
        ("run builtin:vendors/ethercat-fixed-assignment.yaml --duration 0.3", 0),
        ("pdo show left --rig builtin:vendors/ethercat-fixed-assignment.yaml", 0),
    ] {
        let mut program = Command::new(hil_tests::program());
        let seen = hil_tests::processes::output(program.args(line.split(' ')).env("XDG_STATE_HOME", &folder));
        let text = [seen.stdout, seen.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        assert_eq!(seen.status.code(), Some(exit), "{line}: {text}");
    }
}
