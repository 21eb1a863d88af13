//! The five-bar arm: geometry, inertia and friction.

use garde::Validate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::number::{Finite, NotNegative, Positive};

/// Geometry of a five-bar arm. Pairs list the left arm before the right.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Linkage {
    /// Base joints, m.
    pub base_m: [[Finite; 2]; 2],
    /// Lengths of the proximal links, m. Above 0.
    #[garde(dive)]
    pub proximal_m: [Positive; 2],
    /// Lengths of the distal links, m. Above 0.
    #[garde(dive)]
    pub distal_m: [Positive; 2],
    /// Working mode: the side of the line from base joint to wrist on which each elbow lies.
    pub elbows: [ElbowSide; 2],
    /// Assembly mode: the side of the line from left to right elbow on which the wrist lies.
    pub wrist: WristSide,
    /// Position of the tool on its link.
    #[garde(dive)]
    pub tool: Tool,
    /// Radius of the disc about the origin that the tool must reach, m. Above 0. The program checks it when it reads the file.
    #[garde(dive)]
    pub working_radius_m: Positive,
}

impl Linkage {
    /// The parameters of the kinematics.
    pub fn geometry(&self) -> yieldwall_motion::linkage::Geometry {
        use yieldwall_motion::linkage::{Chain, Geometry, Side, Tool, WristSide as Wrist};
        Geometry {
            base_m: self.base_m.map(|point| point.map(Finite::get)),
            proximal_m: self.proximal_m.map(Positive::get),
            distal_m: self.distal_m.map(Positive::get),
            elbows: self.elbows.map(|side| match side {
                ElbowSide::Left => Side::Left,
                ElbowSide::Right => Side::Right,
            }),
            wrist: match self.wrist {
                WristSide::Forward => Wrist::Forward,
                WristSide::Backward => Wrist::Backward,
            },
            tool: Tool {
                fixed_to: match self.tool.fixed_to {
                    DistalLink::Left => Chain::Left,
                    DistalLink::Right => Chain::Right,
                },
                along_m: self.tool.along_m.get(),
                across_m: self.tool.across_m.get(),
            },
        }
    }
}

/// Side of the line from base joint to wrist.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ElbowSide {
    /// To the left of the direction from base joint to wrist.
    Left,
    /// To the right of the direction from base joint to wrist.
    Right,
}

/// Side of the line from left to right elbow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WristSide {
    /// To the left of the direction from left to right elbow.
    Forward,
    /// To the right of the direction from left to right elbow.
    Backward,
}

/// Position of the tool on a distal link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Tool {
    /// The distal link that carries the tool.
    pub fixed_to: DistalLink,
    /// Distance from the wrist along that link, away from its elbow, m.
    pub along_m: Finite,
    /// Distance from the wrist to the left of that direction, m.
    pub across_m: Finite,
}

/// A distal link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DistalLink {
    /// Distal link of the left arm.
    Left,
    /// Distal link of the right arm.
    Right,
}

/// Inertia of a five-bar arm. Pairs list the left arm before the right.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct ArmInertia {
    /// Inertia of each motor, reflected to the link, kg m^2. Above 0.
    #[garde(dive)]
    pub motor_kg_m2: [Positive; 2],
    /// Mass of each proximal link, a uniform rod, kg. 0 or above.
    #[garde(dive)]
    pub proximal_kg: [NotNegative; 2],
    /// Mass of each distal link, a uniform rod, kg. 0 or above.
    #[garde(dive)]
    pub distal_kg: [NotNegative; 2],
    /// Mass at the tool, kg. 0 or above.
    #[garde(dive)]
    pub tool_kg: NotNegative,
}

impl ArmInertia {
    /// The parameters of the dynamics.
    pub fn mass_model(&self) -> yieldwall_motion::linkage::MassModel {
        yieldwall_motion::linkage::MassModel {
            motor_kg_m2: self.motor_kg_m2.map(Positive::get),
            proximal_kg: self.proximal_kg.map(NotNegative::get),
            distal_kg: self.distal_kg.map(NotNegative::get),
            tool_kg: self.tool_kg.get(),
        }
    }
}

/// Inertia and friction of a five-bar arm. Pairs list the left arm before the right.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct ArmModel {
    /// Inertia of each motor, reflected to the link, kg m^2. Above 0.
    #[garde(dive)]
    pub motor_kg_m2: [Positive; 2],
    /// Mass of each proximal link, a uniform rod, kg. 0 or above.
    #[garde(dive)]
    pub proximal_kg: [NotNegative; 2],
    /// Mass of each distal link, a uniform rod, kg. 0 or above.
    #[garde(dive)]
    pub distal_kg: [NotNegative; 2],
    /// Mass at the tool, kg. 0 or above.
    #[garde(dive)]
    pub tool_kg: NotNegative,
    /// Coulomb friction of each joint, N m. 0 or above.
    #[garde(dive)]
    pub coulomb_n_m: [NotNegative; 2],
    /// Viscous friction of each joint, N m s/rad. 0 or above.
    #[garde(dive)]
    pub viscous_n_m_s_per_rad: [NotNegative; 2],
}

impl ArmModel {
    /// The parameters of the dynamics.
    pub fn mass_model(&self) -> yieldwall_motion::linkage::MassModel {
        yieldwall_motion::linkage::MassModel {
            motor_kg_m2: self.motor_kg_m2.map(Positive::get),
            proximal_kg: self.proximal_kg.map(NotNegative::get),
            distal_kg: self.distal_kg.map(NotNegative::get),
            tool_kg: self.tool_kg.get(),
        }
    }
}
