//! NMT: states and resets.

use super::*;

#[test]
fn is_silent_and_deaf_before_boot() {
    let mut device = silent();
    for frame in [(0, &[1, 3][..]), SYNC, (0x203, &[0; 6]), (0x603, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]), (0x705, &[5])] {
        assert_eq!(device.at(0, frame), []);
    }
    assert_eq!(device.poll(1_000_000), []);
    assert_eq!((device.node.state(), device.log().len()), (NmtState::Initialising, 0));
    assert_eq!(device.node.next_deadline(), Time::NEVER);
}

#[test]
fn commands_move_through_the_states() {
    let mut device = booted();
    let steps = [
        (&[0x01, 3][..], NmtState::Operational),
        (&[0x02, 3], NmtState::Stopped),
        (&[0x80, 0], NmtState::PreOperational),
        (&[0x01, 0], NmtState::Operational),
        (&[0x02, 4], NmtState::Operational),
        (&[0x03, 3], NmtState::Operational),
        (&[0x02], NmtState::Operational),
    ];
    for (data, state) in steps {
        assert_eq!(device.take(0, data), []);
        assert_eq!(device.node.state(), state);
    }
    assert_eq!(device.log(), ["Operational", "Stopped", "PreOperational", "Operational"]);
}

#[test]
fn resets_restore_values_and_boot_up_again() {
    let mut device = booted();
    device.write_u32(0x607a, 0, 77).unwrap();
    device.write(0x1017, 0, &[100, 0]).unwrap();
    device.take(0, &[1, 3]);
    device.log();
    assert_eq!(device.take(0, &[0x82, 3]), [Frame::new(0x703, &[0])]);
    assert_eq!(device.log(), ["reset Communication", "PreOperational"]);
    assert_eq!((device.value(0x1017, 0), device.value(0x607a, 0)), (0, 77));
    assert_eq!(device.node.next_deadline(), Time::NEVER);
    assert_eq!(device.take(0, &[0x81, 0]), [Frame::new(0x703, &[0])]);
    assert_eq!((device.value(0x607a, 0), device.node.state()), (0, NmtState::PreOperational));
}

#[test]
fn stopped_serves_no_sdo_and_no_sync() {
    let mut device = operational();
    device.take(0, &[2, 3]);
    device.log();
    assert_eq!(device.take(0x603, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]), []);
    assert_eq!(device.at(0, SYNC), []);
    assert_eq!(device.log(), [""; 0]);
}
