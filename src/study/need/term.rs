//! The terms of the simulated machine and hand that can be left out.

use crate::machine::Machine;
use yieldwall_config::{self as config, BusTiming, CommandMode, EncoderModel, ForceSensorModel, NotNegative, Tracking};

/// A term of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Term {
    /// A step of the integration ten times as long stands for its error.
    FineStep,
    BusTiming,
    EncoderCounts,
    ForceNoise,
    JointElasticity,
    Arm,
    CoulombFriction,
    ViscousFriction,
    LinkMasses,
    ToolMass,
    HandMass,
    HandDamping,
    HandForceLimit,
    Tremor,
}

pub(super) const TERMS: [Term; 14] = [
    Term::FineStep,
    Term::BusTiming,
    Term::EncoderCounts,
    Term::ForceNoise,
    Term::JointElasticity,
    Term::Arm,
    Term::CoulombFriction,
    Term::ViscousFriction,
    Term::LinkMasses,
    Term::ToolMass,
    Term::HandMass,
    Term::HandDamping,
    Term::HandForceLimit,
    Term::Tremor,
];

impl Term {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::FineStep => "fine step",
            Self::BusTiming => "bus timing",
            Self::EncoderCounts => "encoder counts",
            Self::ForceNoise => "force noise",
            Self::JointElasticity => "joint elasticity",
            Self::Arm => "arm",
            Self::CoulombFriction => "Coulomb friction",
            Self::ViscousFriction => "viscous friction",
            Self::LinkMasses => "link masses",
            Self::ToolMass => "tool mass",
            Self::HandMass => "hand mass",
            Self::HandDamping => "hand damping",
            Self::HandForceLimit => "hand force limit",
            Self::Tremor => "tremor",
        }
    }

    /// Leaves the term out. `false` if machine and scene do not have it, or cannot do without it; they are then as before.
    pub(super) fn remove(self, machine: &mut Machine, scene: &mut config::Scene) -> bool {
        let hand = &mut scene.hand;
        match self {
            Self::HandMass => return clear(&mut hand.mass_kg),
            Self::HandDamping => return clear(&mut hand.damping_n_s_per_m),
            Self::Tremor => return hand.tremor.take().is_some(),
            Self::HandForceLimit => return hand.voluntary_force_limit_n.take().is_some(),
            _ => {}
        }
        match machine {
            Machine::Rig(rig) => self.remove_from_rig(rig, scene),
            Machine::Device(device) => match (self, &mut scene.device_model) {
                (Self::FineStep, Some(model)) => coarsen(&mut model.plant_step_us, device.cycle.period_us),
                (Self::ViscousFriction, _) => clear(&mut device.plant.damping_n_s_per_m),
                _ => false,
            },
        }
    }

    fn remove_from_rig(self, rig: &mut config::Rig, scene: &mut config::Scene) -> bool {
        let Some(model) = &mut scene.model else { return false };
        let Some(config::Simulation { timing, arm, .. }) = &mut rig.simulation else { return false };
        let has_arm = model.tracking == Tracking::Rigid;
        match self {
            Self::FineStep => coarsen(&mut model.plant_step_us, rig.cycle.period_us),
            Self::BusTiming => set(timing, BusTiming::Ideal),
            Self::EncoderCounts => set(&mut model.encoder, EncoderModel::Exact),
            Self::ForceNoise => set(&mut model.force_sensor, ForceSensorModel::Quantised),
            Self::JointElasticity => model.joint_elasticity.take().is_some(),
            Self::Arm => {
                let can_do_without = rig.rig.command_mode == CommandMode::Position && model.joint_elasticity.is_none();
                can_do_without && set(&mut model.tracking, Tracking::Ideal)
            }
            Self::CoulombFriction => has_arm && clear_all(&mut arm.coulomb_n_m),
            Self::ViscousFriction => has_arm && clear_all(&mut arm.viscous_n_m_s_per_rad),
            Self::LinkMasses => has_arm && (clear_all(&mut arm.proximal_kg) | clear_all(&mut arm.distal_kg)),
            Self::ToolMass => has_arm && clear(&mut arm.tool_kg),
            Self::HandMass | Self::HandDamping | Self::HandForceLimit | Self::Tremor => false,
        }
    }
}

/// Ten times as long, and no longer than a cycle.
fn coarsen(step_us: &mut u32, period_us: u32) -> bool {
    // The period is a whole multiple of the step.
    let factor = (2..=10).rev().find(|factor| period_us.is_multiple_of(*step_us * factor));
    *step_us *= factor.unwrap_or(1);
    factor.is_some()
}

fn set<T: PartialEq>(place: &mut T, value: T) -> bool {
    let is_change = *place != value;
    *place = value;
    is_change
}

fn clear(value: &mut NotNegative) -> bool {
    NotNegative::new(0.0).is_some_and(|zero| set(value, zero))
}

fn clear_all(values: &mut [NotNegative; 2]) -> bool {
    values.iter_mut().map(clear).fold(false, |a, b| a | b)
}
