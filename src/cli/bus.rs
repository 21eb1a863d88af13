//! `yieldwall bus`: the capacity of a rig's bus.

mod can;
mod frame;
mod segment;

use std::time::Duration;

use serde_json::{Value, json};

use self::can::CanPlan;
use self::segment::SegmentPlan;
use super::ending::rig_failure;
use super::failure::{Exit, Failure};
use super::output::Output;
use yieldwall_bus::budget::{Budget, Conditions};
use yieldwall_config::{self as config, Bus, Diagnostic, Loaded, Report, Rig, Severity, Source};
use yieldwall_rig::RigError;
use yieldwall_run::assembly::{bus_id, bus_plan, segment};

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    /// Compute the longest time of every frame on a rig's bus, and check the cycle
    ///
    /// On CAN the command computes worst-case response times after Davis, Burns, Bril and Lukkien (2007). On EtherCAT it computes
    /// the time of each frame on its way. If a bus cannot keep the cycle, this is a result, not an error: the exit code is 0.
    /// docs/bus-budget.md describes the method and its assumptions.
    Budget(Arguments),
}

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Rig file; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// CAN only: longest time from the end of SYNC until a device has queued its TPDO; simulated devices need none
    #[arg(long, value_name = "US", default_value_t = 0)]
    device_delay_us: u32,
    /// CAN only: release all frames at one moment
    ///
    /// Without this option TPDOs follow SYNC, and RPDOs follow the control step. With --no-fifo this is the published analysis unchanged,
    /// including its bit counts.
    #[arg(long)]
    no_release_jitter: bool,
    /// CAN only: send the master's frames by priority, instead of through the FIFO of a Linux host
    #[arg(long)]
    no_fifo: bool,
}

pub(super) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    let Command::Budget(arguments) = command;
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    if !rig.value.is_on_can() {
        check_arguments(arguments)?;
    }
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

/// Refuses arguments that have no meaning without a CAN bus.
fn check_arguments(arguments: &Arguments) -> Result<(), Failure> {
    let given = [
        ("--device-delay-us", arguments.device_delay_us > 0),
        ("--no-release-jitter", arguments.no_release_jitter),
        ("--no-fifo", arguments.no_fifo),
    ];
    let Some((name, _)) = given.into_iter().find(|(_, is_given)| *is_given) else { return Ok(()) };
    let message = format!("{name} is for a CAN bus, but this rig is on EtherCAT");
    Err(Failure::new(Exit::Usage, message, format!("omit {name}")))
}

fn failure(error: &RigError) -> Failure {
    Failure::new(Exit::ConfigInvalid, error.to_string(), "run `yieldwall config check` on the rig")
}

/// The budget of one of a rig's buses, and its source.
#[derive(Debug)]
pub(super) enum Plan<'a> {
    Can(Box<CanPlan<'a>>),
    Segment(Box<SegmentPlan<'a>>),
}

/// Returns the budgets of all buses, as a run takes them.
pub(super) fn plans(rig: &Rig) -> Result<Vec<Plan<'_>>, RigError> {
    plans_under(rig, |conditions| conditions)
}

fn plans_under(rig: &Rig, change: impl Fn(Conditions) -> Conditions) -> Result<Vec<Plan<'_>>, RigError> {
    let of_can = if rig.is_on_can() { Some(bus_plan(rig)?) } else { None };
    let (setup, conditions) = of_can.map_or((None, Vec::new()), |(setup, conditions)| (Some(setup), conditions));
    let conditions: Vec<Conditions> = conditions.into_iter().map(change).collect();
    let each = rig.buses.iter().map(|(name, bus)| {
        let id = bus_id(rig, name)?;
        let own = conditions.iter().find(|own| own.bus == id);
        Ok(match (bus, &setup, own) {
            (Bus::Canopen(_), Some(setup), Some(own)) => {
                let others = conditions.iter().filter(|other| other.bus != id).copied().collect();
                let (setup, budget) = (setup.clone(), Budget::new(setup, *own)?);
                Some(Plan::Can(Box::new(CanPlan { rig, name, setup, budget, others })))
            }
            (Bus::Canopen(_), ..) => None,
            (Bus::Ethercat(_), ..) => Some(Plan::Segment(Box::new(SegmentPlan::new(rig, name, segment(rig)?)))),
        })
    });
    let plans: Vec<Option<Plan<'_>>> = each.collect::<Result<_, RigError>>()?;
    Ok(plans.into_iter().flatten().collect())
}

/// Names the bus, if there are several.
fn called(rig: &Rig, before: &str, name: &str) -> String {
    if rig.buses.len() > 1 { format!("{before}{name}") } else { String::new() }
}

/// Returns the text: one table for each bus.
fn text(plans: &[Plan<'_>]) -> String {
    plans.iter().map(Plan::text).collect::<Vec<_>>().join("\n")
}

/// Returns all budgets as data: of the only bus, or of each.
pub(super) fn to_json(plans: &[Plan<'_>]) -> Value {
    if let [plan] = plans {
        return plan.to_json();
    }
    json!({
        "schedulable": plans.iter().all(Plan::is_schedulable),
        "buses": plans.iter().map(Plan::to_json).collect::<Vec<_>>(),
    })
}

impl Plan<'_> {
    fn is_schedulable(&self) -> bool {
        match self {
            Plan::Can(plan) => plan.budget.is_schedulable(),
            Plan::Segment(plan) => plan.is_schedulable(),
        }
    }

    /// Returns the name of the bus, and the largest share of its time that frames take.
    #[cfg(feature = "view")]
    pub(super) fn load(&self) -> (&str, f64) {
        match self {
            Plan::Can(plan) => (plan.name, plan.budget.load()),
            Plan::Segment(plan) => plan.load(),
        }
    }

    /// Whether every frame is always in time, or takes none.
    pub(super) fn is_kept(&self) -> bool {
        match self {
            Plan::Can(plan) => plan.is_kept(),
            Plan::Segment(plan) => plan.is_kept(),
        }
    }

    /// Returns the smallest change with which every frame is in time. It holds the bit rate of a CAN bus, the period, and the first
    /// and last moment of the computation in whole us.
    pub(super) fn advice(&self) -> Option<(Option<u32>, Duration, [u64; 2])> {
        match self {
            Plan::Can(plan) => plan.advice().map(|found| (Some(found.bit_rate), found.period, found.compute_at_us)),
            Plan::Segment(plan) => plan.advice().map(|found| (None, found.period, found.compute_at_us)),
        }
    }

    /// Returns the line for `config check`.
    pub(super) fn line(&self) -> String {
        match self {
            Plan::Can(plan) => plan.line(),
            Plan::Segment(plan) => plan.line(),
        }
    }

    /// Returns the text for a person in 80 columns.
    fn text(&self) -> String {
        match self {
            Plan::Can(plan) => plan.text(),
            Plan::Segment(plan) => plan.text(),
        }
    }

    /// Returns the finding on a bus that cannot keep the cycle, for an operator who wants to run the rig: an error, or a warning
    /// for a bus without timing. Returns `None` if the bus keeps the cycle.
    pub(super) fn finding(&self, file: &Loaded<Rig>) -> Option<Diagnostic> {
        match self {
            Plan::Can(plan) => plan.finding(file),
            Plan::Segment(plan) => plan.finding(file),
        }
    }

    /// Returns the data for a program.
    fn to_json(&self) -> Value {
        match self {
            Plan::Can(plan) => plan.to_json(),
            Plan::Segment(plan) => plan.to_json(),
        }
    }
}

/// Checks that the buses keep the cycle. A bus with timing that does not is an error, unless the options ignore it.
pub(super) fn check_buses(rig: &Loaded<Rig>, is_ignored: Option<bool>, output: &mut Output) -> Result<(), Failure> {
    for plan in plans(&rig.value).map_err(|error| rig_failure(&error))? {
        let Some(mut finding) = plan.finding(rig) else { continue };
        if finding.severity == Severity::Error && is_ignored != Some(true) {
            let more = is_ignored.map_or("", |_| "; --ignore-bus-budget runs the rig anyway");
            finding.help = finding.help.map(|help| help + more);
            return Err(Report::from(finding).into());
        }
        finding.severity = Severity::Warning;
        output.configuration(&[finding])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_config::{builtin, builtin_names, load_rig};

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

    /// Returns the shipped rig in torque mode with some of its text replaced.
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
                assert!(plan.is_schedulable(), "{name}:\n{}", plan.text());
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
