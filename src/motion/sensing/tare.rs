//! Taring: the wrench of an untouched handle, as the mean of many samples at rest.

use nalgebra::Vector6;

use super::Wrench;
use super::error::{SensingError, not_negative};

/// Most samples of a tare: a minute at 1 kHz. Longer, and drift is what is measured.
const MOST_SAMPLES: u32 = 60_000;

/// Parameters of a tare.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TareParameters {
    /// Samples whose mean is the bias, 1 to 60 000.
    pub samples: u32,
    /// Largest difference between two samples of any force component, N. More means that somebody holds the handle.
    pub force_spread_limit_n: f64,
    /// Largest difference between two samples of any torque component, N m.
    pub torque_spread_limit_n_m: f64,
}

/// Reason why a tare failed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TareFault {
    /// A sample was saturated.
    Saturated,
    /// The wrench moved by more than its limit.
    Moving {
        /// Largest difference of a force component so far, N.
        force_spread_n: f64,
        /// Largest difference of a torque component so far, N m.
        torque_spread_n_m: f64,
    },
}

/// Progress of a tare.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TareState {
    /// Taking samples.
    Collecting {
        /// Number of samples still to come.
        remaining: u32,
    },
    /// Finished with this bias, sensor frame.
    Done(Wrench),
    /// Given up; the bias before it stays in force.
    Failed(TareFault),
}

/// A tare under way: a mean over samples that must stay close to each other.
#[derive(Clone, Debug)]
pub struct Tare {
    parameters: TareParameters,
    /// The first sample; sums are of differences from it, so that a large bias costs no digits.
    first: Option<Vector6<f64>>,
    sum: Vector6<f64>,
    least: Vector6<f64>,
    greatest: Vector6<f64>,
    state: TareState,
}

impl Tare {
    /// Creates a tare that has seen no sample.
    ///
    /// # Errors
    /// [`SensingError::TareSamples`], or [`SensingError::OutOfRange`] for limits that are not finite or negative.
    pub fn new(parameters: TareParameters) -> Result<Self, SensingError> {
        if !(1..=MOST_SAMPLES).contains(&parameters.samples) {
            return Err(SensingError::TareSamples { received: parameters.samples, most: MOST_SAMPLES });
        }
        not_negative("force spread limit", parameters.force_spread_limit_n)?;
        not_negative("torque spread limit", parameters.torque_spread_limit_n_m)?;
        let zero = Vector6::zeros();
        let state = TareState::Collecting { remaining: parameters.samples };
        Ok(Self { parameters, first: None, sum: zero, least: zero, greatest: zero, state })
    }

    /// Takes the next new sample, before any bias is subtracted. Does nothing once done or failed.
    ///
    /// Real-time: yes.
    pub fn push(&mut self, wrench: &Wrench, saturated: bool) -> TareState {
        let TareState::Collecting { remaining } = self.state else {
            return self.state;
        };
        let first = *self.first.get_or_insert(wrench.0);
        let difference = wrench.0 - first;
        self.sum += difference;
        self.least = self.least.inf(&difference);
        self.greatest = self.greatest.sup(&difference);
        let spread = self.greatest - self.least;
        let force_spread_n = spread.x.max(spread.y).max(spread.z);
        let torque_spread_n_m = spread.w.max(spread.a).max(spread.b);
        self.state = if saturated {
            TareState::Failed(TareFault::Saturated)
        } else if force_spread_n > self.parameters.force_spread_limit_n
            || torque_spread_n_m > self.parameters.torque_spread_limit_n_m
        {
            TareState::Failed(TareFault::Moving { force_spread_n, torque_spread_n_m })
        } else if remaining > 1 {
            TareState::Collecting { remaining: remaining - 1 }
        } else {
            TareState::Done(Wrench(first + self.sum / f64::from(self.parameters.samples)))
        };
        self.state
    }

    /// Returns its progress.
    pub fn state(&self) -> TareState {
        self.state
    }
}
