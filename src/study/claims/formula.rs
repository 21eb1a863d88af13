//! Formulas over the rows of tables, and the claims that compare them.

use super::tables::{COMPARISONS, Condition, Tables, Why, holds, wrong};

/// Words between blanks; brackets are words of their own, and what stands in quotes is never divided.
pub(super) fn words(text: &str) -> Vec<String> {
    let (mut words, mut is_quoted) = (vec![String::new()], false);
    for letter in text.chars() {
        is_quoted ^= letter == '\'';
        match letter {
            ' ' if !is_quoted => words.push(String::new()),
            '(' | ')' | '[' | ']' if !is_quoted => words.extend([letter.to_string(), String::new()]),
            _ => words.last_mut().expect("one at least").push(letter),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Parts between dividers that stand outside of quotes and brackets.
pub(super) fn parts<'a>(text: &'a str, divider: &str) -> Vec<&'a str> {
    let (mut parts, mut begin, mut depth, mut is_quoted) = (Vec::new(), 0, 0, false);
    for (at, letter) in text.char_indices() {
        match letter {
            '\'' => is_quoted = !is_quoted,
            '(' | '[' if !is_quoted => depth += 1,
            ')' | ']' if !is_quoted => depth -= 1,
            _ => {}
        }
        if depth == 0 && !is_quoted && at >= begin && text[at..].starts_with(divider) {
            parts.push(&text[begin..at]);
            begin = at + divider.len();
        }
    }
    parts.push(&text[begin..]);
    parts
}

/// A number as it is printed: it stands for all that are rounded to it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Printed {
    pub(super) value: f64,
    pub(super) half_a_digit: f64,
}

impl Printed {
    /// `48e1` is 480 with two digits.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let (digits, power) = text.split_once('e').unwrap_or((text, "0"));
        let decimals = digits.split_once('.').map_or(0, |(_, behind)| behind.len()) as i32;
        let digit: f64 = format!("1e{}", power.parse::<i32>().ok()? - decimals).parse().ok()?;
        Some(Self { value: text.parse().ok()?, half_a_digit: digit / 2.0 })
    }

    pub(super) fn stands_for(&self, value: f64) -> bool {
        (value - self.value).abs() <= self.half_a_digit + 1e-9 * value.abs()
    }
}

enum Formula {
    Number(f64),
    /// The cell of the only row.
    Cell {
        column: String,
        conditions: Vec<Condition>,
    },
    Call {
        function: String,
        table: Option<String>,
        of: Box<Formula>,
        conditions: Vec<Condition>,
    },
    Absolute(Box<Formula>),
    Operation(Box<Formula>, char, Box<Formula>),
}

struct Parser<'a> {
    words: &'a [String],
}

impl Parser<'_> {
    fn whole(words: &[String]) -> Result<Formula, Why> {
        let mut parser = Parser { words };
        let formula = parser.sum()?;
        match parser.words {
            [] => Ok(formula),
            [word, ..] => wrong(format!("{word:?} does not belong there")),
        }
    }

    fn next_is(&self, word: &str) -> bool {
        self.words.first().is_some_and(|next| next == word)
    }

    fn take(&mut self) -> Result<String, Why> {
        let (first, rest) = self.words.split_first().ok_or(Why::Wrong("the formula ends too soon".to_owned()))?;
        self.words = rest;
        Ok(first.clone())
    }

    fn close(&mut self, bracket: &str) -> Result<(), Why> {
        match self.take()? {
            word if word == bracket => Ok(()),
            word => wrong(format!("{word:?} in place of {bracket:?}")),
        }
    }

    /// What stands between operators, which have blanks on both sides.
    fn chain(&mut self, operators: &[&str], part: fn(&mut Self) -> Result<Formula, Why>) -> Result<Formula, Why> {
        let mut left = part(self)?;
        while let Some(operator) = operators.iter().find(|operator| self.next_is(operator)) {
            self.take()?;
            let sign = operator.chars().next().expect("operators are no empty words");
            left = Formula::Operation(Box::new(left), sign, Box::new(part(self)?));
        }
        Ok(left)
    }

    fn sum(&mut self) -> Result<Formula, Why> {
        self.chain(&["+", "-"], |parser| parser.chain(&["*", "/"], Self::term))
    }

    fn conditions(&mut self) -> Vec<Condition> {
        let mut conditions = Vec::new();
        while let Some(condition) = self.words.first().and_then(|word| Condition::parse(word)) {
            conditions.push(condition);
            self.words = &self.words[1..];
        }
        conditions
    }

    fn term(&mut self) -> Result<Formula, Why> {
        let word = self.take()?;
        if word == "(" {
            let inside = self.sum()?;
            self.close(")")?;
            return Ok(inside);
        }
        if let Ok(number) = word.parse() {
            return Ok(Formula::Number(number));
        }
        if self.next_is("[") {
            self.take()?;
            let conditions = self.conditions();
            self.close("]")?;
            return Ok(Formula::Cell { column: word, conditions });
        }
        if !self.next_is("(") {
            let is_name = word.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_');
            return if is_name {
                Ok(Formula::Cell { column: word, conditions: Vec::new() })
            } else {
                wrong(format!("no column and no number: {word:?}"))
            };
        }
        self.take()?;
        if word == "abs" {
            let inside = self.sum()?;
            self.close(")")?;
            return Ok(Formula::Absolute(Box::new(inside)));
        }
        let is_count = word == "count";
        let table = match self.words {
            [table, ..] if is_count && table != ")" && Condition::parse(table).is_none() => Some(self.take()?),
            [_, next, ..] if !is_count && !["(", ")", "[", "+", "-", "*", "/"].contains(&next.as_str()) => {
                if Condition::parse(next).is_none() {
                    Some(self.take()?)
                } else {
                    None
                }
            }
            _ => None,
        };
        let of = Box::new(if is_count { Formula::Number(1.0) } else { self.sum()? });
        let conditions = self.conditions();
        self.close(")")?;
        Ok(Formula::Call { function: word, table, of, conditions })
    }
}

/// What a formula is about: rows of a table, and the conditions by which they were taken.
#[derive(Clone, Default)]
pub(super) struct Scope {
    pub(super) table: String,
    pub(super) conditions: Vec<Condition>,
    rows: Vec<usize>,
}

impl Scope {
    /// Rows of a table that meet all conditions.
    pub(super) fn of(table: &str, conditions: Vec<Condition>, tables: &mut Tables) -> Result<Self, Why> {
        let csv = tables.table(table)?;
        let rows = csv.meeting(&(0..csv.rows.len()).collect::<Vec<_>>(), &conditions)?;
        Ok(Self { table: table.to_owned(), conditions, rows })
    }

    /// Those of its rows that meet more conditions.
    pub(super) fn with(&self, more: &[Condition], tables: &mut Tables) -> Result<Self, Why> {
        if self.table.is_empty() {
            return if more.is_empty() { Ok(self.clone()) } else { wrong("conditions on no table") };
        }
        let rows = tables.table(&self.table)?.meeting(&self.rows, more)?;
        Ok(Self { conditions: [&self.conditions, more].concat(), rows, ..self.clone() })
    }

    /// Rows of this or another table. A condition takes the place of those that the scope has on its column, and what the scope says
    /// of columns that the other table does not have is left out.
    fn other(&self, table: Option<&String>, own: &[Condition], tables: &mut Tables) -> Result<Self, Why> {
        let name = table.unwrap_or(&self.table);
        if name.is_empty() {
            return wrong("no table");
        }
        let is_replaced = |one: &Condition| own.iter().any(|other| other.column == one.column);
        if *name == self.table && !self.conditions.iter().any(is_replaced) {
            return self.with(own, tables);
        }
        let own = own.iter().map(|one| one.of_row(|column| only(column, self, tables)));
        let own = own.collect::<Result<Vec<_>, _>>()?;
        let csv = tables.table(name)?;
        let kept = self.conditions.iter().filter(|one| !is_replaced(one) && csv.columns.contains(&one.column));
        Self::of(name, kept.chain(&own).cloned().collect(), tables)
    }

    fn cells(&self, tables: &mut Tables, row: usize, columns: &[String]) -> Result<Vec<String>, Why> {
        let csv = tables.table(&self.table)?;
        columns.iter().map(|column| csv.cell(row, column).map(str::to_owned)).collect()
    }

    /// A scope for each combination of the cells that its rows have in some columns.
    fn each(&self, columns: &[String], tables: &mut Tables) -> Result<Vec<Self>, Why> {
        let mut found: Vec<(Vec<String>, Vec<usize>)> = Vec::new();
        for row in self.rows.iter().copied() {
            let texts = self.cells(tables, row, columns)?;
            match found.iter_mut().find(|(others, _)| *others == texts) {
                Some((_, rows)) => rows.push(row),
                None => found.push((texts, vec![row])),
            }
        }
        let scope = |(texts, rows): (Vec<String>, Vec<usize>)| {
            let more = columns.iter().zip(&texts).map(|(column, text)| Condition::equals(column, text));
            Self { table: self.table.clone(), conditions: self.conditions.iter().cloned().chain(more).collect(), rows }
        };
        Ok(found.into_iter().map(scope).collect())
    }
}

impl Formula {
    fn value(&self, scope: &Scope, tables: &mut Tables) -> Result<f64, Why> {
        match self {
            Self::Number(number) => Ok(*number),
            Self::Absolute(inside) => Ok(inside.value(scope, tables)?.abs()),
            Self::Cell { column, conditions } => only(column, &scope.other(None, conditions, tables)?, tables),
            Self::Operation(left, operator, right) => {
                let (left, right) = (left.value(scope, tables)?, right.value(scope, tables)?);
                Ok(match operator {
                    '+' => left + right,
                    '-' => left - right,
                    '*' => left * right,
                    _ => left / right,
                })
            }
            Self::Call { function, table, of, conditions } => {
                let met = scope.other(table.as_ref(), conditions, tables)?;
                let one = |row: &usize| of.value(&Scope { rows: vec![*row], ..met.clone() }, tables);
                let numbers = match function.as_str() {
                    "count" => return Ok(met.rows.len() as f64),
                    "value" | "max" | "min" | "sum" => met.rows.iter().map(one).collect::<Result<Vec<_>, _>>()?,
                    _ => return wrong(format!("no function {function}")),
                };
                match (function.as_str(), numbers.as_slice()) {
                    (_, []) => wrong(format!("no row for {function}")),
                    ("value", [one]) => Ok(*one),
                    ("value", all) => wrong(format!("{} rows for value", all.len())),
                    ("max", all) => Ok(all.iter().copied().fold(f64::NEG_INFINITY, f64::max)),
                    ("min", all) => Ok(all.iter().copied().fold(f64::INFINITY, f64::min)),
                    (_, all) => Ok(all.iter().sum()),
                }
            }
        }
    }
}

/// The number in the cell of the only row.
fn only(column: &str, scope: &Scope, tables: &mut Tables) -> Result<f64, Why> {
    let csv = tables.table(&scope.table)?;
    match scope.rows.as_slice() {
        [row] => csv.number(*row, column),
        [] => csv.place(column).and(wrong(format!("no row for {column}"))),
        rows => csv.place(column).and(wrong(format!("{} rows for {column}", rows.len()))),
    }
}

/// The value of a formula.
pub(super) fn value(text: &str, scope: &Scope, tables: &mut Tables) -> Result<f64, Why> {
    Parser::whole(&words(text))?.value(scope, tables)
}

/// What a claim says of the values on its left, one for each scope.
enum Says {
    Compared(&'static str, Formula),
    Within(f64, f64),
    Rounded(Printed),
    /// The least and the greatest one.
    FromTo(Printed, Printed),
}

impl Says {
    fn parse(words: &[String]) -> Result<(Formula, Self), Why> {
        let is_comparison = |word: &String| ["in", "~"].iter().chain(&COMPARISONS).any(|one| one == word);
        let Some(at) = words.iter().position(is_comparison) else { return wrong("nothing is compared") };
        let (left, right) = (Parser::whole(&words[..at])?, &words[at + 1..]);
        let numbers = match right {
            [one] => one.split_once(".."),
            _ => None,
        };
        let says = match (words[at].as_str(), numbers, right) {
            ("in", Some((low, high)), _) => low.parse().ok().zip(high.parse().ok()).map(|(a, b)| Self::Within(a, b)),
            ("~", Some((low, high)), _) => {
                Printed::parse(low).zip(Printed::parse(high)).map(|(low, high)| Self::FromTo(low, high))
            }
            ("~", None, [one]) => Printed::parse(one).map(Self::Rounded),
            ("in" | "~", ..) => None,
            (word, ..) => COMPARISONS
                .into_iter()
                .find(|comparison| *comparison == word)
                .map(|comparison| Parser::whole(right).map(|right| Self::Compared(comparison, right)))
                .transpose()?,
        };
        says.map(|says| (left, says)).ok_or(Why::Wrong("no range or number".to_owned()))
    }
}

/// The claims of a comment: what they are about, and each of them.
#[derive(Default)]
struct About {
    /// The last scope that names a table: those without one add to it.
    base: Scope,
    scopes: Vec<Scope>,
}

impl About {
    fn read(&mut self, text: &str, tables: &mut Tables) -> Result<(), Why> {
        let words = words(text);
        let (conditions, columns) = match words.iter().position(|word| word == "each") {
            Some(at) => (&words[..at], Some(&words[at + 1..])),
            None => (&words[..], None),
        };
        let scope = self.base_of(conditions, tables)?;
        self.scopes = match columns {
            None => vec![scope],
            Some([number, columns @ ..]) => {
                let scopes = scope.each(columns, tables)?;
                if number.parse() != Ok(scopes.len()) || columns.is_empty() || scopes.is_empty() {
                    return wrong(format!("{} combinations of {columns:?}", scopes.len()));
                }
                scopes
            }
            Some([]) => return wrong("each what?"),
        };
        Ok(())
    }

    fn base_of(&mut self, words: &[String], tables: &mut Tables) -> Result<Scope, Why> {
        let read = |words: &[String]| -> Result<Vec<Condition>, Why> {
            let read = |word: &String| Condition::parse(word).ok_or(Why::Wrong(format!("no condition: {word}")));
            words.iter().map(read).collect()
        };
        match words {
            [table, conditions @ ..] if Condition::parse(table).is_none() => {
                self.base = Scope::of(table, read(conditions)?, tables)?;
                Ok(self.base.clone())
            }
            conditions => self.base.with(&read(conditions)?, tables),
        }
    }

    fn refute(&self, claim: &str, tables: &mut Tables) -> Result<Option<String>, Why> {
        let (left, says) = Says::parse(&words(claim))?;
        let mut values = Vec::new();
        for scope in &self.scopes {
            let value = left.value(scope, tables)?;
            let told = match &says {
                Says::Compared(comparison, right) => {
                    let right = right.value(scope, tables)?;
                    (!holds(value, comparison, right)).then(|| format!("{value} {comparison} {right}"))
                }
                Says::Within(low, high) => (!(holds(*low, "<=", value) && holds(value, "<=", *high)))
                    .then(|| format!("{value} in {low}..{high}")),
                Says::Rounded(printed) => (!printed.stands_for(value)).then(|| format!("{value} ~ {}", printed.value)),
                Says::FromTo(..) => value.is_nan().then(|| "no number".to_owned()),
            };
            if let Some(told) = told {
                let row = scope.rows.first().filter(|_| self.scopes.len() > 1);
                return Ok(Some(told + &row.map_or(String::new(), |row| format!(" (row {row})"))));
            }
            values.push(value);
        }
        let Says::FromTo(low, high) = says else { return Ok(None) };
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let greatest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let is_so = low.stands_for(least) && high.stands_for(greatest);
        Ok((!is_so).then(|| format!("{least}..{greatest} ~ {}..{}", low.value, high.value)))
    }
}

/// How much the claims of a comment say, and what of it does not hold.
pub(super) fn refute(claims: &str, tables: &mut Tables) -> (usize, Vec<String>) {
    let mut about = About { scopes: vec![Scope::default()], ..About::default() };
    let (mut count, mut told) = (0, Vec::new());
    for claim in parts(claims, ";") {
        let claim = claim.trim();
        let scopes = parts(claim, ": ");
        let (claim, scopes) = scopes.split_last().map_or((claim, &[][..]), |(claim, scopes)| (claim.trim(), scopes));
        if let Some(why) = scopes.iter().find_map(|scope| about.read(scope, tables).err()) {
            told.push(format!("{}: {why}", scopes.join(": ")));
            about.scopes.clear();
            continue;
        }
        count += about.scopes.len();
        match about.refute(claim, tables) {
            Ok(None) => {}
            Ok(Some(values)) => told.push(format!("{claim}: {values}")),
            Err(why) => told.push(format!("{claim}: {why}")),
        }
    }
    (count, told)
}
