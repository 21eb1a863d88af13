//! Comparison of a rig's machine data with the machine model of its simulation.

use super::Findings;
use super::words::round;
use crate::tree::{CommandMode, Rig};
use yieldwall_motion::linkage::{FiveBar, MassModel};
use yieldwall_motion::quantity::{JointRates, TipPoint};

/// Largest factor between the inertia of the feed-forward and the inertia of the machine.
const MOST_APART: f64 = 2.0;

/// Checks that the simulated machine can move, and that the feed-forward is for this machine.
pub(super) fn check_machine(findings: &mut Findings, rig: &Rig) {
    let Ok(simulation) = rig.simulated() else { return };
    let arm = &simulation.arm;
    let limit = *rig.guard.torque_limit_n_m;
    let friction = arm.coulomb_n_m.iter().map(|torque| **torque).fold(0.0, f64::max);
    if friction >= limit {
        let key = "simulation.arm.coulomb_n_m";
        let message = format!(
            "`{key}` is {friction} N m, not below `guard.torque_limit_n_m` of {limit} N m: the joint cannot be moved"
        );
        findings
            .warning(key, message, "write the dry friction at the link in N m, or raise the torque limit")
            .see("guard.torque_limit_n_m", "torque limit");
    }
    // The other modes leave the joints to the drives.
    if rig.rig.command_mode != CommandMode::Torque {
        return;
    }
    let fed = rig.control.feed_forward.coulomb_n_m.iter().zip(&arm.coulomb_n_m);
    if let Some((fed, real)) = fed.map(|(fed, real)| (**fed, **real)).find(|(fed, real)| fed > real) {
        let key = "control.feed_forward.coulomb_n_m";
        let message =
            format!("`{key}` is {fed} N m, above the dry friction of {real} N m: it would push a joint that rests");
        findings
            .warning(key, message, "write somewhat less than the friction of the joint")
            .see("simulation.arm.coulomb_n_m", "friction");
    }
    let Some(inertia) = rig.control.feed_forward.inertia else { return };
    let Some(apart) = apart(rig, &inertia.mass_model(), &arm.mass_model()) else { return };
    if !(1.0 / MOST_APART..=MOST_APART).contains(&apart) {
        let key = "control.feed_forward.inertia";
        let message = format!("`{key}` makes the arm {} times as heavy as the simulated machine is", round(apart));
        let help = "write kg and kg m^2 at the link, gear included; or fix the arm of the simulation";
        findings.warning(key, message, help).see("simulation.arm", "machine");
    }
}

/// Returns how many times heavier one arm is than the other, in the middle of the working disc and in the direction of the
/// largest difference.
fn apart(rig: &Rig, one: &MassModel, other: &MassModel) -> Option<f64> {
    let five_bar = FiveBar::new(rig.linkage.geometry()).ok()?;
    let angles = five_bar.inverse(TipPoint::default()).ok()?;
    let mass = |model| Some(five_bar.dynamics(model, angles, JointRates::default()).ok()?.mass);
    let (one, other) = (mass(one)?, mass(other)?);
    // Principal values of one against the other.
    let lower = other.cholesky()?.l().try_inverse()?;
    let values = (lower * one * lower.transpose()).symmetric_eigenvalues();
    let factor = |value: f64| value.max(1.0 / value);
    values.iter().copied().max_by(|one, other| factor(*one).total_cmp(&factor(*other)))
}
