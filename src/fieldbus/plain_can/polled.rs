//! A force sensor that answers when it is asked, in the manner of the CAN interface of the ATI Net F/T.
//!
//! # Source
//! Public manual text: one byte to the base identifier, 02h to read and 04h to bias; the answer to a read as two frames,
//!
//! ```text
//! base + 5   Fx   Tx   Fy       Ty
//! base + 6   Fz   Tz   status   sample number
//! ```
//! Each value has 16 bits. No document gave the order of their bytes, the bits of the status or the scale of the counts. The first two are
//! in [`Format`], the last is in the calibration.

use super::{Order, Status, Telling};
use crate::canopen::Frame;
use yieldwall_motion::sensing::RawSample;

/// Identifiers and layout of a polled sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Format {
    /// Identifier of requests, 001h to 7F9h; answers have five and six more.
    pub base: u16,
    /// Byte order of a number.
    pub byte_order: ByteOrder,
    /// Bits of the status of which any means that a channel is at the end of its range.
    pub overload_bits: u16,
    /// Bits of the status of which any means that the sample is not valid.
    pub invalid_bits: u16,
}

/// Byte order of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// The high byte first.
    BigEndian,
    /// The low byte first.
    LittleEndian,
}

const READ: u8 = 0x02;
const BIAS: u8 = 0x04;
/// From the base to the identifiers of the two frames of an answer.
const ANSWERS: [u16; 2] = [5, 6];

impl Format {
    pub(super) fn data_ids(self) -> [u16; 2] {
        ANSWERS.map(|offset| self.base.saturating_add(offset))
    }

    pub(super) fn order(self, order: Order) -> Option<Frame> {
        match order {
            Order::Read => Some(Frame::new(self.base, &[READ])),
            Order::Zero => Some(Frame::new(self.base, &[BIAS])),
            Order::Start | Order::Stop => None,
        }
    }

    pub(super) fn understand(self, frame: &Frame) -> Option<Order> {
        match (frame.id() == self.base, frame.data().first()?) {
            (true, &READ) => Some(Order::Read),
            (true, &BIAS) => Some(Order::Zero),
            _ => None,
        }
    }

    pub(super) fn encode(self, telling: &Telling) -> [Frame; 2] {
        let Status { overload, invalid } = telling.status;
        let status = if overload { self.overload_bits } else { 0 } | if invalid { self.invalid_bits } else { 0 };
        let [fx, fy, fz, tx, ty, tz] = telling.counts.map(i16::cast_unsigned);
        let words = [[fx, tx, fy, ty], [fz, tz, status, telling.number]];
        let [first, second] = self.data_ids();
        let frame = |id: u16, words: [u16; 4]| {
            let [[a, b], [c, d], [e, f], [g, h]] = words.map(|word| self.bytes(word));
            Frame::new(id, &[a, b, c, d, e, f, g, h])
        };
        [frame(first, words[0]), frame(second, words[1])]
    }

    pub(super) fn decode(self, frames: [&Frame; 2]) -> RawSample {
        let [[fx, tx, fy, ty], [fz, tz, status, number]] = frames.map(|frame| {
            let &[a, b, c, d, e, f, g, h] = frame.bytes();
            [[a, b], [c, d], [e, f], [g, h]].map(|bytes| self.word(bytes))
        });
        let counts = [fx, fy, fz, tx, ty, tz].map(u16::cast_signed);
        let has = |bits: u16| status & bits != 0;
        let status = Status { overload: has(self.overload_bits), invalid: has(self.invalid_bits) };
        // The low byte tells one sample from the next as well.
        super::sample(counts, status, Some(number as u8))
    }

    fn bytes(self, word: u16) -> [u8; 2] {
        match self.byte_order {
            ByteOrder::BigEndian => word.to_be_bytes(),
            ByteOrder::LittleEndian => word.to_le_bytes(),
        }
    }

    fn word(self, bytes: [u8; 2]) -> u16 {
        match self.byte_order {
            ByteOrder::BigEndian => u16::from_be_bytes(bytes),
            ByteOrder::LittleEndian => u16::from_le_bytes(bytes),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BIG: Format =
        Format { base: 0x1b0, byte_order: ByteOrder::BigEndian, overload_bits: 0x0002, invalid_bits: 0x8000 };
    const TELLING: Telling = Telling {
        counts: [0x0102, -2, 0x1234, 0x5678, -32_768, 0x7abc],
        status: Status { overload: true, invalid: true },
        number: 0x0105,
    };

    #[test]
    fn a_sample_is_two_frames_of_literal_bytes() {
        let first = Frame::new(0x1b5, &[0x01, 0x02, 0x56, 0x78, 0xff, 0xfe, 0x80, 0x00]);
        let second = Frame::new(0x1b6, &[0x12, 0x34, 0x7a, 0xbc, 0x80, 0x02, 0x01, 0x05]);
        assert_eq!(BIG.encode(&TELLING), [first, second]);
        let sample = BIG.decode([&first, &second]);
        assert_eq!(sample.counts, [0x0102, -2, 0x1234, 0x5678, -32_768, 0x7abc]);
        assert_eq!((sample.overload, sample.invalid, sample.sequence), (true, true, Some(5)));
        let little = Format { byte_order: ByteOrder::LittleEndian, ..BIG };
        let first = Frame::new(0x1b5, &[0x02, 0x01, 0x78, 0x56, 0xfe, 0xff, 0x00, 0x80]);
        let second = Frame::new(0x1b6, &[0x34, 0x12, 0xbc, 0x7a, 0x02, 0x80, 0x05, 0x01]);
        assert_eq!(little.encode(&TELLING), [first, second]);
        assert_eq!(little.decode([&first, &second]), sample);
    }

    #[test]
    fn only_the_named_bits_of_the_status_count() {
        for (status, overload, invalid) in [
            ([0x00, 0x00], false, false),
            ([0x7f, 0xfd], false, false),
            ([0x00, 0x02], true, false),
            ([0x80, 0], false, true),
        ] {
            let second = Frame::new(0x1b6, &[0, 0, 0, 0, status[0], status[1], 0, 0]);
            let sample = BIG.decode([&Frame::new(0x1b5, &[0; 8]), &second]);
            assert_eq!((sample.overload, sample.invalid), (overload, invalid), "{status:02x?}");
        }
    }

    #[test]
    fn orders_are_literal_bytes() {
        for (order, code) in [(Order::Read, 0x02), (Order::Zero, 0x04)] {
            assert_eq!(BIG.order(order), Some(Frame::new(0x1b0, &[code])));
            assert_eq!(BIG.understand(&Frame::new(0x1b0, &[code])), Some(order));
        }
        assert_eq!((BIG.order(Order::Start), BIG.order(Order::Stop)), (None, None));
        for frame in [Frame::new(0x1b0, &[]), Frame::new(0x1b0, &[0x03]), Frame::new(0x1b1, &[0x02])] {
            assert_eq!(BIG.understand(&frame), None);
        }
    }
}
