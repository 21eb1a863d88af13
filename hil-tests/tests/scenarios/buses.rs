//! Rigs on several buses: the embedded simulation, and the loop for real buses on a cable in memory.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use hil_tests::{
    ObservedFrame, Scenario,
    cable::{Cable, permit},
};
use yieldwall::canopen::BusId;
use yieldwall::config::{BusTiming, ForceSensorModel};
use yieldwall::elementary;
use yieldwall::guard::{Cause, DeviceSet, Fault, State};
use yieldwall::injection::{Injection, Kind, Target};
use yieldwall::rig::{self, DeviceServer};
use yieldwall::run::{Ask, Demands, Ended, Pace, Play, Runner};
use yieldwall_drives::cia402;

/// The sensor on a bus of its own.
fn sensor_apart() -> Scenario {
    Scenario::shipped("paper-admittance-two-buses.yaml")
}

/// Each drive on a bus of its own, both with node id 1; the sensor with the left one.
fn drives_apart() -> Scenario {
    let mut scenario = sensor_apart();
    let [_, right] = &mut scenario.rig.drives;
    right.bus = "sensor".to_owned();
    right.address.canopen_mut().unwrap().node_id = 1;
    (scenario.rig.sensor.bus, scenario.rig.sensor.protocol) =
        ("main".to_owned(), Scenario::torque().rig.sensor.protocol);
    scenario
}

fn injection(kind: Kind, target: Target) -> Injection {
    Injection::new(kind, 0.0).on(target)
}

#[test]
fn the_scene_is_that_of_one_bus() {
    let mut one = Scenario::torque().enabled();
    one.run(6000);
    for scenario in [sensor_apart(), drives_apart()] {
        let mut several = scenario.enabled();
        several.run(6000);
        assert_eq!((several.machine.state(), several.fault()), (State::Running, None), "{}", several.replay);
        let farthest = several.rows.iter().zip(&one.rows).map(|(two, one)| {
            let [x, y] = [0, 1].map(|axis| two.proxy_m[axis] - one.proxy_m[axis]);
            elementary::hypot(x, y)
        });
        let farthest = farthest.fold(0.0, f64::max);
        assert!(farthest < 2e-3, "{farthest} m apart");
        assert!(several.rows.iter().any(|row| row.is_on_surface));
        for (bus, counters) in several.machine.bus_counters().enumerate() {
            let lost = (counters.overflowed, counters.dropped, counters.identifier_clashes);
            assert_eq!(lost, (0, 0, 0), "bus {bus}");
            assert!(counters.frames > 6000, "bus {bus}");
        }
    }
}

#[test]
fn every_bus_has_one_sync_a_cycle_and_its_own_meaning_of_an_identifier() {
    let session = sensor_apart().run(1000);
    let frames = session.recording().frames;
    let last = |id: u16, bus: u8, bytes: u8| {
        let of = |seen: &&ObservedFrame| seen.frame.id() == id && seen.frame.bus() == BusId::new(bus);
        let seen: Vec<_> = frames.iter().filter(of).collect();
        assert!(seen.iter().all(|seen| seen.frame.len() == bytes), "{id:03X}h on bus {bus}");
        seen.len()
    };
    assert_eq!(last(0x080, 0, 0), last(0x080, 1, 0));
    // The position of the left drive, and forces.
    assert!(last(0x181, 0, 6) > 1000 && last(0x181, 1, 8) > 1000);
    assert_eq!((last(0x201, 1, 4), last(0x202, 1, 4), last(0x281, 0, 6)), (0, 0, 0));
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_all_buses() {
    assert!(sensor_apart().run(500).candump() == sensor_apart().run(500).candump());
    assert!(String::from_utf8(sensor_apart().run(5).candump()).unwrap().contains(" vcan1 181#"));
}

/// What happens to the master's interface to one bus stops all axes as what happens to all interfaces does.
#[test]
fn a_fault_of_any_bus_stops_all_axes_in_the_same_cycle() {
    let kinds = [
        Kind::BusOff,
        Kind::InterfaceDown,
        Kind::SendFailed,
        Kind::TransmitStalled,
        Kind::CableOut,
        Kind::ErrorPassive,
    ];
    for scenario in [sensor_apart(), drives_apart()] {
        for kind in kinds {
            for target in [Target::Link, Target::LeftDrive, Target::RightDrive, Target::Sensor] {
                let what = format!("{kind:?} on {target:?}");
                let mut session = scenario.run(500);
                session.inject(Injection { duration_s: Some(0.02), ..injection(kind, target) });
                session.run(1500);
                assert_eq!(session.machine.state(), State::Lost, "{what}: {:?}", session.fault());
                let faults = kind.row().expected.faults;
                assert!(faults.contains(&session.fault().unwrap()), "{what}: {:?}", session.fault());
                assert_names_its_bus(&scenario, target, session.machine.cause().unwrap());
                // Nothing that moves an axis leaves on any bus from the cycle of the fault on.
                let latched = session.rows.iter().position(|row| row.supervisor_state == State::Lost as u8).unwrap();
                assert!(latched <= 500 + 20, "{what}: after {latched} cycles");
                for drive in session.machine.drives() {
                    assert_ne!(drive.state(), cia402::State::OperationEnabled, "{what}");
                    assert!(drive.torque_n_m() == 0.0, "{what}");
                }
            }
        }
    }
}

/// A fault of an interface is told of the one to the bus of the target, and of no other.
fn assert_names_its_bus(scenario: &Scenario, target: Target, cause: Cause) {
    let is_of_interface =
        matches!(cause.fault, Fault::LinkDown | Fault::BusOff | Fault::ErrorPassive | Fault::TransmitStalled);
    let rig = &scenario.rig;
    let name = match target {
        Target::LeftDrive => &rig.drives[0].bus,
        Target::RightDrive => &rig.drives[1].bus,
        Target::Sensor => &rig.sensor.bus,
        _ => return,
    };
    let number = rig.buses.keys().position(|bus| bus == name).unwrap();
    if is_of_interface {
        assert_eq!(cause.devices, DeviceSet::interface(number), "{target:?}: {cause:?}");
    }
}

#[test]
fn what_a_node_of_one_bus_does_is_told_of_it_and_stops_the_drives_of_the_other() {
    let devices = [
        (Target::LeftDrive, DeviceSet::drive(0)),
        (Target::RightDrive, DeviceSet::drive(1)),
        (Target::Sensor, DeviceSet::SENSOR),
    ];
    for scenario in [sensor_apart(), drives_apart()] {
        for (target, device) in devices {
            for (kind, fault) in [
                (Kind::NodeReset, Fault::NodeReset),
                (Kind::DuplicateNode, Fault::DuplicateNode),
                (Kind::Emergency, Fault::Emergency),
            ] {
                let what = format!("{kind:?} of {target:?}");
                let mut session = scenario.run(500);
                session.inject(injection(kind, target));
                session.run(400);
                let cause = session.machine.cause().unwrap_or_else(|| panic!("{what}"));
                assert_eq!((cause.fault, cause.devices), (fault, device), "{what}");
                assert!(session.machine.drives().iter().all(|drive| drive.torque_n_m() == 0.0), "{what}");
            }
        }
    }
}

#[test]
fn the_watchdogs_of_drives_on_two_buses_are_drilled() {
    let scenario = drives_apart();
    let drilled = rig::drill(&scenario.rig, &scenario.scene, |_| ()).unwrap();
    assert!(drilled.judge(Demands::of(&scenario.rig)).is_ok(), "{drilled:?}");
    let of = |scenario: &Scenario| rig::drill(&scenario.rig, &scenario.scene, |_| ()).unwrap();
    assert_eq!(of(&sensor_apart()).findings.len(), drilled.findings.len());
}

#[test]
fn the_loop_for_real_buses_runs_them_in_both_paces() {
    for scenario in [sensor_apart(), drives_apart()] {
        for pace in [Pace::Lockstep, Pace::Free] {
            let what = format!("{} {pace:?}", scenario.rig.rig.name);
            let server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, pace).unwrap();
            let cable = Cable::new(server);
            let mut live = Runner::on_link(&scenario.rig, cable.clone(), cable.clone(), pace).unwrap();
            live.boot().unwrap();
            let serials = live.identities().unwrap();
            assert_eq!(serials.map(|drive| drive.serial_number), [1, 2], "{what}");
            let begun = cable.look(|server| (server.now(), server.counts().syncs));
            let play = Play { cycles: 2000, settling: 50 };
            let permit = permit(&live);
            let played = live.play(&play, &permit, &AtomicBool::new(false), |_| ()).unwrap();
            assert_eq!((played.ended, played.state, played.cause), (Ended::Whole, State::Running, None), "{what}");
            // Two SYNC a cycle are one period of the devices.
            let ended = cable.look(|server| (server.now(), server.counts().syncs));
            let periods = ended.0.since(begun.0).as_secs_f64() / scenario.period_s();
            let cycles = (ended.1 - begun.1) as f64 / 2.0;
            assert!((periods - cycles).abs() < 5.0, "{what}: {periods} periods, {cycles} cycles");
            assert_eq!(live.counts().refused, 0, "{what}");
        }
    }
}

/// One bus of a lost interface: whoever is on another one gets its last orders all the same.
#[test]
fn a_bus_that_stays_silent_is_the_fault_of_its_devices() {
    let scenario = drives_apart();
    let server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, Pace::Free).unwrap();
    let cable = Cable::new(server);
    let mut live = Runner::on_link(&scenario.rig, cable.clone(), cable.clone(), Pace::Free).unwrap();
    live.boot().unwrap();
    let play = Play { cycles: 300, settling: 50 };
    cable.set_passage({
        let begun = cable.look(|server| server.now());
        move |now, is_master, frame| is_master || frame.bus() == BusId::FIRST || now.0 < begun.0 + 1_300_000_000
    });
    let permit = permit(&live);
    let played = live.play(&play, &permit, &AtomicBool::new(false), |_| ()).unwrap();
    assert_eq!(played.ended, Ended::Stopped);
    assert_eq!(played.cause.map(|cause| (cause.fault, cause.devices)), Some((Fault::PdoMissed, DeviceSet::drive(1))));
    for _ in 0..1000 {
        live.run_cycle(Ask::Nothing);
    }
    assert!(cable.look(|server| server.torques_n_m()) == [0.0; 2]);
}

/// The rig on EtherCAT with the sensor of the rig on CAN: as fine, as often, sampled with the drives.
fn on_ethercat() -> Scenario {
    let mut scenario = Scenario::shipped("paper-ethercat.yaml");
    let sensor = Scenario::torque().rig.sensor;
    (scenario.rig.sensor.sample_rate_hz, scenario.rig.sensor.range_counts) =
        (sensor.sample_rate_hz, sensor.range_counts);
    scenario.rig.sensor.calibration = sensor.calibration;
    scenario
}

/// Tools of a scene at every cycle, without noise, frames that take no time, clocks that do not drift, and the sensor sampled with the
/// drives: then the moments of both buses are the same.
fn tools(mut scenario: Scenario) -> Vec<[f64; 3]> {
    scenario.scene.model.as_mut().expect("a model").force_sensor = ForceSensorModel::Quantised;
    scenario.rig.simulated_mut().unwrap().timing = BusTiming::Ideal;
    let mut session = scenario.start();
    session.machine.stop_drift();
    session.enable().unwrap_or_else(|error| panic!("{}: {error}", session.replay));
    session.machine.align_sensor(Duration::ZERO);
    session.run(27_000);
    assert_eq!((session.machine.state(), session.fault()), (State::Running, None), "{}", session.replay);
    session.rows.iter().map(|row| row.tool_m).collect()
}

/// What is left apart is rounding: the arm is integrated to other moments between the samples. Friction that sticks and counts that are
/// whole make it grow, so that the rig on CAN is farther from itself with half the step of the integration.
#[test]
fn a_rig_on_ethercat_moves_its_tool_as_that_on_can() {
    let mut finer = Scenario::torque();
    let step_us = &mut finer.scene.model.as_mut().expect("a model").plant_step_us;
    *step_us /= 2;
    let on_can = tools(Scenario::torque());
    let apart = |other: Vec<[f64; 3]>| -> Vec<f64> {
        on_can.iter().zip(&other).map(|(one, other)| elementary::hypot(one[0] - other[0], one[1] - other[1])).collect()
    };
    let farthest = |apart: &[f64]| apart.iter().copied().fold(0.0, f64::max);
    let (ethercat, finer) = (apart(tools(on_ethercat())), apart(tools(finer)));
    let [early, all, bound] = [&ethercat[..1500], &ethercat, &finer].map(farthest);
    println!("{early:e} m apart in 1.5 s, {all:e} m in 27 s; with half the step {bound:e} m");
    assert!(early < 10e-9, "{early} m apart in the first 1.5 s");
    assert!(all < bound, "{all} m apart, and with half the step {bound} m");
}
