//! A figure of the paper: its machine, its scene, and the windows that are drawn enlarged.

use std::collections::BTreeMap;

use garde::Validate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::fixture::Fixture;
use crate::number::{Finite, Positive, nullable, present};

/// A figure to reproduce: one run for each machine and each hold time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Figure {
    /// Title above the figure.
    #[garde(length(min = 1))]
    pub title: String,
    /// Rig files by label, relative to this file. Either `rigs` or `device` is given.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub rigs: BTreeMap<String, String>,
    /// Impedance device file, relative to this file. Either `rigs` or `device` is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Scene file, relative to this file; it replaces the scene of the machine.
    #[garde(length(min = 1))]
    pub scene: String,
    /// N_wait of each run in steps; replaces `hold_steps` of the fixture.
    #[garde(length(min = 1), inner(range(max = 10_000)))]
    pub hold_steps: Vec<u32>,
    /// A fixture that replaces the fixture of the machine, or null to keep it.
    #[garde(dive)]
    #[serde(deserialize_with = "present")]
    #[schemars(schema_with = "nullable::<Fixture>")]
    pub fixture: Option<Fixture>,
    /// Windows that are drawn enlarged in a figure with several hold times, in place of positions over time; may be empty.
    #[garde(dive)]
    pub magnify: Vec<MagnifiedWindow>,
}

/// A square window of a figure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct MagnifiedWindow {
    /// Centre, m.
    pub center_m: [Finite; 2],
    /// Half of the side, m. Above 0.
    #[garde(dive)]
    pub half_width_m: Positive,
}
