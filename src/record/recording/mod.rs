//! Recordings: every cycle on disk, to be looked at elsewhere and to be run again here.
//!
//! ```text
//! cycle -> CycleRecord -> Producer (wait-free ring) ... Feed (own thread) -> Recorder: cycles.mcap, cycles.csv
//!                                                                         -> BlackBox: the time around a fault
//! Reader: an .mcap, whole or not -> CycleRecord
//! ```
//! A recording holds virtual time only, so that the same run gives the same bytes.

mod black_box;
mod error;
mod feed;
mod fields;
mod forms;
mod reader;
mod scalar;
#[cfg(test)]
mod tests;
mod writer;

pub use black_box::{BlackBox, Saved};
pub use error::ReadError;
pub use feed::{Backpressure, Counts, Feed, Finished, Producer, Sink};
pub use forms::{DecodeError, Difference, csv_header, csv_row, decode, definition, difference, encode, table};
pub use reader::{Damage, Reader};
pub use writer::{About, Recorder, Writer};
