//! The master's end of an SDO channel.

mod steps;

use std::time::Duration;

use super::super::{CanopenError, Frame, NodeId, Outbox, cob};
use super::block::{BlockReceiver, BlockSender};
use super::wire;
use crate::objects::{AbortCode, Address, Scalar, write_patience};
use crate::time::Time;

/// Result of a transfer.
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
        /// The reason.
        code: AbortCode,
        /// Whether the device aborted; otherwise this client aborted and sent an abort to the device.
        is_by_device: bool,
    },
    /// The device did not answer in time; it was sent an abort.
    TimedOut {
        /// Object.
        at: Address,
        /// Whether the device may have carried out a write without the confirmation getting through: read the object
        /// back before writing it again.
        may_be_written: bool,
    },
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    Idle,
    UploadInitiate,
    UploadSegments { toggle: bool, declared: Option<usize> },
    DownloadInitiate,
    DownloadSegments { toggle: bool, sent: usize },
    BlockUploadInitiate,
    BlockUpload { receiver: BlockReceiver, answer: wire::Payload, declared: Option<usize>, has_crc: bool },
    BlockDownloadInitiate { unanswered: u8 },
    BlockDownload { sender: BlockSender, unanswered: u8, has_crc: bool },
    BlockDownloadEnd { has_crc: bool, is_repeated: bool },
}

/// Action after a response.
enum Step {
    Ignore,
    /// A frame that brings the transfer forward without being answered each.
    Wait,
    Send(wire::Payload),
    /// Segments of a block are due.
    Stream,
    End(SdoOutcome),
    Confirm(wire::Payload, SdoOutcome),
    Abort(AbortCode),
}

/// Default number of repetitions of a request.
const RETRIES: u8 = 2;
/// Default longest transfer: 1 MiB in segments at 125 kbit/s.
const LONGEST_TRANSFER: Duration = Duration::from_secs(600);
/// Default time between two segments of a block while process data run: half of the bus at 1 Mbit/s stays free.
const SEGMENT_INTERVAL: Duration = Duration::from_micros(250);
/// Bytes reserved when a client is made; more only as data really arrive.
const RESERVED: usize = 1024;
/// Values of so many bytes take no more frames in segments than in a block.
const SWITCH_BELOW: u8 = 28;

/// One SDO client: expedited, segmented and block transfers to one node, one at a time.
///
/// The client repeats a read a bounded number of times when an answer does not come or its checksum differs. A write is never
/// repeated automatically, since the device may have carried it out: see [`SdoOutcome::TimedOut`]. Within a block transfer
/// lost frames of both sides are sent again; the device writes the object at the end of a transfer only.
#[derive(Clone, Debug)]
pub struct SdoClient {
    node: NodeId,
    timeout: Duration,
    /// Longest time to each answer of the present transfer.
    patience: Duration,
    capacity: usize,
    retries: u8,
    longest: Duration,
    block_size: u8,
    segment_interval: Duration,
    is_exchanging: bool,
    phase: Phase,
    at: Address,
    data: Vec<u8>,
    has_size: bool,
    is_block: bool,
    /// Repetitions left for the frame that is out.
    tries: u8,
    /// Fresh starts left for the read.
    restarts: u8,
    deadline: Time,
    give_up_at: Time,
}

impl SdoClient {
    /// Bytes of the largest value that a client should take without a reason: 1 MiB.
    pub const DEFAULT_CAPACITY: usize = 1 << 20;

    /// Creates a client for `node` that waits up to `timeout` for each answer and holds values of up to `capacity` bytes (at
    /// least 4). A write that the device stores has the time of [`write_patience`]. Memory is taken as data arrive, not
    /// by what a device announces.
    pub fn new(node: NodeId, timeout: Duration, capacity: usize) -> Self {
        let capacity = capacity.max(wire::EXPEDITED);
        SdoClient {
            node,
            timeout,
            patience: timeout,
            capacity,
            retries: RETRIES,
            longest: LONGEST_TRANSFER,
            block_size: wire::LARGEST_BLOCK,
            segment_interval: SEGMENT_INTERVAL,
            is_exchanging: true,
            phase: Phase::Idle,
            at: Address::new(0, 0),
            data: Vec::with_capacity(capacity.min(RESERVED)),
            has_size: true,
            is_block: false,
            tries: 0,
            restarts: 0,
            deadline: Time::NEVER,
            give_up_at: Time::NEVER,
        }
    }

    /// Returns the node that this client talks to.
    pub fn node(&self) -> NodeId {
        self.node
    }

    /// Changes how long an answer may take, from the next request on.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// Sets how often a read, and a frame of a block transfer, is repeated when no answer comes; 2 unless set.
    pub fn set_retries(&mut self, retries: u8) {
        self.retries = retries;
    }

    /// Sets how long a whole transfer may take; ten minutes unless set.
    pub fn set_longest_transfer(&mut self, longest: Duration) {
        self.longest = longest;
    }

    /// Sets how many segments a device may send before an acknowledgement (1 to 127, clamped; 127 unless set). Also sets the time between
    /// two segments of this client while process data run (250 us unless set). Zero sends a whole block at once, which holds up every other
    /// frame behind it.
    pub fn set_block(&mut self, block_size: u8, segment_interval: Duration) {
        self.block_size = block_size.clamp(1, wire::LARGEST_BLOCK);
        self.segment_interval = segment_interval;
    }

    /// Sets whether process data run, which the owner of the loop knows; the default is that they run. While they do not, the client sends
    /// a block as fast as the outbox takes it ([`Outbox::offer`]). The setting also applies to a running transfer.
    pub fn set_exchanging(&mut self, is_exchanging: bool) {
        self.is_exchanging = is_exchanging;
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
        self.begin(now, index, sub, false)?;
        self.request_upload(now, out);
        Ok(())
    }

    /// Starts to read an object in blocks. A device without block transfer sends segments, and so does one that finds
    /// the value too short for blocks.
    ///
    /// # Errors
    /// [`CanopenError::SdoBusy`] while a transfer is running.
    pub fn start_block_upload(
        &mut self,
        now: Time,
        index: u16,
        sub: u8,
        out: &mut impl Outbox,
    ) -> Result<(), CanopenError> {
        self.begin(now, index, sub, true)?;
        self.request_upload(now, out);
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
        self.begin_download(now, index, sub, data, false)?;
        self.phase = Phase::DownloadInitiate;
        self.send(now, wire::download_request(self.at, data), out);
        Ok(())
    }

    /// Starts to write an object in blocks; a device without block transfer gets segments.
    ///
    /// # Errors
    /// [`CanopenError::SdoBusy`] while a transfer is running, [`CanopenError::SdoBuffer`] for too many bytes.
    pub fn start_block_download(
        &mut self,
        now: Time,
        index: u16,
        sub: u8,
        data: &[u8],
        out: &mut impl Outbox,
    ) -> Result<(), CanopenError> {
        self.begin_download(now, index, sub, data, true)?;
        self.phase = Phase::BlockDownloadInitiate { unanswered: 0 };
        self.send(now, wire::block_download_request(self.at, data.len()), out);
        Ok(())
    }

    /// Takes a frame from the bus and returns the outcome when the transfer ended. Frames of other nodes, answers for another object and
    /// aborts of another object do nothing.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) -> Option<SdoOutcome> {
        if frame.id() != cob::sdo_response(self.node) || frame.len() != 8 || !self.is_busy() {
            return None;
        }
        let step = match self.phase {
            Phase::BlockUpload { .. } => self.take_block_frame(frame.bytes()),
            _ => self.step(now, frame.bytes()),
        };
        match step {
            Step::Ignore => None,
            Step::Wait => {
                self.deadline = now + self.patience;
                self.tries = self.retries;
                None
            }
            Step::Send(payload) => {
                self.send(now, payload, out);
                None
            }
            Step::Stream => {
                self.tries = self.retries;
                self.deadline = now + self.patience;
                self.stream(now, out);
                None
            }
            Step::End(outcome) => {
                self.end();
                Some(outcome)
            }
            Step::Confirm(payload, outcome) => {
                self.push(payload, out);
                self.end();
                Some(outcome)
            }
            Step::Abort(AbortCode::CRC) if self.restarts > 0 => {
                self.restart_upload(now, AbortCode::CRC, out);
                None
            }
            Step::Abort(code) => {
                self.cancel_with(code, out);
                Some(SdoOutcome::Aborted { at: self.at, code, is_by_device: false })
            }
        }
    }

    /// Sends the segments that are due, and repeats a request or ends the transfer if the device did not answer in time.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) -> Option<SdoOutcome> {
        if now < self.next_deadline() || !self.is_busy() {
            return None;
        }
        self.stream(now, out);
        if now >= self.give_up_at {
            return Some(self.time_out(out));
        }
        if now < self.deadline { None } else { self.on_silence(now, out) }
    }

    /// Returns the time of the next poll; [`Time::NEVER`] without a transfer.
    pub fn next_deadline(&self) -> Time {
        let answer_by = self.deadline.min(self.give_up_at);
        match &self.phase {
            Phase::BlockDownload { sender, .. } => answer_by.min(sender.next_at()),
            _ => answer_by,
        }
    }

    /// Ends a running transfer with an abort (08000000h); there is no outcome.
    pub fn cancel(&mut self, out: &mut impl Outbox) {
        if self.is_busy() {
            self.cancel_with(AbortCode::GENERAL, out);
        }
    }

    /// Returns the bytes of the last upload; of a download, those written.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// Returns the value of the last upload as a `T`; `None` if the device sent another number of bytes. Without a size
    /// indication the first bytes count.
    pub fn value<T: Scalar>(&self) -> Option<T> {
        let len = T::DATA_TYPE.size()?;
        let data = if self.has_size { Some(self.data.as_slice()) } else { self.data.get(..len) };
        data.and_then(T::from_le_slice)
    }

    fn begin(&mut self, now: Time, index: u16, sub: u8, is_block: bool) -> Result<(), CanopenError> {
        if self.is_busy() {
            return Err(CanopenError::SdoBusy(self.node.raw()));
        }
        self.at = Address::new(index, sub);
        self.data.clear();
        self.patience = self.timeout;
        self.is_block = is_block;
        self.restarts = self.retries;
        self.give_up_at = now + self.longest;
        Ok(())
    }

    /// Whether a value of `len` bytes may be written.
    pub(in super::super) fn check_len(&self, len: usize) -> Result<(), CanopenError> {
        let capacity = self.capacity;
        if len > capacity { Err(CanopenError::SdoBuffer { len, capacity }) } else { Ok(()) }
    }

    fn begin_download(
        &mut self,
        now: Time,
        index: u16,
        sub: u8,
        data: &[u8],
        is_block: bool,
    ) -> Result<(), CanopenError> {
        self.check_len(data.len())?;
        self.begin(now, index, sub, is_block)?;
        self.patience = write_patience(self.at, self.timeout);
        self.has_size = true;
        self.restarts = 0;
        self.data.extend_from_slice(data);
        Ok(())
    }

    fn request_upload(&mut self, now: Time, out: &mut impl Outbox) {
        self.data.clear();
        self.has_size = true;
        if self.is_block {
            self.phase = Phase::BlockUploadInitiate;
            self.send(now, wire::block_upload_request(self.at, self.block_size, SWITCH_BELOW), out);
        } else {
            self.phase = Phase::UploadInitiate;
            self.send(now, wire::upload_request(self.at), out);
        }
    }

    fn restart_upload(&mut self, now: Time, code: AbortCode, out: &mut impl Outbox) {
        self.restarts -= 1;
        self.push(wire::abort(self.at, code), out);
        self.request_upload(now, out);
    }

    /// Sends what has to be answered.
    fn send(&mut self, now: Time, payload: wire::Payload, out: &mut impl Outbox) {
        self.deadline = now + self.patience;
        self.tries = self.retries;
        self.push(payload, out);
    }

    fn push(&self, payload: wire::Payload, out: &mut impl Outbox) {
        out.push(Frame::new(cob::sdo_request(self.node), &payload));
    }

    fn stream(&mut self, now: Time, out: &mut impl Outbox) {
        let Phase::BlockDownload { sender, .. } = &mut self.phase else { return };
        let id = cob::sdo_request(self.node);
        let interval = if self.is_exchanging { self.segment_interval } else { Duration::ZERO };
        // Without room for a time the transfer ends as one without answers does.
        if sender.poll(now, interval, &self.data, |payload| out.offer(Frame::new(id, &payload))) {
            self.tries = self.retries;
            let last = if sender.next_at() == Time::NEVER { now } else { sender.next_at() };
            self.deadline = last + self.patience;
        }
    }

    fn on_silence(&mut self, now: Time, out: &mut impl Outbox) -> Option<SdoOutcome> {
        match self.phase {
            Phase::UploadInitiate | Phase::UploadSegments { .. } if self.restarts > 0 => {
                self.restart_upload(now, AbortCode::TIMEOUT, out);
                return None;
            }
            Phase::Idle
            | Phase::UploadInitiate
            | Phase::UploadSegments { .. }
            | Phase::DownloadInitiate
            | Phase::DownloadSegments { .. } => return Some(self.time_out(out)),
            _ if self.tries == 0 => return Some(self.time_out(out)),
            _ => {}
        }
        match self.repetition() {
            Ok(payload) => {
                self.tries -= 1;
                self.deadline = now + self.patience;
                if let Some(payload) = payload {
                    self.push(payload, out);
                }
                None
            }
            Err(code) => {
                self.cancel_with(code, out);
                Some(SdoOutcome::Aborted { at: self.at, code, is_by_device: false })
            }
        }
    }

    fn time_out(&mut self, out: &mut impl Outbox) -> SdoOutcome {
        let may_be_written = self.may_be_written();
        self.cancel_with(AbortCode::TIMEOUT, out);
        SdoOutcome::TimedOut { at: self.at, may_be_written }
    }

    fn end(&mut self) {
        self.phase = Phase::Idle;
        (self.deadline, self.give_up_at) = (Time::NEVER, Time::NEVER);
    }

    fn cancel_with(&mut self, code: AbortCode, out: &mut impl Outbox) {
        self.push(wire::abort(self.at, code), out);
        self.end();
    }
}
