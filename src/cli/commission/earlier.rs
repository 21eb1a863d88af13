//! The report of an earlier run, which another run continues.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use super::Machine;
use crate::failure::{Exit, Failure};
use yieldwall_config as config;
use yieldwall_run::commission::{Begin, Commissioned, Figure, STEPS, Step, StepReport, Verdict};
use yieldwall_run::{DriveIdentity, fnv1a};

/// The part of a `--json` document that counts here.
#[derive(Deserialize)]
struct Report {
    version: String,
    rig_hash: String,
    machine: Value,
    drives: Option<[DriveIdentity; 2]>,
    steps: Vec<Reported>,
}

#[derive(Deserialize)]
struct Reported {
    step: String,
    verdict: String,
    does: String,
    what: Option<String>,
    figure: Option<f64>,
    limit: Option<f64>,
    unit: Option<String>,
    reason: Option<String>,
    evidence: BTreeMap<String, String>,
    ran_at_unix_s: Option<u64>,
}

/// An earlier run of the same steps with the same rig file.
pub(super) struct Earlier {
    /// The step with which this run continues.
    pub(super) begin: Begin,
    /// The steps before, and when they ran, s since 1970.
    steps: Vec<(StepReport, Option<u64>)>,
}

/// Returns a hash of the rig file's values, and of the device profiles that it names by their files.
pub(super) fn rig_hash(rig: &config::Rig) -> String {
    let profiles = rig.clone().name_profile_files();
    let profiles: Vec<_> = profiles.iter().map(|(_, profile)| profile.as_ref()).collect();
    // A value of these types has a text.
    let text = serde_json::to_string(&(rig, profiles)).unwrap_or_default();
    format!("{:016x}", fnv1a(text.as_bytes()))
}

/// Returns the kind of machine in the `machine` of a report: a step that passed on one kind proves nothing for another.
fn kind(machine: &Value) -> &'static str {
    match (machine["simulated"] == true, machine["lockstep"] == true) {
        (true, _) => "the simulated machine",
        (_, true) => "simulated devices in lockstep",
        _ => "devices by the wall clock",
    }
}

impl Earlier {
    /// Reads a report, and checks whether this run may continue it.
    pub(super) fn read(file: &Path, rig: &config::Rig, machine: &Machine) -> Result<Self, Failure> {
        let name = file.display();
        let invalid = |message: String, help: &str| Failure::new(Exit::ConfigInvalid, message, help);
        let wanted = "write what `yieldwall commission RIG.yaml --json` has printed, whole";
        let text = fs::read_to_string(file).map_err(|error| invalid(format!("{name}: {error}"), wanted))?;
        let report: Report = serde_json::from_str(&text)
            .map_err(|error| invalid(format!("{name}: no report of a commissioning: {error}"), wanted))?;
        Self::of(report, rig, machine).map_err(|(message, help)| invalid(format!("{name}: {message}"), help))
    }

    fn of(report: Report, rig: &config::Rig, machine: &Machine) -> Result<Self, (String, &'static str)> {
        let anew = "begin anew, without --resume";
        let known = STEPS.map(|step| (step.name(), step.does()));
        let told = report.steps.iter().map(|step| (step.step.as_str(), step.does.as_str()));
        if report.version != env!("CARGO_PKG_VERSION") || !told.eq(known) {
            return Err((
                format!("it is of other steps than those of this version ({})", env!("CARGO_PKG_VERSION")),
                anew,
            ));
        }
        if report.rig_hash != rig_hash(rig) {
            let message = "it is of another rig file, or of this one before it was changed: `rig_hash` is another one";
            return Err((
                message.to_owned(),
                "begin anew, without --resume; --from STEP begins behind what a change does not concern",
            ));
        }
        let (of, at) = (kind(&report.machine), kind(&machine.document()));
        if of != at {
            return Err((format!("it is of {of}, and this run is of {at}"), anew));
        }
        let passed = |step: &Reported| step.verdict == Verdict::Pass.name();
        let first = report.steps.iter().rposition(passed).map_or(0, |last| last + 1);
        let Some(from) = STEPS.get(first).copied() else {
            return Err(("its last step has passed: nothing is left to do".to_owned(), anew));
        };
        if first > 0 && report.drives.is_none() {
            return Err(("`drives` is null: that run did not look who the drives are".to_owned(), anew));
        }
        let drives = report.drives.filter(|_| first > 0);
        let steps = report.steps.into_iter().zip(STEPS).take(first);
        Ok(Self { begin: Begin { from, drives }, steps: steps.map(|(step, which)| step.report(which)).collect() })
    }

    /// Returns the result of a step that is not repeated.
    pub(super) fn verdict(&self, step: Step) -> Option<Verdict> {
        self.steps.iter().find(|(report, _)| report.step == step).map(|(report, _)| report.verdict)
    }

    /// Returns the number of steps that passed.
    pub(super) fn passed(&self) -> usize {
        self.steps.iter().filter(|(step, _)| step.verdict == Verdict::Pass).count()
    }

    /// Replaces the skipped steps with those of the earlier run, and states for each when it ran.
    pub(super) fn complete(self, mut commissioned: Commissioned, now_unix_s: u64) -> (Commissioned, Vec<(Step, u64)>) {
        let mut ran = Vec::new();
        for (mut earlier, at) in self.steps {
            let Some(step) = commissioned.steps.iter_mut().find(|step| step.step == earlier.step) else { continue };
            // The identity of the drives was checked again.
            if step.verdict != Verdict::Skipped {
                continue;
            }
            let before = at.map(|at| now_unix_s.saturating_sub(at) as f64 / 3600.0);
            let when = before.map_or(String::new(), |hours| format!(", {hours:.1} h before the end of this one"));
            earlier.evidence.push(("taken".to_owned(), format!("by an earlier run{when}")));
            ran.extend(at.map(|at| (earlier.step, at)));
            *step = earlier;
        }
        (commissioned, ran)
    }
}

impl Reported {
    fn report(self, step: Step) -> (StepReport, Option<u64>) {
        let figure = self.what.zip(self.figure).zip(self.limit).map(|((what, value), limit)| Figure {
            what: what.into(),
            value,
            limit,
            unit: self.unit.unwrap_or_default().into(),
        });
        let verdict = [Verdict::Pass, Verdict::Fail].into_iter().find(|verdict| verdict.name() == self.verdict);
        let report = StepReport {
            step,
            verdict: verdict.unwrap_or(Verdict::Skipped),
            figure,
            reason: self.reason,
            evidence: self.evidence.into_iter().collect(),
            curves: Vec::new(),
        };
        (report, self.ran_at_unix_s)
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::sync::Arc;

    use serde_json::json;

    use super::{Earlier, Machine, Report, rig_hash};
    use yieldwall_config::{Source, load_rig};
    use yieldwall_drives::profiles::SHIPPED;

    #[cfg(target_os = "linux")]
    #[test]
    fn what_passed_on_another_kind_of_machine_is_not_gone_on_from() {
        let rig = load_rig(Source::named("builtin:paper-admittance.yaml")).unwrap().value;
        let simulated =
            |defects: &[&str]| Machine::Simulated { defects: defects.iter().map(|it| (*it).to_owned()).collect() };
        let on_bus = |is_lockstep| Machine::OnBus { buses: vec!["main=can0".to_owned()], is_lockstep };
        let refused = |of: &Machine, at: &Machine| {
            let steps = yieldwall_run::commission::STEPS
                .map(|step| json!({ "step": step.name(), "verdict": "fail", "does": step.does(), "evidence": {} }));
            let report = json!({
                "version": env!("CARGO_PKG_VERSION"), "rig_hash": rig_hash(&rig), "machine": of.document(), "drives": null, "steps": steps,
            });
            let report: Report = serde_json::from_value(report).unwrap();
            Earlier::of(report, &rig, at).err().map(|(message, _)| message)
        };
        // A defect that is mended is no other machine, nor is an interface of another name.
        assert_eq!(refused(&simulated(&["weak-motor"]), &simulated(&[])), None);
        assert_eq!(refused(&on_bus(false), &on_bus(false)), None);
        for (of, at, expected) in [
            (
                simulated(&[]),
                on_bus(false),
                "it is of the simulated machine, and this run is of devices by the wall clock",
            ),
            (
                on_bus(true),
                on_bus(false),
                "it is of simulated devices in lockstep, and this run is of devices by the wall clock",
            ),
        ] {
            assert_eq!(refused(&of, &at).as_deref(), Some(expected));
        }
    }

    #[test]
    fn a_rig_whose_profile_file_was_changed_is_another_one() {
        let rig = Source::named("builtin:paper-admittance.yaml").read().unwrap();
        let rig = rig.replace("profile: simulated-servo", "profile: own.yaml");
        let (_, servo) = SHIPPED.iter().find(|(name, _)| *name == "simulated-servo").unwrap();
        let hash = |profile: &str| {
            let files = [("rig.yaml", rig.as_str()), ("own.yaml", profile)];
            let files = files.map(|(name, text)| (PathBuf::from(name), Arc::from(text)));
            rig_hash(&load_rig(Source::among("rig.yaml", files)).unwrap().value)
        };
        assert_eq!(hash(servo), hash(servo));
        assert_ne!(hash(servo), hash(&servo.replace("tried: simulation", "tried: never")));
    }
}
