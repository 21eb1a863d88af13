//! Methods that the simulation does not use, with its own equations of motion: for contrast.

use nalgebra::{Matrix2, Vector2};
use yieldwall_motion::elementary;

use super::machine::inverse;
use super::scene::Plant;
use yieldwall_motion::linkage::{Dynamics, FiveBar, MassModel};
use yieldwall_motion::quantity::{JointAngles, JointRates};
use yieldwall_sim::arm::{ArmError, ArmParameters, slip_rates};
use yieldwall_sim::hand::HandLoad;

/// Common part of both contrasts: an arm, the load at its tool, and the state.
#[derive(Clone, Debug)]
struct Body<F> {
    linkage: FiveBar,
    mass: MassModel,
    coulomb_n_m: Vector2<f64>,
    viscous_n_m_s_per_rad: Vector2<f64>,
    load: F,
    time_s: f64,
    angles: Vector2<f64>,
    rates: Vector2<f64>,
}

impl<F: Fn(f64, Vector2<f64>) -> HandLoad<2>> Body<F> {
    fn new(parameters: &ArmParameters, start: Vector2<f64>, load: F) -> Self {
        Self {
            linkage: parameters.linkage,
            mass: parameters.mass,
            coulomb_n_m: Vector2::from(parameters.coulomb_n_m),
            viscous_n_m_s_per_rad: Vector2::from(parameters.viscous_n_m_s_per_rad),
            load,
            time_s: 0.0,
            angles: start,
            rates: Vector2::zeros(),
        }
    }

    #[inline]
    fn dynamics(&self, angles: Vector2<f64>, rates: Vector2<f64>) -> Result<Dynamics, ArmError> {
        self.linkage
            .dynamics(&self.mass, JointAngles(angles), JointRates(rates))
            .map_err(|source| ArmError::Linkage { time_s: self.time_s, source })
    }

    /// Takes equal steps to `end_s`, none longer than `step_s`.
    fn run_to(
        &mut self,
        end_s: f64,
        step_s: f64,
        mut step: impl FnMut(&mut Self, f64) -> Result<(), ArmError>,
    ) -> Result<(), ArmError> {
        let start_s = self.time_s;
        let count = ((end_s - start_s) / step_s - 1e-6).ceil().max(1.0);
        let step_s = (end_s - start_s) / count;
        for index in 1..=count as u32 {
            step(self, step_s)?;
            if !(self.angles + self.rates).iter().all(|value| value.is_finite()) {
                return Err(ArmError::NotFinite { time_s: self.time_s });
            }
            self.time_s = start_s + f64::from(index) * step_s;
        }
        self.time_s = end_s;
        Ok(())
    }
}

/// Euler's semi-implicit step: forces at its beginning, `q' = q + h v'`, damping and dry friction implicit and exact. It is of
/// first order.
#[derive(Clone, Debug)]
pub(super) struct SemiImplicit<F>(Body<F>);

impl<F: Fn(f64, Vector2<f64>) -> HandLoad<2>> SemiImplicit<F> {
    /// At rest at these joint angles in rad at time zero.
    pub(super) fn new(parameters: &ArmParameters, start: Vector2<f64>, load: F) -> Self {
        Self(Body::new(parameters, start, load))
    }
}

impl<F: Fn(f64, Vector2<f64>) -> HandLoad<2>> Plant for SemiImplicit<F> {
    fn run_to(&mut self, end_s: f64, step_s: f64, torque_n_m: Vector2<f64>) -> Result<(), ArmError> {
        self.0.run_to(end_s, step_s, |body, step_s| {
            let dynamics = body.dynamics(body.angles, body.rates)?;
            let load = (body.load)(body.time_s, dynamics.tip.0);
            let jacobian = &dynamics.jacobian;
            let damping = jacobian.tr_mul(jacobian) * load.damping_n_s_per_m
                + Matrix2::from_diagonal(&body.viscous_n_m_s_per_rad);
            let torque = torque_n_m + jacobian.tr_mul(&load.force_n) - dynamics.bias.0;
            let impulse = dynamics.mass * body.rates + torque * step_s;
            body.rates = slip_rates(&(dynamics.mass + damping * step_s), impulse, body.coulomb_n_m * step_s);
            body.angles += body.rates * step_s;
            Ok(())
        })
    }

    fn angles(&self) -> Vector2<f64> {
        self.0.angles
    }

    fn rates(&self) -> Vector2<f64> {
        self.0.rates
    }
}

/// The classic fourth-order Runge-Kutta step with dry friction `tau_c tanh(rate / scale)`, which never truly holds.
#[derive(Clone, Debug)]
pub(super) struct Smooth<F> {
    body: Body<F>,
    scale_rad_per_s: f64,
}

impl<F: Fn(f64, Vector2<f64>) -> HandLoad<2>> Smooth<F> {
    /// At rest at these joint angles in rad at time zero.
    pub(super) fn new(parameters: &ArmParameters, scale_rad_per_s: f64, start: Vector2<f64>, load: F) -> Self {
        Self { body: Body::new(parameters, start, load), scale_rad_per_s }
    }
}

impl<F: Fn(f64, Vector2<f64>) -> HandLoad<2>> Plant for Smooth<F> {
    fn run_to(&mut self, end_s: f64, step_s: f64, torque_n_m: Vector2<f64>) -> Result<(), ArmError> {
        let scale = self.scale_rad_per_s;
        self.body.run_to(end_s, step_s, |body, step_s| {
            let acceleration = |after_s: f64, angles: Vector2<f64>, rates: Vector2<f64>| {
                let dynamics = body.dynamics(angles, rates)?;
                let load = (body.load)(body.time_s + after_s, dynamics.tip.0);
                let force = load.force_n - dynamics.jacobian * rates * load.damping_n_s_per_m;
                let friction = body.coulomb_n_m.component_mul(&(rates / scale).map(elementary::tanh))
                    + body.viscous_n_m_s_per_rad.component_mul(&rates);
                let torque = torque_n_m + dynamics.jacobian.tr_mul(&force) - dynamics.bias.0 - friction;
                Ok(inverse(&dynamics.mass) * torque)
            };
            let half_s = 0.5 * step_s;
            let (q, v) = (body.angles, body.rates);
            let a1 = acceleration(0.0, q, v)?;
            let v2 = v + a1 * half_s;
            let a2 = acceleration(half_s, q + v * half_s, v2)?;
            let v3 = v + a2 * half_s;
            let a3 = acceleration(half_s, q + v2 * half_s, v3)?;
            let v4 = v + a3 * step_s;
            let a4 = acceleration(step_s, q + v3 * step_s, v4)?;
            body.angles = q + (v + (v2 + v3) * 2.0 + v4) * (step_s / 6.0);
            body.rates = v + (a1 + (a2 + a3) * 2.0 + a4) * (step_s / 6.0);
            Ok(())
        })
    }

    fn angles(&self) -> Vector2<f64> {
        self.body.angles
    }

    fn rates(&self) -> Vector2<f64> {
        self.body.rates
    }
}
