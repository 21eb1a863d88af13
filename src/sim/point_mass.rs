//! A back-drivable device taken as a point mass in `N` dimensions, moved by a control force and by a hand.

use nalgebra::SVector;
use thiserror::Error;

use super::hand::HandLoad;
use super::substeps::equal_steps;

/// Error in a point mass or in its motion.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PointMassError {
    /// A quantity of the device is out of its range.
    #[error("the point mass has a {name} of {value}")]
    BadParameter {
        /// Quantity, with its unit and range.
        name: &'static str,
        /// Value given.
        value: f64,
    },
    /// A step that is not above zero, or a time that is not finite or needs too many steps.
    #[error("the point mass cannot be moved on from {time_s:.6} s to {end_s:.6} s in steps of {step_s} s")]
    BadStep {
        /// Present time in s.
        time_s: f64,
        /// Time wanted in s.
        end_s: f64,
        /// Step wanted in s.
        step_s: f64,
    },
    /// A force or a hand is not finite, or it threw the mass to infinity. The state is that before the step.
    #[error("the point mass has no finite motion after {time_s:.4} s")]
    NotFinite {
        /// Beginning of the step that failed, in s.
        time_s: f64,
    },
}

/// Mechanical quantities of the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointMassParameters {
    /// Moving mass in kg, without the hand's.
    pub mass_kg: f64,
    /// Viscous friction in N s/m.
    pub damping_n_s_per_m: f64,
    /// Smallest difference of position that the device reports in m; zero for none.
    pub position_resolution_m: f64,
}

/// State of the device. The step is the midpoint rule with damper and spring of the hand taken implicitly, of second
/// order and stable for any stiffness and step.
#[derive(Clone, Debug)]
pub struct PointMass<const N: usize> {
    parameters: PointMassParameters,
    moving_mass_kg: f64,
    time_s: f64,
    position_m: SVector<f64, N>,
    velocity_m_per_s: SVector<f64, N>,
    acceleration_m_per_s2: SVector<f64, N>,
}

impl<const N: usize> PointMass<N> {
    /// A device at rest at `start_m` at time zero, with `hand_mass_kg` attached to it for good.
    ///
    /// # Errors
    /// A mass that is not positive, another quantity that is negative, or anything that is not finite.
    pub fn new(
        parameters: PointMassParameters,
        hand_mass_kg: f64,
        start_m: SVector<f64, N>,
    ) -> Result<Self, PointMassError> {
        let PointMassParameters { mass_kg, damping_n_s_per_m, position_resolution_m } = parameters;
        let start = start_m.iter().find(|coordinate| !coordinate.is_finite()).copied();
        for (name, value, is_good) in [
            ("mass in kg (must be above zero)", mass_kg, mass_kg > 0.0),
            ("damping in N s/m (must not be negative)", damping_n_s_per_m, damping_n_s_per_m >= 0.0),
            ("position resolution in m (must not be negative)", position_resolution_m, position_resolution_m >= 0.0),
            ("hand mass in kg (must not be negative)", hand_mass_kg, hand_mass_kg >= 0.0),
            ("start coordinate in m (must be finite)", start.unwrap_or_default(), start.is_none()),
        ] {
            if !is_good || !value.is_finite() {
                return Err(PointMassError::BadParameter { name, value });
            }
        }
        Ok(Self {
            parameters,
            moving_mass_kg: mass_kg + hand_mass_kg,
            time_s: 0.0,
            position_m: start_m,
            velocity_m_per_s: SVector::zeros(),
            acceleration_m_per_s2: SVector::zeros(),
        })
    }

    /// Present time in s.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// True position in m.
    pub fn position_m(&self) -> SVector<f64, N> {
        self.position_m
    }

    /// Position that the device reports in m: the nearest multiple of its resolution.
    pub fn reported_position_m(&self) -> SVector<f64, N> {
        let resolution = self.parameters.position_resolution_m;
        if resolution > 0.0 { self.position_m.map(|x| (x / resolution).round() * resolution) } else { self.position_m }
    }

    /// Velocity in m/s.
    pub fn velocity_m_per_s(&self) -> SVector<f64, N> {
        self.velocity_m_per_s
    }

    /// Mean acceleration over the last step in m/s^2.
    pub fn acceleration_m_per_s2(&self) -> SVector<f64, N> {
        self.acceleration_m_per_s2
    }

    /// Moves on by `step_s` under a held control force and whatever `hand` does at the step's midpoint, given time and
    /// position.
    ///
    /// # Errors
    /// A step that is not above zero; a result that is not finite. The state is then the one before.
    pub fn advance(
        &mut self,
        step_s: f64,
        control_n: SVector<f64, N>,
        hand: impl FnOnce(f64, SVector<f64, N>) -> HandLoad<N>,
    ) -> Result<(), PointMassError> {
        if !(step_s > 0.0 && step_s.is_finite()) {
            return Err(PointMassError::BadStep { time_s: self.time_s, end_s: self.time_s + step_s, step_s });
        }
        let half_s = 0.5 * step_s;
        let velocity = self.velocity_m_per_s;
        let middle_m = self.position_m + velocity * half_s;
        let load = hand(self.time_s + half_s, middle_m);
        let damping = self.parameters.damping_n_s_per_m + load.damping_n_s_per_m;
        // The spring acts at the mean position, step/4 (v' - v) away from `middle_m`.
        let inertia = self.moving_mass_kg + half_s * half_s * load.stiffness_n_per_m;
        let change = (control_n + load.force_n - velocity * damping) * (step_s / (inertia + half_s * damping));
        let next = velocity + change;
        let position_m = middle_m + next * half_s;
        if !position_m.iter().chain(next.iter()).all(|value| value.is_finite()) {
            return Err(PointMassError::NotFinite { time_s: self.time_s });
        }
        self.time_s += step_s;
        self.position_m = position_m;
        self.velocity_m_per_s = next;
        self.acceleration_m_per_s2 = change / step_s;
        Ok(())
    }

    /// Moves on to `end_s` in equal steps, none longer than `longest_step_s`; nothing happens if `end_s` is not later.
    ///
    /// # Errors
    /// As for [`PointMass::advance`]; the state is that before the failed step. Times or steps that make no sense.
    pub fn advance_to(
        &mut self,
        end_s: f64,
        longest_step_s: f64,
        control_n: SVector<f64, N>,
        mut hand: impl FnMut(f64, SVector<f64, N>) -> HandLoad<N>,
    ) -> Result<(), PointMassError> {
        let start_s = self.time_s;
        let (count, step_s) = equal_steps(start_s, end_s, longest_step_s).ok_or(PointMassError::BadStep {
            time_s: start_s,
            end_s,
            step_s: longest_step_s,
        })?;
        for index in 1..=count {
            self.advance(step_s, control_n, &mut hand)?;
            self.time_s = if index == count { end_s } else { start_s + f64::from(index) * step_s };
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{Hand, HandParameters, Leg, NoiseBand, Path};
    use nalgebra::{Vector1, Vector3};
    use yieldwall_motion::elementary;

    const DEVICE: PointMassParameters =
        PointMassParameters { mass_kg: 0.05, damping_n_s_per_m: 0.5, position_resolution_m: 5.5e-5 };

    fn no_hand<const N: usize>(_: f64, _: SVector<f64, N>) -> HandLoad<N> {
        HandLoad::default()
    }

    fn spring(stiffness: f64, damping: f64) -> impl Fn(f64, Vector1<f64>) -> HandLoad<1> {
        move |_, position| HandLoad {
            force_n: position * -stiffness,
            damping_n_s_per_m: damping,
            stiffness_n_per_m: stiffness,
        }
    }

    #[test]
    fn a_damped_swing_is_the_exact_one_to_second_order() {
        let (mass, stiffness, damping) = (0.55, 400.0, 8.0);
        let decay = 0.5 * (damping + 0.5) / mass;
        let turn = f64::sqrt(stiffness / mass - decay * decay);
        let exact = |time: f64| {
            0.02 * elementary::exp(-decay * time)
                * (elementary::cos(turn * time) + decay / turn * elementary::sin(turn * time))
        };
        let error = |step_s: f64| {
            let mut device = PointMass::new(DEVICE, 0.5, Vector1::new(0.02)).unwrap();
            (1..=300).fold(0.0, |worst: f64, ms| {
                let end_s = f64::from(ms) * 1e-3;
                device.advance_to(end_s, step_s, Vector1::zeros(), spring(stiffness, damping)).unwrap();
                worst.max((device.position_m().x - exact(end_s)).abs())
            })
        };
        let (coarse, fine) = (error(1e-3), error(0.5e-3));
        assert!(coarse < 2e-6, "{coarse}");
        assert!((3.8..4.2).contains(&(coarse / fine)), "{}", coarse / fine);
    }

    #[test]
    fn no_spring_is_too_stiff() {
        let mut device = PointMass::new(DEVICE, 0.0, Vector1::new(0.01)).unwrap();
        for _ in 0..2000 {
            device.advance(1e-3, Vector1::zeros(), spring(1e9, 0.0)).unwrap();
            assert!(device.position_m().x.abs() <= 0.01 * (1.0 + 1e-6));
        }
    }

    #[test]
    fn a_held_force_ends_at_the_speed_that_damping_allows() {
        let mut device = PointMass::new(DEVICE, 0.0, Vector3::zeros()).unwrap();
        device.advance_to(2.0, 1e-3, Vector3::new(1.0, 0.0, -0.5), no_hand).unwrap();
        assert!((device.velocity_m_per_s() - Vector3::new(2.0, 0.0, -1.0)).norm() < 1e-7);
        assert!(device.acceleration_m_per_s2().norm() < 1e-6);
        assert_eq!(device.time_s(), 2.0);
    }

    #[test]
    fn the_reported_position_has_the_devices_resolution() {
        let place = Vector1::new(7.3 * 5.5e-5);
        let device = PointMass::new(DEVICE, 0.0, place).unwrap();
        assert_eq!(device.reported_position_m().x, 7.0 * 5.5e-5);
        let exact = PointMassParameters { position_resolution_m: 0.0, ..DEVICE };
        assert_eq!(PointMass::new(exact, 0.0, place).unwrap().reported_position_m(), place);
    }

    #[test]
    fn a_hand_pulls_it_to_its_target_and_runs_repeat() {
        let run = |seed| {
            let parameters = HandParameters {
                mass_kg: 0.5,
                stiffness_n_per_m: 400.0,
                damping_n_s_per_m: 8.0,
                voluntary_force_limit_n: 40.0,
                tremor: Some(NoiseBand { rms: 0.1, low_hz: 8.0, high_hz: 12.0 }),
                aim_error: None,
            };
            let legs = [Leg::To { point_m: Vector3::new(0.05, 0.0, 0.02), in_s: 0.5 }, Leg::Wait { for_s: 1.0 }];
            let path = Path::new(Vector3::zeros(), &legs).unwrap();
            let mut hand = Hand::new(parameters, path, seed).unwrap();
            let mut device = PointMass::new(DEVICE, hand.mass_kg(), Vector3::zeros()).unwrap();
            let mut felt = Vector3::zeros();
            for ms in 1..=1500 {
                let load = |time_s, position| hand.load(time_s, position);
                device.advance_to(f64::from(ms) * 1e-3, 2.5e-4, Vector3::zeros(), load).unwrap();
                felt = hand.force_on_tool(
                    device.time_s(),
                    device.position_m(),
                    device.velocity_m_per_s(),
                    device.acceleration_m_per_s2(),
                );
            }
            (device.position_m(), felt)
        };
        let (end_m, felt_n) = run(1);
        assert!((end_m - Vector3::new(0.05, 0.0, 0.02)).norm() < 2e-3);
        // The hand moves a device of 50 g: what it gives to it is small once the target rests.
        assert!(felt_n.norm() < 0.1, "{felt_n}");
        assert_eq!(run(1), run(1));
        assert_ne!(run(1), run(2));
    }

    #[test]
    fn nonsense_is_refused_and_leaves_the_state_alone() {
        for bad in [
            PointMassParameters { mass_kg: 0.0, ..DEVICE },
            PointMassParameters { damping_n_s_per_m: -1.0, ..DEVICE },
            PointMassParameters { position_resolution_m: f64::NAN, ..DEVICE },
        ] {
            assert!(PointMass::new(bad, 0.0, Vector1::new(0.0)).is_err(), "{bad:?}");
        }
        assert!(PointMass::new(DEVICE, f64::INFINITY, Vector1::new(0.0)).is_err());
        assert!(PointMass::new(DEVICE, 0.0, Vector1::new(f64::NAN)).is_err());
        let mut device = PointMass::new(DEVICE, 0.0, Vector1::new(0.01)).unwrap();
        let error = device.advance(1e-3, Vector1::new(f64::NAN), no_hand).unwrap_err();
        assert_eq!(error, PointMassError::NotFinite { time_s: 0.0 });
        let from_time = device.advance_to(1.0, 0.0, Vector1::zeros(), no_hand).unwrap_err();
        assert_eq!(from_time, PointMassError::BadStep { time_s: 0.0, end_s: 1.0, step_s: 0.0 });
        assert!(matches!(device.advance(-1e-3, Vector1::zeros(), no_hand), Err(PointMassError::BadStep { .. })));
        assert_eq!((device.position_m().x, device.velocity_m_per_s().x, device.time_s()), (0.01, 0.0, 0.0));
    }
}
