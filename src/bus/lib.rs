//! The bus master: boots the network, walks the drives to Operation Enabled and exchanges process data.
//!
//! ```text
//! Resetting -> Configuring (SDO, node by node in parallel) -> Starting -> Operational
//!                       |                                        |
//!                       +----------------> Failed <--------------+      nothing is enabled
//! ```
//! [`Master`] is sans-I/O: the caller brings frames and moments and carries away what it puts into the outbox. A cycle has two
//! moments: [`Network::open`] at 0 and [`Master::on_compute`] when all process data are in. [`budget`] proves beforehand that they are.
//!
//! `can` knows frames and nodes and delivers raw words; [`ethercat`] does the same for a segment. Each is a [`Network`], and
//! [`Networks`] are all networks of a rig. `script` holds the requests and commands to a device over either bus. `axis` serves
//! all buses: it converts words to SI and back, walks to Operation Enabled, and turns commands that the guard has allowed into
//! targets.

mod axis;
mod can;
mod emergency;
mod error;
pub mod ethercat;
mod master;
mod network;
mod phase;
mod sample;
mod script;
mod setup;
mod signs;
mod turns;

pub use axis::{Arrived, AxisSetup, DriveOrders, DriveWords, HomingState, words_to_enable};
pub use can::{BootPlan, NodePlan, Waiting, budget};
pub use emergency::EmergencyReport;
pub use error::{BootError, BootFailure, Others, Said};
pub use ethercat::SEGMENT_LISTENING;
pub use master::Master;
pub use network::{Network, Networks};
pub use phase::Phase;
pub use sample::SampleCodec;
pub use script::{PlannedRefusal, PlannedWrite, ScriptPlan, Written};
pub use setup::{
    BrakeWords, DriveSetup, HomingOrder, MasterSetup, SensorLink, SensorNode, SensorSetup, SensorStart, Waits,
};
pub use signs::{HeardFrame, LISTENING, Sign, Signs};
pub use yieldwall_drives::cia402::CommandMode;
pub use yieldwall_fieldbus::{LinkEvent, Packet};

// The cycle that tests of the master share with those of the cycle names these as its own package does.
#[cfg(test)]
use yieldwall_motion::{control, cycle, fixture, guard, linkage, sensing};

#[cfg(test)]
mod tests;
