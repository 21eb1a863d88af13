//! Modules that are plugged into a device: what each brings, and the objects that there are then.
//!
//! # Source
//! CiA 306-1, modular devices: `[SupportedModules]`, `[MxModuleInfo]`, `[MxFixedObjects]`, `[MxSubExtends]`, `[ConnectedModules]`.

use std::collections::{BTreeMap, BTreeSet};

use super::ini::Section;
use super::number::{integer, number, whole};
use super::read::Reader;
use super::{Access, Adds, Eds, EdsError, Entry, Extension, Kind, Level, Module, Object, Value};

/// Most kinds of modules, and most that are plugged in.
const MOST: i128 = 254;
/// Last sub-index of an object.
const LAST_SUB: u8 = 254;

impl Reader<'_> {
    pub(super) fn modules(&mut self) -> Result<Vec<Module>, EdsError> {
        let Some(section) = self.sections.get("supportedmodules") else { return Ok(Vec::new()) };
        let count = self.number(section, "NrOfEntries").unwrap_or(0);
        if count > MOST {
            let message = format!("[SupportedModules] says that there are {count} kinds of modules");
            self.find(section.line, Level::Warning, message, "254 are read");
        }
        let mut modules = Vec::new();
        for kind in 1..=count.min(MOST) {
            modules.push(self.module(kind, section.line)?);
        }
        Ok(modules)
    }

    fn module(&mut self, kind: i128, line: usize) -> Result<Module, EdsError> {
        let mut module = Module::default();
        match self.sections.get(&format!("m{kind}moduleinfo")) {
            Some(info) => {
                module.name = info.text("productname");
                module.order_code = info.text("ordercode");
            }
            None => {
                let message = format!("there is no section [M{kind}ModuleInfo]");
                self.find(line, Level::Warning, message, "the module has no name");
            }
        }
        for (index, line) in self.listed(&format!("m{kind}fixedobjects")) {
            let name = format!("m{kind}fixed{index:04x}");
            let Some(section) = self.sections.get(&name) else {
                let message = format!("there is no section [M{kind}Fixed{index:04X}]");
                self.find(line, Level::Warning, message, "the object is left out");
                continue;
            };
            let mut object = self.object(index, section)?;
            for sub in 0..=u8::MAX {
                // Both ways of writing a sub-index are there.
                let written = [format!("{name}sub{sub:x}"), format!("{name}sub{sub:02x}")];
                let Some(section) = written.iter().find_map(|name| self.sections.get(name)) else { continue };
                self.count(section.line, 1)?;
                object.entries.extend(self.entry(section).map(|entry| (sub, entry)));
            }
            module.fixed.insert(index, object);
        }
        for (index, line) in self.listed(&format!("m{kind}subextends")) {
            let Some(section) = self.sections.get(&format!("m{kind}subext{index:04x}")) else {
                let message = format!("there is no section [M{kind}SubExt{index:04X}]");
                self.find(line, Level::Warning, message, "its entries are left out");
                continue;
            };
            module.extensions.extend(self.extension(index, section));
        }
        Ok(module)
    }

    /// The indices of a numbered list, with their lines.
    fn listed(&mut self, name: &str) -> Vec<(u16, usize)> {
        let Some(section) = self.sections.get(name) else { return Vec::new() };
        let mut listed = Vec::new();
        for (key, text) in section.iter().filter(|(key, _)| whole(key).is_some()) {
            match number(&text.text).and_then(|index| u16::try_from(index).ok()) {
                Some(index) => listed.push((index, text.line)),
                None => {
                    let message = format!("entry {key} of [{name}] is no index");
                    self.find(text.line, Level::Warning, message, "it is left out");
                }
            }
        }
        listed
    }

    fn extension(&mut self, index: u16, section: &Section) -> Option<Extension> {
        let entry = self.entry(section)?;
        let text = section.get("count");
        let byte = |text: &str| whole(text).and_then(|number| u8::try_from(number).ok());
        let adds = match text.map(|text| text.text.split_once(';').unwrap_or((&text.text, ""))) {
            None => Some(Adds::Entries(1)),
            Some((entries, "")) => byte(entries).map(Adds::Entries),
            Some((_, bits)) => byte(bits).map(Adds::Bits),
        };
        let Some(adds) = adds else {
            let line = text.map_or(section.line, |text| text.line);
            self.find(
                line,
                Level::Error,
                "Count is neither a number nor `0;BITS`".to_owned(),
                "these entries are left out",
            );
            return None;
        };
        let last_sub = self.number(section, "ObjExtend").and_then(|last| u8::try_from(last).ok()).unwrap_or(0);
        Some(Extension { index, entry, adds, last_sub: last_sub.min(LAST_SUB) })
    }

    pub(super) fn connected(&mut self) -> Vec<u8> {
        let Some(section) = self.sections.get("connectedmodules") else { return Vec::new() };
        let mut slots = BTreeMap::new();
        for (key, text) in section.iter() {
            let Some(slot) = whole(key) else { continue };
            match number(&text.text).and_then(|kind| u8::try_from(kind).ok()).filter(|kind| *kind > 0) {
                Some(kind) if (1..=MOST).contains(&slot) => {
                    slots.insert(slot, kind);
                }
                _ => {
                    let message = format!("entry {key} of [ConnectedModules] is no module in a slot from 1 to {MOST}");
                    self.find(text.line, Level::Warning, message, "it is left out");
                }
            }
        }
        slots.into_values().collect()
    }
}

/// Adds the objects of the modules that are plugged in. Objects that the file already has stay as they are.
pub(super) fn plug(eds: &mut Eds, reader: &mut Reader<'_>) -> Result<(), EdsError> {
    let line = reader.sections.get("connectedmodules").map_or(0, |section| section.line);
    let own: BTreeSet<u16> = eds.objects.keys().copied().collect();
    // Bits of a shared entry that are taken already, by index.
    let mut bits_taken: BTreeMap<u16, u32> = BTreeMap::new();
    for kind in eds.connected.clone() {
        let Some(module) = usize::from(kind).checked_sub(1).and_then(|at| eds.modules.get(at)).cloned() else {
            let message = format!("module {kind} is plugged in, and [SupportedModules] has no such kind");
            reader.find(line, Level::Error, message, "it is left out");
            continue;
        };
        for (index, object) in module.fixed {
            reader.count(line, object.entries.len())?;
            eds.objects.entry(index).or_insert(object);
        }
        for extension in module.extensions.iter().filter(|extension| !own.contains(&extension.index)) {
            let new = match extension.adds {
                Adds::Entries(count) => u32::from(count),
                Adds::Bits(bits) => {
                    let wide = integer(extension.entry.data_type).map_or(8, |(bits, _)| bits);
                    let taken = bits_taken.entry(extension.index).or_default();
                    let before = taken.div_ceil(wide);
                    *taken += u32::from(bits);
                    taken.div_ceil(wide) - before
                }
            };
            reader.count(line, new as usize)?;
            if !extend(&mut eds.objects, extension, new) {
                let message =
                    format!("the object {:04X}h has no place for all entries of its modules", extension.index);
                reader.find(
                    line,
                    Level::Error,
                    message,
                    "entries without a place are ignored: use fewer modules, or another order \
                                                          of slots",
                );
            }
        }
    }
    Ok(())
}

/// Appends entries; whether all have a place.
fn extend(objects: &mut BTreeMap<u16, Object>, extension: &Extension, new: u32) -> bool {
    let last = if extension.last_sub == 0 { LAST_SUB } else { extension.last_sub };
    let mut index = extension.index;
    for _ in 0..new {
        loop {
            let object = objects.entry(index).or_insert_with(|| empty(&extension.entry));
            let sub = object.entries.keys().next_back().map_or(1, |sub| sub.saturating_add(1));
            if sub <= last {
                let name = format!("{} {sub}", extension.entry.name);
                object.entries.insert(sub, Entry { name, ..extension.entry.clone() });
                if let Some(count) = object.entries.get_mut(&0) {
                    count.default = Some(Value::Integer(i128::from(sub)));
                }
                break;
            }
            match index.checked_add(1).filter(|_| extension.last_sub != 0) {
                Some(next) => index = next,
                None => return false,
            }
        }
    }
    true
}

/// An object without entries except their number.
fn empty(of: &Entry) -> Object {
    let count = Entry {
        name: "Number of entries".to_owned(),
        data_type: 5,
        access: Access::ReadOnly,
        default: Some(Value::Integer(0)),
        value: None,
        low: None,
        high: None,
        is_mappable: false,
        is_kept_from_download: false,
        line: of.line,
    };
    Object { name: of.name.clone(), kind: Kind::Array, entries: [(0, count)].into(), line: of.line }
}
