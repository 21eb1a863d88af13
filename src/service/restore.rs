//! Putting the objects of a device to the values of a file.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use yieldwall_drives::eds::{Eds, Entry, Value};
use yieldwall_drives::objects::of_first_axis;

use super::caution::Caution;
use super::connection::Error;
use super::known::{Known, known};
use super::object_access::ObjectAccess;
use yieldwall_fieldbus::objects::{AbortCode, Address};

/// Bit 31 of a COB-ID: the PDO is not used.
const NOT_USED: u32 = 0x8000_0000;

/// One write.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Step {
    /// The object.
    pub at: Address,
    /// Its name.
    pub name: String,
    /// Data type by its number.
    pub data_type: u16,
    /// Present value; `None` if it could not be read.
    pub old: Option<Vec<u8>>,
    /// New value.
    pub new: Vec<u8>,
    /// Whether it has to hold that afterwards: not while a PDO is taken out of use for the time being.
    pub is_final: bool,
}

/// Why a value of the file stays out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Why {
    /// It is not for this.
    Caution(Caution),
    /// Neither a data sheet nor the standards say what the object is.
    Unexplained,
    /// The device does not let it be read, so that it is not known whether it differs, and it could not be put back.
    Unreadable(Error),
    /// The value has no place in the object's type.
    Unfit,
    /// A data sheet keeps it from being written with all others.
    KeptFromDownload,
}

impl fmt::Display for Why {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Caution(caution) => caution.fmt(out),
            Self::Unexplained => out.write_str("is explained by neither data sheet nor standard"),
            Self::Unreadable(error) => write!(out, "cannot be read: {error}"),
            Self::Unfit => out.write_str("does not fit the object's type"),
            Self::KeptFromDownload => {
                out.write_str("is not to be written with all others, by its data sheet (ObjFlags)")
            }
        }
    }
}

/// A value of the file that stays out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// The object.
    pub at: Address,
    /// Its name.
    pub name: String,
    /// Why.
    pub why: Why,
}

/// Reaction of a device to a write.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WriteOutcome {
    /// It holds the value.
    Written,
    /// It refuses, and holds what it held.
    Refused(AbortCode),
    /// It confirmed, and holds something else.
    Holds(Vec<u8>),
}

/// Objects to write, in this order, and objects that are left out although they differ.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Plan {
    /// The writes.
    pub steps: Vec<Step>,
    /// Objects that are left out.
    pub left_out: Vec<LeftOut>,
}

/// Plans the writes that give a device the values of a file; `node_id` is 0 on EtherCAT. An object is written if `explained` (a
/// data sheet) or the standards know it. PDOs are taken out of use while their parameters change: on CAN by their identifier, on
/// EtherCAT by the assignment of their sync manager.
///
/// # Errors
/// [`Error::Link`], [`Error::Interrupted`], and [`Error::NoAnswer`] if the device falls silent.
pub fn plan(
    objects: &mut (impl ObjectAccess + ?Sized),
    node_id: u8,
    wanted: &Eds,
    explained: Option<&Eds>,
) -> Result<Plan, Error> {
    let mut plan = Plan::default();
    let mut changes: BTreeMap<(u16, u8), Step> = BTreeMap::new();
    for (index, sub, entry) in wanted.entries() {
        let at = Address::new(index, sub);
        let Some(Asked { known, wanted }) = asked(at, entry, explained, node_id) else { continue };
        let name = known.as_ref().map_or_else(|| entry.name.clone(), |known| known.name.clone());
        let mut leave_out = |why: Why| plan.left_out.push(LeftOut { at, name: name.clone(), why });
        let forms = match wanted {
            Ok(forms) => forms,
            Err(why) => {
                leave_out(why);
                continue;
            }
        };
        let old = match objects.read(at) {
            Ok(old) => old,
            Err(error @ (Error::Link(_) | Error::Interrupted | Error::NoAnswer)) => return Err(error),
            Err(error) => {
                leave_out(Why::Unreadable(error));
                continue;
            }
        };
        // The length of the answer shows which of the types is the device's own.
        let form = forms.iter().find(|(_, bytes)| bytes.len() == old.len()).or(forms.first());
        let Some((data_type, new)) = form.cloned() else { continue };
        if old == new || Value::from_bytes(data_type, &old) == Value::from_bytes(data_type, &new) {
            continue;
        }
        match (Caution::of_restore(at, &name), &known) {
            (Some(caution), _) => leave_out(Why::Caution(caution)),
            (None, None) => leave_out(Why::Unexplained),
            (None, Some(_)) => {
                changes.insert((index, sub), Step { at, name, data_type, old: Some(old), new, is_final: true });
            }
        }
    }
    plan.steps = in_order(objects, changes)?;
    Ok(plan)
}

/// Value that a file requests for an entry.
struct Asked {
    /// Known facts about the object.
    known: Option<Known>,
    /// Data types that have a place for the value, with its bytes, the likeliest first; or why it is not written.
    wanted: Result<Vec<(u16, Vec<u8>)>, Why>,
}

/// Returns the value that a file requests for an entry; `None` if the file has no value, or if the object only shows something.
fn asked(at: Address, entry: &Entry, explained: Option<&Eds>, node_id: u8) -> Option<Asked> {
    let value = entry.value.as_ref().filter(|_| entry.access.is_writable() && at.index >= 0x1000)?;
    let known = known(at, explained);
    if known.as_ref().is_some_and(|known| known.is_writable == Some(false)) || is_shown(at) {
        return None;
    }
    let of_sheet = explained.and_then(|eds| eds.entry(at.index, at.sub));
    // Drives may have another type than the standard: theirs is in the data sheet, or else in the file.
    let standard = known.as_ref().map_or(entry.data_type, |known| known.data_type);
    let own = if of_sheet.is_some() { standard } else { entry.data_type };
    let forms =
        [standard, own].into_iter().filter_map(|data_type| Some((data_type, value.to_bytes(data_type, node_id)?)));
    let forms: Vec<_> = forms.collect();
    let wanted = if entry.is_kept_from_download || of_sheet.is_some_and(|entry| entry.is_kept_from_download) {
        Err(Why::KeptFromDownload)
    } else if forms.is_empty() {
        Err(Why::Unfit)
    } else {
        Ok(forms)
    };
    Some(Asked { known, wanted })
}

/// Returns the writes that bring a device from its values after a reset to the values of a file, as a CANopen manager makes them
/// at boot (1F22h). Also returns the objects left out, as [`plan`] does. The order for a PDO: out of use, no objects mapped, the
/// mapped objects, their number, its parameters, and at last its identifier.
pub fn downloads(values: &Eds, explained: Option<&Eds>, node_id: u8) -> (Vec<(Address, Vec<u8>)>, Vec<LeftOut>) {
    let (mut all, mut left_out) = (BTreeMap::new(), Vec::new());
    for (index, sub, entry) in values.entries() {
        let at = Address::new(index, sub);
        let Some(Asked { known, wanted }) = asked(at, entry, explained, node_id) else { continue };
        let name = known.as_ref().map_or_else(|| entry.name.clone(), |known| known.name.clone());
        let checked = match (wanted, Caution::of_restore(at, &name), &known) {
            (Err(why), ..) => Err(why),
            (Ok(_), Some(caution), _) => Err(Why::Caution(caution)),
            (Ok(_), None, None) => Err(Why::Unexplained),
            (Ok(forms), None, Some(_)) => Ok(forms.into_iter().map(|(_, bytes)| bytes).next().unwrap_or_default()),
        };
        match checked {
            Ok(bytes) => drop(all.insert((index, sub), bytes)),
            Err(why) => left_out.push(LeftOut { at, name, why }),
        }
    }
    let pdos: BTreeSet<(u16, u16)> = all.keys().filter_map(|(index, _)| pdo(*index)).collect();
    let mut of_pdos = Vec::new();
    for (communication, mapping) in pdos {
        let mut put = |index: u16, sub: u8, bytes: Vec<u8>| of_pdos.push((Address::new(index, sub), bytes));
        let cob_id = all.remove(&(communication, 1));
        let count = all.remove(&(mapping, 0));
        if let Some(cob_id) = &cob_id {
            let out_of_use = super::scan::number(cob_id) | NOT_USED;
            put(communication, 1, out_of_use.to_le_bytes().to_vec());
        }
        if count.is_some() {
            put(mapping, 0, vec![0]);
        }
        let of = |index: u16| (index, 0)..=(index, u8::MAX);
        let mapped: Vec<_> = all.range(of(mapping)).map(|(at, bytes)| (*at, bytes.clone())).collect();
        mapped.into_iter().for_each(|((index, sub), bytes)| put(index, sub, bytes));
        count.into_iter().for_each(|count| put(mapping, 0, count));
        let parameters: Vec<_> = all.range(of(communication)).map(|(at, bytes)| (*at, bytes.clone())).collect();
        parameters.into_iter().for_each(|((index, sub), bytes)| put(index, sub, bytes));
        cob_id.into_iter().for_each(|cob_id| put(communication, 1, cob_id));
        all.retain(|(index, _), _| *index != communication && *index != mapping);
    }
    let others = all.into_iter().map(|((index, sub), bytes)| (Address::new(index, sub), bytes));
    let (heartbeats, others): (Vec<_>, Vec<_>) = others.partition(|(at, _)| matches!(at.index, 0x1016 | 0x1017));
    (others.into_iter().chain(of_pdos).chain(heartbeats).collect(), left_out)
}

/// Writes a value and reads it back.
///
/// # Errors
/// Whatever is no answer: then nothing more should be written.
pub fn carry_out(objects: &mut (impl ObjectAccess + ?Sized), step: &Step) -> Result<WriteOutcome, Error> {
    match objects.write(step.at, &step.new) {
        Ok(()) => {}
        Err(Error::Refused(code)) => return Ok(WriteOutcome::Refused(code)),
        // It may have been written, which reading it tells.
        Err(Error::MayBeWritten) => {}
        Err(error) => return Err(error),
    }
    let holds = objects.read(step.at)?;
    let value = |bytes: &[u8]| Value::from_bytes(step.data_type, bytes);
    Ok(if value(&holds) == value(&step.new) { WriteOutcome::Written } else { WriteOutcome::Holds(holds) })
}

/// Whether an object only shows something, or is written all the time, and keeps nothing: process data, errors, the identity, the
/// mode.
pub fn is_shown(at: Address) -> bool {
    matches!(
        of_first_axis(at.index),
        0x1000..=0x1004
            | 0x1008..=0x100b
            | 0x1018
            | 0x1200
            | 0x603f
            | 0x6041
            | 0x6060..=0x6064
            | 0x6069..=0x606c
            | 0x6074
            | 0x6077..=0x6079
            | 0x60f4
            | 0x60fd
            | 0x6502
            | 0x7130
    )
}

/// Communication parameter and mapping parameter of the PDO that an index is of.
fn pdo(index: u16) -> Option<(u16, u16)> {
    match index {
        0x1400..0x1600 | 0x1800..0x1a00 => Some((index, index + 0x200)),
        0x1600..0x1800 | 0x1a00..0x1c00 => Some((index - 0x200, index)),
        _ => None,
    }
}

/// The sync manager's assignment that PDOs of a mapping are in, on EtherCAT.
fn assignment(mapping: u16) -> u16 {
    if mapping < 0x1a00 { 0x1c12 } else { 0x1c13 }
}

/// A write of an object that the standards know.
fn step(index: u16, sub: u8, old: Option<Vec<u8>>, new: Vec<u8>, is_final: bool) -> Step {
    let at = Address::new(index, sub);
    let known = known(at, None);
    let name = known.as_ref().map_or_else(String::new, |known| known.name.clone());
    Step { at, name, data_type: known.map_or(0x07, |known| known.data_type), old, new, is_final }
}

/// The changes as writes that a device takes: of a PDO, out of use, no objects mapped, the new ones, their number, its parameters, and
/// into use again.
fn in_order(
    objects: &mut (impl ObjectAccess + ?Sized),
    mut changes: BTreeMap<(u16, u8), Step>,
) -> Result<Vec<Step>, Error> {
    let pdos: BTreeSet<(u16, u16)> = changes.keys().filter_map(|(index, _)| pdo(*index)).collect();
    let is_assigned = |index: &u16| matches!(index, 0x1c12 | 0x1c13);
    let mut lists: BTreeMap<u16, Vec<Step>> =
        changes.keys().map(|(index, _)| *index).filter(is_assigned).map(|index| (index, Vec::new())).collect();
    let mut steps = Vec::new();
    for (communication, mapping) in pdos {
        let used = match objects.read(Address::new(communication, 1)) {
            // Of their own length, however many bytes are sent.
            Ok(bytes) => Some(super::scan::number(&bytes)),
            Err(Error::Refused(_)) => None,
            Err(error) => return Err(error),
        };
        let Some(used) = used else {
            let remapped = remapped(objects, mapping, &mut changes)?;
            lists.entry(assignment(mapping)).or_default().extend(remapped);
            continue;
        };
        let cob_id = used.to_le_bytes().to_vec();
        let last = changes.remove(&(communication, 1)).map_or_else(|| cob_id.clone(), |step| step.new);
        let out_of_use = (used | NOT_USED).to_le_bytes().to_vec();
        if used & NOT_USED == 0 {
            steps.push(step(communication, 1, Some(cob_id.clone()), out_of_use.clone(), false));
        }
        steps.extend(remapped(objects, mapping, &mut changes)?);
        steps.extend(taken(&mut changes, communication, 0));
        let is_in_use = used & NOT_USED == 0;
        let now = if is_in_use { out_of_use } else { cob_id };
        if last != now {
            steps.push(step(communication, 1, Some(now), last, true));
        }
    }
    for (list, mapped) in lists {
        let assigned = counted(objects, list, &mut changes, mapped)?;
        steps.extend(assigned);
    }
    // What is left has no order of its own. Heartbeats come last: from then on the device tells of itself.
    let (heartbeats, others): (Vec<_>, Vec<_>) =
        changes.into_values().partition(|step| matches!(step.at.index, 0x1016 | 0x1017));
    Ok(others.into_iter().chain(steps).chain(heartbeats).collect())
}

/// The changes of an index from a sub-index on, which are taken away.
fn taken(changes: &mut BTreeMap<(u16, u8), Step>, index: u16, from: u8) -> Vec<Step> {
    let subs: Vec<u8> = changes.range((index, from)..=(index, u8::MAX)).map(|((_, sub), _)| *sub).collect();
    subs.into_iter().filter_map(|sub| changes.remove(&(index, sub))).collect()
}

/// The changes of a mapping.
fn remapped(
    objects: &mut (impl ObjectAccess + ?Sized),
    mapping: u16,
    changes: &mut BTreeMap<(u16, u8), Step>,
) -> Result<Vec<Step>, Error> {
    if changes.range((mapping, 0)..=(mapping, u8::MAX)).next().is_none() {
        return Ok(Vec::new());
    }
    counted(objects, mapping, changes, Vec::new())
}

/// The changes of a list that holds its length, at sub-index 0: empty, what is done meanwhile, its entries, and its length.
fn counted(
    objects: &mut (impl ObjectAccess + ?Sized),
    list: u16,
    changes: &mut BTreeMap<(u16, u8), Step>,
    meanwhile: Vec<Step>,
) -> Result<Vec<Step>, Error> {
    let mut count = match objects.read(Address::new(list, 0)) {
        Ok(count) => count,
        // A device without the list: what is done meanwhile is all.
        Err(Error::Refused(_)) => return Ok(meanwhile),
        Err(error) => return Err(error),
    };
    count.truncate(1);
    let new = changes.remove(&(list, 0)).map_or_else(|| count.clone(), |step| step.new);
    let mut steps = vec![step(list, 0, Some(count), vec![0], false)];
    steps.extend(meanwhile);
    steps.extend(taken(changes, list, 1));
    steps.push(step(list, 0, Some(vec![0]), new, true));
    Ok(steps)
}
