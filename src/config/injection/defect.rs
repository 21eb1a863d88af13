//! Defects that a machine has from its assembly, for a commissioning to find.

use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

use thiserror::Error;

/// Kind of a defect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
#[expect(missing_docs, reason = "every kind is described by its row of the table")]
pub enum DefectKind {
    EncoderPolarity,
    EncoderResolution,
    GearSign,
    WeakMotor,
    HighFriction,
    Cogging,
    NoisySensor,
    SwappedSensorAxes,
    HeartbeatConsumerOff,
    LimitNotKept,
    StaleParameters,
    Backlash,
    LooseHome,
    BiasedSensor,
    HeavyHandle,
    SlowSensor,
}

/// The size of a defect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DefectSize {
    /// Meaning of the number, with its unit.
    pub what: &'static str,
    /// The usual one.
    pub usual: f64,
    /// The smallest.
    pub least: f64,
    /// The greatest.
    pub most: f64,
}

/// Catalogue row of a defect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DefectRow {
    /// Kind of the defect.
    pub kind: DefectKind,
    /// Its name, as it stands in files and arguments.
    pub name: &'static str,
    /// Description of the defect.
    pub meaning: &'static str,
    /// Whether one of both drives has it, and not the sensor.
    pub is_of_drive: bool,
    /// How large it is; `None` for one that is there or is not.
    pub size: Option<DefectSize>,
    /// Step or check that finds it.
    pub found_by: FoundBy,
}

/// Step or check that finds a defect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FoundBy {
    /// The step of a commissioning that has this name.
    Step(&'static str),
    /// A command.
    Command(&'static str),
}

impl FoundBy {
    /// The step or the command.
    pub fn name(self) -> &'static str {
        match self {
            Self::Step(name) | Self::Command(name) => name,
        }
    }
}

impl Display for FoundBy {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Step(name) => write!(f, "the step `{name}`"),
            Self::Command(name) => write!(f, "`{name}`"),
        }
    }
}

const fn size(what: &'static str, usual: f64, least: f64, most: f64) -> Option<DefectSize> {
    Some(DefectSize { what, usual, least, most })
}

const fn row(
    kind: DefectKind,
    name: &'static str,
    (is_of_drive, found_by): (bool, FoundBy),
    size: Option<DefectSize>,
    meaning: &'static str,
) -> DefectRow {
    DefectRow { kind, name, meaning, is_of_drive, size, found_by }
}

/// All defects, in the order of their kinds.
pub const DEFECTS: [DefectRow; 16] = [
    row(
        DefectKind::EncoderPolarity,
        "encoder-polarity",
        (true, FoundBy::Step("rotation")),
        None,
        "the encoder counts opposite to its motor",
    ),
    row(
        DefectKind::EncoderResolution,
        "encoder-resolution",
        (true, FoundBy::Step("rotation")),
        size("counts for a turn over those in the rig file", 1.25, 1.06, 1.5),
        "the encoder has more counts per turn than in the rig file",
    ),
    row(
        DefectKind::GearSign,
        "gear-sign",
        (true, FoundBy::Step("rotation")),
        None,
        "motor and encoder agree, but the link turns opposite to the rig file",
    ),
    row(
        DefectKind::WeakMotor,
        "weak-motor",
        (true, FoundBy::Step("motor")),
        size("share of the torque that the drive reports", 0.7, 0.5, 0.82),
        "the motor makes less torque than the drive reports: wrong torque constant, or demagnetised motor",
    ),
    row(
        DefectKind::HighFriction,
        "high-friction",
        (true, FoundBy::Step("friction")),
        size("dry friction on top of that of the arm, N m", 6.0, 3.0, 10.0),
        "the joint has more dry friction than in the rig file",
    ),
    row(
        DefectKind::Cogging,
        "cogging",
        (true, FoundBy::Step("motor")),
        size("amplitude of a torque with 100 periods in a turn, N m", 4.0, 3.0, 8.0),
        "the torque has a ripple over the angle, as with a damaged gear",
    ),
    row(
        DefectKind::NoisySensor,
        "noisy-sensor",
        (false, FoundBy::Step("sensor-rest")),
        size("standard deviation of each axis of force, N", 0.5, 0.25, 2.0),
        "the force sensor has too much noise, as with a broken cable shield",
    ),
    row(
        DefectKind::SwappedSensorAxes,
        "swapped-sensor-axes",
        (false, FoundBy::Step("sensor-axes")),
        None,
        "x and y of the force sensor are swapped",
    ),
    row(
        DefectKind::HeartbeatConsumerOff,
        "heartbeat-consumer-off",
        (true, FoundBy::Step("watchdogs")),
        None,
        "the drive does not watch the heartbeat of its master (CAN only)",
    ),
    row(
        DefectKind::LimitNotKept,
        "limit-not-kept",
        (true, FoundBy::Step("limits")),
        None,
        "the drive accepts a torque limit (6072h), reports it, and forgets it",
    ),
    row(
        DefectKind::StaleParameters,
        "stale-parameters",
        (true, FoundBy::Step("parameters")),
        size("torque limit in the positive direction (60E0h), per mille of the rated torque", 300.0, 50.0, 990.0),
        "the drive has a stored torque limit in an object that this program does not write",
    ),
    row(
        DefectKind::Backlash,
        "backlash",
        (true, FoundBy::Step("rotation")),
        size("play between motor and link, degrees", 0.6, 0.3, 2.0),
        "there is play between motor and link, as with a worn gear or a loose coupling",
    ),
    row(
        DefectKind::LooseHome,
        "loose-home",
        (true, FoundBy::Command("yieldwall home --repeat")),
        size("standard deviation of where home is found, rad", 1e-3, 5e-5, 5e-3),
        "home shifts each time, as with a loose switch or encoder disc (homed drives only)",
    ),
    row(
        DefectKind::BiasedSensor,
        "biased-sensor",
        (false, FoundBy::Step("admittance")),
        size("force along x of the sensor that is not there, N", 6.0, 4.0, 12.0),
        "the zero of the force sensor is wrong, by less than the limit of the step `sensor-rest`",
    ),
    row(
        DefectKind::HeavyHandle,
        "heavy-handle",
        (false, FoundBy::Command("yieldwall tune loop")),
        size("mass beyond the force sensor on top of what the rig file says, kg", 0.3, 0.05, 1.0),
        "the handle is heavier than in the rig file, or has an added weight",
    ),
    row(
        DefectKind::SlowSensor,
        "slow-sensor",
        (false, FoundBy::Command("yieldwall tune loop")),
        size("time constant of a low pass in the sensor, ms", 2.0, 1.0, 10.0),
        "the force sensor has a low pass, so that its force is older than in the rig file; needs a handle with mass",
    ),
];

impl DefectKind {
    /// The row of [`DEFECTS`] that describes this kind.
    pub fn row(self) -> &'static DefectRow {
        &DEFECTS[self as usize]
    }

    /// The kind of this name.
    pub fn named(name: &str) -> Option<Self> {
        DEFECTS.iter().find(|row| row.name == name).map(|row| row.kind)
    }
}

/// A defect of a machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Defect {
    /// Kind of the defect.
    pub kind: DefectKind,
    /// Drive that has it: 0 the left one, 1 the right one. Ignored for a defect of the sensor.
    pub drive: usize,
    /// How large it is, in the unit of its row; 0 for one without a size.
    pub size: f64,
}

/// Why there is no such defect.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DefectError {
    /// No kind has this name.
    #[error("there is no defect `{name}`")]
    Unknown {
        /// The name.
        name: String,
    },
    /// The size is out of its range, or there is none.
    #[error(
        "{name} has the size {size}: {}",
        allowed.map_or("it has no size".to_owned(), |allowed| format!("{}, from {} to {}", allowed.what, allowed.least, allowed.most))
    )]
    Size {
        /// Name of the kind.
        name: &'static str,
        /// Size asked for.
        size: String,
        /// Sizes allowed.
        allowed: Option<DefectSize>,
    },
    /// The place is not one of both drives, or the defect is one of the sensor.
    #[error("{name} is not at `{place}`: {}", if *is_of_drive { "write left or right" } else { "it is a defect of the sensor" })]
    TextSpan {
        /// Name of the kind.
        name: &'static str,
        /// Place asked for.
        place: String,
        /// Whether a drive has it.
        is_of_drive: bool,
    },
}

impl Defect {
    /// A defect of the usual size, of the left drive if it is one of a drive.
    pub fn new(kind: DefectKind) -> Self {
        Self { kind, drive: 0, size: kind.row().size.map_or(0.0, |size| size.usual) }
    }

    /// Returns the same defect at the drive of this index.
    #[must_use]
    pub fn at(self, drive: usize) -> Self {
        Self { drive, ..self }
    }

    /// Returns the same defect with another size.
    ///
    /// # Errors
    /// If it takes none, or not this one.
    pub fn sized(self, size: f64) -> Result<Self, DefectError> {
        let row = self.kind.row();
        match row.size {
            Some(allowed) if size >= allowed.least && size <= allowed.most => Ok(Self { size, ..self }),
            allowed => Err(DefectError::Size { name: row.name, size: size.to_string(), allowed }),
        }
    }
}

impl FromStr for Defect {
    type Err = DefectError;

    /// `NAME[=SIZE][:left|right]`.
    fn from_str(text: &str) -> Result<Self, DefectError> {
        let (rest, place) = text.split_once(':').map_or((text, None), |(rest, place)| (rest, Some(place)));
        let (name, size) = rest.split_once('=').map_or((rest, None), |(name, size)| (name, Some(size)));
        let kind = DefectKind::named(name).ok_or_else(|| DefectError::Unknown { name: name.to_owned() })?;
        let row = kind.row();
        let drive = match place {
            None => 0,
            Some("left") if row.is_of_drive => 0,
            Some("right") if row.is_of_drive => 1,
            Some(place) => {
                let place = place.to_owned();
                return Err(DefectError::TextSpan { name: row.name, place, is_of_drive: row.is_of_drive });
            }
        };
        let defect = Self::new(kind).at(drive);
        let Some(size) = size else { return Ok(defect) };
        let error = || DefectError::Size { name: row.name, size: size.to_owned(), allowed: row.size };
        defect.sized(size.parse().map_err(|_| error())?)
    }
}

impl Display for Defect {
    /// As it is written: `NAME[=SIZE][:left|right]`.
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let row = self.kind.row();
        f.write_str(row.name)?;
        if row.size.is_some() {
            write!(f, "={}", self.size)?;
        }
        match (row.is_of_drive, self.drive) {
            (false, _) => Ok(()),
            (true, 0) => f.write_str(":left"),
            (true, _) => f.write_str(":right"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_stand_in_the_order_of_their_kinds_and_names_are_found() {
        for (at, row) in DEFECTS.iter().enumerate() {
            assert_eq!(row.kind as usize, at, "{}", row.name);
            assert_eq!(DefectKind::named(row.name), Some(row.kind));
            assert!(row.size.is_none_or(|size| size.least <= size.usual && size.usual <= size.most), "{}", row.name);
        }
    }

    #[test]
    fn a_defect_is_written_with_size_and_place() {
        let weak = Defect { kind: DefectKind::WeakMotor, drive: 1, size: 0.6 };
        assert_eq!("weak-motor=0.6:right".parse(), Ok(weak));
        assert_eq!(weak.to_string(), "weak-motor=0.6:right");
        for row in &DEFECTS {
            let defect = Defect::new(row.kind);
            assert_eq!(defect.to_string().parse(), Ok(defect));
        }
        assert_eq!("weak-motor".parse(), Ok(Defect::new(DefectKind::WeakMotor)));
        for (text, said) in [
            ("weak-moto", "there is no defect `weak-moto`"),
            ("weak-motor=2", "weak-motor has the size 2: share of the torque that the drive reports, from 0.5 to 0.82"),
            (
                "weak-motor=NaN",
                "weak-motor has the size NaN: share of the torque that the drive reports, from 0.5 to 0.82",
            ),
            ("weak-motor=x", "weak-motor has the size x: share of the torque that the drive reports, from 0.5 to 0.82"),
            ("gear-sign=1", "gear-sign has the size 1: it has no size"),
            ("gear-sign:up", "gear-sign is not at `up`: write left or right"),
            ("noisy-sensor:left", "noisy-sensor is not at `left`: it is a defect of the sensor"),
        ] {
            assert_eq!(text.parse::<Defect>().unwrap_err().to_string(), said);
        }
    }
}
