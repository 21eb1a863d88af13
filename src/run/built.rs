//! Compiler, profile and target of this program.

/// The compiler and its version, as `rustc --version` prints them; empty if that was not to be had.
pub const RUSTC: &str = env!("YIELDWALL_RUSTC");
/// The level of optimisation.
pub const OPT_LEVEL: &str = env!("YIELDWALL_OPT_LEVEL");
/// The processor and system it is built for, as a target triple.
pub const TARGET: &str = env!("YIELDWALL_TARGET");
/// The profile of cargo, by its folder.
pub const PROFILE: &str = env!("YIELDWALL_PROFILE");
