use super::*;
use crate::elementary;
use crate::quantity::{Force, JointRates, TipVelocity};
use proptest::num::f64::ANY;

fn close_to(found: f64, expected: f64) -> bool {
    (found - expected).abs() < 1e-12
}

#[test]
fn a_point_out_of_reach_names_the_chain_and_the_lengths() {
    let error = five_bar(PAPER).inverse(point(0.5, 0.0)).unwrap_err();
    let LinkageError::OutOfReach { chain, distance_m, longest_m } = error else { panic!("{error}") };
    // The right chain carries the tool and is asked first: hypot(0.4, 0.45) = 0.602 m is in its reach of 0.7 m.
    assert_eq!(chain, Chain::Left);
    assert!(close_to(distance_m, 0.5625_f64.sqrt()) && close_to(longest_m, 0.7));
    assert!(error.to_string().contains("left chain cannot reach: 0.75"), "{error}");
    assert!(matches!(
        five_bar(PAPER).inverse(point(-0.5, 0.0)),
        Err(LinkageError::OutOfReach { chain: Chain::Right, .. })
    ));
}

#[test]
fn a_point_at_the_end_of_all_numbers_is_out_of_reach_by_a_finite_number() {
    let error = five_bar(PAPER).inverse(point(f64::MAX, -f64::MAX)).unwrap_err();
    let LinkageError::OutOfReach { distance_m, .. } = error else { panic!("{error}") };
    assert_eq!(distance_m, f64::MAX);
}

#[test]
fn a_point_too_near_to_a_base_joint_names_the_chain_and_the_lengths() {
    let error = five_bar(PAPER).inverse(point(-0.10, -0.40)).unwrap_err();
    let LinkageError::TooClose { chain, distance_m, shortest_m } = error else { panic!("{error}") };
    assert_eq!(chain, Chain::Left);
    assert!(close_to(distance_m, 0.05) && close_to(shortest_m, 0.1));
    // Equal links fold onto the base joint, where any angle would do.
    let error = five_bar(PARALLELOGRAM).inverse(point(0.0, 0.0)).unwrap_err();
    let LinkageError::TooClose { distance_m, shortest_m, .. } = error else { panic!("{error}") };
    assert!(distance_m == 0.0 && close_to(shortest_m, 0.6e-6));
}

#[test]
fn the_edge_of_the_workspace_belongs_to_it_and_the_next_number_does_not() {
    let base = Geometry { base_m: [[0.0, 0.0], [0.25, 0.0]], ..PAPER };
    let arm = five_bar(Geometry { proximal_m: [0.5, 0.5], distal_m: [0.75, 0.75], ..base });
    let angles = arm.inverse(point(0.75, 1.0)).unwrap();
    assert!(close_to(angles.0.x, elementary::atan2(1.0, 0.75)));
    let beyond = arm.inverse(point(0.75, 1.0_f64.next_up().next_up()));
    assert!(matches!(beyond, Err(LinkageError::OutOfReach { chain: Chain::Left, .. })), "{beyond:?}");
    // No joint rates move the tool outwards there.
    let posture = arm.forward(angles).unwrap();
    assert!(posture.smallest_singular_value() < 1e-7);
}

#[test]
fn a_singular_jacobian_gives_no_rates() {
    // Distal and proximal links of both chains in line, to the last bit: the joints at angle 0 move nothing along x.
    let arm = five_bar(Geometry {
        base_m: [[0.0, 0.0], [0.0, 0.0]],
        proximal_m: [0.5, 0.25],
        distal_m: [0.5, 0.75],
        elbows: [Side::Left, Side::Left],
        ..PAPER
    });
    let posture = arm.forward(JointAngles::new(0.5, 0.2)).unwrap();
    let singular = Posture { jacobian: nalgebra::Matrix2::new(1.0, 2.0, 2.0, 4.0), ..posture };
    let refused = singular.joint_rates(TipVelocity::new(0.1, 0.0));
    assert!(matches!(refused, Err(LinkageError::JacobianSingular { smallest_m: 0.0, .. })), "{refused:?}");
    assert_eq!(singular.condition(), CONDITION_LIMIT);
    assert_eq!(Posture { jacobian: nalgebra::Matrix2::zeros(), ..posture }.condition(), CONDITION_LIMIT);
}

#[test]
fn elbows_too_far_apart_are_refused_as_stretched() {
    // 0.6 m between the elbows at full spread, and distal links of 0.5 m together.
    let arm = five_bar(Geometry { distal_m: [0.25, 0.25], ..DESK });
    let error = arm.forward(JointAngles::new(std::f64::consts::PI, 0.0)).unwrap_err();
    let LinkageError::DistalStretched { elbow_distance_m, longest_m } = error else { panic!("{error}") };
    assert!(close_to(elbow_distance_m, 0.6) && close_to(longest_m, 0.5));
    // On the line itself: exactly 0.6 m of distal links.
    let error = five_bar(DESK).forward(JointAngles::new(std::f64::consts::PI, 0.0)).unwrap_err();
    assert!(matches!(error, LinkageError::DistalStretched { .. }), "{error}");
    let error = five_bar(DESK).inverse(point(0.0, 0.0)).unwrap_err();
    assert!(matches!(error, LinkageError::DistalStretched { .. }), "{error}");
}

#[test]
fn meeting_elbows_are_refused_as_folded() {
    for angle in [0.0, 0.4, -2.0] {
        let error = five_bar(PARALLELOGRAM).forward(JointAngles::new(angle, angle)).unwrap_err();
        assert_eq!(error, LinkageError::DistalFolded { elbow_distance_m: 0.0, shortest_m: 0.0 });
    }
    // With unequal distal links before the elbows meet.
    let unequal = five_bar(Geometry { distal_m: [0.4, 0.3], ..PARALLELOGRAM });
    let error = unequal.forward(JointAngles::new(0.1, 0.0)).unwrap_err();
    let LinkageError::DistalFolded { elbow_distance_m, shortest_m } = error else { panic!("{error}") };
    assert!(close_to(elbow_distance_m, 0.6 * elementary::sin(0.05)) && close_to(shortest_m, 0.1));
    // From the inverse: with both elbows on one side of a coaxial base they coincide at every tool point.
    let doubled = five_bar(Geometry { elbows: [Side::Left, Side::Left], ..PARALLELOGRAM });
    let error = doubled.inverse(point(0.2, 0.3)).unwrap_err();
    assert!(matches!(error, LinkageError::DistalFolded { .. }), "{error}");
}

#[test]
fn the_other_assembly_is_refused_with_the_wrists_offset() {
    let error = five_bar(Geometry { wrist: WristSide::Backward, ..PAPER }).inverse(point(0.0, 0.0)).unwrap_err();
    // The elbows lie 0.24334 m below the origin.
    let LinkageError::OtherAssembly { wrist_offset_m } = error else { panic!("{error}") };
    assert!(close_to(wrist_offset_m, 0.2433406566025443));
}

#[test]
fn geometries_of_no_machine_are_refused() {
    let refuse = |geometry: Geometry| FiveBar::new(geometry).unwrap_err();
    for bad in [0.0, -0.3, f64::NAN, f64::INFINITY, 1e-9, 1e9] {
        let error = refuse(Geometry { distal_m: [0.4, bad], ..PAPER });
        assert!(matches!(error, GeometryError::Length { chain: Chain::Right, link: "distal", .. }), "{error}");
        let error = refuse(Geometry { proximal_m: [bad, 0.3], ..PAPER });
        assert!(matches!(error, GeometryError::Length { chain: Chain::Left, link: "proximal", .. }), "{error}");
    }
    for bad in [f64::NAN, f64::NEG_INFINITY, 1e9] {
        let error = refuse(Geometry { base_m: [[0.0, 0.0], [0.1, bad]], ..PAPER });
        assert!(matches!(error, GeometryError::Offset { what: "right base joint", .. }), "{error}");
        let error = refuse(Geometry { tool: Tool { across_m: bad, ..WRIST_TOOL }, ..PAPER });
        assert!(matches!(error, GeometryError::Offset { what: "tool across", .. }), "{error}");
    }
    let error = refuse(Geometry { tool: Tool { along_m: -0.4, ..WRIST_TOOL }, ..PAPER });
    assert_eq!(error, GeometryError::ToolOnElbow { chain: Chain::Right, distance_m: 0.0 });
    let error = refuse(Geometry { base_m: [[0.0, 0.0], [2.0, 0.0]], ..PAPER });
    assert!(matches!(error, GeometryError::NeverCloses { .. }), "{error}");
    // Cranks of very unequal length about one joint keep the elbows apart.
    let error = refuse(Geometry { proximal_m: [1.0, 0.1], distal_m: [0.3, 0.4], ..PARALLELOGRAM });
    let GeometryError::NeverCloses { nearest_m, .. } = error else { panic!("{error}") };
    assert!(close_to(nearest_m, 0.9));
    // Elbows never far enough apart, too: coaxial short cranks with very unequal distal links.
    let error = refuse(Geometry { proximal_m: [0.1, 0.1], distal_m: [0.9, 0.4], ..PARALLELOGRAM });
    let GeometryError::NeverCloses { nearest_m, farthest_m, shortest_m, longest_m } = error else { panic!("{error}") };
    assert!(nearest_m == 0.0 && close_to(farthest_m, 0.2) && close_to(shortest_m, 0.5) && close_to(longest_m, 1.3));
}

#[test]
fn numbers_that_are_not_finite_are_refused_by_name() {
    let arm = five_bar(PAPER);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert!(matches!(arm.inverse(point(bad, 0.0)), Err(LinkageError::NotFinite { .. })));
        assert!(matches!(arm.forward(JointAngles::new(1.0, bad)), Err(LinkageError::NotFinite { .. })));
        let near = arm.inverse_near(point(0.0, 0.0), JointAngles::new(bad, 0.0));
        assert!(matches!(near, Err(LinkageError::NotFinite { .. })));
        let posture = arm.forward(JointAngles::new(2.4, 0.8)).unwrap();
        assert!(matches!(posture.tip_velocity(JointRates::new(bad, 0.0)), Err(LinkageError::NotFinite { .. })));
        assert!(matches!(posture.joint_torques(Force::new(0.0, bad)), Err(LinkageError::NotFinite { .. })));
        assert!(matches!(posture.joint_rates(TipVelocity::new(bad, bad)), Err(LinkageError::NotFinite { .. })));
        assert!(matches!(
            arm.reaches_disc(point(0.0, 0.0), bad, 0.0).unwrap_err().cause,
            LinkageError::NotFinite { .. }
        ));
        assert!(arm.reaches_disc(point(bad, 0.0), 0.1, 0.0).is_err());
    }
}

/// Numbers of every size, many of them near the edges of the paper's linkage.
fn number() -> impl Strategy<Value = f64> {
    let edge = prop_oneof![Just(0.0), Just(0.1), Just(0.3), Just(0.7), Just(-0.45), Just(std::f64::consts::PI)];
    prop_oneof![ANY, -1.0..1.0_f64, -7.0..7.0_f64, (edge, -4..4_i32).prop_map(|(x, k)| x + f64::from(k) * 1e-16)]
}

fn assert_finite(posture: &Posture) {
    assert!(posture.tip.is_finite() && posture.jacobian.iter().all(|x| x.is_finite()));
    assert!(posture.wrist_m.iter().chain(posture.elbows_m.iter().flatten()).all(|x| x.is_finite()));
    assert!(posture.distal_rotation.iter().all(|link| (link.norm_sqr() - 1.0).abs() < 1e-9));
    assert!(posture.smallest_singular_value().is_finite() && posture.condition().is_finite());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn no_input_gives_a_number_that_is_not_finite(
        geometry in prop_oneof![Just(PAPER), Just(DESK), Just(PARALLELOGRAM), Just(SKEW)],
        tip in [number(), number()],
        angles in [number(), number()],
        motion in [number(), number()],
        mass in [number(), number(), number()],
    ) {
        let arm = five_bar(geometry);
        if let Ok(found) = arm.inverse(TipPoint::from(tip)) {
            prop_assert!(found.is_finite());
        }
        if let Ok(found) = arm.inverse_near(TipPoint::from(tip), JointAngles::from(angles)) {
            prop_assert!(found.is_finite());
        }
        let model = MassModel {
            motor_kg_m2: [mass[0]; 2],
            proximal_kg: [mass[1]; 2],
            distal_kg: [mass[1], mass[2]],
            tool_kg: mass[2],
        };
        if let Ok(found) = arm.dynamics(&model, JointAngles::from(angles), JointRates::from(motion)) {
            prop_assert!(found.tip.is_finite() && found.tip_velocity.is_finite() && found.bias.is_finite());
            prop_assert!(found.mass.iter().chain(found.jacobian.iter()).all(|x| x.is_finite()));
            prop_assert!(found.tip_bias_m_per_s2.iter().all(|x| x.is_finite()));
            if let Ok(torque) = found.torque_for(motion) {
                prop_assert!(torque.is_finite());
            }
        }
        if let Ok(posture) = arm.forward(JointAngles::from(angles)) {
            assert_finite(&posture);
            let clearance = arm.clearance(&posture);
            let numbers = [clearance.edge_m, clearance.distal_folded_m, clearance.distal_stretched_m];
            let chains = clearance.stretched_m.into_iter().chain(clearance.folded_m);
            prop_assert!(numbers.into_iter().chain(chains).all(f64::is_finite));
            prop_assert!(posture.tip_velocity(JointRates::from(motion)).map_or(true, |v| v.is_finite()));
            prop_assert!(posture.joint_torques(Force::from(motion)).map_or(true, |v| v.is_finite()));
            prop_assert!(posture.joint_rates(TipVelocity::from(motion)).map_or(true, |v| v.is_finite()));
        }
    }

    #[test]
    fn any_parameters_are_refused_or_usable(
        base_m in [[number(), number()], [number(), number()]],
        proximal_m in [number(), number()],
        distal_m in [number(), number()],
        offset in [number(), number()],
        tip in [number(), number()],
        angles in [number(), number()],
    ) {
        let tool = Tool { fixed_to: Chain::Left, along_m: offset[0], across_m: offset[1] };
        if let Ok(arm) = FiveBar::new(Geometry { base_m, proximal_m, distal_m, tool, ..PAPER }) {
            prop_assert!(arm.inverse(TipPoint::from(tip)).map_or(true, |found| found.is_finite()));
            if let Ok(posture) = arm.forward(JointAngles::from(angles)) {
                assert_finite(&posture);
                prop_assert!(arm.clearance(&posture).edge_m.is_finite());
            }
        }
    }
}
