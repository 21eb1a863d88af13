//! Results of a run on the embedded simulation.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Value, json};

use super::super::ending::{bus_names, devices_text};
use super::super::keep::RunFiles;
use super::super::margins::Margins;
use super::super::on_bus::{document, drive_error_json, drive_error_text, text};
use super::super::report_text::{
    counted_json, counted_text, measures_text, mode_text, settled_json, settled_text, watchdogs_json, watchdogs_text,
};
use super::{Arguments, simulated_interfaces};
use yieldwall_config as config;
use yieldwall_motion::fixture::prediction;
use yieldwall_rig::report::RunReport;
use yieldwall_run::recorder::LOG_STARTS_AT;
use yieldwall_run::{Drilled, Settled};

/// A run, and the facts that were known before it.
pub(super) struct Facts<'a> {
    pub(super) rig: &'a config::Rig,
    pub(super) drilled: Drilled,
    pub(super) margins: Margins,
    pub(super) report: &'a RunReport,
    pub(super) kept: &'a RunFiles,
    /// The figure that was drawn.
    pub(super) figure: Option<&'a Path>,
    pub(super) seed: u64,
    pub(super) wall_s: f64,
}

impl Facts<'_> {
    /// Returns the drill's results on drives other than those that the profiles describe.
    fn settled(&self) -> Vec<Settled> {
        let is_other = self.rig.simulated().is_ok_and(|simulation| simulation.drive_model.is_some());
        if is_other { self.drilled.settled(self.rig) } else { Vec::new() }
    }

    /// Returns the data for a program.
    pub(super) fn json(&self, arguments: &Arguments) -> Value {
        json!({
            "rig": self.rig.rig.name,
            "mode": self.rig.rig.command_mode,
            "seed": self.seed,
            "simulated_s": self.report.simulated_s(),
            "wall_s": self.wall_s,
            "state": self.report.state.map(|state| format!("{state:?}")),
            "cause": self.report.cause.map(|cause| cause.fault.row().name),
            "cause_stage": self.report.cause.map(|cause| format!("{:?}", cause.fault.row().stage).to_lowercase()),
            "cause_devices": self.report.cause.map(|cause| devices_text(cause.devices, &bus_names(self.rig))),
            "margins": self.margins.to_json(),
            "watchdogs": watchdogs_json(&self.drilled),
            "settled": settled_json(&self.settled()),
            "bus_loads": self.report.bus_loads.iter().cloned().collect::<BTreeMap<_, _>>(),
            "held_s": self.report.held_s,
            "held_by_s": self.report.held_by.iter().map(|(fault, held_s)| (fault.row().name, *held_s)).collect::<BTreeMap<_, _>>(),
            "emergencies": self.report.emergencies.iter().map(|told| document(told, self.rig)).collect::<Vec<_>>(),
            "drive_errors": self.report.errors.iter().map(|error| drive_error_json(error, self.rig)).collect::<Vec<_>>(),
            "counted": counted_json(&self.report.counted),
            "foreign_downloads": self.report.foreign_downloads,
            "segment": self.report.segment,
            "measures": self.report.measures,
            "figure": self.figure,
            "candump": arguments.candump,
            "pcapng": arguments.pcapng,
            "recording": arguments.record,
            "recorded": self.kept.files_json(),
            "black_boxes": self.kept.black_boxes_json(),
        })
    }

    /// Returns the text for a person, a line each.
    pub(super) fn text(&self, arguments: &Arguments) -> String {
        let mut lines = Vec::new();
        let period_ms = self.report.period_s * 1e3;
        let simulated = self.report.simulated_s();
        let mode = mode_text(self.rig.rig.command_mode);
        lines.push(format!("rig       {}: {mode}, {period_ms} ms", self.rig.rig.name));
        lines.push(format!(
            "scene     {}: {simulated:.1} s, seed {}, run in {:.2} s ({:.0} x real time)",
            self.rig.simulated().map_or("none", |simulation| &simulation.scene),
            self.seed,
            self.wall_s,
            simulated / self.wall_s
        ));
        for (at, line) in self.margins.lines().into_iter().enumerate() {
            lines.push(format!("{:9} {line}", if at == 0 { "margins" } else { "" }));
        }
        lines.push(watchdogs_text(&self.drilled));
        lines.extend(settled_text(&self.settled()));
        let trace = &self.report.trace;
        let fixture = &self.rig.fixture;
        let contrast = fixture.law.filter(|law| law.guidance().is_some());
        if contrast.is_some() {
            // A law that does not yield has no R.
            let most = if trace.setup.is_unyielding { String::new() } else { format!(", R {} N", trace.yield_n) };
            lines.push(format!("fixture   {}, F {} N{most}", trace.setup.law, trace.friction_n));
        } else if let config::Coupling::Admittance { mass_kg } = fixture.coupling {
            let capture = prediction::capture_speed_m_per_s(trace.yield_n, mass_kg.get(), self.report.period_s);
            let outward = trace.outward_yield_n.map_or(String::new(), |yield_n| format!(", {yield_n} N outward"));
            let hold = match fixture.automatic_hold {
                Some(hold) => format!("automatic hold for hands up to {} kg", *hold.hand_mass_kg),
                None => format!("N_wait {}", trace.hold_steps),
            };
            lines.push(format!(
                "fixture   M {} kg, F {} N, R {} N{outward}, {hold}",
                mass_kg.get(),
                trace.friction_n,
                trace.yield_n
            ));
            lines.push(format!("catch     impacts up to {:.0} mm/s stop on the surface with N_wait 0", 1e3 * capture));
        }
        lines.extend(measures_text(&self.report.measures));
        if let Some(counters) = self.report.bus {
            let loads = &self.report.bus_loads;
            let load = |(name, load): &(String, f64)| {
                let of = if self.rig.buses.len() > 1 { format!(" of {name}") } else { String::new() };
                format!(", load{of} {:.1} %", 100.0 * load)
            };
            lines.push(format!("bus       {} frames{}", counters.frames, loads.iter().map(load).collect::<String>()));
        }
        lines.extend(self.figure.map(|path| format!("figure    {}", path.display())));
        if let (Some(path), Some(start_s)) = (&arguments.candump, self.report.started_at_s) {
            let start_s = start_s + LOG_STARTS_AT.as_secs_f64();
            let buses = self.rig.buses.iter().zip(simulated_interfaces(self.rig));
            let buses = buses.filter(|((_, bus), _)| bus.canopen().is_some());
            let named = match self.rig.buses.len() {
                1 => String::new(),
                _ => buses.map(|((name, _), interface)| format!(", {interface} is {name}")).collect(),
            };
            lines.push(format!("candump   {}; time 0 of the scene is {start_s:.3} in it{named}", path.display()));
        }
        if let (Some(path), Some(start_s)) = (&arguments.pcapng, self.report.started_at_s) {
            let start_s = start_s + LOG_STARTS_AT.as_secs_f64();
            lines.push(format!("pcapng    {}; time 0 of the scene is {start_s:.3} in it", path.display()));
        }
        lines.extend(self.kept.lines());
        let told = self.report.emergencies.iter().map(|told| format!("emcy      {}", text(told, self.rig)));
        lines.extend(told);
        lines.extend(self.report.errors.iter().map(|error| format!("drive     {}", drive_error_text(error, self.rig))));
        lines.extend(self.report.segment.iter().map(|finding| format!("segment   {finding}")));
        lines.extend(counted_text(&self.report.counted, self.report.foreign_downloads));
        if self.report.held_s > 0.0 {
            let by =
                self.report.cause.map_or(String::new(), |cause| format!(", in the end by {}", cause.fault.row().name));
            lines.push(format!("held      {:.3} s at rest by a fault{by}", self.report.held_s));
        }
        lines.join("\n")
    }
}
