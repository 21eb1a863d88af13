//! Concise device configuration files, as object 1F22h of a CANopen manager holds them.
//!
//! | bytes | what |
//! |---|---|
//! | 4 | number of values |
//! | 2, 1, 4 | for each value: index, sub-index, number of bytes |
//! | as many | the value |
//!
//! All numbers are unsigned and little endian. The values are in the order in which a manager writes them: an object may come twice.
//!
//! # Source
//! CiA 302-3, *Configuration and program download*.

use super::{MAX_BYTES, MAX_ENTRIES};

/// Bytes of a value's head: index, sub-index, number of bytes.
const HEAD: usize = 7;

/// Why a concise file cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConciseError {
    /// It is too large to be one.
    #[error("is larger than {MAX_BYTES} bytes")]
    Large,
    /// More values than any device has.
    #[error("byte 0: the number of values is {count}, and at most {MAX_ENTRIES} are read")]
    Many {
        /// Number of values that it says it has.
        count: u32,
    },
    /// It ends in the number of values, or in the head of one.
    #[error("byte {at}: the file ends before the head of value {number} of {count}")]
    NoHead {
        /// Offset of the head, or of the number of values, in bytes.
        at: usize,
        /// Number of the value, from 1.
        number: u32,
        /// Number of values that it says it has; 0 if that is not whole.
        count: u32,
    },
    /// It ends in a value.
    #[error("byte {at}: {index:04X}h:{sub} has {length} bytes by its head, and {left} are left")]
    Short {
        /// Offset of the value in bytes.
        at: usize,
        /// Index of the object.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Bytes that the value has by its head.
        length: u32,
        /// Bytes that the file has.
        left: usize,
    },
    /// Something follows behind the last value.
    #[error("byte {at}: value {count}, the last one, ends here, and {left} bytes follow")]
    Trailing {
        /// Offset of the end of the last value in bytes.
        at: usize,
        /// Number of values.
        count: u32,
        /// Bytes that follow.
        left: usize,
    },
}

/// Whether bytes are those of a concise file with less than 65536 values, not of a text. The upper half of the number is two
/// zeros; no text in UTF-8, UTF-16 or Latin-1 has zeros there.
pub fn is_concise(bytes: &[u8]) -> bool {
    bytes.get(2..4) == Some(&[0, 0])
}

/// An entry of a concise DCF: index, sub-index and the bytes of the value, the lowest first.
pub type ConciseEntry<'a> = (u16, u8, &'a [u8]);

/// The values of a concise file in their order: index, sub-index, bytes.
///
/// # Errors
/// If it is not whole, or too large.
pub fn read_concise(bytes: &[u8]) -> Result<Vec<ConciseEntry<'_>>, ConciseError> {
    if bytes.len() > MAX_BYTES {
        return Err(ConciseError::Large);
    }
    let (count, mut rest) = bytes.split_first_chunk().ok_or(ConciseError::NoHead { at: 0, number: 1, count: 0 })?;
    let count = u32::from_le_bytes(*count);
    if count as usize > MAX_ENTRIES {
        return Err(ConciseError::Many { count });
    }
    let mut values = Vec::new();
    for number in 1..=count {
        let at = bytes.len() - rest.len();
        let (head, after) = rest.split_first_chunk::<HEAD>().ok_or(ConciseError::NoHead { at, number, count })?;
        let [low, high, sub, length @ ..] = *head;
        let (index, length) = (u16::from_le_bytes([low, high]), u32::from_le_bytes(length));
        let short = ConciseError::Short { at: at + HEAD, index, sub, length, left: after.len() };
        let (value, after) = after.split_at_checked(length as usize).ok_or(short)?;
        values.push((index, sub, value));
        rest = after;
    }
    match rest.len() {
        0 => Ok(values),
        left => Err(ConciseError::Trailing { at: bytes.len() - left, count, left }),
    }
}

/// A concise file of values: index, sub-index, bytes.
pub fn concise<'a>(values: impl IntoIterator<Item = (u16, u8, &'a [u8])>) -> Vec<u8> {
    let mut bytes = vec![0; 4];
    let mut count: u32 = 0;
    for (index, sub, value) in values {
        bytes.extend(index.to_le_bytes());
        bytes.push(sub);
        bytes.extend((value.len() as u32).to_le_bytes());
        bytes.extend(value);
        count += 1;
    }
    bytes[..4].copy_from_slice(&count.to_le_bytes());
    bytes
}
