//! `yieldwall`: parse the arguments, run the command, print a diagnostic, set the exit code.
fn main() {}
