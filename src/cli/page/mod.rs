//! `yieldwall view` and `--view`: a page for a browser on this computer, with recordings or with a rig that runs.

#[cfg(feature = "view")]
mod browser;
#[cfg(feature = "view")]
mod description;
#[cfg(not(feature = "view"))]
#[path = "lacking.rs"]
mod serve;
#[cfg(feature = "view")]
mod serve;

use std::net::SocketAddr;
use std::path::PathBuf;

pub(super) use serve::{Page, view};

/// Address of a page where none is named: any free port.
const ANY_PORT: &str = "127.0.0.1:0";

/// The page of a rig that runs.
#[derive(Debug, clap::Args)]
pub(super) struct ViewArgument {
    /// Serve a page that shows the rig to a browser on this computer, and print its address; the simulation then runs by the wall clock
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, require_equals = true, default_missing_value = ANY_PORT)]
    #[arg(conflicts_with_all = ["tui", "dry_run"])]
    pub(super) view: Option<SocketAddr>,
}

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The recording: a cycles.mcap, its folder, or the file of a black box. The page shows a second one over it
    #[arg(value_name = "RECORDING", required = true, num_args = 1..=2)]
    recordings: Vec<PathBuf>,
    /// Address of the page: a loopback address, with port 0 on any free port
    #[arg(long, value_name = "ADDRESS", default_value = ANY_PORT)]
    on: SocketAddr,
    /// Open no browser
    #[arg(long)]
    no_open: bool,
}
