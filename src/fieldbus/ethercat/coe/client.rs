//! The master's end of CoE: one request at a time.

use super::super::u16_at;
use super::MOST_BYTES;
use super::emergency::CoeEmergency;
use super::information::{self, EntryDescription, ListKind, ObjectDescription, operation};
use super::wire::{self, Response, Service};
use crate::ethercat::EthercatError;
use crate::objects::{AbortCode, Address, ObjectError, write_patience};
use crate::time::Time;
use std::time::Duration;

/// Request to a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CoeRequest<'a> {
    /// The value of an object, or with `complete` of all its sub-indices from `at.sub` (0 or 1) on.
    Read {
        /// The object.
        at: Address,
        /// All sub-indices at once.
        complete: bool,
    },
    /// Write of an object's value.
    Write {
        /// The object.
        at: Address,
        /// All sub-indices at once.
        complete: bool,
        /// Little-endian bytes.
        data: &'a [u8],
    },
    /// A list of objects.
    List(ListKind),
    /// The description of an object.
    Object(u16),
    /// The description of an entry.
    Entry(Address),
}

/// Result of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CoeAnswer {
    /// There was no request.
    Idle,
    /// It has not ended.
    Pending,
    /// The bytes of a value.
    Value(Vec<u8>),
    /// The object took the value.
    Written,
    /// The words of a list.
    List(Vec<u16>),
    /// The description of an object.
    Object(ObjectDescription),
    /// The description of an entry.
    Entry(EntryDescription),
    /// The reason why there is no answer.
    Failed(ObjectError),
}

/// Kind of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CoeEvent {
    /// An emergency; the request goes on.
    Emergency(CoeEmergency),
    /// Part of the answer, or its end.
    Answer,
    /// A message that the client did not wait for: late, of another request, or not understood. The request goes on.
    Foreign,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Idle,
    /// The start of the request is to be sent, or its answer awaited.
    Start {
        is_sent: bool,
    },
    /// A segment is asked for.
    Upload {
        toggle: bool,
        declared: usize,
        is_sent: bool,
    },
    /// A segment is sent; from `sent` on of the value.
    Download {
        toggle: bool,
        is_begun: bool,
        sent: usize,
        next: usize,
        is_sent: bool,
    },
    /// Fragments are awaited.
    Fragments,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Read { complete: bool },
    Write { complete: bool },
    Information { operation: u8, wanted: u32 },
}

/// A client of one device. It returns the next message to write ([`CoeClient::message`]), takes each message that was read
/// ([`CoeClient::on_message`]) and has the answer in the end.
///
/// The owner repeats a message that is lost: the mailbox can do that. A request without an answer within the time-out fails.
#[derive(Clone, Debug)]
pub struct CoeClient {
    phase: Phase,
    kind: Kind,
    at: Address,
    value: Vec<u8>,
    /// Most bytes that a value may have.
    most: usize,
    answer: CoeAnswer,
    timeout: Duration,
    /// Longest time to each message of the present request.
    patience: Duration,
    deadline: Time,
}

impl CoeClient {
    /// Creates a client that waits so long for each message, and for the answer to a write as long as [`write_patience`] says.
    pub fn new(timeout: Duration) -> Self {
        CoeClient {
            phase: Phase::Idle,
            kind: Kind::Read { complete: false },
            at: Address::new(0, 0),
            value: Vec::new(),
            most: MOST_BYTES,
            answer: CoeAnswer::Idle,
            timeout,
            patience: timeout,
            deadline: Time::NEVER,
        }
    }

    /// Creates a client whose values have so many bytes at most, for which it has room from the beginning: reading and writing objects does
    /// not allocate then. A longer value of the device is refused as out of memory.
    pub fn within(most: usize, timeout: Duration) -> Self {
        CoeClient { value: Vec::with_capacity(most), most, ..CoeClient::new(timeout) }
    }

    /// Asks something.
    ///
    /// # Errors
    /// [`EthercatError::Busy`] while a request runs; [`EthercatError::Full`] for a value of more than [`MOST_BYTES`], or than the client has
    /// room for.
    pub fn start(&mut self, now: Time, request: CoeRequest<'_>) -> Result<(), EthercatError> {
        if self.is_busy() {
            return Err(EthercatError::Busy);
        }
        self.forget();
        self.patience = self.timeout;
        (self.kind, self.at) = match request {
            CoeRequest::Read { at, complete } => (Kind::Read { complete }, at),
            CoeRequest::Write { at, complete, data } => {
                if data.len() > self.most {
                    return Err(EthercatError::Full { what: "a value", len: data.len(), room: self.most });
                }
                self.value.extend_from_slice(data);
                self.patience = write_patience(at, self.timeout);
                (Kind::Write { complete }, at)
            }
            CoeRequest::List(kind) => {
                (Kind::Information { operation: operation::LIST, wanted: kind as u32 }, Address::new(0, 0))
            }
            CoeRequest::Object(index) => {
                let at = Address::new(index, 0);
                (Kind::Information { operation: operation::OBJECT, wanted: u32::from(index) }, at)
            }
            CoeRequest::Entry(at) => {
                let wanted = u32::from(at.index) | u32::from(at.sub) << 16;
                (Kind::Information { operation: operation::ENTRY, wanted }, at)
            }
        };
        self.phase = Phase::Start { is_sent: false };
        self.answer = CoeAnswer::Pending;
        self.deadline = now + self.patience;
        Ok(())
    }

    /// Whether a request runs.
    pub fn is_busy(&self) -> bool {
        self.phase != Phase::Idle
    }

    /// Returns the result of the last request.
    pub fn answer(&self) -> &CoeAnswer {
        &self.answer
    }

    /// Forgets what was asked last, if it has ended.
    pub fn forget(&mut self) {
        if self.is_busy() {
            return;
        }
        // Its room is used again.
        if let CoeAnswer::Value(value) = std::mem::replace(&mut self.answer, CoeAnswer::Idle) {
            self.value = value;
        }
        self.value.clear();
    }

    /// Returns the latest time for the next call of [`CoeClient::poll`].
    pub fn next_deadline(&self) -> Time {
        self.deadline
    }

    /// Ends the request without an answer, for an owner who knows that none comes.
    pub fn give_up(&mut self, error: ObjectError) {
        if self.is_busy() {
            self.end(CoeAnswer::Failed(error));
        }
    }

    /// Gives up a device that does not answer in time.
    pub fn poll(&mut self, now: Time) {
        if self.is_busy() && now >= self.deadline {
            self.end(CoeAnswer::Failed(ObjectError::NoAnswer));
        }
    }

    /// Writes the message that is to be sent next into `message`, which is as long as the device's mailbox allows; gives its bytes, 0
    /// for none. It counts as sent.
    pub fn message(&mut self, message: &mut [u8]) -> usize {
        match &mut self.phase {
            Phase::Start { is_sent } if !*is_sent => {
                *is_sent = true;
                match self.kind {
                    Kind::Read { complete } => wire::upload(message, self.at, complete),
                    Kind::Write { complete } => {
                        let (len, sent) =
                            wire::initiate(message, Service::SdoRequest, 0x20, self.at, complete, &self.value);
                        if sent < self.value.len() {
                            self.phase =
                                Phase::Download { toggle: true, is_begun: false, sent: 0, next: sent, is_sent: true };
                        }
                        len
                    }
                    Kind::Information { operation, wanted } => {
                        let data = wanted.to_le_bytes();
                        let len = if operation == operation::ENTRY { 4 } else { 2 };
                        information::request(message, operation, data.get(..len).unwrap_or_default())
                    }
                }
            }
            Phase::Upload { toggle, is_sent, .. } if !*is_sent => {
                *is_sent = true;
                wire::toggled(message, Service::SdoRequest, 0x60, *toggle)
            }
            Phase::Download { toggle, sent, next, is_sent, .. } if !*is_sent => {
                *is_sent = true;
                let (len, taken, _) = wire::segment(message, Service::SdoRequest, &self.value, *sent, *toggle);
                *next = *sent + taken;
                len
            }
            _ => 0,
        }
    }

    /// Takes a message of the device.
    pub fn on_message(&mut self, now: Time, message: &[u8]) -> CoeEvent {
        if let Some(emergency) = CoeEmergency::decode(message) {
            return CoeEvent::Emergency(emergency);
        }
        let is_heard = match (Service::of(message), self.kind) {
            _ if !self.is_busy() => false,
            (Some(service @ (Service::SdoRequest | Service::SdoResponse)), Kind::Read { .. } | Kind::Write { .. }) => {
                // An abort is a request by its service. Any other request is this client's own, sent back.
                let response = wire::response(message);
                let response = response
                    .filter(|response| service == Service::SdoResponse || matches!(response, Response::Abort { .. }));
                response.is_some_and(|response| self.take(response))
            }
            // Some devices refuse what they have no information about as they would an object.
            (Some(Service::SdoRequest | Service::SdoResponse), Kind::Information { .. }) => {
                match wire::response(message) {
                    Some(Response::Abort { code, .. }) => self.fail(code),
                    _ => false,
                }
            }
            (Some(Service::Information), Kind::Information { operation, wanted }) => {
                information::decode(message).is_some_and(|part| self.take_information(part, operation, wanted))
            }
            _ => false,
        };
        if !is_heard {
            return CoeEvent::Foreign;
        }
        if self.is_busy() {
            self.deadline = now + self.patience;
        }
        CoeEvent::Answer
    }

    fn end(&mut self, answer: CoeAnswer) -> bool {
        self.phase = Phase::Idle;
        self.deadline = Time::NEVER;
        self.answer = answer;
        true
    }

    fn fail(&mut self, code: AbortCode) -> bool {
        self.end(CoeAnswer::Failed(ObjectError::Aborted(code)))
    }

    /// Whether a response was waited for.
    fn take(&mut self, response: Response<'_>) -> bool {
        match (response, self.phase) {
            (Response::Abort { at, code }, _) if at == self.at => self.fail(code),
            (Response::Upload { at, size, data }, Phase::Start { is_sent: true })
                if at == self.at && matches!(self.kind, Kind::Read { .. }) =>
            {
                let declared = size as usize;
                if declared > self.most {
                    return self.fail(AbortCode::OUT_OF_MEMORY);
                }
                self.value.extend_from_slice(data.get(..declared).unwrap_or(data));
                if self.value.len() == declared {
                    let value = std::mem::take(&mut self.value);
                    return self.end(CoeAnswer::Value(value));
                }
                self.phase = Phase::Upload { toggle: false, declared, is_sent: false };
                true
            }
            (
                Response::UploadSegment { toggle, is_last, data },
                Phase::Upload { toggle: asked, declared, is_sent: true },
            ) => {
                if toggle != asked {
                    return self.fail(AbortCode::TOGGLE);
                }
                if self.value.len() + data.len() > declared {
                    return self.fail(AbortCode::TOO_LONG);
                }
                self.value.extend_from_slice(data);
                if is_last && self.value.len() < declared {
                    return self.fail(AbortCode::TOO_SHORT);
                }
                if is_last {
                    let value = std::mem::take(&mut self.value);
                    return self.end(CoeAnswer::Value(value));
                }
                // Segments without data would go on for ever.
                if data.is_empty() {
                    return self.fail(AbortCode::GENERAL);
                }
                self.phase = Phase::Upload { toggle: !toggle, declared, is_sent: false };
                true
            }
            (Response::Download { at }, Phase::Start { is_sent: true })
                if at == self.at && matches!(self.kind, Kind::Write { .. }) =>
            {
                self.end(CoeAnswer::Written)
            }
            (Response::Download { at }, Phase::Download { is_begun: false, next, is_sent: true, .. })
                if at == self.at =>
            {
                self.phase = Phase::Download { toggle: false, is_begun: true, sent: next, next, is_sent: false };
                true
            }
            (
                Response::DownloadSegment { toggle },
                Phase::Download { toggle: sent_with, is_begun: true, next, is_sent: true, .. },
            ) => {
                if toggle != sent_with {
                    return self.fail(AbortCode::TOGGLE);
                }
                if next >= self.value.len() {
                    return self.end(CoeAnswer::Written);
                }
                self.phase = Phase::Download { toggle: !toggle, is_begun: true, sent: next, next, is_sent: false };
                true
            }
            _ => false,
        }
    }

    /// Whether a message of information was waited for.
    fn take_information(&mut self, part: information::Information<'_>, asked: u8, wanted: u32) -> bool {
        if !matches!(self.phase, Phase::Start { is_sent: true } | Phase::Fragments) {
            return false;
        }
        if part.operation == operation::ERROR {
            return self.fail(information::error_code(part.data));
        }
        if part.operation != asked + 1 {
            return false;
        }
        // The first part says what it answers.
        let is_first = self.phase != Phase::Fragments;
        if is_first && u32::from(u16_at(part.data, 0)) != wanted & 0xffff {
            return false;
        }
        if self.value.len() + part.data.len() > self.most {
            return self.fail(AbortCode::OUT_OF_MEMORY);
        }
        self.value.extend_from_slice(part.data);
        self.phase = Phase::Fragments;
        if part.fragments_left > 0 {
            // As would these.
            return !part.data.is_empty() || self.fail(AbortCode::GENERAL);
        }
        let value = std::mem::take(&mut self.value);
        let answer = match asked {
            operation::LIST => {
                let (words, _) = value.get(2..).unwrap_or_default().as_chunks::<2>();
                Some(CoeAnswer::List(words.iter().map(|word| u16::from_le_bytes(*word)).collect()))
            }
            operation::OBJECT => ObjectDescription::decode(&value).map(CoeAnswer::Object),
            _ => EntryDescription::decode(&value).filter(|entry| entry.at == self.at).map(CoeAnswer::Entry),
        };
        match answer {
            Some(answer) => self.end(answer),
            None => self.fail(AbortCode::GENERAL),
        }
    }
}
