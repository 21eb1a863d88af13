//! Sections of keys and values, with the lines they stand on.

use std::collections::BTreeMap;

use super::{Finding, Level, MAX_FINDINGS};

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

/// Where a line stands.
enum Here {
    /// Before the first section.
    Before,
    /// In a section of this name.
    In(String),
    /// In a section whose name was there already: it is left out.
    Repeated,
}

/// Sections by their names in lower case.
pub(super) type Sections = BTreeMap<String, Section>;

/// Adds a finding, as long as there are not too many.
pub(super) fn add(findings: &mut Vec<Finding>, finding: Finding) {
    match findings.len() {
        len if len < MAX_FINDINGS => findings.push(finding),
        MAX_FINDINGS => findings.push(Finding {
            message: "there are more oddities than are shown".to_owned(),
            help: "fix the others first; is this a data sheet?",
            ..finding
        }),
        _ => {}
    }
}

/// Reads the lines. A line that is no section, key or comment is a finding, and is left out.
pub(super) fn sections(text: &str, findings: &mut Vec<Finding>) -> Sections {
    let mut sections = Sections::new();
    let mut here = Here::Before;
    // A line ends with LF, CR LF, or CR alone.
    let text = text.replace("\r\n", "\n").replace('\r', "\n");
    for (line, content) in text.lines().enumerate().map(|(at, content)| (at + 1, content.trim())) {
        let mut warn = |message: String, help: &'static str| {
            add(findings, Finding { line, level: Level::Warning, message, help });
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
                    Here::Repeated
                }
                None => {
                    sections.insert(name.clone(), Section { line, ..Section::default() });
                    Here::In(name)
                }
            };
        } else if let Some((key, value)) = content.split_once('=') {
            let section = match &here {
                Here::In(name) => sections.get_mut(name),
                Here::Repeated => continue,
                Here::Before => None,
            };
            let Some(section) = section else {
                warn(
                    format!("the key `{}` stands before the first section", key.trim()),
                    "it is left out; write its section above it",
                );
                continue;
            };
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

/// Returns the text before a comment: a `;` after a blank, which names never contain. Quotes protect it.
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
