//! The sensor as a master sees it.

use yieldwall_drives::profiles::{SIMULATED_FORCE_SENSOR, SIMULATED_SERVO};

use super::*;
use crate::canopen::node_id;

const SETTINGS_AT_1_KHZ: fn() -> ForceSensorSettings = || ForceSensorSettings {
    node: node_id(10).unwrap(),
    profile: &SIMULATED_FORCE_SENSOR,
    serial: 7,
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
    assert_eq!(answer[4..], SIMULATED_FORCE_SENSOR.identity.product_code.to_le_bytes());
}

#[test]
fn bad_settings_are_refused() {
    let good = SETTINGS_AT_1_KHZ();
    for bad in [
        ForceSensorSettings { sample_rate_hz: 300, ..good },
        ForceSensorSettings { range_counts: 0, ..good },
        ForceSensorSettings { range_counts: 32_768, ..good },
        ForceSensorSettings { sample_rate_hz: 200, phase_us: 5000, ..good },
    ] {
        assert!(matches!(ForceSensor::new(bad), Err(DeviceError::Setting { .. })));
    }
    let role = ForceSensor::new(ForceSensorSettings { profile: &SIMULATED_SERVO, ..good }).unwrap_err();
    assert!(matches!(role, DeviceError::Role { wanted: "force sensor", .. }));
}
