//! What the simulation of a rig needs and a real bus does not.

use garde::Validate;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::arm::ArmModel;
use crate::config::number::{NotNegative, Positive};

/// What the simulation of a rig takes the machine to be, and what happens in it. Nothing of it is used on a real bus.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Simulation {
    /// How frames are timed on the buses.
    pub timing: BusTiming,
    /// Inertia and friction of the arm.
    #[garde(dive)]
    pub arm: ArmModel,
    /// The loop closed inside each drive in position and velocity mode.
    #[garde(dive)]
    pub drive_position_loop: DrivePositionLoop,
    /// File with the scene to run, relative to this file.
    #[garde(length(min = 1))]
    pub scene: String,
}

/// A rig was to be simulated, and its file names no simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the rig has no `simulation`, which only a rig on a real bus does without")]
pub struct NotSimulated;

/// The schema of a simulation in a rig: the document itself, its file, or nothing.
pub(super) fn named_simulation(generator: &mut SchemaGenerator) -> Schema {
    let whole = generator.subschema_for::<Simulation>();
    json_schema!({ "anyOf": [{ "type": "string", "minLength": 1 }, whole, { "type": "null" }] })
}

/// How the embedded simulation times frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BusTiming {
    /// Bits cost time and priorities decide who waits.
    Arbitrated,
    /// Frames arrive at once.
    Ideal,
}

/// The loop closed inside each drive in position and velocity mode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct DrivePositionLoop {
    /// Its period, us; the control period is a whole multiple of it. 10 to 10 000.
    #[garde(range(min = 10, max = 10_000))]
    pub period_us: u32,
    /// Position gain, N m/rad. Above 0.
    #[garde(dive)]
    pub stiffness_n_m_per_rad: Positive,
    /// Velocity gain, N m s/rad. 0 or above.
    #[garde(dive)]
    pub damping_n_m_s_per_rad: NotNegative,
    /// Integral gain, N m/(rad s). 0 or above.
    #[garde(dive)]
    pub integral_n_m_per_rad_s: NotNegative,
}
