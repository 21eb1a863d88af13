//! The catalogue of injections.

use super::Ending::{DrivesStop, GoesOn, Latched, NotEnabled};
use super::Lasts::{For, FromBoot, Once, Stays};
use super::Recovery::{NewProcess, None as Nothing, Reset, Restart};
use super::Target::{Bus, Drives, Hand, Host, LeftDrive, Link, Operator, RightDrive, Sensor};
use super::{Ending, Expected, Kind, Lasts, Recovery, Row, Size, Target};
use crate::guard::Fault as F;
use crate::guard::Reaction::{self, Count, Freeze, QuickStop, Silence, StopRamp};
use crate::guard::State::{Disabled, Lost, Stopped};

const ONE_DRIVE: &[Target] = &[LeftDrive, RightDrive];
const STOPPED: Ending = Latched(&[Stopped]);
const DISABLED: Ending = Latched(&[Disabled]);
const LOST: Ending = Latched(&[Lost]);
/// Several faults compete; which is seen first hangs on the moment.
const ANY: Ending = Latched(&[Stopped, Disabled, Lost]);

const fn row(
    (kind, name): (Kind, &'static str),
    matrix: &'static [u8],
    targets: &'static [Target],
    lasts: Lasts,
    meaning: &'static str,
    faults: &'static [F],
    (reaction, ending, recovery): (Reaction, Ending, Recovery),
) -> Row {
    let expected = Expected { faults, reaction, ending, recovery };
    Row { kind, name, meaning, matrix, targets, lasts, size: None, expected }
}

const fn sized(row: Row, what: &'static str, usual: f64, (least, most): (f64, f64)) -> Row {
    Row { size: Some(Size { what, usual, least, most }), ..row }
}

/// All injections, in the order of [`Kind`].
pub const CATALOGUE: [Row; Kind::COUNT] = [
    row(
        (Kind::SensorStuck, "sensor-stuck"),
        &[1],
        &[Sensor],
        For(0.3),
        "the force sensor repeats its last counts on all channels, with its counter running",
        &[F::SensorStuck],
        (StopRamp, STOPPED, Reset),
    ),
    row(
        (Kind::SensorInvalid, "sensor-invalid"),
        &[2],
        &[Sensor],
        For(0.1),
        "the force sensor says that its samples are not valid",
        &[F::SensorInvalid],
        (StopRamp, STOPPED, Reset),
    ),
    row(
        (Kind::SensorSaturated, "sensor-saturated"),
        &[3],
        &[Sensor],
        For(0.1),
        "the first two channels of the force sensor are at the end of their range",
        &[F::SensorSaturated, F::ForceLimit, F::ForceStep],
        (StopRamp, STOPPED, Reset),
    ),
    row(
        (Kind::SensorStale, "sensor-stale"),
        &[4],
        &[Sensor],
        For(0.1),
        "the force sensor takes no new samples and sends its last one again, with the same counter",
        &[F::SensorStale, F::SensorLost],
        (StopRamp, STOPPED, Reset),
    ),
    row(
        (Kind::SensorSilent, "sensor-silent"),
        &[5, 11],
        &[Sensor],
        For(0.1),
        "the force sensor's process data do not arrive; its heartbeat does",
        &[F::SensorStale, F::SensorLost],
        (StopRamp, STOPPED, Reset),
    ),
    sized(
        row(
            (Kind::SensorJump, "sensor-jump"),
            &[6],
            &[Sensor],
            For(0.002),
            "the force sensor's zero jumps and comes back",
            &[F::ForceStep],
            (Freeze, GoesOn, Nothing),
        ),
        "a force in N",
        100.0,
        (-200.0, 200.0),
    ),
    sized(
        row(
            (Kind::SensorDrift, "sensor-drift"),
            &[7],
            &[Sensor],
            For(6.0),
            "the force sensor's zero drifts steadily",
            &[F::ForceImplausible, F::OverSpeed, F::ForceLimit, F::FollowingError],
            (StopRamp, STOPPED, Reset),
        ),
        "a drift in N/s",
        40.0,
        (-1000.0, 1000.0),
    ),
    sized(
        row(
            (Kind::SensorClockDrift, "sensor-clock-drift"),
            &[4],
            &[Sensor],
            For(2.0),
            "the force sensor's clock runs at another rate",
            &[],
            (Count, GoesOn, Nothing),
        ),
        "a share of its rate",
        0.9,
        (0.01, 1.0),
    ),
    row(
        (Kind::PdoLost, "pdo-lost"),
        &[11],
        ONE_DRIVE,
        For(0.1),
        "the drive's process data do not arrive",
        &[F::PdoMissed],
        (QuickStop, STOPPED, Reset),
    ),
    sized(
        row(
            (Kind::PdoDelayed, "pdo-delayed"),
            &[10],
            ONE_DRIVE,
            For(0.1),
            "the drive's process data arrive late",
            &[F::PdoMissed, F::PdoLate],
            (QuickStop, STOPPED, Reset),
        ),
        "a delay in s",
        0.0006,
        (0.0, 0.05),
    ),
    sized(
        row(
            (Kind::PdoJitter, "pdo-jitter"),
            &[10, 13],
            ONE_DRIVE,
            For(0.2),
            "every third frame of the drive's process data arrives late",
            &[F::PdoLate, F::PdoMissed],
            (StopRamp, STOPPED, Reset),
        ),
        "a delay in s",
        0.0006,
        (0.0, 0.05),
    ),
    row(
        (Kind::PdoDuplicated, "pdo-duplicated"),
        &[12],
        ONE_DRIVE,
        For(0.2),
        "the drive's process data arrive twice",
        &[F::PdoDuplicated],
        (Count, GoesOn, Nothing),
    ),
    row(
        (Kind::PdoReordered, "pdo-reordered"),
        &[13],
        ONE_DRIVE,
        For(0.2),
        "of two frames of the drive's process data the later one arrives first",
        &[F::PdoDuplicated, F::PdoLate, F::PdoMissed],
        (StopRamp, STOPPED, Reset),
    ),
    sized(
        row(
            (Kind::PdoCorrupt, "pdo-corrupt"),
            &[14],
            ONE_DRIVE,
            For(0.1),
            "random bits of the drive's process data are flipped",
            &[
                F::EncoderJump,
                F::Posture,
                F::FollowingError,
                F::Runaway,
                F::DriveFault,
                F::DriveVoltageOff,
                F::DriveLeftOperation,
                F::DriveIgnoresCommand,
                F::DriveWarning,
            ],
            (QuickStop, ANY, Restart),
        ),
        "a number of bits",
        8.0,
        (1.0, 48.0),
    ),
    row(
        (Kind::PdoShort, "pdo-short"),
        &[14],
        ONE_DRIVE,
        For(0.1),
        "the drive's process data come one byte short",
        &[F::PdoLength, F::PdoMissed],
        (QuickStop, STOPPED, Reset),
    ),
    row(
        (Kind::SetPointsLost, "set-points-lost"),
        &[11, 25],
        ONE_DRIVE,
        For(0.1),
        "the drive does not hear its set-points",
        &[F::DriveFault, F::DriveLeftOperation, F::Emergency, F::FollowingError],
        (QuickStop, ANY, Reset),
    ),
    row(
        (Kind::SyncLost, "sync-lost"),
        &[8],
        &[Bus],
        For(0.1),
        "nobody hears SYNC",
        &[F::PdoMissed, F::SensorStale, F::SensorLost, F::DriveFault, F::Emergency, F::DriveLeftOperation],
        (QuickStop, ANY, Reset),
    ),
    row(
        (Kind::HeartbeatSilent, "heartbeat-silent"),
        &[16],
        &[LeftDrive, RightDrive, Sensor],
        For(0.2),
        "the device's heartbeat does not arrive; its process data do",
        &[F::HeartbeatLost],
        (QuickStop, LOST, Reset),
    ),
    row(
        (Kind::NodeReset, "node-reset"),
        &[15],
        &[LeftDrive, RightDrive, Sensor],
        Once,
        "the device restarts by itself",
        &[F::NodeReset, F::HeartbeatLost, F::PdoMissed, F::DriveLeftOperation],
        (QuickStop, ANY, Restart),
    ),
    row(
        (Kind::NodeSilent, "node-silent"),
        &[5, 16],
        &[LeftDrive, RightDrive, Sensor],
        For(0.5),
        "the device loses its supply, and is switched on again at the end",
        &[F::PdoMissed, F::SensorStale, F::SensorLost, F::HeartbeatLost, F::NodeReset],
        (QuickStop, ANY, Restart),
    ),
    row(
        (Kind::DuplicateNode, "duplicate-node"),
        &[37],
        &[LeftDrive, RightDrive, Sensor],
        For(0.5),
        "another device with the same node id sends its heartbeat",
        &[F::DuplicateNode],
        (QuickStop, STOPPED, Restart),
    ),
    row(
        (Kind::IntruderNmt, "intruder-nmt"),
        &[],
        &[LeftDrive, RightDrive, Sensor],
        Once,
        "another master sends the device to Pre-operational",
        &[F::Intruder, F::HeartbeatLost, F::DriveLeftOperation, F::PdoMissed],
        (QuickStop, ANY, Restart),
    ),
    row(
        (Kind::IntruderSync, "intruder-sync"),
        &[],
        &[Bus],
        For(0.01),
        "another master sends SYNC, half a period beside ours",
        &[F::Intruder, F::PdoDuplicated, F::PdoLate],
        (QuickStop, STOPPED, Reset),
    ),
    row(
        (Kind::IntruderSetPoint, "intruder-set-point"),
        &[],
        ONE_DRIVE,
        For(0.01),
        "another master sends the drive Shutdown in set-points of its own",
        &[F::Intruder, F::DriveLeftOperation],
        (QuickStop, STOPPED, Reset),
    ),
    row(
        (Kind::Emergency, "emergency"),
        &[17],
        &[LeftDrive, RightDrive, Sensor],
        Once,
        "the device sends an emergency message: voltage (3210h) of a drive, device hardware (5000h) of the sensor",
        &[F::Emergency],
        (QuickStop, STOPPED, Reset),
    ),
    row(
        (Kind::EmergencyWarning, "emergency-warning"),
        &[17],
        &[LeftDrive, RightDrive, Sensor],
        Once,
        "the device sends an emergency message that is a warning",
        &[F::EmergencyWarning],
        (Count, GoesOn, Nothing),
    ),
    sized(
        row(
            (Kind::DriveFault, "drive-fault"),
            &[18],
            ONE_DRIVE,
            Once,
            "the drive's own monitoring puts it into fault",
            &[F::DriveFault, F::Emergency],
            (QuickStop, DISABLED, Reset),
        ),
        "an error code (603Fh)",
        0x4210 as f64,
        (1.0, 65_535.0),
    ),
    row(
        (Kind::DriveWarning, "drive-warning"),
        &[43],
        ONE_DRIVE,
        For(2.5),
        "the drive warns of its temperature (status word bit 7)",
        &[F::DriveWarning],
        (StopRamp, STOPPED, Reset),
    ),
    row(
        (Kind::VoltageOff, "voltage-off"),
        &[46],
        &[Drives, LeftDrive, RightDrive],
        For(0.3),
        "the emergency stop takes the voltage from the power stage",
        &[F::DriveVoltageOff, F::DriveLeftOperation],
        (QuickStop, DISABLED, Reset),
    ),
    row(
        (Kind::DriveLeavesOperation, "drive-leaves-operation"),
        &[19],
        ONE_DRIVE,
        Once,
        "the drive leaves Operation Enabled by itself",
        &[F::DriveLeftOperation],
        (QuickStop, STOPPED, Reset),
    ),
    row(
        (Kind::DriveIgnoresCommand, "drive-ignores-command"),
        &[20],
        ONE_DRIVE,
        For(0.1),
        "the drive keeps its last target and says so (status word bit 12)",
        &[F::DriveIgnoresCommand, F::FollowingError],
        (QuickStop, STOPPED, Reset),
    ),
    sized(
        row(
            (Kind::DriveRunaway, "drive-runaway"),
            &[20],
            ONE_DRIVE,
            For(0.3),
            "the drive gives a torque of its own while it is enabled, whatever is commanded",
            &[F::FollowingError, F::Runaway, F::ForceStep, F::ForceLimit, F::ForceImplausible],
            (QuickStop, STOPPED, Reset),
        ),
        "a torque in N m",
        60.0,
        (-200.0, 200.0),
    ),
    sized(
        row(
            (Kind::EncoderJump, "encoder-jump"),
            &[35],
            ONE_DRIVE,
            For(0.3),
            "the drive's angle jumps",
            &[F::EncoderJump],
            (QuickStop, DISABLED, Reset),
        ),
        "an angle in rad",
        0.1,
        (-3.0, 3.0),
    ),
    row(
        (Kind::EncoderStuck, "encoder-stuck"),
        &[35],
        ONE_DRIVE,
        For(3.0),
        "the drive's angle stands still while the joint moves",
        &[F::FollowingError, F::Runaway, F::EncoderJump, F::Posture, F::ForceImplausible],
        (QuickStop, ANY, Reset),
    ),
    row(
        (Kind::ArmBlocked, "arm-blocked"),
        &[20],
        ONE_DRIVE,
        For(8.0),
        "the joint is blocked",
        &[F::FollowingError, F::Runaway, F::ForceImplausible],
        (StopRamp, STOPPED, Reset),
    ),
    sized(
        row(
            (Kind::HandPush, "hand-push"),
            &[41],
            &[Hand],
            For(0.3),
            "the hand pushes hard",
            &[F::OverSpeed, F::ForceStep, F::FollowingError],
            (StopRamp, STOPPED, Reset),
        ),
        "a force in N",
        120.0,
        (0.0, 500.0),
    ),
    sized(
        row(
            (Kind::HandOverload, "hand-overload"),
            &[41],
            &[Hand],
            For(0.3),
            "the hand leans on the tool beyond the force limit",
            &[F::ForceLimit, F::ForceStep, F::OverSpeed, F::FollowingError],
            (StopRamp, STOPPED, Reset),
        ),
        "a force in N",
        192.0,
        (0.0, 500.0),
    ),
    sized(
        row(
            (Kind::HandBlow, "hand-blow"),
            &[41],
            &[Hand],
            For(0.003),
            "the tool gets a blow",
            &[F::ForceStep],
            (Freeze, GoesOn, Nothing),
        ),
        "a force in N",
        180.0,
        (0.0, 500.0),
    ),
    sized(
        row(
            (Kind::HandTremble, "hand-tremble"),
            &[42],
            &[Hand],
            For(1.5),
            "the hand trembles at 25 Hz, as one that swings together with the fixture does",
            &[F::Chatter],
            (StopRamp, STOPPED, Reset),
        ),
        "an amplitude in N",
        60.0,
        (0.0, 300.0),
    ),
    sized(
        row(
            (Kind::HandStiff, "hand-stiff"),
            &[41, 42],
            &[Hand],
            For(2.0),
            "the hand stiffens; the mass of the proxy is enough for it",
            &[],
            (Count, GoesOn, Nothing),
        ),
        "a multiple of its stiffness",
        50.0,
        (0.0, 1000.0),
    ),
    sized(
        row(
            (Kind::HandSwing, "hand-swing"),
            &[41],
            &[Hand],
            For(0.12),
            "the hand throws the tool and holds it back",
            &[F::EnergyLimit],
            (Freeze, GoesOn, Nothing),
        ),
        "a force in N",
        85.0,
        (0.0, 500.0),
    ),
    sized(
        row(
            (Kind::HandToEdge, "hand-to-edge"),
            &[39],
            &[Hand],
            For(3.0),
            "the hand pulls the tool outward to the edge of the workspace",
            &[F::WorkspaceEdge],
            (Count, GoesOn, Nothing),
        ),
        "a force in N",
        60.0,
        (0.0, 200.0),
    ),
    row(
        (Kind::StopRequest, "stop-request"),
        &[],
        &[Operator],
        Once,
        "the person asks for a stop",
        &[F::StopRequested],
        (StopRamp, STOPPED, Reset),
    ),
    sized(
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
    ),
    sized(
        row(
            (Kind::ComputeLate, "compute-late"),
            &[29],
            &[Host],
            For(0.1),
            "every second cycle the computation begins late; a grid point that passes meanwhile is left out",
            &[F::Overrun],
            (StopRamp, STOPPED, Reset),
        ),
        "a time in s",
        0.000_55,
        (0.0, 0.01),
    ),
    sized(
        row(
            (Kind::CycleOverrun, "cycle-overrun"),
            &[28],
            &[Host],
            For(0.1),
            "every second cycle takes long to compute; a grid point that passes meanwhile is left out",
            &[F::Overrun],
            (StopRamp, STOPPED, Reset),
        ),
        "a time in s",
        0.0006,
        (0.0, 0.01),
    ),
    row(
        (Kind::MasterStopped, "master-stopped"),
        &[26],
        &[Host],
        For(0.003),
        "the process is stopped and goes on at the end, with all frames that waited meanwhile",
        &[F::Stalled],
        (QuickStop, STOPPED, Reset),
    ),
    row(
        (Kind::MasterKilled, "master-killed"),
        &[25],
        &[Host],
        Stays,
        "the process is killed and does not come back",
        &[],
        (Silence, DrivesStop, NewProcess),
    ),
    row(
        (Kind::CyclePanic, "cycle-panic"),
        &[27],
        &[Host],
        Once,
        "the cycle panics while it hands over its frames; the last thing that leaves is a quick stop",
        &[F::CyclePanicked],
        (QuickStop, DISABLED, NewProcess),
    ),
    row(
        (Kind::Suspend, "suspend"),
        &[30],
        &[Host],
        For(0.003),
        "the computer is suspended; its monotonic clock stands still meanwhile",
        &[F::Suspended],
        (StopRamp, STOPPED, Reset),
    ),
    row(
        (Kind::SendFailed, "send-failed"),
        &[8],
        &[Link],
        For(0.02),
        "sending fails and says so; what others send arrives",
        &[F::LinkDown],
        (Silence, LOST, Restart),
    ),
    row(
        (Kind::InterfaceDown, "interface-down"),
        &[23],
        &[Link],
        For(0.2),
        "the interface is down: nothing goes in or out, and sending says so",
        &[F::LinkDown, F::PdoMissed, F::HeartbeatLost],
        (Silence, LOST, Restart),
    ),
    row(
        (Kind::BusOff, "bus-off"),
        &[21],
        &[Link],
        For(0.2),
        "the controller goes bus-off: nothing goes in or out",
        &[F::BusOff, F::PdoMissed, F::HeartbeatLost],
        (Silence, LOST, Restart),
    ),
    row(
        (Kind::ErrorPassive, "error-passive"),
        &[22],
        &[Link],
        For(0.02),
        "the controller is error-passive on a disturbed bus that still carries its frames",
        &[F::ErrorPassive],
        (Silence, LOST, Restart),
    ),
    row(
        (Kind::TransmitStalled, "transmit-stalled"),
        &[24],
        &[Link],
        For(0.01),
        "what the master sends waits in its interface",
        &[F::TransmitStalled, F::PdoMissed],
        (Silence, LOST, Restart),
    ),
    row(
        (Kind::CableOut, "cable-out"),
        &[22],
        &[Link],
        For(0.2),
        "the master's cable is out: its frames wait unacknowledged, and nothing arrives",
        &[F::TransmitStalled, F::ErrorPassive, F::PdoMissed, F::HeartbeatLost],
        (Silence, LOST, Restart),
    ),
    row(
        (Kind::IdentityMismatch, "identity-mismatch"),
        &[36],
        &[LeftDrive, RightDrive, Sensor],
        FromBoot,
        "the device is of another vendor than configured",
        &[],
        (Count, NotEnabled, Restart),
    ),
    row(
        (Kind::ConfigDrift, "config-drift"),
        &[38],
        ONE_DRIVE,
        FromBoot,
        "the drive does not keep the torque limit that is written to it",
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
    sized(
        row(
            (Kind::EncoderOffset, "encoder-offset"),
            &[40],
            ONE_DRIVE,
            FromBoot,
            "the drive's zero is wrong",
            &[F::Posture],
            (QuickStop, NotEnabled, Reset),
        ),
        "an angle in rad",
        -1.5,
        (-3.0, 3.0),
    ),
    row(
        (Kind::DriveNotEnabling, "drive-not-enabling"),
        &[19],
        ONE_DRIVE,
        FromBoot,
        "the drive does not follow its controlword to Operation Enabled",
        &[F::EnablingTimeout],
        (QuickStop, NotEnabled, Reset),
    ),
];

#[cfg(test)]
mod tests {
    use super::super::{Injection, InjectionError};
    use super::*;

    /// Rows of the fault matrix that no injection covers, and the test that does.
    const ELSEWHERE: [(u8, &str); 4] = [
        (31, "record: a full disk costs records and not the run"),
        (32, "record: a reader that stalls costs records and not the run"),
        (33, "config: malformed files are refused with a place"),
        (34, "drives: scaling, proptests of the unwrapper"),
    ];

    /// Faults that no injection brings about, and the test that does.
    const NOT_INJECTED: [(F, &str); 2] = [
        (F::NotFinite, "cycle::tests: a defect of this program, fed at the cycle's inputs"),
        (F::WorkspaceLeft, "cycle::tests: the loops hold the arm at the edge, so that it is put beyond it"),
    ];

    #[test]
    fn the_catalogue_is_in_the_order_of_the_kinds_and_every_row_is_possible() {
        for (index, row) in CATALOGUE.iter().enumerate() {
            assert_eq!(row.kind as usize, index, "{}", row.name);
            assert_eq!(Kind::named(row.name), Some(row.kind), "names are unique");
            assert!(!row.meaning.is_empty() && !row.targets.is_empty());
            assert_eq!(Injection::new(row.kind, 1.0).check(), Ok(()), "{}", row.name);
            let strongest = row.expected.reaction;
            let follows = match row.expected.ending {
                GoesOn => strongest <= Freeze,
                Latched(states) => strongest >= StopRamp && states.iter().all(|state| state.is_latched()),
                NotEnabled | DrivesStop => true,
            };
            assert!(follows, "{}", row.name);
            assert_eq!(row.expected.recovery == Nothing, row.expected.ending == GoesOn, "{}", row.name);
        }
    }

    #[test]
    fn every_fault_is_brought_about() {
        for row in &crate::guard::fault::TABLE {
            let injected = CATALOGUE.iter().any(|injection| injection.expected.faults.contains(&row.fault));
            let elsewhere = NOT_INJECTED.iter().any(|(fault, _)| *fault == row.fault);
            assert!(injected != elsewhere, "{}", row.name);
        }
    }

    #[test]
    fn every_row_of_the_matrix_is_covered() {
        for number in (1..=43).chain([46]) {
            let injected = CATALOGUE.iter().any(|row| row.matrix.contains(&number));
            let elsewhere = ELSEWHERE.iter().any(|(row, _)| *row == number);
            assert!(injected != elsewhere, "row {number}");
        }
    }

    #[test]
    fn what_is_not_possible_is_refused() {
        let stuck = Injection::new(Kind::SensorStuck, 1.0);
        assert!(matches!(stuck.on(LeftDrive).check(), Err(InjectionError::Target { .. })));
        assert!(matches!(stuck.sized(1.0).check(), Err(InjectionError::NoSize { .. })));
        assert!(matches!(stuck.lasting(Some(0.0)).check(), Err(InjectionError::Duration { .. })));
        assert!(matches!(Injection::new(Kind::SensorStuck, f64::NAN).check(), Err(InjectionError::Start { .. })));
        assert!(matches!(Injection::new(Kind::SensorStuck, -1.0).check(), Err(InjectionError::Start { .. })));
        let jump = Injection::new(Kind::EncoderJump, 1.0);
        for size in [f64::NAN, 4.0, f64::INFINITY] {
            assert!(matches!(jump.sized(size).check(), Err(InjectionError::Size { .. })));
        }
        let once = Injection::new(Kind::DriveFault, 1.0).lasting(Some(1.0));
        assert!(matches!(once.check(), Err(InjectionError::NoDuration { .. })));
    }
}
