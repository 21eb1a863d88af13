//! The virtual fixture: coupling, levels, surface.

use garde::Validate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::config::number::{Finite, NotNegative, Positive};

/// A plasticity-based virtual fixture (KTF08).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Fixture {
    /// How force and proxy are coupled: `admittance` on a rig, `impedance` on an impedance device.
    #[garde(dive)]
    pub coupling: Coupling,
    /// F in N: friction level, the force at which the proxy yields away from the surface. 0 or above.
    #[garde(dive)]
    pub friction_n: NotNegative,
    /// R in N: force at which the surface yields. Above `friction_n`.
    #[garde(dive)]
    pub yield_n: Positive,
    /// From which sides the surface resists.
    pub side: Side,
    /// N_wait in steps: how long the proxy is held on the surface after it meets it; 0 for no hold. With an admittance
    /// coupling 0 or at least 2, since the input position depends on two past steps.
    #[garde(range(max = 10_000))]
    pub hold_steps: u32,
    /// How the surface's curvature enters the step: `tangent` as in the paper, or `exact` for a circle or sphere.
    pub curvature: Curvature,
    /// Reference surface C.
    #[garde(dive)]
    pub surface: Surface,
}

/// How the user's force and the proxy are coupled.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub enum Coupling {
    /// The proxy is a virtual mass that the measured force moves; the equivalent stiffness is M / T^2.
    Admittance {
        /// M in kg: virtual mass. Above 0.
        #[garde(dive)]
        mass_kg: Positive,
    },
    /// A spring and damper between tool and proxy; the equivalent stiffness is K + B / T.
    Impedance {
        /// K in N/m: stiffness. Above 0.
        #[garde(dive)]
        stiffness_n_per_m: Positive,
        /// B in N s/m: damping. 0 or above.
        #[garde(dive)]
        damping_n_s_per_m: NotNegative,
    },
}

impl Coupling {
    /// Equivalent stiffness kappa in N/m at the sampling interval `period_s`.
    ///
    /// # Source
    /// KTF08: kappa = M / T^2 (admittance), kappa = K + B / T (impedance).
    pub fn equivalent_stiffness_n_per_m(&self, period_s: f64) -> f64 {
        match self {
            Self::Admittance { mass_kg } => **mass_kg / (period_s * period_s),
            Self::Impedance { stiffness_n_per_m, damping_n_s_per_m } => {
                **stiffness_n_per_m + **damping_n_s_per_m / period_s
            }
        }
    }
}

/// From which sides a surface resists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// The proxy is held on the surface from both sides.
    Bilateral,
    /// The proxy is kept out of the forbidden side.
    Unilateral,
}

/// Reference surface of a fixture. `circle` and `line` lie in the plane of a rig; `cylinder`, `plane` and `sphere` in
/// the space of an impedance device.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub enum Surface {
    /// Circle in the plane.
    Circle {
        /// Centre, m.
        center_m: [Finite; 2],
        /// Radius, m. Above 0.
        #[garde(dive)]
        radius_m: Positive,
        /// The side that a unilateral fixture forbids; without effect when `side` is bilateral.
        forbidden: Forbidden,
    },
    /// Straight line in the plane.
    Line {
        /// A point of it, m.
        point_m: [Finite; 2],
        /// Direction across it, of any length but 0; points out of the forbidden side.
        normal: [Finite; 2],
    },
    /// Circular cylinder in space, without end.
    Cylinder {
        /// A point of the axis, m.
        axis_point_m: [Finite; 3],
        /// Direction of the axis, of any length but 0.
        axis_direction: [Finite; 3],
        /// Radius, m. Above 0.
        #[garde(dive)]
        radius_m: Positive,
        /// The side that a unilateral fixture forbids; without effect when `side` is bilateral.
        forbidden: Forbidden,
    },
    /// Plane in space.
    Plane {
        /// A point of it, m.
        point_m: [Finite; 3],
        /// Direction across it, of any length but 0; points out of the forbidden side.
        normal: [Finite; 3],
    },
    /// Sphere in space.
    Sphere {
        /// Centre, m.
        center_m: [Finite; 3],
        /// Radius, m. Above 0.
        #[garde(dive)]
        radius_m: Positive,
        /// The side that a unilateral fixture forbids; without effect when `side` is bilateral.
        forbidden: Forbidden,
    },
}

impl Surface {
    /// Dimension of the space that it lies in: 2 or 3.
    pub fn dimension(&self) -> usize {
        match self {
            Self::Circle { .. } | Self::Line { .. } => 2,
            Self::Cylinder { .. } | Self::Plane { .. } | Self::Sphere { .. } => 3,
        }
    }

    /// Radius of curvature in m; `None` when flat.
    pub fn radius_m(&self) -> Option<f64> {
        match self {
            Self::Circle { radius_m, .. } | Self::Cylinder { radius_m, .. } | Self::Sphere { radius_m, .. } => {
                Some(**radius_m)
            }
            Self::Line { .. } | Self::Plane { .. } => None,
        }
    }

    /// The key that names it in a file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Circle { .. } => "circle",
            Self::Line { .. } => "line",
            Self::Cylinder { .. } => "cylinder",
            Self::Plane { .. } => "plane",
            Self::Sphere { .. } => "sphere",
        }
    }
}

/// Side of a closed surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Forbidden {
    /// The side of the centre.
    Inside,
    /// The far side.
    Outside,
}

/// How the surface's curvature enters the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Curvature {
    /// The step of a flat surface on the tangent, then projection onto the surface, as in the paper.
    Tangent,
    /// Exact in polar coordinates about the centre; for circle and sphere.
    Exact,
}
