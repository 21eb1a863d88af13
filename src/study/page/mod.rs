//! `docs/studies.md` and `docs/study-tables.md`: studies write their findings and tables, from the tables in `docs/data`.
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
use super::{control, cycle, hold, literature, need, pair, plant, speed, stability, task};

/// Writes a block.
type Write = fn(&Tables<'_>) -> Result<String, PageError>;

/// Blocks, each with the study's name before the hyphen.
const BLOCKS: [(&str, Write); 22] = [
    ("control-rates", control::page::rates),
    ("control-findings", control::page::findings),
    ("cycle-rigs", cycle::page::rigs),
    ("cycle-findings", cycle::page::findings),
    ("hold-windows", hold::page::windows),
    ("hold-findings", hold::page::findings),
    ("literature-keemink", literature::page::keemink),
    ("literature-statements", literature::page::statements),
    ("literature-findings", literature::page::findings),
    ("need-models", need::page::models),
    ("need-findings", need::page::findings),
    ("need-terms", need::page::terms),
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

/// The pages, in the folder of the documentation: findings, and the tables behind them.
pub const PAGES: [&str; 2] = ["studies.md", "study-tables.md"];

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

/// Puts new blocks of a study into the pages, each into the page that has its marker, and returns the names of the blocks that changed.
/// Everything else stays as it is.
///
/// # Errors
/// The first block that cannot be written, or marker that is missing or there twice. The pages may then be changed in part.
pub fn refresh(pages: &mut [String], study: &dyn Study, folder: &Path) -> Result<Vec<&'static str>, PageError> {
    refresh_blocks(pages, study, folder, &BLOCKS)
}

fn refresh_blocks(
    pages: &mut [String],
    study: &dyn Study,
    folder: &Path,
    blocks: &[(&'static str, Write)],
) -> Result<Vec<&'static str>, PageError> {
    let prefix = format!("{}-", study.name());
    let known: Vec<_> = blocks.iter().filter(|(name, _)| name.starts_with(&prefix)).collect();
    let lines = pages.iter().flat_map(|page| page.lines());
    let found: Vec<_> = lines.filter_map(|line| line.strip_prefix(BEGIN)?.strip_suffix(" -->")).collect();
    let is_other = |name: &&&str| name.starts_with(&prefix) && known.iter().all(|(known, _)| *known != **name);
    if let Some(name) = found.iter().find(is_other) {
        return Err(PageError::Marker(format!("no study writes the block {name}")));
    }
    let mut changed = Vec::new();
    for &&(block, write) in &known {
        let text = write(&Tables { study, folder });
        let is_new = text.and_then(|text| put(pages, block, text.trim_end()));
        if is_new.map_err(|error| PageError::Block { block, error: Box::new(error) })? {
            changed.push(block);
        }
    }
    Ok(changed)
}

/// Writes a block where its marker is; whether that changes the page.
fn put(pages: &mut [String], name: &str, text: &str) -> Result<bool, PageError> {
    let marker = format!("{BEGIN}{name} -->");
    let mut with_marker = pages.iter_mut().filter(|page| page.contains(&marker));
    let (page, other) = (with_marker.next(), with_marker.next());
    let page = page.ok_or_else(|| PageError::Marker(format!("no page has the line {marker}")))?;
    if other.is_some() || page.matches(&marker).count() > 1 {
        return Err(PageError::Marker(format!("the line {marker} is there twice")));
    }
    let (before, rest) = page.split_once(&marker).unwrap_or((page, ""));
    let end = rest.find(END).filter(|end| !rest[..*end].contains(BEGIN));
    let end = end.ok_or_else(|| PageError::Marker(format!("the page has no line {END} behind {marker}")))?;
    let new = format!("{before}{marker}\n{text}\n{}", &rest[end..]);
    let is_new = new != *page;
    *page = new;
    Ok(is_new)
}

#[cfg(test)]
mod tests;
