//! Points on disk: a file for each table and shard, whose first line says what it belongs to.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;

use super::{Sweep, Table};
use yieldwall_rig::batch::{Lines, LinesError};

/// Why points could not be kept or read.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The file cannot be read, written or understood.
    #[error(transparent)]
    Lines(#[from] LinesError),
    /// The file is of another table, or of this one as another build of the program computes it.
    #[error("{} holds {found}, and {wanted} is asked for", path.display())]
    Other {
        /// The file.
        path: PathBuf,
        /// Heading of the file.
        found: String,
        /// Heading wanted.
        wanted: String,
    },
}

/// A line of the file.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    Table { name: String, points: u64, edition: String },
    Point { index: u64, cells: Vec<Value> },
}

/// Heading that a file must have.
struct Heading<'a> {
    name: &'a str,
    points: u64,
    edition: &'a str,
    takes_any: bool,
}

impl Heading<'_> {
    fn takes(&self, found: &Heading<'_>) -> bool {
        let is_edition = self.edition == found.edition;
        (self.name, self.points) == (found.name, found.points)
            && (is_edition || (self.takes_any && self.is_same_study(found)))
    }

    /// Whether both editions are the same except for the build: the first two words.
    fn is_same_study(&self, found: &Heading<'_>) -> bool {
        let [own, other] = [self.edition, found.edition].map(|edition| edition.splitn(3, ' ').nth(2));
        own == other
    }

    fn text(&self) -> String {
        format!("{} of {} points, {}", self.name, self.points, self.edition)
    }
}

/// The file of one table and shard, open for more points.
#[derive(Debug)]
pub struct Store(Lines);

impl Store {
    /// Reads the points of a sweep from all its files in `folder`, whichever shard left them, and opens the file of `shard` (a
    /// name in the file's name) for more. `edition` names everything on which the points depend besides the table itself: the
    /// word `build`, a name of the build of the program, and then anything else. If a table measures time and is not complete,
    /// its points are discarded: times of two runs must not be compared.
    ///
    /// # Errors
    /// If a file cannot be read, written or understood, or is of another table or another edition; `takes_any` is for
    /// points of another build alone.
    pub fn open(
        folder: &Path,
        sweep: &dyn Sweep,
        edition: &str,
        takes_any: bool,
        shard: &str,
    ) -> Result<(Self, Table), StoreError> {
        let wanted = Heading { name: sweep.name(), points: sweep.points(), edition, takes_any };
        let own = folder.join(format!("{}.{shard}.jsonl", wanted.name));
        let mut table = Table::new(sweep);
        let (mut lines, held) = Lines::open(&own)?;
        let mut is_empty = held.is_empty();
        take(&own, held, &wanted, &mut table)?;
        let others: Vec<_> = Lines::files(folder, wanted.name)?.into_iter().filter(|path| *path != own).collect();
        for path in &others {
            take(path, Lines::read(path)?, &wanted, &mut table)?;
        }
        if sweep.is_timed() && !table.missing().is_empty() {
            others.into_iter().try_for_each(remove)?;
            lines.clear()?;
            (is_empty, table) = (true, Table::new(sweep));
        }
        if is_empty {
            let Heading { name, points, edition, .. } = wanted;
            lines.add(&Line::Table { name: name.to_owned(), points, edition: edition.to_owned() })?;
        }
        Ok((Self(lines), table))
    }

    /// Reads the points of a sweep from all its files in `folder` and leaves them as they are.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub fn read(folder: &Path, sweep: &dyn Sweep, edition: &str, takes_any: bool) -> Result<Table, StoreError> {
        let wanted = Heading { name: sweep.name(), points: sweep.points(), edition, takes_any };
        let mut table = Table::new(sweep);
        for path in Lines::files(folder, wanted.name)? {
            take(&path, Lines::read(&path)?, &wanted, &mut table)?;
        }
        Ok(table)
    }

    /// Throws away all points of a sweep that `folder` holds, whichever shard left them; no folder is no error.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn discard(folder: &Path, sweep: &dyn Sweep) -> Result<(), StoreError> {
        Lines::files(folder, sweep.name())?.into_iter().try_for_each(remove)
    }

    /// Adds one point.
    ///
    /// # Errors
    /// As [`Lines::add`].
    pub fn add(&mut self, index: u64, cells: &[Value]) -> Result<(), StoreError> {
        Ok(self.0.add(&Line::Point { index, cells: cells.to_vec() })?)
    }
}

fn remove(path: PathBuf) -> Result<(), StoreError> {
    std::fs::remove_file(&path).map_err(|source| LinesError::Io { path, source }.into())
}

/// Puts the lines of a file into the table.
fn take(path: &Path, held: Vec<Line>, wanted: &Heading<'_>, table: &mut Table) -> Result<(), StoreError> {
    let other = |found: String| StoreError::Other { path: path.to_path_buf(), found, wanted: wanted.text() };
    for (number, line) in held.into_iter().enumerate() {
        match line {
            Line::Table { name, points, edition } => {
                let found = Heading { name: &name, points, edition: &edition, takes_any: false };
                if number > 0 || !wanted.takes(&found) {
                    return Err(other(found.text()));
                }
            }
            Line::Point { index, cells }
                if number > 0 && index < table.points && cells.len() == table.columns.len() =>
            {
                table.insert(index, cells);
            }
            Line::Point { index, .. } => return Err(other(format!("a point {index} that is not of the table"))),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::super::Clock;
    use super::*;

    struct Squares {
        is_timed: bool,
    }

    impl Sweep for Squares {
        fn name(&self) -> &str {
            "squares"
        }
        fn columns(&self) -> Vec<&str> {
            vec!["side_m", "area_m2"]
        }
        fn points(&self) -> u64 {
            10
        }
        fn is_timed(&self) -> bool {
            self.is_timed
        }
        fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
            let side = 0.1 * index as f64;
            vec![side.into(), (side * side).into()]
        }
    }

    /// A table whose points may be of several runs.
    const SQUARES: Squares = Squares { is_timed: false };

    fn compute(folder: &Path, shard: &str, numbers: impl Iterator<Item = u64>) {
        let (mut store, table) = Store::open(folder, &SQUARES, "build a", false, shard).unwrap();
        for index in numbers.filter(|index| table.missing().contains(index)) {
            store.add(index, &SQUARES.point(index, &|| Duration::ZERO)).unwrap();
        }
    }

    #[test]
    fn shards_together_are_the_whole_and_equal_it_bit_by_bit() {
        let folder = std::env::temp_dir().join(format!("yieldwall-sweep-{}", std::process::id()));
        compute(&folder.join("parts"), "1-of-2", (0..10).step_by(2));
        compute(&folder.join("parts"), "2-of-2", (1..9).step_by(2));
        let (_, table) = Store::open(&folder.join("parts"), &SQUARES, "build a", false, "all").unwrap();
        assert_eq!(table.missing(), [9]);
        compute(&folder.join("parts"), "all", 0..10);
        compute(&folder.join("whole"), "all", 0..10);
        let [parts, whole] = ["parts", "whole"]
            .map(|part| Store::open(&folder.join(part), &SQUARES, "build a", false, "all").unwrap().1);
        assert_eq!(parts.csv(), whole.csv());
        assert!(Store::open(&folder.join("whole"), &SQUARES, "build b", true, "all").is_ok());
        assert!(Store::open(&folder.join("whole"), &SQUARES, "build a of another rig", true, "all").is_err());
        let other = Store::open(&folder.join("whole"), &SQUARES, "build b", false, "all").unwrap_err();
        assert!(matches!(&other, StoreError::Other { found, .. } if found.ends_with("build a")), "{other}");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn times_of_an_interrupted_run_are_measured_anew() {
        let folder = std::env::temp_dir().join(format!("yieldwall-timed-{}", std::process::id()));
        let timed = Squares { is_timed: true };
        let open = || Store::open(&folder, &timed, "build a", false, "whole").unwrap();
        let (mut store, _) = open();
        for index in 0..9 {
            store.add(index, &timed.point(index, &|| Duration::ZERO)).unwrap();
        }
        drop(store);
        let (mut store, table) = open();
        assert_eq!(table.missing().len(), 10, "one was missing");
        for index in 0..10 {
            store.add(index, &timed.point(index, &|| Duration::ZERO)).unwrap();
        }
        drop(store);
        assert!(open().1.missing().is_empty(), "a whole table stays");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
