//! Studies over whole rigs: the figures of the paper and the measures taken from runs.

#[cfg(feature = "figures")]
pub mod drawing;
pub mod measures;
pub mod reproduce;
mod run;

pub use run::{Overrides, RunReport, Stage, run_device, run_rig};
