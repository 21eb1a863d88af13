//! Rules over the text of `src` that no manifest of a package can state.

use std::path::{Path, PathBuf};

/// A wall clock that jumps changes nothing, since nobody looks at it.
#[test]
fn no_package_below_the_command_line_reads_a_clock() {
    let source = source_folder();
    for file in rust_files(&source).iter().filter(|file| !file.starts_with(source.join("cli"))) {
        let text = std::fs::read_to_string(file).unwrap();
        for clock in ["SystemTime", "Instant::now"] {
            assert!(!text.contains(clock), "{} reads {clock}", file.display());
        }
    }
}

/// An axis is the same on every bus.
#[test]
fn axes_know_no_bus() {
    let text = std::fs::read_to_string(source_folder().join("bus/axis.rs")).unwrap();
    for bus in ["canopen", "Frame", "can::", "NodeId"] {
        assert!(!text.contains(bus), "src/bus/axis.rs names {bus}");
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
