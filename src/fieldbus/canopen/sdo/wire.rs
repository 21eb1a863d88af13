//! SDO frames to and from meaning. Frames are eight bytes; unused ones are zero when sent and ignored when received.
//!
//! # Source
//! CiA 301, SDO protocols (expedited, segmented and block).

use canopen_rs::Segment;
use canopen_rs::sdo as codec;
use canopen_rs::sdo::block as block_codec;

use crate::objects::{AbortCode, Address};

/// Payload of every SDO frame.
pub(super) type Payload = [u8; 8];

/// Data bytes of one segment.
pub(super) const SEGMENT: usize = 7;
/// Data bytes of an expedited transfer.
pub(super) const EXPEDITED: usize = 4;
/// Most segments in a block; sequence numbers have 7 bits and start at 1.
pub(super) const LARGEST_BLOCK: u8 = block_codec::MAX_BLKSIZE;

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

/// Request of a client.
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
    BlockDownload {
        at: Address,
        size: Option<u32>,
        has_crc: bool,
    },
    BlockUpload {
        at: Address,
        block_size: u8,
        /// Values of up to so many bytes may be sent without blocks; 0 for none.
        switch_below: u8,
        has_crc: bool,
    },
    /// Begins the first block of an upload.
    BlockStart,
    BlockAcknowledge {
        acknowledged: u8,
        block_size: u8,
    },
    /// The client has all blocks of an upload.
    BlockEndConfirmed,
    Abort,
    /// Nonsense, or the end of a block download without the download.
    Unknown {
        at: Address,
    },
}

/// Answer of a server.
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
    BlockDownload {
        at: Address,
        block_size: u8,
        has_crc: bool,
    },
    BlockAcknowledge {
        acknowledged: u8,
        block_size: u8,
    },
    /// The server has all blocks of a download and has written the object.
    BlockEndConfirmed,
    BlockUpload {
        at: Address,
        size: Option<u32>,
        has_crc: bool,
    },
    Abort {
        at: Address,
        code: AbortCode,
    },
    Unknown,
}

/// A frame while blocks are on their way to its receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BlockFrame<'a> {
    /// Seven bytes. The end of the transfer states how many of them count in the last segment.
    Segment { sequence: u8, is_last: bool, data: &'a [u8; SEGMENT] },
    /// Sequence number 0 does not exist: the other side has aborted.
    Abort { at: Address, code: AbortCode },
}

fn address(payload: &Payload) -> Address {
    let [_, low, high, sub, ..] = *payload;
    Address::new(u16::from_le_bytes([low, high]), sub)
}

fn word(payload: &Payload) -> u32 {
    let [_, _, _, _, a, b, c, d] = *payload;
    u32::from_le_bytes([a, b, c, d])
}

/// Returns the size in an initiate frame of a block transfer, if it is indicated.
fn block_total(payload: &Payload) -> Option<u32> {
    (payload[0] & 0x02 != 0).then(|| word(payload))
}

fn has_crc(payload: &Payload) -> bool {
    payload[0] & 0x04 != 0
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
        5 => match payload[0] & 0x03 {
            0 => {
                Request::BlockUpload { at, block_size: payload[4], switch_below: payload[5], has_crc: has_crc(payload) }
            }
            1 => Request::BlockEndConfirmed,
            2 => Request::BlockAcknowledge { acknowledged: payload[1], block_size: payload[2] },
            _ => Request::BlockStart,
        },
        6 if payload[0] & 0x01 == 0 => {
            Request::BlockDownload { at, size: block_total(payload), has_crc: has_crc(payload) }
        }
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
        5 => match payload[0] & 0x03 {
            0 => Response::BlockDownload { at, block_size: payload[4], has_crc: has_crc(payload) },
            1 => Response::BlockEndConfirmed,
            2 => Response::BlockAcknowledge { acknowledged: payload[1], block_size: payload[2] },
            _ => Response::Unknown,
        },
        6 if payload[0] & 0x01 == 0 => {
            Response::BlockUpload { at, size: block_total(payload), has_crc: has_crc(payload) }
        }
        _ => Response::Unknown,
    }
}

/// Reads a frame while blocks are being received.
pub(super) fn decode_block(payload: &Payload) -> BlockFrame<'_> {
    if payload[0] == ABORT {
        return BlockFrame::Abort { at: address(payload), code: AbortCode(word(payload)) };
    }
    let [head, data @ ..] = payload;
    BlockFrame::Segment { sequence: head & 0x7f, is_last: head & 0x80 != 0, data }
}

/// Reads the end of a block transfer: how many bytes of its last segment do not count, and the checksum.
pub(super) fn decode_block_end(payload: &Payload) -> Option<(u8, u16)> {
    block_codec::decode_end(payload).ok()
}

/// Returns the number of segments in a block transfer; no bytes need one segment too.
pub(super) const fn segments(len: usize) -> usize {
    if len == 0 { 1 } else { len.div_ceil(SEGMENT) }
}

/// Returns segment `place` (from 0) of `data` with its sequence number in the block; the last one says so.
pub(super) fn block_segment(data: &[u8], place: usize, sequence: u8) -> Payload {
    let last = if place + 1 >= segments(data.len()) { 0x80 } else { 0 };
    let mut payload = [0; 8];
    let rest = data.get(place.saturating_mul(SEGMENT)..).unwrap_or_default();
    for (to, from) in payload.iter_mut().skip(1).zip(rest) {
        *to = *from;
    }
    payload[0] = (sequence & 0x7f) | last;
    payload
}

/// Returns the end of a block transfer of `data`.
pub(super) fn block_end(data: &[u8], has_crc: bool) -> Payload {
    let unused = segments(data.len()) * SEGMENT - data.len();
    block_codec::encode_end(unused as u8, if has_crc { crc(data) } else { 0 })
}

/// Returns a request to read in blocks of `block_size` segments; short values may come without.
pub(super) fn block_upload_request(at: Address, block_size: u8, switch_below: u8) -> Payload {
    let mut payload = block_codec::encode_upload_initiate(at.into(), block_size, true);
    payload[5] = switch_below;
    payload
}

/// Returns a request to write in blocks.
pub(super) fn block_download_request(at: Address, len: usize) -> Payload {
    block_codec::encode_download_initiate(at.into(), u32::try_from(len).ok(), true)
}

/// Returns the first answer to a read in blocks.
pub(super) fn block_upload_response(at: Address, len: usize) -> Payload {
    block_codec::encode_upload_initiate_response(at.into(), u32::try_from(len).ok(), true)
}

/// Returns the first answer to a write in blocks.
pub(super) fn block_download_response(at: Address, block_size: u8) -> Payload {
    block_codec::encode_download_initiate_response(at.into(), block_size, true)
}

/// Returns an initiate frame with its data (1 to 4 bytes), 2Xh from a client or 4Xh from a server.
fn expedited(specifier: u8, at: Address, data: &[u8]) -> Payload {
    let len = data.len().clamp(1, EXPEDITED);
    let unused = (EXPEDITED - len) as u8;
    let [low, high] = at.index.to_le_bytes();
    let mut payload = [specifier | unused << 2 | IS_EXPEDITED | SIZE_INDICATED, low, high, at.sub, 0, 0, 0, 0];
    for (to, from) in payload.iter_mut().skip(4).zip(data) {
        *to = *from;
    }
    payload
}

/// Whether so many bytes go into the initiate frame; none do not, since its length field cannot say so.
pub(super) const fn is_expedited(len: usize) -> bool {
    len >= 1 && len <= EXPEDITED
}

/// Returns the first frame of a read.
pub(super) fn upload_request(at: Address) -> Payload {
    codec::encode_upload_request(at.into())
}

/// Returns the confirmation of a write.
pub(super) fn download_response(at: Address) -> Payload {
    codec::encode_download_response(at.into())
}

impl From<Address> for canopen_rs::Address {
    fn from(at: Address) -> Self {
        Self::new(at.index, at.sub)
    }
}

/// Returns the first frame of a write.
pub(super) fn download_request(at: Address, data: &[u8]) -> Payload {
    if is_expedited(data.len()) {
        expedited(0x20, at, data)
    } else {
        codec::encode_download_initiate_segmented(at.into(), data.len() as u32)
    }
}

/// Returns the answer to a read of 1 to 4 bytes, with them in it.
pub(super) fn expedited_upload_response(at: Address, data: &[u8]) -> Payload {
    expedited(0x40, at, data)
}

/// Returns the first answer to a read whose bytes come in segments.
pub(super) fn segmented_upload_response(at: Address, len: usize) -> Payload {
    codec::encode_upload_initiate_segmented_response(at.into(), len as u32)
}

/// Returns the segment of `data` from byte `sent` on, and how many bytes it carries; the last one says so.
pub(super) fn segment(data: &[u8], sent: usize, toggle: bool) -> (Payload, usize) {
    let rest = data.get(sent..).unwrap_or_default();
    let part = rest.get(..SEGMENT).unwrap_or(rest);
    let is_last = part.len() == rest.len();
    (codec::encode_data_segment(part, toggle, is_last).unwrap_or_default(), part.len())
}

/// Returns an abort frame.
pub(super) fn abort(at: Address, code: AbortCode) -> Payload {
    let [low, high] = at.index.to_le_bytes();
    let [a, b, c, d] = code.0.to_le_bytes();
    [ABORT, low, high, at.sub, a, b, c, d]
}

pub(super) use block_codec::crc16 as crc;
pub(super) use block_codec::encode_end_response as block_end_confirmed;
pub(super) use block_codec::encode_sub_response as block_acknowledge;
pub(super) use block_codec::encode_upload_start as block_start;
pub(super) use codec::encode_download_segment_response as download_segment_response;
pub(super) use codec::encode_upload_segment_request as upload_segment_request;
