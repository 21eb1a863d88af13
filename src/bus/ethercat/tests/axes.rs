//! A device of three axes, of which the rig uses the third as its left drive and the first as its right one.

use std::sync::Arc;

use super::*;
use crate::ethercat::station::Station;
use crate::script::Action;
use yieldwall_drives::profiles::{DeviceProfile, Fieldbus};

fn axis(device: Device, axis: u8, rank: u8) -> StationSetup {
    let profile = yieldwall_config::load_profile(yieldwall_config::builtin("vendors/profiles/three-axes.yaml"));
    let profile: Arc<DeviceProfile> = Arc::new(profile.unwrap().value);
    let drive = SegmentDrive {
        name: if device == Device::LeftDrive { "left" } else { "right" }.to_owned(),
        device,
        position: 0,
        profile: profile.of_axis(axis, rank, Fieldbus::Ethercat),
        waits: waits(),
        torque_limit_per_mille: 500,
        speed_limit_counts_per_s: 100_000,
        following_error_counts: 10_000,
        homing: None,
    };
    drive.station(CommandMode::Torque, PERIOD, Acts::AtSync0).unwrap()
}

fn both() -> StationSetup {
    axis(Device::RightDrive, 0, 0).with_axis(axis(Device::LeftDrive, 2, 1))
}

#[test]
fn axes_of_a_device_are_one_boot_and_one_assignment() {
    let setup = both();
    assert_eq!((setup.name.as_str(), setup.devices), ("right and left", DeviceSet::DRIVES));
    assert_eq!((setup.output_bytes(), setup.input_bytes()), (2 * 4, 2 * 6));
    let steps = setup.script();
    let last = |index: u16, sub: u8| {
        let of = steps.iter().filter(|step| (step.index, step.sub) == (index, sub));
        of.map(|step| step.action).next_back()
    };
    let state = |value| Some(Action::State { value, kept: 0 });
    assert_eq!([last(0x1c12, 0), last(0x1c12, 1), last(0x1c12, 2)], [state(2), state(0x1600), state(0x1620)]);
    assert_eq!([last(0x1c13, 0), last(0x1c13, 1), last(0x1c13, 2)], [state(2), state(0x1a00), state(0x1a20)]);
    assert_eq!([last(0x1620, 1), last(0x1620, 2)], [state(0x7040_0010), state(0x7071_0010)]);
    assert_eq!([last(0x1a20, 1), last(0x1a20, 2)], [state(0x7041_0010), state(0x7064_0020)]);
    let count = |index: u16| steps.iter().filter(|step| (step.index, step.sub) == (index, 0)).count();
    assert_eq!([0x1000, 0x6072, 0x6872, 0x7072, 0x2200, 0x2300, 0x2400].map(count), [1, 1, 0, 1, 1, 0, 1]);
}

#[test]
fn each_drive_has_its_part_of_the_process_data() {
    let mut station = Station::new(&both()).unwrap();
    let order = |controlword, target| DriveOrders { controlword, target, releases: false };
    let mut outputs = [0; 8];
    station.put_outputs(&[order(0x0f, -2), order(0x06, 0x0102)], &mut outputs);
    // The first axis is the right drive.
    assert_eq!(outputs, [0x06, 0, 0x02, 0x01, 0x0f, 0, 0xfe, 0xff]);
    let inputs = [0x37, 0x02, 1, 0, 0, 0, 0x50, 0x02, 0xff, 0xff, 0xff, 0xff];
    station.take_inputs(Time(0), &inputs);
    let words: Vec<_> = station.words().map(|(joint, words)| (joint, words.statusword, words.position)).collect();
    assert_eq!(words, [(0, Some(0x0250), Some(-1)), (1, Some(0x0237), Some(1))]);
    assert_eq!(station.miss_outputs(), DeviceSet::DRIVES);
}
