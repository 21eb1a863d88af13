//! Outcomes on disk: a line of JSON for each seed, in a file for each part of a campaign.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::tally::SeedResult;
use yieldwall_rig::batch::{Lines, LinesError, Shard};

/// Name of the files in the folder of a campaign, without ending.
const FILE: &str = "outcomes";

/// Why results could not be kept.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The file cannot be read, written or understood.
    #[error(transparent)]
    Lines(#[from] LinesError),
    /// The file is of runs of another length.
    #[error("{} holds runs of {found} cycles, and {asked} are asked for", path.display())]
    OtherLength {
        /// The file.
        path: PathBuf,
        /// Cycles of its runs.
        found: u32,
        /// Cycles that are asked for.
        asked: u32,
    },
}

/// The results file of a campaign.
#[derive(Debug)]
pub struct Store(Lines);

impl Store {
    /// Opens the results of a part in `folder`, which is made if it is missing, and reads what is finished, in whichever part.
    ///
    /// # Errors
    /// As [`Lines::open`], and if a file holds runs of another length than `cycles`.
    pub fn open(
        folder: &Path,
        cycles: u32,
        shard: Option<Shard>,
    ) -> Result<(Self, BTreeMap<u64, SeedResult>), StoreError> {
        let part = shard.map_or_else(String::new, |shard| format!(".{}", shard.name()));
        let (lines, _) = Lines::open::<SeedResult>(&folder.join(format!("{FILE}{part}.jsonl")))?;
        Ok((Self(lines), Self::read(folder, cycles)?))
    }

    /// Reads the results of all parts in `folder` without changing them; none if there is no such folder.
    ///
    /// # Errors
    /// As [`Lines::read`], and if a file holds runs of another length than `cycles`.
    pub fn read(folder: &Path, cycles: u32) -> Result<BTreeMap<u64, SeedResult>, StoreError> {
        let mut all = BTreeMap::new();
        for path in Lines::files(folder, FILE)? {
            let outcomes = Lines::read::<SeedResult>(&path)?;
            if let Some(other) = outcomes.iter().find(|outcome| outcome.asked != cycles) {
                return Err(StoreError::OtherLength { path, found: other.asked, asked: cycles });
            }
            all.extend(outcomes.into_iter().map(|outcome| (outcome.seed, outcome)));
        }
        Ok(all)
    }

    /// Adds one outcome.
    ///
    /// # Errors
    /// As [`Lines::add`].
    pub fn add(&mut self, outcome: &SeedResult) -> Result<(), StoreError> {
        Ok(self.0.add(outcome)?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Shipped, run_seed};
    use super::*;

    #[test]
    fn outcomes_are_found_again_and_those_of_another_length_refused() {
        let folder = std::env::temp_dir().join(format!("yieldwall-store-{}", std::process::id()));
        let outcome = run_seed(&Shipped::load().unwrap(), 3, 50, None);
        {
            let (mut store, finished) = Store::open(&folder, 50, None).unwrap();
            assert!(finished.is_empty());
            store.add(&outcome).unwrap();
            store.add(&SeedResult { seed: 4, ..outcome.clone() }).unwrap();
        }
        let (_, finished) = Store::open(&folder, 50, None).unwrap();
        assert_eq!(finished.keys().copied().collect::<Vec<_>>(), [3, 4]);
        assert_eq!(finished.get(&3), Some(&outcome));
        assert!(matches!(Store::open(&folder, 51, None), Err(StoreError::OtherLength { found: 50, asked: 51, .. })));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
