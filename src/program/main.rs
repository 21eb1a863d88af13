//! `yieldwall`: parse the arguments, run the command, print a diagnostic, set the exit code.

fn main() -> std::process::ExitCode {
    yieldwall_cli::main(env!("YIELDWALL_COMMIT"), std::env::args_os())
}
