//! Passes on how the program is built: studies name compiler and optimisation, recordings the processor, records of latency the profile.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let of_cargo = |name| std::env::var(name).unwrap_or_default();
    let version = Command::new(of_cargo("RUSTC")).arg("--version").output();
    let version = version.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned());
    set("RUSTC", &version.unwrap_or_default());
    set("OPT_LEVEL", &of_cargo("OPT_LEVEL"));
    set("TARGET", &of_cargo("TARGET"));
    // PROFILE is `debug` or `release`, whatever was derived from them; the folder is called as the profile is.
    let folder = of_cargo("OUT_DIR");
    let profile = Path::new(&folder).ancestors().nth(3).and_then(Path::file_name);
    set("PROFILE", &profile.map(|name| name.to_string_lossy().into_owned()).unwrap_or_default());
}

fn set(name: &str, value: &str) {
    println!("cargo::rustc-env=YIELDWALL_{name}={value}");
}
