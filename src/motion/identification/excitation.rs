//! A small motion of many frequencies at once.

use std::f64::consts::TAU;

use crate::elementary;

/// Lowest frequency, in cycles of a record: slower ones drown in what changes along the way.
const LOWEST: u32 = 2;
/// Frequencies at most.
const MOST_LINES: u32 = 14;
/// Highest frequency, as a share of the sampling frequency, and in Hz.
const HIGHEST_SHARE: f64 = 0.12;
const HIGHEST_HZ: f64 = 120.0;
/// Above this frequency amplitudes fall so that the acceleration stays, Hz: torque is limited too.
const SAME_RATE_TO_HZ: f64 = 20.0;
/// Sets of phases that are tried for the one with the lowest peak.
const SETS_OF_PHASES: u32 = 64;

/// One frequency of an excitation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Whole cycles in a record.
    pub cycles: u32,
    /// Amplitude of the angle, rad.
    pub amplitude_rad: f64,
    /// Phase, rad.
    phase_rad: f64,
}

/// A sum of sines that fit a record a whole number of times, in place of a chirp: periodic, with its energy at few frequencies.
#[derive(Clone, Debug, PartialEq)]
pub struct Excitation {
    lines: Vec<Line>,
    /// The angle in each cycle of a record, rad.
    angles_rad: Vec<f64>,
}

impl Excitation {
    /// Creates an excitation whose records are so many cycles of `period_s` long, and whose rate is `rate_rad_per_s` at most.
    pub fn new(period_s: f64, record_cycles: u32, rate_rad_per_s: f64) -> Self {
        let record_s = period_s * f64::from(record_cycles);
        let highest_hz = (HIGHEST_SHARE / period_s).min(HIGHEST_HZ);
        let highest = ((highest_hz * record_s) as u32).max(LOWEST + 1);
        let ratio = f64::from(highest) / f64::from(LOWEST);
        let mut cycles: Vec<u32> = (0..MOST_LINES)
            .map(|line| {
                let share = f64::from(line) / f64::from(MOST_LINES - 1);
                (f64::from(LOWEST) * elementary::powf(ratio, share)).round() as u32
            })
            .collect();
        cycles.dedup();
        let of_set = |set: u32| {
            let lines = cycles.iter().enumerate().map(|(at, cycles)| {
                let frequency_hz = f64::from(*cycles) / record_s;
                let rate = (SAME_RATE_TO_HZ / frequency_hz).min(1.0);
                // Quadratic phases spread a peak over the record; how steep is tried.
                let turns = f64::from(set + 1) * (at * at) as f64 / (2.0 * f64::from(SETS_OF_PHASES));
                Line { cycles: *cycles, amplitude_rad: rate / (TAU * frequency_hz), phase_rad: TAU * turns.fract() }
            });
            Self::of(lines.collect(), record_cycles)
        };
        let sets = (0..SETS_OF_PHASES).map(of_set).map(|set| (set.greatest_rate(period_s), set));
        let (greatest, mut best) = sets
            .min_by(|(one, _), (other, _)| one.total_cmp(other))
            .unwrap_or((1.0, Self { lines: Vec::new(), angles_rad: Vec::new() }));
        let factor = rate_rad_per_s / greatest;
        best.lines.iter_mut().for_each(|line| line.amplitude_rad *= factor);
        best.angles_rad.iter_mut().for_each(|angle| *angle *= factor);
        best
    }

    fn of(lines: Vec<Line>, record_cycles: u32) -> Self {
        let angle = |cycle: u32| {
            let turns = |line: &Line| f64::from(line.cycles * cycle % record_cycles) / f64::from(record_cycles);
            lines.iter().map(|line| line.amplitude_rad * elementary::sin(TAU * turns(line) + line.phase_rad)).sum()
        };
        let angles_rad = (0..record_cycles).map(angle).collect();
        Self { lines, angles_rad }
    }

    /// Returns the greatest rate, rad/s, with which the angle changes from cycle to cycle.
    pub fn greatest_rate(&self, period_s: f64) -> f64 {
        let next = self.angles_rad.iter().cycle().skip(1);
        self.angles_rad.iter().zip(next).map(|(now, next)| (next - now).abs()).fold(0.0, f64::max) / period_s
    }

    /// Returns the angle in a cycle, rad; it repeats after a record.
    pub fn angle_rad(&self, cycle: u32) -> f64 {
        let at = cycle as usize % self.angles_rad.len().max(1);
        self.angles_rad.get(at).copied().unwrap_or_default()
    }

    /// Returns the frequencies of the excitation in Hz, the lowest first.
    pub fn lines(&self) -> &[Line] {
        &self.lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_excitation_keeps_its_rate_and_has_frequencies_enough_at_every_cycle_time() {
        for (period_s, cycles, least) in [(1e-2, 50, 4), (4e-3, 125, 8), (1e-3, 500, 12), (250e-6, 2000, 12)] {
            let excitation = Excitation::new(period_s, cycles, 0.1);
            assert!((excitation.greatest_rate(period_s) - 0.1).abs() < 1e-12, "{period_s}");
            assert!(excitation.lines().len() >= least, "{period_s}: {:?}", excitation.lines());
            assert!(excitation.lines().is_sorted_by(|one, other| one.cycles < other.cycles));
            assert_eq!(excitation.angle_rad(3), excitation.angle_rad(3 + cycles));
        }
    }
}
