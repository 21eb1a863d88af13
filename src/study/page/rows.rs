//! Selected rows of a table, relations between them, and Markdown.

use serde_json::Value;

use super::PageError;
use crate::sweep::{Row, Table};

/// Ranges of rows that are named one by one.
const MOST_RANGES: usize = 8;

/// Rows of a table, and the words for which ones they are.
#[derive(Clone, Debug)]
pub(crate) struct Rows<'a> {
    what: String,
    rows: Vec<Row<'a>>,
}

impl Table {
    /// All rows.
    pub(crate) fn all(&self) -> Rows<'_> {
        Rows { what: format!("table {}", self.name), rows: self.rows().collect() }
    }
}

/// Compares a cell with a value. Empty cells are `null` and an empty word; whole numbers and others are alike.
fn is(cell: &Value, value: &Value) -> bool {
    match (cell.as_f64(), value.as_f64()) {
        (Some(cell), Some(value)) => cell == value,
        _ => cell == value || (cell.is_null() && value == "") || (cell == "" && value.is_null()),
    }
}

impl<'a> Rows<'a> {
    /// The rows that have this value in a column.
    #[must_use]
    pub(crate) fn with(&self, column: &str, value: impl Into<Value>) -> Self {
        let value = value.into();
        self.filter(&format!("{column} = {value}"), |row| is(row.cell(column), &value))
    }

    /// The rows that meet a condition; `what` names it.
    #[must_use]
    pub(crate) fn filter(&self, what: &str, meets: impl Fn(&Row<'a>) -> bool) -> Self {
        let rows = self.rows.iter().filter(|row| meets(row)).copied().collect();
        Self { what: format!("{}, {what}", self.what), rows }
    }

    /// The rows.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Row<'a>> {
        self.rows.iter()
    }

    /// Number of rows.
    pub(crate) fn count(&self) -> usize {
        self.rows.len()
    }

    /// The rows, as a reader finds them in the table: its name and the numbers, as ranges; of many the number of rows and the ends.
    pub(crate) fn places(&self) -> String {
        let mut ranges: Vec<[u64; 2]> = Vec::new();
        for row in &self.rows {
            match ranges.last_mut().filter(|range| range[1] + 1 == row.index) {
                Some(range) => range[1] = row.index,
                None => ranges.push([row.index; 2]),
            }
        }
        let table = self.rows.first().map_or("", |row| row.table());
        let range =
            |[first, last]: &[u64; 2]| if first == last { first.to_string() } else { format!("{first} to {last}") };
        match ranges.as_slice() {
            [[first, _], .., [_, last]] if ranges.len() > MOST_RANGES => {
                format!("`{table}`, {} rows from {first} to {last}", self.rows.len())
            }
            ranges => format!("`{table}` {}", ranges.iter().map(range).collect::<Vec<_>>().join(", ")),
        }
    }

    /// The one row that is left.
    pub(crate) fn one(&self) -> Result<Row<'a>, PageError> {
        match self.rows.as_slice() {
            [row] => Ok(*row),
            rows => Err(PageError::Rows(format!("{} rows of {}, one is wanted", rows.len(), self.what))),
        }
    }

    /// The number in a column of the one row that is left.
    pub(crate) fn number(&self, column: &str) -> Result<f64, PageError> {
        self.one()?;
        Ok(self.numbers(column)?[0])
    }

    /// The numbers in a column, at least one.
    pub(crate) fn numbers(&self, column: &str) -> Result<Vec<f64>, PageError> {
        if self.rows.is_empty() {
            return Err(PageError::Rows(format!("no row of {}", self.what)));
        }
        let number = |row: &Row<'_>| {
            let number = row.number(column);
            if number.is_finite() {
                Ok(number)
            } else {
                Err(PageError::Rows(format!("no {column} in row {}", row.place())))
            }
        };
        self.rows.iter().map(number).collect()
    }

    /// The least number in a column.
    pub(crate) fn least(&self, column: &str) -> Result<f64, PageError> {
        Ok(self.numbers(column)?.into_iter().fold(f64::INFINITY, f64::min))
    }

    /// The greatest number in a column.
    pub(crate) fn greatest(&self, column: &str) -> Result<f64, PageError> {
        Ok(self.numbers(column)?.into_iter().fold(f64::NEG_INFINITY, f64::max))
    }

    /// Checks a relation in every row, at least one. A comparison with a cell that has no number does not hold.
    pub(crate) fn check(&self, relation: &str, holds: impl Fn(&Row<'a>) -> bool) -> Result<(), PageError> {
        if self.rows.is_empty() {
            return Err(PageError::Rows(format!("no row of {}", self.what)));
        }
        let broken = self.filter(relation, |row| !holds(row));
        self::relation(broken.rows.is_empty(), relation, &broken.rows)
    }
}

/// Checks a relation between rows.
pub(crate) fn relation<'a>(
    holds: bool,
    relation: &str,
    rows: impl IntoIterator<Item = &'a Row<'a>>,
) -> Result<(), PageError> {
    let places: Vec<_> = rows.into_iter().map(Row::place).collect();
    if holds { Ok(()) } else { Err(PageError::NotShown { relation: relation.to_owned(), rows: places.join(", ") }) }
}

/// A number with so many significant digits, at least one, without an exponent.
pub(crate) fn digits(value: f64, count: usize) -> String {
    let rounded = format!("{value:.*e}", count.saturating_sub(1));
    let exponent: i32 = rounded.split_once('e').and_then(|(_, exponent)| exponent.parse().ok()).unwrap_or(0);
    let places = count as i32 - 1 - exponent;
    match usize::try_from(places) {
        Ok(places) => format!("{value:.places$}"),
        Err(_) => format!("{:.0}", rounded.parse().unwrap_or(value)),
    }
}

/// A length in a unit near its size. A share of a unit from `from` on is rounded up to one.
pub(crate) fn in_unit(value_m: f64, from: f64) -> (f64, &'static str) {
    let units = [(1.0, "m"), (1e-3, "mm"), (1e-6, "um"), (1e-9, "nm"), (1e-12, "pm")];
    let (unit_m, unit) = units.into_iter().find(|(unit_m, _)| value_m.abs() >= from * unit_m).unwrap_or((1e-15, "fm"));
    (value_m / unit_m, unit)
}

/// A length with two significant digits and its unit.
pub(crate) fn length(value_m: f64) -> String {
    let (value, unit) = in_unit(value_m, 0.995);
    if value_m == 0.0 { "0".to_owned() } else { format!("{} {unit}", digits(value, 2)) }
}

/// A table in Markdown.
pub(crate) fn markdown<H: AsRef<str>>(head: &[H], rows: &[Vec<String>]) -> String {
    let line = |cells: Vec<&str>| format!("| {} |\n", cells.join(" | "));
    let rule = format!("|{}\n", "---|".repeat(head.len()));
    let body: String = rows.iter().map(|row| line(row.iter().map(String::as_str).collect())).collect();
    line(head.iter().map(AsRef::as_ref).collect()) + &rule + &body
}

/// A list in Markdown.
pub(crate) fn bullets(points: &[String]) -> String {
    points.iter().map(|point| format!("- {point}\n")).collect()
}
