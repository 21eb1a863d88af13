//! Gains that keep the same margins at every period and delay.

use crate::elementary;
use nalgebra::Matrix2;

use super::machine::Machine;
use crate::control::{Gains, Margins, ServoLoop, principal_inertias, worst_margins};
use crate::linkage::LinkageError;
use crate::quantity::{JointRates, TipPoint};

/// Margins that the gains keep at every pose: those of the shipped rig.
pub(super) const GAIN_DB: f64 = 6.0;
pub(super) const PHASE_DEG: f64 = 30.0;
/// Gains of the shipped rig for 1 kHz and one cycle of delay, in joint space (per rad) and in Cartesian space (per m).
const JOINT: Gains = Gains { stiffness: 10_000.0, damping: 95.0, integral: 150_000.0 };
const CARTESIAN: Gains = Gains { stiffness: 90_000.0, damping: 850.0, integral: 1_300_000.0 };
/// Halvings of the search for the bandwidth.
const HALVINGS: u32 = 40;
/// Poses on the circle over which margins are taken.
const POSES: u32 = 12;

/// A controller's gains with what they leave.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tuned {
    pub gains: Gains,
    /// Bandwidth as a multiple of the shipped rig's.
    pub bandwidth: f64,
    pub margins: Margins,
}

/// The shipped gains at another bandwidth: stiffness by its square, damping by itself, integral by its cube, so that the shape of the loop stays.
fn at_bandwidth(is_cartesian: bool, factor: f64) -> Gains {
    let Gains { stiffness, damping, integral } = if is_cartesian { CARTESIAN } else { JOINT };
    Gains {
        stiffness: stiffness * elementary::powi(factor, 2),
        damping: damping * factor,
        integral: integral * elementary::powi(factor, 3),
    }
}

/// The greatest bandwidth that keeps the margins; `None` if no bandwidth does.
pub(super) fn tune(machine: &Machine, is_cartesian: bool, period_s: f64, delay_cycles: f64) -> Option<Tuned> {
    let inertias = inertias(machine, is_cartesian).ok()?;
    let at = |factor: f64| {
        let gains = at_bandwidth(is_cartesian, factor);
        let margins = worst_margins(&ServoLoop { gains, period_s, delay_cycles }, &inertias, 0.0).ok()?;
        Some(Tuned { gains, bandwidth: factor, margins })
    };
    let keeps = |tuned: &Tuned| {
        tuned.margins.stable && tuned.margins.gain_db >= GAIN_DB && tuned.margins.phase_deg >= PHASE_DEG
    };
    let (mut low, mut high) = (0.01, 100.0);
    let mut best = at(low).filter(keeps)?;
    for _ in 0..HALVINGS {
        let middle = f64::sqrt(low * high);
        match at(middle).filter(keeps) {
            Some(tuned) => (low, best) = (middle, tuned),
            None => high = middle,
        }
    }
    Some(best)
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
