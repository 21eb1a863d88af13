//! Passes to the program the commit that it is built from, for recordings and bug reports. The library does not know the commit, so
//! that a commit alone builds only this program anew.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // Debug builds would be linked anew after each commit.
    let is_release = std::env::var("PROFILE").is_ok_and(|profile| profile == "release");
    println!("cargo::rustc-env=YIELDWALL_COMMIT={}", if is_release { commit() } else { String::new() });
}

/// The commit of the working tree, with `-dirty` if it was changed since; empty where that is not known.
fn commit() -> String {
    // Cargo runs this again when one of them changes; one that is not there would make it run each time.
    let log = output(&["rev-parse", "--path-format=absolute", "--git-path", "logs/HEAD"]);
    let parts = ["../../src", "../../drives", "../../Cargo.toml", "../../Cargo.lock", &log];
    for path in parts.into_iter().filter(|path| !path.is_empty() && Path::new(path).exists()) {
        println!("cargo::rerun-if-changed={path}");
    }
    output(&["describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"])
}

/// Output of a git command; empty if it fails.
fn output(arguments: &[&str]) -> String {
    let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success());
    output.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned()).unwrap_or_default()
}
