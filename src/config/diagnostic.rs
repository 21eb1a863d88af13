//! Errors and warnings about a configuration: message, place and remedy, independent of how they are drawn.

use std::fmt;
use std::sync::Arc;

use serde::Serialize;

/// Whether a configuration can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The configuration cannot be used.
    Error,
    /// The configuration can be used, but a person should look at it.
    Warning,
}

/// A piece of a text file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct TextSpan {
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// Start in bytes, from 0.
    pub offset: usize,
    /// Length in bytes; may be 0.
    pub length: usize,
}

impl TextSpan {
    /// The place of a line and column of a text.
    pub(super) fn at(text: &str, line: usize, column: usize, length: usize) -> Self {
        // A byte order mark is not a column.
        let mark = if text.starts_with('\u{feff}') { '\u{feff}'.len_utf8() } else { 0 };
        let mut offset = mark;
        for (index, content) in lines(text.get(mark..).unwrap_or_default()).enumerate() {
            if index + 1 == line {
                offset += content.chars().take(column.saturating_sub(1)).map(char::len_utf8).sum::<usize>();
                break;
            }
            offset += content.len();
        }
        let length = length.min(text.len().saturating_sub(offset));
        Self { line, column, offset, length }
    }
}

/// The lines of a text with their breaks as YAML has them: LF, CR LF, or CR alone.
fn lines(mut text: &str) -> impl Iterator<Item = &str> {
    std::iter::from_fn(move || {
        let found = text.find(['\n', '\r']);
        let len = found.map_or(text.len(), |at| if text[at..].starts_with("\r\n") { at + 2 } else { at + 1 });
        let (line, rest) = text.split_at(len);
        text = rest;
        (!line.is_empty()).then_some(line)
    })
}

/// Another place that explains a finding.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Related {
    /// The file; empty, and left out of JSON, if it is the file of the finding.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub file: String,
    /// Place in the file.
    pub place: TextSpan,
    /// Text at that place.
    pub label: String,
}

/// One finding in a configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Diagnostic {
    /// Whether the configuration can be used.
    pub severity: Severity,
    /// The file, as it was named; empty, and left out of JSON, if the finding concerns no file.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub file: String,
    /// Place in the file; `None` if the finding concerns the whole file.
    pub place: Option<TextSpan>,
    /// The key that it concerns, such as `drives[0].profile`; empty, and left out of JSON, if it concerns none.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub key: String,
    /// The error or warning.
    pub message: String,
    /// The remedy.
    pub help: Option<String>,
    /// Other places that explain it.
    pub related: Vec<Related>,
    /// The text of the file, for the snippet.
    #[serde(skip)]
    pub text: Option<Arc<str>>,
}

impl Diagnostic {
    /// A finding about a whole file.
    pub fn about_file(file: impl Into<String>, message: impl Into<String>, help: impl Into<String>) -> Self {
        Self {
            severity: Severity::Error,
            file: file.into(),
            place: None,
            key: String::new(),
            message: message.into(),
            help: Some(help.into()),
            related: Vec::new(),
            text: None,
        }
    }
}

/// `file:line:column: error: message`, on one line; without a file `error: message`.
impl fmt::Display for Diagnostic {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let colon = if self.file.is_empty() { "" } else { ": " };
        write!(out, "{}", self.file)?;
        if let Some(place) = self.place {
            write!(out, ":{}:{}", place.line, place.column)?;
        }
        let severity = match self.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        };
        write!(out, "{colon}{severity}: {}", self.message)
    }
}

/// Reason why a configuration was refused: at least one error, perhaps warnings, in the order of the lines.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Report {
    /// The findings.
    pub diagnostics: Vec<Diagnostic>,
}

impl Report {
    /// How many of the findings are errors.
    pub fn errors(&self) -> usize {
        self.diagnostics.iter().filter(|finding| finding.severity == Severity::Error).count()
    }
}

impl From<Diagnostic> for Report {
    fn from(diagnostic: Diagnostic) -> Self {
        Self { diagnostics: vec![diagnostic] }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, diagnostic) in self.diagnostics.iter().enumerate() {
            if index > 0 {
                writeln!(out)?;
            }
            write!(out, "{diagnostic}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Report {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_has_no_file_and_no_key_where_there_is_none() {
        let json = |file: &str| serde_json::to_value(Diagnostic::about_file(file, "wrong", "fix it")).unwrap();
        assert_eq!((json("").get("file"), json("").get("key")), (None, None));
        assert_eq!((json("a.yaml")["file"].as_str(), json("a.yaml").get("key")), (Some("a.yaml"), None));
        assert_eq!(Diagnostic::about_file("", "wrong", "").to_string(), "error: wrong");
    }

    #[test]
    fn a_place_counts_the_line_breaks_of_yaml() {
        let text = "a: 1\rb: 2\r\nc: \u{fc}3\n\nd: 4";
        for (line, column, found) in [(1, 1, "a"), (2, 4, "2"), (3, 5, "3"), (5, 1, "d")] {
            let place = TextSpan::at(text, line, column, 1);
            assert_eq!(&text[place.offset..place.offset + place.length], found, "line {line}");
        }
        assert_eq!(TextSpan::at(text, 9, 1, 1), TextSpan { line: 9, column: 1, offset: text.len(), length: 0 });
    }
}
