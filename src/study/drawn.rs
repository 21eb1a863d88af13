//! What studies make and draw rigs and hands with.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use nalgebra::Vector2;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::SeedableRng;

use super::bench::BenchParameters;
use yieldwall_config as config;
use yieldwall_motion::elementary;
use yieldwall_motion::fixture::{Fixture, Shape2};
use yieldwall_rig::simulated_arm;
use yieldwall_run::assembly::{planar_fixture, torque_servo};
use yieldwall_sim::share_of_one;

/// Peak over mean speed of a way by minimum jerk.
pub(super) const PEAK: f64 = 1.875;

/// A stream of random numbers. The same seed: the same numbers.
pub(super) struct Dice(SplitMix64);

impl Dice {
    pub(super) fn new(seed: u64) -> Self {
        Self(SplitMix64::seed_from_u64(seed))
    }

    /// Evenly.
    pub(super) fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * share_of_one(&mut self.0)
    }

    /// Evenly in the logarithm.
    pub(super) fn log_between(&mut self, least: f64, most: f64) -> f64 {
        least * elementary::powf(most / least, share_of_one(&mut self.0))
    }

    pub(super) fn chance(&mut self, probability: f64) -> bool {
        share_of_one(&mut self.0) < probability
    }

    pub(super) fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[(share_of_one(&mut self.0) * choices.len() as f64) as usize]
    }
}

pub(super) fn positive(value: f64) -> config::Positive {
    config::Positive::new(value).unwrap_or_else(|| unreachable!("{value} is above zero"))
}

pub(super) fn not_negative(value: f64) -> config::NotNegative {
    config::NotNegative::new(value).unwrap_or_else(|| unreachable!("{value} is zero or above"))
}

pub(super) fn finite(value: f64) -> config::Finite {
    config::Finite::new(value).unwrap_or_else(|| unreachable!("{value} is finite"))
}

/// Shipped rigs with their scenes, by their names.
type Shipped = BTreeMap<String, (config::Rig, config::Scene)>;

/// A shipped rig and its scene. Each is read once: to read the files takes a tenth of a run.
///
/// # Errors
/// If a file is refused.
pub(super) fn shipped(name: &str) -> Result<(config::Rig, config::Scene), String> {
    static READ: Mutex<Shipped> = Mutex::new(BTreeMap::new());
    let mut read = READ.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = read.get(name) {
        return Ok(known.clone());
    }
    let source = config::builtin(name);
    let rig = config::load_rig(source).map_err(|report| report.to_string())?;
    let scene = rig.scene().map_err(|report| report.to_string())?.value;
    read.insert(name.to_owned(), (rig.value.clone(), scene.clone()));
    Ok((rig.value, scene))
}

/// The bench of a rig in torque mode, its tool at rest at `start_m`, and its fixture: torques act a cycle late, and forces are as old.
///
/// # Errors
/// If the rig's numbers do not fit together.
pub(super) fn bench(
    rig: &config::Rig,
    scene: &config::Scene,
    start_m: Vector2<f64>,
    plant_step_s: f64,
) -> Result<(BenchParameters, Fixture<Shape2, 2>), String> {
    let period_s = 1e-6 * f64::from(rig.cycle.period_us);
    let parameters = BenchParameters {
        arm: simulated_arm(rig, scene).map_err(|error| error.to_string())?,
        start_m,
        period_s,
        plant_step_s,
        servo: torque_servo(rig).map_err(|error| error.to_string())?,
        delay_cycles: 1,
        low_pass: None,
    };
    let fixture = planar_fixture(&rig.fixture, period_s).map_err(|error| error.to_string())?;
    Ok((parameters, fixture))
}
