//! Faults on the bus and in the devices: what leaves in answer, for both drives in the same cycle, and that it stays.

use hil_tests::{Recording, Scenario, Session, setpoint};
use yieldwall::bus::{BootFailure, Phase};
use yieldwall::canopen::Frame;
use yieldwall::elementary;
use yieldwall::guard::{Fault, JointCommand, Request, State};
use yieldwall::injection::{Injection, Kind};
use yieldwall::rig::RigError;
use yieldwall::sim::can::BusCounters;
use yieldwall_drives::cia402;

/// Quick stop, by its literal controlword.
const QUICK_STOP: u16 = 0x0002;
/// The error code that a test gives a drive: internal temperature.
const OVERHEATED: u16 = 0x4210;

fn both() -> [Scenario; 2] {
    [Scenario::torque(), Scenario::position()]
}

/// A rig in motion.
fn moving(scenario: &Scenario) -> Session {
    let session = scenario.run(700);
    let row = session.rows.last().unwrap();
    assert!(elementary::hypot(row.tool_velocity_m_per_s[0], row.tool_velocity_m_per_s[1]) > 0.02, "{}", session.replay);
    session
}

/// Runs until the rig is in `state`; how many cycles that took.
fn cycles_until(session: &mut Session, state: State) -> usize {
    for cycle in 1..=2000 {
        session.step(Request::None);
        if session.machine.state() == state {
            return cycle;
        }
    }
    panic!("{:?} ({:?}) and not {state:?}; replay: {}", session.machine.state(), session.fault(), session.replay)
}

/// The controlwords of both drives, cycle by cycle.
fn controlwords(recording: &Recording) -> Vec<[u16; 2]> {
    let each = |cycle: &&[hil_tests::ObservedFrame]| {
        let word = |id: u16| cycle.iter().find(|seen| seen.frame.id() == id).map(|seen| setpoint(seen).controlword);
        Some([word(0x201)?, word(0x202)?])
    };
    recording.cycles().iter().filter_map(each).collect()
}

/// Checks that both drives were told to stop by `stopped_by` in the same cycle, that nothing enables them afterwards, and that
/// they have no torque in the end.
fn check_stopped(session: &mut Session, stopped_by: [u16; 2]) {
    session.run(600);
    let replay = session.replay.clone();
    let words = controlwords(&session.recording());
    let stop = words.iter().rposition(|words| words[0] & 0x8f == 0x0f || words[1] & 0x8f == 0x0f).unwrap() + 1;
    assert_eq!(words[stop - 1], [0x000f; 2], "both were enabled up to the same cycle; {replay}");
    assert_eq!(words[stop], stopped_by, "both are stopped in the same cycle; {replay}");
    assert!(words.len() > stop + 500, "nothing was enabled for long; {replay}");
    assert!(session.machine.state().is_latched(), "{replay}");
    for drive in session.machine.drives() {
        assert_ne!(drive.state(), cia402::State::OperationEnabled, "{replay}");
        assert_eq!(drive.torque_n_m(), 0.0, "{replay}");
    }
    // Asking to be enabled does not help.
    session.step(Request::Enable);
    session.run(20);
    assert!(session.machine.state().is_latched(), "{replay}");
}

#[test]
fn a_force_sensor_that_falls_silent_freezes_then_stops_the_rig() {
    for scenario in both() {
        for lost in [0x18a, 0x28a] {
            let mut session = moving(&scenario);
            session.tamper(move |_, _, frame: Frame| (frame.id() != lost).then_some(frame));
            assert_eq!(cycles_until(&mut session, State::Holding), 3, "R1; {}", session.replay);
            assert_eq!(session.fault(), Some(Fault::SensorStale));
            assert_eq!(cycles_until(&mut session, State::Stopping), 7, "R2; {}", session.replay);
            assert_eq!(session.fault(), Some(Fault::SensorLost));
            cycles_until(&mut session, State::Stopped);
            check_stopped(&mut session, [QUICK_STOP; 2]);
        }
    }
}

#[test]
fn a_short_gap_of_the_force_sensor_holds_and_clears() {
    for scenario in both() {
        let mut session = moving(&scenario);
        let mut frames = 0;
        session.tamper(move |_, _, frame: Frame| {
            let is_force = frame.id() == 0x18a;
            frames += u32::from(is_force);
            (!is_force || frames > 4).then_some(frame)
        });
        assert_eq!(cycles_until(&mut session, State::Holding), 3);
        let hold = cycles_until(&mut session, State::Running);
        assert!((50..60).contains(&hold), "{hold}");
        session.run(300);
        assert_eq!((session.machine.state(), session.fault()), (State::Running, None), "{}", session.replay);
    }
}

#[test]
fn one_lost_frame_of_a_drive_goes_unnoticed() {
    for scenario in both() {
        let mut session = moving(&scenario);
        let mut frames = 0;
        session.tamper(move |_, _, frame: Frame| {
            frames += u32::from(frame.id() == 0x181);
            (frame.id() != 0x181 || frames != 1).then_some(frame)
        });
        session.run(300);
        assert_eq!((session.machine.state(), session.fault()), (State::Running, None), "{}", session.replay);
        assert_eq!(session.machine.bus_counters().sum::<BusCounters>().dropped, 1);
    }
}

#[test]
fn after_a_fault_a_person_resets_and_enables_and_it_starts_where_it_is() {
    for scenario in both() {
        let mut session = moving(&scenario);
        session.inject(Injection::new(Kind::DriveFault, 0.0).sized(OVERHEATED.into()));
        session.run(500);
        assert_eq!(session.machine.drives()[0].state(), cia402::State::Fault, "nobody has reset it");
        session.step(Request::Reset);
        session.run(20);
        assert_eq!(session.machine.state(), State::Idle);
        assert_ne!(session.machine.drives()[0].state(), cia402::State::Fault);
        session.step(Request::Enable);
        let before = session.rows.len();
        cycles_until(&mut session, State::Running);
        let row = session.rows.last().unwrap();
        assert_eq!(row.target_angles_rad, row.measured_angles_rad, "starts-in-place; {}", session.replay);
        match session.machine.last_outputs().unwrap().command.get() {
            JointCommand::Torque(torques) => assert_eq!(torques.to_array(), [0.0; 2]),
            JointCommand::Position(angles) => assert_eq!(angles.to_array(), row.measured_angles_rad),
            JointCommand::Velocity(_) => unreachable!("no such rig"),
        }
        assert!(session.rows.len() - before < 20);
        // One reset edge, on the bus, to the drive in fault alone.
        let resets = |joint: usize| {
            session.recording().setpoints(joint).iter().filter(|sent| sent.controlword & 0x80 != 0).count()
        };
        assert_eq!((resets(0), resets(1)), (1, 0), "{}", session.replay);
    }
}

/// Replaces the next frame with identifier `id` by `frame`, once.
fn replace_once(session: &mut Session, id: u16, with: Frame) {
    let mut done = false;
    session.tamper(move |_, _, frame: Frame| {
        if done || frame.id() != id {
            return Some(frame);
        }
        done = true;
        Some(with)
    });
}

#[test]
fn a_node_that_restarts_leaves_operational_or_falls_silent_stops_both() {
    let cases: [(u16, Option<Frame>, Fault); 5] = [
        // Boot-up, Pre-operational, Stopped instead of a heartbeat.
        (0x701, Some(Frame::new(0x701, &[0x00])), Fault::NodeReset),
        (0x70a, Some(Frame::new(0x70a, &[0x00])), Fault::NodeReset),
        (0x702, Some(Frame::new(0x702, &[0x7f])), Fault::HeartbeatLost),
        (0x701, Some(Frame::new(0x701, &[0x04])), Fault::HeartbeatLost),
        (0x702, None, Fault::HeartbeatLost),
    ];
    for scenario in both() {
        for (id, with, fault) in cases {
            let mut session = moving(&scenario);
            match with {
                Some(frame) => replace_once(&mut session, id, frame),
                None => session.tamper(move |_, _, frame: Frame| (frame.id() != id).then_some(frame)),
            }
            let state = if fault == Fault::HeartbeatLost { State::Lost } else { State::Stopped };
            let cycles = cycles_until(&mut session, state);
            // A heartbeat every 20 ms, lost after 40.
            let bound = if with.is_some() { 21 } else { 41 };
            assert!(cycles <= bound, "{cycles} cycles; {}", session.replay);
            assert_eq!(session.fault(), Some(fault), "{}", session.replay);
            check_stopped(&mut session, [QUICK_STOP; 2]);
        }
    }
}

/// Checks that the boot was refused at `node` (by name) for a reason that `is_it` knows, and that no drive ever got a
/// set-point.
fn check_refused(
    scenario: &Scenario,
    tamper: impl FnMut(Frame) -> Option<Frame> + Send + 'static,
    name: &str,
) -> BootFailure {
    let mut tamper = tamper;
    let mut session = scenario.start();
    session.tamper(move |_, _, frame| tamper(frame));
    let error = session.enable().expect_err("the rig must not be enabled");
    let RigError::Boot(error) = error else { panic!("{error}") };
    assert_eq!(error.name, name, "{error}");
    assert!(matches!(session.machine.master().networks().phase(), Phase::Failed(_)));
    let recording = session.recording();
    assert!(!recording.frames.is_empty());
    for joint in 0..2 {
        assert!(recording.setpoints(joint).is_empty(), "a set-point left: {error}");
    }
    assert!(recording.with_id(0x000).all(|seen| seen.frame.data()[0] != 0x01), "a node was started: {error}");
    error.failure
}

/// Replaces the value in an expedited SDO answer of `node` about an object.
fn lie(node: u16, object: [u8; 3], value: [u8; 4]) -> impl FnMut(Frame) -> Option<Frame> + Send + 'static {
    move |frame| {
        let data = *frame.bytes();
        let is_it = frame.id() == 0x580 + node && data[0] & 0xe0 == 0x40 && data[1..4] == object;
        let [a, b, c, d] = value;
        Some(if is_it { Frame::new(frame.id(), &[data[0], data[1], data[2], data[3], a, b, c, d]) } else { frame })
    }
}

#[test]
fn a_device_that_is_not_what_the_profile_says_is_never_enabled() {
    for scenario in both() {
        let vendor = check_refused(&scenario, lie(1, [0x18, 0x10, 1], [0x9a, 0, 0, 0]), "left");
        assert!(matches!(vendor, BootFailure::Identity { index: 0x1018, sub: 1, received: 0x9a, .. }), "{vendor}");
        let product = check_refused(&scenario, lie(2, [0x18, 0x10, 2], [3, 4, 0, 0]), "right");
        assert!(matches!(product, BootFailure::Identity { index: 0x1018, sub: 2, received: 0x403, .. }), "{product}");
        let kind = check_refused(&scenario, lie(10, [0x00, 0x10, 0], [0x92, 1, 2, 0]), "wrist");
        assert!(matches!(kind, BootFailure::Identity { index: 0x1000, received: 0x0002_0192, .. }), "{kind}");
        let modes = check_refused(&scenario, lie(1, [0x02, 0x65, 0], [0; 4]), "left");
        assert!(matches!(modes, BootFailure::Identity { index: 0x6502, received: 0, .. }), "{modes}");
        let limit = check_refused(&scenario, lie(2, [0x72, 0x60, 0], [0x10, 0x27, 0, 0]), "right");
        assert!(matches!(limit, BootFailure::ReadBack { index: 0x6072, received: 10_000, .. }), "{limit}");
    }
}

#[test]
fn a_node_that_is_missing_or_deaf_is_named() {
    for scenario in both() {
        let absent = |frame: Frame| (frame.id() & 0x7f != 2 || frame.id() == 0x602).then_some(frame);
        let missing = check_refused(&scenario, absent, "right");
        assert!(matches!(missing, BootFailure::Missing { .. }), "{missing}");
        let mute = |frame: Frame| (frame.id() != 0x58a).then_some(frame);
        let silent = check_refused(&scenario, mute, "wrist");
        assert!(matches!(silent, BootFailure::NoAnswer { index: 0x1000, sub: 0 }), "{silent}");
        // It holds 900 per mille, and refuses another limit.
        let refusing = |frame: Frame| {
            let answer: &[u8] = match (frame.id(), frame.bytes()[0], &frame.bytes()[1..4]) {
                (0x581, 0x60, [0x72, 0x60, 0x00]) => &[0x80, 0x72, 0x60, 0x00, 0x22, 0, 0, 0x08],
                (0x581, 0x4b, [0x72, 0x60, 0x00]) => &[0x4b, 0x72, 0x60, 0x00, 0x84, 0x03, 0, 0],
                _ => return Some(frame),
            };
            Some(Frame::new(0x581, answer))
        };
        let refused = check_refused(&scenario, refusing, "left");
        assert!(matches!(refused, BootFailure::Keeps { index: 0x6072, sub: 0, .. }), "{refused}");
        assert!(refused.to_string().contains("6072h"), "{refused}");
    }
}
