//! The step of an arm with a spring and a damper between each motor and its link.

use nalgebra::{Matrix2, Vector2};

use super::{Arm, ArmError, JointElasticity, Middle, check_not_negative, slip_rates};
use crate::hand::HandLoad;
use yieldwall_motion::linkage::MassModel;
use yieldwall_motion::quantity::{JointAngles, TipPoint};

/// The motors' side of elastic joints: parameters and state.
#[derive(Clone, Debug)]
pub(super) struct Gear {
    stiffness_n_m_per_rad: f64,
    damping_n_m_s_per_rad: f64,
    motor_kg_m2: Vector2<f64>,
    pub(super) angles: Vector2<f64>,
    pub(super) rates: Vector2<f64>,
}

impl Gear {
    /// A relaxed gear, and its motors' inertia taken out of `link_mass`.
    pub(super) fn split(
        elasticity: &JointElasticity,
        link_mass: &mut MassModel,
        start: JointAngles,
    ) -> Result<Self, ArmError> {
        let JointElasticity { stiffness_n_m_per_rad, damping_n_m_s_per_rad, motor_share } = *elasticity;
        check_not_negative("joint stiffness in N m/rad (must not be negative)", stiffness_n_m_per_rad)?;
        check_not_negative("joint damping in N m s/rad (must not be negative)", damping_n_m_s_per_rad)?;
        if !(motor_share > 0.0 && motor_share < 1.0) {
            let name = "motor share of the inertia (must lie between 0 and 1)";
            return Err(ArmError::BadParameter { name, value: motor_share });
        }
        let motor_kg_m2 = Vector2::from(link_mass.motor_kg_m2) * motor_share;
        link_mass.motor_kg_m2 = link_mass.motor_kg_m2.map(|inertia| inertia * (1.0 - motor_share));
        Ok(Self { stiffness_n_m_per_rad, damping_n_m_s_per_rad, motor_kg_m2, angles: start.0, rates: Vector2::zeros() })
    }

    /// Follows the links without strain.
    pub(super) fn relax(&mut self, angles: Vector2<f64>, rates: Vector2<f64>) {
        self.angles = angles;
        self.rates = rates;
    }

    /// Kinetic energy of the motors and energy of the springs in J.
    pub(super) fn energy_j(&self, link_angles: Vector2<f64>) -> f64 {
        let strain = self.angles - link_angles;
        0.5 * self.motor_kg_m2.dot(&self.rates.component_mul(&self.rates))
            + 0.5 * self.stiffness_n_m_per_rad * strain.norm_squared()
    }
}

impl Arm {
    /// Springs and dampers of the joints act with the mean of the step's two ends, hence stable for any stiffness. The
    /// links' rates are eliminated, which leaves the friction problem of the two motors.
    pub(super) fn advance_flexible(
        &mut self,
        step_s: f64,
        torque_n_m: Vector2<f64>,
        load: impl FnOnce(f64, TipPoint) -> HandLoad<2>,
    ) -> Result<(), ArmError> {
        let not_finite = ArmError::NotFinite { time_s: self.time_s };
        let middle = Middle::of(self, step_s, load)?;
        let Some(gear) = &mut self.gear else { return Ok(()) };
        let half_s = 0.5 * step_s;

        // Spring torque is `twist + grip (change of motor rate - change of link rate)`.
        let motor_middle = gear.angles + gear.rates * half_s;
        let twist = (motor_middle - middle.angles) * gear.stiffness_n_m_per_rad
            + (gear.rates - self.rates) * gear.damping_n_m_s_per_rad;
        let grip = 0.5 * (gear.damping_n_m_s_per_rad + gear.stiffness_n_m_per_rad * half_s) * step_s;

        let link_torque = twist + middle.torque - middle.damping * self.rates;
        let link = middle.dynamics.mass + middle.damping * half_s + Matrix2::from_diagonal_element(grip);
        let link_inverse = link.try_inverse().ok_or(not_finite)?;

        let viscous = self.viscous_n_m_s_per_rad;
        let motor_torque = torque_n_m - twist - viscous.component_mul(&gear.rates);
        let motor = Matrix2::from_diagonal(&(gear.motor_kg_m2 + viscous * half_s).add_scalar(grip));

        let reduced = motor - link_inverse * (grip * grip);
        let impulse = reduced * gear.rates + (motor_torque + link_inverse * link_torque * grip) * step_s;
        let motor_rates = slip_rates(&reduced, impulse, self.coulomb_n_m * step_s);
        let motor_change = motor_rates - gear.rates;
        let rates = self.rates + link_inverse * (link_torque * step_s + motor_change * grip);
        if ![motor_rates, rates].iter().flatten().all(|rate| rate.is_finite()) {
            return Err(not_finite);
        }
        gear.angles = motor_middle + motor_rates * half_s;
        gear.rates = motor_rates;
        self.finish(step_s, &middle, rates);
        Ok(())
    }
}
