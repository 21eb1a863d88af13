//! The page of a build that has none.

use super::{Arguments, PageOf, PlayArguments, ViewArgument};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_config as config;
use yieldwall_fieldbus::time::Time;
use yieldwall_record::CycleRecord;
use yieldwall_run::Watch;

fn lacks(what: &str) -> Failure {
    let help = "build the program with it: `cargo build --release --features view`";
    Failure::new(Exit::Usage, format!("this build has no `{what}`"), help)
}

pub(crate) fn view(arguments: &Arguments, _: &mut Output) -> Result<(), Failure> {
    let Arguments { recordings: _, on: _, no_open: _ } = arguments;
    Err(lacks("view"))
}

pub(crate) fn play(arguments: &PlayArguments, _: &mut Output) -> Result<(), Failure> {
    let PlayArguments { rig: _, view: _, no_open: _, record: _ } = arguments;
    Err(lacks("play"))
}

/// Placeholder of the page.
#[derive(Default)]
pub(crate) struct Page(());

impl Page {
    /// Refuses one.
    pub(crate) fn open(&mut self, argument: &ViewArgument, _: &config::Rig, of: PageOf) -> Result<(), Failure> {
        let PageOf { command: _, pace: _ } = of;
        argument.view.map_or(Ok(()), |_| Err(lacks("--view")))
    }

    /// Whether there is one.
    pub(crate) fn is_open(&self) -> bool {
        false
    }

    /// Returns no observer.
    pub(crate) fn watch(&mut self) -> Watch {
        Watch::default()
    }

    /// Returns no observer.
    pub(crate) fn watch_by_the_clock(&mut self) -> Watch {
        Watch::default()
    }

    /// Shows nothing.
    pub(crate) fn show_devices(
        &mut self,
        _: &config::Rig,
    ) -> impl FnMut(Time, &mut dyn FnMut() -> CycleRecord) + use<> {
        |_, _| ()
    }

    /// Does nothing.
    pub(crate) fn end(self, _: &Result<(), Failure>) {}
}
