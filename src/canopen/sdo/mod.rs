//! SDO: both ends of the confirmed access to single objects.

mod client;

pub use client::{SdoClient, SdoOutcome};
