//! Faults that are present from power-on.

use super::super::Ending::NotEnabled;
use super::super::Lasts::FromBoot;
use super::super::Recovery::{Reset, Restart};
use super::super::Target::{LeftDrive, Link, RightDrive, Sensor};
use super::super::{CatalogueRow, Kind};
use super::{ONE_DRIVE, on_any, row, sized};
use yieldwall_motion::guard::Fault as F;
use yieldwall_motion::guard::Reaction::{Count, QuickStop};

pub(super) const ROWS: [CatalogueRow; 6] = [
    row(
        (Kind::IdentityMismatch, "identity-mismatch"),
        &[36],
        &[LeftDrive, RightDrive, Sensor],
        FromBoot,
        "the device has another vendor id than configured",
        &[],
        (Count, NotEnabled, Restart),
    ),
    row(
        (Kind::ConfigDrift, "config-drift"),
        &[38],
        ONE_DRIVE,
        FromBoot,
        "the drive does not keep the torque limit written to it",
        &[],
        (Count, NotEnabled, Restart),
    ),
    row(
        (Kind::WrongNodeId, "wrong-node-id"),
        &[37],
        &[LeftDrive, RightDrive, Sensor],
        FromBoot,
        "the device has another node id than configured",
        &[],
        (Count, NotEnabled, Restart),
    ),
    on_any(sized(
        row(
            (Kind::EncoderOffset, "encoder-offset"),
            &[40],
            ONE_DRIVE,
            FromBoot,
            "the zero of the drive's encoder is wrong",
            &[F::Posture],
            (QuickStop, NotEnabled, Reset),
        ),
        "an angle in rad",
        -1.5,
        (-3.0, 3.0),
    )),
    on_any(row(
        (Kind::DriveNotEnabling, "drive-not-enabling"),
        &[19],
        ONE_DRIVE,
        FromBoot,
        "the drive does not follow its controlword to Operation Enabled",
        &[F::EnablingTimeout],
        (QuickStop, NotEnabled, Reset),
    )),
    row(
        (Kind::WrongBitRate, "wrong-bit-rate"),
        &[21, 22],
        &[LeftDrive, RightDrive, Sensor, Link],
        FromBoot,
        "the device or the master's interface has the wrong bit rate: its frames are errors to the other nodes, and it acknowledges \
         nothing",
        &[],
        (Count, NotEnabled, Restart),
    ),
];
