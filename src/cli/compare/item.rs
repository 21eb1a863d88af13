//! An item to compare: a run, or a recording.

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use serde_json::{Value, json};

use super::super::ending::rig_failure;
use super::super::failure::Failure;
use super::super::interrupt::{interrupted, unless};
use super::super::output::Output;
use super::super::progress::Progress;
use super::super::replay::{damage, failure, open, recording_file};
use super::not_kept;
use yieldwall_config::{self as config, Document, Source};
use yieldwall_motion::guard::State;
use yieldwall_record::recording::{About, Machine, Recording};
use yieldwall_record::{FaultMark, Row, Trace};
use yieldwall_rig::report::measures::Measures;
use yieldwall_rig::report::{Overrides, RunReport, Stage, Watch, replay, run_device, run_rig};

/// The first bytes of a recording.
const MCAP: &[u8] = b"\x89MCAP";

/// A run or a recording.
pub(super) struct Item {
    pub(super) label: char,
    /// As it was named.
    pub(super) name: String,
    what: &'static str,
    pub(super) trace: Trace,
    pub(super) measures: Measures,
    pub(super) period_s: f64,
    /// Machine, scene and profiles, as they were run.
    pub(super) document: Value,
}

impl Item {
    /// Runs or reads the named item.
    pub(super) fn of(
        name: &str,
        label: char,
        overrides: &Overrides,
        is_interrupted: &AtomicBool,
        progress: &Progress,
        output: &mut Output,
    ) -> Result<Self, Failure> {
        if is_recording(Path::new(name)) {
            return Self::read(name, label, output);
        }
        progress.begin(name);
        let source = Source::named(name);
        let mut is_broken_off = false;
        let mut onward = |stage: Stage| {
            progress.at(stage);
            let onward = unless(is_interrupted);
            is_broken_off = onward.is_break();
            onward
        };
        let (what, about, report) = match config::load(source.clone())? {
            Document::Device(device) => {
                output.configuration(&device.warnings)?;
                let scene = device.scene()?.value;
                let about = replay::about_device(&device.value, &scene, overrides);
                ("device", about, run_device(&device.value, &scene, overrides, |_| (), &mut onward))
            }
            // For any other document, the error names its kind.
            Document::Rig(_)
            | Document::Scene(_)
            | Document::Figure(_)
            | Document::Profile(_)
            | Document::Simulation(_)
            | Document::ErrorCodes(_) => {
                let rig = config::load_rig(source)?;
                output.configuration(&rig.warnings)?;
                let scene = rig.scene()?.value;
                let about = replay::about(&rig.value, Some(&scene), overrides);
                ("rig", about, run_rig(&rig.value, &scene, overrides, Watch::default(), &mut onward))
            }
        };
        let report = report.map_err(|error| rig_failure(&error))?;
        if is_broken_off {
            return Err(interrupted(report.simulated_s()));
        }
        let about = about.map_err(|error| not_kept("documents of the run", error))?;
        let RunReport { trace, measures, period_s, .. } = report;
        let document = document(&about)?;
        Ok(Self { label, name: name.to_owned(), what, trace, measures, period_s, document })
    }

    fn read(name: &str, label: char, output: &mut Output) -> Result<Self, Failure> {
        let path = recording_file(Path::new(name));
        let mut recording = open(&path)?;
        let (trace, measures) = replay::recorded(&mut recording).map_err(|error| failure(&path, error))?;
        output.warnings(&damage(recording.damage(), &path));
        let document = document(recording.about())?;
        let what = match recording {
            Recording::Rig(_) => "recording of a rig",
            Recording::Device(_) => "recording of a device",
        };
        let period_s = period_s(&document);
        Ok(Self { label, name: name.to_owned(), what, trace, measures, period_s, document })
    }

    /// Returns the duration of the run, s.
    pub(super) fn time_s(&self) -> f64 {
        self.trace.rows.len() as f64 * self.period_s
    }

    /// Returns the time for which faults held it at rest, s.
    pub(super) fn held_s(&self) -> f64 {
        let is_held = |row: &&Row| row.supervisor_state == State::Holding as u8;
        self.trace.rows.iter().filter(is_held).count() as f64 * self.period_s
    }

    /// Returns the fault that stopped it.
    fn stopped_by(&self) -> Option<&FaultMark> {
        self.trace.faults.last().filter(|_| !self.trace.after.is_empty())
    }

    pub(super) fn line(&self) -> String {
        let end = match self.stopped_by() {
            Some(mark) => format!(", stopped by {} at {:.3} s", mark.fault, mark.time_s),
            None => String::new(),
        };
        format!("{}  {}: {} {}, {:.1} s{end}", self.label, self.name, self.what, self.trace.title, self.time_s())
    }

    pub(super) fn to_json(&self) -> Value {
        json!({
            "label": self.label,
            "name": self.name,
            "what": self.what,
            "machine": self.trace.title,
            "time_s": self.time_s(),
            "held_s": self.held_s(),
            "stopped_by": self.stopped_by().map(|mark| mark.fault),
            "stopped_at_s": self.stopped_by().map(|mark| mark.time_s),
            "measures": self.measures,
        })
    }
}

/// Whether a path is that of a recording, or of a folder with one in it.
fn is_recording(path: &Path) -> bool {
    let file = recording_file(path);
    if !std::fs::metadata(&file).is_ok_and(|metadata| metadata.is_file()) {
        // What is not there is named by its ending.
        return file.extension().is_some_and(|ending| ending == "mcap");
    }
    let mut head = [0; MCAP.len()];
    File::open(&file).and_then(|mut file| file.read_exact(&mut head)).is_ok() && head == MCAP
}

/// Returns the full definition of the run, as one document.
fn document(about: &About) -> Result<Value, Failure> {
    let value = match about.machine {
        Machine::Rig(_) => serde_json::to_value(replay::rig(about)?),
        Machine::Device(_) => serde_json::to_value(replay::device(about)?),
    };
    let mut value = value.map_err(|error| not_kept("document of the machine", error))?;
    // The comparison covers the scene itself, and ignores its file's name.
    for pointer in ["/simulation", ""] {
        if let Some(Value::Object(group)) = value.pointer_mut(pointer) {
            group.remove("scene");
        }
    }
    if let Some(mut scene) = replay::scene(about)? {
        scene.seed = about.seed;
        value["scene"] = serde_json::to_value(scene).map_err(|error| not_kept("scene", error))?;
    }
    for (name, text) in &about.profiles {
        let profile = config::load_profile(Source::memory(name, text.clone()))?.value;
        value["profiles"][name] = serde_json::to_value(profile).map_err(|error| not_kept("profile", error))?;
    }
    if !about.overrides.is_empty() {
        value["overrides"] = about.overrides.clone().into();
    }
    Ok(value)
}

fn period_s(document: &Value) -> f64 {
    1e-6 * document.pointer("/cycle/period_us").and_then(Value::as_f64).unwrap_or_default()
}
