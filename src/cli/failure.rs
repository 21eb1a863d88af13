//! Reason for the failure of a command, and its exit code.

use std::path::Path;
use std::process::ExitCode;

use yieldwall_config::{Diagnostic, Report};
use yieldwall_rig::batch::LinesError;

/// Exit code of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// All went well.
    Ok = 0,
    /// A fault of this program.
    Internal = 1,
    /// The arguments make no sense.
    Usage = 2,
    /// A configuration, a recording or a file of results was refused.
    ConfigInvalid = 3,
    /// The bus or its interface is not there.
    BusUnavailable = 4,
    /// A device is missing or is another one than configured.
    DeviceMismatch = 5,
    /// A device is in fault.
    DeviceFault = 6,
    /// A check gave a result out of its tolerance.
    OutOfTolerance = 7,
    /// A safety limit stopped the rig.
    SafetyStop = 8,
    /// The cycle missed its timing.
    TimingMissed = 9,
    /// Ctrl-C.
    Interrupted = 130,
}

/// Meaning of an exit code.
pub(super) struct Meaning {
    /// The exit code.
    pub(super) exit: Exit,
    /// Meaning in one line, as the help prints it.
    pub(super) brief: &'static str,
    /// Further facts, such as the meaning for single commands; empty if there are none.
    pub(super) more: &'static str,
    /// Next step, empty if there is none.
    pub(super) next: &'static str,
}

const fn meaning(exit: Exit, brief: &'static str, more: &'static str, next: &'static str) -> Meaning {
    Meaning { exit, brief, more, next }
}

/// All exit codes, for the help and for `yieldwall explain`.
pub(super) const EXITS: [Meaning; 11] = [
    meaning(Exit::Ok, "ok", "the command did its task", ""),
    meaning(
        Exit::Internal,
        "internal error",
        "a defect of this program",
        "`yieldwall report` writes a file for a bug report",
    ),
    meaning(
        Exit::Usage,
        "usage",
        "wrong command line, or a file could not be written",
        "`--help` after the command lists its options",
    ),
    meaning(
        Exit::ConfigInvalid,
        "configuration, recording or kept results invalid",
        "run, config check: a file of the rig; replay, plot, compare: a recording; study, sweep: kept points; commission --resume: a report",
        "the message names file and line; `yieldwall config check FILE` checks again",
    ),
    meaning(
        Exit::BusUnavailable,
        "interface or bus unavailable",
        "run, sim, scan: the interface is missing or down; on EtherCAT: another master, or no reply",
        "`yieldwall doctor --bus INTERFACE` finds out why",
    ),
    meaning(
        Exit::DeviceMismatch,
        "device missing or refusing, or identity mismatch",
        "run, drill, commission: a device is missing or has another identity; od, reg, sii: the device refuses or does not answer; sensor: no \
         valid sample",
        "`yieldwall scan --bus INTERFACE` lists the devices",
    ),
    meaning(
        Exit::DeviceFault,
        "device in fault",
        "run, drill: a drive reported a fault; state: the fault remains after a reset; home: a homing error",
        "`yieldwall state NODE` shows the error code",
    ),
    meaning(
        Exit::OutOfTolerance,
        "check out of tolerance",
        "run: energy or torque limit; commission, drill, home: a step; od diff, sii, replay: a difference; soak: an invariant; od \
         dump: an uncertain value",
        "the message names the measured value and its limit",
    ),
    meaning(
        Exit::SafetyStop,
        "stopped by a safety limit",
        "run, jog, tune loop: a fault stopped the rig; home: a joint is blocked or moved too far; state: the drive still has torque",
        "`yieldwall explain FAULT` explains the fault that the message names",
    ),
    meaning(
        Exit::TimingMissed,
        "timing requirement not met",
        "run --bus: the host misses its limit or has no record of `latency`; doctor: a setting of the host",
        "`yieldwall latency` measures this host",
    ),
    meaning(
        Exit::Interrupted,
        "interrupted",
        "Ctrl-C or SIGTERM ended the command",
        "the same command continues where results are kept: `study`, `sweep` and `soak --out`",
    ),
];

/// Returns the exit codes, as the help prints them.
pub(super) fn exit_codes() -> String {
    let lines = EXITS.iter().map(|meaning| format!("\n  {:<3}  {}", meaning.exit.code(), meaning.brief));
    ["Exit codes:".to_owned()].into_iter().chain(lines).collect()
}

impl Exit {
    /// Returns the number.
    pub const fn code(self) -> u8 {
        self as u8
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

/// Combines the ends of two parts of a command that may both fail: the result reports both failures, and the first one gives the
/// exit code.
pub(super) fn both(first: Result<(), Failure>, then: Result<(), Failure>) -> Result<(), Failure> {
    match (first, then) {
        (Err(mut first), Err(then)) => {
            first.report.diagnostics.extend(then.report.diagnostics);
            Err(first)
        }
        (first, then) => first.and(then),
    }
}

/// Returns the first line of a report: `ok` with its facts, or the failure with its exit code.
pub(super) fn verdict(end: &Result<(), Failure>, ok: impl FnOnce() -> String) -> String {
    match end {
        Ok(()) => format!("verdict   ok: {}", ok()),
        Err(failure) => {
            let why = failure.report.diagnostics.first().map_or("", |first| first.message.as_str());
            format!("verdict   NOT OK (exit code {}): {why}", failure.exit.code())
        }
    }
}

/// Failure of a command.
#[derive(Debug)]
pub struct Failure {
    /// Exit code of the program.
    pub exit: Exit,
    /// Report to print; empty if everything was printed before.
    pub report: Report,
}

impl Failure {
    /// Creates a failure outside of any file: the event, and the next step, if there is one.
    pub fn new(exit: Exit, message: impl Into<String>, help: impl Into<String>) -> Self {
        let mut diagnostic = Diagnostic::about_file("", message, help);
        diagnostic.help = diagnostic.help.filter(|help| !help.is_empty());
        Self { exit, report: diagnostic.into() }
    }
}

impl Failure {
    /// Returns a failure of a file, which the message names as well.
    pub(super) fn about_file(exit: Exit, file: &Path, message: impl Into<String>, help: impl Into<String>) -> Self {
        let mut failure = Self::new(exit, message, help);
        failure.report.diagnostics.iter_mut().for_each(|finding| finding.file = file.display().to_string());
        failure
    }
}

impl From<&LinesError> for Failure {
    fn from(error: &LinesError) -> Self {
        let (exit, help) = match error {
            LinesError::Busy { .. } => (Exit::Usage, "wait until it has ended, or choose another folder"),
            LinesError::Line { .. } => (
                Exit::ConfigInvalid,
                "the file was changed, or another version wrote it: delete it, or choose another folder",
            ),
            LinesError::NoFile { .. } => (Exit::Usage, "move it away, or choose another folder"),
            LinesError::Io { .. } => (Exit::Usage, "choose a folder you can write to"),
        };
        Self::new(exit, error.to_string(), help)
    }
}

impl From<Report> for Failure {
    fn from(report: Report) -> Self {
        Self { exit: Exit::ConfigInvalid, report }
    }
}
