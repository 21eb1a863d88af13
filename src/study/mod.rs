//! Studies over whole rigs: the figures of the paper and the measures taken from runs.

#[cfg(feature = "figures")]
pub mod drawing;
pub mod measures;
#[cfg(feature = "recording")]
pub mod replay;
pub mod reproduce;
mod run;

pub use run::{Overrides, RunReport, Stage, Watch, run_device, run_rig};
