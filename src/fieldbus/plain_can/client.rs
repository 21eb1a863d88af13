//! The master's side of a plain CAN sensor.

use std::time::Duration;

use super::pair::Pair;
use super::{Link, Order, Protocol};
use crate::canopen::{Frame, Outbox};
use crate::time::Time;
use yieldwall_motion::sensing::RawSample;

/// Longest silence of a sensor after its start order, until the client sends the order again.
const RETRY: Duration = Duration::from_millis(50);
/// Bytes of each frame of a sample.
const WHOLE: u8 = 8;

/// Kind of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorEvent {
    /// Half of a sample, or what an earlier half lacked.
    Half,
    /// A frame of the sensor that is too short for half of a sample.
    BadLength,
    /// Not of the sensor.
    Other,
}

/// Wakes a sensor and puts its samples together.
///
/// If several samples arrive between two calls of [`Client::take`], the newest counts. The age of a sample is that of its last frame: the
/// client does not know how long the sensor took to measure, filter and queue it.
#[derive(Clone, Copy, Debug)]
pub struct Client {
    link: Link,
    pair: Pair,
    newest: Option<(Time, RawSample)>,
    /// Whether a whole sample has come since the start.
    has_begun: bool,
    /// Arrival time of the last whole sample.
    last_at: Time,
    /// Whether a request has no answer yet.
    is_asked: bool,
    next_order: Time,
}

impl Client {
    /// Creates a client that has sent nothing to its sensor.
    pub fn new(link: Link) -> Self {
        let pair = Pair::new(link.protocol.data_ids(), link.pair_gap);
        Self { link, pair, newest: None, has_begun: false, last_at: Time(0), is_asked: false, next_order: Time::NEVER }
    }

    /// Returns the protocol of the sensor.
    pub fn protocol(&self) -> &Protocol {
        &self.link.protocol
    }

    /// Sets the longest time from the first frame of a sample to its second, in place of the link's value.
    pub fn set_pair_gap(&mut self, gap: Duration) {
        self.link.pair_gap = gap;
        self.pair = Pair::new(self.link.protocol.data_ids(), gap);
    }

    /// Forgets all received frames, and sends nothing to the sensor.
    pub fn restart(&mut self) {
        *self = Self::new(self.link);
    }

    /// Orders the sensor to begin: a sensor that still streams for an earlier master is stopped first.
    pub fn start(&mut self, now: Time, out: &mut impl Outbox) {
        self.restart();
        self.tell(Order::Stop, out);
        self.begin(now, out);
    }

    /// Whether a whole sample has come since [`Client::start`].
    pub fn has_begun(&self) -> bool {
        self.has_begun
    }

    /// Returns the latest time for the next call of [`Client::poll`].
    ///
    /// Real-time: yes.
    pub fn next_deadline(&self) -> Time {
        self.next_order
    }

    /// Repeats the start order to a sensor that has not begun.
    ///
    /// Real-time: yes.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        if now >= self.next_order {
            self.begin(now, out);
        }
    }

    /// Requests a sample, if the sensor sends none without a request.
    ///
    /// Real-time: yes.
    pub fn read(&mut self, out: &mut impl Outbox) {
        self.is_asked = self.tell(Order::Read, out);
    }

    /// Whether a sample that has not come has to come by `now`: one that was asked for, or the next one by the rate of a
    /// sensor that streams.
    ///
    /// Real-time: yes.
    pub fn is_owed(&self, now: Time) -> bool {
        let is_streaming = self.link.protocol.order(Order::Read).is_none();
        self.is_asked || is_streaming && self.has_begun && now.since(self.last_at) >= self.link.sample_period
    }

    /// Takes a frame from the bus.
    ///
    /// Real-time: yes.
    pub fn on_frame(&mut self, now: Time, frame: &Frame) -> SensorEvent {
        if !self.pair.has(frame.id()) {
            return SensorEvent::Other;
        }
        if frame.len() != WHOLE {
            self.pair.clear();
            return SensorEvent::BadLength;
        }
        let Some([first, second]) = self.pair.take(now, frame) else { return SensorEvent::Half };
        if let Some(sample) = self.link.protocol.decode([&first, &second]) {
            self.newest = Some((now, sample));
            (self.has_begun, self.last_at, self.is_asked, self.next_order) = (true, now, false, Time::NEVER);
        }
        SensorEvent::Half
    }

    /// Returns the newest sample that came since the last call.
    ///
    /// Real-time: yes.
    pub fn take(&mut self, now: Time) -> Option<RawSample> {
        let (at, sample) = self.newest.take()?;
        let age_ns = now.since(at).as_nanos().min(u128::from(u32::MAX)) as u32;
        Some(RawSample { age_ns, ..sample })
    }

    fn begin(&mut self, now: Time, out: &mut impl Outbox) {
        if self.link.zero_at_start {
            self.tell(Order::Zero, out);
        }
        self.tell(Order::Start, out);
        self.tell(Order::Read, out);
        self.next_order = now + RETRY;
    }

    /// Whether the sensor takes such an order.
    fn tell(&self, order: Order, out: &mut impl Outbox) -> bool {
        let frame = self.link.protocol.order(order);
        frame.map(|frame| out.push(frame)).is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Status, Telling, polled, streaming};
    use super::*;

    const STREAMING: Link = Link {
        protocol: Protocol::Streaming(streaming::Ids { command: 0x35f, data: [0x360, 0x361] }),
        pair_gap: Duration::from_micros(500),
        sample_period: Duration::from_millis(2),
        zero_at_start: true,
    };
    const POLLED: Link = Link {
        protocol: Protocol::Polled(polled::Format {
            base: 0x1b0,
            byte_order: polled::ByteOrder::BigEndian,
            overload_bits: 2,
            invalid_bits: 1,
        }),
        pair_gap: Duration::from_micros(500),
        sample_period: Duration::from_millis(1),
        zero_at_start: false,
    };

    fn telling(number: u16) -> Telling {
        Telling { counts: [number as i16; 6], status: Status::default(), number }
    }

    fn us(us: u64) -> Time {
        Time::from_micros(us)
    }

    #[test]
    fn a_sensor_is_told_to_begin_until_it_does() {
        let mut client = Client::new(STREAMING);
        let mut out = Vec::new();
        assert_eq!(client.next_deadline(), Time::NEVER);
        client.start(us(0), &mut out);
        let codes = |out: &mut Vec<Frame>| -> Vec<u8> { out.drain(..).map(|frame| frame.bytes()[0]).collect() };
        assert_eq!(codes(&mut out), [0x0c, 0x11, 0x0b]);
        client.poll(us(49_999), &mut out);
        assert!(out.is_empty() && !client.has_begun());
        client.poll(client.next_deadline(), &mut out);
        assert_eq!(codes(&mut out), [0x11, 0x0b]);
        for frame in STREAMING.protocol.encode(&telling(1)) {
            client.on_frame(us(60_000), &frame);
        }
        assert!(client.has_begun() && client.next_deadline() == Time::NEVER);
        client.read(&mut out);
        assert!(out.is_empty(), "it streams");
    }

    #[test]
    fn the_gap_between_both_frames_of_a_sample_can_be_widened_for_good() {
        let mut client = Client::new(STREAMING);
        let [first, second] = STREAMING.protocol.encode(&telling(1));
        let hear = |client: &mut Client| {
            client.start(us(0), &mut Vec::new());
            client.on_frame(us(60_000), &first);
            client.on_frame(us(60_650), &second);
            client.has_begun()
        };
        assert!(!hear(&mut client));
        client.set_pair_gap(Duration::from_secs(1));
        assert!(hear(&mut client) && hear(&mut client));
    }

    #[test]
    fn a_polled_sensor_is_asked() {
        let mut client = Client::new(POLLED);
        let mut out = Vec::new();
        client.start(us(0), &mut out);
        client.read(&mut out);
        assert_eq!(out, [Frame::new(0x1b0, &[2]); 2]);
    }

    #[test]
    fn a_sample_is_owed_when_it_was_asked_for_or_when_the_rate_says_so() {
        let hear = |client: &mut Client, at: Time| {
            for frame in client.protocol().encode(&telling(1)) {
                client.on_frame(at, &frame);
            }
        };
        let mut out = Vec::new();
        let mut polled = Client::new(POLLED);
        assert!(!polled.is_owed(us(0)), "nobody has asked");
        for cycle in [0, 1000] {
            polled.read(&mut out);
            assert!(polled.is_owed(us(cycle)));
            hear(&mut polled, us(cycle));
            assert!(!polled.is_owed(us(cycle + 900)));
        }
        let mut streaming = Client::new(STREAMING);
        streaming.read(&mut out);
        assert!(!streaming.is_owed(us(5000)), "it has not begun");
        hear(&mut streaming, us(10_000));
        assert!(!streaming.is_owed(us(11_999)) && streaming.is_owed(us(12_000)) && streaming.is_owed(us(13_000)));
        hear(&mut streaming, us(12_000));
        assert!(!streaming.is_owed(us(13_000)));
    }

    #[test]
    fn a_sample_is_handed_out_once_with_its_age() {
        let mut client = Client::new(POLLED);
        let [first, second] = POLLED.protocol.encode(&telling(7));
        assert_eq!(client.on_frame(us(100), &first), SensorEvent::Half);
        assert_eq!(client.take(us(150)), None, "half of it");
        assert_eq!(client.on_frame(us(200), &second), SensorEvent::Half);
        let sample = client.take(us(620)).unwrap();
        assert_eq!((sample.counts, sample.sequence, sample.age_ns), ([7; 6], Some(7), 420_000));
        assert_eq!(client.take(us(630)), None);
    }

    #[test]
    fn of_two_samples_the_newer_counts_and_halves_are_dropped() {
        let mut client = Client::new(STREAMING);
        let samples = [1, 2, 3].map(|number| STREAMING.protocol.encode(&telling(number)));
        let [[one, one_more], [two, two_more], [three, three_more]] = samples;
        for (at, frame) in [(0, one), (131, one_more), (1000, two), (1131, two_more)] {
            client.on_frame(us(at), &frame);
        }
        assert_eq!(client.take(us(1200)).map(|sample| sample.counts), Some([2; 6]));
        // The second of the third sample comes too late.
        for (at, frame) in [(2000, three), (2501, three_more)] {
            client.on_frame(us(at), &frame);
        }
        assert_eq!(client.take(us(2600)), None);
    }

    #[test]
    fn short_frames_are_no_halves() {
        let mut client = Client::new(STREAMING);
        let [first, second] = STREAMING.protocol.encode(&telling(1));
        let short = Frame::new(first.id(), &first.data()[..7]);
        client.on_frame(us(0), &first);
        assert_eq!(client.on_frame(us(1), &short), SensorEvent::BadLength);
        client.on_frame(us(2), &second);
        assert_eq!(client.take(us(3)), None, "what was there before the short frame is not trusted");
        assert_eq!(client.on_frame(us(4), &Frame::new(0x35f, &[0x0b])), SensorEvent::Other);
    }
}
