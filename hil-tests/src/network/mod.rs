//! A bus with devices on it, virtual or real, for tests whose bodies do not care which.
//!
//! A body gets a [`Network`], attaches devices to it, opens links and runs engines over them. On [`Virtual`] all of it
//! happens in virtual time; on [`Real`] every device has a thread of its own and frames go through the kernel.

mod devices;
mod lossy;
#[cfg(target_os = "linux")]
mod real;
mod simulated;
mod transfer;

pub use devices::{Peer, Served, bare, device};
pub use lossy::Lossy;
#[cfg(target_os = "linux")]
pub use real::Real;
pub use simulated::{Virtual, VirtualLink};
pub use transfer::{client, hear, lss, run, send_all, transfer};

use yieldwall::canopen::{Frame, Outbox};
use yieldwall::link::CanLink;
use yieldwall::time::Time;

/// What a link may make of it, and a test has to wait for, at most; in virtual time it costs nothing.
pub const PATIENCE: std::time::Duration = std::time::Duration::from_secs(20);

/// One device of a bus, without I/O.
pub trait Participant: Send {
    /// Switches it on.
    fn switch_on(&mut self, now: Time, out: &mut dyn Outbox);
    /// Takes a frame of another participant.
    fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut dyn Outbox);
    /// Does what is due.
    fn poll(&mut self, now: Time, out: &mut dyn Outbox);
    /// When to poll next.
    fn next_deadline(&self) -> Time;
}

/// A bus to which devices can be attached.
pub trait Network {
    /// How one takes part in it.
    type Link: CanLink;

    /// Attaches a device and switches it on.
    fn attach(&mut self, device: impl Participant + 'static);

    /// One more participant, which gets every frame and the echoes of its own.
    fn link(&mut self) -> Self::Link;
}
