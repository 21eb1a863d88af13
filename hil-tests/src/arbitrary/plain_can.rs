//! Force sensors on plain CAN: the master's side and the simulated sensor, fed frames and time.

use std::time::Duration;

use yieldwall::canopen::Frame;
use yieldwall::plain_can::{Client, Link, Order, Protocol, SensorEvent, polled, streaming};
use yieldwall::sim::{ForceSensor, ForceSensorSettings, Speaks};
use yieldwall::time::Time;

use super::bytes::{Bytes, Script};
use super::laws::live;

fn protocol(bytes: &mut Bytes<'_>) -> Protocol {
    match bytes.bool() {
        false => Protocol::Streaming(streaming::Ids { command: 0x35f, data: [0x360, 0x361] }),
        true => Protocol::Polled(polled::Format {
            base: 0x1b0,
            byte_order: bytes.pick(&[polled::ByteOrder::BigEndian, polled::ByteOrder::LittleEndian]),
            overload_bits: bytes.u16(),
            invalid_bits: bytes.u16(),
        }),
    }
}

/// What has to be true of a sample, from the frames alone.
#[derive(Default)]
struct Witness {
    first: Option<(Time, Frame)>,
    whole: Option<Time>,
}

impl Witness {
    fn hear(&mut self, now: Time, frame: &Frame, protocol: &Protocol, gap: Duration) {
        let [first, second] = protocol.data_ids();
        // What streams begins a sample with its order to start; other answers do not.
        let is_sample = |frame: &Frame| matches!(protocol, Protocol::Polled(_)) || frame.bytes()[0] == 0x0b;
        if frame.id() == first || frame.id() == second {
            let earlier = self.first.take().filter(|_| frame.len() == 8);
            if frame.id() == first && frame.len() == 8 {
                self.first = Some((now, *frame));
            } else if earlier.is_some_and(|(at, earlier)| now.since(at) <= gap && is_sample(&earlier)) {
                self.whole = Some(now);
            }
        }
    }
}

/// A sensor on plain CAN that anything is said to, and a master that anything is answered: a sample comes of two frames
/// that follow each other soon enough, once, with the age of the second; nobody sends with identifiers of others.
///
/// # Panics
/// If a law is broken.
pub fn plain_can(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let protocol = protocol(&mut bytes);
    let pair_gap = Duration::from_micros(u64::from(bytes.u16()));
    let mut client = Client::new(Link { protocol, pair_gap, sample_period: 2 * pair_gap, zero_at_start: bytes.bool() });
    let settings = ForceSensorSettings {
        speaks: Speaks::PlainCan { protocol, slow_ppm: u32::from(bytes.u8()) },
        sample_rate_hz: bytes.pick(&[200, 500, 1000]),
        phase_us: u32::from(bytes.u16() % 1000),
        range_counts: 32_000,
    };
    let mut sensor = ForceSensor::new(settings).expect("good settings");
    let (data, order) = (protocol.data_ids(), protocol.order_id());
    let ids = [data[0], data[1], data[0], data[1], order, 0x080];
    let (mut now, mut witness) = (Time::default(), Witness::default());
    sensor.boot(now, &mut Vec::new());
    while !bytes.is_empty() {
        let (mut orders, mut answers) = (Vec::new(), Vec::new());
        match bytes.u8() % 8 {
            0..3 => {
                let frame = bytes.frame(&ids);
                let heard = client.on_frame(now, &frame);
                assert_eq!(heard == SensorEvent::Other, !data.contains(&frame.id()));
                assert_eq!(heard == SensorEvent::BadLength, data.contains(&frame.id()) && frame.len() != 8);
                witness.hear(now, &frame, &protocol, pair_gap);
                sensor.on_frame(now, &frame, &mut answers);
            }
            3 => client.read(&mut orders),
            4 => client.start(now, &mut orders),
            5 => {
                now = now + bytes.wait();
                live(&mut client, now, Client::next_deadline, |client, now| client.poll(now, &mut orders));
                let answers = &mut answers;
                live(&mut sensor, now, ForceSensor::next_deadline, |sensor, now| sensor.poll(now, answers));
            }
            6 => sensor.measure([0; 6].map(|_| bytes.u32() as i32)),
            _ => {
                let sample = client.take(now);
                let counts = sample.map_or([0; 6], |sample| sample.counts);
                assert!(counts.iter().all(|count| i16::try_from(*count).is_ok()));
                if let Some(sample) = sample {
                    let at = witness.whole.expect("two frames were whole");
                    let age_ns = u32::try_from(now.since(at).as_nanos()).unwrap_or(u32::MAX);
                    assert_eq!(sample.age_ns, age_ns);
                    assert!(client.has_begun());
                }
                assert_eq!(client.take(now), None);
            }
        }
        if orders.len() > 1 {
            // A start: what was heard before does not count.
            let is_start = orders.iter().any(|frame: &Frame| protocol.understand(frame) == Some(Order::Stop));
            witness = if is_start { Witness::default() } else { witness };
        }
        assert!(orders.iter().all(|frame| frame.id() == order && protocol.understand(frame).is_some()));
        orders.iter().for_each(|frame| sensor.on_frame(now, frame, &mut answers));
        assert!(answers.len() % 2 == 0);
        for pair in answers.chunks(2) {
            assert_eq!([pair[0].id(), pair[1].id()], data);
            for frame in pair {
                assert_eq!((frame.len(), client.on_frame(now, frame)), (8, SensorEvent::Half));
                witness.hear(now, frame, &protocol, pair_gap);
            }
        }
    }
}

pub(super) fn conversations() -> Vec<Vec<u8>> {
    let begin = |protocol: &[u8]| {
        Script::new().raw(protocol).raw(&[0xf4, 1, 1, 50, 2, 44, 1]).raw(&[4]).raw(&[6]).raw(&[7, 0, 0, 0].repeat(6))
    };
    let cycles = |script: Script| {
        (0..5)
            .fold(script, |script, _| script.raw(&[3, 5]).wait_us(1000).raw(&[7]))
            .raw(&[5])
            .wait_us(250_000)
            .raw(&[7])
    };
    let halves = |script: Script, ids: [u16; 2]| {
        let script = script.raw(&[0]).frame(ids[0], &[0x0b, 0, 1, 0, 2, 0, 3, 0]).raw(&[5]).wait_us(380);
        script.raw(&[0]).frame(ids[1], &[4, 0, 5, 0, 6, 1, 0, 0]).raw(&[7]).raw(&[0]).frame(ids[0], &[0x0b, 1])
    };
    let streaming = halves(cycles(begin(&[0])), [0x360, 0x361]);
    let polled = halves(cycles(begin(&[1, 0, 2, 0, 0, 0x80])), [0x1b5, 0x1b6]);
    vec![streaming.finish(), polled.finish()]
}
