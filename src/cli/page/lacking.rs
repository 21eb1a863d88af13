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

pub(crate) fn view(_: &Arguments, _: &mut Output) -> Result<(), Failure> {
    Err(lacks("view"))
}

/// A page, which no value stands for.
pub(crate) enum Viewing {}

impl Viewing {
    /// Refuses a page.
    pub(crate) fn start(
        argument: &ViewArgument,
        _: &config::Rig,
        _: Option<String>,
    ) -> Result<Option<(Self, Watch)>, Failure> {
        argument.view.map_or(Ok(None), |_| Err(lacks("--view")))
    }

    pub(crate) fn end(self, _: &Result<(), Failure>) {
        match self {}
    }
}
