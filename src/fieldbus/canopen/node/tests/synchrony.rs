//! The synchronous window and the SYNC counter of a device.

use super::*;

#[test]
fn set_points_after_the_synchronous_window_wait_for_the_next_cycle() {
    let mut device = operational();
    device.write_u32(0x1007, 0, 2000).unwrap();
    let setpoint = |value: u8| [0, 0, value, 0, 0, 0];
    // Before the first SYNC there is no window.
    device.at(0, (0x203, &setpoint(1)));
    device.at(10, SYNC);
    assert_eq!(device.value(0x607a, 0), 1);
    device.at(12, (0x203, &setpoint(2)));
    device.at(20, SYNC);
    assert_eq!(device.value(0x607a, 0), 2);
    device.at(23, (0x203, &setpoint(3)));
    device.at(30, SYNC);
    assert_eq!(device.value(0x607a, 0), 2);
    // Event-driven ones do not care.
    device.write(0x1400, 2, &[255]).unwrap();
    device.at(39, (0x203, &setpoint(4)));
    assert_eq!(device.value(0x607a, 0), 4);
}

#[test]
fn set_points_outside_the_window_do_not_hold_off_the_deadline() {
    let mut device = operational();
    device.write_u32(0x1007, 0, 2000).unwrap();
    device.write(0x1400, 5, &[15, 0]).unwrap();
    device.at(10, SYNC);
    device.at(11, (0x203, &[0; 6]));
    device.at(20, SYNC);
    device.at(25, (0x203, &[0; 6]));
    assert_eq!(Device::emergencies(&device.poll(26)), [[0x50, 0x82, 0x11, 1, 0, 0, 0, 0]]);
}

#[test]
fn a_sync_of_the_wrong_length_is_reported_once_and_does_nothing() {
    let mut device = operational();
    device.write(0x1019, 0, &[10]).unwrap();
    device.log();
    let report = [[0x40, 0x82, 0x11, 0, 0, 0, 0, 0]];
    assert_eq!(Device::emergencies(&device.at(0, SYNC)), report);
    assert_eq!((device.at(1, SYNC), device.log()), (vec![], vec![]));
    let frames = device.at(2, (0x080, &[1]));
    assert_eq!((Device::emergencies(&frames), frames.len()), (vec![[0; 8]], 2));
    assert_eq!(Device::emergencies(&device.at(3, (0x080, &[1, 2]))), report);
}

#[test]
fn the_counter_overflow_has_its_range_and_is_fixed_while_a_cycle_is_set() {
    let mut device = booted();
    assert_eq!(device.write(0x1019, 0, &[1]), Err(AbortCode(0x0609_0030)));
    assert_eq!(device.write(0x1019, 0, &[241]), Err(AbortCode(0x0609_0031)));
    device.write(0x1019, 0, &[240]).unwrap();
    device.write_u32(0x1006, 0, 1000).unwrap();
    assert_eq!(device.write(0x1019, 0, &[0]), Err(AbortCode(0x0800_0022)));
    assert_eq!(device.write(0x1019, 0, &[240]), Ok(()));
}
