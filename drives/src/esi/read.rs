//! Reading a file.

use super::{
    Category, Coe, Device, Esi, EsiError, MAX_BYTES, MAX_CATEGORIES, MAX_DEPTH, MAX_ITEMS, MAX_SLOTS, MAX_TEXT, Module,
    OpMode, Pdo, PdoEntry, Slot, SyncManager,
};
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use quick_xml::reader::Reader;
use std::borrow::Cow;

/// A number as the files write it: decimal, or hexadecimal behind `#x`.
pub(super) fn number(text: &str) -> Option<i64> {
    let text = text.trim();
    match text.strip_prefix("#x").or_else(|| text.strip_prefix("#X")).or_else(|| text.strip_prefix("0x")) {
        Some(digits) => i64::from_str_radix(digits, 16).ok().filter(|_| !digits.starts_with(['+', '-'])),
        None => text.parse().ok(),
    }
}

/// The bytes of hexadecimal digits, two a byte.
pub fn hex_bytes(text: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<u8>> = text.chars().map(|char| Some(char.to_digit(16)? as u8)).collect();
    let (pairs, []) = digits.as_deref()?.as_chunks::<2>() else { return None };
    Some(pairs.iter().map(|[high, low]| high << 4 | low).collect())
}

fn is_true(text: &str) -> bool {
    matches!(text.trim(), "1" | "true")
}

/// Position of the reader in the file.
struct Cursor<'a> {
    text: &'a str,
    offset: usize,
}

impl Cursor<'_> {
    fn line(&self) -> usize {
        1 + self.text.as_bytes().get(..self.offset).unwrap_or_default().iter().filter(|byte| **byte == b'\n').count()
    }

    fn number<T: TryFrom<i64>>(&self, element: &'static str, text: &str, most: u64) -> Result<T, EsiError> {
        number(text).and_then(|number| T::try_from(number).ok()).ok_or_else(|| EsiError::Number {
            line: self.line(),
            element,
            text: text.chars().filter(|char| !char.is_control()).take(40).collect(),
            most,
        })
    }

    fn u32(&self, element: &'static str, text: &str) -> Result<u32, EsiError> {
        self.number(element, text, u32::MAX.into())
    }

    fn u16(&self, element: &'static str, text: &str) -> Result<u16, EsiError> {
        self.number(element, text, u16::MAX.into())
    }

    fn u8(&self, element: &'static str, text: &str) -> Result<u8, EsiError> {
        self.number(element, text, u8::MAX.into())
    }
}

#[derive(Default)]
struct Builder {
    esi: Esi,
    items: usize,
    has_root: bool,
    /// Whether the name of the present device or module is in English; names in other languages are passed over.
    has_english_name: bool,
    /// Increments of PDOs and of objects that the slots of the present device share.
    increments: [u16; 2],
    /// Whether the present `ModuleIdent` is the default of its slot.
    is_default_module: bool,
}

/// A part of a file that has process data.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Item {
    Device,
    Module,
}

/// Elements above the present one, by name.
struct Path(Vec<String>);

impl Path {
    /// The names below a device or module, if the present element is in one.
    fn in_item(&self) -> Option<(Item, Vec<&str>)> {
        let names: Vec<&str> = self.0.iter().map(String::as_str).collect();
        match names.as_slice() {
            ["EtherCATInfo", "Descriptions", "Devices", "Device", below @ ..] => Some((Item::Device, below.to_vec())),
            ["EtherCATInfo", "Descriptions", "Modules", "Module", below @ ..] => Some((Item::Module, below.to_vec())),
            _ => None,
        }
    }

    fn is(&self, names: &[&str]) -> bool {
        self.0.iter().map(String::as_str).eq(names.iter().copied())
    }
}

impl Esi {
    /// Reads a file: UTF-8, or Latin-1 as old files are.
    ///
    /// # Errors
    /// If it is no device description, too large, or has a number that cannot be. The error names the line.
    pub fn read(bytes: &[u8]) -> Result<Esi, EsiError> {
        if bytes.len() > MAX_BYTES {
            return Err(EsiError::TooLarge(bytes.len()));
        }
        let text = match std::str::from_utf8(bytes) {
            Ok(text) => Cow::Borrowed(text),
            Err(_) => Cow::Owned(bytes.iter().map(|byte| char::from(*byte)).collect()),
        };
        let mut reader = Reader::from_str(&text);
        let (mut path, mut content) = (Path(Vec::new()), String::new());
        let mut builder = Builder::default();
        loop {
            let event = reader.read_event();
            let place = Cursor { text: &text, offset: usize::try_from(reader.buffer_position()).unwrap_or(usize::MAX) };
            let xml = |what: String| EsiError::Xml { line: place.line(), what };
            match event.map_err(|error| xml(error.to_string()))? {
                Event::Start(start) => {
                    content.clear();
                    builder.open(&place, &mut path, &start)?;
                }
                Event::Empty(start) => {
                    builder.open(&place, &mut path, &start)?;
                    builder.close(&place, &path, "")?;
                    path.0.pop();
                    content.clear();
                }
                Event::End(_) => {
                    builder.close(&place, &path, &content)?;
                    path.0.pop();
                    content.clear();
                }
                Event::Text(text) => append(&place, &mut content, &text.xml10_content())?,
                Event::CData(text) => append(&place, &mut content, &text.xml10_content())?,
                Event::GeneralRef(name) => {
                    let char = match &*name {
                        "amp" => Some('&'),
                        "lt" => Some('<'),
                        "gt" => Some('>'),
                        "quot" => Some('"'),
                        "apos" => Some('\''),
                        _ => name.resolve_char_ref().map_err(|error| xml(error.to_string()))?,
                    };
                    let char = char.ok_or(EsiError::Refused { line: place.line(), what: "an entity of its own" })?;
                    append(&place, &mut content, char.encode_utf8(&mut [0; 4]))?;
                }
                Event::DocType(_) => {
                    return Err(EsiError::Refused { line: place.line(), what: "a document type" });
                }
                Event::Comment(_) | Event::Decl(_) | Event::PI(_) => {}
                Event::Eof if path.0.is_empty() && builder.has_root => return Ok(builder.esi),
                Event::Eof if path.0.is_empty() => return Err(EsiError::NoDescription),
                Event::Eof => return Err(xml("it ends within an element".to_owned())),
            }
        }
    }
}

fn append(place: &Cursor<'_>, content: &mut String, text: &str) -> Result<(), EsiError> {
    if content.len() + text.len() > MAX_TEXT {
        return Err(EsiError::TooMuch { line: place.line(), what: "bytes of text in an element", most: MAX_TEXT });
    }
    content.push_str(text);
    Ok(())
}

/// The value of an attribute; empty if it is not there.
fn attribute(place: &Cursor<'_>, start: &BytesStart<'_>, name: &str) -> Result<String, EsiError> {
    let xml = |what: String| EsiError::Xml { line: place.line(), what };
    let found = start.try_get_attribute(name).map_err(|error| xml(error.to_string()))?;
    let value = found.map(|attribute| attribute.normalized_value(XmlVersion::Explicit1_0)).transpose();
    Ok(value.map_err(|error| xml(error.to_string()))?.unwrap_or_default().into_owned())
}

/// Increments of PDOs and of objects from a slot to the next, by the attributes of an element or as they were.
fn increments(place: &Cursor<'_>, start: &BytesStart<'_>, shared: [u16; 2]) -> Result<[u16; 2], EsiError> {
    let of = |element: &'static str, shared: u16| -> Result<u16, EsiError> {
        let text = attribute(place, start, element)?;
        if text.is_empty() { Ok(shared) } else { place.u16(element, &text) }
    };
    let [pdos, objects] = shared;
    Ok([of("SlotPdoIncrement", pdos)?, of("SlotIndexIncrement", objects)?])
}

impl Builder {
    /// The process data objects of the present device or module.
    fn pdos(&mut self, item: Item, direction: &str) -> Option<&mut Vec<Pdo>> {
        let [rx, tx] = match item {
            Item::Device => self.esi.devices.last_mut().map(|device| [&mut device.rx_pdos, &mut device.tx_pdos]),
            Item::Module => self.esi.modules.last_mut().map(|module| [&mut module.rx_pdos, &mut module.tx_pdos]),
        }?;
        Some(if direction == "RxPdo" { rx } else { tx })
    }

    fn count(&mut self, place: &Cursor<'_>) -> Result<(), EsiError> {
        self.items += 1;
        if self.items > MAX_ITEMS {
            return Err(EsiError::TooMuch {
                line: place.line(),
                what: "devices, objects and entries",
                most: MAX_ITEMS,
            });
        }
        Ok(())
    }

    fn open(&mut self, place: &Cursor<'_>, path: &mut Path, start: &BytesStart<'_>) -> Result<(), EsiError> {
        if path.0.len() >= MAX_DEPTH {
            return Err(EsiError::TooMuch { line: place.line(), what: "elements within one another", most: MAX_DEPTH });
        }
        path.0.push(start.local_name().as_ref().to_owned());
        self.has_root |= path.is(&["EtherCATInfo"]);
        let Some((item, below)) = path.in_item() else { return Ok(()) };
        let get = |name| attribute(place, start, name);
        if below.is_empty() {
            self.count(place)?;
            match item {
                Item::Device => self.esi.devices.push(Device { physics: get("Physics")?, ..Device::default() }),
                Item::Module => self.esi.modules.push(Module::default()),
            }
            (self.has_english_name, self.increments) = (false, [0; 2]);
            return Ok(());
        }
        let is_listed = matches!(below.as_slice(), ["Sm" | "RxPdo" | "TxPdo" | "Fmmu", ..] | ["Dc", "OpMode"]);
        if is_listed && below.len() <= 2 || below.starts_with(&["Slots", "Slot"]) {
            self.count(place)?;
        }
        match below.as_slice() {
            ["Name"] => self.has_english_name = matches!(get("LcId")?.as_str(), "" | "1033" | "2057"),
            [direction @ ("RxPdo" | "TxPdo"), inside @ ..] => {
                let pdos = self.pdos(item, direction);
                pdos.map_or(Ok(()), |pdos| open_pdo(place, pdos, inside, start))?;
                if item == Item::Module && inside.last() == Some(&"Index") && is_true(&get("DependOnSlotGroup")?) {
                    self.esi.modules.last_mut().into_iter().for_each(|module| module.has_slot_groups = true);
                }
            }
            ["Slots"] => self.increments = increments(place, start, [0; 2])?,
            ["Slots", "Slot", "ModuleIdent"] => self.is_default_module = is_true(&get("Default")?),
            _ if item == Item::Device => self.open_device(place, &below, start)?,
            ["Type"] => {
                let Some(module) = self.esi.modules.last_mut() else { return Ok(()) };
                let ident = get("ModuleIdent")?;
                if !ident.is_empty() {
                    module.ident = place.u32("ModuleIdent", &ident)?;
                }
                module.class = get("ModuleClass")?;
            }
            _ => {}
        }
        Ok(())
    }

    /// Opens an element of a device; process data are not among them.
    fn open_device(&mut self, place: &Cursor<'_>, below: &[&str], start: &BytesStart<'_>) -> Result<(), EsiError> {
        let shared = self.increments;
        let get = |name| attribute(place, start, name);
        let Some(device) = self.esi.devices.last_mut() else { return Ok(()) };
        match below {
            ["Slots", "Slot"] => {
                if device.slots.len() >= MAX_SLOTS {
                    return Err(EsiError::TooMuch { line: place.line(), what: "slots of a device", most: MAX_SLOTS });
                }
                let [pdo_increment, index_increment] = increments(place, start, shared)?;
                let instances = |element: &'static str, unless: u32| -> Result<u32, EsiError> {
                    let text = get(element)?;
                    if text.is_empty() { Ok(unless) } else { place.u32(element, &text) }
                };
                device.slots.push(Slot {
                    min_instances: instances("MinInstances", 0)?,
                    max_instances: instances("MaxInstances", 1)?,
                    pdo_increment,
                    index_increment,
                    ..Slot::default()
                });
            }
            ["Type"] => {
                let (product, revision) = (get("ProductCode")?, get("RevisionNo")?);
                if !product.is_empty() {
                    device.product_code = place.u32("ProductCode", &product)?;
                }
                if !revision.is_empty() {
                    device.revision = place.u32("RevisionNo", &revision)?;
                }
            }
            ["Sm"] => {
                let optional = |name, element| -> Result<Option<u16>, EsiError> {
                    let text = get(name)?;
                    if text.is_empty() { Ok(None) } else { place.u16(element, &text).map(Some) }
                };
                let (start, control, enable) = (get("StartAddress")?, get("ControlByte")?, get("Enable")?);
                device.sync_managers.push(SyncManager {
                    kind: String::new(),
                    start: if start.is_empty() { 0 } else { place.u16("StartAddress", &start)? },
                    control: if control.is_empty() { 0 } else { place.u8("ControlByte", &control)? },
                    default_size: optional("DefaultSize", "DefaultSize")?,
                    min_size: optional("MinSize", "MinSize")?,
                    max_size: optional("MaxSize", "MaxSize")?,
                    // Some files write a number with more bits than the first.
                    is_enabled: number(&enable).map_or(is_true(&enable), |number| number & 1 != 0),
                });
            }
            ["Mailbox", "CoE"] => {
                let flag = |name| get(name).map(|text| is_true(&text));
                device.coe = Some(Coe {
                    information: flag("SdoInfo")?,
                    pdo_assign: flag("PdoAssign")?,
                    pdo_configuration: flag("PdoConfig")?,
                    complete_access: flag("CompleteAccess")?,
                    segmented: flag("SegmentedSdo")?,
                });
            }
            ["Eeprom", "Category"] => {
                if device.categories.len() >= MAX_CATEGORIES {
                    let what = "categories for the SII of a device";
                    return Err(EsiError::TooMuch { line: place.line(), what, most: MAX_CATEGORIES });
                }
                device.categories.push(Category::default());
            }
            ["Mailbox", "EoE"] => device.has_eoe = true,
            ["Mailbox", "FoE"] => device.has_foe = true,
            ["Dc", "OpMode"] => device.op_modes.push(OpMode::default()),
            ["Dc", "OpMode", "CycleTimeSync0"] => {
                let factor = get("Factor")?;
                if let Some(mode) = device.op_modes.last_mut().filter(|_| !factor.is_empty()) {
                    mode.sync0_factor = place.number("Factor", &factor, i32::MAX as u64)?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn close(&mut self, place: &Cursor<'_>, path: &Path, content: &str) -> Result<(), EsiError> {
        let text = || content.trim().to_owned();
        if path.is(&["EtherCATInfo", "Vendor", "Id"]) {
            self.esi.vendor_id = place.u32("Vendor/Id", content)?;
        } else if path.is(&["EtherCATInfo", "Vendor", "Name"]) && self.esi.vendor.is_empty() {
            self.esi.vendor = text();
        }
        let Some((item, below)) = path.in_item() else { return Ok(()) };
        match below.as_slice() {
            [direction @ ("RxPdo" | "TxPdo"), inside @ ..] => {
                let pdo = self.pdos(item, direction).and_then(|pdos| pdos.last_mut());
                pdo.map_or(Ok(()), |pdo| close_pdo(place, pdo, inside, content))
            }
            _ if item == Item::Device => self.close_device(place, &below, content),
            [field] => {
                let Some(module) = self.esi.modules.last_mut() else { return Ok(()) };
                match *field {
                    "Type" => module.type_name = text(),
                    "Name" if module.name.is_empty() || self.has_english_name => module.name = text(),
                    _ => {}
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Closes an element of a device; process data are not among them.
    fn close_device(&mut self, place: &Cursor<'_>, below: &[&str], content: &str) -> Result<(), EsiError> {
        let text = || content.trim().to_owned();
        let Some(device) = self.esi.devices.last_mut() else { return Ok(()) };
        match below {
            ["Slots", "Slot", inside @ ..] => {
                let (is_default, slot) = (self.is_default_module, device.slots.last_mut());
                slot.map_or(Ok(()), |slot| close_slot(place, slot, inside, content, is_default))?;
            }
            ["Type"] => device.type_name = text(),
            ["Name"] if device.name.is_empty() || self.has_english_name => device.name = text(),
            ["GroupType"] => device.group = text(),
            ["Profile", "ProfileNo"] => device.profile = Some(place.u32("ProfileNo", content)?),
            ["Fmmu"] => device.fmmus.push(text()),
            ["Sm"] => device.sync_managers.last_mut().into_iter().for_each(|manager| manager.kind = text()),
            ["Info", "StateMachine", "Timeout", "PreopTimeout"] => {
                device.pre_op_ms = Some(place.u32("PreopTimeout", content)?);
            }
            ["Info", "StateMachine", "Timeout", "SafeopOpTimeout"] => {
                device.safe_op_ms = Some(place.u32("SafeopOpTimeout", content)?);
            }
            ["Info", "Mailbox", "Timeout", "ResponseTimeout"] => {
                device.mailbox_response_ms = Some(place.u32("ResponseTimeout", content)?);
            }
            ["Eeprom", "ByteSize"] => device.eeprom_bytes = Some(place.u32("ByteSize", content)?),
            ["Eeprom", "ConfigData"] => device.config_data = text(),
            ["Eeprom", "BootStrap"] => device.bootstrap = text(),
            ["Eeprom", "Category", inside] => {
                let category = device.categories.last_mut();
                category.map_or(Ok(()), |category| close_category(place, category, inside, content))?;
            }
            ["Info", "Electrical", "EBusCurrent"] => {
                device.e_bus_ma = Some(place.number("EBusCurrent", content, i32::MAX as u64)?);
            }
            ["Dc", "OpMode", inside] => {
                if let Some(mode) = device.op_modes.last_mut() {
                    match *inside {
                        "Name" => mode.name = text(),
                        "AssignActivate" => mode.assign_activate = place.u16("AssignActivate", content)?,
                        "CycleTimeSync0" => mode.sync0_cycle_ns = place.u32("CycleTimeSync0", content)?,
                        "ShiftTimeSync0" => {
                            mode.sync0_shift_ns = place.number("ShiftTimeSync0", content, i32::MAX as u64)?;
                        }
                        "CycleTimeSync1" => mode.sync1_cycle_ns = place.u32("CycleTimeSync1", content)?,
                        "ShiftTimeSync1" => {
                            mode.sync1_shift_ns = place.number("ShiftTimeSync1", content, i32::MAX as u64)?;
                        }
                        _ => {}
                    }
                }
            }
            _ => {}
        }
        Ok(())
    }
}

fn close_slot(
    place: &Cursor<'_>,
    slot: &mut Slot,
    inside: &[&str],
    content: &str,
    is_default: bool,
) -> Result<(), EsiError> {
    match inside {
        ["Name"] if slot.name.is_empty() => content.trim().clone_into(&mut slot.name),
        ["ModuleIdent"] => {
            let ident = place.u32("ModuleIdent", content)?;
            slot.idents.push(ident);
            if is_default {
                slot.default.get_or_insert(ident);
            }
        }
        ["ModuleClass"] | ["ModuleClass", "Class"] if !content.trim().is_empty() => {
            slot.classes.push(content.trim().to_owned());
        }
        _ => {}
    }
    Ok(())
}

fn open_pdo(place: &Cursor<'_>, pdos: &mut Vec<Pdo>, inside: &[&str], start: &BytesStart<'_>) -> Result<(), EsiError> {
    let get = |name| attribute(place, start, name);
    if inside.is_empty() {
        let sync_manager = get("Sm")?;
        pdos.push(Pdo {
            sync_manager: if sync_manager.is_empty() { None } else { Some(place.u8("Sm", &sync_manager)?) },
            is_fixed: is_true(&get("Fixed")?),
            is_mandatory: is_true(&get("Mandatory")?),
            ..Pdo::default()
        });
        return Ok(());
    }
    let Some(pdo) = pdos.last_mut() else { return Ok(()) };
    match inside {
        ["Index"] => pdo.depends_on_slot = is_true(&get("DependOnSlot")?),
        ["Entry"] => pdo.entries.push(PdoEntry::default()),
        ["Entry", "Index"] => {
            let depends_on_slot = is_true(&get("DependOnSlot")?);
            pdo.entries.last_mut().into_iter().for_each(|entry| entry.depends_on_slot = depends_on_slot);
        }
        _ => {}
    }
    Ok(())
}

fn close_category(place: &Cursor<'_>, category: &mut Category, inside: &str, content: &str) -> Result<(), EsiError> {
    match inside {
        "CatNo" => category.number = place.u16("CatNo", content)?,
        "Data" => {
            let digits = EsiError::Digits { line: place.line(), element: "Data of a category" };
            category.bytes = hex_bytes(content.trim()).ok_or(digits)?;
        }
        // Hexadecimal digits of it are a text that is read again.
        "DataString" if content.len() >= MAX_TEXT / 2 => {
            let what = "bytes of text in a category";
            return Err(EsiError::TooMuch { line: place.line(), what, most: MAX_TEXT / 2 });
        }
        "DataString" => category.bytes = [content.as_bytes(), &[0]].concat(),
        "DataUINT" => category.bytes = place.u16("DataUINT", content)?.to_le_bytes().to_vec(),
        "DataUDINT" => category.bytes = place.u32("DataUDINT", content)?.to_le_bytes().to_vec(),
        _ => {}
    }
    Ok(())
}

fn close_pdo(place: &Cursor<'_>, pdo: &mut Pdo, inside: &[&str], content: &str) -> Result<(), EsiError> {
    match inside {
        ["Index"] => pdo.index = place.u16("Index of a PDO", content)?,
        ["Name"] if pdo.name.is_empty() => content.trim().clone_into(&mut pdo.name),
        ["Exclude"] => pdo.excludes.push(place.u16("Exclude", content)?),
        ["Entry", field] => {
            let Some(entry) = pdo.entries.last_mut() else { return Ok(()) };
            match *field {
                "Index" => entry.index = place.u16("Index of an entry", content)?,
                "SubIndex" => entry.sub = place.u8("SubIndex", content)?,
                "BitLen" => entry.bits = place.u16("BitLen", content)?,
                "Name" if entry.name.is_empty() => content.trim().clone_into(&mut entry.name),
                "DataType" => content.trim().clone_into(&mut entry.data_type),
                _ => {}
            }
        }
        _ => {}
    }
    Ok(())
}
