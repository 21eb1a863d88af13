use super::*;
use crate::elementary;
use crate::quantity::{Force, JointRates, TipVelocity};
use nalgebra::Matrix2;
use std::f64::consts::{PI, TAU};

#[test]
fn paper_scene_has_the_angles_and_jacobians_of_a_computation_with_60_digits() {
    let arm = five_bar(PAPER);
    let cases = [
        (
            [0.0, 0.0],
            [2.3816712437684187, 0.7599214098213746],
            [0.6539820459530609, 2.4876106076367326],
            [-0.18667465880098383, -0.18667465880098383, -0.24353946104695853, 0.24353946104695853],
        ),
        (
            [0.1, 0.06],
            [1.9923908474585332, 0.6703264468602498],
            [0.631891146593003, 2.1990270087659654],
            [-0.2373748102484661, -0.17704574459697697, -0.17243103608545174, 0.24186073984897213],
        ),
        (
            [-0.08, 0.12],
            [2.2644358684003407, 1.2349515361878958],
            [1.0127794342543275, 2.342245886210049],
            [-0.2103048343111892, -0.23443487237149577, -0.2045182560109608, 0.14633198806607634],
        ),
    ];
    for (tip, angles, distal_angles, [j11, j12, j21, j22]) in cases {
        let found = arm.inverse(TipPoint::from(tip)).unwrap();
        assert!(gap(found.to_array(), angles) < 1e-14, "{found:?}");
        let posture = arm.forward(found).unwrap();
        assert!(gap(posture.tip.to_array(), tip) < 1e-15);
        assert!(gap(posture.wrist_m, tip) < 1e-15);
        assert!(gap(posture.distal_rotation.map(|link| link.angle()), distal_angles) < 1e-14);
        assert!((posture.jacobian - Matrix2::new(j11, j12, j21, j22)).amax() < 1e-14);
        assert_eq!(posture.elbow_sides, PAPER.elbows);
    }
    let elbows = arm.forward(arm.inverse(point(0.0, 0.0)).unwrap()).unwrap().elbows_m;
    assert!(gap(elbows[0], [-0.3174670452885505, -0.2433406566025443]) < 1e-15);
    assert!(gap(elbows[1], [0.3174670452885505, -0.2433406566025443]) < 1e-15);
}

#[test]
fn skew_scene_with_a_tool_offset_has_the_points_of_a_computation_with_60_digits() {
    let posture = five_bar(SKEW).forward(JointAngles::new(2.1, 0.9)).unwrap();
    assert!(gap(posture.tip.to_array(), [0.16432247625371055, 0.47353166907216787]) < 1e-15);
    assert!(gap(posture.wrist_m, [0.09248855822943203, 0.4672159568177002]) < 1e-15);
    assert!(gap(posture.distal_rotation.map(|link| link.angle()), [0.6756981348427331, 2.261398657553596]) < 1e-14);
    let jacobian = Matrix2::new(-0.18998675287661546, -0.1948494683932443, -0.16536276445398246, 0.2955035437630428);
    assert!((posture.jacobian - jacobian).amax() < 1e-14);
}

/// Smallest singular values along the axis of symmetry, from an independent study of this arm.
#[test]
fn desk_scene_loses_its_smallest_singular_value_towards_both_singularities() {
    let arm = five_bar(DESK);
    let reach = (elementary::powi(0.55, 2) - elementary::powi(0.05, 2)).sqrt();
    let cases = [
        (0.36, 0.226, 5e-4),
        (0.05, 0.032, 5e-4),
        (0.001, 6.5e-4, 5e-6),
        (reach - 0.1, 0.21, 5e-3),
        (reach - 0.01, 0.068, 5e-4),
        (reach - 0.001, 0.022, 5e-4),
    ];
    for (y, expected, tolerance) in cases {
        let posture = arm.forward(arm.inverse(point(0.0, y)).unwrap()).unwrap();
        let found = posture.smallest_singular_value();
        assert!((found - expected).abs() < tolerance, "at {y} m: {found}");
    }
}

#[test]
fn every_working_mode_has_one_answer_and_it_belongs_to_one_assembly_mode() {
    let sides = [Side::Left, Side::Right];
    for tool in [
        WRIST_TOOL,
        Tool { fixed_to: Chain::Left, along_m: 0.05, across_m: 0.03 },
        Tool { fixed_to: Chain::Right, along_m: -0.07, across_m: -0.06 },
    ] {
        let mut answers = Vec::new();
        for (left, right) in sides.into_iter().flat_map(|left| sides.map(|right| (left, right))) {
            let mut assemblies = 0;
            for wrist in [WristSide::Forward, WristSide::Backward] {
                let arm = five_bar(Geometry { elbows: [left, right], wrist, tool, ..PAPER });
                match arm.inverse(point(0.03, 0.02)) {
                    Ok(angles) => {
                        let posture = arm.forward(angles).unwrap();
                        assert!(gap(posture.tip.to_array(), [0.03, 0.02]) < 1e-15);
                        assert_eq!(posture.elbow_sides, [left, right]);
                        answers.push(angles.to_array());
                        assemblies += 1;
                    }
                    Err(LinkageError::OtherAssembly { wrist_offset_m }) => {
                        assert!(wrist_offset_m * wrist.sign() < -0.01);
                    }
                    Err(other) => panic!("{other}"),
                }
            }
            assert_eq!(assemblies, 1);
        }
        for (i, a) in answers.iter().enumerate() {
            assert!(answers[i + 1..].iter().all(|b| gap(*a, *b) > 0.1));
        }
    }
}

#[test]
fn coaxial_parallelogram_adds_the_two_cranks() {
    let arm = five_bar(PARALLELOGRAM);
    let posture = arm.forward(JointAngles::new(2.0, 0.7)).unwrap();
    let expected =
        [0.3 * (elementary::cos(2.0) + elementary::cos(0.7)), 0.3 * (elementary::sin(2.0) + elementary::sin(0.7))];
    assert!(gap(posture.tip.to_array(), expected) < 1e-15);
    assert!(gap(posture.distal_rotation.map(|link| link.angle()), [0.7, 2.0]) < 1e-15);
    let jacobian =
        0.3 * Matrix2::new(-elementary::sin(2.0), -elementary::sin(0.7), elementary::cos(2.0), elementary::cos(0.7));
    assert!((posture.jacobian - jacobian).amax() < 1e-15);
    assert!(gap(arm.inverse(posture.tip).unwrap().to_array(), [2.0, 0.7]) < 1e-15);
}

#[test]
fn angles_stay_continuous_over_three_turns_about_a_coaxial_base() {
    let arm =
        five_bar(Geometry { tool: Tool { fixed_to: Chain::Left, along_m: 0.04, across_m: 0.02 }, ..PARALLELOGRAM });
    let start = arm.inverse(point(0.4, 0.0)).unwrap();
    let mut angles = start;
    for step in 1..=300 {
        let (sine, cosine) = elementary::sin_cos(TAU * f64::from(step) / 100.0);
        let next = arm.inverse_near(point(0.4 * cosine, 0.4 * sine), angles).unwrap();
        assert!(gap((next.0 - angles.0).into(), [TAU / 100.0; 2]) < 1e-12);
        angles = next;
    }
    assert!(gap((angles.0 - start.0).into(), [3.0 * TAU; 2]) < 1e-12);
}

#[test]
fn tool_point_is_fixed_to_its_distal_link() {
    for fixed_to in Chain::BOTH {
        let tool = Tool { fixed_to, along_m: 0.05, across_m: 0.02 };
        let arm = five_bar(Geometry { tool, ..PAPER });
        let posture = arm.forward(JointAngles::new(2.2, 0.6)).unwrap();
        let link = posture.distal_rotation[fixed_to.index()];
        let (sine, cosine) = (link.sin_angle(), link.cos_angle());
        let [x, y] = posture.wrist_m;
        let expected = [x + 0.05 * cosine - 0.02 * sine, y + 0.05 * sine + 0.02 * cosine];
        assert!(gap(posture.tip.to_array(), expected) < 1e-15);
    }
}

#[test]
fn condition_is_one_for_a_square_parallelogram_and_limited_where_stretched() {
    let arm = five_bar(PARALLELOGRAM);
    let square = arm.forward(JointAngles::new(0.75 * PI, 0.25 * PI)).unwrap();
    assert!((square.condition() - 1.0).abs() < 1e-14);
    // A chain of 0.5 + 0.75 m, stretched along the hypotenuse of a 0.75, 1 triangle.
    let stretched = five_bar(Geometry {
        base_m: [[0.0, 0.0], [0.25, 0.0]],
        proximal_m: [0.5, 0.5],
        distal_m: [0.75, 0.75],
        ..PAPER
    });
    let posture = stretched.forward(stretched.inverse(point(0.75, 1.0)).unwrap()).unwrap();
    assert!(posture.condition() > 1e7 && posture.condition() <= CONDITION_LIMIT);
}

proptest! {
    #[test]
    fn links_keep_their_lengths((arm, posture) in posed(1e-3)) {
        let Geometry { base_m, proximal_m, distal_m, wrist, .. } = *arm.geometry();
        let apart = |a: [f64; 2], b: [f64; 2]| elementary::hypot(a[0] - b[0], a[1] - b[1]);
        for i in 0..2 {
            prop_assert!((apart(base_m[i], posture.elbows_m[i]) - proximal_m[i]).abs() < 1e-14);
            prop_assert!((apart(posture.wrist_m, posture.elbows_m[i]) - distal_m[i]).abs() < 1e-13);
        }
        let [[x0, y0], [x1, y1]] = posture.elbows_m;
        let side = (x1 - x0) * (posture.wrist_m[1] - y0) - (y1 - y0) * (posture.wrist_m[0] - x0);
        prop_assert!(side * wrist.sign() > 0.0);
    }

    #[test]
    fn forward_of_inverse_is_the_tool_point((arm, posture) in posed(1e-3)) {
        let angles = arm.inverse(posture.tip).unwrap();
        let again = arm.forward(angles).unwrap();
        prop_assert!(gap(again.tip.to_array(), posture.tip.to_array()) < 1e-12);
        prop_assert_eq!(again.elbow_sides, posture.elbow_sides);
    }

    #[test]
    fn inverse_of_forward_is_the_angles((arm, posture) in posed(1e-2), turns in [-3..=3_i32, -3..=3_i32]) {
        let near = JointAngles(posture.angles.0 + nalgebra::Vector2::from(turns.map(f64::from)) * TAU);
        let angles = arm.inverse_near(posture.tip, near).unwrap();
        prop_assert!(gap(angles.to_array(), near.to_array()) < 1e-11);
    }

    #[test]
    fn jacobian_is_the_derivative_of_the_tool_point((arm, posture) in posed(1e-2)) {
        for joint in 0..2 {
            let column = derivative(1e-4, |step| {
                let mut angles = posture.angles;
                angles.0[joint] += step;
                arm.forward(angles).unwrap().tip.to_array()
            });
            let exact = [posture.jacobian[(0, joint)], posture.jacobian[(1, joint)]];
            // The step is a tenth of a percent of the radius of convergence at this margin, or less.
            prop_assert!(gap(column, exact) < 1e-7 * (1.0 + posture.jacobian.amax()), "{column:?} {exact:?}");
        }
    }

    #[test]
    fn singular_values_are_those_of_a_decomposition((_, posture) in posed(1e-3)) {
        let expected = posture.jacobian.svd(false, false).singular_values;
        let tolerance = 1e-12 * expected.max();
        prop_assert!((posture.smallest_singular_value() - expected.min()).abs() < tolerance);
        let condition = expected.max() / expected.min();
        prop_assert!((posture.condition() / condition - 1.0).abs() < 1e-14 * condition.max(100.0));
    }

    #[test]
    fn rates_and_torques_are_dual(
        (_, posture) in posed(1e-2),
        rates in [-5.0..5.0_f64, -5.0..5.0_f64],
        force in [-50.0..50.0_f64, -50.0..50.0_f64],
    ) {
        let rates = JointRates::from(rates);
        let velocity: TipVelocity = posture.tip_velocity(rates).unwrap();
        let back = posture.joint_rates(velocity).unwrap();
        prop_assert!(gap(back.to_array(), rates.to_array()) < 1e-13 * posture.condition().max(10.0));
        let force = Force::from(force);
        let torques = posture.joint_torques(force).unwrap();
        let power = force.0.dot(&velocity.0);
        prop_assert!((torques.0.dot(&rates.0) - power).abs() < 1e-12 * (1.0 + posture.jacobian.amax()) * 500.0);
    }
}
