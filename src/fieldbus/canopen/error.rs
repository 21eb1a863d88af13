//! Faults of a device, a mapping or a call, found before anything is on the bus.

use crate::objects::DictionaryError;

/// A fault found while building a device or starting a service; faults reported by a device are an
/// [`AbortCode`](crate::objects::AbortCode).
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CanopenError {
    /// A node id outside 1 to 127.
    #[error("node id {0} is outside 1 to 127")]
    NodeId(u8),
    /// The dictionary cannot be built, or lacks an object that the node needs.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    /// A PDO number outside 1 to 4.
    #[error("PDO number {0} is outside 1 to 4")]
    PdoNumber(u8),
    /// Mapped objects of more than 64 bits.
    #[error("the mapped objects have {0} bits, and a PDO has room for 64: remove entries, or use a second PDO")]
    PdoBits(u32),
    /// More mapped objects than a mapping record of these devices holds.
    #[error("{0} objects are mapped, and a mapping record has room for 8: remove entries, or use a second PDO")]
    PdoEntries(usize),
    /// A mapping entry that names no object, one that cannot be mapped, or a wrong length.
    #[error("object {index:04X}h:{sub} cannot be mapped with {bits} bits")]
    NotMappable {
        /// Object index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Length in bits of the mapping entry.
        bits: u8,
    },
    /// A COB-ID that is reserved for another service or not 11 bits wide.
    #[error("COB-ID {0:X}h is reserved or not 11 bits wide")]
    CobId(u32),
    /// A transmission type that the engine does not serve (241 to 253).
    #[error("transmission type {0} is not served")]
    TransmissionType(u8),
    /// A SYNC counter overflow value of 1 or above 240.
    #[error("SYNC counter overflow {0} is not 0 or 2 to 240")]
    SyncOverflow(u8),
    /// An SDO transfer is running to this node.
    #[error("an SDO transfer to node {0} is still running")]
    SdoBusy(u8),
    /// An LSS request is running.
    #[error("an LSS request is still running")]
    LssBusy,
    /// More data than the client's buffer holds.
    #[error("{len} bytes do not fit the SDO buffer of {capacity}")]
    SdoBuffer {
        /// Bytes given.
        len: usize,
        /// Bytes that the buffer holds.
        capacity: usize,
    },
}
