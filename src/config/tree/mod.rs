//! The configuration as types. The doc comments become the descriptions in the JSON Schema and the help of a message.
//!
//! Every key is required; a key that may be absent in meaning is written `null`. Every unit stands in the key.

mod device;
mod figure;
mod fixture;
mod rig;
mod scene;

pub use device::{DeviceCycle, DeviceIdentity, DevicePlant, ImpedanceDevice};
pub use figure::{Figure, MagnifiedWindow};
pub use fixture::{Coupling, Curvature, Fixture, Forbidden, Side, Surface};
pub use rig::{
    ArmInertia, ArmModel, Bus, BusTiming, CommandMode, Control, ControlLaw, ControlGains, Cycle, DistalLink, Drive,
    DrivePositionLoop, ElbowSide, FeedForward, Guard, Linkage, Master, Mount, Rig, RigIdentity, RigPlant, Sensor, Tool,
    WristSide,
};
pub use scene::{ArcSpeed, EncoderModel, ForceSensorModel, Hand, JointElasticity, PathSegment, Scene, SceneModel, Tracking, Tremor};
