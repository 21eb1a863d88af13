//! Proofs that a rig on a real bus needs before it is enabled.

use std::path::{Path, PathBuf};

use crate::clock::now_unix_s;
use crate::ending::rig_failure;
use crate::failure::{Exit, Failure};
use crate::keep::state_folder;
use crate::masses::Masses;
use crate::pace::PaceArgument;
use crate::unsafe_drives::{NOTHING_ENABLED, advice, judge};
use crate::{drill, latency};
use yieldwall_config::{self as config, Diagnostic};
use yieldwall_rig as rig;
use yieldwall_rig::analysis::{LEAST_MARGINS, has_margins, identified_margins};
use yieldwall_run::host::{Evidence, Untimely};
use yieldwall_run::{MeasuredLoop, Unproven};

/// In lockstep nothing measures time on the bus; the devices have to be simulated then. Their kind is drilled in virtual time.
pub(crate) fn evidence(
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
        let message = "--pace lockstep needs simulated devices, and the rig has no simulation";
        return Err(Failure::new(Exit::Usage, message, "omit --pace"));
    };
    let drilled = rig::drill(rig, scene, |_| ()).map_err(|error| rig_failure(&error))?;
    judge(&drilled, rig, NOTHING_ENABLED)?;
    Ok(Evidence::InVirtualTime(drilled))
}

/// Returns the failure for drives whose watchdogs nobody has tested, or that failed.
pub(super) fn unproven(error: &Unproven, rig: &config::Rig, buses: &str, file: &str) -> Failure {
    let drill = format!("`yieldwall drill {file} {buses}`");
    let (exit, remedy) = match error {
        Unproven::Missing { .. } | Unproven::Unreadable { .. } => (Exit::DeviceMismatch, format!("{drill} tests them")),
        Unproven::Unsafe(error) => {
            (Exit::OutOfTolerance, format!("{}\nAfter a change {drill} tests the drives again", advice(error, rig)))
        }
    };
    Failure::new(exit, error.to_string(), format!("{NOTHING_ENABLED}; {remedy}"))
}

/// Returns the failure for a computer that has not proved the timing that the rig requires.
pub(super) fn untimely(error: &Untimely, rig: &config::Rig) -> Failure {
    let period_us = rig.cycle.period_us;
    // Long enough for tier B, with a reserve.
    let duration_s = (10 * period_us).div_ceil(1000).max(60);
    let measure = format!("`yieldwall latency --period-us {period_us} --duration {duration_s}` measures it");
    let next = match error {
        Untimely::Missing { .. } | Untimely::Unbelieved { .. } | Untimely::Short { .. } => measure,
        Untimely::Late { .. } => {
            format!(
                "reduce the load of this computer, grant the permissions in docs/realtime.md, or choose a longer cycle; {measure}"
            )
        }
        Untimely::Limit { .. } => "lower the limit, or prove tier A (docs/realtime.md)".to_owned(),
    };
    let help = format!("nothing was sent; {next}; --ignore-latency runs the rig anyway, and its recordings note it");
    Failure::new(Exit::TimingMissed, error.to_string(), help)
}

/// Returns the folder with the measurements of `tune loop` on a bus.
pub(crate) fn loops() -> Result<PathBuf, Failure> {
    state_folder("loops").ok_or_else(|| {
        let message = "no folder for the records of loops: neither XDG_STATE_HOME nor HOME is set";
        Failure::new(Exit::Usage, message, "set XDG_STATE_HOME to a permanent folder")
    })
}

/// Checks that the gains of a rig leave enough margin with the delay and the inertia that were measured on a bus, if they were.
pub(super) fn check_measured_loop(
    rig: &config::Loaded<config::Rig>,
    folder: &Path,
    buses: &str,
) -> Result<(), Failure> {
    let again = format!(
        "`yieldwall tune loop {} {buses} --write` measures it again and writes gains with these margins",
        rig.source
    );
    let refused =
        |message: String, help: &str| Failure::new(Exit::OutOfTolerance, message, format!("nothing was sent; {help}"));
    let measured = MeasuredLoop::load(&rig.value, folder)
        .map_err(|error| refused(error.to_string(), &format!("delete the record, or measure again: {again}")))?;
    let Some(MeasuredLoop { joints, .. }) = measured else { return Ok(()) };
    let Some(margins) = identified_margins(&rig.value, &joints).map_err(|error| rig_failure(&error))? else {
        return Ok(());
    };
    let worst = margins.worst.without_friction;
    if has_margins(&worst, LEAST_MARGINS) {
        return Ok(());
    }
    let (gain_db, phase_deg) = LEAST_MARGINS;
    if !worst.stable {
        let message = format!(
            "with the measured delay of {:.2} cycles the gains make the loop unstable at the worst pose along the surface",
            margins.delay_cycles
        );
        return Err(refused(message, &again));
    }
    let message = format!(
        "with the measured delay of {:.2} cycles the worst pose has gain margins of +{:.1}/-{:.1} dB and a phase margin of {:.0} \
         degrees (limits {gain_db} dB, {phase_deg} degrees)",
        margins.delay_cycles, worst.gain_db, worst.gain_reduction_db, worst.phase_deg
    );
    Err(refused(message, &again))
}

/// Returns the findings on the virtual mass from values that were measured on a bus, if there are any.
pub(super) fn measured_masses(rig: &config::Loaded<config::Rig>, folder: &Path) -> Result<Vec<Diagnostic>, Failure> {
    // Virtual masses depend on hands, and the scene has the hand.
    if rig.value.simulation.is_none() {
        return Ok(Vec::new());
    }
    let masses = Masses::of_recorded(rig, &[], folder)?;
    Ok(masses.and_then(|masses| masses.measured_finding(rig)).into_iter().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_run::JointFound;

    #[test]
    fn a_rig_whose_measured_delay_leaves_too_little_margin_is_refused() {
        let folder = std::env::temp_dir().join(format!("yieldwall-measured-{}", std::process::id()));
        let rig = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap();
        assert!(check_measured_loop(&rig, &folder, "--bus can0").is_ok(), "nothing was measured");
        // At the poses at which the simulated arm begins: as the file has it, and 0.6 ms later.
        let refusals = [(1.0e-3, ""), (1.6e-3, "has gain margins of +"), (8e-3, "make the loop unstable")];
        for (delay_s, refusal) in refusals {
            let joint = |pose_rad| JointFound { inertia_kg_m2: 0.34, pose_rad, delay_s, viscous_n_m_s_per_rad: 0.5 };
            let joints = [[2.2, 0.69], [2.1, 0.79]].map(joint);
            MeasuredLoop::new(&rig.value, joints, None).store(&folder).unwrap();
            let checked = check_measured_loop(&rig, &folder, "--bus can0");
            let message = checked.err().map_or(String::new(), |failure| failure.report.diagnostics[0].message.clone());
            assert!(message.contains(refusal) && message.is_empty() == refusal.is_empty(), "{delay_s}: {message}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
