//! `docs/studies.md`: studies write its tables and findings, from the tables in `docs/data`.
//!
//! ```text
//! <!-- begin: hold-windows -->
//! | rule, window | usual grips | ..
//! <!-- end -->
//! ```
//! A block is the Markdown between two markers. A function of one study returns it, or an error where the tables do not show a
//! relation that its text states. Text outside the markers is written by hand.

mod rows;

pub(crate) use rows::{Rows, bullets, digits, in_unit, length, markdown, relation};

use std::path::{Path, PathBuf};

use thiserror::Error;

use super::sweep::{Study, Table};
use super::{ablation, control, cycle, hold, pair, plant, speed, stability, task};

/// Writes a block.
type Write = fn(&Tables<'_>) -> Result<String, PageError>;

/// Blocks, each with the study's name before the hyphen.
const BLOCKS: [(&str, Write); 17] = [
    ("ablation-terms", ablation::page::terms),
    ("control-rates", control::page::rates),
    ("control-findings", control::page::findings),
    ("cycle-rigs", cycle::page::rigs),
    ("cycle-findings", cycle::page::findings),
    ("hold-windows", hold::page::windows),
    ("hold-findings", hold::page::findings),
    ("pair-delays", pair::page::delays),
    ("pair-findings", pair::page::findings),
    ("plant-methods", plant::page::methods),
    ("plant-findings", plant::page::findings),
    ("speed-widths", speed::page::widths),
    ("speed-findings", speed::page::findings),
    ("stability-masses", stability::page::masses),
    ("stability-findings", stability::page::findings),
    ("task-errors", task::page::errors),
    ("task-findings", task::page::findings),
];

const BEGIN: &str = "<!-- begin: ";
const END: &str = "<!-- end -->";

/// Reason why a page cannot be written.
#[derive(Debug, Error)]
pub enum PageError {
    /// A table cannot be read, or is none of this study.
    #[error("{}: {why}", path.display())]
    Table {
        /// File of the table.
        path: PathBuf,
        /// File of the table within the results of `study`.
        from: String,
        /// The first mistake.
        why: String,
    },
    /// The tables lack rows or numbers that a block looks for.
    #[error("{0}")]
    Rows(String),
    /// The tables do not show what a block states.
    #[error("the tables do not show that {relation}: rows {rows}")]
    NotShown {
        /// The relation.
        relation: String,
        /// The rows that break it, as `--point` takes them.
        rows: String,
    },
    /// The page has no place for a block, or a place for a block that no study writes.
    #[error("{0}")]
    Marker(String),
    /// A block could not be written.
    #[error("block {block}: {error}")]
    Block {
        /// The block.
        block: &'static str,
        /// Reason.
        error: Box<PageError>,
    },
}

/// The tables of a study in a folder.
#[derive(Clone, Copy)]
pub(crate) struct Tables<'a> {
    study: &'a dyn Study,
    folder: &'a Path,
}

impl Tables<'_> {
    /// All points of a table: `FOLDER/study-STUDY-TABLE.csv`, or `FOLDER/study-STUDY.csv` if it has the name of the study.
    pub(crate) fn read(&self, name: &str) -> Result<Table, PageError> {
        let study = self.study.name();
        let sweep = self.study.sweeps().iter().find(|sweep| sweep.name() == name);
        let sweep = sweep.ok_or_else(|| PageError::Rows(format!("{study} has no table {name}")))?;
        let file = if name == study { format!("study-{study}.csv") } else { format!("study-{study}-{name}.csv") };
        let (path, from) = (self.folder.join(file), format!("{study}/{name}.csv"));
        let text = std::fs::read_to_string(&path).map_err(|error| error.to_string());
        text.and_then(|text| Table::from_csv(sweep.as_ref(), &text)).map_err(|why| PageError::Table { path, from, why })
    }
}

/// A page with new blocks of a study, and the names of the blocks that changed. Everything else stays as it is.
///
/// # Errors
/// The first block that cannot be written, or marker that is missing.
pub fn refresh(page: &str, study: &dyn Study, folder: &Path) -> Result<(String, Vec<&'static str>), PageError> {
    refresh_blocks(page, study, folder, &BLOCKS)
}

fn refresh_blocks(
    page: &str,
    study: &dyn Study,
    folder: &Path,
    blocks: &[(&'static str, Write)],
) -> Result<(String, Vec<&'static str>), PageError> {
    let prefix = format!("{}-", study.name());
    let known: Vec<_> = blocks.iter().filter(|(name, _)| name.starts_with(&prefix)).collect();
    let found = page.lines().filter_map(|line| line.strip_prefix(BEGIN)?.strip_suffix(" -->"));
    let mut other = found.filter(|name| name.starts_with(&prefix) && known.iter().all(|(known, _)| known != name));
    if let Some(name) = other.next() {
        return Err(PageError::Marker(format!("no study writes the block {name}")));
    }
    let (mut page, mut changed) = (page.to_owned(), Vec::new());
    for &&(block, write) in &known {
        let text = write(&Tables { study, folder });
        let new = text.and_then(|text| with_block(&page, block, text.trim_end()));
        let new = new.map_err(|error| PageError::Block { block, error: Box::new(error) })?;
        if new != page {
            changed.push(block);
        }
        page = new;
    }
    Ok((page, changed))
}

fn with_block(page: &str, name: &str, text: &str) -> Result<String, PageError> {
    let marker = format!("{BEGIN}{name} -->");
    let missing = |what: &str| PageError::Marker(format!("the page has no line {what}"));
    let (before, rest) = page.split_once(&marker).ok_or_else(|| missing(&marker))?;
    let end = rest.find(END).filter(|end| !rest[..*end].contains(BEGIN));
    let after = &rest[end.ok_or_else(|| missing(&format!("{END} behind {marker}")))?..];
    Ok(format!("{before}{marker}\n{text}\n{after}"))
}

#[cfg(test)]
mod tests;
