//! The tables in `docs/data`, and conditions on their rows.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::rc::Rc;

/// Longest first: the first that fits is taken.
pub(super) const COMPARISONS: [&str; 6] = ["<=", ">=", "!=", "<", ">", "="];

/// Why there is no value.
#[derive(Debug, PartialEq)]
pub(super) enum Why {
    /// A cell is empty.
    Missing(String),
    /// The formula makes no sense.
    Wrong(String),
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (Self::Missing(why) | Self::Wrong(why)) = self;
        f.write_str(why)
    }
}

pub(super) fn wrong<T>(why: impl Into<String>) -> Result<T, Why> {
    Err(Why::Wrong(why.into()))
}

/// `=` and `<=` hold for what differs by rounding alone: 1000 * 0.021 is not the number 21.
pub(super) fn holds(one: f64, comparison: &str, other: f64) -> bool {
    let are_equal = (one - other).abs() <= 1e-12 * other.abs();
    match comparison {
        "<" => one < other && !are_equal,
        "<=" => one < other || are_equal,
        ">" => one > other && !are_equal,
        ">=" => one > other || are_equal,
        "=" => are_equal,
        _ => !are_equal,
    }
}

/// A condition on a cell, such as `rule=N_wait` or `measured_kg>0.8*reference_kg`.
#[derive(Clone, Debug)]
pub(super) struct Condition {
    pub(super) column: String,
    comparison: &'static str,
    wanted: Wanted,
}

#[derive(Clone, Debug)]
enum Wanted {
    Text(String),
    Cell(f64, String),
}

impl Condition {
    /// `None`: the word is no condition.
    pub(super) fn parse(word: &str) -> Option<Self> {
        let at = word.find(['<', '>', '=', '!', '\'']).filter(|at| *at > 0)?;
        let comparison = COMPARISONS.into_iter().find(|comparison| word[at..].starts_with(comparison))?;
        let wanted = &word[at + comparison.len()..];
        let product = wanted.split_once('*').and_then(|(factor, column)| Some((factor.parse().ok()?, column)));
        let wanted = match product {
            Some((factor, column)) => Wanted::Cell(factor, column.to_owned()),
            None if wanted.is_empty() => return None,
            None => Wanted::Text(wanted.trim_matches('\'').to_owned()),
        };
        Some(Self { column: word[..at].to_owned(), comparison, wanted })
    }

    pub(super) fn equals(column: &str, text: &str) -> Self {
        Self { column: column.to_owned(), comparison: "=", wanted: Wanted::Text(text.to_owned()) }
    }

    /// With `period_ms=2*period_ms` a condition wants twice what the row at hand has, whose cell `own` reads.
    pub(super) fn of_row(&self, own: impl FnOnce(&str) -> Result<f64, Why>) -> Result<Self, Why> {
        let wanted = match &self.wanted {
            Wanted::Cell(factor, column) if *column == self.column => Wanted::Text((factor * own(column)?).to_string()),
            wanted => wanted.clone(),
        };
        Ok(Self { wanted, ..self.clone() })
    }

    fn is_met(&self, cell: &str, wanted: &str, factor: f64) -> bool {
        match (cell.parse(), wanted.parse::<f64>()) {
            (Ok(one), Ok(other)) => holds(one, self.comparison, factor * other),
            _ => match self.comparison {
                "=" => cell == wanted,
                "!=" => cell != wanted,
                _ => false,
            },
        }
    }
}

/// A table: names of its columns, and rows.
pub(super) struct Csv {
    pub(super) columns: Vec<String>,
    pub(super) rows: Vec<Vec<String>>,
}

impl Csv {
    /// Rows whose `index` does not count them from 0 are an error: one is missing, or stands twice.
    pub(super) fn parse(text: &str) -> Result<Self, Why> {
        let mut lines = text.lines().map(cells);
        let csv = Self { columns: lines.next().unwrap_or_default(), rows: lines.collect() };
        let Ok(place) = csv.place("index") else { return Ok(csv) };
        match csv.rows.iter().enumerate().find(|(row, cells)| cells.get(place) != Some(&row.to_string())) {
            None => Ok(csv),
            Some((row, _)) => wrong(format!("row {row} has another index")),
        }
    }

    pub(super) fn place(&self, column: &str) -> Result<usize, Why> {
        let place = self.columns.iter().position(|name| name == column);
        place.ok_or_else(|| Why::Wrong(format!("no column {column}")))
    }

    pub(super) fn cell(&self, row: usize, column: &str) -> Result<&str, Why> {
        let place = self.place(column)?;
        Ok(self.rows[row].get(place).map_or("", String::as_str))
    }

    pub(super) fn number(&self, row: usize, column: &str) -> Result<f64, Why> {
        match self.cell(row, column)? {
            "" => Err(Why::Missing(format!("an empty cell of {column}"))),
            cell => cell.parse().or_else(|_| wrong(format!("no number in {column}: {cell}"))),
        }
    }

    /// Those of some rows that meet all conditions.
    pub(super) fn meeting(&self, rows: &[usize], conditions: &[Condition]) -> Result<Vec<usize>, Why> {
        let mut rows = rows.to_vec();
        for condition in conditions {
            let place = self.place(&condition.column)?;
            let cell = |row: usize, place: usize| self.rows[row].get(place).map_or("", String::as_str);
            match &condition.wanted {
                Wanted::Text(text) => rows.retain(|row| condition.is_met(cell(*row, place), text, 1.0)),
                Wanted::Cell(factor, other) => {
                    let other = self.place(other)?;
                    rows.retain(|row| condition.is_met(cell(*row, place), cell(*row, other), *factor));
                }
            }
        }
        Ok(rows)
    }
}

/// The cells of a line of CSV.
fn cells(line: &str) -> Vec<String> {
    let (mut cells, mut is_quoted) = (vec![String::new()], false);
    for letter in line.chars() {
        match letter {
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => cells.push(String::new()),
            _ => cells.last_mut().expect("one at least").push(letter),
        }
    }
    cells
}

/// The tables that claims name.
pub(super) struct Tables {
    folder: PathBuf,
    read: BTreeMap<String, Rc<Csv>>,
}

impl Tables {
    pub(super) fn in_folder(folder: PathBuf) -> Self {
        Self { folder, read: BTreeMap::new() }
    }

    pub(super) fn table(&mut self, name: &str) -> Result<Rc<Csv>, Why> {
        if !self.read.contains_key(name) {
            let path = self.folder.join(format!("study-{name}.csv"));
            let text = std::fs::read_to_string(&path);
            let text = text.map_err(|error| Why::Wrong(format!("{}: {error}", path.display())))?;
            self.read.insert(name.to_owned(), Rc::new(Csv::parse(&text)?));
        }
        Ok(Rc::clone(&self.read[name]))
    }
}
