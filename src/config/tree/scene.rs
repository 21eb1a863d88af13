//! A scene: motion of the hand, and fidelity of the machine model.

use garde::Validate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::injection::{SceneDefect, SceneFault};
use crate::number::{Finite, NotNegative, Positive, nullable, present};

/// Course of a run of the embedded simulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Scene {
    /// Length of the run, s. Above 0, at most 3600.
    #[garde(dive)]
    pub duration_s: Positive,
    /// Seed of noise and tremor: the same seed gives the same run, bit for bit.
    pub seed: u64,
    /// Fidelity of the model of a rig. Either `model` or `device_model` is given.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<SceneModel>,
    /// Fidelity of the model of an impedance device. Either `model` or `device_model` is given.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device_model: Option<DeviceModel>,
    /// The hand that moves the tool.
    #[garde(dive)]
    pub hand: Hand,
    /// Injected faults; none if left out. Only for a rig.
    #[garde(length(max = 64), dive)]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<SceneFault>,
    /// Defects of the machine from the beginning, which `commission` should find; none if left out. Only for a rig.
    #[garde(length(max = 16), dive)]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub defects: Vec<SceneDefect>,
    /// Smallest changes of the scene's outputs that count as an effect when `yieldwall study need` leaves out a modelled term.
    /// Left out: the study does not judge the scene.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<SceneTolerance>,
}

/// Changes of a scene's outputs that do not count as an effect.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct SceneTolerance {
    /// Tolerance of depths and distances from the surface, mm. Above 0.
    #[garde(dive)]
    pub distance_mm: Positive,
    /// Tolerance of the greatest force, N. Above 0.
    #[garde(dive)]
    pub force_n: Positive,
    /// Tolerance of the greatest torque, N m. Above 0; not used on an impedance device.
    #[garde(dive)]
    pub torque_n_m: Positive,
    /// Tolerance of the energy given to the hand, mJ. Above 0.
    #[garde(dive)]
    pub energy_mj: Positive,
}

impl Scene {
    /// Integration step in us, for either kind of machine; `None` only before the scene is checked.
    pub fn plant_step_us(&self) -> Option<u32> {
        let of_device = || self.device_model.map(|model| model.plant_step_us);
        self.model.map(|model| model.plant_step_us).or_else(of_device)
    }
}

/// Fidelity of the model of an impedance device: a point mass without encoders, gears or force sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct DeviceModel {
    /// Integration step, us. 1 to 10 000; the control period is a whole multiple of it.
    #[garde(range(min = 1, max = 10_000))]
    pub plant_step_us: u32,
}

/// Fidelity of the model of a rig.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct SceneModel {
    /// Whether the simulation models the arm, or places the tool at the proxy; `ideal` needs `rig.command_mode: position`.
    pub tracking: Tracking,
    /// Integration step, us. 1 to 10 000; the control period is a whole multiple of it.
    #[garde(range(min = 1, max = 10_000))]
    pub plant_step_us: u32,
    /// Model of the position measurement.
    pub encoder: EncoderModel,
    /// Model of the force measurement.
    pub force_sensor: ForceSensorModel,
    /// Standard deviation of the noise on each axis of the force sensor, counts; used only when `force_sensor` is noisy.
    #[garde(dive)]
    pub force_noise_counts: NotNegative,
    /// Elastic gears between motor and link, or null for stiff ones; null with `tracking: ideal`.
    #[garde(dive)]
    #[serde(deserialize_with = "present")]
    #[schemars(schema_with = "nullable::<JointElasticity>")]
    pub joint_elasticity: Option<JointElasticity>,
}

/// Whether the simulation models the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Tracking {
    /// The tool is where the proxy is; the arm is not modelled.
    Ideal,
    /// The arm with its inertia and friction.
    Rigid,
}

/// Model of the position measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EncoderModel {
    /// Without quantisation.
    Exact,
    /// In whole counts.
    Quantised,
}

/// Model of the force measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ForceSensorModel {
    /// In whole counts, like every sensor on a bus.
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
    /// Share of `arm.motor_kg_m2` of the simulation on the motor side of the gear. Above 0, below 1.
    #[garde(dive)]
    pub motor_share: Positive,
}

/// The hand: a mass that a spring and damper pull along a path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Hand {
    /// Mass of the hand, which moves with the tool, kg. 0 to 100. Arms of people have 0.5 to 3.
    #[garde(dive)]
    pub mass_kg: NotNegative,
    /// Stiffness between aim point and tool, N/m. Above 0, at most 100 000. Arms of people have 100 to 3000.
    #[garde(dive)]
    pub stiffness_n_per_m: Positive,
    /// Damping between aim point and tool, N s/m. 0 to 10 000. Arms of people have 5 to 100.
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
    /// Error of the hand's aim: a slow random deviation from the path. Left out: none.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aim_error: Option<AimError>,
    /// Start position of tool and aim point, m: two coordinates on a rig, three on an impedance device.
    #[garde(length(min = 2, max = 3))]
    pub start_m: Vec<Finite>,
    /// Path of the aim point, segment after segment; the tool follows through the spring.
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

/// Slow random deviation of the aim point from its path. It grows from zero during the first half second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct AimError {
    /// Root mean square on each axis, m. 0 to 0.05. People who trace a line by eye err by about 0.005, in haste by 0.02.
    #[garde(dive)]
    pub rms_m: NotNegative,
    /// Frequency above which it has little power, Hz. Above 0, at most 50. Intended motions of people lie below about 2 Hz.
    #[garde(dive)]
    pub corner_hz: Positive,
}

/// One piece of the path of the aim point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub enum PathSegment {
    /// A straight line to a point, by minimum jerk.
    To {
        /// End point, m: as many coordinates as `start_m`.
        #[garde(length(min = 2, max = 3))]
        point_m: Vec<Finite>,
        /// Duration, s. Above 0.
        #[garde(dive)]
        in_s: Positive,
    },
    /// An arc about a centre, by minimum jerk in the angle. In space the arc turns about the z direction.
    Arc {
        /// Centre, m: as many coordinates as `start_m`, and not the start of the arc; the third is not used.
        #[garde(length(min = 2, max = 3))]
        center_m: Vec<Finite>,
        /// Angle, rad; counter-clockwise positive.
        by_rad: Finite,
        /// Duration, s. Above 0.
        #[garde(dive)]
        in_s: Positive,
        /// Speed profile along the arc.
        speed: ArcSpeed,
    },
    /// A pause.
    Wait {
        /// Duration, s. Above 0.
        #[garde(dive)]
        for_s: Positive,
    },
    /// The hand lets go of the tool, and takes it again at the end of the path so far. The mass of the hand stays at the tool.
    LetGo {
        /// Duration, s. Above 0.
        #[garde(dive)]
        for_s: Positive,
    },
}

/// Speed profile along an arc.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ArcSpeed {
    /// Minimum jerk: from rest to rest.
    Smooth,
    /// Constant, with short ramps.
    Constant,
}

impl PathSegment {
    /// Duration in s.
    pub fn duration_s(&self) -> f64 {
        match self {
            Self::To { in_s, .. } | Self::Arc { in_s, .. } => **in_s,
            Self::Wait { for_s } | Self::LetGo { for_s } => **for_s,
        }
    }
}
