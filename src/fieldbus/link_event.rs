//! Events that an interface reports.

/// Event of one of the caller's interfaces. The rig has one fate: what one bus suffers acts on all axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkEvent {
    /// Own frames could not be sent, or the interface is down.
    SendFailed,
    /// The controller is error-passive.
    ErrorPassive,
    /// The controller is bus-off.
    BusOff,
}
