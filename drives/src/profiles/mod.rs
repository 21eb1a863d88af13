//! A device model as the master needs it: identity, process data per mode, limits, watchdogs, peculiarities.
//!
//! A profile is a file. [`SHIPPED`] holds the texts of the files in `drives/profiles`; the main crate reads them as it reads
//! rigs, with the feature `config` of this crate.

mod axes;
mod limits;
mod sensor;
mod servo;

pub use axes::{Axes, AxisOffset};
pub use limits::{CurrentLimit, LimitSetter, Limits, MotorSpeed, TorqueLimit};
pub use sensor::{ForceSensor, Numbers, Scaling, SensorObjects, StatusBits};
pub use servo::{
    BitState, Brake, BrakeHolder, BrakeOutput, BuiltInWatch, CycleTime, Encoder, EncoderKind, EncoderSide,
    HeartbeatWatch, Homing, OptionCodes, PositionAtHome, ProcessData, Reaction, Servo, ServoObjects, SetPointWatch,
    Setting, SyncWatch, TimeUnit, TimedObject, Watchdogs,
};

use std::collections::BTreeMap;

#[cfg(feature = "config")]
use garde::Validate;
#[cfg(feature = "config")]
use schemars::JsonSchema;
#[cfg(feature = "config")]
use serde::{Deserialize, Serialize};

use crate::cia402::OperationMode;

macro_rules! shipped {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../profiles/", $name, ".yaml")))),*]
    };
}

/// First indices of the mappings of RPDOs and TPDOs.
const FIRST_RPDO: u16 = 0x1600;
const FIRST_TPDO: u16 = 0x1a00;

/// The profiles that come with the program: name and text, in alphabetical order.
pub const SHIPPED: &[(&str, &str)] = shipped![
    "ati-ethercat",
    "ati-ethercat-28-bytes",
    "elmo-gold",
    "inovance-sv660n",
    "maxon-epos4",
    "simulated-force-sensor",
    "simulated-servo",
    "synapticon-somanet",
    "triamec-tsd80e",
    "zeroerr-edriver",
];

/// A device model: a servo drive of CiA 402 or a six-axis force sensor, on CANopen or EtherCAT.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct DeviceProfile {
    /// Name of the profile, and its sources.
    #[cfg_attr(feature = "config", garde(dive))]
    pub profile: About,
    /// Identity that the device reports.
    #[cfg_attr(feature = "config", garde(dive))]
    pub identity: Identity,
    /// Behaviour as a node.
    #[cfg_attr(feature = "config", garde(dive))]
    pub node: NodeTraits,
    /// Role of the device.
    #[cfg_attr(feature = "config", garde(dive))]
    pub device: Role,
}

/// Name of a profile, and its sources.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct About {
    /// Name for messages.
    #[cfg_attr(feature = "config", garde(length(min = 1)))]
    pub name: String,
    /// Device on which the profile was tried.
    pub tried: Tried,
    /// Buses for which its process data are written. Left out: both.
    #[cfg_attr(feature = "config", serde(default = "Fieldbus::all", skip_serializing_if = "Fieldbus::are_all"))]
    #[cfg_attr(feature = "config", garde(length(min = 1, max = 2)))]
    pub buses: Vec<Fieldbus>,
    /// Meanings of its error codes: the name of a table that comes with the program, or the file of a table (`.yaml`), relative
    /// to this file. Left out: the meanings in the standards.
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Option::is_none"), garde(length(min = 1)))]
    pub error_codes: Option<String>,
    /// Documents behind the profile, by the short names that `source` uses.
    #[cfg_attr(feature = "config", garde(length(min = 1)))]
    pub sources: BTreeMap<String, String>,
}

/// A bus that carries objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum Fieldbus {
    /// CANopen.
    Canopen,
    /// CANopen over EtherCAT (CoE).
    Ethercat,
}

impl Fieldbus {
    /// All buses.
    pub fn all() -> Vec<Self> {
        vec![Fieldbus::Canopen, Fieldbus::Ethercat]
    }

    #[cfg(feature = "config")]
    fn are_all(buses: &[Self]) -> bool {
        Self::all().iter().all(|bus| buses.contains(bus))
    }

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Fieldbus::Canopen => "CANopen",
            Fieldbus::Ethercat => "EtherCAT",
        }
    }
}

/// Device on which a profile was tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum Tried {
    /// No device: the profile is written from documents.
    Never,
    /// Only the simulated device.
    Simulation,
    /// The real device.
    Bench,
}

/// Identity that a device reports: 1000h and 1018h, without the serial number.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct Identity {
    /// Device type, 1000h; `null` if no source gives it: the program then accepts any.
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<u32>"))]
    pub device_type: Option<u32>,
    /// Vendor, 1018h:1.
    pub vendor_id: u32,
    /// Products that the profile is for, 1018h:2.
    #[cfg_attr(feature = "config", garde(length(min = 1, max = 64)))]
    pub product_codes: Vec<u32>,
    /// Revisions that the profile is for, 1018h:3.
    pub revisions: Revisions,
}

/// Revisions that a profile is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case", deny_unknown_fields))]
pub enum Revisions {
    /// All revisions: the program does not read 1018h:3.
    Any,
    /// A range, including both ends.
    Range {
        /// First revision.
        from: u32,
        /// Last revision.
        to: u32,
    },
}

impl Revisions {
    /// Returns an identity that the profile accepts.
    pub const fn example(self) -> u32 {
        match self {
            Revisions::Any => 0x0001_0000,
            Revisions::Range { from, .. } => from,
        }
    }

    /// Whether the profile is for this revision.
    pub fn includes(self, revision: u32) -> bool {
        match self {
            Revisions::Any => true,
            Revisions::Range { from, to } => (from..=to).contains(&revision),
        }
    }
}

impl std::fmt::Display for Revisions {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Revisions::Any => write!(formatter, "any"),
            Revisions::Range { from, to } if from == to => write!(formatter, "{from:#x}"),
            Revisions::Range { from, to } => write!(formatter, "{from:#x} to {to:#x}"),
        }
    }
}

/// Behaviour of a device as a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct NodeTraits {
    /// Command that resets the device to its power-on values before the configuration.
    pub reset: Reset,
    /// Whether that reset makes a drive lose its zero.
    pub reset_loses_reference: Known,
    /// Longest time from the reset to the boot-up message, ms. 1 to 60 000.
    #[cfg_attr(feature = "config", garde(range(min = 1, max = 60_000)))]
    pub boot_up_ms: u32,
    /// Longest time to the answer to one SDO request, ms. 1 to 60 000.
    #[cfg_attr(feature = "config", garde(range(min = 1, max = 60_000)))]
    pub sdo_ms: u32,
    /// Longest time from the start command to the first heartbeat in Operational, ms. 1 to 60 000.
    #[cfg_attr(feature = "config", garde(range(min = 1, max = 60_000)))]
    pub start_ms: u32,
}

/// The NMT command that resets a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum Reset {
    /// Reset node: the whole device restarts.
    Node,
    /// Reset communication: the communication objects restart; the drive's own objects stay.
    Communication,
}

/// Statement of a source, or its absence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum Known {
    /// Yes.
    Yes,
    /// No.
    No,
    /// No source says so; the program assumes the safe answer.
    Unknown,
}

/// Role of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"), garde(allow_unvalidated))]
pub enum Role {
    /// A servo drive of CiA 402.
    Servo(#[cfg_attr(feature = "config", garde(dive))] Box<Servo>),
    /// A six-axis force sensor.
    ForceSensor(#[cfg_attr(feature = "config", garde(dive))] Box<ForceSensor>),
}

/// An object of the device, and the source for it.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct Entry {
    /// Index in the object dictionary.
    #[cfg_attr(feature = "config", garde(range(min = 0x1000, max = 0xbfff)))]
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Length in bits: 8, 16 or 32; for a force sensor also 24.
    pub bits: u8,
    /// Source: a key of `profile.sources`.
    #[cfg_attr(feature = "config", garde(length(min = 1)))]
    pub source: String,
}

impl Entry {
    /// Length in bytes.
    pub fn bytes(&self) -> u8 {
        self.bits / 8
    }
}

/// Meaning of a mapped object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum Quantity {
    /// Controlword of a drive.
    Controlword,
    /// Target position, counts.
    TargetPosition,
    /// Target velocity, counts/s.
    TargetVelocity,
    /// Target torque, per mille of the rated torque.
    TargetTorque,
    /// Digital outputs of a drive; with one of them the master holds its brake.
    DigitalOutputs,
    /// Statusword of a drive.
    Statusword,
    /// Actual position, counts.
    PositionActual,
    /// Force along x of a sensor, counts.
    Fx,
    /// Force along y.
    Fy,
    /// Force along z.
    Fz,
    /// Torque about x.
    Tx,
    /// Torque about y.
    Ty,
    /// Torque about z.
    Tz,
    /// Status of a sensor's sample.
    Status,
    /// Second status of a sensor's sample, for an overload.
    Overload,
    /// Counter of a sensor's samples.
    SampleCounter,
    /// Bits without an object: index 0 in the mapping. 1 to 255.
    Gap(u8),
    /// An object without meaning to the rig.
    Unused(Unused),
}

/// A mapped object without meaning to the rig. The master sends `value` in an output, or the value that the boot writes to the
/// object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields))]
pub struct Unused {
    /// Index in the object dictionary; 0005h and the like are the dummies of CANopen.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Length in bits. 1 to 64.
    pub bits: u8,
    /// Value of an output; negative values in two's complement. Left out: the value that the boot writes to the object, otherwise
    /// 0.
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Option::is_none"))]
    pub value: Option<i32>,
}

impl Quantity {
    /// Channels of a force sensor in their order.
    pub const CHANNELS: [Quantity; 6] =
        [Quantity::Fx, Quantity::Fy, Quantity::Fz, Quantity::Tx, Quantity::Ty, Quantity::Tz];

    /// Returns its word in a profile.
    pub const fn word(self) -> &'static str {
        match self {
            Quantity::Controlword => "controlword",
            Quantity::TargetPosition => "target_position",
            Quantity::TargetVelocity => "target_velocity",
            Quantity::TargetTorque => "target_torque",
            Quantity::DigitalOutputs => "digital_outputs",
            Quantity::Statusword => "statusword",
            Quantity::PositionActual => "position_actual",
            Quantity::Fx => "fx",
            Quantity::Fy => "fy",
            Quantity::Fz => "fz",
            Quantity::Tx => "tx",
            Quantity::Ty => "ty",
            Quantity::Tz => "tz",
            Quantity::Status => "status",
            Quantity::Overload => "overload",
            Quantity::SampleCounter => "sample_counter",
            Quantity::Gap(_) => "gap",
            Quantity::Unused(_) => "unused",
        }
    }
}

/// Configuration of one PDO.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct Pdo {
    /// Number of the PDO, 1 to 512 (on CANopen 1 to 4), or the object of its mapping: 0x1600 to 0x17ff for an RPDO, 0x1a00 to
    /// 0x1bff for a TPDO.
    #[cfg_attr(feature = "config", garde(range(min = 1, max = 0x1bff)))]
    pub number: u16,
    /// Whether the mapping is fixed in the device. The master then compares it, and never writes it.
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "std::ops::Not::not"))]
    pub fixed: bool,
    /// Transmission type on CANopen: 1 to 240 every n-th SYNC, 254 and 255 event-driven; 1 if left out. EtherCAT has no
    /// transmission type.
    #[cfg_attr(feature = "config", garde(range(min = 1)), serde(default = "every_sync"))]
    pub transmission_type: u8,
    /// Mapped objects in the order of the payload; on CANopen at most 8 bytes.
    #[cfg_attr(feature = "config", garde(length(min = 1, max = 254)))]
    pub maps: Vec<Quantity>,
}

#[cfg(feature = "config")]
fn every_sync() -> u8 {
    1
}

impl Pdo {
    /// Returns its number on CANopen; 0, which no PDO has, if the PDO cannot be one of CANopen.
    pub fn canopen_number(&self) -> u8 {
        u8::try_from(self.number()).unwrap_or(0)
    }

    /// Its number, counted from 1.
    pub fn number(&self) -> u16 {
        match self.number {
            index @ FIRST_TPDO.. => index - FIRST_TPDO + 1,
            index @ FIRST_RPDO.. => index - FIRST_RPDO + 1,
            number => number,
        }
    }
}

/// PDOs of a device. The directions are those of the device: it receives RPDOs and transmits TPDOs.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct PdoMap {
    /// PDOs that the master sends and the device receives. On CANopen one PDO, which carries controlword and set-point.
    #[cfg_attr(feature = "config", garde(length(max = 16), dive))]
    pub rpdo: Vec<Pdo>,
    /// PDOs that the device sends; on CANopen at most 4.
    #[cfg_attr(feature = "config", garde(length(min = 1, max = 16), dive))]
    pub tpdo: Vec<Pdo>,
}

/// One PDO with the objects that it maps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MappedPdo {
    /// Its number, counted from 1.
    pub number: u16,
    /// Number of the default identifier that the PDO uses on CANopen, 1 to 4: its own number. On a device with several axes it is
    /// the next number that no axis before it uses. Another number means no identifier.
    pub identifier: u8,
    /// Transmission type on CANopen.
    pub transmission_type: u8,
    /// Whether the mapping is fixed in the device.
    pub is_fixed: bool,
    /// The objects in the order of the payload.
    pub objects: Vec<MappedObject>,
}

/// One object in process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MappedObject {
    /// Index; 0 for bits without an object.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Length in bits.
    pub bits: u8,
    /// Its meaning to the rig, if any.
    pub quantity: Option<Quantity>,
    /// Value of an output without a meaning, if the profile gives it.
    pub value: Option<i32>,
}

impl MappedObject {
    /// An object that means `quantity`.
    const fn of(entry: &Entry, quantity: Quantity) -> Self {
        Self { index: entry.index, sub: entry.sub, bits: entry.bits, quantity: Some(quantity), value: None }
    }

    /// The value of the mapping parameter (1600h, 1A00h and following).
    ///
    /// # Source
    /// CiA 301, PDO mapping parameter record: index, sub-index, length in bits, from the highest byte down.
    pub fn to_u32(&self) -> u32 {
        u32::from(self.index) << 16 | u32::from(self.sub) << 8 | u32::from(self.bits)
    }
}

impl MappedPdo {
    /// Returns its number on CANopen; 0, which no PDO has, if the PDO cannot be one of CANopen.
    pub fn canopen_number(&self) -> u8 {
        u8::try_from(self.number).unwrap_or(0)
    }

    /// Place of the object of a quantity in the payload, counted from 0.
    pub fn position(&self, quantity: Quantity) -> Option<usize> {
        self.objects.iter().position(|object| object.quantity == Some(quantity))
    }

    /// Whether it follows SYNC.
    ///
    /// # Source
    /// CiA 301, transmission type: 0 to 240 are synchronous.
    pub fn is_synchronous(&self) -> bool {
        self.transmission_type <= 240
    }

    /// Payload length in bytes.
    pub fn bytes(&self) -> usize {
        self.objects.iter().map(|object| usize::from(object.bits)).sum::<usize>().div_ceil(8)
    }
}

impl DeviceProfile {
    /// Its name.
    pub fn name(&self) -> &str {
        &self.profile.name
    }

    /// Whether its process data are written for a bus.
    pub fn is_for(&self, bus: Fieldbus) -> bool {
        self.profile.buses.contains(&bus)
    }

    /// The drive; `None` for a sensor.
    pub fn servo(&self) -> Option<&Servo> {
        match &self.device {
            Role::Servo(servo) => Some(servo),
            Role::ForceSensor(_) => None,
        }
    }

    /// The force sensor; `None` for a drive.
    pub fn force_sensor(&self) -> Option<&ForceSensor> {
        match &self.device {
            Role::ForceSensor(sensor) => Some(sensor),
            Role::Servo(_) => None,
        }
    }

    /// Returns the PDOs of a drive in `mode`, or of a sensor (`None`); nothing if the model lacks the mode.
    pub fn pdos(&self, mode: Option<OperationMode>) -> Option<&PdoMap> {
        match (&self.device, mode) {
            (Role::Servo(servo), Some(mode)) => servo.process_data.of(mode),
            (Role::ForceSensor(sensor), None) => Some(&sensor.process_data),
            _ => None,
        }
    }

    /// Returns the PDOs of [`DeviceProfile::pdos`] that the device receives and sends, with the objects that they map.
    pub fn mapped(&self, mode: Option<OperationMode>) -> Option<[Vec<MappedPdo>; 2]> {
        let map = self.pdos(mode)?;
        Some([&map.rpdo, &map.tpdo].map(|pdos| {
            let before = self.identifiers_before(pdos.len());
            let identifier = |place: usize| Some(u8::try_from(before? + place + 1).unwrap_or(0));
            let pdo = |(place, pdo): (usize, &Pdo)| {
                let mapped = self.mapped_pdo(pdo);
                MappedPdo { identifier: identifier(place).unwrap_or(mapped.identifier), ..mapped }
            };
            pdos.iter().enumerate().map(pdo).collect()
        }))
    }

    /// Returns a PDO with the objects that it maps. Objects that the device lacks are left out.
    pub fn mapped_pdo(&self, pdo: &Pdo) -> MappedPdo {
        MappedPdo {
            number: pdo.number(),
            identifier: pdo.canopen_number(),
            transmission_type: pdo.transmission_type,
            is_fixed: pdo.fixed,
            objects: pdo.maps.iter().filter_map(|quantity| self.mapped_object(*quantity)).collect(),
        }
    }

    /// Whether the device has the object of a quantity, so that it can be mapped.
    pub fn maps(&self, quantity: Quantity) -> bool {
        self.mapped_object(quantity).is_some()
    }

    fn mapped_object(&self, quantity: Quantity) -> Option<MappedObject> {
        match quantity {
            Quantity::Gap(bits) => Some(MappedObject { index: 0, sub: 0, bits, quantity: None, value: None }),
            Quantity::Unused(Unused { index, sub, bits, value }) => {
                Some(MappedObject { index, sub, bits, quantity: None, value })
            }
            quantity => Some(MappedObject::of(self.object(quantity)?, quantity)),
        }
    }

    /// Returns the largest number of objects in one PDO.
    pub fn mapping_entries(&self) -> u8 {
        match &self.device {
            Role::Servo(servo) => servo.process_data.mapping_entries,
            Role::ForceSensor(sensor) => sensor.mapping_entries,
        }
    }

    /// Returns the object of a quantity; `None` if the device has none.
    pub fn object(&self, quantity: Quantity) -> Option<&Entry> {
        match &self.device {
            Role::Servo(servo) => servo.object(quantity),
            Role::ForceSensor(sensor) => sensor.object(quantity),
        }
    }
}

/// Reads a key that may be `null` but must be written.
#[cfg(feature = "config")]
fn present<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
where
    D: serde::Deserializer<'de>,
    T: Deserialize<'de>,
{
    Option::deserialize(deserializer)
}

/// The schema of a key that may be `null` but must be written.
#[cfg(feature = "config")]
fn nullable<T: JsonSchema>(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
    generator.subschema_for::<Option<T>>()
}
