use super::*;
use crate::elementary;
use nalgebra::Vector2;

fn at(arm: &FiveBar, x: f64, y: f64) -> Posture {
    arm.forward(arm.inverse(point(x, y)).unwrap()).unwrap()
}

#[test]
fn paper_scene_measures_lengths() {
    let arm = five_bar(PAPER);
    let clearance = arm.clearance(&at(&arm, 0.0, 0.0));
    let reach = 0.2125_f64.sqrt();
    assert!(gap(clearance.stretched_m, [0.7 - reach; 2]) < 1e-15);
    assert!(gap(clearance.folded_m, [reach - 0.1; 2]) < 1e-15);
    let elbows = 2.0 * 0.3174670452885505;
    assert!((clearance.distal_stretched_m - (0.8 - elbows)).abs() < 1e-15);
    assert!((clearance.distal_folded_m - elbows).abs() < 1e-15);
    assert!((clearance.edge_m - (0.7 - reach)).abs() < 1e-15);
    let (singularity, clearance_m) = clearance.nearest();
    assert_eq!(singularity, Singularity::DistalStretched);
    assert_eq!(clearance_m, clearance.distal_stretched_m);
}

#[test]
fn each_end_is_named() {
    let arm = five_bar(PAPER);
    let nearest = |x, y| arm.clearance(&at(&arm, x, y)).nearest().0;
    assert_eq!(nearest(0.45, -0.09), Singularity::Stretched(Chain::Left));
    assert_eq!(nearest(-0.45, -0.09), Singularity::Stretched(Chain::Right));
    assert_eq!(nearest(-0.10, -0.34), Singularity::Folded(Chain::Left));
    assert_eq!(nearest(0.10, -0.34), Singularity::Folded(Chain::Right));
    let coaxial = five_bar(PARALLELOGRAM);
    let posture = coaxial.forward(JointAngles::new(1.6, 1.5)).unwrap();
    // The elbows are nearly as near to meeting as the chains are to being stretched; the chains come first.
    let clearance = coaxial.clearance(&posture);
    assert!((clearance.distal_folded_m - 0.6 * elementary::sin(0.05)).abs() < 1e-15);
    assert!((clearance.stretched_m[0] - 0.6 * (1.0 - elementary::cos(0.05))).abs() < 1e-15);
    // Elbows that meet above the middle of a wide base, while both chains are bent.
    let wide = five_bar(Geometry { base_m: [[-0.15, 0.0], [0.15, 0.0]], ..DESK });
    let angle = elementary::atan2(0.2, 0.15) + 0.01;
    let meeting = wide.forward(JointAngles::new(angle, std::f64::consts::PI - angle)).unwrap();
    assert_eq!(wide.clearance(&meeting).nearest().0, Singularity::DistalFolded);
}

#[test]
fn the_wrists_way_to_the_elbows_line_follows_from_the_stretched_clearance() {
    let arm = five_bar(Geometry { distal_m: [0.32, 0.29], ..DESK });
    let posture = arm.forward(JointAngles::new(3.10, 0.02)).unwrap();
    let x = arm.clearance(&posture).distal_stretched_m;
    let [[x0, y0], [x1, y1]] = posture.elbows_m;
    let [wx, wy] = posture.wrist_m;
    let offset = ((x1 - x0) * (wy - y0) - (y1 - y0) * (wx - x0)) / elementary::hypot(x1 - x0, y1 - y0);
    let predicted = (2.0 * 0.32 * 0.29 * x / 0.61_f64).sqrt();
    assert!(x < 0.011 && (offset / predicted - 1.0).abs() < 0.02, "{x} {offset} {predicted}");
}

#[test]
fn margins_and_elbow_sides_are_required() {
    let arm = five_bar(PAPER);
    let posture = at(&arm, 0.0, 0.0);
    let clearance = arm.require_clearance(&posture, 0.1).unwrap();
    assert_eq!(clearance, arm.clearance(&posture));
    let refused = arm.require_clearance(&posture, 0.2).unwrap_err();
    let expected = LinkageError::NearSingularity {
        singularity: Singularity::DistalStretched,
        clearance_m: clearance.distal_stretched_m,
        margin_m: 0.2,
    };
    assert_eq!(refused, expected);
    assert!(matches!(arm.require_clearance(&posture, f64::NAN), Err(LinkageError::NearSingularity { .. })));
    let inward = five_bar(Geometry { elbows: [Side::Right, Side::Right], ..PAPER });
    let refused = inward.require_clearance(&posture, 0.0).unwrap_err();
    assert_eq!(refused, LinkageError::OtherElbow { chain: Chain::Left, side: Side::Left });
}

#[test]
fn the_papers_working_disc_is_reached_and_a_larger_one_is_not() {
    let arm = five_bar(PAPER);
    // The least is 63.27 mm, straight down, where the distal links are nearest to being stretched.
    arm.reaches_disc(point(0.0, 0.0), 0.16, 0.0632).unwrap();
    let error = arm.reaches_disc(point(0.0, 0.0), 0.16, 0.0633).unwrap_err();
    let LinkageError::NearSingularity { singularity, clearance_m, margin_m } = error.cause else { panic!("{error}") };
    assert_eq!((singularity, margin_m), (Singularity::DistalStretched, 0.0633));
    assert!((clearance_m - 0.06327086213484334).abs() < 1e-14, "{error}");
    assert!(gap(error.tip.to_array(), [0.0, -0.16]) < 1e-15, "{error}");
    let error = arm.reaches_disc(point(0.0, 0.0), 0.30, 0.0).unwrap_err();
    assert!(error.tip.norm() <= 0.30 + 1e-12 && error.tip.norm() > 0.16, "{error}");
    let error = arm.reaches_disc(point(0.0, 0.6), 0.01, 0.02).unwrap_err();
    assert!(matches!(error.cause, LinkageError::OutOfReach { .. }), "{error}");
}

#[test]
fn the_edge_is_finite_where_its_slope_is_not_defined() {
    let tool = Tool { fixed_to: Chain::Left, along_m: 0.0, across_m: 0.4 };
    let arm = five_bar(Geometry { base_m: [[0.0, 0.0], [0.25, 0.0]], tool, ..PAPER });
    let posture = arm.forward(JointAngles::new(2.4, 0.8)).unwrap();
    // The wrist on the base joint of the chain without the tool: that chain is folded beyond its end.
    let folded = Posture { wrist_m: [0.25, 0.0], ..posture };
    assert!((arm.clearance(&folded).edge_m + 0.1).abs() < 1e-15);
    // The chain with the tool lies stretched along x, and its crank would move the wrist, seen from the tool half a
    // right angle aside, at right angles to the reach: the slope is 0 / 0.
    let level = Posture {
        elbows_m: [[0.25, 0.0], posture.elbows_m[1]],
        tip: point(0.75, 0.0),
        wrist_m: [0.5, 0.25],
        ..posture
    };
    assert!(arm.clearance(&level).edge_m.is_finite());
}

fn is_reach(error: &LinkageError) -> bool {
    matches!(error, LinkageError::OutOfReach { .. } | LinkageError::TooClose { .. })
}

proptest! {
    #[test]
    fn a_tool_on_the_wrist_can_move_in_every_direction_up_to_the_edge(
        (arm, posture) in posed(1e-3),
        direction in 0.0..std::f64::consts::TAU,
        share in 0.0..0.999_f64,
    ) {
        let tool = Tool { along_m: 0.0, across_m: 0.0, ..arm.geometry().tool };
        let arm = five_bar(Geometry { tool, elbows: arm.geometry().elbows, ..*arm.geometry() });
        let posture = arm.forward(posture.angles).unwrap();
        let clearance = arm.clearance(&posture);
        let way = clearance.edge_m * share;
        let there = TipPoint(posture.tip.0 + way * Vector2::new(elementary::cos(direction), elementary::sin(direction)));
        prop_assert!(arm.inverse(there).map_or_else(|error| !is_reach(&error), |_| true));
        // And along the line through the nearer base joint it ends there.
        let ends = (0..2).any(|i| {
            let outward = (posture.tip.0 - Vector2::from(arm.geometry().base_m[i])).normalize();
            [1.0, -1.0].iter().any(|sign| {
                let beyond = TipPoint(posture.tip.0 + outward * (sign * (clearance.edge_m + 1e-6)));
                arm.inverse(beyond).is_err_and(|error| is_reach(&error))
            })
        });
        prop_assert!(ends);
    }

    #[test]
    fn the_edge_with_an_offset_is_the_gap_over_the_slope_of_the_reach((arm, posture) in posed(0.03)) {
        let held = arm.geometry().tool.fixed_to;
        let (h, f) = (held.index(), held.other().index());
        let base = Vector2::from(arm.geometry().base_m[f]);
        let slope = |axis: usize| derivative(1e-4, |step| {
            let mut tip = posture.tip;
            tip.0[axis] += step;
            let moved = arm.forward(arm.inverse(tip).unwrap()).unwrap();
            [(Vector2::from(moved.wrist_m) - base).norm()]
        })[0];
        let steepness = elementary::hypot(slope(0), slope(1));
        let clearance = arm.clearance(&posture);
        let free = clearance.stretched_m[f].min(clearance.folded_m[f]) / steepness;
        let expected = free.min(clearance.stretched_m[h]).min(clearance.folded_m[h]);
        prop_assert!((clearance.edge_m / expected - 1.0).abs() < 1e-5, "{} {expected}", clearance.edge_m);
    }

    #[test]
    fn clearances_of_a_closed_loop_are_positive((arm, posture) in posed(0.0)) {
        let (_, nearest) = arm.clearance(&posture).nearest();
        prop_assert!(nearest >= 0.0);
    }
}
