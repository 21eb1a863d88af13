//! Studies over whole rigs and over parts of them: the figures of the paper, and the charts of speed, accuracy and stability.

pub mod bench;
mod control;
mod cycle;
pub mod drawing;
mod drawn;
mod hold;
mod literature;
mod machine;
pub mod need;
mod nudge;
pub mod page;
pub mod pair;
pub mod plant;
pub mod reproduce;
#[cfg(test)]
#[path = "../sample.rs"]
mod sample;
pub mod settings;
mod speed;
mod stability;
pub mod sweep;
mod task;

pub use yieldwall_figures::chart;

use std::path::PathBuf;
use std::sync::Arc;

use thiserror::Error;

/// Options of a study that a user may choose.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Program that runs the scene of `plant` in MuJoCo.
    pub mujoco: Option<PathBuf>,
    /// Machine and scene of `need` in place of the shipped ones.
    pub own: Option<Arc<need::Subject>>,
}

/// Why a study cannot do with its options.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OptionsError {
    /// The study runs nothing in MuJoCo.
    #[error("the study {name} runs nothing in MuJoCo")]
    WithoutMujoco {
        /// The study.
        name: String,
    },
    /// The program does not run MuJoCo.
    #[error("MuJoCo does not run: {why}")]
    Mujoco {
        /// Message of the program, or the reason why it cannot be started or understood.
        why: String,
    },
}

impl Options {
    /// Whether the study `name` takes these options, and, if it is to compute, whether a program among them works: it is
    /// run for one cycle.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn check(&self, name: &str, computes: bool) -> Result<(), OptionsError> {
        match &self.mujoco {
            None => Ok(()),
            Some(_) if name != PLANT => Err(OptionsError::WithoutMujoco { name: name.to_owned() }),
            Some(program) if computes => {
                plant::try_mujoco(program).map(drop).map_err(|why| OptionsError::Mujoco { why })
            }
            Some(_) => Ok(()),
        }
    }

    /// Version of the MuJoCo that takes part, by a run of one cycle; `None` without one, or where it does not run.
    pub fn mujoco_version(&self) -> Option<String> {
        plant::try_mujoco(self.mujoco.as_deref()?).ok()
    }
}

/// The study that MuJoCo takes part in.
pub const PLANT: &str = "plant";
/// The study that takes a machine of the user's own.
pub const NEED: &str = "need";

/// Names of all studies.
pub const NAMES: [&str; 10] =
    ["control", "cycle", "hold", "literature", NEED, "pair", PLANT, "speed", "stability", "task"];

/// A study by its name.
pub fn study(name: &str, options: &Options) -> Option<Box<dyn sweep::Study>> {
    Some(match name {
        "control" => Box::new(control::Control::new()),
        "cycle" => Box::new(cycle::CycleStudy::new()),
        "hold" => Box::new(hold::Hold::new()),
        "literature" => Box::new(literature::Literature::new()),
        NEED => Box::new(need::Need::new(options.own.clone())),
        "pair" => Box::new(pair::PairStudy::new()),
        PLANT => Box::new(plant::Integration::new(options.mujoco.clone())),
        "speed" => Box::new(speed::Speed::new()),
        "stability" => Box::new(stability::Stability::new()),
        "task" => Box::new(task::Task::new()),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_is_refused_where_none_is_used_or_where_it_does_not_run() {
        let none = Options::default();
        let absent = Options { mujoco: Some("no-such-program".into()), ..Options::default() };
        assert!(NAMES.iter().all(|name| none.check(name, true).is_ok()));
        for name in NAMES.into_iter().filter(|name| *name != PLANT) {
            assert!(matches!(absent.check(name, false), Err(OptionsError::WithoutMujoco { .. })), "{name}");
        }
        let error = absent.check(PLANT, true).unwrap_err();
        assert!(error.to_string().starts_with("MuJoCo does not run: no-such-program: "), "{error}");
        assert_eq!(absent.check(PLANT, false), Ok(()), "points that are there need no program");
    }
}
