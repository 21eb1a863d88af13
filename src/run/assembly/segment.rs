//! The EtherCAT segment of a rig, as its master has to bring it up.

use std::time::Duration;

use super::error::AssemblyError;
use super::{buses, drive_limits, profile, scaling, waits};
use yieldwall_bus::ethercat::{Acts, Mapped, ProcessData, SegmentDrive, SegmentSetup, StationSetup, StatusMasks};
use yieldwall_bus::{BootError, HomingOrder};
use yieldwall_config as config;
use yieldwall_drives::profiles::{Identity, Quantity, Revisions};
use yieldwall_fieldbus::objects::Address;
use yieldwall_motion::guard::Device;

/// Share of a period after SYNC0 at which the input frame passes: inputs that are latched at SYNC0 are there by then.
const SYNC0_PHASE: u32 = 10;
/// Bits of the status of an ATI sensor (6010h): a channel beyond its range; gage broken, busy, hardware, calibration checksum.
///
/// # Source
/// Axia EtherCAT manual, table of status codes, as open drivers have it.
const OVERLOAD: u32 = 1 << 27 | 1 << 30;
const INVALID: u32 = 1 << 2 | 1 << 3 | 1 << 5 | 1 << 29;

/// How long before a cycle begins the drives sample what it reads: nothing on CAN, whose SYNC begins it.
pub fn sampled_before(rig: &config::Rig) -> Duration {
    match rig.segment_of_drives() {
        Some(_) => Duration::from_micros(rig.cycle.period_us.into()) / SYNC0_PHASE,
        None => Duration::ZERO,
    }
}

/// The segment of a rig whose drives are on it.
///
/// # Errors
/// Where parts of the configuration do not fit together.
pub fn segment(rig: &config::Rig) -> Result<SegmentSetup, AssemblyError> {
    segment_of(rig, [None; 2])
}

/// The same of drives that are brought up for homing, if they have an order.
pub(super) fn segment_of(rig: &config::Rig, homing: [Option<HomingOrder>; 2]) -> Result<SegmentSetup, AssemblyError> {
    let period = Duration::from_micros(rig.cycle.period_us.into());
    let acts = match rig.segment_of_drives().map(|bus| bus.outputs) {
        Some(config::OutputsAct::OnArrival) => Acts::OnArrival,
        _ => Acts::AtSync0,
    };
    let [left, right] = &rig.drives;
    let drives = [(Device::LeftDrive, left), (Device::RightDrive, right)];
    let mut stations = Vec::new();
    for ((device, drive), homing) in drives.into_iter().zip(homing) {
        let not_here = || AssemblyError::NoPosition(drive.name.clone());
        let (profile, limits) = (profile(&drive.profile)?, drive_limits(rig, &scaling(drive)?)?);
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
        stations.push(station.map_err(|failure| BootError {
            node_id: None,
            name: drive.name.clone(),
            step: "plan the process data",
            failure,
        })?);
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

/// The identity that a force sensor on a segment has to report.
pub fn segment_sensor() -> Identity {
    Identity { device_type: 0, vendor_id: 0x0000_0732, product_codes: vec![0x2648_3052], revisions: Revisions::Any }
}

/// A sensor with the objects of ATI's, by its own clock: 6000h counts, 6010h status, 6020h sample counter, 7010h control.
fn sensor(sensor: &config::Sensor) -> Result<StationSetup, AssemblyError> {
    let not_here = || AssemblyError::NoPosition("sensor".to_owned());
    let position = sensor.protocol.position().ok_or_else(not_here)?;
    let identity = segment_sensor();
    let mapped = |index, sub, quantity| Mapped { at: Address::new(index, sub), bits: 32, quantity, value: 0 };
    let channels = (1..).zip(Quantity::CHANNELS).map(|(sub, channel)| mapped(0x6000, sub, Some(channel)));
    let status = [mapped(0x6010, 0, Some(Quantity::Status)), mapped(0x6020, 0, Some(Quantity::SampleCounter))];
    let pdo = |index, entries| vec![ProcessData { index, is_fixed: true, entries }];
    // Control words of 0: the calibration that is in force, and no zero.
    let outputs = pdo(0x1601, vec![mapped(0x7010, 1, None), mapped(0x7010, 2, None)]);
    let inputs = pdo(0x1a00, channels.chain(status).collect());
    let waits = waits(&sensor.waits, None);
    let mut station = StationSetup::other(&sensor.name, Device::Sensor, position, identity, waits, [outputs, inputs]);
    station.status_masks = StatusMasks { overload: OVERLOAD, invalid: INVALID };
    Ok(station)
}
