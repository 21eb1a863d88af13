//! Sections of keys and values, with the lines they stand on.

use std::collections::BTreeMap;

use super::{Finding, Level};

/// Longest line that is read, in bytes.
const LONGEST_LINE: usize = 4096;

/// A value as it is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Text {
    pub(super) text: String,
    pub(super) line: usize,
}

/// The keys of a section, in lower case.
#[derive(Clone, Debug, Default)]
pub(super) struct Section {
    pub(super) line: usize,
    keys: BTreeMap<String, Text>,
}

impl Section {
    pub(super) fn get(&self, key: &str) -> Option<&Text> {
        self.keys.get(&key.to_ascii_lowercase())
    }

    /// Keys in lower case, with their values.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&str, &Text)> {
        self.keys.iter().map(|(key, text)| (key.as_str(), text))
    }

    /// A text without the quotes that some tools put around it; empty if there is none.
    pub(super) fn text(&self, key: &str) -> String {
        self.get(key).map(|text| unquoted(&text.text).to_owned()).unwrap_or_default()
    }
}

/// A text without quotes around all of it; those within belong to it.
pub(super) fn unquoted(text: &str) -> &str {
    let inner = text.strip_prefix('"').and_then(|rest| rest.strip_suffix('"'));
    inner.filter(|inner| !inner.contains('"')).unwrap_or(text)
}

/// Sections by their names in lower case.
pub(super) type Sections = BTreeMap<String, Section>;

/// Reads the lines. What is no section, key or comment is a finding and left out.
pub(super) fn sections(text: &str, findings: &mut Vec<Finding>) -> Sections {
    let mut sections = Sections::new();
    // A second section of one name, and what stands before the first, is left out.
    let mut here: Option<String> = None;
    for (line, content) in text.lines().enumerate().map(|(at, content)| (at + 1, content.trim())) {
        let mut warn = |message: String, help: &'static str| {
            findings.push(Finding { line, level: Level::Warning, message, help });
        };
        if content.len() > LONGEST_LINE {
            warn(format!("the line has more than {LONGEST_LINE} bytes"), "it is left out");
        } else if content.is_empty() || content.starts_with([';', '#']) {
            // A comment.
        } else if let Some(rest) = content.strip_prefix('[') {
            let (name, _) = rest.split_once(']').unwrap_or_else(|| {
                warn(format!("the section `{rest}` is not closed"), "write `]` behind its name");
                (without_comment(rest), "")
            });
            let name = name.trim().to_ascii_lowercase();
            here = match sections.get(&name) {
                Some(first) => {
                    let message = format!("the section `{name}` stands in line {} already", first.line);
                    warn(message, "the first one counts; put the keys of both into one");
                    None
                }
                None => {
                    sections.insert(name.clone(), Section { line, ..Section::default() });
                    Some(name)
                }
            };
        } else if let Some((key, value)) = content.split_once('=') {
            let Some(section) = here.as_ref().and_then(|name| sections.get_mut(name)) else { continue };
            let text = Text { text: without_comment(value).trim().to_owned(), line };
            if let Some(first) = section.keys.get(&key.trim().to_ascii_lowercase()) {
                let message = format!("the key `{}` stands in line {} already", key.trim(), first.line);
                warn(message, "the first one counts; leave one away");
            } else {
                section.keys.insert(key.trim().to_ascii_lowercase(), text);
            }
        } else {
            warn(
                "the line is neither a section nor `key=value`".to_owned(),
                "it is left out; a comment begins with `;`",
            );
        }
    }
    sections
}

/// What stands before a comment: a `;` behind a blank, which names never have. Quotes protect it.
fn without_comment(value: &str) -> &str {
    let mut is_quoted = false;
    let mut before = ' ';
    for (at, one) in value.char_indices() {
        match one {
            '"' => is_quoted = !is_quoted,
            ';' if !is_quoted && before.is_whitespace() => return &value[..at],
            _ => {}
        }
        before = one;
    }
    value
}
