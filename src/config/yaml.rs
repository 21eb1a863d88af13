//! The YAML crate, and nothing else in the program knows it: limits, reading, writing, and where things stand.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_saphyr::granit_parser::{Event, Marker, Parser, ScalarStyle, Span, StructureStyle};
use serde_saphyr::{DefaultMessageFormatter, Error, Location, MessageFormatter, Options};

use super::diagnostic::Place;
use super::number::{NOT_FINITE, TOO_LARGE};
use super::outline::{Content, Form, Node, Outline};

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
    /// A finite number of absurd size.
    TooLarge,
    /// Beyond a limit that keeps hostile files harmless.
    TooBig { limit: String },
    /// More than one document in the file.
    SeveralDocuments,
    /// A second key beside that of a choice.
    SecondChoice,
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
        Error::ExternallyTaggedEnumExpectedScalarOrMapping { .. }
        | Error::ExpectedStringKeyForExternallyTaggedEnum { .. } => {
            Cause::WrongType { expected: "a group with one key".to_owned() }
        }
        Error::NonFiniteFloat { .. } => Cause::NotFinite,
        Error::Budget { .. } => {
            Cause::TooBig { limit: format!("{MAX_NODES} values, {MAX_ALIASES} aliases or {MAX_DEPTH} levels") }
        }
        Error::Message { msg, .. } if msg == NOT_FINITE => Cause::NotFinite,
        Error::Message { msg, .. } if msg == TOO_LARGE => Cause::TooLarge,
        Error::Message { msg, .. } => Cause::Syntax { message: msg.clone() },
        Error::ExpectedMappingEndAfterEnumVariantValue { .. } => Cause::SecondChoice,
        other => Cause::Syntax { message: DefaultMessageFormatter.format_message(other).into_owned() },
    };
    Fault { cause, place: inner.location().and_then(|location| place_of_location(location, text)) }
}

fn place_of_location(location: Location, text: &str) -> Option<Place> {
    let line = usize::try_from(location.line()).ok().filter(|line| *line > 0)?;
    let column = usize::try_from(location.column()).ok()?;
    let length = location.span().byte_len().and_then(|length| usize::try_from(length).ok()).unwrap_or(0);
    Some(Place::at(text, line, column, length))
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
    start: Span,
    in_flow: bool,
    content: Content,
    form: Form,
    /// A key of the mapping whose value comes next.
    pending: Option<(String, Place)>,
}

/// Where the keys and values of a text stand.
///
/// # Errors
/// The first syntax error; no document or more than one; beyond [`MAX_DEPTH`], [`MAX_NODES`] or [`MAX_ALIASES`].
pub(super) fn outline(text: &str) -> Result<Outline, Fault> {
    let mut open: Vec<Open> = Vec::new();
    let mut root = None;
    let (mut nodes, mut aliases, mut documents) = (0, 0, 0);
    // Every value has at most two events, and streams and documents add a few.
    for event in Parser::new_from_str(text).take(2 * MAX_NODES + 8) {
        let (event, span) = event.map_err(|error| {
            let at = error.marker();
            let place = Place::at(text, at.line(), at.col() + 1, 0);
            match error.info() {
                message if message.contains("recursion limit") => too_big(MAX_DEPTH, "levels", place),
                message => Fault { cause: Cause::Syntax { message }, place: Some(place) },
            }
        })?;
        let here = place(span.start, span.end);
        match event {
            Event::DocumentStart(..) => documents += 1,
            Event::SequenceStart(style, anchor, tag) => {
                let form = Form { anchor, is_quoted: false, has_tag: tag.is_some() };
                start(&mut open, span, style, Content::List(Vec::new()), form);
            }
            Event::MappingStart(style, anchor, tag) => {
                let form = Form { anchor, is_quoted: false, has_tag: tag.is_some() };
                start(&mut open, span, style, Content::Map(Vec::new()), form);
            }
            Event::SequenceEnd | Event::MappingEnd => close(&mut open, &mut root, span),
            Event::Scalar(value, style, anchor, tag) => match open.last_mut() {
                Some(Open { content: Content::Map(_), pending: pending @ None, .. }) => {
                    *pending = Some((value.into_owned(), here));
                }
                _ => {
                    let form = Form { anchor, is_quoted: style != ScalarStyle::Plain, has_tag: tag.is_some() };
                    add(&mut open, &mut root, here, Content::Scalar(value.into_owned()), form);
                }
            },
            Event::Alias(anchor) => {
                aliases += 1;
                add(&mut open, &mut root, here, Content::Alias(anchor), Form::default());
            }
            _ => continue,
        }
        nodes += 1;
        let fault = match (documents, nodes, aliases, open.len()) {
            (2.., ..) => Fault { cause: Cause::SeveralDocuments, place: Some(here) },
            (_, nodes, ..) if nodes > MAX_NODES => too_big(MAX_NODES, "values", here),
            (_, _, aliases, _) if aliases > MAX_ALIASES => too_big(MAX_ALIASES, "aliases", here),
            (.., depth) if depth > MAX_DEPTH => too_big(MAX_DEPTH, "levels", here),
            _ => continue,
        };
        return Err(fault);
    }
    match root {
        None => Err(Fault { cause: Cause::Empty, place: None }),
        Some(Node { content: Content::Scalar(text), .. }) if text.is_empty() || text == "~" || text == "null" => {
            Err(Fault { cause: Cause::Empty, place: None })
        }
        root => Ok(Outline { root }),
    }
}

fn too_big(limit: usize, what: &str, place: Place) -> Fault {
    Fault { cause: Cause::TooBig { limit: format!("{limit} {what}") }, place: Some(place) }
}

fn start(open: &mut Vec<Open>, span: Span, style: StructureStyle, content: Content, form: Form) {
    open.push(Open { start: span, in_flow: matches!(style, StructureStyle::Flow), content, form, pending: None });
}

fn close(open: &mut Vec<Open>, root: &mut Option<Node>, end: Span) {
    let Some(done) = open.pop() else { return };
    let end = if done.in_flow { end.end } else { done.start.start };
    add(open, root, place(done.start.start, end), done.content, done.form);
}

fn add(open: &mut [Open], root: &mut Option<Node>, value: Place, content: Content, form: Form) {
    match open.last_mut() {
        None => *root = Some(Node { key: None, value, content, form }),
        Some(Open { content: Content::List(items), .. }) => items.push(Node { key: None, value, content, form }),
        Some(Open { content: Content::Map(entries), pending, .. }) => {
            // A list or mapping as key has no name here; no key of a configuration is one.
            let (name, key) = pending.take().map_or((String::new(), None), |(name, place)| (name, Some(place)));
            entries.push((name, Node { key, value, content, form }));
        }
        Some(_) => {}
    }
}
