//! A machine with its scene, whose models are compared.

use serde::Serialize;
use serde_json::json;

use super::model::{Model, models};
use super::outputs::{Outcome, RAN};
use super::terms::Case;
use crate::machine::Machine;
use yieldwall_config::{
    self as config, BusTiming, Diagnostic, Document, Loaded, Report, SceneTolerance, Severity, Source,
};
use yieldwall_rig::report::Overrides;

/// A machine and a scene with a tolerance.
#[derive(Clone, Debug)]
pub struct Subject {
    pub(super) machine_name: String,
    pub(super) scene_name: String,
    pub(super) machine: Machine,
    pub(super) scene: config::Scene,
    pub(super) tolerance: SceneTolerance,
    pub(super) overrides: Overrides,
    /// From the plainest to the dearest.
    pub(super) models: Vec<Model>,
    /// Place of `simulation.timing`: file and, from 1, line.
    timing_at: String,
    warnings: Vec<Diagnostic>,
}

/// Lines for a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lines {
    /// The file, and what of it the lines replace.
    pub place: String,
    /// YAML.
    pub yaml: String,
}

impl Subject {
    /// Loads a rig with the scene of its simulation, or an impedance device with its scene.
    ///
    /// # Errors
    /// A file that is refused; a file of neither kind; a rig without a simulation; a scene without `tolerance`. Also a rig whose
    /// most expensive model cannot be run, with the reason.
    pub fn load(source: Source) -> Result<Self, Report> {
        let document = config::load(source.clone())?;
        let (machine, scene, warnings, timing_at) = match document {
            Document::Rig(rig) => {
                let timing = rig.finding(Severity::Error, "simulation.timing", "", "", &[]);
                let line = timing.place.map_or_else(String::new, |place| format!(":{}", place.line));
                let scene = rig.scene()?;
                (Machine::Rig(Box::new(rig.value)), scene, rig.warnings, format!("{}{line}", timing.file))
            }
            Document::Device(device) => {
                let scene = device.scene()?;
                (Machine::Device(Box::new(device.value)), scene, device.warnings, String::new())
            }
            _ => {
                let message = format!("{source} is neither a rig nor an impedance device");
                let help = "name a file with a fixture, such as config/paper-admittance.yaml";
                return Err(Diagnostic::about_file(source.to_string(), message, help).into());
            }
        };
        let tolerance = tolerance(&scene)?;
        let mut subject = Self {
            machine_name: source.to_string(),
            scene_name: scene.source.to_string(),
            models: models(&machine, &scene.value, false),
            machine,
            scene: scene.value,
            tolerance,
            overrides: Overrides::default(),
            timing_at,
            warnings,
        };
        subject.keep_what_runs(&source)?;
        Ok(subject)
    }

    /// A shipped machine and scene.
    ///
    /// # Errors
    /// A file that is refused.
    pub(super) fn shipped(case: &Case) -> Result<Self, Report> {
        let (machine, scene, overrides) = case.load()?;
        let source = config::builtin(format!("scenes/{}.yaml", case.scene));
        let tolerance = tolerance(&config::load_scene(source)?)?;
        Ok(Self {
            machine_name: case.machine.to_owned(),
            scene_name: case.scene.to_owned(),
            models: models(&machine, &scene, false),
            machine,
            scene,
            tolerance,
            overrides,
            timing_at: String::new(),
            warnings: Vec::new(),
        })
    }

    /// Findings of its checks that keep nobody from using it.
    pub fn warnings(&self) -> &[Diagnostic] {
        &self.warnings
    }

    /// All that its tables hang on, for one subject to be known from another.
    pub fn text(&self) -> String {
        format!("{:?} {:?} {:?}", self.machine, self.scene, self.overrides)
    }

    /// A file may have `timing: ideal` for a bus that cannot carry its frames; arbitration is then no choice.
    fn keep_what_runs(&mut self, source: &Source) -> Result<(), Report> {
        let run = |subject: &Self| subject.models.last().map(|model| subject.run(model, 0));
        let is_ideal = match &self.machine {
            Machine::Rig(rig) => {
                rig.simulation.as_ref().is_some_and(|simulation| simulation.timing == BusTiming::Ideal)
            }
            Machine::Device(_) => false,
        };
        let mut dearest = run(self);
        if is_ideal && dearest.as_ref().is_some_and(|outcome| outcome.end != RAN) {
            self.models = models(&self.machine, &self.scene, true);
            dearest = run(self);
        }
        match dearest {
            Some(Outcome { end, .. }) if end != RAN => {
                let message = format!("{source}: the model with all terms does not run to its end: {end}");
                let help = format!("`yieldwall run {source}` shows the reason; repair the rig or its scene first");
                Err(Diagnostic::about_file(source.to_string(), message, help).into())
            }
            _ => Ok(()),
        }
    }

    /// Machine and scene with a model.
    pub(super) fn with(&self, model: &Model) -> (Machine, config::Scene) {
        let (mut machine, mut scene) = (self.machine.clone(), self.scene.clone());
        model.apply(&mut machine, &mut scene);
        (machine, scene)
    }

    /// A run with another hand for each round; that of round 0 is the hand of the scene.
    pub(super) fn run(&self, model: &Model, round: u64) -> Outcome {
        let (machine, mut scene) = self.with(model);
        scene.seed = scene.seed.wrapping_add(round);
        Outcome::of(&machine.run(&scene, &self.overrides, |_| {}))
    }

    /// The lines by which the files of the machine have a model; none where they have it.
    pub(super) fn lines(&self, model: &Model) -> Vec<Lines> {
        let (machine, scene) = self.with(model);
        let mut all = Vec::new();
        if let (Machine::Rig(was), Machine::Rig(is)) = (&self.machine, &machine) {
            let [was, is] = [was, is].map(|rig| rig.simulation.as_ref().map(|it| json!({ "timing": it.timing })));
            if was != is {
                let place = format!("{}, in place of `timing` of the simulation", self.timing_at);
                all.push(Lines { place, yaml: changed(&was, &is) });
            }
        }
        if self.scene.model != scene.model {
            all.push(self.of_scene("model", &self.scene.model, &scene.model));
        }
        if self.scene.device_model != scene.device_model {
            all.push(self.of_scene("device_model", &self.scene.device_model, &scene.device_model));
        }
        all
    }

    fn of_scene<T: Serialize>(&self, key: &str, was: &T, is: &T) -> Lines {
        let inner: String = changed(was, is).lines().map(|line| format!("  {line}\n")).collect();
        Lines { place: format!("{}, in place of `{key}`", self.scene_name), yaml: format!("{key}:\n{inner}") }
    }
}

/// The tolerance of a scene.
fn tolerance(scene: &Loaded<config::Scene>) -> Result<SceneTolerance, Report> {
    scene.value.tolerance.ok_or_else(|| {
        let message = "the scene has no `tolerance`: nothing states which changes of an output matter";
        let help = "write one, such as `tolerance: {distance_mm: 0.05, force_n: 1.0, torque_n_m: 1.0, energy_mj: 2.0}`: \
                    changes of depths, of the greatest force and torque, and of the energy given to the hand that do not matter to you";
        scene.finding(Severity::Error, "tolerance", message, help, &[]).into()
    })
}

/// A group as YAML in normal form; a comment has the former value of each key that has another one.
fn changed<T: Serialize>(was: &T, is: &T) -> String {
    let [was, is] = [was, is].map(|value| entries(&config::to_yaml(value).unwrap_or_default()));
    let mut text = String::new();
    for (key, value) in &is {
        let former = was.iter().find(|(other, former)| other == key && former != value);
        let comment = match former.map(|(_, former)| former.trim()) {
            None => String::new(),
            Some(former) if former.contains('\n') => "  # was given".to_owned(),
            Some(former) => format!("  # was {former}"),
        };
        let (first, rest) = value.split_once('\n').unwrap_or((value, ""));
        text += &format!("{key}:{first}{comment}\n{rest}");
    }
    text
}

/// The entries of a group by their keys, each with the rest of its line and the lines below it.
fn entries(yaml: &str) -> Vec<(String, String)> {
    let mut entries: Vec<(String, String)> = Vec::new();
    for line in yaml.lines() {
        match (line.split_once(':'), entries.last_mut()) {
            (Some((key, value)), _) if !line.starts_with([' ', '-']) => {
                entries.push((key.to_owned(), format!("{value}\n")))
            }
            (_, Some((_, above))) => *above += &format!("{line}\n"),
            _ => {}
        }
    }
    entries
}
