//! The bus master: boots the network, walks the drives to Operation Enabled and exchanges process data.
//!
//! ```text
//! Resetting -> Configuring (SDO, node by node in parallel) -> Starting -> Operational
//!                       |                                        |
//!                       +----------------> Failed <--------------+      nothing is enabled
//! ```
//! [`Master`] is sans-I/O: the caller brings frames and moments and carries away what it puts into the outbox. Two
//! moments a cycle are its own: [`Master::on_sync`] at 0 and [`Master::on_compute`] when all process data are in.
//! [`budget`] proves beforehand that they are.

mod boot;
pub mod budget;
mod error;
mod image;
mod master;
mod setup;
mod signs;

pub use error::{BootError, BootFailure, Said};
pub use master::{LinkEvent, Master, Phase, Waiting};
pub use setup::{CommandMode, DriveSetup, MasterSetup, SensorLink, SensorNode, SensorSetup, Waits};
pub use signs::{Heard, LISTENING, Sign, Signs};

#[cfg(test)]
mod tests;
