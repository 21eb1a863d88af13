//! Conversion of a read error into a finding with message, place and remedy.

use std::sync::Arc;

use super::diagnostic::{Diagnostic, Severity, TextSpan};
use super::locator::Locator;
use super::number::TOO_LARGE;
use super::outline::{Content, Node};
use super::schema::Guide;
use super::suggest::nearest;
use super::yaml::{Cause, Fault};

/// Longest list of keys that a message shows.
const SHOWN_KEYS: usize = 14;

/// The finding for a text that is not YAML at all.
pub(super) fn explain_syntax(fault: Fault, file: &str, text: &Arc<str>) -> Diagnostic {
    let (message, help) = match fault.cause {
        Cause::Empty => (
            format!("{file} is empty"),
            "`yieldwall new RIG.yaml` writes a rig; `yieldwall config show builtin:play.yaml` prints one".to_owned(),
        ),
        Cause::SeveralDocuments => (
            "a second document starts here".to_owned(),
            "one file holds one document: remove the line `---`, or put the rest into a file of its own".to_owned(),
        ),
        Cause::TooBig { limit } => (
            format!("the file goes beyond the limit of {limit}"),
            "a configuration is a small file written by hand; is this the right one?".to_owned(),
        ),
        Cause::Syntax { message } => {
            let help = syntax_help(&message);
            (format!("this is not YAML: {message}"), help)
        }
        other => (format!("this cannot be read: {other:?}"), syntax_help("")),
    };
    finding(file, text, fault.place, String::new(), message, help)
}

fn syntax_help(message: &str) -> String {
    let help = if message.contains("tab") {
        "indent with spaces"
    } else if message.contains("repeats what it is part of") {
        "write the value in its place"
    } else if message.contains("comments") {
        "put a space before the `#`"
    } else if message.contains("key") || message.contains("':'") {
        "a key is written `key: value`, with a colon and a space; if this line is so, a bracket or quote before it is open"
    } else if message.contains("bracket") || message.contains("flow") || message.contains("'['") {
        "look for a bracket that is not closed, or a comma that is missing"
    } else if message.contains("anchor") {
        "`*name` repeats what `&name` has marked before it in the same file"
    } else if message.contains("tag") {
        "write the value without the word that begins with `!`"
    } else {
        "look at this line and the one before it: indentation, colons, quotes and brackets"
    };
    help.to_owned()
}

/// The finding for YAML that is not the wanted tree.
pub(super) fn explain(fault: Fault, locator: &Locator, guide: &Guide) -> Diagnostic {
    let outline = &locator.outline;
    let finding = |place: Option<TextSpan>, key: String, message: String, help: String| {
        locator.finding_at(Severity::Error, place, key, message, help)
    };
    let path = fault.path.unwrap_or_default();
    let found = outline.find(&path);
    let place = found.map(Node::place).or(fault.place);
    let finish = |place: Option<TextSpan>, path: String, message: String, help: String| {
        let help = with_description(help, guide, &path);
        finding(place, path, message, help)
    };
    match fault.cause {
        Cause::UnknownKey { key, known } => {
            let is_top = parent(&path).is_empty();
            // A map of names has every key.
            let has_it = |group: &&&str| guide.has(&join(group, &key)) && !guide.has(&join(group, "?"));
            let below = known.iter().filter(|_| is_top).find(has_it);
            let help = match nearest(&key, known.iter().copied()) {
                Some(meant) => format!("did you mean `{meant}`?"),
                None if below.is_some() => format!("did you mean `{}`?", join(below.unwrap_or(&""), &key)),
                None if known.is_empty() => format!("{} has no keys: write `{{}}`", name_of(parent(&path))),
                None => format!("{} has the keys {}", name_of(parent(&path)), shorten(&known)),
            };
            let message = match is_top {
                true => format!("there is no top-level key `{key}`"),
                false => format!("{} has no key `{key}`", name_of(parent(&path))),
            };
            finding(fault.place, path.clone(), message, help)
        }
        Cause::MissingKey { key } => {
            let place = found.map(|node| node.key.unwrap_or(node.place())).or(fault.place);
            let missing = join(&path, key);
            let expected = guide.expectation(&missing).map(|text| format!(": {text}")).unwrap_or_default();
            let message = format!("{} lacks the key `{key}`", name_of(&path));
            finish(place, missing, message, format!("add `{key}`{expected}"))
        }
        Cause::DuplicateKey { key } => {
            let key = key.unwrap_or_default();
            let message = format!("{} has the key `{key}` twice", name_of(parent(&path)));
            let mut finding = finding(fault.place, path.clone(), message, "keep one of the two".to_owned());
            let first = outline.find(&path).and_then(|node| node.key);
            first.into_iter().for_each(|place| locator.relate_at(&mut finding, place, "first here"));
            finding
        }
        Cause::UnknownChoice { word, known } => {
            let help = match nearest(&word, known.iter().copied()) {
                Some(meant) => format!("did you mean `{meant}`?"),
                None => format!("write one of {}", shorten(&known)),
            };
            finish(fault.place, path.clone(), format!("`{path}` cannot be `{word}`"), help)
        }
        Cause::SecondChoice => {
            let message = format!("`{path}` has a second choice here");
            let help = guide.expectation(&path).map(|text| format!("write {text}, and only one of them"));
            finish(fault.place, path, message, help.unwrap_or_default())
        }
        Cause::NotFinite => {
            let node = found.map(Node::describe).unwrap_or_default();
            not_finite(&finish, place, path, &node)
        }
        Cause::TooLarge => {
            let node = found.map(Node::describe).unwrap_or_default();
            let message = format!("{} is {node}, which {TOO_LARGE}", name_of(&path));
            finish(place, path, message, "look at the power of ten: every unit stands in the key".to_owned())
        }
        Cause::WrongType { expected } => {
            let Some(node) = found else {
                return finding(fault.place, path, format!("{expected} was expected"), syntax_help(""));
            };
            let is_infinite = matches!(&node.content, Content::Scalar(word) if overflows(word) || is_named(word));
            if is_infinite {
                return not_finite(&finish, Some(node.place()), path, &node.describe());
            }
            let wanted = guide.expectation(&path).unwrap_or(expected);
            let is_number = matches!(node.content, Content::Scalar(_)) && wanted.contains("number");
            let against = if is_number { format!(", not {wanted}") } else { String::new() };
            let message = format!("{} is {}{against}", name_of(&path), node.describe());
            let help = match &node.content {
                Content::Scalar(word) if has_unit(word) => {
                    format!("write the number alone, the unit stands in the key: {wanted}")
                }
                Content::Scalar(word) if word.replace(',', ".").parse::<f64>().is_ok() && word.contains(',') => {
                    format!("write a decimal point: {wanted}")
                }
                _ => format!("write {wanted}"),
            };
            finish(Some(node.place()), path, message, help)
        }
        cause => {
            let file = locator.files.first().map_or("", |file| file.name.as_str());
            let Diagnostic { key, message, help, .. } =
                explain_syntax(Fault { cause, place: None, path: None }, file, &locator.text);
            finding(fault.place, key, message, help.unwrap_or_default())
        }
    }
}

/// Whether a word names a number that is not finite, without the dot that YAML wants.
fn is_named(word: &str) -> bool {
    let name = word.trim_start_matches(['+', '-']);
    ["nan", "inf", "infinity"].iter().any(|other| name.eq_ignore_ascii_case(other))
}

fn not_finite(
    finish: &impl Fn(Option<TextSpan>, String, String, String) -> Diagnostic,
    place: Option<TextSpan>,
    path: String,
    found: &str,
) -> Diagnostic {
    let message = format!("{} is {found}, which is not a finite number", name_of(&path));
    finish(place, path, message, "write a finite number".to_owned())
}

fn finding(
    file: &str,
    text: &Arc<str>,
    place: Option<TextSpan>,
    key: String,
    message: String,
    help: String,
) -> Diagnostic {
    Diagnostic {
        severity: Severity::Error,
        file: file.to_owned(),
        place,
        key,
        message,
        help: Some(help).filter(|help| !help.is_empty()),
        related: Vec::new(),
        text: place.map(|_| text.clone()),
    }
}

/// Adds the description of a key below the help.
pub(super) fn with_description(help: String, guide: &Guide, path: &str) -> String {
    match (guide.description(path), path.rsplit('.').next()) {
        (Some(text), Some(key)) if !key.is_empty() => format!("{help}\n{key}: {text}"),
        _ => help,
    }
}

/// Returns the name of a path for a sentence.
pub(super) fn name_of(path: &str) -> String {
    if path.is_empty() { "the document".to_owned() } else { format!("`{path}`") }
}

fn join(group: &str, key: &str) -> String {
    if group.is_empty() { key.to_owned() } else { format!("{group}.{key}") }
}

fn parent(path: &str) -> &str {
    path.rfind(['.', '[']).and_then(|at| path.get(..at)).unwrap_or("")
}

fn shorten(known: &[&str]) -> String {
    let shown = known.iter().take(SHOWN_KEYS).copied().collect::<Vec<_>>().join(", ");
    if known.len() > SHOWN_KEYS { format!("{shown} and {} more", known.len() - SHOWN_KEYS) } else { shown }
}

/// A number too large for a finite `f64`.
fn overflows(word: &str) -> bool {
    word.starts_with(|c: char| c.is_ascii_digit() || c == '-') && word.parse::<f64>().is_ok_and(f64::is_infinite)
}

/// A number with letters after it.
fn has_unit(word: &str) -> bool {
    let letters = word.trim_start_matches(|c: char| c.is_ascii_digit() || "+-.".contains(c)).trim();
    letters.len() < word.trim().len() && letters.starts_with(char::is_alphabetic) && word.parse::<f64>().is_err()
}
