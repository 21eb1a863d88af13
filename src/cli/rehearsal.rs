//! Prediction of the result of `run` for a rig or a device, from a simulation of its own scene.

use std::ops::ControlFlow;

use super::ending::{SOFTER_COUPLING, above_bound, rig_failure};
use super::failure::Failure;
use super::run::judge_run;
use super::unsafe_drives::{NOTHING_ENABLED, judge};
use serde_json::{Value, json};

use yieldwall_config::{self as config, Diagnostic, ImpedanceDevice, Loaded, Rig, Severity};
use yieldwall_motion::guard::Fault;
use yieldwall_rig::report::measures::Measures;
use yieldwall_rig::report::{Overrides, RunReport, Watch, run_device, run_rig};
use yieldwall_rig::{self as rig, RigError};

/// Longest simulated part of a scene, in s: a check is no study.
pub(super) const LONGEST_S: f64 = 60.0;

/// Result of a simulated scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Rehearsal {
    /// Duration of the run, s.
    simulated_s: f64,
    /// Time for which faults held the rig at rest, s.
    pub(super) held_s: f64,
    /// Distance of the tool from the traced surface, RMS in mm; of all contacts if it traced none.
    pub(super) tracing_mm: Option<f64>,
    /// Reason why `run` fails with it, at the limit that ends the run.
    pub(super) finding: Option<Diagnostic>,
}

impl Rehearsal {
    fn of(report: &RunReport) -> Self {
        let Measures { tool_rms_tracing_mm, tool_rms_on_surface_mm, .. } = report.measures;
        let tracing_mm = tool_rms_tracing_mm.or(tool_rms_on_surface_mm);
        Self { simulated_s: report.simulated_s(), held_s: report.held_s, tracing_mm, finding: None }
    }

    /// Returns the line for a person, if all is well.
    pub(super) fn line(&self) -> Option<String> {
        let held = match self.held_s {
            0.0 => "without a fault".to_owned(),
            held_s => format!("held at rest for {held_s:.3} s by a fault"),
        };
        let traced = self.tracing_mm.map(|mm| format!("; tracing error {mm:.3} mm RMS")).unwrap_or_default();
        self.finding.is_none().then(|| format!("scene simulated for {:.1} s, {held}{traced}", self.simulated_s))
    }

    /// Returns the data for a program.
    pub(super) fn to_json(&self) -> Value {
        json!({ "is_ok": self.finding.is_none(), "simulated_s": self.simulated_s, "held_s": self.held_s, "tracing_mm": self.tracing_mm })
    }
}

/// Runs the scene of a rig; nothing of a rig without a simulation.
pub(super) fn of_rig(rig: &Loaded<Rig>) -> Option<Rehearsal> {
    let scene = rig.scene().ok()?.value;
    Some(rehearse(&rig.value, &scene).unwrap_or_else(|(at, failure)| Rehearsal {
        finding: Some(told(rig, &at, &failure, &scene)),
        ..Rehearsal::default()
    }))
}

/// Runs the scene of an impedance device.
pub(super) fn of_device(device: &Loaded<ImpedanceDevice>) -> Option<Rehearsal> {
    let scene = device.scene().ok()?.value;
    let failure = match run_device(&device.value, &scene, &shortened(&scene), |_| (), |_| ControlFlow::Continue(())) {
        Ok(report) if report.measures.is_within_bound() => return Some(Rehearsal::of(&report)),
        Ok(report) => above_bound(&report.measures, &device.value.device.name, SOFTER_COUPLING),
        Err(error) => rig_failure(&error),
    };
    let finding = Some(told(device, "fixture.coupling", &failure, &scene));
    Some(Rehearsal { finding, ..Rehearsal::default() })
}

fn rehearse(rig: &Rig, scene: &config::Scene) -> Result<Rehearsal, (String, Failure)> {
    let drilled = rig::drill(rig, scene, |_| ()).map_err(|error| of_error(&error))?;
    judge(&drilled, rig, NOTHING_ENABLED).map_err(|failure| ("drives".to_owned(), failure))?;
    let report = run_rig(rig, scene, &shortened(scene), Watch::default(), |_| ControlFlow::Continue(()))
        .map_err(|error| of_error(&error))?;
    judge_run(&report, rig, scene, &[]).map_err(|failure| (key_of(&report), failure))?;
    Ok(Rehearsal::of(&report))
}

fn shortened(scene: &config::Scene) -> Overrides {
    Overrides { duration_s: Some(scene.duration_s.min(LONGEST_S)), ..Overrides::default() }
}

fn told<T>(document: &Loaded<T>, at: &str, failure: &Failure, scene: &config::Scene) -> Diagnostic {
    let [first, ..] = failure.report.diagnostics.as_slice() else {
        return document.finding(Severity::Warning, at, "the rig's own scene does not run", "run the scene", &[]);
    };
    let length_s = scene.duration_s.min(LONGEST_S);
    let message = format!(
        "in {length_s} s of its own scene `run` ends with exit code {}: {}",
        failure.exit.code(),
        first.message
    );
    // Advice to run the check helps nobody during the check, and neither does advice for a rig that has run.
    let advice =
        first.help.as_deref().filter(|help| !help.contains("config check") && !help.starts_with("start the run again"));
    let help = advice.unwrap_or("check the other messages, and the scene");
    document.finding(Severity::Warning, at, message, help, &[("simulation.scene", "the scene")])
}

fn of_error(error: &RigError) -> (String, Failure) {
    let at = match error {
        RigError::NotEnabled { cause: Some(cause), .. } => key_of_fault(cause.fault),
        RigError::NotEnabled { .. } | RigError::Boot(_) => "drives",
        RigError::Arm(_) => "simulation.arm",
        _ => "simulation",
    };
    (at.to_owned(), rig_failure(error))
}

/// Returns the key of the fault that ended a run or held it longest, or of the energy that the run gave.
fn key_of(report: &RunReport) -> String {
    let held = report.held_by.iter().max_by(|one, other| one.1.total_cmp(&other.1)).map(|(fault, _)| *fault);
    let stopped = report.cause.filter(|_| report.is_stopped()).map(|cause| cause.fault);
    stopped.or(held).map_or("fixture.coupling", key_of_fault).to_owned()
}

/// Returns the key of the number behind a fault, or of the simulation's if no number of the rig is.
fn key_of_fault(fault: Fault) -> &'static str {
    match fault {
        Fault::SensorInvalid | Fault::SensorStuck | Fault::SensorStale | Fault::SensorLost => "sensor.sample_rate_hz",
        Fault::SensorSaturated => "sensor.range_counts",
        Fault::ForceStep => "guard.force_step_limit_n",
        Fault::ForceLimit => "guard.force_limit_n",
        Fault::ForceImplausible => "guard.residual_limit_n_m",
        Fault::EnergyLimit => "guard.energy_limit_j",
        Fault::Chatter => "fixture.coupling",
        Fault::FollowingError | Fault::Runaway | Fault::DriveFault => "guard.following_error_limit_rad",
        Fault::OverSpeed => "guard.tool_speed_limit_m_per_s",
        Fault::WorkspaceEdge | Fault::WorkspaceLeft | Fault::Posture => "guard.singularity_margin_m",
        Fault::EncoderJump => "drives",
        Fault::PdoMissed | Fault::PdoLate => "cycle.compute_at_us",
        _ => "simulation",
    }
}
