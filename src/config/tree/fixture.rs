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
    /// F in N: force below which the tool does not move, off the surface and along it. 0 or above.
    #[garde(dive)]
    pub friction_n: NotNegative,
    /// R in N: force at which the surface yields. Above `friction_n`.
    #[garde(dive)]
    pub yield_n: Positive,
    /// Sides from which the surface resists.
    pub side: Side,
    /// N_wait in steps: how long the proxy stays on the surface after it meets it; 0 for no hold. With an admittance coupling 0
    /// or at least 2, since the input position depends on two past steps.
    #[garde(range(max = 10_000))]
    pub hold_steps: u32,
    /// A hold whose length depends on each impact; `hold_steps` is then 0. Left out: none.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub automatic_hold: Option<AutomaticHold>,
    /// Damping after the rig has given the hand more energy than allowed. Only for the admittance coupling, for surfaces that do
    /// not move and for laws without a spring. Left out: none.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub passivity: Option<Passivity>,
    /// How the curvature of the surface enters the step: `tangent` as in the paper, or `exact` for a circle or sphere.
    pub curvature: Curvature,
    /// Reference C: a surface, or a curve in space or a point.
    #[garde(dive)]
    pub surface: Surface,
    /// Further surfaces with the same levels and the same side. Walls leave free only the space that is free of all walls; of
    /// several guides the nearest acts. At most 15. Left out: none.
    #[garde(dive, length(max = 15))]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub also: Vec<Surface>,
    /// A law that replaces the law of the paper. Left out: the law of the paper.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub law: Option<FixtureLaw>,
    /// A common motion of all surfaces, for the admittance coupling. Left out: none. Figures show the surfaces nearest to their
    /// place, and dashed where they are farthest from it.
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

/// A law that replaces the law of the paper, for comparison: another admissible set, or a law without yielding.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub enum FixtureLaw {
    /// The law of the paper with another yield force on the side that is not forbidden, for a bilateral fixture.
    Tube {
        /// Force at which a guide yields on the side that is not forbidden, N. At least `friction_n`.
        #[garde(dive)]
        outward_yield_n: Positive,
    },
    /// An ellipse with R across the surface and F along it: the direction of the force changes without a corner.
    Ellipse {},
    /// A spring and a damper to the surface. The spring stores energy; friction acts as well.
    Elastic {
        /// Stiffness across the surface, N/m. At most 1e6.
        #[garde(dive)]
        stiffness_n_per_m: Positive,
        /// Damping across the surface, N s/m. 0 to 1e6.
        #[garde(dive)]
        damping_n_s_per_m: NotNegative,
        /// Whether the force is limited to R.
        is_saturated: bool,
    },
    /// Damping that differs across and along the surface: an anisotropic admittance. Friction acts as well.
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

    /// The comparison law that it is; `None` for a law that yields.
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

/// A motion of the surfaces: from their place by the amplitude and back, smoothly and without end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Motion {
    /// Greatest displacement, m.
    pub amplitude_m: [Finite; 2],
    /// Duration of one swing there and back, s. 0.01 to 10000; the greatest speed may be 0.5 m/s.
    #[garde(dive)]
    pub swing_s: Positive,
}

impl From<Motion> for fixture::Motion<2> {
    fn from(motion: Motion) -> Self {
        Self { amplitude_m: SVector::from(motion.amplitude_m.map(|value| value.get())), swing_s: *motion.swing_s }
    }
}

/// A hold after an impact. It ends when the push above R has brought more impulse than the mass of a hand can bring, or when the
/// longest time is over. For the admittance coupling.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct AutomaticHold {
    /// Heaviest hand that must not break through at an impact, kg. 0.1 to 20; 1.5 is right for most rigs.
    #[garde(dive)]
    pub hand_mass_kg: Positive,
    /// Longest hold after an impact, s. 0.002 to 1; 0.15 is right for most rigs.
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
    /// Energy that the rig may give the hand beyond the kinetic energy of its proxy before damping takes it back, J. From 0.0001
    /// to 10, above the energy that the servo lag causes in a rig that does not oscillate, and below `guard.energy_limit_j`.
    #[garde(dive)]
    pub bound_j: Positive,
}

impl From<Passivity> for fixture::Passivity {
    fn from(passivity: Passivity) -> Self {
        Self { bound_j: *passivity.bound_j }
    }
}

/// Coupling between the user's force and the proxy.
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

/// Sides from which a surface resists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// The fixture holds the proxy on the surface from both sides.
    Bilateral,
    /// The fixture keeps the proxy out of the forbidden side.
    Unilateral,
}

/// How the curvature of the surface enters the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Curvature {
    /// The step of a flat surface along the tangent, then projection onto the surface, as in the paper.
    Tangent,
    /// The exact step in polar coordinates about the centre; for circle and sphere.
    Exact,
}
