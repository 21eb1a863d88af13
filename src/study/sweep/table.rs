//! Tables of results.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde_json::{Map, Value};

use super::super::chart::Estimate;
use super::Sweep;

/// The cells of a line of CSV.
fn cells(line: &str) -> Vec<String> {
    let (mut cells, mut is_quoted) = (vec![String::new()], false);
    let mut letters = line.chars().peekable();
    while let Some(letter) = letters.next() {
        match letter {
            '"' if is_quoted && letters.next_if_eq(&'"').is_some() => {
                cells.last_mut().into_iter().for_each(|cell| cell.push('"'))
            }
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => cells.push(String::new()),
            _ => cells.last_mut().into_iter().for_each(|cell| cell.push(letter)),
        }
    }
    cells
}

/// Content of a cell: nothing, a number, a truth value or a word.
fn value(cell: &str) -> Value {
    let number = serde_json::from_str(cell).ok().filter(|value: &Value| value.is_number() || value.is_boolean());
    number.unwrap_or_else(|| if cell.is_empty() { Value::Null } else { cell.into() })
}

/// The points of a table that have been computed.
#[derive(Clone, Debug)]
pub struct Table {
    /// Its name.
    pub name: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Number of points when all are there.
    pub points: u64,
    pub(super) cells: BTreeMap<u64, Vec<Value>>,
}

/// One point of a table.
#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    /// Number of the point.
    pub index: u64,
    table: &'a str,
    columns: &'a [String],
    cells: &'a [Value],
}

impl Table {
    /// A table without points.
    pub fn new(sweep: &dyn Sweep) -> Self {
        let columns = sweep.columns().into_iter().map(str::to_owned).collect();
        Self { name: sweep.name().to_owned(), columns, points: sweep.points(), cells: BTreeMap::new() }
    }

    /// Takes a point in.
    ///
    /// # Panics
    /// If there are not as many cells as columns: a mistake of the study.
    pub fn insert(&mut self, index: u64, cells: Vec<Value>) {
        assert_eq!(cells.len(), self.columns.len(), "cells of point {index} of {}", self.name);
        self.cells.insert(index, cells);
    }

    /// The points, by number.
    pub fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        self.cells.iter().map(|(&index, cells)| Row { index, table: &self.name, columns: &self.columns, cells })
    }

    /// Numbers of the points that have not been computed.
    pub fn missing(&self) -> Vec<u64> {
        (0..self.points).filter(|index| !self.cells.contains_key(index)).collect()
    }

    /// Returns the rows as CSV with a line of names: the number of the point, then its columns. Missing cells are empty.
    pub fn csv(&self) -> String {
        let mut text = format!("index,{}\n", self.columns.join(","));
        for row in self.rows() {
            // Writing to a string does not fail.
            let _ = write!(text, "{}", row.index);
            for cell in row.cells {
                let _ = match cell {
                    Value::Null => write!(text, ","),
                    Value::String(word) if word.contains([',', '"', '\n']) => {
                        write!(text, ",\"{}\"", word.replace('"', "\"\""))
                    }
                    Value::String(word) => write!(text, ",{word}"),
                    other => write!(text, ",{other}"),
                };
            }
            text.push('\n');
        }
        text
    }

    /// Reads what [`Table::csv`] writes of all points, and of further ones that another program has added.
    ///
    /// # Errors
    /// The first mistake.
    pub fn from_csv(sweep: &dyn Sweep, text: &str) -> Result<Self, String> {
        let mut table = Self::new(sweep);
        let mut lines = (1..).zip(text.lines());
        let found = cells(lines.next().map_or("", |(_, line)| line));
        let wanted: Vec<&str> = ["index"].into_iter().chain(table.columns.iter().map(String::as_str)).collect();
        if let Some(column) = wanted.iter().find(|column| !found.iter().any(|name| name == *column)) {
            return Err(format!("the first line has no column {column}"));
        }
        if found != wanted {
            return Err(format!("the first line is not {}", wanted.join(",")));
        }
        for (index, (line, text)) in (0..).zip(lines) {
            let texts = cells(text);
            if texts[0] != index.to_string() || texts.len() != wanted.len() {
                return Err(format!("line {line} is not point {index} with {} cells", wanted.len()));
            }
            if let Some(place) =
                texts.iter().position(|text| text.parse::<f64>().is_ok_and(|number| !number.is_finite()))
            {
                return Err(format!(
                    "line {line} has {} in column {}, where a number or an empty cell belongs",
                    texts[place], wanted[place]
                ));
            }
            table.cells.insert(index, texts.iter().skip(1).map(|text| value(text)).collect());
        }
        let found = table.cells.len() as u64;
        if found < table.points {
            return Err(format!("{found} of {} points are there", table.points));
        }
        table.points = found;
        Ok(table)
    }

    /// The rows as JSON objects.
    pub fn json(&self) -> Value {
        self.rows().map(|row| row.json()).collect()
    }
}

impl<'a> Row<'a> {
    /// Name of the table.
    pub fn table(&self) -> &'a str {
        self.table
    }

    /// Returns the cell of a column; `null` if the study has no such column.
    pub fn cell(&self, column: &str) -> &'a Value {
        let place = self.columns.iter().position(|name| *name == column);
        assert!(cfg!(not(test)) || place.is_some(), "no column {column}");
        place.and_then(|place| self.cells.get(place)).unwrap_or(&Value::Null)
    }

    /// A number; NaN where there is none.
    pub fn number(&self, column: &str) -> f64 {
        self.cell(column).as_f64().unwrap_or(f64::NAN)
    }

    /// A number of one column with the ends of its interval from two more, all times a factor.
    pub fn estimate(&self, columns: [&str; 3], factor: f64) -> Estimate {
        let [value, low, high] = columns.map(|column| factor * self.number(column));
        Estimate { value, low, high }
    }

    /// A word; empty where there is none.
    pub fn word(&self, column: &str) -> &'a str {
        self.cell(column).as_str().unwrap_or("")
    }

    /// Whether a column says so.
    pub fn is(&self, column: &str) -> bool {
        self.cell(column).as_bool().unwrap_or(false)
    }

    /// The table and the number of the point, as `--point` takes them.
    pub fn place(&self) -> String {
        format!("{}:{}", self.table, self.index)
    }

    /// The command that computes this point of a study again, alone.
    pub fn command(&self, study: &str) -> String {
        format!("yieldwall study {study} --point {}", self.place())
    }

    /// The point as an object, with its number.
    pub fn json(&self) -> Value {
        let cells = self.columns.iter().zip(self.cells).map(|(name, cell)| (name.clone(), cell.clone()));
        let index = [("index".to_owned(), Value::from(self.index))];
        Value::Object(index.into_iter().chain(cells).collect::<Map<_, _>>())
    }
}

#[cfg(test)]
mod tests {
    use super::super::Clock;
    use super::*;

    struct Halves;

    impl Sweep for Halves {
        fn name(&self) -> &str {
            "halves"
        }
        fn columns(&self) -> Vec<&str> {
            vec!["whole_m", "half_m", "remark"]
        }
        fn points(&self) -> u64 {
            3
        }
        fn point(&self, index: u64, _: Clock<'_>) -> Vec<Value> {
            let half = if index == 2 { f64::NAN } else { index as f64 / 2.0 };
            vec![index.into(), half.into(), Value::from("so, \"so\"")]
        }
    }

    fn whole() -> Table {
        let mut table = Table::new(&Halves);
        (0..3).for_each(|index| table.insert(index, Halves.point(index, &|| std::time::Duration::ZERO)));
        table
    }

    #[test]
    fn a_table_comes_back_from_its_csv_or_with_the_first_mistake_in_it() {
        let csv = whole().csv();
        let back = Table::from_csv(&Halves, &csv).unwrap();
        assert_eq!((back.csv(), back.json()), (csv.clone(), whole().json()));
        let mistakes = [
            ("half_m", "half_mm", "the first line has no column half_m"),
            ("remark", "remark,more", "the first line is not index,whole_m,half_m,remark"),
            ("2,2,,", "3,2,,", "line 4 is not point 2 with 4 cells"),
            ("2,2,,", "2,2,", "line 4 is not point 2 with 4 cells"),
            ("0.5", "NaN", "line 3 has NaN in column half_m, where a number or an empty cell belongs"),
            ("0.5", "1e999", "line 3 has 1e999 in column half_m, where a number or an empty cell belongs"),
            ("2,2,,\"so, \"\"so\"\"\"\n", "", "2 of 3 points are there"),
        ];
        for (right, wrong, mistake) in mistakes {
            assert_eq!(Table::from_csv(&Halves, &csv.replacen(right, wrong, 1)).unwrap_err(), mistake);
        }
    }

    #[test]
    fn a_table_is_read_by_names_and_written_as_csv_and_json() {
        let mut table = Table::new(&Halves);
        for index in [2, 0] {
            table.insert(index, Halves.point(index, &|| std::time::Duration::ZERO));
        }
        assert_eq!(table.missing(), [1]);
        let csv = "index,whole_m,half_m,remark\n0,0,0.0,\"so, \"\"so\"\"\"\n2,2,,\"so, \"\"so\"\"\"\n";
        assert_eq!(table.csv(), csv);
        let rows: Vec<Row<'_>> = table.rows().collect();
        assert_eq!(rows[1].command("shares"), "yieldwall study shares --point halves:2");
        assert_eq!(rows[0].number("half_m"), 0.0);
        assert!(rows[1].number("half_m").is_nan());
        assert_eq!(rows[1].word("remark"), "so, \"so\"");
        assert_eq!(table.json()[1]["half_m"], Value::Null);
        assert_eq!(table.json()[0]["index"], 0);
    }
}
