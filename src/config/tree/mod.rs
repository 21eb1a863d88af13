//! The configuration as types. The doc comments become the descriptions in the JSON Schema and the help of a message.
//!
//! Every key is required; a key without a value is written `null`. Every key that has a unit names it.

mod arm;
mod device;
mod figure;
mod fixture;
mod injection;
mod profile;
mod rig;
mod scene;
mod sensor;
mod simulation;
mod surface;
mod waits;

pub use arm::{ArmInertia, ArmModel, DistalLink, ElbowSide, Linkage, Tool, WristSide};
pub use device::{DeviceCycle, DeviceIdentity, DevicePlant, ImpedanceDevice};
pub use figure::{Figure, MagnifiedWindow};
pub use fixture::{AutomaticHold, Coupling, Curvature, Fixture, FixtureLaw, Motion, Passivity, Side};
pub use injection::{DefectName, DriveSide, FaultName, FaultTarget, SceneDefect, SceneFault};
pub(crate) use profile::{Fitting, is_yaml};
pub use profile::{ProfileName, shipped_error_codes, shipped_profile};
pub(crate) use rig::NamedProfile;
pub use rig::{
    Address, Bus, CanBus, CanopenAddress, Control, ControlGains, ControlLaw, Cycle, Drive, EthercatAddress,
    EthercatBus, FeedForward, Guard, Homing, OutputsAct, Rig, RigIdentity,
};
pub use scene::{
    AimError, ArcSpeed, DeviceModel, EncoderModel, ForceSensorModel, Hand, JointElasticity, PathSegment, Scene,
    SceneModel, SceneTolerance, Tracking, Tremor,
};
pub use sensor::{ByteOrder, Mount, Sensor, SensorProtocol};
pub use simulation::{
    BusTiming, DriveModel, DrivePositionLoop, NotSimulated, OddObject, SdoInformation, SdoServer, SegmentDevice,
    SentLength, Simulation,
};
pub use surface::{Forbidden, Surface};
pub use waits::Waits;
pub use yieldwall_drives::cia402::CommandMode;
