//! A back-drivable device taken as a point mass in `N` dimensions, moved by a control force and by a hand.

use nalgebra::SVector;
use thiserror::Error;

use super::hand::HandLoad;

/// What is wrong with a point mass or with its motion.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PointMassError {
    /// A quantity of the device is out of its range.
    #[error("the point mass has a {name} of {value}")]
    BadParameter {
        /// Which quantity, with its unit and range.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// A force or a hand is not finite, or it threw the mass to infinity. The state is that before the step.
    #[error("the point mass has no finite motion after {time_s} s")]
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
    /// A result that is not finite; the state is then the one before.
    pub fn advance(
        &mut self,
        step_s: f64,
        control_n: SVector<f64, N>,
        hand: impl FnOnce(f64, SVector<f64, N>) -> HandLoad<N>,
    ) -> Result<(), PointMassError> {
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
        if step_s > 0.0 {
            self.acceleration_m_per_s2 = change / step_s;
        }
        Ok(())
    }

    /// Moves on to `end_s` in equal steps, none longer than `longest_step_s`; nothing happens if `end_s` is not later.
    ///
    /// # Errors
    /// As for [`PointMass::advance`]; the state is that before the failed step. A `longest_step_s` that is not above
    /// zero, or a time that is not finite.
    pub fn advance_to(
        &mut self,
        end_s: f64,
        longest_step_s: f64,
        control_n: SVector<f64, N>,
        mut hand: impl FnMut(f64, SVector<f64, N>) -> HandLoad<N>,
    ) -> Result<(), PointMassError> {
        let (count, step_s) =
            super::substeps::equal_steps(self.time_s, end_s, longest_step_s).ok_or(PointMassError::BadParameter {
                name: "longest step in s (must be above zero)",
                value: longest_step_s,
            })?;
        let start_s = self.time_s;
        for index in 1..=count {
            self.advance(step_s, control_n, &mut hand)?;
            self.time_s = if index == count { end_s } else { start_s + f64::from(index) * step_s };
        }
        Ok(())
    }
}
