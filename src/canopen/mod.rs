//! CANopen engines without I/O (CiA 301), for both sides of the bus.
//!
//! Time, frames and outgoing queues are arguments, so that the same code runs in virtual time, on vcan and on
//! hardware, and the codec that the master uses is the one that the simulated devices are checked against.

mod frame;

pub use frame::{Frame, Outbox, Time};
