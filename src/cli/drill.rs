//! `yieldwall drill`: do the drives stop by themselves when the master falls silent?

use std::sync::{Arc, mpsc};
use std::thread;

use serde_json::json;

use super::failure::{Exit, Failure};
use super::interfaces::Interfaces;
use super::keep::state_folder;
use super::live::{
    News, boot_watch, different, live_failure, on_interrupt, open, print_news, warn_of, with_emergencies,
};
use super::output::Output;
use super::run::{judge, rig_failure, watchdogs_json, watchdogs_text};
use crate::config::{self, Source};
use crate::host::system::{SystemMetronome, lock_memory, run_first};
use crate::run::{Drilled, Pace, RunError, Runner, Subject, drive_addresses, settling_on_bus};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The rig; `builtin:paper-admittance.yaml` names the copy inside the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// The interface; for a rig with several buses once for each, as NAME=INTERFACE
    #[arg(long, value_name = "INTERFACE", required = true)]
    bus: Vec<String>,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.warnings(&rig.warnings);
    let rig = rig.value;
    let folder = state_folder("drills").ok_or_else(no_home)?;
    let is_interrupted = on_interrupt()?;
    // A drill on a computer that grants nothing is coarser, and says so by its resolution.
    warn_of(output, &lock_memory());
    let link = open(&Interfaces::of(&rig, &arguments.bus)?, &rig)?;
    let mut machine = Runner::on_link(&rig, link, SystemMetronome, Pace::Free).map_err(|error| live_failure(&error))?;
    let drives = drive_addresses(&rig).map_err(|error| rig_failure(&error.into()))?;
    let settling = settling_on_bus(&rig);
    output.news("the rig is enabled three times, at rest; nobody may hold the handle")?;
    let (news, told) = mpsc::channel();
    machine.set_boot_watch(boot_watch(news.clone(), Arc::clone(&is_interrupted)));
    let drilling = move || {
        // Nobody listens if the thread that waits has died.
        let _ = run_first().map_err(|refusal| news.send(News::Refused(refusal.to_string())));
        let booted = machine.boot().and_then(|()| machine.check_simulation(drives));
        let known = booted.and_then(|()| machine.identities(drives));
        let drilled: Result<_, RunError> =
            known.and_then(|identities| Ok((identities, machine.drill(drives, settling, &is_interrupted)?)));
        machine.leave();
        (drilled, different(machine.master().emergencies().map(|(_, emergency)| emergency)))
    };
    let thread = thread::Builder::new().name("cycle".to_owned()).spawn(drilling);
    let thread = thread.map_err(|error| Failure::new(Exit::Internal, format!("thread of the cycle: {error}"), ""))?;
    print_news(&told, false, output);
    let (drilled, emergencies) =
        thread.join().map_err(|_| Failure::new(Exit::Internal, "the thread of the cycle has panicked", ""))?;
    let (identities, drilled) = drilled.map_err(|error| with_emergencies(live_failure(&error), &emergencies, &rig))?;
    let path = Subject::new(&rig, identities).store(&drilled, &folder).map_err(|error| {
        Failure::new(Exit::Usage, format!("{}: {error}", folder.display()), "make the folder one that can be written")
    })?;
    let done = format!("the rig was enabled at rest for each of {} watchdogs and is stopped", drilled.findings.len());
    let judged = judge(&drilled, &rig, &done);
    if !output.is_json() {
        output.news(&lines(&drilled, &path.display().to_string()))?;
        return judged;
    }
    let document = json!({ "drives": identities, "watchdogs": watchdogs_json(&drilled), "record": path });
    output.end(document, judged)
}

fn lines(drilled: &Drilled, path: &str) -> String {
    format!("{}\nrecord    {path}", watchdogs_text(drilled))
}

/// The failure that there is no place for records.
pub(super) fn no_home() -> Failure {
    let message = "there is no folder for the records of drills: neither XDG_STATE_HOME nor HOME is set";
    Failure::new(Exit::Usage, message, "set XDG_STATE_HOME to a folder that is kept")
}
