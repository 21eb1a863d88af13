//! The data sheets in `drives/data-sheets`, against what its index says of each.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use super::super::*;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data-sheets")
}

/// What the index has to say of a file, but for its description and the values that it names.
fn told(bytes: &[u8]) -> (String, Vec<String>) {
    match Eds::read(bytes) {
        Ok(Reading { eds, findings }) => {
            let level = |level| if level == Level::Error { "error" } else { "warning" };
            let each = findings.iter().map(|found| format!("{} {} {}", found.line, level(found.level), found.message));
            (format!("read {}", eds.entries().count()), each.collect())
        }
        Err(error) => ("refused".to_owned(), vec![error.to_string()]),
    }
}

/// A field of an entry as the index writes it.
fn field(entry: &Entry, field: &str) -> String {
    let value = |value: &Option<Value>| match value {
        None => "-".to_owned(),
        Some(Value::Integer(number)) => number.to_string(),
        Some(Value::OfNode(number)) => format!("$NODEID+0x{number:X}"),
        Some(Value::Real(number)) => format!("{number:?}"),
        Some(Value::Text(text)) => text.clone(),
        Some(Value::Bytes(bytes)) => format!("{bytes:02X?}"),
    };
    match field {
        "default" => value(&entry.default),
        "value" => value(&entry.value),
        "low" => value(&entry.low),
        "high" => value(&entry.high),
        "name" => entry.name.clone(),
        "type" => format!("{:04X}", entry.data_type),
        "access" => format!("{:?}", entry.access),
        "kept" => entry.is_kept_from_download.to_string(),
        _ => panic!("the index asks for {field}"),
    }
}

/// A file of the index: its name, what becomes of it, its findings, and values as address, field and text.
struct Case<'a> {
    name: &'a str,
    becomes: &'a str,
    findings: Vec<&'a str>,
    values: Vec<[&'a str; 3]>,
}

fn cases(index: &str) -> Vec<Case<'_>> {
    let mut cases: Vec<Case<'_>> = Vec::new();
    for line in index.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        match (line.strip_prefix("    "), cases.last_mut()) {
            (Some(detail), Some(case)) => match detail.strip_prefix("= ") {
                Some(value) => {
                    let mut parts = value.splitn(3, ' ');
                    let mut next = || parts.next().unwrap_or_else(|| panic!("{line}"));
                    case.values.push([next(), next(), next()]);
                }
                None => case.findings.push(detail),
            },
            _ => {
                let parts: Vec<&str> = line.split(" | ").collect();
                let &[name, becomes, _] = parts.as_slice() else { panic!("{line}") };
                cases.push(Case { name, becomes, findings: Vec::new(), values: Vec::new() });
            }
        }
    }
    cases
}

#[test]
fn each_file_is_read_or_refused_as_the_index_says() {
    let index = std::fs::read_to_string(folder().join("index.txt")).unwrap();
    let cases = cases(&index);
    assert!(cases.len() >= 30, "{}", cases.len());
    let in_folder: BTreeSet<String> = std::fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name != "index.txt")
        .collect();
    assert_eq!(in_folder, cases.iter().map(|case| case.name.to_owned()).collect());
    let mut wrong = String::new();
    for Case { name, becomes, findings, values } in &cases {
        let bytes = std::fs::read(folder().join(name)).unwrap();
        let (found, told) = told(&bytes);
        if (found.as_str(), &told.iter().map(String::as_str).collect::<Vec<_>>()) != (*becomes, findings) {
            let _ = writeln!(wrong, "{name} | {found} |\n    {}", told.join("\n    "));
        }
        for [at, of, wanted] in values {
            let (index, sub) = at.split_once(':').unwrap_or_else(|| panic!("{name}: {at}"));
            let at = (u16::from_str_radix(index, 16).unwrap(), u8::from_str_radix(sub, 16).unwrap());
            let eds = Eds::read(&bytes).unwrap().eds;
            let entry = eds.entry(at.0, at.1).unwrap_or_else(|| panic!("{name} has no {at:04X?}"));
            let found = field(entry, of);
            if found != *wanted {
                let _ = writeln!(wrong, "{name}: {at:04X?} {of} is {found}, and not {wanted}");
            }
        }
    }
    assert!(wrong.is_empty(), "\n{wrong}");
}

/// What is read of a file, and written, is read again as it was, without a finding but for what its objects say of themselves.
#[test]
fn each_file_that_is_read_is_written_and_read_again() {
    for case in cases(&std::fs::read_to_string(folder().join("index.txt")).unwrap()) {
        let Ok(Reading { eds, .. }) = Eds::read(&std::fs::read(folder().join(case.name)).unwrap()) else { continue };
        let node = Node { id: 5, name: "left".to_owned(), bit_rate_kbit_per_s: Some(500) };
        let again = Eds::read(eds.to_dcf(&node).as_bytes()).unwrap_or_else(|error| panic!("{}: {error}", case.name));
        assert_eq!(again.eds.node, Some(node), "{}", case.name);
        let without_lines = |eds: &Eds| -> Vec<(u16, u8, Entry)> {
            let each = |(index, sub, entry): (u16, u8, &Entry)| {
                // A name without the quotes that a comment would need stays a name.
                let name = entry.name.replace(" ;", ",");
                (index, sub, Entry { line: 0, name, ..entry.clone() })
            };
            eds.entries().map(each).collect()
        };
        assert_eq!(without_lines(&again.eds), without_lines(&eds), "{}", case.name);
    }
}
