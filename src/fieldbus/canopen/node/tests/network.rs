//! Node guarding, TIME, LSS, and parameters that survive a reset.

use super::*;

fn ask(device: &mut Device, ms: u64) -> Vec<Frame> {
    let mut out = Vec::new();
    device.node.on_frame(Time(ms * MS), &Frame::remote(0x703, 1), &mut device.app, &mut out);
    out
}

// Node guarding.

#[test]
fn a_guarded_device_answers_with_an_alternating_bit() {
    let mut device = booted();
    assert_eq!(ask(&mut device, 0), [Frame::new(0x703, &[0x7f])]);
    assert_eq!(ask(&mut device, 1), [Frame::new(0x703, &[0xff])]);
    device.take(0, &[1, 3]);
    assert_eq!(ask(&mut device, 2), [Frame::new(0x703, &[0x05])]);
    device.take(0, &[0x82, 3]);
    assert_eq!(ask(&mut device, 3), [Frame::new(0x703, &[0x7f])]);
    // Other identifiers are not sent on request, and a device with a heartbeat is not guarded.
    let mut out = Vec::new();
    device.node.on_frame(Time(0), &Frame::remote(0x183, 6), &mut device.app, &mut out);
    device.node.on_frame(Time(0), &Frame::remote(0x080, 0), &mut device.app, &mut out);
    assert_eq!(out, []);
    device.write(0x1017, 0, &[100, 0]).unwrap();
    assert_eq!(ask(&mut device, 4), []);
}

#[test]
fn a_device_that_is_not_asked_any_more_takes_it_for_a_lost_master() {
    let mut device = operational();
    device.write(0x100c, 0, &[100, 0]).unwrap();
    device.write(0x100d, 0, &[3]).unwrap();
    assert_eq!(device.poll(5000), []);
    ask(&mut device, 5000);
    device.log();
    assert_eq!((device.node.next_deadline(), device.poll(5299)), (Time(5300 * MS), vec![]));
    assert_eq!(device.poll(5300), [Frame::new(0x083, &[0x30, 0x81, 0x11, 0, 0, 0, 0, 0])]);
    assert_eq!(device.log(), ["PreOperational", "guarding lost true"]);
    assert_eq!(device.poll(9000), []);
    let answer = [Frame::new(0x703, &[0xff]), Frame::new(0x083, &[0; 8])];
    assert_eq!(ask(&mut device, 9000), answer);
    assert_eq!(device.log(), ["guarding lost false"]);
}

// TIME.

#[test]
fn time_reaches_a_consumer_only() {
    let mut device = booted();
    let noon: (u16, &[u8]) = (0x100, &[0x00, 0x2e, 0x93, 0x02, 0x01, 0x00]);
    device.at(0, noon);
    assert_eq!(device.log(), [""; 0]);
    device.write_u32(0x1012, 0, 0x8000_0100).unwrap();
    device.log();
    device.at(0, noon);
    device.at(0, (0x100, &[0; 5]));
    assert_eq!(device.log(), ["day 1 ms 43200000"]);
    // A producer the device is not, and a restricted identifier.
    for bad in [0x4000_0100, 0x8000_0601] {
        assert_eq!(device.write_u32(0x1012, 0, bad), Err(AbortCode(0x0609_0030)));
    }
}

// LSS.

fn unconfigured() -> Device {
    let mut device = silent();
    device.node.forget_node_id();
    let mut out = Vec::new();
    device.node.boot(Time(0), &mut device.app, &mut out);
    assert_eq!((out, device.node.state()), (vec![], NmtState::Initialising));
    device.log();
    device
}

const ANSWER: u16 = 0x7e4;

#[test]
fn a_device_without_node_id_waits_for_lss_and_then_starts() {
    let mut device = unconfigured();
    assert_eq!(device.take(0x603, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]), []);
    assert_eq!(device.take(0, &[0x81, 0]), []);
    assert_eq!(device.take(0x7e5, &[0x4c, 0, 0, 0, 0, 0, 0, 0]), [Frame::new(ANSWER, &[0x50, 0, 0, 0, 0, 0, 0, 0])]);
    assert_eq!(device.take(0x7e5, &[0x04, 1, 0, 0, 0, 0, 0, 0]), []);
    assert_eq!(device.take(0x7e5, &[0x5e, 0, 0, 0, 0, 0, 0, 0]), [Frame::new(ANSWER, &[0x5e, 0xff, 0, 0, 0, 0, 0, 0])]);
    assert_eq!(device.take(0x7e5, &[0x11, 9, 0, 0, 0, 0, 0, 0]), [Frame::new(ANSWER, &[0x11, 0, 0, 0, 0, 0, 0, 0])]);
    assert_eq!(device.take(0x7e5, &[0x04, 0, 0, 0, 0, 0, 0, 0]), [Frame::new(0x709, &[0])]);
    assert_eq!((device.node.id().raw(), device.node.state()), (9, NmtState::PreOperational));
    // What follows the node id has moved with it.
    for (index, sub, value) in [(0x1014, 0, 0x089), (0x1200, 1, 0x609), (0x1400, 1, 0x209), (0x1801, 1, 0x8000_0289)] {
        assert_eq!(device.value(index, sub), value, "{index:X}h:{sub}");
    }
    assert_eq!(device.take(0x609, &[0x40, 0x17, 0x10, 0, 0, 0, 0, 0])[0].id(), 0x589);
    // It was not stored: power-off forgets it.
    let mut out = Vec::new();
    device.node.boot(Time(0), &mut device.app, &mut out);
    assert_eq!((out, device.node.state()), (vec![], NmtState::Initialising));
}

#[test]
fn a_stored_node_id_survives_power_off_and_a_new_one_applies_at_reset() {
    let mut device = booted();
    device.take(0x7e5, &[0x04, 1, 0, 0, 0, 0, 0, 0]);
    device.take(0x7e5, &[0x11, 9, 0, 0, 0, 0, 0, 0]);
    assert_eq!(device.take(0x7e5, &[0x17, 0, 0, 0, 0, 0, 0, 0]), [Frame::new(ANSWER, &[0x17, 0, 0, 0, 0, 0, 0, 0])]);
    assert_eq!(device.take(0x7e5, &[0x04, 0, 0, 0, 0, 0, 0, 0]), []);
    assert_eq!(device.node.id().raw(), 3);
    assert_eq!(device.take(0, &[0x82, 3]), [Frame::new(0x709, &[0])]);
    let mut out = Vec::new();
    device.node.boot(Time(0), &mut device.app, &mut out);
    assert_eq!(out, [Frame::new(0x709, &[0])]);
}

#[test]
fn bit_timing_reaches_the_device() {
    let mut device = booted();
    device.take(0x7e5, &[0x04, 1, 0, 0, 0, 0, 0, 0]);
    device.log();
    for (table, index, error) in [(0, 5, 1), (1, 0, 1), (0, 9, 1), (0, 2, 0)] {
        let answer = device.take(0x7e5, &[0x13, table, index, 0, 0, 0, 0, 0]);
        assert_eq!(answer, [Frame::new(ANSWER, &[0x13, error, 0, 0, 0, 0, 0, 0])]);
    }
    assert_eq!(device.take(0x7e5, &[0x15, 0xe8, 0x03, 0, 0, 0, 0, 0]), []);
    assert_eq!(device.log(), ["500000 bit/s after 1s"]);
}

// Parameters.

#[test]
fn stored_parameters_survive_a_reset_and_restored_ones_come_back_with_it() {
    let mut device = booted();
    device.write(0x1017, 0, &[100, 0]).unwrap();
    device.write_u32(0x607a, 0, 77).unwrap();
    assert_eq!(device.write_u32(0x1010, 1, 0x6576_6173), Ok(()));
    device.write(0x1017, 0, &[50, 0]).unwrap();
    device.take(0, &[0x81, 3]);
    // Process data is no parameter.
    assert_eq!((device.value(0x1017, 0), device.value(0x607a, 0)), (100, 0));
    let mut out = Vec::new();
    device.node.boot(Time(0), &mut device.app, &mut out);
    assert_eq!(device.value(0x1017, 0), 100);

    assert_eq!(device.write_u32(0x1011, 1, 0x6461_6f6c), Ok(()));
    assert_eq!(device.value(0x1017, 0), 100);
    device.take(0, &[0x81, 3]);
    assert_eq!(device.value(0x1017, 0), 0);
}

#[test]
fn a_wrong_signature_stores_and_restores_nothing() {
    let mut device = booted();
    device.write(0x1017, 0, &[100, 0]).unwrap();
    for (index, signature) in [(0x1010, 0x6461_6f6c), (0x1011, 0x6576_6173), (0x1010, 1)] {
        assert_eq!(device.write_u32(index, 1, signature), Err(AbortCode(0x0800_0020)));
    }
    assert_eq!((device.value(0x1010, 1), device.value(0x1011, 1)), (1, 1));
    device.take(0, &[0x82, 3]);
    assert_eq!(device.value(0x1017, 0), 0);
}
