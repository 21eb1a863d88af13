//! Data sheets as vendors write them, and any bytes.

mod corpus;

use super::*;
use proptest::prelude::*;

fn read(text: &str) -> Reading {
    Eds::read(text.as_bytes()).unwrap()
}

/// The oddities of a file, as lines and words.
fn odd(text: &str) -> Vec<(usize, Level, String)> {
    read(text).findings.into_iter().map(|finding| (finding.line, finding.level, finding.message)).collect()
}

const SMALL: &str = "\
[FileInfo]
EDSVersion=4.0
[DeviceInfo]
VendorName=\"A; vendor\"
VendorNumber=0x000000AB
ProductNumber=17
BaudRate_500=1
BaudRate_1000=1 ; the usual one
NrOfRXPDO=4
LSS_Supported=1
[DummyUsage]
Dummy0005=1
Dummy0006=0
[MandatoryObjects]
SupportedObjects=3
1=0x1000
2=0x1003
3=0x1018
[OptionalObjects]
1=0x1400
[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=RO
DefaultValue=0x00020192 ; a drive
PDOMapping=0
[1003]
ParameterName=Error history
ObjectType=8
DataType=7
AccessType=ro
CompactSubObj=3
[1003Name]
NrOfEntries=1
2=The one before
[1018]
ParameterName=Identity object
ObjectType=0x9
SubNumber=2
[1018sub0]
ParameterName=Number of entries
DataType=0x5
AccessType=const
DefaultValue=1
[1018SUB1]
ParameterName=Vendor ID
DataType=0x7
AccessType=ro
[1400]
ParameterName=RPDO 1
ObjectType=0x9
SubNumber=2
[1400sub0]
ParameterName=Highest sub-index
DataType=0x5
AccessType=ro
DefaultValue=2
[1400sub1]
ParameterName=COB-ID
DataType=0x0007
AccessType=rw
DefaultValue=$nodeid + 0x200
";

#[test]
fn a_data_sheet_is_read_with_comments_compact_arrays_and_node_ids() {
    let Reading { eds, findings } = read(SMALL);
    assert_eq!(findings, []);
    let device = &eds.device;
    assert_eq!(
        (device.vendor.as_str(), device.vendor_number, device.product_number),
        ("A; vendor", Some(0xab), Some(17))
    );
    assert_eq!((&device.bit_rates_kbit_per_s[..], device.rpdos, device.has_lss), (&[500, 1000][..], Some(4), true));
    assert_eq!(eds.dummies.iter().copied().collect::<Vec<_>>(), [5]);
    assert_eq!(eds.entry(0x1000, 0).unwrap().default, Some(Value::Integer(0x20192)));
    let history: Vec<&str> = eds.objects[&0x1003].entries.values().map(|entry| entry.name.as_str()).collect();
    assert_eq!(history, ["Number of entries", "Error history 1", "The one before", "Error history 3"]);
    assert_eq!(eds.entry(0x1400, 1).unwrap().default, Some(Value::OfNode(0x200)));
    assert_eq!(eds.named("vendor-id"), [(0x1018, 1)]);
    assert_eq!(eds.named("identity object.vendor id"), [(0x1018, 1)]);
    assert_eq!(eds.named("DEVICE TYPE"), [(0x1000, 0)]);
    assert_eq!(eds.named("--"), []);
    assert!(eds.entries().all(|(_, _, entry)| entry.access.is_readable()));
}

#[test]
fn each_oddity_is_told_with_its_line_and_the_rest_is_read() {
    let with = |more: &str| odd(&format!("{SMALL}{more}"));
    let last = SMALL.lines().count();
    let one = |more: &str, down: usize, level: Level, words: &str| {
        let found = with(more);
        let is_it = |(line, found, message): &(usize, Level, String)| {
            (*line, *found) == (last + down, level) && message.contains(words)
        };
        assert!(found.iter().any(is_it), "{more}: {found:?}");
    };
    one("what is this\n", 1, Level::Warning, "neither a section nor");
    one("[1000]\nParameterName=Again\n", 1, Level::Warning, "stands in line 21 already");
    one("[2000\nParameterName=x\nDataType=5\nAccessType=rw\n", 1, Level::Warning, "is not closed");
    one("[2000]\nParameterName=x\nDataType=5\nAccessType=rw\n", 1, Level::Warning, "is in no list");
    one("[2000]\nParameterName=x\nDataType=5\nDataType=6\nAccessType=rw\n", 4, Level::Warning, "stands in line");
    one("[2000]\nParameterName=x\nAccessType=rw\n", 1, Level::Error, "has no DataType");
    one("[2000]\nParameterName=x\nDataType=five\nAccessType=rw\n", 3, Level::Error, "is no data type");
    one("[2000]\nParameterName=x\nDataType=5\nAccessType=maybe\n", 4, Level::Warning, "is no access type");
    one("[2000]\nParameterName=x\nDataType=5\n", 1, Level::Warning, "has no AccessType");
    one(
        "[2000]\nParameterName=x\nDataType=5\nAccessType=rw\nDefaultValue=256\n",
        5,
        Level::Error,
        "has no place in 8 bits",
    );
    one("[2000]\nParameterName=x\nDataType=2\nAccessType=rw\nDefaultValue=0xF00\n", 5, Level::Error, "with a sign");
    one(
        "[2000]\nParameterName=x\nDataType=5\nAccessType=rw\nDefaultValue=1.5\n",
        5,
        Level::Error,
        "not a whole number",
    );
    one("[2000]\nParameterName=x\nDataType=8\nAccessType=rw\nDefaultValue=nan\n", 5, Level::Error, "no finite number");
    one("[2000]\nParameterName=x\nDataType=10\nAccessType=rw\nDefaultValue=abc\n", 5, Level::Error, "row of bytes");
    one(
        "[2000]\nDataType=5\nAccessType=rw\nLowLimit=1\nHighLimit=4\nDefaultValue=9\n",
        6,
        Level::Warning,
        "beyond the limits",
    );
    one("[2000]\nParameterName=x\nObjectType=0x44\nDataType=5\nAccessType=rw\n", 3, Level::Warning, "no object has");
    one(
        "[2000]\nParameterName=x\nObjectType=9\nSubNumber=7\n",
        4,
        Level::Warning,
        "says that it has 7 entries, and has 0",
    );
    one("[2000sub1]\nParameterName=x\nDataType=5\nAccessType=rw\n", 1, Level::Error, "belongs to no object");
    one("[1000sub1]\nParameterName=x\nDataType=5\nAccessType=rw\n", 1, Level::Warning, "one variable");
    one("[ManufacturerObjects]\n1=1000h\n", 2, Level::Warning, "without `0x`");
    one("[20010]\nParameterName=x\n", 1, Level::Warning, "is that of no object");
    one("[1003Value]\n9=5\n", 2, Level::Warning, "something for the sub-index 9");
    one("[2000]\nParameterName=x\nDataType=5\nAccessType=rw\nCompactSubObj=300\n", 5, Level::Warning, "at most 254");
    one("[2000]\nParameterName=x\nDataType=5\nAccessType=rw\nPDOMapping=yes\n", 5, Level::Warning, "is no number");
    one("[2000]\nDataType=5\nAccessType=rw\nLowLimit=9\nHighLimit=4\n", 4, Level::Error, "is above its HighLimit");
    one("[2000]\nParameterName=x\nDataType=5\nAccessType=rw\nDefaultValue=1A\n", 5, Level::Warning, "has no `0x`");
    one("[2000]\nParameterName=x\nDataType=1\nAccessType=rw\nDefaultValue=True\n", 5, Level::Warning, "is a word");
    one("[DeviceComissioning]\nNodeID=200\n", 2, Level::Warning, "from 1 to 127");
    one("[ManufacturerObjects]\n1=0x2000\n", 2, Level::Warning, "is listed, and has no section");
    one("[ManufacturerObjects]\n1=here\n", 2, Level::Warning, "is no index");
    let latin = [SMALL.as_bytes(), b"[2000]\nParameterName=Gr\xf6\xdfe\nDataType=5\nAccessType=rw\n"].concat();
    let Reading { eds, findings } = Eds::read(&latin).unwrap();
    assert_eq!(eds.entry(0x2000, 0).unwrap().name, "Größe");
    assert!(
        findings.iter().any(|finding| finding.line == last + 2 && finding.message.contains("not UTF-8")),
        "{findings:?}"
    );
}

#[test]
fn numbers_are_read_as_vendors_write_them() {
    let default = |data_type: &str, text: &str| {
        let more = format!("[2000]\nParameterName=x\nDataType={data_type}\nAccessType=rw\nDefaultValue={text}\n");
        read(&format!("{SMALL}{more}")).eds.entry(0x2000, 0).and_then(|entry| entry.default.clone())
    };
    for (data_type, text, number) in [
        ("0x0004", "-5", -5),
        ("0x0004", "0xFFFFFFFF", -1),
        ("4", "0x7fffffff", 0x7fff_ffff),
        ("0x1B", "0xFFFFFFFFFFFFFFFF", i128::from(u64::MAX)),
        ("7", "010", 8),
        ("7", "09", 9),
        ("7", "+3", 3),
        ("1", "1", 1),
    ] {
        assert_eq!(default(data_type, text), Some(Value::Integer(number)), "{text}");
    }
    for text in ["$NODEID+0x80", "0x80+$NodeID", " $nodeid + 128 "] {
        assert_eq!(default("7", text), Some(Value::OfNode(0x80)), "{text}");
    }
    assert_eq!(default("7", "$NODEID"), Some(Value::OfNode(0)));
    // What is not of the standard and can mean one thing alone.
    for text in ["NODEID+0x80", "$NODEID+80h", "0x80+nodeid"] {
        assert_eq!(default("7", text), Some(Value::OfNode(0x80)), "{text}");
    }
    for text in ["FFh", "FF", "0xFF;all", "00FFh"] {
        assert_eq!(default("7", text), Some(Value::Integer(255)), "{text}");
    }
    for text in ["$NODEID-1", "1+$NODEID+1", "--1", "0x", ""] {
        assert_eq!(default("7", text), None, "{text}");
    }
    assert_eq!(default("8", "1.5"), Some(Value::Real(1.5)));
    assert_eq!(default("8", "0x3FC00000"), Some(Value::Real(1.5)));
    for (text, wanted) in [("V1.2", "V1.2"), ("\"V1.2\"", "V1.2"), ("turn \"On\"", "turn \"On\"")] {
        assert_eq!(default("9", text), Some(Value::Text(wanted.to_owned())));
    }
    assert_eq!(default("10", "01 FF"), Some(Value::Bytes(vec![1, 255])));
}

#[test]
fn what_is_no_data_sheet_is_refused() {
    assert_eq!(Eds::read(b""), Err(EdsError::NoObject { line: 1 }));
    assert_eq!(Eds::read(b"rig:\n  name: mine\n"), Err(EdsError::NoObject { line: 2 }));
    assert_eq!(Eds::read(b"[1000]\nDataType=7\n\0\n"), Err(EdsError::NotText { line: 3 }));
    assert_eq!(Eds::read(&vec![b';'; MAX_BYTES + 1]), Err(EdsError::Large));
    let many: String = (0..500)
        .map(|at| format!("[{:04X}]\nParameterName=x\nDataType=5\nAccessType=rw\nCompactSubObj=254\n", 0x2000 + at))
        .collect();
    assert!(matches!(Eds::read(many.as_bytes()), Err(EdsError::Many { .. })));
}

#[test]
fn oddities_of_a_hostile_file_are_told_up_to_a_number() {
    let junk = format!("{SMALL}{}", "what is this\n".repeat(5 * MAX_FINDINGS));
    let findings = read(&junk).findings;
    assert_eq!(findings.len(), MAX_FINDINGS + 1);
    assert!(findings.last().unwrap().message.contains("more oddities than are shown"), "{:?}", findings.last());
}

#[test]
fn a_text_is_the_same_in_any_encoding_and_with_any_ends_of_lines() {
    let plain = read(SMALL).eds;
    let wide = |word: fn(u16) -> [u8; 2]| {
        let words = std::iter::once(0xfeff).chain(SMALL.encode_utf16());
        Eds::read(&words.flat_map(word).collect::<Vec<u8>>()).unwrap()
    };
    for Reading { eds, findings } in [wide(u16::to_le_bytes), wide(u16::to_be_bytes)] {
        assert_eq!(eds, plain);
        assert!(findings.len() == 1 && findings[0].message.contains("UTF-16"), "{findings:?}");
    }
    for end in ["\r\n", "\r"] {
        assert_eq!(read(&SMALL.replace('\n', end)), Reading { eds: plain.clone(), findings: Vec::new() });
    }
    assert_eq!(read(&format!("\u{feff}{SMALL}")), Reading { eds: plain, findings: Vec::new() });
}

/// A bus coupler with three kinds of modules, as CiA 306 describes them.
const MODULAR: &str = "
[SupportedModules]
NrOfEntries=3
[M1ModuleInfo]
ProductName=Eight inputs
OrderCode=DI8
[M1FixedObjects]
NrOfEntries=1
1=0x6005
[M1Fixed6005]
ParameterName=Interrupt enable
ObjectType=0x7
DataType=0x0001
AccessType=rw
DefaultValue=0
[M1SubExtends]
NrOfEntries=1
1=0x6000
[M1SubExt6000]
ParameterName=Read input
DataType=0x0005
AccessType=ro
PDOMapping=1
Count=1
ObjExtend=2
[M2ModuleInfo]
ProductName=Four inputs
[M2SubExtends]
NrOfEntries=1
1=0x6020
[M2SubExt6020]
ParameterName=Read nibble
DataType=0x0005
AccessType=ro
Count=0;4
[M3ModuleInfo]
ProductName=Nothing
";

#[test]
fn modules_that_are_plugged_in_bring_their_objects() {
    let Reading { eds, findings } = read(&format!("{SMALL}{MODULAR}"));
    assert_eq!(findings, []);
    let names: Vec<&str> = eds.modules.iter().map(|module| module.name.as_str()).collect();
    assert_eq!((names, eds.modules[0].order_code.as_str()), (vec!["Eight inputs", "Four inputs", "Nothing"], "DI8"));
    assert!(!eds.objects.contains_key(&0x6000) && !eds.objects.contains_key(&0x6005));

    let plugged = format!("{SMALL}{MODULAR}[ConnectedModules]\nNrOfEntries=7\n1=1\n2=1\n3=1\n4=2\n5=2\n6=2\n7=3\n");
    let Reading { eds, findings } = read(&plugged);
    assert_eq!(findings, []);
    assert_eq!(eds.connected, [1, 1, 1, 2, 2, 2, 3]);
    let subs = |index: u16| eds.objects[&index].entries.keys().copied().collect::<Vec<u8>>();
    // Two entries at an index, then the next one.
    assert_eq!((subs(0x6000), subs(0x6001)), (vec![0, 1, 2], vec![0, 1]));
    assert_eq!(eds.entry(0x6000, 0).unwrap().default, Some(Value::Integer(2)));
    assert_eq!(eds.entry(0x6001, 1).unwrap().name, "Read input 1");
    assert!(eds.entry(0x6000, 1).unwrap().is_mappable);
    // Three times four bits are two bytes.
    assert_eq!(subs(0x6020), [0, 1, 2]);
    assert_eq!(eds.entry(0x6005, 0).unwrap().default, Some(Value::Integer(0)));
    // What the file has by itself stays.
    let own = "[6000]\nParameterName=Own\nDataType=5\nAccessType=ro\n[OptionalObjects2]\n";
    let found = read(&format!("{plugged}{own}"));
    assert_eq!(found.eds.objects[&0x6000].name, "Own");
    let wrong = odd(&format!("{SMALL}{MODULAR}[ConnectedModules]\n1=4\n2=x\n"));
    assert!(wrong.iter().any(|(.., message)| message.contains("module 4 is plugged in")), "{wrong:?}");
    assert!(wrong.iter().any(|(.., message)| message.contains("is no module in a slot")), "{wrong:?}");
}

#[test]
fn a_configuration_file_is_read_as_it_was_written() {
    let mut eds = read(SMALL).eds;
    let cob_id = eds.objects.get_mut(&0x1400).and_then(|object| object.entries.get_mut(&1)).unwrap();
    cob_id.value = Some(Value::Integer(0x8000_0201));
    let node = Node { id: 17, name: "left drive".to_owned(), bit_rate_kbit_per_s: Some(1000) };
    let Reading { eds: again, findings } = read(&eds.to_dcf(&node));
    assert_eq!(findings, []);
    assert_eq!(again.node, Some(node));
    assert_eq!((&again.device, &again.dummies), (&eds.device, &eds.dummies));
    assert_eq!(values(&again), values(&eds));
}

/// What a file says of its entries, without the lines.
fn values(eds: &Eds) -> Vec<(u16, u8, Entry)> {
    eds.entries().map(|(index, sub, entry)| (index, sub, Entry { line: 0, ..entry.clone() })).collect()
}

#[test]
fn a_concise_file_has_these_bytes() {
    let values: [(u16, u8, &[u8]); 2] = [(0x6040, 0, &[6, 0]), (0x1400, 1, &[1, 2, 0, 0x80])];
    let wanted = [2, 0, 0, 0, 0x40, 0x60, 0, 2, 0, 0, 0, 6, 0, 0x00, 0x14, 1, 4, 0, 0, 0, 1, 2, 0, 0x80];
    assert_eq!(concise(values), wanted);
    assert_eq!(read_concise(&wanted), Ok(values.to_vec()));
    assert!(is_concise(&wanted) && is_concise(&[0; 4]));
    // UTF-8, UTF-16 in both orders with and without a mark, and too few bytes.
    for text in [&b"[D]\n"[..], b"[\0D\0]\0", b"\0[\0D\0]", b"\xff\xfe[\0D\0", b"\xfe\xff\0[\0D", b"[D\0", b""] {
        assert!(!is_concise(text), "{text:?}");
    }
}

#[test]
fn a_concise_file_that_is_not_whole_is_refused_where_it_breaks_off() {
    let whole = [2, 0, 0, 0, 0x40, 0x60, 0, 2, 0, 0, 0, 6, 0, 0x00, 0x14, 1, 4, 0, 0, 0, 1, 2, 0, 0x80];
    let says = |bytes: &[u8]| read_concise(bytes).unwrap_err().to_string();
    assert_eq!(says(&whole[..3]), "byte 0: the file ends before the head of value 1 of 0");
    assert_eq!(says(&whole[..10]), "byte 4: the file ends before the head of value 1 of 2");
    assert_eq!(says(&whole[..13]), "byte 13: the file ends before the head of value 2 of 2");
    assert_eq!(says(&whole[..12]), "byte 11: 6040h:0 has 2 bytes by its head, and 1 are left");
    assert_eq!(says(&whole[..20]), "byte 20: 1400h:1 has 4 bytes by its head, and 0 are left");
    assert_eq!(
        says(&[&whole[..], &[0, 0, 0]].concat()),
        "byte 24: value 2, the last one, ends here, and 3 bytes follow"
    );
    assert_eq!(says(&[0xa1, 0x86, 1, 0]), "byte 0: the number of values is 100001, and at most 100000 are read");
    assert_eq!(says(&vec![0; MAX_BYTES + 1]), "is larger than 4194304 bytes");
    // A length of 4 GB takes no memory.
    let long = [1, 0, 0, 0, 0x40, 0x60, 0, 0xff, 0xff, 0xff, 0xff, 6];
    assert_eq!(says(&long), "byte 11: 6040h:0 has 4294967295 bytes by its head, and 1 are left");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn concise_values_are_read_as_they_were_written(
        values in prop::collection::vec((any::<u16>(), any::<u8>(), prop::collection::vec(any::<u8>(), 0..9)), 0..20),
    ) {
        let values: Vec<(u16, u8, &[u8])> = values.iter().map(|(index, sub, value)| (*index, *sub, &value[..])).collect();
        let bytes = concise(values.iter().copied());
        prop_assert!(is_concise(&bytes));
        prop_assert_eq!(read_concise(&bytes), Ok(values));
    }

    #[test]
    fn any_bytes_are_a_concise_file_that_is_written_alike_or_none(
        count in 0_u8..4, sizes in prop::collection::vec(0_u8..4, 0..4), noise in prop::collection::vec(any::<u8>(), 0..40),
    ) {
        // As if a count and lengths were there, since noise alone seldom has small ones.
        let mut bytes = vec![count, 0, 0, 0];
        for size in sizes {
            bytes.extend([noise.first().copied().unwrap_or(7), 0x60, 0, size, 0, 0, 0]);
            bytes.extend(&noise[..usize::from(size).min(noise.len())]);
        }
        for bytes in [&bytes[..], &noise] {
            if let Ok(values) = read_concise(bytes) {
                prop_assert_eq!(concise(values), bytes);
            }
        }
    }

    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        let _ = Eds::read(&bytes);
    }

    /// Files that begin like data sheets, with a line that is cut, doubled or changed. What is read is written and read again the same.
    #[test]
    fn damaged_data_sheets_are_read_or_refused(
        edits in prop::collection::vec((0..SMALL.len(), any::<u8>(), 0..3u8), 1..12),
    ) {
        let mut bytes = SMALL.as_bytes().to_vec();
        for (at, byte, what) in edits {
            let at = at % bytes.len().max(1);
            match what {
                0 => bytes[at] = byte,
                1 => bytes.truncate(at + 1),
                _ => bytes.insert(at, byte),
            }
        }
        if let Ok(Reading { eds, .. }) = Eds::read(&bytes) {
            let node = Node { id: 1, ..Node::default() };
            let again = read(&eds.to_dcf(&node)).eds;
            prop_assert_eq!(again.objects.len(), eds.objects.len());
        }
    }
}
