//! The six-axis force sensor of the embedded simulation.

use super::{DeviceProfile, Identity, MappingEntry, PdoMap, PdoMapping, Role, SIMULATED_VENDOR};
use crate::objects::{PROCESS_VALUE, SENSOR_SAMPLE_COUNTER, SENSOR_STATUS};

/// Every PDO is bound to each SYNC.
const EVERY_SYNC: u8 = 1;

/// Bit of the sensor's status byte: a channel is at the end of its range.
pub const STATUS_OVERLOAD: u8 = 1 << 0;
/// Bit of the sensor's status byte: the sample is not valid, as the sensor's own monitoring found.
pub const STATUS_INVALID: u8 = 1 << 1;

/// Force sensor in the manner of CiA 404: process values 7130h:1 to 7130h:6 (Fx Fy Fz Tx Ty Tz, 16-bit counts) in two
/// TPDOs, the second with a status byte and a sample counter, so that the pair can be checked for one sample.
pub const SIMULATED_FORCE_SENSOR: DeviceProfile = DeviceProfile {
    name: "simulated-force-sensor",
    // Bit 17: analogue inputs; low word: profile 404.
    device_type: 0x0002_0194,
    identity: Identity { vendor_id: SIMULATED_VENDOR, product_code: 0x0000_0404, revision: 0x0001_0000 },
    role: Role::ForceSensor {
        pdos: PdoMap {
            rpdo: &[],
            tpdo: &[
                PdoMapping {
                    number: 1,
                    transmission_type: EVERY_SYNC,
                    entries: &[
                        MappingEntry::of(PROCESS_VALUE.at(1)),
                        MappingEntry::of(PROCESS_VALUE.at(2)),
                        MappingEntry::of(PROCESS_VALUE.at(3)),
                        MappingEntry::of(PROCESS_VALUE.at(4)),
                    ],
                },
                PdoMapping {
                    number: 2,
                    transmission_type: EVERY_SYNC,
                    entries: &[
                        MappingEntry::of(PROCESS_VALUE.at(5)),
                        MappingEntry::of(PROCESS_VALUE.at(6)),
                        MappingEntry::of(SENSOR_STATUS),
                        MappingEntry::of(SENSOR_SAMPLE_COUNTER),
                    ],
                },
            ],
        },
        sample_rates_hz: &[200, 500, 1000],
    },
};
