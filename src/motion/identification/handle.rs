//! Mass of a handle beyond a force sensor, and the age of what the sensor says, from a tool that is shaken with nobody at it.
//!
//! The sensor then carries what accelerates the handle alone, `f(t) = -m a(t - age)`, seen through what filters it. The accelerations are
//! those of the tool by the encoders, in second differences, which are means over two cycles; at the lines of the excitation their
//! share is known exactly.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use nalgebra::{Complex, Matrix3, Vector3};

use super::{Estimate, Excitation, NotIdentified};
use crate::elementary;

/// Longest age of the search, s.
const LONGEST_S: f64 = 0.03;
/// Cycles by which a force may be younger than the angles: it comes after SYNC.
const YOUNGEST: f64 = -1.0;
/// Cycles that a record needs behind it: those that are younger, and one for the difference.
pub const BEHIND: usize = 2;
/// Steps per cycle of the first search for ages.
const STEPS_PER_CYCLE: f64 = 4.0;
/// Time constants of a low pass that are tried first, s.
const LAGS_S: [f64; 7] = [0.0, 0.3e-3, 0.6e-3, 1.25e-3, 2.5e-3, 5e-3, 10e-3];
/// Steps of the refinement.
const REFINEMENTS: u32 = 40;
/// Largest relative uncertainty of a mass that still determines an age.
const MASS_SHARE: f64 = 0.2;
/// Largest uncertainty of a usable age, as a share of a cycle: the hold of the torque already hides more than that.
const AGE_CYCLES: f64 = 0.25;

/// A tool that was shaken.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shaken {
    /// Tool points in consecutive cycles by the measured angles, m: [`lead_in`] before the record, the record, [`BEHIND`] behind it.
    pub tips_m: Vec<[f64; 2]>,
    /// Force of the sensor in each of these cycles, in the base frame, N. A cycle without a new sample has the last force.
    pub forces_n: Vec<[f64; 2]>,
}

/// Mass beyond a force sensor, and the age of its force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Handle {
    /// Mass that moves beyond the sensor, kg.
    pub mass_kg: Estimate,
    /// Age of a cycle's force before the angles of that cycle, s, for slow forces; negative if the force was sensed later.
    pub age_s: Estimate,
    /// Part of the age that looks like a low pass: its time constant, s.
    pub lag_s: f64,
    /// Interval of the age, s, with the part that the hold of the torque hides.
    pub between_s: [f64; 2],
    /// Residual of the model, as a share of the force at the frequencies of the excitation.
    pub misfit: f64,
}

/// Cycles before a record that the longest age needs.
pub fn lead_in(period_s: f64) -> usize {
    (LONGEST_S / period_s).ceil() as usize + 3
}

/// Returns mass and age from a tool that was shaken. All passages have one excitation, at one phase.
///
/// # Limits
/// A torque that is held for a cycle holds the acceleration too. A sensor without a filter that samples in step with it shows the same for
/// each age within that time. The fit gives the middle of that time, so the age is known to half a cycle. A low pass of time constant `l`
/// spreads the edges. The remaining uncertainty is `T^2/(12 l)` at most, the sum of the multiples of the cycle's rate that the low pass
/// lets through.
///
/// # Errors
/// - [`NotIdentified::TooFew`], [`NotIdentified::NotFinite`];
/// - [`NotIdentified::NoHandle`] for a mass that is too small against the noise to determine the age;
/// - [`NotIdentified::NoDelay`] for an age beyond the range of the search.
pub fn handle(passages: &[Shaken], excitation: &Excitation, period_s: f64) -> Result<Handle, NotIdentified> {
    let mut seen = Spectra::of(passages, excitation, period_s)?;
    let longest = LONGEST_S / period_s;
    let steps = ((longest - YOUNGEST) * STEPS_PER_CYCLE) as u32;
    let ages = (0..=steps).map(|step| YOUNGEST + f64::from(step) / STEPS_PER_CYCLE);
    let starts = ages.flat_map(|age| LAGS_S.into_iter().map(move |lag_s| [age, lag_s * lag_s / (period_s * period_s)]));
    let begun = starts.map(|at| (seen.rest(0, at), at)).min_by(|(one, _), (other, _)| one.total_cmp(other));
    let (_, start) = begun.ok_or(NotIdentified::TooFew)?;
    let (at, fit) = seen.refined(start, [YOUNGEST, longest]).ok_or(NotIdentified::Indistinct)?;
    let [age, squared] = at;
    let degrees = seen.equations().saturating_sub(3).max(1);
    let covariance = fit.normal.try_inverse().ok_or(NotIdentified::Indistinct)? * (fit.rest / degrees as f64);
    let error = |place: usize| covariance[(place, place)].max(0.0).sqrt();
    let mass_kg = Estimate::new(fit.mass, error(0), degrees as f64);
    let age_s = Estimate::new(age * period_s, error(1) * period_s, degrees as f64);
    let is_known = mass_kg.half_width() <= MASS_SHARE * mass_kg.value && age_s.half_width() <= AGE_CYCLES * period_s;
    if !is_known {
        let mass_kg = seen.least_mass();
        return Err(NotIdentified::NoHandle { mass_kg: mass_kg.value, up_to_kg: mass_kg.high.max(0.0) });
    }
    if age >= longest - 1.0 {
        return Err(NotIdentified::NoDelay { longest_s: LONGEST_S });
    }
    let surely = Estimate::new(squared, error(2), degrees as f64).low.max(0.0).sqrt();
    let hidden = if surely > 0.0 { (1.0 / (12.0 * surely)).min(0.5) } else { 0.5 };
    let between_s = [age_s.low - hidden * period_s, age_s.high + hidden * period_s];
    let misfit = (fit.rest / seen.whole()).sqrt();
    Ok(Handle { mass_kg, age_s, lag_s: squared.sqrt() * period_s, between_s, misfit })
}

/// Forces and accelerations at the lines of the excitation. Times are in cycles.
struct Spectra<'a> {
    passages: &'a [Shaken],
    /// Frequencies, rad per cycle.
    turns: Vec<f64>,
    /// Window and wave of each line over a record.
    waves: Vec<Vec<Complex<f64>>>,
    before: usize,
    per_cycle_squared: f64,
    /// Line by line, of each passage along both axes.
    forces: Vec<Complex<f64>>,
    /// Accelerations so many cycles before, line by line, of each passage along both axes.
    accelerations: BTreeMap<i64, Vec<Complex<f64>>>,
}

/// Least squares at an age and a low pass.
struct Fit {
    mass: f64,
    /// Squares of the residual, N^2.
    rest: f64,
    /// Normal matrix of mass, age and the square of the time constant.
    normal: Matrix3<f64>,
    slope: Vector3<f64>,
}

impl<'a> Spectra<'a> {
    fn of(passages: &'a [Shaken], excitation: &Excitation, period_s: f64) -> Result<Self, NotIdentified> {
        let before = lead_in(period_s);
        let length = passages.first().map_or(0, |passage| passage.tips_m.len());
        let record = length.saturating_sub(before + BEHIND);
        let is_whole = |passage: &Shaken| passage.tips_m.len() == length && passage.forces_n.len() == length;
        if record < 8 || excitation.lines().len() < 3 || !passages.iter().all(is_whole) {
            return Err(NotIdentified::TooFew);
        }
        let all = passages.iter().flat_map(|passage| passage.tips_m.iter().chain(&passage.forces_n));
        if !all.flatten().all(|value| value.is_finite()) {
            return Err(NotIdentified::NotFinite);
        }
        let turns: Vec<f64> =
            excitation.lines().iter().map(|line| TAU * f64::from(line.cycles) / record as f64).collect();
        let wave = |turn: &f64| {
            let at = |cycle: usize| {
                let window = elementary::sin(0.5 * TAU * cycle as f64 / record as f64);
                let (sin, cos) = elementary::sin_cos(turn * cycle as f64);
                // The window's mean is a half.
                Complex::new(cos, -sin) * (4.0 / record as f64 * window * window)
            };
            (0..record).map(at).collect::<Vec<_>>()
        };
        let waves = turns.iter().map(wave).collect();
        let per_cycle_squared = 1.0 / (period_s * period_s);
        let mut seen = Self {
            passages,
            turns,
            waves,
            before,
            per_cycle_squared,
            forces: Vec::new(),
            accelerations: BTreeMap::new(),
        };
        seen.forces = seen.lines(|passage, axis, cycle| {
            passage.forces_n.get(before + cycle).and_then(|force| force.get(axis)).copied().unwrap_or_default()
        });
        Ok(seen)
    }

    /// Returns the amplitudes of a signal: line by line, of each passage along both axes.
    fn lines(&self, signal: impl Fn(&Shaken, usize, usize) -> f64) -> Vec<Complex<f64>> {
        let mut found = Vec::with_capacity(self.waves.len() * self.passages.len() * 2);
        for wave in &self.waves {
            for passage in self.passages {
                for axis in 0..2 {
                    let sum = wave.iter().enumerate().map(|(cycle, weight)| weight * signal(passage, axis, cycle));
                    found.push(sum.sum());
                }
            }
        }
        found
    }

    /// Returns the amplitudes of the acceleration that many cycles before, m/s^2.
    fn shifted(&mut self, shift: i64) -> &[Complex<f64>] {
        if !self.accelerations.contains_key(&shift) {
            let difference = |passage: &Shaken, axis: usize, cycle: usize| {
                let at = |by: i64| {
                    let at = usize::try_from((self.before + cycle) as i64 - shift + by).unwrap_or_default();
                    passage.tips_m.get(at).and_then(|tip| tip.get(axis)).copied().unwrap_or_default()
                };
                ((at(1) - at(0)) - (at(0) - at(-1))) * self.per_cycle_squared
            };
            let mut lines = self.lines(difference);
            let per_line = self.passages.len() * 2;
            for (line, of_line) in lines.chunks_mut(per_line).enumerate() {
                // Means over two cycles have less of a high frequency.
                let turn = self.turns.get(line).copied().unwrap_or_default();
                let share = elementary::sin(0.5 * turn) / (0.5 * turn);
                of_line.iter_mut().for_each(|value| *value /= share * share);
            }
            self.accelerations.insert(shift, lines);
        }
        self.accelerations.get(&shift).map_or(&[], Vec::as_slice)
    }

    fn equations(&self) -> usize {
        2 * self.forces.len()
    }

    fn whole(&self) -> f64 {
        self.forces.iter().map(Complex::norm_sqr).sum()
    }

    fn rest(&mut self, shift: i64, at: [f64; 2]) -> f64 {
        self.fit(shift, at).map_or(f64::INFINITY, |fit| fit.rest)
    }

    /// Returns the mass and the residual, with an age in cycles and the square of a time constant in cycles. The part of the age beyond
    /// `shift` turns the phase of a record that is not shifted by it, which is right only for a small part.
    fn fit(&mut self, shift: i64, [age, squared]: [f64; 2]) -> Option<Fit> {
        let per_line = self.passages.len() * 2;
        let turns = self.turns.clone();
        let one = Complex::new(1.0, 0.0);
        let of_line = |turn: f64| {
            let lag = squared.max(0.0).sqrt();
            let whole = Complex::new(1.0, turn * lag);
            // The delay of the low pass is part of the age.
            let filter = turned(turn * lag) / whole;
            let late = turned(-turn * (age - shift as f64));
            let by_squared = turned(turn * lag) / (whole * whole) * (-0.5 * turn * turn);
            [late * filter, late * by_squared, late * filter * Complex::new(0.0, -turn)]
        };
        let factors: Vec<[Complex<f64>; 3]> = turns.into_iter().map(of_line).collect();
        let accelerations = self.shifted(shift).to_vec();
        let model = |place: usize, which: usize| {
            let factor = factors.get(place / per_line).and_then(|factors| factors.get(which)).copied().unwrap_or(one);
            // The sensor is drawn back by what it accelerates.
            -(accelerations.get(place).copied().unwrap_or_default() * factor)
        };
        let product = |one: Complex<f64>, other: Complex<f64>| one.re * other.re + one.im * other.im;
        let (mut squares, mut together) = (0.0, 0.0);
        for (place, force) in self.forces.iter().enumerate() {
            let unit = model(place, 0);
            squares += unit.norm_sqr();
            together += product(unit, *force);
        }
        let mass = together / squares;
        if !mass.is_finite() {
            return None;
        }
        let (mut rest, mut normal, mut slope) = (0.0, Matrix3::zeros(), Vector3::zeros());
        for (place, force) in self.forces.iter().enumerate() {
            let left = force - model(place, 0) * mass;
            let columns = [model(place, 0), model(place, 2) * mass, model(place, 1) * mass];
            rest += left.norm_sqr();
            for part in [|z: Complex<f64>| z.re, |z: Complex<f64>| z.im] {
                let row = Vector3::from(columns.map(part));
                normal += row * row.transpose();
                slope += row * part(left);
            }
        }
        Some(Fit { mass, rest, normal, slope })
    }

    /// From a start to the age and the low pass that leave least, by damped steps of Gauss and Newton.
    fn refined(&mut self, start: [f64; 2], [youngest, longest]: [f64; 2]) -> Option<([f64; 2], Fit)> {
        let shift_of = |at: [f64; 2]| at[0].round() as i64;
        let mut at = start;
        let mut fit = self.fit(shift_of(at), at)?;
        let mut damping = 1e-3;
        for _ in 0..REFINEMENTS {
            let mut damped = fit.normal;
            (0..3).for_each(|place| damped[(place, place)] *= 1.0 + damping);
            let Some(step) = damped.try_inverse().map(|inverse| inverse * fit.slope) else { break };
            let next = [(at[0] + step[1]).clamp(youngest, longest), (at[1] + step[2]).max(0.0)];
            // Both are seen by the same shift, so that what is left can be compared.
            let (here, there) = (self.rest(shift_of(next), at), self.fit(shift_of(next), next)?);
            if there.rest <= here {
                (at, fit, damping) = (next, there, 0.3 * damping);
            } else {
                damping *= 10.0;
            }
        }
        Some((at, fit))
    }

    /// Returns the mass that fits a force without age, whatever the age is, for a mass that is too small to determine the age.
    fn least_mass(&mut self) -> Estimate {
        let Some(fit) = self.fit(0, [0.0; 2]) else { return Estimate::new(0.0, 0.0, 1.0) };
        let degrees = self.equations().saturating_sub(1).max(1);
        let squares = fit.normal[(0, 0)];
        Estimate::new(fit.mass, (fit.rest / degrees as f64 / squares).sqrt(), degrees as f64)
    }
}

/// Returns `e^(j angle)`.
fn turned(angle: f64) -> Complex<f64> {
    let (sin, cos) = elementary::sin_cos(angle);
    Complex::new(cos, sin)
}

#[cfg(test)]
mod tests;
