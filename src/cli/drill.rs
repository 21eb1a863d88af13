//! `yieldwall drill`: do the drives stop by themselves when the master falls silent?

use std::io;

use serde_json::json;

use super::bus::check_buses;
use super::desk::journal::{journals, not_opened};
use super::desk::plan::{self, Sender};
use super::events::{Events, Listening, Stream};
use super::failure::{self, Exit, Failure};
use super::interfaces::Interfaces;
use super::interrupt::on_interrupt;
use super::keep::state_folder;
use super::on_bus::{
    different, live_failure, point_to_node, point_to_resets, thread_failure, told_before, warn, warn_of, with_told,
};
use super::output::Output;
use super::report_text::{settled_json, settled_text, watchdogs_json, watchdogs_text};
use super::unsafe_drives::judge;
use yieldwall_config::{self as config, Source};
use yieldwall_record::trusted;
use yieldwall_run::host::{News, RigOnBus};
use yieldwall_run::recorder::Watched;
use yieldwall_run::{Drilled, Pace, Subject, watchdogs};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Rig file; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Interface of the bus; for a rig with several buses once for each, as NAME=INTERFACE
    #[arg(long, value_name = "INTERFACE", required_unless_present = "dry_run")]
    bus: Vec<String>,
    #[command(flatten)]
    pub(super) stream: Stream,
    /// Print what would be sent to each device, old -> new; only read objects
    ///
    /// Without --bus the command reads the objects of the simulated devices.
    #[arg(long)]
    dry_run: bool,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let events = Events::of(output);
    let end = drill(arguments, &events, output);
    events.end(&end);
    end
}

fn drill(arguments: &Arguments, events: &Events, output: &mut Output) -> Result<(), Failure> {
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.configuration(&rig.warnings)?;
    check_buses(&rig, None, output)?;
    if arguments.dry_run {
        let buses = match arguments.bus.as_slice() {
            [] => Vec::new(),
            several => Interfaces::of(&rig.value, several)?.named(&rig.value),
        };
        return plan::run(&rig, &buses, Sender::Drill, output);
    }
    let rig = rig.value;
    let folder = state_folder("drills").ok_or_else(no_home)?;
    let unkept = |error: io::Error| {
        Failure::new(Exit::Usage, format!("{}: {error}", folder.display()), "make this folder writable")
    };
    // Before anything moves.
    trusted::make_folder(&folder).map_err(unkept)?;
    let is_interrupted = on_interrupt()?;
    let interfaces = Interfaces::of(&rig, &arguments.bus)?;
    let on_bus = RigOnBus::open(&rig, interfaces.names(), Pace::Free, &journals("drill"));
    let mut on_bus = on_bus.map_err(|error| not_opened(&error, &rig, &arguments.rig, &interfaces))?;
    warn_of(output, on_bus.memory());
    let times = match watchdogs(&rig).len() {
        1 => "once".to_owned(),
        several => format!("{several} times"),
    };
    output.news(&format!("the drill enables the rig {times}, at rest; nobody may hold the handle"))?;
    let (listening, watch) = Listening::start(events, Watched::Interfaces(interfaces.names()), &rig)?;
    on_bus.set_watch(watch);
    let outcome = on_bus.drill(&is_interrupted, |news| match news {
        News::Refused(refusal) => warn(output, refusal),
        news => events.news(news),
    });
    listening.finish()?;
    events.clear();
    let outcome = outcome.map_err(|error| thread_failure(&error))?;
    let emergencies = different(outcome.emergencies.into_iter());
    let (identities, drilled) = outcome.drilled.map_err(|error| {
        let failure = point_to_node(live_failure(&error), &error, &rig, &arguments.rig, &interfaces);
        let failure = with_told(failure, &told_before(&error, &emergencies, &rig), &outcome.errors, &rig);
        point_to_resets(failure, &outcome.errors, &rig, &arguments.rig, &interfaces)
    })?;
    let path = Subject::new(&rig, identities).store(&drilled, &folder).map_err(unkept)?;
    let done = match drilled.findings.len() {
        1 => "the rig was enabled at rest for its watchdog, and has stopped".to_owned(),
        several => format!("the rig was enabled at rest for each of {several} watchdogs, and has stopped"),
    };
    let judged = judge(&drilled, &rig, &done);
    events.end(&judged);
    if !output.is_json() {
        let verdict = failure::verdict(&judged, || "the drives stop by their watchdogs".to_owned());
        output.news(&format!("{verdict}\n{}", lines(&drilled, &rig, &path.display().to_string())))?;
        return judged;
    }
    let document = json!({ "drives": identities, "watchdogs": watchdogs_json(&drilled), "settled": settled_json(&drilled.settled(&rig)), "record": path });
    output.end(document, judged)
}

fn lines(drilled: &Drilled, rig: &config::Rig, path: &str) -> String {
    let mut lines = vec![watchdogs_text(drilled)];
    lines.extend(settled_text(&drilled.settled(rig)));
    lines.push(format!("record    {path}"));
    lines.join("\n")
}

/// Returns the failure that there is no place for records.
pub(super) fn no_home() -> Failure {
    let message = "no folder for the records of drills: neither XDG_STATE_HOME nor HOME is set";
    Failure::new(Exit::Usage, message, "set XDG_STATE_HOME to a permanent folder")
}
