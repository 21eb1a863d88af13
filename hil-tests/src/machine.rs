//! The rigs and scenes that come with the program, ready to run.

use yieldwall::config::{self, Source};
use yieldwall::rig::{EmbeddedRig, RigError};

/// A rig with its scene.
#[derive(Clone, Debug)]
pub struct Machine {
    /// The rig.
    pub rig: config::Rig,
    /// The scene.
    pub scene: config::Scene,
}

impl Machine {
    /// The rig `config/{rig}.yaml` with the scene `config/scenes/{scene}.yaml` of this repository.
    ///
    /// # Panics
    /// If one of them is missing or wrong.
    pub fn builtin(rig: &str, scene: &str) -> Self {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../config");
        let rig = config::load_rig(Source::named(&format!("{folder}/{rig}.yaml"))).expect("a rig of the repository");
        let scene = format!("{folder}/scenes/{scene}.yaml");
        let scene = config::load_scene(Source::named(&scene)).expect("a scene of the repository");
        Self { rig: rig.value, scene: scene.value }
    }

    /// The same with another step of the plant.
    ///
    /// # Panics
    /// If the scene has no model of the machine.
    pub fn with_plant_step_us(mut self, step_us: u32) -> Self {
        self.scene.model.as_mut().expect("a scene with a model").plant_step_us = step_us;
        self
    }

    /// Step of the plant in s.
    ///
    /// # Panics
    /// If the scene has no model of the machine.
    pub fn plant_step_s(&self) -> f64 {
        f64::from(self.scene.model.expect("a scene with a model").plant_step_us) * 1e-6
    }

    /// Cycle time in s.
    pub fn period_s(&self) -> f64 {
        f64::from(self.rig.cycle.period_us) * 1e-6
    }

    /// Cycles of the scene.
    pub fn cycles(&self) -> usize {
        (self.scene.duration_s.get() / self.period_s()).round() as usize
    }

    /// The rig, booted and enabled, at the start of the scene.
    ///
    /// # Errors
    /// As [`EmbeddedRig::new`] and [`EmbeddedRig::enable`].
    pub fn enabled(&self) -> Result<EmbeddedRig, RigError> {
        let mut rig = EmbeddedRig::new(&self.rig, &self.scene, &self.rig.fixture, self.scene.seed)?;
        rig.enable()?;
        Ok(rig)
    }
}
