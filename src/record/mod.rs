//! What a run leaves: one [`Row`] per control cycle, gathered in a [`Trace`], and the figures drawn from traces.
//!
//! Rows and traces are plain data without units of their own: every field carries its unit in its name, lengths and
//! forces are in the base frame. Planar rigs leave the third component zero.

mod trace;

#[cfg(feature = "figures")]
pub mod figure;

pub use trace::{ForceMeaning, ON_SURFACE_M, Phase, Reference, Row, Trace};
