//! Both ends of a block transfer: segments in blocks, with one acknowledgement for each block that counts the segments received in order.
//!
//! The sender begins each block after the last segment that was acknowledged, so that lost segments are sent again. Lost acknowledgements
//! need more than the standard specifies. After a silence the receiver acknowledges the segments that it has of the block. If it has none,
//! it repeats the frame that let the block begin. The sender must distinguish such a repetition from a new acknowledgement, so this
//! receiver never requests the same block size twice in a row.
//!
//! # Source
//! CiA 301, SDO block upload and download. The repetition is an addition; a peer without it ends in a timeout as the
//! standard has it, and a repetition that it misunderstands is found by the checksum.

use std::time::Duration;

use super::wire::{self, BlockFrame, LARGEST_BLOCK, Payload, SEGMENT};
use crate::objects::AbortCode;
use crate::time::Time;

/// Time after which a segment for which there was no room is offered again: that of about two frames at 1 Mbit/s.
const BACK_OFF: Duration = Duration::from_micros(250);
/// Blocks in a row that may fail to bring anything; more is a peer that only keeps the transfer open.
const FRUITLESS_BLOCKS: u8 = 16;

/// The end that has the data: the client of a download, the server of an upload.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockSender {
    /// Segments acknowledged so far.
    base: usize,
    block_size: u8,
    /// Segments of this block that are sent.
    sent: u8,
    /// The acknowledgement that let this block begin.
    opened_by: Option<(u8, u8)>,
    /// Whether the receiver has asked for another size each time, so that an equal acknowledgement is an old one.
    is_alternating: bool,
    fruitless: u8,
    next_at: Time,
}

impl BlockSender {
    /// Sends from `now` on.
    pub(super) fn new(now: Time, block_size: u8) -> Result<Self, AbortCode> {
        if !is_valid(block_size) {
            return Err(AbortCode::BLOCK_SIZE);
        }
        Ok(BlockSender {
            base: 0,
            block_size,
            sent: 0,
            opened_by: None,
            is_alternating: true,
            fruitless: 0,
            next_at: now,
        })
    }

    /// Offers the segments of `data` that are due, one every `interval`; a zero interval sends the block as fast as it is taken. Returns
    /// whether a segment was taken. A refused segment is offered again after [`BACK_OFF`].
    pub(super) fn poll(
        &mut self,
        now: Time,
        interval: Duration,
        data: &[u8],
        mut offer: impl FnMut(Payload) -> bool,
    ) -> bool {
        let before = self.sent;
        while now >= self.next_at {
            let place = self.base + usize::from(self.sent);
            if !offer(wire::block_segment(data, place, self.sent + 1)) {
                self.next_at = now + BACK_OFF;
                break;
            }
            self.sent += 1;
            let is_block_done = self.sent >= self.block_size || place + 1 >= wire::segments(data.len());
            self.next_at = if is_block_done { Time::NEVER } else { now + interval };
        }
        self.sent > before
    }

    /// Returns the time at which the next segment is due; [`Time::NEVER`] while an acknowledgement is awaited.
    pub(super) const fn next_at(&self) -> Time {
        self.next_at
    }

    /// Whether nothing has been acknowledged yet.
    pub(super) const fn is_first_block(&self) -> bool {
        self.opened_by.is_none()
    }

    /// Sends the block again: nothing of it has arrived.
    ///
    /// # Errors
    /// 05040003h if that was so too often in a row.
    pub(super) fn restart(&mut self, now: Time) -> Result<(), AbortCode> {
        self.fruitless = count_fruitless(self.fruitless, 0)?;
        self.sent = 0;
        self.next_at = now;
        Ok(())
    }

    /// Takes an acknowledgement of a value of `len` bytes; whether all of it has arrived.
    ///
    /// # Errors
    /// 05040002h for an impossible block size, 05040003h for more segments than were sent or none too often in a row.
    pub(super) fn acknowledge(
        &mut self,
        now: Time,
        acknowledged: u8,
        block_size: u8,
        len: usize,
    ) -> Result<bool, AbortCode> {
        if !is_valid(block_size) {
            return Err(AbortCode::BLOCK_SIZE);
        }
        let is_same = self.opened_by == Some((acknowledged, block_size));
        if is_same && (self.is_alternating || acknowledged > self.sent) {
            return self.restart(now).map(|()| false);
        }
        if acknowledged > self.sent {
            return Err(AbortCode::SEQUENCE);
        }
        self.fruitless = count_fruitless(self.fruitless, acknowledged)?;
        self.is_alternating &= block_size != self.block_size;
        self.opened_by = Some((acknowledged, block_size));
        self.base += usize::from(acknowledged);
        self.block_size = block_size;
        self.sent = 0;
        let is_all = self.base >= wire::segments(len);
        self.next_at = if is_all { Time::NEVER } else { now };
        Ok(is_all)
    }
}

/// Result of a frame of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Taken {
    /// Nothing to send.
    Nothing,
    /// The block is over: send this acknowledgement.
    Acknowledge(Payload),
}

/// The end that gets the data: the server of a download, the client of an upload.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockReceiver {
    /// Segments of this block that arrived in order.
    good: u8,
    block_size: u8,
    largest: u8,
    /// The frame that let this block begin, to be sent again when nothing of the block comes.
    opened_by: Payload,
    is_first_block: bool,
    is_complete: bool,
    /// Whether a silence ended the last block. A sender that was only slow goes on with that block, and its segments must not count as the
    /// end of the next block.
    is_early: bool,
    fruitless: u8,
    /// Bytes that the value may have.
    limit: usize,
}

impl BlockReceiver {
    /// For values of up to `limit` bytes in blocks of up to `block_size` segments, the first of which `opened_by` asked
    /// for.
    pub(super) fn new(block_size: u8, limit: usize, opened_by: Payload) -> Self {
        BlockReceiver {
            good: 0,
            block_size,
            largest: block_size,
            opened_by,
            is_first_block: true,
            is_complete: false,
            is_early: false,
            fruitless: 0,
            limit,
        }
    }

    /// Whether the last segment has arrived.
    pub(super) const fn is_complete(&self) -> bool {
        self.is_complete
    }

    /// Whether nothing at all has arrived.
    pub(super) const fn is_untouched(&self) -> bool {
        self.is_first_block && self.good == 0
    }

    /// Takes a segment; what is out of order does not count. Up to six bytes more than the limit may get into `value`.
    ///
    /// # Errors
    /// 06070012h above the limit, 05040003h if block after block brings nothing.
    pub(super) fn take(&mut self, frame: BlockFrame<'_>, value: &mut Vec<u8>) -> Result<Taken, AbortCode> {
        let BlockFrame::Segment { sequence, is_last, data } = frame else { return Ok(Taken::Nothing) };
        if self.is_complete {
            return Ok(Taken::Nothing);
        }
        if sequence == self.good + 1 && sequence <= self.block_size {
            let least = if is_last { value.len() + usize::from(!value.is_empty()) } else { value.len() + SEGMENT };
            if least > self.limit {
                return Err(AbortCode::TOO_LONG);
            }
            value.extend_from_slice(data);
            self.good = sequence;
            self.is_complete = is_last;
        }
        let is_of_last_block = self.is_early && self.good == 0;
        let is_end = is_last || sequence == self.block_size;
        if is_end && !is_of_last_block { self.close().map(Taken::Acknowledge) } else { Ok(Taken::Nothing) }
    }

    /// Returns the frame to send after a silence.
    pub(super) fn on_silence(&mut self) -> Result<Payload, AbortCode> {
        if self.good == 0 {
            return Ok(self.opened_by);
        }
        let acknowledgement = self.close()?;
        self.is_early = true;
        Ok(acknowledgement)
    }

    /// Ends the block; the next one is larger after success, smaller after loss, and never as large as this one.
    fn close(&mut self) -> Result<Payload, AbortCode> {
        self.fruitless = count_fruitless(self.fruitless, self.good)?;
        let is_whole = self.is_complete || self.good == self.block_size;
        let wanted = if is_whole { self.block_size.saturating_mul(2).min(self.largest) } else { self.block_size / 2 };
        self.block_size = match wanted.max(1) {
            same if same != self.block_size => same,
            1 => 2,
            same => same - 1,
        };
        self.opened_by = wire::block_acknowledge(self.good, self.block_size);
        (self.good, self.is_first_block, self.is_early) = (0, false, false);
        Ok(self.opened_by)
    }

    /// Cuts off what does not count in the last segment and checks the checksum.
    ///
    /// # Errors
    /// 05040004h checksum, 06070012h and 06070013h for another length than declared, 06070010h for an impossible one.
    pub(super) fn finish(
        &self,
        end: (u8, u16),
        has_crc: bool,
        declared: Option<usize>,
        value: &mut Vec<u8>,
    ) -> Result<(), AbortCode> {
        let (unused, crc) = (usize::from(end.0), end.1);
        let is_possible = unused < SEGMENT || (unused == SEGMENT && value.len() == SEGMENT);
        let len = value.len().checked_sub(unused).filter(|_| is_possible).ok_or(AbortCode::LENGTH)?;
        value.truncate(len);
        match declared {
            Some(size) if len < size => Err(AbortCode::TOO_SHORT),
            Some(size) if len > size => Err(AbortCode::TOO_LONG),
            None if len > self.limit => Err(AbortCode::TOO_LONG),
            _ if has_crc && wire::crc(value) != crc => Err(AbortCode::CRC),
            _ => Ok(()),
        }
    }
}

const fn is_valid(block_size: u8) -> bool {
    block_size >= 1 && block_size <= LARGEST_BLOCK
}

fn count_fruitless(before: u8, segments: u8) -> Result<u8, AbortCode> {
    let fruitless = if segments == 0 { before + 1 } else { 0 };
    if fruitless > FRUITLESS_BLOCKS { Err(AbortCode::SEQUENCE) } else { Ok(fruitless) }
}
