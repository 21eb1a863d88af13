//! Rate commands for drives in cyclic synchronous velocity mode.

use super::error::{ControlError, not_negative, positive};
use crate::setvalued::gsat;

/// Position control of one axis by rate: `rate = desired rate + K_p e`, clamped to a limit. The drive closes the
/// velocity loop.
///
/// Without state, so nothing to reset and nothing to wind up. With the delay of one cycle and an ideal drive the loop
/// is free of overshoot for `K_p T <= 0.25` and unstable above `K_p T = 1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateLaw {
    gain_per_s: f64,
    limit: f64,
}

/// A rate command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateStep {
    /// The rate, rad/s or m/s: finite and within the limit.
    pub rate: f64,
    /// Whether the limit clamped it.
    pub saturated: bool,
    /// Whether the input was usable. If not, the rate is zero and the guard must not let it drive an axis.
    pub valid: bool,
}

impl RateLaw {
    /// Creates the law. `gain_per_s` is `K_p >= 0` in 1/s; `limit > 0` bounds the commanded rate, rad/s or m/s.
    ///
    /// # Errors
    /// [`ControlError::OutOfRange`] for values that are not finite or outside these ranges.
    pub fn new(gain_per_s: f64, limit: f64) -> Result<Self, ControlError> {
        Ok(Self { gain_per_s: not_negative("rate gain", gain_per_s)?, limit: positive("rate limit", limit)? })
    }

    /// Returns the rate to command for `error` (desired minus measured, rad or m) and the desired rate (rad/s or m/s). Input
    /// that is not finite gives rate zero and `valid: false`.
    ///
    /// Real-time: yes.
    #[inline]
    pub fn command(&self, error: f64, desired_rate: f64) -> RateStep {
        let free = desired_rate + self.gain_per_s * error;
        if !free.is_finite() {
            return RateStep { rate: 0.0, saturated: false, valid: false };
        }
        let rate = gsat(-self.limit, free, self.limit);
        RateStep { rate, saturated: rate != free, valid: true }
    }
}
