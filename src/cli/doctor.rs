//! `yieldwall doctor`: diagnoses this computer, an interface or a node, and prints the command that fixes it.

use std::path::Path;
use std::time::Duration;

use serde_json::json;

use super::checkup::{Section, finish};
use super::clock::now_unix_s;
use super::desk;
use super::desk::doctor::second_opinion::{self, Consent};
use super::failure::{Exit, Failure};
use super::interfaces::Interfaces;
use super::keep::state_folder;
use super::output::Output;
use yieldwall_config::{self as config, Rig, Source};
use yieldwall_link::checkup::Check;
use yieldwall_link::{Attachment, InterfaceFacts, is_ethernet};
use yieldwall_run::host::Untimely;
use yieldwall_run::host::system::{ComputerFacts, Limits, Readiness, coalescing, coalescing_check, computer, limits};

/// Cycle for which a computer is judged, unless a rig has another one.
const PERIOD_US: u32 = 1000;

#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub(super) struct Arguments {
    /// Rig whose cycle, bit rates and devices are checked; default: a cycle of 1 ms
    #[arg(value_name = "RIG.yaml")]
    rig: Option<String>,
    /// Interface to check, with its devices; repeatable, as NAME=INTERFACE for a rig with several buses
    #[arg(long, value_name = "INTERFACE")]
    bus: Vec<String>,
    /// Network card whose interrupt coalescing is checked; repeatable
    #[arg(long, value_name = "INTERFACE")]
    card: Vec<String>,
    /// EtherCAT: compare the readings with those of another master, ethercrab
    ///
    /// The command asks first, since all devices go through INIT and get new station addresses; it restores state and address. Needs a
    /// build with `--features ethercrab`.
    #[arg(long, requires = "bus")]
    second_opinion: bool,
    /// Skip the question of --second-opinion
    #[arg(long, requires = "second_opinion")]
    yes: bool,
    #[command(subcommand)]
    subject: Option<Subject>,
}

#[derive(Debug, clap::Subcommand)]
enum Subject {
    /// Diagnose why a node does not answer
    Node(desk::doctor::Arguments),
    /// Read a segment with ethercrab, for the process that runs the second opinion
    #[cfg(feature = "ethercrab")]
    #[command(hide = true)]
    Ethercrab(second_opinion::Arguments),
}

/// An interface to check.
struct Wanted {
    interface: String,
    /// Arguments with which a device command reaches this place.
    argument: String,
    /// Bit rate of the rig in bit/s.
    bit_rate: Option<u32>,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    match &arguments.subject {
        Some(Subject::Node(node)) => return desk::doctor::run(node, output),
        #[cfg(feature = "ethercrab")]
        Some(Subject::Ethercrab(ethercrab)) => return second_opinion::run(ethercrab, output),
        None => {}
    }
    let rig = match &arguments.rig {
        Some(name) => {
            let rig = config::load_rig(Source::named(name))?;
            output.configuration(&rig.warnings)?;
            Some(rig.value)
        }
        None => None,
    };
    let wanted = wanted(arguments, rig.as_ref())?;
    let is_segment = |wanted: &Wanted| rig.as_ref().map_or_else(|| is_ethernet(&wanted.interface), Rig::is_on_ethercat);
    let consent = arguments.second_opinion.then(|| consent(&wanted, is_segment, arguments.yes)).transpose()?;
    let period_us = period_us(rig.as_ref());
    let period = Duration::from_micros(period_us.into());
    let mut sections = vec![of_computer(rig.as_ref())];
    let mut opinions = Vec::new();
    for wanted in &wanted {
        if is_segment(wanted) {
            let rig = arguments.rig.as_deref();
            let (interface, argument) = (&wanted.interface, &wanted.argument);
            let (more, opinion) = desk::doctor::on_segment(interface, argument, rig, consent.as_ref(), output)?;
            sections.extend(more);
            opinions.extend(opinion);
            continue;
        }
        let section = of_interface(&wanted.interface, wanted.bit_rate, period);
        let is_usable = !section.is_wrong();
        sections.push(section);
        if is_usable {
            let more = arguments.rig.as_ref().map_or(String::new(), |rig| format!(" --rig {rig}"));
            let commands = format!(" --bus {}{more}", wanted.argument);
            let checks = desk::doctor::devices(&wanted.argument, rig.as_ref(), &commands)?;
            sections.push(Section::new(format!("devices on {}", wanted.interface), Exit::DeviceMismatch, checks));
        }
    }
    if !arguments.card.is_empty() {
        let checks = arguments.card.iter().map(|card| coalescing_check(card, coalescing(card)));
        sections.push(Section::new("network cards", Exit::BusUnavailable, checks.collect()));
    }
    // Obstacles to sending come before late frames.
    sections.sort_by_key(|section| section.exit.code());
    let mut document = json!({ "period_us": period_us });
    if consent.is_some() {
        document["second_opinions"] = opinions.into();
    }
    finish(&sections, document, output)
}

/// Returns a person's consent to the second opinion on all checked segments.
fn consent(wanted: &[Wanted], is_segment: impl Fn(&Wanted) -> bool, is_given: bool) -> Result<Consent, Failure> {
    let segments = wanted.iter().filter(|wanted| is_segment(wanted)).map(|wanted| wanted.interface.as_str());
    let segments: Vec<&str> = segments.collect();
    if segments.is_empty() {
        let message = "--second-opinion is for devices on EtherCAT, and no --bus names an Ethernet interface";
        return Err(Failure::new(Exit::Usage, message, "name it, for example --bus eth0"));
    }
    second_opinion::consent(&segments, is_given)
}

/// Returns the interfaces with the rig's data on their buses.
fn wanted(arguments: &Arguments, rig: Option<&Rig>) -> Result<Vec<Wanted>, Failure> {
    let Some(rig) = rig.filter(|_| !arguments.bus.is_empty()) else {
        if let Some(named) = arguments.bus.iter().find(|bus| bus.contains('=')) {
            let message = format!("--bus {named} names a bus of a rig, but there is no rig");
            return Err(Failure::new(Exit::Usage, message, "name the rig, or omit the name of the bus"));
        }
        let of = |bus: &String| Wanted { interface: bus.clone(), argument: bus.clone(), bit_rate: None };
        return Ok(arguments.bus.iter().map(of).collect());
    };
    let interfaces = Interfaces::of(rig, &arguments.bus)?;
    let is_only = rig.buses.len() == 1;
    let of = |((name, bus), interface): ((&String, &config::Bus), &String)| Wanted {
        interface: interface.clone(),
        argument: if is_only { interface.clone() } else { format!("{name}={interface}") },
        bit_rate: bus.canopen().map(|bus| bus.bit_rate_bit_per_s),
    };
    Ok(rig.buses.iter().zip(interfaces.names()).map(of).collect())
}

/// Returns the checks of this computer, and of each of its CAN interfaces, without sending a frame.
#[cfg(feature = "full")]
pub(super) fn text(rig: Option<&Rig>) -> String {
    let period = Duration::from_micros(period_us(rig).into());
    let of_interfaces = yieldwall_link::interfaces().into_iter().map(|name| of_interface(&name, None, period));
    std::iter::once(of_computer(rig)).chain(of_interfaces).map(|section| section.text()).collect()
}

fn period_us(rig: Option<&Rig>) -> u32 {
    rig.map_or(PERIOD_US, |rig| rig.cycle.period_us)
}

/// Checks this computer.
fn of_computer(rig: Option<&Rig>) -> Section {
    let period_us = period_us(rig);
    let limits = limits();
    let mut checks = ComputerFacts::read(Path::new("/")).checks(Duration::from_micros(period_us.into()));
    checks.extend(limits.checks());
    checks.extend(rig.map(|rig| timing(rig, &limits)));
    Section::new(format!("this computer, for a cycle of {period_us} us"), Exit::TimingMissed, checks)
}

/// Checks an interface.
fn of_interface(name: &str, bit_rate: Option<u32>, period: Duration) -> Section {
    let checks = match InterfaceFacts::read(name, bit_rate) {
        Err(error) => vec![error.check()],
        Ok(facts) => interface_checks(&facts, bit_rate, period),
    };
    Section::new(format!("interface {name}"), Exit::BusUnavailable, checks)
}

fn interface_checks(facts: &InterfaceFacts, bit_rate: Option<u32>, period: Duration) -> Vec<Check> {
    let mut checks = facts.checks(bit_rate);
    let attachment = facts.attachment.to_string();
    checks.push(match facts.attachment.too_slow_for(period.as_micros() as u32) {
        Some((why, help)) => Check::warning("attachment", format!("`{}` {why}", facts.name)).follows(help),
        None if facts.attachment == Attachment::Unknown => Check::unknown("attachment", attachment),
        None => Check::ok("attachment", attachment),
    });
    if !facts.is_virtual() {
        let threads = Readiness::read(Path::new("/"), Some(&facts.name)).checks(period, Some(&facts.name));
        checks.extend(threads.into_iter().filter(|check| matches!(check.subject, "interrupt" | "softirq")));
    }
    checks
}

/// Returns the tier that this computer has proved for a rig, if it has proved one.
#[cfg(feature = "view")]
pub(super) fn proven_tier(rig: &Rig) -> Option<String> {
    let (folder, limits) = (state_folder("latency")?, limits());
    let computer = computer(limits.priority.is_ok(), limits.memory.is_ok());
    computer.check(rig, &folder, now_unix_s()).ok().map(|kept| kept.tier.to_string())
}

/// Checks the timing that this computer has proved for a rig.
fn timing(rig: &Rig, limits: &Limits) -> Check {
    let subject = "timing";
    let Some(folder) = state_folder("latency") else {
        return Check::unknown(subject, "no folder for measurements: set XDG_STATE_HOME or HOME");
    };
    let computer = computer(limits.priority.is_ok(), limits.memory.is_ok());
    let period_us = rig.cycle.period_us;
    let measure = format!("yieldwall latency --period-us {period_us} --duration 60");
    match computer.check(rig, &folder, now_unix_s()) {
        Ok(kept) => Check::ok(subject, format!("tier {} is proved: {}", kept.tier, kept.shown)),
        Err(Untimely::Missing { .. }) => {
            Check::unknown(subject, "the wake-up latency of this computer is not measured yet")
                .follows("`run --bus` requires this measurement, except in lockstep")
                .fix(measure)
        }
        Err(error @ Untimely::Short { .. }) => {
            Check::wrong(subject, error.to_string()).follows("measure again").fix(measure)
        }
        Err(error) => Check::wrong(subject, error.to_string())
            .follows("fix the findings above, or use a slower cycle; then measure again")
            .fix(measure),
    }
}
