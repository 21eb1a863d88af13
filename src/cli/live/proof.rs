//! What has to be shown before a rig on a real bus is enabled.

use crate::cli::ending::rig_failure;
use crate::cli::failure::{Exit, Failure};
use crate::cli::keep::state_folder;
use crate::cli::latency::now_unix_s;
use crate::cli::pace::PaceArgument;
use crate::cli::run::{NOTHING_ENABLED, judge};
use crate::cli::{drill, latency};
use crate::config;
use crate::host::{Evidence, Untimely};
use crate::rig;
use crate::run::Unproven;

/// In lockstep nothing measures time on the bus; the devices have to be simulated then. Their kind is drilled in virtual time.
pub(in crate::cli) fn evidence(
    pace: PaceArgument,
    rig: &config::Rig,
    scene: Option<&config::Scene>,
) -> Result<Evidence, Failure> {
    if pace == PaceArgument::Free {
        let drills = state_folder("drills").ok_or_else(drill::no_home)?;
        let latency = state_folder("latency").ok_or_else(latency::no_home)?;
        return Ok(Evidence::OnRecord { drills, latency, now_unix_s: now_unix_s() });
    }
    let Some(scene) = scene else {
        let message = "--pace lockstep is for simulated devices, and the rig has no simulation";
        return Err(Failure::new(Exit::Usage, message, "leave --pace away"));
    };
    let drilled = rig::drill(rig, scene, |_| ()).map_err(|error| rig_failure(&error))?;
    judge(&drilled, rig, NOTHING_ENABLED)?;
    Ok(Evidence::InVirtualTime(drilled))
}

/// The failure that drives are whose watchdogs nobody has tried, or that failed.
pub(super) fn unproven(error: &Unproven, buses: &str, file: &str) -> Failure {
    let help = format!("nothing was enabled; `yieldwall drill {file} {buses}` tries them");
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
