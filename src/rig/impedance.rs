//! The impedance device: position in, force out, no bus.

use super::build;
use super::error::RigError;
use crate::config;
use crate::fixture::{Fixture, Shape3};
use crate::record::Row;
use crate::sim::hand::Hand;
use crate::sim::point_mass::{PointMass, PointMassParameters};
use nalgebra::Vector3;

/// A point mass in space under a fixture of the impedance type, with the hand on it. The force computed from the
/// position at a sample acts from that sample on, for one period.
pub struct ImpedanceRig {
    device: PointMass<3>,
    hand: Hand<3>,
    fixture: Fixture<Shape3, 3>,
    period_s: f64,
    longest_step_s: f64,
    sample: u64,
}

impl ImpedanceRig {
    /// A device at rest where the scene's hand starts. `fixture` stands in place of the device's own, `seed` in place
    /// of the scene's.
    ///
    /// # Errors
    /// Where parts of the configuration do not fit together.
    pub fn new(
        device: &config::ImpedanceDevice,
        scene: &config::Scene,
        fixture: &config::Fixture,
        seed: u64,
    ) -> Result<Self, RigError> {
        let period_s = f64::from(device.cycle.period_us) * 1e-6;
        let mut hand = build::hand::<3>(scene, seed)?;
        let start = hand.target(0.0).position_m;
        let parameters = PointMassParameters {
            mass_kg: device.plant.mass_kg.get(),
            damping_n_s_per_m: device.plant.damping_n_s_per_m.get(),
            position_resolution_m: device.plant.position_resolution_m.get(),
        };
        let device = PointMass::new(parameters, hand.mass_kg(), start)?;
        let mut fixture = build::spatial_fixture(fixture, period_s)?;
        fixture.reset(&device.reported_position_m())?;
        let step = scene.device_model.map(|model| model.plant_step_us);
        let step = step.ok_or_else(|| RigError::Mismatch("the scene has no `device_model`".into()))?;
        let longest_step_s = f64::from(step) * 1e-6;
        Ok(Self { device, hand, fixture, period_s, longest_step_s, sample: 0 })
    }

    /// One period.
    ///
    /// # Errors
    /// If the simulated device cannot go on.
    pub fn run_cycle(&mut self) -> Result<Row, RigError> {
        let time_s = self.sample as f64 * self.period_s;
        let tool: Vector3<f64> = self.device.position_m();
        let velocity = self.device.velocity_m_per_s();
        let step = self.fixture.step_impedance(&self.device.reported_position_m());
        let row = Row {
            time_s,
            tool_m: tool.into(),
            proxy_m: step.proxy.into(),
            tool_velocity_m_per_s: velocity.into(),
            force_n: step.force_n.into(),
            signed_distance_m: step.signed_distance_m,
            is_on_surface: step.is_on(),
            hold_counter: step.hold_count,
            is_impact: step.is_impact,
            ..Row::default()
        };
        self.sample += 1;
        let hand = &mut self.hand;
        let end_s = self.sample as f64 * self.period_s;
        self.device.advance_to(end_s, self.longest_step_s, step.force_n, |time, handle| hand.load(time, handle))?;
        Ok(row)
    }
}
