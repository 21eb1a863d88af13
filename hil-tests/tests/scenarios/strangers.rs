//! Set-points of somebody else at any moment of the cycle: no SYNC that the master could hold back makes a drive act on one,
//! and no joint moves. What ends on the bus after SYNC was handed over, nobody can hear in time: it is counted apart.

use std::sync::{Arc, Mutex};

use hil_tests::{Scenario, Session};
use yieldwall::canopen::Frame;
use yieldwall::config::{Bus, SensorProtocol};
use yieldwall::guard::{Fault, Request, State};
use yieldwall::injection::{Injection, Kind, Target};
use yieldwall::rig::PORTS;
use yieldwall::time::Time;
use yieldwall_drives::cia402;

/// Cycles after a strike in which the drives have come to rest.
const AFTER: usize = 12;
/// Cycles that a rig may take from a stop to running.
const RETURN: usize = 400;
/// Greatest motion of a joint whose drive did not act on the stranger, rad: that of a control loop that is switched off. One
/// frame that acts moves it further in each of the rigs.
const AT_REST_RAD: f64 = 5e-5;

/// What went over the bus: end of the frame, port, frame.
type Wire = Arc<Mutex<Vec<(Time, usize, Frame)>>>;

/// What strikes did.
#[derive(Clone, Copy, Debug, Default)]
struct Strikes {
    heard: usize,
    too_late: usize,
    /// Farthest that a joint went, rad.
    heard_rad: f64,
    too_late_rad: f64,
}

/// Moments of a cycle, in no order and of every thousandth alike.
fn moments(count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(|at| (at as f64 * 0.618_033_988_749_895).fract())
}

/// A cycle of 100 ms.
fn slow() -> Scenario {
    let mut scenario = Scenario::shipped("paper-admittance-10ms.yaml");
    let rig = &mut scenario.rig;
    (rig.cycle.period_us, rig.cycle.compute_at_us) = (100_000, 50_000);
    rig.buses.values_mut().filter_map(Bus::canopen_mut).for_each(|bus| bus.heartbeat_ms = 250);
    rig.drives.iter_mut().filter_map(|drive| drive.address.canopen_mut()).for_each(|node| node.heartbeat_ms = 250);
    if let SensorProtocol::Canopen { heartbeat_ms, .. } = &mut rig.sensor.protocol {
        *heartbeat_ms = 250;
    }
    scenario
}

fn watched(scenario: &Scenario) -> (Session, Wire) {
    let mut session = scenario.start();
    let wire = Wire::default();
    let seen = Arc::clone(&wire);
    session.machine.set_witness(Box::new(move |passage| {
        seen.lock().expect("one thread").push((passage.time, passage.from, passage.sent));
    }));
    session.enable().unwrap_or_else(|error| panic!("{error}; replay: {}", session.replay));
    (session, wire)
}

/// Resets a rig that was stopped, and enables it.
fn come_back(session: &mut Session) {
    session.step(Request::Reset);
    for cycle in 0..RETURN {
        if session.machine.state() == State::Running {
            session.run(5);
            return;
        }
        let asks = session.machine.state() == State::Idle && cycle % 8 == 7;
        session.step(if asks { Request::Enable } else { Request::None });
    }
    panic!("{:?} by {:?}; replay: {}", session.machine.state(), session.fault(), session.replay);
}

/// Whether the stranger's frame was over when SYNC was handed over; panics if that SYNC left all the same.
fn judge(wire: &[(Time, usize, Frame)], next_sync: Time, what: &str) -> bool {
    let is_set_point = |frame: &Frame| matches!(frame.id(), 0x201 | 0x202);
    let (mut struck, mut is_heard) = (None, false);
    for (time, port, frame) in wire {
        let is_ours = *port == PORTS[0];
        let enables = frame.bytes()[0] & 0x8f == 0x0f;
        match frame.id() {
            _ if !PORTS.contains(port) && is_set_point(frame) => {
                (struck, is_heard) = (Some(frame.id()), *time <= next_sync);
            }
            0x080 if is_ours => assert!(struck.is_none() || !is_heard, "{what}: SYNC after it"),
            id if is_ours && struck == Some(id) && !enables => struck = None,
            _ => {}
        }
    }
    assert_eq!(struck, None, "{what}: no quick stop followed");
    is_heard
}

/// Strikes a running rig that often, at moments all over the cycle.
fn strike(scenario: &Scenario, count: usize) -> Strikes {
    let (mut session, mut wire) = watched(scenario);
    session.run(20);
    let mut strikes = Strikes::default();
    for (at, moment) in moments(count).enumerate() {
        let what = format!("{} strike {at} at {moment:.3} of the cycle; {}", scenario.file, session.replay);
        wire.lock().expect("one thread").clear();
        let before = session.machine.body_truth().angles.to_array();
        let target = [Target::LeftDrive, Target::RightDrive][at % 2];
        let next_sync = session.machine.next_sync() + std::time::Duration::from_secs_f64(scenario.period_s());
        let one_cycle = Some(0.5 * scenario.period_s());
        session.inject(Injection::new(Kind::ForeignSetPoint, 0.0).on(target).sized(moment).lasting(one_cycle));
        let mut farthest_rad = 0.0_f64;
        for _ in 0..AFTER {
            session.step(Request::None);
            let now = session.machine.body_truth().angles.to_array();
            farthest_rad = now.iter().zip(before).map(|(now, then)| (now - then).abs()).fold(farthest_rad, f64::max);
        }
        assert_eq!((session.machine.state(), session.fault()), (State::Stopped, Some(Fault::Intruder)), "{what}");
        for drive in session.machine.drives() {
            assert_ne!(drive.state(), cia402::State::OperationEnabled, "{what}");
        }
        if judge(&wire.lock().expect("one thread"), next_sync, &what) {
            strikes.heard += 1;
            strikes.heard_rad = strikes.heard_rad.max(farthest_rad);
            assert!(farthest_rad < AT_REST_RAD, "{what}: a joint went {farthest_rad} rad");
            come_back(&mut session);
        } else {
            strikes.too_late += 1;
            strikes.too_late_rad = strikes.too_late_rad.max(farthest_rad);
            // The arm is no longer where the scene began.
            (session, wire) = watched(scenario);
            session.run(20);
        }
    }
    println!("{} at {} ms: {strikes:?}", scenario.file, 1e3 * scenario.period_s());
    assert!(strikes.heard > count * 4 / 5, "{strikes:?}");
    strikes
}

#[test]
fn at_1_ms_no_foreign_set_point_that_is_heard_moves_a_joint() {
    for scenario in [Scenario::torque(), Scenario::position()] {
        let strikes = strike(&scenario.still(), 1000);
        // A frame of 86 to 118 us in a cycle of 1000 us.
        assert!(strikes.too_late > 0 && strikes.too_late < 150, "{strikes:?}");
    }
}

#[test]
fn at_10_ms_no_foreign_set_point_that_is_heard_moves_a_joint() {
    strike(&Scenario::shipped("paper-admittance-10ms.yaml").still(), 1000);
}

#[test]
fn at_100_ms_no_foreign_set_point_that_is_heard_moves_a_joint() {
    strike(&slow().still(), 1000);
}

#[test]
fn a_stranger_that_goes_on_keeps_sync_away_and_the_drives_stop_by_themselves() {
    for scenario in [Scenario::torque(), Scenario::position()] {
        let scenario = scenario.still();
        let (mut session, wire) = watched(&scenario);
        session.run(20);
        wire.lock().expect("one thread").clear();
        let begun = session.machine.next_sync();
        session.inject(Injection::new(Kind::ForeignSetPoint, 0.0).sized(0.8).lasting(Some(0.5)));
        session.run(400);
        assert_eq!((session.machine.state(), session.fault()), (State::Stopped, Some(Fault::Intruder)));
        let syncs = wire.lock().expect("one thread").iter().filter(|(_, _, frame)| frame.id() == 0x080).count();
        assert_eq!(syncs, 1, "that of the cycle in which it began, at {begun:?}");
        for drive in session.machine.drives() {
            assert_eq!((drive.torque_n_m(), drive.state() == cia402::State::OperationEnabled), (0.0, false));
        }
        // It ends, and a person has the rig run again.
        session.run(200);
        session.machine.enable_again().unwrap_or_else(|error| panic!("{error}; replay: {}", session.replay));
    }
}
