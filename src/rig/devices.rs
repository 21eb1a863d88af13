//! The configuration made into devices and their world.

use std::time::Duration;

use nalgebra::Vector2;

use super::error::RigError;
use super::world::{Body, Grip, Ideal, Truth, World};
use crate::assembly;
use crate::assembly::AssemblyError;
use crate::bus::{CommandMode, SensorLink};
use crate::canopen::node_id;
use crate::config;
use crate::linkage::FiveBar;
use crate::objects::Address;
use crate::quantity::{JointTorques, TipPoint, TipVelocity};
use crate::sim::arm::{Arm, ArmParameters, JointElasticity};
use crate::sim::{Drive, DriveSettings, Encoder, ForceSensor, ForceSensorSettings, Manner, PositionLoop, Speaks};

/// By how much the clock of a sensor on plain CAN is slow, in parts per million: a usual crystal. It drifts through the
/// cycle, once in 20 s at 1 ms.
const SENSOR_SLOW_PPM: u32 = 50;

pub(super) fn node(raw: u8) -> Result<crate::canopen::NodeId, RigError> {
    node_id(raw).map_err(|error| RigError::Device(error.to_string()))
}

/// The simulation of a rig.
pub(super) fn simulated(rig: &config::Rig) -> Result<&config::Simulation, RigError> {
    Ok(rig.simulated().map_err(AssemblyError::from)?)
}

fn model(scene: &config::Scene) -> Result<&config::SceneModel, RigError> {
    scene.model.as_ref().ok_or_else(|| RigError::Mismatch("the scene has no `model` of a rig".into()))
}

/// What a simulated drive does in a manner of its own.
fn manner(model: &config::DriveModel) -> Manner {
    let config::SdoServer { answer_ms, segments_only, lengths } = &model.sdo_server;
    Manner {
        lacks_dummies: !model.has_dummies,
        refuses_mode: model.refuses_mode,
        sdo_time: Duration::from_millis((*answer_ms).into()),
        segments_only: *segments_only,
        lengths: lengths.iter().map(|sent| (Address::new(sent.index, sent.sub), sent.bytes.into())).collect(),
    }
}

/// The simulated drive of a joint, switched off: of the model that the rig's simulation says, or else of that of the rig.
///
/// # Errors
/// If its profile is not that of a drive.
pub fn drive(rig: &config::Rig, scene: &config::Scene, drive: &config::Drive, serial: u32) -> Result<Drive, RigError> {
    let simulation = simulated(rig)?;
    let servo = &simulation.drive_position_loop;
    let odd = simulation.drive_model.as_ref();
    Drive::new(DriveSettings {
        node: node(drive.address.canopen.node_id)?,
        profile: assembly::profile(odd.map_or(&drive.profile, |odd| &odd.profile))?,
        serial,
        scaling: assembly::scaling(drive)?,
        position_loop: PositionLoop {
            period_us: servo.period_us,
            stiffness_n_m_per_rad: servo.stiffness_n_m_per_rad.get(),
            damping_n_m_s_per_rad: servo.damping_n_m_s_per_rad.get(),
            integral_n_m_per_rad_s: servo.integral_n_m_per_rad_s.get(),
        },
        encoder: match model(scene)?.encoder {
            config::EncoderModel::Exact => Encoder::Exact,
            config::EncoderModel::Quantised => Encoder::Quantised,
        },
        manner: odd.map(manner).unwrap_or_default(),
    })
    .map_err(|error| RigError::Device(error.to_string()))
}

/// The simulated force sensor, switched off.
///
/// # Errors
/// If its profile is not that of a force sensor.
pub fn force_sensor(rig: &config::Rig) -> Result<ForceSensor, RigError> {
    let sensor = &rig.sensor;
    let speaks = match assembly::sensor_link(sensor)? {
        SensorLink::Canopen(setup) => Speaks::Canopen { node: node(setup.node_id)?, profile: setup.profile, serial: 3 },
        SensorLink::PlainCan(link) => Speaks::PlainCan { protocol: link.protocol, slow_ppm: SENSOR_SLOW_PPM },
    };
    ForceSensor::new(ForceSensorSettings {
        speaks,
        sample_rate_hz: sensor.sample_rate_hz.get().round() as u32,
        phase_us: 0,
        range_counts: i32::from(sensor.range_counts),
    })
    .map_err(|error| RigError::Device(error.to_string()))
}

/// The arm that the embedded simulation takes a rig to have, with the mass of the scene's hand and the gears of its model.
///
/// # Errors
/// A linkage that does not close, or a scene without a model.
pub fn arm(rig: &config::Rig, scene: &config::Scene) -> Result<ArmParameters, RigError> {
    let arm = &simulated(rig)?.arm;
    Ok(ArmParameters {
        linkage: assembly::linkage(rig)?,
        mass: assembly::plant_mass(rig)?,
        handle_kg: scene.hand.mass_kg.get(),
        coulomb_n_m: arm.coulomb_n_m.map(|value| value.get()),
        viscous_n_m_s_per_rad: arm.viscous_n_m_s_per_rad.map(|value| value.get()),
        joint_elasticity: model(scene)?.joint_elasticity.as_ref().map(|elasticity| JointElasticity {
            stiffness_n_m_per_rad: elasticity.stiffness_n_m_per_rad.get(),
            damping_n_m_s_per_rad: elasticity.damping_n_m_s_per_rad.get(),
            motor_share: elasticity.motor_share.get(),
        }),
    })
}

pub(super) fn world(rig: &config::Rig, scene: &config::Scene, seed: u64) -> Result<World, RigError> {
    let linkage: FiveBar = assembly::linkage(rig)?;
    let hand = super::hand::hand::<2>(scene, seed)?;
    let start = TipPoint::new(scene.hand.start_m[0].get(), scene.hand.start_m[1].get());
    let angles = linkage.inverse(start)?;
    let model = model(scene)?;
    let body = match model.tracking {
        config::Tracking::Rigid => Body::Arm(Arm::new(&arm(rig, scene)?, angles)?),
        config::Tracking::Ideal => {
            if rig.rig.command_mode != CommandMode::Position {
                let message = "model.tracking ideal needs command_mode position: a torque has no place to go to";
                return Err(RigError::Mismatch(message.into()));
            }
            Body::Ideal(Ideal {
                linkage,
                angles,
                tip: start,
                velocity: TipVelocity::default(),
                acceleration: Vector2::zeros(),
                time_s: 0.0,
            })
        }
    };
    let (calibration, mounting) = assembly::calibration(rig)?;
    Ok(World {
        body,
        hand_stiffness_n_per_m: hand.parameters().stiffness_n_per_m,
        hand,
        calibration,
        mounting,
        noise_counts: match model.force_sensor {
            config::ForceSensorModel::Noisy => model.force_noise_counts.get(),
            config::ForceSensorModel::Quantised => 0.0,
        },
        noise: World::noise_from(seed),
        longest_step_s: f64::from(model.plant_step_us) * 1e-6,
        torques: JointTorques::default(),
        hand_from_s: f64::INFINITY,
        grip: Grip::Firm,
        pushes: Vec::new(),
        truth: Truth::default(),
    })
}
