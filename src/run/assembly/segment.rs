//! The EtherCAT segment of a rig, as its master has to bring it up.

use std::time::Duration;

use super::error::AssemblyError;
use super::{buses, drive_limits, drive_profile, profile, scaling, sensor_start, waits};
use yieldwall_bus::ethercat::{Acts, SegmentDrive, SegmentSensor, SegmentSetup, StationSetup};
use yieldwall_bus::{BootError, BootFailure, HomingOrder};
use yieldwall_config as config;
use yieldwall_motion::guard::Device;

/// Share of a period after SYNC0 at which the input frame passes: inputs that are latched at SYNC0 are there by then.
const SYNC0_PHASE: u32 = 10;
/// Returns the time from the drives' sampling to the begin of the cycle that reads it: zero on CAN, whose SYNC begins the cycle.
pub fn sampled_before(rig: &config::Rig) -> Duration {
    match rig.segment_of_drives() {
        Some(_) => Duration::from_micros(rig.cycle.period_us.into()) / SYNC0_PHASE,
        None => Duration::ZERO,
    }
}

/// Returns the segment of a rig whose drives are on it.
///
/// # Errors
/// If parts of the configuration do not fit together.
pub fn segment(rig: &config::Rig) -> Result<SegmentSetup, AssemblyError> {
    segment_of(rig, [None; 2])
}

/// Returns the segment's setup; a drive with a homing order is brought up for homing.
pub(super) fn segment_of(rig: &config::Rig, homing: [Option<HomingOrder>; 2]) -> Result<SegmentSetup, AssemblyError> {
    let period = Duration::from_micros(rig.cycle.period_us.into());
    let acts = match rig.segment_of_drives().map(|bus| bus.outputs) {
        Some(config::OutputsAct::OnArrival) => Acts::OnArrival,
        _ => Acts::AtSync0,
    };
    let [left, right] = &rig.drives;
    let drives = [(Device::LeftDrive, left), (Device::RightDrive, right)];
    let mut stations: Vec<StationSetup> = Vec::new();
    for ((device, drive), homing) in drives.into_iter().zip(homing) {
        let not_here = || AssemblyError::NoPosition(drive.name.clone());
        let (profile, limits) = (drive_profile(rig, drive)?, drive_limits(rig, &scaling(drive)?)?);
        let setup = SegmentDrive {
            name: drive.name.clone(),
            device,
            position: drive.address.position().ok_or_else(not_here)?,
            waits: waits(&drive.waits, Some(&profile.node)),
            profile,
            torque_limit_per_mille: limits.torque_per_mille,
            speed_limit_counts_per_s: limits.counts_per_s,
            following_error_counts: limits.following_error_counts,
            homing,
        };
        let station = setup.station(rig.rig.command_mode, period, acts);
        stations.push(station.map_err(|failure| plan_error(&drive.name, failure))?);
    }
    if rig.has_one_device() {
        // The process data of the first axis come first.
        let axis = |drive: &config::Drive| drive.address.axis();
        if axis(right) < axis(left) {
            stations.reverse();
        }
        stations = stations.into_iter().reduce(StationSetup::with_axis).into_iter().collect();
    }
    if rig.sensor.protocol.position().is_some() {
        stations.push(sensor(&rig.sensor)?);
    }
    Ok(SegmentSetup {
        bus: buses::bus_id(rig, &left.bus)?,
        period,
        compute_at: Duration::from_micros(rig.cycle.compute_at_us.into()),
        sync0_phase: sampled_before(rig),
        stations,
    })
}

/// Returns the sensor of a rig on its segment.
fn sensor(sensor: &config::Sensor) -> Result<StationSetup, AssemblyError> {
    let config::SensorProtocol::Ethercat { position, profile: name, .. } = &sensor.protocol else {
        return Err(AssemblyError::NoPosition(sensor.name.clone()));
    };
    let profile = profile(name)?;
    let setup = SegmentSensor {
        name: sensor.name.clone(),
        position: *position,
        waits: waits(&sensor.waits, Some(&profile.node)),
        profile,
        start: sensor_start(sensor),
    };
    Ok(setup.station().map_err(|failure| plan_error(&sensor.name, failure))?)
}

fn plan_error(name: &str, failure: BootFailure) -> BootError {
    BootError { node_id: None, name: name.to_owned(), step: "plan the process data", failure }
}
