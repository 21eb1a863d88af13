//! Counts and per mille of a drive to SI and back, for one axis.

use std::f64::consts::TAU;

/// Error of scaling.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ScalingError {
    /// A setting that has to be positive and finite is not.
    #[error("{setting} is {value}, but has to be positive and finite")]
    NotPositive {
        /// Name of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
    },
    /// A value that has to be finite is not.
    #[error("{quantity} is {value}, which is not finite")]
    NotFinite {
        /// Name of the quantity.
        quantity: &'static str,
        /// Its value.
        value: f64,
    },
    /// An angle beyond the range that counts can represent.
    #[error("{angle_rad} rad is more than {} counts away from zero", COUNTS_MAX)]
    TooFar {
        /// The angle in rad.
        angle_rad: f64,
    },
}

/// Largest distance from zero in counts that is scaled: beyond it neighbouring counts share an `f64`.
pub const COUNTS_MAX: i64 = 1 << 53;

/// Sign of counts and torque against the joint angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Direction {
    /// Counts rise with the angle.
    #[default]
    Same,
    /// Counts fall with the angle.
    Reversed,
}

impl Direction {
    /// +1 or -1.
    pub const fn sign(self) -> f64 {
        match self {
            Direction::Same => 1.0,
            Direction::Reversed => -1.0,
        }
    }
}

/// A raw set-point that may have been cut off at the end of its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Saturated<T> {
    /// The value, inside the range.
    pub value: T,
    /// Whether the wanted value was outside the range.
    pub is_saturated: bool,
}

/// Scaling of one axis.
///
/// Positions are `i64` counts without wrap; [`CountUnwrapper`] makes them from the `i32` that a drive reports and
/// [`wrap`] makes the `i32` that a drive takes. Both work modulo 2^32, so that a drive whose counter is shifted by any
/// multiple of 2^32 gets the same commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisScaling {
    counts_per_rad: f64,
    zero_offset_rad: f64,
    rated_torque_n_m: f64,
    sign: f64,
}

impl AxisScaling {
    /// Returns the scaling of an axis with `counts_per_rev` counts per revolution of the output (after the gear). The joint angle
    /// at zero counts is `zero_offset_rad`; the rated torque in N m is that at the output.
    ///
    /// # Errors
    /// If a setting is not finite, or counts or rated torque are not positive.
    pub fn new(
        counts_per_rev: f64,
        direction: Direction,
        zero_offset_rad: f64,
        rated_torque_n_m: f64,
    ) -> Result<Self, ScalingError> {
        for (setting, value) in [("counts per revolution", counts_per_rev), ("rated torque", rated_torque_n_m)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(ScalingError::NotPositive { setting, value });
            }
        }
        Ok(AxisScaling {
            counts_per_rad: counts_per_rev / TAU,
            zero_offset_rad: finite("zero offset", zero_offset_rad)?,
            rated_torque_n_m,
            sign: direction.sign(),
        })
    }

    /// Joint angle in rad.
    ///
    /// Real-time: yes.
    pub fn angle_rad(&self, counts: i64) -> f64 {
        self.zero_offset_rad + self.sign * counts as f64 / self.counts_per_rad
    }

    /// The nearest count to a joint angle in rad.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// If the angle is not finite, or more than [`COUNTS_MAX`] counts away.
    pub fn counts(&self, angle_rad: f64) -> Result<i64, ScalingError> {
        let exact = self.sign * (finite("angle", angle_rad)? - self.zero_offset_rad) * self.counts_per_rad;
        let nearest = exact.round();
        if nearest.abs() > COUNTS_MAX as f64 {
            return Err(ScalingError::TooFar { angle_rad });
        }
        Ok(nearest as i64)
    }

    /// Joint rate in rad/s from counts/s.
    ///
    /// Real-time: yes.
    pub fn rate_rad_per_s(&self, counts_per_s: i32) -> f64 {
        self.sign * f64::from(counts_per_s) / self.counts_per_rad
    }

    /// Counts/s from a joint rate in rad/s, cut off at the range of `i32`.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// If the rate is not finite.
    pub fn rate_counts_per_s(&self, rate_rad_per_s: f64) -> Result<Saturated<i32>, ScalingError> {
        let exact = (self.sign * finite("rate", rate_rad_per_s)? * self.counts_per_rad).round();
        let value = exact as i32;
        Ok(Saturated { value, is_saturated: f64::from(value) != exact })
    }

    /// Torque on the joint in N m from per mille of the rated torque.
    ///
    /// Real-time: yes.
    pub fn torque_n_m(&self, per_mille: i16) -> f64 {
        self.sign * f64::from(per_mille) * self.rated_torque_n_m / 1000.0
    }

    /// Per mille of the rated torque from a torque on the joint in N m, cut off at the range of `i16`.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// If the torque is not finite.
    pub fn torque_per_mille(&self, torque_n_m: f64) -> Result<Saturated<i16>, ScalingError> {
        let exact = (self.sign * finite("torque", torque_n_m)? / self.rated_torque_n_m * 1000.0).round();
        let value = exact as i16;
        Ok(Saturated { value, is_saturated: f64::from(value) != exact })
    }

    /// Counts per radian.
    pub const fn counts_per_rad(&self) -> f64 {
        self.counts_per_rad
    }

    /// Rated torque in N m.
    pub const fn rated_torque_n_m(&self) -> f64 {
        self.rated_torque_n_m
    }
}

fn finite(quantity: &'static str, value: f64) -> Result<f64, ScalingError> {
    if value.is_finite() { Ok(value) } else { Err(ScalingError::NotFinite { quantity, value }) }
}

/// The 32 bits of a position that a drive takes or reports.
///
/// Real-time: yes.
pub const fn wrap(counts: i64) -> i32 {
    counts as i32
}

/// Position without wrap from the `i32` that a drive reports: each report is read as the nearest one, modulo 2^32, to
/// the position before. Right as long as the axis moves less than 2^31 counts between two reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CountUnwrapper {
    counts: i64,
}

impl CountUnwrapper {
    /// Starts near an expected position in counts, so that it does not matter on which side of the wrap a drive was
    /// switched on. Zero takes the first report as it is.
    pub const fn near(expected_counts: i64) -> Self {
        CountUnwrapper { counts: expected_counts }
    }

    /// Takes one report; the position without wrap.
    ///
    /// Real-time: yes.
    pub const fn unwrap(&mut self, reported: i32) -> i64 {
        self.counts = self.counts.wrapping_add(reported.wrapping_sub(wrap(self.counts)) as i64);
        self.counts
    }

    /// The position after the last report.
    ///
    /// Real-time: yes.
    pub const fn counts(&self) -> i64 {
        self.counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rig_axis(direction: Direction) -> AxisScaling {
        AxisScaling::new(800_000.0, direction, 0.25, 60.0).unwrap()
    }

    #[test]
    fn literals_of_the_rig() {
        let axis = rig_axis(Direction::Reversed);
        assert_eq!(axis.counts(0.25).unwrap(), 0);
        assert_eq!(axis.counts(0.25 + TAU).unwrap(), -800_000);
        assert_eq!(axis.torque_per_mille(6.0).unwrap(), Saturated { value: -100, is_saturated: false });
        assert_eq!(axis.torque_per_mille(-2000.0).unwrap(), Saturated { value: i16::MAX, is_saturated: true });
        assert_eq!(axis.rate_counts_per_s(TAU).unwrap(), Saturated { value: -800_000, is_saturated: false });
        assert_eq!(axis.rate_counts_per_s(1e9).unwrap(), Saturated { value: i32::MIN, is_saturated: true });
    }

    #[test]
    fn bad_numbers_are_refused() {
        assert!(matches!(
            AxisScaling::new(0.0, Direction::Same, 0.0, 1.0),
            Err(ScalingError::NotPositive { setting: "counts per revolution", .. })
        ));
        assert!(AxisScaling::new(1.0, Direction::Same, f64::NAN, 1.0).is_err());
        assert!(AxisScaling::new(1.0, Direction::Same, 0.0, f64::INFINITY).is_err());
        let axis = rig_axis(Direction::Same);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(axis.counts(bad).is_err());
            assert!(axis.torque_per_mille(bad).is_err());
            assert!(axis.rate_counts_per_s(bad).is_err());
        }
        assert_eq!(axis.counts(1e300), Err(ScalingError::TooFar { angle_rad: 1e300 }));
    }

    proptest! {
        #[test]
        fn counts_survive_the_way_through_the_angle(counts in -(1i64 << 40)..(1i64 << 40), reversed: bool) {
            let axis = rig_axis(if reversed { Direction::Reversed } else { Direction::Same });
            prop_assert_eq!(axis.counts(axis.angle_rad(counts)).unwrap(), counts);
        }

        #[test]
        fn angles_come_back_within_half_a_count(angle in -1000.0..1000.0f64) {
            let axis = rig_axis(Direction::Same);
            let back = axis.angle_rad(axis.counts(angle).unwrap());
            prop_assert!((back - angle).abs() <= 0.5 / axis.counts_per_rad() * (1.0 + 1e-6));
        }

        #[test]
        fn torque_comes_back_within_half_a_per_mille(torque in -1900.0..1900.0f64) {
            let axis = rig_axis(Direction::Reversed);
            let raw = axis.torque_per_mille(torque).unwrap();
            prop_assert!(!raw.is_saturated);
            prop_assert!((axis.torque_n_m(raw.value) - torque).abs() <= 0.03 * (1.0 + 1e-9));
        }

        #[test]
        fn rate_comes_back_within_half_a_count(rate in -16000.0..16000.0f64) {
            let axis = rig_axis(Direction::Reversed);
            let raw = axis.rate_counts_per_s(rate).unwrap();
            prop_assert!(!raw.is_saturated);
            prop_assert!((axis.rate_rad_per_s(raw.value) - rate).abs() <= 0.5 / axis.counts_per_rad() * (1.0 + 1e-6));
        }

        #[test]
        fn unwrapping_follows_any_motion(
            start in -(1i64 << 40)..(1i64 << 40),
            steps in prop::collection::vec((-(1i64 << 31) + 1)..(1i64 << 31), 0..50),
        ) {
            let mut position = start;
            let mut unwrapper = CountUnwrapper::near(start);
            for step in steps {
                position += step;
                prop_assert_eq!(unwrapper.unwrap(wrap(position)), position);
            }
        }

        #[test]
        fn a_shift_by_whole_wraps_leaves_reports_and_targets_unchanged(
            counts in -(1i64 << 40)..(1i64 << 40),
            ahead in -100_000i64..100_000,
            k in -1000i64..1000,
        ) {
            let shifted = counts + (k << 32);
            prop_assert_eq!(wrap(counts), wrap(shifted));
            let seen = CountUnwrapper::near(counts).unwrap(wrap(shifted));
            prop_assert_eq!(wrap(seen + ahead), wrap(shifted + ahead));
            prop_assert_eq!(seen, counts);
        }
    }
}
