//! Errors of a sensing chain that cannot be built.

/// A parameter that gives no usable sensing chain.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SensingError {
    /// An entry of the calibration matrix is NaN or infinite.
    #[error("calibration matrix: row {row}, column {column} is {value}, not a finite number")]
    CalibrationNotFinite {
        /// Row from 1: Fx, Fy, Fz, Tx, Ty, Tz.
        row: usize,
        /// Column from 1: the count's index.
        column: usize,
        /// The entry.
        value: f64,
    },
    /// The calibration matrix has no usable inverse: some wrench leaves no trace in the counts.
    #[error("calibration matrix is singular: reciprocal condition number {reciprocal_condition:e}")]
    CalibrationSingular {
        /// Reciprocal condition number of the matrix with its rows scaled to one.
        reciprocal_condition: f64,
    },
    /// The range of the counts is not in 1 to [`i32::MAX`].
    #[error("range of the counts is {received}, must be 1 to 2147483647")]
    Range {
        /// The refused range.
        received: i32,
    },
    /// A parameter is NaN, infinite or outside its range.
    #[error("{name} is {value}; it must be {requirement}")]
    OutOfRange {
        /// Name of the parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Its allowed values, in words.
        requirement: &'static str,
    },
    /// A tare over no sample, or over more than can be counted on to be at rest.
    #[error("tare over {received} samples, must be 1 to {most}")]
    TareSamples {
        /// The refused number.
        received: u32,
        /// The most.
        most: u32,
    },
}

/// Returns `value` if it is finite and positive.
pub(super) fn positive(name: &'static str, value: f64) -> Result<f64, SensingError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(SensingError::OutOfRange { name, value, requirement: "finite and greater than zero" })
    }
}

/// Returns `value` if it is finite and not negative.
pub(super) fn not_negative(name: &'static str, value: f64) -> Result<f64, SensingError> {
    if value.is_finite() && value >= 0.0 {
        Ok(value)
    } else {
        Err(SensingError::OutOfRange { name, value, requirement: "finite and not negative" })
    }
}
