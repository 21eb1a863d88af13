//! Meaning of the kinds of the catalogue for a judgement from outside.

use super::observation::Falsified;
use yieldwall_config::injection::{Ending, Injection, Kind, Lasts, Medium, Recovery};
use yieldwall_motion::guard::Fault;

/// Time in s for which what an injection falsified still shows after its end: the arm settles, the filter runs out.
const LINGERS_S: f64 = 0.5;
/// Time in s within which the network reads all registers back that safety rests on.
const HIDDEN_S: f64 = 1.0;

/// Returns the values that an injection falsifies.
pub(super) fn falsifies(kind: Kind) -> Falsified {
    let none = Falsified::default();
    match kind {
        Kind::SensorStuck
        | Kind::SensorInvalid
        | Kind::SensorSaturated
        | Kind::SensorStale
        | Kind::SensorSilent
        | Kind::SensorJump
        | Kind::SensorDrift
        | Kind::SensorClockDrift => Falsified { force: true, ..none },
        Kind::EncoderJump | Kind::EncoderStuck | Kind::EncoderOffset => Falsified { angles: true, ..none },
        Kind::PdoLost
        | Kind::PdoDelayed
        | Kind::PdoJitter
        | Kind::PdoDuplicated
        | Kind::PdoReordered
        | Kind::PdoCorrupt
        | Kind::PdoShort => Falsified { angles: true, force: true, ..none },
        Kind::SetPointsLost
        | Kind::DriveFault
        | Kind::VoltageOff
        | Kind::DriveLeavesOperation
        | Kind::DriveIgnoresCommand
        | Kind::DriveRunaway
        | Kind::ForeignSetPoint
        | Kind::ForeignDownload => Falsified { drives: true, ..none },
        Kind::NodeReset | Kind::NodeSilent | Kind::IntruderNmt | Kind::DriveNotEnabling => {
            Falsified { drives: true, force: true, angles: true, ..none }
        }
        Kind::HandTremble | Kind::HandSwing | Kind::HandStiff => Falsified { hand: true, ..none },
        Kind::ArmBlocked => Falsified { arm: true, ..none },
        Kind::SyncLost
        | Kind::IntruderSync
        | Kind::SecondMaster
        | Kind::SyncLate
        | Kind::ComputeLate
        | Kind::CycleOverrun
        | Kind::MasterStopped
        | Kind::MasterKilled
        | Kind::CyclePanic
        | Kind::Suspend => Falsified { timing: true, drives: true, angles: true, force: true, ..none },
        Kind::SendFailed
        | Kind::InterfaceDown
        | Kind::BusOff
        | Kind::ErrorPassive
        | Kind::TransmitStalled
        | Kind::CableOut => Falsified { link: true, drives: true, angles: true, force: true, ..none },
        Kind::HeartbeatSilent
        | Kind::DuplicateNode
        | Kind::Emergency
        | Kind::EmergencyWarning
        | Kind::DriveWarning
        | Kind::HandPush
        | Kind::HandOverload
        | Kind::HandBlow
        | Kind::HandToEdge
        | Kind::StopRequest
        | Kind::IdentityMismatch
        | Kind::ConfigDrift
        | Kind::WrongNodeId
        | Kind::WrongBitRate => none,
        Kind::FrameLost
        | Kind::FrameDelayed
        | Kind::FrameDuplicated
        | Kind::FrameForeign
        | Kind::FrameShort
        | Kind::FrameCorrupt
        | Kind::DeviceBypassed
        | Kind::DeviceState
        | Kind::ClockJump => Falsified { drives: true, angles: true, force: true, ..none },
        Kind::ForeignOutputs | Kind::ReplayedOutputs | Kind::ForeignRegisterWrite | Kind::HiddenRegisterWrite => {
            Falsified { drives: true, angles: true, force: true, watchdog: true, ..none }
        }
        Kind::MailboxStuck | Kind::EmergencyInSdo => none,
    }
}

/// Returns the usual injection of its kind on a rig with this period. Numbers of cycles are for a period of 1 ms and are scaled.
pub(super) fn usual(kind: Kind, start_s: f64, period_s: f64) -> Injection {
    let injection = Injection::new(kind, start_s);
    let scale = period_s * 1e3;
    match kind {
        Kind::SyncLate | Kind::ComputeLate | Kind::CycleOverrun | Kind::FrameDelayed => Injection {
            duration_s: injection.duration_s.map(|duration_s| duration_s * scale),
            size: injection.size * scale,
            ..injection
        },
        Kind::Suspend
        | Kind::DriveWarning
        | Kind::FrameLost
        | Kind::FrameDuplicated
        | Kind::FrameForeign
        | Kind::FrameShort
        | Kind::FrameCorrupt
        | Kind::ForeignOutputs
        | Kind::ReplayedOutputs
        | Kind::ForeignRegisterWrite => {
            Injection { duration_s: injection.duration_s.map(|duration_s| duration_s * scale), ..injection }
        }
        _ => injection,
    }
}

/// Whether what has to follow is the same at all sizes.
pub(super) fn is_alike_at_any_size(kind: Kind) -> bool {
    matches!(kind, Kind::ForeignSetPoint) || is_a_register(kind)
}

/// Whether its size is the number of a register, which is whole.
pub(super) fn is_a_register(kind: Kind) -> bool {
    matches!(kind, Kind::ForeignRegisterWrite | Kind::HiddenRegisterWrite)
}

/// Returns the time in s within which the first sign of an injection comes, beyond its first cycle.
pub(super) fn shows_within_s(injection: &Injection) -> f64 {
    match injection.kind {
        Kind::HiddenRegisterWrite => HIDDEN_S,
        // It waits for the next request.
        Kind::EmergencyInSdo => injection.end_s() - injection.start_s,
        _ => 0.0,
    }
}

/// Returns the moment at which an injection is over and has shown, in s since the scene began.
pub(super) fn over_s(injection: &Injection) -> f64 {
    injection.end_s().max(injection.start_s + shows_within_s(injection))
}

/// Returns the moment at which the effect of an injection has settled, in s since the scene began.
pub(super) fn settled_s(injection: &Injection) -> f64 {
    over_s(injection) + LINGERS_S
}

/// Whether nothing but a new process comes after it.
pub(super) fn is_last(kind: Kind) -> bool {
    kind.row().expected.recovery == Recovery::NewProcess
}

/// Whether it is there from switching on.
pub(super) fn is_from_boot(kind: Kind) -> bool {
    kind.row().lasts == Lasts::FromBoot
}

/// Whether what has to follow shows on a rig that runs, however it moves at the time. The rest needs motion, a hand
/// that pushes, or noise on the sensor, which a seed has or has not.
pub(super) fn is_certain(kind: Kind) -> bool {
    match kind {
        Kind::SensorStuck
        | Kind::SensorDrift
        | Kind::SensorClockDrift
        | Kind::SensorJump
        | Kind::PdoDelayed
        | Kind::PdoJitter
        | Kind::PdoReordered
        | Kind::PdoCorrupt
        | Kind::SetPointsLost
        | Kind::SyncLost
        | Kind::DriveIgnoresCommand
        | Kind::DriveRunaway
        | Kind::DriveWarning
        | Kind::EncoderStuck
        | Kind::ArmBlocked
        | Kind::HandPush
        | Kind::HandOverload
        | Kind::HandBlow
        | Kind::HandTremble
        | Kind::HandSwing
        | Kind::HandStiff
        | Kind::HandToEdge
        | Kind::SyncLate
        | Kind::ComputeLate
        | Kind::CycleOverrun
        | Kind::MasterStopped
        | Kind::FrameDelayed
        | Kind::FrameCorrupt
        | Kind::EncoderOffset => false,
        _ => matches!(kind.row().expected.ending, Ending::Latched(_) | Ending::NotEnabled | Ending::DrivesStop),
    }
}

/// Returns the faults whose first observable sign is the first cycle at or after the injection's start, or one within
/// [`shows_within_s`]. For all other faults the sign grows with the motion, or is visible only in the rig's own counts.
pub(super) fn shows_at_once(kind: Kind, medium: Medium) -> &'static [Fault] {
    match kind {
        // Mailboxes and ports are looked at now and then, and what a device is without stays the same for a while.
        Kind::NodeReset | Kind::Emergency if medium == Medium::Ethercat => &[],
        Kind::DriveFault if medium == Medium::Ethercat => &[Fault::DriveFault],
        Kind::FrameLost | Kind::FrameShort | Kind::DeviceBypassed => &[Fault::PdoMissed],
        Kind::DeviceState => &[Fault::DeviceState],
        Kind::FrameForeign
        | Kind::ForeignOutputs
        | Kind::ReplayedOutputs
        | Kind::ForeignRegisterWrite
        | Kind::HiddenRegisterWrite => &[Fault::Intruder],
        Kind::SensorInvalid => &[Fault::SensorInvalid],
        Kind::SensorStale | Kind::SensorSilent => &[Fault::SensorStale, Fault::SensorLost],
        Kind::PdoLost => &[Fault::PdoMissed],
        Kind::PdoShort => &[Fault::PdoLength],
        Kind::HeartbeatSilent => &[Fault::HeartbeatLost],
        Kind::NodeReset => &[Fault::NodeReset],
        Kind::Emergency => &[Fault::Emergency],
        Kind::DriveFault => &[Fault::DriveFault, Fault::Emergency],
        Kind::VoltageOff => &[Fault::DriveVoltageOff, Fault::DriveLeftOperation],
        Kind::DriveLeavesOperation => &[Fault::DriveLeftOperation],
        Kind::EncoderJump => &[Fault::EncoderJump],
        Kind::StopRequest => &[Fault::StopRequested],
        Kind::SendFailed | Kind::InterfaceDown => &[Fault::LinkDown],
        Kind::BusOff => &[Fault::BusOff],
        Kind::ErrorPassive => &[Fault::ErrorPassive],
        _ => &[],
    }
}
