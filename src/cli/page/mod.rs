//! `yieldwall view`, `yieldwall play` and `--view`: a page for a browser on this computer. It shows recordings, a simulation whose
//! hand is the pointer, or a running rig.

#[cfg(feature = "view")]
mod browser;
#[cfg(feature = "view")]
mod description;
#[cfg(feature = "view")]
mod play;
#[cfg(not(feature = "view"))]
#[path = "lacking.rs"]
mod serve;
#[cfg(feature = "view")]
mod serve;

use std::net::SocketAddr;
use std::path::PathBuf;

#[cfg(feature = "view")]
pub(super) use play::play;
#[cfg(not(feature = "view"))]
pub(super) use serve::play;
pub(super) use serve::{Page, view};

/// Address of a page where none is named: any free port.
const ANY_PORT: &str = "127.0.0.1:0";

/// The command that a page belongs to.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(not(feature = "view"), expect(dead_code, reason = "a build without the page has no use for it"))]
pub(super) struct PageOf {
    pub(super) command: &'static str,
    pub(super) pace: Pace,
}

/// The time that a rig on a page goes by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pace {
    Virtual,
    Lockstep,
    Free,
}

#[cfg(target_os = "linux")]
impl From<super::pace::PaceArgument> for Pace {
    fn from(pace: super::pace::PaceArgument) -> Self {
        match pace {
            super::pace::PaceArgument::Free => Self::Free,
            super::pace::PaceArgument::Lockstep => Self::Lockstep,
        }
    }
}

/// Page of a running rig.
#[derive(Debug, clap::Args)]
pub(super) struct ViewArgument {
    /// Serve a page that shows the rig to a browser on this computer
    ///
    /// The command prints the address of the page. The simulation then follows the wall clock.
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, require_equals = true, default_missing_value = ANY_PORT)]
    pub(super) view: Option<SocketAddr>,
}

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Recording: a cycles.mcap, its folder, or a black-box file. The page overlays a second one
    #[arg(value_name = "RECORDING", required = true, num_args = 1..=2)]
    recordings: Vec<PathBuf>,
    /// Loopback address of the page; port 0 takes any free port
    #[arg(long, value_name = "ADDRESS", default_value = ANY_PORT)]
    on: SocketAddr,
    /// Do not open a browser
    #[arg(long)]
    no_open: bool,
}

#[derive(Debug, clap::Args)]
pub(super) struct PlayArguments {
    /// Rig file with a simulation
    #[arg(value_name = "RIG.yaml", default_value = "builtin:play.yaml")]
    rig: String,
    /// Loopback address of the page; port 0 takes any free port
    #[arg(long, value_name = "ADDRESS", default_value = ANY_PORT)]
    view: SocketAddr,
    /// Do not open a browser
    #[arg(long)]
    no_open: bool,
    /// Record every cycle and every frame into this folder
    ///
    /// Each fixture chosen on the page gets a new folder in it.
    #[arg(long, value_name = "DIR")]
    record: Option<PathBuf>,
}
