//! The virtual fixture: coupling, levels, law, hold.

use garde::Validate;
use nalgebra::SVector;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::surface::Surface;
use crate::number::{Finite, NotNegative, Positive};
use yieldwall_motion::fixture::{self, FixtureError, Several, Shape2, Shape3};

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
    /// A hold whose length follows from each impact; `hold_steps` is then 0. Left out: none.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub automatic_hold: Option<AutomaticHold>,
    /// Damping when the rig has given the hand more than it may, for the admittance coupling, surfaces that do not move and
    /// laws without a spring. Left out: none.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub passivity: Option<Passivity>,
    /// How the surface's curvature enters the step: `tangent` as in the paper, or `exact` for a circle or sphere.
    pub curvature: Curvature,
    /// Reference C: a surface, or a curve in space or a point.
    #[garde(dive)]
    pub surface: Surface,
    /// Further surfaces, with the same levels and the same side: walls leave what is free of all of them, of guides the
    /// nearest counts. At most 15. Left out: none.
    #[garde(dive, length(max = 15))]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub also: Vec<Surface>,
    /// How the fixture answers in place of the law of the paper. Left out: that law.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub law: Option<FixtureLaw>,
    /// A motion of the surfaces, all together, for the admittance coupling. Left out: none. Figures show them where they
    /// are nearest to their place, and dashed where they are farthest.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<Motion>,
}

impl Fixture {
    /// The surfaces with their keys below the fixture's.
    pub fn surfaces(&self) -> impl Iterator<Item = (String, &Surface)> {
        let further = self.also.iter().enumerate().map(|(index, surface)| (format!("also[{index}]"), surface));
        std::iter::once(("surface".to_owned(), &self.surface)).chain(further)
    }

    /// The reference in the plane; `None` when a surface lies in space.
    ///
    /// # Errors
    /// Why the numbers give no shape.
    pub fn planar(&self) -> Result<Option<Shape2>, FixtureError> {
        let Some(first) = self.surface.planar()? else { return Ok(None) };
        if self.also.is_empty() {
            return Ok(Some(first));
        }
        let Some(mut all) = self.also.iter().map(Surface::planar).collect::<Result<Option<Vec<_>>, _>>()? else {
            return Ok(None);
        };
        all.insert(0, first);
        Ok(Some(Shape2::Several(Several::new(all, self.side == Side::Unilateral)?)))
    }

    /// The reference in space; `None` when a surface lies in the plane.
    ///
    /// # Errors
    /// Why the numbers give no shape.
    pub fn spatial(&self) -> Result<Option<Shape3>, FixtureError> {
        let Some(first) = self.surface.spatial()? else { return Ok(None) };
        if self.also.is_empty() {
            return Ok(Some(first));
        }
        let Some(mut all) = self.also.iter().map(Surface::spatial).collect::<Result<Option<Vec<_>>, _>>()? else {
            return Ok(None);
        };
        all.insert(0, first);
        Ok(Some(Shape3::Several(Several::new(all, self.side == Side::Unilateral)?)))
    }
}

/// How a fixture answers in place of the law of the paper: with another admissible set, or without a yield law, for
/// comparison.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub enum FixtureLaw {
    /// The law of the paper with another yield force on the side that is not forbidden, for a bilateral fixture.
    Tube {
        /// Force at which a guide gives way off the forbidden side, N. At least `friction_n`.
        #[garde(dive)]
        outward_yield_n: Positive,
    },
    /// An ellipse with R across the surface and F along it: a force that turns without a corner.
    Ellipse {},
    /// A spring and a damper to the surface. It stores energy; friction acts besides.
    Elastic {
        /// Stiffness across the surface, N/m. At most 1e6.
        #[garde(dive)]
        stiffness_n_per_m: Positive,
        /// Damping across the surface, N s/m. 0 to 1e6.
        #[garde(dive)]
        damping_n_s_per_m: NotNegative,
        /// Whether the force is cut to R.
        is_saturated: bool,
    },
    /// Damping that differs across and along the surface: an anisotropic admittance. Friction acts besides.
    Viscous {
        /// Across the surface, N s/m. 0 to 1e6.
        #[garde(dive)]
        across_n_s_per_m: NotNegative,
        /// Along the surface, N s/m. 0 to 1e6.
        #[garde(dive)]
        along_n_s_per_m: NotNegative,
    },
    /// Friction alone.
    Free {},
}

impl FixtureLaw {
    /// The key that names it in a file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Tube { .. } => "tube",
            Self::Ellipse {} => "ellipse",
            Self::Elastic { .. } => "elastic",
            Self::Viscous { .. } => "viscous",
            Self::Free {} => "free",
        }
    }

    /// The contrast that it is; `None` for one that yields.
    pub fn guidance(&self) -> Option<fixture::Guidance> {
        match *self {
            Self::Tube { .. } | Self::Ellipse {} => None,
            Self::Elastic { stiffness_n_per_m, damping_n_s_per_m, is_saturated } => Some(fixture::Guidance::Elastic {
                stiffness_n_per_m: *stiffness_n_per_m,
                damping_n_s_per_m: *damping_n_s_per_m,
                is_saturated,
            }),
            Self::Viscous { across_n_s_per_m, along_n_s_per_m } => Some(fixture::Guidance::Viscous {
                across_n_s_per_m: *across_n_s_per_m,
                along_n_s_per_m: *along_n_s_per_m,
            }),
            Self::Free {} => Some(fixture::Guidance::None),
        }
    }
}

/// A motion of the surfaces: from their place by the amplitude and back, smoothly, without end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Motion {
    /// Greatest displacement, m.
    pub amplitude_m: [Finite; 2],
    /// Duration of one way there and back, s. 0.01 to 10000; the greatest speed may be 0.5 m/s.
    #[garde(dive)]
    pub swing_s: Positive,
}

impl From<Motion> for fixture::Motion<2> {
    fn from(motion: Motion) -> Self {
        Self { amplitude_m: SVector::from(motion.amplitude_m.map(|value| value.get())), swing_s: *motion.swing_s }
    }
}

/// A hold after an impact that ends when the push above R has brought more impulse than a hand's mass can, or with its
/// window. For the admittance coupling.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct AutomaticHold {
    /// The heaviest hand that shall not break through at an impact, kg. 0.1 to 20; 1.5 serves most.
    #[garde(dive)]
    pub hand_mass_kg: Positive,
    /// Longest hold after an impact, s. 0.002 to 1; 0.15 serves most.
    #[garde(dive)]
    pub longest_s: Positive,
}

impl From<AutomaticHold> for fixture::AutomaticHold {
    fn from(hold: AutomaticHold) -> Self {
        Self { hand_mass_kg: *hold.hand_mass_kg, longest_s: *hold.longest_s }
    }
}

/// Passivity control in the time domain.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Passivity {
    /// What the rig may give the hand beyond the kinetic energy of its proxy before damping takes it back, J. 0.0001 to 10;
    /// above what the lag of the servo makes of a rig that does not swing, and below `guard.energy_limit_j`.
    #[garde(dive)]
    pub bound_j: Positive,
}

impl From<Passivity> for fixture::Passivity {
    fn from(passivity: Passivity) -> Self {
        Self { bound_j: *passivity.bound_j }
    }
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

/// How the surface's curvature enters the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Curvature {
    /// The step of a flat surface on the tangent, then projection onto the surface, as in the paper.
    Tangent,
    /// Exact in polar coordinates about the centre; for circle and sphere.
    Exact,
}
