//! Commands that a build has with the feature `full` alone: their crates take as long to compile as a tenth of the program. `lacking.rs`
//! stands in their place without it.

pub(super) use super::bug_report::{Arguments as Report, run as report};
pub(super) use super::manual::{Completions, Man, completions, man};
