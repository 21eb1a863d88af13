//! Composition of a rig from several files: its base with the rig's own keys put in place, and its simulation.
//!
//! The files are merged value by value, written as one text and read like any other. Every value of that text knows its file and
//! its place there, so that a finding points there.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::diagnostic::{Diagnostic, Related, Report, TextSpan};
use super::explain::explain_syntax;
use super::kind::{Kind, LIKE};
use super::locator::{File, Locator, Origins, Spot};
use super::outline::{Content, Node, Outline};
use super::schema::Guide;
use super::source::{SET, Source, rebase};
use super::suggest::nearest;
use super::yaml;

/// Key of a rig that holds its simulation, or the name of its file.
const SIMULATION: &str = "simulation";

/// Largest number of base files in a chain.
const MOST_BASES: usize = 8;

/// A value and its origin.
struct Piece {
    key: Option<Spot>,
    value: Spot,
    content: Shape,
}

enum Shape {
    Scalar { text: String, is_quoted: bool },
    List(Vec<Piece>),
    Map(Vec<(String, Piece)>),
}

/// Reads a file and the files that it is composed from, and returns the file that it is a variant of.
///
/// # Errors
/// A file; its first syntax error; a file of another kind; or what cannot be merged.
pub(super) fn open(source: &Source) -> Result<(Locator, Option<Source>), Report> {
    let (file, outline) = read_outline(source)?;
    let like = base(&file, &outline, source)?;
    let names_simulation = Kind::detect(outline.top_keys()) == Some(Kind::Rig)
        && outline.find(SIMULATION).is_some_and(|node| names_file(node).is_some());
    if like.is_none() && !names_simulation {
        return Ok((Locator::of_file(file, outline), None));
    }
    let mut parts = Parts { files: vec![file] };
    let mut whole = parts.expand(&outline)?;
    if let Some((base, like)) = &like {
        whole = parts.merge_with_base(whole, base, (0, like), MOST_BASES)?.0;
    }
    parts.include_simulation(&mut whole, source)?;
    Ok((parts.locate(&whole)?, like.map(|(base, _)| base)))
}

/// Reads a file, and the places of its values.
fn read_outline(source: &Source) -> Result<(File, Outline), Report> {
    let file = File { name: source.to_string(), text: source.read()? };
    let outline = yaml::outline(&file.text).map_err(|fault| explain_syntax(fault, &file.name, &file.text))?;
    match outline.root.as_ref().and_then(first_unprintable) {
        Some((place, character)) => Err(unprintable(&file, &outline, place, character).into()),
        None => Ok((file, outline)),
    }
}

/// Returns the first character in a key or a text that would affect a display, and its place.
fn first_unprintable(node: &Node) -> Option<(TextSpan, char)> {
    match &node.content {
        Content::Scalar(text) => text.chars().find(|one| is_unprintable(*one)).map(|one| (node.place(), one)),
        Content::Alias(_) => None,
        Content::List(items) => items.iter().find_map(first_unprintable),
        Content::Map(entries) => entries.iter().find_map(|(key, inner)| {
            let in_key = key.chars().find(|one| is_unprintable(*one));
            in_key.map(|one| (inner.key.unwrap_or(inner.value), one)).or_else(|| first_unprintable(inner))
        }),
    }
}

/// Whether a character is a control character, or changes the direction of writing.
fn is_unprintable(character: char) -> bool {
    character.is_control() || matches!(character, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

fn unprintable(file: &File, outline: &Outline, place: TextSpan, character: char) -> Diagnostic {
    let key = outline.path_at(place.offset).map(|(path, _)| path.escape_debug().to_string()).unwrap_or_default();
    let message = format!("`{key}` has the character U+{:04X}, which cannot be printed", u32::from(character));
    let help = "leave it out: names and texts go to terminals, figures and recordings, on one line".to_owned();
    file.finding(place, &key, message, help)
}

/// Returns the path in a value, unless the value is null.
fn names_file(node: &Node) -> Option<&str> {
    match &node.content {
        Content::Scalar(path)
            if !path.is_empty() && (node.form.is_quoted || !matches!(path.as_str(), "~" | "null")) =>
        {
            Some(path)
        }
        _ => None,
    }
}

/// Returns the base file of a document, and the value that names it; `None` if the document is no variant.
fn base(file: &File, outline: &Outline, source: &Source) -> Result<Option<(Source, Node)>, Report> {
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
    let Some(path) = names_file(like) else {
        let message = format!("`{LIKE}` is {}", like.describe());
        let help = "write the file that this one is a variant of, such as `paper-admittance.yaml`".to_owned();
        return Err(file.finding(like.place(), LIKE, message, help).into());
    };
    Ok(Some((source.relative(path), like.clone())))
}

/// The files of a document, in the order in which they were opened.
struct Parts {
    files: Vec<File>,
}

impl Parts {
    /// Returns the values of the file that was opened last.
    fn expand(&self, outline: &Outline) -> Result<Piece, Report> {
        let number = self.files.len() - 1;
        let file = &self.files[number];
        let mut expander = Expander { number, file, anchors: BTreeMap::new() };
        match &outline.root {
            Some(root) => expander.piece(root, None),
            None => {
                Err(Diagnostic::about_file(&file.name, format!("{} is empty", file.name), "write a document").into())
            }
        }
    }

    /// Opens a file that is named at a place. An error of the whole file becomes a finding at that place.
    fn open(&mut self, source: &Source, key: &str, at: Spot) -> Result<Outline, Report> {
        let (file, outline) = read_outline(source).map_err(|report| {
            let is_own = self.files[at.0].name == SET && key == LIKE;
            let at_key = |finding: Diagnostic| match finding.place {
                Some(_) => finding,
                // The user named the file, and nobody wrote `like`.
                None if is_own => finding,
                None => self.refuse(key, at, &finding.message, finding.help.as_deref().unwrap_or_default()),
            };
            Report { diagnostics: report.diagnostics.into_iter().map(at_key).collect() }
        })?;
        self.files.push(file);
        Ok(outline)
    }

    fn refuse(&self, key: &str, (file, place): Spot, message: &str, help: &str) -> Diagnostic {
        // The program wrote this text: its place shows nothing to the user.
        if self.files[file].name == SET && key == LIKE {
            return Diagnostic::about_file(SET, message, help);
        }
        self.files[file].finding(place, key, format!("`{key}`: {message}"), help.to_owned())
    }

    /// Merges a variant with its base, which may be a variant itself, and returns the kind of both. `like` holds the number of
    /// the variant's file and the value that names the base.
    fn merge_with_base(
        &mut self,
        mut own: Piece,
        source: &Source,
        (number, like): (usize, &Node),
        levels: usize,
    ) -> Result<(Piece, Kind), Report> {
        let at = (number, like.place());
        if levels == 0 || self.files.iter().any(|file| file.name == source.to_string()) {
            let message = if levels == 0 {
                format!("{source} is the variant of a variant at the {MOST_BASES}th level")
            } else {
                format!("{source} is itself a variant of this file")
            };
            return Err(self.refuse(LIKE, at, &message, "name a document that is written whole").into());
        }
        let mut mark = None;
        if let Shape::Map(entries) = &mut own.content {
            entries.retain(|(key, _)| key != LIKE);
            mark = Kind::detect(entries.iter().map(|(key, _)| key.as_str()));
        }
        let outline = self.open(source, LIKE, at)?;
        let base_number = self.files.len() - 1;
        let next = base(&self.files[base_number], &outline, source)?;
        let expanded = self.expand(&outline)?;
        let (mut piece, kind) = match (&next, Kind::detect(outline.top_keys())) {
            (Some((base, like)), _) => self.merge_with_base(expanded, base, (base_number, like), levels - 1)?,
            (None, Some(kind)) if kind.has_variants() => (expanded, kind),
            (None, kind) => {
                let is = kind.map_or("not a configuration".to_owned(), Kind::with_article);
                if self.files[number].name == SET {
                    let message = format!("{source} is {is}, and --set needs a rig or an impedance device");
                    let help = "name one of these, such as builtin:paper-admittance.yaml";
                    return Err(self.refuse(LIKE, at, &message, help).into());
                }
                let message = format!("{source} is {is}; rigs, impedance devices and scenes have variants");
                return Err(self.refuse(LIKE, at, &message, "name one of these, or write the document whole").into());
            }
        };
        if let Some(own_kind) = mark.filter(|own_kind| *own_kind != kind) {
            let message = format!("{source} is {}, and this file is {}", kind.with_article(), own_kind.with_article());
            if self.files[number].name == SET {
                let message =
                    format!("{source} is {}, and --set names keys of {}", kind.with_article(), own_kind.with_article());
                let help = "write `scene.` before each key of the scene, such as scene.hand.mass_kg=1.0";
                return Err(self.refuse(LIKE, at, &message, help).into());
            }
            return Err(self.refuse(LIKE, at, &message, &format!("name {}", own_kind.with_article())).into());
        }
        self.include_simulation(&mut piece, source)?;
        move_paths(&mut piece, "", kind, names_file(like).unwrap_or_default());
        let guide = Guide::new(kind);
        let merger = Merger { number, own: &self.files[number], base: &self.files[base_number], guide: &guide };
        Ok((merger.merge("", piece, own)?, kind))
    }

    /// Replaces the name of a simulation in a rig by the simulation.
    fn include_simulation(&mut self, rig: &mut Piece, source: &Source) -> Result<(), Report> {
        let Shape::Map(entries) = &mut rig.content else { return Ok(()) };
        let Some((_, named)) = entries.iter_mut().find(|(key, _)| key == SIMULATION) else { return Ok(()) };
        let path = match &named.content {
            Shape::Scalar { text, is_quoted } if *is_quoted || !matches!(text.as_str(), "" | "~" | "null") => {
                text.clone()
            }
            _ => return Ok(()),
        };
        let file = source.relative(&path);
        let outline = self.open(&file, SIMULATION, named.value)?;
        let kind = Kind::detect(outline.top_keys());
        if kind != Some(Kind::Simulation) {
            let is = kind.map_or("not a configuration".to_owned(), Kind::with_article);
            let help = "name a file with `arm`, `drive_position_loop`, `timing` and `scene`, such as simulations/paper-arm.yaml";
            return Err(self
                .refuse(SIMULATION, named.value, &format!("{file} is {is}; a simulation is required"), help)
                .into());
        }
        let mut piece = self.expand(&outline)?;
        move_paths(&mut piece, "", Kind::Simulation, &path);
        // What concerns all of it stands in its file.
        *named = Piece { key: Some(piece.value), ..piece };
        Ok(())
    }

    /// Joins all values into one text.
    fn locate(self, whole: &Piece) -> Result<Locator, Report> {
        let mut text = String::new();
        write(whole, 0, &mut text);
        let outline = yaml::outline(&text).map_err(|fault| {
            let name = self.files.first().map_or("", |file| &file.name);
            Report::from(Diagnostic {
                place: None,
                text: None,
                ..explain_syntax(fault, name, &Arc::from(text.as_str()))
            })
        })?;
        let mut origins = Origins::new();
        if let Some(root) = &outline.root {
            note(root, whole, &mut origins);
        }
        Ok(Locator { files: self.files, text: text.into(), outline, origins })
    }
}

/// Turns an outline into values without aliases.
struct Expander<'a> {
    number: usize,
    file: &'a File,
    /// Values by the number of their anchor; one that is not closed yet is not among them.
    anchors: BTreeMap<usize, &'a Node>,
}

impl<'a> Expander<'a> {
    /// Returns a value; everything within an alias has the place of the alias.
    fn piece(&mut self, node: &'a Node, within: Option<TextSpan>) -> Result<Piece, Report> {
        let file = self.file;
        let refuse = |message: String, help: &str| {
            Err(file.finding(within.unwrap_or(node.value), "", message, help.to_owned()).into())
        };
        let number = self.number;
        let spot = |place: Option<TextSpan>| place.map(|place| (number, place));
        let content = match &node.content {
            Content::Scalar(text) => Shape::Scalar { text: text.clone(), is_quoted: node.form.is_quoted },
            Content::Alias(anchor) => match self.anchors.get(anchor).copied() {
                Some(target) => {
                    let piece = self.piece(target, Some(within.unwrap_or(node.value)))?;
                    return Ok(Piece { key: spot(within.or(node.key)), ..piece });
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
        Ok(Piece { key: spot(within.or(node.key)), value: (self.number, within.unwrap_or(node.value)), content })
    }
}

/// Paths in the base start from its folder; paths in the variant start from the variant's folder.
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
    /// Number of the variant's file.
    number: usize,
    own: &'a File,
    base: &'a File,
    guide: &'a Guide,
}

impl Merger<'_> {
    /// Merges the values at a path: groups key by key; any other value of the variant replaces the base's value. A choice merges
    /// only with the same choice, and a list with named entries entry by entry.
    fn merge(&self, at: &str, base: Piece, own: Piece) -> Result<Piece, Report> {
        let Piece { key, value, content } = own;
        let content = match (base.content, content) {
            (Shape::Map(base), Shape::Map(own)) if !self.guide.is_choice(at) || same_choice(&base, &own) => {
                Shape::Map(self.merge_entries(at, base, own)?)
            }
            (Shape::List(base), Shape::List(own)) if self.guide.has(&format!("{at}[0].name")) => {
                Shape::List(self.merge_named(at, base, own)?)
            }
            (_, own) => own,
        };
        Ok(Piece { key, value, content })
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
                    format!("`{here}` has no `name`, which identifies the entries of `{at}` in {}", self.base.name);
                let help = format!("write the name of the entry that this one changes: {}", names.join(" or "));
                return Err(self.own.finding(entry.key.unwrap_or(entry.value).1, &here, message, help).into());
            };
            let Some(of_base) = base.iter_mut().find(|other| other.name().is_some_and(|(other, _)| other == name))
            else {
                let help = match nearest(name, names.iter().map(String::as_str)) {
                    Some(meant) => format!("did you mean `{meant}`?"),
                    None => {
                        format!("it has {}; an entry of a variant changes the one of its name", names.join(" and "))
                    }
                };
                let message = format!("`{here}.name` is `{name}`, and `{at}` of {} has no such entry", self.base.name);
                return Err(self.own.finding(place, &format!("{here}.name"), message, help).into());
            };
            if of_base.value.0 == self.number {
                let first = of_base.name().map(|(_, place)| Related {
                    file: String::new(),
                    place,
                    label: "first here".to_owned(),
                });
                let message = format!("`{here}.name` is `{name}` again");
                let mut finding = self.own.finding(
                    place,
                    &format!("{here}.name"),
                    message,
                    "write all that changes in one entry".to_owned(),
                );
                finding.related.extend(first);
                return Err(finding.into());
            }
            let empty = Piece { key: None, value: of_base.value, content: Shape::List(Vec::new()) };
            let of_base_was = std::mem::replace(of_base, empty);
            *of_base = self.merge(&here, of_base_was, entry)?;
        }
        Ok(base)
    }
}

impl Piece {
    /// Whether the value means the same between brackets. A value that stood there does; a value that a merge added may not.
    fn fits_brackets(&self) -> bool {
        match &self.content {
            Shape::Scalar { text, is_quoted } => *is_quoted || !text.contains([',', '[', ']', '{', '}', '\n']),
            Shape::List(items) => items.iter().all(Self::fits_brackets),
            Shape::Map(entries) => entries.iter().all(|(_, value)| value.fits_brackets()),
        }
    }

    /// Returns the name of an entry of a list, and its place.
    fn name(&self) -> Option<(&str, TextSpan)> {
        let Shape::Map(entries) = &self.content else { return None };
        entries.iter().find_map(|(key, value)| match &value.content {
            Shape::Scalar { text, .. } if key == "name" => Some((text.as_str(), value.value.1)),
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

/// Writes a value after its key, or as a document. A value in brackets keeps them where possible; other groups and lists are in
/// block style, each value on a line.
fn write(piece: &Piece, indent: usize, out: &mut String) {
    let is_inner = !out.is_empty();
    let is_empty = match &piece.content {
        Shape::Scalar { .. } => true,
        Shape::List(items) => items.is_empty(),
        Shape::Map(entries) => entries.is_empty(),
    };
    if is_empty || (piece.value.1.length > 0 && piece.fits_brackets()) {
        if is_inner {
            out.push(' ');
        }
        write_in_line(piece, out);
        out.push('\n');
        return;
    }
    if is_inner {
        out.push('\n');
    }
    match &piece.content {
        Shape::Scalar { .. } => {}
        Shape::List(items) => {
            for item in items {
                out.push_str(&" ".repeat(indent));
                out.push('-');
                write(item, indent + 1, out);
            }
        }
        Shape::Map(entries) => {
            for (key, value) in entries {
                out.push_str(&" ".repeat(indent));
                out.push_str(&word(key));
                out.push(':');
                write(value, indent + 1, out);
            }
        }
    }
}

fn write_in_line(piece: &Piece, out: &mut String) {
    match &piece.content {
        Shape::Scalar { text, is_quoted } if *is_quoted || text.contains('\n') => out.push_str(&quote(text)),
        // Nothing at all is read as `~`.
        Shape::Scalar { text, .. } => out.push_str(if piece.value.1.length == 0 { "" } else { text }),
        Shape::List(items) => {
            out.push('[');
            for (index, item) in items.iter().enumerate() {
                out.push_str(if index > 0 { ", " } else { "" });
                write_in_line(item, out);
            }
            out.push(']');
        }
        Shape::Map(entries) => {
            out.push('{');
            for (index, (key, value)) in entries.iter().enumerate() {
                out.push_str(if index > 0 { ", " } else { "" });
                out.push_str(&word(key));
                out.push_str(": ");
                write_in_line(value, out);
            }
            out.push('}');
        }
    }
}

/// A key as it is written.
fn word(key: &str) -> String {
    let is_word = !key.is_empty() && key.chars().all(|c| c.is_alphanumeric() || "_<".contains(c));
    if is_word { key.to_owned() } else { quote(key) }
}

fn quote(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// Notes the places in the files for the values of the written text.
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
    origins.entry(written.value.offset).or_insert(piece.value);
    if let (Some(at), Some(place)) = (written.key, piece.key) {
        origins.insert(at.offset, place);
    }
}
