//! Places of each key and value of a YAML text, by path.

use super::diagnostic::TextSpan;

/// The shape of a document with the place of every key and value. An alias has no inner places: what lies in it is
/// found at the alias.
#[derive(Debug)]
pub(super) struct Outline {
    pub(super) root: Option<Node>,
}

/// One value.
#[derive(Clone, Debug)]
pub(super) struct Node {
    /// Place of the key of the value, if it has one.
    pub(super) key: Option<TextSpan>,
    /// Place of the value; for a list or mapping in block style only its start.
    pub(super) value: TextSpan,
    pub(super) content: Content,
    pub(super) form: Form,
}

/// Style of a value, as far as it matters for writing it again.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Form {
    /// The number of its anchor, from 1; 0 without one.
    pub(super) anchor: usize,
    /// Whether it is a text in quotes or a block of text.
    pub(super) is_quoted: bool,
}

/// Content of a value.
#[derive(Clone, Debug)]
pub(super) enum Content {
    /// Plain or quoted text.
    Scalar(String),
    /// A reference to the anchor of this number.
    Alias(usize),
    /// Entries in the order of the file.
    List(Vec<Node>),
    /// Entries by key in the order of the file.
    Map(Vec<(String, Node)>),
}

/// One step of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step<'a> {
    Key(&'a str),
    Index(usize),
}

/// The steps of a path such as `drives[0].profile`.
pub(super) fn steps(path: &str) -> impl Iterator<Item = Step<'_>> {
    path.split(['.', '[']).filter(|part| !part.is_empty()).map(|part| match part.strip_suffix(']') {
        Some(index) => index.parse().map_or(Step::Key(part), Step::Index),
        None => Step::Key(part),
    })
}

impl Node {
    /// Returns the place to point at: a value that can be seen as a whole, else its key.
    pub(super) fn place(&self) -> TextSpan {
        match (&self.content, self.key) {
            (Content::List(_) | Content::Map(_), Some(key)) if self.value.length == 0 => key,
            _ => self.value,
        }
    }

    /// Describes the value in words.
    pub(super) fn describe(&self) -> String {
        match &self.content {
            Content::Scalar(text) if text.is_empty() || self.value.length == 0 => "empty".to_owned(),
            Content::Scalar(text) if text.chars().count() > 40 => "a long text".to_owned(),
            Content::Scalar(text) => format!("`{}`", text.escape_debug()),
            Content::Alias(_) => "an alias".to_owned(),
            Content::List(items) if items.len() == 1 => "a list of 1 entry".to_owned(),
            Content::List(items) => format!("a list of {} entries", items.len()),
            Content::Map(entries) if entries.is_empty() => "an empty group".to_owned(),
            Content::Map(_) => "a group of keys".to_owned(),
        }
    }

    fn child(&self, step: Step<'_>) -> Option<&Node> {
        match (&self.content, step) {
            (Content::List(items), Step::Index(index)) => items.get(index),
            (Content::Map(entries), Step::Key(wanted)) => {
                let direct = entries.iter().find(|(key, _)| key == wanted).map(|(_, node)| node);
                // The key of a choice (`coupling: {admittance: {..}}`) is not part of a path in the checked tree.
                match (direct, entries.as_slice()) {
                    (None, [(_, only)]) => only.child(step),
                    (direct, _) => direct,
                }
            }
            _ => None,
        }
    }

    fn path_at(&self, offset: usize, here: &str) -> Option<(String, &Node)> {
        if self.key.is_some_and(|key| key.offset == offset) {
            return Some((here.to_owned(), self));
        }
        let inner = match &self.content {
            Content::Map(entries) => entries.iter().find_map(|(key, node)| {
                let path = if here.is_empty() { key.clone() } else { format!("{here}.{key}") };
                node.path_at(offset, &path)
            }),
            Content::List(items) => {
                items.iter().enumerate().find_map(|(index, node)| node.path_at(offset, &format!("{here}[{index}]")))
            }
            Content::Scalar(_) | Content::Alias(_) => None,
        };
        inner.or_else(|| (self.value.offset == offset).then(|| (here.to_owned(), self)))
    }
}

impl Outline {
    /// The value at a path.
    pub(super) fn find(&self, path: &str) -> Option<&Node> {
        steps(path).try_fold(self.root.as_ref()?, |node, step| node.child(step))
    }

    /// Returns the value at a path, or the nearest existing part of the path.
    pub(super) fn nearest(&self, path: &str) -> Option<&Node> {
        let mut node = self.root.as_ref()?;
        for step in steps(path) {
            match node.child(step) {
                Some(child) => node = child,
                None => break,
            }
        }
        Some(node)
    }

    /// Path and value of the key or value that starts at a byte offset.
    pub(super) fn path_at(&self, offset: usize) -> Option<(String, &Node)> {
        self.root.as_ref()?.path_at(offset, "")
    }

    /// The keys of the document.
    pub(super) fn top_keys(&self) -> impl Iterator<Item = &str> {
        let entries = match &self.root {
            Some(Node { content: Content::Map(entries), .. }) => entries.as_slice(),
            _ => &[],
        };
        entries.iter().map(|(key, _)| key.as_str())
    }
}

/// Whether an unquoted word means null.
pub(super) fn is_null(word: &str) -> bool {
    word.is_empty() || word == "~" || word.eq_ignore_ascii_case("null")
}
