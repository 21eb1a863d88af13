use super::super::draw::Shipped;
use super::*;
use yieldwall_config::injection::Kind;
use yieldwall_sim::arm::ArmError;

fn machine() -> Machine {
    Machine::draw(&Shipped::load().unwrap(), 0)
}

/// The boot took time: the cycle after it that does not run begins where it would have run.
#[test]
fn a_cycle_that_does_not_run_after_a_new_boot_has_its_own_moment() {
    let drawn = machine();
    let course = Course { machine: &drawn, script: &[], seed: 0, cycles: 10 };
    let mut run = Run::new(&course);
    let mut rig = EmbeddedRig::new(&drawn.rig, &drawn.scene, &drawn.rig.fixture, 0).unwrap();
    run.watch(&mut rig);
    rig.power_up().unwrap();
    run.cycle(&mut rig, Request::None).unwrap();
    let before_ns = run.seen.sync_ns;
    assert!(run.restart(&mut rig).unwrap());
    rig.take_handle();
    rig.inject(Injection::new(Kind::MasterStopped, 0.0)).unwrap();
    let sync_ns = rig.next_sync().0;
    assert!(sync_ns > before_ns + 5_000_000, "the boot takes more than some cycles: {before_ns} to {sync_ns}");
    run.cycle(&mut rig, Request::None).unwrap();
    assert!(!run.seen.ran);
    assert_eq!(run.seen.sync_ns, sync_ns);
}

#[test]
fn an_arm_that_cannot_go_on_is_excused_by_what_led_it_there() {
    let drawn = machine();
    let stuck = [Injection::new(Kind::EncoderStuck, 0.0)];
    let error = RigError::Arm(ArmError::NearSingularity { time_s: 1.0, transmission: 30.7, limit: 30.0 });
    let excuse = |script: &[Injection], state: State, tool_m: [f64; 2]| {
        let course = Course { machine: &drawn, script, seed: 0, cycles: 10 };
        let mut run = Run::new(&course);
        run.scene_from_ns = Some(0);
        (run.seen.state, run.seen.truth.tool_m) = (state, tool_m);
        run.excuse_of(&error)
    };
    assert_eq!(excuse(&[], State::Running, [0.1, 0.0]), None);
    assert_eq!(excuse(&stuck, State::Running, [0.1, 0.0]), Some(Excuse::Falsified));
    assert_eq!(excuse(&[], State::Running, [0.25, 0.0]), Some(Excuse::Far));
    assert_eq!(excuse(&[], State::Stopped, [0.1, 0.0]), Some(Excuse::Unheld));
}

#[test]
fn an_arm_that_the_drives_take_over_in_motion_is_carried_for_a_while() {
    use yieldwall_drives::cia402::State as Drive;
    let drawn = machine();
    let course = Course { machine: &drawn, script: &[], seed: 0, cycles: 10 };
    let carried = |radius_m: f64, speed: f64, was_held: bool, drive: Drive, state: State| {
        let mut run = Run::new(&course);
        run.was_held = was_held;
        (run.seen.truth.drives, run.seen.state) = ([drive; 2], state);
        (run.seen.truth.tool_m, run.seen.truth.velocity_m_per_s) = ([0.0, radius_m], [0.0, speed]);
        run.note_takeover();
        run.carried_until_ns > 0
    };
    let (on, off) = (Drive::OperationEnabled, Drive::ReadyToSwitchOn);
    assert!(carried(0.2, 1.2, false, on, State::Running) && carried(0.2, 1.2, false, off, State::Enabling));
    // In motion within the working disc, at rest outside of it, and held all the while.
    for (radius_m, speed, was_held) in [(0.15, 1.2, false), (0.2, 0.0, false), (0.2, 1.2, true)] {
        assert!(!carried(radius_m, speed, was_held, on, State::Running));
    }
    assert!(!carried(0.15, 1.2, false, off, State::Enabling) && !carried(0.2, 0.0, false, off, State::Enabling));
    assert!(!carried(0.2, 1.2, false, off, State::Idle), "nobody asked to be enabled");
}
