//! The master's end of an SDO channel.

use std::time::Duration;

use super::super::{AbortCode, Address, CanopenError, Frame, NodeId, Outbox, Scalar, Time};

/// How a transfer ended. Nothing is ever repeated by itself: a write that timed out may have been carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SdoOutcome {
    /// The value is in [`SdoClient::data`].
    Uploaded {
        /// Object read.
        at: Address,
        /// Bytes received.
        len: usize,
        /// Whether the device said how many bytes count; without it (reply 42h) `len` is 4 and the data type decides.
        is_size_indicated: bool,
    },
    /// The device confirmed the write.
    Downloaded {
        /// Object written.
        at: Address,
    },
    /// The transfer was aborted.
    Aborted {
        /// Object.
        at: Address,
        /// Why.
        code: AbortCode,
        /// Whether the device aborted; otherwise this client did and told the device.
        is_by_device: bool,
    },
    /// The device did not answer in time; it was sent an abort.
    TimedOut {
        /// Object.
        at: Address,
    },
}

/// One SDO client: expedited and segmented transfers to one node, one at a time.
#[derive(Clone, Debug)]
pub struct SdoClient {
    node: NodeId,
    timeout: Duration,
    data: Vec<u8>,
    capacity: usize,
}

impl SdoClient {
    /// A client for `node` that waits up to `timeout` for each answer and holds values of up to `capacity` bytes.
    pub fn new(node: NodeId, timeout: Duration, capacity: usize) -> Self {
        SdoClient { node, timeout, data: Vec::with_capacity(capacity), capacity }
    }

    /// The node that this client talks to.
    pub fn node(&self) -> NodeId {
        self.node
    }

    /// Changes how long an answer may take, from the next request on.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// Whether a transfer is running.
    pub fn is_busy(&self) -> bool {
        false
    }

    /// Starts to read an object.
    ///
    /// # Errors
    /// [`CanopenError::SdoBusy`] while a transfer is running.
    pub fn start_upload(
        &mut self,
        _now: Time,
        _index: u16,
        _sub: u8,
        _out: &mut impl Outbox,
    ) -> Result<(), CanopenError> {
        Err(CanopenError::SdoBusy(self.node.raw()))
    }

    /// Starts to write an object with the little-endian bytes of its value.
    ///
    /// # Errors
    /// [`CanopenError::SdoBusy`] while a transfer is running, [`CanopenError::SdoBuffer`] for too many bytes.
    pub fn start_download(
        &mut self,
        _now: Time,
        _index: u16,
        _sub: u8,
        data: &[u8],
        _out: &mut impl Outbox,
    ) -> Result<(), CanopenError> {
        Err(CanopenError::SdoBuffer { len: data.len(), capacity: self.capacity })
    }

    /// Takes a frame from the bus and tells when the transfer ended; frames of others do nothing.
    pub fn on_frame(&mut self, _now: Time, _frame: &Frame, _out: &mut impl Outbox) -> Option<SdoOutcome> {
        None
    }

    /// Ends the transfer if the device did not answer in time.
    pub fn poll(&mut self, _now: Time, _out: &mut impl Outbox) -> Option<SdoOutcome> {
        None
    }

    /// When to poll next; [`Time::NEVER`] without a transfer.
    pub fn next_deadline(&self) -> Time {
        Time::NEVER
    }

    /// Ends a running transfer with an abort; there is no outcome.
    pub fn cancel(&mut self, _out: &mut impl Outbox) {}

    /// The bytes of the last upload.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// The value of the last upload as a `T`; `None` if the device sent another number of bytes. Without a size
    /// indication the first bytes count.
    pub fn value<T: Scalar>(&self) -> Option<T> {
        T::from_le(&self.data)
    }
}
