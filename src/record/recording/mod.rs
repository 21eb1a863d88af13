//! Recordings: every cycle on disk, for other programs to read and for this program to run again.
//!
//! ```text
//! cycle -> CycleRecord -> Producer (wait-free ring) ... Feed (own thread) -> Recorder: cycles.mcap, cycles.csv
//!                                                                         -> BlackBox: the time around a fault
//! Reader: an .mcap, whole or not -> CycleRecord
//! and in the same forms: the DeviceRecord of each sample of an impedance device
//! ```
//! A recording holds virtual time only, so that the same run gives the same bytes.

mod about;
mod black_box;
mod error;
mod feed;
mod fields;
mod forms;
mod reader;
mod recorded;
mod scalar;
#[cfg(test)]
mod tests;
mod writer;

pub use about::{About, Machine};
pub use black_box::{BlackBox, Saved};
pub use error::ReadError;
pub use feed::{Backpressure, Counts, Feed, Finished, Inlet, Outlet, Producer, Sink, side_ring};
pub use forms::{
    DecodeError, Difference, FieldLayout, Layout, csv_header, csv_row, decode, definition, difference, encode, layout,
    pack, table,
};
pub use reader::{Damage, Reader, Recording, open};
pub use recorded::Recorded;
pub use writer::{Recorder, Writer};
