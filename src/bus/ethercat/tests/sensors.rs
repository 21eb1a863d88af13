//! Force sensors by their profiles: what is read of them, and which ones are refused.

use super::*;
use crate::setup::SensorStart;
use std::sync::Arc;
use yieldwall_config::{Source, builtin, load_profile};
use yieldwall_drives::profiles::DeviceProfile;

fn text(name: &str) -> String {
    builtin(name).read().unwrap().to_string()
}

fn profile(text: String) -> Arc<DeviceProfile> {
    Arc::new(load_profile(Source::memory("sensor.yaml", text)).unwrap_or_else(|report| panic!("{report}")).value)
}

fn floats() -> Arc<DeviceProfile> {
    profile(text("vendors/profiles/float-sensor.yaml"))
}

/// The usual segment with a master whose sensor has the profile `wanted`, and a device of the profile `is`.
fn bench(wanted: Arc<DeviceProfile>, start: SensorStart, is: Arc<DeviceProfile>) -> Bench {
    let sensor = SegmentSensor { name: "wrist".to_owned(), position: 2, profile: wanted, waits: waits(), start };
    let mut setup = setup();
    setup.stations[2] = sensor.station().unwrap();
    let settings = ForceTorqueSettings { sample_rate_hz: 1000, ..ForceTorqueSettings::new(is, 3) };
    let device = SimulatedDevice::ForceTorque(Box::new(ForceTorqueSensor::new(&settings).unwrap()));
    Bench::new(&setup, vec![controller(drive(1), 0), controller(drive(2), 0), controller(device, 0)])
}

fn device(bench: &mut Bench) -> &mut ForceTorqueSensor {
    bench.segment.controller_mut(2).unwrap().device_mut().force_torque_mut().unwrap()
}

fn refused(wanted: Arc<DeviceProfile>, start: SensorStart, is: Arc<DeviceProfile>) -> String {
    bench(wanted, start, is).start().unwrap_err()
}

#[test]
fn each_family_is_read_by_its_profile() {
    let counts = [1_000_000, -2_000_000, 3, -4_000_000, 5_000_000, -6];
    for (name, sequence) in [("ati-ethercat", true), ("ati-ethercat-28-bytes", false)] {
        let mut bench = bench(shipped_profile(name), SensorStart::default(), shipped_profile(name));
        bench.start().unwrap();
        device(&mut bench).measure(counts);
        bench.cycles(3, &REST);
        let sample = bench.cycle(&REST).sample.unwrap();
        assert_eq!((sample.counts, sample.sequence.is_some()), (counts, sequence), "{name}");
    }
    let mut bench = bench(floats(), SensorStart::default(), floats());
    bench.start().unwrap();
    device(&mut bench).measure(counts);
    bench.cycles(3, &REST);
    let sample = bench.cycle(&REST).sample.unwrap();
    assert_eq!((sample.counts, sample.overload, sample.invalid), (counts, false, false));
    device(&mut bench).measure([500_000_000; 6]);
    device(&mut bench).set_invalid(true);
    bench.cycles(3, &REST);
    let sample = bench.cycle(&REST).sample.unwrap();
    assert_eq!((sample.overload, sample.invalid), (true, true));
}

#[test]
fn floats_without_a_status_say_by_no_number_that_they_are_not_valid() {
    let without = text("vendors/profiles/float-sensor.yaml").replace("invalid: 0xffff0000", "invalid: 0");
    let mut bench = bench(profile(without.clone()), SensorStart::default(), profile(without));
    bench.start().unwrap();
    device(&mut bench).set_invalid(true);
    bench.cycles(3, &REST);
    let sample = bench.cycle(&REST).sample.unwrap();
    assert_eq!((sample.counts, sample.overload, sample.invalid), ([0; 6], false, true));
}

#[test]
fn a_sensor_zeroes_itself_only_if_it_is_told_to() {
    let tilted = [100_000, 0, -200_000, 0, 0, 7_000_000];
    for (zeroes, counts) in [(false, tilted), (true, [0; 6])] {
        for of in [floats(), shipped_profile("ati-ethercat")] {
            let start = SensorStart { zeroes, ..SensorStart::default() };
            let mut bench = bench(of.clone(), start, of);
            device(&mut bench).measure(tilted);
            bench.start().unwrap();
            bench.cycles(3, &REST);
            assert_eq!(bench.cycle(&REST).sample.unwrap().counts, counts);
        }
    }
}

#[test]
fn another_sensor_is_refused_by_identity_process_data_or_counts_per_unit() {
    let start = SensorStart::default();
    let (usual, short) = (shipped_profile("ati-ethercat"), shipped_profile("ati-ethercat-28-bytes"));
    assert_eq!(
        refused(usual.clone(), start, floats()),
        "wrist (position 2): check its identity: the vendor is 0xffff5958 and should be 0x732"
    );
    assert_eq!(
        refused(short.clone(), start, usual.clone()),
        "wrist (position 2): check its identity: the revision is 0x1 and should be 0x10111"
    );
    let layout = refused(usual, start, short.clone());
    assert!(layout.starts_with("wrist (position 2): map the process data") && layout.contains("1A00h:0"), "{layout}");
    // The device has a million counts per N and per N m.
    let scaled = text("profiles/ati-ethercat-28-bytes.yaml").replace(
        "    zero:",
        "    scaling:\n      objects:\n        per_n: {index: 0x2040, sub: 49, bits: 32, source: drivers}\n        per_n_m: {index: 0x2040, \
         sub: 50, bits: 32, source: drivers}\n    zero:",
    );
    let by = |counts_per_unit| SensorStart { counts_per_unit, ..start };
    for near in [[1e6, 1e6], [0.95e6, 1.05e6]] {
        bench(profile(scaled.clone()), by(near), short.clone()).start().unwrap();
    }
    let message = refused(profile(scaled), by([1e6, 1e3]), short);
    assert_eq!(
        message,
        "wrist (position 2): compare its counts per unit: object 2040h:50 holds 1000000 counts per unit, and `sensor.calibration` \
         has 1000: calibrate for 1000000, or set the unit with the vendor's tool"
    );
}

/// A mapping that can be written is written, over two process data objects with gaps.
#[test]
fn process_data_of_two_objects_with_gaps_are_mapped() {
    let two = text("vendors/profiles/float-sensor.yaml").replace(
        "            - tx\n",
        "        - number: 5\n          maps:\n            - gap: 8\n            - tx\n",
    );
    let mut bench = bench(profile(two.clone()), SensorStart::default(), profile(two));
    bench.start().unwrap();
    let counts = [1_000_000, 2_000_000, 3_000_000, 4_000_000, 5_000_000, 6_000_000];
    device(&mut bench).measure(counts);
    bench.cycles(3, &REST);
    assert_eq!(bench.cycle(&REST).sample.unwrap().counts, counts);
}
