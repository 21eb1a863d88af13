//! First-order low pass of a sampled signal.

use crate::elementary;
use std::f64::consts::TAU;

use super::error::{SensingError, not_negative, positive};

/// First-order low pass for samples at a fixed interval: `y += alpha (x - y)`, `alpha = 1 - exp(-2 pi f_c T)`. It takes the
/// first sample as it is, so it starts without a transient.
///
/// Lag in the force path is the quickest way to lose light virtual masses: use it only against noise that a scene
/// really has.
#[derive(Clone, Debug)]
pub struct LowPass {
    alpha: f64,
    interval_s: f64,
}

impl LowPass {
    /// Cut-off frequency in Hz (-3 dB of the continuous filter it follows) and the interval of the samples in s.
    ///
    /// # Errors
    /// [`SensingError::OutOfRange`] for values that are not finite and positive, or a cut-off so low that the delay is
    /// not finite.
    pub fn new(cut_off_hz: f64, interval_s: f64) -> Result<Self, SensingError> {
        let interval_s = positive("sample interval", interval_s)?;
        let alpha = -elementary::exp_m1(-TAU * positive("low-pass cut-off", cut_off_hz)? * interval_s);
        let filter = Self { alpha, interval_s };
        not_negative("low-pass delay in s", filter.delay_s())?;
        Ok(filter)
    }

    /// Returns the next output after `output` for the input `input`.
    ///
    /// Real-time: yes.
    #[inline]
    pub fn next(&self, output: f64, input: f64) -> f64 {
        output + self.alpha * (input - output)
    }

    /// Delay of slow signals, s: `T (1 - alpha)/alpha`, about `1/(2 pi f_c) - T/2`.
    pub fn delay_s(&self) -> f64 {
        self.interval_s * (1.0 - self.alpha) / self.alpha
    }
}
