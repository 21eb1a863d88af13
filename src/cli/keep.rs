//! Words for the files that a run leaves on disk.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::ending::{bus_names, describe};
use super::failure::{Exit, Failure};
use super::replace::{no_folder, unwritten};
use yieldwall_config::{self as config, Diagnostic, Report, Severity};
use yieldwall_record::DeviceRecord;
use yieldwall_record::recording::{About, Saved};
use yieldwall_run::Watch;
use yieldwall_run::recorder::{self, RecorderError, RunFile, RunRecorder, Wanted, Watched};

/// Returns the description of a recording, with the commit of this program.
pub(super) fn described(about: Result<About, String>) -> Result<About, Failure> {
    let about =
        about.map_err(|error| Failure::new(Exit::Internal, format!("documents of the recording: {error}"), ""))?;
    Ok(About { commit: super::commit().to_owned(), ..about })
}

/// Files under way.
pub(super) struct Keep {
    buses: Vec<String>,
    recorder: RunRecorder,
}

/// Files that a run left.
pub(super) struct RunFiles {
    /// Names of the buses.
    buses: Vec<String>,
    files: Vec<RunFile>,
    black_boxes: Vec<Saved>,
}

impl Keep {
    /// Creates the files, and returns the observer of the rig.
    pub(super) fn start(
        watched: Watched<'_>,
        rig: &config::Rig,
        about: &About,
        wanted: &Wanted<'_>,
    ) -> Result<(Self, Watch), Failure> {
        let usual = state_folder("black-box").filter(|_| wanted.record.is_none());
        let wanted = Wanted { black_box: wanted.black_box.or(usual.as_deref()), ..*wanted };
        let started = RunRecorder::start(watched, rig, about, &wanted);
        let (recorder, watch) = started.map_err(|error| failure(&error))?;
        Ok((Self { buses: bus_names(rig), recorder }, watch))
    }

    /// Makes the files of an impedance device, and the closure that takes its samples.
    pub(super) fn start_device(
        device: &config::ImpedanceDevice,
        about: &About,
        record: Option<&Path>,
    ) -> Result<(Self, impl FnMut(&DeviceRecord) + use<>), Failure> {
        let started = RunRecorder::start_device(device, about, record);
        let (recorder, observer) = started.map_err(|error| failure(&error))?;
        Ok((Self { buses: Vec::new(), recorder }, observer))
    }

    /// Waits until everything is in its file.
    pub(super) fn finish(self) -> Result<RunFiles, Failure> {
        let recorder::RunFiles { files, black_boxes } = self.recorder.finish().map_err(|error| failure(&error))?;
        Ok(RunFiles { buses: self.buses, files, black_boxes })
    }
}

fn failure(error: &RecorderError) -> Failure {
    match error {
        RecorderError::Folder { path, error } => no_folder(path, error),
        RecorderError::Exists { path } => {
            let help = "name another folder; recordings are never overwritten, not even with --force";
            Failure::about_file(Exit::Usage, path, format!("{error}: nothing was run"), help)
        }
        RecorderError::File { path, error } => unwritten(path, error),
        RecorderError::NoThread { .. } | RecorderError::Panicked(_) => {
            Failure::new(Exit::Internal, error.to_string(), "")
        }
    }
}

/// `$XDG_STATE_HOME/yieldwall/NAME`, by default below `~/.local/state`; `None` without a home.
pub(super) fn state_folder(name: &str) -> Option<PathBuf> {
    let of = |variable| std::env::var_os(variable).map(PathBuf::from).filter(|path: &PathBuf| path.is_absolute());
    let state = of("XDG_STATE_HOME").or_else(|| of("HOME").map(|home| home.join(".local/state")))?;
    Some(state.join("yieldwall").join(name))
}

impl RunFiles {
    /// Returns a line for each file.
    pub(super) fn lines(&self) -> Vec<String> {
        let files = self.files.iter().filter(|file| file.what != "frames").map(|file| {
            let (kept, what) = (file.end.counts.kept, file.what);
            format!("recorded  {kept} {what} into {}", file.path.display())
        });
        let boxes = self.black_boxes.iter().filter_map(|saved| {
            let path = saved.file.as_ref().ok()?;
            Some(format!(
                "kept      black box of {} at {}: {}",
                saved.cause.fault.row().name,
                when(saved),
                path.display()
            ))
        });
        files.chain(boxes).collect()
    }

    /// Returns the warnings of records that a slow disk lost, and of black boxes that were not written.
    pub(super) fn warnings(&self) -> Vec<Diagnostic> {
        let warning = |file: &str, message: String, help: &str| Diagnostic {
            severity: Severity::Warning,
            ..Diagnostic::about_file(file, message, help)
        };
        let slow = self.files.iter().filter(|file| file.end.counts.lost() > 0 && file.end.error.is_none());
        let files = slow.map(|file| Diagnostic {
            severity: Severity::Warning,
            ..lost(file, "the disk was too slow", "the run itself went on; record to a faster disk")
        });
        let boxes = self.black_boxes.iter().filter_map(|saved| {
            let error = saved.file.as_ref().err()?;
            let message = format!("no black box of {} at {}: {error}", saved.cause.fault.row().name, when(saved));
            Some(warning("", message, "name a folder that can be written with --black-box"))
        });
        files.chain(boxes).collect()
    }

    /// Fails if a file that was asked for could not be written.
    ///
    /// # Errors
    /// If there is such a file.
    pub(super) fn is_written(&self) -> Result<(), Failure> {
        let help = "the run itself went on; make room on the disk, or name a file on another one";
        let unwritten = self.files.iter().filter_map(|file| Some((file, file.end.error.as_ref()?)));
        let diagnostics: Vec<Diagnostic> =
            unwritten.map(|(file, error)| lost(file, &error.to_string(), help)).collect();
        if diagnostics.is_empty() { Ok(()) } else { Err(Failure { exit: Exit::Usage, report: Report { diagnostics } }) }
    }

    /// Adds the black box of the last fault to the failure's help.
    pub(super) fn point_to_black_box(&self, mut failure: Failure) -> Failure {
        let file = self.black_boxes.last().and_then(|saved| saved.file.as_ref().ok());
        if let (Some(file), Some(finding)) = (file, failure.report.diagnostics.last_mut()) {
            let path = format!("what happened around it is in {}", file.display());
            finding.help = Some(match finding.help.take() {
                Some(help) if !help.is_empty() => format!("{help}; {path}"),
                _ => path,
            });
        }
        failure
    }

    pub(super) fn files_json(&self) -> Value {
        let file = |file: &RunFile| {
            let counts = file.end.counts;
            json!({
                "file": file.path,
                "what": file.what,
                "kept": counts.kept,
                "dropped": counts.dropped,
                "refused": counts.refused,
                "error": file.end.error.as_ref().map(ToString::to_string),
            })
        };
        self.files.iter().map(file).collect()
    }

    pub(super) fn black_boxes_json(&self) -> Value {
        let saved = |saved: &Saved| {
            json!({
                "fault": saved.cause.fault.row().name,
                "where": describe(saved.cause, &self.buses),
                "state": format!("{:?}", saved.state),
                "time_s": saved.scene_time_s.is_finite().then_some(saved.scene_time_s),
                "file": saved.file.as_ref().ok(),
                "error": saved.file.as_ref().err().map(ToString::to_string),
            })
        };
        self.black_boxes.iter().map(saved).collect()
    }
}

/// Returns the finding that a file has lost items.
fn lost(file: &RunFile, why: &str, help: &str) -> Diagnostic {
    let (counts, what) = (file.end.counts, file.what);
    let all = counts.kept + counts.lost();
    let path = file.path.display().to_string();
    let message = format!("{path}: {} of {all} {what} are lost: {why}", counts.lost());
    Diagnostic::about_file(path, message, help)
}

fn when(saved: &Saved) -> String {
    if saved.scene_time_s.is_finite() { format!("{:.3} s", saved.scene_time_s) } else { "enabling".to_owned() }
}
