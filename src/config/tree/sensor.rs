//! The force sensor.

use garde::Validate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::profile::ProfileName;
use super::waits::Waits;
use crate::number::{Finite, NotNegative, Positive, nullable, present};

/// A six-axis force sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Sensor {
    /// Name for reports and messages.
    #[garde(length(min = 1))]
    pub name: String,
    /// Bus of the sensor: a key of `buses`.
    pub bus: String,
    /// Protocol of the sensor on that bus, and its identifiers.
    #[garde(dive)]
    pub protocol: SensorProtocol,
    /// Sample rate, Hz. On CANopen the fastest rate of the profile that is not above the rate of the cycle. On other buses the
    /// rate to which the sensor is set: a whole number from 1 to 10 000, or a rate of its profile.
    #[garde(dive)]
    pub sample_rate_hz: Positive,
    /// Calibration matrix: wrench = matrix * counts; rows Fx Fy Fz (N per count) then Tx Ty Tz (N m per count).
    pub calibration: [[Finite; 6]; 6],
    /// Counts at which the sensor saturates, 1 and up; at most what its channels can send, which is 32 767 on plain CAN.
    #[garde(range(min = 1, max = 2_147_483_647))]
    pub range_counts: u32,
    /// Link on which the sensor turns.
    pub mounted_on: Mount,
    /// Angle of the sensor's x axis relative to that link, rad.
    pub mounting_angle_rad: Finite,
    /// Mass beyond the sensor, kg. 0 or above. The program subtracts its inertia from the reading. It is a part of the tool's
    /// mass; the simulated sensor carries it.
    #[garde(dive)]
    pub handle_mass_kg: NotNegative,
    /// Corner frequency of the low pass on the force, Hz, below half the sampling rate of the control; null for no filter.
    #[garde(dive)]
    #[serde(deserialize_with = "present")]
    #[schemars(schema_with = "nullable::<Positive>")]
    pub low_pass_hz: Option<Positive>,
    /// Largest force that the rig accepts as the zero of the sensor each time it is enabled, N. Nobody may touch the handle then.
    /// Left out: no tare; the sensor's own zero counts.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tare_up_to_n: Option<Positive>,
    /// Times for which the boot of the network waits for the sensor. Left out: the usual times.
    #[garde(dive)]
    #[serde(default)]
    pub waits: Waits,
}

/// Protocol of a force sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub enum SensorProtocol {
    /// A CANopen node whose process data follow SYNC.
    Canopen {
        /// CANopen node-ID, 1 to 127; each node of the bus has its own.
        #[garde(range(min = 1, max = 127))]
        node_id: u8,
        /// Device model: identity, process data and status bits.
        profile: ProfileName,
        /// Heartbeat period of the sensor, ms; this program watches it. 1 to 10 000, at least two control periods.
        #[garde(range(min = 1, max = 10_000))]
        heartbeat_ms: u16,
        /// Whether the sensor zeroes itself during the boot, by the objects `zero` of its profile. Nobody may touch the handle
        /// then. No if left out.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        zero_at_start: bool,
    },
    /// Plain CAN: the sensor streams samples by its own clock, each in two frames, as the Robotous RFT series does.
    Streaming {
        /// Identifier of commands to the sensor. 1 to 2047, written 0x001 to 0x7ff.
        #[garde(range(min = 1, max = 0x7ff))]
        command_id: u16,
        /// Identifiers of the two frames of a sample, the first below the second. 1 to 2047.
        #[garde(inner(range(min = 1, max = 0x7ff)))]
        data_ids: [u16; 2],
        /// Longest time from the first frame of a sample to its second, us. 1 to 1 000 000. Longer than other frames can delay
        /// the second frame, shorter than the time between samples.
        #[garde(range(min = 1, max = 1_000_000))]
        pair_gap_us: u32,
        /// Whether the program commands the sensor to zero itself at each start. Nobody may touch the handle then.
        zero_at_start: bool,
    },
    /// Plain CAN: the program asks the sensor in every cycle, and the sensor answers with two frames, as the ATI Net F/T does.
    Polled {
        /// Identifier of requests; the answers have the identifiers 5 and 6 above it. 1 to 2041, written 0x001 to 0x7f9.
        #[garde(range(min = 1, max = 0x7f9))]
        base_id: u16,
        /// Byte order of a number.
        byte_order: ByteOrder,
        /// Bits of the status word that report a channel at the end of its range, such as 0x0002. Any of them counts.
        overload_bits: u16,
        /// Bits of the status word that report an invalid sample. Any of them counts.
        invalid_bits: u16,
        /// Longest time from the first frame of an answer to its second, us. 1 to 1 000 000.
        #[garde(range(min = 1, max = 1_000_000))]
        pair_gap_us: u32,
        /// Whether the program commands the sensor to zero itself at each start. Nobody may touch the handle then.
        zero_at_start: bool,
    },
    /// A device of an EtherCAT segment.
    Ethercat {
        /// Number of devices between the computer and this device. 0 for the first one; each device has its own number.
        position: u16,
        /// Device model: identity, process data and status bits; `ati-ethercat` if left out.
        #[serde(default = "usual_on_ethercat", skip_serializing_if = "is_usual_on_ethercat")]
        profile: ProfileName,
        /// Whether the sensor zeroes itself during the boot, by the objects `zero` of its profile. Nobody may touch the handle
        /// then. No if left out.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        zero_at_start: bool,
    },
}

/// Model of a sensor on EtherCAT for which the rig names none.
fn usual_on_ethercat() -> ProfileName {
    ProfileName::from("ati-ethercat".to_owned())
}

fn is_usual_on_ethercat(name: &ProfileName) -> bool {
    name.as_str() == usual_on_ethercat().as_str()
}

impl Sensor {
    /// Counts per N and per N m, by the mean of the rows of `calibration` of each.
    pub fn counts_per_unit(&self) -> [f64; 2] {
        let size = |row: &[Finite; 6]| row.iter().map(|gain| **gain * **gain).sum::<f64>().sqrt();
        let [fx, fy, fz, tx, ty, tz] = &self.calibration;
        [[fx, fy, fz], [tx, ty, tz]].map(|rows| 3.0 / rows.map(size).iter().sum::<f64>())
    }

    /// Whether samples carry no counter while the process data come in every cycle. Then each arrival counts as a sample.
    pub fn counts_arrivals(&self) -> bool {
        let model = self.protocol.profile().and_then(|profile| profile.get()?.force_sensor());
        model.is_some_and(|model| {
            let tpdos = &model.process_data.tpdo;
            let is_of_cycle = self.protocol.position().is_some() || tpdos.iter().all(|pdo| pdo.transmission_type == 1);
            model.objects.sample_counter.is_none() && is_of_cycle
        })
    }
}

impl SensorProtocol {
    /// The device model, if the sensor has one.
    pub fn profile(&self) -> Option<&ProfileName> {
        match self {
            SensorProtocol::Canopen { profile, .. } | SensorProtocol::Ethercat { profile, .. } => Some(profile),
            SensorProtocol::Streaming { .. } | SensorProtocol::Polled { .. } => None,
        }
    }

    /// Returns the key and the model, to change it.
    pub(crate) fn profile_mut(&mut self) -> Option<(&'static str, &mut ProfileName)> {
        match self {
            SensorProtocol::Canopen { profile, .. } => Some(("sensor.protocol.canopen.profile", profile)),
            SensorProtocol::Ethercat { profile, .. } => Some(("sensor.protocol.ethercat.profile", profile)),
            SensorProtocol::Streaming { .. } | SensorProtocol::Polled { .. } => None,
        }
    }

    /// Whether the program commands the sensor to zero itself at each start.
    pub fn zero_at_start(&self) -> bool {
        match self {
            SensorProtocol::Canopen { zero_at_start, .. }
            | SensorProtocol::Streaming { zero_at_start, .. }
            | SensorProtocol::Polled { zero_at_start, .. }
            | SensorProtocol::Ethercat { zero_at_start, .. } => *zero_at_start,
        }
    }

    /// Place in an EtherCAT segment.
    pub fn position(&self) -> Option<u16> {
        match self {
            SensorProtocol::Ethercat { position, .. } => Some(*position),
            _ => None,
        }
    }

    /// Node-ID of a sensor that is a CANopen node.
    pub fn node_id(&self) -> Option<u8> {
        match self {
            SensorProtocol::Canopen { node_id, .. } => Some(*node_id),
            _ => None,
        }
    }

    /// Heartbeat period of a sensor that is a CANopen node, ms.
    pub fn heartbeat_ms(&self) -> Option<u16> {
        match self {
            SensorProtocol::Canopen { heartbeat_ms, .. } => Some(*heartbeat_ms),
            _ => None,
        }
    }
}

/// Byte order of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ByteOrder {
    /// The high byte first.
    BigEndian,
    /// The low byte first.
    LittleEndian,
}

/// Link on which a sensor turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mount {
    /// The base: the sensor does not turn.
    Base,
    /// The distal link of the left arm.
    LeftDistal,
    /// The distal link of the right arm.
    RightDistal,
}
