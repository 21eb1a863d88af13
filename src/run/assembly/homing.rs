//! Drives that find their reference by themselves: their homing orders, and the meaning of their positions before homing.

use super::error::AssemblyError;
use super::{profile, scaling};
use yieldwall_bus::{AxisSetup, HomingOrder};
use yieldwall_config as config;
use yieldwall_drives::scaling::wrap;

/// Time in which a joint that homes comes up to its rate, s.
pub const HOMING_COMES_UP_S: f64 = 0.2;

/// Returns the interpretation of a drive's positions, near this angle in rad.
pub(super) fn axis(drive: &config::Drive, expected_rad: f64) -> Result<AxisSetup, AssemblyError> {
    let model = profile(&drive.profile)?;
    let homing = model.servo().and_then(|servo| servo.homing.clone());
    let home = homing.zip(drive.homing.map(|homing| homing.angle_rad.get()));
    Ok(AxisSetup { scaling: scaling(drive)?, expected_rad, home })
}

/// Returns the homing orders of both drives.
///
/// # Errors
/// If one has no `homing` in the rig.
pub(super) fn orders(rig: &config::Rig) -> Result<[HomingOrder; 2], AssemblyError> {
    let [left, right] = &rig.drives;
    Ok([order(left)?, order(right)?])
}

fn order(drive: &config::Drive) -> Result<HomingOrder, AssemblyError> {
    let none = || AssemblyError::NoHoming(drive.name.clone());
    let homing = drive.homing.ok_or_else(none)?;
    let scaling = scaling(drive)?;
    let counts = |rate: f64| (rate * scaling.counts_per_rad()).round().clamp(1.0, f64::from(i32::MAX)) as u32;
    let rate = homing.rate_rad_per_s.get();
    Ok(HomingOrder {
        method: homing.method,
        speed_counts_per_s: counts(rate),
        acceleration_counts_per_s2: counts(rate / HOMING_COMES_UP_S),
        position_at_home: wrap(scaling.counts(homing.angle_rad.get())?),
    })
}
