//! The simulated arm against the arm of this study.

use nalgebra::Vector2;
use proptest::prelude::*;
use std::f64::consts::TAU;
use yieldwall_motion::elementary;

use super::{Events, Plant, STUDY_ARM, StudyArm};
use yieldwall_motion::linkage::MassModel;
use yieldwall_motion::quantity::{JointAngles, JointRates, JointTorques, TipPoint};
use yieldwall_sim::arm::{Arm, ArmError, ArmParameters, JointElasticity};
use yieldwall_sim::hand::HandLoad;

fn parameters(arm: &StudyArm) -> ArmParameters {
    arm.parameters().unwrap()
}

fn arm_at(parameters: &ArmParameters, tip: Vector2<f64>) -> Arm {
    let start = parameters.linkage.inverse(TipPoint(tip)).unwrap();
    Arm::new(parameters, start).unwrap()
}

fn no_load(_: f64, _: TipPoint) -> HandLoad<2> {
    HandLoad::default()
}

fn push(force_n: Vector2<f64>) -> impl Fn(f64, TipPoint) -> HandLoad<2> {
    move |_, _| HandLoad { force_n, ..HandLoad::default() }
}

fn greatest_distance(one: &[Vector2<f64>], other: &[Vector2<f64>]) -> f64 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

/// A push exceeds the holding torque of the joints for less than a step of the ground truth, which then stays at rest. If the two
/// disagree, refine the ground truth before you blame the arm.
#[test]
fn a_grazing_break_away_is_seen_where_a_coarse_ground_truth_misses_it() {
    let force = |time_s: f64| Vector2::new((63.5 - 20.0 * elementary::powi((time_s - 3.5e-3) / 1e-3, 2)).max(0.0), 0.0);
    let start = STUDY_ARM.inverse(Vector2::new(0.0, 0.36));
    let oracle = |step_s: f64| {
        let mut oracle = Events::new(STUDY_ARM, start, |time_s: f64, _: Vector2<f64>| HandLoad {
            force_n: force(time_s),
            ..HandLoad::default()
        });
        oracle.run_to(0.01, step_s, Vector2::zeros()).unwrap();
        oracle.angles()
    };
    let mut arm = Arm::new(&parameters(&STUDY_ARM), JointAngles(start)).unwrap();
    let load = |time_s: f64, _: TipPoint| HandLoad { force_n: force(time_s), ..HandLoad::default() };
    arm.advance_to(0.01, 1e-6, JointTorques::new(0.0, 0.0), load).unwrap();
    let (coarse, fine) = (oracle(1e-3), oracle(1e-5));
    let moved_rad = (fine - start).norm();
    assert_eq!(coarse, start, "missed");
    assert!(moved_rad > 1e-9, "{moved_rad}");
    assert!((arm.angles().0 - fine).norm() < 0.01 * moved_rad, "{} of {moved_rad}", (arm.angles().0 - fine).norm());
}

#[test]
fn what_sticks_does_not_creep() {
    for step_s in [1e-3, 1e-4] {
        let mut arm = arm_at(&parameters(&STUDY_ARM), Vector2::new(0.03, 0.33));
        let start = arm.angles();
        arm.advance_to(2.0, step_s, JointTorques::new(0.0, 0.0), push(Vector2::new(20.0, 0.0))).unwrap();
        assert_eq!(arm.angles(), start);
        assert_eq!(arm.rates(), JointRates::default());
        assert_eq!(arm.tip().unwrap().acceleration_m_per_s2, [0.0; 2]);
    }
}

#[test]
fn the_arm_breaks_away_where_statics_says() {
    let place = Vector2::new(0.0, 0.36);
    let jacobian = STUDY_ARM.motion(STUDY_ARM.inverse(place), Vector2::zeros()).jacobian;
    // Both joints are loaded alike by a sideways force here.
    let break_away_n = STUDY_ARM.coulomb_n_m / jacobian.m11.abs();
    assert!((break_away_n - 62.6).abs() < 0.1, "{break_away_n}");
    for (share, moves) in [(0.9999, false), (1.0001, true)] {
        let mut arm = arm_at(&parameters(&STUDY_ARM), place);
        let start = arm.angles();
        let force_n = Vector2::new(share * break_away_n, 0.0);
        arm.advance_to(0.01, 1e-4, JointTorques::new(0.0, 0.0), push(force_n)).unwrap();
        assert_eq!(arm.angles() != start, moves);
    }
}

#[test]
fn locking_distal_links_stop_the_arm_with_a_name() {
    // Distal links so short that the motors, pushing outward, can stretch them.
    let short = StudyArm { distal_m: 0.25, ..STUDY_ARM };
    for step_s in [1e-3, 1e-4] {
        for (sign, kind) in [(1.0, "outward"), (-1.0, "inward")] {
            let mut arm = arm_at(&parameters(&short), Vector2::new(0.0, 0.36));
            let torques = JointTorques::new(14.0 * sign, -14.0 * sign);
            let mut fastest_m_per_s = 0.0f64;
            let error = loop {
                assert!(arm.time_s() < 5.0, "{kind}: never stopped");
                if let Err(error) = arm.advance(step_s, torques, no_load) {
                    break error;
                }
                match arm.tip() {
                    Ok(tip) => fastest_m_per_s = fastest_m_per_s.max(tip.velocity.norm()),
                    Err(error) => break error,
                }
            };
            let named = matches!(error, ArmError::NearSingularity { .. } | ArmError::Linkage { .. });
            assert!(named, "{kind}: {error}");
            assert!(fastest_m_per_s < 3.0, "{kind}: {fastest_m_per_s} m/s");
            assert!(arm.angles().is_finite() && arm.rates().is_finite());
        }
    }
}

#[test]
fn an_error_leaves_the_state_alone() {
    let parameters = parameters(&STUDY_ARM);
    let elasticity = JointElasticity { stiffness_n_m_per_rad: 2e4, damping_n_m_s_per_rad: 5.0, motor_share: 0.6 };
    for joint_elasticity in [None, Some(elasticity)] {
        let mut arm = arm_at(&ArmParameters { joint_elasticity, ..parameters }, Vector2::new(0.0, 0.36));
        arm.set_rates(JointRates::new(0.3, -0.2));
        let before = (arm.time_s(), arm.angles(), arm.rates(), arm.motor_angles(), arm.motor_rates());
        let at_rest = JointTorques::new(0.0, 0.0);
        for bad in [f64::NAN, f64::INFINITY] {
            let error = arm.advance(1e-4, JointTorques::new(bad, 0.0), no_load).unwrap_err();
            assert!(matches!(error, ArmError::NotFinite { .. }), "{error}");
            let error = arm.advance(1e-4, at_rest, push(Vector2::new(0.0, bad))).unwrap_err();
            assert!(matches!(error, ArmError::NotFinite { .. }), "{error}");
            assert!(matches!(arm.advance(bad, at_rest, no_load), Err(ArmError::BadStep { .. })));
            assert!(matches!(arm.advance_to(bad, 1e-4, at_rest, no_load), Err(ArmError::BadStep { .. })));
        }
        assert!(matches!(arm.advance(0.0, at_rest, no_load), Err(ArmError::BadStep { .. })));
        assert!(matches!(arm.advance_to(1.0, -1.0, at_rest, no_load), Err(ArmError::BadStep { .. })));
        assert_eq!(before, (arm.time_s(), arm.angles(), arm.rates(), arm.motor_angles(), arm.motor_rates()));
    }
}

#[test]
fn bad_parameters_are_refused() {
    let good = parameters(&STUDY_ARM);
    let start = good.linkage.inverse(TipPoint::new(0.0, 0.36)).unwrap();
    let elasticity = JointElasticity { stiffness_n_m_per_rad: 2e4, damping_n_m_s_per_rad: 5.0, motor_share: 0.6 };
    let with = |elasticity| ArmParameters { joint_elasticity: Some(elasticity), ..good };
    for bad in [
        ArmParameters { coulomb_n_m: [10.0, -1.0], ..good },
        ArmParameters { viscous_n_m_s_per_rad: [f64::NAN, 1.0], ..good },
        ArmParameters { handle_kg: -0.5, ..good },
        with(JointElasticity { motor_share: 1.0, ..elasticity }),
        with(JointElasticity { motor_share: f64::NAN, ..elasticity }),
        with(JointElasticity { stiffness_n_m_per_rad: -1.0, ..elasticity }),
        with(JointElasticity { damping_n_m_s_per_rad: f64::INFINITY, ..elasticity }),
    ] {
        assert!(matches!(Arm::new(&bad, start), Err(ArmError::BadParameter { .. })), "{bad:?}");
    }
    let massless = ArmParameters { mass: MassModel { motor_kg_m2: [0.0; 2], ..good.mass }, ..good };
    assert!(matches!(Arm::new(&massless, start), Err(ArmError::BadMass(_))));
    let apart = JointAngles::new(std::f64::consts::PI, 0.0);
    assert!(matches!(Arm::new(&good, apart), Err(ArmError::Linkage { .. })));
}

#[test]
fn time_is_met_exactly_and_runs_repeat() {
    let run = || {
        let mut arm = arm_at(&parameters(&STUDY_ARM), Vector2::new(0.0, 0.36));
        for end_s in [0.0013, 0.1, 0.1, 0.05, 0.10003] {
            let due_s = f64::max(end_s, arm.time_s());
            arm.advance_to(end_s, 1e-4, JointTorques::new(14.0, 12.0), no_load).unwrap();
            assert_eq!(arm.time_s(), due_s);
        }
        (arm.angles(), arm.rates())
    };
    assert_eq!(run(), run());
}

fn elastic(stiffness_n_m_per_rad: f64, damping_n_m_s_per_rad: f64, arm: &StudyArm) -> ArmParameters {
    let elasticity = JointElasticity { stiffness_n_m_per_rad, damping_n_m_s_per_rad, motor_share: 0.6 };
    ArmParameters { joint_elasticity: Some(elasticity), ..parameters(arm) }
}

/// Motion under a slowly turning push, in steps of 0.1 ms or shorter.
fn pushed_about(parameters: &ArmParameters, step_s: f64) -> Vec<Vector2<f64>> {
    let mut arm = arm_at(parameters, Vector2::new(0.05, 0.36));
    let load = |time_s: f64, _: TipPoint| {
        let (sin, cos) = elementary::sin_cos(TAU * 2.0 * time_s);
        HandLoad { force_n: Vector2::new(100.0 * sin, 100.0 * cos), damping_n_s_per_m: 5.0, stiffness_n_per_m: 0.0 }
    };
    (1..=400)
        .map(|ms| {
            arm.advance_to(f64::from(ms) * 1e-3, step_s, JointTorques::new(0.0, 0.0), load).unwrap();
            arm.tip().unwrap().position.0
        })
        .collect()
}

#[test]
fn very_stiff_elastic_joints_are_rigid_joints() {
    let rigid = pushed_about(&parameters(&STUDY_ARM), 1e-4);
    assert!(rigid.iter().any(|tip| (tip - rigid[0]).norm() > 0.02), "it moves");
    let soft_m = greatest_distance(&pushed_about(&elastic(2e4, 5.0, &STUDY_ARM), 1e-4), &rigid);
    let stiff_m = greatest_distance(&pushed_about(&elastic(2e7, 5e3, &STUDY_ARM), 1e-4), &rigid);
    // The difference is the springs' compliance, a thousandth of the other's.
    assert!(soft_m > 1e-4 && (800.0..1200.0).contains(&(soft_m / stiff_m)), "{soft_m} m, {stiff_m} m");
}

#[test]
fn elastic_steps_converge_with_the_square_of_the_step() {
    let parameters = elastic(2e4, 5.0, &StudyArm { coulomb_n_m: 0.0, ..STUDY_ARM });
    let fine = pushed_about(&parameters, 1e-5);
    let coarse_m = greatest_distance(&pushed_about(&parameters, 5e-4), &fine);
    let half_m = greatest_distance(&pushed_about(&parameters, 2.5e-4), &fine);
    assert!((3.5..4.5).contains(&(coarse_m / half_m)), "{}", coarse_m / half_m);
}

#[test]
fn a_held_motor_lets_its_link_swing() {
    // With more friction than the push can beat, the links swing on their springs about the held motors.
    let mut arm = arm_at(&elastic(2e4, 0.0, &STUDY_ARM), Vector2::new(0.0, 0.36));
    let (motors, links) = (arm.motor_angles(), arm.angles());
    arm.advance_to(0.1, 1e-4, JointTorques::new(0.0, 0.0), push(Vector2::new(20.0, 0.0))).unwrap();
    assert_eq!(arm.motor_angles(), motors);
    assert_eq!(arm.motor_rates(), JointRates::default());
    assert!((arm.angles() - links).norm() > 1e-5);
}

#[test]
fn an_elastic_arm_without_friction_keeps_its_energy() {
    let free = StudyArm { coulomb_n_m: 0.0, viscous_n_m_s_per_rad: 0.0, ..STUDY_ARM };
    let drift = |step_s: f64| {
        let mut arm = arm_at(&elastic(2e4, 0.0, &free), Vector2::new(0.0, 0.36));
        arm.advance_to(0.01, step_s, JointTorques::new(0.0, 0.0), push(Vector2::new(100.0, 30.0))).unwrap();
        let before = arm.energy_j().unwrap();
        arm.advance_to(0.3, step_s, JointTorques::new(0.0, 0.0), no_load).unwrap();
        (arm.energy_j().unwrap() / before - 1.0).abs()
    };
    assert!(drift(1e-4) < 1e-3, "{}", drift(1e-4));
    assert!(drift(1e-5) < 1e-5, "{}", drift(1e-5));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn the_ground_truth_has_the_equations_of_motion_of_the_linkage(
        place in (-0.12..0.12, 0.25..0.45), rates in (-3.0..3.0, -3.0..3.0),
    ) {
        let parameters = parameters(&STUDY_ARM);
        let angles = STUDY_ARM.inverse(Vector2::new(place.0, place.1));
        let rates = Vector2::new(rates.0, rates.1);
        let expected = STUDY_ARM.motion(angles, rates);
        let found =
            parameters.linkage.dynamics(&parameters.mass, JointAngles(angles), JointRates(rates)).unwrap();
        prop_assert!((found.tip.0 - expected.tip).norm() < 1e-13);
        prop_assert!((found.jacobian - expected.jacobian).norm() < 1e-12);
        prop_assert!((found.mass - expected.mass).norm() < 1e-12);
        prop_assert!((found.bias.0 - expected.bias).norm() < 1e-11);
    }

    /// Without motors and hand, friction takes energy at every step until the arm rests for good.
    #[test]
    fn energy_only_falls(
        place in (-0.08..0.08, 0.3..0.42), rates in (-2.0..2.0, -2.0..2.0), is_elastic in any::<bool>(),
        step_s in prop_oneof![Just(1e-3), Just(1e-4)],
    ) {
        let parameters = if is_elastic { elastic(2e4, 5.0, &STUDY_ARM) } else { parameters(&STUDY_ARM) };
        let mut arm = arm_at(&parameters, Vector2::new(place.0, place.1));
        arm.set_rates(JointRates::new(rates.0, rates.1));
        let mut before = arm.energy_j().unwrap();
        for _ in 0..200 {
            arm.advance(step_s, JointTorques::new(0.0, 0.0), no_load).unwrap();
            let now = arm.energy_j().unwrap();
            prop_assert!(now <= before * (1.0 + 1e-12), "{} after {}", now, before);
            before = now;
        }
        if !is_elastic && step_s == 1e-3 {
            prop_assert_eq!(arm.rates(), JointRates::default());
        }
    }

    #[test]
    fn without_friction_energy_is_kept_to_the_order_of_the_step(
        place in (-0.05..0.05, 0.32..0.40), rates in (-1.0..1.0, -1.0..1.0),
    ) {
        let free = StudyArm { coulomb_n_m: 0.0, viscous_n_m_s_per_rad: 0.0, ..STUDY_ARM };
        let mut arm = arm_at(&parameters(&free), Vector2::new(place.0, place.1));
        arm.set_rates(JointRates::new(rates.0, rates.1));
        let before = arm.energy_j().unwrap();
        arm.advance_to(0.05, 1e-4, JointTorques::new(0.0, 0.0), no_load).unwrap();
        prop_assert!((arm.energy_j().unwrap() - before).abs() <= 1e-6 * before);
    }
}
