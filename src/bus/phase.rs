//! Phases of the network.

use crate::error::BootError;

/// Where the network stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Nothing was sent yet but a heartbeat, or the network was left.
    Off,
    /// The nodes were reset and have to announce themselves.
    Resetting,
    /// The nodes are configured.
    Configuring,
    /// The nodes were started.
    Starting,
    /// Process data are exchanged; `on_sync` and `on_compute` are called every cycle.
    Operational,
    /// A node is missing or is not what it should be, or there is another master. Final: nothing is enabled.
    Failed(BootError),
}
