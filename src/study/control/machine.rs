//! The arm of the shipped rig and its hand.

use crate::config;
use crate::linkage::{FiveBar, MassModel};
use crate::sim::arm::{ArmParameters, JointElasticity};

/// What a trial needs of the rig and scene of the paper.
#[derive(Clone, Debug)]
pub(super) struct Machine {
    pub linkage: FiveBar,
    /// Of the feed-forward and of the simulated arm: the same.
    pub model: MassModel,
    pub coulomb_n_m: [f64; 2],
    pub viscous_n_m_s_per_rad: [f64; 2],
    /// Share of the dry friction that is fed forward.
    pub coulomb_share: f64,
    pub torque_limit_n_m: f64,
    pub sliding_time_s: f64,
    pub hand_kg: f64,
    pub hand_n_per_m: f64,
    pub hand_n_s_per_m: f64,
    pub elasticity: JointElasticity,
}

impl Machine {
    /// From `paper-admittance.yaml`, with the gears of `circle-tour-elastic.yaml`.
    ///
    /// # Panics
    /// If a shipped file is refused or the elastic scene has no gears.
    pub(super) fn shipped() -> Self {
        let source = config::builtin("paper-admittance.yaml");
        let rig = config::load_rig(source.clone()).unwrap_or_else(|report| panic!("{report}")).value;
        let scene = |name: &str| {
            config::load_scene(config::builtin(format!("scenes/{name}.yaml")))
                .unwrap_or_else(|report| panic!("{report}"))
                .value
        };
        let hand = scene("circle-tour").hand;
        let gear = scene("circle-tour-elastic").model.and_then(|model| model.joint_elasticity);
        let gear = gear.unwrap_or_else(|| panic!("the elastic scene has no gears"));
        let arm = rig.plant.arm;
        let coulomb_n_m = arm.coulomb_n_m.map(|value| value.get());
        Self {
            linkage: FiveBar::new(rig.linkage.geometry()).unwrap_or_else(|error| panic!("{error}")),
            model: MassModel {
                motor_kg_m2: arm.motor_kg_m2.map(|value| value.get()),
                proximal_kg: arm.proximal_kg.map(|value| value.get()),
                distal_kg: arm.distal_kg.map(|value| value.get()),
                tool_kg: arm.tool_kg.get(),
            },
            coulomb_n_m,
            viscous_n_m_s_per_rad: arm.viscous_n_m_s_per_rad.map(|value| value.get()),
            coulomb_share: rig.control.feed_forward.coulomb_n_m[0].get() / coulomb_n_m[0],
            torque_limit_n_m: rig.guard.torque_limit_n_m.get(),
            sliding_time_s: rig.control.sliding_time_s.get(),
            hand_kg: hand.mass_kg.get(),
            hand_n_per_m: hand.stiffness_n_per_m.get(),
            hand_n_s_per_m: hand.damping_n_s_per_m.get(),
            elasticity: JointElasticity {
                stiffness_n_m_per_rad: gear.stiffness_n_m_per_rad.get(),
                damping_n_m_s_per_rad: gear.damping_n_m_s_per_rad.get(),
                motor_share: gear.motor_share.get(),
            },
        }
    }

    pub(super) fn arm(&self, is_elastic: bool) -> ArmParameters {
        ArmParameters {
            linkage: self.linkage,
            mass: self.model,
            handle_kg: self.hand_kg,
            coulomb_n_m: self.coulomb_n_m,
            viscous_n_m_s_per_rad: self.viscous_n_m_s_per_rad,
            joint_elasticity: is_elastic.then_some(self.elasticity),
        }
    }
}
