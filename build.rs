//! Tells the program what has built it: results of studies name the compiler.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let version = Command::new(rustc).arg("--version").output();
    let version = version.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned()).unwrap_or_default();
    println!("cargo::rustc-env=YIELDWALL_RUSTC={version}");
    println!("cargo::rustc-env=YIELDWALL_OPT_LEVEL={}", std::env::var("OPT_LEVEL").unwrap_or_default());
}
