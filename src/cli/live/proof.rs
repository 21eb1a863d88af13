//! What has to be shown before a rig on a real bus is enabled.

use std::path::PathBuf;

use super::PaceArgument;
use crate::cli::failure::{Exit, Failure};
use crate::cli::keep::state_folder;
use crate::cli::run::{Arguments, NOTHING_ENABLED, judge, rig_failure};
use crate::cli::{drill, latency};
use crate::config;
use crate::host::system::computer;
use crate::host::{Kept, Untimely};
use crate::rig;
use crate::run::{NotProven, Proof, RunError, Unproven};

/// What has to be shown of drives and computer.
pub(super) struct Demanded {
    /// Of the drives.
    pub(super) proof: Proof,
    /// Of the computer, by the records in this folder; nothing where nothing has to be in time.
    measurements: Option<PathBuf>,
}

impl Demanded {
    /// What this computer has proved of its timing; nothing where nothing has to be in time.
    pub(super) fn timing(
        &self,
        rig: &config::Rig,
        has_priority: bool,
        has_locked_memory: bool,
    ) -> Option<Result<Kept, Untimely>> {
        let folder = self.measurements.as_ref()?;
        Some(computer(has_priority, has_locked_memory).check(rig, folder, latency::now_unix_s()))
    }
}

/// In lockstep nothing measures time on the bus; the devices have to be simulated then. Their kind is drilled in virtual time.
pub(super) fn proof(pace: PaceArgument, rig: &config::Rig, scene: &config::Scene) -> Result<Demanded, Failure> {
    if pace == PaceArgument::Free {
        let drills = state_folder("drills").ok_or_else(drill::no_home)?;
        let measurements = state_folder("latency").ok_or_else(latency::no_home)?;
        return Ok(Demanded { proof: Proof::OnRecord(drills), measurements: Some(measurements) });
    }
    judge(&rig::drill(rig, scene, |_| ()).map_err(|error| rig_failure(&error))?, rig, NOTHING_ENABLED)?;
    Ok(Demanded { proof: Proof::InVirtualTime, measurements: None })
}

/// Why the rig did not come to run.
#[derive(Debug, thiserror::Error)]
pub(super) enum NotRun {
    #[error(transparent)]
    Run(#[from] RunError),
    #[error(transparent)]
    Unproven(#[from] Unproven),
    #[error(transparent)]
    Untimely(#[from] Untimely),
}

impl From<NotProven> for NotRun {
    fn from(error: NotProven) -> Self {
        match error {
            NotProven::Run(error) => Self::Run(error),
            NotProven::Unproven(error) => Self::Unproven(error),
        }
    }
}

/// The failure that drives are whose watchdogs nobody has tried, or that failed.
pub(super) fn unproven(error: &Unproven, buses: &str, arguments: &Arguments) -> Failure {
    let help = format!("nothing was enabled; `yieldwall drill {} {buses}` tries them", arguments.rig);
    let exit = match error {
        Unproven::Missing { .. } | Unproven::Unreadable { .. } => Exit::DeviceMismatch,
        Unproven::Unsafe(_) => Exit::OutOfTolerance,
    };
    Failure::new(exit, error.to_string(), help)
}

/// The failure that a computer is that has not proved the timing which the rig asks for.
pub(super) fn untimely(error: &Untimely, rig: &config::Rig) -> Failure {
    let period_us = rig.cycle.period_us;
    // Long enough for tier B, with a reserve.
    let duration_s = (10 * period_us).div_ceil(1000).max(60);
    let measure = format!("`yieldwall latency --period-us {period_us} --duration {duration_s}` measures it");
    let next = match error {
        Untimely::Missing { .. } => measure,
        Untimely::Late { .. } => {
            format!(
                "give the computer less to do or the rig a slower cycle, grant what docs/realtime.md says; {measure}"
            )
        }
        Untimely::Limit { .. } => "lower the limit, or prove tier A as docs/realtime.md says".to_owned(),
    };
    let help = format!("nothing was sent; {next}; --ignore-latency runs the rig all the same, and recordings say so");
    Failure::new(Exit::TimingMissed, error.to_string(), help)
}
