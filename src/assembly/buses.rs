//! The buses of a rig: their numbers, and what their budgets take.

use std::time::Duration;

use super::error::AssemblyError;
use super::network;
use crate::bus::MasterSetup;
use crate::bus::budget::Conditions;
use crate::config;

/// The network of a rig and the conditions of the budget of each of its buses, in the order of their names: devices that
/// answer SYNC without delay, as the simulated ones do, and a host whose frames go out through one FIFO a bus. The bit rate
/// counts, also where the simulation has timing `ideal`.
///
/// # Errors
/// Where parts of the configuration do not fit together.
pub fn bus_plan(rig: &config::Rig) -> Result<(MasterSetup, Vec<Conditions>), AssemblyError> {
    let conditions = (0..).zip(rig.buses.values()).map(|(bus, configured)| Conditions {
        bus,
        bit_rate: configured.canopen.bit_rate_bit_per_s,
        compute_at: Duration::from_micros(rig.cycle.compute_at_us.into()),
        device_delay: Duration::ZERO,
        has_release_jitter: true,
        has_fifo: true,
    });
    Ok((network(rig)?, conditions.collect()))
}

/// Number of a bus: its place among the names.
///
/// # Errors
/// If there is no bus of this name.
pub fn bus_number(rig: &config::Rig, name: &str) -> Result<u8, AssemblyError> {
    let at = rig.buses.keys().position(|bus| bus == name).and_then(|at| u8::try_from(at).ok());
    at.ok_or_else(|| AssemblyError::Mismatch(format!("`buses` has no bus named {name}")))
}

/// Numbers of the buses of the left drive, the right drive and the sensor.
///
/// # Errors
/// If one is not among `buses`.
pub fn device_buses(rig: &config::Rig) -> Result<[u8; 3], AssemblyError> {
    let [left, right] = &rig.drives;
    Ok([bus_number(rig, &left.bus)?, bus_number(rig, &right.bus)?, bus_number(rig, &rig.sensor.bus)?])
}
