//! The rig on a real bus: the same master as in the embedded simulation, on the clock of the wall.
//!
//! ```text
//! wake at 0:          drain the link, SYNC alone
//! wake at t_compute:  drain the link, Cycle::step, set-points
//! ```
//! [`LiveRig`] is the loop, on any [`CanLink`](crate::link::CanLink) and any [`Metronome`]. [`serve`] is the other end: the
//! simulated devices on a link of their own. Neither reads a clock but through these two.

#[cfg(all(feature = "socketcan", target_os = "linux"))]
mod attach;
mod drill;
mod error;
mod histogram;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub mod host;
mod latency;
mod listen;
mod metronome;
mod proof;
mod rig;
mod scene;
mod serve;
mod simulation;
mod stages;
mod timing;

#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub use attach::{AttachError, Attached, Entrance, attach};
pub use drill::{DriveAddress, drive_addresses};
pub use error::LiveError;
pub use histogram::Histogram;
pub use latency::{Latency, Lateness, PROBE, PROVING_CYCLES, STOCK_CYCLES, Tier, measure_latency};
pub use listen::listen;
pub use metronome::Metronome;
pub use proof::{DriveIdentity, Subject, Unproven};
pub use rig::{BootWatch, LinkCounts, LiveRig};
pub use scene::{Ended, Play, Played};
pub use serve::{ServeError, serve};
pub use stages::StageTimes;
pub use timing::{Computer, Kept, Measured, REDUCED_FORCE_N, REDUCED_SPEED_M_PER_S, Untimely};
