//! Inertia, viscous friction and delay of a joint that turns one way while it is excited.

use std::f64::consts::TAU;

use nalgebra::{Complex, Matrix3, Vector3};

use super::{Estimate, Excitation, NotIdentified};
use crate::elementary;

/// Cycles before a record that a passage needs: a torque may act that much later than it is set, less two cycles.
pub const MOST_SHIFTS: usize = 18;
/// Longest delay of the search, cycles.
const LONGEST_DELAY: f64 = (MOST_SHIFTS - 2) as f64;
/// Steps per cycle of the first search for delays.
const STEPS_PER_CYCLE: f64 = 20.0;
/// Divisions of the interval around the best of them.
const DIVISIONS: u32 = 60;

/// A joint that turned one way while it was excited.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Passage {
    /// Its angle in consecutive cycles, rad: [`MOST_SHIFTS`] before the record, the record, one behind it.
    pub angles_rad: Vec<f64>,
    /// The torque that was set in each of these cycles, N m.
    pub torques_n_m: Vec<f64>,
}

/// Response of a joint to a torque at one frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// The frequency, Hz.
    pub frequency_hz: f64,
    /// Measured angle over set torque, rad/(N m), delay and hold included.
    pub plant: Complex<f64>,
}

/// Identified dynamics of a joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Dynamics {
    /// Mean inertia that the joint feels over its travel, kg m^2.
    pub inertia_kg_m2: Estimate,
    /// Viscous friction, N m s/rad. Far less certain than that of slow travels.
    pub viscous_n_m_s_per_rad: Estimate,
    /// Time from the sample of an angle to the change of torque that was computed from it, besides the hold, s.
    pub delay_s: Estimate,
    /// Residual of the model, as a share of the torque at the frequencies of the excitation.
    pub misfit: f64,
    /// Response at each frequency.
    pub responses: Vec<Response>,
}

/// Both sides of the equation of motion at each frequency: `J acceleration + b rate = torque(delay)`.
struct Equation {
    /// Frequencies, rad per cycle.
    turns: Vec<f64>,
    acceleration: Vec<Complex<f64>>,
    rate: Vec<Complex<f64>>,
}

/// Returns inertia, viscous friction and delay from the set torques. Each torque is held from when it acts until the next one does. All
/// passages have one excitation, at one phase.
///
/// # Errors
/// [`NotIdentified`] if there are too few samples, or if they do not determine the unknowns.
pub fn dynamics(passages: &[Passage], excitation: &Excitation, period_s: f64) -> Result<Dynamics, NotIdentified> {
    let equation = Equation::of(passages, excitation, period_s)?;
    let record = passages.first().map_or(0, |passage| passage.angles_rad.len().saturating_sub(MOST_SHIFTS + 1));
    if passages.iter().any(|passage| passage.torques_n_m.len() != passage.angles_rad.len()) {
        return Err(NotIdentified::TooFew);
    }
    let shifted: Vec<Vec<Complex<f64>>> = (0..=MOST_SHIFTS)
        .map(|shift| {
            let of_line = |turn: &f64| {
                let sum = |passage: &Passage| {
                    let torque = |at: usize| passage.torques_n_m.get(MOST_SHIFTS + at - shift).copied();
                    windowed(*turn, record, |at| torque(at).unwrap_or_default())
                };
                passages.iter().map(sum).sum::<Complex<f64>>() / passages.len() as f64
            };
            equation.turns.iter().map(of_line).collect()
        })
        .collect();
    let torque = |delay: f64| {
        let whole = (delay.floor()).clamp(0.0, LONGEST_DELAY);
        let late = delay - whole;
        let weights = [0.5 * (1.0 - late) * (1.0 - late), 0.5 + late - late * late, 0.5 * late * late];
        let slopes = [late - 1.0, 1.0 - 2.0 * late, late];
        let at = |line: usize, weights: [f64; 3]| {
            let of = |(shift, weight): (usize, f64)| {
                shifted
                    .get(whole as usize + shift)
                    .and_then(|lines| lines.get(line))
                    .map_or(Complex::default(), |u| u * weight)
            };
            weights.into_iter().enumerate().map(of).sum::<Complex<f64>>()
        };
        (0..equation.turns.len()).map(|line| [at(line, weights), at(line, slopes)]).collect()
    };
    let mut found = equation.solve(period_s, torque)?;
    let set = shifted.first().map_or(&[][..], Vec::as_slice);
    found.responses = equation
        .turns
        .iter()
        .zip(&equation.acceleration)
        .zip(set)
        .map(|((turn, acceleration), torque)| {
            let half = elementary::sin(0.5 * turn);
            let angle = acceleration * (-period_s * period_s / (4.0 * half * half));
            Response { frequency_hz: turn / (TAU * period_s), plant: angle / torque }
        })
        .collect();
    Ok(found)
}

impl Equation {
    fn of(passages: &[Passage], excitation: &Excitation, period_s: f64) -> Result<Self, NotIdentified> {
        let lengths = || passages.iter().map(|passage| passage.angles_rad.len());
        let (Some(length), true) = (lengths().next(), lengths().all(|length| lengths().next() == Some(length))) else {
            return Err(NotIdentified::TooFew);
        };
        if length < 4 * MOST_SHIFTS / 3 || excitation.lines().len() < 3 {
            return Err(NotIdentified::TooFew);
        }
        let all = passages.iter().flat_map(|passage| passage.angles_rad.iter().chain(&passage.torques_n_m));
        if !all.into_iter().all(|value| value.is_finite()) {
            return Err(NotIdentified::NotFinite);
        }
        let record = length - MOST_SHIFTS - 1;
        let turns: Vec<f64> =
            excitation.lines().iter().map(|line| TAU * f64::from(line.cycles) / record as f64).collect();
        let mean = |of: &dyn Fn(&Passage) -> Complex<f64>| {
            passages.iter().map(of).sum::<Complex<f64>>() / passages.len() as f64
        };
        let angle = |passage: &Passage, at: usize| passage.angles_rad.get(at).copied().unwrap_or_default();
        let acceleration = |turn: &f64| {
            mean(&|passage| {
                windowed(*turn, record, |at| {
                    let at = at + MOST_SHIFTS;
                    let [before, now, next] = [at - 1, at, at + 1].map(|at| angle(passage, at));
                    ((next - now) - (now - before)) / (period_s * period_s)
                })
            })
        };
        let rate = |turn: &f64| {
            // A central difference has less of a high frequency than the mean over two cycles.
            let share = elementary::sin(0.5 * turn) / (0.5 * turn);
            let central = elementary::sin(*turn) / turn;
            mean(&|passage| {
                windowed(*turn, record, |at| {
                    let at = at + MOST_SHIFTS;
                    (angle(passage, at + 1) - angle(passage, at - 1)) / (2.0 * period_s)
                })
            }) * (share * share / central)
        };
        let (acceleration, rate) = (turns.iter().map(acceleration).collect(), turns.iter().map(rate).collect());
        Ok(Self { turns, acceleration, rate })
    }

    /// Returns the inertia, the viscous friction and the delay that leave least, by torque and its slope over the delay in cycles.
    fn solve(&self, period_s: f64, torque: impl Fn(f64) -> Vec<[Complex<f64>; 2]>) -> Result<Dynamics, NotIdentified> {
        let rest = |delay: f64| self.fit(&torque(delay)).map_or(f64::INFINITY, |fit| fit.rest);
        let steps = (LONGEST_DELAY * STEPS_PER_CYCLE) as u32;
        let at = |step: u32| f64::from(step) / STEPS_PER_CYCLE;
        let best = (0..=steps).map(|step| (rest(at(step)), step)).min_by(|(one, _), (other, _)| one.total_cmp(other));
        let (_, best) = best.ok_or(NotIdentified::Indistinct)?;
        if best == steps {
            return Err(NotIdentified::NoDelay { longest_s: LONGEST_DELAY * period_s });
        }
        let (mut low, mut high) = (at(best.saturating_sub(1)), at(best + 1));
        for _ in 0..DIVISIONS {
            let third = (high - low) / 3.0;
            if rest(low + third) <= rest(high - third) { high -= third } else { low += third }
        }
        let delay = 0.5 * (low + high);
        let sides = torque(delay);
        let fit = self.fit(&sides).ok_or(NotIdentified::Indistinct)?;
        if fit.inertia.is_nan() || fit.inertia <= 0.0 {
            return Err(NotIdentified::NoInertia);
        }
        let mut rows = Vec::with_capacity(2 * self.turns.len());
        for ((acceleration, rate), [torque, slope]) in self.acceleration.iter().zip(&self.rate).zip(&sides) {
            let left = acceleration * fit.inertia + rate * fit.viscous - torque;
            for part in [|z: &Complex<f64>| z.re, |z: &Complex<f64>| z.im] {
                rows.push((Vector3::new(part(acceleration), part(rate), -part(slope)), part(&left)));
            }
        }
        let errors = errors(&rows).ok_or(NotIdentified::Indistinct)?;
        let estimate =
            |value: f64, scale: f64, Spread { error, degrees }: Spread| Estimate::new(value, error * scale, degrees);
        let whole: f64 = sides.iter().map(|[torque, _]| torque.norm_sqr()).sum();
        let found = Dynamics {
            inertia_kg_m2: estimate(fit.inertia, 1.0, errors[0]),
            viscous_n_m_s_per_rad: estimate(fit.viscous, 1.0, errors[1]),
            delay_s: estimate(delay * period_s, period_s, errors[2]),
            misfit: (fit.rest / whole).sqrt(),
            responses: Vec::new(),
        };
        let is_finite = [found.inertia_kg_m2, found.viscous_n_m_s_per_rad, found.delay_s]
            .iter()
            .all(|estimate| estimate.low.is_finite() && estimate.high.is_finite());
        if is_finite { Ok(found) } else { Err(NotIdentified::Indistinct) }
    }

    /// Solves the least squares at a known delay.
    fn fit(&self, sides: &[[Complex<f64>; 2]]) -> Option<Fit> {
        let product = |one: &Complex<f64>, other: &Complex<f64>| one.re * other.re + one.im * other.im;
        let [mut aa, mut av, mut vv, mut aw, mut vw] = [0.0; 5];
        for ((a, v), [w, _]) in self.acceleration.iter().zip(&self.rate).zip(sides) {
            aa += product(a, a);
            av += product(a, v);
            vv += product(v, v);
            aw += product(a, w);
            vw += product(v, w);
        }
        let determinant = aa * vv - av * av;
        if determinant.is_nan() || determinant <= 1e-12 * aa * vv {
            return None;
        }
        let (inertia, viscous) = ((aw * vv - vw * av) / determinant, (vw * aa - aw * av) / determinant);
        let left = self.acceleration.iter().zip(&self.rate).zip(sides);
        let rest = left.map(|((a, v), [w, _])| (a * inertia + v * viscous - w).norm_sqr()).sum();
        Some(Fit { inertia, viscous, rest })
    }
}

/// A standard error, and with how many degrees of freedom it is known, at least 1.
#[derive(Clone, Copy)]
struct Spread {
    error: f64,
    degrees: f64,
}

/// Returns standard errors of the least-squares solution, from the row of each equation and its residual. The rounding of an encoder is an
/// acceleration that grows with the square of the frequency, so the equations have unequal errors. A few equations then cause most of an
/// error, which is known with as few degrees of freedom.
///
/// # Source
/// J. G. MacKinnon and H. White, Some heteroskedasticity-consistent covariance matrix estimators with improved finite sample properties,
/// J. of Econometrics 29 (1985): HC3. F. E. Satterthwaite, An approximate distribution of estimates of variance components, Biometrics
/// Bulletin 2 (1946): a sum of squares w with normal errors has `3 (sum w)^2 / sum w^2 - 2` degrees of freedom, without bias.
fn errors(rows: &[(Vector3<f64>, f64)]) -> Option<[Spread; 3]> {
    let normal: Matrix3<f64> = rows.iter().map(|(row, _)| row * row.transpose()).sum();
    let inverse = normal.try_inverse()?;
    let most = rows.len().saturating_sub(3).max(1) as f64;
    let of = |unknown: usize| {
        let (variance, squares) = rows.iter().fold((0.0, 0.0), |(variance, squares), (row, left)| {
            let weighted = inverse * row;
            // What one equation alone decides leaves nothing.
            let left = left / (1.0 - row.dot(&weighted)).max(1e-3);
            let part = elementary::powi(weighted[unknown] * left, 2);
            (variance + part, squares + part * part)
        });
        let degrees = if squares > 0.0 { (3.0 * variance * variance / squares - 2.0).clamp(1.0, most) } else { most };
        Spread { error: variance.sqrt(), degrees }
    };
    Some([of(0), of(1), of(2)])
}

struct Fit {
    inertia: f64,
    viscous: f64,
    /// Squares of what is left, (N m)^2.
    rest: f64,
}

/// Returns the amplitude of what `value` has of a frequency in a record, with a window that takes out what changes slowly.
fn windowed(turn: f64, record: usize, value: impl Fn(usize) -> f64) -> Complex<f64> {
    let sum: Complex<f64> = (0..record)
        .map(|at| {
            let window = elementary::sin(0.5 * TAU * at as f64 / record as f64);
            let (sin, cos) = elementary::sin_cos(turn * at as f64);
            Complex::new(cos, -sin) * (window * window * value(at))
        })
        .sum();
    // The window's mean is a half.
    sum * (4.0 / record as f64)
}

#[cfg(test)]
mod tests;
