//! Frames and devices of an EtherCAT segment.

use super::super::Ending::{self, GoesOn};
use super::super::Lasts::{For, Once};
use super::super::Target::{Bus, LeftDrive, RightDrive, Sensor};
use super::super::{CatalogueRow, Expected, Kind, Lasts, Medium, Recovery, Target};
use super::{ANY, LOST, STOPPED, STOPPED_OR_LOST, sized};
use Recovery::{Reset, Restart};
use yieldwall_motion::guard::Fault as F;
use yieldwall_motion::guard::Reaction::{self, Count, QuickStop, StopRamp};

const DEVICES: &[Target] = &[LeftDrive, RightDrive, Sensor];
/// Devices whose clocks the cycles follow.
const DRIVES: &[Target] = &[LeftDrive, RightDrive];
/// Another master is named, and the devices leave OP.
const INTRUDED: (Reaction, Ending, Recovery) = (QuickStop, STOPPED, Restart);
/// Size of a write to a register.
const REGISTERS: &str = "a register: 0 for 0420h, 1 for 0400h, 2 for 0010h";
/// The rig goes on.
const NOTHING: (Reaction, Ending, Recovery) = (Count, GoesOn, Recovery::None);

const fn row(
    (kind, name): (Kind, &'static str),
    targets: &'static [Target],
    lasts: Lasts,
    meaning: &'static str,
    faults: &'static [F],
    (reaction, ending, recovery): (Reaction, Ending, Recovery),
) -> CatalogueRow {
    let expected = Expected { faults, reaction, ending, recovery };
    let media = &[Medium::Ethercat];
    CatalogueRow { kind, name, meaning, matrix: &[], targets, media, lasts, size: None, expected, on_ethercat: None }
}

pub(super) const ROWS: [CatalogueRow; 15] = [
    row(
        (Kind::FrameLost, "frame-lost"),
        &[Bus],
        For(0.02),
        "frames are lost on the way to the first device",
        &[F::PdoMissed, F::SensorStale, F::SensorLost, F::DeviceState],
        (StopRamp, STOPPED_OR_LOST, Restart),
    ),
    sized(
        row(
            (Kind::FrameDelayed, "frame-delayed"),
            &[Bus],
            For(0.1),
            "frames come back late",
            &[F::PdoLate, F::PdoMissed, F::SensorStale, F::SensorLost],
            (StopRamp, STOPPED, Reset),
        ),
        "a delay in s",
        0.0006,
        (0.0, 0.05),
    ),
    row(
        (Kind::FrameDuplicated, "frame-duplicated"),
        &[Bus],
        For(0.1),
        "frames come back twice",
        &[F::PdoDuplicated],
        (StopRamp, STOPPED, Reset),
    ),
    row(
        (Kind::FrameForeign, "frame-foreign"),
        &[Bus],
        For(0.02),
        "a foreign EtherCAT frame arrives before each frame of the master",
        &[F::Intruder],
        INTRUDED,
    ),
    row(
        (Kind::FrameShort, "frame-short"),
        &[Bus],
        For(0.02),
        "frames come back without the last byte of their last working counter",
        &[F::PdoMissed, F::SensorStale, F::SensorLost, F::PdoLate],
        (StopRamp, STOPPED, Reset),
    ),
    sized(
        row(
            (Kind::FrameCorrupt, "frame-corrupt"),
            &[Bus],
            For(0.02),
            "random bits of the datagrams flip on the way back, as if nobody checked the frame check sequence",
            &[
                F::PdoMissed,
                F::SensorInvalid,
                F::SensorSaturated,
                F::SensorStale,
                F::SensorLost,
                F::PdoLate,
                F::DeviceState,
                F::ClockLost,
                F::EncoderJump,
                F::Posture,
                F::FollowingError,
                F::Runaway,
                F::DriveFault,
                F::DriveVoltageOff,
                F::DriveLeftOperation,
                F::DriveIgnoresCommand,
                F::DriveWarning,
                F::Intruder,
                F::ForceStep,
                F::ForceLimit,
                F::ForceImplausible,
                F::PortErrors,
            ],
            (QuickStop, ANY, Restart),
        ),
        "a number of bits",
        8.0,
        (1.0, 48.0),
    ),
    row(
        (Kind::DeviceBypassed, "device-bypassed"),
        DEVICES,
        For(0.1),
        "the device forwards frames without processing them: working counters are too small",
        &[F::PdoMissed, F::SensorStale, F::SensorLost, F::ClockLost, F::DeviceState],
        (StopRamp, STOPPED_OR_LOST, Restart),
    ),
    row(
        (Kind::MailboxStuck, "mailbox-stuck"),
        DEVICES,
        For(1.0),
        "the device does not answer its mailbox",
        &[],
        NOTHING,
    ),
    sized(
        row(
            (Kind::DeviceState, "device-state"),
            DEVICES,
            Once,
            "the device leaves OP with an error (AL status code)",
            &[F::DeviceState],
            (QuickStop, LOST, Restart),
        ),
        "an AL status code, such as 26 (001Ah)",
        26.0,
        (1.0, 65_535.0),
    ),
    sized(
        row(
            (Kind::ClockJump, "clock-jump"),
            DRIVES,
            Once,
            "the clock of the device jumps",
            &[F::ClockLost],
            (QuickStop, LOST, Restart),
        ),
        "a time in ns",
        1_000_000.0,
        (-1.0e9, 1.0e9),
    ),
    row(
        (Kind::EmergencyInSdo, "emergency-in-sdo"),
        DRIVES,
        For(3.0),
        "the drive sends an emergency between the next SDO request and its answer, for example the read-back of a limit",
        &[F::Emergency],
        (QuickStop, STOPPED, Reset),
    ),
    row(
        (Kind::ForeignOutputs, "foreign-outputs"),
        &[Bus],
        For(0.02),
        "after each output frame a frame with the master's source address sets other targets",
        &[F::Intruder],
        INTRUDED,
    ),
    row(
        (Kind::ReplayedOutputs, "replayed-outputs"),
        &[Bus],
        For(0.02),
        "after each output frame an older output frame is sent again",
        &[F::Intruder],
        INTRUDED,
    ),
    sized(
        row(
            (Kind::ForeignRegisterWrite, "foreign-register-write"),
            &[Bus],
            For(0.02),
            "after each output frame a frame with the master's source address writes to a register of a device",
            &[F::Intruder],
            INTRUDED,
        ),
        REGISTERS,
        0.0,
        (0.0, 2.0),
    ),
    sized(
        row(
            (Kind::HiddenRegisterWrite, "hidden-register-write"),
            DRIVES,
            Once,
            "a foreign node writes to a register of the drive with a frame that the master does not receive; found within 1 s",
            // The address of the reference clock is that of the cycle's own datagram.
            &[F::Intruder, F::ClockLost],
            (QuickStop, STOPPED_OR_LOST, Restart),
        ),
        REGISTERS,
        0.0,
        (0.0, 2.0),
    ),
];
