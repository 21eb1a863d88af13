//! The guard's energy bound on whole rigs. Energy from a moving mass or a moving wall is no fault; energy from an oscillating loop
//! is one.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use serde_json::json;
use yieldwall_run::Observer;

/// A rig of the program and its scene, to be changed.
fn pair(file: &str) -> (config::Rig, config::Scene) {
    let source = config::builtin(file);
    let rig = config::load_rig(source).unwrap();
    let scene = rig.scene().unwrap().value;
    (rig.value, scene)
}

fn set<T: serde::de::DeserializeOwned>(place: &mut T, value: serde_json::Value) {
    *place = serde_json::from_value(value).unwrap();
}

/// The run, and in how many cycles the guard held the rig because of `energy-limit`.
fn run(rig: &config::Rig, scene: &config::Scene) -> (RunReport, usize) {
    let held = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&held);
    let observer: Observer = Box::new(move |record| {
        let is_held = record.directive.state == State::Holding;
        if is_held && record.cause.is_some_and(|cause| cause.fault == Fault::EnergyLimit) {
            count.fetch_add(1, Ordering::Relaxed);
        }
    });
    let watch = Watch { observer: Some(observer), ..Watch::default() };
    let report = run_rig(rig, scene, &Overrides::default(), watch, |_| ControlFlow::Continue(())).unwrap();
    (report, held.load(Ordering::Relaxed))
}

fn fastest_m_per_s(report: &RunReport) -> f64 {
    let speed = |row: &Row| row.tool_velocity_m_per_s.iter().map(|value| value * value).sum::<f64>().sqrt();
    report.trace.rows.iter().map(speed).fold(0.0, f64::max)
}

/// A hand that throws 2 kg by 100 mm and stops it gets back what the mass held, without friction nearly all of it.
#[test]
fn a_free_move_of_the_hand_is_no_energy_limit() {
    for (file, friction_n) in [("paper-admittance.yaml", 0.0), ("paper-admittance-csp.yaml", 3.0)] {
        let (mut rig, mut scene) = pair(file);
        rig.fixture.friction_n = serde_json::from_value(json!(friction_n)).unwrap();
        scene.hand.start_m = serde_json::from_value(json!([-0.05, 0.0])).unwrap();
        set(&mut scene.hand.stiffness_n_per_m, json!(2500.0));
        set(&mut scene.hand.damping_n_s_per_m, json!(90.0));
        set(&mut scene.hand.voluntary_force_limit_n, json!(null));
        set(
            &mut scene.hand.path,
            json!([{ "wait": { "for_s": 0.3 } }, { "to": { "point_m": [0.05, 0.0], "in_s": 0.21 } }, { "wait": { "for_s": 0.5 } }]),
        );
        set(&mut scene.duration_s, json!(1.0));
        let (report, held) = run(&rig, &scene);
        let speed = fastest_m_per_s(&report);
        assert!(speed > 0.75, "{file}: 2 kg at {speed} m/s hold more than 0.5 J");
        let rise_j = report.measures.energy_rise_j;
        assert!(rise_j > *rig.guard.energy_limit_j, "{file}: the hand gets {rise_j} J of it in one go");
        assert_eq!((report.state, report.cause, held), (Some(State::Running), None, 0), "{file}");
        assert!(report.measures.is_within_bound(), "{file}: {:?}", report.measures);
    }
}

/// A wall that comes pushes a hand away that yields, with up to 20 N over 50 mm: that is the wall's work.
#[test]
fn a_hand_that_yields_to_a_wall_is_no_energy_limit() {
    for speed_m_per_s in [0.05, 0.25] {
        let (mut rig, mut scene) = pair("moving-walls.yaml");
        let amplitude_m = 0.05;
        let swing_s = std::f64::consts::PI * amplitude_m / speed_m_per_s;
        rig.fixture.also.clear();
        rig.fixture.motion =
            serde_json::from_value(json!({ "amplitude_m": [amplitude_m, 0.0], "swing_s": swing_s })).unwrap();
        scene.hand.start_m = serde_json::from_value(json!([-0.04, 0.0])).unwrap();
        // It presses with 17 N in the beginning, and with all the way of the wall by 2 N more.
        set(&mut scene.hand.stiffness_n_per_m, json!(40.0));
        set(
            &mut scene.hand.path,
            json!([{ "to": { "point_m": [-0.39, 0.0], "in_s": 0.3 } }, { "wait": { "for_s": 0.1 } }]),
        );
        set(&mut scene.duration_s, json!(0.4 + swing_s));
        let (report, held) = run(&rig, &scene);
        let given_j = report.measures.energy_rise_j;
        assert!(given_j > *rig.guard.energy_limit_j, "{speed_m_per_s} m/s: the wall gives {given_j} J");
        assert_eq!((report.state, report.cause, held), (Some(State::Running), None, 0), "{speed_m_per_s} m/s");
        assert!(report.measures.is_within_bound(), "{speed_m_per_s} m/s: {:?}", report.measures);
    }
}

/// A virtual mass far below the least one in a stiff hand: the loop feeds the hand until its force is at its limit, and on.
#[test]
fn a_rig_that_swings_is_an_energy_limit() {
    let (mut rig, mut scene) = pair("paper-admittance.yaml");
    set(&mut rig.fixture.coupling, json!({ "admittance": { "mass_kg": 0.1 } }));
    set(&mut scene.hand.stiffness_n_per_m, json!(1500.0));
    // At 40 N the hand takes some 0.3 J each second; the scenes of a rig that does not swing give 0.01 J at most.
    set(&mut rig.guard.energy_limit_j, json!(0.1));
    // What the torque limit cuts off is not in the balance.
    rig.guard.residual_limit_n_m = None;
    let least_kg =
        crate::analysis::held_masses(&rig, &scene, &[crate::analysis::hand_of(&scene)], 0.1).unwrap().unwrap()[0]
            .masses
            .map(|masses| masses.least_kg);
    assert!(least_kg.is_some_and(|least_kg| least_kg > 0.2), "{least_kg:?}");
    set(&mut scene.duration_s, json!(6.0));
    let (report, held) = run(&rig, &scene);
    assert!(held > 0, "{:?} {:?} {:?}", report.state, report.cause, report.measures);
    assert!(!report.measures.is_within_bound(), "{:?}", report.measures);
}
