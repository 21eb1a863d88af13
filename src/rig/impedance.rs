//! The impedance device: position in, force out, no bus.

use super::error::RigError;
use yieldwall_config as config;
use yieldwall_motion::fixture::{Fixture, Shape3};
use yieldwall_record::DeviceRecord;
use yieldwall_run::assembly;
use yieldwall_sim::hand::Hand;
use yieldwall_sim::point_mass::{PointMass, PointMassParameters};

/// The fixture of an impedance device, from a reported position to the force of its actuators.
pub struct ImpedanceLoop(Fixture<Shape3, 3>);

impl ImpedanceLoop {
    /// Creates a loop that begins at a reported position. `fixture` replaces the device's own.
    ///
    /// # Errors
    /// Where the fixture cannot be built, or cannot begin there.
    pub fn new(
        device: &config::ImpedanceDevice,
        fixture: &config::Fixture,
        reported_m: [f64; 3],
    ) -> Result<Self, RigError> {
        let mut fixture = assembly::spatial_fixture(fixture, f64::from(device.cycle.period_us) * 1e-6)?;
        fixture.reset(&reported_m.into())?;
        Ok(Self(fixture))
    }

    /// Computes one sample: the report of `record`, with the response of the fixture.
    pub fn step(&mut self, record: &DeviceRecord) -> DeviceRecord {
        let step = self.0.step_impedance(&record.reported_m.into());
        DeviceRecord {
            proxy_m: step.proxy.into(),
            force_n: step.force_n.into(),
            signed_distance_m: step.signed_distance_m,
            is_on_surface: step.is_on(),
            hold_counter: step.hold_count,
            is_impact: step.is_impact,
            ..*record
        }
    }
}

/// A point mass in space under a fixture of the impedance type, with the hand on it. The force computed from the
/// position at a sample acts from that sample on, for one period.
pub struct ImpedanceRig {
    device: PointMass<3>,
    hand: Hand<3>,
    control: ImpedanceLoop,
    period_s: f64,
    longest_step_s: f64,
    sample: u64,
}

impl ImpedanceRig {
    /// Creates a device at rest where the scene's hand starts. `fixture` replaces the device's own, `seed` the scene's.
    ///
    /// # Errors
    /// If parts of the configuration do not fit together.
    pub fn new(
        config: &config::ImpedanceDevice,
        scene: &config::Scene,
        fixture: &config::Fixture,
        seed: u64,
    ) -> Result<Self, RigError> {
        let period_s = f64::from(config.cycle.period_us) * 1e-6;
        let mut hand = super::hand::hand::<3>(scene, seed)?;
        let start = hand.target(0.0).position_m;
        let parameters = PointMassParameters {
            mass_kg: config.plant.mass_kg.get(),
            damping_n_s_per_m: config.plant.damping_n_s_per_m.get(),
            position_resolution_m: config.plant.position_resolution_m.get(),
        };
        let device = PointMass::new(parameters, hand.mass_kg(), start)?;
        let control = ImpedanceLoop::new(config, fixture, device.reported_position_m().into())?;
        let step = scene.device_model.map(|model| model.plant_step_us);
        let step = step.ok_or(RigError::NoModel("device_model"))?;
        let longest_step_s = f64::from(step) * 1e-6;
        Ok(Self { device, hand, control, period_s, longest_step_s, sample: 0 })
    }

    /// Runs one period.
    ///
    /// # Errors
    /// If the simulated device cannot go on.
    pub fn run_cycle(&mut self) -> Result<DeviceRecord, RigError> {
        let time_s = self.sample as f64 * self.period_s;
        let record = self.control.step(&DeviceRecord {
            index: self.sample,
            sample_ns: (time_s * 1e9).round() as u64,
            scene_time_s: time_s,
            reported_m: self.device.reported_position_m().into(),
            true_position_m: self.device.position_m().into(),
            true_velocity_m_per_s: self.device.velocity_m_per_s().into(),
            ..DeviceRecord::default()
        });
        self.sample += 1;
        let hand = &mut self.hand;
        let end_s = self.sample as f64 * self.period_s;
        let force_n = record.force_n.into();
        self.device.advance_to(end_s, self.longest_step_s, force_n, |time, handle| hand.load(time, handle))?;
        Ok(record)
    }
}
