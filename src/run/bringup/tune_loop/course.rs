//! Course of a joint while its loop is identified.

use std::f64::consts::PI;

use yieldwall_motion::elementary;
use yieldwall_motion::identification::{Excitation, MOST_SHIFTS};

const DEG: f64 = PI / 180.0;
/// How far each travel goes, rad.
pub(super) const WAY_RAD: f64 = 12.0 * DEG;
/// Rates of the slow travels, rad/s, the fastest first, since a joint with too little torque shows early. No rate is a simple
/// fraction of another one, so the counts of targets make different patterns in the cycles of each.
pub(super) const RATES: [f64; 5] = [20.0 * DEG, 13.7 * DEG, 9.4 * DEG, 6.3 * DEG, 4.1 * DEG];
/// How fast the joint goes while it is excited or stepped, rad/s.
const CARRIER: f64 = 10.0 * DEG;
/// Greatest rate of the excitation, as a share of the carrier: the joint never stops, even if its loop overshoots.
const EXCITATION_SHARE: f64 = 0.5;
/// Time in which a travel comes up to its rate, and down, s.
const RAMP_S: f64 = 0.1;
/// Time that the loop needs to forget the ramp, s: the integral takes over dry friction.
const FORGETS_S: f64 = 0.2;
/// Rest of a joint between two travels, s. If an encoder freezes just short of its target, the controller pushes the joint more and
/// more meanwhile.
const REST_S: f64 = 0.05;
/// Length of a record, s.
const RECORD_S: f64 = 0.5;
/// How often the joint goes to and fro while it is excited, and with a step.
const EXCITED: u32 = 3;
const STEPPED: u32 = 2;
/// Time in which the reference goes from a tenth of the step to nine tenths, s: at 0.247 and at 0.753 of its time.
pub const STEP_RISE_S: f64 = 0.506 * STEP_S;
/// The step, rad, in what time it is made, since a torque cannot follow one at once, and what is recorded before and behind, s.
pub(super) const STEP_RAD: f64 = 0.5e-3;
const STEP_S: f64 = 0.02;
const BEFORE_STEP_S: f64 = 0.05;
const BEHIND_STEP_S: f64 = 0.25;

/// Content of a part of a course.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shows {
    /// A travel at one of [`RATES`].
    Steady(usize),
    /// An excitation, with as many cycles around its record as it takes.
    Excited,
    /// A step, at this cycle of the part.
    Step(usize),
}

/// Evaluated part of a course.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Part {
    /// Content.
    pub(super) shows: Shows,
    /// Whether the joint goes away from where the course began.
    pub(super) is_away: bool,
    /// Its first cycle.
    pub(super) from: usize,
    /// How many cycles.
    pub(super) count: usize,
}

/// Commanded angle of a joint in each cycle.
#[derive(Clone, Debug)]
pub(super) struct Course {
    /// How far from where it begins, rad.
    pub(super) offsets_rad: Vec<f64>,
    /// Parts that are evaluated.
    pub(super) parts: Vec<Part>,
    /// The excitation.
    pub(super) excitation: Excitation,
    period_s: f64,
}

impl Course {
    /// Creates the whole course of a joint with this cycle time; the first travel is counter-clockwise if `sign` is positive.
    pub(super) fn new(period_s: f64, sign: f64) -> Self {
        let record = (RECORD_S / period_s).round().max(1.0) as u32;
        let excitation = Excitation::new(period_s, record, EXCITATION_SHARE * CARRIER);
        let mut course = Self { offsets_rad: Vec::new(), parts: Vec::new(), excitation, period_s };
        for (at, rate) in RATES.into_iter().enumerate() {
            for direction in [sign, -sign] {
                let (from, count) = course.travel(direction, rate, |_, _| 0.0);
                let forgets = course.cycles(FORGETS_S).min(count / 2);
                course.look(Shows::Steady(at), direction == sign, from + forgets, count - forgets);
            }
        }
        for _ in 0..EXCITED {
            for direction in [sign, -sign] {
                let excitation = course.excitation.clone();
                let ramp = course.cycles(RAMP_S);
                let count = course.cruise(CARRIER);
                // The record ends where the ramp begins, and the excitation fades with it.
                let begin = (count - 1).saturating_sub(record as usize);
                let phase = record as usize * 8 - begin;
                let extra = |cycle: usize, is_ramp: bool| {
                    let come = (cycle as f64 / ramp as f64).min(1.0);
                    let gone = if is_ramp { ((cycle - count) as f64 / ramp as f64).min(1.0) } else { 0.0 };
                    (come - gone) * excitation.angle_rad((cycle + phase) as u32)
                };
                let (from, count) = course.travel(direction, CARRIER, extra);
                let needed = record as usize + MOST_SHIFTS + 1;
                course.look(Shows::Excited, direction == sign, (from + count).saturating_sub(needed), needed);
            }
        }
        for _ in 0..STEPPED {
            for direction in [sign, -sign] {
                let count = course.cruise(CARRIER);
                let (before, behind) = (course.cycles(BEFORE_STEP_S), course.cycles(BEHIND_STEP_S));
                let (at, steps) = (count.saturating_sub(behind), course.cycles(STEP_S));
                let extra = |cycle: usize, _| {
                    let share = ((cycle + 1).saturating_sub(at) as f64 / steps as f64).min(1.0);
                    // Minimum jerk from zero to one.
                    let come = elementary::powi(share, 3) * (10.0 - 15.0 * share + 6.0 * share * share);
                    direction * STEP_RAD * come
                };
                let (from, _) = course.travel(direction, CARRIER, extra);
                course.look(Shows::Step(before), direction == sign, from + at.saturating_sub(before), before + behind);
            }
        }
        course
    }

    fn cycles(&self, time_s: f64) -> usize {
        (time_s / self.period_s).round().max(1.0) as usize
    }

    /// Cycles at the full rate of a travel.
    fn cruise(&self, rate: f64) -> usize {
        self.cycles(WAY_RAD / rate - RAMP_S)
    }

    fn look(&mut self, shows: Shows, is_away: bool, from: usize, count: usize) {
        self.parts.push(Part { shows, is_away, from, count });
    }

    /// Adds a travel with an extra motion on top. `extra` depends on the cycle since the full rate was reached, and on whether that
    /// rate was left again. Returns the first cycle at the full rate, and the number of these cycles.
    fn travel(&mut self, direction: f64, rate: f64, extra: impl Fn(usize, bool) -> f64) -> (usize, usize) {
        let mut carrier = self.offsets_rad.last().copied().unwrap_or_default();
        let (ramp, cruise) = (self.cycles(RAMP_S), self.cruise(rate));
        let step = direction * rate * self.period_s;
        for cycle in 0..ramp {
            carrier += step * (cycle as f64 + 0.5) / ramp as f64;
            self.offsets_rad.push(carrier);
        }
        let from = self.offsets_rad.len();
        for cycle in 0..cruise {
            carrier += step;
            self.offsets_rad.push(carrier + extra(cycle, false));
        }
        for cycle in 0..ramp {
            carrier += step * (1.0 - (cycle as f64 + 0.5) / ramp as f64);
            self.offsets_rad.push(carrier + extra(cruise + cycle, true));
        }
        let last = self.offsets_rad.last().copied().unwrap_or_default();
        let rest = self.cycles(REST_S);
        self.offsets_rad.extend(std::iter::repeat_n(last, rest));
        (from, cruise)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_course_keeps_to_its_way_and_its_rates_at_each_cycle_time() {
        for period_s in [10e-3, 4e-3, 2e-3, 1e-3, 250e-6] {
            let course = Course::new(period_s, 1.0);
            let greatest = course.offsets_rad.iter().fold(0.0_f64, |most, offset| most.max(offset.abs()));
            assert!((greatest / WAY_RAD - 1.0).abs() < 0.05, "{period_s}: {greatest}");
            let ends = course.offsets_rad.last().unwrap();
            assert!(ends.abs() < 2.5e-3, "{period_s}: it ends {ends} rad from where it began");
            let steps = course.offsets_rad.windows(2).map(|two| (two[1] - two[0]).abs());
            let most = steps.fold(0.0, f64::max);
            assert!(most < 0.45 * period_s, "{period_s}: {most}");
            for part in &course.parts {
                let offsets = &course.offsets_rad[part.from..part.from + part.count];
                let sign = if part.is_away { 1.0 } else { -1.0 };
                let turns = offsets.windows(2).all(|two| sign * (two[1] - two[0]) > 0.0);
                assert!(turns, "{period_s}: {part:?} stands");
            }
            assert_eq!(course.parts.len(), 20);
        }
    }

    #[test]
    fn every_record_of_an_excitation_begins_at_the_same_phase() {
        let course = Course::new(1e-3, -1.0);
        let excited = course.parts.iter().filter(|part| part.shows == Shows::Excited);
        let first: Vec<Vec<f64>> = excited
            .map(|part| {
                let sign = if part.is_away { -1.0 } else { 1.0 };
                let offsets = &course.offsets_rad[part.from + MOST_SHIFTS..part.from + part.count];
                let carried = |(at, offset): (usize, &f64)| offset - offsets[0] - sign * CARRIER * 1e-3 * at as f64;
                offsets.iter().enumerate().map(carried).collect()
            })
            .collect();
        assert_eq!(first.len(), 6);
        for other in &first {
            assert!(other.iter().zip(&first[0]).all(|(one, other)| (one - other).abs() < 1e-9));
        }
    }
}
