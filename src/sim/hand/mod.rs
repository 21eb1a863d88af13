//! A simulated hand: a spring and a damper that pull the handle towards a moving target, the hand's mass, tremor,
//! and an aim that errs.
//!
//! It serves mechanical claims (depth of penetration, energy, stability). It says nothing about how well people do.

mod noise;
mod path;

pub use noise::{GRID_PERIOD_S, NoiseBand};
pub use path::{Leg, Path, PathPoint, Speed};

use nalgebra::SVector;
use thiserror::Error;

use self::noise::Noise;
use yieldwall_motion::setvalued::sat;

/// Time over which the error of the aim grows: a hand that takes the tool aims where it is.
const AIM_ERROR_RISE_S: f64 = 0.5;
/// Added to the seed, so that the error of the aim knows nothing of the tremor.
const AIM_STREAM: u64 = 0x9e37_79b9_7f4a_7c15;

/// Error in a hand, its tremor or its path.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum HandError {
    /// A quantity of the hand is not finite or below zero.
    #[error("the hand's {name} is {value}; it must be finite and not negative")]
    BadParameter {
        /// Quantity, with its unit.
        name: &'static str,
        /// Value given.
        value: f64,
    },
    /// A band is empty, below zero or beyond what its time grid carries.
    #[error("a band from {low_hz} Hz to {high_hz} Hz: need 0 < low < high <= {highest_hz} Hz")]
    BadBand {
        /// Lower edge in Hz.
        low_hz: f64,
        /// Upper edge in Hz.
        high_hz: f64,
        /// The greatest upper edge in Hz.
        highest_hz: f64,
    },
    /// A coordinate of the path is not finite.
    #[error("leg {leg} of the path has a coordinate that is not finite (the start is leg 0)")]
    NotFinite {
        /// Number of the leg, from 1; 0 is the start.
        leg: usize,
    },
    /// A leg lasts no time.
    #[error("leg {leg} of the path lasts {in_s} s; it must be finite and longer than zero")]
    BadDuration {
        /// Number of the leg, from 1.
        leg: usize,
        /// Value given, in s.
        in_s: f64,
    },
    /// An arc starts at its own centre.
    #[error("leg {leg} of the path is an arc that starts {radius_m} m from its centre")]
    NoRadius {
        /// Number of the leg, from 1.
        leg: usize,
        /// Distance of the start from the centre in m.
        radius_m: f64,
    },
    /// An arc in a space without a plane.
    #[error("leg {leg} of the path is an arc, which needs two dimensions or more")]
    NoPlane {
        /// Number of the leg, from 1.
        leg: usize,
    },
}

/// Mechanical quantities of a hand.
///
/// # Source
/// Orders of magnitude for a hand on a handle: 0.5 to 2 kg, 100 to 1000 N/m (3000 braced), 5 to 40 N s/m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandParameters {
    /// Mass that moves with the handle in kg.
    pub mass_kg: f64,
    /// Spring between target and handle in N/m.
    pub stiffness_n_per_m: f64,
    /// Damper between target and handle in N s/m.
    pub damping_n_s_per_m: f64,
    /// Greatest force of the spring in N; infinity for no limit.
    pub voluntary_force_limit_n: f64,
    /// Force noise of the tremor in N, if any: 8 to 12 Hz. Force rather than motion, so that the mass of the device
    /// attenuates it.
    pub tremor: Option<NoiseBand>,
    /// Error of the aim, if any.
    pub aim_error: Option<AimError>,
}

/// A slow random course of the point that a hand aims at about its path. It grows from nothing over the first half second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AimError {
    /// Root mean square along each axis in m.
    pub rms_m: f64,
    /// Above this frequency it has little power, in Hz; people move by intent below some 2 Hz.
    pub corner_hz: f64,
}

/// Load of a hand on the handle near one moment: `force - damping * velocity - stiffness * (position - here)`.
///
/// The hand's mass is not in it: it belongs to the mass that the plant moves. The default is no hand at all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandLoad<const N: usize> {
    /// Force on a handle at rest at the position asked for, in N.
    pub force_n: SVector<f64, N>,
    /// Damping in N s/m.
    pub damping_n_s_per_m: f64,
    /// How the force falls with the handle's position in N/m; zero while the spring is at its limit.
    pub stiffness_n_per_m: f64,
}

impl<const N: usize> Default for HandLoad<N> {
    fn default() -> Self {
        Self { force_n: SVector::zeros(), damping_n_s_per_m: 0.0, stiffness_n_per_m: 0.0 }
    }
}

/// A hand that follows a path in `N` dimensions. Same parameters, path and seed: the same forces, bit for bit, however
/// the caller divides time.
#[derive(Clone, Debug)]
pub struct Hand<const N: usize> {
    parameters: HandParameters,
    path: Path<N>,
    /// Point that a person aims at in place of the path, and the time of it in s.
    aim: Option<(f64, PathPoint<N>)>,
    tremor: Option<Noise<N>>,
    aim_error: Option<Noise<N>>,
}

impl<const N: usize> Hand<N> {
    /// A hand with the given mechanics that aims along `path`; `seed` fixes its noise.
    ///
    /// # Errors
    /// A quantity that is negative, NaN or (the force limit excepted) infinite; a bad band.
    pub fn new(parameters: HandParameters, path: Path<N>, seed: u64) -> Result<Self, HandError> {
        let HandParameters {
            mass_kg,
            stiffness_n_per_m,
            damping_n_s_per_m,
            voluntary_force_limit_n,
            tremor,
            aim_error,
        } = parameters;
        check_not_negative("mass in kg", mass_kg)?;
        check_not_negative("stiffness in N/m", stiffness_n_per_m)?;
        check_not_negative("damping in N s/m", damping_n_s_per_m)?;
        if voluntary_force_limit_n != f64::INFINITY {
            check_not_negative("voluntary force limit in N", voluntary_force_limit_n)?;
        }
        let tremor = tremor.map(|tremor| Noise::in_band(tremor, seed)).transpose()?;
        let stream = seed.wrapping_add(AIM_STREAM);
        let aim_error = aim_error.map(|error| Noise::below(error.rms_m, error.corner_hz, stream)).transpose()?;
        Ok(Self { parameters, path, aim: None, tremor, aim_error })
    }

    /// The parameters it was made with.
    pub fn parameters(&self) -> &HandParameters {
        &self.parameters
    }

    /// Mass that moves with the handle in kg; the plant has to add it to its own.
    pub fn mass_kg(&self) -> f64 {
        self.parameters.mass_kg
    }

    /// Gives the hand another grip stiffness, N/m: finite and not negative. Its largest force stays.
    ///
    /// # Errors
    /// For another number.
    pub fn set_stiffness(&mut self, stiffness_n_per_m: f64) -> Result<(), HandError> {
        check_not_negative("stiffness in N/m", stiffness_n_per_m)?;
        self.parameters.stiffness_n_per_m = stiffness_n_per_m;
        Ok(())
    }

    /// Leaves the path: from now on the hand aims at a point that is at `aim` at `time_s` and keeps its velocity.
    pub fn aim_at(&mut self, time_s: f64, aim: PathPoint<N>) {
        self.aim = Some((time_s, aim));
    }

    /// Whether the path has let go of the handle at the time of the last target.
    #[inline]
    fn is_gone(&self) -> bool {
        self.aim.is_none() && !self.path.holds()
    }

    /// Where the hand aims at `time_s`.
    pub fn target(&mut self, time_s: f64) -> PathPoint<N> {
        let mut target = match self.aim {
            Some((from_s, aim)) => {
                PathPoint { position_m: aim.position_m + aim.velocity_m_per_s * (time_s - from_s), ..aim }
            }
            None => self.path.at(time_s),
        };
        if let Some(error) = &mut self.aim_error {
            let share = (time_s / AIM_ERROR_RISE_S).clamp(0.0, 1.0);
            target.position_m += error.value(time_s) * share;
            target.velocity_m_per_s += error.rate() * share;
        }
        target
    }

    /// Returns the load of the hand on a handle at `handle_m` at `time_s`.
    ///
    /// Times should not decrease by more than [`GRID_PERIOD_S`] from call to call: noise has no longer memory.
    #[inline]
    pub fn load(&mut self, time_s: f64, handle_m: SVector<f64, N>) -> HandLoad<N> {
        let target = self.target(time_s);
        if self.is_gone() {
            return HandLoad::default();
        }
        let HandParameters { stiffness_n_per_m, damping_n_s_per_m, voluntary_force_limit_n: limit, .. } =
            self.parameters;
        let pull = (target.position_m - handle_m) * stiffness_n_per_m;
        let at_limit = pull.norm_squared() > limit * limit;
        let mut force_n = sat(pull, limit) + target.velocity_m_per_s * damping_n_s_per_m;
        if let Some(tremor) = &mut self.tremor {
            force_n += tremor.value(time_s);
        }
        HandLoad { force_n, damping_n_s_per_m, stiffness_n_per_m: if at_limit { 0.0 } else { stiffness_n_per_m } }
    }

    /// Force from the hand on the tool in N, as a sensor between the two measures it: spring, damper and tremor, less
    /// what the hand's own mass takes.
    ///
    /// `handle_m`, `velocity_m_per_s` and `acceleration_m_per_s2` are those of the handle at `time_s`. Time as for
    /// [`Hand::load`].
    pub fn force_on_tool(
        &mut self,
        time_s: f64,
        handle_m: SVector<f64, N>,
        velocity_m_per_s: SVector<f64, N>,
        acceleration_m_per_s2: SVector<f64, N>,
    ) -> SVector<f64, N> {
        let load = self.load(time_s, handle_m);
        if self.is_gone() {
            return load.force_n;
        }
        load.force_n - velocity_m_per_s * load.damping_n_s_per_m - acceleration_m_per_s2 * self.parameters.mass_kg
    }
}

fn check_not_negative(name: &'static str, value: f64) -> Result<(), HandError> {
    if value.is_finite() && value >= 0.0 { Ok(()) } else { Err(HandError::BadParameter { name, value }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use yieldwall_motion::elementary;

    fn parameters() -> HandParameters {
        HandParameters {
            mass_kg: 0.5,
            stiffness_n_per_m: 400.0,
            damping_n_s_per_m: 8.0,
            voluntary_force_limit_n: 40.0,
            tremor: None,
            aim_error: None,
        }
    }

    fn hand(parameters: HandParameters, seed: u64) -> Hand<2> {
        let path = Path::new(Vector2::new(0.1, 0.0), &[Leg::To { point_m: Vector2::new(0.1, 0.2), in_s: 1.0 }]);
        Hand::new(parameters, path.unwrap(), seed).unwrap()
    }

    #[test]
    fn the_force_is_spring_damper_and_inertia() {
        let mut hand = hand(parameters(), 1);
        // Half-way a minimum-jerk leg of 0.2 m in 1 s is at 0.1 m with 15/8 of the mean speed.
        let force = hand.force_on_tool(0.5, Vector2::new(0.08, 0.11), Vector2::new(0.1, -0.2), Vector2::new(2.0, -1.0));
        let expected =
            Vector2::new(400.0 * 0.02 - 8.0 * 0.1 - 0.5 * 2.0, 400.0 * -0.01 + 8.0 * (0.2 * 1.875 + 0.2) + 0.5 * 1.0);
        assert!((force - expected).norm() < 1e-12, "{force} against {expected}");
    }

    #[test]
    fn the_spring_gives_in_at_its_limit_and_keeps_its_direction() {
        let mut hand = hand(parameters(), 1);
        let load = hand.load(0.0, Vector2::new(0.4, 0.4));
        assert!((load.force_n.norm() - 40.0).abs() < 1e-12);
        assert!((load.force_n.x * -0.4 - load.force_n.y * -0.3).abs() < 1e-12);
        assert_eq!(load.stiffness_n_per_m, 0.0);
        assert_eq!(hand.load(0.0, Vector2::new(0.15, 0.0)).stiffness_n_per_m, 400.0);
    }

    #[test]
    fn a_hand_that_lets_go_does_nothing_to_the_handle_and_takes_it_again() {
        let here = Vector2::new(0.1, 0.0);
        let legs = [Leg::Wait { for_s: 1.0 }, Leg::LetGo { for_s: 1.0 }, Leg::Wait { for_s: 1.0 }];
        let mut hand = Hand::new(parameters(), Path::new(here, &legs).unwrap(), 1).unwrap();
        let mut force = |time_s| {
            hand.force_on_tool(time_s, Vector2::new(0.0, 0.0), Vector2::new(0.1, 0.0), Vector2::new(1.0, 0.0)).x
        };
        let held_n = 400.0 * 0.1 - 8.0 * 0.1 - 0.5;
        assert_eq!([0.5, 1.5, 2.5, 1.5].map(&mut force), [held_n, 0.0, held_n, 0.0]);
        hand.aim_at(1.5, PathPoint { position_m: here, velocity_m_per_s: Vector2::new(0.2, 0.0) });
        // The aim goes on with its velocity, whatever the path says.
        assert!((hand.load(1.6, here).force_n.x - (400.0 * 0.02 + 8.0 * 0.2)).abs() < 1e-9);
    }

    #[test]
    fn an_unlimited_spring_has_no_limit() {
        let mut hand = hand(HandParameters { voluntary_force_limit_n: f64::INFINITY, ..parameters() }, 1);
        assert!((hand.load(0.0, Vector2::new(-9.9, 0.0)).force_n.x - 4000.0).abs() < 1e-9);
    }

    #[test]
    fn bad_quantities_are_refused_by_name() {
        let path = || Path::new(Vector2::new(0.1, 0.0), &[]).unwrap();
        for bad in [
            HandParameters { mass_kg: -0.1, ..parameters() },
            HandParameters { stiffness_n_per_m: f64::NAN, ..parameters() },
            HandParameters { damping_n_s_per_m: f64::INFINITY, ..parameters() },
            HandParameters { voluntary_force_limit_n: f64::NAN, ..parameters() },
        ] {
            assert!(matches!(Hand::new(bad, path(), 1), Err(HandError::BadParameter { .. })), "{bad:?}");
        }
        let tremor = Some(NoiseBand { rms: -1.0, low_hz: 8.0, high_hz: 12.0 });
        assert!(Hand::new(HandParameters { tremor, ..parameters() }, path(), 1).is_err());
    }

    #[test]
    fn forces_repeat_with_the_seed_and_do_not_depend_on_the_calls_between() {
        let tremor = Some(NoiseBand { rms: 0.1, low_hz: 8.0, high_hz: 12.0 });
        let parameters = HandParameters { tremor, ..parameters() };
        let run = |seed, calls_between: usize| {
            let mut hand = hand(parameters, seed);
            let mut forces = Vec::new();
            for index in 0..500 {
                let from = f64::from(index) * 3.7e-3;
                forces.push(hand.load(from, Vector2::zeros()).force_n);
                for between in 1..=calls_between {
                    hand.load(from + 3.7e-3 * between as f64 / (calls_between + 1) as f64, Vector2::zeros());
                }
            }
            forces
        };
        assert_eq!(run(1, 0), run(1, 0));
        assert_eq!(run(1, 0), run(1, 7));
        assert_ne!(run(1, 0), run(2, 0));
    }

    #[test]
    fn an_aim_errs_about_its_path_and_begins_on_it() {
        let aim_error = Some(AimError { rms_m: 0.01, corner_hz: 0.8 });
        let mut hand = hand(HandParameters { aim_error, ..parameters() }, 3);
        assert_eq!(hand.target(0.0).position_m, Vector2::new(0.1, 0.0));
        // The path has ended; the error goes on.
        let square = |time_s: f64, hand: &mut Hand<2>| {
            elementary::powi((hand.target(time_s).position_m - Vector2::new(0.1, 0.2)).x, 2)
        };
        let rms = ((0..200_000).map(|i| square(2.0 + 0.002 * f64::from(i), &mut hand)).sum::<f64>() / 200_000.0).sqrt();
        // 400 s at a coherence time of 0.3 s: a scatter of some 4 %.
        assert!((rms / 0.01 - 1.0).abs() < 0.12, "{rms}");
        let (before, after) = (hand.target(500.0001), hand.target(500.0009));
        let slope = (after.position_m - before.position_m) / 0.0008;
        assert!((slope - after.velocity_m_per_s).norm() < 1e-9, "the velocity is that of the erring aim");
        let speed = |time_s: f64, hand: &mut Hand<2>| elementary::powi(hand.target(time_s).velocity_m_per_s.x, 2);
        let rms =
            ((0..200_000).map(|i| speed(600.0 + 0.002 * f64::from(i), &mut hand)).sum::<f64>() / 200_000.0).sqrt();
        // That of a filter of the second order: natural frequency times RMS.
        assert!((rms / (0.01 * std::f64::consts::TAU * 0.8) - 1.0).abs() < 0.12, "{rms}");
    }
}
