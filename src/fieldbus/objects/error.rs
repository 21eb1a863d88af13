//! Faults of a dictionary, found before anything is on a bus.

use super::DataType;

/// A fault found while a dictionary is built or a handle is taken; what a device reports is an
/// [`AbortCode`](super::AbortCode).
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DictionaryError {
    /// Two declarations have the same address.
    #[error("object {index:04X}h:{sub} is declared twice")]
    Duplicate {
        /// Object index.
        index: u16,
        /// Sub-index.
        sub: u8,
    },
    /// The dictionary has no such object.
    #[error("object {index:04X}h:{sub} does not exist")]
    NoObject {
        /// Object index.
        index: u16,
        /// Sub-index.
        sub: u8,
    },
    /// The object has another data type than the one asked for.
    #[error("object {index:04X}h:{sub} is {is}, not {wanted}")]
    TypeMismatch {
        /// Object index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Type of the object.
        is: DataType,
        /// Type asked for.
        wanted: DataType,
    },
    /// Limits that are inverted or not comparable, a default outside them, or limits on a string.
    #[error("object {index:04X}h:{sub}: the limits are inverted or the default is outside them")]
    Limits {
        /// Object index.
        index: u16,
        /// Sub-index.
        sub: u8,
    },
    /// The value is longer than the object can hold, or a basic type has another size.
    #[error("object {index:04X}h:{sub} holds {capacity} bytes, not {len}")]
    Length {
        /// Object index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Bytes given.
        len: usize,
        /// Bytes that the object holds.
        capacity: usize,
    },
}
