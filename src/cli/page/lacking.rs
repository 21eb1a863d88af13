//! The page of a build that has none.

use super::{Arguments, ViewArgument};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_config as config;
use yieldwall_run::Watch;

fn lacks(what: &str) -> Failure {
    let help = "build the program with it: `cargo build --release --features view`";
    Failure::new(Exit::Usage, format!("this build has no `{what}`"), help)
}

pub(crate) fn view(arguments: &Arguments, _: &mut Output) -> Result<(), Failure> {
    let Arguments { recordings: _, on: _, no_open: _ } = arguments;
    Err(lacks("view"))
}

/// No page.
#[derive(Default)]
pub(crate) struct Page(());

impl Page {
    /// Refuses one.
    pub(crate) fn open(&mut self, argument: &ViewArgument, _: &config::Rig) -> Result<(), Failure> {
        argument.view.map_or(Ok(()), |_| Err(lacks("--view")))
    }

    /// Whether there is one.
    pub(crate) fn is_open(&self) -> bool {
        false
    }

    /// No observer.
    pub(crate) fn watch(&mut self) -> Watch {
        Watch::default()
    }

    /// Does nothing.
    pub(crate) fn end(self, _: &Result<(), Failure>) {}
}
