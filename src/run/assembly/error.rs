//! Why a configuration makes no rig.

use thiserror::Error;

use yieldwall_bus::BootError;
use yieldwall_config::NotSimulated;
use yieldwall_drives::scaling::ScalingError;
use yieldwall_motion::control::ControlError;
use yieldwall_motion::fixture::FixtureError;
use yieldwall_motion::linkage::{GeometryError, LinkageError};
use yieldwall_motion::sensing::SensingError;

/// Why a configuration makes no rig.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum AssemblyError {
    /// It was to be simulated.
    #[error(transparent)]
    NotSimulated(#[from] NotSimulated),
    /// The network cannot be planned.
    #[error(transparent)]
    Boot(#[from] BootError),
    /// The linkage cannot be built.
    #[error("linkage: {0}")]
    Geometry(#[from] GeometryError),
    /// The linkage cannot be where it has to be.
    #[error("linkage: {0}")]
    Linkage(#[from] LinkageError),
    /// The fixture was refused.
    #[error("fixture: {0}")]
    Fixture(#[from] FixtureError),
    /// A controller was refused.
    #[error("control: {0}")]
    Control(#[from] ControlError),
    /// The sensor's parameters were refused.
    #[error("sensor: {0}")]
    Sensing(#[from] SensingError),
    /// A drive's scaling was refused.
    #[error("drive: {0}")]
    Scaling(#[from] ScalingError),
    /// A CAN bus is wanted, and the devices are on EtherCAT.
    #[error("the rig is on EtherCAT, and a CAN bus is wanted here")]
    OnEthercat,
    /// The fixture's surface is of another dimension than the machine.
    #[error("the fixture's surface is a {surface} in {dimension} dimensions, this machine moves in {wanted}")]
    Dimension {
        /// Its surface.
        surface: &'static str,
        /// Coordinates of a point of it.
        dimension: usize,
        /// Coordinates of a point of the machine.
        wanted: usize,
    },
    /// The gains are those of another command mode.
    #[error("command_mode {mode} needs control.gains {gains}")]
    Gains {
        /// The command mode.
        mode: &'static str,
        /// The gains that it needs.
        gains: &'static str,
    },
    /// There is no device profile of this name.
    #[error("there is no device profile named {0}")]
    NoProfile(String),
    /// A device that is wanted on a segment has no position there.
    #[error("`{0}` has no position on a segment")]
    NoPosition(String),
    /// The rig has no bus of this name.
    #[error("`buses` has no bus named {0}")]
    NoBus(String),
    /// A drive is to be homed and has no homing.
    #[error("`{0}` has no `homing`")]
    NoHoming(String),
    /// There is no joint of this number.
    #[error("there is no joint {0}")]
    NoJoint(usize),
}
