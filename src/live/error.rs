//! Why a rig on a real bus could not go on.

use thiserror::Error;

use crate::bus::BootError;
use crate::guard::{Cause, DeviceSet};
use crate::link::SendError;
use crate::rig::RigError;

/// Why a rig on a real bus could not go on.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum LiveError {
    /// The rig cannot be built.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// A node is missing or is not what it should be. Nothing was enabled.
    #[error(transparent)]
    Boot(#[from] BootError),
    /// The network could not be booted because nothing can be sent.
    #[error("while the network was booted, {}: {error}", DeviceSet::interface(*.bus))]
    Send {
        /// Number of the bus.
        bus: u8,
        /// Why not.
        error: SendError,
    },
    /// The network did not come up.
    #[error("the network did not come up within {waited_s} s: {phase}")]
    NotBooted {
        /// How long it was waited for, in s.
        waited_s: f64,
        /// Where it stood.
        phase: String,
    },
    /// The drives did not reach Operation Enabled.
    #[error("the rig was not enabled within {waited_s} s{}", because(.cause))]
    NotEnabled {
        /// How long it was waited for, in s.
        waited_s: f64,
        /// The fault that kept it from being enabled, if one did.
        cause: Option<Cause>,
    },
    /// A node does not tell an object.
    #[error("node {node_id} does not tell object {index:04X}h:{sub}")]
    Unread {
        /// Node id.
        node_id: u8,
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
    },
    /// A person asked for the end before the rig ran.
    #[error("interrupted before the rig ran")]
    Interrupted,
}

fn because(cause: &Option<Cause>) -> String {
    cause.map_or(String::new(), |cause| {
        let row = cause.fault.row();
        format!(", because of {} ({}): {}", row.name, cause.devices, row.meaning)
    })
}
