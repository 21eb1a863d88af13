//! The force sensor of a rig that idles: what it shows is looked at, or taken for its zero.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::Vector6;

use super::error::RunError;
use super::permit::Ask;
use super::place::Place;
use super::runner::Runner;
use crate::assembly::calibration;
use yieldwall_config::{self as config, Positive};
use yieldwall_motion::sensing::{TareFault, TareParameters, TareState, Wrench};

/// How long samples are taken, s, and how many at least.
const TARE_S: f64 = 0.5;
const LEAST_SAMPLES: f64 = 20.0;
/// How long the sensor settles before, s.
const SETTLING_S: f64 = 0.3;
/// How much longer than its samples need a tare may take.
const PATIENCE: f64 = 3.0;
/// Share of the greatest zero by which forces may differ while samples are taken.
const SPREAD_SHARE: f64 = 0.5;
/// Lever by which a force at the handle makes a torque at the sensor, m: it scales the permitted difference of torques.
const LEVER_M: f64 = 0.2;

/// Readings of a force sensor over a while.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrenches {
    count: u64,
    mean: Vector6<f64>,
    /// Sum of the squares of the distances from the mean.
    squares: Vector6<f64>,
    least: Vector6<f64>,
    greatest: Vector6<f64>,
    /// Samples with a channel at the end of its range.
    pub saturated: u64,
    /// Samples that the sensor marks as invalid; no other figure includes them.
    pub invalid: u64,
}

impl Wrenches {
    /// Takes a valid sample.
    ///
    /// # Source
    /// Welford, *Note on a method for calculating corrected sums of squares and products* (1962).
    pub fn push(&mut self, wrench: &Wrench) {
        self.count += 1;
        let from = wrench.0 - self.mean;
        self.mean += from / self.count as f64;
        self.squares += from.component_mul(&(wrench.0 - self.mean));
        let is_first = self.count == 1;
        self.least = if is_first { wrench.0 } else { self.least.inf(&wrench.0) };
        self.greatest = if is_first { wrench.0 } else { self.greatest.sup(&wrench.0) };
    }

    /// Returns the number of valid samples.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns the mean of each axis, sensor frame, N and N m; 0 without samples.
    pub fn mean(&self) -> Wrench {
        Wrench(self.mean)
    }

    /// Returns the standard deviation of each axis, N and N m; 0 without samples.
    pub fn deviation(&self) -> Wrench {
        Wrench(self.squares.map(|squares| (squares / self.count.max(1) as f64).sqrt()))
    }

    /// Returns the least value of each axis, N and N m.
    pub fn least(&self) -> Wrench {
        Wrench(self.least)
    }

    /// Returns the greatest value of each axis, N and N m.
    pub fn greatest(&self) -> Wrench {
        Wrench(self.greatest)
    }
}

/// How a rig is tared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tared {
    /// The greatest force in the plane of the arm that is taken for a zero, N.
    most_n: f64,
    parameters: TareParameters,
    /// How long it may take, s.
    limit_s: f64,
}

/// Why what the force sensor shows is no zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NoZero {
    /// Forces differ too much while nobody may touch the handle: the greatest difference, N.
    Moves(f64),
    /// A force is too great: its size, N, and the greatest that is taken.
    Great(f64, f64),
    /// A channel is at the end of its range, or samples are not valid.
    Saturated,
    /// Too few samples came.
    Silent,
}

impl std::fmt::Display for NoZero {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Moves(spread_n) => {
                write!(out, "forces differ by {spread_n:.2} N, so that somebody touches the handle or the arm moves")
            }
            Self::Great(force_n, most_n) => write!(out, "it shows {force_n:.2} N, more than {most_n:.2} N"),
            Self::Saturated => out.write_str("a channel is at the end of its range, or a sample is not valid"),
            Self::Silent => out.write_str("too few samples came"),
        }
    }
}

impl Tared {
    /// Creates the taring with zeros up to `most_n`.
    pub(super) fn up_to(rig: &config::Rig, most_n: Positive) -> Self {
        let cycle_hz = 1e6 / f64::from(rig.cycle.period_us);
        let rate_hz = rig.sensor.sample_rate_hz.get().min(cycle_hz);
        let samples = (TARE_S * rate_hz).max(LEAST_SAMPLES).ceil();
        let force_n = SPREAD_SHARE * most_n.get();
        let parameters = TareParameters {
            samples: samples as u32,
            force_spread_limit_n: force_n,
            torque_spread_limit_n_m: LEVER_M * force_n,
        };
        Self { most_n: most_n.get(), parameters, limit_s: PATIENCE * samples / rate_hz }
    }

    /// Creates the taring of the rig file; `None` if the file asks for none.
    pub(super) fn of(rig: &config::Rig) -> Option<Self> {
        rig.sensor.tare_up_to_n.map(|most_n| Self::up_to(rig, most_n))
    }
}

impl<P: Place + ?Sized> Runner<P> {
    /// Tares the force sensor of a booted rig that idles: its mean reading within half a second is its zero until the next tare.
    /// Nobody may touch the handle. Returns the wrench that is the zero now, in the sensor's frame.
    ///
    /// # Errors
    /// [`RunError::NotTared`] if the reading is no valid zero, and the zero then stays as it was; if a person asks for the end.
    pub fn tare(
        &mut self,
        rig: &config::Rig,
        most_n: Positive,
        is_interrupted: &AtomicBool,
    ) -> Result<Wrench, RunError> {
        self.tare_by(Tared::up_to(rig, most_n), is_interrupted)
    }

    pub(super) fn tare_by(&mut self, tared: Tared, is_interrupted: &AtomicBool) -> Result<Wrench, RunError> {
        let not_tared = |why: NoZero| RunError::NotTared { why };
        self.idle(SETTLING_S, is_interrupted)?;
        let before = self.master().cycle().sensing().bias();
        self.master.cycle_mut().start_tare(tared.parameters).map_err(|_| not_tared(NoZero::Silent))?;
        for _ in 0..self.cycles_in(tared.limit_s).max(1) {
            self.idle(0.0, is_interrupted)?;
            match self.master().cycle().sensing().tare_state() {
                Some(TareState::Done(zero)) => {
                    let (x, y) = (zero.0.x, zero.0.y);
                    let force_n = yieldwall_motion::elementary::hypot(x, y);
                    if force_n <= tared.most_n {
                        return Ok(zero);
                    }
                    self.master.cycle_mut().set_bias(before);
                    return Err(not_tared(NoZero::Great(force_n, tared.most_n)));
                }
                Some(TareState::Failed(TareFault::Saturated)) => return Err(not_tared(NoZero::Saturated)),
                Some(TareState::Failed(TareFault::Moving { force_spread_n, .. })) => {
                    return Err(not_tared(NoZero::Moves(force_spread_n)));
                }
                _ => {}
            }
        }
        self.master.cycle_mut().set_bias(before);
        Err(not_tared(NoZero::Silent))
    }

    /// Listens to the force sensor of a booted rig that idles, after the sensor has settled. `each` receives the time in s and the
    /// wrench of every valid sample. The wrench is in the sensor's frame, by the calibration of the rig file alone, without
    /// subtracting a zero.
    ///
    /// If a person asks for the end, it returns the readings until then.
    ///
    /// # Errors
    /// If a person asks for the end before.
    pub fn sense(
        &mut self,
        rig: &config::Rig,
        time_s: f64,
        is_interrupted: &AtomicBool,
        mut each: impl FnMut(f64, &Wrench),
    ) -> Result<Wrenches, RunError> {
        let (calibration, _) = calibration(rig)?;
        self.idle(SETTLING_S, is_interrupted)?;
        let period_s = self.period().as_secs_f64();
        let mut wrenches = Wrenches::default();
        for cycle in 1..=self.cycles_in(time_s) {
            if is_interrupted.load(Ordering::Relaxed) {
                break;
            }
            let Some(sample) = self.run_cycle(Ask::Nothing).and_then(|record| record.inputs.sample) else { continue };
            wrenches.saturated += u64::from(calibration.is_saturated(&sample));
            if sample.invalid {
                wrenches.invalid += 1;
                continue;
            }
            let wrench = calibration.wrench(&sample);
            wrenches.push(&wrench);
            each(f64::from(cycle) * period_s, &wrench);
        }
        Ok(wrenches)
    }

    /// Listens as [`Runner::sense`]; `told` receives the readings of every `row_s` and the begin of that interval, s.
    ///
    /// # Errors
    /// As [`Runner::sense`].
    pub fn sense_in_rows(
        &mut self,
        rig: &config::Rig,
        [time_s, row_s]: [f64; 2],
        is_interrupted: &AtomicBool,
        mut told: impl FnMut(f64, Wrenches),
    ) -> Result<Wrenches, RunError> {
        let (mut from_s, mut row) = (0.0, Wrenches::default());
        let all = self.sense(rig, time_s, is_interrupted, |now_s, wrench| {
            // A while without a sample is a row as well.
            while now_s > from_s + row_s {
                told(from_s, row);
                (from_s, row) = (from_s + row_s, Wrenches::default());
            }
            row.push(wrench);
        })?;
        told(from_s, row);
        Ok(all)
    }

    /// Lets the rig idle for a time, at least for a cycle.
    fn idle(&mut self, time_s: f64, is_interrupted: &AtomicBool) -> Result<(), RunError> {
        for _ in 0..self.cycles_in(time_s).max(1) {
            if is_interrupted.load(Ordering::Relaxed) {
                return Err(RunError::Interrupted);
            }
            self.run_cycle(Ask::Nothing);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_shown_has_mean_deviation_and_ends() {
        let mut all = Wrenches::default();
        assert_eq!((all.count(), all.mean().0.x, all.deviation().0.x), (0, 0.0, 0.0));
        for x in [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0] {
            all.push(&Wrench(Vector6::new(x, -x, 0.0, 0.0, 0.0, 1.0)));
        }
        assert_eq!((all.count(), all.mean().0.x, all.mean().0.y, all.mean().0.b), (8, 5.0, -5.0, 1.0));
        assert!((all.deviation().0.x - 2.0).abs() < 1e-12 && all.deviation().0.b == 0.0);
        assert_eq!((all.least().0.x, all.greatest().0.x, all.least().0.y, all.greatest().0.y), (2.0, 9.0, -9.0, -2.0));
    }
}
