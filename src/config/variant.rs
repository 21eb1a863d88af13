//! A variant: the file that it is like, with the keys that it has itself put in place.
//!
//! Both files are merged value by value, written as one text and read as any other. Every value of that text knows the
//! file and the place where it stands, so that a finding points there.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::diagnostic::{Diagnostic, Place, Related, Report, Severity};
use super::kind::Kind;
use super::outline::{Content, Node, Outline};
use super::schema::Guide;
use super::source::{Source, rebase};
use super::suggest::nearest;
use super::yaml::{self, MAX_NODES};

/// The key that names the file which a variant is like.
pub(super) const LIKE: &str = "like";

/// A file that has been read.
#[derive(Clone, Debug)]
pub(super) struct File {
    pub(super) name: String,
    pub(super) text: Arc<str>,
}

/// Where the values of a text stand in the files that it was put together from, by their place in the text. Empty for
/// the text of one file.
pub(super) type Origins = BTreeMap<usize, (usize, Place)>;

/// A value and the file that it is from.
struct Piece {
    file: usize,
    key: Option<Place>,
    value: Place,
    content: Shape,
}

enum Shape {
    Scalar { text: String, is_quoted: bool },
    List(Vec<Piece>),
    Map(Vec<(String, Piece)>),
}

/// A variant and its base as one text.
pub(super) struct Merged {
    pub(super) text: Arc<str>,
    pub(super) outline: Outline,
    pub(super) origins: Origins,
}

/// The file that a document is like, and the value that names it; `None` when it is no variant.
///
/// # Errors
/// When what stands at `like` names no file, or stands there twice.
pub(super) fn base(file: &File, outline: &Outline, source: &Source) -> Result<Option<(Source, Node)>, Report> {
    let Some(Node { content: Content::Map(entries), .. }) = &outline.root else { return Ok(None) };
    let mut named = entries.iter().filter(|(key, _)| key == LIKE).map(|(_, node)| node);
    let Some(like) = named.next() else { return Ok(None) };
    if let Some(second) = named.next() {
        let place = second.key.unwrap_or(second.value);
        let help = "a variant is like one file: keep one of the two";
        return Err(file
            .finding(place, LIKE, format!("the document has the key `{LIKE}` twice"), help.to_owned())
            .into());
    }
    match &like.content {
        Content::Scalar(path)
            if !path.is_empty() && (like.form.is_quoted || !matches!(path.as_str(), "~" | "null")) =>
        {
            Ok(Some((source.relative(path), like.clone())))
        }
        _ => {
            let message = format!("`{LIKE}` is {}", like.describe());
            let help = "write the file that this one is a variant of, such as `paper-admittance.yaml`".to_owned();
            Err(file.finding(like.place(), LIKE, message, help).into())
        }
    }
}

impl File {
    /// An error at a place of this file.
    pub(super) fn finding(&self, place: Place, key: &str, message: String, help: String) -> Diagnostic {
        Diagnostic {
            severity: Severity::Error,
            file: self.name.clone(),
            place: Some(place),
            key: key.to_owned(),
            message,
            help: Some(help),
            related: Vec::new(),
            text: Some(self.text.clone()),
        }
    }
}

/// Merges a variant, the first of the `files`, with the second, which it names by the path `like`.
///
/// # Errors
/// What only documents of one file may have; or an entry of a list that no entry of the base has the name of.
pub(super) fn merge(
    files: &[File; 2],
    outlines: [&Outline; 2],
    like: &str,
    kind: Kind,
    guide: &Guide,
) -> Result<Merged, Report> {
    let [mut own, mut base] =
        [(0, outlines[0]), (1, outlines[1])].map(|(file, outline)| Expander::expand(file, outline, files));
    if let Ok(Piece { content: Shape::Map(entries), .. }) = &mut own {
        entries.retain(|(key, _)| key != LIKE);
    }
    if let Ok(base) = &mut base {
        move_paths(base, "", kind, like);
    }
    let merged = Merger { files, guide }.merge("", base?, own?)?;
    let mut text = String::new();
    write(&merged, 0, &mut text);
    let outline = match yaml::outline(&text) {
        Ok(outline) => outline,
        Err(fault) => {
            return Err(
                Diagnostic::about_file(&files[0].name, format!("this cannot be read: {:?}", fault.cause), "").into()
            );
        }
    };
    let mut origins = Origins::new();
    if let Some(root) = &outline.root {
        note(root, &merged, &mut origins);
    }
    Ok(Merged { text: text.into(), outline, origins })
}

/// Turns an outline into values without aliases.
struct Expander<'a> {
    file: usize,
    files: &'a [File; 2],
    /// Values by the number of their anchor, and where the anchors are that are still open.
    anchors: BTreeMap<usize, &'a Node>,
    nodes: usize,
}

impl<'a> Expander<'a> {
    fn expand(file: usize, outline: &'a Outline, files: &'a [File; 2]) -> Result<Piece, Report> {
        let mut this = Self { file, files, anchors: BTreeMap::new(), nodes: 0 };
        match &outline.root {
            Some(root) => this.piece(root, None),
            None => Err(Diagnostic::about_file(&files[file].name, format!("{} is empty", files[file].name), "").into()),
        }
    }

    /// A value; within an alias all of it stands where the alias does.
    fn piece(&mut self, node: &'a Node, within: Option<Place>) -> Result<Piece, Report> {
        let in_file = &self.files[self.file];
        let refuse = |message: String, help: &str| {
            Err(in_file.finding(within.unwrap_or(node.value), "", message, help.to_owned()).into())
        };
        self.nodes += 1;
        if self.nodes > MAX_NODES {
            return refuse(
                format!("the file goes beyond the limit of {MAX_NODES} values"),
                "a configuration is a small file written by hand; is this the right one?",
            );
        }
        if node.form.has_tag {
            return refuse(
                "a tag has no meaning in a variant and in the file that it is like".to_owned(),
                "write the value without the word that begins with `!`",
            );
        }
        let content = match &node.content {
            Content::Scalar(text) => Shape::Scalar { text: text.clone(), is_quoted: node.form.is_quoted },
            Content::Alias(anchor) => match self.anchors.get(anchor).copied() {
                Some(target) => {
                    let piece = self.piece(target, Some(within.unwrap_or(node.value)))?;
                    return Ok(Piece { key: within.or(node.key), ..piece });
                }
                None => {
                    return refuse("this alias repeats what it is part of".to_owned(), "write the value in its place");
                }
            },
            Content::List(items) => {
                Shape::List(items.iter().map(|item| self.piece(item, within)).collect::<Result<_, _>>()?)
            }
            Content::Map(entries) => {
                let mut pieces = Vec::new();
                for (key, value) in entries {
                    if value.key.is_none() {
                        return refuse("a key is a word".to_owned(), "write keys as words, without brackets");
                    }
                    pieces.push((key.clone(), self.piece(value, within)?));
                }
                Shape::Map(pieces)
            }
        };
        if node.form.anchor > 0 {
            self.anchors.insert(node.form.anchor, node);
        }
        Ok(Piece { file: self.file, key: within.or(node.key), value: within.unwrap_or(node.value), content })
    }
}

/// Paths in the base start from its folder; in the variant they start from that of the variant.
fn move_paths(piece: &mut Piece, at: &str, kind: Kind, like: &str) {
    match &mut piece.content {
        Shape::Scalar { text, .. } => {
            if kind.names_file(at, text) {
                *text = rebase(like, text);
            }
        }
        Shape::List(items) => {
            let all = items.iter_mut().enumerate();
            all.for_each(|(index, item)| move_paths(item, &format!("{at}[{index}]"), kind, like));
        }
        Shape::Map(entries) => {
            entries.iter_mut().for_each(|(key, value)| move_paths(value, &join(at, key), kind, like))
        }
    }
}

struct Merger<'a> {
    files: &'a [File; 2],
    guide: &'a Guide,
}

impl Merger<'_> {
    /// What stands at a path: groups are merged key by key, anything else is that of the variant. A choice is merged
    /// with the same choice alone, and a list whose entries have names entry by entry.
    fn merge(&self, at: &str, base: Piece, own: Piece) -> Result<Piece, Report> {
        let Piece { file, key, value, content } = own;
        let content = match (base.content, content) {
            (Shape::Map(base), Shape::Map(own)) if !self.guide.is_choice(at) || same_choice(&base, &own) => {
                Shape::Map(self.merge_entries(at, base, own)?)
            }
            (Shape::List(base), Shape::List(own)) if self.guide.has(&format!("{at}[0].name")) => {
                Shape::List(self.merge_named(at, base, own)?)
            }
            (_, own) => own,
        };
        Ok(Piece { file, key, value, content })
    }

    fn merge_entries(
        &self,
        at: &str,
        base: Vec<(String, Piece)>,
        own: Vec<(String, Piece)>,
    ) -> Result<Vec<(String, Piece)>, Report> {
        // A key that stands twice stays so, and is refused when the text is read.
        let mut own: Vec<Option<(String, Piece)>> = own.into_iter().map(Some).collect();
        let mut merged = Vec::new();
        for (key, value) in base {
            let same = own.iter_mut().find(|entry| entry.as_ref().is_some_and(|(other, _)| *other == key));
            let value = match same.and_then(Option::take) {
                Some((_, own)) => self.merge(&join(at, &key), value, own)?,
                None => value,
            };
            merged.push((key, value));
        }
        merged.extend(own.into_iter().flatten());
        Ok(merged)
    }

    fn merge_named(&self, at: &str, mut base: Vec<Piece>, own: Vec<Piece>) -> Result<Vec<Piece>, Report> {
        for (index, entry) in own.into_iter().enumerate() {
            let here = format!("{at}[{index}]");
            let names: Vec<String> =
                base.iter().filter_map(|entry| entry.name().map(|(name, _)| name.to_owned())).collect();
            let Some((name, place)) = entry.name() else {
                let message =
                    format!("`{here}` has no `name`, and `{at}` of {} are told apart by it", self.files[1].name);
                let help = format!("write the name of the entry that this one changes: {}", names.join(" or "));
                return Err(self.files[0].finding(entry.key.unwrap_or(entry.value), &here, message, help).into());
            };
            let Some(of_base) = base.iter_mut().find(|other| other.name().is_some_and(|(other, _)| other == name))
            else {
                let help = match nearest(name, names.iter().map(String::as_str)) {
                    Some(meant) => format!("did you mean `{meant}`?"),
                    None => {
                        format!("it has {}; an entry of a variant changes the one of its name", names.join(" and "))
                    }
                };
                let message =
                    format!("`{here}.name` is `{name}`, and `{at}` of {} has no such entry", self.files[1].name);
                return Err(self.files[0].finding(place, &format!("{here}.name"), message, help).into());
            };
            if of_base.file == 0 {
                let first = of_base.name().map(|(_, place)| Related {
                    file: String::new(),
                    place,
                    label: "first here".to_owned(),
                });
                let message = format!("`{here}.name` is `{name}` again");
                let mut finding = self.files[0].finding(
                    place,
                    &format!("{here}.name"),
                    message,
                    "write all that changes in one entry".to_owned(),
                );
                finding.related.extend(first);
                return Err(finding.into());
            }
            let empty = Piece { file: 1, key: None, value: of_base.value, content: Shape::List(Vec::new()) };
            let of_base_was = std::mem::replace(of_base, empty);
            *of_base = self.merge(&here, of_base_was, entry)?;
        }
        Ok(base)
    }
}

impl Piece {
    /// The name that an entry of a list has, and where it stands.
    fn name(&self) -> Option<(&str, Place)> {
        let Shape::Map(entries) = &self.content else { return None };
        entries.iter().find_map(|(key, value)| match &value.content {
            Shape::Scalar { text, .. } if key == "name" => Some((text.as_str(), value.value)),
            _ => None,
        })
    }
}

fn same_choice(base: &[(String, Piece)], own: &[(String, Piece)]) -> bool {
    own.iter().all(|(key, _)| base.iter().any(|(other, _)| other == key))
}

fn join(group: &str, key: &str) -> String {
    if group.is_empty() { key.to_owned() } else { format!("{group}.{key}") }
}

/// Writes a value after its key, or as a document: groups and lists in block style, each plain value on a line.
fn write(piece: &Piece, indent: usize, out: &mut String) {
    let is_inner = !out.is_empty();
    match &piece.content {
        Shape::Scalar { text, is_quoted } => {
            if is_inner {
                out.push(' ');
            }
            out.push_str(&if *is_quoted || text.contains('\n') { quote(text) } else { text.clone() });
            out.push('\n');
        }
        Shape::List(items) if items.is_empty() => out.push_str(if is_inner { " []\n" } else { "[]\n" }),
        Shape::Map(entries) if entries.is_empty() => out.push_str(if is_inner { " {}\n" } else { "{}\n" }),
        Shape::List(items) => {
            if is_inner {
                out.push('\n');
            }
            for item in items {
                out.push_str(&" ".repeat(indent));
                out.push('-');
                write(item, indent + 1, out);
            }
        }
        Shape::Map(entries) => {
            if is_inner {
                out.push('\n');
            }
            for (key, value) in entries {
                out.push_str(&" ".repeat(indent));
                let is_word = key.chars().all(|c| c.is_alphanumeric() || "_<".contains(c));
                out.push_str(&if is_word && !key.is_empty() { key.clone() } else { quote(key) });
                out.push(':');
                write(value, indent + 1, out);
            }
        }
    }
}

fn quote(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// Notes where the values of the text that was written stand in the files.
fn note(written: &Node, piece: &Piece, origins: &mut Origins) {
    match (&written.content, &piece.content) {
        (Content::Map(entries), Shape::Map(pieces)) => {
            for ((_, written), (_, piece)) in entries.iter().zip(pieces) {
                note(written, piece, origins);
            }
        }
        (Content::List(items), Shape::List(pieces)) => {
            for (written, piece) in items.iter().zip(pieces) {
                note(written, piece, origins);
            }
        }
        _ => {}
    }
    // A group begins where its first key does, and that is noted already.
    origins.entry(written.value.offset).or_insert((piece.file, piece.value));
    if let (Some(at), Some(place)) = (written.key, piece.key) {
        origins.insert(at.offset, (piece.file, place));
    }
}
