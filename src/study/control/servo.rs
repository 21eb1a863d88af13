//! Gains that keep the same margins at every period and delay.

use nalgebra::Matrix2;
use yieldwall_motion::elementary;

use super::machine::Machine;
use yieldwall_motion::control::{Gains, Tuned, principal_inertias, stiffest};
use yieldwall_motion::linkage::LinkageError;
use yieldwall_motion::quantity::{JointRates, TipPoint};

/// Margins that the gains keep at every pose: those of the shipped rig.
pub(super) const GAIN_DB: f64 = 6.0;
pub(super) const PHASE_DEG: f64 = 30.0;
/// Gains of the shipped rig for 1 kHz and one cycle of delay, in joint space (per rad) and in Cartesian space (per m).
const JOINT: Gains = Gains { stiffness: 10_000.0, damping: 95.0, integral: 150_000.0 };
const CARTESIAN: Gains = Gains { stiffness: 90_000.0, damping: 850.0, integral: 1_300_000.0 };
/// Poses on the circle over which margins are taken.
const POSES: u32 = 12;

/// The greatest bandwidth of the shipped rig's gains that keeps the margins; `None` if no bandwidth does.
pub(super) fn tune(machine: &Machine, is_cartesian: bool, period_s: f64, delay_cycles: f64) -> Option<Tuned> {
    let shape = if is_cartesian { CARTESIAN } else { JOINT };
    stiffest(shape, period_s, delay_cycles, &inertias(machine, is_cartesian).ok()?, |margins| {
        margins.gain_db >= GAIN_DB && margins.phase_deg >= PHASE_DEG
    })
}

/// Least and greatest inertia over poses on the circle.
fn inertias(machine: &Machine, is_cartesian: bool) -> Result<Vec<f64>, LinkageError> {
    let mut all = Vec::new();
    for pose in 0..POSES {
        let angle = std::f64::consts::TAU * f64::from(pose) / f64::from(POSES);
        let angles = machine.arm.linkage.inverse(TipPoint::new(
            super::RADIUS_M * elementary::cos(angle),
            super::RADIUS_M * elementary::sin(angle),
        ))?;
        let dynamics = machine.arm.linkage.dynamics(&machine.arm.mass, angles, JointRates::default())?;
        let mass = match (is_cartesian, dynamics.jacobian.try_inverse()) {
            (true, Some(inverse)) => inverse.transpose() * dynamics.mass * inverse,
            _ => dynamics.mass,
        };
        let mass: Matrix2<f64> = 0.5 * (mass + mass.transpose());
        all.extend(principal_inertias(&mass).into_iter().flatten());
    }
    all.sort_by(f64::total_cmp);
    // Margins are worst at one end or the other.
    Ok(vec![all[0], all[all.len() - 1]])
}
