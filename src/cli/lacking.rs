//! Commands that this build lacks, each with the command that builds them. `full.rs` has them.

use std::ffi::OsString;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use super::failure::{Exit, Failure};
use super::output::Output;
use super::tui::View;
use yieldwall_run::Orders;

/// Arguments of a command that this build lacks: any.
#[derive(Debug, clap::Args)]
pub(super) struct Lacking {
    #[arg(hide = true, allow_hyphen_values = true, trailing_var_arg = true)]
    _any: Vec<OsString>,
}

pub(super) type Report = Lacking;
pub(super) type Completions = Lacking;
pub(super) type Man = Lacking;

fn lacks(what: &str) -> Failure {
    let help = "build the program with it: `cargo build --release --features full`";
    Failure::new(Exit::Usage, format!("this build has no `{what}`"), help)
}

pub(super) fn report(_: &Report, _: &mut Output) -> Result<(), Failure> {
    Err(lacks("report"))
}

pub(super) fn completions(_: &Completions, _: &mut Output) -> Result<(), Failure> {
    Err(lacks("completions"))
}

pub(super) fn man(_: &Man, _: &mut Output) -> Result<(), Failure> {
    Err(lacks("man"))
}

/// The screen of this build, which has no value.
#[derive(Debug)]
pub(super) enum Screen {}

impl Screen {
    /// Refuses.
    pub(super) fn start(_: &Arc<Mutex<View>>, _: &Arc<AtomicBool>, _: Option<Arc<Orders>>) -> Result<Self, Failure> {
        Err(lacks("--tui"))
    }
}

impl Drop for Screen {
    /// The screen of a full build restores the terminal on drop.
    fn drop(&mut self) {
        match *self {}
    }
}

/// Refuses a screen on any terminal.
pub(super) fn check_terminal() -> Result<(), Failure> {
    Err(lacks("--tui"))
}
