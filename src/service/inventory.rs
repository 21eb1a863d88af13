//! All objects of a device with their values: by its data sheet, or found by asking.

use std::collections::BTreeMap;
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

/// Where objects may lie: communication, vendor, profiles. What is above belongs to network variables and bridges.
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
/// Objects whose reading empties them, or takes for ever: a program, an error log of the vendor.
const PROGRAMS: std::ops::Range<u16> = 0x1f50..0x1f60;

/// An object without a value, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnreadObject {
    /// The object.
    pub at: Address,
    /// Why there is none.
    pub why: Error,
}

/// All objects of a device with their values as they are now, found by asking for every index there may be. Nothing is written.
///
/// A data type that neither the standards nor the length tell is OCTET_STRING; whether an object may be written, only a data sheet
/// tells, so that all are taken to be. `progress` is told the share that is done, 0 to 1.
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

/// The same of a device on any bus, into a sheet that says who it is; `node_id` is 0 where there is none. Where the device lists its objects,
/// those are read.
///
/// # Errors
/// As [`inventory`].
pub fn inventory_of(
    objects: &mut (impl ObjectAccess + ?Sized),
    node_id: u8,
    mut eds: Eds,
    mut progress: impl FnMut(f64),
) -> Result<(Eds, Vec<UnreadObject>), Error> {
    let mut missed = Vec::new();
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
        if let Some(object) = object(objects, node_id, index, &mut missed)? {
            entries += object.entries.len();
            bytes += object.entries.values().map(size).sum::<usize>();
            eds.objects.insert(index, object);
        }
        if entries + missed.len() > MOST_ENTRIES || bytes > MOST_BYTES {
            return Err(Error::Boundless(entries));
        }
    }
    let count = |from: u16| eds.objects.range(from..from + 0x200).count() as u16;
    (eds.device.rpdos, eds.device.tpdos) = (Some(count(0x1400)), Some(count(0x1800)));
    progress(1.0);
    Ok((eds, missed))
}

/// The object at an index; `None` if there is none.
fn object(
    objects: &mut (impl ObjectAccess + ?Sized),
    node_id: u8,
    index: u16,
    missed: &mut Vec<UnreadObject>,
) -> Result<Option<Object>, Error> {
    let mut entries = BTreeMap::new();
    let first = match objects.read(Address::new(index, 0)) {
        Err(Error::Refused(AbortCode::NO_OBJECT)) => return Ok(None),
        Err(error @ (Error::Link(_) | Error::Interrupted | Error::NoAnswer)) => return Err(error),
        first => first,
    };
    let mut take = |sub: u8, answer: Result<Vec<u8>, Error>| {
        let at = Address::new(index, sub);
        match answer {
            Ok(bytes) => {
                entries.insert(sub, entry(at, &bytes, node_id));
                Ok(true)
            }
            Err(Error::Refused(AbortCode::NO_OBJECT | AbortCode::NO_SUB_INDEX)) => Ok(false),
            Err(error @ (Error::Link(_) | Error::Interrupted)) => Err(error),
            Err(why) => {
                missed.push(UnreadObject { at, why });
                Ok(true)
            }
        }
    };
    let count = match &first {
        Ok(bytes) if bytes.len() == 1 => bytes.first().copied().unwrap_or_default(),
        // Without a first entry the others are looked for where most devices have them.
        Err(Error::Refused(AbortCode::NO_SUB_INDEX)) => 8,
        _ => 0,
    };
    take(0, first)?;
    let mut has_more = false;
    // A variable that happens to be one byte long has nothing at sub-index 1.
    if count > 0 && count < u8::MAX && take(1, objects.read(Address::new(index, 1)))? {
        has_more = true;
        for sub in 2..=count {
            take(sub, objects.read(Address::new(index, sub)))?;
        }
    }
    if entries.is_empty() {
        return Ok(None);
    }
    let name = known(Address::new(index, 0), None).map_or_else(|| format!("object-{index:04x}"), |known| known.name);
    let kind = if has_more { Kind::Record } else { Kind::Variable };
    let name = if has_more { format!("object-{index:04x}") } else { name };
    Ok(Some(Object { name, kind, entries, line: 0 }))
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

/// A data sheet with the values that the device has now. What may not be read has none.
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
            Ok(bytes) => entry.value = Some(of_node(at, Value::from_bytes(entry.data_type, &bytes), node_id)),
            Err(error @ (Error::Link(_) | Error::Interrupted | Error::NoAnswer)) => return Err(error),
            Err(why) => missed.push(UnreadObject { at, why }),
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

/// The data type of a value of this length, where nothing else tells it: an unsigned number of one, two, four or eight bytes.
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
}
