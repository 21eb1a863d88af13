//! Tables of the page, each cell of which is held against a formula.

use super::formula::{Printed, Scope, parts, value, words};
use super::tables::{Condition, Tables, Why, wrong};

/// A part of the comment above a table: for which rows or columns it is, and what it says of them.
struct Line {
    /// Text of the key cells of a row, or of a heading.
    pattern: String,
    conditions: Vec<String>,
    formulas: Vec<String>,
}

/// What the comments above a table say.
#[derive(Default)]
struct Layout {
    scope: Scope,
    formulas: Vec<String>,
    /// Numbers that may stand behind `<` and `>`.
    limits: Vec<String>,
    corner: Option<Line>,
    heads: Vec<Line>,
    rows: Vec<Line>,
    columns: Vec<Line>,
}

impl Layout {
    fn read(text: &str, tables: &mut Tables) -> Result<Self, Why> {
        let mut layout = Self::default();
        for part in parts(text, ";") {
            let (left, formulas) = match parts(part.trim(), ": ").as_slice() {
                [left, formulas] => (words(left), parts(formulas, ", ").into_iter().map(str::to_owned).collect()),
                _ => (words(part), Vec::new()),
            };
            let [kind, rest @ ..] = left.as_slice() else { return wrong("an empty part") };
            let line = |words: &[String]| match words {
                [pattern, conditions @ ..] => Ok(Line {
                    pattern: pattern.trim_matches('\'').to_owned(),
                    conditions: conditions.to_vec(),
                    formulas: formulas.clone(),
                }),
                [] => wrong(format!("{kind} of what?")),
            };
            match kind.as_str() {
                "corner" => layout.corner = Some(line(rest)?),
                "limits" => layout.limits = rest.to_vec(),
                "head" => layout.heads.push(line(rest)?),
                "row" => layout.rows.push(line(rest)?),
                "column" => layout.columns.push(line(rest)?),
                table => {
                    layout.scope = Scope::of(table, conditions(rest, &[])?, tables)?;
                    layout.formulas = formulas;
                }
            }
        }
        Ok(layout)
    }
}

/// Conditions of words in which `{name}` stands for what a pattern has found.
fn conditions(words: &[String], found: &[(String, String)]) -> Result<Vec<Condition>, Why> {
    let read = |word: &String| {
        let word = found.iter().fold(word.clone(), |word, (name, text)| word.replace(&format!("{{{name}}}"), text));
        Condition::parse(&word).ok_or(Why::Wrong(format!("no condition: {word}")))
    };
    words.iter().map(read).collect()
}

/// What stands for the `{names}` of a pattern in a text; `None` if the text is another one.
fn matched(pattern: &str, text: &str) -> Option<Vec<(String, String)>> {
    let Some((before, rest)) = pattern.split_once('{') else { return (pattern == text).then(Vec::new) };
    let (name, after) = rest.split_once('}')?;
    let text = text.strip_prefix(before)?;
    text.char_indices().skip(1).map(|(at, _)| at).chain([text.len()]).filter(|end| *end > 0).find_map(|end| {
        let mut found = matched(after, &text[end..])?;
        found.push((name.to_owned(), text[..end].to_owned()));
        Some(found)
    })
}

impl Line {
    /// The scope for what this line is about; `None` if it is about something else.
    fn scope(&self, text: &str, scope: &Scope, tables: &mut Tables) -> Option<Result<Scope, Why>> {
        let found = matched(&self.pattern, text)?;
        Some(conditions(&self.conditions, &found).and_then(|mut all| {
            let csv = tables.table(&scope.table)?;
            let named = found.iter().filter(|(name, _)| csv.columns.contains(name));
            all.extend(named.map(|(name, text)| Condition::equals(name, text)));
            scope.with(&all, tables)
        }))
    }

    fn width(&self) -> usize {
        self.pattern.split(" | ").count()
    }
}

/// The cells of a line of the page; blanks that divide thousands are left out.
fn cells(line: &str) -> Vec<String> {
    let line = line.trim();
    let line = line.strip_prefix('|').unwrap_or(line);
    let line = line.strip_suffix('|').unwrap_or(line);
    line.split('|').map(|cell| without_gaps(cell.trim())).collect()
}

fn without_gaps(text: &str) -> String {
    let bytes = text.as_bytes();
    let is_digit = |at: usize| bytes.get(at).is_some_and(u8::is_ascii_digit);
    let is_gap = |at: usize| at > 0 && is_digit(at - 1) && (1..4).all(|step| is_digit(at + step)) && !is_digit(at + 4);
    text.char_indices().filter(|(at, letter)| *letter != ' ' || !is_gap(*at)).map(|(_, letter)| letter).collect()
}

/// A number in a cell, with `<` or `>` before it and its unit.
struct Found {
    text: String,
    sign: Option<char>,
    printed: Printed,
    unit: String,
}

fn numbers(cell: &str) -> Result<Vec<Found>, Why> {
    let mut found: Vec<Found> = Vec::new();
    let mut rest = cell;
    let mut before = ' ';
    while let Some(letter) = rest.chars().next() {
        let tail = &rest[letter.len_utf8()..];
        let has_digit = |text: &str| text.starts_with(|digit: char| digit.is_ascii_digit());
        let begins = |text: &str| has_digit(text) || text.strip_prefix('.').is_some_and(has_digit);
        let (is_sign, is_number) = (['<', '>', '-'].contains(&letter) && begins(tail), begins(rest));
        if before.is_alphanumeric() || !(is_sign || is_number) {
            (before, rest) = (letter, tail);
            continue;
        }
        let begin = if is_sign && letter != '-' { 1 } else { 0 };
        let is_part = |(at, digit): (usize, char)| digit.is_ascii_digit() || digit == '.' || at == 0 && digit == '-';
        let end = rest[begin..].char_indices().position(|part| !is_part(part)).unwrap_or(rest.len() - begin) + begin;
        let text = rest[begin..end].trim_end_matches('.');
        let printed = Printed::parse(text).ok_or(Why::Wrong(format!("no number: {text}")))?;
        rest = &rest[end..];
        before = '0';
        let unit = rest.strip_prefix(' ').unwrap_or(rest).chars().take_while(|one| one.is_alphabetic() || *one == '/');
        found.push(Found {
            text: text.to_owned(),
            sign: (begin == 1).then_some(letter),
            printed,
            unit: unit.collect(),
        });
    }
    Ok(found)
}

impl Found {
    /// Whether it is the value; `unit` is the one in which the formula counts.
    fn is(&self, value: Result<f64, Why>, unit: Option<&str>) -> Result<bool, Why> {
        let scale = match (unit, self.unit.strip_suffix(unit.unwrap_or_default())) {
            (None, _) | (_, Some("")) => 1.0,
            (_, Some("m")) => 1e-3,
            (_, Some("u")) => 1e-6,
            (_, Some("n")) => 1e-9,
            (_, Some("p")) => 1e-12,
            _ if self.printed.value == 0.0 => return Ok(value? == 0.0 && !self.text.starts_with('-')),
            (Some(unit), _) => return wrong(format!("{} is not counted in {unit}", self.printed.value)),
        };
        let (printed, half) = (self.printed.value * scale, self.printed.half_a_digit * scale);
        Ok(match (self.sign, value) {
            (Some('>'), Err(Why::Missing(_))) => true,
            (Some('>'), Ok(value)) => value > printed,
            (Some(_), Ok(value)) => value < printed,
            (None, Ok(value)) if self.text.starts_with('-') && value >= 0.0 => false,
            (None, Ok(value)) => Printed { value: printed, half_a_digit: half }.stands_for(value),
            (_, Err(why)) => return Err(why),
        })
    }
}

/// How many numbers of a cell were looked at.
fn check(cell: &str, formulas: &[String], limits: &[String], scope: &Scope, tables: &mut Tables) -> Result<usize, Why> {
    if formulas.is_empty() {
        return wrong(format!("no formula for {cell:?}"));
    }
    if formulas == ["-"] {
        return Ok(0);
    }
    let found = numbers(cell)?;
    if let Some(other) = found.iter().find(|one| one.sign.is_some() && !limits.contains(&one.text)) {
        return wrong(format!("{} is no limit of this table", other.text));
    }
    if found.len() > formulas.len() {
        return wrong(format!("{} numbers and {} formulas for {cell:?}", found.len(), formulas.len()));
    }
    for (place, formula) in formulas.iter().enumerate() {
        let (text, unit) =
            formula.split_once(" as ").map_or((formula.as_str(), None), |(text, unit)| (text, Some(unit)));
        let value = value(text, scope, tables);
        let shown = value.as_ref().map_or_else(Why::to_string, f64::to_string);
        let is_right = match (found.get(place), value) {
            (None, Err(Why::Missing(_))) => true,
            // A number that is left out is the one before it.
            (None, value) => found.last().map_or(Ok(false), |last| last.is(value, unit))?,
            (Some(number), value) => number.is(value, unit)?,
        };
        if !is_right {
            return wrong(format!("{cell:?} says otherwise than {text}: {shown}"));
        }
    }
    Ok(found.len())
}

/// How many numbers of a table were looked at, and what is wrong, with the number of its line.
pub(super) fn refute(comment: &str, lines: &[&str], tables: &mut Tables) -> (usize, Vec<(usize, String)>) {
    let layout = match Layout::read(comment, tables) {
        Ok(layout) => layout,
        Err(why) => return (0, vec![(0, why.to_string())]),
    };
    let (mut count, mut told) = (0, Vec::new());
    let mut headings = lines.first().map_or_else(Vec::new, |line| cells(line));
    let mut above: Vec<String> = Vec::new();
    for (number, line) in lines.iter().enumerate().skip(2) {
        let raw = cells(line);
        let with_above = raw.iter().enumerate().map(|(place, cell)| match above.get(place) {
            Some(before) if cell.is_empty() => before.clone(),
            _ => cell.clone(),
        });
        let full: Vec<String> = with_above.collect();
        if let Some(head) = layout.heads.iter().find(|head| full.first() == Some(&head.pattern)) {
            headings = under(&headings, &raw, head.width());
            continue;
        }
        let row = [&raw, &full].into_iter().find_map(|cells| {
            layout.rows.iter().find_map(|row| {
                let key = cells.get(..row.width())?.join(" | ");
                Some((row, row.scope(&key, &layout.scope, tables)?))
            })
        });
        above = full;
        let check_row = || {
            let (row, scope) = row.ok_or(Why::Wrong("no row of the comment above is for this one".to_owned()))?;
            let mut scope = scope?;
            if let Some(corner) = &layout.corner {
                let key = headings.get(..corner.width()).unwrap_or_default().join(" | ");
                let found = corner.scope(&key, &scope, tables);
                scope = found.ok_or_else(|| Why::Wrong(format!("another corner than {}: {key}", corner.pattern)))??;
            }
            if raw.len() != headings.len() {
                return wrong(format!("{} cells under {} headings", raw.len(), headings.len()));
            }
            let mut count = 0;
            for (place, cell) in raw.iter().enumerate().skip(row.width()) {
                let heading = headings.get(place).map_or("", String::as_str);
                let column = layout.columns.iter().find_map(|one| Some((one, one.scope(heading, &scope, tables)?)));
                let (column, scope) =
                    column.ok_or_else(|| Why::Wrong(format!("no column of the comment above is for {heading:?}")))?;
                let formulas = [&column.formulas, &row.formulas].into_iter().find(|formulas| !formulas.is_empty());
                count += check(cell, formulas.unwrap_or(&layout.formulas), &layout.limits, &scope?, tables)?;
            }
            Ok::<usize, Why>(count)
        };
        match check_row() {
            Ok(one) => count += one,
            Err(why) => told.push((number, why.to_string())),
        }
    }
    (count, told)
}

/// Headings with a second line under them: an empty one is the same as on its left.
fn under(headings: &[String], second: &[String], keys: usize) -> Vec<String> {
    let mut last = String::new();
    let pairs = headings.iter().zip(second).enumerate();
    let join = |(place, (heading, second)): (usize, (&String, &String))| {
        if !heading.is_empty() {
            last.clone_from(heading);
        }
        if place < keys { second.clone() } else { format!("{last} {second}").trim().to_owned() }
    };
    pairs.map(join).collect()
}
