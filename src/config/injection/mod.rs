//! Fault injection as data: possible faults on the embedded simulation and on served devices, and the required reactions.
//!
//! [`Kind`] names a fault. [`CATALOGUE`] describes each fault: its effect, place and kind of bus, and the required reaction.
//! [`Injection`] is a fault at a moment. The rig in virtual time carries injections out, and so does the program that serves a
//! segment.

mod catalogue;
mod defect;
mod error;

pub use catalogue::CATALOGUE;
pub use defect::{DEFECTS, Defect, DefectError, DefectKind, DefectRow, DefectSize, FoundBy};
pub use error::InjectionError;

use yieldwall_motion::guard::{Fault, Reaction, State};

/// Kind of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
#[expect(missing_docs, reason = "every kind is described by its row of the catalogue")]
pub enum Kind {
    SensorStuck,
    SensorInvalid,
    SensorSaturated,
    SensorStale,
    SensorSilent,
    SensorJump,
    SensorDrift,
    SensorClockDrift,
    PdoLost,
    PdoDelayed,
    PdoJitter,
    PdoDuplicated,
    PdoReordered,
    PdoCorrupt,
    PdoShort,
    SetPointsLost,
    SyncLost,
    HeartbeatSilent,
    NodeReset,
    NodeSilent,
    DuplicateNode,
    IntruderNmt,
    IntruderSync,
    ForeignSetPoint,
    ForeignDownload,
    SecondMaster,
    Emergency,
    EmergencyWarning,
    DriveFault,
    DriveWarning,
    VoltageOff,
    DriveLeavesOperation,
    DriveIgnoresCommand,
    DriveRunaway,
    EncoderJump,
    EncoderStuck,
    ArmBlocked,
    HandPush,
    HandOverload,
    HandBlow,
    HandTremble,
    HandStiff,
    HandSwing,
    HandToEdge,
    StopRequest,
    SyncLate,
    ComputeLate,
    CycleOverrun,
    MasterStopped,
    MasterKilled,
    CyclePanic,
    Suspend,
    SendFailed,
    InterfaceDown,
    BusOff,
    ErrorPassive,
    TransmitStalled,
    CableOut,
    IdentityMismatch,
    ConfigDrift,
    WrongNodeId,
    EncoderOffset,
    DriveNotEnabling,
    WrongBitRate,
    FrameLost,
    FrameDelayed,
    FrameDuplicated,
    FrameForeign,
    FrameShort,
    FrameCorrupt,
    DeviceBypassed,
    MailboxStuck,
    DeviceState,
    ClockJump,
    EmergencyInSdo,
    ForeignOutputs,
    ReplayedOutputs,
    ForeignRegisterWrite,
    HiddenRegisterWrite,
}

impl Kind {
    /// Number of kinds.
    pub const COUNT: usize = Kind::HiddenRegisterWrite as usize + 1;

    /// The row of [`CATALOGUE`] that describes this kind.
    pub fn row(self) -> &'static CatalogueRow {
        &CATALOGUE[self as usize]
    }

    /// The kind of this name.
    pub fn named(name: &str) -> Option<Self> {
        CATALOGUE.iter().find(|row| row.name == name).map(|row| row.kind)
    }
}

/// Place of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Target {
    /// The left drive, its encoder or its joint.
    LeftDrive,
    /// The right drive, its encoder or its joint.
    RightDrive,
    /// Both drives.
    Drives,
    /// The force sensor.
    Sensor,
    /// The whole bus.
    Bus,
    /// The hand on the tool.
    Hand,
    /// The computer that runs the master.
    Host,
    /// The master's interfaces to all buses; an injection that acts there can name devices instead, for their buses.
    Link,
    /// The person at the rig.
    Operator,
}

impl Target {
    /// All targets with their names.
    pub const NAMES: [(Self, &'static str); 9] = [
        (Self::LeftDrive, "left_drive"),
        (Self::RightDrive, "right_drive"),
        (Self::Drives, "drives"),
        (Self::Sensor, "sensor"),
        (Self::Bus, "bus"),
        (Self::Hand, "hand"),
        (Self::Host, "host"),
        (Self::Link, "link"),
        (Self::Operator, "operator"),
    ];

    /// Returns the name in files and arguments.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(target, _)| *target == self).map_or("", |(_, name)| name)
    }

    /// The target of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(_, known)| *known == name).map(|(target, _)| *target)
    }

    /// Whether joint 0 (left) or 1 (right) is concerned.
    pub fn has_joint(self, joint: usize) -> bool {
        match self {
            Self::LeftDrive => joint == 0,
            Self::RightDrive => joint == 1,
            Self::Drives => joint < 2,
            _ => false,
        }
    }

    /// Whether a device is concerned: 0 the left drive, 1 the right drive, 2 the sensor.
    pub fn has_device(self, device: usize) -> bool {
        self.has_joint(device) || self == Self::Sensor && device == 2
    }
}

/// A kind of bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Medium {
    /// CAN buses.
    Can,
    /// An EtherCAT segment.
    Ethercat,
}

impl Medium {
    /// Returns the name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Can => "CAN",
            Self::Ethercat => "EtherCAT",
        }
    }
}

/// Duration of an injection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lasts {
    /// It happens once, in one cycle.
    Once,
    /// This many seconds, unless another duration is given.
    For(f64),
    /// To the end, unless a duration is given.
    Stays,
    /// Present from power-on; found while the rig is booted or enabled.
    FromBoot,
}

/// A number that gives the strength of an injection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Size {
    /// Meaning of the number, with its unit.
    pub what: &'static str,
    /// Usual value.
    pub usual: f64,
    /// Least value.
    pub least: f64,
    /// Greatest value.
    pub most: f64,
}

/// End of a rig under an injection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The rig runs, or holds and runs again by itself.
    GoesOn,
    /// The rig latches in one of these states.
    Latched(&'static [State]),
    /// The rig is never enabled.
    NotEnabled,
    /// No master is left to stop the rig: the drives stop by their own watchdogs.
    DrivesStop,
}

/// Action of a person that makes the rig run again after the injection is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Recovery {
    /// Nothing.
    None,
    /// Reset and enable.
    Reset,
    /// Reboot the network, reset and enable.
    Restart,
    /// Restart the program.
    NewProcess,
}

/// Reaction that must follow an injection with the row's own target, duration and size, on a rig in motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Expected {
    /// Faults that may show; one of them causes a stop. Empty if there is nothing to notice, or if the boot refuses.
    pub faults: &'static [Fault],
    /// The strongest reaction.
    pub reaction: Reaction,
    /// How the rig ends.
    pub ending: Ending,
    /// Action that makes the rig run again.
    pub recovery: Recovery,
}

/// A kind of injection and its properties.
#[derive(Clone, Copy, Debug)]
pub struct CatalogueRow {
    /// The kind.
    pub kind: Kind,
    /// Short, unique name in files and arguments.
    pub name: &'static str,
    /// Description of the effect.
    pub meaning: &'static str,
    /// The rows of the fault matrix that it covers.
    pub matrix: &'static [u8],
    /// Places where it can act; the first unless another is given.
    pub targets: &'static [Target],
    /// Kinds of bus on which it acts.
    pub media: &'static [Medium],
    /// Duration.
    pub lasts: Lasts,
    /// How strong, if that can be chosen.
    pub size: Option<Size>,
    /// Required reaction; on EtherCAT too, unless `on_ethercat` replaces it.
    pub expected: Expected,
    /// Required reaction on EtherCAT, if it differs from the reaction on CAN.
    pub on_ethercat: Option<&'static Expected>,
}

impl CatalogueRow {
    /// Whether a fault may show on some kind of bus.
    pub fn brings(&self, fault: Fault) -> bool {
        self.media.iter().any(|medium| self.expected_on(*medium).faults.contains(&fault))
    }

    /// Returns the required reaction on such a bus.
    pub fn expected_on(&self, medium: Medium) -> &Expected {
        self.on_ethercat.filter(|_| medium == Medium::Ethercat).unwrap_or(&self.expected)
    }
}

/// Something broken at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Injection {
    /// Kind of the fault.
    pub kind: Kind,
    /// Where.
    pub target: Target,
    /// When it begins, in s since the scene began; of no meaning for what is there from switching on.
    pub start_s: f64,
    /// Duration in s; `None` if the fault stays. Ignored for faults that happen once.
    pub duration_s: Option<f64>,
    /// How strong it is, in the unit of [`CatalogueRow::size`]; of no meaning without one.
    pub size: f64,
}

impl Injection {
    /// The usual injection of its kind, beginning `start_s` seconds after the scene.
    pub fn new(kind: Kind, start_s: f64) -> Self {
        let row = kind.row();
        let duration_s = match row.lasts {
            Lasts::For(duration_s) => Some(duration_s),
            _ => None,
        };
        let target = row.targets.first().copied().unwrap_or(Target::Host);
        Self { kind, target, start_s, duration_s, size: row.size.map_or(0.0, |size| size.usual) }
    }

    /// Returns the same injection at another place.
    #[must_use]
    pub fn on(self, target: Target) -> Self {
        Self { target, ..self }
    }

    /// Returns the same injection with another duration; `None` if it stays.
    #[must_use]
    pub fn lasting(self, duration_s: Option<f64>) -> Self {
        Self { duration_s, ..self }
    }

    /// Returns the same injection with another strength.
    #[must_use]
    pub fn sized(self, size: f64) -> Self {
        Self { size, ..self }
    }

    /// Whether it acts on the computer that runs the master, or on its interfaces: that is another program where devices are served.
    pub fn is_at_master(&self) -> bool {
        matches!(self.target, Target::Host | Target::Operator)
            || matches!(self.kind, Kind::SendFailed | Kind::InterfaceDown)
    }

    /// Returns the kind of bus on which it acts. With a device as target, it is the bus of that device. Otherwise it is a segment
    /// if the rig has a segment on which the kind means something, or if the rig has no other bus. `is_on_segment` answers for a
    /// device: 0 is the left drive, 1 the right drive, 2 the sensor.
    pub fn medium(&self, is_on_segment: impl Fn(usize) -> bool) -> Medium {
        let mut named = (0..3).filter(|device| self.target.has_device(*device)).peekable();
        let is_there = match named.peek() {
            Some(_) => named.all(is_on_segment),
            None if self.kind.row().media.contains(&Medium::Ethercat) => (0..3).any(is_on_segment),
            None => (0..3).all(is_on_segment),
        };
        if is_there { Medium::Ethercat } else { Medium::Can }
    }

    /// End of the injection in s; infinity if it stays. A fault that happens once ends when it begins.
    pub fn end_s(&self) -> f64 {
        match (self.kind.row().lasts, self.duration_s) {
            (Lasts::Once, _) => self.start_s,
            (_, Some(duration_s)) => self.start_s + duration_s,
            (_, None) => f64::INFINITY,
        }
    }

    /// # Errors
    /// As [`Injection::check`]; or the kind means nothing on such a bus.
    pub fn check_on(&self, medium: Medium) -> Result<(), InjectionError> {
        let row = self.kind.row();
        if !row.media.contains(&medium) {
            return Err(InjectionError::Medium { name: row.name, medium, media: row.media });
        }
        self.check()
    }

    /// # Errors
    /// If target, times or size are not possible for the kind.
    pub fn check(&self) -> Result<(), InjectionError> {
        let row = self.kind.row();
        if !row.targets.contains(&self.target) {
            return Err(InjectionError::Target { name: row.name, target: self.target, targets: row.targets });
        }
        if !(self.start_s >= 0.0 && self.start_s.is_finite()) {
            return Err(InjectionError::Start { name: row.name, start_s: self.start_s });
        }
        if let Some(duration_s) = self.duration_s {
            if matches!(row.lasts, Lasts::Once | Lasts::FromBoot) {
                return Err(InjectionError::NoDuration { name: row.name });
            }
            if !(duration_s > 0.0 && duration_s.is_finite()) {
                return Err(InjectionError::Duration { name: row.name, duration_s });
            }
        }
        match row.size {
            Some(size) if !(size.least..=size.most).contains(&self.size) => {
                Err(InjectionError::Size { name: row.name, size: self.size, allowed: size })
            }
            None if self.size != 0.0 => Err(InjectionError::NoSize { name: row.name }),
            _ => Ok(()),
        }
    }
}
