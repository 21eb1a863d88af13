//! Results of a run on a real bus.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::LoopTimes;
use crate::ending::{bus_names, devices_text};
use crate::interfaces::Interfaces;
use crate::keep::RunFiles;
use crate::on_bus::{document, drive_error_json, drive_error_text, text};
use crate::pace::PaceArgument;
use crate::report_text::{counted_json, counted_text, measures_text, mode_text};
use crate::run::Arguments;
use yieldwall_config as config;
use yieldwall_rig::report::measures::Measures;
use yieldwall_run::Played;
use yieldwall_run::host::{Histogram, HostedRun, ProvenTiming};

/// All of it.
pub(super) struct Facts<'a> {
    pub(super) interfaces: &'a Interfaces,
    pub(super) arguments: &'a Arguments,
    pub(super) rig: &'a config::Rig,
    pub(super) outcome: &'a HostedRun,
    pub(super) seen: &'a LoopTimes,
    pub(super) played: &'a Played,
    pub(super) measures: &'a Measures,
    pub(super) kept: &'a RunFiles,
    /// The figure that was drawn.
    pub(super) figure: Option<&'a std::path::Path>,
}

impl Facts<'_> {
    fn refusals(&self) -> Vec<String> {
        [&self.outcome.priority, &self.outcome.memory]
            .into_iter()
            .filter_map(|granted| granted.as_ref().err().map(ToString::to_string))
            .collect()
    }

    /// For a person.
    pub(super) fn lines(&self, time_s: f64) -> Vec<String> {
        let (counts, LoopTimes { stages, skipped }) = (self.outcome.counts, self.seen);
        let period_ms = f64::from(self.rig.cycle.period_us) * 1e-3;
        let mut lines = vec![
            format!("rig       {}: {}, {period_ms} ms", self.rig.rig.name, mode_text(self.rig.rig.command_mode)),
            format!(
                "bus       {}, {}: {} frames received, {} own frames seen, {} lost here, {} not sent",
                self.interfaces.shown(self.rig),
                self.arguments.pace.name(),
                counts.received,
                counts.echoed,
                counts.overflowed,
                counts.refused
            ),
            format!(
                "ran       {} cycles, {time_s:.1} s; state at the end: {:?}",
                self.played.cycles, self.played.state
            ),
        ];
        if self.played.came_back > 0 {
            let times = match self.played.came_back {
                1 => "once".to_owned(),
                more => format!("{more} times"),
            };
            lines.push(format!("resumed   {times}, reset and enabled by a person; measures end with the first fault"));
        }
        match self.refusals().as_slice() {
            [] => lines.push("realtime  SCHED_FIFO and locked memory".to_owned()),
            refusals => lines.extend(refusals.iter().map(|refusal| format!("realtime  {refusal}"))),
        }
        lines.extend(self.outcome.timing.as_ref().map(|timing| match timing {
            Ok(ProvenTiming { tier, shown }) => format!("timing    tier {tier}: {shown}"),
            Err(error) => format!("timing    not proved (ignored): {error}"),
        }));
        let emergencies = &self.outcome.emergencies;
        lines.extend(emergencies.iter().map(|emergency| format!("emcy      {}", text(emergency, self.rig))));
        lines
            .extend(self.outcome.errors.iter().map(|error| format!("drive     {}", drive_error_text(error, self.rig))));
        lines.extend(self.outcome.segment.iter().map(|finding| format!("segment   {finding}")));
        lines.extend(counted_text(&self.outcome.counted, self.outcome.foreign_downloads));
        if self.arguments.pace == PaceArgument::Free {
            for (at, (_, text, times)) in stages.each().enumerate() {
                let us = |share| 1e6 * times.quantile(share).as_secs_f64();
                let (p50, p99, max) = (us(0.5), us(0.99), us(1.0));
                let head = if at == 0 { "stages" } else { "" };
                lines.push(format!("{head:9} {text} p50 {p50:.0}, p99 {p99:.0}, max {max:.0} us"));
            }
            lines.push(format!("{:9} {skipped} cycles skipped", ""));
        }
        lines.extend(measures_text(self.measures));
        lines.extend(self.figure.map(|path| format!("figure    {}", path.display())));
        lines.extend(self.arguments.candump.as_ref().map(|path| format!("candump   {}", path.display())));
        lines.extend(self.arguments.pcapng.as_ref().map(|path| format!("pcapng    {}", path.display())));
        lines.extend(self.kept.lines());
        lines
    }

    /// As data.
    pub(super) fn json(&self, time_s: f64) -> Value {
        let (counts, LoopTimes { stages, skipped }) = (self.outcome.counts, self.seen);
        let times = |times: &Histogram| {
            let us = |share| 1e6 * times.quantile(share).as_secs_f64();
            json!({ "p50_us": us(0.5), "p99_us": us(0.99), "p999_us": us(0.999), "max_us": us(1.0) })
        };
        let cause = self.played.cause;
        json!({
            "rig": self.rig.rig.name,
            "mode": self.rig.rig.command_mode,
            "buses": self.rig.buses.keys().zip(self.interfaces.names()).collect::<BTreeMap<_, _>>(),
            "pace": format!("{:?}", self.arguments.pace).to_lowercase(),
            "cycles": self.played.cycles,
            "time_s": time_s,
            "came_back": self.played.came_back,
            "ended": format!("{:?}", self.played.ended),
            "state": format!("{:?}", self.played.state),
            "cause": cause.map(|cause| cause.fault.row().name),
            "cause_devices": cause.map(|cause| devices_text(cause.devices, &bus_names(self.rig))),
            "emergencies": self.outcome.emergencies.iter().map(|one| document(one, self.rig)).collect::<Vec<_>>(),
            "drive_errors": self.outcome.errors.iter().map(|error| drive_error_json(error, self.rig)).collect::<Vec<_>>(),
            "counted": counted_json(&self.outcome.counted),
            "foreign_downloads": self.outcome.foreign_downloads,
            "segment": self.outcome.segment,
            "frames": {
                "received": counts.received,
                "echoed": counts.echoed,
                "lost": counts.overflowed,
                "not_sent": counts.refused,
            },
            "realtime_refused": self.refusals(),
            "timing": self.outcome.timing.as_ref().map(|timing| match timing {
                Ok(ProvenTiming { tier, shown }) => json!({ "tier": tier, "shown": shown }),
                Err(error) => json!({ "ignored": error.to_string() }),
            }),
            "stages": stages.each().map(|(name, _, of)| (name, times(of))).collect::<BTreeMap<_, _>>(),
            "skipped": skipped,
            "measures": self.measures,
            "figure": self.figure,
            "candump": self.arguments.candump,
            "pcapng": self.arguments.pcapng,
            "recording": self.arguments.record,
            "recorded": self.kept.files_json(),
            "black_boxes": self.kept.black_boxes_json(),
        })
    }
}
