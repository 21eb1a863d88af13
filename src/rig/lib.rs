//! A configuration assembled into a rig that runs in virtual time.
//!
//! ```text
//! config -> assembly -> run::Runner [ Master [ Cycle ] ] <-> place in virtual time [ VirtualBus <-> Drive x2, ForceSensor <-> World (arm, hand) ]
//! ```
//! The place of [`EmbeddedRig`] processes events in order of virtual time: frames that arrive, and moments for which devices
//! or the loop wait. The [`DeviceServer`] puts the same devices on any other CAN bus, [`SegmentServer`] those of a rig on EtherCAT.
//! [`ImpedanceRig`] is the device without a bus.

pub mod analysis;
pub mod batch;
mod defects;
mod device_slot;
mod devices;
mod drill;
mod embedded;
mod error;
mod far_end;
mod frame_faults;
mod hand;
mod impedance;
mod line;
pub mod live;
mod misread;
mod playground;
pub mod report;
#[cfg(test)]
#[path = "../sample.rs"]
mod sample;
mod script;
mod segment;
mod server;
mod silence;
mod world;

pub use device_slot::{Answer, Call, Peer};
pub use devices::{
    arm as simulated_arm, drive as simulated_drive, force_sensor as simulated_force_sensor,
    segment as simulated_segment,
};
pub use drill::drill;
pub use embedded::{BodyTruth, EmbeddedRig, PORTS};
pub use error::RigError;
pub use impedance::{ImpedanceLoop, ImpedanceRig};
pub use playground::Playground;
pub use segment::{SegmentServed, SegmentServer};
pub use server::{DeviceServer, Served};
