//! Recordings made, run again and drawn.

use std::io::Read;
use std::path::PathBuf;
use std::sync::Arc;

use super::run::{Overrides, trace};
use crate::config::{self, Report, Source};
use crate::guard::{Request, State};
use crate::record::recording::{About, Difference, ReadError, Reader, difference, encode};
use crate::record::{CycleRecord, ForceMeaning, Trace};
use crate::rig::{self, RigError};

const RIG: &str = "rig.yaml";
const SCENE: &str = "scene.yaml";

/// What a recording of a run with these documents says of it.
///
/// # Errors
/// When a document cannot be written; no checked one cannot.
pub fn about(rig: &config::Rig, scene: &config::Scene, overrides: &Overrides) -> Result<About, String> {
    let fixture = overrides.fixture.as_ref().unwrap_or(&rig.fixture).clone();
    let effective = config::Rig { fixture, scene: SCENE.to_owned(), ..rig.clone() };
    let seed = overrides.seed.map(|seed| format!("--seed {seed}"));
    let duration = overrides.duration_s.map(|duration| format!("--duration {duration}"));
    Ok(About {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        commit: env!("YIELDWALL_COMMIT").to_owned(),
        target: env!("YIELDWALL_TARGET").to_owned(),
        rig: config::to_yaml(&effective)?,
        scene: config::to_yaml(scene)?,
        seed: overrides.seed.unwrap_or(scene.seed),
        overrides: [duration, seed].into_iter().flatten().collect::<Vec<_>>().join(" "),
    })
}

/// The rig that was recorded.
///
/// # Errors
/// If its documents are refused, as they are when they are read from files.
pub fn rig(about: &About) -> Result<config::Rig, Report> {
    let texts = [(RIG, &about.rig), (SCENE, &about.scene)];
    let texts = texts.map(|(name, text)| (PathBuf::from(name), Arc::from(text.as_str())));
    Ok(config::load_rig(Source::among(RIG, texts))?.value)
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
    /// The rig that they describe.
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

/// Runs the cycles of a recording again on what entered them, from the first one after the boot, and compares what left
/// them.
///
/// # Errors
/// If the recording cannot be read, or its rig not be built.
pub fn replay<R: Read>(reader: &mut Reader<R>) -> Result<Replay, ReplayError> {
    let rig = rig(reader.about())?;
    let mut cycle = rig::cycle(&rig, &rig.fixture)?;
    let (mut before, mut after) = (Vec::new(), Vec::new());
    let mut cycles = 0;
    while let Some(recorded) = reader.next_record()? {
        if recorded.moment.index != cycles {
            return Ok(Replay { cycles, end: End::Gap { expected: cycles, found: recorded.moment.index } });
        }
        let outputs = cycle.step(&recorded.inputs);
        let CycleRecord { moment, inputs, truth, .. } = recorded;
        let again = CycleRecord::new(moment, &inputs, &outputs, cycle.cause(), truth);
        encode(&recorded, &mut before);
        encode(&again, &mut after);
        if before != after
            && let Some(difference) = difference(&recorded, &again)
        {
            let end = End::Different { index: moment.index, scene_time_s: moment.scene_time_s, difference };
            return Ok(Replay { cycles, end });
        }
        cycles += 1;
    }
    Ok(Replay { cycles, end: End::Whole })
}

/// The trace of a recording, for drawings: the same as that of the run that was recorded.
///
/// # Errors
/// As [`replay`].
pub fn recorded_trace<R: Read>(reader: &mut Reader<R>) -> Result<Trace, ReplayError> {
    let rig = rig(reader.about())?;
    let mut rows = Vec::new();
    let mut was_latched = false;
    while let Some(record) = reader.next_record()? {
        // From the begin of the scene to the stop at its end, or to the fault that stopped the rig.
        if record.moment.scene_time_s >= 0.0 && record.inputs.request == Request::None && !was_latched {
            rows.push(record.row());
        }
        was_latched |= State::is_latched(record.directive.state);
    }
    Ok(trace(rig.rig.name.clone(), &rig.fixture, ForceMeaning::HandOnTool, rows))
}
