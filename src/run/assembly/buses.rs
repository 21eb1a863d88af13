//! The buses of a rig: which is which, and what their budgets take.

use std::time::Duration;

use super::error::AssemblyError;
use super::network;
use yieldwall_bus::MasterSetup;
use yieldwall_bus::budget::Conditions;
use yieldwall_config as config;
use yieldwall_fieldbus::canopen::BusId;

/// Returns the network of a rig on CAN and the conditions for the budget of each CAN bus, in the order of the bus names. The budget
/// assumes devices that answer SYNC without delay, as the simulated ones do, and a host that sends through one FIFO per bus. The
/// bit rate counts even if the simulation has timing `ideal`.
///
/// # Errors
/// If parts of the configuration do not fit together, and for a rig without CAN.
pub fn bus_plan(rig: &config::Rig) -> Result<(MasterSetup, Vec<Conditions>), AssemblyError> {
    let conditions = BusId::all().zip(rig.buses.values()).filter_map(|(bus, configured)| {
        Some(Conditions {
            bus,
            bit_rate: configured.canopen()?.bit_rate_bit_per_s,
            compute_at: Duration::from_micros(rig.cycle.compute_at_us.into()),
            device_delay: Duration::ZERO,
            has_release_jitter: true,
            has_fifo: true,
        })
    });
    Ok((network(rig)?, conditions.collect()))
}

/// Returns the bus of this name: its number is its place among the names.
///
/// # Errors
/// If there is no bus of this name.
pub fn bus_id(rig: &config::Rig, name: &str) -> Result<BusId, AssemblyError> {
    let found = BusId::all().zip(rig.buses.keys()).find(|(_, known)| *known == name).map(|(bus, _)| bus);
    found.ok_or_else(|| AssemblyError::NoBus(name.to_owned()))
}

/// Returns the buses of the left drive, the right drive and the sensor.
///
/// # Errors
/// If one is not among `buses`.
pub fn device_buses(rig: &config::Rig) -> Result<[BusId; 3], AssemblyError> {
    let [left, right] = &rig.drives;
    Ok([bus_id(rig, &left.bus)?, bus_id(rig, &right.bus)?, bus_id(rig, &rig.sensor.bus)?])
}

/// Returns the bus that is an EtherCAT segment, if there is one.
///
/// # Errors
/// As [`bus_id`].
pub fn segment_bus(rig: &config::Rig) -> Result<Option<BusId>, AssemblyError> {
    let segment = rig.buses.iter().find(|(_, bus)| bus.canopen().is_none());
    segment.map(|(name, _)| bus_id(rig, name)).transpose()
}
