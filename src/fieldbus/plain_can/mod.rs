//! Force sensors that speak plain CAN, without I/O and for both sides of the bus.
//!
//! Six counts of 16 bits do not fit into one frame, so a sample takes two frames. The master's side is [`Client`]: it wakes the sensor,
//! puts frames together and hands out whole samples with their age. The codec is [`Protocol`], which the simulated sensors use as well.
//!
//! Two protocols are supported:
//!
//! - [`streaming`]: after a start order the sensor sends samples by its own clock. A sample is whole if the second frame comes right behind
//!   the first.
//! - [`polled`]: the master requests a sample in every cycle. A sample is whole under the same condition; its second frame has the number
//!   of the sample.

mod client;
mod pair;
pub mod polled;
pub mod streaming;

pub use client::{Client, SensorEvent};

use std::time::Duration;

use crate::canopen::Frame;
use yieldwall_motion::sensing::RawSample;

/// Order to a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Stream samples.
    Start,
    /// Stream no more.
    Stop,
    /// Take what is measured now for zero. No sensor remembers it when it is switched off.
    Zero,
    /// Send the newest sample.
    Read,
}

/// State that a sensor reports with a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// A channel is at the end of its range.
    pub overload: bool,
    /// The sample is not valid; a streaming sensor cannot say so.
    pub invalid: bool,
}

/// A sample as the sensor sends it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Telling {
    /// Fx, Fy, Fz, Tx, Ty, Tz.
    pub counts: [i16; 6],
    /// State of the sensor.
    pub status: Status,
    /// Number of the sample; a streaming sensor does not send it.
    pub number: u16,
}

/// Codec of one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// It streams.
    Streaming(streaming::Ids),
    /// It answers requests.
    Polled(polled::Format),
}

impl Protocol {
    /// Returns the identifier of orders.
    pub fn order_id(&self) -> u16 {
        match self {
            Protocol::Streaming(ids) => ids.command,
            Protocol::Polled(format) => format.base,
        }
    }

    /// Identifiers of the two frames of a sample.
    pub fn data_ids(&self) -> [u16; 2] {
        match self {
            Protocol::Streaming(ids) => ids.data,
            Protocol::Polled(format) => format.data_ids(),
        }
    }

    /// Returns the frame of an order; `None` if such a sensor takes none.
    ///
    /// Real-time: yes.
    pub fn order(&self, order: Order) -> Option<Frame> {
        match self {
            Protocol::Streaming(ids) => ids.order(order),
            Protocol::Polled(format) => format.order(order),
        }
    }

    /// Returns the order that a frame is, for the sensor's side.
    pub fn understand(&self, frame: &Frame) -> Option<Order> {
        match self {
            Protocol::Streaming(ids) => ids.understand(frame),
            Protocol::Polled(format) => format.understand(frame),
        }
    }

    /// Returns the frames of a sample, in the order in which they are sent.
    pub fn encode(&self, telling: &Telling) -> [Frame; 2] {
        match self {
            Protocol::Streaming(ids) => ids.encode(telling),
            Protocol::Polled(format) => format.encode(telling),
        }
    }

    /// Returns the sample of two frames of eight bytes that belong together; `None` if they are no sample.
    fn decode(&self, frames: [&Frame; 2]) -> Option<RawSample> {
        match self {
            Protocol::Streaming(ids) => ids.decode(frames),
            Protocol::Polled(format) => Some(format.decode(frames)),
        }
    }
}

/// Connection of the master to a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Link {
    /// Protocol of the sensor.
    pub protocol: Protocol,
    /// Longest time from the first frame of a sample to its second; below the sensor's period.
    pub pair_gap: Duration,
    /// Time from one sample to the next by the sensor's rate.
    pub sample_period: Duration,
    /// Whether the network's start sends the sensor a zero order: the handle must be untouched then.
    pub zero_at_start: bool,
}

fn sample(counts: [i16; 6], status: Status, sequence: Option<u8>) -> RawSample {
    let Status { overload, invalid } = status;
    RawSample { counts: counts.map(i32::from), sequence, overload, invalid, age_ns: 0 }
}
