//! Outcomes on disk: a line of JSON for each seed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::tally::SeedResult;
use yieldwall_rig::batch::{Lines, LinesError};

/// Name of the file in the folder of a campaign.
const FILE: &str = "outcomes.jsonl";

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
    /// Opens the results in `folder`, which is made if it is missing, and reads what is finished.
    ///
    /// # Errors
    /// As [`Lines::open`], and if the file holds runs of another length than `cycles`.
    pub fn open(folder: &Path, cycles: u32) -> Result<(Self, BTreeMap<u64, SeedResult>), StoreError> {
        let path = folder.join(FILE);
        let (lines, outcomes) = Lines::open::<SeedResult>(&path)?;
        match outcomes.iter().find(|outcome| outcome.asked != cycles) {
            Some(other) => Err(StoreError::OtherLength { path, found: other.asked, asked: cycles }),
            None => Ok((Self(lines), outcomes.into_iter().map(|outcome| (outcome.seed, outcome)).collect())),
        }
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
            let (mut store, finished) = Store::open(&folder, 50).unwrap();
            assert!(finished.is_empty());
            store.add(&outcome).unwrap();
            store.add(&SeedResult { seed: 4, ..outcome.clone() }).unwrap();
        }
        let (_, finished) = Store::open(&folder, 50).unwrap();
        assert_eq!(finished.keys().copied().collect::<Vec<_>>(), [3, 4]);
        assert_eq!(finished.get(&3), Some(&outcome));
        assert!(matches!(Store::open(&folder, 51), Err(StoreError::OtherLength { found: 50, asked: 51, .. })));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
