//! Modes of operation.

use crate::profiles::Quantity;
#[cfg(feature = "config")]
use schemars::JsonSchema;
#[cfg(feature = "config")]
use serde::{Deserialize, Serialize};

/// Quantity that the drives receive in each cycle (CiA 402 mode of operation).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema), serde(rename_all = "snake_case"))]
pub enum CommandMode {
    /// Cyclic synchronous torque (CST): this program closes the position loop.
    Torque,
    /// Cyclic synchronous velocity (CSV).
    Velocity,
    /// Cyclic synchronous position (CSP): the drives close the position loop.
    Position,
}

impl CommandMode {
    /// The drives' mode of operation.
    pub const fn operation_mode(self) -> OperationMode {
        match self {
            CommandMode::Position => OperationMode::CyclicPosition,
            CommandMode::Velocity => OperationMode::CyclicVelocity,
            CommandMode::Torque => OperationMode::CyclicTorque,
        }
    }

    /// Returns the quantity of the set-points.
    pub const fn set_point(self) -> Quantity {
        match self {
            CommandMode::Position => Quantity::TargetPosition,
            CommandMode::Velocity => Quantity::TargetVelocity,
            CommandMode::Torque => Quantity::TargetTorque,
        }
    }
}

/// A mode of operation of CiA 402 (objects 6060h and 6061h). Manufacturer-specific modes are negative and not listed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(i8)]
pub enum OperationMode {
    /// Profile position.
    ProfilePosition = 1,
    /// Velocity (frequency converters).
    Velocity = 2,
    /// Profile velocity.
    ProfileVelocity = 3,
    /// Profile torque.
    ProfileTorque = 4,
    /// Homing.
    Homing = 6,
    /// Interpolated position.
    InterpolatedPosition = 7,
    /// Cyclic synchronous position (CSP).
    CyclicPosition = 8,
    /// Cyclic synchronous velocity (CSV).
    CyclicVelocity = 9,
    /// Cyclic synchronous torque (CST).
    CyclicTorque = 10,
    /// Cyclic synchronous torque with commutation angle.
    CyclicTorqueWithAngle = 11,
}

impl OperationMode {
    /// Every mode, ascending.
    pub const ALL: [OperationMode; 10] = [
        OperationMode::ProfilePosition,
        OperationMode::Velocity,
        OperationMode::ProfileVelocity,
        OperationMode::ProfileTorque,
        OperationMode::Homing,
        OperationMode::InterpolatedPosition,
        OperationMode::CyclicPosition,
        OperationMode::CyclicVelocity,
        OperationMode::CyclicTorque,
        OperationMode::CyclicTorqueWithAngle,
    ];

    /// The value of 6060h that requests this mode.
    pub const fn code(self) -> i8 {
        self as i8
    }

    /// The mode with this code; `None` for 0 (no mode), reserved and manufacturer-specific codes.
    ///
    /// Real-time: yes.
    pub const fn from_code(code: i8) -> Option<Self> {
        Some(match code {
            1 => OperationMode::ProfilePosition,
            2 => OperationMode::Velocity,
            3 => OperationMode::ProfileVelocity,
            4 => OperationMode::ProfileTorque,
            6 => OperationMode::Homing,
            7 => OperationMode::InterpolatedPosition,
            8 => OperationMode::CyclicPosition,
            9 => OperationMode::CyclicVelocity,
            10 => OperationMode::CyclicTorque,
            11 => OperationMode::CyclicTorqueWithAngle,
            _ => return None,
        })
    }

    /// The bit of 6502h that says that a drive has this mode.
    pub const fn supported_bit(self) -> u32 {
        1 << (self as i8 - 1)
    }

    /// Whether a drive with these supported modes (6502h) has this mode.
    pub const fn is_in(self, supported_modes: u32) -> bool {
        supported_modes & self.supported_bit() != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_decodes_to_its_mode_and_no_other() {
        for code in i8::MIN..=i8::MAX {
            let expected = OperationMode::ALL.into_iter().find(|mode| mode.code() == code);
            assert_eq!(OperationMode::from_code(code), expected);
        }
    }

    #[test]
    fn supported_bits_are_those_of_6502h() {
        assert_eq!(OperationMode::Homing.supported_bit(), 1 << 5);
        assert_eq!(OperationMode::CyclicPosition.supported_bit(), 1 << 7);
        assert_eq!(OperationMode::CyclicVelocity.supported_bit(), 1 << 8);
        assert_eq!(OperationMode::CyclicTorque.supported_bit(), 1 << 9);
        assert!(OperationMode::CyclicTorque.is_in(0x200));
        assert!(!OperationMode::CyclicTorque.is_in(0x1ff));
    }
}
