//! From the configuration to the parts of a rig: linkage, fixture, control, guard, cycle and master, and what its buses carry.

mod buses;
mod error;
mod homing;
mod segment;

use std::sync::Arc;
use std::time::Duration;

use nalgebra::Matrix6;

use yieldwall_bus::ethercat::{Budget, SegmentSetup};
use yieldwall_bus::{DriveSetup, Master, MasterSetup, SensorLink, SensorNode, SensorSetup, SensorStart, Waits};
use yieldwall_config as config;
use yieldwall_drives::profiles::{DeviceProfile, NodeTraits};
use yieldwall_drives::scaling::{AxisScaling, Direction};
use yieldwall_fieldbus::plain_can;
use yieldwall_motion::control::{FeedForwardParameters, Gains, Law, RateLaw};
use yieldwall_motion::cycle::{Cycle, Servo, Settings, TorqueServo, TorqueServoParameters};
use yieldwall_motion::fixture::{
    self, Admittance, BallAndEllipse, BallAndTube, Contrast, Coupling, Curvature, Fixture, Guidance, Impedance, Limits,
    Parameters, Rearm, Shape2, Shape3, Side,
};
use yieldwall_motion::guard::{self, Gate};
use yieldwall_motion::linkage::{FiveBar, MassModel};
use yieldwall_motion::quantity::TipPoint;
use yieldwall_motion::sensing::{Calibration, MountedOn, Mounting, Sensing, SensingParameters};

pub use buses::{bus_id, bus_plan, device_buses, segment_bus};
pub use error::AssemblyError;
pub use homing::HOMING_COMES_UP_S;
pub use segment::{sampled_before, segment};

/// Returns the cycle time in s.
pub fn period_s(rig: &config::Rig) -> f64 {
    f64::from(rig.cycle.period_us) * 1e-6
}

/// Returns the five-bar linkage.
///
/// # Errors
/// If its geometry is none.
pub fn linkage(rig: &config::Rig) -> Result<FiveBar, AssemblyError> {
    Ok(FiveBar::new(rig.linkage.geometry())?)
}

/// Returns the inertia of the simulated arm.
///
/// # Errors
/// If the rig has no simulation.
pub fn plant_mass(rig: &config::Rig) -> Result<MassModel, AssemblyError> {
    Ok(rig.simulated()?.arm.mass_model())
}

fn coupling(fixture: &config::Fixture) -> Coupling {
    match fixture.coupling {
        config::Coupling::Admittance { mass_kg } => Coupling::Admittance(Admittance { mass_kg: mass_kg.get() }),
        config::Coupling::Impedance { stiffness_n_per_m, damping_n_s_per_m } => Coupling::Impedance(Impedance {
            stiffness_n_per_m: stiffness_n_per_m.get(),
            damping_n_s_per_m: damping_n_s_per_m.get(),
        }),
    }
}

fn parameters(fixture: &config::Fixture, period_s: f64) -> Parameters {
    Parameters {
        coupling: coupling(fixture),
        limits: Limits { friction_n: fixture.friction_n.get(), yield_n: fixture.yield_n.get() },
        side: match fixture.side {
            config::Side::Bilateral => Side::Bilateral,
            config::Side::Unilateral => Side::Unilateral,
        },
        hold_steps: fixture.hold_steps,
        rearm: Rearm::default(),
        curvature: match fixture.curvature {
            config::Curvature::Tangent => Curvature::Tangent,
            config::Curvature::Exact => Curvature::Exact,
        },
        period_s,
    }
}

fn law(configured: &config::Fixture, period_s: f64) -> Result<fixture::Law, AssemblyError> {
    let Parameters { limits, side, curvature, .. } = parameters(configured, period_s);
    let kappa = configured.coupling.equivalent_stiffness_n_per_m(period_s);
    let tube = BallAndTube::new(limits, kappa, side, curvature);
    Ok(match configured.law {
        None => fixture::Law::Plastic(tube),
        Some(config::FixtureLaw::Tube { outward_yield_n }) => {
            fixture::Law::Plastic(tube.with_outward_yield(outward_yield_n.get(), kappa)?)
        }
        Some(config::FixtureLaw::Ellipse {}) => fixture::Law::Ellipse(BallAndEllipse::new(limits, kappa, side)),
        Some(other) => {
            let guidance = other.guidance().unwrap_or(Guidance::None);
            fixture::Law::Contrast(Contrast::new(guidance, limits, side, kappa, period_s)?)
        }
    })
}

/// Returns the planar fixture of an admittance rig.
pub fn planar_fixture(fixture: &config::Fixture, period_s: f64) -> Result<Fixture<Shape2, 2>, AssemblyError> {
    let shape = fixture.planar()?.ok_or_else(|| wrong_dimension(&fixture.surface, 2))?;
    let mut built = Fixture::with_set(shape, parameters(fixture, period_s), law(fixture, period_s)?)?;
    if let Some(hold) = fixture.automatic_hold {
        built = built.with_automatic_hold(hold.into())?;
    }
    if let Some(motion) = fixture.motion {
        built = built.with_motion(motion.into())?;
    }
    if let Some(passivity) = fixture.passivity {
        built = built.with_passivity(passivity.into())?;
    }
    Ok(built)
}

/// Returns the fixture of a machine in space, such as an impedance device.
///
/// # Errors
/// If its surface or its parameters are refused.
pub fn spatial_fixture(fixture: &config::Fixture, period_s: f64) -> Result<Fixture<Shape3, 3>, AssemblyError> {
    let shape = fixture.spatial()?.ok_or_else(|| wrong_dimension(&fixture.surface, 3))?;
    Ok(Fixture::with_set(shape, parameters(fixture, period_s), law(fixture, period_s)?)?)
}

fn wrong_dimension(surface: &config::Surface, wanted: usize) -> AssemblyError {
    AssemblyError::Dimension { surface: surface.name(), dimension: surface.dimension(), wanted }
}

/// Returns calibration and mounting of the force sensor, shared with the simulated one.
pub fn calibration(rig: &config::Rig) -> Result<(Calibration, Mounting), AssemblyError> {
    let sensor = &rig.sensor;
    let matrix = Matrix6::from_fn(|row, column| sensor.calibration[row][column].get());
    let link = match sensor.mounted_on {
        config::Mount::Base => MountedOn::Base,
        config::Mount::LeftDistal => MountedOn::LeftDistal,
        config::Mount::RightDistal => MountedOn::RightDistal,
    };
    let mounting = Mounting::new(link, sensor.mounting_angle_rad.get())?;
    Ok((Calibration::new(matrix, i32::try_from(sensor.range_counts).unwrap_or(i32::MAX))?, mounting))
}

/// Returns the gains of the joint controllers, and whether they are those of the tool in the plane; `None` if the joints are driven
/// by rate.
pub fn gains(control: &config::Control) -> Option<(Gains, bool)> {
    match control.gains {
        config::ControlGains::Joint { stiffness_n_m_per_rad, damping_n_m_s_per_rad, integral_n_m_per_rad_s } => Some((
            Gains {
                stiffness: stiffness_n_m_per_rad.get(),
                damping: damping_n_m_s_per_rad.get(),
                integral: integral_n_m_per_rad_s.get(),
            },
            false,
        )),
        config::ControlGains::Cartesian { stiffness_n_per_m, damping_n_s_per_m, integral_n_per_m_s } => Some((
            Gains {
                stiffness: stiffness_n_per_m.get(),
                damping: damping_n_s_per_m.get(),
                integral: integral_n_per_m_s.get(),
            },
            true,
        )),
        config::ControlGains::Rate { .. } => None,
    }
}

fn servo(rig: &config::Rig) -> Result<Servo, AssemblyError> {
    let control = &rig.control;
    match rig.rig.command_mode {
        config::CommandMode::Position => Ok(Servo::Position),
        config::CommandMode::Velocity => match control.gains {
            config::ControlGains::Rate { gain_per_s } => {
                let limit = rig.guard.joint_speed_limit_rad_per_s.get();
                Ok(Servo::Velocity(RateLaw::new(gain_per_s.get(), limit)?))
            }
            _ => Err(AssemblyError::Gains { mode: "velocity", gains: "rate" }),
        },
        config::CommandMode::Torque => {
            Ok(Servo::Torque(Box::new(TorqueServo::new(&torque_servo(rig)?, &linkage(rig)?, period_s(rig))?)))
        }
    }
}

/// Returns the parameters of the servo of a rig in torque mode.
///
/// # Errors
/// If its gains are those of another mode.
pub fn torque_servo(rig: &config::Rig) -> Result<TorqueServoParameters, AssemblyError> {
    let control = &rig.control;
    let Some((gains, is_cartesian)) = gains(control) else {
        return Err(AssemblyError::Gains { mode: "torque", gains: "joint or cartesian" });
    };
    Ok(TorqueServoParameters {
        law: match control.law {
            config::ControlLaw::Psmc => Law::Psmc,
            config::ControlLaw::Pid => Law::Pid,
        },
        gains,
        sliding_time_s: control.sliding_time_s.get(),
        is_cartesian,
        torque_limit_n_m: rig.guard.torque_limit_n_m.get(),
        feed_forward: FeedForwardParameters {
            coulomb_n_m: control.feed_forward.coulomb_n_m.map(|value| value.get()),
            viscous_n_m_s_per_rad: control.feed_forward.viscous_n_m_s_per_rad.map(|value| value.get()),
            coulomb_transition_rad: FeedForwardParameters::DEFAULT_TRANSITION_RAD,
        },
        inertia: control.feed_forward.inertia.as_ref().map(config::ArmInertia::mass_model),
    })
}

/// Returns all stages of the cycle. `fixture` replaces the rig's own.
///
/// # Errors
/// If parts of the configuration do not fit together.
pub fn cycle(rig: &config::Rig, fixture: &config::Fixture) -> Result<Cycle, AssemblyError> {
    let period_s = period_s(rig);
    let limits = &rig.guard;
    let (calibration, mounting) = calibration(rig)?;
    let sensing = Sensing::new(SensingParameters {
        calibration,
        mounting,
        handle_mass_kg: rig.sensor.handle_mass_kg.get(),
        low_pass_hz: rig.sensor.low_pass_hz.map(|value| value.get()),
        // Without a counter of samples each one that arrives is new.
        sample_rate_hz: if rig.sensor.counts_arrivals() { period_s.recip() } else { rig.sensor.sample_rate_hz.get() },
        cycle_period_s: period_s,
        force_step_limit_n: limits.force_step_limit_n.get(),
    })?;
    let gate = Gate::new(guard::Limits {
        period_s,
        torque_n_m: [limits.torque_limit_n_m.get(); 2],
        joint_speed_rad_per_s: limits.joint_speed_limit_rad_per_s.get(),
    });
    let settings = Settings {
        period_s,
        singularity_margin_m: limits.singularity_margin_m.get(),
        tool_speed_limit_m_per_s: limits.tool_speed_limit_m_per_s.get(),
        joint_speed_limit_rad_per_s: limits.joint_speed_limit_rad_per_s.get(),
        force_limit_n: limits.force_limit_n.get(),
        following_error_limit_rad: limits.following_error_limit_rad.get(),
        stop_deceleration_m_per_s2: limits.stop_deceleration_m_per_s2.get(),
        residual_limit_n_m: limits.residual_limit_n_m.map(|value| value.get()),
        energy_limit_j: limits.energy_limit_j.get(),
        enabling_limit_s: rig.drives.each_ref().map(|drive| f64::from(drive.enabling_ms) * 1e-3),
        brake_s: rig.drives.iter().map(brake_s).fold(0.0, f64::max),
        compute_budget_s: f64::from(rig.cycle.period_us.saturating_sub(rig.cycle.compute_at_us)) * 1e-6,
    };
    Ok(Cycle::new(settings, linkage(rig)?, sensing, planar_fixture(fixture, period_s)?, servo(rig)?, gate))
}

/// Returns the closing time of a drive's brake, s; 0 if the master does not hold the brake.
fn brake_s(drive: &config::Drive) -> f64 {
    let servo = drive.profile.get().and_then(|profile| profile.servo());
    let output = servo.and_then(|servo| servo.brake.of_master());
    output.map_or(0.0, |output| f64::from(output.closes_in_ms) * 1e-3)
}

/// Returns the device profile of a drive, as that of its axis.
///
/// # Errors
/// If there is none.
pub fn drive_profile(rig: &config::Rig, drive: &config::Drive) -> Result<Arc<DeviceProfile>, AssemblyError> {
    rig.model(drive).ok_or_else(|| AssemblyError::NoProfile(drive.profile.as_str().to_owned()))
}

/// Returns the device profile of this name.
///
/// # Errors
/// If there is none.
pub fn profile(name: &config::ProfileName) -> Result<Arc<DeviceProfile>, AssemblyError> {
    let missing = || AssemblyError::NoProfile(name.as_str().to_owned());
    name.get().cloned().ok_or_else(missing)
}

/// Returns the conversion from the units of a drive to SI.
///
/// # Errors
/// If a number of it has no meaning.
pub fn scaling(drive: &config::Drive) -> Result<AxisScaling, AssemblyError> {
    let direction = if drive.direction < 0 { Direction::Reversed } else { Direction::Same };
    Ok(AxisScaling::new(
        f64::from(drive.encoder_counts_per_rev),
        direction,
        drive.zero_offset_rad.get(),
        drive.rated_torque_n_m.get(),
    )?)
}

/// Returns the number of cycles from the drives' measurement to the resulting change of torque, without the zero-order hold. A
/// computed torque acts at the next SYNC or SYNC0. If the outputs of a segment act on arrival, it acts in the same cycle, and the
/// number is a fraction of one.
///
/// # Errors
/// If parts of the configuration do not fit together.
pub fn delay_cycles(rig: &config::Rig) -> Result<f64, AssemblyError> {
    match rig.segment_of_drives() {
        Some(_) => Ok(Budget::new(&segment(rig)?).delay().as_secs_f64() / period_s(rig)),
        None => Ok(1.0),
    }
}

/// Returns the master of a rig, with its cycle inside.
///
/// # Errors
/// If parts of the configuration do not fit together.
pub fn master(rig: &config::Rig, fixture: &config::Fixture) -> Result<Master, AssemblyError> {
    let can = rig.own_node().map(|_| network(rig)).transpose()?;
    let segment = rig.is_on_ethercat().then(|| segment(rig)).transpose()?;
    master_of(rig, fixture, (can, segment))
}

/// Returns the master of a rig whose drives are brought up in homing mode.
///
/// # Errors
/// As [`master`], and if a drive has no homing.
pub fn homing_master(rig: &config::Rig) -> Result<Master, AssemblyError> {
    let orders = homing::orders(rig)?;
    let mut can = rig.own_node().map(|_| network(rig)).transpose()?;
    for setup in can.iter_mut().flat_map(|can| &mut can.drives) {
        let drive = rig.drives.iter().position(|drive| drive.name == setup.name);
        setup.homing = drive.and_then(|drive| orders.get(drive)).copied();
    }
    let segment = rig.is_on_ethercat().then(|| segment::segment_of(rig, orders.map(Some))).transpose()?;
    master_of(rig, &rig.fixture, (can, segment))
}

fn master_of(
    rig: &config::Rig,
    fixture: &config::Fixture,
    (can, segment): (Option<MasterSetup>, Option<SegmentSetup>),
) -> Result<Master, AssemblyError> {
    let cycle = cycle(rig, fixture)?;
    let ([left, right], [left_rad, right_rad]) = (&rig.drives, origin(rig)?);
    let axes = [homing::axis(left, left_rad)?, homing::axis(right, right_rad)?];
    Ok(Master::new((can.as_ref(), segment.as_ref()), axes, cycle)?)
}

/// Returns the angles of the task's origin, from which the turn of the encoders is taken: an arm is always within half a turn of
/// it.
fn origin(rig: &config::Rig) -> Result<[f64; 2], AssemblyError> {
    Ok(linkage(rig)?.inverse(TipPoint::new(0.0, 0.0))?.to_array())
}

/// Returns the network as the master has to bring it up.
pub(crate) fn network(rig: &config::Rig) -> Result<MasterSetup, AssemblyError> {
    let link = sensor_link(&rig.sensor)?;
    let of_profile = match &link {
        SensorLink::Canopen(node) => Some(&node.profile.node),
        SensorLink::PlainCan(_) => None,
    };
    let own = rig.own_node().ok_or(AssemblyError::OnEthercat)?;
    Ok(MasterSetup {
        node_id: own.node_id,
        heartbeat: Duration::from_millis(own.heartbeat_ms.into()),
        period: Duration::from_micros(rig.cycle.period_us.into()),
        mode: rig.rig.command_mode,
        drives: rig
            .drives
            .iter()
            .filter(|drive| drive.address.canopen().is_some())
            .map(|own| drive(rig, own))
            .collect::<Result<_, _>>()?,
        sensor: SensorSetup {
            name: rig.sensor.name.clone(),
            bus: buses::bus_id(rig, &rig.sensor.bus)?,
            waits: waits(&rig.sensor.waits, of_profile),
            link,
            sample_period: sample_period(rig),
        },
    })
}

/// Returns how long each drive may take to answer a request for an object.
///
/// # Errors
/// If a profile is unknown.
pub fn request_timeouts(rig: &config::Rig) -> Result<[Duration; 2], AssemblyError> {
    let timeout =
        |drive: &config::Drive| Ok::<_, AssemblyError>(waits(&drive.waits, Some(&profile(&drive.profile)?.node)).sdo);
    let [left, right] = &rig.drives;
    Ok([timeout(left)?, timeout(right)?])
}

/// Returns the time from one sample of the force sensor to the next.
pub fn sample_period(rig: &config::Rig) -> Duration {
    Duration::from_secs_f64(rig.sensor.sample_rate_hz.get().recip())
}

/// Returns the steps of the boot for the force sensor, except its process data.
fn sensor_start(sensor: &config::Sensor) -> SensorStart {
    SensorStart { zeroes: sensor.protocol.zero_at_start(), counts_per_unit: sensor.counts_per_unit() }
}

/// Returns the protocol of the force sensor.
///
/// # Errors
/// If its profile or node-ID is unknown.
pub fn sensor_link(sensor: &config::Sensor) -> Result<SensorLink, AssemblyError> {
    let plain = |protocol, pair_gap_us: u32, zero_at_start| {
        let pair_gap = Duration::from_micros(pair_gap_us.into());
        let sample_period = Duration::from_secs_f64(sensor.sample_rate_hz.get().recip());
        SensorLink::PlainCan(plain_can::Link { protocol, pair_gap, sample_period, zero_at_start })
    };
    Ok(match sensor.protocol {
        config::SensorProtocol::Canopen { node_id, profile: ref name, heartbeat_ms, .. } => {
            let heartbeat = Duration::from_millis(heartbeat_ms.into());
            SensorLink::Canopen(SensorNode { node_id, profile: profile(name)?, heartbeat, start: sensor_start(sensor) })
        }
        config::SensorProtocol::Streaming { command_id, data_ids, pair_gap_us, zero_at_start } => {
            let ids = plain_can::streaming::Ids { command: command_id, data: data_ids };
            plain(plain_can::Protocol::Streaming(ids), pair_gap_us, zero_at_start)
        }
        config::SensorProtocol::Ethercat { .. } => return Err(AssemblyError::OnEthercat),
        config::SensorProtocol::Polled {
            base_id,
            byte_order,
            overload_bits,
            invalid_bits,
            pair_gap_us,
            zero_at_start,
        } => {
            let byte_order = match byte_order {
                config::ByteOrder::BigEndian => plain_can::polled::ByteOrder::BigEndian,
                config::ByteOrder::LittleEndian => plain_can::polled::ByteOrder::LittleEndian,
            };
            let format = plain_can::polled::Format { base: base_id, byte_order, overload_bits, invalid_bits };
            plain(plain_can::Protocol::Polled(format), pair_gap_us, zero_at_start)
        }
    })
}

/// How long a sensor on plain CAN is waited for.
const PLAIN_WAIT_MS: u32 = 5000;

fn waits(waits: &config::Waits, of_profile: Option<&NodeTraits>) -> Waits {
    let wait = |own: Option<u32>, of_profile: Option<u32>| {
        Duration::from_millis(own.or(of_profile).unwrap_or(PLAIN_WAIT_MS).into())
    };
    Waits {
        boot_up: wait(waits.boot_up_ms, of_profile.map(|node| node.boot_up_ms)),
        sdo: wait(waits.sdo_ms, of_profile.map(|node| node.sdo_ms)),
        start: wait(waits.start_ms, of_profile.map(|node| node.start_ms)),
    }
}

/// The drive's own speed limit as a share of the guard's, which is to act first.
const SPEED_LIMIT_SHARE: f64 = 1.25;

/// The limits that a drive is given.
struct DriveLimits {
    torque_per_mille: u16,
    counts_per_s: u32,
    following_error_counts: u32,
}

fn drive_limits(rig: &config::Rig, scaling: &AxisScaling) -> Result<DriveLimits, AssemblyError> {
    let window = 2.0 * rig.guard.following_error_limit_rad.get() * scaling.counts_per_rad();
    let speed = SPEED_LIMIT_SHARE * rig.guard.joint_speed_limit_rad_per_s.get() * scaling.counts_per_rad();
    Ok(DriveLimits {
        torque_per_mille: scaling.torque_per_mille(rig.guard.torque_limit_n_m.get())?.value.unsigned_abs(),
        counts_per_s: speed.round().min(f64::from(u32::MAX)) as u32,
        // The drive's own window is the guard's second, wider one.
        following_error_counts: window.round().min(f64::from(u32::MAX - 1)) as u32,
    })
}

/// Returns the torque limits for the drives, in 1/1000 of their rated torques.
///
/// # Errors
/// As [`scaling`].
pub(crate) fn torque_limits_per_mille(rig: &config::Rig) -> Result<[u16; 2], AssemblyError> {
    let limit = |drive: &config::Drive| Ok::<_, AssemblyError>(drive_limits(rig, &scaling(drive)?)?.torque_per_mille);
    let [left, right] = &rig.drives;
    Ok([limit(left)?, limit(right)?])
}

fn drive(rig: &config::Rig, drive: &config::Drive) -> Result<DriveSetup, AssemblyError> {
    let (profile, limits) = (drive_profile(rig, drive)?, drive_limits(rig, &scaling(drive)?)?);
    let node = drive.address.canopen().ok_or(AssemblyError::OnEthercat)?;
    Ok(DriveSetup {
        name: drive.name.clone(),
        bus: buses::bus_id(rig, &drive.bus)?,
        node_id: node.node_id,
        heartbeat: Duration::from_millis(node.heartbeat_ms.into()),
        waits: waits(&drive.waits, Some(&profile.node)),
        profile,
        torque_limit_per_mille: limits.torque_per_mille,
        speed_limit_counts_per_s: limits.counts_per_s,
        following_error_counts: limits.following_error_counts,
        homing: None,
    })
}
