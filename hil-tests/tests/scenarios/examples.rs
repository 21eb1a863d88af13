//! Holds `examples` to what is promised of it: `cargo test` runs every example, and the front page names it.
//!
//! Each example has its test in its own file, where `test = true` of the manifest lets `cargo test` run it.

use std::path::Path;

fn text(path: impl AsRef<Path>) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The names of the examples, by their files.
fn names() -> Vec<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples");
    let files = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let names = files.map(|path| path.file_stem().and_then(|stem| stem.to_str()).expect("a plain name").to_owned());
    names.collect()
}

#[test]
fn every_example_is_run_as_a_test() {
    let manifest = text("Cargo.toml");
    let entries: Vec<&str> = manifest.split("\n[").filter(|entry| entry.starts_with("[example]]")).collect();
    let names = names();
    assert!(names.len() >= 6, "{names:?}");
    for name in names {
        let entry = entries.iter().find(|entry| entry.contains(&format!("name = \"{name}\"\n")));
        let entry = entry.unwrap_or_else(|| panic!("{name} stands not in Cargo.toml"));
        assert!(entry.contains("test = true\n") && entry.contains("required-features = ["), "{entry}");
        let source = text(format!("examples/{name}.rs"));
        assert!(source.contains("#[test]\n") && source.contains("assert"), "{name} tests nothing");
        assert!(source.contains(&format!("--example {name}")), "{name} does not say how it is run");
    }
}

#[test]
fn the_front_page_names_every_example() {
    let page = text("README.md");
    for name in names() {
        assert!(page.contains(&format!("(examples/{name}.rs)")), "README.md does not name {name}");
    }
}
