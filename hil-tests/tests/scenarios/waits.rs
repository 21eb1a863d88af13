//! Drives that take their time: to reset, to answer, to be enabled. In virtual time, on the embedded bus and on a cable.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use hil_tests::{
    Scenario,
    cable::{Cable, permit},
};
use yieldwall::bus::BootFailure;
use yieldwall::config::Waits;
use yieldwall::guard::{Fault, State};
use yieldwall::rig::{DeviceServer, EmbeddedRig, RigError};
use yieldwall::run::bringup;
use yieldwall::run::{Ask, Demands, Enable, Enabling, OnLink, Pace, RunError, Runner};

/// How slow the drives are: reset and SDO, in ms.
type Slow = [u64; 2];

fn embedded(scenario: &Scenario, [reset, sdo]: Slow) -> EmbeddedRig {
    let mut rig = scenario.start().machine;
    rig.set_reset_time(Duration::from_millis(reset));
    rig.set_sdo_time(Duration::from_millis(sdo));
    rig
}

fn wired(scenario: &Scenario, pace: Pace, [reset, sdo]: Slow) -> (Cable, Runner<OnLink<Cable, Cable>>) {
    let mut server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, pace).unwrap();
    server.set_reset_time(Duration::from_millis(reset));
    server.set_sdo_time(Duration::from_millis(sdo));
    let cable = Cable::new(server);
    let rig = Runner::on_link(&scenario.rig, cable.clone(), cable.clone(), pace).unwrap();
    (cable, rig)
}

#[test]
fn a_drive_that_takes_its_time_to_reset_or_to_answer_is_waited_for() {
    for slow in [[700, 0], [3000, 0], [0, 600], [3000, 600]] {
        let mut rig = embedded(&Scenario::torque(), slow);
        rig.enable().unwrap_or_else(|error| panic!("{slow:?}: {error}"));
        for pace in [Pace::Lockstep, Pace::Free] {
            let scenario = Scenario::position();
            let (_cable, mut rig) = wired(&scenario, pace, slow);
            rig.boot().unwrap_or_else(|error| panic!("{slow:?} {pace:?}: {error}"));
            rig.check_simulation().unwrap();
            let permit = permit(&rig);
            let mut enabling = Enabling::new(&scenario.rig);
            while let Enable::Ask(ask) = enabling.next(rig.state(), &permit) {
                rig.run_cycle(ask);
            }
            assert_eq!(rig.state(), State::Running, "{slow:?} {pace:?}");
        }
    }
}

#[test]
fn a_drive_that_takes_longer_than_its_setting_is_named_with_what_it_was_waited_for() {
    let mut scenario = Scenario::torque();
    scenario.rig.drives[1].waits = Waits { boot_up_ms: Some(600), sdo_ms: Some(500), start_ms: None };
    let check = |error: RigError, slow: Slow| {
        let RigError::Boot(error) = error else { panic!("{slow:?}: {error}") };
        assert_eq!((error.node_id, error.name.as_str()), (Some(2), "right"), "{slow:?}");
        match slow {
            [700, _] => assert!(matches!(error.failure, BootFailure::Missing { waited_ms: 600, .. }), "{error}"),
            // What is read is asked for three times, what is written once.
            _ => assert!(matches!(error.failure, BootFailure::NoAnswer { index: 0x1017, sub: 0 }), "{error}"),
        }
    };
    for slow in [[700, 0], [0, 600]] {
        check(embedded(&scenario, slow).enable().unwrap_err(), slow);
        for pace in [Pace::Lockstep, Pace::Free] {
            let (_cable, mut rig) = wired(&scenario, pace, slow);
            match rig.boot().unwrap_err() {
                RunError::Boot(error) => check(error.into(), slow),
                other => panic!("{slow:?} {pace:?}: {other}"),
            }
        }
    }
}

#[test]
fn a_person_can_end_a_boot_that_waits_and_sees_what_it_waits_for() {
    let (_cable, mut rig) = wired(&Scenario::torque(), Pace::Free, [3000, 0]);
    let told = Arc::new(Mutex::new(Vec::new()));
    let seen = Arc::clone(&told);
    rig.set_boot_watch(Box::new(move |waiting| {
        let mut seen = seen.lock().unwrap();
        seen.push(waiting.map(|waiting| waiting.to_string()));
        waiting.is_some_and(|waiting| waiting.waited >= Duration::from_millis(220))
    }));
    assert_eq!(rig.boot(), Err(RunError::Interrupted));
    let told = told.lock().unwrap();
    assert_eq!(told[0].as_deref(), Some("node 1 (left): wait for the boot-up message, for 5.0 s at most"));
    assert!(
        told.contains(&Some("node 1 (left): wait for the boot-up message, for 4.8 s at most".to_owned())),
        "{told:?}"
    );
    assert_eq!(told.last(), Some(&None), "the boot is over");
}

#[test]
fn a_drive_that_answers_slowly_is_drilled_as_finely_as_it_answers() {
    let scenario = Scenario::position();
    let (_cable, mut rig) = wired(&scenario, Pace::Free, [700, 600]);
    let drilled = bringup::drill(&mut rig, 50, &AtomicBool::new(false), |_| ()).unwrap();
    let demands = Demands::of(&scenario.rig);
    drilled.judge(demands).unwrap();
    assert!(drilled.judge(Demands { is_torque: true, ..demands }).is_err(), "nobody knows that it stops within 10 ms");
    let resolution = drilled.resolution.as_millis();
    assert!((600..700).contains(&resolution), "{drilled:?}");
}

/// A drive whose brake opens late: it does not follow the controlword meanwhile.
#[test]
fn a_drive_that_is_enabled_late_is_waited_for_as_long_as_its_setting_says() {
    for (enabling_ms, is_enabled) in [(5000, true), (2000, false)] {
        let mut scenario = Scenario::torque();
        scenario.rig.drives[0].enabling_ms = enabling_ms;
        scenario.rig.drives[1].enabling_ms = 9000;
        let (cable, mut rig) = wired(&scenario, Pace::Free, [0, 0]);
        rig.boot().unwrap();
        cable.change(|server| server.set_ignores_controlword(0, true));
        let permit = permit(&rig);
        let mut enabling = Enabling::new(&scenario.rig);
        let mut cycle = 0;
        while let Enable::Ask(ask) = enabling.next(rig.state(), &permit) {
            if cycle == 3000 {
                cable.change(|server| server.set_ignores_controlword(0, false));
            }
            rig.run_cycle(ask);
            cycle += 1;
        }
        assert_eq!(rig.state() == State::Running, is_enabled, "{enabling_ms} ms");
        if !is_enabled {
            assert_eq!(rig.cause().map(|cause| cause.fault), Some(Fault::EnablingTimeout));
            assert!((2000..2100).contains(&cycle), "{cycle} cycles");
            rig.run_cycle(Ask::Nothing);
            assert!(rig.state().is_latched());
        }
    }
}
