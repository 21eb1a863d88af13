//! The configuration made into devices and their world.

use std::time::Duration;

use nalgebra::Vector2;

use super::defects::{self, Defects};
use super::error::RigError;
use super::far_end::DEVICES;
use super::world::{Body, Grip, Ideal, SensorFilter, Truth, World};
use yieldwall_bus::{CommandMode, SensorLink};
use yieldwall_config as config;
use yieldwall_config::injection::DefectKind;
use yieldwall_drives::watchdog::Watchdog;
use yieldwall_fieldbus::canopen::node_id;
use yieldwall_fieldbus::objects::{Address, ObjectDictionary, ServedDevice};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::linkage::FiveBar;
use yieldwall_motion::quantity::{Force, JointTorques, TipPoint, TipVelocity};
use yieldwall_run::Pace;
use yieldwall_run::assembly;
use yieldwall_run::assembly::AssemblyError;
use yieldwall_sim::arm::{Arm, ArmParameters, JointElasticity};
use yieldwall_sim::ethercat::{Controller, ControllerSettings, Information, Manner, Segment, SimulatedDevice, sii};
use yieldwall_sim::{
    AxisSettings, Drive, DriveQuirks, DriveSettings, Encoder, EthercatDrive, ForceSensor, ForceSensorSettings,
    ForceTorqueSensor, ForceTorqueSettings, OddObject, PositionLoop, Speaks,
};

/// By how much the clock of a sensor on plain CAN is slow, in parts per million: a usual crystal. It drifts through the
/// cycle, once in 20 s at 1 ms.
const SENSOR_SLOW_PPM: u32 = 50;

pub(super) fn node(raw: u8) -> Result<yieldwall_fieldbus::canopen::NodeId, RigError> {
    node_id(raw).map_err(|error| RigError::Device(error.to_string()))
}

/// Returns the simulation of a rig.
pub(super) fn simulated(rig: &config::Rig) -> Result<&config::Simulation, RigError> {
    Ok(rig.simulated().map_err(AssemblyError::from)?)
}

fn model(scene: &config::Scene) -> Result<&config::SceneModel, RigError> {
    scene.model.as_ref().ok_or(RigError::NoModel("model"))
}

/// Returns the simulated behaviour in which a drive differs from others.
fn manner(model: &config::DriveModel) -> DriveQuirks {
    let config::SdoServer { answer_ms, segments_only, lengths } = &model.sdo_server;
    DriveQuirks {
        lacks_dummies: !model.has_dummies,
        refuses_mode: model.refuses_mode,
        sdo_time: Duration::from_millis((*answer_ms).into()),
        segments_only: *segments_only,
        lengths: lengths.iter().map(|sent| (Address::new(sent.index, sent.sub), sent.bytes.into())).collect(),
        objects: odd_objects(model),
        fault_code: model.fault_code,
        supply_time: Duration::from_millis(model.supply_ms.into()),
    }
}

/// Objects of a simulated drive that are otherwise than those of CiA 402.
fn odd_objects(model: &config::DriveModel) -> Vec<OddObject> {
    let odd = |odd: &config::OddObject| OddObject {
        index: odd.index,
        sub: odd.sub,
        is_absent: odd.absent,
        is_read_only: odd.read_only,
        holds: odd.holds,
        needed_bits: odd.needed_bits,
        write_time: Duration::from_millis(odd.write_ms.into()),
    };
    model.objects.iter().map(odd).collect()
}

/// Returns the simulated drive of a joint, switched off: the model in the rig's simulation, or else the rig's own.
///
/// # Errors
/// If its profile is not that of a drive.
pub fn drive(rig: &config::Rig, scene: &config::Scene, drive: &config::Drive, serial: u32) -> Result<Drive, RigError> {
    let AxisSettings { scaling, position_loop, encoder } = axis(rig, scene, drive)?;
    let odd = simulated(rig)?.drive_model.as_ref();
    let profile = assembly::profile(odd.map_or(&drive.profile, |odd| &odd.profile))?;
    let joints = axis_settings(rig, scene, drive, profile.axes())?;
    let settings = DriveSettings {
        node: node(drive.address.node_id().ok_or(AssemblyError::OnEthercat)?)?,
        profile,
        serial,
        scaling,
        position_loop,
        encoder,
        manner: odd.map(manner).unwrap_or_default(),
    };
    let made = Drive::of_axes(&settings, |axis| joints.of(axis));
    let mut made = made.map_err(|error| RigError::Device(error.to_string()))?;
    for drive in rig.drives.iter().filter(|other| other.shares_device(drive)) {
        made.on_axis(axis_of(drive), |made| prepare_on_can(rig, scene, drive, made))?;
    }
    Ok(made)
}

/// Applies the peculiarities of a drive on CAN, or of its encoder.
fn prepare_on_can(
    rig: &config::Rig,
    scene: &config::Scene,
    drive: &config::Drive,
    made: &mut Drive,
) -> Result<(), RigError> {
    let joint = usize::from(drive.name == rig.drives[1].name);
    let has = |kind| defects::has(scene, kind, joint);
    if let Some(homing) = drive.homing {
        made.set_incremental(homing.angle_rad.get());
    }
    if let Some(deviation_rad) = defects::size(scene, DefectKind::LooseHome, joint)? {
        made.set_loose_mark(deviation_rad, scene.seed ^ LOOSE_HOME_SEED[joint]);
    }
    if let Some(per_mille) = defects::size(scene, DefectKind::StaleParameters, joint)? {
        made.set_stored_torque_limit(per_mille as u16);
    }
    if has(DefectKind::HeartbeatConsumerOff)? {
        made.ignore(Watchdog::Heartbeat);
    }
    made.set_forgets_torque_limit(has(DefectKind::LimitNotKept)?);
    Ok(())
}

/// Returns the simulated force sensor, switched off.
///
/// # Errors
/// If its profile is not that of a force sensor.
pub fn force_sensor(rig: &config::Rig) -> Result<ForceSensor, RigError> {
    let sensor = &rig.sensor;
    let speaks = match assembly::sensor_link(sensor)? {
        SensorLink::Canopen(setup) => Speaks::Canopen {
            node: node(setup.node_id)?,
            profile: setup.profile,
            serial: 3,
            counts_per_unit: sensor.counts_per_unit().map(|counts| counts.round() as u32),
        },
        SensorLink::PlainCan(link) => Speaks::PlainCan { protocol: link.protocol, slow_ppm: SENSOR_SLOW_PPM },
    };
    ForceSensor::new(ForceSensorSettings {
        speaks,
        sample_rate_hz: sensor.sample_rate_hz.get().round() as u32,
        phase_us: 0,
        range_counts: i32::try_from(sensor.range_counts).unwrap_or(i32::MAX),
    })
    .map_err(|error| RigError::Device(error.to_string()))
}

/// Marks of both joints are loose apart from each other and from the rest of the scene.
const LOOSE_HOME_SEED: [u64; 2] = [0x105e_0000_0000_0001, 0x105e_0000_0000_0002];

/// Differences between the clocks of devices on EtherCAT, in parts per billion.
const DRIFTS_PPB: [i32; 3] = [12_000, -23_000, 31_000];

/// Returns the devices of a rig that are `here` on an EtherCAT segment, switched on, in the order of their positions. Also returns
/// the positions of left drive, right drive and sensor in the segment. If the master has a clock of its own, the clocks of devices
/// drift apart.
///
/// # Errors
/// If the rig is not on EtherCAT, or a profile is not that of a drive.
pub fn segment(
    rig: &config::Rig,
    scene: &config::Scene,
    here: [bool; DEVICES],
    pace: Pace,
) -> Result<(Segment<SimulatedDevice>, [Option<usize>; DEVICES]), RigError> {
    let [left, right] = &rig.drives;
    let positions = [left.address.position(), right.address.position(), rig.sensor.protocol.position()];
    let mut line: Vec<(u16, Option<usize>)> = Vec::new();
    // Axes of one device are here together.
    let is_here = |device: usize| {
        here.get(device) == Some(&true) || rig.has_one_device() && device < 2 && here[..2].contains(&true)
    };
    for (device, position) in positions.into_iter().enumerate().filter(|(device, _)| is_here(*device)) {
        let is_new = |position: &u16| !line.iter().any(|(known, _)| known == position);
        line.extend(position.filter(is_new).map(|position| (position, Some(device))));
    }
    let odd = &simulated(rig)?.segment;
    let beside = odd.iter().map(|odd| odd.position).filter(|position| !positions.contains(&Some(*position)));
    if here == [true; DEVICES] {
        line.extend(beside.map(|position| (position, None)));
    }
    if line.is_empty() && here.contains(&true) {
        return Err(RigError::NoneOnEthercat);
    }
    line.sort_unstable();
    let mut places = [None; DEVICES];
    let mut controllers = Vec::new();
    for (place, (position, device)) in line.into_iter().enumerate() {
        let made = match device {
            None => {
                let none = ObjectDictionary::builder().build();
                SimulatedDevice::Objects(Box::new(none.map_err(|error| RigError::Device(error.to_string()))?))
            }
            Some(device) => match rig.drives.get(device) {
                Some(drive) => SimulatedDevice::Drive(Box::new(ethercat_drive(rig, scene, drive, device as u32 + 1)?)),
                None => SimulatedDevice::ForceTorque(Box::new(force_torque_sensor(rig)?)),
            },
        };
        let drift_ppb = match (pace, device) {
            (Pace::Free, Some(device)) => DRIFTS_PPB.get(device).copied().unwrap_or_default(),
            _ => 0,
        };
        let odd = odd.iter().find(|odd| odd.position == position);
        let image = odd.and_then(config::SegmentDevice::image);
        let image =
            image.unwrap_or_else(|| if device.is_some() { sii(made.od()).write() } else { EMPTY_CHIP.to_vec() });
        let manner = odd.map(manner_on_segment).unwrap_or_default();
        let settings = ControllerSettings { drift_ppb, manner, ..ControllerSettings::new(image) };
        controllers.push(Controller::new(made, settings));
        for (device, known) in places.iter_mut().enumerate() {
            if is_here(device) && positions.get(device) == Some(&Some(position)) {
                *known = Some(place);
            }
        }
    }
    Ok((Segment::new(Time(0), controllers), places))
}

/// Chip of a device that is not programmed.
const EMPTY_CHIP: [u8; 2048] = [0xff; 2048];

/// Oddities of a simulated device on EtherCAT.
fn manner_on_segment(device: &config::SegmentDevice) -> Manner {
    Manner {
        al_status_bits: device.al_status_bits,
        mailbox_counter: device.mailbox_counter,
        information: match device.sdo_information {
            config::SdoInformation::Answered => Information::Answered,
            config::SdoInformation::Unanswered => Information::Unanswered,
            config::SdoInformation::Aborted => Information::Aborted,
            config::SdoInformation::MailboxError => Information::MailboxError,
        },
        is_turned: device.is_turned,
    }
}

fn ethercat_drive(
    rig: &config::Rig,
    scene: &config::Scene,
    drive: &config::Drive,
    serial: u32,
) -> Result<EthercatDrive, RigError> {
    let odd = simulated(rig)?.drive_model.as_ref();
    let profile = assembly::profile(odd.map_or(&drive.profile, |odd| &odd.profile))?;
    let manner = odd.map(manner).unwrap_or_default();
    let joints = axis_settings(rig, scene, drive, profile.axes())?;
    let made = EthercatDrive::odd(&profile, serial, |axis| joints.of(axis), &manner);
    let mut made = made.map_err(|error| RigError::Device(error.to_string()))?;
    for drive in rig.drives.iter().filter(|other| other.shares_device(drive)) {
        made.on_axis(axis_of(drive), |made| prepare(rig, scene, drive, made))?;
    }
    Ok(made)
}

/// Applies the peculiarities of a drive, or of its encoder.
fn prepare(
    rig: &config::Rig,
    scene: &config::Scene,
    drive: &config::Drive,
    made: &mut EthercatDrive,
) -> Result<(), RigError> {
    let joint = usize::from(drive.name == rig.drives[1].name);
    made.set_forgets_torque_limit(defects::has(scene, DefectKind::LimitNotKept, joint)?);
    if let Some(per_mille) = defects::size(scene, DefectKind::StaleParameters, joint)? {
        made.set_stored_torque_limit(per_mille as u16);
    }
    if let Some(homing) = drive.homing {
        made.set_incremental(homing.angle_rad.get());
    }
    if let Some(deviation_rad) = defects::size(scene, DefectKind::LooseHome, joint)? {
        made.set_loose_mark(deviation_rad, scene.seed ^ LOOSE_HOME_SEED[joint]);
    }
    Ok(())
}

/// Returns the axis of a drive in its device.
fn axis_of(drive: &config::Drive) -> usize {
    drive.address.axis().unwrap_or_default().into()
}

/// Returns the axes of the left and the right drive in their devices.
pub(super) fn axes(rig: &config::Rig) -> [usize; 2] {
    rig.drives.each_ref().map(axis_of)
}

/// The joints of the axes of a device.
struct Joints(Vec<AxisSettings>);

impl Joints {
    fn of(&self, axis: u8) -> &AxisSettings {
        &self.0[usize::from(axis).min(self.0.len() - 1)]
    }
}

/// Returns the joints of the axes of a drive's device. An unused axis is like the drive's own.
fn axis_settings(
    rig: &config::Rig,
    scene: &config::Scene,
    drive: &config::Drive,
    axes: u8,
) -> Result<Joints, RigError> {
    let at = |number: usize| rig.drives.iter().find(|other| other.shares_device(drive) && axis_of(other) == number);
    let all = (0..usize::from(axes)).map(|number| axis(rig, scene, at(number).unwrap_or(drive)));
    Ok(Joints(all.collect::<Result<_, _>>()?))
}

/// Returns the sensor on the segment, of the rig's model. It reports by itself the counts for one N and one N m; the configuration
/// has the same numbers.
fn force_torque_sensor(rig: &config::Rig) -> Result<ForceTorqueSensor, RigError> {
    let sensor = &rig.sensor;
    let profile = sensor.protocol.profile().ok_or(RigError::NoneOnEthercat)?;
    let [counts_per_n, counts_per_n_m] = sensor.counts_per_unit().map(|counts| counts.round() as i32);
    let settings = ForceTorqueSettings {
        sample_rate_hz: sensor.sample_rate_hz.get().round() as u32,
        range_counts: i32::try_from(sensor.range_counts).unwrap_or(i32::MAX),
        counts_per_n,
        counts_per_n_m,
        ..ForceTorqueSettings::new(assembly::profile(profile)?, 3)
    };
    ForceTorqueSensor::new(&settings).map_err(|error| RigError::Device(error.to_string()))
}

/// How a drive sits on its joint.
fn axis(rig: &config::Rig, scene: &config::Scene, drive: &config::Drive) -> Result<AxisSettings, RigError> {
    let servo = &simulated(rig)?.drive_position_loop;
    Ok(AxisSettings {
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
    })
}

/// Returns the arm of a rig in the embedded simulation, with the mass of the scene's hand and the gears of its model. The handle
/// beyond the force sensor (`sensor.handle_mass_kg`) is a part of its tool.
///
/// # Errors
/// A linkage that does not close, or a scene without a model.
pub fn arm(rig: &config::Rig, scene: &config::Scene) -> Result<ArmParameters, RigError> {
    let arm = &simulated(rig)?.arm;
    Ok(ArmParameters {
        linkage: assembly::linkage(rig)?,
        mass: assembly::plant_mass(rig)?,
        handle_kg: scene.hand.mass_kg.get() + defects::hung_kg(scene)?,
        coulomb_n_m: defects::friction(scene, arm.coulomb_n_m.map(|value| value.get()))?,
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
                return Err(RigError::IdealInTorque);
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
        has_hand: true,
        hand_stiffness_n_per_m: hand.parameters().stiffness_n_per_m,
        hand,
        calibration,
        mounting,
        noise_counts: defects::sensor_noise_counts(rig, scene)?.unwrap_or(match model.force_sensor {
            config::ForceSensorModel::Noisy => model.force_noise_counts.get(),
            config::ForceSensorModel::Quantised => 0.0,
        }),
        noise: World::noise_from(seed),
        longest_step_s: f64::from(model.plant_step_us) * 1e-6,
        torques: JointTorques::default(),
        are_braked: [false; 2],
        links: angles,
        hand_from_s: f64::INFINITY,
        grip: Grip::Firm,
        pushes: Vec::new(),
        weight: Force::default(),
        defects: Defects::new(rig, scene, angles)?,
        handle_kg: rig.sensor.handle_mass_kg.get() + defects::hung_kg(scene)?,
        filter: SensorFilter::new(defects::sensor_lag_s(scene)?),
        truth: Truth::default(),
        sampled: None,
    })
}
