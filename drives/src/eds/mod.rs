//! Electronic data sheets (EDS) and device configuration files (DCF): what objects a device has, and what they are set to.
//!
//! ```text
//! bytes -> text (UTF-8, UTF-16, or Latin-1 as old files are) -> sections with lines -> Eds, and findings
//! Eds with values -> DCF (text), concise DCF (object 1F22h) -> values
//! ```
//!
//! Files of vendors break the standard in many ways. The reader takes everything that it can read; each oddity is a [`Finding`]
//! with its line. It refuses a file that is no data sheet at all.
//!
//! # Source
//! CiA 306-1, *Electronic data sheet specification*, 1.3.

mod bytes;
mod concise;
mod ini;
mod modules;
mod number;
mod read;
#[cfg(test)]
mod tests;
mod write;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

pub use concise::{ConciseEntry, ConciseError, concise, is_concise, read_concise};

/// Largest file that is read, in bytes.
pub const MAX_BYTES: usize = 4 << 20;
/// Largest number of oddities that are reported for one file.
pub const MAX_FINDINGS: usize = 1000;
/// Most entries that a file may have: as many as a full `CompactSubObj` of some hundred arrays.
pub const MAX_ENTRIES: usize = 100_000;

/// Contents of a data sheet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Eds {
    /// Vendor, product and what it supports.
    pub device: DeviceInfo,
    /// Objects by index.
    pub objects: BTreeMap<u16, Object>,
    /// Data types that may be mapped as dummies, by their index.
    pub dummies: BTreeSet<u16>,
    /// Modules that can be plugged in, by their number less 1.
    pub modules: Vec<Module>,
    /// Modules that are plugged in, from the first slot on, by their numbers from 1: a DCF says so. Their objects are among `objects`.
    pub connected: Vec<u8>,
    /// The node that a DCF is for.
    pub node: Option<Node>,
}

/// Vendor and product.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceInfo {
    /// Name of the vendor.
    pub vendor: String,
    /// 1018h:01.
    pub vendor_number: Option<u32>,
    /// Name of the product.
    pub product: String,
    /// 1018h:02.
    pub product_number: Option<u32>,
    /// 1018h:03.
    pub revision_number: Option<u32>,
    /// Bit rates in kbit/s that it has.
    pub bit_rates_kbit_per_s: Vec<u32>,
    /// Number of RPDOs.
    pub rpdos: Option<u16>,
    /// Number of TPDOs.
    pub tpdos: Option<u16>,
    /// Whether its node id and bit rate can be set by LSS.
    pub has_lss: bool,
}

/// The node of a device configuration file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Node {
    /// 1 to 127; 0 of a device without one, as on EtherCAT.
    pub id: u8,
    /// Its name.
    pub name: String,
    /// In kbit/s.
    pub bit_rate_kbit_per_s: Option<u32>,
}

/// A module that can be plugged into the device.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Module {
    /// Name of the product.
    pub name: String,
    /// Code for ordering the product.
    pub order_code: String,
    /// Objects that are there once such a module is plugged in, by index.
    pub fixed: BTreeMap<u16, Object>,
    /// Entries that each such module adds.
    pub extensions: Vec<Extension>,
}

/// Entries that a module adds to an object.
#[derive(Clone, Debug, PartialEq)]
pub struct Extension {
    /// Index of the object.
    pub index: u16,
    /// Description that each of the entries has.
    pub entry: Entry,
    /// How much each module adds.
    pub adds: Adds,
    /// The last sub-index before the object of the next index is used; 0 if none is.
    pub last_sub: u8,
}

/// How much a module adds to an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Adds {
    /// So many entries.
    Entries(u8),
    /// So many bits; modules side by side share an entry.
    Bits(u8),
}

/// One object: a variable, or entries under one index.
#[derive(Clone, Debug, PartialEq)]
pub struct Object {
    /// Name.
    pub name: String,
    /// Kind of the object.
    pub kind: Kind,
    /// Entries by sub-index; a variable has the one at 0.
    pub entries: BTreeMap<u8, Entry>,
    /// Line of its section.
    pub line: usize,
}

/// Kind of an object; the numbers are those of CiA 301.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A block of bytes.
    Domain = 2,
    /// The definition of a type.
    TypeDefinition = 5,
    /// The definition of a record.
    RecordDefinition = 6,
    /// One value.
    Variable = 7,
    /// Values of one type.
    Array = 8,
    /// Values of several types.
    Record = 9,
}

/// One entry of the object dictionary.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Name.
    pub name: String,
    /// Data type by its index, as 0007h for UNSIGNED32.
    pub data_type: u16,
    /// Permission to read and write it.
    pub access: Access,
    /// Value after a reset.
    pub default: Option<Value>,
    /// Value that a DCF sets it to.
    pub value: Option<Value>,
    /// Least value.
    pub low: Option<Value>,
    /// Greatest value.
    pub high: Option<Value>,
    /// Whether it may be mapped into a PDO.
    pub is_mappable: bool,
    /// Whether the device refuses it, or does something else, when all values are written (bit 0 of `ObjFlags`).
    pub is_kept_from_download: bool,
    /// Line of its section.
    pub line: usize,
}

/// Permission to read and write an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Read, and it never changes.
    Constant,
    /// Read.
    ReadOnly,
    /// Write.
    WriteOnly,
    /// Read and write.
    ReadWrite,
    /// Read and write; mapped into a TPDO.
    ReadWriteInput,
    /// Read and write; mapped into an RPDO.
    ReadWriteOutput,
}

impl Access {
    /// Whether an SDO may write it.
    pub fn is_writable(self) -> bool {
        !matches!(self, Self::Constant | Self::ReadOnly)
    }

    /// Whether an SDO may read it.
    pub fn is_readable(self) -> bool {
        self != Self::WriteOnly
    }
}

/// A value of an entry.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A whole number.
    Integer(i128),
    /// A whole number to which the node id is added.
    OfNode(i128),
    /// A finite number.
    Real(f64),
    /// Text.
    Text(String),
    /// Bytes.
    Bytes(Vec<u8>),
}

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// The file can be used, and this part of it should be looked at.
    Warning,
    /// This part of the file is left out.
    Error,
}

/// An oddity of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Line, from 1.
    pub line: usize,
    /// How much it matters.
    pub level: Level,
    /// Description of the oddity.
    pub message: String,
    /// How the reader treats it, or text to write in its place.
    pub help: &'static str,
}

impl fmt::Display for Finding {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "line {}: {}; {}", self.line, self.message, self.help)
    }
}

/// Why a file is no data sheet.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EdsError {
    /// It is too large to be one.
    #[error("is larger than {MAX_BYTES} bytes")]
    Large,
    /// It has zeros in it.
    #[error("line {line}: is no text in UTF-8, UTF-16 or Latin-1")]
    NotText {
        /// Line of the first zero.
        line: usize,
    },
    /// No section is that of an object.
    #[error("line {line}: the file ends and has no object: no section is called as an index, such as [1000]")]
    NoObject {
        /// Its last line.
        line: usize,
    },
    /// More entries than any device has.
    #[error("line {line}: has more than {MAX_ENTRIES} entries")]
    Many {
        /// Line of the object with which they are too many.
        line: usize,
    },
}

/// A data sheet as it was read.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// The data sheet.
    pub eds: Eds,
    /// Its oddities, in the order of the lines.
    pub findings: Vec<Finding>,
}

impl Eds {
    /// Reads an EDS or a DCF.
    ///
    /// # Errors
    /// If it is none.
    pub fn read(bytes: &[u8]) -> Result<Reading, EdsError> {
        read::read(bytes)
    }

    /// The entry at an index and a sub-index.
    pub fn entry(&self, index: u16, sub: u8) -> Option<&Entry> {
        self.objects.get(&index)?.entries.get(&sub)
    }

    /// All entries with their addresses, in order.
    pub fn entries(&self) -> impl Iterator<Item = (u16, u8, &Entry)> {
        self.objects
            .iter()
            .flat_map(|(index, object)| object.entries.iter().map(move |(sub, entry)| (*index, *sub, entry)))
    }

    /// The addresses of all entries of this name: that of a variable, that of an entry, or both with a dot between, as
    /// `identity object.vendor id`. Blanks, dashes, underlines and case do not count.
    pub fn named(&self, name: &str) -> Vec<(u16, u8)> {
        let wanted = bare(name);
        let is_meant = |object: &Object, sub: u8, entry: &Entry| match object.kind {
            Kind::Variable | Kind::Domain => bare(&object.name) == wanted,
            _ => {
                let own = bare(&entry.name);
                own == wanted
                    || format!("{}.{own}", bare(&object.name)) == wanted
                    || (sub == 0 && bare(&object.name) == wanted)
            }
        };
        let objects = self.objects.iter();
        objects
            .flat_map(|(index, object)| object.entries.iter().map(move |(sub, entry)| (*index, *sub, object, entry)))
            .filter(|(_, sub, object, entry)| !wanted.is_empty() && is_meant(object, *sub, entry))
            .map(|(index, sub, ..)| (index, sub))
            .collect()
    }
}

/// A name without what people write in different ways.
fn bare(name: &str) -> String {
    name.chars().filter(|one| one.is_alphanumeric() || *one == '.').flat_map(char::to_lowercase).collect()
}
