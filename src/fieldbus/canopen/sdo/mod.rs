//! SDO: both ends of the confirmed access to single objects.

mod block;
mod client;
mod clients;
mod server;
#[cfg(test)]
mod tests;
mod wire;

pub use client::{SdoClient, SdoOutcome};
pub use clients::{SdoClients, SdoReply, SdoTicket};
pub(super) use server::{Objects, SdoServer};
