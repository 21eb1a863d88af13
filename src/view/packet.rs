//! Packets: a header of 16 bytes and packed records behind one another, all little-endian.
//!
//! ```text
//! 0   u8       1
//! 1   u8 x 3   0
//! 4   u32      count of records
//! 8   u64      records lost before this packet, since the start
//! 16           records, as `yieldwall_record::recording::layout` describes them
//! ```

use axum::body::Bytes;
use yieldwall_record::recording::{Recorded, pack};

/// Size of the header in bytes.
const HEADER: usize = 16;
/// Kind of a packet of records.
const KIND: u8 = 1;

/// A packet that is being filled.
#[derive(Debug)]
pub(crate) struct Packet {
    bytes: Vec<u8>,
    count: u32,
    capacity: usize,
}

impl Packet {
    /// Returns an empty packet with room for `records` of `stride` bytes.
    pub(crate) fn new(records: u32, stride: usize) -> Self {
        let capacity = HEADER + records as usize * stride;
        Self { bytes: Self::blank(capacity), count: 0, capacity }
    }

    fn blank(capacity: usize) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(capacity);
        bytes.resize(HEADER, 0);
        bytes
    }

    /// Adds a record, and returns its bytes.
    pub(crate) fn push<T: Recorded>(&mut self, record: &T) -> &[u8] {
        let start = self.bytes.len();
        pack(record, &mut self.bytes);
        self.count += 1;
        self.bytes.get(start..).unwrap_or_default()
    }

    /// Number of records so far.
    pub(crate) fn count(&self) -> u32 {
        self.count
    }

    /// Returns the packet and begins another; `None` if there are no records.
    pub(crate) fn take(&mut self, lost: u64) -> Option<Bytes> {
        if self.count == 0 {
            return None;
        }
        let mut bytes = std::mem::replace(&mut self.bytes, Self::blank(self.capacity));
        let count = std::mem::take(&mut self.count);
        let header =
            [u32::from(KIND).to_le_bytes(), count.to_le_bytes()].into_iter().flatten().chain(lost.to_le_bytes());
        bytes.iter_mut().zip(header).for_each(|(to, from)| *to = from);
        Some(bytes.into())
    }
}
