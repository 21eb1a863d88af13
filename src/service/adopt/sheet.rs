//! Comparison of a data sheet with the objects of a drive.

use yieldwall_drives::eds::{Access, Eds, Entry, Value};
use yieldwall_drives::objects as cia;

use super::{RPDO, Survey};
use crate::known::known;
use yieldwall_fieldbus::objects::{AbortCode, Address};

/// Longest name of an object, or of a product, that is taken from a data sheet.
const LONGEST_NAME: usize = 60;
/// UNSIGNED8, which a dummy entry of one byte is of.
const DUMMY_TYPE: u16 = 0x05;
/// Parameters of PDOs: what their values may be depends on one another, which no limit says.
const PDO_PARAMETERS: std::ops::Range<u16> = 0x1400..0x1c00;

/// Result of reading one object of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectReading {
    /// It has none.
    Absent,
    /// It was sent with so many bytes.
    Sent(usize),
    /// It took this value.
    Took(i64),
    /// It refused this value.
    Refused(i64, AbortCode),
    /// Whether it goes into a PDO.
    Mapped(bool),
}

/// Entries of the first RPDO's mapping by a data sheet; `None` where it does not say.
pub(super) fn mapping_entries(sheet: &Eds) -> Option<u8> {
    sheet.objects.get(&RPDO.mapping)?.entries.keys().copied().max().filter(|last| (1..=64).contains(last))
}

/// Contradictions between a data sheet or a device description and the drive, a line each. The drive's word counts.
pub fn contradictions(sheet: Option<&Eds>, survey: &Survey) -> Vec<String> {
    let mut found = survey.pdo_contradictions.clone();
    let Some(sheet) = sheet else { return found };
    let device = &sheet.device;
    let declared = |at: cia::Object| match sheet.entry(at.index, at.sub) {
        Some(Entry { default: Some(Value::Integer(value)), access: Access::Constant | Access::ReadOnly, .. }) => {
            u32::try_from(*value).ok()
        }
        _ => None,
    };
    let [vendor, product, revision, _] = survey.identity;
    for (what, of_sheet, of_drive) in [
        ("device type", declared(cia::DEVICE_TYPE), Some(survey.device_type)),
        ("vendor", device.vendor_number.or(declared(cia::VENDOR_ID)), vendor),
        ("product code", device.product_number.or(declared(cia::PRODUCT_CODE)), product),
        ("revision", device.revision_number.or(declared(cia::REVISION)), revision),
        ("supported modes (6502h)", declared(cia::SUPPORTED_MODES), Some(survey.supported_modes)),
    ] {
        if let (Some(of_sheet), Some(of_drive)) = (of_sheet, of_drive)
            && of_sheet != of_drive
        {
            found.push(format!("{what}: {of_sheet:08X}h by the data sheet, {of_drive:08X}h by the drive"));
        }
    }
    if let Some(entries) = mapping_entries(sheet).filter(|entries| *entries != survey.mapping_entries) {
        let own = survey.mapping_entries;
        found.push(format!("entries of a mapping: {entries} by the data sheet, {own} by the drive"));
    }
    let has_dummies = sheet.dummies.contains(&DUMMY_TYPE);
    if has_dummies != survey.has_dummies {
        let word = |has: bool| if has { "yes" } else { "no" };
        let [of_sheet, of_drive] = [has_dummies, survey.has_dummies].map(word);
        found.push(format!("dummy entries of one byte: {of_sheet} by the data sheet, {of_drive} by the drive"));
    }
    for (at, told) in &survey.told {
        let Some(line) = contradiction(sheet, *at, *told) else { continue };
        if !found.contains(&line) {
            found.push(line);
        }
    }
    found
}

fn contradiction(sheet: &Eds, at: Address, told: ObjectReading) -> Option<String> {
    let name = name(at, Some(sheet));
    let Some(entry) = sheet.entry(at.index, at.sub) else {
        return match told {
            ObjectReading::Sent(_) | ObjectReading::Took(_) => {
                Some(format!("{at} {name}: not in the data sheet, and the drive has it"))
            }
            ObjectReading::Absent | ObjectReading::Refused(..) | ObjectReading::Mapped(_) => None,
        };
    };
    let limit = |limit: &Option<Value>| match limit {
        Some(Value::Integer(value)) => i64::try_from(*value).ok(),
        _ => None,
    };
    let (low, high) = (limit(&entry.low), limit(&entry.high));
    let allows = |value: i64| low.is_none_or(|low| low <= value) && high.is_none_or(|high| value <= high);
    let range = || {
        let word = |end: Option<i64>, open: &str| end.map_or(open.to_owned(), |end| end.to_string());
        format!("{} to {}", word(low, "its least"), word(high, "its greatest"))
    };
    let has_limits = (low.is_some() || high.is_some()) && !PDO_PARAMETERS.contains(&at.index);
    let line = match told {
        ObjectReading::Absent => "in the data sheet, and the drive does not have it".to_owned(),
        ObjectReading::Sent(bytes) => {
            let meant = usize::from(Value::Integer(0).to_bytes(entry.data_type, 0)?.len() as u8);
            if bytes == meant {
                return None;
            }
            format!("bytes: {meant} by the data sheet, {bytes} from the drive")
        }
        ObjectReading::Took(_) if !entry.access.is_writable() => {
            "read only by the data sheet, and the drive takes a value".to_owned()
        }
        ObjectReading::Took(value) if has_limits && !allows(value) => {
            format!("{} by the data sheet, and the drive takes {value}", range())
        }
        ObjectReading::Refused(_, AbortCode::READ_ONLY) if entry.access.is_writable() => {
            "written by the data sheet, and the drive says that it is read only".to_owned()
        }
        ObjectReading::Refused(value, code) if has_limits && allows(value) && entry.access.is_writable() => {
            format!("{} by the data sheet, and the drive refuses {value} ({})", range(), code.name())
        }
        ObjectReading::Mapped(true) if !entry.is_mappable => {
            "not mapped by the data sheet, and the drive maps it".to_owned()
        }
        ObjectReading::Mapped(false) if entry.is_mappable => {
            "mapped by the data sheet, and the drive does not map it".to_owned()
        }
        ObjectReading::Took(_) | ObjectReading::Refused(..) | ObjectReading::Mapped(_) => return None,
    };
    Some(format!("{at} {name}: {line}"))
}

/// The name of an object by a data sheet, or else by the standards, as it can stand in a file.
pub(super) fn name(at: Address, sheet: Option<&Eds>) -> String {
    known(at, sheet).map_or_else(|| "without a name".to_owned(), |known| plain(&known.name))
}

/// A text of a data sheet without what does something to whatever shows it, and not longer than a name.
pub(super) fn plain(text: &str) -> String {
    text.chars()
        .map(|one| if one == '"' || one == '\\' { '\'' } else { one })
        .filter(|one| one.is_alphanumeric() || one.is_ascii_graphic() || *one == ' ')
        .take(LONGEST_NAME)
        .collect::<String>()
        .trim()
        .to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet() -> Eds {
        let text = b"[DeviceInfo]\nVendorName=x\nVendorNumber=0x10\nProductNumber=0x20\n[DummyUsage]\nDummy0005=1\n\
            [6007]\nParameterName=Abort\nObjectType=7\nDataType=3\nAccessType=rw\nLowLimit=0\nHighLimit=2\n\
            [6041]\nParameterName=Status\nObjectType=7\nDataType=6\nAccessType=ro\nPDOMapping=1\n\
            [6072]\nParameterName=Peak \x1b[31m\"torque\"\nObjectType=7\nDataType=6\nAccessType=ro\nPDOMapping=0\n\
            [1600]\nParameterName=Map\nObjectType=9\nSubNumber=3\n[1600sub0]\nParameterName=n\nDataType=5\nAccessType=rw\n\
            [1600sub1]\nParameterName=1\nDataType=7\nAccessType=rw\n[1600sub2]\nParameterName=2\nDataType=7\nAccessType=rw\n";
        Eds::read(text).unwrap().eds
    }

    #[test]
    fn each_thing_that_a_sheet_says_otherwise_is_a_line() {
        let at = |index: u16| Address::new(index, 0);
        let survey = Survey {
            identity: [Some(0x10), Some(0x21), Some(1), Some(1)],
            mapping_entries: 4,
            told: vec![
                (at(0x6007), ObjectReading::Refused(1, AbortCode::VALUE)),
                (at(0x6007), ObjectReading::Took(3)),
                (at(0x6041), ObjectReading::Sent(4)),
                (at(0x6041), ObjectReading::Mapped(false)),
                (at(0x6072), ObjectReading::Took(900)),
                (at(0x6072), ObjectReading::Mapped(true)),
                (at(0x60c2), ObjectReading::Sent(1)),
                (at(0x6041), ObjectReading::Sent(4)),
                (at(0x6041), ObjectReading::Absent),
            ],
            ..Survey::default()
        };
        let lines = contradictions(Some(&sheet()), &survey);
        let expected = [
            "product code: 00000020h by the data sheet, 00000021h by the drive",
            "entries of a mapping: 2 by the data sheet, 4 by the drive",
            "dummy entries of one byte: yes by the data sheet, no by the drive",
            "6007h:0 Abort: 0 to 2 by the data sheet, and the drive refuses 1",
            "6007h:0 Abort: 0 to 2 by the data sheet, and the drive takes 3",
            "6041h:0 Status: bytes: 2 by the data sheet, 4 from the drive",
            "6041h:0 Status: mapped by the data sheet, and the drive does not map it",
            "6072h:0 Peak [31m'torque': read only by the data sheet, and the drive takes a value",
            "6072h:0 Peak [31m'torque': not mapped by the data sheet, and the drive maps it",
            "60C2h:0 without a name: not in the data sheet, and the drive has it",
            "6041h:0 Status: in the data sheet, and the drive does not have it",
        ];
        assert_eq!(lines.len(), expected.len(), "{lines:#?}");
        for (line, expected) in lines.iter().zip(expected) {
            assert!(line.starts_with(expected), "{line}\n{expected}");
        }
    }

    #[test]
    fn a_sheet_that_is_right_contradicts_nothing() {
        let survey = Survey {
            identity: [Some(0x10), Some(0x20), None, None],
            mapping_entries: 2,
            has_dummies: true,
            told: vec![
                (Address::new(0x6007, 0), ObjectReading::Took(2)),
                (Address::new(0x6007, 0), ObjectReading::Refused(3, AbortCode::VALUE)),
                (Address::new(0x6041, 0), ObjectReading::Sent(2)),
                (Address::new(0x6041, 0), ObjectReading::Mapped(true)),
            ],
            ..Survey::default()
        };
        assert_eq!(contradictions(Some(&sheet()), &survey), Vec::<String>::new());
    }
}
