//! Stability margins of the sampled joint loop, with its real delay.
//!
//! Two joints of mass matrix `M` with the same controller and the same viscous friction `b` on both obey
//! `M v' + b v = u`, `u = C(z) e` on each. In the eigenvectors of `M` that is two separate loops with the eigenvalues as
//! inertias, exactly, at a fixed pose. So the margins of the arm are the worst over the eigenvalues of `M` over all
//! poses. In Cartesian space the same holds for the task-space mass matrix, in kg.

use crate::elementary;
use std::f64::consts::PI;
use std::sync::LazyLock;

use nalgebra::{Complex, Matrix2};

use super::Gains;
use super::error::{ControlError, not_negative, positive};
use super::stability::{is_stable_about_one, product, sum};

/// Longest delay of a [`ServoLoop`] in cycles. A rig has one or two; the bound keeps polynomials small and the
/// frequency grid dense enough for the delay's phase.
pub const MAX_DELAY_CYCLES: f64 = 16.0;

/// Points of the frequency grid in the search for crossovers, evenly in the logarithm.
const GRID_POINTS: usize = 6000;
/// Lowest frequency of the grid over the highest, the Nyquist frequency. A loop that crosses below, at less than 0.1 mHz for 1 kHz, is not
/// a servo.
const GRID_SPAN: f64 = 1e-7;
/// Halvings of a grid interval when a crossover is refined: to the last bit of a `f64`.
const BISECTIONS: usize = 60;

/// A position servo as sampled: the controller, its interval and the delay from measuring to acting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoLoop {
    /// Gains of PID, or of PSMC below saturation.
    pub gains: Gains,
    /// Sampling interval in s.
    pub period_s: f64,
    /// Time from sampling to the change of torque, in sampling intervals, besides the zero-order hold; 0 to
    /// [`MAX_DELAY_CYCLES`], not only whole numbers. A set-point that answers the SYNC before has 1.
    pub delay_cycles: f64,
}

/// Distance of a loop from instability. The signs of `gain_db`, `phase_deg` and `gain_reduction_db` say on which side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margins {
    /// Factor by which all gains together may grow, dB; infinity if without bound. Negative: they must shrink by that much.
    /// Negative infinity if no common factor makes the loop stable.
    pub gain_db: f64,
    /// Factor by which all gains together may shrink, dB; infinity if without bound. The integral needs a least gain. Negative:
    /// they must grow.
    pub gain_reduction_db: f64,
    /// Least phase margin over all gain crossovers, degrees; negative if the loop is unstable. A loop whose gain never
    /// falls to one below the Nyquist frequency has -180.
    pub phase_deg: f64,
    /// Further delay until instability, s, as if the loop were continuous at its crossover; zero if unstable.
    pub delay_margin_s: f64,
    /// The crossover of the least phase margin, Hz.
    pub crossover_hz: f64,
    /// Whether the closed loop is stable: all its poles inside the unit circle.
    pub stable: bool,
}

/// Returns the margins of one joint, or of one direction of the base frame. The loop is the exact discrete one of the controller, the delay
/// and the zero-order hold before `1/(J s^2 + b s)`.
///
/// `inertia` is `J > 0`, kg m^2 or kg; `viscous` is `b >= 0`, N m s/rad or N s/m. Coulomb friction is left out: it hides a poor margin in
/// time simulations and does not improve it. `viscous` zero is the worse case as a rule.
///
/// # Errors
/// [`ControlError::OutOfRange`] for gains, times, inertia or friction that are not finite or outside their ranges.
///
/// # Source
/// Åström, Wittenmark, *Computer-Controlled Systems* (1997), section 2.6 (sampling a system with delay).
pub fn margins(servo: &ServoLoop, inertia: f64, viscous: f64) -> Result<Margins, ControlError> {
    Ok(OpenLoop::new(servo, inertia, viscous)?.margins(&Frequency::grid(servo)))
}

/// Returns the loop of [`margins`], opened at the controller's output, at a frequency in Hz above 0 and up to half of the sampling
/// frequency.
///
/// # Errors
/// As [`margins`].
pub fn open_loop(
    servo: &ServoLoop,
    inertia: f64,
    viscous: f64,
    frequency_hz: f64,
) -> Result<Complex<f64>, ControlError> {
    let turn = positive("frequency", frequency_hz)? * servo.period_s * 2.0 * PI;
    Ok(OpenLoop::new(servo, inertia, viscous)?.response_at(turn.min(PI)))
}

/// Returns the response of a loop's controller to an error at a frequency in Hz, as [`open_loop`]: torque per angle, N m/rad or N/m.
///
/// # Errors
/// As [`margins`].
pub fn controller(servo: &ServoLoop, frequency_hz: f64) -> Result<Complex<f64>, ControlError> {
    servo.gains.checked()?;
    let turn = positive("frequency", frequency_hz)? * positive("period", servo.period_s)? * 2.0 * PI;
    Ok(controller_response(&servo.gains, servo.period_s, turn.min(PI)))
}

/// Whether the loop of [`margins`] is stable. Much quicker than its margins.
///
/// # Errors
/// As [`margins`].
pub fn is_stable(servo: &ServoLoop, inertia: f64, viscous: f64) -> Result<bool, ControlError> {
    Ok(OpenLoop::new(servo, inertia, viscous)?.is_stable(1.0))
}

/// Returns the worst of [`margins`] over `inertias`: each figure the least of all, the crossover that of the least phase margin,
/// stable if all are.
///
/// # Errors
/// [`ControlError::NoInertia`] for an empty list, and as [`margins`].
pub fn worst_margins(servo: &ServoLoop, inertias: &[f64], viscous: f64) -> Result<Margins, ControlError> {
    let mut worst: Option<Margins> = None;
    let grid = Frequency::grid(servo);
    for &inertia in inertias {
        let next = OpenLoop::new(servo, inertia, viscous)?.margins(&grid);
        worst = Some(worst.map_or(next, |least| Margins {
            gain_db: least.gain_db.min(next.gain_db),
            gain_reduction_db: least.gain_reduction_db.min(next.gain_reduction_db),
            phase_deg: least.phase_deg.min(next.phase_deg),
            delay_margin_s: least.delay_margin_s.min(next.delay_margin_s),
            crossover_hz: if next.phase_deg < least.phase_deg { next.crossover_hz } else { least.crossover_hz },
            stable: least.stable && next.stable,
        }));
    }
    worst.ok_or(ControlError::NoInertia)
}

/// Returns the eigenvalues of a mass matrix, the lesser first: the inertias over which a pose's margins are taken, kg m^2 for
/// joint space or kg for Cartesian space.
///
/// # Errors
/// [`ControlError::NotPositiveDefinite`] if an entry is not finite, the matrix is not symmetric to 1e-9 of its trace,
/// or the lesser eigenvalue is not positive.
pub fn principal_inertias(mass_matrix: &Matrix2<f64>) -> Result<[f64; 2], ControlError> {
    let [a, d] = [mass_matrix[(0, 0)], mass_matrix[(1, 1)]];
    let asymmetry = mass_matrix[(0, 1)] - mass_matrix[(1, 0)];
    let off = 0.5 * (mass_matrix[(0, 1)] + mass_matrix[(1, 0)]);
    let greater = 0.5 * (a + d) + elementary::hypot(0.5 * (a - d), off);
    // By the determinant, not by the difference, which cancels.
    let least = (a * d - off * off) / greater;
    if greater.is_finite() && least > 0.0 && asymmetry.abs() <= 1e-9 * (a + d) {
        Ok([least, greater])
    } else {
        Err(ControlError::NotPositiveDefinite { least, asymmetry })
    }
}

/// The frequencies `theta` of the grid, the lowest first.
static GRID: LazyLock<Vec<f64>> = LazyLock::new(|| {
    let at = |i: usize| PI * (1.0 - 1e-7) * elementary::powf(GRID_SPAN, 1.0 - i as f64 / GRID_POINTS as f64);
    (0..=GRID_POINTS).map(at).collect()
});

/// Terms of a loop at one frequency that do not depend on the plant.
struct Frequency {
    /// `theta`, from above 0 to pi.
    theta: f64,
    /// `exp(i theta) - 1`.
    below: Complex<f64>,
    /// `exp(-i theta)`.
    earlier: Complex<f64>,
    controller: Complex<f64>,
    /// Response of the whole cycles of delay.
    delay: Complex<f64>,
}

impl Frequency {
    fn of(servo: &ServoLoop, theta: f64) -> Self {
        let (sin, cos) = elementary::sin_cos(-theta * servo.delay_cycles.trunc());
        let below = below_one(theta);
        Self {
            theta,
            below,
            earlier: (below + 1.0).inv(),
            controller: controller_response(&servo.gains, servo.period_s, theta),
            delay: Complex::new(cos, sin),
        }
    }

    /// Returns the frequencies of the search for crossovers, the lowest first.
    fn grid(servo: &ServoLoop) -> Vec<Self> {
        GRID.iter().map(|&theta| Self::of(servo, theta)).collect()
    }
}

/// The loop opened at the controller's output: `L(z) = C(z) P(z)`.
struct OpenLoop {
    servo: ServoLoop,
    /// Position and rate after the part of an interval with the new input, and after the part with the old one.
    input: [[f64; 2]; 2],
    /// `z - pole` of the rate is `z - 1 + rate_loss`, `rate_loss = 1 - exp(-b T/J)`.
    rate_loss: f64,
    /// Position gained in an interval by a unit rate, s.
    coast: f64,
    whole_delay: usize,
}

impl OpenLoop {
    fn new(servo: &ServoLoop, inertia: f64, viscous: f64) -> Result<Self, ControlError> {
        servo.gains.checked()?;
        let t = positive("period", servo.period_s)?;
        let j = positive("inertia", inertia)?;
        let decay = not_negative("viscous friction", viscous)? / j;
        let delay = not_negative("delay in cycles", servo.delay_cycles)?;
        if delay > MAX_DELAY_CYCLES {
            return Err(ControlError::OutOfRange {
                name: "delay in cycles",
                value: delay,
                requirement: "at most MAX_DELAY_CYCLES",
            });
        }
        let late = delay.fract() * t;
        let [late_position, late_rate] = step_response(late, decay);
        // The old input acts first and then coasts through the rest of the interval.
        let rest = t - late;
        let old = [late_position + coast(rest, decay) * late_rate, elementary::exp(-decay * rest) * late_rate];
        let new = step_response(rest, decay);
        Ok(Self {
            servo: *servo,
            input: [new, old].map(|pair| pair.map(|x| x / j)),
            rate_loss: -elementary::exp_m1(-decay * t),
            coast: coast(t, decay),
            whole_delay: delay.trunc() as usize,
        })
    }

    /// Returns `L(exp(i theta))`, `theta` from above 0 to pi.
    fn response_at(&self, theta: f64) -> Complex<f64> {
        self.response(&Frequency::of(&self.servo, theta))
    }

    /// Returns `L` at a frequency.
    fn response(&self, frequency: &Frequency) -> Complex<f64> {
        let Frequency { below, earlier, controller, delay, .. } = *frequency;
        let [new, old] = self.input;
        let [position, rate] = [0, 1].map(|i| earlier * old[i] + new[i]);
        let free = below + self.rate_loss;
        let plant = (position * free + rate * self.coast) / (below * free);
        controller * plant * delay
    }

    /// Whether the loop is stable with all gains multiplied by `factor`.
    fn is_stable(&self, factor: f64) -> bool {
        let Gains { stiffness: k, damping: b, integral: l } = self.servo.gains;
        let t = self.servo.period_s;
        let [new, old] = self.input;
        let free = [self.rate_loss, 1.0];
        // All polynomials in d = z - 1. (old + new z)/z without a delay within the interval is new alone.
        let [position, rate] = [0, 1].map(|i| if old[i] == 0.0 { vec![new[i]] } else { vec![old[i] + new[i], new[i]] });
        let plant_zeros = sum(&product(&position, &free), self.coast, &rate);
        let mut plant_poles = product(&[0.0, 1.0], &free);
        for _ in 0..self.whole_delay + usize::from(position.len() > 1) {
            plant_poles = product(&plant_poles, &[1.0, 1.0]);
        }
        // Without integral action the controller has no pole at one; left in, it would count as unstable.
        let (zeros, poles) = if l > 0.0 {
            let integral = l * t * t;
            (vec![integral, k * t + 2.0 * integral, b + k * t + integral], vec![0.0, t, t])
        } else {
            (vec![k * t, k * t + b], vec![t, t])
        };
        is_stable_about_one(&sum(&product(&plant_poles, &poles), factor, &product(&plant_zeros, &zeros)))
    }

    fn margins(&self, grid: &[Frequency]) -> Margins {
        let stable = self.is_stable(1.0);
        let sign = if stable { 1.0 } else { -1.0 };
        let (gain_crossovers, critical_gains) = self.crossovers(grid);
        let (gain_db, gain_reduction_db) = self.gain_margins(&critical_gains);
        let nyquist_hz = 0.5 / self.servo.period_s;
        let mut margins = Margins {
            gain_db,
            gain_reduction_db,
            phase_deg: -180.0,
            delay_margin_s: 0.0,
            crossover_hz: nyquist_hz,
            stable,
        };
        let mut least = f64::INFINITY;
        let mut delay_cycles = f64::INFINITY;
        for theta in gain_crossovers {
            // Lag that turns L to -1, 0 to 2 pi; the lead that does is its complement.
            let response = self.response_at(theta);
            let lag = (PI + elementary::atan2(response.im, response.re)).rem_euclid(2.0 * PI);
            delay_cycles = delay_cycles.min(lag / theta);
            let phase = lag.min(2.0 * PI - lag);
            if phase < least {
                least = phase;
                margins.phase_deg = sign * phase.to_degrees();
                margins.crossover_hz = nyquist_hz * theta / PI;
            }
        }
        if stable {
            margins.delay_margin_s = delay_cycles * self.servo.period_s;
        }
        margins
    }

    /// Frequencies `theta` at which `|L| = 1`, and the factors on all gains at which `L` passes through -1.
    fn crossovers(&self, grid: &[Frequency]) -> (Vec<f64>, Vec<f64>) {
        let is_weak = |response: Complex<f64>| {
            // Away from one nobody waits for a root.
            let square = response.norm_sqr();
            if (square - 1.0).abs() > 1e-3 { square < 1.0 } else { elementary::hypot(response.re, response.im) < 1.0 }
        };
        let lags = |response: Complex<f64>| response.im < 0.0;
        let mut gain_crossovers = Vec::new();
        let mut critical_gains = Vec::new();
        // L is real at pi itself.
        let nyquist = self.response_at(PI).re;
        if nyquist < 0.0 {
            critical_gains.push(-1.0 / nyquist);
        }
        let mut last: Option<(f64, bool, bool)> = None;
        for frequency in grid {
            let (high, response) = (frequency.theta, self.response(frequency));
            let (weak, late) = (is_weak(response), lags(response));
            if let Some((low, was_weak, was_late)) = last {
                if was_weak != weak {
                    gain_crossovers.push(change_between(low, high, |theta| is_weak(self.response_at(theta))));
                }
                if was_late != late {
                    let theta = change_between(low, high, |theta| lags(self.response_at(theta)));
                    let real = self.response_at(theta).re;
                    if real < 0.0 {
                        critical_gains.push(-1.0 / real);
                    }
                }
            }
            last = Some((high, weak, late));
        }
        critical_gains.sort_by(f64::total_cmp);
        (gain_crossovers, critical_gains)
    }

    /// Returns the gain margin upwards and downwards in dB: the ends of the range of factors around one, or nearest to one, for
    /// which the loop is stable.
    fn gain_margins(&self, critical_gains: &[f64]) -> (f64, f64) {
        let mut best: Option<(f64, f64)> = None;
        let distance = |(low, high): (f64, f64)| elementary::ln(low).max(-elementary::ln(high)).max(0.0);
        for i in 0..=critical_gains.len() {
            let low = if i == 0 { 0.0 } else { critical_gains[i - 1] };
            let high = critical_gains.get(i).copied().unwrap_or(f64::INFINITY);
            let inside = match (low > 0.0, high.is_finite()) {
                (true, true) => (low * high).sqrt(),
                (true, false) => 2.0 * low,
                (false, true) => 0.5 * high,
                (false, false) => 1.0,
            };
            if self.is_stable(inside) && best.is_none_or(|range| distance((low, high)) < distance(range)) {
                best = Some((low, high));
            }
        }
        best.map_or((f64::NEG_INFINITY, f64::NEG_INFINITY), |(low, high)| {
            (20.0 * elementary::log10(high), -20.0 * elementary::log10(low))
        })
    }
}

/// Returns `exp(i theta) - 1` without cancellation at low frequencies.
fn below_one(theta: f64) -> Complex<f64> {
    Complex::new(-2.0 * elementary::powi(elementary::sin(0.5 * theta), 2), elementary::sin(theta))
}

/// Returns `C(exp(i theta))`, `theta` from above 0 to pi.
fn controller_response(gains: &Gains, period_s: f64, theta: f64) -> Complex<f64> {
    let below = below_one(theta);
    let back = below / ((below + 1.0) * period_s);
    back * gains.damping + gains.stiffness + back.inv() * gains.integral
}

/// Returns the position gained in the time `t` by a unit rate that friction slows with the rate constant `decay`, s.
fn coast(t: f64, decay: f64) -> f64 {
    if decay * t == 0.0 { t } else { -elementary::exp_m1(-decay * t) / decay }
}

/// Returns the position (s^2) and rate (s) after the time `t` under a unit acceleration from rest, slowed with `decay`.
fn step_response(t: f64, decay: f64) -> [f64; 2] {
    let x = decay * t;
    let position = if x < 0.02 {
        // (x - 1 + exp(-x))/x^2 cancels for small x; its series is good to 1e-15 here.
        t * t * (1.0 / 2.0 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x * (1.0 / 720.0 - x / 5040.0)))))
    } else {
        (t - coast(t, decay)) / decay
    };
    [position, coast(t, decay)]
}

/// Returns the place where `is` changes in `(low, high]`, at whose ends it differs; the ends are positive.
fn change_between(mut low: f64, mut high: f64, is: impl Fn(f64) -> bool) -> f64 {
    let at_high = is(high);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if is(middle) == at_high { high = middle } else { low = middle }
    }
    high
}
