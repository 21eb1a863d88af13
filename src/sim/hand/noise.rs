//! Random courses: the force of a tremor, in a narrow band, and the error of an aim, slow and smooth.

use crate::standard_normal;
use nalgebra::{Matrix2, SVector, Vector2};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use yieldwall_motion::elementary;

use super::{HandError, check_not_negative};

/// Time between two values of the noise, in s. Between them the force is interpolated linearly, which takes less than
/// 0.1 % off the RMS at 12 Hz.
pub const GRID_PERIOD_S: f64 = 1e-3;

/// The greatest upper edge of the band in Hz: a tenth of the grid's rate.
const HIGHEST_HZ: f64 = 0.1 / GRID_PERIOD_S;

/// Size and band of a noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseBand {
    /// Root mean square along each axis, in the unit of what is noisy.
    pub rms: f64,
    /// Lower edge of the band in Hz, where the power density has fallen to half.
    pub low_hz: f64,
    /// Upper edge of the band in Hz, where the power density has fallen to half.
    pub high_hz: f64,
}

/// Output of the filter that is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Output {
    /// `p'`: a band-pass. Its course has no slope.
    Band,
    /// `w p`: a low-pass, flat up to the natural frequency. Its course has a slope.
    Smooth,
}

/// White noise through a second-order filter, independent along each axis and stationary from time zero.
///
/// The filter `p'' + 2 z w p' + w^2 p = noise` advances on a fixed grid of [`GRID_PERIOD_S`] by its exact transition. Therefore
/// neither the step of the plant nor the moments of the calls change its course.
///
/// # Source
/// Discretisation: the stationary covariance of `(w p, p')` is `rms^2 I`; derived here.
#[derive(Clone, Debug)]
pub(super) struct Noise<const N: usize> {
    generator: Xoshiro256PlusPlus,
    transition: Matrix2<f64>,
    /// Lower Cholesky factor of the covariance that one grid period adds.
    noise: Matrix2<f64>,
    /// Filter states `(w p, p')`, one per axis.
    states: [Vector2<f64>; N],
    output: Output,
    from: SVector<f64, N>,
    to: SVector<f64, N>,
    /// Grid number of `from`.
    index: u64,
}

impl<const N: usize> Noise<N> {
    /// A noise whose course `seed` fixes.
    ///
    /// # Errors
    /// An RMS that is negative or not finite; a band that is not `0 < low < high <= 100 Hz`.
    pub(super) fn in_band(parameters: NoiseBand, seed: u64) -> Result<Self, HandError> {
        Self::new(parameters, Output::Band, seed)
    }

    /// A noise with a slope and no power far above `corner_hz`, whose course `seed` fixes.
    ///
    /// # Errors
    /// An RMS that is negative or not finite; a corner that is not above 0 and at most 50 Hz.
    pub(super) fn below(rms: f64, corner_hz: f64, seed: u64) -> Result<Self, HandError> {
        // A natural frequency at the corner, damped by three quarters of the critical.
        Self::new(NoiseBand { rms, low_hz: 0.5 * corner_hz, high_hz: 2.0 * corner_hz }, Output::Smooth, seed)
    }

    fn new(parameters: NoiseBand, output: Output, seed: u64) -> Result<Self, HandError> {
        let NoiseBand { rms, low_hz, high_hz } = parameters;
        check_not_negative("noise (RMS)", rms)?;
        if !(low_hz > 0.0 && low_hz < high_hz && high_hz <= HIGHEST_HZ) {
            return Err(HandError::BadBand { low_hz, high_hz, highest_hz: HIGHEST_HZ });
        }
        let transition = transition(low_hz, high_hz);
        let added = (Matrix2::identity() - transition * transition.transpose()) * (rms * rms);
        let mut noise = Self {
            generator: Xoshiro256PlusPlus::seed_from_u64(seed),
            transition,
            noise: lower_factor(&added),
            states: [Vector2::zeros(); N],
            output,
            from: SVector::zeros(),
            to: SVector::zeros(),
            index: 0,
        };
        for state in &mut noise.states {
            *state = normal_pair(&mut noise.generator) * rms;
        }
        noise.from = noise.output();
        noise.advance_state();
        Ok(noise)
    }

    /// The value at `time_s`.
    ///
    /// For a time before the present grid period it is that of the period's beginning, and for one that is not
    /// finite as well. A call costs one filter step for each grid period since the last call.
    #[inline]
    pub(super) fn value(&mut self, time_s: f64) -> SVector<f64, N> {
        let grid = time_s / GRID_PERIOD_S;
        // The cast saturates: a negative time gives zero.
        let wanted = if grid.is_finite() { grid as u64 } else { 0 };
        while self.index < wanted {
            self.index += 1;
            self.from = self.to;
            self.advance_state();
        }
        let share = if wanted < self.index || !grid.is_finite() { 0.0 } else { (grid - wanted as f64).max(0.0) };
        self.from + (self.to - self.from) * share
    }

    /// How fast the value changes around the time last asked for, per second.
    #[inline]
    pub(super) fn rate(&self) -> SVector<f64, N> {
        (self.to - self.from) / GRID_PERIOD_S
    }

    fn advance_state(&mut self) {
        for state in &mut self.states {
            *state = self.transition * *state + self.noise * normal_pair(&mut self.generator);
        }
        self.to = self.output();
    }

    fn output(&self) -> SVector<f64, N> {
        SVector::from_fn(|axis, _| match self.output {
            Output::Band => self.states[axis].y,
            Output::Smooth => self.states[axis].x,
        })
    }
}

/// Transition of `(w p, p')` over one grid period.
fn transition(low_hz: f64, high_hz: f64) -> Matrix2<f64> {
    let natural = std::f64::consts::TAU * (low_hz * high_hz).sqrt();
    // Half of the -3 dB width, which is also the rate at which the envelope decays.
    let decay = 0.5 * std::f64::consts::TAU * (high_hz - low_hz);
    let envelope = elementary::exp(-decay * GRID_PERIOD_S);
    // (cos, sin/rate) of the damped rotation; with low close to zero the filter is overdamped.
    let squared = natural * natural - decay * decay;
    let turn = squared.abs().sqrt() * GRID_PERIOD_S;
    let (cos, sin_by_rate) = if turn < 1e-6 {
        (1.0, GRID_PERIOD_S)
    } else if squared > 0.0 {
        (elementary::cos(turn), elementary::sin(turn) * GRID_PERIOD_S / turn)
    } else {
        (elementary::cosh(turn), elementary::sinh(turn) * GRID_PERIOD_S / turn)
    };
    Matrix2::new(cos + decay * sin_by_rate, natural * sin_by_rate, -natural * sin_by_rate, cos - decay * sin_by_rate)
        * envelope
}

/// `L` with `L L^T = covariance`, for a covariance that rounding may have left slightly indefinite.
fn lower_factor(covariance: &Matrix2<f64>) -> Matrix2<f64> {
    let first = covariance.m11.max(0.0).sqrt();
    let below = if first > 0.0 { covariance.m21 / first } else { 0.0 };
    Matrix2::new(first, 0.0, below, (covariance.m22 - below * below).max(0.0).sqrt())
}

fn normal_pair(generator: &mut Xoshiro256PlusPlus) -> Vector2<f64> {
    Vector2::new(standard_normal(generator), standard_normal(generator))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const USUAL: NoiseBand = NoiseBand { rms: 0.1, low_hz: 8.0, high_hz: 12.0 };

    fn samples(parameters: NoiseBand, seed: u64, count: u32) -> Vec<[f64; 2]> {
        let mut noise = Noise::<2>::in_band(parameters, seed).unwrap();
        (0..count).map(|index| noise.value((f64::from(index) + 0.5) * GRID_PERIOD_S).into()).collect()
    }

    /// Mean power density at one frequency over segments of 2 s, by direct Fourier sums.
    fn power(samples: &[f64], frequency_hz: f64) -> f64 {
        let segments = samples.chunks_exact(2000);
        let count = segments.len() as f64;
        let sum: f64 = segments
            .map(|segment| {
                let (mut cos, mut sin) = (0.0, 0.0);
                for (index, sample) in segment.iter().enumerate() {
                    let phase = TAU * frequency_hz * index as f64 * GRID_PERIOD_S;
                    cos += sample * elementary::cos(phase);
                    sin += sample * elementary::sin(phase);
                }
                cos * cos + sin * sin
            })
            .sum();
        sum / count
    }

    #[test]
    fn the_rms_is_the_one_given_on_each_axis() {
        let samples = samples(USUAL, 7, 400_000);
        for axis in 0..2 {
            let mean_square = samples.iter().map(|sample| sample[axis] * sample[axis]).sum::<f64>() / 400_000.0;
            // 400 s at a coherence time of 1/(2 pi 4 Hz) leaves about 1.5 % of scatter.
            assert!((mean_square.sqrt() / 0.1 - 1.0).abs() < 0.04, "axis {axis}: {}", mean_square.sqrt());
        }
        let product = samples.iter().map(|sample| sample[0] * sample[1]).sum::<f64>() / 400_000.0;
        assert!(product.abs() < 0.05 * 0.01, "axes are independent: {product}");
    }

    #[test]
    fn it_is_stationary_from_the_start() {
        let mean_square = (0..4000)
            .map(|seed| elementary::powi(Noise::<1>::in_band(USUAL, seed).unwrap().value(0.0).x, 2))
            .sum::<f64>()
            / 4000.0;
        assert!((mean_square.sqrt() / 0.1 - 1.0).abs() < 0.04, "{}", mean_square.sqrt());
    }

    #[test]
    fn the_power_lies_in_the_band() {
        let first: Vec<f64> = samples(USUAL, 3, 1_000_000).iter().map(|sample| sample[0]).collect();
        let top = power(&first, 96f64.sqrt());
        // 500 segments: a scatter of 4.5 % each.
        for edge_hz in [8.0, 12.0] {
            let ratio = power(&first, edge_hz) / top;
            assert!((0.4..0.65).contains(&ratio), "{edge_hz} Hz: {ratio}");
        }
        for far_hz in [2.0, 40.0] {
            let ratio = power(&first, far_hz) / top;
            assert!(ratio < 0.02, "{far_hz} Hz: {ratio}");
        }
    }

    #[test]
    fn the_transition_solves_the_filter() {
        for (low_hz, high_hz) in [(8.0, 12.0), (0.5, 30.0)] {
            let natural = TAU * f64::sqrt(low_hz * high_hz);
            let decay = 0.5 * TAU * (high_hz - low_hz);
            let rate = Matrix2::new(0.0, natural, -natural, -2.0 * decay);
            let mut expected = Matrix2::identity();
            let mut term = Matrix2::identity();
            for order in 1..20 {
                term = term * rate * (GRID_PERIOD_S / f64::from(order));
                expected += term;
            }
            assert!((transition(low_hz, high_hz) - expected).norm() < 1e-13);
        }
    }

    #[test]
    fn the_force_is_continuous_in_time() {
        let mut noise = Noise::<2>::in_band(USUAL, 5).unwrap();
        let mut before = noise.value(0.0);
        for index in 1..20_000 {
            let now = noise.value(f64::from(index) * 1e-4);
            assert!((now - before).norm() < 0.01);
            before = now;
        }
    }

    #[test]
    fn odd_times_give_a_finite_force() {
        let mut noise = Noise::<2>::in_band(USUAL, 5).unwrap();
        let start = noise.value(0.0);
        assert_eq!(noise.value(-1.0), start);
        assert_eq!(noise.value(f64::NAN), start);
        assert_eq!(noise.value(f64::INFINITY), start);
        let later = noise.value(0.25);
        assert_eq!(noise.value(0.1), later);
    }

    #[test]
    fn an_empty_band_is_refused() {
        for (low_hz, high_hz) in [(12.0, 8.0), (0.0, 8.0), (8.0, 200.0), (f64::NAN, 8.0)] {
            let bad = NoiseBand { low_hz, high_hz, ..USUAL };
            assert!(matches!(Noise::<2>::in_band(bad, 1), Err(HandError::BadBand { .. })));
        }
    }

    #[test]
    fn no_tremor_force_is_no_force() {
        let mut noise = Noise::<2>::in_band(NoiseBand { rms: 0.0, ..USUAL }, 1).unwrap();
        assert_eq!(noise.value(0.5).norm(), 0.0);
    }
}
