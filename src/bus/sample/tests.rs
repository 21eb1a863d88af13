//! The codec against bytes that were written by hand, and against any bytes.

use proptest::prelude::*;
use yieldwall_drives::profiles::{DeviceProfile, Role};

use super::*;
use crate::ethercat::{SegmentSensor, StationSetup};
use crate::setup::{SensorStart, Waits};
use std::sync::Arc;
use std::time::Duration;
use yieldwall_config::{Source, builtin, load_profile, shipped_profile};

fn of_file(name: &str) -> Arc<DeviceProfile> {
    Arc::new(load_profile(builtin(name)).unwrap().value)
}

/// A profile with some of the text of the shipped one on CANopen replaced.
fn edited(changes: &[(&str, &str)]) -> Arc<DeviceProfile> {
    let text = builtin("profiles/simulated-force-sensor.yaml").read().unwrap().to_string();
    let text = changes.iter().fold(text, |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    });
    Arc::new(load_profile(Source::memory("sensor.yaml", text)).unwrap_or_else(|report| panic!("{report}")).value)
}

fn station(profile: Arc<DeviceProfile>) -> StationSetup {
    let ms = Duration::from_millis;
    let sensor = SegmentSensor {
        name: "wrist".to_owned(),
        position: 0,
        profile,
        waits: Waits { boot_up: ms(1), sdo: ms(1), start: ms(1) },
        start: SensorStart::default(),
    };
    sensor.station().unwrap()
}

/// The sample that a sensor on a segment sends by these bytes, which are all of its inputs.
fn sample(profile: Arc<DeviceProfile>, bytes: &[u8]) -> RawSample {
    let setup = station(profile);
    assert_eq!(setup.input_bytes(), bytes.len());
    crate::ethercat::sample_of(&setup, bytes).unwrap()
}

#[test]
fn thirty_two_bytes_of_the_named_sensor() {
    let bytes = [
        0x01, 0x00, 0x00, 0x00, 0xfe, 0xff, 0xff, 0xff, 0x40, 0x42, 0x0f, 0x00, 0xc0, 0xbd, 0xf0, 0xff, 0xff, 0xff,
        0xff, 0x7f, 0x00, 0x00, 0x00, 0x80, 0x00, 0x00, 0x00, 0x08, 0x2a, 0x01, 0x00, 0x00,
    ];
    let expected = RawSample {
        counts: [1, -2, 1_000_000, -1_000_000, i32::MAX, i32::MIN],
        sequence: Some(0x2a),
        overload: true,
        invalid: false,
        age_ns: 0,
    };
    assert_eq!(sample(shipped_profile("ati-ethercat"), &bytes), expected);
}

#[test]
fn twenty_eight_bytes_of_its_other_revision_have_no_counter() {
    let mut bytes = [0; 28];
    (bytes[0], bytes[20], bytes[24]) = (7, 9, 0x04);
    let expected = RawSample { counts: [7, 0, 0, 0, 0, 9], sequence: None, overload: false, invalid: true, age_ns: 0 };
    assert_eq!(sample(shipped_profile("ati-ethercat-28-bytes"), &bytes), expected);
}

/// Status, 32 bits of warnings, six floats, 16 bits of saturation, and what is nothing to the program.
fn floats(channels: [[u8; 4]; 6], errors: [u8; 4], saturated: [u8; 2]) -> Vec<u8> {
    let mut bytes = vec![0x55];
    bytes.extend(errors);
    bytes.extend(channels.concat());
    bytes.extend(saturated);
    bytes.resize(35, 0xaa);
    bytes
}

const ONE: [u8; 4] = [0x00, 0x00, 0x80, 0x3f];
const MINUS_TWO_AND_A_HALF: [u8; 4] = [0x00, 0x00, 0x20, 0xc0];

#[test]
fn floats_become_counts_of_the_constants() {
    let profile = of_file("vendors/profiles/float-sensor.yaml");
    let bytes = floats([ONE, MINUS_TWO_AND_A_HALF, [0; 4], ONE, MINUS_TWO_AND_A_HALF, ONE], [0; 4], [0; 2]);
    let good = sample(profile.clone(), &bytes);
    assert_eq!(good.counts, [1_000_000, -2_500_000, 0, 1_000_000, -2_500_000, 1_000_000]);
    assert_eq!((good.sequence, good.overload, good.invalid), (None, false, false));
    let saturated = sample(profile.clone(), &floats([ONE; 6], [0; 4], [0, 0x80]));
    assert_eq!((saturated.overload, saturated.invalid), (true, false));
    let wrong = sample(profile, &floats([ONE; 6], [0, 0, 1, 0], [0; 2]));
    assert_eq!((wrong.overload, wrong.invalid), (false, true));
}

#[test]
fn what_is_no_number_is_not_valid_and_what_is_too_large_is_cut_off() {
    let profile = of_file("vendors/profiles/float-sensor.yaml");
    let nan = [0x00, 0x00, 0xc0, 0x7f];
    let (infinite, least) = ([0x00, 0x00, 0x80, 0x7f], [0x00, 0x00, 0x80, 0xff]);
    for (bad, counts) in [(nan, 0), (infinite, i32::MAX), (least, i32::MIN)] {
        for channel in 0..6 {
            let mut channels = [ONE; 6];
            channels[channel] = bad;
            let sample = sample(profile.clone(), &floats(channels, [0; 4], [0; 2]));
            assert!(sample.invalid && sample.counts[channel] == counts, "{sample:?}");
        }
    }
    // 1e30 N is finite, and beyond any range.
    let huge = [0xca, 0xf2, 0x49, 0x71];
    let cut_off = sample(profile, &floats([huge; 6], [0; 4], [0; 2]));
    assert_eq!((cut_off.counts, cut_off.invalid), ([i32::MAX; 6], false));
}

#[test]
fn numbers_of_24_bits_and_without_sign_lie_where_the_profile_says_it() {
    let narrow = [
        ("  tried: simulation", "  buses: [ethercat]\n  tried: simulation"),
        ("bits: 16", "bits: 24"),
        ("maps: [fx, fy, fz, tx]}", "maps: [{gap: 4}, fx, fy, {unused: {index: 0x2003, sub: 1, bits: 8}}]}"),
        ("maps: [ty, tz, status, sample_counter]}", "maps: [fz, tx, ty, tz, status, sample_counter]}"),
    ];
    let mut bytes = [0u8; 22];
    // Four bits, then -2 and 0x123456 in 24 bits each.
    bytes[..7].copy_from_slice(&[0xe5, 0xff, 0xff, 0x6f, 0x45, 0x23, 0x01]);
    let signed = sample(edited(&narrow), &bytes);
    assert_eq!(signed.counts[..2], [-2, 0x12_3456]);
    let unsigned = [&narrow[..], &[("      status: {index", "      numbers: unsigned\n      status: {index")]].concat();
    // Half of the range is zero.
    let offset = sample(edited(&unsigned), &bytes);
    assert_eq!(offset.counts[..3], [0xff_fffe - 0x80_0000, 0x12_3456 - 0x80_0000, -0x80_0000]);
}

proptest! {
    #[test]
    fn any_bytes_make_a_sample(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
        for profile in [
            shipped_profile("ati-ethercat"),
            shipped_profile("ati-ethercat-28-bytes"),
            shipped_profile("simulated-force-sensor"),
            of_file("vendors/profiles/float-sensor.yaml"),
        ] {
            let whole = crate::ethercat::sample_of(&station(profile), &bytes);
            prop_assert!(whole.is_some());
        }
    }

    #[test]
    fn any_word_of_any_length_is_taken(raw: u64, bits in 1u8..=32, numbers in 0..3usize) {
        let mut profile = (*shipped_profile("simulated-force-sensor")).clone();
        let Role::ForceSensor(sensor) = &mut profile.device else { unreachable!() };
        sensor.objects.numbers = [Numbers::Signed, Numbers::Unsigned, Numbers::Real][numbers];
        let codec = SampleCodec::new(&profile);
        let mut sample = NO_SAMPLE;
        prop_assert!(codec.take(Quantity::Fz, raw, bits, &mut sample));
        let half = 1i64 << (bits - 1);
        let is_real = numbers == 2;
        prop_assert!(is_real || (-half..half).contains(&sample.counts[2].into()));
        for quantity in [Quantity::Status, Quantity::Overload, Quantity::SampleCounter, Quantity::Controlword] {
            prop_assert!(!codec.take(quantity, raw, bits, &mut sample));
        }
    }
}
