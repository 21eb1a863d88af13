//! The trace of a run, the measures taken from it, and a recording run again.

#[cfg(test)]
mod bound_tests;
mod judgement;
pub mod measures;
#[cfg(feature = "recording")]
pub mod replay;
mod run;

pub use judgement::Shortcoming;
pub use run::{
    IMPEDANCE_DEVICE, Overrides, RunLog, RunReport, Stage, drive, measured, measured_device, run_device, run_rig,
};
pub use yieldwall_run::Watch;
