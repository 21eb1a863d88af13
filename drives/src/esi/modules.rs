//! The modules in the slots of a device.
//!
//! # Source
//! ETG.2000, elements `Slots` and `Modules`; ETG.5001.1, modular device profile: places are counted from 1 as the sub-indices of F030h and
//! F050h are, and the first place has no increment. Indices of PDOs and of what they map: ETG.1000.6.

use super::{Device, Esi, MAX_BYTES, MAX_SLOTS, Module, Pdo, PdoEntry, Slot};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

/// Indices of the process data objects that a master writes, and of those that it reads.
const RX_PDOS: RangeInclusive<u32> = 0x1600..=0x17ff;
const TX_PDOS: RangeInclusive<u32> = 0x1a00..=0x1bff;
/// The controlword of a first axis (CiA 402).
const CONTROLWORD: u16 = 0x6040;
/// Objects of a vendor.
const OF_VENDOR: std::ops::Range<u16> = 0x2000..0x6000;
/// Distances that a device profile can have, of objects and of PDOs.
const OBJECT_STEPS: RangeInclusive<u16> = 1..=0x2000;
const PDO_STEPS: RangeInclusive<u16> = 1..=255;
/// Modules that a message lists.
const MOST_LISTED: usize = 12;
/// The word for a place that stays empty.
const EMPTY: &str = "none";

/// A module in a place of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PluggedModule<'a> {
    /// The place, from 1.
    pub place: u8,
    /// The slot that the place is of.
    pub slot: &'a Slot,
    /// The module.
    pub module: &'a Module,
}

/// Distances from an axis of a device to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisSteps {
    /// Distance of objects from 6000h on.
    pub objects: u16,
    /// Distance of PDOs.
    pub pdos: u16,
    /// Distance of the vendor's objects; 0 for objects that all axes share.
    pub vendor_objects: u16,
}

/// Why the modules of a device are unknown.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ModuleError {
    /// A slot takes several modules, and none is the default.
    #[error("{slot} takes one of several modules, and the file names no default: {modules}")]
    Several {
        /// The slot in words.
        slot: String,
        /// Its place.
        place: u8,
        /// Names of the modules.
        modules: String,
    },
    /// A slot needs a module, and the file does not have it.
    #[error("{slot} needs module {ident:08X}h, which the file does not describe")]
    NotDescribed {
        /// The slot in words.
        slot: String,
        /// Its place.
        place: u8,
        /// Identification of the module.
        ident: u32,
    },
    /// A slot needs a module, and the file has none for it.
    #[error("{slot} needs a module, and the file describes none for it")]
    NoModules {
        /// The slot in words.
        slot: String,
        /// Its place.
        place: u8,
    },
    /// A slot does not take the module that was named for it.
    #[error("{slot} takes no module `{word}`; it takes {modules}")]
    NotTaken {
        /// The slot in words.
        slot: String,
        /// Its place.
        place: u8,
        /// The word for the module.
        word: String,
        /// Names of the modules.
        modules: String,
    },
    /// The description has no such place.
    #[error("the device has no slot {place}: the file describes {last}")]
    NoSlot {
        /// The place that was named.
        place: u32,
        /// Number of places.
        last: u32,
    },
    /// More places need modules than a device can have.
    #[error("{slot} needs modules beyond slot {MAX_SLOTS}, the last one that a device can have")]
    TooMany {
        /// The slot in words.
        slot: String,
    },
    /// An index comes to lie where it cannot be.
    #[error(
        "{slot}: {index:04X}h of module `{module}` would be {moved:X}h by the increment of the slot, and {most:04X}h is the last one"
    )]
    OutOfRange {
        /// The slot in words.
        slot: String,
        /// Name of the module.
        module: String,
        /// Index in the first place.
        index: u16,
        /// Index there.
        moved: u32,
        /// Greatest index.
        most: u32,
    },
    /// Two process data objects have one index.
    #[error("PDO {index:04X}h is in slot {first} and again in slot {second}; two PDOs need two indices")]
    Twice {
        /// A place.
        first: u8,
        /// The other place.
        second: u8,
        /// The index.
        index: u16,
    },
    /// Indices depend on groups of slots.
    #[error(
        "{slot}: indices of module `{module}` depend on a group of slots (DependOnSlotGroup), which this program does not resolve"
    )]
    SlotGroups {
        /// The slot in words.
        slot: String,
        /// Name of the module.
        module: String,
    },
    /// The process data of all places are too large.
    #[error("the process data of the modules up to {slot} take more than the 64 MiB that are kept")]
    TooLarge {
        /// The slot in words.
        slot: String,
    },
}

impl ModuleError {
    /// The place for which another module can be named.
    pub fn place(&self) -> Option<u8> {
        match self {
            Self::Several { place, .. } | Self::NotDescribed { place, .. } | Self::NotTaken { place, .. } => {
                Some(*place)
            }
            _ => None,
        }
    }
}

/// A text of a file for a message: short, without control characters.
fn shown(text: &str) -> String {
    text.chars().filter(|char| !char.is_control()).take(40).collect()
}

fn words(place: u32, slot: &Slot) -> String {
    match shown(&slot.name) {
        name if name.is_empty() => format!("slot {place}"),
        name => format!("slot {place} ({name})"),
    }
}

fn listed(modules: &[&Module]) -> String {
    let name = |module: &&Module| format!("{} (#x{:08X})", shown(module.title()), module.ident);
    let names: Vec<String> = modules.iter().take(MOST_LISTED).map(name).collect();
    match (names.is_empty(), modules.len().saturating_sub(MOST_LISTED)) {
        (true, _) => "none that the file describes".to_owned(),
        (false, 0) => names.join(", "),
        (false, more) => format!("{} and {more} more", names.join(", ")),
    }
}

impl Module {
    /// Its type, or else its name.
    pub fn title(&self) -> &str {
        if self.type_name.is_empty() { &self.name } else { &self.type_name }
    }

    /// Whether a word names it: its type, name or identification.
    fn is_called(&self, word: &str) -> bool {
        let names = [&self.type_name, &self.name];
        super::read::number(word) == Some(self.ident.into())
            || names.iter().any(|name| !name.is_empty() && name.eq_ignore_ascii_case(word))
    }

    /// Entries of its process data objects.
    fn entries(&self) -> impl Iterator<Item = &PdoEntry> {
        self.rx_pdos.iter().chain(&self.tx_pdos).flat_map(|pdo| &pdo.entries)
    }

    /// Bytes that its process data take, at least.
    fn weight(&self) -> usize {
        let pdos = self.rx_pdos.iter().chain(&self.tx_pdos);
        let entries = |pdo: &Pdo| {
            pdo.entries.iter().map(|entry| size_of_val(entry) + entry.name.len() + entry.data_type.len()).sum::<usize>()
        };
        pdos.map(|pdo| size_of_val(pdo) + pdo.name.len() + 2 * pdo.excludes.len() + entries(pdo)).sum()
    }
}

impl Slot {
    /// Places that it has in a row.
    fn places(&self) -> u32 {
        self.max_instances.max(1)
    }

    /// Places that have a module unless another one is named.
    fn filled(&self) -> u32 {
        let least = u32::from(self.default.is_some());
        self.min_instances.max(least).min(self.places())
    }
}

impl Esi {
    /// The modules that fit into a slot, each identification once.
    fn modules_of(&self, slot: &Slot) -> Vec<&Module> {
        let (idents, classes): (BTreeSet<_>, BTreeSet<_>) =
            (slot.idents.iter().collect(), slot.classes.iter().collect());
        let mut seen = BTreeSet::new();
        let fits = |module: &&Module| {
            idents.contains(&module.ident) || !module.class.is_empty() && classes.contains(&module.class)
        };
        self.modules.iter().filter(fits).filter(|module| seen.insert(module.ident)).collect()
    }

    /// Returns the modules in the places of a device. `named` names modules by place, from 1, and by type, name or
    /// identification. A place that it does not name has the default of its slot, or the only module of a slot that is never
    /// empty. `none` names an empty place.
    ///
    /// # Errors
    /// If a slot has several modules without a default, or the file does not describe a module. The message names the slot.
    pub fn plugged<'a>(
        &'a self,
        device: &'a Device,
        named: &BTreeMap<u32, String>,
    ) -> Result<Vec<PluggedModule<'a>>, ModuleError> {
        let mut plugged = Vec::new();
        let mut before = 0_u32;
        for slot in &device.slots {
            let first = before.saturating_add(1);
            before = before.saturating_add(slot.places());
            let filled = first.saturating_add(slot.filled());
            if slot.filled() > 0 && filled - 1 > MAX_SLOTS as u32 {
                return Err(ModuleError::TooMany { slot: words(first, slot) });
            }
            let places: BTreeSet<u32> =
                (first..filled).chain(named.range(first..=before).map(|(place, _)| *place)).collect();
            let modules = if places.is_empty() { Vec::new() } else { self.modules_of(slot) };
            for number in places {
                let place = u8::try_from(number).map_err(|_| ModuleError::TooMany { slot: words(number, slot) })?;
                let module = match named.get(&number) {
                    Some(word) if word == EMPTY && slot.min_instances == 0 => None,
                    Some(word) => Some(named_module(place, slot, &modules, word)?),
                    None => Some(standard_module(place, slot, &modules)?),
                };
                plugged.extend(module.map(|module| PluggedModule { place, slot, module }));
            }
        }
        let known = 1..=before;
        match named.keys().find(|place| !known.contains(place)) {
            Some(place) => Err(ModuleError::NoSlot { place: *place, last: before }),
            None => Ok(plugged),
        }
    }
}

fn named_module<'a>(place: u8, slot: &Slot, modules: &[&'a Module], word: &str) -> Result<&'a Module, ModuleError> {
    let mut called = modules.iter().filter(|module| module.is_called(word));
    match (called.next(), called.next()) {
        (Some(module), None) => Ok(module),
        _ => Err(ModuleError::NotTaken {
            slot: words(place.into(), slot),
            place,
            word: shown(word),
            modules: listed(modules),
        }),
    }
}

/// The default module of a slot, or its only one.
fn standard_module<'a>(place: u8, slot: &Slot, modules: &[&'a Module]) -> Result<&'a Module, ModuleError> {
    let words = || words(place.into(), slot);
    let ident = match (slot.default, slot.idents.as_slice(), modules) {
        (Some(ident), ..) => ident,
        (None, [ident], []) => *ident,
        (None, _, [only]) if slot.idents.len() <= 1 => only.ident,
        (None, _, []) => return Err(ModuleError::NoModules { slot: words(), place }),
        _ => return Err(ModuleError::Several { slot: words(), place, modules: listed(modules) }),
    };
    let module = modules.iter().copied().find(|module| module.ident == ident);
    module.ok_or_else(|| ModuleError::NotDescribed { slot: words(), place, ident })
}

impl PluggedModule<'_> {
    /// The slot in words.
    pub fn words(&self) -> String {
        words(self.place.into(), self.slot)
    }

    fn moved(&self, index: u16, increment: u16, most: u32) -> Result<u16, ModuleError> {
        let moved = u32::from(index) + u32::from(self.place.saturating_sub(1)) * u32::from(increment);
        u16::try_from(moved).ok().filter(|_| moved <= most).ok_or_else(|| ModuleError::OutOfRange {
            slot: self.words(),
            module: shown(self.module.title()),
            index,
            moved,
            most,
        })
    }

    /// A process data object of the module in its place.
    fn pdo(&self, pdo: &Pdo, most: u32) -> Result<Pdo, ModuleError> {
        let mut pdo = pdo.clone();
        if std::mem::take(&mut pdo.depends_on_slot) {
            for index in std::iter::once(&mut pdo.index).chain(&mut pdo.excludes) {
                *index = self.moved(*index, self.slot.pdo_increment, most)?;
            }
        }
        for entry in &mut pdo.entries {
            if std::mem::take(&mut entry.depends_on_slot) {
                entry.index = self.moved(entry.index, self.slot.index_increment, u16::MAX.into())?;
            }
        }
        Ok(pdo)
    }
}

impl Device {
    /// The device with the process data objects of its modules. A module's object has precedence over one of the device at its index.
    ///
    /// # Errors
    /// If an index of a module comes to lie beyond those of process data objects, or where another module has one.
    pub fn with_modules(&self, plugged: &[PluggedModule<'_>]) -> Result<Device, ModuleError> {
        let (mut rx_pdos, mut tx_pdos) = (Vec::new(), Vec::new());
        let mut placed: BTreeMap<u16, u8> = BTreeMap::new();
        let mut bytes = 0;
        for own in plugged {
            let module = own.module;
            bytes += module.weight();
            if bytes > MAX_BYTES {
                return Err(ModuleError::TooLarge { slot: own.words() });
            }
            if module.has_slot_groups {
                return Err(ModuleError::SlotGroups { slot: own.words(), module: shown(module.title()) });
            }
            for (from, to, indices) in
                [(&module.rx_pdos, &mut rx_pdos, RX_PDOS), (&module.tx_pdos, &mut tx_pdos, TX_PDOS)]
            {
                for pdo in from {
                    let pdo = own.pdo(pdo, *indices.end())?;
                    if let Some(first) = placed.insert(pdo.index, own.place) {
                        return Err(ModuleError::Twice { first, second: own.place, index: pdo.index });
                    }
                    to.push(pdo);
                }
            }
        }
        let mut device = self.clone();
        for (own, of_modules) in [(&mut device.rx_pdos, rx_pdos), (&mut device.tx_pdos, tx_pdos)] {
            own.retain(|pdo| !placed.contains_key(&pdo.index));
            own.extend(of_modules);
        }
        Ok(device)
    }
}

/// Distances of the axes of a device whose first two axes are modules, the first one in place 1. `None` for any other device, and for distances
/// that a device profile cannot have.
pub fn axis_steps(plugged: &[PluggedModule<'_>]) -> Option<AxisSteps> {
    let is_axis = |own: &&PluggedModule<'_>| {
        own.module.entries().any(|entry| entry.index == CONTROLWORD && entry.depends_on_slot)
    };
    let mut axes = plugged.iter().filter(is_axis);
    let (first, second) = (axes.next().filter(|first| first.place == 1)?, axes.next()?);
    let places = u16::from(second.place.saturating_sub(1));
    let [objects, pdos] =
        [second.slot.index_increment, second.slot.pdo_increment].map(|increment| increment.saturating_mul(places));
    let is_possible = OBJECT_STEPS.contains(&objects) && PDO_STEPS.contains(&pdos);
    let is_own = first.module.entries().any(|entry| entry.depends_on_slot && OF_VENDOR.contains(&entry.index));
    is_possible.then_some(AxisSteps { objects, pdos, vendor_objects: if is_own { objects } else { 0 } })
}
