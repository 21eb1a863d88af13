//! The chain as a whole, one step per cycle, and what it says about its own trustworthiness.

use nalgebra::{UnitComplex, Vector2};

use super::error::{SensingError, not_negative, positive};
use super::{Calibration, LowPass, Mounting, RawSample, Tare, TareParameters, TareState, Wrench};
use crate::quantity::Force;

/// Missed samples from which a reading is stale: the third missing one is the first that makes the last sample more
/// than two intervals old.
pub const STALE_AFTER_MISSED_SAMPLES: u32 = 3;

/// Forces from here on are refused, N: differences of two that are less, and their squares, stay finite.
const GREATEST_N: f64 = 1e150;

/// Parameters of a sensing chain.
#[derive(Clone, Debug)]
pub struct SensingParameters {
    /// Counts to wrench.
    pub calibration: Calibration,
    /// Mounting of the sensor on its link.
    pub mounting: Mounting,
    /// Mass on the hand's side of the sensor, kg, not negative.
    pub handle_mass_kg: f64,
    /// Cut-off of the low pass, Hz; none for no filter.
    pub low_pass_hz: Option<f64>,
    /// Samples per second that the sensor makes, Hz.
    pub sample_rate_hz: f64,
    /// Interval of [`Sensing::step`], s.
    pub cycle_period_s: f64,
    /// Greatest change of the hand's force from one sample to the next, N, positive; infinite for no limit.
    pub force_step_limit_n: f64,
}

/// Samples in a row with the same six counts from which a sensor whose noise is known is stuck.
pub const STUCK_AFTER_IDENTICAL_SAMPLES: u32 = 50;
/// Smallest number of pairs of successive samples at rest that show whether a sensor has noise.
const NOISE_PAIRS: u32 = 8;

/// Whether the sensor's samples differ from each other while nothing is to be measured.
///
/// The last 64 pairs of successive samples that were taken at rest are remembered. A sensor whose noise shows in at least
/// half of them (of at least eight) repeats itself 50 times by chance once in 2^49 samples or less. A sensor without
/// noise at rest, quantised and still, never counts as stuck.
#[derive(Clone, Copy, Debug, Default)]
struct NoiseMemory {
    differed: u64,
    pairs: u32,
}

impl NoiseMemory {
    fn note(&mut self, differs: bool) {
        self.differed = self.differed << 1 | u64::from(differs);
        self.pairs = (self.pairs + 1).min(u64::BITS);
    }

    fn has_noise(&self) -> bool {
        self.pairs >= NOISE_PAIRS && 2 * self.differed.count_ones() >= self.pairs
    }
}

/// The force of the hand in one cycle. All numbers are finite, always.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Force of the hand on the tool, N, base frame: from the last usable sample, zero before the first.
    pub force: Force,
    /// Torque about z at the sensor's origin, N m, from the same sample. Not corrected for the handle's inertia.
    pub torque_z_n_m: f64,
    /// Whether a new sample came in this cycle.
    pub new_sample: bool,
    /// Whether the last sample was at 98 % of the range or had its overload bit set.
    pub saturated: bool,
    /// Whether [`STALE_AFTER_MISSED_SAMPLES`] or more samples are missing.
    pub stale: bool,
    /// Whether `force` stands for the last sample: there was one, the angle and acceleration given with it were finite
    /// and no tare is under way. Says nothing of `saturated` and `stale`.
    pub valid: bool,
    /// Time since the last new sample came (or since the start), s: the sample's own age and the cycles since.
    pub age_s: f64,
    /// New samples that should have come since the last one and did not. Counted in the sensor's own interval (or in
    /// cycles, if those are longer): a sensor of 200 Hz misses none in the four cycles of 1 ms between its samples.
    pub missed_samples: u32,
    /// New samples in a row with the same six counts as the last one, itself included: 1 after a change, 0 before the
    /// first sample.
    pub identical_samples: u32,
    /// Whether `identical_samples` has reached [`STUCK_AFTER_IDENTICAL_SAMPLES`] though the sensor's noise had shown at
    /// rest: its converter hangs.
    pub stuck: bool,
    /// Samples in a row that gave no valid force: the sensor said that they are not valid, or angle or acceleration were
    /// not finite.
    pub refused_samples: u32,
    /// Whether the last sample's force was further from the one before than the limit; `force` went by the limit only.
    pub stepped: bool,
}

impl Reading {
    /// Before the first sample.
    const NONE: Self = Self {
        force: Force(Vector2::new(0.0, 0.0)),
        torque_z_n_m: 0.0,
        new_sample: false,
        saturated: false,
        stale: false,
        valid: false,
        age_s: 0.0,
        missed_samples: 0,
        identical_samples: 0,
        stuck: false,
        refused_samples: 0,
        stepped: false,
    };

    /// Whether the force may drive the proxy: valid, neither saturated nor stale.
    ///
    /// Real-time: yes.
    pub fn is_usable(&self) -> bool {
        self.valid && !self.saturated && !self.stale
    }
}

/// From raw samples to readings, with the state of tare, filter and flags.
#[derive(Clone, Debug)]
pub struct Sensing {
    calibration: Calibration,
    mounting: Mounting,
    handle_mass_kg: f64,
    low_pass: Option<LowPass>,
    cycle_period_s: f64,
    /// Cycles per sample interval, at least one.
    cycles_per_sample: f64,
    bias: Wrench,
    tare: Option<Tare>,
    last_sample: Option<RawSample>,
    /// Whether `last` holds the output of an earlier sample, so that the filter may go on from it.
    filtering: bool,
    cycles_since_new: u32,
    noise: NoiseMemory,
    is_resting: bool,
    force_step_limit_n: f64,
    /// Force before the filter of the last valid sample.
    unfiltered: Option<Force>,
    last: Reading,
}

impl Sensing {
    /// Creates a chain without bias that has seen no sample.
    ///
    /// # Errors
    /// [`SensingError::OutOfRange`] for a mass, rate, period, angle or cut-off that is not finite or outside its range.
    pub fn new(parameters: SensingParameters) -> Result<Self, SensingError> {
        let cycle_period_s = positive("cycle period", parameters.cycle_period_s)?;
        let interval_s = positive("sample interval", positive("sample rate", parameters.sample_rate_hz)?.recip())?;
        // More than one sample per cycle cannot be seen: the cycle is the interval then, also for the filter.
        let interval_s = interval_s.max(cycle_period_s);
        // The age of a sample stays finite however long none comes.
        not_negative("longest age of a sample in s", cycle_period_s * f64::from(u32::MAX))?;
        let step_limit = parameters.force_step_limit_n;
        if step_limit != f64::INFINITY {
            positive("force step limit", step_limit)?;
        }
        let low_pass = parameters.low_pass_hz.map(|hz| LowPass::new(hz, interval_s)).transpose()?;
        Ok(Self {
            calibration: parameters.calibration,
            mounting: parameters.mounting,
            handle_mass_kg: not_negative("handle mass", parameters.handle_mass_kg)?,
            low_pass,
            cycle_period_s,
            cycles_per_sample: interval_s / cycle_period_s,
            bias: Wrench::default(),
            tare: None,
            last_sample: None,
            filtering: false,
            cycles_since_new: 0,
            noise: NoiseMemory::default(),
            is_resting: false,
            force_step_limit_n: step_limit,
            unfiltered: None,
            last: Reading::NONE,
        })
    }

    /// Forgets all samples, and the sensor's noise; bias and tare stay.
    pub fn restart(&mut self) {
        (self.last_sample, self.unfiltered, self.filtering) = (None, None, false);
        self.cycles_since_new = 0;
        self.noise = NoiseMemory::default();
        self.last = Reading::NONE;
    }

    /// Says whether the rig rests: the samples to come then show whether the sensor has noise.
    ///
    /// Real-time: yes.
    pub fn set_resting(&mut self, is_resting: bool) {
        self.is_resting = is_resting;
    }

    /// Computes one cycle. `sample` is the sample that arrived since the last step, `None` without one; a sample whose sequence counter has
    /// not changed is not new. `link` is the rotation of the link under the sensor ([`Mounting::link_rotation`]), and `tool_acceleration`
    /// is the acceleration of the handle in m/s^2, base frame. Both are at the time of the sample.
    ///
    /// The handle's mass `m` lies between hand and sensor. The sensor therefore carries the hand's force less the force that accelerates
    /// the handle: `h = sensed + m a`.
    ///
    /// Without a new sample the force stays as it is, in the base frame. The force stays too, and the reading is not valid, if the sensor
    /// marks the sample as not valid. A force that is not finite or beyond 1e150 N has the same effect. The limit bounds the change of the
    /// force from the sample before, once for each sample interval between them. A force further away is moved from the last force by the
    /// limit. While a tare is under way the force is zero and not valid.
    ///
    /// Real-time: yes.
    pub fn step(
        &mut self,
        sample: Option<&RawSample>,
        link: UnitComplex<f64>,
        tool_acceleration: Vector2<f64>,
    ) -> Reading {
        match sample.filter(|sample| self.is_new(sample)) {
            Some(sample) => self.take(sample, link, tool_acceleration),
            None => {
                self.cycles_since_new = self.cycles_since_new.saturating_add(1);
                self.last.new_sample = false;
            }
        }
        let cycles = f64::from(self.cycles_since_new);
        let arrived_s = self.last_sample.map_or(0.0, |sample| 1e-9 * f64::from(sample.age_ns));
        self.last.age_s = cycles * self.cycle_period_s + arrived_s;
        // A sample due at this very cycle counts as due: 5.000000001 cycles are five.
        self.last.missed_samples = (cycles / self.cycles_per_sample + 1e-6) as u32;
        self.last.stale = self.last.missed_samples >= STALE_AFTER_MISSED_SAMPLES;
        self.last
    }

    fn is_new(&self, sample: &RawSample) -> bool {
        match (self.last_sample.and_then(|last| last.sequence), sample.sequence) {
            (Some(last), Some(sequence)) => last != sequence,
            _ => true,
        }
    }

    fn take(&mut self, sample: &RawSample, link: UnitComplex<f64>, tool_acceleration: Vector2<f64>) {
        let same = self.last_sample.is_some_and(|last| last.counts == sample.counts);
        if self.is_resting && self.last_sample.is_some() {
            self.noise.note(!same);
        }
        self.last.identical_samples = if same { self.last.identical_samples.saturating_add(1) } else { 1 };
        self.last.stuck = self.last.identical_samples >= STUCK_AFTER_IDENTICAL_SAMPLES && self.noise.has_noise();
        let intervals = f64::from(self.last.missed_samples) + 1.0;
        self.last_sample = Some(*sample);
        self.cycles_since_new = 0;
        self.last.new_sample = true;
        self.last.stepped = false;
        self.last.saturated = self.calibration.is_saturated(sample);
        let wrench = self.calibration.wrench(sample);
        if self.is_taring(sample, &wrench) {
            (self.last.force, self.last.torque_z_n_m) = (Force::default(), 0.0);
            (self.last.valid, self.filtering, self.unfiltered) = (false, false, None);
            return;
        }
        if sample.invalid {
            return self.refuse();
        }
        let wrench = Wrench(wrench.0 - self.bias.0);
        let sensed = self.mounting.to_base(&wrench, link);
        let hand = sensed + Force(tool_acceleration * self.handle_mass_kg);
        // Not a number is not below anything.
        let is_bounded = hand.norm() < GREATEST_N;
        if !is_bounded {
            return self.refuse();
        }
        let (hand, stepped) = self.limit_step(hand, intervals * self.force_step_limit_n);
        let (force, torque) = self.filter(hand, wrench.0.b);
        self.unfiltered = Some(hand);
        (self.last.force, self.last.torque_z_n_m) = (force, torque);
        (self.last.valid, self.last.refused_samples, self.last.stepped) = (true, 0, stepped);
        self.filtering = true;
    }

    fn refuse(&mut self) {
        self.last.valid = false;
        self.last.refused_samples = self.last.refused_samples.saturating_add(1);
    }

    fn limit_step(&self, hand: Force, limit_n: f64) -> (Force, bool) {
        let Some(last) = self.unfiltered else { return (hand, false) };
        let step = hand - last;
        let size = step.norm();
        if size > limit_n { (last + step * (limit_n / size), true) } else { (hand, false) }
    }

    fn filter(&self, force: Force, torque_z_n_m: f64) -> (Force, f64) {
        match &self.low_pass {
            Some(filter) if self.filtering => (
                Force(self.last.force.0.zip_map(&force.0, |output, input| filter.next(output, input))),
                filter.next(self.last.torque_z_n_m, torque_z_n_m),
            ),
            _ => (force, torque_z_n_m),
        }
    }

    /// Adds a sample to a tare under way; returns whether the sample belonged to a tare.
    fn is_taring(&mut self, sample: &RawSample, wrench: &Wrench) -> bool {
        let Some(tare) = &mut self.tare else {
            return false;
        };
        if !matches!(tare.state(), TareState::Collecting { .. }) {
            return false;
        }
        if let TareState::Done(bias) = tare.push(wrench, self.last.saturated || sample.invalid) {
            self.bias = bias;
        }
        true
    }

    /// Starts a tare over the samples to come; one under way is given up. Until it succeeds the bias of before stays.
    ///
    /// The handle must be untouched and at rest.
    ///
    /// # Errors
    /// As [`Tare::new`]; nothing is started then.
    pub fn start_tare(&mut self, parameters: TareParameters) -> Result<(), SensingError> {
        self.tare = Some(Tare::new(parameters)?);
        (self.last.force, self.last.torque_z_n_m) = (Force::default(), 0.0);
        self.last.valid = false;
        Ok(())
    }

    /// Returns the progress of the last started tare; none if no tare was ever started.
    pub fn tare_state(&self) -> Option<TareState> {
        self.tare.as_ref().map(Tare::state)
    }

    /// Takes a wrench for the zero, sensor frame, in place of a tare under way.
    pub fn set_bias(&mut self, bias: Wrench) {
        (self.bias, self.tare) = (bias, None);
    }

    /// Returns the wrench that counts as zero, sensor frame.
    pub fn bias(&self) -> Wrench {
        self.bias
    }

    /// Counts to wrench.
    ///
    /// Real-time: yes.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// Mounting of the sensor on its link.
    pub fn mounting(&self) -> Mounting {
        self.mounting
    }

    /// Delay of slow forces by the low pass, s; zero without one. The age of the sample comes on top.
    pub fn filter_delay_s(&self) -> f64 {
        self.low_pass.as_ref().map_or(0.0, LowPass::delay_s)
    }
}
