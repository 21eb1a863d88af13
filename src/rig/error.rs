//! Why a rig could not be built or could not go on.

use thiserror::Error;

use yieldwall_bus::BootError;
use yieldwall_config::injection::{DefectError, InjectionError};
use yieldwall_drives::scaling::ScalingError;
use yieldwall_motion::control::ControlError;
use yieldwall_motion::fixture::FixtureError;
use yieldwall_motion::guard::Cause;
use yieldwall_motion::linkage::{GeometryError, LinkageError};
use yieldwall_motion::sensing::SensingError;
use yieldwall_run::RunError;
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
    /// A defect of the scene is not possible.
    #[error(transparent)]
    Defect(#[from] DefectError),
    /// An arm that tracks ideally makes no frames.
    #[error("model.tracking ideal works on CAN only: on EtherCAT the arm has to be rigid")]
    IdealOnEthercat,
    /// An arm that tracks ideally is on a bus.
    #[error("model.tracking ideal works in the embedded simulation only: on a bus the arm has to be rigid")]
    IdealOnBus,
    /// An arm that tracks ideally is sent torques.
    #[error("model.tracking ideal needs command_mode position: a torque has no place to go to")]
    IdealInTorque,
    /// There is no arm to block.
    #[error("arm-blocked needs `model.tracking: rigid`: there is no arm to block")]
    NoArmToBlock,
    /// An injection needs something that this rig does not have.
    #[error("{injection} needs {needed}")]
    InjectionNeeds {
        /// Its name.
        injection: &'static str,
        /// The thing that it needs.
        needed: &'static str,
    },
    /// An injection at the computer that runs the master, which is not here.
    #[error("{0} is of the computer that runs the master, which is not here")]
    InjectionAtMaster(&'static str),
    /// The target of an injection is not on this segment.
    #[error("{injection}: {target} is not on this segment")]
    NotHere {
        /// Its name.
        injection: &'static str,
        /// Its target.
        target: &'static str,
    },
    /// The scene does not name the part that it simulates.
    #[error("the scene has no `{0}`")]
    NoModel(&'static str),
    /// A point of the scene has another number of coordinates than the machine.
    #[error("{point} of the scene has {found} coordinates, this machine has {wanted}")]
    Coordinates {
        /// Name of the point.
        point: String,
        /// Its coordinates.
        found: usize,
        /// Coordinates of the machine.
        wanted: usize,
    },
    /// No device of a segment is simulated here.
    #[error("none of these devices is on EtherCAT")]
    NoneOnEthercat,
    /// The loop of the rig was refused.
    #[error(transparent)]
    Run(RunError),
    /// The pose is singular.
    #[error("singular pose")]
    Singular,
    /// A delay was identified beyond those for which margins are known.
    #[error("a delay of {found_cycles:.1} cycles was identified, and margins are known up to {most_cycles}")]
    Delay {
        /// The delay, in cycles.
        found_cycles: f64,
        /// The greatest, in cycles.
        most_cycles: f64,
    },
    /// The bus of the force sensor has no plan.
    #[error("the sensor's bus has no plan")]
    NoPlan,
    /// The scene of the rig cannot be read.
    #[error("the scene cannot be read")]
    NoScene,
    /// The fixture is of the impedance type.
    #[error("the fixture has to have the coupling `admittance`")]
    NoAdmittance,
    /// A drive still makes torque after the rig was commanded to stop.
    #[error("the rig did not stop within {waited_s} s: {state}")]
    NotStopped {
        /// How long it was waited for, in s.
        waited_s: f64,
        /// States of the drives, or of the supervisor.
        state: String,
    },
    /// The drives did not reach Operation Enabled.
    #[error("the rig was not enabled after {waited_s:.1} s: {state}")]
    NotEnabled {
        /// How long it was waited for, in s.
        waited_s: f64,
        /// State of the supervisor.
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
            other => Self::Assembly(other),
        }
    }
}

/// Errors in a part of a rig are the same while it is assembled and while it runs.
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
