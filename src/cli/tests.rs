use clap::CommandFactory;

use super::failure::{EXIT_CODES, Exit};
use super::*;

#[test]
fn arguments_are_consistent() {
    Arguments::command().debug_assert();
}

#[test]
fn help_lists_every_exit_code() {
    for exit in [
        Exit::Ok,
        Exit::Internal,
        Exit::Usage,
        Exit::ConfigInvalid,
        Exit::BusUnavailable,
        Exit::DeviceMismatch,
        Exit::DeviceFault,
        Exit::OutOfTolerance,
        Exit::SafetyStop,
        Exit::TimingMissed,
        Exit::Interrupted,
    ] {
        assert!(EXIT_CODES.lines().any(|line| line.trim().starts_with(&format!("{} ", exit.code()))), "{exit:?}");
    }
}
