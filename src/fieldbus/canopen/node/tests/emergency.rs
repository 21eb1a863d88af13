//! Emergencies: sent, remembered, cleared.

use super::*;

#[test]
fn emergencies_are_sent_once_remembered_and_cleared() {
    let mut device = booted();
    let mut out = Vec::new();
    let voltage = ErrorRegister(ErrorRegister::VOLTAGE);
    device.node.raise_emergency(&mut device.app.od, EmcyCode(0x3210), voltage, [0; 5], &mut out);
    device.node.raise_emergency(&mut device.app.od, EmcyCode(0x3210), voltage, [0; 5], &mut out);
    device.node.raise_emergency(
        &mut device.app.od,
        EmcyCode::FOLLOWING_ERROR,
        ErrorRegister(0x20),
        [1, 2, 3, 4, 5],
        &mut out,
    );
    device.node.clear_emergency(&mut device.app.od, EmcyCode(0x3210), &mut out);
    device.node.clear_emergency(&mut device.app.od, EmcyCode(0x3210), &mut out);
    device.node.clear_all_emergencies(&mut device.app.od, &mut out);
    device.node.clear_all_emergencies(&mut device.app.od, &mut out);
    let expected = [
        [0x10, 0x32, 0x05, 0, 0, 0, 0, 0],
        [0x11, 0x86, 0x25, 1, 2, 3, 4, 5],
        [0, 0, 0x21, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 0, 0],
    ];
    assert_eq!(Device::emergencies(&out), expected);
    assert_eq!([0, 1, 2, 3].map(|sub| device.value(0x1003, sub)), [2, 0x0201_8611, 0x3210, 0]);
    let read = |sub| [0x40, 0x03, 0x10, sub, 0, 0, 0, 0];
    assert_eq!(device.take(0x603, &read(2))[0].data(), [0x43, 0x03, 0x10, 2, 0x10, 0x32, 0, 0]);
    assert_eq!(device.take(0x603, &read(3))[0].data(), [0x80, 0x03, 0x10, 3, 0x24, 0, 0, 0x08]);
    assert_eq!(device.write(0x1003, 0, &[1]), Err(AbortCode(0x0609_0030)));
    assert_eq!(device.write(0x1003, 0, &[0]), Ok(()));
    assert_eq!([0, 1, 2].map(|sub| device.value(0x1003, sub)), [0; 3]);
}

#[test]
fn history_keeps_the_latest_eight() {
    let mut device = booted();
    for code in 0..20 {
        let mut out = Vec::new();
        device.node.raise_emergency(&mut device.app.od, EmcyCode(0xff00 + code), ErrorRegister(0x80), [0; 5], &mut out);
        assert_eq!(out.len(), 1);
    }
    assert_eq!((device.value(0x1003, 0), device.value(0x1003, 1), device.value(0x1003, 8)), (8, 0xff13, 0xff0c));
}

#[test]
fn emergencies_are_not_sent_when_stopped_or_switched_off() {
    let mut device = booted();
    let mut out = Vec::new();
    assert_eq!(device.write_u32(0x1014, 0, 0x0a0), Err(AbortCode(0x0609_0030)));
    device.write_u32(0x1014, 0, 0x8000_0083).unwrap();
    device.node.raise_emergency(&mut device.app.od, EmcyCode::GENERIC, ErrorRegister(0), [0; 5], &mut out);
    assert_eq!((out.len(), device.value(0x1001, 0)), (0, 1));
    device.write_u32(0x1014, 0, 0x0a0).unwrap();
    device.node.clear_all_emergencies(&mut device.app.od, &mut out);
    assert_eq!(out, [Frame::new(0x0a0, &[0; 8])]);
    device.take(0, &[2, 3]);
    device.node.raise_emergency(&mut device.app.od, EmcyCode::GENERIC, ErrorRegister(0), [0; 5], &mut out);
    assert_eq!((out.len(), device.value(0x1001, 0)), (1, 1));
}
