//! Where the network stands, and what an interface tells of itself.

use crate::bus::error::BootError;

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

/// What one of the caller's interfaces tells of itself. The rig has one fate: what one bus suffers acts on all axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkEvent {
    /// Own frames could not be sent, or the interface is down.
    SendFailed,
    /// The controller is error-passive.
    ErrorPassive,
    /// The controller is bus-off.
    BusOff,
}
