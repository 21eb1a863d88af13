//! Holds `src` to the layer rule of `docs/ARCHITECTURE.md`: who may name whom.
//!
//! The test walks the module tree from `lib.rs` and `main.rs`, takes every path in code (not only in `use` lines)
//! and asks the table below. Code that exists only for tests may name any layer, but not every foreign crate.

#[path = "layers/scan.rs"]
mod scan;
#[path = "layers/tokens.rs"]
mod tokens;

use scan::{Child, Scan, check};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The rule as people read it. When this block and the one in the document differ, one of them is out of date.
const RULE: &str = "\
quantity, setvalued  <-  sensing, fixture, linkage, control (never one another)  <-  guard  <-  cycle  <-  bus  <-  assembly  <-  run  <-  rig  <-  study, soak (not one another)  <-  cli
drives, canopen      <-  bus, run, sim; guard and cycle may name the states of `drives::cia402`
ethercat             EtherCAT codecs and engines: names objects and time; named by bus, explanation, sim, rig, live, service
time, objects        the clock; dictionary, values and abort codes of any bus: objects names time; named by canopen and whatever names canopen
plain_can            names canopen and sensing; named by bus, assembly, sim, rig
assembly             from config to the parts below run; names nothing simulated
run                  the loop: names assembly, link, record and what they name; never rig, sim, host, cli
sim                  may name drives, canopen, linkage, sensing, setvalued, quantity; never cycle, guard, control, fixture
explanation          faults and codes in words: names config, guard, canopen, ethercat, objects, drives; named by report, host, cli
link                 names canopen and ethercat; named by run, rig, host, live, service, cli
host                 the computer, and a rig on its interfaces: names run and what run names; named by cli
analysis             what can be said of a rig before it runs: names rig and what rig names; named by study, cli
report               what a run shows: names rig and what rig names; named by study, cli
live                 simulated devices on a link: names link, rig and what rig names; named by cli
service              devices asked one by one when no rig runs: names link, bus, canopen, ethercat, objects, drives; named by cli
config               names the parameter types of the layers below cycle; named by bus, assembly, run, sim, rig, host, study, soak, record, cli
identification       what a joint, an arm or a force sensor is, from what was measured: names elementary, linkage, quantity; named by run, cli
elementary           names nothing; named by all
batch                names nothing; named by study, soak, cli
record               names what enters and leaves a cycle: cycle, guard, sensing, quantity, the states of `drives::cia402`; named by run, rig, study, soak, cli
figures              drawn traces: names record and elementary; named as `record::figure` by report, study, cli
";

/// All layers. `drives` is not among them: it is a package of its own, `yieldwall_drives`.
const LAYERS: [&str; 34] = [
    "analysis",
    "batch",
    "elementary",
    "identification",
    "quantity",
    "setvalued",
    "sensing",
    "fixture",
    "linkage",
    "control",
    "guard",
    "cycle",
    "time",
    "objects",
    "canopen",
    "ethercat",
    "plain_can",
    "bus",
    "explanation",
    "link",
    "config",
    "sim",
    "record",
    "figures",
    "report",
    "assembly",
    "run",
    "host",
    "rig",
    "live",
    "service",
    "study",
    "soak",
    "cli",
];

/// The layers that a layer may name beside itself; `None` for what is not a layer.
fn may_name(layer: &str) -> Option<Vec<&'static str>> {
    let base = vec!["quantity", "setvalued", "elementary"];
    let stages = [&base[..], &["sensing", "fixture", "linkage", "control"]].concat();
    let engines = ["drives", "time", "objects", "canopen"];
    let states = ["drives::cia402"];
    let bus = || [&stages[..], &["guard", "cycle", "plain_can", "ethercat"], &engines, &["config"]].concat();
    let run = vec!["assembly", "bus", "link", "record"];
    Some(match layer {
        "elementary" | "time" | "quantity" | "setvalued" | "batch" => vec![],
        "identification" => vec!["elementary", "linkage", "quantity"],
        "objects" => vec!["time"],
        "canopen" | "ethercat" => vec!["time", "objects"],
        "sensing" | "fixture" | "linkage" | "control" => base,
        "guard" => [&stages[..], &states].concat(),
        "cycle" => [&stages[..], &states, &["guard"]].concat(),
        "plain_can" => vec!["time", "canopen", "sensing"],
        "bus" => bus(),
        "explanation" => [&engines[..], &["ethercat", "guard", "config"]].concat(),
        "link" => vec!["time", "canopen", "ethercat"],
        "config" => [&stages[..], &engines, &["guard"]].concat(),
        "sim" => [&base[..], &engines, &["ethercat", "plain_can", "sensing", "linkage", "config"]].concat(),
        "figures" => vec!["elementary", "record"],
        "record" => [&["elementary", "quantity", "config", "sensing", "guard", "cycle"], &states[..]].concat(),
        "assembly" => [bus(), vec!["bus"]].concat(),
        "run" => [bus(), run, vec!["identification"]].concat(),
        "host" => [bus(), run, vec!["run", "explanation"]].concat(),
        "rig" => [bus(), run, vec!["run", "sim", "ethercat"]].concat(),
        "analysis" => [bus(), run, vec!["run", "sim", "rig"]].concat(),
        "report" => [bus(), run, vec!["run", "explanation", "sim", "rig"]].concat(),
        "service" => [&engines[..], &["bus", "ethercat", "link"]].concat(),
        "live" => [bus(), run, vec!["run", "sim", "rig", "ethercat"]].concat(),
        "soak" => [bus(), run, vec!["run", "batch", "sim", "rig"]].concat(),
        "study" => [bus(), run, vec!["run", "batch", "sim", "rig", "analysis", "report"]].concat(),
        "cli" => {
            let above = [
                "analysis",
                "batch",
                "explanation",
                "ethercat",
                "run",
                "identification",
                "host",
                "sim",
                "live",
                "report",
                "rig",
                "service",
                "study",
                "soak",
            ];
            [bus(), run, above.to_vec()].concat()
        }
        _ => return None,
    })
}

/// Foreign crates that only some places may name, tests included.
const ONLY_IN: [(&str, &[&str]); 13] = [
    ("libm", &["elementary"]),
    ("clap", &["cli", "main"]),
    ("miette", &["cli", "main"]),
    ("ratatui", &["cli::tui"]),
    ("granit_parser", &["config::yaml"]),
    ("serde_saphyr", &["config::yaml"]),
    ("kuva", &["figures", "study::chart"]),
    ("canopen_rs", &["canopen"]),
    ("mcap", &["record::recording"]),
    ("rtrb", &["record::recording"]),
    ("socketcan", &["link::linux"]),
    ("neli", &["link::linux"]),
    ("libc", &["link::linux", "link::ethernet", "link::hold", "host::system"]),
];

#[test]
fn layers_name_only_what_lies_below_them() {
    let source = source_folder();
    let mut walk = Walk::default();
    for (root, name) in [
        ("motion/lib.rs", "lib"),
        ("fieldbus/lib.rs", "lib"),
        ("config/lib.rs", "config"),
        ("link/lib.rs", "link"),
        ("record/lib.rs", "record"),
        ("figures/lib.rs", "figures"),
        ("lib.rs", "lib"),
        ("program/main.rs", "main"),
    ] {
        walk.file(&source, &source.join(root), &[name.to_owned()], false);
    }
    // A script of the build is no module.
    walk.files.insert(source.join("program/build.rs"));
    assert!(walk.violations.is_empty(), "the layer rule is broken:\n{}", walk.violations.join("\n"));
    for layer in LAYERS {
        assert!(walk.layers.contains(layer), "{layer} is in the table but not in src");
    }
    let unread: Vec<_> = rust_files(&source).into_iter().filter(|file| !walk.files.contains(file)).collect();
    assert!(unread.is_empty(), "no module declares {unread:?}: not compiled, or a declaration that this test misses");
}

/// A wall clock that jumps changes nothing, since nobody looks at it.
#[test]
fn no_layer_below_the_command_line_reads_a_clock() {
    let source = source_folder();
    for file in rust_files(&source).iter().filter(|file| !file.starts_with(source.join("cli"))) {
        let text = std::fs::read_to_string(file).unwrap();
        for clock in ["SystemTime", "Instant::now"] {
            assert!(!text.contains(clock), "{} reads {clock}", file.display());
        }
    }
}

/// What is the same on every bus knows none.
#[test]
fn axes_know_no_bus() {
    let text = std::fs::read_to_string(source_folder().join("bus/axis.rs")).unwrap();
    for bus in ["canopen", "Frame", "can::", "NodeId"] {
        assert!(!text.contains(bus), "src/bus/axis.rs names {bus}");
    }
}

#[test]
fn the_document_states_the_same_rule() {
    let document = std::fs::read_to_string(source_folder().join("../docs/ARCHITECTURE.md")).unwrap();
    assert!(document.contains(&format!("```text\n{RULE}```\n")), "docs/ARCHITECTURE.md states another layer rule");
}

#[test]
fn the_checker_finds_each_kind_of_violation() {
    let found = |module: &str, source: &str| check(module, source).0;
    let named = |module, source| found(module, source).join("; ");
    assert_eq!(named("fixture::proxy", "\nuse crate::control::Pid;"), "line 2: fixture names control");
    assert_eq!(named("guard", "use crate::{quantity::Force, bus, guard::Gate};"), "line 1: guard names bus");
    assert_eq!(named("sim::arm", "fn f() { let x = crate::cycle::step(); }"), "line 1: sim names cycle");
    assert_eq!(named("sim::arm::rigid", "use super::super::super::guard::Gate;"), "line 1: sim names guard");
    assert_eq!(named("sim::arm", "mod inner { use super::super::super::guard; }"), "line 1: sim names guard");
    assert_eq!(named("record", "use super::{rig as r};"), "line 1: record names rig");
    assert_eq!(named("cycle", "use crate::{self as all, fixture};"), "line 1: cycle names the whole crate");
    assert_eq!(named("cycle", "use crate::*;"), "line 1: cycle names the whole crate");
    assert_eq!(named("cycle", "macro_rules! m { () => { $crate::bus::Master } }"), "line 1: cycle names bus");
    assert_eq!(named("linkage", "use yieldwall_drives::scaling;"), "line 1: linkage names drives");
    assert_eq!(named("cycle", "use yieldwall_drives::{cia402, scaling};"), "line 1: cycle names drives");
    assert_eq!(named("bus", "use canopen_rs::sdo;"), "line 1: bus names the crate canopen_rs");
    assert_eq!(named("study", "use kuva as plots;"), "line 1: study names the crate kuva");
    assert_eq!(named("study", "#[derive(clap::Args)] struct A;"), "line 1: study names the crate clap");
    assert_eq!(named("config", "pub use ::serde_saphyr::Error;"), "line 1: config names the crate serde_saphyr");
    assert_eq!(named("rig", "#[cfg(test)] mod tests { use kuva::Color; }"), "line 1: rig names the crate kuva");
    assert_eq!(named("sensing", "#[cfg(any(test, unix))] use crate::bus;"), "line 1: sensing names bus");
    assert_eq!(named("sensing", "#[cfg(test)] use crate::bus; use crate::rig;"), "line 1: sensing names rig");
    assert_eq!(named("oracle", "use crate::bus;"), "line 1: oracle is not a layer of the table");
}

#[test]
fn the_checker_lets_the_rest_pass() {
    for (module, source) in [
        ("fixture", "// use crate::control;\n/* crate::bus /* nested */ crate::rig */ use crate::quantity;"),
        ("fixture", r##"const A: &str = "crate::control \" crate::bus"; const B: &str = r#"crate::"bus"#;"##),
        ("fixture", "fn f<'a>(x: &'a str, c: char) -> bool { c == 'a' || c == '\\'' } use crate::fixture::Proxy;"),
        ("fixture::proxy", "use super::surface::Surface; use self::inner::X; use super::super::quantity::Force;"),
        ("fixture", "#[cfg(test)] mod tests { use crate::control::Pid; fn f() {} }"),
        ("fixture", "#[cfg(all(test, unix))] #[allow(dead_code)] fn f(a: [u8; 2]) -> u8 { crate::bus::g() }"),
        ("fixture", "struct A { #[cfg(test)] probe: crate::bus::Probe, b: u8 }"),
        ("canopen::sdo", "use canopen_rs::sdo; use std::fmt;"),
        ("figures::page", "use kuva::render::Scene;"),
        ("config::yaml", "use serde_saphyr::from_str;"),
        ("cycle", "use yieldwall_drives::cia402; use yieldwall_drives::cia402::State;"),
        ("main", "use yieldwall::cli; use miette::Result;"),
        ("sim::can", "let kuva = 1; let y = kuva + x.clap();"),
    ] {
        assert_eq!(check(module, source).0, Vec::<String>::new(), "{source}");
    }
}

#[test]
fn the_checker_knows_which_modules_are_tests() {
    let source = "mod a; #[cfg(test)] mod b; #[cfg(test)] #[path = \"c_tests.rs\"] mod c; pub mod d { mod e; }";
    let children = check("sim", source).1;
    let seen: Vec<_> = children.iter().map(|child| (child.name.as_str(), child.is_test)).collect();
    assert_eq!(seen, [("a", false), ("b", true), ("c", true), ("d::e", false)]);
    assert_eq!(children[2].path.as_deref(), Some("c_tests.rs"));
}

/// What was seen on the way through the module tree.
#[derive(Default)]
struct Walk {
    files: BTreeSet<PathBuf>,
    layers: BTreeSet<String>,
    violations: Vec<String>,
}

impl Walk {
    fn file(&mut self, source: &Path, file: &Path, module: &[String], is_test: bool) {
        let text = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        self.files.insert(file.to_path_buf());
        self.layers.insert(module[0].clone());
        let mut scan = Scan::new(&text, module, is_test);
        scan.items();
        let shown = file.strip_prefix(source).unwrap_or(file).display();
        self.violations.extend(scan.violations.iter().map(|violation| format!("src/{shown}, {violation}")));
        let is_folder = ["mod.rs", "lib.rs", "main.rs"].iter().any(|name| file.ends_with(name));
        let folder = if is_folder { file.parent().unwrap().to_path_buf() } else { file.with_extension("") };
        for Child { name, path, is_test: is_test_child } in scan.children {
            let names: Vec<String> = name.split("::").map(str::to_owned).collect();
            let child = match path {
                Some(path) => file.parent().unwrap().join(path),
                None => {
                    let stem = names.iter().fold(folder.clone(), |folder, name| folder.join(name));
                    if stem.is_dir() && stem.join("mod.rs").is_file() {
                        stem.join("mod.rs")
                    } else {
                        stem.with_extension("rs")
                    }
                }
            };
            let is_root = matches!(module, [one] if one == "lib" || one == "main");
            let parent = if is_root { &[] } else { module };
            self.file(source, &child, &[parent, &names].concat(), is_test || is_test_child);
        }
    }
}

fn source_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../src")
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files
}
