//! The loop for a real bus, on a cable in memory: the rig against the same simulated devices, on a clock of its own.

use std::cell::Cell;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use hil_tests::segment_cable::SegmentCable;
use hil_tests::{
    Scenario,
    cable::{Cable, permit},
};
use yieldwall::bus::{BootFailure, SensorLink};
use yieldwall::canopen::{BusId, Frame, cob};
use yieldwall::config::{self, Source};
use yieldwall::elementary;
use yieldwall::guard::{Device, DeviceSet, Fault, State};
use yieldwall::link::CanLink;
use yieldwall::record::Row;
use yieldwall::rig::{self, DeviceServer, SegmentServer};
use yieldwall::run::bringup;
use yieldwall::run::{
    Ask, DRILL_LIMIT, Demands, Enable, Enabling, Ended, NotProven, OnLink, Orders, Pace, Play, Played, Proof, RunError,
    Runner, Unproven, Unsafe, Which,
};
use yieldwall::time::Time;
use yieldwall_drives::cia402;
use yieldwall_drives::profiles::SHIPPED;
use yieldwall_drives::watchdog::Watchdog;

type Rig = Runner<OnLink<Cable, Cable>>;

/// A drive as errors name it.
fn drive(node_id: u8) -> Which {
    let device = if node_id == 1 { Device::LeftDrive } else { Device::RightDrive };
    Which { device, node_id: Some(node_id) }
}

fn wired(scenario: &Scenario, pace: Pace) -> (Cable, Rig) {
    let server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, pace).unwrap();
    let cable = Cable::new(server);
    let rig = Runner::on_link(&scenario.rig, cable.clone(), cable.clone(), pace).unwrap();
    (cable, rig)
}

fn play(rig: &mut Rig, cycles: u64) -> (Played, Vec<Row>) {
    let mut rows = Vec::new();
    let play = Play { cycles, settling: 50 };
    let permit = permit(rig);
    let played = rig.play(&play, &permit, &AtomicBool::new(false), |record| rows.push(record.row())).unwrap();
    (played, rows)
}

/// The rig, enabled and run for `cycles` cycles.
fn running(scenario: &Scenario, pace: Pace, cycles: u32) -> (Cable, Rig) {
    let (cable, mut rig) = wired(scenario, pace);
    rig.boot().unwrap();
    let permit = permit(&rig);
    let mut enabling = Enabling::new(&scenario.rig);
    while let Enable::Ask(ask) = enabling.next(rig.state(), &permit) {
        rig.run_cycle(ask);
    }
    for _ in 0..cycles {
        rig.run_cycle(Ask::Nothing);
    }
    assert_eq!(rig.state(), State::Running);
    (cable, rig)
}

fn deepest_mm(rows: &[Row]) -> f64 {
    rows.iter().filter(|row| row.is_on_surface).map(|row| 1e3 * row.signed_distance_m.abs()).fold(0.0, f64::max)
}

#[test]
fn the_scene_is_that_of_the_embedded_simulation_in_both_paces_and_modes() {
    for scenario in [Scenario::torque(), Scenario::position()] {
        let mut embedded = scenario.enabled();
        embedded.run(4000);
        for pace in [Pace::Lockstep, Pace::Free] {
            let (cable, mut rig) = wired(&scenario, pace);
            rig.boot().unwrap();
            let (played, rows) = play(&mut rig, 4000);
            let what = format!("{} {pace:?}: {played:?}", scenario.file);
            assert_eq!((played.ended, played.state, played.cause), (Ended::Whole, State::Running, None), "{what}");
            // The devices' clocks start at other moments: the same motion within a cycle, not the same bits.
            let farthest = rows.iter().zip(&embedded.rows).map(|(live, embedded)| {
                let [x, y] = [0, 1].map(|axis| live.proxy_m[axis] - embedded.proxy_m[axis]);
                elementary::hypot(x, y)
            });
            let farthest = farthest.fold(0.0, f64::max);
            assert!(farthest < 2e-3, "{what}: {farthest} m apart");
            assert!(rows.iter().any(|row| row.is_on_surface), "{what}: never on the surface");
            assert!((deepest_mm(&rows) - deepest_mm(&embedded.rows)).abs() < 1.0, "{what}");
            let counts = rig.counts();
            assert_eq!((counts.overflowed, counts.refused), (0, 0), "{what}");
            cable.look(|server| {
                assert!(server.torques_n_m() == [0.0; 2], "{what}");
                assert!(server.counts().syncs > 4000, "{what}");
            });
        }
    }
}

/// A rig whose sensor speaks plain CAN.
const PLAIN: [&str; 2] = ["paper-admittance-streaming.yaml", "paper-admittance-polled.yaml"];

#[test]
fn in_lockstep_a_sensor_on_plain_can_is_waited_for_and_the_moment_of_the_boot_does_not_matter() {
    for file in PLAIN {
        let scenario = Scenario::shipped(file);
        let SensorLink::PlainCan(sensor) = yieldwall::assembly::bus_plan(&scenario.rig).unwrap().0.sensor.link else {
            panic!("{file}: not on plain CAN")
        };
        let mut runs = Vec::new();
        // How much later the network is booted, and how much longer the samples take than all process data.
        for (later_us, slower_us) in [(0, 0), (123_457, 0), (0, 700), (777_777, 1900)] {
            let (cable, mut rig) = wired(&scenario, Pace::Lockstep);
            cable.pass(Duration::from_micros(later_us));
            cable.set_slow(&sensor.protocol.data_ids(), Duration::from_micros(slower_us));
            rig.boot().unwrap();
            let mut samples = Vec::new();
            let play_it = Play { cycles: 3000, settling: 50 };
            let permit = permit(&rig);
            let played = rig.play(&play_it, &permit, &AtomicBool::new(false), |record| {
                let sample = record.inputs.sample.map(|sample| sample.counts);
                samples.push((record.moment.index, sample, record.row().proxy_m));
            });
            assert_eq!(played.unwrap().ended, Ended::Whole, "{file}");
            runs.push(samples);
        }
        let come = runs[0].iter().filter(|(_, sample, _)| sample.is_some()).count();
        let expected = 3000.0 * scenario.period_s() * scenario.rig.sensor.sample_rate_hz.get();
        assert!((come as f64 - expected).abs() <= 1.0, "{file}: {come} samples, {expected} by the rate");
        for (number, run) in runs.iter().enumerate() {
            let first = run.iter().zip(&runs[0]).enumerate().find(|(_, (one, other))| one != other);
            assert_eq!(first, None, "{file}: run {number} differs from the first one");
        }
    }
}

#[test]
fn a_sensor_on_plain_can_that_dies_in_lockstep_is_not_waited_for_without_end() {
    for file in PLAIN {
        let scenario = Scenario::shipped(file);
        let (cable, mut rig) = running(&scenario, Pace::Lockstep, 300);
        let SensorLink::PlainCan(sensor) = yieldwall::assembly::bus_plan(&scenario.rig).unwrap().0.sensor.link else {
            panic!("{file}: not on plain CAN")
        };
        let ids = sensor.protocol.data_ids();
        cable.set_passage(move |_, is_master, frame| is_master || !ids.contains(&frame.id()));
        assert!(until_latched(&mut rig, 2000).is_some(), "{file}");
        assert_at_rest(&cable, &mut rig, State::Stopped);
    }
}

/// Runs until the supervisor latches, for at most so many cycles; how many it took.
fn until_latched(rig: &mut Rig, limit: u32) -> Option<u32> {
    (1..=limit).find(|_| {
        rig.run_cycle(Ask::Nothing);
        rig.state().is_latched()
    })
}

fn fault(rig: &Rig) -> Option<Fault> {
    rig.cause().map(|cause| cause.fault)
}

fn drive_states(cable: &Cable) -> [cia402::State; 2] {
    cable.look(|server| server.drive_states())
}

/// Latched, both drives without torque, and nothing starts again by itself.
fn assert_at_rest(cable: &Cable, rig: &mut Rig, state: State) {
    for _ in 0..1500 {
        rig.run_cycle(Ask::Nothing);
    }
    assert_eq!(rig.state(), state);
    cable.look(|server| {
        assert!(server.drive_states().iter().all(|state| *state != cia402::State::OperationEnabled));
        assert_eq!(server.torques_n_m(), [0.0; 2]);
    });
}

#[test]
fn a_master_that_was_stopped_sends_no_target_when_it_goes_on() {
    for scenario in [Scenario::torque(), Scenario::position()] {
        let (cable, mut rig) = running(&scenario, Pace::Free, 300);
        cable.pass(Duration::from_millis(200));
        // The drives have acted meanwhile, by themselves.
        assert!(drive_states(&cable).iter().all(|state| *state != cia402::State::OperationEnabled));
        let record = rig.run_cycle(Ask::Nothing).unwrap();
        assert!(record.inputs.timing.skipped >= 199, "{:?}", record.inputs.timing);
        assert!(rig.state().is_latched(), "in the first cycle");
        let stood = record.moment.standstill.expect("the computer did not run it");
        assert!((198..=200).contains(&stood.lasted.as_millis()), "{stood:?}");
        let state = rig.state();
        assert_at_rest(&cable, &mut rig, state);
    }
}

#[test]
fn a_cycle_that_is_late_again_and_again_stops_the_rig() {
    let (cable, mut rig) = running(&Scenario::torque(), Pace::Free, 100);
    cable.set_late(Duration::from_micros(800));
    let cycles = until_latched(&mut rig, 2000).expect("it stops");
    assert!(cycles > 3, "one late cycle stops nothing");
    assert!(matches!(fault(&rig), Some(Fault::Overrun | Fault::SyncJitter)), "{:?}", fault(&rig));
    cable.set_late(Duration::ZERO);
    assert_at_rest(&cable, &mut rig, State::Stopped);
}

#[test]
fn an_interface_that_goes_down_is_a_lost_bus_and_the_drives_stop_by_themselves() {
    for pace in [Pace::Free, Pace::Lockstep] {
        let (cable, mut rig) = running(&Scenario::torque(), pace, 300);
        cable.set_down(true);
        assert!(until_latched(&mut rig, 3).is_some(), "{pace:?}");
        assert_eq!((rig.state(), fault(&rig)), (State::Lost, Some(Fault::LinkDown)));
        // In lockstep simulated time stands still for two seconds of the wall.
        cable.pass(Duration::from_secs(3));
        assert!(drive_states(&cable).iter().all(|state| *state != cia402::State::OperationEnabled), "{pace:?}");
        // It comes back up: nothing of before is sent, and nothing starts.
        cable.set_down(false);
        assert_at_rest(&cable, &mut rig, State::Lost);
    }
}

#[test]
fn an_interface_that_stalls_releases_one_cycle_at_most() {
    for scenario in [Scenario::torque(), Scenario::position()] {
        let (cable, mut rig) = running(&scenario, Pace::Free, 300);
        cable.set_stalled(true);
        for _ in 0..20 {
            rig.run_cycle(Ask::Nothing);
        }
        assert_eq!((rig.state(), fault(&rig)), (State::Lost, Some(Fault::TransmitStalled)));
        // SYNC and the two set-points of the cycle in which it stalled, or less; nothing that was computed later.
        let released = cable.set_stalled(false);
        assert!(released <= 3, "{released} frames");
        assert_at_rest(&cable, &mut rig, State::Lost);
    }
}

#[test]
fn a_drive_that_dies_stops_the_other_in_the_same_cycle() {
    for pace in [Pace::Free, Pace::Lockstep] {
        let scenario = Scenario::torque();
        let (cable, mut rig) = running(&scenario, pace, 300);
        let left = cob::node_id(1).unwrap();
        let own = [cob::tpdo(1, left), Some(cob::heartbeat(left)), Some(cob::emcy(left))];
        cable.set_passage(move |_, is_master, frame| is_master || !own.contains(&Some(frame.id())));
        // Missed process data: after two cycles the reference comes to rest, after five the drives quick-stop.
        assert_eq!(until_latched(&mut rig, 10), Some(5), "{pace:?}");
        assert_eq!((rig.state(), fault(&rig)), (State::Stopped, Some(Fault::PdoMissed)));
        assert_eq!(rig.standstill_before_fault(), None, "the computer has nothing to do with it");
        assert_at_rest(&cable, &mut rig, State::Stopped);
    }
}

#[test]
fn no_sync_follows_a_foreign_set_point_before_a_quick_stop_and_no_joint_moves() {
    for (scenario, pace, strikes) in [
        (Scenario::torque(), Pace::Lockstep, 1000),
        (Scenario::position(), Pace::Lockstep, 200),
        (Scenario::torque(), Pace::Free, 200),
        (Scenario::position(), Pace::Free, 200),
    ] {
        let file = scenario.file;
        // Enable Operation with half of the rated torque, or with position 0.
        let target = if file == Scenario::torque().file { &[0x0f, 0, 0xf4, 0x01][..] } else { &[0x0f, 0, 0, 0, 0, 0] };
        let (cable, mut rig) = running(&scenario.still(), pace, 20);
        // Behind which own frame the stranger sends next, and the identifier for which no quick stop has followed.
        let (next, open, syncs) = (Rc::new(Cell::new(None)), Rc::new(Cell::new(None)), Rc::new(Cell::new(0)));
        cable.set_stranger({
            let (next, open) = (Rc::clone(&next), Rc::clone(&open));
            move |own| {
                let (_, foreign): (u16, Frame) = next.get().filter(|(behind, _)| own.id() == *behind)?;
                next.set(None);
                open.set(Some(foreign.id()));
                Some(foreign)
            }
        });
        cable.set_passage({
            let (open, syncs) = (Rc::clone(&open), Rc::clone(&syncs));
            move |_, is_master, frame| {
                let is_stop = frame.bytes()[0] & 0x8f != 0x0f;
                if is_master && frame.id() == cob::SYNC {
                    syncs.set(syncs.get() + u32::from(open.get().is_some()));
                } else if is_master && open.get() == Some(frame.id()) && is_stop {
                    open.set(None);
                }
                true
            }
        });
        let mut farthest_rad = 0.0_f64;
        for strike in 0..strikes {
            let what = format!("{file} {pace:?} strike {strike}");
            let id = [0x201, 0x202][strike % 2];
            next.set(Some(([0x080, 0x201, 0x202][strike / 2 % 3], Frame::new(id, target))));
            let angles = |rig: &Rig| rig.last_outputs().map(|last| last.signals.measured_angles.to_array()).unwrap();
            let before = angles(&rig);
            for _ in 0..10 {
                rig.run_cycle(Ask::Nothing);
                let moved = angles(&rig).into_iter().zip(before).map(|(now, then)| (now - then).abs());
                farthest_rad = moved.fold(farthest_rad, f64::max);
            }
            assert_eq!((rig.state(), fault(&rig)), (State::Stopped, Some(Fault::Intruder)), "{what}");
            assert_eq!((syncs.get(), open.get()), (0, None), "{what}: SYNC made it act");
            assert!(farthest_rad < 5e-5, "{what}: a joint went {farthest_rad} rad");
            rig.run_cycle(Ask::Reset);
            for cycle in 0..400 {
                if rig.state() == State::Running {
                    break;
                }
                let asks = rig.state() == State::Idle && cycle % 8 == 7;
                let permit = permit(&rig);
                rig.run_cycle(if asks { Ask::Enable(&permit) } else { Ask::Nothing });
            }
            assert_eq!(rig.state(), State::Running, "{what}: {:?}", rig.cause());
        }
    }
}

#[test]
fn a_sensor_that_dies_stops_the_rig_along_its_ramp() {
    let (cable, mut rig) = running(&Scenario::position(), Pace::Lockstep, 300);
    cable.set_passage(|_, is_master, frame| is_master || !matches!(frame.id(), 0x18a | 0x28a | 0x70a));
    assert!(until_latched(&mut rig, 2000).is_some());
    assert_at_rest(&cable, &mut rig, State::Stopped);
}

#[test]
fn a_drive_that_does_not_answer_is_given_up_wherever_the_clock_of_lockstep_stands() {
    // The cycles' clock is 20 s ahead of the cable's clock, or behind it.
    for (cycles, passes) in [(20_000, Duration::ZERO), (300, Duration::from_secs(20))] {
        let (cable, mut rig) = wired(&Scenario::torque(), Pace::Lockstep);
        rig.boot().unwrap();
        for _ in 0..cycles {
            rig.run_cycle(Ask::Nothing);
        }
        cable.pass(passes);
        let from = cable.now();
        cable.set_passage(|_, is_master, frame| is_master || frame.id() != 0x581);
        let read = rig.read(Device::LeftDrive, 0x1018, 1);
        assert_eq!(read, Err(RunError::Unread { which: drive(1), index: 0x1018, sub: 1 }));
        let waited = cable.now().since(from);
        assert!(waited >= Duration::from_millis(900) && waited < Duration::from_secs(8), "{waited:?}");
    }
}

#[test]
fn who_is_not_there_is_named_and_nothing_is_enabled() {
    let (cable, mut rig) = wired(&Scenario::torque(), Pace::Free);
    cable.set_passage(|_, is_master, frame| is_master || frame.id() & 0x7f != 2);
    let error = rig.boot().unwrap_err();
    let RunError::Boot(error) = &error else { panic!("{error}") };
    assert_eq!((error.node_id, error.name.as_str()), (Some(2), "right"));
    assert!(matches!(error.failure, BootFailure::Missing { .. }), "{error}");
    assert!(drive_states(&cable).iter().all(|state| *state == cia402::State::SwitchOnDisabled));
    cable.set_down(true);
    assert!(matches!(rig.boot(), Err(RunError::Send { bus: BusId::FIRST, .. })));
}

#[test]
fn the_drill_on_a_bus_finds_what_the_one_in_virtual_time_finds() {
    for scenario in [Scenario::torque(), Scenario::position()] {
        let demands = Demands::of(&scenario.rig);
        let (_, mut live) = wired(&scenario, Pace::Free);
        let on_bus = bringup::drill(&mut live, 50, &AtomicBool::new(false), |_| ()).unwrap();
        let virtually = rig::drill(&scenario.rig, &scenario.scene, |_| ()).unwrap();
        on_bus.judge(demands).unwrap();
        virtually.judge(demands).unwrap();
        assert!(on_bus.resolution <= Duration::from_millis(3), "{:?}", on_bus.resolution);
        for (one, other) in on_bus.findings.iter().zip(&virtually.findings) {
            assert_eq!(one.watchdog, other.watchdog);
            for (one, other) in one.stopped_after.iter().zip(&other.stopped_after) {
                let apart = one.unwrap().abs_diff(other.unwrap());
                assert!(apart <= on_bus.resolution + Duration::from_millis(1), "{on_bus:?} {virtually:?}");
            }
        }
    }
}

#[test]
fn a_drive_without_a_watchdog_is_found_on_the_bus_and_in_virtual_time() {
    let scenario = Scenario::position();
    for watchdog in Watchdog::CANOPEN {
        let mut server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, Pace::Free).unwrap();
        server.ignore(watchdog);
        let cable = Cable::new(server);
        let mut live = Runner::on_link(&scenario.rig, cable.clone(), cable.clone(), Pace::Free).unwrap();
        let on_bus = bringup::drill(&mut live, 50, &AtomicBool::new(false), |_| ()).unwrap();
        let virtually = rig::drill(&scenario.rig, &scenario.scene, |machine| machine.ignore(watchdog)).unwrap();
        for drilled in [on_bus, virtually] {
            assert_eq!(
                drilled.judge(Demands::of(&scenario.rig)),
                Err(Unsafe::GoesOn { side: "left", watchdog }),
                "{drilled:?}"
            );
            let others = drilled.findings.iter().filter(|finding| finding.watchdog != watchdog);
            assert!(others.into_iter().all(|finding| {
                finding.stopped_after.iter().all(|after| after.is_some_and(|after| after < DRILL_LIMIT))
            }));
        }
        cable.look(|server| assert!(server.torques_n_m() == [0.0; 2], "it was stopped"));
    }
}

#[test]
fn simulated_drives_of_another_pace_or_in_lockstep_without_a_watchdog_are_refused_with_the_reason() {
    let scenario = Scenario::torque();
    let asked = |devices: Pace, pace: Pace, lacks: Option<Watchdog>| {
        let mut server = DeviceServer::new(&scenario.rig, &scenario.scene, scenario.seed, devices).unwrap();
        lacks.into_iter().for_each(|watchdog| server.ignore(watchdog));
        let cable = Cable::new(server);
        let mut rig = Runner::on_link(&scenario.rig, cable.clone(), cable.clone(), pace).unwrap();
        rig.boot().unwrap();
        rig.check_simulation()
    };
    for (pace, other) in [(Pace::Lockstep, Pace::Free), (Pace::Free, Pace::Lockstep)] {
        assert_eq!(asked(pace, pace, None), Ok(()));
        assert_eq!(asked(other, pace, None), Err(RunError::Pace { which: drive(1), pace }));
    }
    for watchdog in Watchdog::CANOPEN {
        let refused = RunError::Unwatched { which: drive(1), watchdog };
        assert_eq!(asked(Pace::Lockstep, Pace::Lockstep, Some(watchdog)), Err(refused));
        // By the wall clock the drill finds it.
        assert_eq!(asked(Pace::Free, Pace::Free, Some(watchdog)), Ok(()));
    }
}

#[test]
fn a_drive_without_the_mark_of_simulated_ones_is_refused_in_lockstep_and_nothing_but_the_whole_mark_counts() {
    let scenario = Scenario::torque();
    let proof = Proof::InVirtualTime(rig::drill(&scenario.rig, &scenario.scene, |_| ()).unwrap());
    for pace in [Pace::Lockstep, Pace::Free] {
        for sub in 1..=4 {
            let (cable, mut rig) = wired(&scenario, pace);
            rig.boot().unwrap();
            // It does not answer when it is asked for one of the four words.
            cable.set_passage(move |_, _, frame| {
                (frame.id(), frame.data().get(..4)) != (0x602, Some(&[0x40, 0x12, 0x20, sub]))
            });
            let proved = rig.prove(&scenario.rig, &proof);
            assert!(
                matches!(proved, Err(NotProven::Run(RunError::Unmarked { which })) if which == drive(2)),
                "{pace:?}, word {sub}: {proved:?}"
            );
        }
    }
    let (_, mut rig) = wired(&scenario, Pace::Lockstep);
    rig.boot().unwrap();
    assert!(rig.prove(&scenario.rig, &proof).is_ok());
    let lacking = rig::drill(&scenario.rig, &scenario.scene, |machine| machine.ignore(Watchdog::Sync)).unwrap();
    let proved = rig.prove(&scenario.rig, &Proof::InVirtualTime(lacking));
    assert!(matches!(proved, Err(NotProven::Unproven(Unproven::Unsafe(_)))), "{proved:?}");
    // Not by the wall clock, where their drill is possible.
    let (_, mut rig) = wired(&scenario, Pace::Free);
    rig.boot().unwrap();
    let proved = rig.prove(&scenario.rig, &proof);
    assert!(matches!(proved, Err(NotProven::Run(RunError::NotSimulated { which })) if which == drive(1)), "{proved:?}");
}

#[test]
fn a_permit_of_an_earlier_boot_enables_nothing() {
    let (cable, mut rig) = wired(&Scenario::torque(), Pace::Free);
    let before = permit(&rig);
    rig.boot().unwrap();
    let first = permit(&rig);
    let play = Play { cycles: 100, settling: 50 };
    let is_interrupted = AtomicBool::new(false);
    assert_eq!(rig.play(&play, &before, &is_interrupted, |_| ()), Err(RunError::OldPermit));
    rig.play(&play, &first, &is_interrupted, |_| ()).unwrap();
    rig.leave();
    rig.boot().unwrap();
    assert_eq!(rig.play(&play, &first, &is_interrupted, |_| ()), Err(RunError::OldPermit));
    rig.run_cycle(Ask::Reset);
    for _ in 0..100 {
        rig.run_cycle(Ask::Enable(&first));
    }
    assert_eq!(rig.state(), State::Idle);
    assert!(drive_states(&cable).iter().all(|state| *state != cia402::State::OperationEnabled));
    let again = permit(&rig);
    rig.play(&play, &again, &is_interrupted, |_| ()).unwrap();
}

/// Has somebody answer in the place of the right drive when it is asked for these objects.
fn answer_for_right(cable: &Cable, answers: &'static [([u8; 3], u32)]) {
    let answer = |frame: &Frame| {
        let asked = frame.data().get(1..4).filter(|_| frame.id() == 0x602 && frame.data()[0] == 0x40)?;
        let (multiplexer, value) = answers.iter().find(|(multiplexer, _)| multiplexer == asked)?;
        Some(Frame::new(0x582, &[&[0x43], &multiplexer[..], &value.to_le_bytes()].concat()))
    };
    cable.set_passage(move |_, _, frame| answer(frame).is_none());
    cable.set_stranger(answer);
}

#[test]
fn a_drive_of_another_profile_and_vendor_is_a_simulated_one_by_its_mark_alone() {
    const VENDOR: ([u8; 3], u32) = ([0x18, 0x10, 1], 0x0000_01dd);
    // Another word in the mark.
    const UNMARKED: &[([u8; 3], u32)] = &[VENDOR, ([0x12, 0x20, 4], u32::from_le_bytes(*b"vicf"))];
    let mut scenario = Scenario::torque();
    let model = SHIPPED
        .iter()
        .find(|(name, _)| *name == "simulated-servo")
        .unwrap()
        .1
        .replace("tried: simulation", "tried: never");
    let files = [
        (
            "rig.yaml",
            Source::named("builtin:paper-admittance.yaml")
                .read()
                .unwrap()
                .replace("profile: simulated-servo", "profile: model.yaml"),
        ),
        ("model.yaml", model),
    ];
    let files = files.map(|(name, text)| (PathBuf::from(name), Arc::from(text)));
    let described = config::load_rig(Source::among("rig.yaml", files)).unwrap().value;
    for (drive, other) in scenario.rig.drives.iter_mut().zip(described.drives) {
        drive.profile = other.profile;
    }
    let asked = |pace: Pace, answers| {
        let (cable, mut rig) = wired(&scenario, pace);
        rig.boot().unwrap();
        answer_for_right(&cable, answers);
        rig.check_simulation()
    };
    // The drives of a model that somebody has described in a file are simulated under that model's vendor.
    assert_eq!(asked(Pace::Lockstep, &[VENDOR]), Ok(()));
    assert_eq!(asked(Pace::Lockstep, UNMARKED), Err(RunError::NotSimulated { which: drive(2) }));
    assert_eq!(asked(Pace::Free, UNMARKED), Ok(()));
}

#[test]
fn in_lockstep_one_device_that_is_missing_takes_no_patience_from_the_others() {
    let (cable, mut rig) = running(&Scenario::torque(), Pace::Lockstep, 300);
    cable.set_passage(|_, is_master, frame| is_master || !matches!(frame.id(), 0x18a | 0x28a));
    cable.set_slow(&[0x181], Duration::from_millis(100));
    for cycle in 0..5 {
        let record = rig.run_cycle(Ask::Nothing).unwrap();
        let there = record.inputs.drives.map(|drive| drive.angle_rad.is_some());
        assert_eq!((there, record.inputs.sample), ([true; 2], None), "cycle {cycle}");
    }
}

#[test]
fn what_came_while_a_master_in_lockstep_was_stopped_is_of_one_device_each() {
    let (cable, mut rig) = running(&Scenario::torque(), Pace::Lockstep, 300);
    cable.pass(Duration::from_secs(5));
    assert!(drive_states(&cable).iter().all(|state| *state != cia402::State::OperationEnabled));
    for cycle in 0..20 {
        let record = rig.run_cycle(Ask::Nothing).unwrap();
        assert_eq!(record.inputs.link.duplicate_node, DeviceSet::NONE, "cycle {cycle}");
    }
    assert!(rig.state().is_latched());
    let stood = rig.standstill_before_fault().expect("it is why the drives have stopped");
    assert_eq!(stood.lasted.as_secs(), 5, "{stood:?}");
}

#[test]
fn an_orderly_end_leaves_no_error_in_the_drives_and_their_watch_lasts_until_they_are_stopped() {
    for (pace, slow_ms) in [(Pace::Free, 0), (Pace::Lockstep, 0), (Pace::Free, 600)] {
        let (cable, mut rig) = running(&Scenario::torque(), pace, 100);
        cable.change(|server| server.set_sdo_time(Duration::from_millis(slow_ms)));
        let seen = Arc::new(Mutex::new(Vec::new()));
        let noted = Arc::clone(&seen);
        cable.set_passage(move |_, _, frame| {
            let is_told = matches!(frame.id(), 0x081 | 0x082) || frame.bytes()[..4] == [0x23, 0x16, 0x10, 0x01];
            is_told.then(|| noted.lock().unwrap().push(frame.id()));
            true
        });
        assert!(rig.stop());
        assert_eq!(*seen.lock().unwrap(), [0_u16; 0], "{pace:?}: nothing is taken from drives that make torque");
        rig.leave();
        cable.pass(Duration::from_secs(1));
        assert_eq!(
            *seen.lock().unwrap(),
            [0x601, 0x602],
            "{pace:?}, {slow_ms} ms: the watch is ended, and no emergency"
        );
    }
}

#[test]
fn drives_that_still_make_torque_keep_their_watch_when_the_master_leaves() {
    let (cable, mut rig) = running(&Scenario::torque(), Pace::Free, 100);
    let written = Arc::new(Mutex::new(0));
    let count = Arc::clone(&written);
    cable.set_passage(move |_, _, frame| {
        *count.lock().unwrap() += u32::from(frame.bytes()[..4] == [0x23, 0x16, 0x10, 0x01]);
        true
    });
    rig.leave();
    assert_eq!(*written.lock().unwrap(), 0);
    cable.pass(Duration::from_secs(1));
    assert!(drive_states(&cable).iter().all(|state| *state != cia402::State::OperationEnabled));
}

#[test]
fn nodes_that_stay_pre_operational_are_named_with_their_state() {
    let (cable, mut rig) = wired(&Scenario::torque(), Pace::Free);
    // The start command is lost.
    cable.set_passage(|_, is_master, frame| !(is_master && frame.id() == cob::NMT && frame.data().first() == Some(&1)));
    let text = rig.boot().unwrap_err().to_string();
    let told = "node 1 (left): start the node: not Operational within 5000 ms after the start command; its last heartbeat says \
                Pre-operational";
    assert_eq!(text, told);
}

#[test]
fn who_watches_a_run_sees_its_last_frames() {
    for pace in [Pace::Free, Pace::Lockstep] {
        let (_, mut rig) = running(&Scenario::torque(), pace, 100);
        let seen = Arc::new(Mutex::new(Vec::<Frame>::new()));
        let tapped = Arc::clone(&seen);
        rig.set_tap(Box::new(move |_, packet| tapped.lock().unwrap().extend(packet.can())));
        rig.run_cycle(Ask::Nothing);
        rig.leave();
        let ids: Vec<u16> = seen.lock().unwrap().iter().map(|frame| frame.id()).collect();
        for id in [0x080, 0x201, 0x202, cob::NMT] {
            assert!(ids.contains(&id), "{pace:?}: {id:03X}h is not among {ids:03X?}");
        }
    }
}

/// A rig that a stall stops after 300 cycles, attended by somebody who gives these orders in every cycle in which it is stopped or
/// idles after that; who asks for the end when it has not come back for a second. How it ended, and the states that it was in since.
fn attended(gives: [bool; 2]) -> (Played, Vec<State>) {
    let (cable, mut rig) = wired(&Scenario::torque(), Pace::Free);
    rig.boot().unwrap();
    let (orders, is_interrupted) = (Arc::new(Orders::default()), Arc::new(AtomicBool::new(false)));
    let states = Arc::new(Mutex::new(Vec::new()));
    let (person, end, seen) = (Arc::clone(&orders), Arc::clone(&is_interrupted), Arc::clone(&states));
    let mut waited = 0;
    rig.set_observer(Box::new(move |record| {
        let mut seen = seen.lock().unwrap();
        let state = record.directive.state;
        if seen.is_empty() && !state.is_latched() {
            return;
        }
        if seen.last() != Some(&state) {
            seen.push(state);
        }
        let rests = state.is_latched() || state == State::Idle;
        waited = if rests { waited + 1 } else { 0 };
        if rests && gives[0] {
            person.reset();
        }
        if rests && gives[1] {
            person.enable();
        }
        if waited > 1000 {
            end.store(true, Ordering::Relaxed);
        }
    }));
    let mut cycle = 0;
    let permit = permit(&rig);
    let play = Play { cycles: 1000, settling: 50 };
    let played = rig.play_attended(&play, &permit, &is_interrupted, Some(&orders), |_| {
        cycle += 1;
        if cycle == 300 {
            cable.pass(Duration::from_millis(20));
        }
    });
    let states = states.lock().unwrap().clone();
    (played.unwrap(), states)
}

#[test]
fn a_rig_that_was_stopped_comes_back_by_both_orders_of_a_person_and_by_nothing_less() {
    let (played, states) = attended([true, true]);
    assert_eq!((played.ended, played.cycles, played.came_back), (Ended::Whole, 1000, 1), "{states:?}");
    let stopped = states[0];
    assert!(stopped.is_latched(), "{states:?}");
    assert_eq!(states[1..4], [State::Idle, State::Enabling, State::Running], "{states:?}");
    // A reset enables nothing; enabling without a reset is nothing.
    let (played, states) = attended([true, false]);
    assert_eq!((played.ended, played.came_back), (Ended::Stopped, 0), "{states:?}");
    assert_eq!(states, [stopped, State::Idle]);
    assert!(played.cause.is_some() && played.state == stopped, "what stopped it is not forgotten: {played:?}");
    for gives in [[false, true], [false, false]] {
        let (played, states) = attended(gives);
        assert_eq!((played.ended, played.came_back, &states[..]), (Ended::Stopped, 0, &[stopped][..]));
    }
}

/// The shipped rig on EtherCAT, and the cable to its devices.
fn on_segment(pace: Pace) -> (SegmentCable, config::Rig, Runner<OnLink<SegmentCable, SegmentCable>>) {
    let rig = hil_tests::segment::shipped();
    let scene = rig.scene().unwrap().value;
    let now = Time::from_micros(1_000_000);
    let server = SegmentServer::new(&rig.value, &scene, 1, pace, [true; 3], now).unwrap();
    let cable = SegmentCable::new(server, now);
    let runner = Runner::on_link(&rig.value, cable.clone(), cable.clone(), pace).unwrap();
    (cable, rig.value, runner)
}

#[test]
fn a_rig_on_ethercat_follows_the_hand_and_stops_in_both_paces() {
    for pace in [Pace::Free, Pace::Lockstep] {
        let (cable, _, mut rig) = on_segment(pace);
        rig.boot().unwrap();
        rig.check_simulation().unwrap();
        let identities = rig.identities().unwrap();
        assert_eq!(identities.map(|drive| (drive.node_id, drive.serial_number)), [(None, 1), (None, 2)]);
        let permit = permit(&rig);
        let mut rows = Vec::new();
        let play = Play { cycles: 4000, settling: 50 };
        let played = rig.play(&play, &permit, &AtomicBool::new(false), |record| rows.push(record.row())).unwrap();
        let what = format!("{pace:?}: {played:?}");
        assert_eq!((played.ended, played.state, played.cause), (Ended::Whole, State::Running, None), "{what}");
        assert!(rows.iter().any(|row| row.is_on_surface), "{what}: never on the surface");
        let segment = rig.master().networks().segment().unwrap();
        let counts = segment.counts();
        assert_eq!((counts.lost, counts.late, counts.foreign, rig.counts().refused), (0, 0, 0, 0), "{what}");
        assert!(segment.clock_lost().is_empty(), "{what}");
        assert_eq!(cable.change(|server| server.torques_n_m()), [0.0; 2], "{what}");
        rig.leave();
        // It can be booted again, after leaving and without.
        for _ in 0..2 {
            rig.boot().unwrap();
        }
    }
}

#[test]
fn drives_on_ethercat_stop_by_themselves_without_outputs_and_without_op() {
    let (cable, config, mut rig) = on_segment(Pace::Free);
    let drilled = bringup::drill(&mut rig, 50, &AtomicBool::new(false), |_| ()).unwrap();
    drilled.judge(Demands::of(&config)).unwrap();
    let [outputs, op] = drilled.findings.as_slice() else { panic!("{drilled:?}") };
    assert_eq!([outputs.watchdog, op.watchdog], [Watchdog::Outputs, Watchdog::Operational]);
    assert!(drilled.resolution.abs_diff(Duration::from_millis(1)) < Duration::from_micros(10), "a period: {drilled:?}");
    // Five cycles, and up to one more until the inputs say so.
    // SAFE-OP is asked for in the next frame beside the cycle.
    for (finding, [least_us, most_us]) in [(outputs, [5000, 6500]), (op, [0, 2500])] {
        let is_in_time =
            |after: &Option<Duration>| after.is_some_and(|it| (least_us..=most_us).contains(&it.as_micros()));
        assert!(finding.stopped_after.iter().all(is_in_time), "{finding:?}");
    }
    assert_eq!(cable.change(|server| server.torques_n_m()), [0.0; 2]);
}

#[test]
fn a_cable_that_is_pulled_stops_both_axes_and_nothing_comes_back_by_itself() {
    for pace in [Pace::Free, Pace::Lockstep] {
        let (cable, _, mut rig) = on_segment(pace);
        rig.boot().unwrap();
        let permit = permit(&rig);
        let run = |rig: &mut Runner<_>, cycles: u32| {
            for _ in 0..cycles {
                rig.run_cycle(Ask::Nothing);
            }
        };
        run(&mut rig, 60);
        rig.run_cycle(Ask::Enable(&permit));
        run(&mut rig, 300);
        assert_eq!(rig.state(), State::Running);
        cable.set_out(true);
        run(&mut rig, 5);
        assert!(rig.state().is_latched(), "{pace:?}: {:?}", rig.state());
        cable.set_out(false);
        run(&mut rig, 500);
        assert!(rig.state().is_latched(), "{pace:?}: {:?}", rig.state());
        assert_eq!(cable.change(|server| server.torques_n_m()), [0.0; 2], "{pace:?}");
        // A person restarts it.
        rig.boot().unwrap();
        run(&mut rig, 60);
        assert_ne!(rig.state(), State::Running, "nobody has enabled it");
    }
}
