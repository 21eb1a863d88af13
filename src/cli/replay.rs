//! `yieldwall replay`: a recording's cycles, run again and compared.

use std::fs::File;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::ending::rig_failure;
use super::failure::{self, Exit, Failure};
use super::output::Output;
use yieldwall_config::{Diagnostic, Severity};
use yieldwall_record::recording::{self, About, Damage, ReadError, Recording};
use yieldwall_rig::report::replay::{End, ReplayError, replay_any};
use yieldwall_run::recorder::MCAP;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Recording: a cycles.mcap, its folder, or a black-box file
    #[arg(value_name = "RECORDING")]
    recording: PathBuf,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let path = &recording_file(&arguments.recording);
    let mut recording = open(path)?;
    let found = warn_of_version(recording.about(), path);
    output.warnings(&found);
    let replayed = replay_any(&mut recording).map_err(|error| failure(path, error))?;
    let damage = damage(recording.damage(), path);
    output.warnings(&damage);
    let (cycles, records) = (replayed.cycles, records(&recording));
    let record = records.trim_end_matches('s');
    let failure = match &replayed.end {
        End::Whole if cycles > 0 => None,
        End::Whole => {
            Some(refuse(path, &format!("holds no {record}"), "record one with `yieldwall run RIG.yaml --record DIR`"))
        }
        End::Different { index, scene_time_s, difference } => Some(Failure::new(
            Exit::OutOfTolerance,
            format!(
                "{}: {record} {index} (scene {scene_time_s:.3} s) differs in {}: {} was recorded, {} was computed; the {cycles} \
                 {records} before are byte-identical",
                path.display(),
                difference.field,
                difference.one,
                difference.other
            ),
            "replay with the program that recorded it: `yieldwall record info` names it",
        )),
        End::Gap { expected, found } => {
            let gap = if found > expected {
                format!("misses the {records} {expected} to {}", found - 1)
            } else {
                format!("has {record} {found} where {record} {expected} should be")
            };
            let message = format!(
                "{gap}: {cycles} {records} are byte-identical, and what the stages remember afterwards is not known"
            );
            let help = "only a recording from the first cycle after the boot on can be run again; a black box can be \
                        drawn with `yieldwall plot`";
            Some(refuse(path, &message, help))
        }
    };
    if output.is_json() {
        let difference = match &replayed.end {
            End::Different { index, difference, .. } => json!({
                "cycle": index,
                "field": difference.field,
                "recorded": difference.one,
                "replayed": difference.other,
            }),
            _ => json!(null),
        };
        let all: Vec<&Diagnostic> =
            found.iter().chain(&damage).chain(failure.iter().flat_map(|failure| &failure.report.diagnostics)).collect();
        output.report(json!({
            "recording": path,
            "identical_cycles": cycles,
            "is_identical": failure.is_none(),
            "difference": difference,
            "exit_code": failure.as_ref().map_or(0, |failure| failure.exit.code()),
            "diagnostics": all,
        }))?;
        let silent = |failure: Failure| Failure {
            exit: failure.exit,
            report: yieldwall_config::Report { diagnostics: Vec::new() },
        };
        return failure.map_or(Ok(()), |failure| Err(silent(failure)));
    }
    let end = failure.map_or(Ok(()), Err);
    output.news(&failure::verdict(&end, || format!("{cycles} {records}, byte-identical")))?;
    end
}

/// Returns the file of a recording; a recorded folder stands for the file in it.
pub(super) fn recording_file(path: &Path) -> PathBuf {
    let inside = path.join(MCAP);
    if inside.is_file() { inside } else { path.to_owned() }
}

/// Opens a recording.
pub(super) fn open(path: &Path) -> Result<Recording<File>, Failure> {
    recording::open(path).map_err(|error| read_failure(path, &error))
}

/// Returns the name of its records.
pub(super) fn records(recording: &Recording<File>) -> &'static str {
    match recording {
        Recording::Rig(_) => "cycles",
        Recording::Device(_) => "samples",
    }
}

pub(super) fn read_failure(path: &Path, error: &ReadError) -> Failure {
    let name = path.display().to_string();
    let is_configuration = match error {
        ReadError::Io(_) => name.starts_with("builtin:"),
        _ => name.ends_with(".yaml"),
    };
    if is_configuration {
        return refuse(
            path,
            "is a configuration, not a recording",
            &format!("record one with `yieldwall run {name} --record DIR`"),
        );
    }
    let help = match error {
        ReadError::Io(_) => "check the path",
        ReadError::NotMcap => "name a cycles.mcap or the file of a black box",
        ReadError::NoDescription(_) => "it is not a recording of this program, or was cut before its first cycle",
        ReadError::DamagedDescription => {
            "it cannot be run again; its cycles can be read: `yieldwall record info`, `yieldwall plot`"
        }
        ReadError::OtherMachine { .. } => "name a recording of the other kind",
        ReadError::OtherFields { .. } => "use the program of that version; other readers of MCAP can read it",
    };
    // The content of a file may have control characters.
    refuse(path, &error.to_string().escape_debug().to_string(), help)
}

pub(super) fn failure(path: &Path, error: ReplayError) -> Failure {
    match error {
        ReplayError::Read(error) => read_failure(path, &error),
        ReplayError::Config(report) => report.into(),
        ReplayError::Rig(error) => rig_failure(&error),
    }
}

fn refuse(path: &Path, message: &str, help: &str) -> Failure {
    let report = Diagnostic::about_file(path.display().to_string(), format!("{} {message}", path.display()), help);
    Failure { exit: Exit::ConfigInvalid, report: report.into() }
}

fn warning(path: &Path, message: &str, help: &str) -> Diagnostic {
    let message = format!("{} {message}", path.display());
    Diagnostic { severity: Severity::Warning, ..Diagnostic::about_file(path.display().to_string(), message, help) }
}

/// Returns the program that made a recording: version, commit and processor, as far as the recording names them.
pub(super) fn maker(about: &About) -> String {
    let mut text = format!("version {}", about.version.escape_debug());
    for (name, value) in [("commit", &about.commit), ("built for", &about.target)] {
        if !value.is_empty() {
            text.push_str(&format!(", {name} {}", value.escape_debug()));
        }
    }
    text
}

/// Returns a warning, if another version of the program made the recording.
fn warn_of_version(about: &About, path: &Path) -> Vec<Diagnostic> {
    let own = env!("CARGO_PKG_VERSION");
    let message = format!("was recorded by {} of this program, and this is version {own}", maker(about));
    let help = "a difference may come from the program";
    if about.version == own { Vec::new() } else { vec![warning(path, &message, help)] }
}

/// Returns a warning for each place at which something of the file is lost.
pub(super) fn damage(damage: &[Damage], path: &Path) -> Vec<Diagnostic> {
    let help = "`yieldwall record repair` writes what is left into a whole file";
    let one = |damage| warning(path, &format!("is damaged at {damage}"), help);
    damage.iter().map(one).collect()
}
