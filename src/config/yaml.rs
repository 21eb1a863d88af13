//! The YAML crate, and nothing else in the program knows it: limits, reading, writing, and where things stand.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_saphyr::granit_parser::{Event, Marker, Parser, Span, StructureStyle};
use serde_saphyr::{Error, Location, Options};

use super::diagnostic::Place;
use super::outline::{Content, Node, Outline};

/// Deepest nesting. The deepest value of a rig lies at 5.
pub(super) const MAX_DEPTH: usize = 32;
/// Most values in a document, aliases expanded. A rig has about 300.
pub(super) const MAX_NODES: usize = 20_000;
/// Most aliases in a document.
pub(super) const MAX_ALIASES: usize = 100;

/// Why a text is not the wanted tree.
#[derive(Debug)]
pub(super) struct Fault {
    pub(super) cause: Cause,
    pub(super) place: Option<Place>,
}

/// The causes that have an answer of their own.
#[derive(Debug)]
pub(super) enum Cause {
    /// No document at all.
    Empty,
    /// A key that the tree does not have.
    UnknownKey { key: String, known: Vec<&'static str> },
    /// A key that the tree needs.
    MissingKey { key: &'static str },
    /// A key twice in one mapping.
    DuplicateKey { key: Option<String> },
    /// A word that is none of the choices.
    UnknownChoice { word: String, known: Vec<&'static str> },
    /// A value of another type.
    WrongType { expected: String },
    /// NaN or infinity.
    NotFinite,
    /// Beyond a limit that keeps hostile files harmless.
    TooBig { what: &'static str },
    /// More than one document in the file.
    SeveralDocuments,
    /// Not YAML, or nothing that has an answer of its own.
    Syntax { message: String },
}

fn options() -> Options {
    serde_saphyr::options! {
        budget: serde_saphyr::budget! {
            max_depth: MAX_DEPTH,
            max_nodes: MAX_NODES,
            max_aliases: MAX_ALIASES,
            max_documents: 1,
        },
        with_snippet: false,
        strict_booleans: true,
        reject_unsupported_tags: true,
    }
}

/// Reads one document.
pub(super) fn parse<T: DeserializeOwned>(text: &str) -> Result<T, Fault> {
    serde_saphyr::from_str_with_options(text, options()).map_err(|error| fault(&error, text))
}

/// Writes a document in normal form: block style, keys in the order of the tree.
pub(super) fn write<T: Serialize>(value: &T) -> Result<String, String> {
    serde_saphyr::to_string(value).map_err(|error| error.to_string())
}

fn fault(error: &Error, text: &str) -> Fault {
    let inner = match error {
        Error::WithSnippet { error, .. } | Error::AliasError { error, .. } => return fault(error, text),
        inner => inner,
    };
    let cause = match inner {
        Error::Eof { .. } if text.trim().is_empty() => Cause::Empty,
        Error::SerdeUnknownField { field, expected, .. } => {
            Cause::UnknownKey { key: field.clone(), known: expected.clone() }
        }
        Error::SerdeUnknownVariant { variant, expected, .. } => {
            Cause::UnknownChoice { word: variant.clone(), known: expected.clone() }
        }
        Error::SerdeMissingField { field, .. } => Cause::MissingKey { key: field },
        Error::DuplicateMappingKey { key, .. } => Cause::DuplicateKey { key: key.clone() },
        Error::InvalidScalar { ty, .. } => Cause::WrongType { expected: (*ty).to_owned() },
        Error::Unexpected { expected, .. } => Cause::WrongType { expected: (*expected).to_owned() },
        Error::SerdeInvalidType { expected, .. }
        | Error::SerdeInvalidValue { expected, .. }
        | Error::SerdeInvalidLength { expected, .. } => Cause::WrongType { expected: expected.clone() },
        Error::NonFiniteFloat { .. } => Cause::NotFinite,
        Error::Budget { .. } => Cause::TooBig { what: "too large" },
        Error::MultipleDocuments { .. } => Cause::SeveralDocuments,
        other => Cause::Syntax { message: other.to_string() },
    };
    Fault { cause, place: inner.location().and_then(place_of_location) }
}

fn place_of_location(location: Location) -> Option<Place> {
    let span = location.span();
    Some(Place {
        line: usize::try_from(location.line()).ok().filter(|line| *line > 0)?,
        column: usize::try_from(location.column()).ok()?,
        offset: usize::try_from(span.byte_offset()?).ok()?,
        length: usize::try_from(span.byte_len()?).ok()?,
    })
}

fn place(start: Marker, end: Marker) -> Place {
    let offset = start.byte_offset().unwrap_or(0);
    Place {
        line: start.line(),
        column: start.col() + 1,
        offset,
        length: end.byte_offset().unwrap_or(offset).saturating_sub(offset),
    }
}

/// A list or mapping that is still open.
struct Open {
    key: Option<Place>,
    start: Span,
    in_flow: bool,
    content: Content,
    /// A key of the mapping whose value comes next.
    pending: Option<(String, Place)>,
}

/// Where the keys and values of a text stand, as far as it is YAML.
pub(super) fn outline(text: &str) -> Outline {
    let mut open: Vec<Open> = Vec::new();
    let mut root = None;
    for event in Parser::new_from_str(text).take(4 * MAX_NODES) {
        let Ok((event, span)) = event else { break };
        match event {
            Event::SequenceStart(style, ..) => start(&mut open, span, style, Content::List(Vec::new())),
            Event::MappingStart(style, ..) => start(&mut open, span, style, Content::Map(Vec::new())),
            Event::SequenceEnd | Event::MappingEnd => close(&mut open, &mut root, span),
            Event::Scalar(value, ..) => {
                let here = place(span.start, span.end);
                match open.last_mut() {
                    Some(Open { content: Content::Map(_), pending: pending @ None, .. }) => {
                        *pending = Some((value.into_owned(), here));
                    }
                    _ => add(&mut open, &mut root, here, Content::Scalar(value.into_owned())),
                }
            }
            Event::Alias(_) => add(&mut open, &mut root, place(span.start, span.end), Content::Alias),
            Event::DocumentEnd => break,
            _ => {}
        }
        if open.len() > MAX_DEPTH {
            break;
        }
    }
    // A text that breaks off still has an outline of what came before.
    while let Some(last) = open.last() {
        let end = last.start;
        close(&mut open, &mut root, end);
    }
    Outline { root }
}

fn start(open: &mut Vec<Open>, span: Span, style: StructureStyle, content: Content) {
    let key = open.last().and_then(|parent| parent.pending.as_ref()).map(|(_, place)| *place);
    open.push(Open { key, start: span, in_flow: matches!(style, StructureStyle::Flow), content, pending: None });
}

fn close(open: &mut Vec<Open>, root: &mut Option<Node>, end: Span) {
    let Some(done) = open.pop() else { return };
    let end = if done.in_flow { end.end } else { done.start.start };
    add(open, root, place(done.start.start, end), done.content);
}

fn add(open: &mut [Open], root: &mut Option<Node>, value: Place, content: Content) {
    match open.last_mut() {
        None => *root = Some(Node { key: None, value, content }),
        Some(Open { content: Content::List(items), .. }) => items.push(Node { key: None, value, content }),
        Some(Open { content: Content::Map(entries), pending, .. }) => {
            // A list or mapping as key has no name here; no key of a configuration is one.
            let (name, key) = pending.take().map_or((String::new(), None), |(name, place)| (name, Some(place)));
            entries.push((name, Node { key, value, content }));
        }
        Some(_) => {}
    }
}
