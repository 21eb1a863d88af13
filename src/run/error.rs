//! Why a rig could not go on.

use std::fmt;

use thiserror::Error;

use super::pace::Pace;
use super::sensor::NoZero;
use crate::assembly::AssemblyError;
use yieldwall_bus::{BootError, HeardFrame};
use yieldwall_drives::watchdog::Watchdog;
use yieldwall_fieldbus::canopen::BusId;
use yieldwall_link::SendError;
use yieldwall_motion::guard::{Cause, Device, DeviceSet};

/// A device as a person finds it: by its node id on CAN, or else by what it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Which {
    /// The device.
    pub device: Device,
    /// Its node id, if it is a CANopen node.
    pub node_id: Option<u8>,
}

impl Which {
    /// Returns `the simulated drive with node id 1` or `the simulated left drive`.
    fn drive(self, adjective: &str) -> String {
        match self.node_id {
            Some(node_id) => format!("the {adjective}drive with node id {node_id}"),
            None => format!("the {adjective}{}", self.device.set()),
        }
    }
}

impl fmt::Display for Which {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.node_id {
            Some(node_id) => write!(f, "node {node_id}"),
            None => write!(f, "the {}", self.device.set()),
        }
    }
}

/// Why a rig could not go on.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum RunError {
    /// The rig cannot be built.
    #[error(transparent)]
    Assembly(#[from] AssemblyError),
    /// A node is missing or is not what it should be. Nothing was enabled.
    #[error(transparent)]
    Boot(#[from] BootError),
    /// Somebody else is the master of a bus.
    #[error(
        "{}{}. Heard: {heard}, on the {}",
        if *.has_sent { "another master began at the same moment" } else { "a master is on this bus" },
        if *.has_sent { "; nothing was enabled, and nothing more is sent" } else { "; nothing was sent" },
        DeviceSet::interface(heard.frame.bus().index())
    )]
    OtherMaster {
        /// Frame that shows it.
        heard: HeardFrame,
        /// Whether this master had sent something before.
        has_sent: bool,
    },
    /// The network could not be booted because nothing can be sent.
    #[error("while the network was booted, {}: {error}", DeviceSet::interface(.bus.index()))]
    Send {
        /// The bus.
        bus: BusId,
        /// Why not.
        error: SendError,
    },
    /// The cycle has panicked, and nothing is booted for it.
    #[error("the cycle has panicked: only a new process can boot the network")]
    NotBooted,
    /// The permit to enable is of another boot, or of another rig. Nothing was enabled.
    #[error(
        "the network was booted anew since it was proved that its drives stop by themselves: they may be others, prove it again"
    )]
    OldPermit,
    /// A rig on a computer was asked for a permit that only one in virtual time has.
    #[error("this rig is not in virtual time: prove that its drives stop by themselves")]
    NotVirtual,
    /// The drives did not reach Operation Enabled.
    #[error("the rig was not enabled within {waited_s:.1} s{}", because(.cause))]
    NotEnabled {
        /// Waiting time, in s.
        waited_s: f64,
        /// The fault that kept it from being enabled, if one did.
        cause: Option<Cause>,
    },
    /// The force sensor's reading is not a valid zero. Nothing was enabled.
    #[error("the force sensor was not tared: {why}")]
    NotTared {
        /// Why it is none.
        why: NoZero,
    },
    /// The rig stopped for another reason before a watchdog was tried, so the result does not concern the watchdog.
    #[error("the rig was stopped before the watchdog on {} was tried{}", .watchdog.name(), because(.cause))]
    NotTried {
        /// The watchdog.
        watchdog: Watchdog,
        /// The fault that stopped it.
        cause: Option<Cause>,
    },
    /// A drive accepts no torque limit, or does not keep the commanded one. Nothing was enabled.
    #[error(
        "{} takes no torque limit, so that none holds while it is moved for the first time",
        .which.drive("")
    )]
    NoTorqueLimit {
        /// The device.
        which: Which,
    },
    /// A drive keeps a torque limit of its own, which is higher than a first motion may have. Nothing was enabled.
    #[error("{} keeps its own torque limit, {own_n_m:.2} N m, and it is to be moved with {most_n_m:.2} N m", .which.drive(""))]
    DriveLimit {
        /// The device.
        which: Which,
        /// Its limit, N m.
        own_n_m: f64,
        /// Most torque for the motion, N m.
        most_n_m: f64,
    },
    /// A node does not report an object.
    #[error("{which} does not report object {index:04X}h:{sub}")]
    Unread {
        /// The device.
        which: Which,
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
    },
    /// The simulated devices live on another clock. Nothing was enabled.
    #[error(
        "{} {}",
        .which.drive("simulated "),
        match .pace {
            Pace::Lockstep => "follows the wall clock, and this rig runs in lockstep",
            Pace::Free => "runs in lockstep, and this rig follows the wall clock",
        }
    )]
    Pace {
        /// The device.
        which: Which,
        /// The pace of the rig.
        pace: Pace,
    },
    /// A drive has a profile of simulated drives but not their mark. Nothing was enabled.
    #[error(
        "the profile of {} is one of simulated drives, and the drive's object 2012h does not say `simulated device`",
        .which.drive("")
    )]
    Unmarked {
        /// The device.
        which: Which,
    },
    /// A drive is no simulated one in lockstep, and was not drilled. Nothing was enabled.
    #[error(
        "{} is no simulated one in lockstep, and nothing shows that it stops without its master",
        .which.drive("")
    )]
    NotSimulated {
        /// The device.
        which: Which,
    },
    /// A simulated drive would go on without its master. Nothing was enabled.
    #[error("{} does not stop without {}", .which.drive("simulated "), .watchdog.name())]
    Unwatched {
        /// The device.
        which: Which,
        /// The missing watchdog.
        watchdog: Watchdog,
    },
    /// A drive with an incremental encoder was not homed since it was switched on. Nothing was enabled.
    #[error("{} does not know where its joint is: it was not homed since it was switched on", .which.drive(""))]
    NotHomed {
        /// The device.
        which: Which,
    },
    /// A drive that was homed looks for home in one direction only, and its joint is behind home. Nothing was enabled.
    #[error(
        "{} is homed, and its joint stands {:.2} deg behind home, which it looks for one way alone",
        .which.drive(""),
        .by_rad.abs().to_degrees()
    )]
    BehindHome {
        /// The device.
        which: Which,
        /// Distance of the joint beyond home, rad; the sign is that of its angle.
        by_rad: f64,
    },
    /// The linkage cannot be at the angles that the drives report.
    #[error("the linkage cannot be at the angles that the drives report")]
    NoPosture,
    /// The linkage cannot follow the commanded travel of the joints.
    #[error(
        "the way leads too near a singularity or the edge of the workspace: {:.0} % of it is free", (100.0 * .share).floor()
    )]
    WayBlocked {
        /// How much of the way is free, 0 to 1.
        share: f64,
    },
    /// A person asked for the end before the rig ran.
    #[error("interrupted before the rig ran")]
    Interrupted,
}

fn because(cause: &Option<Cause>) -> String {
    cause.map_or(String::new(), |cause| {
        let row = cause.fault.row();
        let devices = if cause.devices.is_empty() { String::new() } else { format!(" ({})", cause.devices) };
        format!(", because of {}{devices}: {}", row.name, row.meaning)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_motion::guard::Fault;

    #[test]
    fn what_kept_a_rig_from_being_enabled_is_named_with_the_devices_if_there_are_any() {
        let said = |fault, devices| {
            let error = RunError::NotEnabled { waited_s: 1.5, cause: Some(Cause { fault, devices }) };
            error.to_string()
        };
        assert!(
            said(Fault::Overrun, DeviceSet::NONE)
                .starts_with("the rig was not enabled within 1.5 s, because of overrun: ")
        );
        assert!(said(Fault::PdoMissed, DeviceSet::SENSOR).contains(" because of pdo-missed (force sensor): "));
    }
}
