//! The virtual masses that `tune fixture` prints against runs of whole rigs without dry friction: a nudge dies away above the least mass and
//! not below.

use super::Bench;
use super::drawn_rig::Drawn;
use crate::drawn::{not_negative, positive, shipped};
use yieldwall_config as config;
use yieldwall_motion::control::Grip;
use yieldwall_rig::analysis::{hand_of, held_masses, stiffer};

/// Phases of the sensor's clock that are looked at.
const PHASES: u32 = 16;
/// By how much the least mass that is printed may be too light, and too heavy.
const TOO_LIGHT: f64 = 1.02;
const TOO_HEAVY: f64 = 1.15;

/// The rig with buses whose frames cost no time: no SYNC waits for another frame.
fn on_ideal_buses(rig: &config::Rig) -> config::Rig {
    let mut rig = rig.clone();
    rig.simulation.iter_mut().for_each(|simulation| simulation.timing = config::BusTiming::Ideal);
    rig
}

#[test]
fn a_request_may_come_as_early_as_its_shortest_frames_let_it() {
    // With the longest ones alone 1.31 kg were printed, and it swings up to 1.68 kg: which samples are missed jumps between.
    let Drawn { rig, scene, grip } = Drawn::of(1).unwrap();
    let printed = held_masses(&rig, &scene, &[grip], 1.0).unwrap().unwrap()[0].masses.unwrap();
    let mut bench = Bench::new(&rig, &scene, &grip, printed.least_at_m, PHASES);
    assert!(bench.is_stable(TOO_LIGHT * printed.least_kg).unwrap(), "{printed:?} is too light");
    assert!(!bench.is_stable(printed.least_kg / TOO_HEAVY).unwrap(), "{printed:?} is too heavy");
}

/// Masses of the handle and least masses, kg.
type MassesByHandle = &'static [(f64, f64)];

/// Paper's rigs with a heavier handle, and with a low pass or in position mode.
const HANDLES: [(&str, Option<f64>, MassesByHandle); 3] = [
    ("paper-admittance.yaml", None, &[(0.0, 0.585), (0.1, 0.748), (0.2, 0.915), (0.3, 1.083), (0.45, 1.336)]),
    ("paper-admittance.yaml", Some(40.0), &[(0.0, 0.232), (0.3, 0.434), (0.45, 0.533)]),
    ("paper-admittance-csp.yaml", None, &[(0.0, 0.180), (0.3, 0.495), (0.45, 0.652)]),
];

/// The rig and its hand, with a handle.
fn with_handle(name: &str, low_pass_hz: Option<f64>, handle_kg: f64) -> (config::Rig, config::Scene, Grip) {
    let (mut rig, scene) = shipped(name).unwrap();
    rig.sensor.handle_mass_kg = not_negative(handle_kg);
    rig.sensor.low_pass_hz = low_pass_hz.and_then(config::Positive::new);
    let grip = hand_of(&scene);
    (rig, scene, grip)
}

/// Computed by another program, event by event, with the handle on the sensor and its inertia taken out of the reading.
#[test]
fn a_heavy_handle_asks_for_more_mass() {
    for (name, low_pass_hz, known) in HANDLES {
        for &(handle_kg, exact_kg) in known {
            let (rig, scene, grip) = with_handle(name, low_pass_hz, handle_kg);
            let printed = held_masses(&rig, &scene, &[grip], 1.0).unwrap().unwrap()[0].masses.unwrap().least_kg;
            let ratio = printed / exact_kg;
            assert!((0.99..1.01).contains(&ratio), "{name}, {low_pass_hz:?}, {handle_kg} kg: {printed}");
        }
    }
}

#[test]
fn runs_with_a_heavy_handle_swing_below_what_is_printed_and_not_above() {
    for (name, low_pass_hz, _) in HANDLES {
        let (rig, scene, grip) = with_handle(name, low_pass_hz, 0.3);
        let rig = on_ideal_buses(&rig);
        let printed = held_masses(&rig, &scene, &[grip], 1.0).unwrap().unwrap()[0].masses.unwrap();
        let mut bench = Bench::new(&rig, &scene, &grip, printed.least_at_m, PHASES);
        assert!(bench.is_stable(TOO_LIGHT * printed.least_kg).unwrap(), "{name}: {printed:?} is too light");
        assert!(!bench.is_stable(printed.least_kg / 1.05).unwrap(), "{name}: {printed:?} is too heavy");
    }
}

/// Runs with a hand of 400 N/m and without dry friction: a mass that swings or was stopped, and one that came to rest.
const GEARS: [(&str, f64, [f64; 2]); 6] = [
    ("paper-admittance.yaml", 20_000.0, [2.0, 3.0]),
    ("paper-admittance.yaml", 8000.0, [0.62, 1.0]),
    ("paper-admittance.yaml", 3000.0, [0.0, 0.62]),
    ("paper-admittance-csp.yaml", 20_000.0, [0.55, 0.8]),
    ("paper-admittance-csp.yaml", 8000.0, [0.2, 0.4]),
    ("paper-admittance-csp.yaml", 3000.0, [0.0, 0.2]),
];

/// The rig, its scene with gears of this stiffness, and its hand.
fn with_gears(name: &str, stiffness_n_m_per_rad: f64) -> (config::Rig, config::Scene, Grip) {
    let (rig, mut scene) = shipped(name).unwrap();
    scene.model.as_mut().unwrap().joint_elasticity = Some(config::JointElasticity {
        stiffness_n_m_per_rad: positive(stiffness_n_m_per_rad),
        damping_n_m_s_per_rad: not_negative(10.0),
        motor_share: positive(0.9),
    });
    let grip = hand_of(&scene);
    (rig, scene, grip)
}

#[test]
fn elastic_gears_of_the_scene_count() {
    for (name, stiffness, [swings_kg, rests_kg]) in GEARS {
        let (rig, scene, grip) = with_gears(name, stiffness);
        let printed = held_masses(&rig, &scene, &[grip], 1.0).unwrap().unwrap()[0].masses.unwrap().least_kg;
        assert!(printed > swings_kg && printed < rests_kg, "{name}, {stiffness} N m/rad: {printed}");
    }
}

#[test]
fn runs_with_elastic_gears_swing_below_what_is_printed_and_not_above() {
    for (name, stiffness, _) in GEARS {
        let (rig, scene, grip) = with_gears(name, stiffness);
        let rig = on_ideal_buses(&rig);
        let printed = held_masses(&rig, &scene, &[grip], 1.0).unwrap().unwrap()[0].masses.unwrap();
        let mut bench = Bench::new(&rig, &scene, &grip, printed.least_at_m, PHASES);
        assert!(bench.is_stable(1.03 * printed.least_kg).unwrap(), "{name}: {printed:?} is too light");
        assert!(!bench.is_stable(printed.least_kg / 1.05).unwrap(), "{name}: {printed:?} is too heavy");
    }
}

/// Masses that are tried where none is printed, kg.
const NONE_KG: [f64; 6] = [0.03, 0.2, 1.0, 5.0, 30.0, 200.0];

#[test]
fn runs_of_drawn_rigs_swing_below_what_is_printed_and_not_above() {
    for number in crate::sample::share(0..60, 3) {
        let Drawn { rig, scene, grip } = Drawn::of(number).unwrap();
        let rig = on_ideal_buses(&rig);
        let Some(printed) = held_masses(&rig, &scene, &[grip], 1.0).unwrap().unwrap()[0].masses else {
            let mut bench = Bench::new(&rig, &scene, &grip, [0.0, -0.12], PHASES);
            assert!(
                NONE_KG.into_iter().all(|mass_kg| !bench.is_stable(mass_kg).unwrap()),
                "{number}: a mass is stable"
            );
            continue;
        };
        let mut bench = Bench::new(&rig, &scene, &grip, printed.least_at_m, PHASES);
        assert!(bench.is_stable(TOO_LIGHT * printed.least_kg).unwrap(), "{number}: {printed:?} is too light");
        assert!(!bench.is_stable(printed.least_kg / TOO_HEAVY).unwrap(), "{number}: {printed:?} is too heavy");
    }
}

#[test]
fn a_stiff_hand_drifts_above_the_greatest_printed_mass_and_not_below() {
    let (rig, scene) = shipped("paper-admittance.yaml").unwrap();
    let (rig, grip) = (on_ideal_buses(&rig), stiffer(&hand_of(&scene), 8000.0));
    let printed = held_masses(&rig, &scene, &[grip], 1.0).unwrap().unwrap()[0].masses.unwrap();
    let mut bench = Bench::new(&rig, &scene, &grip, printed.greatest_at_m, PHASES);
    assert!(bench.is_stable(printed.greatest_kg / TOO_HEAVY).unwrap(), "{printed:?} is too great");
    assert!(!bench.is_stable(printed.greatest_kg * TOO_HEAVY).unwrap(), "{printed:?} is too small");
}

/// At some phases a frame of the sensor is on the bus when SYNC is due, and the drives sample and act late.
#[test]
fn frames_of_a_streaming_sensor_make_a_rig_without_friction_swing_at_every_mass() {
    let (rig, scene) = shipped("paper-admittance-streaming.yaml").unwrap();
    let grip = stiffer(&hand_of(&scene), 500.0);
    let printed = held_masses(&rig, &scene, &[grip], 1.0).unwrap().unwrap()[0].masses.unwrap();
    let mut bench = Bench::new(&rig, &scene, &grip, printed.least_at_m, PHASES);
    for factor in [TOO_LIGHT, 3.0, 10.0] {
        assert!(!bench.is_stable(factor * printed.least_kg).unwrap(), "{factor} times the printed mass is stable");
    }
    let mut bench = Bench::new(&on_ideal_buses(&rig), &scene, &grip, printed.least_at_m, PHASES);
    assert!(bench.is_stable(TOO_LIGHT * printed.least_kg).unwrap(), "unstable without time of frames");
}
