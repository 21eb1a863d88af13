// Each of its users takes a part of it.
#[allow(dead_code, unused_imports, clippy::duplicate_mod)]
#[path = "../../config/malformed/mod.rs"]
mod malformed;

use std::sync::atomic::AtomicBool;

use super::*;
use malformed::{base_text, with};
use proptest::prelude::*;
use yieldwall_config::{Source, load_rig};
use yieldwall_motion::elementary;
use yieldwall_motion::guard::{DeviceSet, Fault};
use yieldwall_motion::quantity::Force;
use yieldwall_run::{Bounds, bringup};

fn shipped(permit: fn(&Runner<Simulation>) -> Permit) -> EmbeddedRig {
    let loaded = config::load_rig(config::Source::named("builtin:paper-admittance.yaml")).unwrap();
    let scene = loaded.scene().unwrap().value;
    let mut machine = EmbeddedRig::new(&loaded.value, &scene, &loaded.value.fixture, scene.seed).unwrap();
    machine.boot().unwrap();
    machine.permit = permit(&machine.runner);
    machine.come_to_run(machine.enabling).unwrap();
    machine
}

/// Returns how far the hand of the scene moves the reference in a second, rad, and the state then.
fn led(mut machine: EmbeddedRig) -> (f64, State) {
    let at = |row: &Row| row.target_angles_rad;
    let first = at(&machine.run_cycle(Request::None).unwrap());
    let mut farthest = 0.0_f64;
    for _ in 0..1000 {
        let [left, right] = at(&machine.run_cycle(Request::None).unwrap());
        farthest = farthest.max((left - first[0]).abs()).max((right - first[1]).abs());
    }
    (farthest, machine.state())
}

#[test]
fn a_rig_that_was_enabled_to_rest_is_stopped_when_somebody_leads_it_away() {
    let (farthest, state) = led(shipped(Permit::in_virtual_time));
    assert!(farthest > 0.1 && state == State::Running, "{farthest} {state:?}");
    let (farthest, state) = led(shipped(Permit::for_drill));
    // And what the ramp takes.
    assert!(farthest < 0.04 && state == State::Stopped, "{farthest} {state:?}");
}

/// The master's own drill asks for SAFE-OP by frames; the other one takes the devices there.
#[test]
fn drives_on_ethercat_stop_without_outputs_and_without_op() {
    let loaded = config::load_rig(config::builtin("paper-ethercat.yaml")).unwrap();
    let (rig, scene) = (&loaded.value, loaded.scene().unwrap().value);
    let mut machine = EmbeddedRig::new(rig, &scene, &rig.fixture, scene.seed).unwrap();
    let by_frames = bringup::drill(&mut machine.runner, 50, &AtomicBool::new(false), |_| ()).unwrap();
    let virtually = crate::drill(rig, &scene, |_| ()).unwrap();
    for drilled in [by_frames, virtually] {
        let of = |finding: &yieldwall_run::Finding| (finding.watchdog.name(), finding.stopped_in.map(Option::unwrap));
        let [outputs, op] = drilled.findings.as_slice() else { panic!("{drilled:?}") };
        let off = [cia402::State::SwitchOnDisabled; 2];
        assert_eq!([of(outputs), of(op)], [("outputs", off), ("OP", off)]);
        for (finding, [least_ms, most_ms]) in [(outputs, [4, 8]), (op, [0, 4])] {
            let is_within = |after: Option<Duration>| (least_ms..=most_ms).contains(&after.unwrap().as_millis());
            assert!(finding.stopped_after.into_iter().all(is_within), "{drilled:?}");
        }
    }
}

/// A shipped rig whose simulated drives have this Fault from power-on, or power stages that come so late.
fn with_late_drives(file: &str, fault_code: u16, supply_ms: u32) -> EmbeddedRig {
    let loaded = config::load_rig(config::builtin(file)).unwrap();
    let (mut rig, scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    rig.simulation.as_mut().unwrap().drive_model = Some(config::DriveModel {
        profile: rig.drives[0].profile.clone(),
        has_dummies: true,
        refuses_mode: false,
        sdo_server: config::SdoServer { answer_ms: 0, segments_only: false, lengths: Vec::new() },
        objects: Vec::new(),
        fault_code,
        supply_ms,
    });
    let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
    machine.boot().unwrap();
    machine
}

/// The boot resets nodes on CAN, and a Fault lasts.
#[test]
fn drives_in_fault_from_power_on_keep_a_rig_from_its_drill_and_say_why() {
    use yieldwall_drives::cia402::Statusword;
    for file in ["paper-admittance-csp.yaml", "paper-ethercat.yaml"] {
        let mut machine = with_late_drives(file, 0x7121, 0);
        let drilled = bringup::drill(&mut machine.runner, 50, &AtomicBool::new(false), |_| ());
        let Err(RunError::NotEnabled { cause: Some(cause), .. }) = drilled else { panic!("{file}: {drilled:?}") };
        assert_eq!(cause, Cause { fault: Fault::DriveFault, devices: DeviceSet::DRIVES }, "{file}");
        let errors: Vec<_> = machine.runner.errors().collect();
        let states = errors.iter().map(|error| Statusword(error.statusword.unwrap()).state());
        assert_eq!(states.collect::<Vec<_>>(), [Some(cia402::State::Fault); 2], "{file}");
        assert_eq!(errors.iter().map(|error| error.code).collect::<Vec<_>>(), [Some(0x7121); 2], "{file}");
    }
}

#[test]
fn power_stages_that_come_later_are_told_and_withdrawn() {
    for file in ["paper-admittance-csp.yaml", "paper-ethercat.yaml"] {
        let mut machine = with_late_drives(file, 0, 5);
        bringup::drill(&mut machine.runner, 50, &AtomicBool::new(false), |_| ()).unwrap();
        let told = machine.master().networks().told();
        let of_supply: Vec<_> = told.iter().filter(|told| told.code.0 == 0x3220).collect();
        assert!(!of_supply.is_empty() && of_supply.iter().all(|told| told.is_withdrawn), "{file}: {told:?}");
    }
}

#[test]
fn bring_up_is_kept_within_its_bounds() {
    let loaded = config::load_rig(config::Source::named("builtin:paper-admittance.yaml")).unwrap();
    let positive = |value| config::Positive::new(value).unwrap();
    let bounds = Bounds { motion_rad: positive(0.05), torque_n_m: positive(40.0) };
    let scene = loaded.scene().unwrap().value;
    let mut machine = EmbeddedRig::new(&loaded.value, &scene, &loaded.value.fixture, scene.seed).unwrap();
    machine.boot().unwrap();
    machine.permit = machine.runner.bring_up_in_virtual_time(&loaded.value, bounds).unwrap();
    let rated_n_m = loaded.value.drives[0].rated_torque_n_m.get();
    let limit = machine.runner.read(yieldwall_motion::guard::Device::LeftDrive, 0x6072, 0).unwrap();
    assert_eq!(f64::from(limit), (40.0 / rated_n_m * 1000.0).round());
    machine.come_to_run(machine.enabling).unwrap();
    let (farthest, state) = led(machine);
    assert!(farthest > 0.05 && farthest < 0.07 && state == State::Stopped, "{farthest} {state:?}");
}

#[test]
fn a_permit_is_of_one_boot_of_one_rig() {
    let mut machine = shipped(Permit::in_virtual_time);
    let other = shipped(Permit::in_virtual_time);
    assert_eq!(machine.runner.check_permit(&machine.permit), Ok(()));
    assert_eq!(machine.runner.check_permit(&other.permit), Err(RunError::OldPermit));
    assert!(machine.runner.stop());
    let old = std::mem::replace(&mut machine.permit, other.permit);
    machine.start_network().unwrap();
    assert_eq!(machine.runner.check_permit(&machine.permit), Ok(()), "proved again");
    for permit in [&old, &Permit::without_proof(&other.runner, "of another rig")] {
        let enabled = machine.runner.enable(0, permit, &AtomicBool::new(false));
        assert_eq!(enabled, Err(RunError::OldPermit));
        for _ in 0..200 {
            machine.runner.run_cycle(Ask::Enable(permit));
            assert_eq!(machine.state(), State::Idle);
        }
    }
    machine.runner.enable(0, &machine.permit, &AtomicBool::new(false)).unwrap();
}

#[test]
fn a_rig_on_ethercat_follows_its_hand_and_stops_also_with_its_sensor_on_can() {
    for file in ["paper-ethercat.yaml", "paper-ethercat-can-sensor.yaml"] {
        let loaded = config::load_rig(config::builtin(file)).unwrap();
        let (rig, scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
        let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
        machine.enable().unwrap();
        let start_m = machine.run_cycle(Request::None).unwrap().tool_m;
        let mut farthest = 0.0_f64;
        for _ in 0..2000 {
            let row = machine.run_cycle(Request::None).unwrap();
            farthest = farthest.max((row.tool_m[0] - start_m[0]).abs()).max((row.tool_m[1] - start_m[1]).abs());
        }
        assert_eq!((machine.state(), machine.cause()), (State::Running, None), "{file}");
        assert!(farthest > 0.01, "{file}: {farthest}");
        let counted: Vec<_> = machine.master().cycle().faults().counted().collect();
        assert!(counted.is_empty(), "{file}: {counted:?}");
        assert!(
            machine.master().networks().told().is_empty() && machine.master().networks().findings().is_empty(),
            "{file}"
        );
        machine.stop().unwrap();
    }
}

/// A rig that is tared up to 3 N, with a force that pulls at the tool all the time; after a second of rest.
fn tared(pull: Force) -> Result<(Force, State), RigError> {
    let mut loaded = config::load_rig(config::Source::named("builtin:paper-admittance.yaml")).unwrap();
    loaded.value.sensor.tare_up_to_n = config::Positive::new(3.0);
    let scene = loaded.scene().unwrap().value;
    let mut machine = EmbeddedRig::new(&loaded.value, &scene, &loaded.value.fixture, scene.seed).unwrap();
    machine.boot()?;
    machine.place_mut().far.world.weight = pull;
    let enabled = machine.come_to_run(machine.enabling);
    assert!(enabled.is_ok() || machine.drive_states().iter().all(|state| *state != cia402::State::OperationEnabled));
    enabled?;
    machine.place_mut().far.world.let_go();
    let mut felt = Force::default();
    for _ in 0..1000 {
        machine.run_cycle(Request::None)?;
        felt = machine.runner.last_outputs().unwrap().signals.force;
    }
    Ok((felt, machine.state()))
}

#[test]
fn what_pulls_at_the_tool_when_a_rig_is_enabled_is_the_zero_unless_it_is_too_great() {
    let (felt, state) = tared(Force::new(1.6, -1.6)).unwrap();
    assert!(felt.norm() < 0.2 && state == State::Running, "{felt:?} {state:?}");
    let error = tared(Force::new(3.0, 3.0)).unwrap_err().to_string();
    assert!(error.contains("the force sensor was not tared: it shows 4.2"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// Every number of a rig or its scene replaced by any number of any size: refused, or the rig can be built.
    #[test]
    fn any_number_in_a_rig_is_answered(
        which in 0..300_usize,
        number in prop_oneof![any::<f64>(), -10.0..1e4_f64, Just(0.0), (-320.0..320.0_f64).prop_map(|power| elementary::powf(10.0, power))],
        is_whole in any::<bool>(),
        mode in prop_oneof![Just("torque"), Just("position")],
    ) {
        let name = if which % 4 == 0 { "scene.yaml" } else { "rig.yaml" };
        let original = base_text(name).replace("command_mode: torque", &format!("command_mode: {mode}"));
        let is_number = |at: usize| original[..at].ends_with([' ', '[', '-']) && !original[..at].ends_with("- ");
        let digits = original.match_indices(|c: char| c.is_ascii_digit()).map(|(at, _)| at);
        let starts: Vec<usize> = digits.filter(|at| is_number(*at)).collect();
        let start = starts[which % starts.len()];
        let end = start + original[start..].find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(0);
        let number = if is_whole { format!("{:.0}", number.clamp(-1e6, 1e6)) } else { format!("{number:?}") };
        let text = format!("{}{number}{}", &original[..start], &original[end..]);
        if let Ok(rig) = load_rig(with("rig.yaml", name, &text)) {
            let scene = rig.scene().unwrap().value;
            let built = EmbeddedRig::new(&rig.value, &scene, &rig.value.fixture, scene.seed);
            prop_assert!(built.is_ok(), "{number} at {:?}: {}", original[..start].lines().last(), built.err().unwrap());
        }
    }
}
