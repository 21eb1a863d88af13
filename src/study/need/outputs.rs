//! Outputs of a scene, and by how much of its tolerance they change from one model to another.

use yieldwall_config::SceneTolerance;
use yieldwall_rig::RigError;
use yieldwall_rig::report::RunReport;
use yieldwall_rig::report::measures::Measures;

/// An output of a scene.
struct Output {
    column: &'static str,
    of: fn(&Measures) -> Option<f64>,
    tolerance: fn(&SceneTolerance) -> f64,
}

const OUTPUTS: [Output; COUNT] = [
    // Whether a proxy that comes to rest on the surface touches it once or twice is no output.
    Output { column: "impacts", of: |m| Some(m.impacts.len() as f64), tolerance: |_| f64::INFINITY },
    Output { column: "unintended_releases", of: |m| Some(f64::from(m.unintended_releases)), tolerance: |_| 0.5 },
    Output { column: "penetration_mm", of: |m| Some(m.penetration_mm), tolerance: |t| *t.distance_mm },
    Output { column: "tool_depth_mm", of: tool_depth_mm, tolerance: |t| *t.distance_mm },
    Output { column: "tool_rms_on_surface_mm", of: |m| m.tool_rms_on_surface_mm, tolerance: |t| *t.distance_mm },
    Output { column: "tool_max_on_surface_mm", of: |m| m.tool_max_on_surface_mm, tolerance: |t| *t.distance_mm },
    Output { column: "peak_force_on_surface_n", of: |m| m.peak_force_on_surface_n, tolerance: |t| *t.force_n },
    Output { column: "peak_torque_n_m", of: |m| m.peak_torque_n_m, tolerance: |t| *t.torque_n_m },
    Output { column: "energy_given_mj", of: |m| Some(1e3 * m.energy_given_j), tolerance: |t| *t.energy_mj },
];

const COUNT: usize = 9;

/// Returns the name of an output in the space that a line of the text has.
pub(super) fn short(column: &str) -> &str {
    match column {
        "unintended_releases" => "releases",
        "penetration_mm" => "proxy depth",
        "tool_depth_mm" => "tool depth",
        "tool_rms_on_surface_mm" => "tool RMS",
        "tool_max_on_surface_mm" => "tool max",
        "peak_force_on_surface_n" => "force",
        "peak_torque_n_m" => "torque",
        "energy_given_mj" => "energy",
        other => other,
    }
}

fn tool_depth_mm(measures: &Measures) -> Option<f64> {
    measures.impacts.iter().map(|impact| impact.tool_depth_mm).max_by(f64::total_cmp)
}

/// The end of a run that no fault stopped.
pub(super) const RAN: &str = "ran";

/// Outcome of a run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Outcome {
    /// Its end, in a word.
    pub(crate) end: String,
    /// The outputs, in the order of their columns; `None` for a run that could not be made.
    pub(super) values: Option<[Option<f64>; COUNT]>,
    /// Time that the scene ran, in s.
    pub(super) simulated_s: f64,
}

/// The output that changes most.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Change {
    pub(super) column: &'static str,
    /// By how much; infinite where it appears or vanishes.
    pub(super) change: f64,
    /// The change over the scene's tolerance, 0 or above.
    pub(super) over_tolerance: f64,
}

/// Names of the columns of the outputs.
#[cfg(test)]
pub(super) fn columns() -> [&'static str; COUNT] {
    OUTPUTS.map(|output| output.column)
}

impl Outcome {
    pub(crate) fn of(run: &Result<RunReport, RigError>) -> Self {
        match run {
            Err(error) => Self { end: error.to_string(), values: None, simulated_s: 0.0 },
            Ok(run) => {
                let end = match run.cause {
                    _ if !run.is_stopped() => RAN.to_owned(),
                    cause => format!("stopped by {}", cause.map_or("a fault", |cause| cause.fault.row().name)),
                };
                let values = OUTPUTS.each_ref().map(|output| (output.of)(&run.measures));
                Self { end, values: Some(values), simulated_s: run.simulated_s() }
            }
        }
    }

    /// The output that differs most from that of a reference, over its tolerance; `None` if one of them was not run to an end.
    pub(super) fn change_from(&self, reference: &Self, tolerance: &SceneTolerance) -> Option<Change> {
        let (was, is) = (reference.values.as_ref()?, self.values.as_ref()?);
        let change = |((output, was), is): ((&Output, &Option<f64>), &Option<f64>)| {
            let change = match (was, is) {
                (Some(was), Some(is)) => is - was,
                (None, None) => 0.0,
                _ => f64::INFINITY,
            };
            // An output without a tolerance changes nothing, also where it appears.
            let over_tolerance = match (output.tolerance)(tolerance) {
                tolerance if tolerance.is_finite() => (change / tolerance).abs(),
                _ => 0.0,
            };
            Change { column: output.column, change, over_tolerance }
        };
        let changes = OUTPUTS.iter().zip(was).zip(is).map(change);
        changes.max_by(|one, other| one.over_tolerance.total_cmp(&other.over_tolerance))
    }
}

/// Whether no output changes by more than its tolerance, and the run ends as the reference does.
pub(super) fn is_alike(outcome: &Outcome, reference: &Outcome, change: Option<Change>) -> bool {
    outcome.end == reference.end && change.is_some_and(|change| change.over_tolerance <= 1.0)
}
