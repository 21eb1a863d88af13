//! Objects that nobody writes by the way.

use std::fmt;

use yieldwall_drives::cia402::Command;
use yieldwall_drives::objects;

use super::scan::number;
use yieldwall_fieldbus::objects::Address;

/// Why an object is not written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Caution {
    /// A controlword that would bring a drive nearer to Operation Enabled.
    Enables,
    /// A set-point, or what is added to one.
    SetPoint,
    /// The device would store or restore its memory.
    Memory,
    /// Commutation, encoder or calibration: what was measured on this very device.
    Measured,
    /// Its firmware or program.
    Program,
}

impl fmt::Display for Caution {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Enables => "brings the drive nearer to Operation Enabled",
            Self::SetPoint => "is a set-point",
            Self::Memory => "makes the device store or restore its memory",
            Self::Measured => "is of the commutation, the encoder or a calibration, measured on one very device",
            Self::Program => "is of the device's program",
        })
    }
}

/// Set-points of CiA 402 and what is added to them: vl target velocity, target torque, target position, offsets, target velocity; and digital
/// outputs, of which one may hold a brake.
const SET_POINTS: [u16; 9] = [0x6042, 0x6071, 0x607a, 0x60b0, 0x60b1, 0x60b2, 0x60c1, 0x60fe, 0x60ff];
/// Home offset, position range, resolutions of the encoder, gear, feed, polarity and motor data of CiA 402.
const MEASURED: [u16; 11] = [0x607c, 0x607e, 0x608f, 0x6090, 0x6091, 0x6092, 0x60e6, 0x60eb, 0x6402, 0x6404, 0x6410];
/// Words in the names of other such objects.
const MEASURED_WORDS: [&str; 10] = [
    "commut",
    "encoder",
    "hall",
    "resolver",
    "calib",
    "phase",
    "pole pair",
    "electrical angle",
    "home offset",
    "zero offset",
];

impl Caution {
    /// Returns the reason not to write this value.
    pub fn of_write(at: Address, value: &[u8]) -> Option<Self> {
        if objects::of_first_axis(at.index) == objects::CONTROLWORD.index {
            let word = number(value) as u16;
            let is_down = matches!(Command::decode(word), Command::DisableVoltage | Command::QuickStop)
                || word == Command::FaultReset.controlword();
            return (!is_down).then_some(Self::Enables);
        }
        Self::of_object(at).filter(|caution| *caution != Self::Measured)
    }

    /// Returns the reason not to restore an object to the value of a file, by its address and its name.
    pub fn of_restore(at: Address, name: &str) -> Option<Self> {
        let lower = name.to_lowercase().replace(['_', '-'], " ");
        let is_measured = || MEASURED_WORDS.iter().any(|word| lower.contains(word));
        match objects::of_first_axis(at.index) {
            0x6040 => Some(Self::Enables),
            _ => Self::of_object(at).or_else(|| is_measured().then_some(Self::Measured)),
        }
    }

    fn of_object(at: Address) -> Option<Self> {
        match objects::of_first_axis(at.index) {
            index if SET_POINTS.contains(&index) => Some(Self::SetPoint),
            index if MEASURED.contains(&index) => Some(Self::Measured),
            0x1010 | 0x1011 => Some(Self::Memory),
            0x1f50..=0x1f5f => Some(Self::Program),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_controlword_of_any_axis_goes_down_only() {
        for (word, caution) in [
            (0x00_u16, None),
            (0x02, None),
            (0x80, None),
            (0x06, Some(Caution::Enables)),
            (0x07, Some(Caution::Enables)),
            (0x0f, Some(Caution::Enables)),
            (0x8f, Some(Caution::Enables)),
        ] {
            for index in [0x6040, 0x6840, 0x7040, 0x9840] {
                let at = Address::new(index, 0);
                assert_eq!(Caution::of_write(at, &word.to_le_bytes()), caution, "{word:02x}");
            }
        }
    }

    #[test]
    fn what_was_measured_on_one_device_is_not_put_back() {
        for (index, name, caution) in [
            (0x607c, "Home offset", Some(Caution::Measured)),
            (0x2010, "Commutation angle", Some(Caution::Measured)),
            (0x2011, "HALL_SEQUENCE", Some(Caution::Measured)),
            (0x6072, "Max torque", None),
            (0x607a, "Target position", Some(Caution::SetPoint)),
            (0x687a, "Target position", Some(Caution::SetPoint)),
            (0x6840, "Controlword", Some(Caution::Enables)),
            (0x1010, "Store", Some(Caution::Memory)),
            (0x1f51, "Program control", Some(Caution::Program)),
        ] {
            assert_eq!(Caution::of_restore(Address::new(index, 0), name), caution, "{name}");
        }
    }
}
