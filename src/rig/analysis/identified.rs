//! The loop of a rig by what was identified of its joints.

use super::margins::{PoseMargins, margins_of};
use crate::RigError;
use yieldwall_config as config;
use yieldwall_motion::control::MAX_DELAY_CYCLES;
use yieldwall_motion::linkage::MassModel;
use yieldwall_motion::quantity::{JointAngles, JointRates};
use yieldwall_run::JointFound;
use yieldwall_run::assembly::{linkage, period_s, plant_mass};

/// Least inertia that a motor is taken to have, kg m^2, where the model's links alone already have more than was identified.
const LEAST_MOTOR_KG_M2: f64 = 1e-3;

/// Returns models of the arm with the identified inertia at the poses at which it was identified.
///
/// Two numbers do not show which part of the arm is heavier than in the rig file's model, so there are two models. In the first the
/// difference turns with the motors, the same at each pose. In the second, as much of it as possible is a mass at the tool.
///
/// # Errors
/// If the linkage cannot be at a pose.
pub fn identified_models(rig: &config::Rig, found: &[JointFound; 2]) -> Result<Vec<MassModel>, RigError> {
    let nothing =
        MassModel { motor_kg_m2: [LEAST_MOTOR_KG_M2; 2], proximal_kg: [0.0; 2], distal_kg: [0.0; 2], tool_kg: 0.0 };
    let from_file = rig.control.feed_forward.inertia.as_ref().map(config::ArmInertia::mass_model);
    let model = from_file.or_else(|| plant_mass(rig).ok()).unwrap_or(nothing);
    let linkage = linkage(rig)?;
    let with_motors = |model: MassModel| -> Result<MassModel, RigError> {
        let mut changed = model;
        for (joint, (motor, found)) in changed.motor_kg_m2.iter_mut().zip(found).enumerate() {
            let mass = linkage.dynamics(&model, JointAngles::from(found.pose_rad), JointRates::default())?.mass;
            *motor = (*motor + found.inertia_kg_m2 - mass[(joint, joint)]).max(LEAST_MOTOR_KG_M2);
        }
        Ok(changed)
    };
    let (mut together, mut spread) = (0.0, 0.0);
    for (joint, found) in found.iter().enumerate() {
        let dynamics = linkage.dynamics(&model, JointAngles::from(found.pose_rad), JointRates::default())?;
        let of_tool = dynamics.jacobian.column(joint).norm_squared();
        together += of_tool * (found.inertia_kg_m2 - dynamics.mass[(joint, joint)]);
        spread += of_tool * of_tool;
    }
    let tool_kg = (model.tool_kg + together / spread).max(0.0);
    let mut models = vec![with_motors(model)?];
    if tool_kg.is_finite() {
        models.push(with_motors(MassModel { tool_kg, ..model })?);
    }
    Ok(models)
}

/// Returns the longer delay of both joints, in cycles.
pub(super) fn identified_delay_cycles(rig: &config::Rig, found: &[JointFound; 2]) -> Result<f64, RigError> {
    let delay_cycles = found.iter().map(|joint| joint.delay_s).fold(0.0, f64::max) / period_s(rig);
    if delay_cycles > MAX_DELAY_CYCLES {
        return Err(RigError::Delay { found_cycles: delay_cycles, most_cycles: MAX_DELAY_CYCLES });
    }
    Ok(delay_cycles)
}

/// Returns margins as [`pose_margins`](super::pose_margins), by the identified values: the worst over both models of
/// [`identified_models`], with the longer delay of both joints.
///
/// # Errors
/// As [`pose_margins`](super::pose_margins), and for a delay beyond [`MAX_DELAY_CYCLES`].
pub fn identified_margins(rig: &config::Rig, found: &[JointFound; 2]) -> Result<Option<PoseMargins>, RigError> {
    let delay_cycles = identified_delay_cycles(rig, found)?;
    let viscous = found.each_ref().map(|joint| joint.viscous_n_m_s_per_rad.max(0.0));
    margins_of(rig, &identified_models(rig, found)?, viscous, delay_cycles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::{PROPOSED_MARGINS, has_margins, pose_margins};
    use yieldwall_run::assembly::delay_cycles;

    fn shipped() -> config::Rig {
        config::load_rig(config::builtin("paper-admittance.yaml")).unwrap().value
    }

    /// What would be identified of an arm of these masses.
    fn found(rig: &config::Rig, mass: &MassModel) -> [JointFound; 2] {
        let linkage = linkage(rig).unwrap();
        let pose = linkage.inverse(yieldwall_motion::quantity::TipPoint::new(0.07, 0.04)).unwrap();
        let dynamics = linkage.dynamics(mass, pose, JointRates::default()).unwrap();
        let delay_s = delay_cycles(rig).unwrap() * period_s(rig);
        [0, 1].map(|joint| JointFound {
            inertia_kg_m2: dynamics.mass[(joint, joint)],
            pose_rad: pose.to_array(),
            delay_s,
            viscous_n_m_s_per_rad: 0.5,
        })
    }

    #[test]
    fn an_arm_as_the_file_has_it_has_the_margins_of_the_file() {
        let rig = shipped();
        let mass = rig.control.feed_forward.inertia.as_ref().unwrap().mass_model();
        let (by_file, identified) =
            (pose_margins(&rig).unwrap().unwrap(), identified_margins(&rig, &found(&rig, &mass)).unwrap().unwrap());
        let near = |one: f64, other: f64| (one / other - 1.0).abs() < 1e-9;
        assert!(near(by_file.worst.without_friction.phase_deg, identified.worst.without_friction.phase_deg));
        assert!(near(by_file.inertia[0], identified.inertia[0]) && near(by_file.inertia[1], identified.inertia[1]));
    }

    #[test]
    fn an_older_force_asks_for_more_mass() {
        use crate::analysis::{hand_of, held_masses, held_masses_identified};
        use yieldwall_run::ForceFound;
        let loaded = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap();
        let rig = &loaded.value;
        let mass = rig.control.feed_forward.inertia.as_ref().unwrap().mass_model();
        let scene = loaded.scene().unwrap().value;
        let (found, hand) = (found(rig, &mass), hand_of(&scene));
        let least_kg = |force: Option<&ForceFound>| {
            let holdings = held_masses_identified((rig, &scene), (&found, force), &[hand], 2.0).unwrap().unwrap();
            holdings[0].masses.unwrap().least_kg
        };
        let by_file = held_masses(rig, &scene, &[hand], 2.0).unwrap().unwrap()[0].masses.unwrap().least_kg;
        let old = ForceFound { between_s: [9.8e-3, 10.2e-3], mass_kg: 0.3 };
        let (known, older) = (least_kg(None), least_kg(Some(&old)));
        assert!((known / by_file - 1.0).abs() < 0.01 && older > 1.5 * known, "{by_file} {known} {older}");
    }

    #[test]
    fn gains_by_what_was_identified_have_their_margins_on_the_real_arm_whatever_of_it_is_heavier() {
        let rig = shipped();
        let mass = rig.control.feed_forward.inertia.as_ref().unwrap().mass_model();
        let heavier_tool = MassModel { tool_kg: 2.5, ..mass };
        let heavier_motors = MassModel { motor_kg_m2: [0.6, 0.1], ..mass };
        for real in [heavier_tool, heavier_motors] {
            let found = found(&rig, &real);
            let margins = identified_margins(&rig, &found).unwrap().unwrap();
            let tuned = crate::analysis::proposed_gains(&rig, &margins).unwrap();
            let mut with_gains = rig.clone();
            if let config::ControlGains::Joint {
                stiffness_n_m_per_rad: k,
                damping_n_m_s_per_rad: b,
                integral_n_m_per_rad_s: l,
            } = &mut with_gains.control.gains
            {
                *k = config::Positive::new(tuned.gains.stiffness).unwrap();
                *b = config::NotNegative::new(tuned.gains.damping).unwrap();
                *l = config::NotNegative::new(tuned.gains.integral).unwrap();
            }
            let reached = margins_of(&with_gains, &[real], [0.0; 2], delay_cycles(&rig).unwrap()).unwrap().unwrap();
            assert!(has_margins(&reached.worst.without_friction, PROPOSED_MARGINS), "{real:?}: {reached:?}");
        }
    }
}
