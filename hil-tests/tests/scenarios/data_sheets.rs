//! Electronic data sheets that others have written, read here and by python-canopen: the same entries, and the same from what is
//! written of them here.
//!
//! `hil-tests/run` fetches both and runs this; alone:
//! `YIELDWALL_DATA_SHEETS=$(hil-tests/peers/data_sheets) YIELDWALL_PYTHON=$(hil-tests/peers/install) cargo test -p hil-tests --test
//! scenarios data_sheets:: -- --ignored`

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value as Json;
use yieldwall_drives::eds::{Eds, Kind, Level, Node, Value};

/// The node that python-canopen reads them for.
const NODE: u8 = 5;

fn named(variable: &str) -> PathBuf {
    std::env::var_os(variable).map(PathBuf::from).unwrap_or_else(|| panic!("{variable} is not set"))
}

/// All data sheets in a folder and in those below it.
fn sheets(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut found: Vec<PathBuf> = entries
        .flat_map(|path| match path.is_dir() {
            true => sheets(&path),
            false if path.extension().is_some_and(|ending| ending == "eds") => vec![path],
            false => Vec::new(),
        })
        .collect();
    found.sort();
    found
}

/// What python-canopen reads in files.
fn of_python(paths: &[&Path]) -> Vec<BTreeMap<String, Json>> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/data_sheets.py");
    let seen = Command::new(named("YIELDWALL_PYTHON")).arg(script).args(paths).output().unwrap();
    assert!(seen.status.success(), "{}", String::from_utf8_lossy(&seen.stderr));
    serde_json::from_slice(&seen.stdout).unwrap()
}

/// A value as python-canopen has it.
fn json(value: &Value) -> Json {
    match value {
        Value::Integer(number) => Json::from(*number as i64),
        Value::OfNode(number) => Json::from(*number as i64 + i64::from(NODE)),
        Value::Real(number) => Json::from(*number),
        Value::Text(text) => Json::from(text.clone()),
        Value::Bytes(bytes) => Json::from(bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>()),
    }
}

#[test]
#[ignore = "needs python-canopen and its source: hil-tests/run fetches them"]
fn data_sheets_of_others_are_read_and_written_as_python_canopen_reads_them() {
    let paths = sheets(&named("YIELDWALL_DATA_SHEETS"));
    assert!(paths.len() >= 3, "{paths:?}");
    let folder = std::env::temp_dir().join(format!("yieldwall-data-sheets-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    for path in paths {
        let shown = path.display();
        let reading = Eds::read(&std::fs::read(&path).unwrap()).unwrap_or_else(|error| panic!("{shown}: {error}"));
        let mut eds = reading.eds;
        // What a vendor's own file has is left out nowhere.
        let lost: Vec<_> = reading.findings.iter().filter(|finding| finding.level == Level::Error).collect();
        println!("{shown}: {} entries, {} findings", eds.entries().count(), reading.findings.len());
        // Every entry that takes a whole number is set to one.
        let mut set = BTreeMap::new();
        for (index, object) in &mut eds.objects {
            for (sub, entry) in object.entries.iter_mut().filter(|(_, entry)| entry.access.is_writable()) {
                if matches!(entry.data_type, 2..=7) {
                    entry.value = Some(entry.high.clone().unwrap_or(Value::Integer(i128::from(*sub % 100))));
                    set.insert(format!("{index:04X}:{sub:02X}"), entry.value.as_ref().map(json).unwrap());
                }
            }
        }
        let written = folder.join("written.dcf");
        std::fs::write(&written, eds.to_dcf(&Node { id: NODE, ..Node::default() })).unwrap();
        let [theirs, ours] = of_python(&[&path, &written]).try_into().unwrap();
        let entries: BTreeMap<String, _> =
            eds.entries().map(|(index, sub, entry)| (format!("{index:04X}:{sub:02X}"), entry)).collect();
        for (key, expected) in &theirs {
            let index = u16::from_str_radix(&key[..4], 16).unwrap();
            // Of an object that stands for many entries python-canopen has a pattern alone, and a number of entries of its own.
            let is_pattern = theirs.keys().filter(|other| other.starts_with(&key[..4])).count()
                < eds.objects.get(&index).map_or(0, |object| object.entries.len())
                || (expected["name"] == "Number of entries"
                    && expected["access"] == "rw"
                    && expected["default"].is_null());
            let Some(found) = ours.get(key) else { panic!("{shown}: {key} is lost; {lost:?}") };
            if is_pattern {
                continue;
            }
            for field in ["name", "data_type", "access", "default", "low", "high"] {
                assert_eq!(found[field], expected[field], "{shown}: {key} {field}");
            }
            // A row of bytes is written in another way by each side; it is theirs from our file, above.
            let default = entries
                .get(key)
                .and_then(|entry| entry.default.as_ref())
                .filter(|value| matches!(value, Value::Integer(_) | Value::OfNode(_)));
            if let (Some(default), false) = (default, expected["default"].is_null()) {
                assert_eq!(json(default), expected["default"], "{shown}: {key}");
            }
        }
        assert!(!set.is_empty() || !shown.to_string().contains("e35"), "{shown}: nothing can be set");
        for (key, value) in set {
            assert_eq!(ours[&key]["value"], value, "{shown}: {key}");
        }
    }
    std::fs::remove_dir_all(folder).unwrap();
}

/// The odd files of `drives/data-sheets`: what is written of each is read by python-canopen as it is here.
#[test]
#[ignore = "needs python-canopen: hil-tests/run fetches it"]
fn what_is_written_of_odd_data_sheets_is_read_by_python_canopen_as_it_is_here() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../drives/data-sheets");
    let folder = std::env::temp_dir().join(format!("yieldwall-odd-sheets-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let mut written: Vec<(PathBuf, Eds)> = Vec::new();
    for entry in std::fs::read_dir(corpus).unwrap().map(Result::unwrap) {
        let Ok(reading) = Eds::read(&std::fs::read(entry.path()).unwrap()) else { continue };
        let mut eds = reading.eds;
        for entry in eds.objects.values_mut().flat_map(|object| object.entries.values_mut()) {
            if entry.access.is_writable() && matches!(entry.data_type, 2..=7) && entry.value.is_none() {
                entry.value = Some(Value::Integer(5));
            }
        }
        let path = folder.join(entry.file_name()).with_extension("dcf");
        std::fs::write(&path, eds.to_dcf(&Node { id: NODE, ..Node::default() })).unwrap();
        written.push((path, eds));
    }
    assert!(written.len() >= 30, "{}", written.len());
    let paths: Vec<&Path> = written.iter().map(|(path, _)| path.as_path()).collect();
    let mut compared = 0;
    for ((path, eds), theirs) in written.iter().zip(of_python(&paths)) {
        let shown = path.file_name().unwrap().to_string_lossy();
        // Types below 1000h are none of its objects.
        for (index, sub, entry) in eds.entries().filter(|(index, ..)| *index >= 0x1000) {
            let key = format!("{index:04X}:{sub:02X}");
            let Some(found) = theirs.get(&key) else { panic!("{shown}: {key} is lost") };
            assert_eq!(found["name"], named_as(eds, index, sub, &entry.name), "{shown}: {key}");
            // A type of the vendor's own it takes for a domain.
            if entry.data_type < 0x40 {
                assert_eq!(found["data_type"], entry.data_type, "{shown}: {key}");
            }
            let values =
                [("default", &entry.default), ("value", &entry.value), ("low", &entry.low), ("high", &entry.high)];
            for (field, value) in values {
                if let Some(value @ (Value::Integer(_) | Value::OfNode(_))) = value {
                    assert_eq!(found[field], json(value), "{shown}: {key} {field}");
                    compared += 1;
                }
            }
        }
    }
    assert!(compared > 400, "{compared}");
    std::fs::remove_dir_all(folder).unwrap();
}

/// The name that python-canopen gives an entry: of a variable, that of its object.
fn named_as<'a>(eds: &'a Eds, index: u16, sub: u8, own: &'a str) -> &'a str {
    let object = &eds.objects[&index];
    if sub == 0 && object.entries.len() == 1 && matches!(object.kind, Kind::Variable | Kind::Domain) {
        &object.name
    } else {
        own
    }
}
