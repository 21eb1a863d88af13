//! A configuration assembled into a rig that runs in virtual time.
//!
//! ```text
//! config::Rig + config::Scene -> build -> Master (cycle inside) <-> VirtualBus <-> Drive x2, ForceSensor <-> World (arm, hand)
//! ```
//! [`EmbeddedRig`] processes events in order of virtual time: frames that arrive, moments that devices or the master
//! wait for, and the two moments of each cycle. [`ImpedanceRig`] is the device without a bus.

mod budget;
mod build;
mod embedded;
mod error;
mod impedance;
mod margins;
mod world;

pub use budget::bus_plan;
pub use build::cycle;
pub use embedded::{BodyTruth, EmbeddedRig, Observer, PORTS, Tap};
pub use error::RigError;
pub use impedance::ImpedanceRig;
pub use margins::{Margin, PoseMargins, pose_margins};
