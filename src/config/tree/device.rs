//! An impedance device: a point mass in space.

use garde::Validate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::fixture::Fixture;
use crate::number::{NotNegative, Positive};

/// An impedance device [KTF08, IV-A]: a back-drivable device, modelled as a point mass in space. Its position is measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct ImpedanceDevice {
    /// Name of the device.
    #[garde(dive)]
    pub device: DeviceIdentity,
    /// Timing of the control.
    #[garde(dive)]
    pub cycle: DeviceCycle,
    /// The virtual fixture; its coupling is `impedance`, its surface lies in space.
    #[garde(dive)]
    pub fixture: Fixture,
    /// Machine model of the embedded simulation.
    #[garde(dive)]
    pub plant: DevicePlant,
    /// File with the scene to run, relative to this file.
    #[garde(length(min = 1))]
    pub scene: String,
}

/// Identity of an impedance device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct DeviceIdentity {
    /// Name for reports and figures.
    #[garde(length(min = 1))]
    pub name: String,
}

/// Timing of an impedance device.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct DeviceCycle {
    /// T in us: sampling interval. 100 to 100 000.
    #[garde(range(min = 100, max = 100_000))]
    pub period_us: u32,
}

/// Mechanics of an impedance device.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct DevicePlant {
    /// Moving mass, kg. Above 0.
    #[garde(dive)]
    pub mass_kg: Positive,
    /// Viscous damping, N s/m. 0 or above.
    #[garde(dive)]
    pub damping_n_s_per_m: NotNegative,
    /// Step of the measured position, m. 0 for an exact measurement.
    #[garde(dive)]
    pub position_resolution_m: NotNegative,
}
