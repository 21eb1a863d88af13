//! Errors of a controller, a feed-forward or a margin that cannot be built.

/// A parameter that gives no usable controller or margin.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ControlError {
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
    /// A mass matrix that is not symmetric and positive definite.
    #[error(
        "the mass matrix is not symmetric positive definite: least eigenvalue {least:.3e}, asymmetry {asymmetry:.3e}"
    )]
    NotPositiveDefinite {
        /// Its least eigenvalue, kg m^2 or kg.
        least: f64,
        /// Difference of its off-diagonal entries.
        asymmetry: f64,
    },
    /// Margins over an empty list of inertias.
    #[error("margins need at least one inertia")]
    NoInertia,
}

/// Returns `value` if it is finite and positive.
pub(super) fn positive(name: &'static str, value: f64) -> Result<f64, ControlError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(ControlError::OutOfRange { name, value, requirement: "finite and greater than zero" })
    }
}

/// Returns `value` if it is finite and not negative.
pub(super) fn not_negative(name: &'static str, value: f64) -> Result<f64, ControlError> {
    if value.is_finite() && value >= 0.0 {
        Ok(value)
    } else {
        Err(ControlError::OutOfRange { name, value, requirement: "finite and not negative" })
    }
}
