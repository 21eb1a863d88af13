//! A six-axis force sensor on CANopen or EtherCAT: its objects, its process data, and the meaning of its numbers.

#[cfg(feature = "config")]
use garde::Validate;
#[cfg(feature = "config")]
use schemars::JsonSchema;
#[cfg(feature = "config")]
use serde::{Deserialize, Serialize};

use super::{Entry, PdoMap, Quantity, Setting};
#[cfg(feature = "config")]
use super::{nullable, present};

/// A six-axis force sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct ForceSensor {
    /// Its objects.
    #[cfg_attr(feature = "config", garde(dive))]
    pub objects: SensorObjects,
    /// Largest number of objects in one PDO. 1 to 64.
    #[cfg_attr(feature = "config", garde(range(min = 1, max = 64)))]
    pub mapping_entries: u8,
    /// Its PDOs.
    #[cfg_attr(feature = "config", garde(dive))]
    pub process_data: PdoMap,
    /// Bits of its status.
    pub status_bits: StatusBits,
    /// Sample rates of the sensor, Hz; empty if it takes any whole number from 1 to 10 000.
    #[cfg_attr(feature = "config", garde(length(max = 64)))]
    pub sample_rates_hz: Vec<u32>,
    /// Counts per unit. Left out if they differ from sensor to sensor; then only `calibration` of the rig gives them.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Option::is_none"))]
    pub scaling: Option<Scaling>,
    /// Objects and values that make the sensor take its present reading as zero, in their order: one per channel, or some for all
    /// channels. Left out if the sensor cannot do it.
    #[cfg_attr(feature = "config", garde(length(max = 6), dive))]
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Vec::is_empty"))]
    pub zero: Vec<Setting>,
}

/// Objects of a force sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct SensorObjects {
    /// Process values Fx Fy Fz Tx Ty Tz, of 8, 16, 24 or 32 bits.
    #[cfg_attr(feature = "config", garde(dive))]
    pub channels: [Entry; 6],
    /// Number format of the channels; signed whole numbers if left out.
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Numbers::is_signed"))]
    pub numbers: Numbers,
    /// Status of the newest sample; null if there is none.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<Entry>"))]
    pub status: Option<Entry>,
    /// A second status, which holds the bits `status_bits.overload`. Left out if `status` holds them.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(default, skip_serializing_if = "Option::is_none"))]
    pub overload: Option<Entry>,
    /// Counter that rises by one with each new sample; null if there is none.
    #[cfg_attr(feature = "config", garde(dive))]
    #[cfg_attr(feature = "config", serde(deserialize_with = "present"), schemars(schema_with = "nullable::<Entry>"))]
    pub sample_counter: Option<Entry>,
}

/// Number format of a channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case"))]
pub enum Numbers {
    /// Whole numbers in two's complement.
    #[default]
    Signed,
    /// Unsigned whole numbers; the middle of the range is zero (offset binary).
    Unsigned,
    /// IEEE 754 numbers of 32 bits (REAL32), in N and N m; `scaling.constant` gives the counts per N and per N m that the program
    /// uses.
    Real,
}

impl Numbers {
    #[cfg(feature = "config")]
    fn is_signed(&self) -> bool {
        *self == Numbers::Signed
    }

    /// Returns the largest number of counts of a channel of this width.
    pub fn most_counts(self, bits: u8) -> u32 {
        // Counts are signed words in this program.
        let bits = if self == Numbers::Real { 32 } else { u32::from(bits).clamp(2, 32) };
        u32::MAX >> (33 - bits)
    }
}

/// Bits in a force sensor's status. Any of several bits counts; 0 means that there is no such bit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields))]
pub struct StatusBits {
    /// Bits for a channel at the end of its range.
    pub overload: u32,
    /// Bits for an invalid sample.
    pub invalid: u32,
}

/// Counts per unit of a sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(rename_all = "snake_case", deny_unknown_fields), garde(allow_unvalidated))]
pub enum Scaling {
    /// Fixed counts per unit, equal for all sensors of the model.
    Constant {
        /// Counts per N, 1 and up.
        per_n: u32,
        /// Counts per N m, 1 and up.
        per_n_m: u32,
    },
    /// Counts per unit that the sensor reports. The boot reads both and compares them with `calibration` of the rig.
    Objects {
        /// Counts per N.
        #[cfg_attr(feature = "config", garde(dive))]
        per_n: Entry,
        /// Counts per N m.
        #[cfg_attr(feature = "config", garde(dive))]
        per_n_m: Entry,
    },
}

impl Scaling {
    /// Whether two numbers of counts per unit differ by at most a tenth. Calibrations of two sensors differ by less, and two
    /// units by more.
    pub fn agrees(counts: u32, wanted: f64) -> bool {
        (f64::from(counts) - wanted).abs() <= 0.1 * wanted
    }
}

impl ForceSensor {
    /// Returns the object of a quantity; `None` if the sensor has none.
    pub fn object(&self, quantity: Quantity) -> Option<&Entry> {
        match quantity {
            Quantity::Status => self.objects.status.as_ref(),
            Quantity::Overload => self.objects.overload.as_ref(),
            Quantity::SampleCounter => self.objects.sample_counter.as_ref(),
            _ => {
                let channel = Quantity::CHANNELS.iter().position(|channel| *channel == quantity)?;
                self.objects.channels.get(channel)
            }
        }
    }

    /// Whether the sensor can report an invalid sample: by a bit of its status, or by values that are not numbers.
    pub fn shows_invalid(&self) -> bool {
        self.status_bits.invalid != 0 || self.objects.numbers == Numbers::Real
    }

    /// Returns the largest number of counts that all of its channels can have.
    pub fn most_counts(&self) -> u32 {
        let of = |channel: &Entry| self.objects.numbers.most_counts(channel.bits);
        self.objects.channels.iter().map(of).min().unwrap_or(1)
    }
}
