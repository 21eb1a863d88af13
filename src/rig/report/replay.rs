//! Recordings made, run again and drawn.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::PathBuf;
use std::sync::Arc;

use super::measures::Measures;
use super::run::{Overrides, RunLog, measured, measured_device};
use crate::{ImpedanceLoop, RigError};
use yieldwall_config::{self as config, Report, Source};
use yieldwall_motion::guard::Request;
use yieldwall_record::recording::{
    About, Difference, Machine, ReadError, Reader, Recorded, Recording, difference, encode,
};
use yieldwall_record::{CycleRecord, DeviceRecord, Trace};
use yieldwall_run::assembly;

const SCENE: &str = "scene.yaml";

/// Returns the description for a recording of a run with these documents. Without a scene the rig has no simulation in it.
///
/// # Errors
/// When a document cannot be written; no checked one cannot.
pub fn about(rig: &config::Rig, scene: Option<&config::Scene>, overrides: &Overrides) -> Result<About, String> {
    let fixture = overrides.fixture.as_ref().unwrap_or(&rig.fixture).clone();
    let mut effective = config::Rig { fixture, ..rig.clone() };
    match (scene, &mut effective.simulation) {
        (Some(_), Some(simulation)) => SCENE.clone_into(&mut simulation.scene),
        (None, simulation) => *simulation = None,
        (Some(_), None) => {}
    }
    let mut profiles = BTreeMap::new();
    for (name, profile) in effective.name_profile_files() {
        profiles.insert(name, config::to_yaml(&*profile)?);
    }
    about_run(Machine::Rig(config::to_yaml(&effective)?), scene, profiles, overrides)
}

/// Returns the description for a recording of an impedance device.
///
/// # Errors
/// As [`about`].
pub fn about_device(
    device: &config::ImpedanceDevice,
    scene: &config::Scene,
    overrides: &Overrides,
) -> Result<About, String> {
    let fixture = overrides.fixture.as_ref().unwrap_or(&device.fixture).clone();
    let effective = config::ImpedanceDevice { fixture, scene: SCENE.to_owned(), ..device.clone() };
    about_run(Machine::Device(config::to_yaml(&effective)?), Some(scene), BTreeMap::new(), overrides)
}

fn about_run(
    machine: Machine,
    scene: Option<&config::Scene>,
    profiles: BTreeMap<String, String>,
    overrides: &Overrides,
) -> Result<About, String> {
    let seed = overrides.seed.map(|seed| format!("--seed {seed}"));
    let duration = overrides.duration_s.map(|duration| format!("--duration {duration}"));
    Ok(About {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        commit: String::new(),
        target: yieldwall_run::built::TARGET.to_owned(),
        machine,
        scene: scene.map(config::to_yaml).transpose()?.unwrap_or_default(),
        profiles,
        seed: overrides.seed.or(scene.map(|scene| scene.seed)).unwrap_or_default(),
        overrides: [duration, seed].into_iter().flatten().collect::<Vec<_>>().join(" "),
        is_damaged: false,
    })
}

/// Returns the documents of a recording as files in one folder; the first is the machine's.
fn documents(about: &About) -> Source {
    let name = about.machine.name();
    let profiles = about.profiles.iter().map(|(name, text)| (name.as_str(), text.as_str()));
    let texts = [(name, about.machine.document()), (SCENE, &about.scene)].into_iter().chain(profiles);
    Source::among(name, texts.map(|(name, text)| (PathBuf::from(name), Arc::from(text))))
}

/// Returns the recorded rig.
///
/// # Errors
/// If its documents are refused, as they are when they are read from files.
pub fn rig(about: &About) -> Result<config::Rig, Report> {
    Ok(config::load_rig(documents(about))?.value)
}

/// Returns the recorded impedance device.
///
/// # Errors
/// As [`rig()`].
pub fn device(about: &About) -> Result<config::ImpedanceDevice, Report> {
    Ok(config::load_device(documents(about))?.value)
}

/// Returns the recorded scene; `None` for a rig on a bus without one.
///
/// # Errors
/// As [`rig()`].
pub fn scene(about: &About) -> Result<Option<config::Scene>, Report> {
    if about.scene.is_empty() {
        return Ok(None);
    }
    Ok(Some(config::load_scene(Source::memory(SCENE, about.scene.clone()))?.value))
}

/// Why a recording could not be run again or drawn.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The file.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The documents in it.
    #[error("the documents in it are refused")]
    Config(#[from] Report),
    /// The machine that they describe.
    #[error(transparent)]
    Rig(#[from] RigError),
}

/// How far a recording was run again.
#[derive(Clone, Debug, PartialEq)]
pub struct Replay {
    /// Cycles that gave again what was recorded, bit by bit.
    pub cycles: u64,
    /// Why it ended.
    pub end: End,
}

/// Why a replay ended.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// All cycles were run.
    Whole,
    /// A cycle gave something else.
    Different {
        /// Number of the cycle.
        index: u64,
        /// Time of the scene in s; minus infinity before it.
        scene_time_s: f64,
        /// The first field that differs: what was recorded, and what the replay gave.
        difference: Difference,
    },
    /// Cycles are missing, so that what the stages remember is not known.
    Gap {
        /// Number of the cycle that should have come.
        expected: u64,
        /// Number of the cycle that came.
        found: u64,
    },
}

/// Runs what was recorded again on what entered it, from the first record on, and compares what left it.
///
/// # Errors
/// If the recording cannot be read, or its machine not be built.
pub fn replay_any<R: Read>(recording: &mut Recording<R>) -> Result<Replay, ReplayError> {
    match recording {
        Recording::Rig(reader) => replay(reader),
        Recording::Device(reader) => replay_device(reader),
    }
}

/// Refuses a damaged description: a replay of it would compare another machine.
fn undamaged(about: &About) -> Result<&About, ReadError> {
    if about.is_damaged { Err(ReadError::DamagedDescription) } else { Ok(about) }
}

/// Replays the cycles of a rig, from the first one after the boot.
///
/// # Errors
/// As [`replay_any`].
pub fn replay<R: Read>(reader: &mut Reader<R>) -> Result<Replay, ReplayError> {
    let rig = rig(undamaged(reader.about())?)?;
    let mut cycle = assembly::cycle(&rig, &rig.fixture).map_err(RigError::from)?;
    again(reader, |CycleRecord { moment, inputs, truth, .. }| {
        let outputs = cycle.step(inputs);
        Ok(CycleRecord::new(*moment, inputs, &outputs, cycle.cause(), *truth))
    })
}

/// Replays the samples of an impedance device.
///
/// # Errors
/// As [`replay_any`].
pub fn replay_device<R: Read>(reader: &mut Reader<R, DeviceRecord>) -> Result<Replay, ReplayError> {
    let device = device(undamaged(reader.about())?)?;
    let mut control = None;
    again(reader, |record| {
        let begun = match control.take() {
            Some(begun) => begun,
            None => ImpedanceLoop::new(&device, &device.fixture, record.reported_m)?,
        };
        Ok(control.insert(begun).step(record))
    })
}

fn again<R: Read, T: Recorded>(
    reader: &mut Reader<R, T>,
    mut step: impl FnMut(&T) -> Result<T, RigError>,
) -> Result<Replay, ReplayError> {
    let (mut before, mut after) = (Vec::new(), Vec::new());
    let mut cycles = 0;
    while let Some(recorded) = reader.next_record()? {
        let index = recorded.index();
        if index != cycles {
            return Ok(Replay { cycles, end: End::Gap { expected: cycles, found: index } });
        }
        let again = step(&recorded)?;
        encode(&recorded, &mut before);
        encode(&again, &mut after);
        if before != after
            && let Some(difference) = difference(&recorded, &again)
        {
            let end = End::Different { index, scene_time_s: recorded.scene_time_s(), difference };
            return Ok(Replay { cycles, end });
        }
        cycles += 1;
    }
    Ok(Replay { cycles, end: End::Whole })
}

/// Returns the trace of a recording and its measures, which equal those of the recorded run.
///
/// # Errors
/// As [`replay_any`].
pub fn recorded<R: Read>(recording: &mut Recording<R>) -> Result<(Trace, Measures), ReplayError> {
    match recording {
        Recording::Rig(reader) => {
            let rig = rig(reader.about())?;
            let mut seen = RunLog::default();
            while let Some(record) = reader.next_record()? {
                // From the begin of the scene to the stop at its end; after a fault that stopped the rig, all there is.
                let is_asked = record.inputs.request != Request::None && !seen.is_stopped();
                if record.moment.scene_time_s >= 0.0 && !is_asked {
                    seen.take(record.row(), record.directive.state, record.cause);
                }
            }
            Ok(measured(&rig, &rig.fixture, seen))
        }
        Recording::Device(reader) => {
            let device = device(reader.about())?;
            let mut rows = Vec::new();
            while let Some(record) = reader.next_record()? {
                rows.push(record.row());
            }
            Ok(measured_device(&device, &device.fixture, rows))
        }
    }
}
