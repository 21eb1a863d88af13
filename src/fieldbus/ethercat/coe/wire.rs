//! The bytes of CoE messages.

use super::super::{array, u16_at, u32_at};
use crate::objects::{AbortCode, Address};

/// Bytes of the CoE header.
pub(super) const HEADER: usize = 2;
/// Bytes before the data of an initiate: CoE header, command, index, sub-index, size.
pub(super) const INITIATE: usize = HEADER + 8;
/// Bytes before the data of a segment: CoE header and command.
pub(super) const SEGMENT: usize = HEADER + 1;
/// Data bytes that a segment has at least.
pub(super) const LEAST_SEGMENT: usize = 7;

/// Kind of a CoE message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Service {
    /// Emergency.
    Emergency = 1,
    /// SDO request; an abort too, of either side.
    SdoRequest = 2,
    /// SDO response.
    SdoResponse = 3,
    /// SDO information.
    Information = 8,
}

impl Service {
    /// Returns the service of a message; `None` for one that is too short or that is not served.
    pub fn of(message: &[u8]) -> Option<Self> {
        let header = message.first_chunk::<HEADER>()?;
        Some(match header[1] >> 4 {
            1 => Service::Emergency,
            2 => Service::SdoRequest,
            3 => Service::SdoResponse,
            8 => Service::Information,
            _ => return None,
        })
    }

    pub(super) const fn header(self) -> [u8; HEADER] {
        [0, (self as u8) << 4]
    }
}

/// Command of an abort.
pub(super) const ABORT: u8 = 0x80;
const COMPLETE: u8 = 0x10;
const TOGGLE: u8 = 0x10;

/// An SDO request, as a server reads it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Request<'a> {
    Download { at: Address, is_complete: bool, size: u32, data: &'a [u8] },
    DownloadSegment { toggle: bool, is_last: bool, data: &'a [u8] },
    Upload { at: Address, is_complete: bool },
    UploadSegment { toggle: bool },
    Abort,
    Unknown { at: Address },
}

/// Returns the index and sub-index of an SDO message.
pub(super) fn address(message: &[u8]) -> Address {
    let [sub] = array(message, HEADER + 3);
    Address::new(u16_at(message, HEADER + 1), sub)
}

/// Returns the bytes in a segment. A message of ten bytes states how many of its seven data bytes are unused.
fn segment_data(message: &[u8], command: u8) -> &[u8] {
    let data = message.get(SEGMENT..).unwrap_or_default();
    let unused = if data.len() == LEAST_SEGMENT { usize::from(command >> 1 & 7) } else { 0 };
    data.get(..data.len() - unused).unwrap_or_default()
}

/// Reads a request; `None` if it is shorter than any.
pub(super) fn request(message: &[u8]) -> Option<Request<'_>> {
    let &command = message.get(HEADER)?;
    if message.len() < INITIATE {
        return None;
    }
    let at = address(message);
    let is_complete = command & COMPLETE != 0;
    Some(match command >> 5 {
        0 => Request::DownloadSegment {
            toggle: command & TOGGLE != 0,
            is_last: command & 1 != 0,
            data: segment_data(message, command),
        },
        1 if command & 0x02 != 0 => {
            let unused = if command & 0x01 != 0 { usize::from(command >> 2 & 3) } else { 0 };
            let data = message.get(HEADER + 4..INITIATE - unused)?;
            Request::Download { at, is_complete, size: data.len() as u32, data }
        }
        1 => Request::Download {
            at,
            is_complete,
            size: u32_at(message, HEADER + 4),
            data: message.get(INITIATE..).unwrap_or_default(),
        },
        2 => Request::Upload { at, is_complete },
        3 => Request::UploadSegment { toggle: command & TOGGLE != 0 },
        4 => Request::Abort,
        _ => Request::Unknown { at },
    })
}

/// An SDO response, as a client reads it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Response<'a> {
    Upload { at: Address, size: u32, data: &'a [u8] },
    UploadSegment { toggle: bool, is_last: bool, data: &'a [u8] },
    Download { at: Address },
    DownloadSegment { toggle: bool },
    Abort { at: Address, code: AbortCode },
    Unknown,
}

/// Reads a response; `None` if it is shorter than any.
pub(super) fn response(message: &[u8]) -> Option<Response<'_>> {
    let &command = message.get(HEADER)?;
    if message.len() < SEGMENT + LEAST_SEGMENT {
        // Some devices answer a segment of a download with a command alone.
        let is_segment = command >> 5 == 1;
        return is_segment.then_some(Response::DownloadSegment { toggle: command & TOGGLE != 0 });
    }
    let at = address(message);
    Some(match command >> 5 {
        0 => Response::UploadSegment {
            toggle: command & TOGGLE != 0,
            is_last: command & 1 != 0,
            data: segment_data(message, command),
        },
        1 => Response::DownloadSegment { toggle: command & TOGGLE != 0 },
        2 if command & 0x02 != 0 => {
            let unused = if command & 0x01 != 0 { usize::from(command >> 2 & 3) } else { 0 };
            let data = message.get(HEADER + 4..INITIATE - unused)?;
            Response::Upload { at, size: data.len() as u32, data }
        }
        2 => Response::Upload {
            at,
            size: u32_at(message, HEADER + 4),
            data: message.get(INITIATE..).unwrap_or_default(),
        },
        3 => Response::Download { at },
        4 => Response::Abort { at, code: AbortCode(u32_at(message, HEADER + 4)) },
        _ => Response::Unknown,
    })
}

/// A message that is written from its front; what does not fit is not written, and the message is then empty.
#[derive(Debug)]
pub(super) struct Writer<'a> {
    buffer: &'a mut [u8],
    len: usize,
}

impl<'a> Writer<'a> {
    pub(super) fn new(buffer: &'a mut [u8], service: Service) -> Self {
        Writer { buffer, len: 0 }.put(&service.header())
    }

    /// Writes the header and command of an SDO.
    pub(super) fn sdo(buffer: &'a mut [u8], service: Service, command: u8, at: Address) -> Self {
        let [low, high] = at.index.to_le_bytes();
        Writer::new(buffer, service).put(&[command, low, high, at.sub])
    }

    pub(super) fn put(mut self, bytes: &[u8]) -> Self {
        let end = self.len.saturating_add(bytes.len());
        if let Some(to) = self.buffer.get_mut(self.len..end) {
            to.copy_from_slice(bytes);
            self.len = end;
        } else {
            // An empty message is none.
            (self.buffer, self.len) = (&mut [], 0);
        }
        self
    }

    pub(super) fn room(&self) -> usize {
        self.buffer.len() - self.len
    }

    pub(super) fn finish(self) -> usize {
        self.len
    }
}

/// Writes an abort; returns its number of bytes.
pub(super) fn abort(buffer: &mut [u8], at: Address, code: AbortCode) -> usize {
    Writer::sdo(buffer, Service::SdoRequest, ABORT, at).put(&code.0.to_le_bytes()).finish()
}

/// Writes the start of a download or of the answer to an upload: `command` is 20h or 40h. Returns the bytes of the message and those of the
/// value in it.
pub(super) fn initiate(
    buffer: &mut [u8],
    service: Service,
    command: u8,
    at: Address,
    is_complete: bool,
    value: &[u8],
) -> (usize, usize) {
    let command = command | if is_complete { COMPLETE } else { 0 };
    if let len @ 1..=4 = value.len() {
        let unused = 4 - len;
        let written = Writer::sdo(buffer, service, command | 0x03 | (unused as u8) << 2, at).put(value);
        return (written.put(&[0; 4][..unused]).finish(), len);
    }
    let written = Writer::sdo(buffer, service, command | 0x01, at).put(&(value.len() as u32).to_le_bytes());
    let first = value.get(..written.room()).unwrap_or(value);
    (written.put(first).finish(), first.len())
}

/// Writes the segment of `value` from `sent` on; returns the bytes of the message, those of the value in it, and whether it is the last.
pub(super) fn segment(
    buffer: &mut [u8],
    service: Service,
    value: &[u8],
    sent: usize,
    toggle: bool,
) -> (usize, usize, bool) {
    let rest = value.get(sent..).unwrap_or_default();
    let part = rest.get(..buffer.len().saturating_sub(SEGMENT)).unwrap_or(rest);
    let (is_last, unused) = (part.len() == rest.len(), LEAST_SEGMENT.saturating_sub(part.len()));
    let command = u8::from(is_last) | (unused as u8) << 1 | if toggle { TOGGLE } else { 0 };
    let written = Writer::new(buffer, service).put(&[command]).put(part).put(&[0; LEAST_SEGMENT][..unused]);
    (written.finish(), part.len(), is_last)
}

/// Writes a request for an upload; returns its number of bytes.
pub(super) fn upload(buffer: &mut [u8], at: Address, is_complete: bool) -> usize {
    let command = 0x40 | if is_complete { COMPLETE } else { 0 };
    Writer::sdo(buffer, Service::SdoRequest, command, at).put(&[0; 4]).finish()
}

/// Writes a command with the toggle bit and seven empty bytes: 60h asks for a segment, 20h takes one.
pub(super) fn toggled(buffer: &mut [u8], service: Service, command: u8, toggle: bool) -> usize {
    let command = command | if toggle { TOGGLE } else { 0 };
    Writer::new(buffer, service).put(&[command]).put(&[0; LEAST_SEGMENT]).finish()
}

/// Writes the answer to the start of a download; returns its number of bytes.
pub(super) fn download_response(buffer: &mut [u8], at: Address, is_complete: bool) -> usize {
    let command = 0x60 | if is_complete { COMPLETE } else { 0 };
    Writer::sdo(buffer, Service::SdoResponse, command, at).put(&[0; 4]).finish()
}
