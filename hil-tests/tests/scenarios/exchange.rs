//! The shipped rigs from the outside: what goes over the bus when all is well, and that it is always the same.

use hil_tests::{DRIVE_NODES, ObservedFrame, Recording, SENSOR_NODE, Scenario, Session};
use yieldwall::canopen::Frame;
use yieldwall::config::{BusTiming, CommandMode, Finite, PathSegment, Side, Tracking};
use yieldwall::elementary;
use yieldwall::guard::State;
use yieldwall::rig::RigError;
use yieldwall::sim::can::BusCounters;

/// Counts of a turn of the shipped rigs, over its angle.
const COUNTS_PER_RAD: f64 = 800_000.0 / std::f64::consts::TAU;

fn shipped() -> Vec<Scenario> {
    let files = [
        "paper-admittance.yaml",
        "paper-admittance-cartesian.yaml",
        "paper-admittance-csv.yaml",
        "paper-admittance-csp.yaml",
        "paper-admittance-2ms.yaml",
        "paper-admittance-4ms.yaml",
    ];
    files.map(Scenario::shipped).to_vec()
}

fn cycles_of(scenario: &Scenario, seconds: f64) -> usize {
    (seconds / scenario.period_s()).round() as usize
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    elementary::hypot(a[0] - b[0], a[1] - b[1])
}

#[test]
fn every_shipped_rig_boots_enables_and_follows_the_hand() {
    for scenario in shipped() {
        let session = scenario.run(cycles_of(&scenario, 2.0));
        let replay = &session.replay;
        assert_eq!((session.machine.state(), session.fault()), (State::Running, None), "{replay}");
        let (first, last) = (session.rows.first().unwrap(), session.rows.last().unwrap());
        let way = distance(first.tool_m, last.tool_m);
        assert!(way > 0.03, "the hand took the tool along: {way} m; {replay}");
        let error = session.rows.iter().map(|row| distance(row.tool_m, row.proxy_m)).fold(0.0, f64::max);
        // The tool is where the proxy was about two cycles ago.
        assert!(error < 1e-3 + 4.0 * scenario.period_s() * 0.3, "tool and proxy are {error} m apart; {replay}");
        let counters: BusCounters = session.machine.bus_counters().sum();
        assert_eq!((counters.overflowed, counters.dropped, counters.identifier_clashes), (0, 0, 0), "{replay}");
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_one_does_not() {
    for scenario in [Scenario::torque(), Scenario::position()] {
        let (first, second) = (scenario.run(600), scenario.run(600));
        assert!(first.candump() == second.candump(), "frames differ; {}", first.replay);
        assert_eq!(format!("{:?}", first.rows), format!("{:?}", second.rows), "{}", first.replay);
        let mut other = scenario.clone();
        other.seed += 1;
        assert!(first.candump() != other.run(600).candump(), "a seed without effect; {}", first.replay);
    }
}

#[test]
fn a_silent_observer_changes_nothing() {
    let scenario = Scenario::torque();
    let observed = scenario.run(300);
    let mut alone =
        yieldwall::rig::EmbeddedRig::new(&scenario.rig, &scenario.scene, &scenario.rig.fixture, scenario.seed).unwrap();
    alone.enable().unwrap();
    let rows: Vec<_> = (0..300).map(|_| alone.run_cycle(yieldwall::guard::Request::None).unwrap()).collect();
    assert_eq!(format!("{:?}", observed.rows), format!("{rows:?}"), "{}", observed.replay);
}

/// A session whose force frame number `flipped` after enabling has one bit flipped.
fn with_a_flipped_bit(scenario: &Scenario, flipped: Option<usize>) -> Session {
    let mut session = scenario.enabled();
    let mut number = 0;
    session.tamper(move |_, _, frame: Frame| {
        if frame.id() != 0x180 + SENSOR_NODE {
            return Some(frame);
        }
        number += 1;
        // Bit 8 of the first channel: 256 counts.
        let bits = if Some(number) == flipped { frame.bits() ^ 0x100 } else { frame.bits() };
        Some(Frame::from_bits(frame.id(), bits, frame.len()))
    });
    session.run(900);
    session
}

#[test]
fn one_flipped_bit_of_a_force_frame_changes_the_set_points_that_follow() {
    for scenario in [Scenario::torque(), Scenario::position()] {
        let (clean, flipped) = (with_a_flipped_bit(&scenario, None), with_a_flipped_bit(&scenario, Some(700)));
        let (clean, flipped) = (clean.recording(), flipped.recording());
        let at = (0..clean.frames.len()).find(|&at| clean.frames[at] != flipped.frames[at]).expect("it differs");
        assert_eq!(clean.frames[at].frame.id(), 0x180 + SENSOR_NODE, "the flipped frame is the first that differs");
        let differing = (0..2).map(|joint| {
            let (a, b) = (clean.setpoints(joint), flipped.setpoints(joint));
            a.iter().zip(&b).filter(|(a, b)| a.target != b.target).count()
        });
        assert!(differing.sum::<usize>() > 100, "the run is another one; {}", scenario.replay());
    }
}

/// Checks from the frames alone: no set-point that moves an axis unless both drives reported Operation Enabled in that
/// cycle (moves-enabled); steps and torques within the limits (bounded-motion, bounded-effort); the first target is the measured position (starts-in-place); one
/// set-point per drive and SYNC (fresh-set-point).
fn check_setpoints(scenario: &Scenario, recording: &Recording) {
    let replay = scenario.replay();
    let mode = scenario.rig.rig.command_mode;
    let fastest = scenario.rig.guard.joint_speed_limit_rad_per_s.get() * COUNTS_PER_RAD;
    let longest = fastest * scenario.period_s() + 1.0;
    let mut last: [Option<i32>; 2] = [None; 2];
    let mut moving = 0;
    for cycle in recording.cycles() {
        let find = |base: u16, joint: usize| -> Vec<&ObservedFrame> {
            cycle.iter().filter(|seen| seen.frame.id() == base + DRIVE_NODES[joint]).collect()
        };
        let statuses = [0, 1].map(|joint| find(0x180, joint).first().map(|seen| hil_tests::status(seen)));
        let all_enabled = statuses.iter().all(|status| status.is_some_and(|status| status.is_enabled()));
        for joint in 0..2 {
            let sent = find(0x200, joint);
            assert!(sent.len() <= 1, "fresh-set-point: {} set-points in one cycle; {replay}", sent.len());
            let Some(seen) = sent.first() else { continue };
            let sent = hil_tests::setpoint(seen);
            let moves = match mode {
                CommandMode::Position => Some(sent.target) != statuses[joint].map(|status| status.position),
                CommandMode::Velocity | CommandMode::Torque => sent.target != 0,
            };
            assert!(!moves || (all_enabled && sent.enables()), "moves-enabled: {sent:?} while {statuses:?}; {replay}");
            let size = f64::from(sent.target).abs();
            match (mode, last[joint].filter(|_| all_enabled)) {
                (CommandMode::Torque, _) => assert!(size <= 1000.0, "bounded-effort: {sent:?}; {replay}"),
                (CommandMode::Velocity, _) => assert!(size <= fastest + 1.0, "bounded-effort: {sent:?}; {replay}"),
                (CommandMode::Position, Some(before)) => {
                    let step = f64::from(sent.target.wrapping_sub(before).abs());
                    assert!(step <= longest, "bounded-motion: {before} {sent:?}; {replay}");
                }
                (CommandMode::Position, None) => {}
            }
            moving += usize::from(moves);
            last[joint] = Some(sent.target);
        }
    }
    assert!(moving > 500, "the check saw motion: {moving}; {replay}");
}

#[test]
fn set_points_keep_the_limits_as_seen_on_the_bus() {
    for scenario in shipped() {
        let mut session = scenario.run(cycles_of(&scenario, 2.0));
        session.machine.stop().unwrap();
        let is_on = |drive: &yieldwall::sim::Drive| drive.state() == yieldwall_drives::cia402::State::OperationEnabled;
        assert!(!session.machine.drives().into_iter().any(is_on), "stopped means that no drive is enabled");
        session.run(20);
        check_setpoints(&scenario, &session.recording());
    }
}

#[test]
fn a_cycle_is_sync_alone_then_process_data_then_set_points_and_nothing_is_left_over() {
    for scenario in shipped() {
        let session = scenario.run(cycles_of(&scenario, 1.0));
        let replay = &session.replay;
        let period = u64::from(scenario.rig.cycle.period_us) * 1000;
        let compute = u64::from(scenario.rig.cycle.compute_at_us) * 1000;
        let recording = session.recording();
        let cycles = recording.cycles();
        assert!(cycles.len() > 240);
        for cycle in &cycles[..cycles.len() - 1] {
            let start = cycle[0].time.0 / period * period;
            // A frame of a device may be on the wire when SYNC is due: 132 bits at most, and SYNC itself has 44 to 52.
            let at = cycle[0].time.0 - start;
            assert!((44_000..=184_000).contains(&at), "SYNC ends {at} ns after its moment; {replay}");
            let ids: Vec<u16> = cycle.iter().map(|seen| seen.frame.id()).collect();
            for id in [0x181, 0x182, 0x18a, 0x28a, 0x201, 0x202] {
                assert_eq!(ids.iter().filter(|seen| **seen == id).count(), 1, "{id:03X}h in {ids:03X?}; {replay}");
            }
            for seen in *cycle {
                let at = seen.time.0 - start;
                let id = seen.frame.id();
                match id {
                    0x181 | 0x182 | 0x18a | 0x28a => assert!(at < compute, "{id:03X}h at {at} ns; {replay}"),
                    0x201 | 0x202 => assert!(at > compute && at < period, "{id:03X}h at {at} ns; {replay}"),
                    // The master's heartbeat stays within its cycle, so that SYNC finds an empty queue.
                    0x77f => assert!(at > compute && at < period, "{id:03X}h at {at} ns; {replay}"),
                    _ => {}
                }
            }
        }
        let seconds = recording.frames.last().unwrap().time.as_secs_f64();
        let load = session.machine.bus_counters().sum::<BusCounters>().bits as f64 / (seconds * 1e6);
        assert!(load < 0.80, "bus-load: bus load {load}; {replay}");
    }
}

#[test]
fn an_ideal_bus_and_ideal_tracking_work() {
    for mut scenario in [Scenario::torque(), Scenario::position()] {
        scenario.rig.simulated_mut().unwrap().timing = BusTiming::Ideal;
        let session = scenario.run(1000);
        assert_eq!((session.machine.state(), session.fault()), (State::Running, None));
        let recording = session.recording();
        assert!(recording.cycles().iter().all(|cycle| cycle[0].time.0 % 1_000_000 == 0), "frames take no time");
    }
    let mut scenario = Scenario::position();
    scenario.scene.model.as_mut().unwrap().tracking = Tracking::Ideal;
    let session = scenario.run(1500);
    assert_eq!((session.machine.state(), session.fault()), (State::Running, None));
    for pair in session.rows.windows(2) {
        // The tool at a SYNC is where the proxy of the cycle before was.
        assert!(distance(pair[1].tool_m, pair[0].proxy_m) < 1e-9, "{pair:?}");
    }
    assert!(distance(session.rows[0].tool_m, session.rows[1499].tool_m) > 0.03);
    let mut torque = Scenario::torque();
    torque.scene.model.as_mut().unwrap().tracking = Tracking::Ideal;
    let refused = yieldwall::rig::EmbeddedRig::new(&torque.rig, &torque.scene, &torque.rig.fixture, 1);
    assert!(matches!(refused, Err(RigError::IdealInTorque)), "a torque has no place to go to");
}

/// Greatest depth of the proxy beyond the circle and greatest push, in mm and N, of a hand that knocks on the circle from
/// inside without reaching R.
fn knock(hold_steps: u32) -> (f64, f64) {
    let mut scenario = Scenario::position();
    scenario.rig.fixture.hold_steps = hold_steps;
    scenario.rig.fixture.side = Side::Bilateral;
    scenario.scene.model.as_mut().unwrap().tracking = Tracking::Ideal;
    let finite = |value: f64| Finite::new(value).unwrap();
    let hand = &mut scenario.scene.hand;
    hand.tremor = None;
    // A mass that is stopped within one cycle would push with far more than R.
    hand.mass_kg = yieldwall::config::NotNegative::new(0.0).unwrap();
    hand.start_m = vec![finite(0.06), finite(0.0)];
    let to = |x: f64, seconds: f64| PathSegment::To {
        point_m: vec![finite(x), finite(0.0)],
        in_s: yieldwall::config::Positive::new(seconds).unwrap(),
    };
    hand.path = vec![to(0.14, 0.5), to(0.10, 0.4), to(0.14, 0.3)];
    let session = scenario.run(1500);
    assert_eq!(session.machine.state(), State::Running);
    let depth =
        session.rows.iter().map(|row| elementary::hypot(row.proxy_m[0], row.proxy_m[1]) - 0.12).fold(0.0, f64::max);
    let push = session.rows.iter().map(|row| elementary::hypot(row.force_n[0], row.force_n[1])).fold(0.0, f64::max);
    assert!(session.rows.iter().any(|row| row.is_impact) || hold_steps == 0);
    (1e3 * depth, push)
}

#[test]
fn a_hand_below_r_does_not_pass_a_surface_that_holds() {
    // Without a hold the same knock goes through: the check can tell.
    assert!(knock(0).0 > 1.0);
    for hold_steps in [2, 20] {
        let (depth, push) = knock(hold_steps);
        assert!(push < 20.0, "the hand stayed below R: {push} N");
        assert!(depth < 1e-6, "N_wait = {hold_steps}: {depth} mm deep");
    }
}
