//! PID in the same discrete form, for contrast with PSMC.

use super::error::{ControlError, positive};
use super::{AxisController, AxisStep, EffortRange, Gains};

/// PID of one axis by backward differences: `f = K e + B (e - e1)/T + L I`, `I += T e` including the current error.
///
/// Anti-windup by conditional integration: an increment that would push a saturated effort further out of its range is
/// dropped. So the integral cannot grow while the effort is saturated, but unlike PSMC the law knows nothing of the
/// speed it arrives with and overshoots after a long saturation.
///
/// # Source
/// Åström, Hägglund, *Advanced PID Control* (2006), chapter 3 (discretisation, windup).
#[derive(Clone, Debug)]
pub struct Pid {
    gains: Gains,
    period_s: f64,
    /// `I`, rad s or m s.
    integral: f64,
    /// Change of the integral in the last step.
    increment: f64,
    previous_error: Option<f64>,
}

impl Pid {
    /// Creates a PID at rest: no integral; the first error is taken as the previous one too. `period_s` is the sampling interval
    /// `T > 0` in s.
    ///
    /// # Errors
    /// [`ControlError::OutOfRange`] for a gain or period that is not finite or outside its range.
    pub fn new(gains: Gains, period_s: f64) -> Result<Self, ControlError> {
        let (gains, period_s) = (gains.checked()?, positive("period", period_s)?);
        Ok(Self { gains, period_s, integral: 0.0, increment: 0.0, previous_error: None })
    }

    /// Returns `L I`, the effort of the integral term after the last step, N m or N.
    ///
    /// Real-time: yes.
    pub fn integral_effort(&self) -> f64 {
        self.gains.integral * self.integral
    }
}

impl AxisController for Pid {
    #[inline]
    fn step(&mut self, error: f64, range: EffortRange) -> AxisStep {
        let Gains { stiffness, damping, integral: integral_gain } = self.gains;
        let rate = (error - self.previous_error.unwrap_or(error)) / self.period_s;
        let increment = self.period_s * error;
        let free = stiffness * error + damping * rate + integral_gain * (self.integral + increment);
        if !free.is_finite() {
            self.previous_error = None;
            return AxisStep::REFUSED;
        }
        let pushes_out = (free > range.upper() && error > 0.0) || (free < range.lower() && error < 0.0);
        self.increment = if pushes_out { 0.0 } else { increment };
        self.integral += self.increment;
        self.previous_error = Some(error);
        let effort = range.clamp(free);
        AxisStep { effort, wanted: free, saturated: effort != free, valid: true }
    }

    fn reset(&mut self, error: f64) {
        (self.integral, self.increment) = (0.0, 0.0);
        self.previous_error = error.is_finite().then_some(error);
    }

    fn draw_back(&mut self, error: f64) {
        self.integral = self.gains.integral_drawn_back(self.integral - self.increment, error, self.period_s);
        self.increment = 0.0;
        self.previous_error = error.is_finite().then_some(error);
    }

    fn step_stiffness(&self) -> f64 {
        let Gains { stiffness, damping, integral } = self.gains;
        stiffness + damping / self.period_s + integral * self.period_s
    }
}
