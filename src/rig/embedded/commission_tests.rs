//! Machines that are commissioned on the embedded simulation: healthy ones, and such with a defect.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use super::*;
use crate::sample::{self, share};
use proptest::prelude::*;
use yieldwall_config::injection::{DEFECTS, Defect, DefectKind, DefectRow, FoundBy, Kind, Target};
use yieldwall_drives::profiles::{EncoderKind, Role, SetPointWatch};
use yieldwall_motion::quantity::JointAngles;
use yieldwall_run::bringup;
use yieldwall_run::commission::{Begin, Commissioned, STEPS, Step, StepReport, Verdict};

const RIGS: [&str; 5] = [
    "paper-admittance.yaml",
    "paper-admittance-csv.yaml",
    "paper-admittance-csp.yaml",
    "paper-ethercat.yaml",
    "paper-ethercat-can-sensor.yaml",
];

/// Outcome of a commissioning, and the state of the machine afterwards.
struct Done {
    commissioned: Commissioned,
    states: [cia402::State; 2],
    /// The torque limits of the drives on CAN, per mille.
    limits: Vec<i64>,
    /// How far each link went from where it was first enabled in a step at most, rad.
    farthest_rad: f64,
}

fn commissioned(file: &str, defects: &[Defect], injections: &[Injection]) -> Done {
    until(file, defects, injections, u64::MAX)
}

/// Commissions with a person who asks for the end after so many cycles.
fn until(file: &str, defects: &[Defect], injections: &[Injection], cycles: u64) -> Done {
    let loaded = config::load_rig(config::builtin(file)).unwrap();
    let (rig, mut scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    scene.defects = defects.iter().map(|defect| (*defect).into()).collect();
    let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
    machine.set_injections(injections).unwrap();
    let farthest = Arc::new(Mutex::new(0.0_f64));
    let seen = Arc::clone(&farthest);
    // By the truth of the tool, from the moment at which a drive says that it is enabled until one says so again.
    let linkage = yieldwall_run::assembly::linkage(&rig).unwrap();
    let (mut start, mut was_on, mut count) = (JointAngles::default(), None, 0);
    let is_interrupted = Arc::new(AtomicBool::new(false));
    let asks = Arc::clone(&is_interrupted);
    machine.set_observer(Box::new(move |record| {
        count += 1;
        asks.fetch_or(count > cycles, Ordering::Relaxed);
        let is_on = record.inputs.drives.iter().any(|drive| drive.state == cia402::State::OperationEnabled);
        let Some(angles) = record.truth.and_then(|truth| linkage.inverse(truth.tool).ok()) else { return };
        if is_on && was_on != Some(true) {
            (start, was_on) = (angles, Some(true));
        }
        was_on = was_on.map(|_| is_on);
        if was_on.is_some() {
            let mut farthest = seen.lock().unwrap();
            *farthest = farthest.max((angles - start).max_abs());
        }
    }));
    let commissioned = machine.commission(&rig, Step::Communication.into(), &is_interrupted, |_| ()).unwrap();
    let limits = machine.drives().iter().map(|drive| drive.torque_limit_per_mille().into()).collect();
    let farthest_rad = *farthest.lock().unwrap();
    Done { commissioned, states: machine.drive_states(), limits, farthest_rad }
}

/// The farthest that any step lets a joint go, rad.
fn bound_rad() -> f64 {
    STEPS.into_iter().filter_map(Step::motion_bound_rad).fold(0.0, f64::max)
}

#[test]
fn a_healthy_machine_passes_every_step_in_every_mode_and_on_every_bus() {
    // The fixture of the last but one moves the handle by itself where nobody holds it. The encoders of the last one begin anew with each boot.
    for file in share(RIGS.into_iter().chain(["circle-elastic.yaml", "paper-incremental.yaml"]), 3) {
        let done = commissioned(file, &[], &[]);
        let steps = done.commissioned.steps;
        let beside: Vec<_> = steps
            .iter()
            .filter(|step| step.verdict != Verdict::Pass)
            .map(|step| (step.step, &step.figure, &step.reason, &step.evidence))
            .collect();
        assert!(beside.is_empty(), "{file}: {beside:#?}");
        assert!(steps.iter().map(|step| step.step).eq(STEPS));
        assert!(!done.states.contains(&cia402::State::OperationEnabled), "{file}");
        assert!(done.limits.iter().all(|limit| *limit == 1000), "{file}: {:?}", done.limits);
        assert!(done.farthest_rad < bound_rad(), "{file}: {}", done.farthest_rad);
    }
}

/// Drives with a limit of the current, and drives without any object of a limit.
#[test]
fn drives_without_6072h_pass_every_step() {
    for profile in ["maxon-epos4", "zeroerr-edriver"] {
        let loaded = config::load_rig(config::builtin("paper-admittance-csp.yaml")).unwrap();
        let (mut rig, scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
        for drive in &mut rig.drives {
            let mut shipped = (**config::ProfileName::from(profile.to_owned()).get().unwrap()).clone();
            let Role::Servo(servo) = &mut shipped.device else { unreachable!() };
            // A simulated drive does not act for a time that nobody knows.
            servo.watchdogs.set_points = SetPointWatch::None;
            drive.profile.set(shipped, None);
            drive.encoder = Some(EncoderKind::MultiTurn);
        }
        let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
        let done = machine.commission(&rig, Step::Communication.into(), &AtomicBool::new(false), |_| ()).unwrap();
        assert_eq!(done.verdict(), Verdict::Pass, "{profile}: {:#?}", done.steps);
        assert!(!machine.drive_states().into_iter().any(cia402::State::has_torque), "{profile}");
        assert!(machine.drives().iter().all(|drive| drive.torque_limit_per_mille() == 1000), "{profile}");
    }
}

#[test]
fn what_drives_say_of_a_watchdog_that_was_tried_is_no_part_of_a_later_step() {
    let loaded = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap();
    let scene = loaded.scene().unwrap().value;
    let mut machine = EmbeddedRig::new(&loaded.value, &scene, &loaded.value.fixture, scene.seed).unwrap();
    machine.boot().unwrap();
    bringup::drill(&mut machine.runner, 20, &AtomicBool::new(false), |_| ()).unwrap();
    assert!(!machine.master().networks().told().is_empty());
    machine.commission(&loaded.value, Step::Admittance.into(), &AtomicBool::new(false), |_| ()).unwrap();
    assert_eq!(machine.master().networks().told(), []);
}

/// The pull at the tool in the step `motor` is no zero of the sensor.
#[test]
fn a_machine_that_is_tared_passes_every_step() {
    let mut loaded = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap();
    loaded.value.sensor.tare_up_to_n = config::Positive::new(5.0);
    let scene = loaded.scene().unwrap().value;
    let mut machine = EmbeddedRig::new(&loaded.value, &scene, &loaded.value.fixture, scene.seed).unwrap();
    let done = machine.commission(&loaded.value, Step::Motor.into(), &AtomicBool::new(false), |_| ()).unwrap();
    assert_eq!(done.verdict(), Verdict::Pass, "{:#?}", done.steps);
}

/// The report of the step in which the handle is left alone, of a rig and a scene that were changed.
fn left_alone(file: &str, change: impl Fn(&mut config::Rig, &mut config::Scene)) -> StepReport {
    let loaded = config::load_rig(config::builtin(file)).unwrap();
    let (mut rig, mut scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    change(&mut rig, &mut scene);
    let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
    let mut done = machine.commission(&rig, Step::Admittance.into(), &AtomicBool::new(false), |_| ()).unwrap();
    assert!(!machine.drive_states().into_iter().any(cia402::State::has_torque));
    assert!(machine.drives().iter().all(|drive| drive.torque_limit_per_mille() == 1000), "{:?}", done.steps);
    done.steps.pop().unwrap()
}

/// Dry friction would hold its joints, and it does not rest when it is enabled: there is cogging.
#[test]
fn a_loop_that_oscillates_by_itself_fails() {
    let report = left_alone("paper-admittance.yaml", |rig, scene| {
        let none = config::NotNegative::new(0.0).unwrap();
        let config::ControlGains::Joint { stiffness_n_m_per_rad: stiffness, damping_n_m_s_per_rad: damping, .. } =
            &mut rig.control.gains
        else {
            unreachable!()
        };
        *stiffness = config::Positive::new(4.0 * stiffness.get()).unwrap();
        *damping = config::NotNegative::new(4.0 * damping.get()).unwrap();
        rig.control.feed_forward.coulomb_n_m = [none; 2];
        rig.simulation.as_mut().unwrap().arm.coulomb_n_m = [none; 2];
        scene.defects = vec![Defect::new(DefectKind::Cogging).sized(3.0).unwrap().into()];
    });
    let told = format!("{:?} {:?} {:?}", report.verdict, report.reason, report.evidence);
    assert!(report.verdict == Verdict::Fail && told.contains("oscillates by"), "{told}");
}

#[test]
fn a_wrong_zero_that_is_tared_is_none() {
    let biased = |rig: &mut config::Rig, scene: &mut config::Scene, tare_up_to_n: Option<f64>| {
        scene.defects = vec![Defect::new(DefectKind::BiasedSensor).sized(5.0).unwrap().into()];
        rig.sensor.tare_up_to_n = tare_up_to_n.and_then(config::Positive::new);
    };
    let report = left_alone("paper-admittance.yaml", |rig, scene| biased(rig, scene, Some(6.0)));
    assert_eq!(report.verdict, Verdict::Pass, "{report:?}");
    let report = left_alone("paper-admittance.yaml", |rig, scene| biased(rig, scene, None));
    assert!(report.reason.as_ref().unwrap().contains("its zero is wrong"), "{report:?}");
}

#[test]
fn surfaces_that_move_take_the_tool_along_and_are_no_failure() {
    let report = left_alone("moving-walls.yaml", |_, _| ());
    assert_eq!(report.verdict, Verdict::Skipped, "{report:?}");
    assert!(report.reason.as_ref().unwrap().contains("`fixture.motion`"), "{report:?}");
}

/// Whether a machine with this defect fails at the step that has to find it, and at none before.
fn is_found(file: &str, defect: Defect) -> Result<(), String> {
    let row = defect.kind.row();
    let done = commissioned(file, &[defect], &[]);
    let steps = done.commissioned.steps;
    let failed = steps.iter().find(|step| step.verdict == Verdict::Fail);
    let told = failed.map(|step| (step.step, &step.figure, &step.reason, &step.evidence));
    let told = format!("{file}, {defect:?}: {told:#?}");
    let is_at = failed.is_some_and(|step| FoundBy::Step(step.step.name()) == row.found_by && step.reason.is_some());
    let is_off = !done.states.contains(&cia402::State::OperationEnabled);
    let is_within = done.farthest_rad < bound_rad();
    let are_kept = done.limits.iter().all(|limit| *limit == 1000);
    if is_at && is_off && is_within && are_kept {
        Ok(())
    } else {
        Err(format!("{told} {is_off} {is_within} {are_kept} {}", done.farthest_rad))
    }
}

/// The defects that a step has to find.
fn found_by_steps() -> impl Iterator<Item = &'static DefectRow> {
    DEFECTS.iter().filter(|row| matches!(row.found_by, FoundBy::Step(_)))
}

#[test]
fn every_defect_is_found_by_its_step_at_either_drive_and_on_either_bus() {
    let mut cases = Vec::new();
    for row in found_by_steps() {
        assert!(Step::named(row.found_by.name()).is_some(), "{}", row.name);
        for (drive, file) in
            [(0, "paper-admittance.yaml"), (1, "paper-ethercat.yaml"), (1, "paper-admittance-csp.yaml")]
        {
            if row.kind != DefectKind::HeartbeatConsumerOff || file != "paper-ethercat.yaml" {
                cases.push((file, Defect::new(row.kind).at(drive)));
            }
        }
    }
    let missed = share(cases, 12).into_iter().filter_map(|(file, defect)| is_found(file, defect).err());
    let missed: Vec<String> = missed.collect();
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}

/// `YIELDWALL_COMMISSIONINGS=500` tries more.
fn cases() -> u32 {
    std::env::var("YIELDWALL_COMMISSIONINGS").ok().and_then(|text| text.parse().ok()).unwrap_or(sample::cases(16))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), ..ProptestConfig::default() })]

    #[test]
    fn a_defect_of_any_size_is_found(kind in 0..found_by_steps().count(), share in 0.0..=1.0f64, drive in 0usize..2, rig in 0usize..5) {
        let row = found_by_steps().nth(kind).unwrap();
        let is_on_ethercat = RIGS[rig].starts_with("paper-ethercat");
        prop_assume!(!(row.kind == DefectKind::HeartbeatConsumerOff && is_on_ethercat));
        let defect = Defect::new(row.kind).at(drive);
        let size = row.size.map(|size| size.least + share * (size.most - size.least));
        let defect = size.map_or(defect, |size| defect.sized(size).unwrap());
        if let Err(told) = is_found(RIGS[rig], defect) {
            prop_assert!(false, "{}", told);
        }
    }

    /// Whenever a person asks for the end: no torque, no lowered limit, and a report that names the remaining steps.
    #[test]
    fn it_ends_when_it_is_asked_to(rig in 0usize..5, cycles in 0..60_000u64) {
        let done = until(RIGS[rig], &[], &[], cycles);
        let Commissioned { steps, interrupted_in, .. } = done.commissioned;
        prop_assert!(steps.iter().map(|step| step.step).eq(STEPS) && steps.iter().all(|step| step.verdict != Verdict::Fail), "{steps:?}");
        let passed = steps.iter().take_while(|step| step.verdict == Verdict::Pass).count();
        prop_assert!(steps[passed..].iter().all(|step| step.verdict == Verdict::Skipped && step.reason.is_some()), "{steps:?}");
        prop_assert_eq!(interrupted_in, STEPS.get(passed).copied());
        prop_assert!(!done.states.contains(&cia402::State::OperationEnabled), "{:?}", done.states);
        prop_assert!(done.limits.iter().all(|limit| *limit == 1000), "{:?}", done.limits);
        prop_assert!(done.farthest_rad < bound_rad(), "{}", done.farthest_rad);
    }

    /// Whatever breaks on the way: no joint leaves the bound, and no drive is left with torque or with a lowered limit.
    #[test]
    fn whatever_breaks_nothing_goes_too_far(
        rig in 0usize..5, at_s in 0.0..110.0f64, for_s in 0.01..0.5f64, defect in prop::option::of(0..DEFECTS.len()),
        kind in prop::sample::select(vec![
            Kind::DriveFault, Kind::DriveLeavesOperation, Kind::VoltageOff, Kind::EncoderStuck, Kind::Emergency, Kind::NodeReset,
            Kind::ArmBlocked, Kind::SensorInvalid,
        ]),
    ) {
        let targets = kind.row().targets;
        let target = if targets.contains(&Target::LeftDrive) { Target::LeftDrive } else { targets[0] };
        let broken = Injection::new(kind, at_s).on(target).lasting(Some(for_s));
        let broken = if broken.check().is_ok() { broken } else { broken.lasting(None) };
        let is_on_ethercat = RIGS[rig].starts_with("paper-ethercat");
        let defect = defect.map(|at| Defect::new(DEFECTS[at].kind));
        let defect = defect.filter(|defect| !(defect.kind == DefectKind::HeartbeatConsumerOff && is_on_ethercat));
        let done = commissioned(RIGS[rig], &defect.into_iter().collect::<Vec<_>>(), &[broken]);
        prop_assert!(done.farthest_rad < bound_rad(), "{} {broken:?} {defect:?}: {}", RIGS[rig], done.farthest_rad);
        prop_assert!(!done.states.contains(&cia402::State::OperationEnabled), "{:?}", done.states);
        prop_assert!(done.limits.iter().all(|limit| *limit == 1000), "{broken:?} {defect:?}: {:?}", done.limits);
    }
}

/// A resumed commissioning has the same drives, or nothing moves.
#[test]
fn a_commissioning_goes_on_with_the_same_drives_alone() {
    let loaded = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap();
    let (rig, scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    let commissioned = |begin| {
        let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
        machine.commission(&rig, begin, &AtomicBool::new(false), |_| ()).unwrap()
    };
    let verdict = |done: &Commissioned, step: Step| done.steps.iter().find(|it| it.step == step).map(|it| it.verdict);
    let first = commissioned(Begin::from(Step::Communication));
    let again = commissioned(Begin { from: Step::Friction, drives: first.drives });
    let verdicts =
        [Step::Communication, Step::Identity, Step::Limits, Step::Friction].map(|step| verdict(&again, step));
    use Verdict::{Fail, Pass, Skipped};
    assert_eq!(verdicts, [Skipped, Pass, Skipped, Pass].map(Some), "{again:?}");
    let mut others = first.drives.unwrap();
    others[1].serial_number += 1;
    let other = commissioned(Begin { from: Step::Friction, drives: Some(others) });
    let reason = other.steps.iter().find_map(|step| step.reason.clone().filter(|_| step.verdict == Fail)).unwrap();
    assert!(reason.starts_with("right is not the drive of the report"), "{reason}");
    assert_eq!([Step::Identity, Step::Friction].map(|step| verdict(&other, step)), [Some(Fail), Some(Skipped)]);
}
