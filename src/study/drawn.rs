//! Common helpers of studies that make and draw rigs and hands.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use nalgebra::Vector2;

use super::bench::BenchParameters;
use yieldwall_config as config;
use yieldwall_motion::fixture::{Fixture, Shape2};
use yieldwall_rig::simulated_arm;
use yieldwall_run::assembly::{planar_fixture, torque_servo};

/// Peak over mean speed of a way by minimum jerk.
pub(super) const PEAK: f64 = 1.875;

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
