//! SDO frames to and from meaning. Frames are eight bytes; unused ones are zero when sent and ignored when received.
//!
//! # Source
//! CiA 301, SDO protocols (expedited and segmented).

use canopen_rs::Segment;
use canopen_rs::sdo as codec;

use super::super::{AbortCode, Address};

/// Payload of every SDO frame.
pub(super) type Payload = [u8; 8];

/// Data bytes of one segment.
pub(super) const SEGMENT: usize = 7;
/// Data bytes of an expedited transfer.
pub(super) const EXPEDITED: usize = 4;

const SIZE_INDICATED: u8 = 0x01;
const IS_EXPEDITED: u8 = 0x02;
const ABORT: u8 = 0x80;

/// The data of an initiate frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Initiate<'a> {
    /// 1 to 4 bytes at once; four bytes of which the receiver knows how many count if the size is not indicated.
    Expedited { data: &'a [u8], is_size_indicated: bool },
    /// Segments follow, of this many bytes in all if indicated.
    Segmented { size: Option<u32> },
}

/// What a client asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Request<'a> {
    Download {
        at: Address,
        initiate: Initiate<'a>,
    },
    DownloadSegment(Segment<'a>),
    Upload {
        at: Address,
    },
    UploadSegment {
        toggle: bool,
    },
    Abort,
    /// Block transfer or nonsense.
    Unknown {
        at: Address,
    },
}

/// What a server answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Response<'a> {
    Upload {
        at: Address,
        initiate: Initiate<'a>,
    },
    UploadSegment(Segment<'a>),
    Download {
        at: Address,
    },
    DownloadSegment {
        toggle: bool,
    },
    Abort {
        at: Address,
        code: AbortCode,
    },
    /// Block transfer or nonsense.
    Unknown,
}

fn address(payload: &Payload) -> Address {
    let [_, low, high, sub, ..] = *payload;
    Address::new(u16::from_le_bytes([low, high]), sub)
}

fn word(payload: &Payload) -> u32 {
    let [_, _, _, _, a, b, c, d] = *payload;
    u32::from_le_bytes([a, b, c, d])
}

fn initiate(payload: &Payload) -> Initiate<'_> {
    let [command, _, _, _, data @ ..] = payload;
    let is_size_indicated = command & SIZE_INDICATED != 0;
    if command & IS_EXPEDITED != 0 {
        let unused = if is_size_indicated { usize::from(command >> 2 & 3) } else { 0 };
        Initiate::Expedited { data: data.get(..EXPEDITED - unused).unwrap_or_default(), is_size_indicated }
    } else {
        Initiate::Segmented { size: is_size_indicated.then(|| word(payload)) }
    }
}

/// Reads a request.
pub(super) fn decode_request(payload: &Payload) -> Request<'_> {
    let at = address(payload);
    match payload[0] >> 5 {
        0 => codec::decode_data_segment(payload).map_or(Request::Unknown { at }, Request::DownloadSegment),
        1 => Request::Download { at, initiate: initiate(payload) },
        2 => Request::Upload { at },
        3 => Request::UploadSegment { toggle: payload[0] & 0x10 != 0 },
        4 => Request::Abort,
        _ => Request::Unknown { at },
    }
}

/// Reads a response.
pub(super) fn decode_response(payload: &Payload) -> Response<'_> {
    let at = address(payload);
    match payload[0] >> 5 {
        0 => codec::decode_data_segment(payload).map_or(Response::Unknown, Response::UploadSegment),
        1 => Response::DownloadSegment { toggle: payload[0] & 0x10 != 0 },
        2 => Response::Upload { at, initiate: initiate(payload) },
        3 => Response::Download { at },
        4 => Response::Abort { at, code: AbortCode(word(payload)) },
        _ => Response::Unknown,
    }
}

/// An initiate frame with its data (1 to 4 bytes), 2Xh from a client or 4Xh from a server.
fn expedited(specifier: u8, at: Address, data: &[u8]) -> Payload {
    let len = data.len().clamp(1, EXPEDITED);
    let unused = (EXPEDITED - len) as u8;
    let [low, high] = at.index.to_le_bytes();
    let mut payload = [specifier | unused << 2 | IS_EXPEDITED | SIZE_INDICATED, low, high, at.subindex, 0, 0, 0, 0];
    for (to, from) in payload.iter_mut().skip(4).zip(data) {
        *to = *from;
    }
    payload
}

/// Whether so many bytes go into the initiate frame; none do not, since its length field cannot say so.
pub(super) const fn is_expedited(len: usize) -> bool {
    len >= 1 && len <= EXPEDITED
}

/// The first frame of a write.
pub(super) fn download_request(at: Address, data: &[u8]) -> Payload {
    if is_expedited(data.len()) {
        expedited(0x20, at, data)
    } else {
        codec::encode_download_initiate_segmented(at, data.len() as u32)
    }
}

/// The first answer to a read.
pub(super) fn upload_response(at: Address, data: &[u8]) -> Payload {
    if is_expedited(data.len()) {
        expedited(0x40, at, data)
    } else {
        codec::encode_upload_initiate_segmented_response(at, data.len() as u32)
    }
}

/// The segment of `data` from byte `sent` on, and how many bytes it carries; the last one says so.
pub(super) fn segment(data: &[u8], sent: usize, toggle: bool) -> (Payload, usize) {
    let rest = data.get(sent..).unwrap_or_default();
    let part = rest.get(..SEGMENT).unwrap_or(rest);
    let is_last = part.len() == rest.len();
    (codec::encode_data_segment(part, toggle, is_last).unwrap_or_default(), part.len())
}

/// An abort frame.
pub(super) fn abort(at: Address, code: AbortCode) -> Payload {
    let [low, high] = at.index.to_le_bytes();
    let [a, b, c, d] = code.0.to_le_bytes();
    [ABORT, low, high, at.subindex, a, b, c, d]
}

pub(super) use codec::encode_download_response as download_response;
pub(super) use codec::encode_download_segment_response as download_segment_response;
pub(super) use codec::encode_upload_request as upload_request;
pub(super) use codec::encode_upload_segment_request as upload_segment_request;
