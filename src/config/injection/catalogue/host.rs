//! The person, the computer and its interface.

use super::super::Ending::DrivesStop;
use super::super::Lasts::{For, Once, Stays};
use super::super::Recovery::{NewProcess, Reset, Restart};
use super::super::Target::{Drives, Host, LeftDrive, Link, Operator, RightDrive, Sensor};
use super::super::{CatalogueRow, Kind, Target};
use super::{DISABLED, LOST, STOPPED, cut_off_on_ethercat, on_any, row, sized};
use yieldwall_motion::guard::Fault as F;
use yieldwall_motion::guard::Reaction::{QuickStop, Silence, StopRamp};

/// The master's interfaces: all, or those to the bus of a device.
const LINKS: [Target; 5] = [Link, LeftDrive, RightDrive, Drives, Sensor];

pub(super) const ROWS: [CatalogueRow; 14] = [
    on_any(row(
        (Kind::StopRequest, "stop-request"),
        &[],
        &[Operator],
        Once,
        "the operator requests a stop",
        &[F::StopRequested],
        (StopRamp, STOPPED, Reset),
    )),
    on_any(sized(
        row(
            (Kind::SyncLate, "sync-late"),
            &[9],
            &[Host],
            For(0.1),
            "every second cycle SYNC leaves late",
            &[F::SyncJitter],
            (StopRamp, STOPPED, Reset),
        ),
        "a time in s",
        0.000_25,
        (0.0, 0.01),
    )),
    on_any(sized(
        row(
            (Kind::ComputeLate, "compute-late"),
            &[29],
            &[Host],
            For(0.1),
            "every second cycle the computation begins late; grid points in this time are skipped",
            &[F::Overrun],
            (StopRamp, STOPPED, Reset),
        ),
        "a time in s",
        0.000_55,
        (0.0, 0.01),
    )),
    on_any(sized(
        row(
            (Kind::CycleOverrun, "cycle-overrun"),
            &[28],
            &[Host],
            For(0.1),
            "every second cycle takes long to compute; grid points in this time are skipped",
            &[F::Overrun],
            (StopRamp, STOPPED, Reset),
        ),
        "a time in s",
        0.0006,
        (0.0, 0.01),
    )),
    on_any(row(
        (Kind::MasterStopped, "master-stopped"),
        &[26],
        &[Host],
        For(0.003),
        "the process is suspended; it continues at the end, with all waiting frames",
        &[F::Stalled],
        (QuickStop, STOPPED, Reset),
    )),
    on_any(row(
        (Kind::MasterKilled, "master-killed"),
        &[25],
        &[Host],
        Stays,
        "the process is killed and does not return",
        &[],
        (Silence, DrivesStop, NewProcess),
    )),
    on_any(row(
        (Kind::CyclePanic, "cycle-panic"),
        &[27],
        &[Host],
        Once,
        "the cycle panics while it sends its frames; the last frame is a quick stop",
        &[F::CyclePanicked],
        (QuickStop, DISABLED, NewProcess),
    )),
    on_any(row(
        (Kind::Suspend, "suspend"),
        &[30],
        &[Host],
        For(0.003),
        "the computer is suspended, and its monotonic clock stops",
        &[F::Suspended],
        (StopRamp, STOPPED, Reset),
    )),
    on_any(row(
        (Kind::SendFailed, "send-failed"),
        &[8],
        &LINKS,
        For(0.02),
        "sending fails with an error; receiving works",
        &[F::LinkDown],
        (Silence, LOST, Restart),
    )),
    on_any(row(
        (Kind::InterfaceDown, "interface-down"),
        &[23],
        &LINKS,
        For(0.2),
        "the interface is down: no frame goes in or out, and sending returns an error",
        &[F::LinkDown, F::PdoMissed, F::HeartbeatLost],
        (Silence, LOST, Restart),
    )),
    row(
        (Kind::BusOff, "bus-off"),
        &[21],
        &LINKS,
        For(0.2),
        "the controller goes bus-off: no frame goes in or out",
        &[F::BusOff, F::PdoMissed, F::HeartbeatLost],
        (Silence, LOST, Restart),
    ),
    row(
        (Kind::ErrorPassive, "error-passive"),
        &[22],
        &LINKS,
        For(0.02),
        "the controller is error-passive on a disturbed bus that still carries its frames",
        &[F::ErrorPassive],
        (Silence, LOST, Restart),
    ),
    row(
        (Kind::TransmitStalled, "transmit-stalled"),
        &[24],
        &LINKS,
        For(0.01),
        "the master's frames wait in its interface",
        &[F::TransmitStalled, F::PdoMissed],
        (Silence, LOST, Restart),
    ),
    cut_off_on_ethercat(row(
        (Kind::CableOut, "cable-out"),
        &[22],
        &LINKS,
        For(0.2),
        "the master's cable is unplugged: its frames wait unacknowledged, and no frame arrives",
        &[F::TransmitStalled, F::ErrorPassive, F::PdoMissed, F::HeartbeatLost],
        (Silence, LOST, Restart),
    )),
];
