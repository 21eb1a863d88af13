//! Findings on one file before a command uses it.

use serde_json::{Value, json};

use super::super::bus::{Plan, plans, to_json};
use super::super::margins::{Margins, has_other_inertia};
use super::super::masses::Masses;
use super::super::rehearsal::{self, Rehearsal};
use super::super::tune;
use yieldwall_config::{self as config, Diagnostic, Document, ImpedanceDevice, Loaded, Report, Rig, Severity, Source};
use yieldwall_rig::analysis::{Coupled, coupled_device};

/// A file, with its findings and computed results.
pub(crate) struct Checked {
    pub(crate) result: Result<Document, Report>,
    pub(crate) findings: Vec<Diagnostic>,
    margins: Option<Margins>,
    masses: Option<Masses>,
    coupled: Option<Coupled>,
    pub(super) rehearsal: Option<Rehearsal>,
}

impl Checked {
    /// Reads a file, and computes the results that need no run.
    pub(crate) fn of(source: Source) -> Self {
        let result = config::load(source);
        let mut findings = match &result {
            Ok(document) => document.warnings().to_vec(),
            Err(report) => report.diagnostics.clone(),
        };
        let (rig, device) = (rig(&result), device(&result));
        let margins = rig.map(|rig| Margins::of(&rig.value));
        let is_unstable = margins.as_ref().is_some_and(Margins::is_unstable);
        let masses = rig.filter(|_| !is_unstable).and_then(|rig| Masses::of(rig, &[]).ok());
        let coupled = device.and_then(|device| coupled_device(&device.value, 1.0).ok().flatten());
        if let Some(rig) = rig {
            findings.extend(plans(&rig.value).iter().flatten().filter_map(|plan| plan.finding(rig)));
            if !has_other_inertia(rig) {
                findings.extend(masses.as_ref().and_then(|masses| masses.finding(rig)));
                findings.extend(margins.as_ref().and_then(|margins| margins.finding(rig)));
            }
        }
        findings
            .extend(device.zip(coupled.as_ref()).and_then(|(device, coupled)| tune::coupled_finding(device, coupled)));
        Self { margins, masses, coupled, findings, result, rehearsal: None }
    }

    /// Runs the scene of a rig or of a device in which there is no error.
    pub(crate) fn rehearse(&mut self) {
        if self.findings.iter().all(|finding| finding.severity == Severity::Warning) {
            let of_rig = rig(&self.result).and_then(rehearsal::of_rig);
            self.rehearsal = of_rig.or_else(|| device(&self.result).and_then(rehearsal::of_device));
            self.findings.extend(self.rehearsal.as_ref().and_then(|rehearsal| rehearsal.finding.clone()));
        }
    }

    /// Whether its scene was run, and ended as it should.
    pub(crate) fn has_passed(&self) -> bool {
        self.rehearsal.as_ref().is_some_and(|rehearsal| rehearsal.finding.is_none())
    }

    fn plans(&self) -> Vec<Plan<'_>> {
        rig(&self.result).and_then(|rig| plans(&rig.value).ok()).unwrap_or_default()
    }

    /// Returns the computed results as lines of text.
    pub(crate) fn lines(&self) -> impl Iterator<Item = String> {
        let device = device(&self.result).zip(self.coupled.as_ref());
        let coupled = device.map(|(device, coupled)| tune::coupled_lines(&device.value, coupled, 1.0));
        let margins = self.margins.iter().flat_map(Margins::lines).chain(self.masses.iter().flat_map(Masses::lines));
        margins
            .chain(coupled.into_iter().flatten())
            .chain(self.plans().iter().map(Plan::line).collect::<Vec<_>>())
            .chain(self.rehearsal.iter().filter_map(Rehearsal::line))
    }

    /// Returns the file and its findings as data.
    pub(crate) fn to_json(&self, file: &str, is_ok: bool) -> Value {
        let kind = self.result.as_ref().ok().map(|document| document.kind().to_string());
        let mut entry = json!({ "file": file, "ok": is_ok, "kind": kind, "diagnostics": self.findings });
        if let Some(like) = rig(&self.result).and_then(|rig| rig.like.as_ref()) {
            entry["like"] = like.to_string().into();
        }
        if let Some(margins) = &self.margins {
            entry["margins"] = margins.to_json();
        }
        if let Some(masses) = &self.masses {
            entry["virtual_mass"] = masses.to_json(1.0);
        }
        if let Some(coupled) = &self.coupled {
            entry["virtual_coupling"] = tune::coupled_json(coupled, 1.0);
        }
        let plans = self.plans();
        if !plans.is_empty() {
            entry["bus_budget"] = to_json(&plans);
        }
        if let Some(rehearsal) = &self.rehearsal {
            entry["rehearsal"] = rehearsal.to_json();
        }
        entry
    }
}

fn rig(result: &Result<Document, Report>) -> Option<&Loaded<Rig>> {
    match result {
        Ok(Document::Rig(rig)) => Some(rig),
        _ => None,
    }
}

fn device(result: &Result<Document, Report>) -> Option<&Loaded<ImpedanceDevice>> {
    match result {
        Ok(Document::Device(device)) => Some(device),
        _ => None,
    }
}
