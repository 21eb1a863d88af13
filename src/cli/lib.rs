//! The command-line program: one file per command.
//!
//! A command gets its arguments and an [`Output`], and returns nothing or a [`Failure`]. It prints results to standard
//! output only; findings and failures go to standard error, or with `--json` into the one document on standard output.

#[cfg(target_os = "linux")]
mod at_the_arm;
#[cfg(feature = "full")]
mod bug_report;
mod bus;
mod calibrate;
#[cfg(target_os = "linux")]
mod checkup;
mod clock;
mod commission;
mod compare;
mod config;
mod confirm;
mod desk;
#[cfg(target_os = "linux")]
mod doctor;
#[cfg(target_os = "linux")]
mod drill;
mod ending;
mod escaped;
mod events;
mod examples;
mod explain;
mod failure;
mod faults;
#[cfg(target_os = "linux")]
mod first_motion;
mod fit;
#[cfg(feature = "full")]
mod full;
#[cfg(not(feature = "full"))]
#[path = "lacking.rs"]
mod full;
mod home;
#[cfg(target_os = "linux")]
mod interfaces;
#[cfg(target_os = "linux")]
mod interrupt;
mod jog;
mod keep;
#[cfg(target_os = "linux")]
mod latency;
#[cfg(target_os = "linux")]
mod live;
#[cfg(feature = "full")]
mod manual;
mod margins;
mod masses;
mod new;
#[cfg(target_os = "linux")]
mod on_bus;
mod output;
mod overview;
#[cfg(target_os = "linux")]
mod pace;
mod page;
mod parts;
mod picture;
mod plot;
mod printable;
mod progress;
mod record;
mod rehearsal;
mod render;
mod replace;
mod replay;
mod report_text;
mod reproduce;
mod run;
#[cfg(target_os = "linux")]
mod sensor;
mod sim;
mod soak;
mod study;
mod sweep;
#[cfg(target_os = "linux")]
mod tui;
mod tune;
mod unsafe_drives;
mod usage;

use std::ffi::OsString;
use std::io::Write;
use std::process::ExitCode;
use std::sync::OnceLock;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

pub use failure::{Exit, Failure};
pub use output::Output;

/// Heading of the options that every command takes.
const GLOBAL: &str = "Global options";

/// Plasticity-based virtual fixtures on a five-bar rig.
#[derive(Debug, Parser)]
#[command(name = "yieldwall", version, after_help = failure::exit_codes(), arg_required_else_help = true)]
struct Arguments {
    /// Print only warnings and failures
    #[arg(long, short, global = true, help_heading = GLOBAL)]
    quiet: bool,
    /// Print progress on standard error, such as each step of the boot
    #[arg(long, short, global = true, help_heading = GLOBAL, conflicts_with = "quiet")]
    verbose: bool,
    /// Print one JSON document on standard output instead of text
    #[arg(long, global = true, help_heading = GLOBAL)]
    json: bool,
    /// Treat warnings of a configuration as errors
    #[arg(long, global = true, help_heading = GLOBAL)]
    deny_warnings: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Create a rig with its simulation and scene, from flags or a few questions
    New(new::Arguments),
    /// Run a rig with its scene, on the embedded simulation or on a real bus
    Run(run::Arguments),
    /// Simulate drives, sensor, arm and hand on a real bus
    #[cfg(target_os = "linux")]
    Sim(sim::Arguments),
    /// Test on a bus that drives stop if the master falls silent, for `run --bus`
    #[cfg(target_os = "linux")]
    Drill(drill::Arguments),
    /// Move one joint slowly by an angle, at low torque, while the other one holds
    Jog(jog::Arguments),
    /// Find the references of incremental encoders, one joint at a time
    Home(home::Arguments),
    /// Calibrate link lengths and encoder zeros from hand-guided points
    #[command(subcommand)]
    Calibrate(calibrate::Command),
    /// Show force-sensor readings, check the sensor's zero, or calibrate the sensor
    #[command(subcommand)]
    Sensor(sensor::Command),
    /// Commission a rig step by step and write a report
    Commission(commission::Arguments),
    /// Measure this computer's wake-up latency, and the round-trip time on a bus
    #[cfg(target_os = "linux")]
    Latency(latency::Arguments),
    /// Diagnose a computer, interface or node, and print the command that fixes it
    #[cfg(target_os = "linux")]
    Doctor(doctor::Arguments),
    /// Find the devices on a bus, with identity and matching entry of the rig
    Scan(desk::scan::Arguments),
    /// Show the identity and condition of a device
    Info(desk::info::Arguments),
    /// Read, write, dump, compare and restore the objects of a device
    #[command(subcommand)]
    Od(desk::od::Command),
    /// Write profiles of drives
    #[command(subcommand)]
    Drive(desk::adopt::Command),
    /// Show the process data of a device
    #[command(subcommand)]
    Pdo(desk::pdo::Command),
    /// Start, stop and reset devices by network management (NMT)
    Nmt(desk::nmt::Arguments),
    /// Explain the errors that devices have stored
    Emcy(desk::emcy::Arguments),
    /// Show a device's state, reset a drive's fault, or change an EtherCAT state
    State(desk::state::Arguments),
    /// Set the node ids of devices that have none, or a wrong one
    #[command(subcommand)]
    Lss(desk::lss::Command),
    /// Show the distributed clocks of devices on EtherCAT
    Dc(desk::dc::Arguments),
    /// Show the port error counters of EtherCAT devices, and what to check
    Errors(desk::errors::Arguments),
    /// Read, write and check the memory chips (SII) of EtherCAT devices
    #[command(subcommand)]
    Sii(desk::sii::Command),
    /// Show or set the alias of an EtherCAT device
    Alias(desk::alias::Arguments),
    /// Read and write the registers of an EtherCAT device
    #[command(subcommand)]
    Reg(desk::reg::Command),
    /// Decode the frames on a bus, one by one, without sending
    Monitor(desk::monitor::Arguments),
    /// List the faults that can be injected, with their effects and consequences
    Faults(faults::Arguments),
    /// Explain a fault, an error code, an SDO abort code or a statusword
    Explain(explain::Arguments),
    /// Run the paper's experiments and draw its figures
    Reproduce(reproduce::Arguments),
    /// Recompute the cycles of a recording, and compare them bit by bit
    Replay(replay::Arguments),
    /// Draw the trajectory, force and power of a recording
    Plot(plot::Arguments),
    /// Show recordings in the browser: play, jump to faults and impacts, overlay
    View(page::Arguments),
    /// Push a simulated tool by mouse in the browser: yielding wall beside a spring
    Play(page::PlayArguments),
    /// Compare runs and recordings: measures, curves, and configurations
    Compare(compare::Arguments),
    /// Inspect, repair and export recordings
    #[command(subcommand)]
    Record(record::Command),
    /// Run rigs, hands and faults drawn from seeds, and judge every cycle
    Soak(soak::Arguments),
    /// Compute tables and charts of speed, accuracy and stability
    Study(study::Arguments),
    /// Run a rig with every combination of given values; write a table and a chart
    Sweep(sweep::Arguments),
    /// Compute the timing of a rig's bus
    #[command(subcommand)]
    Bus(bus::Command),
    /// Compute stable fixture parameters and gains of a rig, with a reserve
    #[command(subcommand)]
    Tune(tune::Command),
    /// Collect a bug report in one zip, without names of users and computers
    Report(full::Report),
    /// Check, show and describe configuration files
    #[command(subcommand)]
    Config(config::Command),
    /// Print completions for a shell: `source <(yieldwall completions bash)`
    Completions(full::Completions),
    /// Print the manual page, or write the pages of all commands
    Man(full::Man),
}

impl Command {
    /// Whether events are wanted as a stream of objects.
    fn streams(&self) -> bool {
        match self {
            Self::Run(arguments) => arguments.stream.jsonl,
            #[cfg(target_os = "linux")]
            Self::Drill(arguments) => arguments.stream.jsonl,
            #[cfg(target_os = "linux")]
            Self::Latency(arguments) => arguments.stream.jsonl,
            _ => false,
        }
    }
}

/// Commit from which the program was built, as the program reports it.
static COMMIT: OnceLock<&'static str> = OnceLock::new();

fn commit() -> &'static str {
    COMMIT.get().copied().unwrap_or_default()
}

/// Runs the program with these arguments, the first of which is its name. `commit` is the commit of the build, empty if it is not
/// known.
pub fn main(commit: &'static str, arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    COMMIT.get_or_init(|| commit);
    run(arguments).into()
}

fn run(arguments: impl IntoIterator<Item = OsString>) -> Exit {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let wants_json = arguments
        .iter()
        .take_while(|argument| *argument != "--")
        .any(|argument| argument == "--json" || argument == "--jsonl");
    let parsed =
        overview::program().try_get_matches_from(&arguments).and_then(|found| Arguments::from_arg_matches(&found));
    let arguments = match parsed.map_err(|error| usage::with_tip(error, &Arguments::command(), &arguments)) {
        Ok(arguments) => arguments,
        Err(error) if error.use_stderr() && wants_json => {
            let text = error.to_string();
            let (message, help) = text.trim().split_once("\n\n").unwrap_or((text.trim(), ""));
            let failure = Failure::new(Exit::Usage, message.trim_start_matches("error: "), help);
            Output::new(false, true, false).failure(&failure);
            return failure.exit;
        }
        Err(error) => {
            // Help and version are no errors, and a reader that has gone away needs no message.
            let _ = if error.use_stderr() { refusal(&error) } else { error.print() };
            return if error.use_stderr() { Exit::Usage } else { Exit::Ok };
        }
    };
    if arguments.verbose {
        tracing_subscriber::fmt()
            .with_max_level(tracing::Level::DEBUG)
            .without_time()
            .with_target(false)
            .with_ansi(output::has_color())
            .with_writer(std::io::stderr)
            .init();
    }
    let mut output = Output::new(arguments.quiet, arguments.json, arguments.deny_warnings);
    if arguments.command.streams() {
        output = output.streaming();
    }
    let result = match arguments.command {
        Command::New(arguments) => new::run(&arguments, &mut output),
        #[cfg(target_os = "linux")]
        Command::Run(arguments) if !arguments.bus.is_empty() => live::run(&arguments, &mut output),
        Command::Run(arguments) => run::run(&arguments, &mut output),
        #[cfg(target_os = "linux")]
        Command::Sim(arguments) => sim::run(&arguments, &mut output),
        #[cfg(target_os = "linux")]
        Command::Drill(arguments) => drill::run(&arguments, &mut output),
        Command::Jog(arguments) => jog::run(&arguments, &mut output),
        Command::Home(arguments) => home::run(&arguments, &mut output),
        Command::Calibrate(command) => calibrate::run(&command, &mut output),
        Command::Sensor(command) => sensor::run(&command, &mut output),
        Command::Commission(arguments) => commission::run(&arguments, &mut output),
        #[cfg(target_os = "linux")]
        Command::Latency(arguments) => latency::run(&arguments, &mut output),
        #[cfg(target_os = "linux")]
        Command::Doctor(arguments) => doctor::run(&arguments, &mut output),
        Command::Scan(arguments) => desk::scan::run(&arguments, &mut output),
        Command::Info(arguments) => desk::info::run(&arguments, &mut output),
        Command::Od(command) => desk::od::run(&command, &mut output),
        Command::Drive(command) => desk::adopt::run(&command, &mut output),
        Command::Pdo(command) => desk::pdo::run(&command, &mut output),
        Command::Nmt(arguments) => desk::nmt::run(&arguments, &mut output),
        Command::Emcy(arguments) => desk::emcy::run(&arguments, &mut output),
        Command::State(arguments) => desk::state::run(&arguments, &mut output),
        Command::Lss(command) => desk::lss::run(&command, &mut output),
        Command::Dc(arguments) => desk::dc::run(&arguments, &mut output),
        Command::Errors(arguments) => desk::errors::run(&arguments, &mut output),
        Command::Sii(command) => desk::sii::run(&command, &mut output),
        Command::Alias(arguments) => desk::alias::run(&arguments, &mut output),
        Command::Reg(command) => desk::reg::run(&command, &mut output),
        Command::Monitor(arguments) => desk::monitor::run(&arguments, &mut output),
        Command::Faults(arguments) => faults::list(&arguments, &mut output),
        Command::Explain(arguments) => explain::run(&arguments, &mut output),
        Command::Reproduce(arguments) => reproduce::run(&arguments, &mut output),
        Command::Replay(arguments) => replay::run(&arguments, &mut output),
        Command::Plot(arguments) => plot::run(&arguments, &mut output),
        Command::View(arguments) => page::view(&arguments, &mut output),
        Command::Play(arguments) => page::play(&arguments, &mut output),
        Command::Compare(arguments) => compare::run(&arguments, &mut output),
        Command::Record(command) => record::run(&command, &mut output),
        Command::Soak(arguments) => soak::run(&arguments, &mut output),
        Command::Study(arguments) => study::run(&arguments, &mut output),
        Command::Sweep(arguments) => sweep::run(&arguments, &mut output),
        Command::Bus(command) => bus::run(&command, &mut output),
        Command::Tune(command) => tune::run(&command, &mut output),
        Command::Report(arguments) => full::report(&arguments, &mut output),
        Command::Config(command) => config::run(command, &mut output),
        Command::Completions(arguments) => full::completions(&arguments, &mut output),
        Command::Man(arguments) => full::man(&arguments, &mut output),
    };
    match result {
        Ok(()) => Exit::Ok,
        Err(failure) => {
            output.failure(&failure);
            failure.exit
        }
    }
}

/// Prints why arguments make no sense, in lines that fit the terminal.
fn refusal(error: &clap::Error) -> std::io::Result<()> {
    let text = error.render();
    let text = if output::has_color() { text.ansi().to_string() } else { text.to_string() };
    let columns = fit::columns(std::io::stderr()).unwrap_or(fit::USUAL);
    std::io::stderr().lock().write_all(fit::fitted(&text, columns).as_bytes())
}

#[cfg(test)]
#[path = "../sample.rs"]
mod sample;
#[cfg(test)]
mod tests;
