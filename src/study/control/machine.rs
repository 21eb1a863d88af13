//! The arm of the shipped rig, its servo and its hand.

use yieldwall_config as config;
use yieldwall_motion::control::Grip;
use yieldwall_motion::cycle::TorqueServoParameters;
use yieldwall_rig::analysis::hand_of;
use yieldwall_rig::simulated_arm;
use yieldwall_run::assembly::torque_servo;
use yieldwall_sim::arm::{ArmParameters, JointElasticity};

/// Parts of the paper's rig and scene that a trial needs.
#[derive(Clone, Debug)]
pub(super) struct Machine {
    /// Without gears; its masses are also those of the feed-forward.
    pub arm: ArmParameters,
    pub gears: JointElasticity,
    pub servo: TorqueServoParameters,
    pub hand: Grip,
}

impl Machine {
    /// From `paper-admittance.yaml`, with the gears of `circle-tour-elastic.yaml`.
    ///
    /// # Panics
    /// If a shipped file is refused or the elastic scene has no gears.
    pub(super) fn shipped() -> Self {
        let rig = config::load_rig(config::builtin("paper-admittance.yaml"));
        let rig = rig.unwrap_or_else(|report| panic!("{report}")).value;
        let [rigid, elastic] = ["circle-tour", "circle-tour-elastic"].map(|name| {
            let scene = config::load_scene(config::builtin(format!("scenes/{name}.yaml")));
            scene.unwrap_or_else(|report| panic!("{report}")).value
        });
        let arm = |scene| simulated_arm(&rig, scene).unwrap_or_else(|error| panic!("{error}"));
        Self {
            arm: arm(&rigid),
            gears: arm(&elastic).joint_elasticity.unwrap_or_else(|| panic!("the elastic scene has no gears")),
            servo: torque_servo(&rig).unwrap_or_else(|error| panic!("{error}")),
            hand: hand_of(&rigid),
        }
    }
}
