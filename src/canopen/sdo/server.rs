//! The device's end of an SDO channel.

use std::time::Duration;

use super::super::{AbortCode, Address, Time};
use super::wire::{self, Initiate, Payload, Request};

/// What the server serves: a dictionary with the rules of its device.
pub(in super::super) trait Objects {
    /// Puts the value of an object into `value`, which is empty.
    fn read(&mut self, at: Address, value: &mut Vec<u8>) -> Result<(), AbortCode>;
    /// Whether a write may begin; with the number of bytes if the client told it.
    fn check_download(&self, at: Address, len: Option<usize>) -> Result<(), AbortCode>;
    /// The size of an object of a basic type.
    fn size(&self, at: Address) -> Option<usize>;
    /// Writes an object.
    fn write(&mut self, at: Address, value: &[u8]) -> Result<(), AbortCode>;
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    Idle,
    Upload { toggle: bool, sent: usize },
    Download { toggle: bool, declared: Option<usize> },
}

/// One SDO server: expedited and segmented transfers, one at a time; a new initiate drops the old transfer.
#[derive(Clone, Debug)]
pub(in super::super) struct SdoServer {
    phase: Phase,
    at: Address,
    value: Vec<u8>,
    capacity: usize,
    timeout: Duration,
    deadline: Time,
}

impl SdoServer {
    /// A server for values of up to `capacity` bytes.
    pub(in super::super) fn new(capacity: usize, timeout: Duration) -> Self {
        SdoServer {
            phase: Phase::Idle,
            at: Address::new(0, 0),
            value: Vec::with_capacity(capacity),
            capacity,
            timeout,
            deadline: Time::NEVER,
        }
    }

    pub(in super::super) fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// Forgets a running transfer.
    pub(in super::super) fn reset(&mut self) {
        self.phase = Phase::Idle;
        self.deadline = Time::NEVER;
    }

    /// [`Time::NEVER`] without a transfer.
    pub(in super::super) fn next_deadline(&self) -> Time {
        self.deadline
    }

    /// The abort frame if the client let a transfer hang.
    pub(in super::super) fn poll(&mut self, now: Time) -> Option<Payload> {
        if now < self.deadline {
            return None;
        }
        self.reset();
        Some(wire::abort(self.at, AbortCode::TIMEOUT))
    }

    /// The answer to a request; none to an abort.
    pub(in super::super) fn on_request(
        &mut self,
        now: Time,
        payload: &Payload,
        objects: &mut impl Objects,
    ) -> Option<Payload> {
        let answer = match wire::decode_request(payload) {
            Request::Abort => {
                self.reset();
                return None;
            }
            Request::Upload { at } => self.start_upload(at, objects),
            Request::Download { at, initiate } => self.start_download(at, initiate, objects),
            Request::UploadSegment { toggle } => self.send_segment(toggle),
            Request::DownloadSegment(segment) => self.take_segment(segment.data, segment.last, segment.toggle, objects),
            Request::Unknown { at } => {
                self.start(at);
                Err(AbortCode::COMMAND)
            }
        };
        if answer.is_err() {
            self.reset();
        }
        self.deadline = if matches!(self.phase, Phase::Idle) { Time::NEVER } else { now + self.timeout };
        Some(answer.unwrap_or_else(|code| wire::abort(self.at, code)))
    }

    fn start(&mut self, at: Address) {
        self.reset();
        self.at = at;
        self.value.clear();
    }

    fn start_upload(&mut self, at: Address, objects: &mut impl Objects) -> Result<Payload, AbortCode> {
        self.start(at);
        objects.read(at, &mut self.value)?;
        if !wire::is_expedited(self.value.len()) {
            self.phase = Phase::Upload { toggle: false, sent: 0 };
        }
        Ok(wire::upload_response(at, &self.value))
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
}
