//! Drives that are axes of one device, on CANopen and on EtherCAT.

use std::process::Command;

use hil_tests::{Scenario, Session};
use yieldwall::guard::{DeviceSet, Fault, Request, State};
use yieldwall::injection::{Injection, Kind, Target};
use yieldwall_drives::cia402;

const RIGS: [&str; 2] = ["vendors/three-axes.yaml", "vendors/ethercat-three-axes.yaml"];

/// The error code that a test gives a drive: internal temperature.
const OVERHEATED: f64 = 16912.0;

/// A rig in motion, and then until it is latched.
fn stopped_by(scenario: &Scenario, injection: Injection) -> Session {
    let mut session = scenario.run(700);
    assert_eq!((session.machine.state(), session.fault()), (State::Running, None), "{}", session.replay);
    session.inject(injection);
    for _ in 0..2000 {
        session.step(Request::None);
        if session.machine.state().is_latched() {
            return session;
        }
    }
    panic!("{:?}; replay: {}", session.machine.state(), session.replay)
}

/// Until the ramps are over.
fn at_rest(session: &mut Session) -> [cia402::State; 2] {
    session.run(1500);
    assert!(session.machine.state().is_latched(), "{}", session.replay);
    assert_eq!(session.machine.drive_torques_n_m(), [0.0; 2], "{}", session.replay);
    session.machine.drive_states()
}

#[test]
fn rigs_on_one_device_follow_the_hand_and_stop() {
    for file in RIGS {
        let mut session = Scenario::shipped(file).run(1500);
        let [first, last] = [session.rows.first().unwrap(), session.rows.last().unwrap()].map(|row| row.tool_m);
        assert!((first[0] - last[0]).abs() + (first[1] - last[1]).abs() > 0.01, "{file}: {first:?} {last:?}");
        assert_eq!(session.machine.state(), State::Running, "{file}");
        let counted: Vec<_> = session.machine.master().cycle().faults().counted().collect();
        assert!(counted.is_empty(), "{file}: {counted:?}");
        session.machine.stop().unwrap();
        assert_eq!(session.machine.drive_states(), [cia402::State::SwitchOnDisabled; 2], "{file}");
    }
}

#[test]
fn a_fault_of_one_axis_stops_both_and_is_one_of_that_axis() {
    for file in RIGS {
        for (target, place) in [(Target::LeftDrive, 0), (Target::RightDrive, 1)] {
            let injection = Injection { size: OVERHEATED, ..Injection::new(Kind::DriveFault, 0.8).on(target) };
            let mut session = stopped_by(&Scenario::shipped(file), injection);
            let cause = session.machine.cause().unwrap();
            assert_eq!(cause.fault, Fault::DriveFault, "{file} {target:?}");
            assert_eq!(cause.devices, DeviceSet::drive(place), "{file} {target:?}: not of the other axis");
            let mut states = [cia402::State::SwitchOnDisabled; 2];
            states[place] = cia402::State::Fault;
            assert_eq!(at_rest(&mut session), states, "{file} {target:?}");
        }
    }
}

#[test]
fn the_loss_of_the_device_is_one_of_both_drives_in_one_cycle() {
    for file in RIGS {
        // Whichever of them is meant, the device is gone.
        for target in [Target::LeftDrive, Target::RightDrive] {
            let injection = Injection::new(Kind::NodeSilent, 0.8).on(target);
            let mut session = stopped_by(&Scenario::shipped(file), injection);
            let cause = session.machine.cause().unwrap();
            assert_eq!(cause.devices & DeviceSet::DRIVES, DeviceSet::DRIVES, "{file} {target:?}: {cause:?}");
            session.run(1500);
            assert_eq!(session.machine.drive_torques_n_m(), [0.0; 2], "{file} {target:?}");
        }
    }
}

#[test]
fn the_watchdogs_of_all_axes_are_drilled() {
    for file in RIGS {
        let scenario = Scenario::shipped(file);
        let drilled = yieldwall::rig::drill(&scenario.rig, &scenario.scene, |_| ()).unwrap();
        assert!(!drilled.findings.is_empty(), "{file}");
        for finding in &drilled.findings {
            assert!(finding.stopped_in.iter().all(Option::is_some), "{file}: {finding:?}");
        }
    }
}

#[test]
fn the_program_checks_runs_and_counts_them() {
    let folder = std::env::temp_dir().join(format!("yieldwall-axes-{}", std::process::id()));
    let run = |line: &str| {
        let mut program = Command::new(hil_tests::program());
        let seen = hil_tests::processes::output(program.args(line.split(' ')).env("XDG_STATE_HOME", &folder));
        let text = [seen.stdout, seen.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        assert_eq!(seen.status.code(), Some(0), "{line}: {text}");
        text
    };
    for file in RIGS {
        run(&format!("config check builtin:{file}"));
        run(&format!("run builtin:{file} --duration 0.3"));
    }
    // One node has one heartbeat and one emergency, and a PDO of each direction for each axis.
    let budget = run("bus budget builtin:vendors/three-axes.yaml");
    for (name, times) in [
        ("and right heartbeat", 1),
        ("left and right EMCY", 1),
        ("left TPDO1", 1),
        ("right TPDO65", 1),
        ("right RPDO65", 1),
    ] {
        assert_eq!(budget.matches(name).count(), times, "{name}: {budget}");
    }
}
