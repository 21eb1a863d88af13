//! PDOs: when they are sent and when they apply.

use super::*;

#[test]
fn fault_11_synchronous_rpdos_apply_at_the_next_sync() {
    let mut device = operational();
    for target in [5u8, 9] {
        assert_eq!(device.take(0x203, &[0x0f, 0, target, 0, 0, 0]), []);
        assert_eq!((device.value(0x6040, 0), device.value(0x607a, 0)), (0, 0));
    }
    // The latest one counts; TPDOs are sampled after the device has reacted.
    assert_eq!(device.at(1, SYNC), [Frame::new(0x183, &[0x50, 0x02, 9, 0, 0, 0])]);
    assert_eq!(device.value(0x6040, 0), 0x0f);
    assert_eq!(device.log(), ["rpdo 1 target 9", "sync"]);
    device.at(2, SYNC);
    assert_eq!(device.log(), ["sync"]);
}

#[test]
fn every_synchronous_type_latches_and_event_driven_types_do_not() {
    for (transmission_type, latches) in [(0, true), (1, true), (240, true), (254, false), (255, false)] {
        let mut device = operational();
        device.write(0x1400, 2, &[transmission_type]).unwrap();
        device.log();
        device.take(0x203, &[0x0f, 0, 5, 0, 0, 0]);
        assert_eq!(device.value(0x607a, 0), if latches { 0 } else { 5 });
        assert_eq!(device.log().len(), usize::from(!latches));
        device.at(0, SYNC);
        assert_eq!(device.value(0x607a, 0), 5);
    }
}

#[test]
fn pdos_exist_in_operational_only() {
    let mut device = booted();
    device.take(0x203, &[0x0f, 0, 5, 0, 0, 0]);
    assert_eq!(device.at(0, SYNC), []);
    assert_eq!((device.value(0x607a, 0), device.log()), (0, vec!["sync".to_string()]));
    // What was latched before leaving Operational is not applied on return.
    device.take(0, &[1, 3]);
    device.take(0x203, &[0x0f, 0, 5, 0, 0, 0]);
    device.take(0, &[0x80, 3]);
    device.take(0, &[1, 3]);
    assert_eq!(device.at(0, SYNC), [Frame::new(0x183, &[0x50, 0x02, 0, 0, 0, 0])]);
}

#[test]
fn fault_10_a_tpdo_of_type_n_is_sent_at_every_nth_sync() {
    let mut device = operational();
    device.write(0x1800, 2, &[10]).unwrap();
    let sent: Vec<usize> = (1..=30).filter(|&ms| !device.at(ms, SYNC).is_empty()).map(|ms| ms as usize).collect();
    assert_eq!(sent, [10, 20, 30]);
}

#[test]
fn sync_start_value_aligns_tpdos_to_the_counter() {
    let mut device = booted();
    device.write_u32(0x1800, 1, 0x8000_0183).unwrap();
    device.write(0x1800, 2, &[2]).unwrap();
    device.write(0x1800, 6, &[3]).unwrap();
    device.write_u32(0x1800, 1, 0x183).unwrap();
    assert_eq!(device.write(0x1800, 6, &[4]), Err(AbortCode(0x0800_0022)));
    device.take(0, &[1, 3]);
    let sent: Vec<u8> = (1..=8).filter(|&count| !device.at(0, (0x080, &[count])).is_empty()).collect();
    assert_eq!(sent, [4, 6, 8]);
}

#[test]
fn type_0_is_sent_at_sync_when_the_value_changed_or_the_device_asks() {
    let mut device = operational();
    device.write(0x1800, 2, &[0]).unwrap();
    assert_eq!(device.at(0, SYNC).len(), 1);
    assert_eq!(device.at(0, SYNC).len(), 0);
    device.take(0x203, &[0, 0, 1, 0, 0, 0]);
    assert_eq!(device.at(0, SYNC), [Frame::new(0x183, &[0x50, 0x02, 1, 0, 0, 0])]);
    let mut out = Vec::new();
    device.node.trigger_tpdo(Time(0), 1, &device.app.od, &mut out);
    assert_eq!((out.len(), device.at(0, SYNC).len(), device.at(0, SYNC).len()), (0, 1, 0));
}

#[test]
fn event_driven_tpdos_obey_trigger_event_timer_and_inhibit_time() {
    let mut device = booted();
    device.write_u32(0x1800, 1, 0x8000_0183).unwrap();
    device.write(0x1800, 2, &[255]).unwrap();
    device.write(0x1800, 3, &[20, 0]).unwrap();
    device.write(0x1800, 5, &[10, 0]).unwrap();
    device.write_u32(0x1800, 1, 0x183).unwrap();
    assert_eq!(device.write(0x1800, 3, &[30, 0]), Err(AbortCode(0x0800_0022)));
    device.take(0, &[1, 3]);
    let mut out = Vec::new();
    // Timer at 10 and 20 ms, on its grid even if polled late.
    assert_eq!(device.node.next_deadline(), Time(10 * MS));
    assert_eq!((device.poll(9).len(), device.poll(11).len(), device.poll(12).len()), (0, 1, 0));
    assert_eq!((device.node.next_deadline(), device.poll(20).len()), (Time(20 * MS), 1));
    // A trigger within 2 ms waits; afterwards the timer runs from the triggered frame.
    device.node.trigger_tpdo(Time(21 * MS), 1, &device.app.od, &mut out);
    assert_eq!((out.len(), device.node.next_deadline()), (0, Time(22 * MS)));
    assert_eq!((device.poll(22).len(), device.node.next_deadline()), (1, Time(32 * MS)));
    device.node.trigger_tpdo(Time(25 * MS), 1, &device.app.od, &mut out);
    assert_eq!(out.len(), 1);
    device.node.trigger_tpdo(Time(28 * MS), 0, &device.app.od, &mut out);
    device.node.trigger_tpdo(Time(28 * MS), 5, &device.app.od, &mut out);
    device.take(0, &[0x80, 3]);
    device.node.trigger_tpdo(Time(30 * MS), 1, &device.app.od, &mut out);
    assert_eq!((out.len(), device.node.next_deadline()), (1, Time::NEVER));
}

#[test]
fn a_short_rpdo_is_dropped_with_one_emergency_until_a_good_one_comes() {
    let mut device = operational();
    assert_eq!(device.take(0x203, &[1, 2, 3]), [Frame::new(0x083, &[0x10, 0x82, 0x11, 1, 0, 0, 0, 0])]);
    assert_eq!(device.take(0x203, &[1, 2, 3, 4, 5]), []);
    device.at(0, SYNC);
    assert_eq!(device.value(0x6040, 0), 0);
    // Bytes beyond the mapping do not matter.
    assert_eq!(device.take(0x203, &[6, 0, 1, 0, 0, 0, 9, 9]), [Frame::new(0x083, &[0; 8])]);
    device.at(0, SYNC);
    assert_eq!((device.value(0x6040, 0), device.value(0x607a, 0)), (6, 1));
}

#[test]
fn an_rpdo_that_does_not_come_in_time_is_reported_once() {
    let mut device = operational();
    device.write(0x1400, 5, &[5, 0]).unwrap();
    device.log();
    assert_eq!(device.poll(100), []);
    device.at(100, (0x203, &[6, 0, 1, 0, 0, 0]));
    device.at(103, (0x203, &[6, 0, 1, 0, 0, 0]));
    assert_eq!((device.poll(105), device.poll(107)), (vec![], vec![]));
    assert_eq!(device.node.next_deadline(), Time(108 * MS));
    assert_eq!(device.poll(108), [Frame::new(0x083, &[0x50, 0x82, 0x11, 1, 0, 0, 0, 0])]);
    assert_eq!((device.poll(200), device.node.next_deadline()), (vec![], Time::NEVER));
    assert_eq!(device.log(), ["late rpdo 1"]);
    assert_eq!(device.at(201, (0x203, &[6, 0, 1, 0, 0, 0])), [Frame::new(0x083, &[0; 8])]);
    // Leaving Operational ends the watch.
    device.at(202, (0, &[0x80, 3]));
    assert_eq!((device.poll(1000), device.node.next_deadline()), (vec![], Time::NEVER));
}

#[test]
fn sync_identifier_is_configurable() {
    let mut device = operational();
    device.write_u32(0x1005, 0, 0x0c0).unwrap();
    assert_eq!((device.at(0, SYNC).len(), device.take(0x0c0, &[]).len()), (0, 1));
    let report = [[0x40, 0x82, 0x11, 0, 0, 0, 0, 0]];
    assert_eq!(Device::emergencies(&device.take(0x0c0, &[1, 2])), report);
    assert_eq!(device.write_u32(0x1005, 0, 0x4000_0080), Err(AbortCode(0x0609_0030)));
    assert_eq!(device.write_u32(0x1005, 0, 0x601), Err(AbortCode(0x0609_0030)));
}
