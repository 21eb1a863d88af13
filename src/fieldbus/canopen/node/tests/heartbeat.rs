//! Heartbeats: its own, and those that it watches.

use super::*;

#[test]
fn heartbeat_keeps_to_its_grid_and_tells_the_state() {
    let mut device = booted();
    device.write_at(10, 0x1017, 0, &[100, 0]).unwrap();
    assert_eq!(device.node.next_deadline(), Time(110 * MS));
    assert_eq!(device.poll(109), []);
    assert_eq!(device.poll(113), [Frame::new(0x703, &[0x7f])]);
    assert_eq!(device.node.next_deadline(), Time(210 * MS));
    device.at(200, (0, &[1, 3]));
    assert_eq!(device.poll(210), [Frame::new(0x703, &[0x05])]);
    device.at(300, (0, &[2, 3]));
    assert_eq!(device.poll(310), [Frame::new(0x703, &[0x04])]);
    // After a long pause one heartbeat, not a burst.
    assert_eq!(device.poll(1000).len(), 1);
    assert_eq!((device.poll(1001), device.node.next_deadline()), (vec![], Time(1100 * MS)));
}

fn watching_127() -> Device {
    let mut device = operational();
    device.write_u32(0x1016, 1, 127 << 16 | 50).unwrap();
    assert_eq!(device.poll(500), []);
    assert_eq!(device.at(1000, (0x77f, &[5])), []);
    device.log();
    device
}

#[test]
fn a_lost_heartbeat_gives_an_emergency_and_leaves_operational() {
    let mut device = watching_127();
    assert_eq!(device.poll(1049), []);
    assert_eq!(device.poll(1050), [Frame::new(0x083, &[0x30, 0x81, 0x11, 127, 0, 0, 0, 0])]);
    assert_eq!(device.log(), ["PreOperational", "heartbeat of 127 Lost"]);
    assert_eq!((device.value(0x1001, 0), device.value(0x1003, 1)), (0x11, 0x007f_8130));
    assert_eq!(device.at(1200, (0x77f, &[5])), [Frame::new(0x083, &[0; 8])]);
    assert_eq!(device.value(0x1001, 0), 0);
    assert_eq!(device.log(), ["heartbeat of 127 Present(Operational)"]);
}

#[test]
fn configuring_the_watch_anew_clears_its_errors() {
    let mut device = watching_127();
    device.poll(1050);
    let request = [0x23, 0x16, 0x10, 1, 0, 0, 0, 0];
    assert_eq!(Device::emergencies(&device.at(1060, (0x603, &request))), [[0; 8]]);
    assert_eq!((device.value(0x1001, 0), device.poll(9000)), (0, vec![]));
}

#[test]
fn error_behaviour_decides_what_a_lost_heartbeat_does() {
    for (behaviour, state) in [(0, NmtState::PreOperational), (1, NmtState::Operational), (2, NmtState::Stopped)] {
        let mut device = watching_127();
        device.write_at(1000, 0x1029, 1, &[behaviour]).unwrap();
        assert_eq!(device.poll(1050).len(), 1);
        assert_eq!(device.node.state(), state);
    }
    assert_eq!(booted().write(0x1029, 1, &[3]), Err(AbortCode(0x0609_0031)));
}

#[test]
fn several_producers_are_watched_but_none_twice() {
    let mut device = booted();
    assert_eq!(device.write_u32(0x1016, 1, 127 << 16 | 50), Ok(()));
    assert_eq!(device.write_u32(0x1016, 2, 126 << 16 | 100), Ok(()));
    assert_eq!(device.write_u32(0x1016, 3, 127 << 16 | 70), Err(AbortCode(0x0604_0043)));
    assert_eq!(device.write_u32(0x1016, 3, 200 << 16 | 70), Err(AbortCode(0x0609_0030)));
    assert_eq!(device.write_u32(0x1016, 1, 127 << 16 | 60), Ok(()));
    assert_eq!(device.write_u32(0x1016, 5, 0), Err(AbortCode(0x0609_0011)));
    device.at(0, (0x77f, &[5]));
    device.at(0, (0x77e, &[5]));
    assert_eq!(Device::emergencies(&device.poll(60)), [[0x30, 0x81, 0x11, 127, 0, 0, 0, 0]]);
    assert_eq!(Device::emergencies(&device.poll(100)), [[0x30, 0x81, 0x11, 126, 0, 0, 0, 0]]);
    // One back, one still lost: the register keeps its bits.
    assert_eq!(Device::emergencies(&device.at(110, (0x77f, &[5]))), [[0, 0, 0x11, 0, 0, 0, 0, 0]]);
}
