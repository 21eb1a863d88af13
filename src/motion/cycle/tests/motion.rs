//! Behaviour of the reference without a fault.

use super::*;

#[test]
fn it_rests_until_it_is_enabled() {
    for servo in [Servo::Position, velocity_servo(), torque_servo(Law::Psmc, false)] {
        let mut bench = Bench::new(servo, [0.05, 0.02]);
        bench.force = [15.0, 5.0];
        for _ in 0..20 {
            let outputs = bench.step(Request::None);
            assert_eq!((outputs.directive.state, outputs.directive.motion), (State::Idle, Motion::Rest));
            assert_eq!(outputs.signals.proxy, outputs.signals.tool);
            assert!(bench.cycle.track.now().is_none());
        }
        assert!((bench.cycle.measured.angles.left() - bench.angles[0].unwrap()).abs() == 0.0);
    }
}

#[test]
fn it_starts_where_it_is_measured_and_without_force() {
    for servo in [Servo::Position, velocity_servo(), torque_servo(Law::Psmc, false), torque_servo(Law::Pid, true)] {
        let mut bench = Bench::new(servo, [0.05, 0.02]);
        bench.force = [15.0, 5.0];
        let first = bench.enable();
        let measured = JointAngles::from(bench.angles.map(Option::unwrap));
        let reference = bench.reference();
        assert_eq!(reference.angles(), measured, "starts-in-place");
        assert_eq!(reference.point, first.signals.tool);
        assert_eq!((reference.velocity, reference.rates), (TipVelocity::default(), JointRates::default()));
        match first.command.get() {
            JointCommand::Position(target) => assert_eq!(*target, measured, "starts-in-place: to the count"),
            JointCommand::Velocity(rates) => assert_eq!(*rates, JointRates::default()),
            JointCommand::Torque(torques) => assert_eq!(*torques, JointTorques::default()),
        }
    }
}

#[test]
fn enabling_again_starts_from_the_new_place_and_not_from_the_old_target() {
    let mut bench = Bench::running(Servo::Position, [0.0, 0.0]);
    bench.force = [12.0, 0.0];
    for _ in 0..60 {
        bench.follow();
    }
    let old = bench.reference().point;
    while bench.cycle.state() != State::Stopped {
        bench.step(Request::Stop);
    }
    bench.step(Request::None);
    let elsewhere = bench.cycle.linkage.inverse(TipPoint::new(-0.05, 0.08)).unwrap();
    // The arm is carried there by hand, slower than an encoder's jump.
    let here = bench.cycle.measured.angles;
    for part in 1..=200 {
        bench.angles = (here + (elsewhere - here) * f64::from(part) / 200.0).to_array().map(Some);
        bench.step(Request::None);
    }
    bench.step(Request::Reset);
    let first = bench.enable();
    assert_eq!(*first.command.get(), JointCommand::Position(bench.cycle.measured.angles));
    assert!((bench.reference().point - old).norm() > 0.05);
    assert_eq!(bench.reference().velocity, TipVelocity::default());
}

#[test]
fn the_proxy_is_a_mass_that_friction_holds() {
    let mut bench = Bench::running(Servo::Position, [0.02, 0.0]);
    bench.force = [2.9, 0.0];
    for _ in 0..50 {
        bench.follow();
    }
    let start = bench.reference().point;
    assert!((start - TipPoint::new(0.02, 0.0)).norm() < 1e-12, "below F nothing moves: {start:?}");
    bench.force = [10.0, 0.0];
    let steps = 50;
    for _ in 0..steps {
        bench.follow();
    }
    // Steps of a T^2, 2 a T^2, ...: the sum of the first n is n (n + 1) / 2 a T^2. The force is read to half a count on
    // two axes.
    let acceleration = (10.0 - FRICTION_N) / MASS_KG;
    let expected = f64::from(steps * (steps + 1)) / 2.0 * acceleration * PERIOD_S * PERIOD_S;
    let way = bench.reference().point - start;
    assert!((way.x() - expected).abs() < 2e-3 * expected, "{} against {expected}", way.x());
    assert!(way.y().abs() < 2e-3 * expected);
}

#[test]
fn a_position_command_is_the_reference() {
    let mut bench = Bench::running(Servo::Position, [0.0, 0.0]);
    bench.force = [0.0, 9.0];
    for _ in 0..100 {
        let outputs = bench.follow();
        assert_eq!(*outputs.command.get(), JointCommand::Position(bench.reference().angles()));
    }
    assert!(bench.reference().point.y() > 0.01);
}

#[test]
fn a_stop_ramps_down_then_quick_stops_and_latches() {
    let mut bench = Bench::running(Servo::Position, [0.02, 0.0]);
    bench.force = [10.0, 0.0];
    for _ in 0..100 {
        bench.follow();
    }
    let speed = bench.reference().velocity.norm();
    assert!(speed > 0.3);
    let start = bench.reference().point;
    let mut cycles = 0;
    let mut last = bench.reference();
    loop {
        let outputs = bench.step(if cycles == 0 { Request::Stop } else { Request::None });
        bench.angles = outputs.signals.target_angles.to_array().map(Some);
        if outputs.directive.state == State::Stopped {
            assert_eq!((outputs.directive.goal, outputs.directive.motion), (cia402::Goal::QuickStop, Motion::Rest));
            break;
        }
        assert_eq!((outputs.directive.state, outputs.directive.motion), (State::Stopping, Motion::Halt));
        assert_eq!(outputs.directive.goal, cia402::Goal::OperationEnabled);
        let now = bench.reference();
        assert!((now.velocity - last.velocity).norm() <= 2.0 * DECELERATION * PERIOD_S);
        assert!(now.velocity.norm() <= last.velocity.norm() + 1e-12, "it only slows down");
        last = now;
        cycles += 1;
        assert!(cycles < 1000);
    }
    assert!((f64::from(cycles) * PERIOD_S - 1.5 * speed / DECELERATION).abs() <= 2.0 * PERIOD_S, "{cycles}");
    let way = (last.point - start).norm();
    assert!((way - 0.75 * speed * speed / DECELERATION).abs() < 1e-6, "{way}");
    assert_eq!(bench.fault(), Some(Fault::StopRequested));
    for request in [Request::None, Request::Enable, Request::Stop, Request::None] {
        assert_eq!(bench.step(request).directive.state, State::Stopped);
    }
    assert_eq!(bench.step(Request::Reset).directive.state, State::Idle);
    for _ in 0..100 {
        assert_eq!(bench.step(Request::None).directive.state, State::Idle, "nothing enables by itself");
    }
}

#[test]
fn a_freeze_brings_the_reference_to_rest_and_clears_by_itself() {
    let mut bench = Bench::running(Servo::Position, [0.02, 0.0]);
    bench.force = [10.0, 0.0];
    for _ in 0..50 {
        bench.follow();
    }
    bench.samples = false;
    bench.follow();
    bench.follow();
    assert_eq!(bench.cycle.state(), State::Running, "two missing samples are no fault");
    assert_eq!(bench.follow().directive.state, State::Holding);
    assert_eq!(bench.fault(), Some(Fault::SensorStale));
    bench.samples = true;
    let mut held = None;
    for cycle in 0..49 {
        let before = bench.reference();
        assert_eq!(bench.follow().directive.state, State::Holding, "{cycle}");
        let now = bench.reference();
        assert!((now.velocity - before.velocity).norm() <= 2.0 * DECELERATION * PERIOD_S);
        if now.velocity == TipVelocity::default() {
            let place = *held.get_or_insert(now.point);
            assert_eq!(now.point, place, "at rest it stays, whatever the hand does");
        }
    }
    assert!(held.is_some());
    let before = bench.reference().point;
    assert_eq!(bench.follow().directive.state, State::Running);
    assert_eq!(bench.fault(), None);
    let step = (bench.reference().point - before).norm();
    assert!(step <= 10.0 / MASS_KG * PERIOD_S * PERIOD_S, "it starts from rest: {step}");
    for _ in 0..20 {
        bench.follow();
    }
    assert!(bench.reference().velocity.x() > 0.01, "and runs again");
}

#[test]
fn the_workspace_edge_holds_the_reference_and_lets_it_back() {
    let mut bench = Bench::running(Servo::Position, [0.0, 0.13]);
    // Away from the circle: R resists.
    bench.force = [0.0, 26.0];
    let mut held = 0;
    for _ in 0..3000 {
        bench.follow();
        assert_eq!((bench.cycle.state(), bench.fault()), (State::Running, None));
        let clearance = bench.cycle.clearance_m;
        assert!(clearance > 0.5 * MARGIN_M, "{clearance}");
        held += u32::from(bench.cycle.faults.count(Fault::WorkspaceEdge) > 0);
    }
    assert!(held > 2000, "it came to the edge and stayed: {held}");
    let edge = bench.reference();
    assert!(edge.velocity.norm() < 0.01 && edge.point.y() > 0.2);
    bench.force = [0.0, -5.0];
    for _ in 0..200 {
        bench.follow();
    }
    assert_eq!(bench.cycle.faults.count(Fault::WorkspaceEdge), 0);
    let back = bench.reference().point;
    assert!(back.y() < edge.point.y() - 0.01, "{back:?}");
}

/// Speed of the reference across the edge in the last cycle, m/s: how fast its clearance fell.
fn approach(bench: &Bench, before: &Reference) -> f64 {
    let clearance =
        |reference: &Reference| bench.cycle.clearance_of_m(&bench.cycle.linkage.forward(reference.angles()).unwrap());
    (clearance(before) - clearance(&bench.reference())) / PERIOD_S
}

#[test]
fn the_reference_comes_to_rest_at_the_edge_without_a_jerk() {
    for force in [[0.0, 26.0], [8.0, 30.0], [-20.0, 30.0]] {
        let mut bench = Bench::running(Servo::Position, [0.0, 0.13]);
        bench.force = force;
        let (mut last_approach, mut fastest) = (0.0f64, 0.0f64);
        let mut is_braking = false;
        for cycle in 0..1500 {
            let before = bench.reference();
            bench.follow();
            assert_eq!((bench.cycle.state(), bench.fault()), (State::Running, None), "{force:?}");
            let here = bench.cycle.linkage.forward(bench.reference().angles()).unwrap();
            let clearance = bench.cycle.clearance_of_m(&here);
            assert!(clearance > MARGIN_M - 1e-6, "{force:?}: {clearance}");
            let approach = approach(&bench, &before);
            let bound = (2.0 * DECELERATION * (clearance - MARGIN_M).max(0.0)).sqrt();
            assert!(approach <= bound + 2.0 * DECELERATION * PERIOD_S, "{force:?}: {approach} m/s in cycle {cycle}");
            is_braking |= bench.cycle.faults.count(Fault::WorkspaceEdge) > 0;
            if is_braking {
                let change = last_approach - approach;
                assert!(change <= 2.0 * DECELERATION * PERIOD_S, "{force:?}: {change} m/s in cycle {cycle}");
            }
            fastest = fastest.max(approach);
            last_approach = approach;
        }
        assert!(is_braking && fastest > 0.3, "{force:?}: it ran against the edge: {fastest}");
    }
}

#[test]
fn along_the_edge_the_reference_goes_on() {
    let mut bench = Bench::running(Servo::Position, [0.0, 0.13]);
    bench.force = [0.0, 26.0];
    for _ in 0..1000 {
        bench.follow();
    }
    let start = bench.reference().point;
    // Pressed against the edge and pushed along it.
    bench.force = [24.0, 20.0];
    let mut last = bench.reference().velocity;
    for _ in 0..300 {
        bench.follow();
        assert!(bench.cycle.clearance_m > MARGIN_M - 1e-5, "{}", bench.cycle.clearance_m);
        let now = bench.reference().velocity;
        assert!((now - last).norm() <= 2.0 * DECELERATION * PERIOD_S, "{} m/s at once", (now - last).norm());
        last = now;
    }
    assert!((bench.reference().point - start).norm() > 0.02, "{:?}", bench.reference().point);
    assert_eq!((bench.cycle.state(), bench.fault()), (State::Running, None));
}

#[test]
fn a_stop_at_the_edge_ends_there() {
    let mut bench = Bench::running(Servo::Position, [0.0, 0.13]);
    bench.force = [0.0, 30.0];
    while bench.cycle.clearance_m > MARGIN_M + 0.01 {
        bench.follow();
    }
    let speed = bench.reference().velocity.norm();
    assert!(0.75 * speed * speed / DECELERATION > 0.01, "the ramp alone would pass the edge: {speed}");
    for cycle in 0.. {
        let outputs = bench.step(Request::Stop);
        bench.angles = outputs.signals.target_angles.to_array().map(Some);
        let clearance = bench.cycle.clearance_m;
        assert!(clearance > 0.5 * MARGIN_M, "{clearance}");
        if outputs.directive.state == State::Stopped {
            break;
        }
        assert!(cycle < 1000);
    }
}

#[test]
fn whole_turns_of_the_encoders_change_nothing() {
    let run = |turns: [f64; 2]| {
        let mut bench = Bench::new(Servo::Position, [0.0, 0.0]);
        let shift = turns.map(|turns| turns * std::f64::consts::TAU);
        bench.angles = [bench.angles[0].map(|angle| angle + shift[0]), bench.angles[1].map(|angle| angle + shift[1])];
        bench.force = [8.0, 4.0];
        bench.enable();
        for _ in 0..200 {
            bench.follow();
        }
        (bench.reference().point, bench.reference().angles() - JointAngles::from(shift))
    };
    let (point, angles) = run([0.0, 0.0]);
    for turns in [[1.0, -1.0], [-3.0, 2.0]] {
        let (shifted_point, shifted_angles) = run(turns);
        assert!((point - shifted_point).norm() < 1e-9 && (angles - shifted_angles).norm() < 1e-9, "{turns:?}");
    }
}

/// A bench whose proxy meets the circle from inside at `speed` and is held there.
fn at_an_impact(push_n: f64, hold_steps: u32) -> Bench {
    let mut bench = Bench::with_fixture(Servo::Position, [0.04, 0.0], fixture(hold_steps));
    bench.enable();
    bench.force = [push_n, 0.0];
    for _ in 0..3000 {
        if bench.follow().signals.is_impact {
            return bench;
        }
    }
    panic!("no impact");
}

/// The force leaps one or a few cycles after an impact, and the rig freezes. The reference stays on the surface that it met. The hold goes
/// on when the rig runs again: a hand that still presses with more than R is held as without the fault.
#[test]
fn a_freeze_right_after_an_impact_keeps_the_proxy_on_its_side_and_its_hold() {
    for later in 0..4 {
        for push_n in [6.0, 12.0, 18.0] {
            let mut bench = at_an_impact(push_n, 40);
            for _ in 0..later {
                bench.follow();
            }
            bench.force = [push_n + FORCE_STEP_LIMIT_N + 5.0, 0.0];
            assert_eq!(bench.follow().directive.state, State::Holding);
            bench.force = [30.0, 0.0];
            let mut running = 0;
            while running < 30 {
                let signals = bench.follow().signals;
                let distance_m = signals.proxy.norm() - 0.12;
                assert!(
                    distance_m.abs() <= 1e-9,
                    "{later} {push_n} N, running {running}: {distance_m} m beyond the circle"
                );
                running += u32::from(bench.cycle.state() == State::Running);
            }
        }
    }
}

/// A stop ramp of a proxy that flies towards the surface ends on the surface, not beyond it.
#[test]
fn a_freeze_before_an_impact_leads_up_to_the_surface_at_most() {
    let mut bench = Bench::with_fixture(Servo::Position, [0.04, 0.0], fixture(40));
    bench.enable();
    bench.force = [18.0, 0.0];
    // 0.75 v^2 / a with the 0.6 m/s of then is 27 mm.
    while bench.follow().signals.proxy.norm() < 0.11 {}
    bench.force = [-30.0, 0.0];
    assert_eq!(bench.follow().directive.state, State::Holding);
    let mut farthest = 0.0_f64;
    for _ in 0..200 {
        farthest = farthest.max(bench.follow().signals.proxy.norm());
        bench.force = [-5.0, 0.0];
    }
    assert!((farthest - 0.12).abs() <= 1e-9, "{farthest}");
}
