//! From what was recorded along a course to what it shows.

use std::f64::consts::TAU;

use nalgebra::Complex;

use super::course::{Course, Part, RATES, STEP_RAD, Shows};
use super::felt::Felt;
use super::{Follows, JointLoop, StepAnswer};
use yieldwall_motion::elementary;
use yieldwall_motion::identification::{
    Dynamics, Friction, MOST_SHIFTS, NotIdentified, Passage, Steady, dynamics, friction,
};
use yieldwall_motion::quantity::JointAngles;
use yieldwall_motion::sensing::RawSample;

/// Data of a joint in one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Sample {
    pub(super) reference_rad: f64,
    pub(super) angle_rad: f64,
    /// The torque that was set; zero where the drive closes the loop.
    pub(super) torque_n_m: f64,
    pub(super) is_cut: bool,
    /// Angles of both joints.
    pub(super) angles: JointAngles,
    /// A sample of the force sensor that came in this cycle.
    pub(super) force: Option<RawSample>,
}

/// Recording along a course.
pub(super) struct Trace<'a> {
    pub(super) course: &'a Course,
    pub(super) samples: &'a [Sample],
    /// Readings of the force sensor in the same cycles.
    pub(super) felt: &'a [Felt],
    /// Samples before which a cycle is missing.
    pub(super) skipped: &'a [usize],
    /// Torques that the drive reported: the sample at which it was asked, and N m.
    pub(super) told: &'a [[f64; 2]],
    pub(super) period_s: f64,
}

impl Trace<'_> {
    /// Parts of which no cycle is missing.
    fn parts(&self) -> impl Iterator<Item = (&Part, &[Sample])> {
        self.course.parts.iter().filter_map(|part| {
            let range = part.from..part.from + part.count;
            let is_whole = !self.skipped.iter().any(|at| range.contains(at));
            self.samples.get(range).filter(|_| is_whole).map(|samples| (part, samples))
        })
    }

    /// Returns the drive's reports in a part, by the sample of the part.
    fn told(&self, part: &Part) -> impl Iterator<Item = [f64; 2]> {
        let (from, to) = (part.from as f64, (part.from + part.count) as f64);
        self.told.iter().filter(move |[at, _]| (from..to).contains(at)).map(move |[at, torque]| [at - from, *torque])
    }

    /// Whether a torque was cut in a part, or comes to this one.
    pub(super) fn is_cut(&self, limit_n_m: f64) -> bool {
        self.parts().any(|(part, samples)| {
            let is_cut = |sample: &Sample| sample.is_cut || sample.torque_n_m.abs() >= limit_n_m;
            samples.iter().any(is_cut) || self.told(part).any(|[_, torque]| torque.abs() >= limit_n_m)
        })
    }

    /// Identifies the joint from the recording.
    pub(super) fn identified(&self, joint: usize, pose: JointAngles, is_told: bool, torque_n_m: f64) -> JointLoop {
        let follows = self.follows();
        let dynamics = if is_told { Err(NotIdentified::InDrive) } else { self.dynamics() };
        let inertia = dynamics.as_ref().map_or(0.0, |found| found.inertia_kg_m2.value);
        JointLoop {
            joint,
            pose,
            friction: self.friction(is_told, inertia),
            dynamics,
            handle: self.handle(),
            is_told,
            lag_s: lag_s(&follows),
            follows,
            step: self.step(),
            torque_n_m,
            left_out: self.course.parts.len() - self.parts().count(),
        }
    }

    fn friction(&self, is_told: bool, inertia_kg_m2: f64) -> Result<Friction, NotIdentified> {
        let mut travels = vec![Steady::default(); RATES.len()];
        for (part, samples) in self.parts() {
            let Shows::Steady(rate) = part.shows else { continue };
            let (Some(travel), Some((first, last))) = (travels.get_mut(rate), samples.first().zip(samples.last()))
            else {
                continue;
            };
            let is_forward = last.reference_rad > first.reference_rad;
            let sample = |at: usize, torque: f64| {
                samples.get(at).map(|sample| [at as f64 * self.period_s, sample.angle_rad, torque])
            };
            let to = if is_forward { &mut travel.forward } else { &mut travel.backward };
            if is_told {
                to.extend(self.told(part).filter_map(|[at, torque]| sample(at as usize, torque)));
            } else {
                to.extend(samples.iter().enumerate().filter_map(|(at, set)| sample(at, set.torque_n_m)));
            }
        }
        travels.retain(|travel| !travel.forward.is_empty() && !travel.backward.is_empty());
        friction(&travels, inertia_kg_m2)
    }

    fn excited(&self) -> impl Iterator<Item = (&Part, &[Sample])> {
        self.parts().filter(|(part, _)| part.shows == Shows::Excited)
    }

    fn dynamics(&self) -> Result<Dynamics, NotIdentified> {
        let mut stands = false;
        let passages: Vec<Passage> = self
            .excited()
            .map(|(_, samples)| {
                let angles_rad: Vec<f64> = samples.iter().map(|sample| sample.angle_rad).collect();
                stands |= stands_somewhere(&angles_rad, self.period_s);
                Passage { angles_rad, torques_n_m: samples.iter().map(|sample| sample.torque_n_m).collect() }
            })
            .collect();
        if stands {
            return Err(NotIdentified::Stands);
        }
        dynamics(&passages, &self.course.excitation, self.period_s)
    }

    fn follows(&self) -> Vec<Follows> {
        let records: Vec<&[Sample]> = self.excited().filter_map(|(_, samples)| samples.get(MOST_SHIFTS..)).collect();
        let Some(record) = records.first().map(|samples| samples.len().saturating_sub(1)) else { return Vec::new() };
        let lines = self.course.excitation.lines().iter();
        lines
            .map(|line| {
                let turn = TAU * f64::from(line.cycles) / record as f64;
                let amplitude = |of: fn(&Sample) -> f64| {
                    let each = |samples: &&[Sample]| {
                        let first = samples.first().map_or(0.0, of);
                        // The travel falls out of a second difference.
                        let curve = samples.windows(3).map(|three| match three {
                            [before, now, next] => (of(next) - first) - 2.0 * (of(now) - first) + (of(before) - first),
                            _ => 0.0,
                        });
                        curve
                            .enumerate()
                            .map(|(at, value)| {
                                let window = elementary::sin(0.5 * TAU * at as f64 / record as f64);
                                let (sin, cos) = elementary::sin_cos(turn * at as f64);
                                Complex::new(cos, -sin) * (window * window * value)
                            })
                            .sum::<Complex<f64>>()
                    };
                    records.iter().map(each).sum::<Complex<f64>>()
                };
                let ratio = amplitude(|sample| sample.angle_rad) / amplitude(|sample| sample.reference_rad);
                Follows { frequency_hz: turn / (TAU * self.period_s), ratio }
            })
            .collect()
    }

    /// Returns the mean of all steps, without the travel before each.
    fn step(&self) -> Option<StepAnswer> {
        let mut sums: Vec<[f64; 2]> = Vec::new();
        let (mut count, mut step_at) = (0.0, 0);
        for (part, samples) in self.parts() {
            let Shows::Step(at) = part.shows else { continue };
            let before = samples.get(..at).filter(|before| before.len() >= 2)?;
            let (first, last) = (before.first()?, before.last()?);
            let rate = (last.reference_rad - first.reference_rad) / (before.len() - 1) as f64;
            let mean = |of: fn(&Sample) -> f64| {
                let beside = before.iter().enumerate().map(|(cycle, sample)| of(sample) - rate * cycle as f64);
                beside.sum::<f64>() / before.len() as f64
            };
            let from = [mean(|sample| sample.reference_rad), mean(|sample| sample.angle_rad)];
            sums.resize(samples.len(), [0.0; 2]);
            let scale = STEP_RAD.copysign(rate);
            for (cycle, (sum, sample)) in sums.iter_mut().zip(samples).enumerate() {
                let travel = rate * cycle as f64;
                sum[0] += (sample.reference_rad - travel - from[0]) / scale;
                sum[1] += (sample.angle_rad - travel - from[1]) / scale;
            }
            (count, step_at) = (count + 1.0, at);
        }
        if count == 0.0 {
            return None;
        }
        let samples: Vec<[f64; 3]> = sums
            .iter()
            .enumerate()
            .map(|(cycle, [reference, angle])| {
                let time_s = (cycle as f64 - step_at as f64) * self.period_s;
                [time_s, reference / count, angle / count]
            })
            .collect();
        let comes_to = |share: f64| samples.iter().find(|[_, _, angle]| *angle >= share).map(|[time, ..]| *time);
        let rise_s = comes_to(0.1).zip(comes_to(0.9)).map(|(from, to)| to - from);
        let greatest = samples.iter().map(|[_, _, angle]| *angle).fold(0.0, f64::max);
        Some(StepAnswer { overshoot: (greatest - 1.0).max(0.0), rise_s, samples })
    }
}

/// Whether a travelling joint stops or turns back for a moment: its angle does not advance over 5 ms or two cycles.
fn stands_somewhere(angles_rad: &[f64], period_s: f64) -> bool {
    const MOMENT_S: f64 = 5e-3;
    let cycles = ((MOMENT_S / period_s).round() as usize).max(2);
    let way = angles_rad.last().zip(angles_rad.first()).map_or(0.0, |(last, first)| last - first);
    angles_rad.windows(cycles + 1).any(|some| match (some.first(), some.last()) {
        (Some(first), Some(last)) => (last - first) * way <= 0.0,
        _ => true,
    })
}

/// By how much the angle is behind at the lowest frequencies, by least squares over their phases, where the joint follows.
fn lag_s(follows: &[Follows]) -> Option<f64> {
    let slow = follows.iter().take(4).filter(|follows| follows.ratio.re > 0.5);
    let (together, spread) = slow.fold((0.0, 0.0), |(together, spread), follows| {
        let turn = TAU * follows.frequency_hz;
        (together - turn * elementary::atan2(follows.ratio.im, follows.ratio.re), spread + turn * turn)
    });
    (spread > 0.0).then(|| together / spread)
}
