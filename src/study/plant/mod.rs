//! How fast and how exactly the simulated arm is integrated, beside other methods and beside MuJoCo.
//!
//! All contestants have the same scene, controller and hand. The study times the controller, the steps and the copying of joint
//! angles on one thread, in CPU time, for all contestants in turn.

mod beside;
mod contestant;
mod contrast;
mod events;
mod machine;
mod method;
mod mujoco;
pub(super) mod page;
mod reading;
mod scene;
mod speed;

#[cfg(test)]
mod arm_tests;
#[cfg(test)]
mod tests;

pub use events::Events;
pub use machine::{Motion, STUDY_ARM, StudyArm};
pub use method::{Method, Run};
pub use mujoco::{Effort, MujocoRun, Settings, Softness, run as run_mujoco};
pub use scene::{Aim, CYCLE_S, Gains, HOLD, Plant, STUDY, Scene, Spring, Way, lock, stiff};

use std::path::{Path, PathBuf};

use self::beside::{Hold, Lock, Stiff};
use self::speed::Speed;
use super::sweep::{Report, Study, Sweep, Table};

/// Whether `program` runs MuJoCo: one cycle of a scene, and the version of the library.
///
/// # Errors
/// What it said, or that it cannot be started or understood, in words.
pub(super) fn try_mujoco(program: &Path) -> Result<String, String> {
    let settings = Settings { integrator: "implicitfast", softness: Softness::Default };
    run_mujoco(program, settings, &Scene { cycles: 1, ..HOLD }, CYCLE_S, Effort { warm: 0, repeats: 1 })
        .map(|outcome| outcome.version)
}

/// The study `plant`.
pub(super) struct Integration(Vec<Box<dyn Sweep>>);

impl Integration {
    /// With MuJoCo beside it if there is a program that runs it.
    pub(super) fn new(program: Option<PathBuf>) -> Self {
        let speed = Speed::new(program.clone());
        let (hold, lock) = (Hold { program: program.clone() }, Lock { program: program.clone() });
        Self(vec![Box::new(speed), Box::new(hold), Box::new(Stiff::new(program)), Box::new(lock)])
    }
}

impl Study for Integration {
    fn name(&self) -> &'static str {
        "plant"
    }

    fn about(&self) -> &'static str {
        "error against speed of the simulated arm's integrators, and of MuJoCo's, on one scene"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        match tables {
            [speed, hold, stiff, lock] => reading::read(speed, hold, stiff, lock),
            _ => Report::default(),
        }
    }
}
