//! From the bits of a force sensor's process data to a sample.

use yieldwall_drives::profiles::{DeviceProfile, Numbers, Quantity, Scaling, StatusBits};
use yieldwall_fieldbus::objects::{mask, sign_extend};
use yieldwall_motion::sensing::RawSample;

/// No sample yet.
pub(crate) const NO_SAMPLE: RawSample =
    RawSample { counts: [0; 6], sequence: None, overload: false, invalid: false, age_ns: 0 };

/// Meaning of the bits of a force sensor's process data.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SampleCodec {
    numbers: Numbers,
    status_bits: StatusBits,
    /// Whether `status_bits.overload` are bits of a status of their own.
    has_overload: bool,
    /// Counts per N and per N m of numbers that are in N and N m.
    counts_per_unit: [f64; 2],
}

impl SampleCodec {
    /// Forces among the channels.
    const FORCES: usize = 3;

    /// The codec of a sensor; one of a drive takes nothing for a sample.
    pub fn new(profile: &DeviceProfile) -> Self {
        let Some(sensor) = profile.force_sensor() else { return Self::default() };
        Self {
            numbers: sensor.objects.numbers,
            status_bits: sensor.status_bits,
            has_overload: sensor.objects.overload.is_some(),
            counts_per_unit: match sensor.scaling {
                Some(Scaling::Constant { per_n, per_n_m }) => [per_n, per_n_m].map(f64::from),
                _ => [1.0; 2],
            },
        }
    }

    /// Takes `bits` bits of a value, 1 to 32, from the low part of `raw` into a sample whose flags were not set before. Returns
    /// whether the bits were those of a channel. A number that is not finite makes the sample invalid; a number beyond 32 bits of
    /// counts becomes the greatest.
    ///
    /// Real-time: yes.
    pub fn take(&self, quantity: Quantity, raw: u64, bits: u8, sample: &mut RawSample) -> bool {
        let raw = raw & mask(bits);
        let word = raw as u32;
        match quantity {
            Quantity::Status => {
                sample.overload |= !self.has_overload && word & self.status_bits.overload != 0;
                sample.invalid |= word & self.status_bits.invalid != 0;
            }
            Quantity::Overload => sample.overload |= word & self.status_bits.overload != 0,
            Quantity::SampleCounter => sample.sequence = Some(word as u8),
            quantity => {
                let Some(channel) = Quantity::CHANNELS.iter().position(|channel| *channel == quantity) else {
                    return false;
                };
                let counts = match self.numbers {
                    Numbers::Signed => sign_extend(raw, bits) as i32,
                    // The greatest value is below 2^32, and half of the range is zero.
                    Numbers::Unsigned => (raw as i64 - (1 << (bits.clamp(1, 32) - 1))) as i32,
                    Numbers::Real => {
                        let value = f64::from(f32::from_bits(word));
                        sample.invalid |= !value.is_finite();
                        let [per_n, per_n_m] = self.counts_per_unit;
                        // Not a number casts to 0, and what is too large to the ends of the range.
                        (value * if channel < Self::FORCES { per_n } else { per_n_m }).round() as i32
                    }
                };
                if let Some(to) = sample.counts.get_mut(channel) {
                    *to = counts;
                }
                return true;
            }
        }
        false
    }
}

#[cfg(test)]
mod tests;
