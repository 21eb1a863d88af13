//! Joints that are moved on the embedded simulation.

use std::sync::atomic::AtomicBool;

use super::*;
use proptest::prelude::*;
use yieldwall_config::injection::{Kind, Target};
use yieldwall_motion::cycle::LeadLimits;
use yieldwall_motion::quantity::JointAngles;
use yieldwall_run::{Bounds, Ended, Jog, Jogged, Key, Keys};

const TORQUE_N_M: f64 = 15.0;

fn jog(by: [f64; 2], rate: f64) -> Jog<'static> {
    let limits = LeadLimits { rate_rad_per_s: rate, acceleration_rad_per_s2: 5.0 * rate };
    Jog { by: JointAngles::from(by), keys: None, limits, settling: 20, is_metered: false }
}

/// Returns the outcome of a jog with an injection, and with a check in every cycle.
fn jogged(
    file: &str,
    jog: &Jog<'_>,
    injections: &[Injection],
    mut look: impl FnMut(&CycleRecord) + Send + 'static,
) -> Result<(Jogged, [cia402::State; 2]), RunError> {
    let loaded = config::load_rig(config::builtin(file)).unwrap();
    let (rig, scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
    machine.set_injections(injections).unwrap();
    machine.set_observer(Box::new(move |record| look(record)));
    let positive = |value| config::Positive::new(value).unwrap();
    let way = jog.by.to_array().into_iter().fold(0.0_f64, |most, by| most.max(by.abs()));
    let bounds = Bounds { motion_rad: positive(way + 0.02), torque_n_m: positive(TORQUE_N_M) };
    let jogged = machine.jog(&rig, jog, bounds, &AtomicBool::new(false), |_| ()).unwrap();
    jogged.map(|jogged| (jogged, machine.drive_states()))
}

const RIGS: [&str; 6] = [
    "paper-admittance.yaml",
    "paper-admittance-cartesian.yaml",
    "paper-admittance-csv.yaml",
    "paper-admittance-csp.yaml",
    "paper-ethercat.yaml",
    "paper-ethercat-can-sensor.yaml",
];

#[test]
fn a_joint_goes_by_its_angle_and_the_other_one_holds_in_every_mode_and_on_every_bus() {
    for file in RIGS {
        let (end, states) = jogged(file, &jog([0.08, 0.0], 0.2), &[], |_| ()).unwrap();
        assert_eq!((end.ended, end.state, end.cause), (Ended::Whole, State::Running, None), "{file}");
        let [left, right] = (end.to - end.from).to_array();
        assert!((left - 0.08).abs() < 1e-3 && right.abs() < 1e-3, "{file}: {left} {right}");
        assert!(!states.contains(&cia402::State::OperationEnabled), "{file}: {states:?}");
    }
}

#[test]
fn a_fault_at_either_drive_stops_both_and_nothing_goes_on_by_itself() {
    for file in ["paper-admittance.yaml", "paper-ethercat.yaml"] {
        for target in [Target::LeftDrive, Target::RightDrive] {
            for kind in [Kind::DriveFault, Kind::DriveLeavesOperation] {
                let broken = Injection::new(kind, 0.8).on(target);
                let (end, states) = jogged(file, &jog([0.2, 0.0], 0.2), &[broken], |_| ()).unwrap();
                assert_eq!(end.ended, Ended::Stopped, "{file} {kind:?} {target:?}");
                assert!(end.state.is_latched() || end.state == State::Stopping, "{:?}", end.state);
                assert!(!states.contains(&cia402::State::OperationEnabled), "{file} {kind:?}: {states:?}");
                assert!((end.to - end.from).left() < 0.19, "{file} {kind:?}: it went on");
            }
        }
    }
}

#[test]
fn a_way_that_the_linkage_does_not_go_is_refused_before_anything_is_enabled() {
    for by in [[1.8, 0.0], [-1.8, 0.0], [0.0, 1.8], [0.0, -1.8]] {
        let enabled = std::sync::Arc::new(AtomicBool::new(false));
        let seen = std::sync::Arc::clone(&enabled);
        let end = jogged("paper-admittance.yaml", &jog(by, 0.2), &[], move |record| {
            let is_on = record.inputs.drives.iter().any(|drive| drive.state == cia402::State::OperationEnabled);
            seen.fetch_or(is_on, std::sync::atomic::Ordering::Relaxed);
        });
        let Err(RunError::WayBlocked { share }) = end else { panic!("{by:?}: {end:?}") };
        assert!(share > 0.1 && share < 1.0, "{by:?}: {share}");
        assert!(!enabled.load(std::sync::atomic::Ordering::Relaxed));
    }
}

#[test]
fn after_a_jog_the_fixture_has_the_tool_again() {
    let loaded = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap();
    let (rig, scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
    let positive = |value| config::Positive::new(value).unwrap();
    let bounds = Bounds { motion_rad: positive(0.1), torque_n_m: positive(TORQUE_N_M) };
    let end = machine.jog(&rig, &jog([0.05, 0.0], 0.2), bounds, &AtomicBool::new(false), |_| ()).unwrap().unwrap();
    assert_eq!(end.ended, Ended::Whole);
    machine.restart().unwrap();
    let start_m = machine.run_cycle(Request::None).unwrap().tool_m;
    let mut farthest = 0.0_f64;
    for _ in 0..2000 {
        let row = machine.run_cycle(Request::None).unwrap();
        farthest = farthest.max((row.tool_m[0] - start_m[0]).abs()).max((row.tool_m[1] - start_m[1]).abs());
    }
    assert!(farthest > 0.01, "the hand leads it: {farthest}");
}

/// Returns the outcome for a joint that keys guide by up to 0.1 rad to either side: `pressed` receives the time of each record and
/// returns the key.
fn led_by_keys(mut pressed: impl FnMut(f64) -> Option<Key> + Send + 'static) -> (Jogged, Vec<[f64; 2]>) {
    use std::sync::{Arc, Mutex};
    let (keys, ways) = (Arc::<Keys>::default(), Arc::<Mutex<Vec<[f64; 2]>>>::default());
    let (told, seen) = (Arc::clone(&keys), Arc::clone(&ways));
    let with_keys = Jog { keys: Some(&keys), ..jog([0.1, 0.0], 0.2) };
    let (end, states) = jogged("paper-admittance.yaml", &with_keys, &[], move |record| {
        if record.directive.state == State::Running {
            let row = record.row();
            seen.lock().unwrap().push([row.time_s, row.target_angles_rad[0]]);
            pressed(row.time_s).into_iter().for_each(|key| told.press(key));
        }
    })
    .unwrap();
    assert!(!states.contains(&cia402::State::OperationEnabled), "{states:?}");
    let ways = ways.lock().unwrap().clone();
    (end, ways)
}

#[test]
fn a_joint_rests_soon_after_the_last_key_and_keys_lead_it_back() {
    let (end, ways) = led_by_keys(|time_s| match time_s {
        0.5..0.8 => Some(Key::Forward),
        1.8..2.0 => Some(Key::Backward),
        3.0.. => Some(Key::End),
        _ => None,
    });
    assert_eq!((end.ended, end.state), (Ended::Whole, State::Running));
    let at = |wanted_s: f64| ways.iter().find(|[time_s, _]| *time_s >= wanted_s).unwrap()[1] - ways[0][1];
    assert_eq!(at(0.49), 0.0);
    // 0.3 s with keys, 0.2 s in which the last one holds, and 0.2 s of ramp.
    assert!((at(1.25) - 0.2 * 0.5).abs() < 2e-3, "{}", at(1.25));
    assert!(at(0.95) < at(1.0) && at(1.25) == at(1.79), "{} {}", at(1.25), at(1.79));
    assert!((at(2.9) - at(1.79) + 0.2 * 0.4).abs() < 2e-3, "{} {}", at(2.9), at(1.79));
}

#[test]
fn keys_lead_no_joint_beyond_its_way_and_the_end_is_heard_while_they_come() {
    let (end, ways) = led_by_keys(|time_s| Some(if time_s > 2.0 { Key::End } else { Key::Forward }));
    assert_eq!(end.ended, Ended::Whole);
    let farthest = ways.iter().map(|[_, angle]| angle - ways[0][1]).fold(0.0, f64::max);
    assert!((farthest - 0.1).abs() < 1e-9, "{farthest}");
    let (end, ways) = led_by_keys(|time_s| Some(if time_s > 0.3 { Key::End } else { Key::Forward }));
    let farthest = ways.iter().map(|[_, angle]| angle - ways[0][1]).fold(0.0, f64::max);
    assert!(end.ended == Ended::Whole && farthest < 0.09, "{farthest}");
    assert!(ways.last().unwrap()[0] < 1.2, "it ends when the joint has rested");
}

/// How far beyond its way a joint goes by the truth of the tool, rad.
struct Went {
    linkage: yieldwall_motion::linkage::FiveBar,
    start: Option<JointAngles>,
    beyond_rad: std::sync::Arc<std::sync::Mutex<f64>>,
}

impl Went {
    fn new(file: &str) -> (Self, std::sync::Arc<std::sync::Mutex<f64>>) {
        let linkage =
            yieldwall_run::assembly::linkage(&config::load_rig(config::builtin(file)).unwrap().value).unwrap();
        let beyond_rad = std::sync::Arc::default();
        (Self { linkage, start: None, beyond_rad: std::sync::Arc::clone(&beyond_rad) }, beyond_rad)
    }

    fn look(&mut self, record: &CycleRecord, by: [f64; 2]) {
        let Some(angles) = record.truth.and_then(|truth| self.linkage.inverse(truth.tool).ok()) else { return };
        let gone = (angles - *self.start.get_or_insert(angles)).to_array();
        let beyond = |joint: usize| (gone[joint] - by[joint].max(0.0)).max(by[joint].min(0.0) - gone[joint]);
        let mut most = self.beyond_rad.lock().unwrap();
        *most = most.max(beyond(0)).max(beyond(1));
    }
}

/// Just short of its target a joint is near enough to be no following error, and is pushed on while it is to rest.
#[test]
fn an_encoder_that_stands_still_at_any_moment_leads_no_joint_away() {
    let by = [0.07, 0.0];
    for file in ["paper-admittance.yaml", "paper-admittance-csv.yaml", "paper-admittance-csp.yaml"] {
        for at in 0..60 {
            let at_s = 0.02 * f64::from(at);
            let stuck = Injection::new(Kind::EncoderStuck, at_s).on(Target::LeftDrive).lasting(Some(0.5));
            let (mut went, beyond) = Went::new(file);
            let end = jogged(file, &jog(by, 0.1), &[stuck], move |record| went.look(record, by));
            let beyond = *beyond.lock().unwrap();
            assert!(beyond < 0.05, "{file} at {at_s}: {beyond} {end:?}");
        }
    }
}

/// `YIELDWALL_JOGS=500` tries more.
fn cases() -> u32 {
    std::env::var("YIELDWALL_JOGS").ok().and_then(|text| text.parse().ok()).unwrap_or(24)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), ..ProptestConfig::default() })]
    /// Whatever is broken on the way: no joint is led beyond its way or goes far beyond it, and no torque above the limit is asked for.
    #[test]
    fn no_joint_leaves_its_bounds(
        left in -0.3..0.3f64, right in -0.3..0.3f64, rate in 0.05..0.5f64, rig in 0usize..6,
        kind in prop::sample::select(vec![
            Kind::DriveFault, Kind::DriveLeavesOperation, Kind::VoltageOff, Kind::EncoderStuck, Kind::Emergency, Kind::NodeReset,
            Kind::ArmBlocked, Kind::SensorInvalid,
        ]),
        at_s in 0.0..1.5f64, for_s in 0.01..0.5f64,
    ) {
        let targets = kind.row().targets;
        let target = if targets.contains(&Target::LeftDrive) { Target::LeftDrive } else { targets[0] };
        let broken = Injection::new(kind, at_s).on(target).lasting(Some(for_s));
        let broken = if broken.check().is_ok() { broken } else { broken.lasting(None) };
        let start = std::sync::Mutex::new(None::<[f64; 2]>);
        let by = [left, right];
        let beyond = std::sync::Arc::new(std::sync::Mutex::new([0.0_f64; 2]));
        let farthest = std::sync::Arc::clone(&beyond);
        let (mut went, by_truth) = Went::new(RIGS[rig]);
        let end = jogged(RIGS[rig], &jog(by, rate), &[broken], move |record| {
            let now = record.row().target_angles_rad;
            let mut start = start.lock().unwrap();
            went.look(record, by);
            if record.directive.state != State::Running && record.directive.state != State::Stopping {
                return;
            }
            let start = start.get_or_insert(now);
            let mut farthest = farthest.lock().unwrap();
            for joint in 0..2 {
                let way = now[joint] - start[joint];
                let (low, high) = (by[joint].min(0.0), by[joint].max(0.0));
                farthest[joint] = farthest[joint].max(way - high).max(low - way);
            }
        });
        let [left_beyond, right_beyond] = *beyond.lock().unwrap();
        // A ramp of the tool is a straight line: the joint that holds moves a little with it.
        prop_assert!(left_beyond < 0.02 && right_beyond < 0.02, "{} {:?}: {left_beyond} {right_beyond}", RIGS[rig], end);
        let went = *by_truth.lock().unwrap();
        prop_assert!(went < 0.05, "{} {broken:?} {end:?}: {went}", RIGS[rig]);
        // By the drives themselves: one that is not heard any more may be told to be still moving.
        if let Ok((_, states)) = end {
            prop_assert!(!states.contains(&cia402::State::OperationEnabled), "{states:?}");
        }
    }
}
