//! Conversion of the outline of a text into a tree of types; the text itself is read once.
//!
//! The deserializer of the YAML crate is large, and was compiled again for each type of the tree. This reader walks existing
//! values, knows the path of each, and so names the wrong key.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::de::value::StrDeserializer;
use serde::de::{
    DeserializeOwned, DeserializeSeed, Deserializer, EnumAccess, Error, Expected, IntoDeserializer, MapAccess,
    SeqAccess, Unexpected, VariantAccess, Visitor,
};
use serde::forward_to_deserialize_any;

use super::diagnostic::TextSpan;
use super::number::{NOT_FINITE, TOO_LARGE};
use super::outline::{Content, Node, Outline, is_null};
use super::yaml::{Cause, Fault, outline};

/// The key whose group or list of groups is merged into the group that it stands in.
const MERGE: &str = "<<";

/// Reads a text into a tree.
///
/// # Errors
/// As [`outline`] and [`read`].
pub(super) fn parse<T: DeserializeOwned>(text: &str) -> Result<T, Fault> {
    read(&outline(text)?)
}

/// Reads an outline into a tree.
///
/// # Errors
/// The first value that does not fit the tree, with its path.
pub(super) fn read<T: DeserializeOwned>(outline: &Outline) -> Result<T, Fault> {
    let Some(root) = &outline.root else { return Err(Fault { cause: Cause::Empty, place: None, path: None }) };
    let mut anchors = BTreeMap::new();
    note_anchors(root, &mut anchors);
    let reader = Reader { node: root, anchors: &anchors };
    T::deserialize(reader).map_err(|refusal| *refusal.at(root.place()).0)
}

fn note_anchors<'a>(node: &'a Node, anchors: &mut Anchors<'a>) {
    if node.form.anchor > 0 {
        anchors.insert(node.form.anchor, node);
    }
    match &node.content {
        Content::List(items) => items.iter().for_each(|item| note_anchors(item, anchors)),
        Content::Map(entries) => entries.iter().for_each(|(_, value)| note_anchors(value, anchors)),
        Content::Scalar(_) | Content::Alias(_) => {}
    }
}

/// Values by the number of their anchor.
type Anchors<'a> = BTreeMap<usize, &'a Node>;

/// A fault, small enough to be handed up from everywhere.
#[derive(Debug)]
struct Refusal(Box<Fault>);

impl Refusal {
    fn new(cause: Cause) -> Self {
        Self(Box::new(Fault { cause, place: None, path: Some(String::new()) }))
    }

    fn wrong_type(expected: &dyn Expected) -> Self {
        Self::new(Cause::WrongType { expected: expected.to_string() })
    }

    /// Places a fault that has no place yet.
    fn at(mut self, place: TextSpan) -> Self {
        self.0.place.get_or_insert(place);
        self
    }

    /// Puts a step before the path of a fault.
    fn within(mut self, step: &str) -> Self {
        if let Some(path) = &mut self.0.path {
            let joint = if path.is_empty() || path.starts_with('[') { "" } else { "." };
            *path = format!("{step}{joint}{path}");
        }
        self
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{:?}", self.0.cause)
    }
}

impl std::error::Error for Refusal {}

impl Error for Refusal {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self::new(match message.to_string() {
            message if message == NOT_FINITE => Cause::NotFinite,
            message if message == TOO_LARGE => Cause::TooLarge,
            message => Cause::Syntax { message },
        })
    }

    fn invalid_type(_: Unexpected<'_>, expected: &dyn Expected) -> Self {
        Self::wrong_type(expected)
    }

    fn invalid_value(_: Unexpected<'_>, expected: &dyn Expected) -> Self {
        Self::wrong_type(expected)
    }

    fn invalid_length(_: usize, expected: &dyn Expected) -> Self {
        Self::wrong_type(expected)
    }

    fn unknown_variant(word: &str, known: &'static [&'static str]) -> Self {
        Self::new(Cause::UnknownChoice { word: word.to_owned(), known: known.to_vec() })
    }

    fn unknown_field(key: &str, known: &'static [&'static str]) -> Self {
        Self::new(Cause::UnknownKey { key: key.to_owned(), known: known.to_vec() })
    }

    fn missing_field(key: &'static str) -> Self {
        Self::new(Cause::MissingKey { key })
    }
}

/// Reads one value.
#[derive(Clone, Copy)]
struct Reader<'de> {
    node: &'de Node,
    anchors: &'de Anchors<'de>,
}

impl<'de> Reader<'de> {
    /// Returns the value, or the value that an alias repeats. A missing anchor was refused before.
    fn content(self) -> (&'de Content, bool) {
        let mut node = self.node;
        while let Content::Alias(anchor) = &node.content {
            match self.anchors.get(anchor) {
                Some(target) => node = target,
                None => break,
            }
        }
        (&node.content, node.form.is_quoted)
    }

    fn is_null(self) -> bool {
        matches!(self.content(), (Content::Scalar(text), false) if is_null(text))
    }

    /// The text of a scalar, as `read` understands it.
    fn scalar<T>(self, expected: &dyn Expected, read: fn(&str) -> Option<T>) -> Result<T, Refusal> {
        let value = match self.content().0 {
            Content::Scalar(text) => read(text.trim()),
            _ => None,
        };
        value.ok_or_else(|| Refusal::wrong_type(expected))
    }

    fn entries(self, expected: &dyn Expected) -> Result<Entries<'de>, Refusal> {
        let mut all = Vec::new();
        match self.content().0 {
            Content::Map(entries) => all.extend(entries.iter().map(|(key, node)| (key.as_str(), node))),
            // A group of which nothing is written.
            _ if self.is_null() => {}
            _ => return Err(Refusal::wrong_type(expected)),
        }
        let merges: Vec<&Node> = all.extract_if(.., |(key, _)| *key == MERGE).map(|(_, node)| node).collect();
        for node in merges {
            let merged = Self { node, ..self };
            let groups: Vec<Self> = match merged.content().0 {
                Content::List(groups) => groups.iter().map(|node| Self { node, ..self }).collect(),
                _ => vec![merged],
            };
            for group in groups {
                for (key, node) in group.entries(expected)?.left {
                    if all.iter().all(|(own, _)| *own != key) {
                        all.push((key, node));
                    }
                }
            }
        }
        Ok(Entries { left: all.into_iter(), value: None, seen: BTreeSet::new(), anchors: self.anchors })
    }
}

/// A whole number of YAML 1.2: decimal without leading zeros, hexadecimal, octal or binary; `_` may stand between two digits.
fn whole(text: &str) -> Option<i128> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let lower = digits.to_ascii_lowercase();
    let of = |prefix: &str, radix: u32| Some((lower.strip_prefix(prefix)?, radix));
    let (digits, radix) = of("0x", 16).or(of("0o", 8)).or(of("0b", 2)).unwrap_or((&lower, 10));
    let is_padded = radix == 10 && digits.len() > 1 && digits.starts_with('0');
    let is_digits =
        !is_padded && digits.split('_').all(|part| !part.is_empty() && part.chars().all(|c| c.is_digit(radix)));
    is_digits.then(|| i128::from_str_radix(&digits.replace('_', ""), radix).ok()).flatten().map(|number| sign * number)
}

fn signed(text: &str) -> Option<i64> {
    whole(text)?.try_into().ok()
}

fn unsigned(text: &str) -> Option<u64> {
    whole(text)?.try_into().ok()
}

/// Parses a number of YAML 1.2. A number too large for an `f64` is no number.
fn number(text: &str) -> Option<f64> {
    match text.to_ascii_lowercase().as_str() {
        ".nan" => Some(f64::NAN),
        ".inf" | "+.inf" => Some(f64::INFINITY),
        "-.inf" => Some(f64::NEG_INFINITY),
        _ => text.parse().ok().filter(|number: &f64| number.is_finite()),
    }
}

fn truth(text: &str) -> Option<bool> {
    match text.to_ascii_lowercase().as_str() {
        "true" => Some(true),
        "false" => Some(false),
        _ => None,
    }
}

macro_rules! scalars {
    ($($method:ident $visit:ident $read:ident;)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
            let value = self.scalar(&visitor, $read)?;
            visitor.$visit(value)
        })*
    };
}

impl<'de> Deserializer<'de> for Reader<'de> {
    type Error = Refusal;

    scalars! {
        deserialize_bool visit_bool truth;
        deserialize_i8 visit_i64 signed;
        deserialize_i16 visit_i64 signed;
        deserialize_i32 visit_i64 signed;
        deserialize_i64 visit_i64 signed;
        deserialize_u8 visit_u64 unsigned;
        deserialize_u16 visit_u64 unsigned;
        deserialize_u32 visit_u64 unsigned;
        deserialize_u64 visit_u64 unsigned;
        deserialize_f32 visit_f64 number;
        deserialize_f64 visit_f64 number;
    }

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.content().0 {
            Content::List(_) => self.deserialize_seq(visitor),
            Content::Map(_) => self.deserialize_map(visitor),
            _ => self.deserialize_str(visitor),
        }
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.content().0 {
            Content::Scalar(text) if !self.is_null() => visitor.visit_borrowed_str(text),
            _ => Err(Refusal::wrong_type(&visitor)),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        self.deserialize_str(visitor)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        if self.is_null() { visitor.visit_none() } else { visitor.visit_some(self) }
    }

    fn deserialize_unit<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        if self.is_null() { visitor.visit_unit() } else { Err(Refusal::wrong_type(&visitor)) }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(self, _: &'static str, visitor: V) -> Result<V::Value, Refusal> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        let Content::List(items) = self.content().0 else { return Err(Refusal::wrong_type(&visitor)) };
        let mut left = Items { items, next: 0, anchors: self.anchors };
        let length = Length(items.len());
        let value = visitor.visit_seq(&mut left)?;
        if left.next < items.len() { Err(Refusal::wrong_type(&length)) } else { Ok(value) }
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, Refusal> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        let entries = self.entries(&visitor)?;
        match visitor.visit_map(entries) {
            // Nothing is written where something is wanted.
            Err(Refusal(fault)) if self.is_null() && matches!(fault.cause, Cause::MissingKey { .. }) => {
                Err(Refusal::wrong_type(&"a group of keys"))
            }
            result => result,
        }
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        self.deserialize_map(visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        match self.content().0 {
            Content::Scalar(word) if !self.is_null() => {
                visitor.visit_enum(Choice { word, place: self.node.place(), group: None })
            }
            Content::Map(entries) => match entries.as_slice() {
                [] => Err(Refusal::wrong_type(&"a group with one key")),
                [(word, node)] => {
                    let group = Self { node, ..self };
                    visitor.visit_enum(Choice { word, place: node.key.unwrap_or(node.value), group: Some(group) })
                }
                [_, (_, second), ..] => Err(Refusal::new(Cause::SecondChoice).at(second.key.unwrap_or(second.value))),
            },
            _ => Err(Refusal::wrong_type(&"a group with one key")),
        }
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        visitor.visit_unit()
    }

    forward_to_deserialize_any! { i128 u128 char bytes byte_buf unit_struct tuple_struct identifier }
}

/// A list with a length other than the expected one.
struct Length(usize);

impl Expected for Length {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "fewer than {} entries", self.0)
    }
}

/// The items of a list.
struct Items<'de> {
    items: &'de [Node],
    next: usize,
    anchors: &'de Anchors<'de>,
}

impl<'de> SeqAccess<'de> for &mut Items<'de> {
    type Error = Refusal;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, Refusal> {
        let index = self.next;
        let Some(node) = self.items.get(index) else { return Ok(None) };
        self.next += 1;
        let item = seed.deserialize(Reader { node, anchors: self.anchors });
        item.map(Some).map_err(|refusal| refusal.at(node.place()).within(&format!("[{index}]")))
    }
}

/// The entries of a group, merged ones last.
struct Entries<'de> {
    left: std::vec::IntoIter<(&'de str, &'de Node)>,
    value: Option<(&'de str, &'de Node)>,
    seen: BTreeSet<&'de str>,
    anchors: &'de Anchors<'de>,
}

impl<'de> MapAccess<'de> for Entries<'de> {
    type Error = Refusal;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, Refusal> {
        self.value = self.left.next();
        let Some((key, node)) = self.value else { return Ok(None) };
        let place = node.key.unwrap_or(node.value);
        let refuse = |cause| Err(Refusal::new(cause).at(place).within(key));
        if node.key.is_none() {
            return refuse(Cause::Syntax { message: "a key is a word, without brackets".to_owned() });
        }
        if !self.seen.insert(key) {
            return refuse(Cause::DuplicateKey { key: Some(key.to_owned()) });
        }
        let word: StrDeserializer<'de, Refusal> = key.into_deserializer();
        seed.deserialize(word).map(Some).map_err(|refusal| refusal.at(place).within(key))
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, Refusal> {
        let Some((key, node)) = self.value.take() else { return Err(Refusal::custom("a value without a key")) };
        let value = seed.deserialize(Reader { node, anchors: self.anchors });
        value.map_err(|refusal| refusal.at(node.place()).within(key))
    }
}

/// A choice: a word, or a group with it for its only key.
struct Choice<'de> {
    word: &'de str,
    place: TextSpan,
    group: Option<Reader<'de>>,
}

impl<'de> EnumAccess<'de> for Choice<'de> {
    type Error = Refusal;
    type Variant = Self;

    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Self), Refusal> {
        let word: StrDeserializer<'de, Refusal> = self.word.into_deserializer();
        let choice = seed.deserialize(word).map_err(|refusal| refusal.at(self.place))?;
        Ok((choice, self))
    }
}

impl<'de> Choice<'de> {
    /// Reads the value behind the word.
    fn read<T>(self, read: impl FnOnce(Reader<'de>) -> Result<T, Refusal>) -> Result<T, Refusal> {
        let Some(group) = self.group else { return Err(Refusal::wrong_type(&"a group with one key")) };
        read(group).map_err(|refusal| refusal.at(group.node.place()).within(self.word))
    }
}

impl<'de> VariantAccess<'de> for Choice<'de> {
    type Error = Refusal;

    fn unit_variant(self) -> Result<(), Refusal> {
        match self.group {
            Some(group) if !group.is_null() => self.read(|_| Err(Refusal::wrong_type(&"nothing"))),
            _ => Ok(()),
        }
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, Refusal> {
        self.read(|group| seed.deserialize(group))
    }

    fn tuple_variant<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, Refusal> {
        self.read(|group| group.deserialize_seq(visitor))
    }

    fn struct_variant<V: Visitor<'de>>(self, _: &'static [&'static str], visitor: V) -> Result<V::Value, Refusal> {
        self.read(|group| group.deserialize_map(visitor))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde::Deserialize;

    use super::*;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Tree {
        gain: f64,
        count: u8,
        is_on: bool,
        name: String,
        limit: Option<i32>,
        pair: [f64; 2],
        choice: Choice,
        by_name: BTreeMap<String, i64>,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(rename_all = "snake_case", deny_unknown_fields)]
    enum Choice {
        Nothing,
        Single(f64),
        Group { radius: f64 },
    }

    const TREE: &str = "gain: 2\ncount: 0x1f\nis_on: true\nname: a\nlimit: ~\npair: [1, -.5e1]\nchoice: {group: {radius: 1.5}}\nby_name: {b: -0b11, c: 0o17}\n";

    fn read_with(from: &str, to: &str) -> Result<Tree, (String, String)> {
        assert!(TREE.contains(from), "{from}");
        parse(&TREE.replacen(from, to, 1))
            .map_err(|Fault { cause, path, .. }| (format!("{cause:?}"), path.unwrap_or_default()))
    }

    #[test]
    fn a_text_becomes_the_tree() {
        let tree = read_with("", "").unwrap();
        let by_name = [("b".to_owned(), -3), ("c".to_owned(), 15)].into();
        let choice = Choice::Group { radius: 1.5 };
        let name = "a".to_owned();
        let wanted = Tree { gain: 2.0, count: 31, is_on: true, name, limit: None, pair: [1.0, -5.0], choice, by_name };
        assert_eq!(tree, wanted);
        assert_eq!(read_with("{group: {radius: 1.5}}", "nothing").unwrap().choice, Choice::Nothing);
        assert_eq!(read_with("{group: {radius: 1.5}}", "{single: .5}").unwrap().choice, Choice::Single(0.5));
        assert_eq!(read_with("limit: ~", "limit: 7").unwrap().limit, Some(7));
        assert_eq!(read_with("count: 0x1f", "count: 1_0_0").unwrap().count, 100);
        assert_eq!(read_with("count: 0x1f", "count: 0X1_F").unwrap().count, 31);
        assert_eq!(read_with("name: a", "name: 'null'").unwrap().name, "null");
        assert_eq!(read_with("name: a", "name: 12").unwrap().name, "12");
        assert!(read_with("gain: 2", "gain: .nan").unwrap().gain.is_nan());
    }

    #[test]
    fn each_fault_has_the_path_of_its_value() {
        for (from, to, cause, path) in [
            ("gain: 2", "gain: strong", "WrongType", "gain"),
            ("gain: 2", "gain: inf", "WrongType", "gain"),
            ("gain: 2", "gain: 1e999", "WrongType", "gain"),
            ("count: 0x1f", "count: 256", "WrongType", "count"),
            ("count: 0x1f", "count: 007", "WrongType", "count"),
            ("count: 0x1f", "count: 0x-1", "WrongType", "count"),
            ("count: 0x1f", "count: 1__0", "WrongType", "count"),
            ("count: 0x1f", "count: _1", "WrongType", "count"),
            ("count: 0x1f", "count: 1.0", "WrongType", "count"),
            ("is_on: true", "is_on: yes", "WrongType", "is_on"),
            ("name: a", "name: null", "WrongType", "name"),
            ("name: a", "name: [a]", "WrongType", "name"),
            ("limit: ~", "limit: 1e3", "WrongType", "limit"),
            ("pair: [1, ", "pair: [x, ", "WrongType", "pair[0]"),
            ("pair: [1, ", "pair: [1, 1, ", "WrongType", "pair"),
            ("pair: [1, -.5e1]", "pair: [1]", "WrongType", "pair"),
            ("radius: 1.5", "radius: ", "WrongType", "choice.group.radius"),
            ("radius: 1.5", "", "MissingKey", "choice.group"),
            ("radius: 1.5", "radius: 1, side: 2", "UnknownKey", "choice.group.side"),
            ("group: {radius: 1.5}", "groop: {radius: 1.5}", "UnknownChoice", "choice"),
            ("{group: {radius: 1.5}}", "group", "WrongType", "choice"),
            ("{group: {radius: 1.5}}", "{group: {radius: 1.5}, nothing: }", "SecondChoice", "choice"),
            ("{group: {radius: 1.5}}", "{}", "WrongType", "choice"),
            ("{group: {radius: 1.5}}", "{nothing: 1}", "WrongType", "choice.nothing"),
            ("b: -0b11", "b: 1, b: 2", "DuplicateKey", "by_name.b"),
            ("b: -0b11", "[b]: 1", "Syntax", "by_name"),
            ("gain: 2\n", "", "MissingKey", ""),
        ] {
            let (found, at) = read_with(from, to).unwrap_err();
            assert!(found.starts_with(cause) && at == path, "{to}: {found} at `{at}`");
        }
    }

    #[test]
    fn aliases_and_merged_groups_are_what_they_repeat() {
        let repeated: BTreeMap<String, Vec<f64>> = parse("one: &one [2.5]\ntwo: *one\n").unwrap();
        assert_eq!(repeated["two"], [2.5]);
        type Groups = BTreeMap<String, BTreeMap<String, f64>>;
        let merged: Groups =
            parse("base: &base {a: 1, b: 2}\nmore: &more {b: 3, c: 4}\nown: {<<: [*base, *more], a: 5}\n").unwrap();
        assert_eq!(
            merged["own"],
            [("a", 5.0), ("b", 2.0), ("c", 4.0)].map(|(key, value)| (key.to_owned(), value)).into()
        );
        let fault = parse::<Groups>("base: {a: 1}\nown: {<<: 1}\n").unwrap_err();
        assert!(matches!(fault.cause, Cause::WrongType { .. }) && fault.path.as_deref() == Some("own"), "{fault:?}");
    }
}
