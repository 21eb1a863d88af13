//! The end of a run: with each shipped drive in each mode it has, on both buses, however the run ends, no drive is left with torque.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use hil_tests::Scenario;
use hil_tests::cable::{Cable, permit};
use hil_tests::segment_cable::SegmentCable;
use yieldwall::config::{
    Address, CommandMode, EthercatAddress, Positive, ProfileName, Rig, SensorProtocol, Source, builtin, load_rig,
};
use yieldwall::cycle::LeadLimits;
use yieldwall::injection::{Injection, Kind, Target};
use yieldwall::quantity::JointAngles;
use yieldwall::rig::{self, DeviceServer, EmbeddedRig, SegmentServer};
use yieldwall::run::commission::{Step, Verdict};
use yieldwall::run::{Bounds, Ended, HomePlan, Jog, Pace, Place, Play, Played, Runner};
use yieldwall::time::Time;
use yieldwall_drives::cia402;
use yieldwall_drives::profiles::{EncoderKind, Fieldbus, Role};

/// Each mode, and the shipped rig on CAN that has it.
const MODES: [(&str, CommandMode, cia402::OperationMode); 3] = [
    ("paper-admittance.yaml", CommandMode::Torque, cia402::OperationMode::CyclicTorque),
    ("paper-admittance-csv.yaml", CommandMode::Velocity, cia402::OperationMode::CyclicVelocity),
    ("paper-admittance-csp.yaml", CommandMode::Position, cia402::OperationMode::CyclicPosition),
];
/// The shipped rig on EtherCAT.
const ETHERCAT: &str = "paper-ethercat.yaml";
const CYCLES: u64 = 400;

/// A shipped rig with drives of this profile.
fn scenario(file: &'static str, profile: &'static str) -> Scenario {
    let mut scenario = Scenario::shipped(file);
    for drive in &mut scenario.rig.drives {
        drive.profile = ProfileName::from(profile.to_owned());
        drive.encoder = Some(EncoderKind::MultiTurn);
    }
    if file == ETHERCAT {
        share_device(&mut scenario.rig);
    }
    scenario
}

/// Makes both drives axes of one device, if their profile is of one that has several.
fn share_device(rig: &mut Rig) {
    if rig.drives[0].profile.get().is_none_or(|profile| profile.axes() < 2) {
        return;
    }
    for (axis, drive) in (0..).zip(&mut rig.drives) {
        drive.address = Address::Ethercat(EthercatAddress { position: 0, axis: Some(axis) });
    }
    if let SensorProtocol::Ethercat { position, .. } = &mut rig.sensor.protocol {
        *position = 1;
    }
}

/// The shipped rig on EtherCAT, in the mode of one on CAN.
fn on_ethercat(can: &Scenario, profile: &'static str) -> Scenario {
    let mut segment = scenario(ETHERCAT, profile);
    segment.rig.rig.command_mode = can.rig.rig.command_mode;
    segment.rig.control = can.rig.control;
    segment
}

/// The end of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    Whole,
    Interrupted,
    Fault,
}

const WAYS: [Way; 3] = [Way::Whole, Way::Interrupted, Way::Fault];

fn is_off(states: impl IntoIterator<Item = cia402::State>) -> bool {
    !states.into_iter().any(cia402::State::has_torque)
}

/// Runs a rig that is booted, and ends it that way.
fn end<P: Place>(rig: &mut Runner<P>, way: Way, mut fail: impl FnMut()) -> Played {
    let play = Play { cycles: if way == Way::Whole { CYCLES } else { 10 * CYCLES }, settling: 50 };
    let (permit, is_interrupted) = (permit(rig), AtomicBool::new(false));
    let mut cycles = 0;
    rig.play(&play, &permit, &is_interrupted, |_| {
        cycles += 1;
        match way {
            Way::Interrupted if cycles == CYCLES => is_interrupted.store(true, Ordering::Relaxed),
            Way::Fault if cycles == CYCLES => fail(),
            _ => {}
        }
    })
    .unwrap()
}

fn embedded(scenario: &Scenario, way: Way) -> bool {
    let mut session = scenario.run(CYCLES as usize);
    if way == Way::Fault {
        session.inject(Injection::new(Kind::DriveFault, 0.0).on(Target::RightDrive));
        session.run(2000);
        assert!(session.machine.state().is_latched());
    } else {
        session.machine.stop().unwrap();
    }
    is_off(session.machine.drive_states())
}

fn on_can(scenario: &Scenario, way: Way) -> bool {
    let server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, Pace::Free).unwrap();
    let cable = Cable::new(server);
    let mut rig = Runner::on_link(&scenario.rig, cable.clone(), cable.clone(), Pace::Free).unwrap();
    rig.boot().unwrap();
    let played = end(&mut rig, way, || cable.set_passage(|_, is_own, frame| is_own || frame.id() != 0x182));
    check(&played, way);
    is_off(cable.look(|server| server.drive_states())) && cable.look(|server| server.torques_n_m()) == [0.0; 2]
}

fn on_segment(scenario: &Scenario, way: Way) -> bool {
    let now = Time::from_micros(1_000_000);
    let server = SegmentServer::new(&scenario.rig, &scenario.scene, 1, Pace::Free, [true; 3], now).unwrap();
    let cable = SegmentCable::new(server, now);
    let mut rig = Runner::on_link(&scenario.rig, cable.clone(), cable.clone(), Pace::Free).unwrap();
    rig.boot().unwrap();
    let fault = Injection::new(Kind::DriveFault, 0.0).on(Target::RightDrive);
    let played = end(&mut rig, way, || cable.change(|server| server.inject(fault).unwrap()));
    check(&played, way);
    // Before the segment leaves OP.
    is_off(cable.change(|server| server.drive_states()).into_iter().flatten())
        && cable.change(|server| server.torques_n_m()) == [0.0; 2]
}

fn check(played: &Played, way: Way) {
    let ended = match way {
        Way::Whole => Ended::Whole,
        Way::Interrupted => Ended::Interrupted,
        Way::Fault => Ended::Stopped,
    };
    assert_eq!(played.ended, ended, "{way:?}: {played:?}");
}

#[test]
fn no_drive_is_left_with_torque_whatever_its_profile_says_of_its_quick_stop() {
    let profiles: Vec<_> = ProfileName::shipped()
        .filter_map(|(name, profile)| match &profile.device {
            Role::Servo(servo) => Some((name, servo, profile.is_for(Fieldbus::Canopen))),
            _ => None,
        })
        .collect();
    assert!(profiles.len() >= 6, "{}", profiles.len());
    println!("{:18} {:9} {:13} {:11} {:10} EtherCAT", "profile", "mode", "end", "simulation", "CAN");
    for (name, servo, has_can) in profiles {
        for (file, mode, _) in MODES.into_iter().filter(|(_, _, mode)| servo.process_data.of(*mode).is_some()) {
            let can = scenario(file, name);
            let segment = on_ethercat(&can, name);
            for way in WAYS {
                let sim = embedded(if has_can { &can } else { &segment }, way);
                let off = [Some(sim), has_can.then(|| on_can(&can, way)), Some(on_segment(&segment, way))];
                let words =
                    |is_off: Option<bool>| is_off.map_or("-", |is_off| if is_off { "no torque" } else { "TORQUE" });
                let [sim, can, ethercat] = off.map(words);
                println!("{name:18} {:9} {:13} {sim:11} {can:10} {ethercat}", format!("{mode:?}"), format!("{way:?}"));
                assert!(!off.contains(&Some(false)), "{name} {mode:?} {way:?}: simulation, CAN, EtherCAT");
            }
            let drilled = if has_can { &can } else { &segment };
            let drilled = rig::drill(&drilled.rig, &drilled.scene, |_| ()).unwrap();
            assert!(!drilled.findings.is_empty(), "{name} {mode:?}");
        }
    }
}

/// The profile of a shipped drive with what no document says of its watches: five periods, and a fault. Without these no drill is passed.
fn completed(name: &str, bus: Fieldbus, has_torque: bool) -> ProfileName {
    let profile = builtin(format!("profiles/{name}.yaml")).read().unwrap();
    let profile = profile.replace("periods: null", "periods: 5").replace("reaction: unknown", "reaction: fault");
    // A rig is read in a mode that the drive has.
    let base = match (bus, has_torque) {
        (Fieldbus::Canopen, true) => "paper-admittance.yaml",
        (Fieldbus::Canopen, false) => "paper-admittance-csp.yaml",
        (Fieldbus::Ethercat, true) => "paper-ethercat.yaml",
        (Fieldbus::Ethercat, false) => "paper-ethercat.yaml\nrig: {command_mode: position}",
    };
    let drive = |side| format!("  - {{name: {side}, profile: completed.yaml, encoder: multi_turn}}\n");
    let rig = format!("like: builtin:{base}\ndrives:\n{}{}", drive("left"), drive("right"));
    let files = [("rig.yaml", rig), ("completed.yaml", profile.to_string())];
    let files = files.map(|(path, text)| (PathBuf::from(path), Arc::from(text)));
    let rig = load_rig(Source::among("rig.yaml", files)).unwrap_or_else(|report| panic!("{name}: {report}"));
    rig.value.drives[0].profile.clone()
}

fn machine(scenario: &Scenario) -> EmbeddedRig {
    EmbeddedRig::new(&scenario.rig, &scenario.scene, &scenario.rig.fixture, scenario.seed).unwrap()
}

/// The ends of a jog, of a commissioning and of homing, in a word each, and whether any of them leaves torque.
fn brought_up(scenario: &Scenario, is_commissioned: bool) -> ([String; 3], bool) {
    let positive = |value| Positive::new(value).unwrap();
    let go_on = AtomicBool::new(false);
    let rig = &scenario.rig;
    let mut machine = machine(scenario);
    let limits = LeadLimits { rate_rad_per_s: 0.2, acceleration_rad_per_s2: 1.0 };
    let jog = Jog { by: JointAngles::from([0.05, 0.0]), keys: None, limits, settling: 20, is_metered: false };
    let bounds = Bounds { motion_rad: positive(0.1), torque_n_m: positive(15.0) };
    let jogged = machine.jog(rig, &jog, bounds, &go_on, |_| ()).unwrap();
    let jogged = jogged.map_or_else(|error| error.to_string(), |jogged| format!("{:?}", jogged.ended));
    let mut off = is_off(machine.drive_states());
    let mut commissioned = "-".to_owned();
    if is_commissioned {
        let mut machine = self::machine(scenario);
        let done = machine.commission(rig, Step::Communication.into(), &go_on, |_| ()).unwrap();
        let failed = done.steps.iter().find(|step| step.verdict == Verdict::Fail);
        commissioned = failed.map_or("Pass".to_owned(), |step| format!("{}: {:?}", step.step.name(), step.reason));
        off &= is_off(machine.drive_states());
    }
    let mut homed = "-".to_owned();
    if let Some(plan) = HomePlan::of(rig, [true; 2], 20) {
        let mut machine = self::machine(scenario);
        let done = machine.home(rig, &plan, positive(15.0), &go_on).unwrap();
        homed = done.map_or_else(
            |error| error.to_string(),
            |homed| homed.failed.map_or("Pass".to_owned(), |why| format!("{why:?}")),
        );
        off &= is_off(machine.drive_states());
    }
    ([jogged, commissioned, homed], off)
}

#[test]
fn shipped_drives_are_jogged_commissioned_and_homed_and_left_without_torque() {
    println!("{:18} {:9} {:9} {:6} {:10} homing", "profile", "mode", "bus", "jog", "commission");
    for (name, profile) in ProfileName::shipped() {
        let Some(servo) = profile.servo() else { continue };
        let buses = [(Fieldbus::Canopen, "CAN"), (Fieldbus::Ethercat, "EtherCAT")];
        for (bus, word) in buses.into_iter().filter(|(bus, _)| profile.is_for(*bus)) {
            let completed = completed(name, bus, servo.process_data.torque.is_some());
            // A commissioning takes as long as all else; it is made in one mode.
            let mut is_first = true;
            for (file, mode, _) in MODES.into_iter().filter(|(_, _, mode)| servo.process_data.of(*mode).is_some()) {
                let can = scenario(file, name);
                let mut used = if bus == Fieldbus::Canopen { can } else { on_ethercat(&can, name) };
                used.rig.drives.iter_mut().for_each(|drive| drive.profile = completed.clone());
                let ([jogged, commissioned, homed], is_off) = brought_up(&used, is_first);
                println!("{name:18} {:9} {word:9} {jogged:6} {commissioned:10} {homed}", format!("{mode:?}"));
                assert!(is_off, "{name} {mode:?} {word}");
                assert_eq!(jogged, "Whole", "{name} {mode:?} {word}");
                assert!(["Pass", "-"].contains(&commissioned.as_str()), "{name} {mode:?} {word}: {commissioned}");
                is_first = false;
            }
        }
    }
}
