//! Outcomes on disk: a line of JSON for each seed, appended when it is finished.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::tally::Outcome;

/// Name of the file in the folder of a campaign.
const FILE: &str = "outcomes.jsonl";

/// Why results could not be kept.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The file cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A line in the middle of the file is no outcome.
    #[error("{}, line {line}: {source}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Why.
        source: serde_json::Error,
    },
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
pub struct Store {
    path: PathBuf,
    file: File,
}

impl Store {
    /// Opens the results in `folder`, which is made if it is missing, and reads what is finished. A last line without an
    /// end, as a program that was interrupted leaves it, is cut off.
    ///
    /// # Errors
    /// If the file cannot be read, written or understood, or holds runs of another length than `cycles`.
    pub fn open(folder: &Path, cycles: u32) -> Result<(Self, BTreeMap<u64, Outcome>), StoreError> {
        let path = folder.join(FILE);
        let fail = |source| StoreError::Io { path: path.clone(), source };
        std::fs::create_dir_all(folder).map_err(fail)?;
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path).map_err(fail)?;
        let mut finished = BTreeMap::new();
        let mut whole = 0u64;
        let mut reader = BufReader::new(&file);
        let mut line = Vec::new();
        for number in 1.. {
            line.clear();
            let length = reader.read_until(b'\n', &mut line).map_err(fail)?;
            if length == 0 || line.last() != Some(&b'\n') {
                break;
            }
            let outcome: Outcome = serde_json::from_slice(&line).map_err(|source| StoreError::Line {
                path: path.clone(),
                line: number,
                source,
            })?;
            if outcome.asked != cycles {
                return Err(StoreError::OtherLength { path: path.clone(), found: outcome.asked, asked: cycles });
            }
            finished.insert(outcome.seed, outcome);
            whole += length as u64;
        }
        file.set_len(whole).map_err(fail)?;
        file.seek(SeekFrom::Start(whole)).map_err(fail)?;
        Ok((Self { path, file }, finished))
    }

    /// Adds one line.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn add(&mut self, outcome: &Outcome) -> Result<(), StoreError> {
        let fail = |source| StoreError::Io { path: self.path.clone(), source };
        let mut line = serde_json::to_vec(outcome).map_err(|source| fail(source.into()))?;
        line.push(b'\n');
        // One call: a line is there or it is the last one.
        (&self.file).write_all(&line).map_err(fail)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Shipped, run_seed};
    use super::*;

    #[test]
    fn what_is_finished_is_found_again_and_a_torn_line_is_cut_off() {
        let folder = std::env::temp_dir().join(format!("yieldwall-store-{}", std::process::id()));
        let shipped = Shipped::load().unwrap();
        let outcome = run_seed(&shipped, 3, 50, None);
        let path = folder.join(FILE);
        {
            let (mut store, finished) = Store::open(&folder, 50).unwrap();
            assert!(finished.is_empty());
            store.add(&outcome).unwrap();
        }
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, [&whole[..], &whole[..whole.len() / 2]].concat()).unwrap();
        {
            let (mut store, finished) = Store::open(&folder, 50).unwrap();
            assert_eq!(finished.get(&3), Some(&outcome));
            store.add(&Outcome { seed: 4, ..outcome.clone() }).unwrap();
        }
        let (_, finished) = Store::open(&folder, 50).unwrap();
        assert_eq!(finished.keys().copied().collect::<Vec<_>>(), [3, 4]);
        assert!(matches!(Store::open(&folder, 51), Err(StoreError::OtherLength { found: 50, asked: 51, .. })));
        std::fs::write(&path, "{}\n").unwrap();
        assert!(matches!(Store::open(&folder, 50), Err(StoreError::Line { line: 1, .. })));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
