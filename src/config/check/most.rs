//! The most that an arm can do at its torque limit.

use std::f64::consts::TAU;

use crate::tree::Rig;
use nalgebra::Vector2;
use yieldwall_motion::elementary;
use yieldwall_motion::linkage::FiveBar;
use yieldwall_motion::quantity::{Force, JointAngles, JointRates, TipPoint};

/// Number of examined places on each of [`RINGS`]; the middle of the disc is examined too.
const PLACES: u32 = 24;
/// Shares of the radius of the disc.
const RINGS: [f64; 2] = [0.5, 1.0];

/// The most that an arm can do within its working disc when each joint has the torque limit, without friction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Most {
    /// Largest turn of a joint within the disc, rad.
    pub(super) turn_rad: f64,
    /// Acceleration of the tool, m/s^2.
    pub(super) acceleration_m_per_s2: f64,
    /// Rate of a joint if the limit drives it all through the disc, rad/s.
    pub(super) joint_speed_rad_per_s: f64,
    /// Speed of the tool if the limit drives it all across the disc, m/s.
    pub(super) tool_speed_m_per_s: f64,
    /// Force at the tool, N.
    pub(super) force_n: f64,
    /// Force that the tool has in every direction at every place, N.
    pub(super) sure_force_n: f64,
    /// Work of the force all across the disc, J.
    pub(super) energy_j: f64,
    /// Torque of a joint per force at the tool, m.
    pub(super) lever_m: f64,
}

impl Most {
    /// Returns the values of a rig. `None` if its arm, or the arm's inertia, is unknown or does not reach the disc.
    pub(super) fn of(rig: &Rig) -> Option<Self> {
        let five_bar = FiveBar::new(rig.linkage.geometry()).ok()?;
        let inertia = rig.control.feed_forward.inertia.map(|inertia| inertia.mass_model());
        let model = inertia.or_else(|| Some(rig.simulated().ok()?.arm.mass_model()))?;
        model.check().ok()?;
        let (torque, radius_m) = (*rig.guard.torque_limit_n_m, *rig.linkage.working_radius_m);
        let mut most = Self { sure_force_n: f64::INFINITY, ..Self::default() };
        let mut joint_rad_per_s2 = 0.0_f64;
        let mut ranges = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for tip in places(radius_m) {
            let angles = five_bar.inverse(tip).ok()?;
            let dynamics = five_bar.dynamics(&model, angles, JointRates::default()).ok()?;
            let (inverse, jacobian) = (dynamics.mass.try_inverse()?, dynamics.jacobian);
            for (range, angle) in ranges.iter_mut().zip(near(angles, five_bar.inverse(TipPoint::default()).ok()?)) {
                *range = [range[0].min(angle), range[1].max(angle)];
            }
            // The torques that do most are at the corners of what the limit allows; two of the four are the others' opposites.
            for torques in [Vector2::new(torque, torque), Vector2::new(torque, -torque)] {
                let joints = inverse * torques;
                joint_rad_per_s2 = joint_rad_per_s2.max(joints.amax());
                most.acceleration_m_per_s2 = most.acceleration_m_per_s2.max((jacobian * joints).norm());
                let force = jacobian.transpose().try_inverse()? * torques;
                most.force_n = most.force_n.max(force.norm());
            }
            for direction in 0..PLACES {
                let (sine, cosine) = elementary::sin_cos(TAU * f64::from(direction) / f64::from(PLACES));
                let levers = five_bar.forward(angles).ok()?.joint_torques(Force::new(cosine, sine)).ok()?;
                most.lever_m = most.lever_m.max(levers.0.amax());
                most.sure_force_n = most.sure_force_n.min(torque / levers.0.amax());
            }
        }
        most.turn_rad = ranges.iter().map(|[least, greatest]| greatest - least).fold(0.0, f64::max);
        most.joint_speed_rad_per_s = (2.0 * joint_rad_per_s2 * most.turn_rad).sqrt();
        most.tool_speed_m_per_s = (2.0 * most.acceleration_m_per_s2 * 2.0 * radius_m).sqrt();
        most.energy_j = most.force_n * 2.0 * radius_m;
        Some(most)
    }
}

fn places(radius_m: f64) -> impl Iterator<Item = TipPoint> {
    let rings = RINGS.into_iter().flat_map(move |share| {
        (0..PLACES).map(move |place| {
            let (sine, cosine) = elementary::sin_cos(TAU * f64::from(place) / f64::from(PLACES));
            TipPoint::new(share * radius_m * cosine, share * radius_m * sine)
        })
    });
    std::iter::once(TipPoint::default()).chain(rings)
}

/// Returns angles without a jump by a turn from others.
fn near(angles: JointAngles, others: JointAngles) -> [f64; 2] {
    let [left, right] = angles.to_array();
    let [other_left, other_right] = others.to_array();
    [(left, other_left), (right, other_right)].map(|(angle, other)| angle - TAU * ((angle - other) / TAU).round())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{builtin, load_rig};

    /// Of the shipped arm at the middle of its disc, by hand: both proximal links stand so that the tool is straight ahead.
    #[test]
    fn the_shipped_arm_does_what_its_torque_and_mass_let_it() {
        let rig = load_rig(builtin("paper-admittance.yaml")).unwrap().value;
        let most = Most::of(&rig).unwrap();
        let lighter = {
            let mut rig = rig.clone();
            rig.control.feed_forward.inertia.as_mut().unwrap().tool_kg = crate::NotNegative::new(0.0).unwrap();
            Most::of(&rig).unwrap()
        };
        // No lever is longer than both links, and none of the forces smaller than the torque at that lever.
        assert!(most.lever_m < 0.7 && most.sure_force_n > 60.0 / 0.7, "{most:?}");
        assert!(most.force_n >= most.sure_force_n && lighter.acceleration_m_per_s2 > most.acceleration_m_per_s2);
        // One motor alone, without a tool: torque over inertia.
        assert!(lighter.joint_speed_rad_per_s <= (2.0 * 60.0 / 0.25 * most.turn_rad).sqrt() * (1.0 + 1e-12));
        let wider = (most.tool_speed_m_per_s / (2.0 * most.acceleration_m_per_s2 * 0.32).sqrt() - 1.0).abs();
        assert!(wider < 1e-12 && (most.energy_j / (0.32 * most.force_n) - 1.0).abs() < 1e-12, "{most:?}");
    }
}
