//! SDO information: what objects a device has.
//!
//! ```text
//! CoE header | operation 7 bits, incomplete 1 bit | 0 | fragments left 2 | data
//! ```

use super::super::{array, u16_at, u32_at};
use super::wire::{HEADER, Service, Writer};
use crate::objects::{AbortCode, Access, Address, DataType, Description, Mappable, ObjectDictionary};

/// Bytes before the data.
pub(super) const INFORMATION: usize = HEADER + 4;
const INCOMPLETE: u8 = 0x80;

/// Operations; a response has the number of its request and one.
pub(super) mod operation {
    pub(in super::super) const LIST: u8 = 1;
    pub(in super::super) const OBJECT: u8 = 3;
    pub(in super::super) const ENTRY: u8 = 5;
    pub(in super::super) const ERROR: u8 = 7;
}

/// Objects of a list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum ListKind {
    /// Lengths of the five lists.
    Lengths = 0,
    /// All objects.
    All = 1,
    /// Objects that outputs can carry.
    Outputs = 2,
    /// Objects that inputs can carry.
    Inputs = 3,
    /// Objects to store for the replacement of a device.
    Backup = 4,
    /// Objects that are set at the start.
    Settings = 5,
}

impl ListKind {
    const LISTS: [ListKind; 5] =
        [ListKind::All, ListKind::Outputs, ListKind::Inputs, ListKind::Backup, ListKind::Settings];

    /// Returns the list of a number; `None` for a number without a list.
    pub const fn from_number(number: u16) -> Option<Self> {
        Some(match number {
            0 => ListKind::Lengths,
            1 => ListKind::All,
            2 => ListKind::Outputs,
            3 => ListKind::Inputs,
            4 => ListKind::Backup,
            5 => ListKind::Settings,
            _ => return None,
        })
    }

    fn holds(self, member: &Description) -> bool {
        match self {
            ListKind::Lengths => false,
            ListKind::All => true,
            ListKind::Outputs => matches!(member.mappable, Mappable::Rpdo | Mappable::Both),
            ListKind::Inputs => matches!(member.mappable, Mappable::Tpdo | Mappable::Both),
            ListKind::Backup | ListKind::Settings => {
                member.access == Access::ReadWrite && member.mappable == Mappable::No
            }
        }
    }

    fn holds_index(self, od: &ObjectDictionary, index: u16) -> bool {
        od.under(index).any(|member| self.holds(&member))
    }
}

/// Returns all indices of a dictionary, ascending.
fn indices(od: &ObjectDictionary) -> impl Iterator<Item = u16> {
    let mut next = Some(0);
    std::iter::from_fn(move || {
        let index = od.next_index(next?)?.at.index;
        next = index.checked_add(1);
        Some(index)
    })
}

/// Puts the words of a list into `value`, which is empty, the kind before them.
pub(super) fn list(od: &ObjectDictionary, kind: ListKind, value: &mut Vec<u8>) {
    value.extend_from_slice(&(kind as u16).to_le_bytes());
    if kind == ListKind::Lengths {
        for list in ListKind::LISTS {
            let count = indices(od).filter(|index| list.holds_index(od, *index)).count() as u16;
            value.extend_from_slice(&count.to_le_bytes());
        }
    } else {
        indices(od)
            .filter(|index| kind.holds_index(od, *index))
            .for_each(|index| value.extend_from_slice(&index.to_le_bytes()));
    }
}

/// Writes the fragment of a response from `sent` on; returns the bytes of the message and those of the response in it.
pub(super) fn fragment(buffer: &mut [u8], operation: u8, value: &[u8], sent: usize) -> (usize, usize) {
    let room = buffer.len().saturating_sub(INFORMATION);
    let rest = value.get(sent..).unwrap_or_default();
    // Words are not torn.
    let part = rest.get(..room & !1).unwrap_or(rest);
    let left = rest.len() - part.len();
    let fragments = left.div_ceil((room & !1).max(1)) as u16;
    let [low, high] = fragments.to_le_bytes();
    let incomplete = if left > 0 { INCOMPLETE } else { 0 };
    let written = Writer::new(buffer, Service::Information).put(&[operation | incomplete, 0, low, high]).put(part);
    (written.finish(), part.len())
}

/// Writes an error; returns its number of bytes.
pub(super) fn error(buffer: &mut [u8], code: AbortCode) -> usize {
    let written = Writer::new(buffer, Service::Information).put(&[operation::ERROR, 0, 0, 0]);
    written.put(&code.0.to_le_bytes()).finish()
}

/// Writes a request; returns its number of bytes.
pub(super) fn request(buffer: &mut [u8], operation: u8, data: &[u8]) -> usize {
    Writer::new(buffer, Service::Information).put(&[operation, 0, 0, 0]).put(data).finish()
}

/// Contents of a message of SDO information.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Information<'a> {
    pub(super) operation: u8,
    pub(super) fragments_left: u16,
    pub(super) data: &'a [u8],
}

/// Reads a message; `None` if it is too short.
pub(super) fn decode(message: &[u8]) -> Option<Information<'_>> {
    let data = message.get(INFORMATION..)?;
    let [operation, _] = array(message, HEADER);
    Some(Information { operation: operation & !INCOMPLETE, fragments_left: u16_at(message, HEADER + 2), data })
}

/// Structure of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ObjectCode {
    /// One value.
    Variable = 7,
    /// Values of one type.
    Array = 8,
    /// Values of several types.
    Record = 9,
}

/// Description of an object by its device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ObjectDescription {
    /// Index.
    pub index: u16,
    /// Index of the data type.
    pub data_type: u16,
    /// Highest sub-index.
    pub highest_sub: u8,
    /// Number of what it is made of, as [`ObjectCode`].
    pub code: u8,
    /// Name, as it came: not checked for control characters.
    pub name: String,
}

impl ObjectDescription {
    /// Reads the description from the data of a response; `None` if it is too short.
    pub(super) fn decode(data: &[u8]) -> Option<Self> {
        let head: &[u8; 6] = data.first_chunk()?;
        Some(ObjectDescription {
            index: u16_at(head, 0),
            data_type: u16_at(head, 2),
            highest_sub: head[4],
            code: head[5],
            name: text(data.get(6..).unwrap_or_default()),
        })
    }
}

/// Description of an entry by its device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EntryDescription {
    /// Its address.
    pub at: Address,
    /// Index of the data type.
    pub data_type: u16,
    /// Length in bits.
    pub bits: u16,
    /// Access rights: see the constants.
    pub access: u16,
    /// Name, as it came: not checked for control characters.
    pub name: String,
}

impl EntryDescription {
    /// It may be read in PRE-OP, SAFE-OP and OP.
    pub const READ: u16 = 0x0007;
    /// It may be written in PRE-OP, SAFE-OP and OP.
    pub const WRITE: u16 = 0x0038;
    /// Outputs can carry it.
    pub const OUTPUT: u16 = 1 << 6;
    /// Inputs can carry it.
    pub const INPUT: u16 = 1 << 7;
    /// It has to be stored for a device to be replaced.
    pub const BACKUP: u16 = 1 << 8;
    /// It is set at the start.
    pub const SETTING: u16 = 1 << 9;

    /// Reads the description from the data of a response; `None` if it is too short. Unit, default and limits would be part of the name,
    /// but the master does not request them.
    pub(super) fn decode(data: &[u8]) -> Option<Self> {
        let head: &[u8; 10] = data.first_chunk()?;
        Some(EntryDescription {
            at: Address::new(u16_at(head, 0), head[2]),
            data_type: u16_at(head, 4),
            bits: u16_at(head, 6),
            access: u16_at(head, 8),
            name: text(data.get(10..).unwrap_or_default()),
        })
    }
}

fn text(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| char::from(*byte)).collect()
}

/// Returns the index of the type of records that the standard does not describe: PDO mapping, or any other.
fn record_type(index: u16) -> u16 {
    match index {
        0x1018 => 0x23,
        0x1600..=0x17ff | 0x1a00..=0x1bff => 0x21,
        0x1c32 | 0x1c33 => 0x29,
        _ => 0x2a,
    }
}

/// Puts the description of an object into `value`, which is empty.
pub(super) fn describe_object(od: &ObjectDictionary, index: u16, value: &mut Vec<u8>) -> Result<(), AbortCode> {
    let first = od.under(index).next().ok_or(AbortCode::NO_OBJECT)?;
    let highest = od.under(index).last().map_or(0, |last| last.at.sub);
    let mut members = od.under(index).filter(|member| member.at.sub > 0).map(|member| member.data_type);
    let (code, data_type) = match members.next() {
        None => (ObjectCode::Variable, first.data_type as u16),
        Some(data_type) if members.all(|other| other == data_type) && record_type(index) == 0x2a => {
            (ObjectCode::Array, data_type as u16)
        }
        Some(_) => (ObjectCode::Record, record_type(index)),
    };
    value.extend_from_slice(&index.to_le_bytes());
    value.extend_from_slice(&data_type.to_le_bytes());
    value.extend_from_slice(&[highest, code as u8]);
    value.extend_from_slice(first.name.as_bytes());
    Ok(())
}

/// Puts the description of an entry into `value`, which is empty. Unit, default and limits are left out.
pub(super) fn describe_entry(od: &ObjectDictionary, at: Address, value: &mut Vec<u8>) -> Result<(), AbortCode> {
    let entry = od.describe(at)?;
    let mut access = match entry.access {
        Access::ReadOnly | Access::Const => EntryDescription::READ,
        Access::WriteOnly => EntryDescription::WRITE,
        Access::ReadWrite => EntryDescription::READ | EntryDescription::WRITE,
    };
    for (list, bit) in [
        (ListKind::Outputs, EntryDescription::OUTPUT),
        (ListKind::Inputs, EntryDescription::INPUT),
        (ListKind::Backup, EntryDescription::BACKUP),
        (ListKind::Settings, EntryDescription::SETTING),
    ] {
        access |= if list.holds(&entry) { bit } else { 0 };
    }
    let bits = entry.data_type.bits().map_or(8 * entry.capacity, usize::from).min(usize::from(u16::MAX)) as u16;
    value.extend_from_slice(&at.index.to_le_bytes());
    value.extend_from_slice(&[at.sub, 0]);
    for word in [entry.data_type as u16, bits, access] {
        value.extend_from_slice(&word.to_le_bytes());
    }
    let name = match (entry.name, at.sub) {
        ("", 0) if entry.data_type == DataType::Unsigned8 => "SubIndex 000",
        (name, _) => name,
    };
    value.extend_from_slice(name.as_bytes());
    Ok(())
}

/// Returns the abort code of an error response.
pub(super) fn error_code(data: &[u8]) -> AbortCode {
    AbortCode(u32_at(data, 0))
}
