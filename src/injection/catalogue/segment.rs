//! Frames and devices of an EtherCAT segment that is served to a master.

use super::super::Lasts::{For, Once};
use super::super::Target::{Bus, LeftDrive, RightDrive, Sensor};
use super::super::{Ending, Expected, Kind, Lasts, Medium, Recovery, Row, Target};
use super::sized;
use crate::guard::Reaction;

const DEVICES: &[Target] = &[LeftDrive, RightDrive, Sensor];

const fn row(
    (kind, name): (Kind, &'static str),
    targets: &'static [Target],
    lasts: Lasts,
    meaning: &'static str,
) -> Row {
    let (reaction, ending, recovery) = (Reaction::Count, Ending::UpToMaster, Recovery::None);
    let expected = Expected { faults: &[], reaction, ending, recovery };
    Row { kind, name, meaning, matrix: &[], targets, media: &[Medium::Ethercat], lasts, size: None, expected }
}

pub(super) const ROWS: [Row; 11] = [
    row((Kind::FrameLost, "frame-lost"), &[Bus], For(0.02), "frames are lost on the way to the first device"),
    sized(
        row((Kind::FrameDelayed, "frame-delayed"), &[Bus], For(0.1), "frames come back late"),
        "a delay in s",
        0.0006,
        (0.0, 0.05),
    ),
    row((Kind::FrameDuplicated, "frame-duplicated"), &[Bus], For(0.1), "frames come back twice"),
    row(
        (Kind::FrameForeign, "frame-foreign"),
        &[Bus],
        For(0.02),
        "before each frame another one comes that the master has not sent, with the type of EtherCAT",
    ),
    row(
        (Kind::FrameShort, "frame-short"),
        &[Bus],
        For(0.02),
        "frames come back without the last byte of their last working counter",
    ),
    sized(
        row(
            (Kind::FrameCorrupt, "frame-corrupt"),
            &[Bus],
            For(0.02),
            "random bits of the datagrams are flipped on the way back, as where nobody looks at the check sequence",
        ),
        "a number of bits",
        8.0,
        (1.0, 48.0),
    ),
    row(
        (Kind::DeviceBypassed, "device-bypassed"),
        DEVICES,
        For(0.1),
        "the device passes frames on without processing them: working counters are short",
    ),
    row((Kind::MailboxStuck, "mailbox-stuck"), DEVICES, For(1.0), "the device does not answer its mailbox"),
    sized(
        row((Kind::DeviceState, "device-state"), DEVICES, Once, "the device leaves OP with an error (AL status code)"),
        "an AL status code, such as 26 (001Ah)",
        26.0,
        (1.0, 65_535.0),
    ),
    sized(
        row((Kind::ClockJump, "clock-jump"), DEVICES, Once, "the clock of the device jumps"),
        "a time in ns",
        1_000_000.0,
        (-1.0e9, 1.0e9),
    ),
    row(
        (Kind::EmergencyInSdo, "emergency-in-sdo"),
        DEVICES,
        Once,
        "the device sends an emergency between the next SDO request and its answer",
    ),
];
