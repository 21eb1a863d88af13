//! The commissioning of a rig on real buses, with questions on the terminal to a person at the arm.

use std::io::{self, Write};
use std::sync::Arc;
use std::time::Duration;

use serde_json::json;

use super::{Arguments, Earlier, Machine, Taken, begin, end, told};
use crate::at_the_arm::Typed;
use crate::clock::now_unix_s;
use crate::confirm::agreed;
use crate::desk::journal::{journal_failure, journals, restored};
use crate::events::Events;
use crate::failure::{Exit, Failure, both};
use crate::first_motion::{Opened, concluded};
use crate::interfaces::Interfaces;
use crate::interrupt::on_interrupt;
use crate::live::not_run;
use crate::on_bus::{warn, with_told};
use crate::output::Output;
use crate::page::{Page, PageOf};
use yieldwall_config as config;
use yieldwall_motion::quantity::Force;
use yieldwall_run::commission::{Begin, STEPS};
use yieldwall_run::host::{News, Person};
use yieldwall_service::OnInterfaces;

/// Time in which drives have started after power-on.
const BOOTS_WITHIN: Duration = Duration::from_secs(10);

/// Somebody at the arm, or nobody.
struct AtTheTerminal {
    /// Names of the drives; nobody is asked without them.
    names: Option<[String; 2]>,
    typed: Typed,
}

impl Person for AtTheTerminal {
    fn look(&mut self, joint: usize) {
        if let Some(name) = self.names.as_ref().and_then(|names| names.get(joint)).cloned() {
            self.typed.ask(&format!(
                "Note the angle of the proximal link of {name}, for example with a digital protractor, and press Enter:"
            ));
        }
    }

    fn turned(&mut self, joint: usize) -> Option<f64> {
        let name = self.names.as_ref()?.get(joint)?.clone();
        let question = format!(
            "By how many degrees has the proximal link of {name} turned since then? Counter-clockwise, seen from above, is positive. The link turns back \
             and forth, so that one of the two angles is negative. Press Enter alone if you have not looked:"
        );
        loop {
            let text = self.typed.ask(&question).filter(|text| !text.is_empty())?;
            match text.trim_end_matches("deg").trim().parse::<f64>() {
                Ok(degrees) if degrees.is_finite() && degrees.abs() <= 360.0 => return Some(degrees.to_radians()),
                // Nothing is lost if standard error is closed.
                _ => drop(writeln!(io::stderr(), "write a number of degrees, such as 4.1")),
            }
        }
    }

    fn power_cycle(&mut self, restarted: &mut dyn FnMut() -> [bool; 2]) -> bool {
        let Some(names) = &self.names else { return false };
        let question = "Switch the supply of both drives off and on again, including the logic supply. Write yes once they are on; anything else \
                        skips this check:";
        loop {
            let is_on = self.typed.agrees_while(question, || {
                restarted();
            });
            if !is_on {
                return false;
            }
            let mut seen = [false; 2];
            let has_restarted = self.typed.wait(BOOTS_WITHIN, || {
                seen = restarted();
                seen == [true; 2]
            });
            if has_restarted {
                return true;
            }
            for (name, _) in names.iter().zip(seen).filter(|(_, seen)| !seen) {
                // Nothing is lost if standard error is closed.
                let _ = writeln!(
                    io::stderr(),
                    "{name} has not restarted since the question: its logic supply was not off, or is not on yet"
                );
            }
        }
    }

    fn accepts_drive_limit(&mut self, text: &str) -> bool {
        // With --yes nobody is asked; --accept-drive-limit says it then.
        self.names.is_some() && self.typed.agrees_while(&format!("{text} Write yes to accept this limit:"), || ())
    }

    fn pull(&mut self, force: Force) -> bool {
        if self.names.is_none() {
            return false;
        }
        self.typed.pull(force, "anything else skips the step")
    }
}

/// Restores the devices' values from before killed commands. Returns whether there was such a command.
fn close_journals(interfaces: &Interfaces, output: &mut Output) -> Result<bool, Failure> {
    let mut are_closed = false;
    // A person who wants the program to end waits for it.
    on_interrupt()?;
    while let Some(left) =
        journals("commission").left_on(interfaces.names()).map_err(|error| journal_failure(&error))?
    {
        output.aside(&left.to_string());
        restored(left.restore(&mut OnInterfaces), output)?;
        are_closed = true;
    }
    Ok(are_closed)
}

pub(super) fn run(
    arguments: &Arguments,
    file: &str,
    loaded: &config::Loaded<config::Rig>,
    output: &mut Output,
) -> Result<(), Failure> {
    let rig = &loaded.value;
    if arguments.restore {
        let are_closed = close_journals(&arguments.on_bus.interfaces(rig)?, output)?;
        return match output.is_json() {
            true => output.report(json!({ "restored": are_closed })),
            false => output.news(if are_closed {
                "restored  all changed objects"
            } else {
                "restored  nothing: no object of this bus was left changed"
            }),
        };
    }
    let interfaces = arguments.on_bus.interfaces(rig)?;
    let machine = Machine::OnBus { buses: interfaces.named(rig), is_lockstep: !arguments.on_bus.is_by_the_clock() };
    let (begin, earlier) = begin(arguments, rig, &machine, output)?;
    if !arguments.yes {
        for step in STEPS {
            let bound = step
                .motion_bound_rad()
                .map_or(String::new(), |bound| format!(" (limit of a joint: {:.1} deg)", bound.to_degrees()));
            // The person who is asked reads it, whatever else is printed.
            let _ = writeln!(io::stderr(), "{:14} {}{bound}", step.name(), step.does());
        }
        if !agreed("Confirm: the arm is free to move, nobody touches it, and one hand is on the emergency stop") {
            return Err(Failure::new(Exit::Usage, "nothing was done", "answer yes, or add --yes"));
        }
    }
    close_journals(&interfaces, output)?;
    let mut page = Page::default();
    page.open(&arguments.page, rig, PageOf { command: "commission", pace: arguments.on_bus.pace().into() })?;
    let end = commissioned(arguments, (file, loaded), (&machine, begin, earlier), &mut page, output);
    page.end(&end);
    end
}

/// Commissions the rig on its buses, from a step on.
fn commissioned(
    arguments: &Arguments,
    (file, loaded): (&str, &config::Loaded<config::Rig>),
    (machine, begin, earlier): (&Machine, Begin, Option<Earlier>),
    page: &mut Page,
    output: &mut Output,
) -> Result<(), Failure> {
    let (events, rig) = (Events::of(output), &loaded.value);
    let opened = arguments.on_bus.open("commission", file, loaded, output)?;
    let Opened { mut on_bus, terms, interfaces, is_interrupted } = opened;
    on_bus.set_watch(page.watch());
    let names = rig.drives.each_ref().map(|drive| drive.name.clone());
    let mut person =
        AtTheTerminal { names: (!arguments.yes).then_some(names), typed: Typed::new(Arc::clone(&is_interrupted)) };
    let mut ran = Vec::new();
    let outcome = on_bus.commission(&terms, begin, &mut person, &is_interrupted, |news| match news {
        News::Refused(refusal) => warn(output, refusal),
        News::Stepped(report) => {
            events.clear();
            ran.push((report.step, now_unix_s()));
            // What cannot be printed stands in the document all the same.
            let _ = output.news(&told(earlier.as_ref(), &report));
        }
        // It is booted for every motion.
        News::Step(_) | News::Proved => {}
        news => events.news(news),
    });
    let (outcome, given_back) = concluded(&events, outcome, output)?;
    match &outcome.played {
        Ok(commissioned) => {
            let with_emergencies = |failure| with_told(failure, &outcome.emergencies, &outcome.errors, rig);
            let taken = Taken::new(earlier, commissioned.clone(), ran);
            end(arguments, rig, &taken, machine, (with_emergencies, given_back), output)
        }
        Err(error) => both(Err(not_run(error, &outcome, &interfaces, rig, file)), given_back),
    }
}
