//! A rig on real buses that is commissioned, with a person at the arm who is asked on the terminal.

use std::io::{self, BufReader};

use super::{Arguments, end, lines};
use crate::cli::confirm::{agreed, answer};
use crate::cli::events::Events;
use crate::cli::failure::{Exit, Failure};
use crate::cli::interfaces::Interfaces;
use crate::cli::interrupt::on_interrupt;
use crate::cli::live::{evidence, not_run};
use crate::cli::on_bus::{different, open_failure, thread_failure, warn, warn_of};
use crate::cli::output::Output;
use crate::cli::pace::PaceArgument;
use crate::config;
use crate::host::{News, Person, RigOnBus, Terms};
use crate::quantity::Force;
use crate::run::commission::{STEPS, Step};

/// Somebody at the arm, or nobody.
struct AtTheTerminal {
    /// Names of the drives; nobody is asked without them.
    names: Option<[String; 2]>,
}

impl AtTheTerminal {
    fn ask(&self, question: &str) -> Option<String> {
        answer(&mut BufReader::with_capacity(1, io::stdin()), &mut io::stderr(), question)
    }
}

impl Person for AtTheTerminal {
    fn turned(&mut self, joint: usize) -> Option<f64> {
        let name = self.names.as_ref()?.get(joint)?;
        let question = format!(
            "By how many degrees has the proximal link of {name} turned, counter-clockwise as seen from above? \
             Clockwise is negative; nothing if you have not looked:"
        );
        loop {
            let text = self.ask(&question).filter(|text| !text.is_empty())?;
            match text.trim_end_matches("deg").trim().parse::<f64>() {
                Ok(degrees) if degrees.is_finite() && degrees.abs() <= 360.0 => return Some(degrees.to_radians()),
                // Nothing is lost if standard error is closed.
                _ => drop(io::Write::write_all(&mut io::stderr(), b"write a number of degrees, such as 4.1\n")),
            }
        }
    }

    fn pull(&mut self, force: Force) -> bool {
        if self.names.is_none() {
            return false;
        }
        if force == Force::default() {
            self.ask("Take the pull away, then press Enter:");
            return true;
        }
        let (along, size) = if force.x() != 0.0 { ("x", force.x()) } else { ("y", force.y()) };
        let question = format!(
            "Have {size:.0} N pull at the tool along {along} of the base frame, by a weight over a pulley or a spring balance, and write yes; \
             anything else skips the step:"
        );
        self.ask(&question).is_some_and(|text| matches!(text.as_str(), "y" | "yes"))
    }
}

pub(super) fn run(
    arguments: &Arguments,
    file: &str,
    rig: &config::Loaded<config::Rig>,
    output: &mut Output,
) -> Result<(), Failure> {
    let events = Events::of(output);
    let scene = match (&rig.value.simulation, arguments.pace) {
        (None, _) | (_, PaceArgument::Free) => None,
        _ => Some(rig.scene()?.value),
    };
    let rig = &rig.value;
    let from = arguments.from.unwrap_or(Step::Communication);
    if !arguments.yes {
        for step in STEPS {
            let bound = step
                .motion_bound_rad()
                .map_or(String::new(), |bound| format!(" (a joint goes {:.1} deg at most)", bound.to_degrees()));
            output.news(&format!("{:14} {}{bound}", step.name(), step.does()))?;
        }
        if !agreed("Is the arm free to move, does nobody hold it, and has somebody a hand on the emergency stop") {
            return Err(Failure::new(Exit::Usage, "nothing was done", "answer yes, or write --yes"));
        }
    }
    let terms = Terms {
        evidence: evidence(arguments.pace, rig, scene.as_ref())?,
        needs_realtime: false,
        ignores_latency: arguments.ignore_latency,
        ignores_bus_budget: false,
    };
    let is_interrupted = on_interrupt()?;
    let interfaces = Interfaces::of(rig, &arguments.bus)?;
    let on_bus = RigOnBus::open(rig, interfaces.names(), arguments.pace.pace());
    let on_bus = on_bus.map_err(|error| open_failure(&error))?;
    warn_of(output, on_bus.memory());
    let names = rig.drives.each_ref().map(|drive| drive.name.clone());
    let mut person = AtTheTerminal { names: (!arguments.yes).then_some(names) };
    let outcome = on_bus.commission(&terms, from, &mut person, &is_interrupted, |news| match news {
        News::Refused(refusal) => warn(output, refusal),
        News::Stepped(report) => {
            events.clear();
            // What cannot be printed stands in the document all the same.
            let _ = output.news(&lines(&report));
        }
        // It is booted for every motion.
        News::Step(_) | News::Proved => {}
        news => events.news(news),
    });
    events.clear();
    let mut outcome = outcome.map_err(|error| thread_failure(&error))?;
    outcome.emergencies = different(outcome.emergencies.into_iter());
    match &outcome.played {
        Ok(commissioned) => end(arguments, rig, commissioned.clone(), output),
        Err(error) => Err(not_run(error, &outcome, &interfaces, rig, file)),
    }
}
