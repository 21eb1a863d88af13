//! `--pace`: the clock of a run.

use yieldwall_run::Pace;

/// Event that the loop or the devices wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum PaceArgument {
    /// The wall clock
    Free,
    /// Master and simulated devices wait for each other: one period per SYNC, on EtherCAT per frame that reads process data
    Lockstep,
}

impl PaceArgument {
    pub(super) fn pace(self) -> Pace {
        match self {
            PaceArgument::Free => Pace::Free,
            PaceArgument::Lockstep => Pace::Lockstep,
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            PaceArgument::Free => "by the wall clock",
            PaceArgument::Lockstep => "in lockstep",
        }
    }
}
