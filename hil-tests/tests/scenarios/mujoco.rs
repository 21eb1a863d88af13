//! The model that the study `plant` gives to MuJoCo is the arm that it gives to the rest.
//!
//! `hil-tests/run` fetches MuJoCo and runs this; alone:
//! `YIELDWALL_MUJOCO=$(hil-tests/peers/mujoco) cargo test -p hil-tests --test scenarios mujoco:: -- --ignored`

use nalgebra::Vector2;
use std::path::PathBuf;
use yieldwall::study::plant::{
    Effort, HOLD, Method, MujocoRun, Run, STUDY, Scene, Settings, Softness, lock, run_mujoco,
};

fn mujoco(scene: &Scene, integrator: &'static str, softness: Softness, step_s: f64) -> MujocoRun {
    let program = std::env::var_os("YIELDWALL_MUJOCO").map(PathBuf::from);
    let program = program.expect("YIELDWALL_MUJOCO names what hil-tests/peers/mujoco prints");
    let effort = Effort { warm: 10, repeats: 1 };
    run_mujoco(&program, Settings { integrator, softness }, scene, step_s, effort).unwrap()
}

fn tips(scene: &Scene, method: Method, step_s: f64) -> Vec<Vector2<f64>> {
    let mut run = Run::new(scene);
    run.run(method, step_s, scene.cycles).unwrap();
    run.tips()
}

fn greatest_distance(one: &[Vector2<f64>], other: &[Vector2<f64>]) -> f64 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

#[test]
#[ignore = "needs MuJoCo: hil-tests/run fetches it"]
fn fine_steps_of_mujoco_agree_with_the_reference() {
    let reference = tips(&STUDY, Method::Events, 1e-4);
    for softness in [Softness::Tuned, Softness::Hardest] {
        let found = mujoco(&STUDY, "RK4", softness, 2e-5);
        let gap_m = greatest_distance(&found.tips, &reference);
        assert!(gap_m < 2e-9, "{softness:?}: {gap_m} m");
        assert!(found.loop_gap_m < 1e-10 && found.on_core_s > 0.0, "{found:?}");
    }
    // What is set is what runs: soft constraints give way.
    let soft = mujoco(&STUDY, "RK4", Softness::Default, 1e-4);
    assert!(greatest_distance(&soft.tips, &reference) > 1e-4);
}

#[test]
#[ignore = "needs MuJoCo: hil-tests/run fetches it"]
fn pushes_and_torques_reach_mujoco() {
    let held = mujoco(&HOLD, "RK4", Softness::Hardest, 1e-3).tips;
    assert!(greatest_distance(&held[1000..], &vec![held[999]; 1000]) < 1e-12);
    let crept = mujoco(&HOLD, "RK4", Softness::Default, 1e-3).tips;
    assert!((1e-3..1e-2).contains(&(crept[1999] - crept[999]).norm()));
    // Until the links near their line, the motors' torques move both alike.
    let scene = Scene { cycles: 150, ..lock(1.0) };
    let gap_m =
        greatest_distance(&mujoco(&scene, "RK4", Softness::Hardest, 1e-4).tips, &tips(&scene, Method::Events, 1e-4));
    assert!(gap_m < 1e-7, "{gap_m} m");
}
