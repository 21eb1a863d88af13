//! Why a rig could not be built or could not go on.

use thiserror::Error;

use yieldwall_bus::BootError;
use yieldwall_config::injection::InjectionError;
use yieldwall_drives::scaling::ScalingError;
use yieldwall_motion::control::ControlError;
use yieldwall_motion::fixture::FixtureError;
use yieldwall_motion::guard::Cause;
use yieldwall_motion::linkage::{GeometryError, LinkageError};
use yieldwall_motion::sensing::SensingError;
use yieldwall_run::assembly::AssemblyError;
use yieldwall_sim::arm::ArmError;
use yieldwall_sim::can::CanError;
use yieldwall_sim::hand::HandError;
use yieldwall_sim::point_mass::PointMassError;

/// Why a rig could not be built or could not go on.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum RigError {
    /// The network did not come up.
    #[error(transparent)]
    Boot(#[from] BootError),
    /// The configuration makes no rig, or the arm cannot be where it has to be.
    #[error(transparent)]
    Assembly(AssemblyError),
    /// The simulated arm was refused, or cannot go on.
    #[error("arm: {0}")]
    Arm(#[from] ArmError),
    /// The simulated hand was refused.
    #[error("hand: {0}")]
    Hand(#[from] HandError),
    /// The simulated impedance device was refused, or cannot go on.
    #[error("device: {0}")]
    PointMass(#[from] PointMassError),
    /// The virtual bus was refused.
    #[error("bus: {0}")]
    Can(#[from] CanError),
    /// A simulated device was refused.
    #[error("simulated device: {0}")]
    Device(String),
    /// An injection is not possible.
    #[error(transparent)]
    Injection(#[from] InjectionError),
    /// Two parts of the configuration do not fit together.
    #[error("{0}")]
    Mismatch(String),
    /// A drive still makes torque after the rig was told to stop.
    #[error("the rig did not stop within {waited_s} s: {state}")]
    NotStopped {
        /// How long it was waited for, in s.
        waited_s: f64,
        /// State of the supervisor.
        state: String,
    },
    /// The drives did not reach Operation Enabled.
    #[error("the rig was not enabled after {waited_s:.1} s: {state}")]
    NotEnabled {
        /// How long it was waited for, in s.
        waited_s: f64,
        /// What the supervisor said.
        state: String,
        /// The fault that kept it from being enabled, if one did.
        cause: Option<Cause>,
    },
}

impl From<AssemblyError> for RigError {
    fn from(error: AssemblyError) -> Self {
        match error {
            // A network that cannot be planned does not come up.
            AssemblyError::Boot(error) => Self::Boot(error),
            AssemblyError::Mismatch(error) => Self::Mismatch(error),
            other => Self::Assembly(other),
        }
    }
}

/// What goes wrong in a part of a rig goes wrong alike while it is assembled and while it runs.
macro_rules! as_in_assembly {
    ($($error:ty),*) => {
        $(impl From<$error> for RigError {
            fn from(error: $error) -> Self {
                Self::Assembly(error.into())
            }
        })*
    };
}

as_in_assembly!(GeometryError, LinkageError, FixtureError, ControlError, SensingError, ScalingError);
