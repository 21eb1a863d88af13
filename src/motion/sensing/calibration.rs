//! Counts to wrench by the sensor's matrix, and back.

use nalgebra::{Matrix6, Vector6};

use super::SensingError;

/// Counts from this fraction of the range on are saturated: a real sensor bends before it clips.
pub const SATURATION_FRACTION: f64 = 0.98;

/// Reciprocal condition number below which a calibration counts as singular. Rows are scaled first, so N beside N m
/// does not matter; a usable sensor is at 0.01 or better.
const LEAST_RECIPROCAL_CONDITION: f64 = 1e-9;

/// One sample as it came from the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RawSample {
    /// Six counts in the order of the calibration's columns.
    pub counts: [i32; 6],
    /// The sensor's own counter of samples, if it sends one: a sample with the counter of the one before is not new.
    pub sequence: Option<u8>,
    /// The sensor's overload bit.
    pub overload: bool,
    /// Whether the sensor says that the counts are not valid.
    pub invalid: bool,
    /// Time from the last frame of the sample to the step that takes it, ns.
    pub age_ns: u32,
}

/// Force and torque in the sensor frame: Fx, Fy, Fz in N, Tx, Ty, Tz in N m, about the sensor's origin, exerted on the
/// sensor by the hand's side. The sensor's z axis is that of the base frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench(pub Vector6<f64>);

/// The linear map between counts and wrench, and the range of the counts.
#[derive(Clone, Debug)]
pub struct Calibration {
    matrix: Matrix6<f64>,
    inverse: Matrix6<f64>,
    range_counts: i32,
    saturated_counts: u32,
}

impl Calibration {
    /// Returns `wrench = matrix * counts`, rows Fx Fy Fz (N per count) Tx Ty Tz (N m per count); counts lie in
    /// `-range_counts..=range_counts`.
    ///
    /// # Errors
    /// [`SensingError::CalibrationNotFinite`], [`SensingError::CalibrationSingular`] if a row is zero or the rows,
    /// scaled to equal size, are dependent to 1e-9, [`SensingError::Range`] for a range below 1,
    /// [`SensingError::OutOfRange`] if full-scale counts overflow.
    pub fn new(matrix: Matrix6<f64>, range_counts: i32) -> Result<Self, SensingError> {
        for row in 0..6 {
            for column in 0..6 {
                let value = matrix[(row, column)];
                if !value.is_finite() {
                    return Err(SensingError::CalibrationNotFinite { row: row + 1, column: column + 1, value });
                }
            }
        }
        if range_counts < 1 {
            return Err(SensingError::Range { received: range_counts });
        }
        let largest = matrix.amax();
        // Any sum over counts and any later product with it stays finite.
        if largest * 6.0 * f64::from(i32::MAX) > 1e100 {
            return Err(SensingError::OutOfRange {
                name: "largest calibration entry",
                value: largest,
                requirement: "small enough for finite wrenches",
            });
        }
        let inverse = invert(&matrix)?;
        let saturated_counts = (SATURATION_FRACTION * f64::from(range_counts)).ceil() as u32;
        Ok(Self { matrix, inverse, range_counts, saturated_counts })
    }

    /// Returns the wrench that the counts stand for, finite for any counts.
    ///
    /// Real-time: yes.
    #[inline]
    pub fn wrench(&self, sample: &RawSample) -> Wrench {
        Wrench(self.matrix * Vector6::from(sample.counts.map(f64::from)))
    }

    /// Whether a count is at 98 % of the range or more, or the overload bit is set.
    ///
    /// Real-time: yes.
    #[inline]
    pub fn is_saturated(&self, sample: &RawSample) -> bool {
        sample.overload || sample.counts.iter().any(|count| count.unsigned_abs() >= self.saturated_counts)
    }

    /// Returns the counts that a sensor with this calibration shows under `wrench`: rounded to whole counts and clipped to the
    /// range. A component that is not finite shows as zero counts, or as the range if infinite.
    ///
    /// Real-time: yes.
    pub fn counts_for(&self, wrench: &Wrench) -> [i32; 6] {
        let range = f64::from(self.range_counts);
        // NaN casts to 0.
        <[f64; 6]>::from(self.inverse * wrench.0).map(|count| count.round().clamp(-range, range) as i32)
    }

    /// Returns the largest rounding error of a wrench that went through counts, per component in N and N m: half a count on every
    /// axis.
    pub fn resolution(&self) -> Wrench {
        Wrench(self.matrix.abs() * Vector6::repeat(0.5))
    }

    /// Returns the range: counts lie in `-range_counts..=range_counts`.
    pub fn range_counts(&self) -> i32 {
        self.range_counts
    }
}

/// Inverse by way of rows of equal size.
fn invert(matrix: &Matrix6<f64>) -> Result<Matrix6<f64>, SensingError> {
    let singular = |reciprocal_condition| SensingError::CalibrationSingular { reciprocal_condition };
    let sizes = Vector6::from_fn(|row, _| matrix.row(row).amax());
    // Subnormal rows would overflow when scaled.
    if sizes.min() < 1e-100 {
        return Err(singular(0.0));
    }
    let scale = Matrix6::from_diagonal(&sizes.map(f64::recip));
    let scaled = scale * matrix;
    let inverse = scaled.try_inverse().ok_or(singular(0.0))?;
    let size = |m: &Matrix6<f64>| m.row_iter().map(|row| row.abs().sum()).fold(0.0, f64::max);
    let reciprocal_condition = 1.0 / (size(&scaled) * size(&inverse));
    if reciprocal_condition >= LEAST_RECIPROCAL_CONDITION {
        Ok(inverse * scale)
    } else {
        Err(singular(reciprocal_condition))
    }
}
