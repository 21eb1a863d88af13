//! The age of the force, and the mass of the handle, as they are identified on the embedded simulation.

use std::sync::atomic::AtomicBool;

use super::tune_loop_tests::{AT_1_KHZ, at_4_khz, on_ethercat, rig};
use super::*;
use crate::analysis::{believed_age_s, later_s};
use crate::sample::share;
use yieldwall_config::injection::{Defect, DefectKind};
use yieldwall_motion::identification::NotIdentified;
use yieldwall_run::{ForceFound, JointLoop, LoopPlan};

/// Identifies a joint with these defects. Also returns the root mean square of the force in the cycles meanwhile, N.
fn found(loaded: &config::Loaded<config::Rig>, joint: usize, seed: u64, defects: &[Defect]) -> (JointLoop, f64) {
    let (rig, mut scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    scene.defects = defects.iter().map(|defect| (*defect).into()).collect();
    let step_us = &mut scene.model.as_mut().unwrap().plant_step_us;
    *step_us = if rig.cycle.period_us.is_multiple_of(*step_us) { *step_us } else { 50 };
    let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, seed).unwrap();
    let sums = std::sync::Arc::new(std::sync::Mutex::new([0.0, 0.0]));
    let seen = std::sync::Arc::clone(&sums);
    machine.set_observer(Box::new(move |record| {
        let mut sums = seen.lock().unwrap();
        (sums[0], sums[1]) = (sums[0] + record.signals.force.0.norm_squared(), sums[1] + 1.0);
    }));
    let plan = LoopPlan { joint, torque_n_m: None };
    let traced = machine.tune_loop(&rig, &plan, &AtomicBool::new(false)).unwrap().unwrap();
    let [squares, count] = *sums.lock().unwrap();
    let found = traced.found.unwrap_or_else(|| panic!("{:?} {:?}", traced.ended, traced.cause));
    (found, (squares / count).sqrt())
}

fn weight(kg: f64) -> Defect {
    Defect::new(DefectKind::HeavyHandle).sized(kg).unwrap()
}

fn slow(ms: f64) -> Defect {
    Defect::new(DefectKind::SlowSensor).sized(ms).unwrap()
}

fn with_sensor(rate_hz: u32) -> config::Loaded<config::Rig> {
    rig(&format!("{AT_1_KHZ}sensor: {{sample_rate_hz: {rate_hz}}}\n"))
}

/// On CAN and on EtherCAT, with a sensor that SYNC clocks and with clocks of their own.
fn rigs() -> [(&'static str, config::Loaded<config::Rig>); 5] {
    let streaming = config::load_rig(config::builtin("paper-admittance-streaming.yaml")).unwrap();
    [
        ("CAN, 1 kHz", rig(AT_1_KHZ)),
        ("CAN, 1 kHz, sensor at 500 Hz", with_sensor(500)),
        ("CAN, 1 kHz, streaming", streaming),
        ("EtherCAT, 1 kHz", rig(&on_ethercat("usual", "{}", "{period_us: 1000, compute_at_us: 480}"))),
        ("EtherCAT, 4 kHz", at_4_khz()),
    ]
}

#[test]
fn the_age_of_a_force_behind_a_low_pass_is_identified_on_each_bus() {
    for (name, loaded) in share(rigs(), 2) {
        let period_s = f64::from(loaded.value.cycle.period_us) * 1e-6;
        let [least, most] = believed_age_s(&loaded.value).unwrap();
        for (joint, seed, lag_ms) in [(0, 1, 2.0), (1, 2, 2.0), (0, 3, 4.0)] {
            let (found, _) = found(&loaded, joint, seed, &[weight(0.3), slow(lag_ms)]);
            let handle = found.handle.unwrap_or_else(|error| panic!("{name}: {error}"));
            let [low, high] = [least, most].map(|age| age + 1e-3 * lag_ms);
            eprintln!(
                "{name} {joint} {lag_ms} ms: {:.1} us beside the middle of {:.1} to {:.1} us +- {:.1} us, from {:.0} to {:.0} us, low pass {:.2} ms, {:.4} +- \
                 {:.4} kg, misfit {:.3}",
                1e6 * (handle.age_s.value - 0.5 * (low + high)),
                1e6 * low,
                1e6 * high,
                1e6 * handle.age_s.half_width(),
                1e6 * handle.between_s[0],
                1e6 * handle.between_s[1],
                1e3 * handle.lag_s,
                handle.mass_kg.value,
                handle.mass_kg.half_width(),
                handle.misfit
            );
            // A sensor that samples right behind an edge of the torque is seen older by all that the hold hides.
            let (beyond_s, [least_s, most_s]) = (0.02 * period_s, handle.between_s);
            assert!(most_s > low - beyond_s && least_s < high + beyond_s, "{name} {joint} {lag_ms} ms: {handle:?}");
            assert!((handle.mass_kg.value / 0.3 - 1.0).abs() < 0.1, "{name}: {:?}", handle.mass_kg);
            let force = ForceFound { between_s: handle.between_s, mass_kg: handle.mass_kg.value };
            let later_s = later_s(&loaded.value, &force).unwrap();
            assert!(later_s > 1e-3 * lag_ms - 50e-6, "{name}: {later_s}");
            assert!(later_s < 1e-3 * lag_ms + period_s + (most - least), "{name}: {later_s}");
        }
    }
}

#[test]
fn a_sensor_as_the_file_has_it_contradicts_nothing_at_any_seed() {
    for (name, loaded) in share(rigs(), 2) {
        for (joint, seed) in [(0, 4), (1, 5)] {
            let (found, _) = found(&loaded, joint, seed, &[weight(0.3)]);
            let handle = found.handle.unwrap_or_else(|error| panic!("{name}: {error}"));
            eprintln!("{name} {joint}: {handle:?}, believed {:?}", believed_age_s(&loaded.value));
            let force = ForceFound { between_s: handle.between_s, mass_kg: handle.mass_kg.value };
            assert_eq!(later_s(&loaded.value, &force).unwrap(), 0.0, "{name} {joint}: {handle:?}");
            assert!((handle.mass_kg.value / 0.3 - 1.0).abs() < 0.1, "{name}: {:?}", handle.mass_kg);
        }
    }
}

#[test]
fn the_simulated_sensor_carries_the_handle_that_the_file_has_and_the_cycle_takes_it_out() {
    let known = rig(&format!("{AT_1_KHZ}sensor: {{handle_mass_kg: 0.3}}\n"));
    let (of_known, taken_out_n) = found(&known, 0, 1, &[]);
    let handle = of_known.handle.unwrap();
    assert!((handle.mass_kg.value / 0.3 - 1.0).abs() < 0.1, "{handle:?}");
    let unknown = rig(AT_1_KHZ);
    let (of_unknown, whole_n) = found(&unknown, 0, 1, &[weight(0.3)]);
    eprintln!("{taken_out_n} N of {whole_n} N are left");
    // What is taken out is as the reference goes, and in step with the angles, while the force is felt half a cycle before.
    assert!(taken_out_n < 0.7 * whole_n, "{taken_out_n} N of {whole_n} N");
    // The handle of the file is a part of its tool; what hangs there beside it is heavier.
    let inertia = |found: &JointLoop| found.dynamics.as_ref().unwrap().inertia_kg_m2.value;
    let (bare, nothing_n) = found(&unknown, 0, 1, &[]);
    assert!((inertia(&of_known) / inertia(&bare) - 1.0).abs() < 0.01, "{:?}", of_known.dynamics);
    assert!(inertia(&of_unknown) > 1.04 * inertia(&bare), "{:?}", of_unknown.dynamics);
    assert!(nothing_n < 0.1, "{nothing_n} N with nothing beyond the sensor");
    let Err(NotIdentified::NoHandle { up_to_kg, .. }) = bare.handle else { panic!("{:?}", bare.handle) };
    assert!(up_to_kg < 5e-3, "{up_to_kg}");
}

#[test]
fn where_the_drive_closes_the_loop_the_age_is_identified_too() {
    for mode in ["csp", "csv"] {
        let loaded = config::load_rig(config::builtin(format!("paper-admittance-{mode}.yaml"))).unwrap();
        let (found, _) = found(&loaded, 1, 7, &[weight(0.3), slow(2.0)]);
        let handle = found.handle.unwrap();
        eprintln!("{mode}: {handle:?}");
        assert!((handle.age_s.value - 2e-3).abs() < 100e-6, "{mode}: {handle:?}");
    }
}
