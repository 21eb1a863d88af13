//! The device's end of an SDO channel.

use std::time::Duration;

use super::block::{BlockReceiver, BlockSender, Taken};
use super::wire::{self, BlockFrame, Initiate, Payload, Request};
use crate::objects::{AbortCode, Address};
use crate::time::Time;

/// Objects of the server: a dictionary with the rules of its device.
pub(in super::super) trait Objects {
    /// Puts the value of an object into `value`, which is empty.
    fn read(&mut self, at: Address, value: &mut Vec<u8>) -> Result<(), AbortCode>;
    /// Checks whether a write may begin. `len` is the number of bytes, if the client sent it.
    fn check_download(&self, at: Address, len: Option<usize>) -> Result<(), AbortCode>;
    /// Returns the size of an object of a basic type.
    fn size(&self, at: Address) -> Option<usize>;
    /// Writes an object.
    fn write(&mut self, at: Address, value: &[u8]) -> Result<(), AbortCode>;
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    Idle,
    Upload { toggle: bool, sent: usize },
    Download { toggle: bool, declared: Option<usize> },
    BlockUploadStart { block_size: u8, has_crc: bool },
    BlockUpload { sender: BlockSender, has_crc: bool },
    BlockUploadEnd { has_crc: bool },
    BlockDownload { receiver: BlockReceiver, request: Payload, declared: Option<usize>, has_crc: bool },
}

/// Default time between two segments of a block while process data run.
const SEGMENT_INTERVAL: Duration = Duration::from_micros(250);
/// In a block transfer a client is given up after so many waiting times. An acknowledgement is repeated after half a
/// waiting time: a client that is only slow would misunderstand an earlier repetition.
const BLOCK_PATIENCE: u32 = 4;

type Answer = Result<Option<Payload>, AbortCode>;

/// One SDO server for expedited, segmented and block transfers, one at a time. A new initiate drops the old transfer, except while segments
/// of a block are expected: any frame can then be a segment.
#[derive(Clone, Debug)]
pub(in super::super) struct SdoServer {
    phase: Phase,
    at: Address,
    value: Vec<u8>,
    capacity: usize,
    timeout: Duration,
    block_size: u8,
    segment_interval: Duration,
    segments_only: bool,
    deadline: Time,
    repeat_at: Time,
    /// The end of the last block download, which is confirmed again, but not carried out again, when it is repeated.
    ended_by: Option<Payload>,
}

impl SdoServer {
    /// Creates a server for values of up to `capacity` bytes.
    pub(in super::super) fn new(capacity: usize, timeout: Duration) -> Self {
        SdoServer {
            phase: Phase::Idle,
            at: Address::new(0, 0),
            value: Vec::with_capacity(capacity + wire::SEGMENT),
            capacity,
            timeout,
            block_size: wire::LARGEST_BLOCK,
            segment_interval: SEGMENT_INTERVAL,
            segments_only: false,
            deadline: Time::NEVER,
            repeat_at: Time::NEVER,
            ended_by: None,
        }
    }

    pub(in super::super) fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    pub(in super::super) fn set_block(&mut self, block_size: u8, segment_interval: Duration) {
        self.block_size = block_size.clamp(1, wire::LARGEST_BLOCK);
        self.segment_interval = segment_interval;
    }

    pub(in super::super) fn set_segments_only(&mut self, is_so: bool) {
        self.segments_only = is_so;
    }

    /// Forgets a running transfer.
    pub(in super::super) fn reset(&mut self) {
        self.phase = Phase::Idle;
        (self.deadline, self.repeat_at) = (Time::NEVER, Time::NEVER);
        self.ended_by = None;
    }

    /// [`Time::NEVER`] without a transfer.
    pub(in super::super) fn next_deadline(&self) -> Time {
        let answer_by = self.deadline.min(self.repeat_at);
        match &self.phase {
            Phase::BlockUpload { sender, .. } => answer_by.min(sender.next_at()),
            _ => answer_by,
        }
    }

    /// Offers the segments of a block that are due, and returns any other frame to send. This is a repeated acknowledgement, or the abort
    /// of a transfer that the client let hang or for which there was no room.
    pub(in super::super) fn poll(
        &mut self,
        now: Time,
        is_exchanging: bool,
        offer: impl FnMut(Payload) -> bool,
    ) -> Option<Payload> {
        if now < self.next_deadline() {
            return None;
        }
        if now >= self.deadline {
            // A client that does not confirm the end of an upload has acknowledged all of it before.
            let is_all_said = matches!(self.phase, Phase::BlockUploadEnd { .. });
            self.reset();
            return (!is_all_said).then(|| wire::abort(self.at, AbortCode::TIMEOUT));
        }
        match &mut self.phase {
            Phase::BlockUpload { sender, .. } => {
                let interval = if is_exchanging { self.segment_interval } else { Duration::ZERO };
                if sender.poll(now, interval, &self.value, offer) {
                    self.deadline = now + self.timeout * BLOCK_PATIENCE;
                }
                None
            }
            Phase::BlockDownload { receiver, .. } => {
                self.repeat_at = now + self.timeout / 2;
                match receiver.on_silence() {
                    Ok(payload) => Some(payload),
                    Err(code) => {
                        self.reset();
                        Some(wire::abort(self.at, code))
                    }
                }
            }
            _ => None,
        }
    }

    /// Returns the answer to a request; none to an abort and to most segments of a block. Segments that are to be sent come from
    /// [`SdoServer::poll`].
    pub(in super::super) fn on_request(
        &mut self,
        now: Time,
        payload: &Payload,
        objects: &mut impl Objects,
    ) -> Option<Payload> {
        let answer = match self.phase {
            Phase::BlockDownload { .. } => self.take_block_frame(payload, objects),
            _ => self.answer(now, payload, objects),
        };
        if answer.is_err() {
            self.reset();
        }
        (self.deadline, self.repeat_at) = match self.phase {
            Phase::Idle => (Time::NEVER, Time::NEVER),
            Phase::Upload { .. } | Phase::Download { .. } => (now + self.timeout, Time::NEVER),
            Phase::BlockDownload { .. } => (now + self.timeout * BLOCK_PATIENCE, now + self.timeout / 2),
            Phase::BlockUploadStart { .. } | Phase::BlockUpload { .. } | Phase::BlockUploadEnd { .. } => {
                (now + self.timeout * BLOCK_PATIENCE, Time::NEVER)
            }
        };
        answer.unwrap_or_else(|code| Some(wire::abort(self.at, code)))
    }

    fn answer(&mut self, now: Time, payload: &Payload, objects: &mut impl Objects) -> Answer {
        if self.ended_by.as_ref() == Some(payload) {
            return Ok(Some(wire::block_end_confirmed()));
        }
        match wire::decode_request(payload) {
            Request::BlockUpload { at, .. } | Request::BlockDownload { at, .. } if self.segments_only => {
                self.start(at);
                Err(AbortCode::COMMAND)
            }
            Request::Abort => {
                self.reset();
                Ok(None)
            }
            Request::Upload { at } => self.start_upload(at, objects).map(Some),
            Request::Download { at, initiate } => self.start_download(at, initiate, objects).map(Some),
            Request::UploadSegment { toggle } => self.send_segment(toggle).map(Some),
            Request::DownloadSegment(segment) => {
                self.take_segment(segment.data, segment.last, segment.toggle, objects).map(Some)
            }
            Request::BlockUpload { at, block_size, switch_below, has_crc } => {
                self.start_block_upload(at, block_size, switch_below, has_crc, objects).map(Some)
            }
            Request::BlockDownload { at, size, has_crc } => {
                self.start_block_download(*payload, at, size, has_crc, objects).map(Some)
            }
            Request::BlockStart => self.begin_block(now),
            Request::BlockAcknowledge { acknowledged, block_size } => {
                self.take_acknowledgement(now, acknowledged, block_size)
            }
            Request::BlockEndConfirmed if matches!(self.phase, Phase::BlockUploadEnd { .. }) => {
                self.reset();
                Ok(None)
            }
            Request::BlockEndConfirmed => Err(AbortCode::COMMAND),
            Request::Unknown { at } => {
                self.start(at);
                Err(AbortCode::COMMAND)
            }
        }
    }

    fn start(&mut self, at: Address) {
        self.reset();
        self.at = at;
        self.value.clear();
    }

    fn start_upload(&mut self, at: Address, objects: &mut impl Objects) -> Result<Payload, AbortCode> {
        self.start(at);
        objects.read(at, &mut self.value)?;
        Ok(self.upload())
    }

    /// Sends the value without blocks.
    fn upload(&mut self) -> Payload {
        if wire::is_expedited(self.value.len()) && !self.segments_only {
            return wire::expedited_upload_response(self.at, &self.value);
        }
        self.phase = Phase::Upload { toggle: false, sent: 0 };
        wire::segmented_upload_response(self.at, self.value.len())
    }

    fn start_download(
        &mut self,
        at: Address,
        initiate: Initiate<'_>,
        objects: &mut impl Objects,
    ) -> Result<Payload, AbortCode> {
        self.start(at);
        match initiate {
            Initiate::Expedited { data, is_size_indicated } => {
                let len = if is_size_indicated { data.len() } else { objects.size(at).unwrap_or(data.len()) };
                // Without a size the object's type decides; one of more than four bytes is then too short.
                objects.write(at, data.get(..len).unwrap_or(data))?;
            }
            Initiate::Segmented { size } => {
                let declared = size.map(|size| size as usize);
                objects.check_download(at, declared)?;
                self.phase = Phase::Download { toggle: false, declared };
            }
        }
        Ok(wire::download_response(at))
    }

    fn send_segment(&mut self, toggle: bool) -> Result<Payload, AbortCode> {
        match self.phase {
            Phase::Upload { toggle: expected, .. } if toggle != expected => Err(AbortCode::TOGGLE),
            Phase::Upload { sent, .. } => {
                let (payload, len) = wire::segment(&self.value, sent, toggle);
                let sent = sent + len;
                self.phase =
                    if sent < self.value.len() { Phase::Upload { toggle: !toggle, sent } } else { Phase::Idle };
                Ok(payload)
            }
            _ => Err(AbortCode::COMMAND),
        }
    }

    fn take_segment(
        &mut self,
        data: &[u8],
        is_last: bool,
        toggle: bool,
        objects: &mut impl Objects,
    ) -> Result<Payload, AbortCode> {
        let Phase::Download { toggle: expected, declared } = self.phase else {
            return Err(AbortCode::COMMAND);
        };
        if toggle != expected {
            return Err(AbortCode::TOGGLE);
        }
        let len = self.value.len() + data.len();
        if len > declared.unwrap_or(self.capacity).min(self.capacity) {
            return Err(AbortCode::TOO_LONG);
        }
        self.value.extend_from_slice(data);
        if is_last {
            if declared.is_some_and(|size| len < size) {
                return Err(AbortCode::TOO_SHORT);
            }
            objects.write(self.at, &self.value)?;
            self.phase = Phase::Idle;
        } else {
            self.phase = Phase::Download { toggle: !toggle, declared };
        }
        Ok(wire::download_segment_response(toggle))
    }

    fn start_block_upload(
        &mut self,
        at: Address,
        block_size: u8,
        switch_below: u8,
        has_crc: bool,
        objects: &mut impl Objects,
    ) -> Result<Payload, AbortCode> {
        self.start(at);
        if !(1..=wire::LARGEST_BLOCK).contains(&block_size) {
            return Err(AbortCode::BLOCK_SIZE);
        }
        objects.read(at, &mut self.value)?;
        if self.value.len() <= usize::from(switch_below) {
            return Ok(self.upload());
        }
        self.phase = Phase::BlockUploadStart { block_size, has_crc };
        Ok(wire::block_upload_response(at, self.value.len()))
    }

    /// Begins the first block, or begins it again.
    fn begin_block(&mut self, now: Time) -> Answer {
        match &mut self.phase {
            Phase::BlockUploadStart { block_size, has_crc } => {
                let sender = BlockSender::new(now, *block_size)?;
                self.phase = Phase::BlockUpload { sender, has_crc: *has_crc };
                Ok(None)
            }
            Phase::BlockUpload { sender, .. } => {
                if sender.is_first_block() {
                    sender.restart(now)?;
                }
                Ok(None)
            }
            _ => Err(AbortCode::COMMAND),
        }
    }

    fn take_acknowledgement(&mut self, now: Time, acknowledged: u8, block_size: u8) -> Answer {
        let has_crc = match &mut self.phase {
            Phase::BlockUpload { sender, has_crc } => {
                if !sender.acknowledge(now, acknowledged, block_size, self.value.len())? {
                    return Ok(None);
                }
                *has_crc
            }
            // The client has not seen the end.
            Phase::BlockUploadEnd { has_crc } => *has_crc,
            _ => return Err(AbortCode::COMMAND),
        };
        self.phase = Phase::BlockUploadEnd { has_crc };
        Ok(Some(wire::block_end(&self.value, has_crc)))
    }

    fn start_block_download(
        &mut self,
        request: Payload,
        at: Address,
        size: Option<u32>,
        has_crc: bool,
        objects: &mut impl Objects,
    ) -> Result<Payload, AbortCode> {
        self.start(at);
        let declared = size.map(|size| size as usize);
        objects.check_download(at, declared)?;
        let answer = wire::block_download_response(at, self.block_size);
        let limit = declared.unwrap_or(self.capacity).min(self.capacity);
        let receiver = BlockReceiver::new(self.block_size, limit, answer);
        self.phase = Phase::BlockDownload { receiver, request, declared, has_crc };
        Ok(answer)
    }

    /// Takes a frame while blocks of a download are on their way: anything but an abort is a segment or the end.
    fn take_block_frame(&mut self, payload: &Payload, objects: &mut impl Objects) -> Answer {
        let Phase::BlockDownload { receiver, request, declared, has_crc } = &mut self.phase else { return Ok(None) };
        let frame = wire::decode_block(payload);
        if let BlockFrame::Abort { .. } = frame {
            self.reset();
            return Ok(None);
        }
        if receiver.is_complete() {
            let Some(end) = wire::decode_block_end(payload) else { return Ok(None) };
            receiver.finish(end, *has_crc, *declared, &mut self.value)?;
            objects.write(self.at, &self.value)?;
            self.reset();
            self.ended_by = Some(*payload);
            return Ok(Some(wire::block_end_confirmed()));
        }
        // The client has not seen the answer to its request.
        if receiver.is_untouched() && payload == request {
            return receiver.on_silence().map(Some);
        }
        match receiver.take(frame, &mut self.value)? {
            Taken::Nothing => Ok(None),
            Taken::Acknowledge(acknowledgement) => Ok(Some(acknowledgement)),
        }
    }
}
