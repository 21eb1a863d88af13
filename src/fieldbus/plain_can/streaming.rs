//! A force sensor that streams its samples, in the manner of the Robotous RFT series.
//!
//! # Source
//! Public manual pages and drivers of the RFT40, RFT60, RFT64 and RFT80. The first byte of the command frame is an order: 0Bh (start), 0Ch
//! (stop) or 11h (bias). A sample has 16 bytes over two frames, big-endian, with Tx across both of them:
//!
//! ```text
//! first    0Bh     Fx    Fx    Fy    Fy    Fz    Fz    Tx high
//! second   Tx low  Ty    Ty    Tz    Tz    overload    0     0
//! ```
//! As delivered the identifiers are 064h, 001h and 002h, all of which outrank SYNC. The scale of the counts was not found:
//! it is in the calibration.

use super::{Order, Status, Telling};
use crate::canopen::Frame;
use yieldwall_motion::sensing::RawSample;

/// Identifiers of a streaming sensor, 001h to 7FFh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ids {
    /// Identifier of orders to the sensor.
    pub command: u16,
    /// Identifiers of the two frames of a sample, the first below the second: the sensor's own queue sends the lower one first.
    pub data: [u16; 2],
}

const START: u8 = 0x0b;
const STOP: u8 = 0x0c;
const BIAS: u8 = 0x11;

impl Ids {
    pub(super) fn order(self, order: Order) -> Option<Frame> {
        let code = match order {
            Order::Start => START,
            Order::Stop => STOP,
            Order::Zero => BIAS,
            Order::Read => return None,
        };
        Some(Frame::new(self.command, &[code, 0, 0, 0, 0, 0, 0, 0]))
    }

    pub(super) fn understand(self, frame: &Frame) -> Option<Order> {
        if frame.id() != self.command {
            return None;
        }
        match *frame.data().first()? {
            START => Some(Order::Start),
            STOP => Some(Order::Stop),
            BIAS => Some(Order::Zero),
            _ => None,
        }
    }

    pub(super) fn encode(self, telling: &Telling) -> [Frame; 2] {
        let [fx, fy, fz, tx, ty, tz] = telling.counts.map(i16::to_be_bytes);
        let overload = u8::from(telling.status.overload);
        let [first, second] = self.data;
        [
            Frame::new(first, &[START, fx[0], fx[1], fy[0], fy[1], fz[0], fz[1], tx[0]]),
            Frame::new(second, &[tx[1], ty[0], ty[1], tz[0], tz[1], overload, 0, 0]),
        ]
    }

    /// `None` for an answer to another order.
    pub(super) fn decode(self, [first, second]: [&Frame; 2]) -> Option<RawSample> {
        let &[code, fx0, fx1, fy0, fy1, fz0, fz1, tx0] = first.bytes();
        let &[tx1, ty0, ty1, tz0, tz1, overload, ..] = second.bytes();
        let pairs = [[fx0, fx1], [fy0, fy1], [fz0, fz1], [tx0, tx1], [ty0, ty1], [tz0, tz1]];
        let status = Status { overload: overload != 0, invalid: false };
        (code == START).then(|| super::sample(pairs.map(i16::from_be_bytes), status, None))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDS: Ids = Ids { command: 0x35f, data: [0x360, 0x361] };

    #[test]
    fn a_sample_is_two_frames_of_literal_bytes() {
        let telling = Telling {
            counts: [0x0102, -2, 0x1234, 0x5678, -32_768, 0x7abc],
            status: Status { overload: true, invalid: false },
            number: 9,
        };
        let first = Frame::new(0x360, &[0x0b, 0x01, 0x02, 0xff, 0xfe, 0x12, 0x34, 0x56]);
        let second = Frame::new(0x361, &[0x78, 0x80, 0x00, 0x7a, 0xbc, 0x01, 0x00, 0x00]);
        assert_eq!(IDS.encode(&telling), [first, second]);
        let sample = IDS.decode([&first, &second]).unwrap();
        assert_eq!(sample.counts, [0x0102, -2, 0x1234, 0x5678, -32_768, 0x7abc]);
        assert_eq!((sample.overload, sample.invalid, sample.sequence), (true, false, None));
        let other = Frame::new(0x360, &[0x01, b'R', b'F', b'T', b'6', b'0', 0, 0]);
        assert_eq!(IDS.decode([&other, &second]), None, "the answer to another order");
    }

    #[test]
    fn orders_are_literal_bytes() {
        for (order, code) in [(Order::Start, 0x0b), (Order::Stop, 0x0c), (Order::Zero, 0x11)] {
            let frame = Frame::new(0x35f, &[code, 0, 0, 0, 0, 0, 0, 0]);
            assert_eq!(IDS.order(order), Some(frame));
            assert_eq!(IDS.understand(&frame), Some(order));
        }
        assert_eq!(IDS.order(Order::Read), None);
        for frame in [Frame::new(0x35f, &[0x0d]), Frame::new(0x35f, &[]), Frame::new(0x360, &[0x0b])] {
            assert_eq!(IDS.understand(&frame), None);
        }
    }
}
