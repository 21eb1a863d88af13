//! All that is known of one sample of an impedance device.

use super::Row;

/// Reports of a simulated impedance device at one sample, and the results of its fixture. Lengths and forces are in the base frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeviceRecord {
    /// Number of the sample, from 0.
    pub index: u64,
    /// Its moment in ns since the scene began.
    pub sample_ns: u64,
    /// Time of the sample in s since the scene began.
    pub scene_time_s: f64,
    /// Position of the handle as the device reports it, in m.
    pub reported_m: [f64; 3],
    /// The proxy in m.
    pub proxy_m: [f64; 3],
    /// Force of the actuators on the handle from this sample on, in N.
    pub force_n: [f64; 3],
    /// Distance of the proxy from the surface in m, negative on the forbidden side.
    pub signed_distance_m: f64,
    /// Whether the fixture keeps the proxy on the surface.
    pub is_on_surface: bool,
    /// Samples for which the proxy is still held.
    pub hold_counter: u32,
    /// Whether the proxy met the surface at this sample.
    pub is_impact: bool,
    /// Position of the handle in the simulation, in m.
    pub true_position_m: [f64; 3],
    /// Velocity of the handle in the simulation, in m/s.
    pub true_velocity_m_per_s: [f64; 3],
}

impl DeviceRecord {
    /// Returns the row that figures and measures read.
    pub fn row(&self) -> Row {
        Row {
            time_s: self.scene_time_s,
            tool_m: self.true_position_m,
            proxy_m: self.proxy_m,
            tool_velocity_m_per_s: self.true_velocity_m_per_s,
            force_n: self.force_n,
            signed_distance_m: self.signed_distance_m,
            is_on_surface: self.is_on_surface,
            hold_counter: self.hold_counter,
            is_impact: self.is_impact,
            ..Row::default()
        }
    }
}
