//! Rigs whose force sensor speaks plain CAN: they run, and the faults of the matrix hold for them.

use hil_tests::{Scenario, Session};
use yieldwall::canopen::Frame;
use yieldwall::config::Positive;
use yieldwall::elementary;
use yieldwall::guard::{Fault, Request, State};
use yieldwall::injection::{Injection, Kind, Target};
use yieldwall::rig::RigError;
use yieldwall::time::Time;

const STREAMING: &str = "paper-admittance-streaming.yaml";
const POLLED: &str = "paper-admittance-polled.yaml";
/// Port of the sensor on the virtual bus.
const SENSOR: usize = 3;
/// Cycles of the scene before something is injected: the tool moves.
const BEFORE: usize = 700;

fn sensor_ids(file: &str) -> [u16; 3] {
    if file == STREAMING { [0x35f, 0x360, 0x361] } else { [0x1b0, 0x1b5, 0x1b6] }
}

/// Runs on for as long as it takes to know how it ends; with the faults that showed of those that the injection brings.
fn inject(file: &'static str, injection: Injection) -> (Session, Vec<Fault>) {
    let mut session = Scenario::shipped(file).run(BEFORE);
    assert_eq!(session.machine.state(), State::Running, "{file}");
    session.inject(injection);
    let mut seen = Vec::new();
    for _ in 0..1500 {
        session.step(Request::None);
        let counts = session.machine.master().cycle().faults();
        let new = injection.kind.row().expected.faults.iter().filter(|fault| counts.count(**fault) > 0);
        let new: Vec<Fault> = new.copied().filter(|fault| !seen.contains(fault)).collect();
        seen.extend(new);
    }
    (session, seen)
}

fn sensor(kind: Kind) -> Injection {
    Injection { target: Target::Sensor, ..Injection::new(kind, 0.0) }
}

#[test]
fn rigs_run_at_every_rate_and_the_force_is_no_older_than_a_period_and_a_cycle() {
    for file in [STREAMING, POLLED] {
        for rate_hz in [200.0, 500.0, 1000.0] {
            let mut scenario = Scenario::shipped(file);
            scenario.rig.sensor.sample_rate_hz = Positive::new(rate_hz).unwrap();
            let session = scenario.run(5000);
            assert_eq!(session.machine.state(), State::Running, "{file} at {rate_hz} Hz: {:?}", session.fault());
            let oldest = session.rows.iter().map(|row| row.force_age_s).fold(0.0, f64::max);
            // Its clock is slow by 50 ppm; an answer tells the sample of up to a cycle before.
            let allowed = 1.0001 / rate_hz + scenario.period_s() + 0.0005;
            assert!(oldest > 0.0 && oldest <= allowed, "{file} at {rate_hz} Hz: {oldest} s");
            let pressed =
                session.rows.iter().map(|row| elementary::hypot(row.force_n[0], row.force_n[1])).fold(0.0, f64::max);
            assert!(pressed > 5.0, "{file} at {rate_hz} Hz: the hand is felt, {pressed} N");
        }
    }
}

#[test]
fn the_sensor_is_told_to_begin_and_its_frames_come_in_pairs() {
    for file in [STREAMING, POLLED] {
        let session = Scenario::shipped(file).run(200);
        let [order, first, second] = sensor_ids(file);
        let frames = session.recording().frames;
        let orders: Vec<u8> =
            frames.iter().filter(|seen| seen.frame.id() == order).map(|seen| seen.frame.bytes()[0]).collect();
        if file == STREAMING {
            assert_eq!(orders, [0x0c, 0x11, 0x0b], "stop, zero, start, and nothing more");
        } else {
            assert_eq!(orders[..2], [0x04, 0x02]);
            assert!(orders.len() > 200 && orders[2..].iter().all(|code| *code == 0x02));
        }
        let of_sensor: Vec<u16> =
            frames.iter().map(|seen| seen.frame.id()).filter(|id| [first, second].contains(id)).collect();
        assert!(of_sensor.len() >= 200);
        assert!(of_sensor.chunks_exact(2).all(|pair| pair == [first, second]));
        assert!(frames.iter().all(|seen| seen.frame.id() != 0x70a), "no heartbeat, and none is missed");
    }
}

#[test]
fn a_sensor_that_says_nothing_new_stops_the_rig() {
    for file in [STREAMING, POLLED] {
        for kind in [Kind::SensorStale, Kind::SensorSilent] {
            let (session, seen) = inject(file, sensor(kind));
            assert_eq!(
                (session.machine.state(), session.fault()),
                (State::Stopped, Some(Fault::SensorLost)),
                "{file} {kind:?}"
            );
            assert!(seen.contains(&Fault::SensorStale), "{file} {kind:?}: {seen:?}");
        }
    }
}

#[test]
fn a_sensor_that_hangs_or_is_at_its_end_stops_the_rig() {
    for file in [STREAMING, POLLED] {
        let stuck = Injection { duration_s: Some(1.0), ..sensor(Kind::SensorStuck) };
        for (injection, fault) in [(stuck, Fault::SensorStuck), (sensor(Kind::SensorSaturated), Fault::SensorSaturated)]
        {
            let (session, seen) = inject(file, injection);
            assert_eq!(session.machine.state(), State::Stopped, "{file} {:?}", injection.kind);
            assert!(seen.contains(&fault), "{file} {:?}: {seen:?}", injection.kind);
            let caused = session.fault().unwrap();
            assert!(injection.kind.row().expected.faults.contains(&caused), "{file} {:?}: {caused:?}", injection.kind);
        }
    }
}

#[test]
fn a_polled_sensor_can_say_that_its_samples_are_not_valid() {
    let (session, _) = inject(POLLED, sensor(Kind::SensorInvalid));
    assert_eq!((session.machine.state(), session.fault()), (State::Stopped, Some(Fault::SensorInvalid)));
}

#[test]
fn a_clock_that_is_slow_by_a_tenth_is_no_fault() {
    for file in [STREAMING, POLLED] {
        let (session, _) = inject(file, Injection { duration_s: Some(1.0), ..sensor(Kind::SensorClockDrift) });
        assert_eq!(session.machine.state(), State::Running, "{file}: {:?}", session.fault());
    }
}

#[test]
fn a_sensor_that_was_without_supply_comes_back_when_the_rig_is_started_anew() {
    for file in [STREAMING, POLLED] {
        for kind in [Kind::NodeSilent, Kind::NodeReset] {
            let (mut session, _) = inject(file, sensor(kind));
            // A polled sensor that restarts goes on to answer, from zero.
            let goes_on = (file, kind) == (POLLED, Kind::NodeReset);
            let expected = if goes_on { State::Running } else { State::Stopped };
            assert_eq!(session.machine.state(), expected, "{file} {kind:?}: {:?}", session.fault());
            session.machine.restart().unwrap_or_else(|error| panic!("{file} {kind:?}: {error}"));
            session.run(100);
            assert_eq!(session.machine.state(), State::Running, "{file} {kind:?}");
        }
    }
}

#[test]
fn what_only_a_canopen_node_can_do_is_refused() {
    for file in [STREAMING, POLLED] {
        let mut session = Scenario::shipped(file).start();
        for kind in [
            Kind::HeartbeatSilent,
            Kind::DuplicateNode,
            Kind::IntruderNmt,
            Kind::Emergency,
            Kind::EmergencyWarning,
            Kind::IdentityMismatch,
            Kind::WrongNodeId,
        ] {
            let refused = session.machine.inject(sensor(kind));
            assert!(matches!(refused, Err(RigError::InjectionNeeds { .. })), "{file} {kind:?}: {refused:?}");
        }
        let invalid = session.machine.inject(sensor(Kind::SensorInvalid));
        assert_eq!(invalid.is_err(), file == STREAMING);
    }
}

#[test]
fn a_sensor_that_is_not_there_is_named() {
    for file in [STREAMING, POLLED] {
        let mut session = Scenario::shipped(file).start();
        session.tamper(|_: Time, from: usize, frame: Frame| (from != SENSOR).then_some(frame));
        let error = session.enable().unwrap_err().to_string();
        assert!(error.contains("wrist: wait for samples: no whole sample within 5000 ms"), "{error}");
    }
}

#[test]
fn halves_that_are_lost_are_samples_that_are_lost_and_no_other_force() {
    for file in [STREAMING, POLLED] {
        let [_, first, second] = sensor_ids(file);
        let clean = Scenario::shipped(file).run(2000);
        let mut session = Scenario::shipped(file).enabled();
        let mut number = 0u32;
        session.tamper(move |_: Time, _: usize, frame: Frame| {
            let is_half = frame.id() == first || frame.id() == second;
            number += u32::from(is_half);
            (!(is_half && number.is_multiple_of(7))).then_some(frame)
        });
        session.run(2000);
        assert_eq!(session.machine.state(), State::Running, "{file}: {:?}", session.fault());
        let most = |rows: &[yieldwall::record::Row]| {
            let steps = rows.windows(2).map(|pair| (pair[1].force_n[0] - pair[0].force_n[0]).abs());
            steps.fold(0.0, f64::max)
        };
        // A sample of two halves would be a leap of the force.
        assert!(most(&session.rows) < 4.0 * most(&clean.rows), "{file}");
        session.step(Request::None);
    }
}

#[test]
fn somebody_else_who_gives_orders_to_the_sensor_stops_the_rig() {
    for file in [STREAMING, POLLED] {
        let [order, first, _] = sensor_ids(file);
        let mut session = Scenario::shipped(file).run(BEFORE);
        // A frame of the sensor is heard as an order, once.
        let mut is_done = false;
        session.tamper(move |_: Time, _: usize, frame: Frame| {
            let is_it = frame.id() == first && !is_done;
            is_done |= is_it;
            Some(if is_it { Frame::new(order, &[0x55]) } else { frame })
        });
        session.run(300);
        assert_eq!(session.fault(), Some(Fault::Intruder), "{file}");
    }
}
