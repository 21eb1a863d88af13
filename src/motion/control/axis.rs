//! Common parts of all laws of one axis: gains, the range of the effort, the step and the choice of a law.

use super::error::{ControlError, not_negative, positive};
use super::{Pid, Psmc};
use crate::setvalued::gsat;

/// Gains of PID and PSMC on one axis. Per joint in N m/rad, N m s/rad, N m/(rad s); per direction of the base frame in
/// N/m, N s/m, N/(m s).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// `K`, effort per error; greater than zero.
    pub stiffness: f64,
    /// `B`, effort per rate of the error; not negative.
    pub damping: f64,
    /// `L`, effort per time integral of the error; not negative, zero for none.
    pub integral: f64,
}

impl Gains {
    /// Returns these gains, if they are finite, `K > 0`, `B >= 0` and `L >= 0`.
    ///
    /// # Errors
    /// [`ControlError::OutOfRange`] names the first gain that is not.
    pub fn checked(self) -> Result<Self, ControlError> {
        positive("stiffness", self.stiffness)?;
        not_negative("damping", self.damping)?;
        not_negative("integral gain", self.integral)?;
        Ok(self)
    }
}

impl Gains {
    /// Returns the integral of an axis that cannot move, after one period of `period_s`, in rad s or m s. The inputs are the `integral`
    /// before the period and the `error` at which the effort is at its limit. The integral goes to `-error B/K` within the integral time
    /// `K/L`.
    ///
    /// A released axis without friction comes to rest where its effort is zero: at the desired position with an integral of zero. On the
    /// way there, the error thus integrates to the amount that the integral lacked at the release. If that amount was zero, the axis has to
    /// pass the desired position, by as much area as on its approach. With `-error B/K` the area is that of an approach under spring and
    /// damping alone, which does not pass. At most half of the spring is given up for it: `B/K` counts up to `K/(2 L)`.
    ///
    /// Real-time: yes.
    #[inline]
    pub(super) fn integral_drawn_back(&self, integral: f64, error: f64, period_s: f64) -> f64 {
        let Self { stiffness, damping, integral: gain } = *self;
        if gain == 0.0 || !error.is_finite() {
            return integral;
        }
        let lead_s = (damping / stiffness).min(0.5 * stiffness / gain);
        let share = (period_s * gain / stiffness).min(1.0);
        integral + share * (-lead_s * error - integral)
    }
}

/// The efforts that a law may command, `lower <= 0 <= upper`: what a torque or force limit leaves beside the
/// feed-forward, so in general not symmetric.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffortRange {
    lower: f64,
    upper: f64,
}

impl EffortRange {
    /// Returns the range `[lower, upper]`. An end on the wrong side of zero, or not finite, becomes zero: a broken limit allows
    /// no effort in its direction.
    ///
    /// Real-time: yes.
    pub fn new(lower: f64, upper: f64) -> Self {
        let lower = if lower.is_finite() && lower < 0.0 { lower } else { 0.0 };
        let upper = if upper.is_finite() && upper > 0.0 { upper } else { 0.0 };
        Self { lower, upper }
    }

    /// Returns the range `[-limit, limit]`.
    ///
    /// Real-time: yes.
    pub fn symmetric(limit: f64) -> Self {
        Self::new(-limit, limit)
    }

    /// Returns the feed-forward cut to `[-limit, limit]` and the range that is left for the law, so that their sum keeps within
    /// the limit whatever the law does.
    ///
    /// The second difference of a proxy that stops within one period asks for an inertia torque far above any limit;
    /// the cut bounds it. Zero is always in the range, so the law is never forced to push. A feed-forward that is not
    /// finite counts as zero.
    ///
    /// Real-time: yes.
    pub fn around(limit: f64, feed_forward: f64) -> (f64, Self) {
        let limit = if limit.is_finite() && limit > 0.0 { limit } else { 0.0 };
        let feed_forward = if feed_forward.is_finite() { gsat(-limit, feed_forward, limit) } else { 0.0 };
        (feed_forward, Self::new(-limit - feed_forward, limit - feed_forward))
    }

    /// Returns the least effort, at most zero.
    pub fn lower(&self) -> f64 {
        self.lower
    }

    /// Returns the greatest effort, at least zero.
    pub fn upper(&self) -> f64 {
        self.upper
    }

    /// Returns `effort` clamped to the range; NaN stays NaN.
    #[inline]
    pub fn clamp(&self, effort: f64) -> f64 {
        gsat(self.lower, effort, self.upper)
    }
}

/// Command of a law in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisStep {
    /// The effort, N m or N: finite and within the range.
    pub effort: f64,
    /// Effort of the law without a range.
    pub wanted: f64,
    /// Whether the range clamped it.
    pub saturated: bool,
    /// Whether the input was usable. If not, the effort is zero and the guard must not let it drive an axis.
    pub valid: bool,
}

impl AxisStep {
    pub(super) const REFUSED: Self = Self { effort: 0.0, wanted: 0.0, saturated: false, valid: false };
}

/// A sampled law that turns the error of one axis into an effort.
pub trait AxisController {
    /// Computes one period: `error` is desired minus measured, rad or m. The law takes rates of the error itself, by backward difference.
    ///
    /// An error that is not finite gives [`AxisStep::valid`] false, effort zero and no change of the integral. The next usable error starts
    /// without a difference, so that the gap makes no kick.
    ///
    /// Real-time: yes.
    fn step(&mut self, error: f64, range: EffortRange) -> AxisStep;

    /// Forgets the past, as on enabling: no integral, no rate, `error` taken as the previous one (bumpless).
    ///
    /// Real-time: yes.
    fn reset(&mut self, error: f64);

    /// Replaces the error of the last step by `error`, because the desired position was drawn back after it. The integral then goes to
    /// `-error B/K` within the integral time `K/L`: a released axis comes to rest at the desired position and does not pass it.
    ///
    /// Real-time: yes.
    fn draw_back(&mut self, error: f64);

    /// Returns the growth of [`AxisStep::wanted`] with the error of the same step: `K + B/T + L T`, N m/rad or N/m.
    fn step_stiffness(&self) -> f64;
}

/// Control law of a rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// Proxy-based sliding mode control.
    Psmc,
    /// Proportional, integral and derivative action.
    Pid,
}

impl Law {
    /// Returns a controller of this law for one axis with sampling interval `period_s`. `sliding_time_s` is `H` of PSMC in s;
    /// PID does not use it.
    ///
    /// # Errors
    /// As [`Psmc::new`] and [`Pid::new`].
    pub fn controller(self, gains: Gains, sliding_time_s: f64, period_s: f64) -> Result<Axis, ControlError> {
        Ok(match self {
            Law::Psmc => Axis::Psmc(Psmc::new(gains, sliding_time_s, period_s)?),
            Law::Pid => Axis::Pid(Pid::new(gains, period_s)?),
        })
    }
}

/// A controller whose law was chosen by configuration.
#[derive(Clone, Debug)]
pub enum Axis {
    /// Proxy-based sliding mode control.
    Psmc(Psmc),
    /// Proportional, integral and derivative action.
    Pid(Pid),
}

impl AxisController for Axis {
    #[inline]
    fn step(&mut self, error: f64, range: EffortRange) -> AxisStep {
        match self {
            Axis::Psmc(law) => law.step(error, range),
            Axis::Pid(law) => law.step(error, range),
        }
    }

    fn reset(&mut self, error: f64) {
        match self {
            Axis::Psmc(law) => law.reset(error),
            Axis::Pid(law) => law.reset(error),
        }
    }

    fn draw_back(&mut self, error: f64) {
        match self {
            Axis::Psmc(law) => law.draw_back(error),
            Axis::Pid(law) => law.draw_back(error),
        }
    }

    fn step_stiffness(&self) -> f64 {
        match self {
            Axis::Psmc(law) => law.step_stiffness(),
            Axis::Pid(law) => law.step_stiffness(),
        }
    }
}
