//! The budget of a CAN bus.

use serde_json::{Value, json};

use super::called;
use super::frame::{NAME_WIDTH, figures, row, verdict};
use yieldwall_bus::MasterSetup;
use yieldwall_bus::budget::{Advice, Budget, Conditions, FrameBudget, advise};
use yieldwall_config::{Diagnostic, Loaded, Rig, Severity};

/// The budget of one of a rig's CAN buses, and its source.
#[derive(Debug)]
pub(crate) struct CanPlan<'a> {
    pub(super) rig: &'a Rig,
    /// Its name.
    pub(super) name: &'a str,
    pub(super) setup: MasterSetup,
    pub(super) budget: Budget,
    /// The conditions of the rig's other CAN buses.
    pub(super) others: Vec<Conditions>,
}

impl CanPlan<'_> {
    fn is_ideal(&self) -> bool {
        !self.rig.frames_take_time()
    }

    /// Whether every frame is always in time, or takes no time.
    pub(crate) fn is_kept(&self) -> bool {
        self.is_ideal() || self.budget.is_schedulable()
    }

    /// Returns the smallest change with which every frame is in time.
    pub(crate) fn advice(&self) -> Option<Advice> {
        advise(&self.setup, self.budget.conditions, &self.others).ok().flatten()
    }

    /// Returns the line for `config check`.
    pub(crate) fn line(&self) -> String {
        let load = 100.0 * self.budget.load();
        let nearest = self.budget.latest().map(|latest| format!(", {}", verdict(latest))).unwrap_or_default();
        format!("bus{} load at most {load:.1} %{nearest}", called(self.rig, " ", self.name))
    }

    /// Returns the text for a person in 80 columns.
    pub(super) fn text(&self) -> String {
        let budget = &self.budget;
        let Conditions { bit_rate, compute_at, .. } = budget.conditions;
        let late = budget.regular().filter(|frame| !frame.is_in_time()).count();
        let mut lines = vec![
            match late {
                _ if budget.is_schedulable() => "verdict   ok: every frame arrives in time".to_owned(),
                1 => "verdict   NOT OK: 1 frame can be late".to_owned(),
                _ => format!("verdict   NOT OK: {late} frames can be late"),
            },
            format!("rig       {}{}", self.rig.rig.name, called(self.rig, ", bus ", self.name)),
            format!(
                "bus       {} kbit/s, cycle {} us, control step at {} us",
                f64::from(bit_rate) / 1e3,
                budget.cycle.as_micros(),
                compute_at.as_micros()
            ),
            format!(
                "load      at most {:.1} % (SYNC and process data {:.1} %)",
                100.0 * budget.load(),
                100.0 * budget.cyclic_load()
            ),
            String::new(),
            format!("{:>4}  {:<NAME_WIDTH$} {:>5} {:>4}    times in us", "", "", "", ""),
            format!(
                "{:>4}  {:<NAME_WIDTH$} {:>5} {:>4} {:>7} {:>7} {:>7} {:>7}  from",
                "COB", "frame", "bytes", "bits", "period", "longest", "allowed", "slack"
            ),
        ];
        lines.extend(budget.frames.iter().map(|frame| row(frame, budget.conditions.is_plain())));
        lines.push("from: moment from which the times count: SYNC, the control step, or the queue".to_owned());
        lines.push("in the sender".to_owned());
        lines.push(String::new());
        lines.extend(self.verdict());
        lines.push(String::new());
        lines.push("* not counted for the other frames, nor for the verdict:".to_owned());
        let disturbed = [
            ("an SDO exchange in operation", &budget.latest_with_sdo, "this program sends none then"),
            ("emergencies of all nodes in one cycle", &budget.latest_with_emergencies, "they stop the rig"),
        ];
        for (what, latest, why) in disturbed {
            let verdict = latest.as_ref().map(verdict).unwrap_or_default();
            lines.push(format!("  with {what} ({why}):"));
            lines.push(format!("  {verdict}"));
        }
        if self.is_ideal() {
            lines.push("`timing: ideal`: the embedded simulation delivers every frame at once; the".to_owned());
            lines.push("table is for a real bus of this bit rate.".to_owned());
        }
        lines.join("\n") + "\n"
    }

    fn verdict(&self) -> Vec<String> {
        let Some(latest) = self.budget.latest() else { return Vec::new() };
        if self.budget.is_schedulable() {
            return vec!["least slack:".to_owned(), format!("  {}", verdict(latest))];
        }
        let lines = ["latest frame:", &format!("  {}", verdict(latest)), "advice:", &format!("  {}", self.help())];
        lines.map(str::to_owned).to_vec()
    }

    /// Returns the advice: the values to change.
    fn help(&self) -> String {
        let Some(advice) = self.advice() else {
            return "no bit rate or period suffices: map less process data".to_owned();
        };
        let [earliest, latest] = advice.compute_at_us;
        let step = if earliest == latest {
            format!("`compute_at_us` {earliest}")
        } else {
            format!("`compute_at_us` {} ({earliest} to {latest})", earliest.midpoint(latest))
        };
        if advice.bit_rate != self.budget.conditions.bit_rate {
            format!("raise `bit_rate_bit_per_s` to {}, with {step}", advice.bit_rate)
        } else if advice.period != self.budget.cycle {
            format!("raise `period_us` to {}, with {step}", advice.period.as_micros())
        } else {
            format!("write {step}")
        }
    }

    /// Returns the key that the advice is about.
    fn key(&self) -> String {
        match self.advice() {
            Some(advice) if advice.bit_rate != self.budget.conditions.bit_rate => {
                format!("buses.{}.canopen.bit_rate_bit_per_s", self.name)
            }
            Some(advice) if advice.period == self.budget.cycle => "cycle.compute_at_us".to_owned(),
            _ => "cycle.period_us".to_owned(),
        }
    }

    /// Returns the finding on a bus that cannot keep the cycle, for an operator who wants to run the rig: an error, or a warning
    /// for a bus without timing. Returns `None` if the bus keeps the cycle.
    pub(crate) fn finding(&self, file: &Loaded<Rig>) -> Option<Diagnostic> {
        let latest = self.budget.latest().filter(|_| !self.budget.is_schedulable())?;
        let called = called(self.rig, " ", self.name);
        let (severity, where_to) = if self.is_ideal() {
            (Severity::Warning, format!("a real bus{called} would not keep the cycle"))
        } else {
            (Severity::Error, format!("the bus{called} cannot keep the cycle"))
        };
        let key = self.key();
        let bit_rate = format!("buses.{}.canopen.bit_rate_bit_per_s", self.name);
        let see = [
            ("cycle.period_us", "period_us"),
            ("cycle.compute_at_us", "compute_at_us"),
            (bit_rate.as_str(), "bit_rate_bit_per_s"),
        ];
        let see: Vec<(&str, &str)> = see.into_iter().filter(|(other, _)| *other != key).collect();
        let help = format!("{}; `yieldwall bus budget {}` lists every frame", self.help(), file.source);
        Some(file.finding(severity, &key, format!("{where_to}: {}", verdict(latest)), help, &see))
    }

    /// Returns the data for a program.
    pub(super) fn to_json(&self) -> Value {
        let budget = &self.budget;
        let Conditions { bit_rate, compute_at, device_delay, has_release_jitter, has_fifo, .. } = budget.conditions;
        let disturbed = |latest: &Option<FrameBudget>| {
            let is_schedulable = latest.as_ref().is_some_and(FrameBudget::is_in_time);
            json!({ "schedulable": is_schedulable, "latest": latest.as_ref().map(figures) })
        };
        let mut document = json!({
            "bus": self.name,
            "bit_rate": bit_rate,
            "cycle_us": budget.cycle.as_micros() as u64,
            "compute_at_us": compute_at.as_micros() as u64,
            "device_delay_us": device_delay.as_micros() as u64,
            "release_jitter": has_release_jitter,
            "fifo": has_fifo,
            "timing": if self.is_ideal() { "ideal" } else { "arbitrated" },
            "load_worst": budget.load(),
            "load_cyclic_worst": budget.cyclic_load(),
            "schedulable": budget.is_schedulable(),
            "frames": budget.frames.iter().map(figures).collect::<Vec<_>>(),
            "with_sdo": disturbed(&budget.latest_with_sdo),
            "with_emergencies": disturbed(&budget.latest_with_emergencies),
        });
        if !budget.is_schedulable() {
            document["advice"] = json!(self.advice().map(|advice| json!({
                "bit_rate": advice.bit_rate,
                "cycle_us": advice.period.as_micros() as u64,
                "compute_at_us": advice.compute_at_us,
            })));
        }
        document
    }
}
