//! What studies make and draw rigs and hands with.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::SeedableRng;

use crate::config;
use crate::elementary;
use crate::sim::share_of_one;

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
