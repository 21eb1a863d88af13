//! From sections to a data sheet.

use std::collections::BTreeMap;

use super::ini::{Section, Sections, Text, add, sections};
use super::modules::plug;
use super::number::{integer, number, odd_value, value, whole};
use super::{
    Access, DeviceInfo, Eds, EdsError, Entry, Finding, Kind, Level, MAX_BYTES, MAX_ENTRIES, Node, Object, Reading,
    Value,
};

/// Bit rates that a device may have, in kbit/s.
const BIT_RATES: [u32; 8] = [10, 20, 50, 125, 250, 500, 800, 1000];
/// Lists of the objects that a file has.
const LISTS: [&str; 3] = ["MandatoryObjects", "OptionalObjects", "ManufacturerObjects"];
/// Type of the number of entries at sub-index 0.
const UNSIGNED8: u16 = 5;

pub(super) fn read(bytes: &[u8]) -> Result<Reading, EdsError> {
    if bytes.len() > MAX_BYTES {
        return Err(EdsError::Large);
    }
    let mut findings = Vec::new();
    let text = text(bytes, &mut findings);
    if let Some(at) = text.find('\0') {
        let line = text.get(..at).map_or(1, |before| 1 + before.matches('\n').count());
        return Err(EdsError::NotText { line });
    }
    let sections = sections(text.trim_start_matches('\u{feff}'), &mut findings);
    let mut reader = Reader { sections: &sections, findings, entries: 0 };
    let objects = reader.objects()?;
    if objects.is_empty() {
        return Err(EdsError::NoObject { line: text.lines().count().max(1) });
    }
    reader.check_lists(&objects);
    reader.check_names(&objects);
    let mut eds = Eds {
        device: reader.device(),
        dummies: reader.dummies(),
        modules: reader.modules()?,
        connected: reader.connected(),
        node: reader.node(),
        objects,
    };
    plug(&mut eds, &mut reader)?;
    let mut findings = reader.findings;
    findings.sort_by_key(|finding| finding.line);
    Ok(Reading { eds, findings })
}

/// UTF-8; UTF-16 with its mark; or Latin-1, whose bytes are the first 256 characters.
fn text(bytes: &[u8], findings: &mut Vec<Finding>) -> String {
    let wide = |bytes: &[u8], word: fn([u8; 2]) -> u16| {
        let words = bytes.chunks_exact(2).map(|pair| word([pair[0], pair[1]]));
        char::decode_utf16(words).map(|one| one.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
    };
    let utf16: Option<String> = match bytes {
        [0xff, 0xfe, rest @ ..] => Some(wide(rest, u16::from_le_bytes)),
        [0xfe, 0xff, rest @ ..] => Some(wide(rest, u16::from_be_bytes)),
        _ => None,
    };
    if let Some(text) = utf16 {
        let message = "the file is UTF-16".to_owned();
        let help = "it is read; other tools want UTF-8";
        findings.push(Finding { line: 1, level: Level::Warning, message, help });
        return text;
    }
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(error) => {
            let line = 1 + bytes.iter().take(error.valid_up_to()).filter(|byte| **byte == b'\n').count();
            let message = "the file is not UTF-8 from here on".to_owned();
            findings.push(Finding { line, level: Level::Warning, message, help: "it is read as Latin-1" });
            bytes.iter().copied().map(char::from).collect()
        }
    }
}

/// Sections on their way to a data sheet.
pub(super) struct Reader<'a> {
    pub(super) sections: &'a Sections,
    findings: Vec<Finding>,
    entries: usize,
}

/// Meaning of the name of a section.
enum Name {
    Object(u16),
    Sub(u16, u8),
    Other,
}

fn name_of(section: &str) -> Name {
    let hexadecimal = |digits: &str| {
        let digits = digits.strip_prefix("0x").unwrap_or(digits);
        let is_number = (1..=4).contains(&digits.len()) && digits.bytes().all(|one| one.is_ascii_hexdigit());
        is_number.then(|| u16::from_str_radix(digits, 16).ok()).flatten()
    };
    if let Some((index, sub)) = section.split_once("sub") {
        return match (hexadecimal(index.trim()), hexadecimal(sub.trim()).map(u8::try_from)) {
            (Some(index), Some(Ok(sub))) => Name::Sub(index, sub),
            _ => Name::Other,
        };
    }
    // An index has four digits: the modules and parts of other standards have shorter numbers.
    match hexadecimal(section) {
        Some(index) if section.trim_start_matches("0x").len() == 4 => Name::Object(index),
        _ => Name::Other,
    }
}

/// Whether a section has names, values or links of an object.
fn is_part(section: &str) -> bool {
    let parts = ["name", "value", "denotation", "objectlinks"];
    parts.iter().any(|part| section.strip_suffix(part).is_some_and(|index| matches!(name_of(index), Name::Object(_))))
}

impl Reader<'_> {
    pub(super) fn find(&mut self, line: usize, level: Level, message: String, help: &'static str) {
        add(&mut self.findings, Finding { line, level, message, help });
    }

    /// Returns the number at a key. A text that is no number is a finding and counts as missing; an empty text is just missing.
    pub(super) fn number(&mut self, section: &Section, key: &str) -> Option<i128> {
        let text = section.get(key).filter(|text| !text.text.is_empty())?;
        let found = number(&text.text);
        if found.is_none() {
            let message = format!("{key} is `{}`, which is no number", text.text.escape_debug());
            self.find(text.line, Level::Warning, message, "it is taken as if it were not there");
        }
        found
    }

    fn objects(&mut self) -> Result<BTreeMap<u16, Object>, EdsError> {
        let mut objects = BTreeMap::new();
        for (name, section) in self.sections {
            match name_of(name) {
                Name::Object(index) => {
                    let object = self.object(index, section)?;
                    objects.insert(index, object);
                }
                Name::Other if name.starts_with(|one: char| one.is_ascii_digit()) && !is_part(name) => {
                    let message = format!("the section `{}` is that of no object", name.escape_debug());
                    let help = "it is left out; an index has four hexadecimal digits, a sub-index one or two";
                    self.find(section.line, Level::Warning, message, help);
                }
                _ => {}
            }
        }
        for (name, section) in self.sections {
            let Name::Sub(index, sub) = name_of(name) else { continue };
            self.count(section.line, 1)?;
            let Some(object) = objects.get_mut(&index) else {
                let message = format!("[{name}] belongs to no object: there is no section [{index:04X}]");
                self.find(section.line, Level::Error, message, "it is left out");
                continue;
            };
            if object.kind == Kind::Variable {
                let message = format!("[{name}] belongs to an object that is one variable");
                self.find(section.line, Level::Warning, message, "the object is taken for a record");
                object.kind = Kind::Record;
                object.entries.clear();
            }
            if let Some(entry) = self.entry(section) {
                object.entries.insert(sub, entry);
            }
        }
        // A variable of no known type has been told, and nothing is left of it.
        objects.retain(|_, object: &mut Object| {
            !(object.entries.is_empty() && matches!(object.kind, Kind::Variable | Kind::Domain))
        });
        self.check_counts(&objects);
        Ok(objects)
    }

    pub(super) fn count(&mut self, line: usize, more: usize) -> Result<(), EdsError> {
        self.entries += more;
        if self.entries > MAX_ENTRIES { Err(EdsError::Many { line }) } else { Ok(()) }
    }

    /// The object of a section, without the entries that have sections of their own.
    pub(super) fn object(&mut self, index: u16, section: &Section) -> Result<Object, EdsError> {
        let name = section.text("parametername");
        let code = section.get("objecttype").map_or(Some(7), |text| number(&text.text));
        let kind = match code {
            Some(2) => Kind::Domain,
            Some(5) => Kind::TypeDefinition,
            Some(6) => Kind::RecordDefinition,
            Some(7) => Kind::Variable,
            Some(8) => Kind::Array,
            Some(9) => Kind::Record,
            _ => {
                let line = section.get("objecttype").map_or(section.line, |text| text.line);
                let message = format!("the object {index:04X}h has a type that no object has");
                self.find(line, Level::Warning, message, "it is taken for a variable (0x7)");
                Kind::Variable
            }
        };
        let mut object = Object { name, kind, entries: BTreeMap::new(), line: section.line };
        let compact = self.number(section, "CompactSubObj").unwrap_or(0);
        if compact != 0 && !(1..=254).contains(&compact) {
            let line = section.get("compactsubobj").map_or(section.line, |text| text.line);
            let message =
                format!("CompactSubObj of {index:04X}h is {compact}, and an object has at most 254 such entries");
            self.find(line, Level::Warning, message, "254 are taken of more, and none of a negative number");
        }
        if compact > 0 {
            let subs = u8::try_from(compact.min(254)).unwrap_or(254);
            self.count(section.line, usize::from(subs) + 1)?;
            object.entries = self.compact(index, section, subs);
            if object.kind == Kind::Variable {
                object.kind = Kind::Array;
            }
        } else if kind == Kind::TypeDefinition && section.get("datatype").is_none() {
            // It stands for a type, and has no value.
        } else if matches!(kind, Kind::Variable | Kind::Domain | Kind::TypeDefinition) {
            self.count(section.line, 1)?;
            object.entries.extend(self.entry(section).map(|entry| (0, entry)));
        }
        Ok(object)
    }

    /// The entries of an object that stands for many of one type.
    fn compact(&mut self, index: u16, section: &Section, subs: u8) -> BTreeMap<u8, Entry> {
        let Some(entry) = self.entry(section) else { return BTreeMap::new() };
        let part = |what: &str| self.sections.get(&format!("{index:04x}{what}"));
        let (names, values) = (part("name"), part("value"));
        let mut wrong = Vec::new();
        let one = |sub: u8| {
            let named = names.map(|names| names.text(&sub.to_string())).filter(|name| !name.is_empty());
            let set = values.and_then(|values| values.get(&sub.to_string()));
            let set = set.and_then(|text| match value(&text.text, entry.data_type) {
                Ok(value) => Some(value),
                Err(message) => {
                    wrong.push((text.line, message));
                    None
                }
            });
            let name = named.unwrap_or_else(|| format!("{} {sub}", entry.name));
            (sub, Entry { name, value: set, ..entry.clone() })
        };
        let mut entries: BTreeMap<u8, Entry> = (1..=subs).map(one).collect();
        let count = Entry {
            name: "Number of entries".to_owned(),
            data_type: UNSIGNED8,
            access: Access::ReadOnly,
            default: Some(Value::Integer(i128::from(subs))),
            value: None,
            low: None,
            high: None,
            is_mappable: false,
            is_kept_from_download: false,
            line: section.line,
        };
        entries.insert(0, count);
        for (line, message) in wrong {
            self.find(line, Level::Error, message, "this value is left out");
        }
        entries
    }

    /// The entry of a section; `None` if its type is not known.
    pub(super) fn entry(&mut self, section: &Section) -> Option<Entry> {
        let data_type = match section.get("datatype").map(|text| (number(&text.text), text)) {
            Some((Some(number), _)) if (1..=0xfff).contains(&number) => number as u16,
            Some((_, Text { text, line })) => {
                let message = format!("`{text}` is no data type");
                self.find(*line, Level::Error, message, "the entry is left out; 0x0007 is UNSIGNED32");
                return None;
            }
            // A domain needs none.
            None if section.get("objecttype").is_some_and(|text| number(&text.text) == Some(2)) => 0x0f,
            None => {
                let message = format!("`{}` has no DataType", section.text("parametername"));
                self.find(section.line, Level::Error, message, "the entry is left out");
                return None;
            }
        };
        let access = match section.get("accesstype").map(|text| (text.text.to_ascii_lowercase(), text.line)) {
            Some((word, line)) => match word.as_str() {
                "const" => Access::Constant,
                "ro" => Access::ReadOnly,
                "wo" => Access::WriteOnly,
                "rw" => Access::ReadWrite,
                "rwr" => Access::ReadWriteInput,
                "rww" => Access::ReadWriteOutput,
                _ => {
                    let message = format!("`{}` is no access type", word.escape_debug());
                    self.find(line, Level::Warning, message, "nothing is written there (ro)");
                    Access::ReadOnly
                }
            },
            None => {
                let message = format!("`{}` has no AccessType", section.text("parametername"));
                self.find(section.line, Level::Warning, message, "nothing is written there (ro)");
                Access::ReadOnly
            }
        };
        let mut taken = |key: &str| self.value(section, key, data_type);
        let (default, set, mut low, mut high) =
            (taken("defaultvalue"), taken("parametervalue"), taken("lowlimit"), taken("highlimit"));
        let is_inverted = match (&low, &high) {
            (Some(Value::Integer(low)), Some(Value::Integer(high))) => low > high,
            (Some(Value::Real(low)), Some(Value::Real(high))) => low > high,
            _ => false,
        };
        if is_inverted {
            let line = section.get("lowlimit").map_or(section.line, |text| text.line);
            let message = format!("LowLimit of `{}` is above its HighLimit", section.text("parametername"));
            self.find(line, Level::Error, message, "both limits are left out");
            (low, high) = (None, None);
        }
        for (key, of) in [("defaultvalue", &default), ("parametervalue", &set)] {
            let beyond = |limit: &Option<Value>, is_low: bool| match (of, limit) {
                (Some(Value::Integer(value)), Some(Value::Integer(limit))) => {
                    if is_low {
                        value < limit
                    } else {
                        value > limit
                    }
                }
                (Some(Value::Real(value)), Some(Value::Real(limit))) => {
                    if is_low {
                        value < limit
                    } else {
                        value > limit
                    }
                }
                _ => false,
            };
            if let (Some(text), true) = (section.get(key), beyond(&low, true) || beyond(&high, false)) {
                let message = format!("`{}` is beyond the limits of `{}`", text.text, section.text("parametername"));
                self.find(text.line, Level::Warning, message, "look at LowLimit and HighLimit");
            }
        }
        let is_mappable = self.number(section, "PDOMapping").is_some_and(|number| number != 0);
        let is_kept_from_download = self.number(section, "ObjFlags").is_some_and(|flags| flags & 1 != 0);
        let name = section.text("parametername");
        let line = section.line;
        Some(Entry {
            name,
            data_type,
            access,
            default,
            value: set,
            low,
            high,
            is_mappable,
            is_kept_from_download,
            line,
        })
    }

    /// A value, if there is one: nothing stands for none.
    fn value(&mut self, section: &Section, key: &str, data_type: u16) -> Option<Value> {
        let text = section.get(key)?;
        let is_text = integer(data_type).is_none() && !matches!(data_type, 0x08 | 0x11);
        if text.text.is_empty() && (!is_text || key != "defaultvalue") {
            return None;
        }
        match value(&text.text, data_type) {
            Ok(value) => Some(value),
            Err(message) => match odd_value(&text.text, data_type) {
                Some((value, what)) => {
                    let message = format!("`{}` {what}", text.text.escape_debug());
                    self.find(text.line, Level::Warning, message, "it is taken for what it can mean alone");
                    Some(value)
                }
                None => {
                    self.find(text.line, Level::Error, message, "this value is left out");
                    None
                }
            },
        }
    }

    /// Whether objects have as many entries as they say.
    fn check_counts(&mut self, objects: &BTreeMap<u16, Object>) {
        for (index, object) in objects {
            let section = self.sections.get(&format!("{index:04x}"));
            let Some(text) = section.and_then(|section| section.get("subnumber")) else { continue };
            let Some(said) = number(&text.text) else { continue };
            let found = object.entries.len() as i128;
            if said != 0 && said != found && !matches!(object.kind, Kind::Variable | Kind::Domain) {
                let message = format!("the object {index:04X}h says that it has {said} entries, and has {found}");
                self.find(text.line, Level::Warning, message, "those that are there count");
            }
        }
    }

    /// Whether the lists of objects name those that are there.
    fn check_lists(&mut self, objects: &BTreeMap<u16, Object>) {
        let mut listed = Vec::new();
        for list in LISTS {
            let Some(section) = self.sections.get(&list.to_ascii_lowercase()) else { continue };
            let there = section.iter().filter(|(key, _)| key.bytes().all(|one| one.is_ascii_digit())).count();
            let said = self.number(section, "SupportedObjects");
            if let (Some(text), Some(said)) = (section.get("supportedobjects"), said)
                && said != there as i128
            {
                let message = format!("[{list}] says that it lists {said} objects, and lists {there}");
                self.find(text.line, Level::Warning, message, "those that are listed count");
            }
            for (key, text) in section.iter().filter(|(key, _)| key.bytes().all(|one| one.is_ascii_digit())) {
                let digits = text.text.trim_end_matches(['h', 'H']);
                let bare = Some(digits)
                    .filter(|digits| digits.len() == 4)
                    .and_then(|digits| u16::from_str_radix(digits, 16).ok());
                match number(&text.text).and_then(|number| u16::try_from(number).ok()) {
                    Some(index) if objects.contains_key(&index) => listed.push(index),
                    _ if bare.is_some_and(|index| objects.contains_key(&index)) => {
                        listed.extend(bare);
                        let message =
                            format!("entry {key} of [{list}] is `{}`, without `0x`", text.text.escape_debug());
                        self.find(text.line, Level::Warning, message, "it is taken as hexadecimal");
                    }
                    Some(index) if self.sections.contains_key(&format!("{index:04x}")) => {}
                    Some(index) => {
                        let message = format!("the object {index:04X}h is listed, and has no section");
                        self.find(text.line, Level::Warning, message, "it is left out");
                    }
                    None => {
                        let message = format!("entry {key} of [{list}] is no index");
                        self.find(text.line, Level::Warning, message, "it is left out");
                    }
                }
            }
        }
        listed.sort_unstable();
        for (index, object) in objects {
            if listed.binary_search(index).is_err() {
                let message = format!("the object {index:04X}h has a section, and is in no list");
                self.find(object.line, Level::Warning, message, "it is taken all the same");
            }
        }
    }

    /// Whether names and values of compact objects belong to entries that are there.
    fn check_names(&mut self, objects: &BTreeMap<u16, Object>) {
        for (name, section) in self.sections {
            let Some(index) = ["name", "value", "denotation"].iter().find_map(|part| name.strip_suffix(part)) else {
                continue;
            };
            let Name::Object(index) = name_of(index) else { continue };
            let object = objects.get(&index);
            for (key, text) in section.iter() {
                let Some(sub) = whole(key) else { continue };
                let is_there =
                    u8::try_from(sub).is_ok_and(|sub| object.is_some_and(|object| object.entries.contains_key(&sub)));
                if !is_there {
                    let message = format!("[{name}] has something for the sub-index {sub}, which is not there");
                    self.find(text.line, Level::Warning, message, "it is left out; compare with CompactSubObj");
                }
            }
        }
    }

    fn device(&mut self) -> DeviceInfo {
        let Some(section) = self.sections.get("deviceinfo") else { return DeviceInfo::default() };
        let identity = |number: Option<i128>| number.and_then(|number| u32::try_from(number).ok());
        let count = |number: Option<i128>| number.and_then(|number| u16::try_from(number).ok());
        DeviceInfo {
            vendor: section.text("vendorname"),
            vendor_number: identity(self.number(section, "VendorNumber")),
            product: section.text("productname"),
            product_number: identity(self.number(section, "ProductNumber")),
            revision_number: identity(self.number(section, "RevisionNumber")),
            bit_rates_kbit_per_s: BIT_RATES
                .into_iter()
                .filter(|rate| self.number(section, &format!("BaudRate_{rate}")).is_some_and(|number| number != 0))
                .collect(),
            rpdos: count(self.number(section, "NrOfRXPDO")),
            tpdos: count(self.number(section, "NrOfTXPDO")),
            has_lss: self.number(section, "LSS_Supported").is_some_and(|number| number != 0),
        }
    }

    fn dummies(&self) -> std::collections::BTreeSet<u16> {
        let Some(section) = self.sections.get("dummyusage") else { return Default::default() };
        let used = section.iter().filter(|(_, text)| number(&text.text) == Some(1));
        used.filter_map(|(key, _)| u16::from_str_radix(key.strip_prefix("dummy")?, 16).ok()).collect()
    }

    fn node(&mut self) -> Option<Node> {
        // The standard's own spelling has one m; tools write both.
        let section =
            ["devicecomissioning", "devicecommissioning"].into_iter().find_map(|name| self.sections.get(name))?;
        let said = self.number(section, "NodeID");
        let id = said.and_then(|number| u8::try_from(number).ok()).filter(|id| (1..=127).contains(id));
        let Some(id) = id else {
            // A device on EtherCAT has none.
            section.get("nodeid")?;
            let line = section.get("nodeid").map_or(section.line, |text| text.line);
            let message = format!("NodeID of [{}] is no number from 1 to 127", "DeviceComissioning");
            self.find(line, Level::Warning, message, "the file is taken as one of no certain node");
            return None;
        };
        let bit_rate_kbit_per_s = self.number(section, "Baudrate").and_then(|rate| u32::try_from(rate).ok());
        Some(Node { id, name: section.text("nodename"), bit_rate_kbit_per_s })
    }
}
