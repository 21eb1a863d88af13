//! The YAML crates: limits, places of the values of a text, and writing. Nothing else in the program uses these crates.

use std::collections::BTreeMap;

use granit_parser::{Event, Marker, Parser, ScalarStyle, Span, StructureStyle};
use serde::Serialize;

use super::diagnostic::TextSpan;
use super::outline::{Content, Form, Node, Outline};

/// Deepest nesting. The deepest value of a rig lies at 5.
pub(super) const MAX_DEPTH: usize = 32;
/// Most values in a document, aliases expanded. A rig has about 300.
pub(super) const MAX_NODES: usize = 20_000;
/// Most aliases in a document.
pub(super) const MAX_ALIASES: usize = 100;

/// Reason why a text is not the wanted tree.
#[derive(Debug)]
pub(super) struct Fault {
    pub(super) cause: Cause,
    pub(super) place: Option<TextSpan>,
    /// Path of the value, if the text is YAML but does not fit the tree.
    pub(super) path: Option<String>,
}

impl Fault {
    fn of_text(cause: Cause, place: TextSpan) -> Self {
        Self { cause, place: Some(place), path: None }
    }
}

/// Causes with their own message.
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
    /// A second key next to the key of a choice.
    SecondChoice,
    /// Not YAML, or a cause without its own message.
    Syntax { message: String },
}

/// Writes a document in normal form: block style, keys in the order of the tree.
pub(super) fn write<T: Serialize>(value: &T) -> Result<String, String> {
    serde_saphyr::to_string(value).map_err(|error| error.to_string())
}

fn place(start: Marker, end: Marker) -> TextSpan {
    let offset = start.byte_offset().unwrap_or(0);
    TextSpan {
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
    pending: Option<(String, TextSpan)>,
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
            let place = TextSpan::at(text, at.line(), at.col() + 1, 0);
            match error.info() {
                message if message.contains("recursion limit") => too_big(MAX_DEPTH, "levels", place),
                message => Fault::of_text(Cause::Syntax { message }, place),
            }
        })?;
        let here = place(span.start, span.end);
        if let Event::SequenceStart(.., Some(_)) | Event::MappingStart(.., Some(_)) | Event::Scalar(.., Some(_)) =
            &event
        {
            let message = "a tag has no meaning here".to_owned();
            return Err(Fault::of_text(Cause::Syntax { message }, here));
        }
        match event {
            Event::DocumentStart(..) => documents += 1,
            Event::SequenceStart(style, anchor, _) => {
                let form = Form { anchor, is_quoted: false };
                start(&mut open, span, style, Content::List(Vec::new()), form);
            }
            Event::MappingStart(style, anchor, _) => {
                let form = Form { anchor, is_quoted: false };
                start(&mut open, span, style, Content::Map(Vec::new()), form);
            }
            Event::SequenceEnd | Event::MappingEnd => close(&mut open, &mut root, span),
            Event::Scalar(value, style, anchor, _) => match open.last_mut() {
                Some(Open { content: Content::Map(_), pending: pending @ None, .. }) => {
                    *pending = Some((value.into_owned(), here));
                }
                _ => {
                    let form = Form { anchor, is_quoted: style != ScalarStyle::Plain };
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
            (2.., ..) => Fault::of_text(Cause::SeveralDocuments, here),
            (_, nodes, ..) if nodes > MAX_NODES => too_big(MAX_NODES, "values", here),
            (_, _, aliases, _) if aliases > MAX_ALIASES => too_big(MAX_ALIASES, "aliases", here),
            (.., depth) if depth > MAX_DEPTH => too_big(MAX_DEPTH, "levels", here),
            _ => continue,
        };
        return Err(fault);
    }
    match root {
        Some(Node { content: Content::Scalar(text), .. }) if text.is_empty() || text == "~" || text == "null" => {
            Err(Fault { cause: Cause::Empty, place: None, path: None })
        }
        Some(root) => size(&root, &mut BTreeMap::new()).map(|_| Outline { root: Some(root) }),
        None => Err(Fault { cause: Cause::Empty, place: None, path: None }),
    }
}

/// Returns the number of values in a value, aliases expanded; `sizes` holds this number for each value with an anchor, by the
/// anchor's number.
fn size(node: &Node, sizes: &mut BTreeMap<usize, usize>) -> Result<usize, Fault> {
    let mut sum = 1;
    match &node.content {
        Content::Scalar(_) => {}
        Content::List(items) => {
            for item in items {
                sum += size(item, sizes)?;
            }
        }
        Content::Map(entries) => {
            for (_, value) in entries {
                sum += size(value, sizes)?;
            }
        }
        Content::Alias(anchor) => match sizes.get(anchor) {
            Some(size) => sum = *size,
            None => {
                let message = "this alias repeats what it is part of".to_owned();
                return Err(Fault::of_text(Cause::Syntax { message }, node.value));
            }
        },
    }
    if node.form.anchor > 0 {
        sizes.insert(node.form.anchor, sum);
    }
    if sum > MAX_NODES { Err(too_big(MAX_NODES, "values", node.value)) } else { Ok(sum) }
}

fn too_big(limit: usize, what: &str, place: TextSpan) -> Fault {
    Fault::of_text(Cause::TooBig { limit: format!("{limit} {what}") }, place)
}

fn start(open: &mut Vec<Open>, span: Span, style: StructureStyle, content: Content, form: Form) {
    open.push(Open { start: span, in_flow: matches!(style, StructureStyle::Flow), content, form, pending: None });
}

fn close(open: &mut Vec<Open>, root: &mut Option<Node>, end: Span) {
    let Some(done) = open.pop() else { return };
    let end = if done.in_flow { end.end } else { done.start.start };
    add(open, root, place(done.start.start, end), done.content, done.form);
}

fn add(open: &mut [Open], root: &mut Option<Node>, value: TextSpan, content: Content, form: Form) {
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
