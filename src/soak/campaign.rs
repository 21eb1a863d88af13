//! Many seeds on several threads.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::atomic::AtomicBool;

use super::draw::Shipped;
use super::seed::run_seed;
use super::store::{Store, StoreError};
use super::tally::SeedResult;
use yieldwall_rig::batch::{self, Shard};

/// Parameters of a campaign.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Campaign {
    /// The seeds.
    pub seeds: Range<u64>,
    /// The part of them that is run; all of them if `None`.
    pub shard: Option<Shard>,
    /// Cycles of each.
    pub cycles: u32,
    /// Threads, at least one.
    pub jobs: usize,
}

impl Campaign {
    /// Whether a seed is run.
    pub fn holds(&self, seed: u64) -> bool {
        self.seeds.contains(&seed) && self.shard.is_none_or(|shard| shard.holds(seed))
    }

    /// Returns the seeds that are run and have no outcome yet.
    pub fn missing(&self, outcomes: &BTreeMap<u64, SeedResult>) -> Vec<u64> {
        self.seeds.clone().filter(|seed| self.holds(*seed) && !outcomes.contains_key(seed)).collect()
    }
}

/// Runs all seeds of the campaign that `store` does not hold yet, each on the next thread that is free, and gives their outcomes by seed.
/// `progress` is called with every outcome that is new, in the order in which they finish. Once `is_stopped` is set no seed begins;
/// those that run are finished and kept, and [`Campaign::missing`] gives the others.
///
/// # Errors
/// If an outcome cannot be kept; what is running then comes to its end.
pub fn run(
    shipped: &Shipped,
    campaign: &Campaign,
    store: Option<(Store, BTreeMap<u64, SeedResult>)>,
    is_stopped: &AtomicBool,
    mut progress: impl FnMut(&SeedResult),
) -> Result<BTreeMap<u64, SeedResult>, StoreError> {
    let (mut store, known) = store.map_or((None, BTreeMap::new()), |(store, known)| (Some(store), known));
    let mut outcomes: BTreeMap<u64, SeedResult> = known.into_iter().filter(|(seed, _)| campaign.holds(*seed)).collect();
    let left = campaign.missing(&outcomes);
    let work = |seed| run_seed(shipped, seed, campaign.cycles, None);
    batch::run(&left, campaign.jobs, is_stopped, work, |seed, outcome| {
        if let Some(store) = &mut store {
            store.add(&outcome)?;
        }
        progress(&outcome);
        outcomes.insert(seed, outcome);
        Ok::<_, StoreError>(())
    })?;
    Ok(outcomes)
}
