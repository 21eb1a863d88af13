//! Access to the objects of a device, whatever its bus: what is asked for, and how it ends.

use super::{AbortCode, Address};
use std::time::Duration;
use thiserror::Error;

/// Longest time for a write of 1010h or 1011h: the device erases and writes its memory before it answers.
const STORING: Duration = Duration::from_secs(10);

/// Returns the longest time to the answer to a write of an object: `usual`, and at least 10 s for 1010h (store parameters) and 1011h
/// (restore default parameters).
///
/// Real-time: yes.
pub fn write_patience(at: Address, usual: Duration) -> Duration {
    if matches!(at.index, 0x1010 | 0x1011) { usual.max(STORING) } else { usual }
}

/// Request to a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectRequest<'a> {
    /// The value of an object.
    Read(Address),
    /// Write of an object: the little-endian bytes of the value.
    Write(Address, &'a [u8]),
}

/// Result of the last request to a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectAnswer<'a> {
    /// There was no request since the start of the network.
    NotAsked,
    /// It has not ended.
    Pending,
    /// The bytes that were read; none after a write.
    Done(&'a [u8]),
    /// The reason why there are none.
    Failed(ObjectError),
}

/// Reason why an object could not be read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ObjectError {
    /// The device has no objects, as a sensor on plain CAN.
    #[error("the device has no object dictionary")]
    NoObjects,
    /// The device has not answered the last request, or is being configured.
    #[error("the device is being asked already")]
    Busy,
    /// The network was never started, or did not come up: nothing is sent, since another master may be there.
    #[error("the network was not booted")]
    NotBooted,
    /// More bytes than a transfer takes.
    #[error("{0} bytes are more than a transfer takes")]
    TooLong(usize),
    /// The transfer was aborted.
    #[error("{0}")]
    Aborted(AbortCode),
    /// The device does not answer in time, or was restarted meanwhile.
    #[error("no answer")]
    NoAnswer,
}
