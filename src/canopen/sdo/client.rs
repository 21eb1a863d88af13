//! The master's end of an SDO channel.

use std::time::Duration;

use super::super::{AbortCode, Address, CanopenError, Frame, NodeId, Outbox, Scalar, Time, cob};
use super::wire::{self, Initiate, Response};

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

#[derive(Clone, Copy, Debug)]
enum Phase {
    Idle,
    UploadInitiate,
    UploadSegments { toggle: bool, declared: Option<usize> },
    DownloadInitiate,
    DownloadSegments { toggle: bool, sent: usize },
}

/// What a response leads to.
enum Step {
    Ignore,
    Send(wire::Payload),
    End(SdoOutcome),
    Abort(AbortCode),
}

/// One SDO client: expedited and segmented transfers to one node, one at a time.
#[derive(Clone, Debug)]
pub struct SdoClient {
    node: NodeId,
    timeout: Duration,
    capacity: usize,
    phase: Phase,
    at: Address,
    data: Vec<u8>,
    has_size: bool,
    deadline: Time,
}

impl SdoClient {
    /// A client for `node` that waits up to `timeout` for each answer and holds values of up to `capacity` bytes (at
    /// least 4).
    pub fn new(node: NodeId, timeout: Duration, capacity: usize) -> Self {
        let capacity = capacity.max(wire::EXPEDITED);
        SdoClient {
            node,
            timeout,
            capacity,
            phase: Phase::Idle,
            at: Address::new(0, 0),
            data: Vec::with_capacity(capacity),
            has_size: true,
            deadline: Time::NEVER,
        }
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
        !matches!(self.phase, Phase::Idle)
    }

    /// Starts to read an object.
    ///
    /// # Errors
    /// [`CanopenError::SdoBusy`] while a transfer is running.
    pub fn start_upload(&mut self, now: Time, index: u16, sub: u8, out: &mut impl Outbox) -> Result<(), CanopenError> {
        self.begin(index, sub)?;
        self.phase = Phase::UploadInitiate;
        self.send(now, wire::upload_request(self.at), out);
        Ok(())
    }

    /// Starts to write an object with the little-endian bytes of its value.
    ///
    /// # Errors
    /// [`CanopenError::SdoBusy`] while a transfer is running, [`CanopenError::SdoBuffer`] for too many bytes.
    pub fn start_download(
        &mut self,
        now: Time,
        index: u16,
        sub: u8,
        data: &[u8],
        out: &mut impl Outbox,
    ) -> Result<(), CanopenError> {
        if data.len() > self.capacity {
            return Err(CanopenError::SdoBuffer { len: data.len(), capacity: self.capacity });
        }
        self.begin(index, sub)?;
        self.data.extend_from_slice(data);
        self.phase = Phase::DownloadInitiate;
        self.send(now, wire::download_request(self.at, data), out);
        Ok(())
    }

    /// Takes a frame from the bus and tells when the transfer ended. Frames of others, answers for another object and
    /// aborts of another object do nothing.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) -> Option<SdoOutcome> {
        if frame.id() != cob::sdo_response(self.node) || frame.len() != 8 || !self.is_busy() {
            return None;
        }
        match self.step(wire::decode_response(frame.bytes())) {
            Step::Ignore => None,
            Step::Send(payload) => {
                self.send(now, payload, out);
                None
            }
            Step::End(outcome) => {
                self.end();
                Some(outcome)
            }
            Step::Abort(code) => {
                self.cancel_with(code, out);
                Some(SdoOutcome::Aborted { at: self.at, code, is_by_device: false })
            }
        }
    }

    /// Ends the transfer if the device did not answer in time.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) -> Option<SdoOutcome> {
        if now < self.deadline || !self.is_busy() {
            return None;
        }
        self.cancel_with(AbortCode::TIMEOUT, out);
        Some(SdoOutcome::TimedOut { at: self.at })
    }

    /// When to poll next; [`Time::NEVER`] without a transfer.
    pub fn next_deadline(&self) -> Time {
        self.deadline
    }

    /// Ends a running transfer with an abort (08000000h); there is no outcome.
    pub fn cancel(&mut self, out: &mut impl Outbox) {
        if self.is_busy() {
            self.cancel_with(AbortCode::GENERAL, out);
        }
    }

    /// The bytes of the last upload; of a download, those written.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// The value of the last upload as a `T`; `None` if the device sent another number of bytes. Without a size
    /// indication the first bytes count.
    pub fn value<T: Scalar>(&self) -> Option<T> {
        let len = T::DATA_TYPE.size()?;
        let data = if self.has_size { Some(self.data.as_slice()) } else { self.data.get(..len) };
        data.and_then(T::from_le_slice)
    }

    fn begin(&mut self, index: u16, sub: u8) -> Result<(), CanopenError> {
        if self.is_busy() {
            return Err(CanopenError::SdoBusy(self.node.raw()));
        }
        self.at = Address::new(index, sub);
        self.data.clear();
        self.has_size = true;
        Ok(())
    }

    fn send(&mut self, now: Time, payload: wire::Payload, out: &mut impl Outbox) {
        self.deadline = now + self.timeout;
        out.push(Frame::new(cob::sdo_request(self.node), &payload));
    }

    fn end(&mut self) {
        self.phase = Phase::Idle;
        self.deadline = Time::NEVER;
    }

    fn cancel_with(&mut self, code: AbortCode, out: &mut impl Outbox) {
        out.push(Frame::new(cob::sdo_request(self.node), &wire::abort(self.at, code)));
        self.end();
    }

    fn step(&mut self, response: Response<'_>) -> Step {
        let mine = self.at;
        match (self.phase, response) {
            (_, Response::Abort { at, code }) if at == mine => {
                Step::End(SdoOutcome::Aborted { at, code, is_by_device: true })
            }
            (Phase::UploadInitiate, Response::Upload { at, initiate }) if at == mine => self.upload(initiate),
            (Phase::UploadSegments { toggle, declared }, Response::UploadSegment(segment)) => {
                if segment.toggle != toggle {
                    return Step::Abort(AbortCode::TOGGLE);
                }
                self.data_segment(segment.data, segment.last, toggle, declared)
            }
            (Phase::DownloadInitiate, Response::Download { at }) if at == mine => {
                if wire::is_expedited(self.data.len()) {
                    return Step::End(SdoOutcome::Downloaded { at });
                }
                self.next_segment(false, 0)
            }
            (Phase::DownloadSegments { toggle, sent }, Response::DownloadSegment { toggle: echoed }) => {
                if echoed != toggle {
                    Step::Abort(AbortCode::TOGGLE)
                } else if sent >= self.data.len() {
                    Step::End(SdoOutcome::Downloaded { at: mine })
                } else {
                    self.next_segment(!toggle, sent)
                }
            }
            // Late answers to earlier transfers; a device that really lost step runs into the time limit.
            _ => Step::Ignore,
        }
    }

    fn upload(&mut self, initiate: Initiate<'_>) -> Step {
        match initiate {
            Initiate::Expedited { data, is_size_indicated } => {
                self.data.extend_from_slice(data);
                self.has_size = is_size_indicated;
                Step::End(SdoOutcome::Uploaded { at: self.at, len: data.len(), is_size_indicated })
            }
            Initiate::Segmented { size } => {
                let declared = size.map(|size| size as usize);
                if declared.is_some_and(|size| size > self.capacity) {
                    return Step::Abort(AbortCode::OUT_OF_MEMORY);
                }
                self.phase = Phase::UploadSegments { toggle: false, declared };
                Step::Send(wire::upload_segment_request(false))
            }
        }
    }

    fn data_segment(&mut self, data: &[u8], is_last: bool, toggle: bool, declared: Option<usize>) -> Step {
        let len = self.data.len() + data.len();
        if declared.is_some_and(|size| len > size) {
            return Step::Abort(AbortCode::TOO_LONG);
        }
        if len > self.capacity {
            return Step::Abort(AbortCode::OUT_OF_MEMORY);
        }
        self.data.extend_from_slice(data);
        if is_last {
            return match declared {
                Some(size) if len < size => Step::Abort(AbortCode::TOO_SHORT),
                _ => Step::End(SdoOutcome::Uploaded { at: self.at, len, is_size_indicated: true }),
            };
        }
        // An empty segment that is not the last would let a device keep the transfer open for ever.
        if data.is_empty() {
            return Step::Abort(AbortCode::LENGTH);
        }
        self.phase = Phase::UploadSegments { toggle: !toggle, declared };
        Step::Send(wire::upload_segment_request(!toggle))
    }

    fn next_segment(&mut self, toggle: bool, sent: usize) -> Step {
        let (payload, len) = wire::segment(&self.data, sent, toggle);
        self.phase = Phase::DownloadSegments { toggle, sent: sent + len };
        Step::Send(payload)
    }
}
