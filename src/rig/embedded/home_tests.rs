//! Joints that are homed on the embedded simulation.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use super::*;
use proptest::prelude::*;
use yieldwall_config::injection::{Defect, DefectKind, Kind, Target};
use yieldwall_motion::quantity::JointAngles;
use yieldwall_run::bringup;
use yieldwall_run::{Bounds, Ended, HOMING_BEYOND_RAD, HomePlan, Homed, NotHome, NotProven, Repeated, RunError};

const RIG: &str = "paper-incremental.yaml";

/// The rig, with the arm where the scene has it, on CAN or on EtherCAT, in a command mode, and with homing changed.
fn rig(
    is_on_ethercat: bool,
    mode: config::CommandMode,
    change: impl Fn(usize, &mut config::Homing),
) -> (config::Rig, config::Scene) {
    let loaded = config::load_rig(config::builtin(RIG)).unwrap();
    let scene = loaded.scene().unwrap().value;
    let mut rig = loaded.value;
    if is_on_ethercat {
        let other = config::load_rig(config::builtin("paper-ethercat.yaml")).unwrap().value;
        let homing = rig.drives.each_ref().map(|drive| (drive.encoder, drive.homing));
        rig = other;
        for (drive, (encoder, homing)) in rig.drives.iter_mut().zip(homing) {
            (drive.encoder, drive.homing) = (encoder, homing);
        }
    }
    rig.rig.command_mode = mode;
    if mode == config::CommandMode::Velocity {
        rig.control.gains = config::ControlGains::Rate { gain_per_s: config::Positive::new(60.0).unwrap() };
    }
    for (joint, drive) in rig.drives.iter_mut().enumerate() {
        drive.homing.iter_mut().for_each(|homing| change(joint, homing));
    }
    (rig, scene)
}

/// Returns the outcome of homing, the true angles at the end, and the largest travel of each link.
fn homed(
    (rig, scene): &(config::Rig, config::Scene),
    joints: [bool; 2],
    injections: &[Injection],
) -> (Result<Homed, RunError>, JointAngles, [f64; 2]) {
    let mut machine = EmbeddedRig::new(rig, scene, &rig.fixture, scene.seed).unwrap();
    machine.set_injections(injections).unwrap();
    let plan = HomePlan::of(rig, joints, 20).unwrap();
    let linkage = yieldwall_run::assembly::linkage(rig).unwrap();
    let farthest = Arc::new(Mutex::new(([0.0_f64; 2], None)));
    let seen = Arc::clone(&farthest);
    machine.set_observer(Box::new(move |record| {
        let Some(angles) = record.truth.and_then(|truth| linkage.inverse(truth.tool).ok()) else { return };
        let (farthest, start) = &mut *seen.lock().unwrap();
        let gone = angles - *start.get_or_insert(angles);
        farthest.iter_mut().zip(gone.to_array()).for_each(|(farthest, gone)| *farthest = farthest.max(gone.abs()));
    }));
    let torque = config::Positive::new(15.0).unwrap();
    let homed = machine.home(rig, &plan, torque, &AtomicBool::new(false)).unwrap();
    assert!(!machine.drive_states().into_iter().any(cia402::State::has_torque), "{homed:?}");
    let [left, right] = machine.arm().unwrap().motor_angles().to_array();
    let farthest = farthest.lock().unwrap().0;
    (homed, JointAngles::new(left, right), farthest)
}

#[test]
fn both_joints_find_their_index_in_every_mode_and_on_every_bus() {
    use config::CommandMode::{Position, Torque, Velocity};
    for is_on_ethercat in [false, true] {
        for mode in [Torque, Velocity, Position] {
            let machine = rig(is_on_ethercat, mode, |_, _| ());
            let (homed, truth, farthest) = homed(&machine, [true; 2], &[]);
            let homed = homed.unwrap();
            let told = format!("EtherCAT {is_on_ethercat}, {mode:?}: {homed:?}");
            assert_eq!((homed.ended, homed.failed, homed.cause), (Ended::Whole, None, None), "{told}");
            for (joint, truth) in homed.joints.iter().zip(truth.to_array()) {
                assert!(joint.is_homed && joint.is_referenced, "{told}");
                // Where its position has it is where it is.
                assert!((joint.angle_rad - truth).abs() < 1e-3, "{told}, truly at {truth}");
            }
            assert!(farthest.iter().all(|gone| *gone < 0.1), "{told}: {farthest:?}");
        }
    }
}

#[test]
fn limit_switches_and_jigs_are_references_too() {
    // Of each joint: method and how far its start is from home, in the direction that leads there.
    let (start, _) = (rig(false, config::CommandMode::Torque, |_, _| ()), ());
    let from = EmbeddedRig::new(&start.0, &start.1, &start.0.fixture, 1).unwrap().arm().unwrap().motor_angles();
    for (method, off_rad) in [(17, -0.06), (18, 0.06), (33, -0.06), (34, 0.06), (35, 0.0), (37, 0.0)] {
        let machine = rig(false, config::CommandMode::Torque, |joint, homing| {
            homing.method = method;
            homing.angle_rad = config::Finite::new(from.to_array()[joint] + off_rad).unwrap();
        });
        let (homed, truth, _) = homed(&machine, [true; 2], &[]);
        let homed = homed.unwrap();
        assert_eq!((homed.ended, homed.failed), (Ended::Whole, None), "method {method}: {homed:?}");
        for (joint, truth) in homed.joints.iter().zip(truth.to_array()) {
            assert!((joint.angle_rad - truth).abs() < 1e-3, "method {method}: {homed:?}, truly at {truth}");
        }
    }
}

#[test]
fn a_joint_that_is_not_asked_for_holds_and_stays_without_a_reference() {
    let machine = rig(false, config::CommandMode::Torque, |_, _| ());
    let (homed, _, farthest) = homed(&machine, [false, true], &[]);
    let [left, right] = homed.unwrap().joints;
    assert!(!left.is_homed && !left.is_referenced && right.is_homed && right.is_referenced);
    assert!(farthest[0] < 2e-3, "{farthest:?}");
}

#[test]
fn a_drive_that_knows_its_reference_is_not_sent_the_wrong_way_for_it() {
    for is_on_ethercat in [false, true] {
        let (rig, scene) = rig(is_on_ethercat, config::CommandMode::Torque, |_, _| ());
        let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
        let enabled = Arc::new(Mutex::new(0));
        let counted = Arc::clone(&enabled);
        machine.set_observer(Box::new(move |record| {
            let is_on = record.inputs.drives.iter().any(|drive| drive.state == cia402::State::OperationEnabled);
            *counted.lock().unwrap() += u32::from(is_on);
        }));
        let (plan, is_interrupted) = (HomePlan::of(&rig, [true; 2], 20).unwrap(), AtomicBool::new(false));
        let torque_n_m = config::Positive::new(15.0).unwrap();
        assert_eq!(machine.home(&rig, &plan, torque_n_m, &is_interrupted).unwrap().unwrap().failed, None);
        let before = *enabled.lock().unwrap();
        assert!(before > 0);
        // Each joint has come to rest behind its index, and nobody has switched the drives off.
        let runner = &mut machine.runner;
        runner.boot().unwrap();
        let bounds = Bounds { motion_rad: config::Positive::new(plan.bound_rad()).unwrap(), torque_n_m };
        let permit = super::boot::bring_up(runner, &rig, bounds).unwrap();
        let again = bringup::home(runner, &rig, &plan, &permit, &is_interrupted);
        assert!(matches!(again, Err(RunError::BehindHome { by_rad, .. }) if by_rad.abs() < 0.02), "{again:?}");
        assert_eq!(*enabled.lock().unwrap(), before, "nothing was enabled");
    }
}

#[test]
fn an_index_that_is_not_on_the_way_ends_at_the_bound() {
    // It lies behind, and the joint goes as far as it may.
    let machine = rig(false, config::CommandMode::Torque, |joint, homing| homing.method = [33, 34][joint]);
    let (homed, _, farthest) = homed(&machine, [true; 2], &[]);
    let homed = homed.unwrap();
    assert!(matches!(homed.failed, Some((0, NotHome::TooFar(0, _)))), "{homed:?}");
    assert!(farthest[0] < 0.15 + HOMING_BEYOND_RAD + 0.02, "{farthest:?}");
    assert!(farthest[1] < 0.02 && !homed.joints[0].is_homed);
}

#[test]
fn a_drive_that_takes_the_offset_with_the_other_sign_is_found() {
    let machine = rig(false, config::CommandMode::Torque, |_, _| ());
    let mut other = machine.clone();
    for drive in &mut other.0.drives {
        let mut profile = (**drive.profile.get().unwrap()).clone();
        let yieldwall_drives::profiles::Role::Servo(servo) = &mut profile.device else { unreachable!() };
        servo.homing.as_mut().unwrap().position_at_home = yieldwall_drives::profiles::PositionAtHome::Offset;
        drive.profile.set(profile, None);
    }
    // The drives are those of the first one.
    let mut rig = other.0;
    rig.simulation.as_mut().unwrap().drive_model = Some(config::DriveModel {
        profile: machine.0.drives[0].profile.clone(),
        has_dummies: true,
        refuses_mode: false,
        sdo_server: config::SdoServer { answer_ms: 0, segments_only: false, lengths: Vec::new() },
        objects: Vec::new(),
        fault_code: 0,
        supply_ms: 0,
    });
    let (homed, ..) = homed(&(rig, machine.1), [true; 2], &[]);
    assert!(matches!(homed.unwrap().failed, Some((0, NotHome::Elsewhere(_)))));
}

#[test]
fn a_rig_that_was_not_homed_is_not_run() {
    let (rig, scene) = rig(false, config::CommandMode::Torque, |_, _| ());
    let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
    machine.boot().unwrap();
    let error = machine.come_to_run(machine.enabling).unwrap_err();
    assert!(error.to_string().contains("it was not homed since it was switched on"), "{error}");
    // A drive that loses its supply has to be homed again.
    let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
    machine.inject(Injection::new(Kind::NodeReset, 0.3).on(Target::LeftDrive)).unwrap();
    machine.enable().unwrap();
    for _ in 0..600 {
        machine.run_cycle(Request::None).unwrap();
    }
    assert!(machine.state().is_latched());
    let error = machine.restart().unwrap_err();
    assert!(error.to_string().contains("node id 1 does not know where its joint is"), "{error}");
}

#[test]
fn a_joint_whose_encoder_stands_still_loses_its_torque() {
    let stuck = Injection::new(Kind::EncoderStuck, 2.39).on(Target::RightDrive).lasting(Some(0.314));
    for is_on_ethercat in [false, true] {
        let (homed, _, farthest) =
            homed(&rig(is_on_ethercat, config::CommandMode::Torque, |_, _| ()), [true; 2], &[stuck]);
        let homed = homed.unwrap();
        assert!(matches!(homed.failed, Some((1, NotHome::Blocked(1, _)))), "{homed:?} {farthest:?}");
        assert!(homed.joints[0].is_homed && !homed.joints[1].is_homed, "{homed:?} {farthest:?}");
        assert_eq!(
            homed.cause.map(|cause| cause.fault),
            Some(yieldwall_motion::guard::Fault::FollowingError),
            "{homed:?}"
        );
    }
}

#[test]
fn an_encoder_that_stands_still_at_any_moment_leads_no_joint_away() {
    let machine = rig(false, config::CommandMode::Torque, |_, _| ());
    for target in [Target::LeftDrive, Target::RightDrive] {
        for at in 0..30 {
            let stuck = Injection::new(Kind::EncoderStuck, 0.1 * f64::from(at) + 0.05).on(target).lasting(Some(0.5));
            let (homed, _, farthest) = homed(&machine, [true; 2], &[stuck]);
            assert!(farthest.iter().all(|gone| *gone < 0.15 + HOMING_BEYOND_RAD), "{stuck:?}: {farthest:?} {homed:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Whatever breaks on the way, encoders too: no link leaves its bound, and no drive is left with torque.
    #[test]
    fn whatever_breaks_no_joint_goes_too_far(
        is_on_ethercat: bool, at_s in 0.0..3.0f64, for_s in 0.01..0.5f64, is_left: bool,
        kind in prop::sample::select(vec![
            Kind::DriveFault, Kind::DriveLeavesOperation, Kind::VoltageOff, Kind::Emergency, Kind::NodeReset, Kind::ArmBlocked,
            Kind::SensorInvalid, Kind::EncoderStuck, Kind::EncoderJump,
        ]),
    ) {
        let targets = kind.row().targets;
        let wanted = if is_left { Target::LeftDrive } else { Target::RightDrive };
        let target = if targets.contains(&wanted) { wanted } else { targets[0] };
        let broken = Injection::new(kind, at_s).on(target).lasting(Some(for_s));
        let broken = if broken.check().is_ok() { broken } else { broken.lasting(None) };
        let machine = rig(is_on_ethercat, config::CommandMode::Torque, |_, _| ());
        let (homed, _, farthest) = homed(&machine, [true; 2], &[broken]);
        prop_assert!(farthest.iter().all(|gone| *gone < 0.15 + 2.0 * HOMING_BEYOND_RAD), "{broken:?}: {farthest:?} {homed:?}");
    }
}

/// Homes the joints of a rig this many times. Returns the true angles of home after each, in the positions that the drive then has,
/// rad.
fn repeated(
    (rig, scene): &(config::Rig, config::Scene),
    (joints, times): ([bool; 2], u32),
    defects: &[Defect],
    injections: &[Injection],
) -> (Result<Repeated, NotProven>, Vec<JointAngles>, [f64; 2]) {
    let mut scene = scene.clone();
    scene.defects = defects.iter().map(|defect| (*defect).into()).collect();
    let mut machine = EmbeddedRig::new(rig, &scene, &rig.fixture, scene.seed).unwrap();
    machine.set_injections(injections).unwrap();
    let plan = HomePlan::of(rig, joints, 20).unwrap();
    let linkage = yieldwall_run::assembly::linkage(rig).unwrap();
    let seen = Arc::new(Mutex::new((JointAngles::default(), None, [0.0_f64; 2])));
    let sees = Arc::clone(&seen);
    machine.set_observer(Box::new(move |record| {
        let Some(angles) = record.truth.and_then(|truth| linkage.inverse(truth.tool).ok()) else { return };
        let (now, start, farthest) = &mut *sees.lock().unwrap();
        *now = angles;
        let gone = angles - *start.get_or_insert(angles);
        farthest.iter_mut().zip(gone.to_array()).for_each(|(farthest, gone)| *farthest = farthest.max(gone.abs()));
    }));
    let bound = |value| config::Positive::new(value).unwrap();
    let bounds = Bounds { motion_rad: bound(plan.bound_rad()), torque_n_m: bound(15.0) };
    let mut homes = Vec::new();
    let told = |homed: &Homed| {
        let told = homed.joints.map(|joint| joint.angle_rad);
        homes.push(seen.lock().unwrap().0 - JointAngles::from(told));
    };
    let repeated = machine.home_repeatedly(rig, (&plan, times), bounds, &AtomicBool::new(false), told).unwrap();
    assert!(!machine.drive_states().into_iter().any(cia402::State::has_torque), "{repeated:?}");
    let farthest = seen.lock().unwrap().2;
    (repeated, homes, farthest)
}

/// A count of the encoder, rad.
const COUNT_RAD: f64 = std::f64::consts::TAU / 800_000.0;

#[test]
fn a_perfect_index_is_found_at_the_same_place_each_time() {
    use config::CommandMode::{Position, Torque, Velocity};
    for (is_on_ethercat, mode) in [(false, Torque), (false, Velocity), (false, Position), (true, Torque)] {
        let machine = rig(is_on_ethercat, mode, |_, _| ());
        let (repeated, _, farthest) = repeated(&machine, ([true; 2], 3), &[], &[]);
        let repeated = repeated.unwrap();
        let told = format!("EtherCAT {is_on_ethercat}, {mode:?}: {repeated:?}");
        assert_eq!((repeated.homed.len(), repeated.stopped, repeated.unknown), (3, None, None), "{told}");
        for shifts in &repeated.shifts_rad {
            assert_eq!(shifts.len(), 2, "{told}");
            assert!(shifts.iter().all(|shift| shift.abs() < 2.0 * COUNT_RAD), "{told}");
        }
        assert!(farthest.iter().all(|gone| *gone < 0.1), "{told}: {farthest:?}");
    }
}

#[test]
fn limit_switches_are_found_again_too() {
    let start = rig(false, config::CommandMode::Torque, |_, _| ());
    let from = EmbeddedRig::new(&start.0, &start.1, &start.0.fixture, 1).unwrap().arm().unwrap().motor_angles();
    for (method, off_rad) in [(17, -0.06), (18, 0.06)] {
        let machine = rig(false, config::CommandMode::Torque, |joint, homing| {
            homing.method = method;
            homing.angle_rad = config::Finite::new(from.to_array()[joint] + off_rad).unwrap();
        });
        let loose = Defect::new(DefectKind::LooseHome);
        let (repeated, homes, _) = repeated(&machine, ([true; 2], 4), &[loose], &[]);
        let repeated = repeated.unwrap();
        assert_eq!((repeated.homed.len(), repeated.unknown), (4, None), "method {method}: {repeated:?}");
        shifts_are_true(&repeated, &homes).unwrap();
    }
}

/// Whether each shift is the one that the truth has. A shift is the difference of two homes, and each home has an error of up to two counts: one
/// of the encoder, and one of the motion between the sample of the drive and the look at the arm.
fn shifts_are_true(repeated: &Repeated, homes: &[JointAngles]) -> Result<(), String> {
    for (joint, shifts) in repeated.shifts_rad.iter().enumerate() {
        let truth = homes.windows(2).map(|two| (two[1] - two[0]).to_array()[joint]);
        for (shift, truth) in shifts.iter().zip(truth) {
            if (shift - truth).abs() > 4.0 * COUNT_RAD {
                return Err(format!("joint {joint}: {shift} and not {truth}: {repeated:?}"));
            }
        }
    }
    Ok(())
}

#[test]
fn a_joint_that_is_not_asked_for_is_not_homed_again_either() {
    let machine = rig(false, config::CommandMode::Torque, |_, _| ());
    let (repeated, _, farthest) = repeated(&machine, ([false, true], 3), &[], &[]);
    let repeated = repeated.unwrap();
    assert_eq!(repeated.shifts_rad.map(|shifts| shifts.len()), [0, 2]);
    assert!(farthest[0] < 2e-3, "{farthest:?}");
}

#[test]
fn the_scatter_that_was_planted_is_found() {
    use yieldwall_motion::identification::Estimate;
    let machine = rig(false, config::CommandMode::Torque, |_, homing| {
        homing.rate_rad_per_s = config::Positive::new(0.1).unwrap();
    });
    for (drive, size) in [(0, 1e-3), (1, 2e-4)] {
        let loose = Defect::new(DefectKind::LooseHome).at(drive).sized(size).unwrap();
        let (repeated, homes, _) = repeated(&machine, ([drive == 0, drive == 1], 25), &[loose], &[]);
        let repeated = repeated.unwrap();
        assert_eq!((repeated.homed.len(), repeated.unknown), (25, None), "{repeated:?}");
        shifts_are_true(&repeated, &homes).unwrap();
        let mut found = vec![0.0];
        repeated.shifts_rad[drive].iter().for_each(|shift| found.push(found.last().unwrap() + shift));
        let home = Estimate::scatter(&found).unwrap();
        assert!(home.contains(size), "{home:?} {size}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, ..ProptestConfig::default() })]

    /// Whatever the size of the scatter, on either bus: each shift is the true one.
    #[test]
    fn shifts_are_those_of_the_truth(is_on_ethercat: bool, share in 0.0..=1.0f64, seed: u64, rate in 0.02..0.15f64) {
        let mut machine = rig(is_on_ethercat, config::CommandMode::Torque, |_, homing| {
            homing.rate_rad_per_s = config::Positive::new(rate).unwrap();
        });
        machine.1.seed = seed >> 12;
        let size = DefectKind::LooseHome.row().size.unwrap();
        let defect = Defect::new(DefectKind::LooseHome).sized(size.least + share * (size.most - size.least)).unwrap();
        let (repeated, homes, _) = repeated(&machine, ([true; 2], 3), &[defect, defect.at(1)], &[]);
        let repeated = repeated.unwrap();
        prop_assert_eq!((repeated.homed.len(), repeated.stopped, repeated.unknown), (3, None, None), "{:?}", repeated);
        if let Err(told) = shifts_are_true(&repeated, &homes) {
            prop_assert!(false, "{}", told);
        }
    }

    /// Whatever breaks while it is repeated: no link leaves its bound, and no drive is left with torque.
    #[test]
    fn whatever_breaks_while_it_is_repeated_no_joint_goes_too_far(
        is_on_ethercat: bool, at_s in 0.0..16.0f64, for_s in 0.01..0.5f64, is_left: bool,
        kind in prop::sample::select(vec![
            Kind::DriveFault, Kind::DriveLeavesOperation, Kind::VoltageOff, Kind::Emergency, Kind::NodeReset, Kind::ArmBlocked,
            Kind::EncoderStuck, Kind::EncoderJump,
        ]),
    ) {
        let targets = kind.row().targets;
        let wanted = if is_left { Target::LeftDrive } else { Target::RightDrive };
        let target = if targets.contains(&wanted) { wanted } else { targets[0] };
        let broken = Injection::new(kind, at_s).on(target).lasting(Some(for_s));
        let broken = if broken.check().is_ok() { broken } else { broken.lasting(None) };
        let machine = rig(is_on_ethercat, config::CommandMode::Torque, |_, _| ());
        let (repeated, _, farthest) = repeated(&machine, ([true; 2], 3), &[], &[broken]);
        prop_assert!(farthest.iter().all(|gone| *gone < 0.15 + 2.0 * HOMING_BEYOND_RAD), "{broken:?}: {farthest:?} {repeated:?}");
    }
}

/// A machine with other links and zeros than in its file, whose tool a person guides to points of a plate.
#[test]
fn links_and_zeros_are_found_from_points() {
    use yieldwall_motion::identification::kinematics;
    use yieldwall_motion::quantity::TipPoint;
    let loaded = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap();
    let (mut built, scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    built.linkage.proximal_m[0] = config::Positive::new(0.3012).unwrap();
    built.linkage.distal_m[1] = config::Positive::new(0.3987).unwrap();
    let points: Vec<TipPoint> = (0..16)
        .map(|at| {
            let angle = f64::from(at) * std::f64::consts::TAU / 8.0;
            let radius = if at < 8 { 0.06 } else { 0.12 };
            let (sin, cos) = yieldwall_motion::elementary::sin_cos(angle);
            TipPoint::new(radius * cos, radius * sin)
        })
        .collect();
    let mut machine = EmbeddedRig::new(&built, &scene, &built.fixture, scene.seed).unwrap();
    let angles = machine.visit(&points, &AtomicBool::new(false)).unwrap().unwrap();
    let off = JointAngles::new(0.004, -0.003);
    let visited: Vec<_> = points.into_iter().zip(angles.into_iter().map(|angles| angles - off)).collect();
    let found = kinematics(&loaded.value.linkage.geometry(), &visited).unwrap();
    // A count is 8 urad.
    assert!((found.proximal_m[0].value - 0.3012).abs() < 2e-5, "{found:?}");
    assert!((found.distal_m[1].value - 0.3987).abs() < 2e-5, "{found:?}");
    assert!(
        (found.zero_rad[0].value - 0.004).abs() < 1e-4 && (found.zero_rad[1].value + 0.003).abs() < 1e-4,
        "{found:?}"
    );
    assert!(found.residual_m[0] > 5e-4 && found.residual_m[1] < 1e-5, "{found:?}");
}

/// A sensor that feels too much along x and too little along y, and one whose axes are taken for one another.
#[test]
fn a_sensor_is_calibrated_by_pulls() {
    use yieldwall_motion::identification::force_map;
    let loaded = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap();
    let (rig, mut scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    let map = |rig: &config::Rig, scene: &config::Scene, told: &config::Rig| {
        let mut machine = EmbeddedRig::new(rig, scene, &rig.fixture, scene.seed).unwrap();
        let pulled = machine.pulls(told, 8.0, &AtomicBool::new(false)).unwrap().unwrap();
        let xy = |wrench: yieldwall_motion::sensing::Wrench| [wrench.0.x, wrench.0.y];
        let pulls: Vec<_> = pulled.iter().map(|pulled| (xy(pulled.expected), xy(pulled.shown.mean()))).collect();
        force_map(&pulls).unwrap()
    };
    // What the file takes a count for is not what it is.
    let mut told = rig.clone();
    told.sensor.calibration[0][0] = config::Finite::new(1.2 * rig.sensor.calibration[0][0].get()).unwrap();
    told.sensor.calibration[1][1] = config::Finite::new(0.9 * rig.sensor.calibration[1][1].get()).unwrap();
    let found = map(&rig, &scene, &told);
    assert!((found.gains()[0] - 1.2).abs() < 2e-3 && (found.gains()[1] - 0.9).abs() < 2e-3, "{found:?}");
    assert!(found.turn_rad().abs() < 2e-3 && found.cross_talk() < 2e-3 && !found.is_mirrored(), "{found:?}");
    scene.defects = vec![Defect::new(DefectKind::SwappedSensorAxes).into()];
    assert!(map(&rig, &scene, &rig).is_mirrored());
}
