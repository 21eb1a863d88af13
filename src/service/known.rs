//! Objects that have a name: those of the standards, and those of a data sheet.

use yieldwall_drives::eds::{self, Eds};
use yieldwall_drives::objects;

use super::scan::number;
use yieldwall_fieldbus::objects::{Address, mask, sign_extend};

/// Whole numbers by the numbers of their types.
const I8: u16 = 0x02;
const I16: u16 = 0x03;
const I32: u16 = 0x04;
const U8: u16 = 0x05;
const U16: u16 = 0x06;
const U32: u16 = 0x07;

/// Known facts about an object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Known {
    /// Its name.
    pub name: String,
    /// Its data type by its number, as 0007h for UNSIGNED32.
    pub data_type: u16,
    /// Whether it may be written, if that is known.
    pub is_writable: Option<bool>,
}

/// Returns the facts about an object in a data sheet, or else in the standards.
pub fn known(at: Address, eds: Option<&Eds>) -> Option<Known> {
    eds.and_then(|eds| of_sheet(at, eds)).or_else(|| of_standard(at))
}

/// The data type of an object that holds `held`. The data sheet or the standards give it, except that a torque limit which a drive counts
/// with a minus has a sign.
pub fn type_held(at: Address, eds: Option<&Eds>, held: &[u8]) -> Option<u16> {
    let is_of_sheet = eds.is_some_and(|eds| eds.entry(at.index, at.sub).is_some());
    let is_limit = [objects::POSITIVE_TORQUE_LIMIT, objects::NEGATIVE_TORQUE_LIMIT]
        .iter()
        .any(|limit| (limit.index, limit.sub) == (at.index, at.sub));
    match (is_limit && !is_of_sheet && torque_limit(held) < 0, held.len(), number(held)) {
        (false, ..) => known(at, eds).map(|known| known.data_type),
        (true, ..=1, _) => Some(I8),
        (true, _, ..=0xffff) => Some(I16),
        (true, ..) => Some(I32),
    }
}

/// A torque limit (60E0h, 60E1h) from its bytes, in the drive's unit. Some drives count the limit as a magnitude, others as a negative
/// number. All bits set are no limit (`u32::MAX`).
pub fn torque_limit(held: &[u8]) -> i64 {
    let word = number(held);
    let bits = match (held.len(), word) {
        (..=1, _) => 8,
        // More bytes than the value needs: a device may fill up with zeros.
        (_, ..=0xffff) => 16,
        _ => 32,
    };
    let word = u64::from(word);
    if word == mask(bits) { i64::from(u32::MAX) } else { sign_extend(word, bits) }
}

/// An object with its name, if it has one: `6041h:0 statusword`.
pub fn titled(at: Address, name: &str) -> String {
    if name.is_empty() { at.to_string() } else { format!("{at} {name}") }
}

fn of_sheet(at: Address, eds: &Eds) -> Option<Known> {
    let object = eds.objects.get(&at.index)?;
    let entry = object.entries.get(&at.sub)?;
    let name = match object.kind {
        eds::Kind::Variable | eds::Kind::Domain => object.name.clone(),
        _ => format!("{}.{}", object.name, entry.name),
    };
    Some(Known { name, data_type: entry.data_type, is_writable: Some(entry.access.is_writable()) })
}

/// The objects that have the same meaning in every device: not those of a vendor, 2000h to 5FFFh.
fn standard() -> impl Iterator<Item = &'static objects::Object> {
    objects::ALL.iter().filter(|object| !(0x2000..0x6000).contains(&object.index))
}

fn of_standard(at: Address) -> Option<Known> {
    let own = standard().find(|object| (object.index, object.sub) == (at.index, at.sub));
    if let Some(object) = own {
        return Some(Known { name: word(object.name), data_type: object.data_type.number(), is_writable: None });
    }
    let pdo = usize::from(at.index & 0x1ff) + 1;
    let named = |name: String, data_type: u16| Some(Known { name, data_type, is_writable: None });
    match (at.index & 0xfe00, at.index, at.sub) {
        (_, 0x1003, sub) => named(format!("error-{sub}"), U32),
        (_, 0x1009, 0) => named("hardware-version".to_owned(), 0x09),
        (_, 0x100a, 0) => named("software-version".to_owned(), 0x09),
        (_, 0x1010 | 0x1011 | 0x1016 | 0x1018 | 0x1029, 0) => named("highest-sub-index".to_owned(), U8),
        (_, 0x1016, sub) => named(format!("consumer-heartbeat-{sub}"), U32),
        (_, 0x1029, sub) => named(format!("error-behaviour-{sub}"), U8),
        (_, 0x1200, 1) => named("sdo-request-cob-id".to_owned(), U32),
        (_, 0x1200, 2) => named("sdo-response-cob-id".to_owned(), U32),
        (0x1400 | 0x1800, _, sub) => {
            let direction = if at.index < 0x1800 { "rpdo" } else { "tpdo" };
            let (what, data_type) = match sub {
                0 => ("highest-sub-index", U8),
                1 => ("cob-id", U32),
                2 => ("transmission-type", U8),
                3 => ("inhibit-time-100us", U16),
                5 => ("event-timer-ms", U16),
                6 => ("sync-start", U8),
                _ => return None,
            };
            named(format!("{direction}-{pdo}.{what}"), data_type)
        }
        (0x1600 | 0x1a00, _, sub) => {
            let direction = if at.index < 0x1a00 { "rpdo" } else { "tpdo" };
            match sub {
                0 => named(format!("{direction}-{pdo}.mapped"), U8),
                sub => named(format!("{direction}-{pdo}.map-{sub}"), U32),
            }
        }
        (_, 0x1c12 | 0x1c13, sub) => {
            let direction = if at.index == 0x1c12 { "rpdos" } else { "tpdos" };
            match sub {
                0 => named(format!("{direction}.assigned"), U8),
                sub => named(format!("{direction}.assign-{sub}"), U16),
            }
        }
        (_, 0x6125 | 0x7130, 0) => named("highest-sub-index".to_owned(), U8),
        (_, 0x6125, sub) => named(format!("auto-zero-{sub}"), U32),
        (_, 0x7130, sub) => named(format!("process-value-{sub}"), 0x03),
        _ => None,
    }
}

/// Where the objects of this name lie. Case, dashes, underlines and blanks do not count.
///
/// If the data sheet has the object that the standards call so, the name means that object. Otherwise the names of the data sheet come
/// before those of the standards. Entries that other objects explain, such as those of a mapping, come last: many editors name them as
/// what they map. Among several objects of a data sheet the one counts that is spelt exactly so.
pub fn named(name: &str, eds: Option<&Eds>) -> Vec<Address> {
    let bare =
        |name: &str| name.chars().filter(|one| one.is_alphanumeric()).flat_map(char::to_lowercase).collect::<String>();
    let wanted = bare(name);
    let meant = standard().filter(|object| bare(object.name) == wanted);
    let of_standard: Vec<Address> = meant.map(|object| Address::new(object.index, object.sub)).collect();
    let Some(eds) = eds else { return of_standard };
    if of_standard.iter().any(|at| eds.entry(at.index, at.sub).is_some()) {
        return of_standard;
    }
    let of_sheet = eds.named(name).into_iter().map(|(index, sub)| Address::new(index, sub));
    let (explained, own): (Vec<Address>, Vec<Address>) = of_sheet.partition(|at| is_explained(*at));
    let found = [own, of_standard, explained].into_iter().find(|found| !found.is_empty()).unwrap_or_default();
    let exact: Vec<Address> = found.iter().copied().filter(|at| is_spelt(name, *at, eds)).collect();
    if exact.len() == 1 { exact } else { found }
}

/// Whether an entry only names another object or an error: entries of mappings, of assignments and of the error history.
fn is_explained(at: Address) -> bool {
    at.sub > 0 && matches!(at.index, 0x1003 | 0x1600..0x1800 | 0x1a00..0x1c00 | 0x1c10..0x1c30)
}

/// Whether a data sheet spells the name of an entry, of its object, or both with a dot between, exactly so.
fn is_spelt(name: &str, at: Address, eds: &Eds) -> bool {
    let own = eds.entry(at.index, at.sub).is_some_and(|entry| entry.name == name);
    let object = at.sub == 0 && eds.objects.get(&at.index).is_some_and(|object| object.name == name);
    own || object || of_sheet(at, eds).is_some_and(|known| known.name == name)
}

/// The names of the standards, and those of a data sheet: what somebody may have meant.
pub fn names(eds: Option<&Eds>) -> Vec<String> {
    let of_sheet = eds.into_iter().flat_map(Eds::entries).filter_map(|(index, sub, _)| {
        let known = known(Address::new(index, sub), eds)?;
        Some(word(&known.name).replace(' ', "-"))
    });
    standard().map(|object| word(object.name)).chain(of_sheet).collect()
}

/// `STATUSWORD` as `statusword`.
fn word(name: &str) -> String {
    name.to_lowercase().replace('_', "-")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_of_the_standards_are_found_by_their_names_and_back() {
        for object in standard() {
            let at = Address::new(object.index, object.sub);
            let found = known(at, None).unwrap();
            assert_eq!(named(&found.name, None), [at], "{}", found.name);
        }
        assert_eq!(named("Status Word", None), [Address::new(0x6041, 0)]);
        assert_eq!(known(Address::new(0x1a01, 2), None).unwrap().name, "tpdo-2.map-2");
        assert_eq!(known(Address::new(0x2010, 0), None), None, "of a vendor");
    }

    #[test]
    fn a_torque_limit_is_a_magnitude_or_a_negative_number() {
        let no_limit = i64::from(u32::MAX);
        for (held, limit, data_type) in [
            (&[0xe8, 0x03][..], 1000, U16),
            (&[0x18, 0xfc], -1000, I16),
            (&[0x0c, 0xfe], -500, I16),
            (&[0x9c], -100, I8),
            (&[0x64], 100, U16),
            (&[0x18, 0xfc, 0xff, 0xff], -1000, I32),
            (&[0x18, 0xfc, 0, 0], -1000, I16),
            (&[0xe8, 0x03, 0, 0], 1000, U16),
            (&[0xff, 0xff], no_limit, U16),
            (&[0xff; 4], no_limit, U16),
            (&[0xff, 0xff, 0, 0], no_limit, U16),
        ] {
            assert_eq!(torque_limit(held), limit, "{held:02x?}");
            assert_eq!(type_held(Address::new(0x60e1, 0), None, held), Some(data_type), "{held:02x?}");
        }
        assert_eq!(type_held(Address::new(0x6072, 0), None, &[0x18, 0xfc]), Some(U16), "another limit");
        let text =
            b"[DeviceInfo]\nVendorName=x\n[60E1]\nParameterName=Limit\nObjectType=7\nDataType=6\nAccessType=rw\n";
        let sheet = Eds::read(text).unwrap().eds;
        assert_eq!(type_held(Address::new(0x60e1, 0), Some(&sheet), &[0x18, 0xfc]), Some(U16), "the data sheet counts");
    }

    #[test]
    fn a_data_sheet_comes_first() {
        let text = b"[DeviceInfo]\nVendorName=x\n[6041]\nParameterName=Status Word\nObjectType=7\nDataType=6\nAccessType=ro\n\
            [2000]\nParameterName=Motor\nObjectType=9\nSubNumber=2\n[2000sub0]\nParameterName=Entries\nDataType=5\nAccessType=ro\n\
            [2000sub1]\nParameterName=Pole pairs\nDataType=5\nAccessType=rw\n";
        let eds = Eds::read(text).unwrap().eds;
        assert_eq!(named("motor.polepairs", Some(&eds)), [Address::new(0x2000, 1)]);
        assert_eq!(named("statusword", Some(&eds)), [Address::new(0x6041, 0)]);
        let pairs = known(Address::new(0x2000, 1), Some(&eds)).unwrap();
        assert_eq!((pairs.name.as_str(), pairs.data_type, pairs.is_writable), ("Motor.Pole pairs", 5, Some(true)));
    }

    /// A sheet of variables, and of records with one entry.
    fn sheet(objects: &[(u16, u8, &str)]) -> Eds {
        let mut text = "[DeviceInfo]\nVendorName=x\n".to_owned();
        for (index, sub, name) in objects {
            text += &match sub {
                0 => format!("[{index:04X}]\nParameterName={name}\nObjectType=7\nDataType=6\nAccessType=rw\n"),
                sub => format!(
                    "[{index:04X}]\nParameterName=List\nObjectType=9\nSubNumber=1\n\
                     [{index:04X}sub{sub:X}]\nParameterName={name}\nDataType=7\nAccessType=rw\n"
                ),
            };
        }
        Eds::read(text.as_bytes()).unwrap().eds
    }

    #[test]
    fn a_name_means_the_object_and_not_the_entries_that_list_it() {
        let [status, code] = [Address::new(0x6041, 0), Address::new(0x603f, 0)];
        for (objects, name, meant) in [
            (&[(0x1a00, 1, "Statusword"), (0x6041, 0, "Statusword")][..], "statusword", &[status][..]),
            (
                &[(0x1600, 2, "Target torque"), (0x6071, 0, "Target torque")],
                "target-torque",
                &[Address::new(0x6071, 0)],
            ),
            // The object has another name, or is not in the sheet at all.
            (&[(0x1a00, 1, "Statusword"), (0x6041, 0, "Drive status")], "statusword", &[status]),
            (&[(0x1a00, 1, "Statusword")], "statusword", &[status]),
            (&[(0x1003, 1, "Error code"), (0x603f, 0, "Error code")], "error code", &[code]),
            // Objects of the vendor beside their entries in a mapping.
            (
                &[(0x1a01, 3, "Motor current"), (0x2031, 0, "Motor current")],
                "motor-current",
                &[Address::new(0x2031, 0)],
            ),
            (&[(0x1a01, 3, "Gap")], "gap", &[Address::new(0x1a01, 3)]),
            (&[(0x2041, 0, "status_word"), (0x6041, 0, "Statusword")], "statusword", &[status]),
            // Names that differ by case and blanks alone: by their spelling, or both.
            (&[(0x2000, 0, "Gain P"), (0x2001, 0, "GainP")], "GainP", &[Address::new(0x2001, 0)]),
            (&[(0x2000, 0, "Gain P"), (0x2001, 0, "GainP")], "Gain P", &[Address::new(0x2000, 0)]),
            (
                &[(0x2000, 0, "Gain P"), (0x2001, 0, "GainP")],
                "gain-p",
                &[Address::new(0x2000, 0), Address::new(0x2001, 0)],
            ),
        ] {
            assert_eq!(named(name, Some(&sheet(objects))), meant, "{objects:?} {name}");
        }
    }
}
