//! CANopen engines without I/O (CiA 301), for both sides of the bus.
//!
//! Time, frames and outgoing queues are arguments, so that the same code runs in virtual time, on vcan and on
//! hardware, and the codec that the master uses is the one that the simulated devices are checked against.
//!
//! | side | what |
//! |---|---|
//! | master | [`SdoClient`], [`SdoClients`], [`nmt::HeartbeatConsumer`], [`NodeGuard`], [`SyncProducer`], [`time::TimeProducer`], [`Emergency`], [`lss::LssMaster`], [`pdo::Layout`] |
//! | device | [`Node`] over an [`ObjectDictionary`], with an [`Application`] behind it |
//! | both | [`cob`], [`nmt`], [`AbortCode`], [`EmcyCode`] |
//!
//! Codecs and small types come from the crate `canopen-rs`, which no other folder names.

mod abort;
pub mod cob;
pub mod dictionary;
mod emcy;
mod error;
mod frame;
mod guarding;
pub mod lss;
pub mod nmt;
mod node;
pub mod pdo;
mod sdo;
mod sync;
pub mod time;
mod value;

pub use abort::AbortCode;
pub use canopen_rs::{Address, ErrorRegister, MappingEntry, NmtCommand, NmtState, NodeId};
pub use cob::node_id;
pub use dictionary::{Access, DeviceIdentity, Handle, Mappable, Object, ObjectDictionary};
pub use emcy::{EmcyCode, Emergency, PastError};
pub use error::CanopenError;
pub use frame::{Frame, OnBus, Outbox, Time};
pub use guarding::{GuardEvent, NodeGuard};
pub use nmt::{HeartbeatChange, HeartbeatConsumer, HeartbeatEvent};
pub use node::{Application, Node, Reset};
pub use pdo::{Field, Layout, PdoParameters};
pub use sdo::{SdoClient, SdoClients, SdoOutcome, SdoReply, SdoRequest, SdoTicket};
pub use sync::SyncProducer;
pub use value::{DataType, Scalar};
