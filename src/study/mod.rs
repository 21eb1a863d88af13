//! Studies over whole rigs and over parts of them: the figures of the paper, the measures taken from runs, and the charts
//! of speed, accuracy and stability.

mod ablation;
pub mod bench;
pub mod chart;
mod control;
mod curvature;
#[cfg(feature = "figures")]
pub mod drawing;
mod hold;
mod machine;
pub mod measures;
mod pair;
pub mod plant;
#[cfg(feature = "recording")]
pub mod replay;
pub mod reproduce;
mod run;
mod stability;
pub mod sweep;
mod task;

pub use run::{Overrides, RunReport, Stage, Watch, measured, run_device, run_rig};

use std::path::PathBuf;

/// What a user may choose of a study.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Program that runs the scene of `plant` in MuJoCo.
    pub mujoco: Option<PathBuf>,
}

/// Names of all studies.
pub const NAMES: [&str; 8] = ["ablation", "control", "fixture", "hold", "pair", "plant", "stability", "task"];

/// A study by its name.
pub fn study(name: &str, options: &Options) -> Option<Box<dyn sweep::Study>> {
    Some(match name {
        "ablation" => Box::new(ablation::Ablation::new()),
        "control" => Box::new(control::Control::new()),
        "fixture" => Box::new(curvature::TangentOrExact::new()),
        "hold" => Box::new(hold::Hold::new()),
        "pair" => Box::new(pair::PairStudy::new()),
        "plant" => Box::new(plant::Integration::new(options.mujoco.clone())),
        "stability" => Box::new(stability::Stability::new()),
        "task" => Box::new(task::Task::new()),
        _ => return None,
    })
}
