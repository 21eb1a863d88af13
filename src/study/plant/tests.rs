use nalgebra::Vector2;
use std::path::Path;

use super::*;

fn tips(scene: &Scene, method: Method, step_s: f64) -> Vec<Vector2<f64>> {
    let mut run = Run::new(scene);
    run.run(method, step_s, scene.cycles).unwrap();
    run.tips()
}

fn greatest_distance(one: &[Vector2<f64>], other: &[Vector2<f64>]) -> f64 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

fn error_m(method: Method, step_s: f64, reference: &[Vector2<f64>]) -> f64 {
    greatest_distance(&tips(&STUDY, method, step_s), reference)
}

#[test]
fn fine_steps_agree_with_the_reference() {
    let reference = tips(&STUDY, Method::Events, 0.25e-3);
    let gap_m = error_m(Method::Midpoint, 1e-5, &reference);
    assert!(gap_m < 1e-10, "{gap_m} m");
    let gap_m = error_m(Method::Events, 1e-4, &reference);
    assert!(gap_m < 1e-11, "{gap_m} m");
    // A step of use: 3.6 nm.
    let gap_m = error_m(Method::Midpoint, 1e-4, &reference);
    assert!(gap_m < 5e-9, "{gap_m} m");
}

#[test]
fn the_reference_meets_all_events_of_the_scene() {
    let mut arm = Events::new(STUDY.arm, STUDY.start(), |time_s, tip| STUDY.load(time_s, tip));
    for (cycle, aim) in STUDY.plan().iter().enumerate() {
        let torque = STUDY.torque(aim, arm.angles(), arm.rates());
        arm.run_to((cycle + 1) as f64 * CYCLE_S, CYCLE_S, torque).unwrap();
    }
    assert_eq!(arm.count(), 11);
}

#[test]
fn errors_fall_with_the_order_of_the_method() {
    let reference = tips(&STUDY, Method::Events, 0.25e-3);
    for (method, step_s, ratios) in [
        (Method::Midpoint, 1e-3, 3.0..4.2),
        (Method::Midpoint, 1e-4, 3.0..5.0),
        (Method::SemiImplicit, 1e-3, 1.8..2.2),
        (Method::SemiImplicit, 1e-4, 1.8..2.2),
    ] {
        let coarse_m = error_m(method, step_s, &reference);
        let fine_m = error_m(method, 0.5 * step_s, &reference);
        assert!(ratios.contains(&(coarse_m / fine_m)), "{method}, {step_s} s: {coarse_m} m, {fine_m} m");
    }
    // Smooth friction is another model: no step fixes it.
    let smooth = Method::Smooth { scale_rad_per_s: 0.01 };
    let (coarse_m, fine_m) = (error_m(smooth, 2.5e-4, &reference), error_m(smooth, 5e-5, &reference));
    assert!(coarse_m > 4e-5 && (coarse_m / fine_m - 1.0).abs() < 0.02, "{coarse_m} m, {fine_m} m");
}

#[test]
fn what_is_held_keeps_its_angle_to_the_last_bit() {
    for method in [Method::SemiImplicit, Method::Midpoint, Method::Events] {
        for step_s in [1e-3, 1e-4] {
            let mut run = Run::new(&HOLD);
            run.run(method, step_s, HOLD.cycles).unwrap();
            assert!(run.angles.iter().all(|&angles| angles == HOLD.start()), "{method}, {step_s} s");
        }
    }
    // The push is felt: what only resists motion creeps under it.
    let mut run = Run::new(&HOLD);
    run.run(Method::Smooth { scale_rad_per_s: 0.01 }, 1e-3, HOLD.cycles).unwrap();
    let crept_m = greatest_distance(&run.tips()[1000..], &vec![run.tips()[999]; 1000]);
    assert!((1e-3..2e-3).contains(&crept_m), "{crept_m} m");
}

#[test]
fn a_stiff_hand_is_followed_too() {
    for (n_per_m, limit_m) in [(5e3, 1e-10), (5e4, 1e-10), (1e6, 5e-7)] {
        let scene = stiff(Spring { n_per_m, n_s_per_m: 15.0 });
        let reference = tips(&scene, Method::Events, 1e-4);
        let gap_m = greatest_distance(&tips(&scene, Method::Midpoint, 1e-5), &reference);
        assert!(gap_m < limit_m, "{n_per_m} N/m: {gap_m} m");
    }
}

#[test]
fn a_program_that_cannot_be_run_is_named() {
    let settings = Settings { integrator: "RK4", softness: Softness::Default };
    let effort = Effort { warm: 0, repeats: 1 };
    let error = run_mujoco(Path::new("no-such-program"), settings, &HOLD, 1e-3, effort).unwrap_err();
    assert!(error.starts_with("no-such-program: "), "{error}");
}
