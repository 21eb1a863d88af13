//! Device profiles as files: a drive that is no shipped one runs by its file alone, and a wrong file moves nothing.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use hil_tests::{Scenario, cable::Cable};
use yieldwall::config::{self, CommandMode, ProfileName, Report, Source};
use yieldwall::guard::State;
use yieldwall::rig::{self, DeviceServer, EmbeddedRig};
use yieldwall::run::bringup;
use yieldwall::run::{Demands, Pace, Runner, TORQUE_LIMIT, Unsafe};
use yieldwall_drives::cia402;
use yieldwall_drives::profiles::{EncoderKind, Fieldbus, Tried};
use yieldwall_drives::watchdog::Watchdog;

const PROFILE: &str = include_str!("other-vendor.yaml");

fn shipped_rig() -> String {
    Source::named("builtin:paper-admittance.yaml").read().unwrap().to_string()
}

/// A rig whose drives name this profile.
fn with_profile(rig: &str, name: &str) -> String {
    assert_eq!(rig.matches("profile: simulated-servo").count(), 2);
    rig.replace("profile: simulated-servo", &format!("profile: {name}"))
}

/// A rig whose drives have the profile of this text.
fn load(rig: &str, profile: &str) -> Result<config::Loaded<config::Rig>, Report> {
    let texts = [("rig.yaml", with_profile(rig, "drive.yaml")), ("drive.yaml", profile.to_owned())];
    config::load_rig(Source::among("rig.yaml", texts.map(|(name, text)| (PathBuf::from(name), Arc::from(text)))))
}

/// A shipped scenario with drives of this profile.
fn scenario(mut scenario: Scenario, profile: &str) -> Scenario {
    let loaded = load(&shipped_rig(), profile).unwrap_or_else(|report| panic!("{report}"));
    for (drive, of_profile) in scenario.rig.drives.iter_mut().zip(loaded.value.drives) {
        drive.profile = of_profile.profile;
    }
    scenario
}

#[test]
fn a_drive_of_another_vendor_boots_drills_and_runs_by_its_file_alone() {
    for base in [Scenario::torque(), Scenario::position()] {
        let scenario = scenario(base, PROFILE);
        assert_eq!(scenario.rig.drives[0].profile.as_str(), "drive.yaml");
        let session = scenario.run(3000);
        assert_eq!(session.machine.state(), State::Running);

        let server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, Pace::Free).unwrap();
        let cable = Cable::new(server);
        let mut live = Runner::on_link(&scenario.rig, cable.clone(), cable.clone(), Pace::Free).unwrap();
        let on_bus = bringup::drill(&mut live, 50, &AtomicBool::new(false), |_| ()).unwrap();
        let virtually = rig::drill(&scenario.rig, &scenario.scene, |_| ()).unwrap();
        for drilled in [on_bus, virtually] {
            drilled.judge(Demands::of(&scenario.rig)).unwrap_or_else(|error| panic!("{error}: {drilled:?}"));
            let fast = |watchdog| {
                let finding = drilled.findings.iter().find(|finding| finding.watchdog == watchdog).unwrap();
                finding.stopped_after.iter().all(|after| after.is_some_and(|after| after <= TORQUE_LIMIT))
            };
            assert!(fast(Watchdog::Sync) && fast(Watchdog::SetPoints) && !fast(Watchdog::Heartbeat), "{drilled:?}");
        }
    }
}

#[test]
fn a_watchdog_that_the_profile_lacks_is_told_in_position_mode_and_refused_in_torque_mode_unless_another_is_fast() {
    let none = "      sync: none";
    let sync = PROFILE.split("      sync:\n").nth(1).and_then(|rest| rest.lines().next()).unwrap();
    let without_sync = PROFILE.replace(&format!("      sync:\n{sync}"), none);
    let set_points =
        without_sync.split("      set_points:\n").nth(1).and_then(|rest| rest.lines().next()).unwrap().to_owned();
    let without_both = without_sync.replace(&format!("      set_points:\n{set_points}"), "      set_points: none");
    let torque = shipped_rig();
    let position = torque.replace("command_mode: torque", "command_mode: position");
    let told = |rig: &str, profile: &str| load(rig, profile).map(|loaded| loaded.warnings.len());
    assert_eq!(told(&torque, PROFILE).unwrap(), 0);
    assert_eq!(told(&torque, &without_sync).unwrap(), 1, "the watch for set-points acts within 5 ms");
    let report = told(&torque, &without_both).unwrap_err();
    assert!(report.to_string().contains("have no watchdog for SYNC and set-points, and no other stops"), "{report}");
    assert_eq!(told(&position, &without_both).unwrap(), 1);
    // With a heartbeat that is soon missed torque may be commanded.
    let soon = torque.replacen("heartbeat_ms: 20 ", "heartbeat_ms: 5 ", 1);
    assert_eq!(told(&soon, &without_both).unwrap(), 1);

    // The drill finds the same, and takes a drive that does what its profile says.
    // Set-points act with SYNC, so that the watch for them acts without SYNC as well.
    let goes_on = Err(Unsafe::GoesOn { side: "left", watchdog: Watchdog::Sync });
    let cases = [(&without_sync, Scenario::torque(), Ok(())), (&without_both, Scenario::position(), goes_on)];
    for (profile, base, if_it_had_all) in cases {
        let scenario = scenario_with(base, profile, &position);
        let drilled = rig::drill(&scenario.rig, &scenario.scene, |_| ()).unwrap();
        drilled.judge(Demands::of(&scenario.rig)).unwrap_or_else(|error| panic!("{error}: {drilled:?}"));
        let all = Demands { lacks: [0; 2], ..Demands::of(&scenario.rig) };
        assert_eq!(drilled.judge(all), if_it_had_all);
    }
}

fn scenario_with(mut scenario: Scenario, profile: &str, rig: &str) -> Scenario {
    let loaded = load(rig, profile).unwrap_or_else(|report| panic!("{report}"));
    for (drive, of_profile) in scenario.rig.drives.iter_mut().zip(loaded.value.drives) {
        drive.profile = of_profile.profile;
    }
    scenario
}

#[test]
fn a_drive_without_the_masters_heartbeat_is_never_run() {
    let from = PROFILE.find("      heartbeat:\n").unwrap();
    let to = PROFILE.find("      set_points:\n").unwrap();
    let profile = format!("{}      heartbeat: none\n{}", &PROFILE[..from], &PROFILE[to..]);
    for mode in ["torque", "velocity", "position"] {
        let rig = shipped_rig().replace("command_mode: torque", &format!("command_mode: {mode}"));
        let report = load(&rig, &profile).unwrap_err();
        assert!(report.to_string().contains("continue if this program fails"), "{report}");
    }
}

#[test]
fn the_profiles_of_real_drives_run_on_simulated_drives_of_their_kind_and_say_that_nobody_tried_them() {
    let real: Vec<&str> = ProfileName::shipped()
        .filter(|(_, profile)| profile.profile.tried == Tried::Never && profile.servo().is_some())
        .filter(|(_, profile)| profile.is_for(Fieldbus::Canopen))
        .map(|(name, _)| name)
        .collect();
    assert!(real.len() >= 3, "{real:?}");
    for name in real {
        let mut base = Scenario::position();
        for drive in &mut base.rig.drives {
            drive.profile = ProfileName::from(name.to_owned());
            drive.encoder = Some(EncoderKind::MultiTurn);
        }
        let session = base.run(500);
        assert_eq!(session.machine.state(), State::Running, "{name}");

        let rig = with_profile(&shipped_rig().replace("command_mode: torque", "command_mode: position"), name);
        let load = |text: String| config::load_rig(Source::memory("rig.yaml", text));
        let loaded = load(rig.replace("    direction: 1", "    encoder: multi_turn\n    direction: 1"));
        let loaded = loaded.unwrap_or_else(|report| panic!("{name}: {report}"));
        assert!(loaded.warnings.iter().any(|finding| finding.message.contains("never tried")), "{name}");
        let incremental = load(rig.replace("    direction: 1", "    encoder: incremental\n    direction: 1"));
        assert!(incremental.unwrap_err().to_string().contains("may not know where their zero is"), "{name}");
    }
}

/// A class of mistakes that concern what the rig asks of the drive.
const TOO_FEW: &str = "too few watchdogs";

/// Class of a mistake, what is replaced in the profile, and by what.
const MISTAKES: [(&str, &str, &str); 65] = [
    ("no YAML", "profile:\n", "profile: [\n"),
    ("no YAML", "device_type: 0x00020192", "device_type 0x00020192"),
    ("no YAML", "  servo:\n", "\tservo:\n"),
    ("missing key", "  name: other-vendor\n", ""),
    ("missing key", "  tried: bench\n", ""),
    ("missing key", "  vendor_id: 0x00000abc\n", ""),
    ("missing key", "  product_codes: [0x00001111, 0x00002222]\n", ""),
    ("missing key", "  reset: node\n", ""),
    ("missing key", "      target_velocity: null\n", ""),
    ("missing key", "      velocity: null\n", ""),
    ("missing key", "      motor_speed: null\n", ""),
    ("missing key", "      communication_error: null\n", ""),
    ("missing key", "    brake: {held_by: drive}\n", ""),
    ("unknown key", "vendor_id:", "vendor:"),
    ("unknown key", "boot_up_ms: 2000", "bootup_ms: 2000"),
    ("unknown key", "      set_points:", "      setpoints:"),
    ("unknown key", "  servo:", "  drive:"),
    ("unknown word", "tried: bench", "tried: often"),
    ("unknown word", "reset: node", "reset: none"),
    ("unknown word", "reset_loses_reference: no", "reset_loses_reference: maybe"),
    ("unknown word", "mode_changes_in: [switch_on_disabled", "mode_changes_in: [switched_off"),
    ("unknown word", "maps: [target_torque, controlword]", "maps: [torque, controlword]"),
    ("unknown word", "reaction: fault", "reaction: stop"),
    ("unknown word", "kind: multi_turn", "kind: absolute"),
    ("wrong type", "vendor_id: 0x00000abc", "vendor_id: abc"),
    ("wrong type", "device_type: 0x00020192", "device_type: -1"),
    ("wrong type", "product_codes: [0x00001111, 0x00002222]", "product_codes: 0x1111"),
    ("wrong type", "index: 0x6040", "index: 6040h"),
    ("wrong type", "unit: {us: 100}", "unit: {us: fast}"),
    ("wrong type", "unit: {us: 100}", "unit: {us: .nan}"),
    ("out of range", "boot_up_ms: 2000", "boot_up_ms: 0"),
    ("out of range", "sdo_ms: 500", "sdo_ms: 70000"),
    ("out of range", "mapping_entries: 4", "mapping_entries: 0"),
    (
        "out of range",
        "number: 2, transmission_type: 1, maps: [target_torque",
        "number: 5, transmission_type: 1, maps: [target_torque",
    ),
    ("out of range", "index: 0x6040", "index: 0x0040"),
    ("out of range", "product_codes: [0x00001111, 0x00002222]", "product_codes: []"),
    ("out of range", "{from: 0x00030000, to: 0x0003ffff}", "{from: 0x00040000, to: 0x0003ffff}"),
    ("wrong length", "index: 0x6040, sub: 0, bits: 16", "index: 0x6040, sub: 0, bits: 32"),
    ("wrong length", "index: 0x6064, sub: 0, bits: 32", "index: 0x6064, sub: 0, bits: 16"),
    ("wrong length", "index: 0x2480, sub: 0, bits: 16", "index: 0x2480, sub: 0, bits: 12"),
    ("wrong length", "index: 0x1016, sub: 1, bits: 32", "index: 0x1016, sub: 1, bits: 16"),
    ("wrong mapping", "maps: [target_torque, controlword]", "maps: [target_torque]"),
    ("wrong mapping", "maps: [target_torque, controlword]", "maps: [controlword]"),
    ("wrong mapping", "maps: [target_torque, controlword]", "maps: [target_position, controlword]"),
    ("wrong mapping", "maps: [target_torque, controlword]", "maps: [target_torque, statusword]"),
    ("wrong mapping", "maps: [target_torque, controlword]", "maps: [controlword, controlword, target_torque]"),
    (
        "wrong mapping",
        "- {number: 3, transmission_type: 1, maps: [statusword]}",
        "- {number: 1, transmission_type: 1, maps: [statusword]}",
    ),
    (
        "wrong mapping",
        "- {number: 1, transmission_type: 1, maps: [position_actual]}",
        "- {number: 1, transmission_type: 1, maps: [statusword]}",
    ),
    (
        "wrong mapping",
        "transmission_type: 1, maps: [position_actual]",
        "transmission_type: 254, maps: [position_actual]",
    ),
    ("wrong mapping", "mapping_entries: 4", "mapping_entries: 1"),
    (
        "wrong value",
        "object: {index: 0x6007, sub: 0, bits: 16, source: sheet}, value: 1",
        "object: {index: 0x6007, sub: 0, bits: 16, source: sheet}, value: 0",
    ),
    ("wrong value", "value: 6}", "value: 0}"),
    ("wrong value", "value: 6}", "value: 70000}"),
    (
        "wrong value",
        "mode_changes_in: [switch_on_disabled, ready_to_switch_on]",
        "mode_changes_in: [ready_to_switch_on]",
    ),
    ("no source", "index: 0x6041, sub: 0, bits: 16, source: sheet", "index: 0x6041, sub: 0, bits: 16, source: hearsay"),
    ("no source", "    sheet: the data sheet", "    paper: the data sheet"),
    // By the rule of the core, at the rig's key that names the profile.
    (
        TOO_FEW,
        "      heartbeat:\n        consumer: {index: 0x1016, sub: 1, bits: 32, source: sheet}\n",
        "      heartbeat: none\n",
    ),
    (
        TOO_FEW,
        "      set_points:\n        object: {object: {index: 0x2480, sub: 0, bits: 16, source: sheet}, unit: {us: 100}, reaction: fault}\n      \
         sync:\n        object: {object: {index: 0x2481, sub: 0, bits: 8, source: sheet}, unit: cycles, reaction: abort_connection}\n",
        "      set_points: none\n      sync: none\n",
    ),
    // What the file alone does not show: the device is another.
    ("another device", "vendor_id: 0x00000abc", "vendor_id: 0x00000abd"),
    ("another device", "[0x00001111, 0x00002222]", "[0x00003333]"),
    ("another device", "{from: 0x00030000, to: 0x0003ffff}", "{from: 0x00040000, to: 0x0004ffff}"),
    ("another device", "device_type: 0x00020192", "device_type: 0x00020191"),
    ("another device", "index: 0x2480", "index: 0x2580"),
    ("another device", "index: 0x2500", "index: 0x2501"),
    ("another device", "index: 0x6072", "index: 0x6073"),
];

#[test]
fn a_wrong_profile_is_refused_at_its_place_and_nothing_moves() {
    let classes: std::collections::BTreeSet<&str> = MISTAKES.iter().map(|mistake| mistake.0).collect();
    assert!(MISTAKES.len() >= 60 && classes.len() == 12, "{classes:?}");
    let rig = shipped_rig();
    for (class, from, to) in MISTAKES {
        let what = format!("{class}: `{from}` -> `{to}`");
        assert!(PROFILE.contains(from), "{what}");
        let wrong = PROFILE.replacen(from, to, 1);
        match load(&rig, &wrong) {
            Err(report) => {
                let first = &report.diagnostics[0];
                let file = if class == TOO_FEW { "rig.yaml" } else { "drive.yaml" };
                assert!(first.place.is_some() && first.file == file, "{what}: {report}");
            }
            Ok(loaded) => {
                assert_eq!(class, "another device", "{what}: it was taken");
                // The devices are as the right profile says, the master goes by the wrong one.
                let scenario = scenario(Scenario::torque(), PROFILE);
                let server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, Pace::Free).unwrap();
                let cable = Cable::new(server);
                let mut live = Runner::on_link(&loaded.value, cable.clone(), cable.clone(), Pace::Free).unwrap();
                let error = live.boot().expect_err(&what).to_string();
                assert!(error.contains("node 1 (left)"), "{what}: {error}");
                let states = cable.look(|server| server.drive_states());
                assert!(states.iter().all(|state| *state == cia402::State::SwitchOnDisabled), "{what}");
            }
        }
    }
}

#[test]
fn a_simulated_drive_refuses_objects_where_it_does_not_have_them() {
    let profile = PROFILE.replace("index: 0x6040", "index: 0x6840");
    let rig = load(&shipped_rig(), &profile).unwrap().value;
    let Scenario { scene, seed, .. } = Scenario::torque();
    let error = EmbeddedRig::new(&rig, &scene, &rig.fixture, seed).err().unwrap().to_string();
    assert!(error.contains("the simulated drive has its controlword at 6040h:0 with 16 bits"), "{error}");
    let mut velocity = load(&shipped_rig(), PROFILE).unwrap().value;
    velocity.rig.command_mode = CommandMode::Velocity;
    let error = EmbeddedRig::new(&velocity, &scene, &velocity.fixture, seed).err().unwrap().to_string();
    assert!(error.contains("velocity"), "{error}");
}
