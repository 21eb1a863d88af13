//! Records of a run: a [`CycleRecord`] of every control cycle, or a [`DeviceRecord`] of every sample. Records become the [`Row`]s of a
//! [`Trace`], and recordings on disk.
//!
//! Rows and traces are plain data without units of their own: every field carries its unit in its name, lengths and
//! forces are in the base frame. Planar rigs leave the third component zero.

mod cycle;
mod device;
mod trace;
pub mod trusted;

#[cfg(feature = "recording")]
pub mod recording;

/// Time before and after a fault that a black box keeps, in s.
pub const AROUND_FAULT_S: f64 = 2.0;

pub use cycle::{CycleRecord, Moment, Stages, Standstill, Truth, fault_severity};
pub use device::DeviceRecord;
pub use trace::{FaultMark, ForceMeaning, ON_SURFACE_M, Phase, Reference, Row, Setup, Trace};
