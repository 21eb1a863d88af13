//! A scene: what the hand does, and how truly the simulation models the machine.

use garde::Validate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::injection::{SceneDefect, SceneFault};
use crate::number::{Finite, NotNegative, Positive, nullable, present};

/// What happens in a run of the embedded simulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Scene {
    /// Length of the run, s. Above 0, at most 3600.
    #[garde(dive)]
    pub duration_s: Positive,
    /// Seed of noise and tremor: the same seed gives the same run, bit for bit.
    pub seed: u64,
    /// How truly a rig is modelled. Either `model` or `device_model` is given.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<SceneModel>,
    /// How truly an impedance device is modelled. Either `model` or `device_model` is given.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device_model: Option<DeviceModel>,
    /// The hand that moves the tool.
    #[garde(dive)]
    pub hand: Hand,
    /// What is broken on purpose; nothing if left out. Only a rig has it.
    #[garde(length(max = 64), dive)]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<SceneFault>,
    /// What is wrong with the machine from the beginning, for a commissioning to find; nothing if left out. Only a rig has it.
    #[garde(length(max = 16), dive)]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub defects: Vec<SceneDefect>,
    /// How much the outputs of the scene may change when a modelled term is left out before the term counts as having an
    /// effect: `yieldwall study need`. Left out: not judged.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<SceneTolerance>,
}

/// What counts as no change of a scene's outputs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct SceneTolerance {
    /// Of depths and distances from the surface, mm. Above 0.
    #[garde(dive)]
    pub distance_mm: Positive,
    /// Of the greatest force, N. Above 0.
    #[garde(dive)]
    pub force_n: Positive,
    /// Of the greatest torque, N m. Above 0; not used on an impedance device.
    #[garde(dive)]
    pub torque_n_m: Positive,
    /// Of the energy given to the hand, mJ. Above 0.
    #[garde(dive)]
    pub energy_mj: Positive,
}

impl Scene {
    /// Step of the integration in us, whatever machine the scene is for; `None` only before the scene is checked.
    pub fn plant_step_us(&self) -> Option<u32> {
        let of_device = || self.device_model.map(|model| model.plant_step_us);
        self.model.map(|model| model.plant_step_us).or_else(of_device)
    }
}

/// How truly the simulation models an impedance device: a point mass that has neither encoders, gears nor force sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct DeviceModel {
    /// Step of the integration, us. 1 to 10 000; the control period is a whole multiple of it.
    #[garde(range(min = 1, max = 10_000))]
    pub plant_step_us: u32,
}

/// How truly the simulation models a rig.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct SceneModel {
    /// Whether the arm is simulated or the tool is where the proxy is; `ideal` needs `rig.command_mode: position`.
    pub tracking: Tracking,
    /// Step of the integration, us. 1 to 10 000; the control period is a whole multiple of it.
    #[garde(range(min = 1, max = 10_000))]
    pub plant_step_us: u32,
    /// How the position is measured.
    pub encoder: EncoderModel,
    /// How the force is measured.
    pub force_sensor: ForceSensorModel,
    /// Standard deviation of the noise on each axis of the force sensor, counts; read only when `force_sensor` is noisy.
    #[garde(dive)]
    pub force_noise_counts: NotNegative,
    /// Elastic gears between motor and link, or null for stiff ones; null with `tracking: ideal`.
    #[garde(dive)]
    #[serde(deserialize_with = "present")]
    #[schemars(schema_with = "nullable::<JointElasticity>")]
    pub joint_elasticity: Option<JointElasticity>,
}

/// Whether the arm is simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Tracking {
    /// The tool is where the proxy is; there is no arm.
    Ideal,
    /// The machine with its inertia and friction.
    Rigid,
}

/// How the position is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EncoderModel {
    /// Without quantisation.
    Exact,
    /// In whole counts.
    Quantised,
}

/// How the force is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ForceSensorModel {
    /// In whole counts, as every sensor on a bus.
    Quantised,
    /// In whole counts, with noise.
    Noisy,
}

/// Elastic gears between motor and link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct JointElasticity {
    /// Stiffness of each gear, N m/rad. Above 0.
    #[garde(dive)]
    pub stiffness_n_m_per_rad: Positive,
    /// Damping of each gear, N m s/rad. 0 or above.
    #[garde(dive)]
    pub damping_n_m_s_per_rad: NotNegative,
    /// Part of `arm.motor_kg_m2` of the simulation that lies on the motor's side of the gear. Above 0, below 1.
    #[garde(dive)]
    pub motor_share: Positive,
}

/// The hand: a mass that is pulled along a path by a spring and damper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Hand {
    /// Mass that moves with the tool, kg. 0 or above.
    #[garde(dive)]
    pub mass_kg: NotNegative,
    /// Stiffness between the point aimed at and the tool, N/m. Above 0.
    #[garde(dive)]
    pub stiffness_n_per_m: Positive,
    /// Damping between the point aimed at and the tool, N s/m. 0 or above.
    #[garde(dive)]
    pub damping_n_s_per_m: NotNegative,
    /// Largest force of the spring and damper together, N, above 0; or null for a hand without limit.
    #[garde(dive)]
    #[serde(deserialize_with = "present")]
    #[schemars(schema_with = "nullable::<Positive>")]
    pub voluntary_force_limit_n: Option<Positive>,
    /// Force noise of a human hand, or null for none.
    #[garde(dive)]
    #[serde(deserialize_with = "present")]
    #[schemars(schema_with = "nullable::<Tremor>")]
    pub tremor: Option<Tremor>,
    /// Error of the hand's aim: a slow random course about the path. Left out: none.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aim_error: Option<AimError>,
    /// Where tool and aim are at the start, m: two coordinates on a rig, three on an impedance device.
    #[garde(length(min = 2, max = 3))]
    pub start_m: Vec<Finite>,
    /// Path of the point that the hand aims at, segment after segment; the tool follows through the spring.
    #[garde(length(min = 1), dive)]
    pub path: Vec<PathSegment>,
}

/// Band-limited random force of a human hand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Tremor {
    /// Root mean square on each axis, N. 0 or above.
    #[garde(dive)]
    pub force_rms_n: NotNegative,
    /// Lower edge of the band, Hz. Above 0.
    #[garde(dive)]
    pub low_hz: Positive,
    /// Upper edge of the band, Hz. Above `low_hz`, at most 100.
    #[garde(dive)]
    pub high_hz: Positive,
}

/// Slow random course of the point aimed at about its path. It grows from nothing over the first half second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct AimError {
    /// Root mean square on each axis, m. 0 to 0.05; people who trace a line by eye err by some 0.005, in haste by 0.02.
    #[garde(dive)]
    pub rms_m: NotNegative,
    /// Above this frequency it has little power, Hz. Above 0, at most 50; people move by intent below some 2 Hz.
    #[garde(dive)]
    pub corner_hz: Positive,
}

/// One piece of the path of the point that the hand aims at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub enum PathSegment {
    /// Straight to a point, by minimum jerk.
    To {
        /// End point, m: as many coordinates as `start_m`.
        #[garde(length(min = 2, max = 3))]
        point_m: Vec<Finite>,
        /// Duration, s. Above 0.
        #[garde(dive)]
        in_s: Positive,
    },
    /// Along an arc about a centre, by minimum jerk in the angle. In space the arc turns about the z direction.
    Arc {
        /// Centre, m: as many coordinates as `start_m`, and not where the arc starts; the third is not used.
        #[garde(length(min = 2, max = 3))]
        center_m: Vec<Finite>,
        /// Angle, rad; counter-clockwise positive.
        by_rad: Finite,
        /// Duration, s. Above 0.
        #[garde(dive)]
        in_s: Positive,
        /// How the speed runs along the arc.
        speed: ArcSpeed,
    },
    /// Stay.
    Wait {
        /// Duration, s. Above 0.
        #[garde(dive)]
        for_s: Positive,
    },
    /// Let go of the tool, and take it again at the end where the path has come to. The mass of the hand stays at the tool.
    LetGo {
        /// Duration, s. Above 0.
        #[garde(dive)]
        for_s: Positive,
    },
}

/// How the speed runs along an arc.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ArcSpeed {
    /// Minimum jerk: from rest to rest.
    Smooth,
    /// Constant, with short ramps.
    Constant,
}

impl PathSegment {
    /// How long it lasts in s.
    pub fn duration_s(&self) -> f64 {
        match self {
            Self::To { in_s, .. } | Self::Arc { in_s, .. } => **in_s,
            Self::Wait { for_s } | Self::LetGo { for_s } => **for_s,
        }
    }
}
