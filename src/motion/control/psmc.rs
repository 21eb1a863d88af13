//! Proxy-based sliding mode control in discrete time.

use super::error::{ControlError, not_negative, positive};
use super::{AxisController, AxisStep, EffortRange, Gains};

/// Proxy-based sliding mode control (PSMC) of one axis. A PID coupling pulls the axis towards an inner proxy `q`. The proxy slides to the
/// desired position along a line with time constant `H`, driven by a force of at most the range. Unsaturated, it is the PID of the same
/// gains; after saturation it comes back without overshoot and without a wound-up integral.
///
/// Continuous law, `p` measured, `p_d` desired, `f` effort, `F` limit:
/// ```text
/// f = F sgn(p_d - q + H (p_d' - q')),    f = K (q - p) + B (q' - p') + L integral(q - p)
/// ```
/// Backward Euler with `a = integral(q - p)` and its last increment `d1 = a(i-1) - a(i-2)` as the state, and
/// `G = L T^2 + K T + B`:
/// ```text
/// sigma = e + H (e - e1)/T
/// f*    = G/(T + H) sigma + L a1 + (K H + L T H - B)/(T (T + H)) d1
/// f     = gsat(lower, f*, upper)
/// da    = (B d1 + T^2 (f - L a1))/G;   a1 += da;   d1 = da
/// ```
/// The increment is kept, not the older integral: their difference would cancel. `L = 0` and `H = 0` are allowed.
///
/// # Limits of the equality with PID
/// It is exact from `e = 0`. A start with `e(0) != 0` leaves a transient `exp(-t/H)` and an integral offset of about
/// `L H e(0)`. No overshoot after saturation needs `H >= 1.3 v/(2 a)`, with `a = (F + friction)/J` and peak speed `v`.
///
/// # Example
/// ```
/// use yieldwall_motion::control::{AxisController, EffortRange, Gains, Psmc};
///
/// // In N m/rad, N m s/rad and N m/(rad s); H is 0.15 s, T is 1 ms.
/// let gains = Gains { stiffness: 2000.0, damping: 40.0, integral: 2000.0 };
/// let mut joint = Psmc::new(gains, 0.15, 0.001)?;
/// // The joint is 0.5 rad off, and its drive makes 10 N m at most.
/// let step = joint.step(0.5, EffortRange::symmetric(10.0));
/// assert_eq!((step.effort, step.saturated), (10.0, true));
/// # Ok::<(), yieldwall_motion::control::ControlError>(())
/// ```
///
/// # Source
/// Kikuuwe, Fujimoto, *Proxy-based sliding mode control for accurate and safe position control* (2006), the law;
/// \[KTF08, footnote 1\] uses it. The discrete form is derived as above.
#[derive(Clone, Debug)]
pub struct Psmc {
    gains: Gains,
    sliding_time_s: f64,
    period_s: f64,
    /// `G`.
    step_gain: f64,
    /// Factor of `sigma` in `f*`.
    sliding_factor: f64,
    /// Factor of `d1` in `f*`.
    increment_factor: f64,
    /// `a1`, rad s or m s.
    integral: f64,
    /// `d1`, rad s or m s.
    increment: f64,
    previous_error: Option<f64>,
}

impl Psmc {
    /// Creates a PSMC at rest: no integral, no rate; the first error is taken as the previous one too.
    ///
    /// `sliding_time_s` is `H >= 0` in s, `period_s` the sampling interval `T > 0` in s.
    ///
    /// # Errors
    /// [`ControlError::OutOfRange`] for a gain or time that is not finite or outside its range.
    pub fn new(gains: Gains, sliding_time_s: f64, period_s: f64) -> Result<Self, ControlError> {
        let gains = gains.checked()?;
        let h = not_negative("sliding time", sliding_time_s)?;
        let t = positive("period", period_s)?;
        let Gains { stiffness: k, damping: b, integral: l } = gains;
        let step_gain = positive("L T^2 + K T + B", l * t * t + k * t + b)?;
        Ok(Self {
            gains,
            sliding_time_s: h,
            period_s: t,
            step_gain,
            sliding_factor: step_gain / (t + h),
            increment_factor: (k * h + l * t * h - b) / (t * (t + h)),
            integral: 0.0,
            increment: 0.0,
            previous_error: None,
        })
    }

    /// Returns the position of the inner proxy, seen from the measured position: `q - p` of the last step, rad or m.
    ///
    /// Real-time: yes.
    pub fn proxy_offset(&self) -> f64 {
        self.increment / self.period_s
    }

    /// Returns `L a`, the effort of the integral term after the last step, N m or N.
    ///
    /// Real-time: yes.
    pub fn integral_effort(&self) -> f64 {
        self.gains.integral * self.integral
    }
}

impl AxisController for Psmc {
    #[inline]
    fn step(&mut self, error: f64, range: EffortRange) -> AxisStep {
        let t = self.period_s;
        let sigma = error + self.sliding_time_s * (error - self.previous_error.unwrap_or(error)) / t;
        let held = self.gains.integral * self.integral;
        let free = self.sliding_factor * sigma + held + self.increment_factor * self.increment;
        if !free.is_finite() {
            self.previous_error = None;
            return AxisStep::REFUSED;
        }
        let effort = range.clamp(free);
        self.increment = (self.gains.damping * self.increment + t * t * (effort - held)) / self.step_gain;
        self.integral += self.increment;
        self.previous_error = Some(error);
        AxisStep { effort, wanted: free, saturated: effort != free, valid: true }
    }

    fn reset(&mut self, error: f64) {
        self.integral = 0.0;
        self.increment = 0.0;
        self.previous_error = error.is_finite().then_some(error);
    }

    fn draw_back(&mut self, error: f64) {
        self.integral = self.gains.integral_drawn_back(self.integral - self.increment, error, self.period_s);
        self.previous_error = error.is_finite().then_some(error);
    }

    fn step_stiffness(&self) -> f64 {
        // G/(T + H) (1 + H/T).
        self.step_gain / self.period_s
    }
}
