//! Decoders and engines keep their promises whatever bytes they are given.
//!
//! One table, [`TARGETS`], for these tests and for the fuzzer in `hil-tests/fuzz`. A failure prints the input in
//! hexadecimal and the command that runs it again.

use std::collections::BTreeSet;
use std::path::Path;

use hil_tests::arbitrary::{TARGETS, Target};
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::{Config, TestError, TestRunner};

/// Longest random input in bytes.
const LONGEST: usize = 1200;
/// Random inputs per target, and altered ones.
const CASES: u32 = 1500;
/// Inputs that broke a law once: a name and the bytes in hexadecimal per line.
const ONCE_BROKEN: &str = include_str!("arbitrary-inputs.txt");
/// Names one input to run, as `name:hexadecimal`.
const INPUT: &str = "ARBITRARY_INPUT";

/// One alteration of a seed.
#[derive(Clone, Debug)]
enum Change {
    Set(Index, u8),
    Flip(Index, u8),
    Insert(Index, Vec<u8>),
    Remove(Index, u8),
    Repeat(Index, u8),
    Move(Index, Index),
}

impl Change {
    fn any() -> impl Strategy<Value = Change> {
        let at = || any::<Index>();
        prop_oneof![
            (at(), any::<u8>()).prop_map(|(at, value)| Change::Set(at, value)),
            (at(), 0..8u8).prop_map(|(at, bit)| Change::Flip(at, bit)),
            (at(), prop::collection::vec(any::<u8>(), 1..16)).prop_map(|(at, bytes)| Change::Insert(at, bytes)),
            (at(), 1..16u8).prop_map(|(at, count)| Change::Remove(at, count)),
            (at(), 1..48u8).prop_map(|(at, count)| Change::Repeat(at, count)),
            (at(), at()).prop_map(|(from, to)| Change::Move(from, to)),
        ]
    }

    fn apply(&self, bytes: &mut Vec<u8>) {
        if bytes.is_empty() {
            bytes.push(0);
        }
        let size = bytes.len();
        let end = |at: usize, count: u8| (at + usize::from(count)).min(size);
        match self {
            Change::Set(at, value) => bytes[at.index(size)] = *value,
            Change::Flip(at, bit) => bytes[at.index(size)] ^= 1 << bit,
            Change::Insert(at, fresh) => drop(bytes.splice(at.index(size)..at.index(size), fresh.iter().copied())),
            Change::Remove(at, count) => drop(bytes.drain(at.index(size)..end(at.index(size), *count))),
            Change::Repeat(at, count) => {
                let at = at.index(size);
                let again = bytes[at..end(at, *count)].to_vec();
                drop(bytes.splice(at..at, again));
            }
            Change::Move(from, to) => bytes[to.index(size)] = bytes[from.index(size)],
        }
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn bytes_of(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).expect("hexadecimal")).collect()
}

fn target(name: &str) -> &'static Target {
    TARGETS.iter().find(|target| target.name == name).unwrap_or_else(|| panic!("there is no body named {name}"))
}

/// Runs a body on inputs of a strategy. A failure is shrunk, and says how to run it again.
fn hold(target: &Target, inputs: impl Strategy<Value = Vec<u8>>) -> Result<(), String> {
    let config = Config { cases: CASES, failure_persistence: None, max_shrink_iters: 20_000, ..Config::default() };
    let result = TestRunner::new(config).run(&inputs, |bytes| {
        (target.body)(&bytes);
        Ok(())
    });
    result.map_err(|error| match error {
        TestError::Fail(reason, bytes) => {
            let (name, hex) = (target.name, hex(&bytes));
            format!("{name}: {reason}\nagain: {INPUT}={name}:{hex} cargo test -p hil-tests --test scenarios known\n")
        }
        other => format!("{}: {other}\n", target.name),
    })
}

/// Runs every body, whatever becomes of the others.
fn hold_all(run: impl Fn(&Target) -> Result<(), String>) {
    let failures: Vec<String> = TARGETS.iter().filter_map(|target| run(target).err()).collect();
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
}

#[test]
fn random_bytes_break_no_law() {
    hold_all(|target| hold(target, prop::collection::vec(any::<u8>(), 0..LONGEST)));
}

#[test]
fn altered_conversations_break_no_law() {
    hold_all(|target| {
        let seeds = (target.seeds)();
        assert!(!seeds.is_empty(), "{} has no seed", target.name);
        let changes = prop::collection::vec(Change::any(), 1..24);
        let altered = (prop::sample::select(seeds), changes).prop_map(|(mut bytes, changes)| {
            changes.iter().for_each(|change| change.apply(&mut bytes));
            bytes
        });
        hold(target, altered)
    });
}

#[test]
fn known_inputs_break_no_law() {
    for target in TARGETS {
        (target.seeds)().iter().for_each(|seed| (target.body)(seed));
    }
    for line in ONCE_BROKEN.lines().filter(|line| !line.starts_with('#')) {
        let (name, hex) = line.split_once(' ').expect("a name and an input");
        (target(name).body)(&bytes_of(hex));
    }
    if let Ok(input) = std::env::var(INPUT) {
        let (name, hex) = input.split_once(':').expect("a name and an input");
        (target(name).body)(&bytes_of(hex));
    }
}

#[test]
fn the_fuzzer_has_every_body() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz");
    let names: BTreeSet<String> = TARGETS.iter().map(|target| target.name.to_owned()).collect();
    assert!(TARGETS.is_sorted_by_key(|target| target.name) && names.len() == TARGETS.len());
    let mut files = BTreeSet::new();
    for entry in std::fs::read_dir(folder.join("fuzz_targets")).expect("the folder of targets") {
        let path = entry.expect("an entry").path();
        let name = path.file_stem().and_then(|stem| stem.to_str()).expect("a name").to_owned();
        let expected =
            format!("#![no_main]\nlibfuzzer_sys::fuzz_target!(|bytes: &[u8]| hil_tests::arbitrary::{name}(bytes));\n");
        assert_eq!(std::fs::read_to_string(&path).expect("a text"), expected, "{}", path.display());
        files.insert(name);
    }
    assert_eq!(files, names, "hil-tests/fuzz/fuzz_targets");
    let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).expect("a manifest");
    let binaries: Vec<&str> = manifest.split("[[bin]]\n").skip(1).map(str::trim_end).collect();
    let expected: Vec<String> = names
        .iter()
        .map(|name| {
            format!("name = \"{name}\"\npath = \"fuzz_targets/{name}.rs\"\ntest = false\ndoc = false\nbench = false")
        })
        .collect();
    assert_eq!(binaries, expected, "hil-tests/fuzz/Cargo.toml");
}
