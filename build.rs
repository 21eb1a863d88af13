//! Tells the program what has built it: results of studies name the compiler, recordings commit and processor.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let rustc = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    set("RUSTC", &output(&rustc, &["--version"]));
    let of_cargo = |name| std::env::var(name).unwrap_or_default();
    set("OPT_LEVEL", &of_cargo("OPT_LEVEL"));
    set("TARGET", &of_cargo("TARGET"));
    // Other builds would be made anew after each commit.
    let is_release = of_cargo("PROFILE") == "release";
    set("COMMIT", &if is_release { commit() } else { String::new() });
}

/// The commit of the working tree, with `-dirty` if it was changed since; empty where that is not known.
fn commit() -> String {
    for path in ["src", "drives", "Cargo.toml", "Cargo.lock"] {
        println!("cargo::rerun-if-changed={path}");
    }
    let log = output("git", &["rev-parse", "--git-path", "logs/HEAD"]);
    if !log.is_empty() {
        println!("cargo::rerun-if-changed={log}");
    }
    output("git", &["describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"])
}

fn set(name: &str, value: &str) {
    println!("cargo::rustc-env=YIELDWALL_{name}={value}");
}

/// What a command prints; nothing if it fails.
fn output(program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program).args(arguments).output().ok().filter(|output| output.status.success());
    output.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned()).unwrap_or_default()
}
