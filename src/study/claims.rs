//! What `docs/studies.md` says is held against the tables in `docs/data`.
//!
//! A claim stands in a comment behind its sentence, and several are divided by semicolons:
//! ```text
//! <!-- claim: value(hold-impacts through place=wall rule=N_wait window_ms=0) > 0.9 * 3000; max(hold-pushes delay_max_s) < 0.6 -->
//! ```
//! `TERM [+ - * /] TERM ... COMPARISON ...`, from left to right, `*` and `/` first; or `... in LOW..HIGH`. A term is a number or one of
//! - `value(TABLE COLUMN CONDITION ...)`: the number in the one row that meets all conditions,
//! - `max(...)`, `min(...)`, `sum(...)`: of all rows that do, at least one,
//! - `count(TABLE CONDITION ...)`: how many do.
//!
//! A condition is `COLUMN` `=`, `!=`, `<`, `<=`, `>` or `>=` a word, a word in quotes or a number. Empty cells are `''`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Sections in which a bullet point without a claim is an error.
const CHECKED: [&str; 8] = ["control", "cycle", "energy", "hold", "pair", "plant", "speed", "task"];
const BEGIN: &str = "<!-- claim:";
const END: &str = "-->";
/// Longest first: the first that fits is taken.
const COMPARISONS: [&str; 6] = ["<=", ">=", "!=", "<", ">", "="];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs")
}

/// A table: names of its columns, and rows.
struct Csv {
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Csv {
    fn parse(text: &str) -> Self {
        let mut lines = text.lines().map(cells);
        Self { columns: lines.next().unwrap_or_default(), rows: lines.collect() }
    }

    fn place(&self, column: &str) -> Result<usize, String> {
        self.columns.iter().position(|name| name == column).ok_or(format!("no column {column}"))
    }

    fn meeting(&self, conditions: &[String]) -> Result<Vec<&Vec<String>>, String> {
        let mut rows: Vec<_> = self.rows.iter().collect();
        for condition in conditions {
            let (column, comparison, wanted) = split(condition).ok_or(format!("no condition: {condition}"))?;
            let (place, wanted) = (self.place(column)?, wanted.trim_matches('\''));
            rows.retain(|row| {
                let cell = row.get(place).map_or("", String::as_str);
                match (cell.parse::<f64>(), wanted.parse::<f64>()) {
                    (Ok(one), Ok(other)) => holds(one, comparison, other),
                    _ => match comparison {
                        "=" => cell == wanted,
                        "!=" => cell != wanted,
                        _ => false,
                    },
                }
            });
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

/// Left side, comparison, right side.
fn split(text: &str) -> Option<(&str, &str, &str)> {
    let at = text.find(['<', '>', '=', '!'])?;
    let comparison = COMPARISONS.into_iter().find(|comparison| text[at..].starts_with(comparison))?;
    Some((text[..at].trim(), comparison, text[at + comparison.len()..].trim()))
}

fn holds(one: f64, comparison: &str, other: f64) -> bool {
    match comparison {
        "<" => one < other,
        "<=" => one <= other,
        ">" => one > other,
        ">=" => one >= other,
        "=" => one == other,
        _ => one != other,
    }
}

/// The tables that claims name.
struct Tables {
    folder: PathBuf,
    read: BTreeMap<String, Csv>,
}

impl Tables {
    fn in_folder(folder: PathBuf) -> Self {
        Self { folder, read: BTreeMap::new() }
    }

    fn table(&mut self, name: &str) -> Result<&Csv, String> {
        if !self.read.contains_key(name) {
            let path = self.folder.join(format!("study-{name}.csv"));
            let text = std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
            self.read.insert(name.to_owned(), Csv::parse(&text));
        }
        Ok(&self.read[name])
    }

    /// A call such as `max(TABLE COLUMN CONDITION ...)`.
    fn call(&mut self, function: &str, inside: &str) -> Result<f64, String> {
        let mut words = words(inside).into_iter();
        let table = self.table(&words.next().ok_or("no table")?)?;
        if function == "count" {
            return Ok(table.meeting(&words.collect::<Vec<_>>())?.len() as f64);
        }
        let place = table.place(&words.next().ok_or("no column")?)?;
        let rows = table.meeting(&words.collect::<Vec<_>>())?;
        let number = |row: &&Vec<String>| row[place].parse().map_err(|_| format!("no number in {function}({inside})"));
        let numbers = rows.iter().map(number).collect::<Result<Vec<f64>, _>>()?;
        match (function, numbers.as_slice()) {
            (_, []) => Err(format!("no row meets {function}({inside})")),
            ("value", [one]) => Ok(*one),
            ("value", all) => Err(format!("{} rows meet value({inside})", all.len())),
            ("max", all) => Ok(all.iter().copied().fold(f64::NEG_INFINITY, f64::max)),
            ("min", all) => Ok(all.iter().copied().fold(f64::INFINITY, f64::min)),
            ("sum", all) => Ok(all.iter().sum()),
            _ => Err(format!("no function {function}")),
        }
    }

    /// A number or a call.
    fn term(&mut self, text: &str) -> Result<f64, String> {
        let text = text.trim();
        match text.strip_suffix(')').and_then(|text| text.split_once('(')) {
            Some((function, inside)) => self.call(function.trim(), inside),
            None => text.parse().map_err(|_| format!("no number: {text:?}")),
        }
    }

    /// Terms with operators between them, each between blanks.
    fn sum(&mut self, text: &str) -> Result<f64, String> {
        let (mut sum, mut product, mut sign, mut operator) = (0.0, 1.0, 1.0, "*");
        for part in parts(text) {
            match part.as_str() {
                "+" | "-" => {
                    sum += sign * product;
                    (product, sign, operator) = (1.0, if part == "+" { 1.0 } else { -1.0 }, "*");
                }
                "*" => operator = "*",
                "/" => operator = "/",
                term if operator == "*" => product *= self.term(term)?,
                term => product /= self.term(term)?,
            }
        }
        Ok(sum + sign * product)
    }

    /// Why a claim does not hold; `None` if it does.
    fn refute(&mut self, claim: &str) -> Option<String> {
        let found = match top(claim) {
            Some((left, "in", right)) => right.split_once("..").ok_or("no range".to_owned()).and_then(|(low, high)| {
                let (value, low, high) = (self.sum(left)?, self.sum(low)?, self.sum(high)?);
                Ok(((low..=high).contains(&value), format!("{value} in {low}..{high}")))
            }),
            Some((left, comparison, right)) => self.sum(left).and_then(|one| {
                let other = self.sum(right)?;
                Ok((holds(one, comparison, other), format!("{one} {comparison} {other}")))
            }),
            None => Err("nothing is compared".to_owned()),
        };
        match found {
            Ok((true, _)) => None,
            Ok((false, values)) => Some(format!("{claim}: {values}")),
            Err(why) => Some(format!("{claim}: {why}")),
        }
    }
}

/// Words between blanks; what stands in quotes is one.
fn words(text: &str) -> Vec<String> {
    let (mut words, mut is_quoted) = (vec![String::new()], false);
    for letter in text.chars() {
        is_quoted ^= letter == '\'';
        if letter == ' ' && !is_quoted {
            words.push(String::new());
        } else {
            words.last_mut().expect("one at least").push(letter);
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Terms and operators: words, but a call with all that it holds is one.
fn parts(text: &str) -> Vec<String> {
    let mut parts: Vec<String> = Vec::new();
    for word in words(text) {
        match parts.last_mut() {
            Some(part) if part.contains('(') && !part.ends_with(')') => *part += &format!(" {word}"),
            _ => parts.push(word),
        }
    }
    parts
}

/// The comparison outside of all calls, and what stands on its sides.
fn top(claim: &str) -> Option<(&str, &str, &str)> {
    let mut depth = 0;
    for (at, letter) in claim.char_indices() {
        match letter {
            '(' => depth += 1,
            ')' => depth -= 1,
            _ if depth > 0 => {}
            '<' | '>' | '=' | '!' => {
                let (_, comparison, right) = split(&claim[at..])?;
                return Some((&claim[..at], comparison, right));
            }
            ' ' if claim[at..].starts_with(" in ") => return Some((&claim[..at], "in", &claim[at + 4..])),
            _ => {}
        }
    }
    None
}

/// All that is wrong with a page, a line each.
fn refuted(name: &str, page: &str, tables: &mut Tables) -> (usize, Vec<String>) {
    let (mut count, mut wrong) = (0, Vec::new());
    let (mut section, mut unproved): (&str, Option<usize>) = ("", None);
    let bare = |unproved: &mut Option<usize>, wrong: &mut Vec<String>| {
        wrong.extend(unproved.take().map(|line| format!("{name}:{line}: no claim stands behind this point")));
    };
    for (index, line) in page.lines().enumerate() {
        let number = index + 1;
        if let Some(heading) = line.strip_prefix("## ") {
            bare(&mut unproved, &mut wrong);
            section = heading;
        }
        if CHECKED.contains(&section) && line.starts_with("- ") {
            bare(&mut unproved, &mut wrong);
            unproved = Some(number);
        }
        let Some((_, rest)) = line.split_once(BEGIN) else { continue };
        let Some((claims, _)) = rest.split_once(END) else {
            wrong.push(format!("{name}:{number}: a claim has to end in its line"));
            continue;
        };
        unproved = None;
        for claim in claims.split(';').map(str::trim) {
            count += 1;
            wrong.extend(tables.refute(claim).map(|why| format!("{name}:{number}: {why}")));
        }
    }
    bare(&mut unproved, &mut wrong);
    (count, wrong)
}

#[test]
fn what_the_studies_are_said_to_show_stands_in_their_tables() {
    let page = std::fs::read_to_string(root().join("studies.md")).unwrap();
    let (count, wrong) = refuted("docs/studies.md", &page, &mut Tables::in_folder(root().join("data")));
    assert!(wrong.is_empty(), "{} of {count} claims do not hold:\n{}", wrong.len(), wrong.join("\n"));
    for section in CHECKED {
        assert!(page.contains(&format!("\n## {section}\n")), "no section {section}");
    }
    assert!(count >= 20, "{count} claims are left");
}

#[test]
fn a_claim_that_does_not_hold_is_told_with_its_line() {
    let folder = std::env::temp_dir().join(format!("yieldwall-claims-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let csv = "index,law,grip,error_m\n0,plastic,little damped,0.5\n1,\"spring, cut\",soft,2\n2,plastic,,4\n";
    std::fs::write(folder.join("study-small.csv"), csv).unwrap();
    let mut tables = Tables::in_folder(folder.clone());
    let right = [
        "value(small error_m law=plastic grip='little damped') = 0.5",
        "2 * max(small error_m) - 1 + 6 / 3 > 8.9",
        "sum(small error_m law=plastic) in 4.4..4.6",
        "min(small error_m index>=1) = value(small error_m law='spring, cut')",
        "count(small grip='') + count(small grip!='') = 3",
        "10 - 2 * 3 - 1 = 3",
    ];
    for claim in right {
        assert_eq!(tables.refute(claim), None);
    }
    let wrong = [
        ("value(small error_m index=2) < 4", "4 < 4"),
        ("max(small error_m) in 4.1..5", "4 in 4.1..5"),
        ("value(small error_m law=plastic) > 0", "2 rows meet"),
        ("max(small error_m index>7) > 0", "no row meets"),
        ("max(small error_mm) > 0", "no column error_mm"),
        ("max(small error_m gripp=soft) > 0", "no column gripp"),
        ("max(small grip) > 0", "no number in"),
        ("max(large error_m) > 0", "study-large.csv"),
        ("mean(small error_m) > 0", "no function mean"),
        ("max(small error_m)", "nothing is compared"),
        ("some > 0", "no number"),
    ];
    for (claim, why) in wrong {
        let told = tables.refute(claim).unwrap_or_else(|| panic!("{claim} holds"));
        assert!(told.contains(why), "{told}");
    }
    let page =
        "## hold\n\n- One.\n  <!-- claim: 1 < 2; 2 < 1 -->\n- Two.\n- Three. <!-- claim: 3 = 3 -->\n## edge\n- Four.\n";
    let (count, wrong) = refuted("page.md", page, &mut tables);
    assert_eq!(count, 3);
    assert_eq!(wrong, ["page.md:4: 2 < 1: 2 < 1", "page.md:5: no claim stands behind this point"]);
    std::fs::remove_dir_all(&folder).unwrap();
}
