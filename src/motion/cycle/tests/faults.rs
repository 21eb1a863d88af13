//! Every fault by an injection, the cycle in which the reaction leaves, and what garbage does.

use super::*;
use crate::elementary;
use crate::guard::fault::TABLE;
use proptest::prelude::*;

/// A bench in motion at about 0.2 m/s.
fn moving() -> Bench {
    let mut bench = Bench::running(Servo::Position, [0.02, 0.0]);
    bench.force = [10.0, 0.0];
    for _ in 0..60 {
        bench.follow();
    }
    bench
}

/// A bench on which `fault` can happen.
fn prepared(fault: Fault) -> Bench {
    match fault {
        Fault::SensorStuck => {
            let mut bench = Bench::new(Servo::Position, [0.02, 0.0]);
            for cycle in 0..20 {
                bench.force = [0.1 * f64::from(cycle % 3), 0.0];
                bench.step(Request::None);
            }
            bench.enable();
            bench
        }
        // The torques of the bench move nothing: the arm is where the reference is.
        Fault::ForceImplausible => Bench::running(torque_servo(Law::Psmc, false), [0.02, 0.0]),
        Fault::ForceLimit => {
            let mut bench = moving();
            bench.cycle.sensing = sensing_with(1000.0, f64::INFINITY);
            bench
        }
        Fault::EnablingTimeout => {
            let mut bench = Bench::new(Servo::Position, [0.02, 0.0]);
            bench.step(Request::None);
            bench.step(Request::Enable);
            bench
        }
        _ => moving(),
    }
}

fn push_angle(bench: &mut Bench, joint: usize, by: f64) {
    bench.angles[joint] = bench.angles[joint].map(|angle| angle + by);
}

/// One cycle with `fault` in it; to be called once a cycle.
fn inject(fault: Fault, bench: &mut Bench) -> Outputs {
    let mut request = Request::None;
    match fault {
        Fault::StopRequested => request = Request::Stop,
        Fault::SensorSaturated => bench.overload = true,
        Fault::SensorInvalid => bench.invalid = true,
        // The sample of a still hand, again and again.
        Fault::SensorStuck => {}
        Fault::ForceStep => bench.force = [-bench.force[0].signum() * (FORCE_STEP_LIMIT_N - 5.0), 0.0],
        // The arm follows without a torque that answers the force.
        Fault::ForceImplausible => {
            bench.cycle.settings.residual_limit_n_m = Some(2.0);
            bench.force = [0.0, 12.0];
        }
        // The tool is thrown back against the push, over a limit that a millimetre reaches.
        Fault::EnergyLimit => {
            bench.cycle.settings.energy_limit_j = 1e-4;
            push_tool(bench, [-2e-4, 0.0]);
            return bench.step(Request::None);
        }
        // A hand that swings at 25 Hz.
        Fault::Chatter => {
            let swing = if bench.sequence % 40 < 20 { 1.0 } else { -1.0 };
            bench.force = [0.0, 19.0 * swing];
        }
        Fault::DriveVoltageOff => bench.has_voltage = false,
        Fault::DriveWarning => bench.has_warning = true,
        Fault::EnablingTimeout => bench.drives = [cia402::State::SwitchedOn; 2],
        Fault::SyncJitter => bench.timing.sync_late_ns = 201_000,
        Fault::Overrun => bench.timing.compute_late_ns = 501_000,
        Fault::Stalled => bench.timing.skipped = 3,
        Fault::Suspended => bench.timing.suspended = true,
        Fault::SensorStale | Fault::SensorLost => bench.samples = false,
        Fault::ForceLimit => bench.force = [FORCE_LIMIT_N + 5.0, 0.0],
        Fault::PdoMissed => {
            return bench.step_without(0);
        }
        Fault::PdoLength => bench.link.bad_length = DeviceSet::LEFT_DRIVE,
        Fault::NodeReset => bench.link.node_reset = DeviceSet::LEFT_DRIVE,
        Fault::HeartbeatLost => bench.link.heartbeat_lost = DeviceSet::LEFT_DRIVE,
        Fault::Emergency => bench.link.emergency = DeviceSet::LEFT_DRIVE,
        Fault::DriveFault => bench.drives[1] = cia402::State::Fault,
        Fault::DriveLeftOperation => bench.drives[0] = cia402::State::SwitchedOn,
        Fault::DriveIgnoresCommand => bench.follows_command = false,
        // The joint is dragged along at 5 rad/s, which is no jump.
        Fault::FollowingError | Fault::Runaway => {
            push_angle(bench, 0, 5e-3);
            return bench.step(Request::None);
        }
        Fault::EncoderJump => push_angle(bench, 1, 2.5 * JOINT_SPEED_LIMIT * PERIOD_S),
        Fault::Posture => {
            let mut other = geometry();
            other.elbows = [Side::Right, Side::Right];
            let angles = FiveBar::new(other).unwrap().inverse(TipPoint::new(0.0, 0.0)).unwrap();
            assert!(bench.cycle.linkage.forward(angles).is_ok(), "the loop closes with the elbow on the other side");
            // The whole history is there: only the posture is wrong.
            bench.cycle.measured.angles = angles;
            if let Some(reference) = bench.cycle.track.now_mut() {
                reference.closure = bench.cycle.linkage.close(angles).unwrap();
            }
            bench.angles = angles.to_array().map(Some);
        }
        Fault::WorkspaceEdge => {
            let is_fast = bench.cycle.track.now().is_some_and(|reference| reference.velocity.norm() > 0.3);
            bench.force = [0.0, if is_fast { 0.0 } else { 26.0 }];
        }
        Fault::WorkspaceLeft => {
            // The whole arm is taken there, reference and all: only the place is wrong.
            if let Some(reference) = bench.cycle.track.now_mut() {
                let tip = reference.point + TipDisplacement::new(0.0, 2e-4);
                if let Ok(closure) = bench.cycle.linkage.close_near(tip, reference.angles()) {
                    (reference.point, reference.closure) = (tip, closure);
                    bench.cycle.fixture.reset(&tip.0).unwrap();
                    bench.angles = closure.angles().to_array().map(Some);
                }
            }
            return bench.step(Request::None);
        }
        Fault::OverSpeed => bench.force = [140.0, 0.0],
        Fault::NotFinite => {
            if let Some(reference) = bench.cycle.track.now_mut() {
                reference.closure = reference.closure.at_no_angle();
            }
        }
        Fault::LinkDown => bench.link.send_failed = DeviceSet::interface(1),
        Fault::PdoDuplicated => bench.link.duplicated = DeviceSet::LEFT_DRIVE,
        Fault::PdoLate => bench.link.late = DeviceSet::SENSOR,
        Fault::DuplicateNode => bench.link.duplicate_node = DeviceSet::LEFT_DRIVE,
        Fault::EmergencyWarning => bench.link.emergency_warning = DeviceSet::LEFT_DRIVE,
        Fault::Intruder => bench.link.intruder = true,
        Fault::TransmitStalled => bench.link.transmit_stalled = DeviceSet::interface(1),
        Fault::ErrorPassive => bench.link.error_passive = DeviceSet::interface(1),
        Fault::BusOff => bench.link.bus_off = DeviceSet::interface(1),
        Fault::DeviceState => bench.link.device_state = DeviceSet::RIGHT_DRIVE,
        Fault::ClockLost => bench.link.clock_lost = DeviceSet::LEFT_DRIVE,
        Fault::PortErrors => bench.link.port_errors = DeviceSet::RIGHT_DRIVE | DeviceSet::SENSOR,
        Fault::CyclePanicked => unreachable!("not seen in the cycle"),
    }
    let outputs = bench.step(request);
    bench.angles = outputs.signals.target_angles.to_array().map(Some);
    outputs
}

fn push_tool(bench: &mut Bench, by: [f64; 2]) {
    let tip = bench.cycle.linkage.forward(JointAngles::from(bench.angles.map(Option::unwrap))).unwrap().tip;
    let angles = bench.cycle.linkage.inverse(tip + TipDisplacement::from(by)).unwrap();
    bench.angles = angles.to_array().map(Some);
}

impl Bench {
    /// One cycle in which the process data of `joint` do not arrive.
    fn step_without(&mut self, joint: usize) -> Outputs {
        let there = self.angles[joint].take();
        let outputs = self.step(Request::None);
        self.angles = outputs.signals.target_angles.to_array().map(Some);
        if self.cycle.state().is_latched() {
            self.angles[joint] = there;
        }
        outputs
    }
}

#[test]
fn every_fault_of_the_table_can_be_injected_and_reacts() {
    // A cycle that failed observes nothing any more: see the tests of the bus.
    for row in TABLE.iter().filter(|row| row.fault != Fault::CyclePanicked) {
        let mut bench = prepared(row.fault);
        let strongest = row.steps.last().unwrap().reaction;
        let mut caused = false;
        let mut observed = false;
        for cycle in 0..2500 {
            let was_latched = bench.cycle.state().is_latched();
            inject(row.fault, &mut bench);
            observed |= bench.cycle.faults.count(row.fault) > 0;
            caused |= bench.fault() == Some(row.fault);
            if was_latched && cycle > 5 || (strongest == guard::Reaction::Count && observed) {
                break;
            }
        }
        assert!(observed, "{}: never observed", row.name);
        let state = bench.cycle.state();
        match strongest {
            guard::Reaction::Count => assert_eq!((state, caused), (State::Running, false), "{}", row.name),
            guard::Reaction::Freeze => assert!(caused, "{}", row.name),
            _ => assert_eq!((state, caused), (row.final_state(strongest), true), "{}", row.name),
        }
        assert!(state == State::Running || state.is_latched() || strongest == guard::Reaction::Freeze, "{}", row.name);
    }
}

#[test]
fn the_reaction_leaves_within_its_bound() {
    use State::*;
    // Cycles from the first observable one to the state, itself included. Bounds of the fault table.
    let bounds: [(Fault, State, usize); 38] = [
        (Fault::StopRequested, Stopping, 1),
        (Fault::SensorInvalid, Holding, 1),
        (Fault::SensorInvalid, Stopping, 3),
        (Fault::SensorSaturated, Holding, 1),
        (Fault::SensorSaturated, Stopping, 5),
        (Fault::SensorStale, Holding, 3),
        (Fault::SensorLost, Stopping, 10),
        (Fault::ForceLimit, Holding, 1),
        (Fault::ForceLimit, Stopping, 20),
        (Fault::PdoMissed, Holding, 2),
        (Fault::PdoMissed, Stopped, 5),
        (Fault::PdoLength, Stopped, 2),
        (Fault::NodeReset, Stopped, 1),
        (Fault::HeartbeatLost, Lost, 1),
        (Fault::Emergency, Stopped, 1),
        (Fault::DriveFault, Disabled, 1),
        (Fault::DriveLeftOperation, Stopped, 1),
        (Fault::DriveIgnoresCommand, Stopped, 3),
        (Fault::EncoderJump, Disabled, 1),
        (Fault::Posture, Stopped, 1),
        (Fault::ForceStep, Holding, 1),
        (Fault::DriveVoltageOff, Disabled, 1),
        (Fault::DriveWarning, Stopping, 2000),
        (Fault::DuplicateNode, Stopped, 1),
        (Fault::Intruder, Stopped, 1),
        (Fault::SyncJitter, Stopping, 10),
        (Fault::Overrun, Holding, 3),
        (Fault::Overrun, Stopping, 10),
        (Fault::PdoLate, Stopping, 10),
        (Fault::Stalled, Stopped, 1),
        (Fault::Suspended, Stopping, 1),
        (Fault::TransmitStalled, Lost, 2),
        (Fault::ErrorPassive, Lost, 5),
        (Fault::BusOff, Lost, 1),
        (Fault::LinkDown, Lost, 1),
        (Fault::DeviceState, Lost, 1),
        (Fault::ClockLost, Lost, 1),
        (Fault::PortErrors, Lost, 2),
    ];
    for (fault, state, cycles) in bounds {
        let mut bench = prepared(fault);
        for cycle in 1..=cycles {
            let outputs = inject(fault, &mut bench);
            assert_eq!(outputs.directive.state == state, cycle == cycles, "{fault:?} in cycle {cycle}");
        }
        if state.is_latched() {
            // All axes, in that same cycle.
            let outputs = inject(fault, &mut bench);
            assert_eq!(outputs.directive.motion, Motion::Rest);
            assert!(bench.cycle.track.now().is_none());
        }
    }
}

/// A bench whose sensor sends every fifth cycle.
fn slow_sensor() -> Bench {
    let mut bench = moving();
    bench.cycle.sensing = sensing_with(200.0, FORCE_STEP_LIMIT_N);
    bench
}

#[test]
fn a_slow_sensor_is_counted_by_its_samples() {
    let mut bench = slow_sensor();
    bench.invalid = true;
    let mut states = Vec::new();
    for cycle in 0..20 {
        bench.samples = cycle % 5 == 0;
        states.push(bench.follow().directive.state);
        assert_eq!(bench.cycle.faults.count(Fault::SensorInvalid), cycle / 5 + 1, "cycle {cycle}");
    }
    assert_eq!(states[..10], [State::Holding; 10]);
    assert_eq!(states[10], State::Stopping, "by the third sample");
}

#[test]
fn a_drive_on_its_way_to_operation_may_be_without_voltage() {
    let mut bench = Bench::new(Servo::Position, [0.02, 0.0]);
    bench.has_voltage = false;
    bench.step(Request::None);
    bench.step(Request::Enable);
    bench.drives = [cia402::State::SwitchedOn; 2];
    assert_eq!(bench.step(Request::None).directive.state, State::Enabling);
    bench.has_voltage = true;
    assert_eq!(bench.step(Request::None).directive.state, State::Running);
    bench.has_voltage = false;
    bench.step(Request::None);
    assert_eq!((bench.cycle.state(), bench.fault()), (State::Disabled, Some(Fault::DriveVoltageOff)));
}

#[test]
fn the_cause_names_the_devices() {
    let devices = |fault| {
        let mut bench = prepared(fault);
        while bench.fault() != Some(fault) {
            inject(fault, &mut bench);
        }
        bench.cycle.cause().unwrap().devices
    };
    assert_eq!(devices(Fault::PdoMissed), DeviceSet::LEFT_DRIVE);
    assert_eq!(devices(Fault::DriveFault), DeviceSet::RIGHT_DRIVE);
    assert_eq!(devices(Fault::EncoderJump), DeviceSet::RIGHT_DRIVE);
    assert_eq!(devices(Fault::FollowingError), DeviceSet::LEFT_DRIVE);
    assert_eq!(devices(Fault::SensorStuck), DeviceSet::SENSOR);
    assert_eq!(devices(Fault::EnablingTimeout), DeviceSet::DRIVES);
    assert_eq!(devices(Fault::Stalled), DeviceSet::HOST);
    assert_eq!(devices(Fault::WorkspaceLeft), DeviceSet::NONE);
}

#[test]
fn a_cycle_in_time_is_no_fault() {
    let mut bench = moving();
    for _ in 0..200 {
        bench.timing = Timing {
            sync_late_ns: 199_000,
            compute_late_ns: 499_000,
            last_compute_ns: 399_000,
            skipped: 0,
            suspended: false,
        };
        assert_eq!(bench.follow().directive.state, State::Running);
    }
    for fault in [Fault::SyncJitter, Fault::Overrun, Fault::Stalled, Fault::Suspended] {
        assert_eq!(bench.cycle.faults.count(fault), 0, "{fault:?}");
    }
    // A computation too long, and a grid point left out, are overruns.
    for timing in [Timing { last_compute_ns: 401_000, ..Timing::default() }, Timing { skipped: 2, ..Timing::default() }]
    {
        bench.timing = timing;
        bench.follow();
        assert_eq!(bench.cycle.faults.count(Fault::Overrun), 1);
        assert_eq!(bench.cycle.faults.count(Fault::Stalled), 0);
        bench.follow();
    }
}

#[test]
fn a_rig_that_starts_again_remembers_nothing() {
    let mut bench = moving();
    inject(Fault::NodeReset, &mut bench);
    assert_eq!(bench.cycle.state(), State::Stopped);
    bench.cycle.restart();
    assert_eq!((bench.cycle.state(), bench.fault()), (State::Idle, None));
    // Angles far from those before are no jump.
    bench.angles = bench.cycle.linkage.inverse(TipPoint::new(-0.1, 0.05)).unwrap().to_array().map(Some);
    bench.step(Request::None);
    assert_eq!(bench.cycle.faults.worst(), None);
    bench.enable();
}

#[test]
fn one_missed_frame_is_predicted_and_forgotten() {
    let mut bench = moving();
    let before = bench.cycle.measured;
    let outputs = bench.step_without(0);
    assert_eq!(outputs.directive.state, State::Running);
    let predicted = before.angles.left() + before.rates.left() * PERIOD_S;
    assert_eq!(outputs.signals.measured_angles.left(), predicted);
    assert!(before.rates.left().abs() > 0.1, "it was moving");
    for _ in 0..10 {
        assert_eq!(bench.follow().directive.state, State::Running);
    }
    assert_eq!(bench.fault(), None);
}

#[test]
fn prediction_ends() {
    let mut bench = moving();
    let mut last = 0.0;
    for cycle in 0..80_000 {
        bench.angles[0] = None;
        let outputs = bench.step(Request::None);
        let now = outputs.signals.measured_angles.left();
        assert!(cycle < 5 || now == last, "cycle {cycle}");
        last = now;
    }
    // Back where it was predicted to be: that is no jump.
    bench.angles[0] = Some(last);
    bench.step(Request::None);
    assert_eq!(bench.cycle.faults.count(Fault::EncoderJump), 0);
}

#[test]
fn a_wrong_elbow_keeps_the_rig_from_being_enabled() {
    let mut other = geometry();
    other.elbows = [Side::Right, Side::Right];
    let angles = FiveBar::new(other).unwrap().inverse(TipPoint::new(0.0, 0.0)).unwrap();
    let mut bench = Bench::new(Servo::Position, [0.0, 0.0]);
    bench.angles = angles.to_array().map(Some);
    for request in [Request::None, Request::Enable, Request::None, Request::None] {
        assert_eq!(bench.step(request).directive.state, State::Idle);
    }
    assert_eq!(bench.fault(), Some(Fault::Posture));
}

#[test]
fn a_drive_that_drops_out_while_the_other_is_enabled_is_not_enabled_again() {
    let mut bench = Bench::new(Servo::Position, [0.02, 0.0]);
    let state = |bench: &mut Bench, left, right, request| {
        bench.drives = [left, right];
        bench.step(request).directive.state
    };
    use cia402::State::{OperationEnabled, SwitchOnDisabled, SwitchedOn};
    state(&mut bench, SwitchedOn, SwitchedOn, Request::None);
    assert_eq!(state(&mut bench, SwitchedOn, SwitchedOn, Request::Enable), State::Enabling);
    assert_eq!(state(&mut bench, OperationEnabled, SwitchedOn, Request::None), State::Enabling);
    assert_eq!(state(&mut bench, SwitchOnDisabled, SwitchedOn, Request::None), State::Stopped);
    assert_eq!(bench.fault(), Some(Fault::DriveLeftOperation));
}

#[test]
fn it_does_not_start_from_a_predicted_position() {
    let mut bench = Bench::new(Servo::Position, [0.02, 0.0]);
    bench.step(Request::None);
    bench.step(Request::Enable);
    let there = bench.angles[0].take();
    assert_eq!(bench.step(Request::None).directive.state, State::Enabling);
    bench.angles[0] = there;
    assert_eq!(bench.step(Request::None).directive.state, State::Running);
}

#[test]
fn the_distance_from_the_surface_is_known_in_every_state() {
    let mut bench = moving();
    let check = |bench: &mut Bench, request, state| {
        let outputs = bench.step(request);
        bench.angles = outputs.signals.target_angles.to_array().map(Some);
        assert_eq!(outputs.directive.state, state);
        let [x, y] = outputs.signals.proxy.to_array();
        assert!((outputs.signals.signed_distance_m - (elementary::hypot(x, y) - 0.12)).abs() < 1e-12, "{state:?}");
    };
    check(&mut bench, Request::None, State::Running);
    bench.overload = true;
    check(&mut bench, Request::None, State::Holding);
    bench.overload = false;
    check(&mut bench, Request::Stop, State::Stopping);
    while bench.cycle.state() != State::Stopped {
        bench.follow();
    }
    check(&mut bench, Request::None, State::Stopped);
}

#[test]
fn a_reference_too_fast_stops_along_the_ramp_from_the_last_good_one() {
    let mut bench = Bench::running(Servo::Position, [-0.06, 0.0]);
    bench.force = [120.0, 0.0];
    let mut last = bench.reference();
    let mut ramp = 0;
    for _ in 0..1000 {
        let outputs = bench.follow();
        if outputs.directive.state == State::Stopped {
            break;
        }
        let now = bench.reference();
        assert!(now.velocity.norm() <= TOOL_SPEED_LIMIT);
        if outputs.directive.state == State::Stopping {
            let change = (now.velocity - last.velocity).norm();
            assert!(change <= 2.0 * DECELERATION * PERIOD_S, "{change} in cycle {ramp} of the ramp");
            ramp += 1;
        }
        last = now;
    }
    assert_eq!((bench.cycle.state(), bench.fault()), (State::Stopped, Some(Fault::OverSpeed)));
    assert!(ramp > 100, "{ramp}");
}

#[test]
fn a_joint_target_too_fast_stops_along_the_ramp_too() {
    let mut bench = moving();
    // A jump of the proxy by 8 mm in a cycle would be 8 m/s.
    let far = bench.reference().point + TipDisplacement::new(0.008, 0.0);
    bench.cycle.settings.tool_speed_limit_m_per_s = 100.0;
    bench.cycle.fixture.reset(&far.0).unwrap();
    let before = bench.reference();
    let outputs = bench.follow();
    assert_eq!(outputs.directive.state, State::Stopping);
    assert_eq!(bench.fault(), Some(Fault::OverSpeed));
    let step = (bench.reference().point - before.point).norm();
    assert!(step <= before.velocity.norm() * PERIOD_S * (1.0 + 1e-9), "{step}");
}

#[test]
fn an_arm_that_turned_while_no_cycle_ran_is_no_jump() {
    // 8 rad/s for three periods; the limit of one period is 12 rad/s.
    let turned = |timing: Timing| {
        let mut bench = moving();
        bench.timing = timing;
        for joint in 0..2 {
            push_angle(&mut bench, joint, 8.0 * 3.0 * PERIOD_S);
        }
        bench.step(Request::None);
        bench.cycle.faults.count(Fault::EncoderJump)
    };
    assert_eq!(turned(Timing::default()), 1);
    assert_eq!(turned(Timing { skipped: 2, ..Timing::default() }), 0);
    assert_eq!(turned(Timing { suspended: true, ..Timing::default() }), 0);
}

#[test]
fn a_stop_that_cannot_be_followed_is_a_quick_stop_in_the_same_cycle() {
    let mut bench = moving();
    let limits = guard::Limits { period_s: PERIOD_S, torque_n_m: [60.0; 2], joint_speed_rad_per_s: 1e-6 };
    bench.cycle.gate = crate::guard::Gate::new(limits);
    let outputs = bench.follow();
    assert_eq!((outputs.directive.state, bench.fault()), (State::Stopped, Some(Fault::OverSpeed)));
    assert_eq!(outputs.directive.goal, cia402::Goal::QuickStop);
}

#[test]
fn nothing_that_is_not_finite_comes_out() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300] {
        for joint in 0..2 {
            let mut bench = moving();
            for _ in 0..5 {
                bench.angles[joint] = Some(bad);
                bench.step(Request::None);
            }
            assert!(bench.cycle.state().is_latched(), "{bad} on joint {joint}: {:?}", bench.cycle.state());
        }
    }
}

fn drive_state() -> impl Strategy<Value = cia402::State> {
    prop_oneof![
        6 => Just(cia402::State::OperationEnabled),
        1 => proptest::sample::select(cia402::State::ALL.to_vec()),
    ]
}

fn angle() -> impl Strategy<Value = Option<f64>> {
    prop_oneof![
        12 => Just(Some(0.0)),
        2 => (-0.01..0.01f64).prop_map(Some),
        1 => any::<f64>().prop_map(Some),
        1 => Just(None),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    // `Bench::step` asserts the invariants in every cycle.
    #[test]
    fn no_garbage_breaks_the_invariants(
        mode in 0..4usize,
        cycles in proptest::collection::vec(
            ((angle(), angle()), (drive_state(), drive_state()), any::<[i32; 6]>(), 0..12u8, any::<u8>()), 1..60),
    ) {
        let servo = [
            Servo::Position, velocity_servo(), torque_servo(Law::Psmc, false), torque_servo(Law::Pid, true),
        ][mode].clone();
        let mut bench = Bench::running(servo, [-0.03, 0.01]);
        for ((left, right), (first, second), counts, request, sequence) in cycles {
            let request = match request {
                0 => Request::Enable,
                1 => Request::Stop,
                2 => Request::Reset,
                _ => Request::None,
            };
            let here = bench.cycle.measured.angles.to_array();
            bench.angles = [left.map(|by| here[0] + by), right.map(|by| here[1] + by)];
            let mut inputs = bench.inputs(request);
            inputs.drives[0].state = first;
            inputs.drives[1].state = second;
            let is_wild = sequence % 4 == 0;
            inputs.sample = inputs.sample.map(|sample| RawSample {
                counts: if is_wild { counts } else { counts.map(|count| count % 2000) },
                ..sample
            });
            let before = bench.cycle.state();
            let outputs = bench.cycle.step(&inputs);
            assert_is_safe(&inputs, &outputs);
            prop_assert!(!before.is_latched() || outputs.directive.state.is_latched() || request == Request::Reset);
        }
    }
}
