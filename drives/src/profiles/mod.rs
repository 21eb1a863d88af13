//! What the master has to know about a device model: identity, PDO mapping per mode, peculiarities. One file per model.

mod simulated_force_sensor;
mod simulated_servo;

pub use simulated_force_sensor::{SIMULATED_FORCE_SENSOR, STATUS_INVALID, STATUS_OVERLOAD};
pub use simulated_servo::SIMULATED_SERVO;

use crate::cia402::OperationMode;
use crate::objects::Object;

/// Identity object 1018h, without the serial number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Identity {
    /// 1018h:1.
    pub vendor_id: u32,
    /// 1018h:2.
    pub product_code: u32,
    /// 1018h:3.
    pub revision: u32,
}

/// Vendor id of the simulated devices; not assigned by CiA.
pub const SIMULATED_VENDOR: u32 = 0xffff_5957;

/// One mapped object of a PDO.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MappingEntry {
    /// Index of the mapped object.
    pub index: u16,
    /// Sub-index of the mapped object.
    pub sub: u8,
    /// Length in bits.
    pub bits: u8,
}

impl MappingEntry {
    /// Maps the whole of an object.
    pub const fn of(object: Object) -> Self {
        MappingEntry { index: object.index, sub: object.sub, bits: object.bits() }
    }

    /// The value of the mapping parameter (1600h, 1A00h and following).
    ///
    /// # Source
    /// CiA 301, PDO mapping parameter record: index, sub-index, length in bits, from the highest byte down.
    pub const fn to_u32(self) -> u32 {
        (self.index as u32) << 16 | (self.sub as u32) << 8 | self.bits as u32
    }
}

/// The wanted configuration of one PDO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoMapping {
    /// Number of the PDO, from 1; its parameters are at 13FFh + number (RPDO) or 17FFh + number (TPDO).
    pub number: u8,
    /// Transmission type: 1 to 240 every n-th SYNC, 254 and 255 event-driven.
    pub transmission_type: u8,
    /// Mapped objects in the order of the payload.
    pub entries: &'static [MappingEntry],
}

impl PdoMapping {
    /// Payload length in bytes.
    pub fn len(&self) -> usize {
        self.entries.iter().map(|entry| usize::from(entry.bits)).sum::<usize>().div_ceil(8)
    }

    /// Whether the PDO carries nothing.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Bit offset of an object in the payload, `None` if the PDO does not carry it.
    pub fn offset_bits(&self, object: Object) -> Option<usize> {
        let mut offset = 0;
        for entry in self.entries {
            if (entry.index, entry.sub) == (object.index, object.sub) {
                return Some(offset);
            }
            offset += usize::from(entry.bits);
        }
        None
    }
}

/// PDOs of a device, as the device sees them: it receives RPDOs and transmits TPDOs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoMap {
    /// Received by the device, sent by the master.
    pub rpdo: &'static [PdoMapping],
    /// Sent by the device.
    pub tpdo: &'static [PdoMapping],
}

/// The PDOs of a drive in one mode of operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModeMap {
    /// The mode.
    pub mode: OperationMode,
    /// Its PDOs.
    pub pdos: PdoMap,
}

/// What a device does with an RPDO that does not come in its deadline (event timer of the RPDO); the standard leaves it
/// to the maker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RpdoTimeoutReaction {
    /// Nothing.
    None,
    /// EMCY 8250h and the reaction of 6007h.
    AbortConnection,
    /// EMCY 8250h and a fault: the reaction of 605Eh, then Fault.
    Fault,
}

/// Where a model differs from another within the standard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quirks {
    /// Whether 6060h may change in Operation Enabled.
    pub mode_changes_while_enabled: bool,
    /// What an RPDO timeout does.
    pub rpdo_timeout: RpdoTimeoutReaction,
    /// After how many interpolation periods (60C2h) without SYNC an enabled drive goes into fault; 0 for never.
    pub sync_lost_periods: u32,
    /// Whether the drive has 6080h and heeds it in the cyclic synchronous modes.
    pub limits_motor_speed: bool,
}

/// What a device is used as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// A drive of CiA 402.
    Servo {
        /// Supported modes, 6502h.
        supported_modes: u32,
        /// PDOs for each mode that the master may use.
        modes: &'static [ModeMap],
        /// Peculiarities.
        quirks: Quirks,
    },
    /// A six-axis force sensor in the manner of CiA 404.
    ForceSensor {
        /// PDOs.
        pdos: PdoMap,
        /// Sample rates in Hz that the model has.
        sample_rates_hz: &'static [u32],
    },
}

/// One device model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceProfile {
    /// Name that a configuration uses.
    pub name: &'static str,
    /// Device type, 1000h.
    pub device_type: u32,
    /// What 1018h has to say.
    pub identity: Identity,
    /// What it is used as.
    pub role: Role,
}

impl DeviceProfile {
    /// PDOs of a drive in `mode`, of a sensor in any mode (`None`); nothing if the model does not have the mode.
    pub fn pdos(&self, mode: Option<OperationMode>) -> Option<PdoMap> {
        match (self.role, mode) {
            (Role::Servo { modes, .. }, Some(mode)) => modes.iter().find(|map| map.mode == mode).map(|map| map.pdos),
            (Role::ForceSensor { pdos, .. }, None) => Some(pdos),
            _ => None,
        }
    }

    /// Peculiarities of a drive; `None` of a sensor.
    pub fn quirks(&self) -> Option<Quirks> {
        match self.role {
            Role::Servo { quirks, .. } => Some(quirks),
            Role::ForceSensor { .. } => None,
        }
    }
}

/// All device models.
pub const ALL: &[&DeviceProfile] = &[&SIMULATED_SERVO, &SIMULATED_FORCE_SENSOR];

/// The model with this name.
pub fn find(name: &str) -> Option<&'static DeviceProfile> {
    ALL.iter().copied().find(|profile| profile.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects;

    fn every_pdo() -> impl Iterator<Item = PdoMapping> {
        ALL.iter()
            .flat_map(|profile| match profile.role {
                Role::Servo { modes, .. } => modes.iter().map(|map| map.pdos).collect::<Vec<_>>(),
                Role::ForceSensor { pdos, .. } => vec![pdos],
            })
            .flat_map(|map| map.rpdo.iter().chain(map.tpdo).copied().collect::<Vec<_>>())
    }

    #[test]
    fn every_mapping_fits_a_frame_and_names_known_objects() {
        for pdo in every_pdo() {
            assert!((1..=4).contains(&pdo.number));
            assert!((1..=8).contains(&pdo.len()), "{pdo:?}");
            for entry in pdo.entries {
                let known = objects::ALL.iter().find(|object| {
                    object.index == entry.index
                        && (object.sub == entry.sub || object.index == objects::PROCESS_VALUE.index)
                });
                assert_eq!(known.map(|object| object.bits()), Some(entry.bits), "{entry:?}");
            }
        }
    }

    #[test]
    fn every_mode_map_is_a_supported_mode_and_starts_with_the_words() {
        for profile in ALL {
            let Role::Servo { supported_modes, modes, .. } = profile.role else { continue };
            for map in modes {
                assert!(map.mode.is_in(supported_modes));
                assert_eq!(map.pdos.rpdo[0].offset_bits(objects::CONTROLWORD), Some(0));
                assert_eq!(map.pdos.tpdo[0].offset_bits(objects::STATUSWORD), Some(0));
                assert_eq!(map.pdos.tpdo[0].offset_bits(objects::POSITION_ACTUAL), Some(16));
            }
        }
    }

    #[test]
    fn names_are_found() {
        assert_eq!(find("simulated-servo").map(|profile| profile.identity), Some(SIMULATED_SERVO.identity));
        assert!(find("no-such-device").is_none());
        for profile in ALL {
            assert_eq!(find(profile.name).map(|found| found.name), Some(profile.name));
        }
    }

    #[test]
    fn payload_lengths_are_those_of_the_bus_budget() {
        let lengths = |mode| {
            let map = SIMULATED_SERVO.pdos(Some(mode)).unwrap();
            (map.rpdo[0].len(), map.tpdo[0].len())
        };
        assert_eq!(lengths(OperationMode::CyclicTorque), (4, 6));
        assert_eq!(lengths(OperationMode::CyclicPosition), (6, 6));
        assert_eq!(lengths(OperationMode::CyclicVelocity), (6, 6));
        let sensor = SIMULATED_FORCE_SENSOR.pdos(None).unwrap();
        assert_eq!(sensor.tpdo.iter().map(PdoMapping::len).collect::<Vec<_>>(), [8, 6]);
    }

    #[test]
    fn mapping_entries_are_the_literals_of_the_standard() {
        assert_eq!(MappingEntry::of(objects::CONTROLWORD).to_u32(), 0x6040_0010);
        assert_eq!(MappingEntry::of(objects::PROCESS_VALUE.at(6)).to_u32(), 0x7130_0610);
    }
}
