//! SDO: both ends of the confirmed access to single objects.

mod block;
mod client;
mod server;
#[cfg(test)]
mod tests;
mod wire;

pub use client::{SdoClient, SdoOutcome};
pub(super) use server::{Objects, SdoServer};
