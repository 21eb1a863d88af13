//! `yieldwall bus`: what the bus of a rig can carry.

mod frame;

use std::time::Duration;

use serde_json::{Value, json};

use self::frame::{NAME_WIDTH, figures, row, verdict};
use super::failure::{Exit, Failure};
use super::output::Output;
use crate::assembly::bus_plan;
use crate::bus::MasterSetup;
use crate::bus::budget::{Advice, Budget, Conditions, FrameBudget, advise};
use crate::config::{self, Diagnostic, Loaded, Rig, Severity, Source};
use crate::rig::RigError;

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    /// Tell the longest time of every frame on a rig's bus, and whether the cycle can be kept
    ///
    /// Worst-case response times after Davis, Burns, Bril and Lukkien (2007). A bus that cannot keep the cycle is a
    /// result, not an error: the exit code is 0. docs/bus-budget.md has the method and its assumptions.
    Budget(Arguments),
}

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The rig; `builtin:paper-admittance.yaml` names the copy inside the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Longest time from the end of SYNC to a TPDO in the queue of its device; the simulated devices take none
    #[arg(long, value_name = "US", default_value_t = 0)]
    device_delay_us: u32,
    /// Let all frames be released at one moment, instead of TPDOs after SYNC and RPDOs after the control step; with
    /// --no-fifo the published analysis as it stands, its bits included
    #[arg(long)]
    no_release_jitter: bool,
    /// Let the master's frames go out by priority, instead of through the FIFO of a Linux host
    #[arg(long)]
    no_fifo: bool,
}

pub(super) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    let Command::Budget(arguments) = command;
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.configuration(&rig.warnings)?;
    let plans = plans_under(&rig.value, |conditions| Conditions {
        device_delay: Duration::from_micros(arguments.device_delay_us.into()),
        has_release_jitter: !arguments.no_release_jitter,
        has_fifo: !arguments.no_fifo,
        ..conditions
    });
    let plans = plans.map_err(|error| failure(&error))?;
    if output.is_json() { output.report(to_json(&plans)) } else { output.result(&text(&plans)) }
}

fn failure(error: &RigError) -> Failure {
    Failure::new(Exit::ConfigInvalid, error.to_string(), "run `yieldwall config check` on the rig")
}

/// The budget of one of a rig's buses and what it was made from.
#[derive(Debug)]
pub(super) struct Plan<'a> {
    rig: &'a Rig,
    /// Its name.
    name: &'a str,
    setup: MasterSetup,
    budget: Budget,
    /// The conditions of the rig's other buses.
    others: Vec<Conditions>,
}

/// The budgets of all buses, as a run takes them.
pub(super) fn plans(rig: &Rig) -> Result<Vec<Plan<'_>>, RigError> {
    plans_under(rig, |conditions| conditions)
}

fn plans_under(rig: &Rig, change: impl Fn(Conditions) -> Conditions) -> Result<Vec<Plan<'_>>, RigError> {
    if !rig.is_on_can() {
        return Ok(Vec::new());
    }
    let (setup, conditions) = bus_plan(rig)?;
    let conditions: Vec<Conditions> = conditions.into_iter().map(change).collect();
    let each = rig.buses.keys().zip(&conditions).map(|(name, own)| {
        let others = conditions.iter().filter(|other| other.bus != own.bus).copied().collect();
        Ok(Plan { rig, name, setup: setup.clone(), budget: Budget::new(&setup, *own)?, others })
    });
    each.collect()
}

/// One table for each bus.
fn text(plans: &[Plan<'_>]) -> String {
    plans.iter().map(Plan::text).collect::<Vec<_>>().join("\n")
}

/// All budgets for a program to read: of the only bus, or of each.
pub(super) fn to_json(plans: &[Plan<'_>]) -> Value {
    if let [plan] = plans {
        return plan.to_json();
    }
    json!({
        "schedulable": plans.iter().all(|plan| plan.budget.is_schedulable()),
        "buses": plans.iter().map(Plan::to_json).collect::<Vec<_>>(),
    })
}

impl Plan<'_> {
    fn is_ideal(&self) -> bool {
        !self.rig.frames_take_time()
    }

    /// Whether every frame is always in time, or takes none.
    pub(super) fn is_kept(&self) -> bool {
        self.is_ideal() || self.budget.is_schedulable()
    }

    /// How the bus is called where there are several.
    fn called(&self, before: &str, after: &str) -> String {
        if self.rig.buses.len() > 1 { format!("{before}{}{after}", self.name) } else { String::new() }
    }

    /// The least change with which everything is in time.
    pub(super) fn advice(&self) -> Option<Advice> {
        advise(&self.setup, self.budget.conditions, &self.others).ok().flatten()
    }

    /// One line for `config check`.
    pub(super) fn line(&self) -> String {
        let load = 100.0 * self.budget.load();
        let nearest = self.budget.latest().map(|latest| format!(", {}", verdict(latest))).unwrap_or_default();
        format!("bus{} load at most {load:.1} %{nearest}", self.called(" ", ""))
    }

    /// For a person to read in 80 columns.
    fn text(&self) -> String {
        let budget = &self.budget;
        let Conditions { bit_rate, compute_at, .. } = budget.conditions;
        let mut lines = vec![
            format!(
                "{}{}: {} kbit/s, cycle {} us, control step at {} us",
                self.rig.rig.name,
                self.called(", bus ", ""),
                f64::from(bit_rate) / 1e3,
                budget.cycle.as_micros(),
                compute_at.as_micros()
            ),
            format!(
                "load at most {:.1} %, of it SYNC and process data {:.1} %",
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
        lines.push(String::new());
        lines.extend(self.verdict());
        lines.push(String::new());
        lines.push("* not counted for the other frames, and not in the verdict:".to_owned());
        let disturbed = [
            ("an SDO exchange in operation", &budget.latest_with_sdo, "this program makes none then"),
            ("emergencies of all nodes in one cycle", &budget.latest_with_emergencies, "they stop the rig"),
        ];
        for (what, latest, why) in disturbed {
            let verdict = latest.as_ref().map(verdict).unwrap_or_default();
            lines.push(format!("  with {what} ({why}):"));
            lines.push(format!("  {verdict}"));
        }
        if self.is_ideal() {
            lines.push("`timing: ideal`: the embedded simulation delivers every frame at once; this".to_owned());
            lines.push("table is what a real bus of this bit rate would do.".to_owned());
        }
        lines.join("\n") + "\n"
    }

    fn verdict(&self) -> Vec<String> {
        let Some(latest) = self.budget.latest() else { return Vec::new() };
        if self.budget.is_schedulable() {
            return vec!["schedulable:".to_owned(), format!("  {}", verdict(latest))];
        }
        let late = self.budget.regular().filter(|frame| !frame.is_in_time()).count();
        let others = if late > 1 { format!(", {late} frames late") } else { String::new() };
        vec![format!("NOT schedulable{others}:"), format!("  {}", verdict(latest)), format!("  {}", self.help())]
    }

    /// What to change.
    fn help(&self) -> String {
        let Some(advice) = self.advice() else {
            return "no bit rate or period does: map less process data".to_owned();
        };
        let [earliest, latest] = advice.compute_at_us;
        let step = if earliest == latest {
            format!("`compute_at_us` {earliest}")
        } else {
            format!("`compute_at_us` {earliest} to {latest}")
        };
        if advice.bit_rate != self.budget.conditions.bit_rate {
            format!("raise `bit_rate_bit_per_s` to {}, with {step}", advice.bit_rate)
        } else if advice.period != self.budget.cycle {
            format!("raise `period_us` to {}, with {step}", advice.period.as_micros())
        } else {
            format!("write {step}")
        }
    }

    /// The key that the help is about.
    fn key(&self) -> String {
        match self.advice() {
            Some(advice) if advice.bit_rate != self.budget.conditions.bit_rate => {
                format!("buses.{}.canopen.bit_rate_bit_per_s", self.name)
            }
            Some(advice) if advice.period == self.budget.cycle => "cycle.compute_at_us".to_owned(),
            _ => "cycle.period_us".to_owned(),
        }
    }

    /// What a bus that cannot keep the cycle is for whoever wants to run the rig: an error, on a bus without timing a
    /// warning. `None` if it can.
    pub(super) fn finding(&self, file: &Loaded<Rig>) -> Option<Diagnostic> {
        let latest = self.budget.latest().filter(|_| !self.budget.is_schedulable())?;
        let called = self.called(" ", "");
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

    /// For a program to read.
    fn to_json(&self) -> Value {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{builtin, builtin_names, load_rig};

    /// A simulation on buses whose frames take no time.
    const IDEAL: (&str, &str) = (
        "simulation: simulations/paper-arm.yaml",
        "simulation: {timing: ideal, arm: {motor_kg_m2: [0.25, 0.25], proximal_kg: [0, 0], distal_kg: [0, 0], tool_kg: 1, \
         coulomb_n_m: [10, 10], viscous_n_m_s_per_rad: [0.5, 0.5]}, drive_position_loop: {period_us: 125, \
         stiffness_n_m_per_rad: 20000, damping_n_m_s_per_rad: 150, integral_n_m_per_rad_s: 200000}, \
         scene: scenes/circle-tour.yaml}",
    );

    fn rigs() -> impl Iterator<Item = &'static str> {
        builtin_names().filter(|name| name.starts_with("paper-admittance"))
    }

    /// The shipped rig in torque mode with some of its text replaced.
    fn changed(changes: &[(&str, &str)]) -> Loaded<Rig> {
        let shipped = builtin("paper-admittance.yaml").read().unwrap();
        let text = changes.iter().fold(shipped.to_string(), |text, (from, to)| {
            assert!(text.contains(from), "{from}");
            text.replace(from, to)
        });
        load_rig(Source::memory("rig.yaml", text)).unwrap()
    }

    fn drawn(changes: &[(&str, &str)]) -> String {
        let rig = changed(changes);
        let findings: Vec<_> = plans(&rig.value).unwrap().iter().filter_map(|plan| plan.finding(&rig)).collect();
        super::super::render::Renderer::new(false).render(&findings)
    }

    #[test]
    fn shipped_rigs_fit_their_bus() {
        assert!(rigs().count() >= 10);
        for name in rigs() {
            let rig = load_rig(builtin(name)).unwrap();
            for plan in plans(&rig.value).unwrap() {
                assert!(plan.budget.is_schedulable(), "{name}:\n{}", plan.text());
                assert_eq!(plan.finding(&rig), None);
            }
        }
    }

    #[test]
    fn the_table_fits_80_columns_and_is_sorted() {
        let slow = ("bit_rate_bit_per_s: 1000000", "bit_rate_bit_per_s: 50000");
        let long = ("name: left", "name: a-left-drive-with-a-name-that-goes-on-and-on");
        for changes in [&[][..], &[slow], &[long], &[IDEAL]] {
            let rig = changed(changes);
            let text = text(&plans(&rig.value).unwrap());
            let rows = text.lines().filter(|line| line.len() > 5 && line.as_bytes()[3] == b'h');
            let ids: Vec<&str> = rows.map(|line| &line[..3]).collect();
            assert!(ids.len() == 16 && ids.is_sorted(), "{text}");
            for line in text.lines() {
                let is_long = changes.contains(&long) && line.contains("a-left-drive-with");
                assert!(line.chars().count() <= 80 || is_long, "{line}");
            }
        }
    }

    #[test]
    fn tables() {
        insta::assert_snapshot!("bus-budget", text(&plans(&changed(&[]).value).unwrap()));
        let slow = changed(&[("bit_rate_bit_per_s: 1000000", "bit_rate_bit_per_s: 500000")]);
        insta::assert_snapshot!("bus-budget-slow", text(&plans(&slow.value).unwrap()));
    }

    #[test]
    fn findings_say_which_frame_how_late_and_what_to_change() {
        let early = drawn(&[("compute_at_us: 620", "compute_at_us: 500")]);
        let late = drawn(&[("compute_at_us: 620", "compute_at_us: 900")]);
        let slow = drawn(&[("bit_rate_bit_per_s: 1000000", "bit_rate_bit_per_s: 500000")]);
        let ideal = drawn(&[("compute_at_us: 620", "compute_at_us: 500"), IDEAL]);
        insta::assert_snapshot!("bus-findings", [early, late, slow, ideal].join("\n"));
    }

    #[test]
    fn the_document_has_the_keys_that_programs_read() {
        let rig = changed(&[]);
        let document = to_json(&plans(&rig.value).unwrap());
        assert_eq!(document["bus"], json!("main"));
        assert_eq!((&document["bit_rate"], &document["cycle_us"]), (&json!(1_000_000), &json!(1000)));
        assert_eq!(document["schedulable"], json!(true));
        assert!((document["load_worst"].as_f64().unwrap() - 0.738).abs() < 1e-9);
        let sync = &document["frames"][0];
        assert_eq!((&sync["name"], &sync["cob_id"], &sync["bytes"]), (&json!("SYNC"), &json!(0x80), &json!(0)));
        assert_eq!((&sync["bits_worst"], &sync["deadline_us"]), (&json!(55), &json!(620)));
        assert!(sync["response_time_us"].as_u64().is_some());
        let slow = changed(&[("bit_rate_bit_per_s: 1000000", "bit_rate_bit_per_s: 250000")]);
        let document = to_json(&plans(&slow.value).unwrap());
        assert_eq!((&document["schedulable"], &document["advice"]["bit_rate"]), (&json!(false), &json!(1_000_000)));
        assert!(document["frames"].as_array().unwrap().iter().any(|frame| frame["response_time_us"].is_null()));
    }
}
