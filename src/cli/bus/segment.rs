//! The budget of an EtherCAT segment.

use serde_json::{Value, json};

use super::called;
use yieldwall_bus::ethercat::{Advice, Budget, FrameBudget, PlannedDatagram, Purpose, SegmentSetup, advise};
use yieldwall_config::{Diagnostic, Loaded, Rig, Severity};

/// The budget of a rig's segment, and its source.
#[derive(Debug)]
pub(crate) struct SegmentPlan<'a> {
    rig: &'a Rig,
    /// The name of the bus.
    name: &'a str,
    setup: SegmentSetup,
    budget: Budget,
}

impl<'a> SegmentPlan<'a> {
    pub(super) fn new(rig: &'a Rig, name: &'a str, setup: SegmentSetup) -> Self {
        let budget = Budget::new(&setup);
        Self { rig, name, setup, budget }
    }

    pub(super) fn is_schedulable(&self) -> bool {
        self.budget.is_schedulable()
    }

    /// Returns the name of the bus, and the largest share of its time that frames take.
    #[cfg(feature = "view")]
    pub(super) fn load(&self) -> (&str, f64) {
        (self.name, self.budget.load())
    }

    /// Whether every frame is in time, or takes none.
    pub(super) fn is_kept(&self) -> bool {
        !self.rig.frames_take_time() || self.is_schedulable()
    }

    pub(super) fn advice(&self) -> Option<Advice> {
        advise(&self.setup)
    }

    /// Returns the line for `config check`.
    pub(super) fn line(&self) -> String {
        let load = 100.0 * self.budget.load();
        format!(
            "bus{} load at most {load:.1} %, {}",
            called(self.rig, " ", self.name),
            self.verdict(self.budget.latest())
        )
    }

    /// Describes a frame's slack against its deadline.
    fn verdict(&self, frame: &FrameBudget) -> String {
        let [done, by] = match frame.frame.purpose {
            Purpose::Inputs => ["is back", "the control step"],
            Purpose::Outputs | Purpose::Repeat if self.budget.has_sync0 => ["is at the last device", "SYNC0"],
            Purpose::Outputs | Purpose::Repeat => ["is at the last device", "the next cycle"],
            Purpose::Service => ["is back", "the next cycle"],
        };
        let (left_us, what) = (us(frame.left_ns().unsigned_abs()), frame.frame.purpose.word());
        let side = if frame.is_in_time() { "before" } else { "after" };
        format!("the {what} frame {done} {left_us} us {side} {by}")
    }

    /// Returns the advice: the values to change.
    fn help(&self) -> String {
        let Some(Advice { period, compute_at_us: [earliest, latest] }) = self.advice() else {
            return "no period suffices: map less process data".to_owned();
        };
        let step = format!("`compute_at_us` {} ({earliest} to {latest})", earliest.midpoint(latest));
        if period == self.budget.period {
            format!("write {step}")
        } else {
            format!("raise `period_us` to {}, with {step}", period.as_micros())
        }
    }

    /// Returns the finding on a segment that cannot keep the cycle, for an operator who wants to run the rig.
    pub(super) fn finding(&self, file: &Loaded<Rig>) -> Option<Diagnostic> {
        if self.is_schedulable() {
            return None;
        }
        let called = called(self.rig, " ", self.name);
        let (severity, what) = if self.is_kept() {
            (Severity::Warning, format!("a real segment{called} would not keep the cycle"))
        } else {
            (Severity::Error, format!("the segment{called} cannot keep the cycle"))
        };
        let is_moment = self.advice().is_some_and(|advice| advice.period == self.budget.period);
        let (moment, period) = (("cycle.compute_at_us", "compute_at_us"), ("cycle.period_us", "period_us"));
        let ((key, _), see) = if is_moment { (moment, period) } else { (period, moment) };
        let message = format!("{what}: {}", self.verdict(self.budget.latest()));
        let help = format!("{}; `yieldwall bus budget {}` lists every frame", self.help(), file.source);
        Some(file.finding(severity, key, message, help, &[see]))
    }

    /// Returns the text for a person in 80 columns.
    pub(super) fn text(&self) -> String {
        let budget = &self.budget;
        let computing_us = Budget::computing().as_micros();
        let verdict = if self.is_schedulable() { "ok: every frame is in time" } else { "NOT OK: frames are late" };
        let mut lines = vec![
            format!("verdict   {verdict}"),
            format!("rig       {}{}", self.rig.rig.name, called(self.rig, ", bus ", self.name)),
            format!(
                "bus       EtherCAT, {} devices, cycle {} us, control step at {} us",
                budget.devices,
                budget.period.as_micros(),
                budget.compute_at.as_micros()
            ),
            format!("load      at most {:.1} %", 100.0 * budget.load()),
            String::new(),
            format!("{:<8} {:>5} {:>5}    times in us", "", "", "on"),
            format!(
                "{:<8} {:>5} {:>5} {:>8} {:>8} {:>8} {:>8} {:>8}",
                "frame", "bytes", "wire", "time", "sent", "done", "allowed", "slack"
            ),
        ];
        let sent = || budget.frames.iter().filter(|each| !each.frame.is_empty());
        lines.extend(sent().map(row));
        lines.push(String::new());
        lines.extend(sent().flat_map(|each| datagrams(each.frame.purpose, &each.frame.datagrams)));
        lines.push(String::new());
        if self.is_schedulable() {
            lines.push(format!("slack of each frame, with {computing_us} us for computing and for the devices:"));
            lines.extend(sent().map(|each| format!("  {}", self.verdict(each))));
        } else {
            lines.push(format!("late frames, with {computing_us} us for computing and for the devices:"));
            let late = budget.frames.iter().filter(|each| !each.is_in_time());
            lines.extend(late.map(|each| format!("  {}", self.verdict(each))));
            lines.push("advice:".to_owned());
            lines.push(format!("  {}", self.help()));
        }
        let by = if budget.has_sync0 { "SYNC0" } else { "the next cycle" };
        lines.push(format!(
            "outputs of another master take effect in the last {} us before {by}",
            us(budget.exposed_ns)
        ));
        lines.push("wake-up and send latency of this computer have to fit into the slack".to_owned());
        lines.join("\n") + "\n"
    }

    /// Returns the data for a program.
    pub(super) fn to_json(&self) -> Value {
        let budget = &self.budget;
        let mut document = json!({
            "bus": self.name,
            "kind": "ethercat",
            "cycle_us": budget.period.as_micros() as u64,
            "compute_at_us": budget.compute_at.as_micros() as u64,
            "computing_us": Budget::computing().as_micros() as u64,
            "devices": budget.devices,
            "timing": if self.rig.frames_take_time() { "real" } else { "ideal" },
            "load_worst": budget.load(),
            "schedulable": self.is_schedulable(),
            "exposed_ns": budget.exposed_ns,
            "frames": budget.frames.iter().filter(|each| !each.frame.is_empty()).map(figures).collect::<Vec<_>>(),
        });
        if !self.is_schedulable() {
            document["advice"] = json!(self.advice().map(|advice| json!({
                "cycle_us": advice.period.as_micros() as u64,
                "compute_at_us": advice.compute_at_us,
            })));
        }
        document
    }
}

/// Formats a time as us with two decimals.
fn us(time_ns: u64) -> String {
    format!("{:.2}", time_ns as f64 * 1e-3)
}

fn row(each: &FrameBudget) -> String {
    let frame = &each.frame;
    let left_us = each.left_ns() as f64 * 1e-3;
    format!(
        "{:<8} {:>5} {:>5} {:>8} {:>8} {:>8} {:>8} {left_us:>8.2}",
        frame.purpose.word(),
        frame.len(),
        frame.wire_bytes(),
        us(frame.wire_ns()),
        us(each.sent_ns),
        us(each.done_ns),
        us(each.deadline_ns),
    )
}

/// Returns the datagrams of a frame with their bytes of data, those of a device in a line.
fn datagrams(purpose: Purpose, all: &[PlannedDatagram]) -> Vec<String> {
    let mut lines: Vec<(Option<&str>, Vec<String>)> = Vec::new();
    for PlannedDatagram { command, device, len } in all {
        let words = format!("{} {len}", command.name());
        match lines.last_mut() {
            Some((last, line)) if *last == device.as_deref() && last.is_some() => line.push(words),
            // The first of all devices' ports represents the others.
            Some((None, _)) if device.is_none() => {}
            _ => lines.push((device.as_deref(), vec![words])),
        }
    }
    let several = if purpose == Purpose::Service && all.len() > 1 { " .." } else { "" };
    let each = lines.into_iter().enumerate().map(|(at, (device, words))| {
        let frame = if at == 0 { purpose.word() } else { "" };
        let device = device.map(|name| format!("{name} ")).unwrap_or_default();
        format!("{frame:<8} {device}{}{several}", words.join(", "))
    });
    each.collect()
}

fn figures(each: &FrameBudget) -> Value {
    let datagram =
        |one: &PlannedDatagram| json!({ "command": one.command.name(), "device": one.device, "bytes": one.len });
    json!({
        "name": each.frame.purpose.word(),
        "datagrams": each.frame.datagrams.iter().map(datagram).collect::<Vec<_>>(),
        "bytes": each.frame.len(),
        "wire_bytes": each.frame.wire_bytes(),
        "wire_ns": each.frame.wire_ns(),
        "sent_ns": each.sent_ns,
        "done_ns": each.done_ns,
        "deadline_ns": each.deadline_ns,
        "left_ns": each.left_ns(),
        "in_time": each.is_in_time(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::{plans, text, to_json};
    use super::*;
    use yieldwall_config::{Source, builtin, load_rig};

    /// Returns the shipped rig on EtherCAT with another cycle.
    fn rig(period_us: u32, compute_at_us: u32) -> Loaded<Rig> {
        let shipped = builtin("paper-ethercat.yaml").read().unwrap().replace("like: ", "like: builtin:");
        let cycle = format!("\ncycle: {{period_us: {period_us}, compute_at_us: {compute_at_us}}}\n");
        load_rig(Source::memory("rig.yaml", shipped.to_string() + &cycle)).unwrap()
    }

    #[test]
    fn tables_and_findings() {
        let shipped = load_rig(builtin("paper-ethercat.yaml")).unwrap();
        insta::assert_snapshot!("segment-budget", text(&plans(&shipped.value).unwrap()));
        let drawn: Vec<String> = [(1000, 15), (1000, 880)]
            .into_iter()
            .map(|(period_us, compute_at_us)| {
                let rig = rig(period_us, compute_at_us);
                let plans = plans(&rig.value).unwrap();
                let findings: Vec<_> = plans.iter().filter_map(|plan| plan.finding(&rig)).collect();
                format!("{}\n{}", text(&plans), crate::render::Renderer::new(false).render(&findings))
            })
            .collect();
        insta::assert_snapshot!("segment-findings", drawn.join("\n"));
    }

    #[test]
    fn more_process_data_than_fits_asks_for_a_longer_period() {
        let file = rig(1000, 620);
        let [period, compute_at] = [125, 40].map(std::time::Duration::from_micros);
        let mut setup = SegmentSetup {
            period,
            compute_at,
            sync0_phase: period / 10,
            ..yieldwall_run::assembly::segment(&file.value).unwrap()
        };
        setup.stations.iter_mut().for_each(|station| {
            let all = &mut station.inputs[0].entries;
            *all = all.iter().copied().cycle().take(100).collect();
        });
        let finding = SegmentPlan::new(&file.value, "main", setup.clone()).finding(&file).unwrap();
        assert_eq!(finding.key, "cycle.period_us");
        let help = finding.help.unwrap();
        assert!(help.contains("raise `period_us` to 200, with `compute_at_us` "), "{help}");
        let Advice { period, compute_at_us: [earliest, _] } = advise(&setup).unwrap();
        let compute_at = std::time::Duration::from_micros(earliest);
        let mended = SegmentSetup { period, compute_at, sync0_phase: period / 10, ..setup };
        assert_eq!(SegmentPlan::new(&file.value, "main", mended).finding(&file), None);
    }

    #[test]
    fn the_advised_moment_and_period_pass() {
        for (period_us, compute_at_us) in [(1000, 15), (1000, 880), (1000, 999)] {
            let late = rig(period_us, compute_at_us);
            let plans = plans(&late.value).unwrap();
            let document = to_json(&plans);
            assert_eq!(document["schedulable"], false, "{period_us} {compute_at_us}");
            assert_eq!(plans[0].finding(&late).unwrap().severity, Severity::Error);
            let number = |value: &Value| value.as_u64().unwrap() as u32;
            let advised = &document["advice"];
            for moment in [&advised["compute_at_us"][0], &advised["compute_at_us"][1]] {
                let mended = rig(number(&advised["cycle_us"]), number(moment));
                assert_eq!(super::super::plans(&mended.value).unwrap()[0].finding(&mended), None, "{advised}");
            }
        }
    }

    #[test]
    fn the_document_has_the_keys_that_programs_read() {
        let shipped = load_rig(builtin("paper-ethercat.yaml")).unwrap();
        let document = to_json(&plans(&shipped.value).unwrap());
        assert_eq!((&document["bus"], &document["kind"]), (&json!("main"), &json!("ethercat")));
        assert_eq!((&document["schedulable"], &document["devices"]), (&json!(true), &json!(3)));
        let [inputs, outputs, service, repeat] = document["frames"].as_array().unwrap().as_slice() else {
            panic!("{document}")
        };
        assert_eq!(inputs["datagrams"][0], json!({ "command": "FRMW", "device": null, "bytes": 8 }));
        assert_eq!(outputs["datagrams"][0]["device"], "left");
        assert_eq!((&inputs["sent_ns"], &service["in_time"]), (&json!(0), &json!(true)));
        assert_eq!((&repeat["name"], &repeat["deadline_ns"]), (&json!("repeat"), &outputs["deadline_ns"]));
    }
}
