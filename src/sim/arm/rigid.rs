//! The step of an arm with rigid joints.

use nalgebra::{Matrix2, Vector2};

use super::{Arm, ArmError, Middle, slip_rates};
use crate::hand::HandLoad;
use yieldwall_motion::quantity::TipPoint;

impl Arm {
    /// `(M + h C / 2) v' + h tau_c Sgn(v')` contains `(M - h C / 2) v + h (u - bias + J^T F)`, with everything taken at
    /// the midpoint.
    #[inline(always)]
    pub(super) fn advance_rigid(
        &mut self,
        step_s: f64,
        torque_n_m: Vector2<f64>,
        load: impl FnOnce(f64, TipPoint) -> HandLoad<2>,
    ) -> Result<(), ArmError> {
        let middle = Middle::of(self, step_s, load)?;
        let damping = (middle.damping + Matrix2::from_diagonal(&self.viscous_n_m_s_per_rad)) * (0.5 * step_s);
        let mass = middle.dynamics.mass;
        let impulse = (mass - damping) * self.rates + (torque_n_m + middle.torque) * step_s;
        let rates = slip_rates(&(mass + damping), impulse, self.coulomb_n_m * step_s);
        if !(rates.x.is_finite() && rates.y.is_finite()) {
            return Err(ArmError::NotFinite { time_s: self.time_s });
        }
        self.finish(step_s, &middle, rates);
        Ok(())
    }
}
