//! CANopen engines without I/O (CiA 301), for both sides of the bus.
//!
//! Time, frames and outgoing queues are arguments, so that the same code runs in virtual time, on vcan and on hardware. The tests check the
//! simulated devices against the same codec that the master uses.
//!
//! | side | what |
//! |---|---|
//! | master | [`SdoClient`], [`SdoClients`], [`nmt::HeartbeatConsumer`], [`SyncProducer`], [`Emergency`], [`lss::LssMaster`], [`pdo::Layout`] |
//! | device | [`Node`], which speaks for an [`Application`] and borrows its dictionary; [`CommunicationProfile`] |
//! | both | [`cob`], [`nmt`], [`EmcyCode`] |
//!
//! Codecs and small types come from the crate `canopen-rs`, which no other folder names.

pub mod cob;
mod communication;
mod emcy;
mod error;
mod frame;
mod guarding;
pub mod lss;
pub mod nmt;
mod node;
mod node_set;
pub mod pdo;
mod sdo;
mod sync;
pub mod time;

pub use canopen_rs::{ErrorRegister, MappingEntry, NmtCommand, NmtState, NodeId};
pub use cob::node_id;
pub use communication::CommunicationProfile;
pub use emcy::{EmcyCode, Emergency, PastError};
pub use error::CanopenError;
pub use frame::{BusId, Frame, OnBus, Outbox};
pub use nmt::{HeartbeatChange, HeartbeatConsumer, HeartbeatEvent};
pub use node::{Application, Node};
pub use node_set::NodeSet;
pub use pdo::{Field, Layout, PdoParameters, is_dummy};
pub use sdo::{SdoClient, SdoClients, SdoOutcome, SdoReply, SdoTicket};
pub use sync::SyncProducer;
