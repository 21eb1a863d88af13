//! Many seeds on several threads.

use std::collections::BTreeMap;
use std::ops::Range;

use super::draw::Shipped;
use super::seed::run_seed;
use super::store::{Store, StoreError};
use super::tally::SeedResult;
use yieldwall_rig::batch;

/// What is run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Campaign {
    /// The seeds.
    pub seeds: Range<u64>,
    /// Cycles of each.
    pub cycles: u32,
    /// Threads, at least one.
    pub jobs: usize,
}

/// Runs all seeds that `store` does not hold yet, each on the next thread that is free, and gives all outcomes by seed.
/// `progress` is called with every outcome that is new, in the order in which they finish.
///
/// # Errors
/// If an outcome cannot be kept; what is running then comes to its end.
pub fn run(
    shipped: &Shipped,
    campaign: &Campaign,
    store: Option<(Store, BTreeMap<u64, SeedResult>)>,
    mut progress: impl FnMut(&SeedResult),
) -> Result<BTreeMap<u64, SeedResult>, StoreError> {
    let (mut store, known) = store.map_or((None, BTreeMap::new()), |(store, known)| (Some(store), known));
    let mut outcomes: BTreeMap<u64, SeedResult> =
        known.into_iter().filter(|(seed, _)| campaign.seeds.contains(seed)).collect();
    let left: Vec<u64> = campaign.seeds.clone().filter(|seed| !outcomes.contains_key(seed)).collect();
    let work = |seed| run_seed(shipped, seed, campaign.cycles, None);
    batch::run(&left, campaign.jobs, work, |seed, outcome| {
        if let Some(store) = &mut store {
            store.add(&outcome)?;
        }
        progress(&outcome);
        outcomes.insert(seed, outcome);
        Ok::<_, StoreError>(())
    })?;
    Ok(outcomes)
}
