//! The sensor as a master sees it.

use yieldwall_config::shipped_profile;

use super::*;
use yieldwall_fieldbus::canopen::node_id;

const SETTINGS_AT_1_KHZ: fn() -> ForceSensorSettings = || ForceSensorSettings {
    speaks: Speaks::Canopen {
        node: node_id(10).unwrap(),
        profile: shipped_profile("simulated-force-sensor"),
        serial: 7,
        counts_per_unit: [1; 2],
    },
    sample_rate_hz: 1000,
    phase_us: 0,
    range_counts: 32_000,
};

const SYNC: [u8; 0] = [];

struct Bench {
    sensor: ForceSensor,
    sent: Vec<Frame>,
}

impl Bench {
    /// Operational, both TPDOs switched on.
    fn new(settings: ForceSensorSettings) -> Self {
        let mut bench = Bench { sensor: ForceSensor::new(settings).unwrap(), sent: Vec::new() };
        bench.sensor.boot(Time(0), &mut bench.sent);
        assert_eq!(bench.take(), [Frame::new(0x70a, &[0])]);
        bench.write(0x1800, 1, &0x18au32.to_le_bytes());
        bench.write(0x1801, 1, &0x28au32.to_le_bytes());
        bench.sensor.on_frame(Time(0), &Frame::new(0x000, &[0x01, 10]), &mut bench.sent);
        bench
    }

    fn take(&mut self) -> Vec<Frame> {
        std::mem::take(&mut self.sent)
    }

    fn request(&mut self, data: [u8; 8]) -> [u8; 8] {
        self.sensor.on_frame(Time(0), &Frame::new(0x60a, &data), &mut self.sent);
        let answer = self.take();
        assert_eq!((answer.len(), answer[0].id()), (1, 0x58a));
        *answer[0].bytes()
    }

    fn try_write(&mut self, index: u16, sub: u8, value: &[u8; 4]) -> [u8; 8] {
        let [low, high] = index.to_le_bytes();
        self.request([0x23, low, high, sub, value[0], value[1], value[2], value[3]])
    }

    fn write(&mut self, index: u16, sub: u8, value: &[u8; 4]) {
        let answer = self.try_write(index, sub, value);
        assert_eq!(answer[0], 0x60, "{index:04x}:{sub} refused with {answer:02x?}");
    }

    fn poll_until(&mut self, until: Time) {
        while self.sensor.next_deadline() <= until {
            let now = self.sensor.next_deadline();
            self.sensor.poll(now, &mut self.sent);
        }
    }

    fn sync(&mut self, now: Time, counts: [i32; 6]) -> Vec<Frame> {
        self.sensor.measure(counts);
        self.sensor.on_frame(now, &Frame::new(0x080, &SYNC), &mut self.sent);
        self.take()
    }
}

#[test]
fn one_sample_is_two_frames_of_literal_bytes() {
    let mut bench = Bench::new(SETTINGS_AT_1_KHZ());
    let sent = bench.sync(Time::from_micros(1000), [1, -2, 0x1234, -32_000 + 1, 300, -1]);
    let expected = [
        Frame::new(0x18a, &[0x01, 0x00, 0xfe, 0xff, 0x34, 0x12, 0x01, 0x83]),
        Frame::new(0x28a, &[0x2c, 0x01, 0xff, 0xff, 0x00, 0x01]),
    ];
    assert_eq!(sent, expected);
}

#[test]
fn at_1_khz_each_sync_is_a_sample_and_the_counter_wraps() {
    let mut bench = Bench::new(SETTINGS_AT_1_KHZ());
    for k in 1..=600u32 {
        let sent = bench.sync(Time::from_micros(u64::from(k) * 1000), [0; 6]);
        assert_eq!(sent[1].bytes()[5], k as u8);
    }
}

#[test]
fn at_200_hz_five_syncs_share_a_sample_of_the_free_running_clock() {
    let mut bench = Bench::new(ForceSensorSettings { sample_rate_hz: 200, phase_us: 2300, ..SETTINGS_AT_1_KHZ() });
    let mut seen = Vec::new();
    for k in 0..20u64 {
        let now = Time::from_micros(k * 1000);
        bench.sensor.measure([(k as i32) * 10 - 5; 6]);
        bench.poll_until(now);
        let sent = bench.sync(now, [(k as i32) * 10; 6]);
        seen.push((sent[0].bytes()[0], sent[1].bytes()[5]));
    }
    // Samples at 2.3, 7.3, 12.3 and 17.3 ms show from the next SYNC on.
    let expected: Vec<(u8, u8)> = (0..20)
        .map(|k| if k < 3 { (0, 0) } else { (((k - 3) / 5 * 50 + 25) as u8, ((k - 3) / 5 + 1) as u8) })
        .collect();
    assert_eq!(seen, expected);
}

#[test]
fn overload_shows_and_is_cut_off_at_the_range() {
    let mut bench = Bench::new(SETTINGS_AT_1_KHZ());
    for (counts, raw, status) in
        [(31_999, 31_999i16, 0), (32_000, 32_000, 1), (40_000, 32_000, 1), (-99_999, -32_000, 1)]
    {
        let sent = bench.sync(Time(0), [0, 0, 0, 0, 0, counts]);
        let data = sent[1].bytes();
        assert_eq!((i16::from_le_bytes([data[2], data[3]]), data[4]), (raw, status), "{counts} counts");
    }
}

#[test]
fn auto_zero_needs_its_signature_and_zeroes_one_channel() {
    let mut bench = Bench::new(SETTINGS_AT_1_KHZ());
    bench.sync(Time(0), [100; 6]);
    assert_eq!(bench.try_write(0x6125, 2, b"ZERO"), [0x80, 0x25, 0x61, 2, 0x30, 0x00, 0x09, 0x06]);
    bench.write(0x6125, 2, b"zero");
    let sent = bench.sync(Time(0), [107; 6]);
    assert_eq!(sent[0].bytes(), &[107, 0, 7, 0, 107, 0, 107, 0]);
    bench.sensor.on_frame(Time(0), &Frame::new(0x000, &[0x81, 10]), &mut bench.sent);
    bench.take();
    bench.sync(Time(0), [107; 6]);
    let answer = bench.request([0x40, 0x30, 0x71, 2, 0, 0, 0, 0]);
    assert_eq!(answer[4], 107, "a reset forgets the zero");
}

#[test]
fn identity_is_that_of_the_profile() {
    let mut bench = Bench::new(SETTINGS_AT_1_KHZ());
    let answer = bench.request([0x40, 0x18, 0x10, 2, 0, 0, 0, 0]);
    assert_eq!(answer[4..], 0x404u32.to_le_bytes());
}

#[test]
fn bad_settings_are_refused() {
    let good = SETTINGS_AT_1_KHZ();
    for bad in [
        ForceSensorSettings { sample_rate_hz: 300, ..good.clone() },
        ForceSensorSettings { range_counts: 0, ..good.clone() },
        ForceSensorSettings { range_counts: 32_768, ..good.clone() },
        ForceSensorSettings { sample_rate_hz: 200, phase_us: 5000, ..good.clone() },
    ] {
        assert!(matches!(ForceSensor::new(bad), Err(DeviceError::Setting { .. })));
    }
    let role = ForceSensor::new(ForceSensorSettings {
        speaks: Speaks::Canopen {
            node: node_id(10).unwrap(),
            profile: shipped_profile("simulated-servo"),
            serial: 7,
            counts_per_unit: [1; 2],
        },
        ..good
    })
    .unwrap_err();
    assert!(matches!(role, DeviceError::Role { wanted: "force sensor", .. }));
}

mod plain_can {
    use super::*;
    use yieldwall_fieldbus::plain_can::{polled, streaming};

    const STREAMING: Protocol = Protocol::Streaming(streaming::Ids { command: 0x35f, data: [0x360, 0x361] });
    const POLLED: Protocol = Protocol::Polled(polled::Format {
        base: 0x1b0,
        byte_order: polled::ByteOrder::BigEndian,
        overload_bits: 0x0002,
        invalid_bits: 0x8000,
    });

    fn settings(protocol: Protocol, sample_rate_hz: u32) -> ForceSensorSettings {
        let speaks = Speaks::PlainCan { protocol, slow_ppm: 0 };
        ForceSensorSettings { speaks, sample_rate_hz, phase_us: 300, range_counts: 32_000 }
    }

    fn on(settings: ForceSensorSettings) -> (ForceSensor, Vec<Frame>) {
        let (mut sensor, mut sent) = (ForceSensor::new(settings).unwrap(), Vec::new());
        sensor.boot(Time(0), &mut sent);
        assert!(sent.is_empty(), "it says nothing until it is told to");
        (sensor, sent)
    }

    /// Moments in us at which something was sent up to `until_us`.
    fn moments(sensor: &mut ForceSensor, until_us: u64) -> Vec<(u64, Vec<Frame>)> {
        let mut moments = Vec::new();
        while sensor.next_deadline() <= Time::from_micros(until_us) {
            let (now, mut sent) = (sensor.next_deadline(), Vec::new());
            sensor.poll(now, &mut sent);
            if !sent.is_empty() {
                moments.push((now.0 / 1000, sent));
            }
        }
        moments
    }

    #[test]
    fn a_streaming_sensor_sends_each_sample_of_its_clock_between_start_and_stop() {
        for (rate, samples) in [(200, 4), (500, 10), (1000, 20)] {
            let (mut sensor, mut sent) = on(settings(STREAMING, rate));
            assert_eq!(moments(&mut sensor, 20_000).len(), 0);
            sensor.measure([1, -2, 3, 0x0405, 6, -7]);
            sensor.on_frame(Time::from_micros(20_000), &Frame::new(0x35f, &[0x0b, 0, 0, 0, 0, 0, 0, 0]), &mut sent);
            let streamed = moments(&mut sensor, 40_000);
            assert_eq!(streamed.len(), samples, "{rate} Hz");
            let period_us = 1_000_000 / u64::from(rate);
            assert!(streamed.windows(2).all(|pair| pair[1].0 - pair[0].0 == period_us) && streamed[0].0 == 20_300);
            let first = Frame::new(0x360, &[0x0b, 0x00, 0x01, 0xff, 0xfe, 0x00, 0x03, 0x04]);
            let second = Frame::new(0x361, &[0x05, 0x00, 0x06, 0xff, 0xf9, 0x00, 0x00, 0x00]);
            assert!(streamed.iter().all(|(_, frames)| *frames == [first, second]));
            sensor.on_frame(Time::from_micros(40_000), &Frame::new(0x35f, &[0x0c]), &mut sent);
            assert!(moments(&mut sensor, 60_000).is_empty() && sent.is_empty());
        }
    }

    #[test]
    fn a_polled_sensor_answers_with_its_newest_sample_and_its_number() {
        for (rate, number) in [(200, 4), (500, 10), (1000, 20)] {
            let (mut sensor, mut sent) = on(settings(POLLED, rate));
            sensor.measure([1, -2, 3, 0x0405, 6, 32_000]);
            assert_eq!(moments(&mut sensor, 20_000).len(), 0, "nobody has asked");
            sensor.on_frame(Time::from_micros(20_000), &Frame::new(0x1b0, &[2]), &mut sent);
            let first = Frame::new(0x1b5, &[0x00, 0x01, 0x04, 0x05, 0xff, 0xfe, 0x00, 0x06]);
            let second = Frame::new(0x1b6, &[0x00, 0x03, 0x7d, 0x00, 0x00, 0x02, 0x00, number]);
            assert_eq!(sent, [first, second], "{rate} Hz");
        }
    }

    #[test]
    fn a_zero_holds_until_the_sensor_is_switched_off() {
        let (mut sensor, mut sent) = on(settings(POLLED, 1000));
        let read = |sensor: &mut ForceSensor, at_us: u64| {
            moments(sensor, at_us);
            let mut sent = Vec::new();
            sensor.on_frame(Time::from_micros(at_us), &Frame::new(0x1b0, &[2]), &mut sent);
            i16::from_be_bytes([sent[0].bytes()[0], sent[0].bytes()[1]])
        };
        sensor.measure([100; 6]);
        assert_eq!(read(&mut sensor, 5000), 100);
        sensor.on_frame(Time::from_micros(5000), &Frame::new(0x1b0, &[4]), &mut sent);
        sensor.measure([107; 6]);
        assert_eq!((read(&mut sensor, 6000), read(&mut sensor, 7000)), (107 - 100, 7));
        sensor.switch_off();
        sensor.on_frame(Time::from_micros(8000), &Frame::new(0x1b0, &[2]), &mut sent);
        assert!(sent.is_empty() && sensor.next_deadline() == Time::NEVER);
        sensor.boot(Time::from_micros(9000), &mut sent);
        assert_eq!(read(&mut sensor, 10_000), 107);
    }

    #[test]
    fn a_clock_that_stands_still_stops_a_stream_and_repeats_an_answer() {
        let (mut sensor, mut sent) = on(settings(STREAMING, 1000));
        sensor.on_frame(Time(0), &Frame::new(0x35f, &[0x0b]), &mut sent);
        assert_eq!(moments(&mut sensor, 5000).len(), 5);
        sensor.set_clock_rate(0.0);
        assert!(moments(&mut sensor, 9000).is_empty());
        let (mut sensor, mut sent) = on(settings(POLLED, 1000));
        moments(&mut sensor, 5000);
        sensor.set_clock_rate(0.0);
        sensor.set_invalid(true);
        for at_us in [6000, 7000] {
            moments(&mut sensor, at_us);
            sensor.on_frame(Time::from_micros(at_us), &Frame::new(0x1b0, &[2]), &mut sent);
        }
        assert_eq!(sent[1].bytes()[4..], [0x00, 0x00, 0x00, 0x05], "the sample of before");
        assert_eq!(sent[1], sent[3]);
        sensor.set_clock_rate(1.0);
        moments(&mut sensor, 8000);
        sensor.on_frame(Time::from_micros(8000), &Frame::new(0x1b0, &[2]), &mut sent);
        assert_eq!(sent[5].bytes()[4..6], [0x80, 0x00]);
    }

    #[test]
    fn bad_settings_are_refused() {
        for bad in [
            settings(STREAMING, 0),
            settings(POLLED, 10_001),
            ForceSensorSettings {
                speaks: Speaks::PlainCan { protocol: POLLED, slow_ppm: 1001 },
                ..settings(POLLED, 1000)
            },
            ForceSensorSettings { phase_us: 5000, ..settings(STREAMING, 200) },
        ] {
            let told = format!("{bad:?}");
            assert!(matches!(ForceSensor::new(bad), Err(DeviceError::Setting { .. })), "{told}");
        }
    }
}
