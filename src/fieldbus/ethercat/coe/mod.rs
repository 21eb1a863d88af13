//! CANopen over EtherCAT (CoE): the objects of a device over its mailbox.
//!
//! ```text
//! mailbox message: CoE header 2 (number 9 bits, service 4 bits) | service
//! ```
//!
//! | side | what |
//! |---|---|
//! | master | [`CoeClient`]: reads, writes and lists objects, hears emergencies |
//! | device | [`CoeServer`]: serves what a [`ServedDevice`](crate::objects::ServedDevice) lends |
//!
//! Engines take and give messages without the mailbox header; [`mailbox`](super::mailbox) puts it before them.
//!
//! # Source
//! ETG.1000.6, 5.6.

mod client;
mod complete;
mod emergency;
mod information;
mod server;
#[cfg(test)]
mod tests;
mod wire;

pub use client::{CoeAnswer, CoeClient, CoeEvent, CoeRequest};
pub use emergency::CoeEmergency;
pub use information::{EntryDescription, ListKind, ObjectCode, ObjectDescription};
pub use server::CoeServer;
pub use wire::Service;

/// Most bytes of a value or a list that are transferred.
pub const MOST_BYTES: usize = 1 << 20;
