//! `yieldwall sim`: simulated devices on a real bus.

use serde_json::json;

use super::failure::{Exit, Failure};
use super::live::{PaceArgument, link_failure, on_interrupt};
use super::output::Output;
use super::run::rig_failure;
use crate::config::{self, Source};
use crate::link::{SocketCan, SocketCanSettings};
use crate::live::{ServeError, serve};
use crate::rig::DeviceServer;
use crate::sim::Watchdog;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The rig; `builtin:paper-admittance.yaml` names the copy inside the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// The interface
    #[arg(long, value_name = "INTERFACE")]
    bus: String,
    /// What simulated time follows; the same as for `run`
    #[arg(long, value_enum, default_value_t = PaceArgument::Free)]
    pace: PaceArgument,
    /// Seed of tremor and sensor noise, in place of the scene's
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Have the drives ignore that this stays away, so that a drill has something to find; may be repeated
    #[arg(long, value_enum, value_name = "WHAT")]
    unwatched: Vec<Unwatched>,
}

/// What a drive may not watch.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Unwatched {
    /// SYNC
    Sync,
    /// The set-points
    SetPoints,
    /// The master's heartbeat
    Heartbeat,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.warnings(&rig.warnings);
    let scene = config::load_scene(rig.source.relative(&rig.value.scene))?;
    let rig = rig.value;
    let seed = arguments.seed.unwrap_or(scene.value.seed);
    let mut server =
        DeviceServer::new(&rig, &scene.value, seed, arguments.pace.pace()).map_err(|error| rig_failure(&error))?;
    for unwatched in &arguments.unwatched {
        server.ignore(match unwatched {
            Unwatched::Sync => Watchdog::Sync,
            Unwatched::SetPoints => Watchdog::SetPoints,
            Unwatched::Heartbeat => Watchdog::Heartbeat,
        });
    }
    let is_interrupted = on_interrupt()?;
    let bit_rate = rig.buses.values().next().map(|bus| bus.bit_rate_bit_per_s);
    let settings = SocketCanSettings { bit_rate, ..SocketCanSettings::everything(&arguments.bus) };
    let mut link = SocketCan::open(&settings).map_err(|error| link_failure(&error))?;
    let [left, right] = &rig.drives;
    output.news(&format!(
        "simulated {} ({}), {} ({}) and {} ({}) on {}, {}; Ctrl-C ends it",
        left.name,
        left.node_id,
        right.name,
        right.node_id,
        rig.sensor.name,
        rig.sensor.node_id,
        arguments.bus,
        arguments.pace.name()
    ))?;
    let served = serve(&mut server, &mut link, &is_interrupted);
    let counts = server.counts();
    let time_s = server.now().as_secs_f64();
    if output.is_json() {
        output.json(&json!({ "time_s": time_s, "syncs": counts.syncs, "sent": counts.sent }))?;
    } else {
        output
            .news(&format!("served    {} SYNC, {} frames sent, {time_s:.3} s simulated", counts.syncs, counts.sent))?;
    }
    served.map_err(|error| match &error {
        ServeError::Rig(error) => rig_failure(error),
        ServeError::Gone => Failure::new(Exit::BusUnavailable, error.to_string(), "plug the adapter in again"),
    })
}
