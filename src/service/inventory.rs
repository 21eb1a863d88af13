//! All objects of a device with their values: by its data sheet, or found by asking.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use yieldwall_drives::eds::{Access, DeviceInfo, Eds, Entry, Kind, Node, Object, Value};

use super::connection::{Error, Service};
use super::known::{known, type_held};
use super::object_access::ObjectAccess;
use super::scan::{identify, of_node};
use yieldwall_fieldbus::canopen::NodeId;
use yieldwall_fieldbus::canopen::lss::{LssAddress, LssOutcome, LssRequest};
use yieldwall_fieldbus::objects::{AbortCode, Address};
use yieldwall_link::CanLink;

/// Ranges of the indices of objects: communication, vendor, profiles. Indices above belong to network variables and bridges.
const RANGES: [std::ops::Range<u16>; 3] = [0x1000..0x2000, 0x2000..0x6000, 0x6000..0xa000];
/// Data types of values by their length, where nothing says which: UNSIGNED8, 16, 32, 64; else OCTET_STRING.
const BY_LENGTH: [(usize, u16); 4] = [(1, 0x05), (2, 0x06), (4, 0x07), (8, 0x1b)];
const VISIBLE_STRING: u16 = 0x09;
const OCTET_STRING: u16 = 0x0a;
const DOMAIN: u16 = 0x0f;
const U8: u16 = 0x05;
/// How long a device may take to answer that it has LSS.
const LSS_ANSWER: Duration = Duration::from_millis(200);
/// Entries that are looked for at most, and bytes of their values: more than a device with the largest dictionary has.
const MOST_ENTRIES: usize = 16_384;
const MOST_BYTES: usize = 16 << 20;
/// Bytes to which a device fills a number up at most.
const MOST_FILLED: usize = 8;
/// Objects whose reading empties them, or takes for ever: a program, an error log of the vendor.
const PROGRAMS: std::ops::Range<u16> = 0x1f50..0x1f60;

/// An object without a value, or with one that is not certain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnreadObject {
    /// The object.
    pub at: Address,
    /// The reason.
    pub why: Unread,
}

/// Why an object has no value, or none that is certain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unread {
    /// The device gives no value.
    Failed(Error),
    /// The device fills answers up, and nothing gives the type of the value in this one, whose length is in bytes.
    Padded(usize),
    /// The answer, whose length is in bytes, is no value of the type that the data sheet gives.
    Unfit(usize),
}

impl Unread {
    /// Whether the device has answered with a value that the inventory cannot vouch for.
    pub fn is_uncertain(self) -> bool {
        !matches!(self, Self::Failed(_))
    }
}

impl fmt::Display for Unread {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Failed(error) => error.fmt(out),
            Self::Padded(bytes) => {
                write!(out, "comes with {bytes} bytes from a device that fills answers up: its type is not known")
            }
            Self::Unfit(bytes) => {
                write!(out, "comes with {bytes} bytes that are no value of its type in the data sheet")
            }
        }
    }
}

/// Findings of an inventory beside the values.
#[derive(Default)]
struct Doubts {
    missed: Vec<UnreadObject>,
    /// Entries whose type only their length gives, and that may be filled up; with their lengths.
    by_length: Vec<(Address, usize)>,
    /// Whether a value whose length CiA 301 fixes came with more bytes.
    is_padding: bool,
}

/// All objects of a device with their values as they are now, found by asking for every index there may be. Nothing is written.
///
/// If neither the standards nor the length determine the data type, it is OCTET_STRING. Only a data sheet says whether an object
/// may be written; the inventory therefore marks every object as writable. `progress` gets the share that is done, 0 to 1.
///
/// # Errors
/// [`Error::Link`], [`Error::Interrupted`], [`Error::NoAnswer`] if the device falls silent, and [`Error::Boundless`] if it answers for more
/// objects than there can be.
pub fn inventory<L: CanLink>(
    service: &mut Service<L>,
    node: NodeId,
    progress: impl FnMut(f64),
) -> Result<(Eds, Vec<UnreadObject>), Error> {
    let eds = sheet(service, node)?;
    inventory_of(&mut service.objects(node), node.raw(), eds, progress)
}

/// Reads the inventory of a device on any bus, into a sheet with its identity; `node_id` is 0 where there is none. If the device
/// lists its objects, only those are read.
///
/// # Errors
/// As [`inventory`].
pub fn inventory_of(
    objects: &mut (impl ObjectAccess + ?Sized),
    node_id: u8,
    mut eds: Eds,
    mut progress: impl FnMut(f64),
) -> Result<(Eds, Vec<UnreadObject>), Error> {
    let mut doubts = Doubts::default();
    let (mut entries, mut bytes) = (0, 0);
    // Below 1000h are types, not objects.
    let listed = objects.indices()?.map(|listed| listed.into_iter().filter(|index| *index >= 0x1000).collect());
    let indices: Vec<u16> = listed.unwrap_or_else(|| RANGES.into_iter().flatten().collect());
    for (done, index) in indices.iter().copied().enumerate() {
        if done.is_multiple_of(0x100) {
            progress(done as f64 / indices.len() as f64);
        }
        if PROGRAMS.contains(&index) {
            continue;
        }
        if let Some(object) = object(objects, node_id, index, &mut doubts)? {
            entries += object.entries.len();
            bytes += object.entries.values().map(size).sum::<usize>();
            eds.objects.insert(index, object);
        }
        if entries + doubts.missed.len() > MOST_ENTRIES || bytes > MOST_BYTES {
            return Err(Error::Boundless(entries));
        }
    }
    let count = |from: u16| eds.objects.range(from..from + 0x200).count() as u16;
    (eds.device.rpdos, eds.device.tpdos) = (Some(count(0x1400)), Some(count(0x1800)));
    progress(1.0);
    let Doubts { mut missed, by_length, is_padding } = doubts;
    if is_padding {
        missed.extend(by_length.into_iter().map(|(at, length)| UnreadObject { at, why: Unread::Padded(length) }));
        missed.sort_by_key(|missed| (missed.at.index, missed.at.sub));
    }
    Ok((eds, missed))
}

/// The object at an index; `None` if there is none.
fn object(
    objects: &mut (impl ObjectAccess + ?Sized),
    node_id: u8,
    index: u16,
    doubts: &mut Doubts,
) -> Result<Option<Object>, Error> {
    let mut entries = BTreeMap::new();
    let mut first = match objects.read(Address::new(index, 0)) {
        Err(Error::Refused(AbortCode::NO_OBJECT)) => return Ok(None),
        Err(error @ (Error::Link(_) | Error::Interrupted | Error::NoAnswer)) => return Err(error),
        first => first,
    };
    // A longer answer is no count that was filled up.
    let may_count = first.as_ref().map_or(true, |bytes| bytes.len() <= MOST_FILLED);
    let is_list = may_count && is_list(index);
    let count = if may_count { count(index, is_list, &first) } else { 0 };
    let mut take = |sub: u8, answer: Result<Vec<u8>, Error>| {
        let at = Address::new(index, sub);
        match answer {
            Ok(bytes) => {
                let entry = entry(at, &bytes, node_id);
                doubts.weigh(at, &bytes, entry.data_type);
                entries.insert(sub, entry);
                Ok(true)
            }
            Err(Error::Refused(AbortCode::NO_OBJECT | AbortCode::NO_SUB_INDEX)) => Ok(false),
            Err(error @ (Error::Link(_) | Error::Interrupted)) => Err(error),
            Err(why) => {
                doubts.missed.push(UnreadObject { at, why: Unread::Failed(why) });
                Ok(true)
            }
        }
    };
    // A variable that happens to be a small number has nothing at sub-index 1. A list may lack its first entry.
    let mut has_more = count > 0 && take(1, objects.read(Address::new(index, 1)))?;
    if has_more || is_list {
        for sub in 2..=count {
            has_more |= take(sub, objects.read(Address::new(index, sub)))?;
        }
    }
    let mut is_filled = false;
    if let (Ok(bytes), true) = (&mut first, is_list || has_more) {
        is_filled = bytes.len() > 1;
        // Sub-index 0 of a list is a count, whatever its length.
        bytes.truncate(1);
    }
    take(0, first)?;
    doubts.is_padding |= is_filled;
    if entries.is_empty() {
        return Ok(None);
    }
    let name = known(Address::new(index, 0), None).map_or_else(|| format!("object-{index:04x}"), |known| known.name);
    let kind = if has_more { Kind::Record } else { Kind::Variable };
    let name = if has_more { format!("object-{index:04x}") } else { name };
    Ok(Some(Object { name, kind, entries, line: 0 }))
}

/// Whether the standards have entries at an index, of which sub-index 0 holds the number.
fn is_list(index: u16) -> bool {
    let has_count = known(Address::new(index, 0), None).is_none_or(|known| known.data_type == U8);
    has_count && known(Address::new(index, 1), None).is_some()
}

/// Returns how many entries after sub-index 0 are worth a request, 0 to 254, from its answer. A list has the number in its first
/// byte. For an unknown object, a small number of any length counts.
fn count(index: u16, is_list: bool, first: &Result<Vec<u8>, Error>) -> u8 {
    let count = match first {
        Ok(bytes) if is_list => bytes.first().copied().unwrap_or_default(),
        Ok(bytes) if known(Address::new(index, 0), None).is_none() => match bytes.split_first() {
            Some((count, more)) if more.iter().all(|byte| *byte == 0) => *count,
            _ => 0,
        },
        // Without a first entry the others are looked for where most devices have them.
        Err(Error::Refused(AbortCode::NO_SUB_INDEX)) => 8,
        _ => 0,
    };
    if count < u8::MAX { count } else { 0 }
}

impl Doubts {
    /// Notes whether an answer is longer than CiA 301 has it, and whether its type is a guess that the length of the answer gives.
    fn weigh(&mut self, at: Address, bytes: &[u8], data_type: u16) {
        let standard = type_held(at, None, bytes);
        // Bytes of a whole number, from the number of its values.
        let size = |data_type: u16| Value::range(data_type).map(|range| (range.end - range.start).ilog2().div_ceil(8));
        let is_longer = standard.and_then(size).is_some_and(|size| bytes.len() > size as usize);
        self.is_padding |= is_longer && at.index < 0x2000;
        let may_be_filled = bytes.len() > 1 && matches!(bytes.last(), Some(0 | 0xff));
        if standard != Some(data_type) && may_be_filled {
            self.by_length.push((at, bytes.len()));
        }
    }
}

/// Bytes of a value that is not a number.
fn size(entry: &Entry) -> usize {
    match &entry.value {
        Some(Value::Text(text)) => text.len(),
        Some(Value::Bytes(bytes)) => bytes.len(),
        _ => 0,
    }
}

fn entry(at: Address, bytes: &[u8], node_id: u8) -> Entry {
    let known = known(at, None);
    let by_length = || type_by_length(bytes.len());
    let is_text = || !bytes.is_empty() && bytes.iter().all(|byte| matches!(byte, 0x20..0x7f | 0));
    // A string of four letters is more often a number.
    let data_type = match (type_held(at, None, bytes), by_length()) {
        (Some(data_type), _) => data_type,
        (None, Some(data_type)) => data_type,
        (None, None) if is_text() => VISIBLE_STRING,
        (None, None) => OCTET_STRING,
    };
    let data_type = match Value::from_bytes(data_type, bytes) {
        Value::Bytes(_) if data_type != DOMAIN => by_length().unwrap_or(OCTET_STRING),
        _ => data_type,
    };
    let is_fixed =
        at.sub == 0 && data_type == U8 && known.as_ref().is_some_and(|known| known.name == "highest-sub-index");
    Entry {
        name: known.map_or_else(|| format!("entry-{}", at.sub), |known| known.name),
        data_type,
        access: if is_fixed { Access::Constant } else { Access::ReadWrite },
        default: None,
        value: Some(of_node(at, Value::from_bytes(data_type, bytes), node_id)),
        low: None,
        high: None,
        is_mappable: false,
        is_kept_from_download: false,
        line: 0,
    }
}

/// Returns a data sheet with the present values of the device. An object that may not be read has none.
///
/// # Errors
/// [`Error::Link`], [`Error::Interrupted`], and [`Error::NoAnswer`] if the device falls silent.
pub fn values_of(
    objects: &mut (impl ObjectAccess + ?Sized),
    node_id: u8,
    sheet: &Eds,
    mut progress: impl FnMut(f64),
) -> Result<(Eds, Vec<UnreadObject>), Error> {
    let mut eds = sheet.clone();
    eds.node = Some(Node { id: node_id, ..Node::default() });
    let mut missed = Vec::new();
    let all = sheet.entries().count().max(1);
    let entries = eds
        .objects
        .iter_mut()
        .flat_map(|(index, object)| object.entries.iter_mut().map(|(sub, entry)| (*index, *sub, entry)));
    for (done, (index, sub, entry)) in entries.enumerate() {
        progress(done as f64 / all as f64);
        entry.value = None;
        let is_program = PROGRAMS.contains(&index) || entry.data_type == DOMAIN;
        // Below 1000h are types, not objects.
        if !entry.access.is_readable() || is_program || index < 0x1000 {
            continue;
        }
        let at = Address::new(index, sub);
        match objects.read(at) {
            Ok(bytes) => match Value::from_bytes(entry.data_type, &bytes) {
                Value::Bytes(bytes) if Value::range(entry.data_type).is_some() => {
                    missed.push(UnreadObject { at, why: Unread::Unfit(bytes.len()) });
                }
                value => entry.value = Some(of_node(at, value, node_id)),
            },
            Err(error @ (Error::Link(_) | Error::Interrupted | Error::NoAnswer)) => return Err(error),
            Err(why) => missed.push(UnreadObject { at, why: Unread::Failed(why) }),
        }
    }
    progress(1.0);
    Ok((eds, missed))
}

/// A data sheet of values alone, as a backup has them.
pub fn sheet_of(node_id: u8, values: &[(Address, Vec<u8>)], explained: Option<&Eds>) -> Eds {
    let mut sheet = Eds { node: Some(Node { id: node_id, ..Node::default() }), ..Eds::default() };
    for (at, bytes) in values {
        let known = known(*at, explained);
        let data_type = type_held(*at, explained, bytes).unwrap_or(OCTET_STRING);
        let entry = Entry {
            name: known.map_or_else(String::new, |known| known.name),
            data_type,
            access: Access::ReadWrite,
            default: None,
            value: Some(Value::from_bytes(data_type, bytes)),
            low: None,
            high: None,
            is_mappable: false,
            is_kept_from_download: false,
            line: 0,
        };
        let object = sheet.objects.entry(at.index).or_insert_with(|| Object {
            name: format!("object-{:04x}", at.index),
            kind: Kind::Variable,
            entries: BTreeMap::new(),
            line: 0,
        });
        object.entries.insert(at.sub, entry);
        if object.entries.len() > 1 || at.sub > 0 {
            object.kind = Kind::Record;
        }
    }
    sheet
}

/// Returns the data type of a value of this length, if nothing else determines it: an unsigned number of one, two, four or eight
/// bytes.
pub fn type_by_length(len: usize) -> Option<u16> {
    BY_LENGTH.iter().find(|(known, _)| *known == len).map(|(_, data_type)| *data_type)
}

/// An empty sheet with who the device is.
fn sheet<L: CanLink>(service: &mut Service<L>, node: NodeId) -> Result<Eds, Error> {
    let (identity, name) = identify(service, &[node])?.pop().unwrap_or_default();
    let [vendor_number, product_number, revision_number, _] = identity;
    let has_lss = match identity {
        [Some(vendor_id), Some(product_code), Some(revision), Some(serial)] => {
            let address = LssAddress { vendor_id, product_code, revision, serial };
            service.lss(LssRequest::Identify(address), LSS_ANSWER)? == LssOutcome::Done
        }
        _ => false,
    };
    let device = DeviceInfo {
        vendor: String::new(),
        vendor_number,
        product: name.unwrap_or_default(),
        product_number,
        revision_number,
        has_lss,
        ..DeviceInfo::default()
    };
    Ok(Eds { device, node: Some(Node { id: node.raw(), ..Node::default() }), ..Eds::default() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A device that has a value of so many bytes wherever it is asked for one.
    struct Agreeable(usize);

    impl ObjectAccess for Agreeable {
        fn read(&mut self, _: Address) -> Result<Vec<u8>, Error> {
            Ok(vec![8; self.0])
        }

        fn write(&mut self, _: Address, _: &[u8]) -> Result<(), Error> {
            Err(Error::NoAnswer)
        }
    }

    #[test]
    fn a_device_that_answers_for_everything_is_given_up() {
        for length in [1, 100, 100_000] {
            let end = inventory_of(&mut Agreeable(length), 1, Eds::default(), |_| ());
            let Err(Error::Boundless(entries)) = end else { panic!("{length}: {:?}", end.map(|_| ())) };
            assert!(entries <= MOST_ENTRIES + 0x100, "{length}: {entries}");
            assert!(length == 1 || entries * length <= MOST_BYTES + length, "{length}: {entries}");
        }
    }

    /// A device that fills its answers up with zeros to four bytes, or does not.
    struct Filling(usize, Vec<((u16, u8), Vec<u8>)>);

    impl Filling {
        fn new(length: usize) -> Self {
            let bytes = |number: u32| number.to_le_bytes().to_vec();
            let objects = vec![
                ((0x1000, 0), bytes(0x0002_0192)),
                ((0x1001, 0), vec![0]),
                ((0x1018, 0), vec![2]),
                ((0x1018, 1), bytes(0x5957)),
                ((0x1018, 2), bytes(0x0402)),
                ((0x1600, 0), vec![2]),
                ((0x1600, 1), bytes(0x6040_0010)),
                ((0x1600, 2), bytes(0x607a_0020)),
                // A list that lacks its first entry.
                ((0x1800, 0), vec![2]),
                ((0x1800, 2), vec![1]),
                ((0x1c12, 0), vec![1]),
                ((0x1c12, 1), vec![0, 0x16]),
                // Objects that nobody knows: a record, a variable that looks like a count, and one that fills its bytes.
                ((0x2000, 0), vec![1]),
                ((0x2000, 1), vec![7, 0]),
                ((0x2001, 0), vec![3, 0]),
                ((0x2002, 0), bytes(0x1234_5678)),
                ((0x6041, 0), vec![0x40, 0x02]),
            ];
            Self(length, objects)
        }
    }

    impl ObjectAccess for Filling {
        fn read(&mut self, at: Address) -> Result<Vec<u8>, Error> {
            let found = self.1.iter().find(|(place, _)| *place == (at.index, at.sub));
            let is_there = self.1.iter().any(|((index, _), _)| *index == at.index);
            let Some((_, bytes)) = found else {
                let code = if is_there { AbortCode::NO_SUB_INDEX } else { AbortCode::NO_OBJECT };
                return Err(Error::Refused(code));
            };
            let mut bytes = bytes.clone();
            bytes.resize(bytes.len().max(self.0), 0);
            Ok(bytes)
        }

        fn write(&mut self, _: Address, _: &[u8]) -> Result<(), Error> {
            Err(Error::NoAnswer)
        }
    }

    /// Entries with their values; a file in between, so that what the file cannot say does not count.
    fn values(eds: &Eds) -> Vec<((u16, u8), Value)> {
        let text = eds.to_dcf(&Node { id: 1, ..Node::default() });
        let read = Eds::read(text.as_bytes()).unwrap();
        assert_eq!(read.findings, []);
        read.eds.entries().filter_map(|(index, sub, entry)| Some(((index, sub), entry.value.clone()?))).collect()
    }

    #[test]
    fn a_device_that_fills_its_answers_up_loses_no_entry_and_no_doubt_is_silent() {
        let (plain, missed) = inventory_of(&mut Filling::new(1), 1, Eds::default(), |_| ()).unwrap();
        assert_eq!(missed, []);
        let places: Vec<(u16, u8)> = Filling::new(1).1.iter().map(|(place, _)| *place).collect();
        let plain = values(&plain);
        assert_eq!(plain.iter().map(|(place, _)| *place).collect::<Vec<_>>(), places);
        for length in [2, 4, 8] {
            let (filled, missed) = inventory_of(&mut Filling::new(length), 1, Eds::default(), |_| ()).unwrap();
            assert_eq!(values(&filled), plain, "{length} bytes");
            let doubtful: Vec<(u16, u8)> = missed.iter().map(|missed| (missed.at.index, missed.at.sub)).collect();
            let with_zeros =
                if length == 8 { &[(0x2000, 1), (0x2001, 0), (0x2002, 0)][..] } else { &[(0x2000, 1), (0x2001, 0)] };
            assert_eq!(doubtful, with_zeros, "{length} bytes");
            assert!(missed.iter().all(|missed| missed.why.is_uncertain()));
            // A data sheet gives the types.
            let (read, missed) = values_of(&mut Filling::new(length), 1, &filled, |_| ()).unwrap();
            assert_eq!((values(&read), missed), (plain.clone(), vec![]), "{length} bytes");
        }
    }

    #[test]
    fn an_answer_that_is_no_value_of_its_type_is_named() {
        let (mut sheet, _) = inventory_of(&mut Filling::new(1), 1, Eds::default(), |_| ()).unwrap();
        let entry = sheet.objects.get_mut(&0x2002).and_then(|object| object.entries.get_mut(&0)).unwrap();
        entry.data_type = U8;
        let (read, missed) = values_of(&mut Filling::new(4), 1, &sheet, |_| ()).unwrap();
        assert_eq!(missed, [UnreadObject { at: Address::new(0x2002, 0), why: Unread::Unfit(4) }]);
        assert_eq!(read.entry(0x2002, 0).unwrap().value, None);
    }
}
