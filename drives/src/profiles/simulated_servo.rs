//! The servo drive of the embedded simulation.

use super::{
    DeviceProfile, Identity, MappingEntry, ModeMap, PdoMap, PdoMapping, Quirks, Role, RpdoTimeoutReaction,
    SIMULATED_VENDOR,
};
use crate::cia402::OperationMode;
use crate::objects::{CONTROLWORD, POSITION_ACTUAL, STATUSWORD, TARGET_POSITION, TARGET_TORQUE, TARGET_VELOCITY};

/// Every PDO is bound to each SYNC.
const EVERY_SYNC: u8 = 1;

const TPDO: &[PdoMapping] = &[PdoMapping {
    number: 1,
    transmission_type: EVERY_SYNC,
    entries: &[MappingEntry::of(STATUSWORD), MappingEntry::of(POSITION_ACTUAL)],
}];

const fn rpdo(entries: &'static [MappingEntry]) -> PdoMapping {
    PdoMapping { number: 1, transmission_type: EVERY_SYNC, entries }
}

/// Servo drive with the three cyclic synchronous modes. One RPDO and one TPDO of 4 to 6 bytes per drive leave room on
/// a 1 Mbit/s bus for two drives and a sensor at 1 kHz.
pub const SIMULATED_SERVO: DeviceProfile = DeviceProfile {
    name: "simulated-servo",
    // Bit 17: servo drive; low word: profile 402.
    device_type: 0x0002_0192,
    identity: Identity { vendor_id: SIMULATED_VENDOR, product_code: 0x0000_0402, revision: 0x0001_0000 },
    role: Role::Servo {
        supported_modes: OperationMode::CyclicPosition.supported_bit()
            | OperationMode::CyclicVelocity.supported_bit()
            | OperationMode::CyclicTorque.supported_bit(),
        modes: &[
            ModeMap {
                mode: OperationMode::CyclicPosition,
                pdos: PdoMap {
                    rpdo: &[rpdo(&[MappingEntry::of(CONTROLWORD), MappingEntry::of(TARGET_POSITION)])],
                    tpdo: TPDO,
                },
            },
            ModeMap {
                mode: OperationMode::CyclicVelocity,
                pdos: PdoMap {
                    rpdo: &[rpdo(&[MappingEntry::of(CONTROLWORD), MappingEntry::of(TARGET_VELOCITY)])],
                    tpdo: TPDO,
                },
            },
            ModeMap {
                mode: OperationMode::CyclicTorque,
                pdos: PdoMap {
                    rpdo: &[rpdo(&[MappingEntry::of(CONTROLWORD), MappingEntry::of(TARGET_TORQUE)])],
                    tpdo: TPDO,
                },
            },
        ],
        quirks: Quirks {
            mode_changes_while_enabled: false,
            rpdo_timeout: RpdoTimeoutReaction::Fault,
            sync_lost_periods: 5,
            limits_motor_speed: true,
        },
    },
};
