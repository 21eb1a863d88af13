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
    /// Two parts of the configuration do not fit together.
    #[error("{0}")]
    Mismatch(String),
}
