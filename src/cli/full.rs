//! Commands that only a build with the feature `full` has: their crates take a tenth of the program's compile time. `lacking.rs`
//! replaces them in other builds.

pub(super) use super::bug_report::{Arguments as Report, run as report};
pub(super) use super::manual::{Completions, Man, completions, man};
