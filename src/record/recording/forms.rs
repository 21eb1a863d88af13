//! The forms of a record: message definition, bytes, text; and what differs between two.

use std::fmt::Write;

use super::fields::{Field, Visitor};
use super::recorded::Recorded;
use super::scalar::Scalar;

/// Header before the data of a message: plain CDR, little-endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Returns the message definition: one line a field, with unit and meaning behind it, and before a field with few values these as
/// constants.
pub fn definition<T: Recorded>() -> String {
    let mut definition = Definition(T::HEAD.to_owned());
    T::blank().walk(&mut definition);
    definition.0
}

struct Definition(String);

impl Visitor for Definition {
    fn visit<S: Scalar>(&mut self, Field { name, unit, meaning }: Field, _: &mut S) {
        for (code, number) in S::codes() {
            let constant = format!("{name}_{code}").to_uppercase().replace('-', "_");
            // A string takes everything.
            let _ = writeln!(self.0, "{} {constant}={number}", S::TYPE);
        }
        let unit = if unit.is_empty() { String::new() } else { format!("[{unit}] ") };
        let _ = writeln!(self.0, "{} {name}  # {unit}{meaning}", S::TYPE);
    }
}

/// Returns the fields as a table of a document.
pub fn table<T: Recorded>() -> String {
    let head = String::from("| field | type | unit | meaning |\n|---|---|---|---|\n");
    let mut table = Table { text: head, seen: Vec::new() };
    T::blank().walk(&mut table);
    table.text
}

struct Table {
    text: String,
    /// The lists of codes so far, with the fields where they stand.
    seen: Vec<(String, &'static str)>,
}

impl Visitor for Table {
    fn visit<S: Scalar>(&mut self, Field { name, unit, meaning }: Field, _: &mut S) {
        let codes: Vec<String> = S::codes().into_iter().map(|(code, number)| format!("{number} {code}")).collect();
        let codes = codes.join(", ");
        let values = match self.seen.iter().find(|(seen, _)| *seen == codes) {
            _ if codes.is_empty() => String::new(),
            Some((_, first)) => format!(": numbers as for `{first}`"),
            None => format!(": {codes}"),
        };
        self.seen.push((codes, name));
        // A string takes everything.
        let _ = writeln!(self.text, "| `{name}` | {} | {unit} | {meaning}{values} |", S::TYPE);
    }
}

/// Puts the bytes of `record` into `out`, in place of what was there.
pub fn encode<T: Recorded>(record: &T, out: &mut Vec<u8>) {
    out.clear();
    out.extend_from_slice(&ENCAPSULATION);
    append(record, out);
}

/// Appends the data of `record` to `out`; alignment counts from its first byte.
fn append<T: Recorded>(record: &T, out: &mut Vec<u8>) {
    let start = out.len();
    { *record }.walk(&mut Encoder { out, start });
}

struct Encoder<'a> {
    out: &'a mut Vec<u8>,
    start: usize,
}

impl Visitor for Encoder<'_> {
    fn visit<S: Scalar>(&mut self, _: Field, value: &mut S) {
        let data = self.out.len() - self.start;
        self.out.resize(self.start + data.next_multiple_of(S::SIZE), 0);
        self.out.extend(value.bits().to_le_bytes().iter().take(S::SIZE));
    }
}

/// Reason why bytes are no record.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// Another encoding.
    #[error("a message does not begin as little-endian CDR does")]
    Encapsulation,
    /// Too few or too many bytes.
    #[error("a message of {length} bytes is too {}", if *.is_long { "long" } else { "short" })]
    Length {
        /// Bytes that there are.
        length: usize,
        /// Whether these are more than the fields take.
        is_long: bool,
    },
    /// A number that stands for nothing.
    #[error("{field} is {bits:#x}, which stands for nothing")]
    Value {
        /// The field.
        field: &'static str,
        /// Its bits.
        bits: u64,
    },
}

/// Returns the record that these bytes are.
///
/// # Errors
/// If the bytes are no record.
pub fn decode<T: Recorded>(bytes: &[u8]) -> Result<T, DecodeError> {
    let data = bytes.strip_prefix(&ENCAPSULATION).ok_or(DecodeError::Encapsulation)?;
    let mut decoder = Decoder { data, at: 0, error: None };
    let mut record = T::blank();
    record.walk(&mut decoder);
    match decoder.error {
        Some(error) => Err(error),
        None if decoder.at < data.len() => Err(DecodeError::Length { length: bytes.len(), is_long: true }),
        None => Ok(record),
    }
}

struct Decoder<'a> {
    data: &'a [u8],
    at: usize,
    error: Option<DecodeError>,
}

impl Visitor for Decoder<'_> {
    fn visit<S: Scalar>(&mut self, field: Field, value: &mut S) {
        if self.error.is_some() {
            return;
        }
        let from = self.at.next_multiple_of(S::SIZE);
        self.at = from + S::SIZE;
        let Some(bytes) = self.data.get(from..self.at) else {
            let length = self.data.len() + ENCAPSULATION.len();
            self.error = Some(DecodeError::Length { length, is_long: false });
            return;
        };
        let bits = bits_of(bytes);
        match S::of_bits(bits) {
            Some(read) => *value = read,
            None => self.error = Some(DecodeError::Value { field: field.name, bits }),
        }
    }
}

/// Returns the bits in at most eight little-endian bytes.
fn bits_of(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |bits, byte| bits << 8 | u64::from(*byte))
}

/// Alignment of a packed record in bytes: the size of the largest field.
const PACKED_ALIGNMENT: usize = 8;

/// Appends `record` to `out` as [`layout`] describes it: the data of [`encode`] without what stands before, and zeros up to
/// [`Layout::stride`].
pub fn pack<T: Recorded>(record: &T, out: &mut Vec<u8>) {
    let start = out.len();
    append(record, out);
    out.resize(start + (out.len() - start).next_multiple_of(PACKED_ALIGNMENT), 0);
}

/// Place of every field in a packed record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    /// The fields in the order of their offsets.
    pub fields: Vec<FieldLayout>,
    /// Distance from one record to the next in bytes, a multiple of 8.
    pub stride: usize,
}

/// Place of one field in a packed record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldLayout {
    /// Name, unique; ends in the unit where there is one.
    pub name: &'static str,
    /// Unit; empty for a number without one.
    pub unit: &'static str,
    /// Meaning in a few words.
    pub meaning: &'static str,
    /// Type as a message definition names it, such as `float64` or `uint8`.
    pub type_name: &'static str,
    /// First byte, from the first one of the record; a multiple of `size`.
    pub offset: usize,
    /// Size in bytes: 1, 2, 4 or 8.
    pub size: usize,
    /// Names with their numbers, where the value is one of few; of a set of devices the bits.
    pub codes: Vec<(String, u64)>,
}

impl Layout {
    /// Returns the field of this name.
    pub fn field(&self, name: &str) -> Option<&FieldLayout> {
        self.fields.iter().find(|field| field.name == name)
    }
}

impl FieldLayout {
    /// Returns the bits of this field in a packed record; `None` if the record is too short.
    pub fn bits(&self, record: &[u8]) -> Option<u64> {
        record.get(self.offset..self.offset + self.size).map(bits_of)
    }
}

/// Returns the layout of the records that [`pack`] writes.
pub fn layout<T: Recorded>() -> Layout {
    let mut layout = Layout::default();
    T::blank().walk(&mut layout);
    layout.stride = layout.stride.next_multiple_of(PACKED_ALIGNMENT);
    layout
}

impl Visitor for Layout {
    fn visit<S: Scalar>(&mut self, Field { name, unit, meaning }: Field, _: &mut S) {
        let offset = self.stride.next_multiple_of(S::SIZE);
        let (type_name, size, codes) = (S::TYPE, S::SIZE, S::codes());
        self.fields.push(FieldLayout { name, unit, meaning, type_name, offset, size, codes });
        self.stride = offset + size;
    }
}

/// Returns the names of the fields, between commas.
pub fn csv_header<T: Recorded>() -> String {
    let mut header = Header(String::new());
    T::blank().walk(&mut header);
    header.0
}

struct Header(String);

impl Visitor for Header {
    fn visit<S: Scalar>(&mut self, field: Field, _: &mut S) {
        separate(&mut self.0);
        self.0.push_str(field.name);
    }
}

/// Puts the values of `record`, between commas, into `out`, and replaces its previous contents. A number is written with as many digits as
/// distinguish it from its neighbours. An absent value is written as nothing.
pub fn csv_row<T: Recorded>(record: &T, out: &mut String) {
    out.clear();
    { *record }.walk(&mut Row(out));
}

struct Row<'a>(&'a mut String);

impl Visitor for Row<'_> {
    fn visit<S: Scalar>(&mut self, _: Field, value: &mut S) {
        separate(self.0);
        value.text(self.0);
    }

    fn visit_if<S: Scalar>(&mut self, is_there: bool, field: Field, value: &mut S) {
        if is_there {
            self.visit(field, value);
        } else {
            separate(self.0);
        }
    }
}

fn separate(text: &mut String) {
    if !text.is_empty() {
        text.push(',');
    }
}

/// The first field in which two records differ by their bits, with both values as text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// Name of the field.
    pub field: &'static str,
    /// Its value in the first record.
    pub one: String,
    /// Its value in the second record.
    pub other: String,
}

/// Returns the first difference between two records; `None` if they are the same, bit by bit.
pub fn difference<T: Recorded>(one: &T, other: &T) -> Option<Difference> {
    let mut values = Values(Vec::new());
    { *other }.walk(&mut values);
    let mut compare = Compare { others: values.0.into_iter(), found: None };
    { *one }.walk(&mut compare);
    compare.found
}

struct Values(Vec<(u64, String)>);

impl Visitor for Values {
    fn visit<S: Scalar>(&mut self, _: Field, value: &mut S) {
        self.0.push((value.bits(), exact(*value)));
    }
}

struct Compare {
    others: std::vec::IntoIter<(u64, String)>,
    found: Option<Difference>,
}

impl Visitor for Compare {
    fn visit<S: Scalar>(&mut self, field: Field, value: &mut S) {
        if let Some((bits, other)) = self.others.next()
            && bits != value.bits()
            && self.found.is_none()
        {
            self.found = Some(Difference { field: field.name, one: exact(*value), other });
        }
    }
}

/// Returns a value as text, with its bits where these may differ although the text does not.
fn exact<S: Scalar>(value: S) -> String {
    let mut text = String::new();
    value.text(&mut text);
    if S::TYPE == f64::TYPE {
        let _ = write!(text, " ({:016x}h)", value.bits());
    }
    text
}
