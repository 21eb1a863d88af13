//! The bus of a rig as its budget takes it.

use std::time::Duration;

use super::build;
use super::error::RigError;
use crate::bus::MasterSetup;
use crate::bus::budget::Conditions;
use crate::config;

/// The network of a rig and the conditions of the budget of each of its buses, in the order of their names: devices that
/// answer SYNC without delay, as the simulated ones do, and a host whose frames go out through one FIFO a bus. The bit rate
/// counts, also where the file has timing `ideal`.
///
/// # Errors
/// Where parts of the configuration do not fit together.
pub fn bus_plan(rig: &config::Rig) -> Result<(MasterSetup, Vec<Conditions>), RigError> {
    let conditions = (0..).zip(rig.buses.values()).map(|(bus, configured)| Conditions {
        bus,
        bit_rate: configured.bit_rate_bit_per_s,
        compute_at: Duration::from_micros(rig.cycle.compute_at_us.into()),
        device_delay: Duration::ZERO,
        has_release_jitter: true,
        has_fifo: true,
    });
    Ok((build::network(rig)?, conditions.collect()))
}
