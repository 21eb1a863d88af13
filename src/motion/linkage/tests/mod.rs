//! Scenes and random linkages that the tests share.

mod clearance;
mod dynamics;
mod kinematics;
mod refusals;

use super::*;
use crate::quantity::{JointAngles, TipPoint};
use proptest::prelude::*;

pub(super) const WRIST_TOOL: Tool = Tool { fixed_to: Chain::Right, along_m: 0.0, across_m: 0.0 };

/// The rig of `config/paper-admittance.yaml`.
pub(super) const PAPER: Geometry = Geometry {
    base_m: [[-0.10, -0.45], [0.10, -0.45]],
    proximal_m: [0.30, 0.30],
    distal_m: [0.40, 0.40],
    elbows: [Side::Left, Side::Right],
    wrist: WristSide::Forward,
    tool: WRIST_TOOL,
};

/// A small symmetric arm whose distal links are stretched with the wrist at the origin.
pub(super) const DESK: Geometry = Geometry {
    base_m: [[-0.05, 0.0], [0.05, 0.0]],
    proximal_m: [0.25, 0.25],
    distal_m: [0.30, 0.30],
    elbows: [Side::Left, Side::Right],
    wrist: WristSide::Forward,
    tool: WRIST_TOOL,
};

/// Both base joints in the origin and equal links: a parallelogram.
pub(super) const PARALLELOGRAM: Geometry = Geometry {
    base_m: [[0.0, 0.0], [0.0, 0.0]],
    proximal_m: [0.30, 0.30],
    distal_m: [0.30, 0.30],
    elbows: [Side::Left, Side::Right],
    wrist: WristSide::Forward,
    tool: WRIST_TOOL,
};

/// Nothing equal, tool off the wrist.
pub(super) const SKEW: Geometry = Geometry {
    base_m: [[-0.07, 0.02], [0.11, -0.03]],
    proximal_m: [0.25, 0.31],
    distal_m: [0.37, 0.33],
    elbows: [Side::Left, Side::Right],
    wrist: WristSide::Forward,
    tool: Tool { fixed_to: Chain::Left, along_m: 0.06, across_m: -0.04 },
};

pub(super) fn five_bar(geometry: Geometry) -> FiveBar {
    FiveBar::new(geometry).expect("a valid geometry")
}

pub(super) fn chain() -> impl Strategy<Value = Chain> {
    prop_oneof![Just(Chain::Left), Just(Chain::Right)]
}

/// Any linkage of desk size; the elbows' sides are arbitrary until a posture decides them.
fn geometry() -> impl Strategy<Value = Geometry> {
    let length = || 0.1..1.0_f64;
    let base = prop_oneof![
        1 => Just([[0.2, -0.1], [0.2, -0.1]]),
        3 => [[-0.5..0.5_f64, -0.5..0.5_f64], [-0.5..0.5_f64, -0.5..0.5_f64]],
    ];
    let tool = prop_oneof![
        1 => chain().prop_map(|fixed_to| Tool { fixed_to, along_m: 0.0, across_m: 0.0 }),
        2 => (chain(), -0.05..0.3_f64, -0.3..0.3_f64)
            .prop_map(|(fixed_to, along_m, across_m)| Tool { fixed_to, along_m, across_m }),
    ];
    let wrist = prop_oneof![Just(WristSide::Forward), Just(WristSide::Backward)];
    (base, [length(), length()], [length(), length()], wrist, tool).prop_map(
        |(base_m, proximal_m, distal_m, wrist, tool)| Geometry {
            base_m,
            proximal_m,
            distal_m,
            elbows: [Side::Left, Side::Left],
            wrist,
            tool,
        },
    )
}

/// Any linkage at any angles at which it has at least `margin_m` of clearance; its working mode is that of the
/// angles, so all working and assembly modes occur.
pub(super) fn posed(margin_m: f64) -> impl Strategy<Value = (FiveBar, Posture)> {
    (geometry(), [-3.1..3.1_f64, -3.1..3.1_f64]).prop_filter_map(
        "loop open or near singular",
        move |(geometry, angles)| {
            let posture = FiveBar::new(geometry).ok()?.forward(JointAngles::from(angles)).ok()?;
            let linkage = FiveBar::new(Geometry { elbows: posture.elbow_sides, ..geometry }).ok()?;
            linkage.require_clearance(&posture, margin_m).ok()?;
            Some((linkage, posture))
        },
    )
}

/// Largest difference of the components.
pub(super) fn gap(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).abs().max((a[1] - b[1]).abs())
}

/// Derivative at zero of a vector-valued function by five points, with an error of the order `step^4`.
pub(super) fn derivative<const N: usize>(step: f64, f: impl Fn(f64) -> [f64; N]) -> [f64; N] {
    let [far_back, back, ahead, far_ahead] = [-2.0, -1.0, 1.0, 2.0].map(|k: f64| f(k * step));
    std::array::from_fn(|i| (8.0 * (ahead[i] - back[i]) - (far_ahead[i] - far_back[i])) / (12.0 * step))
}

pub(super) fn point(x: f64, y: f64) -> TipPoint {
    TipPoint::new(x, y)
}
