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
#[command(name = "yieldwall", version, after_help = failure::EXIT_CODES, arg_required_else_help = true)]
struct Arguments {
    /// Print warnings and failures only
    #[arg(long, short, global = true, help_heading = GLOBAL)]
    quiet: bool,
    /// Tell on standard error what is done on the way, such as each step of the boot
    #[arg(long, short, global = true, help_heading = GLOBAL, conflicts_with = "quiet")]
    verbose: bool,
    /// Print one JSON document on standard output instead of text
    #[arg(long, global = true, help_heading = GLOBAL)]
    json: bool,
    /// Refuse a configuration that has warnings, as one that has errors
    #[arg(long, global = true, help_heading = GLOBAL)]
    deny_warnings: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Write a new rig with its simulation and its scene, from flags or from a few questions
    New(new::Arguments),
    /// Run a rig with its scene, on the embedded simulation or on a real bus
    Run(run::Arguments),
    /// Put simulated drives, sensor, arm and hand on a real bus
    #[cfg(target_os = "linux")]
    Sim(sim::Arguments),
    /// Show on a real bus that the drives stop by themselves when the master falls silent; `run --bus` asks for it
    #[cfg(target_os = "linux")]
    Drill(drill::Arguments),
    /// Move one joint by an angle, slowly and with little torque, while the other one holds
    Jog(jog::Arguments),
    /// Have each drive with an incremental encoder find its reference, one after the other, while the other one holds
    Home(home::Arguments),
    /// Tell link lengths and encoder zeros of the arm from points that its tool is led to
    #[command(subcommand)]
    Calibrate(calibrate::Command),
    /// Show what the force sensor of a rig sends, the zero that it has, or what it makes of known forces
    #[command(subcommand)]
    Sensor(sensor::Command),
    /// Take the ordered steps from drives that answer to an arm that may be run, and write a report
    Commission(commission::Arguments),
    /// Measure how late this computer wakes up, and how long a frame takes to the bus and back
    #[cfg(target_os = "linux")]
    Latency(latency::Arguments),
    /// Say what keeps this computer, an interface or a node from being of use, and the command that mends it
    #[cfg(target_os = "linux")]
    Doctor(doctor::Arguments),
    /// Find the devices on a bus: who answers, what it is, and which entry of the rig it fits
    Scan(desk::scan::Arguments),
    /// Say of one device who it is and how it is
    Info(desk::info::Arguments),
    /// Read, write, keep, compare and restore the objects of a device
    #[command(subcommand)]
    Od(desk::od::Command),
    /// Profiles of drives
    #[command(subcommand)]
    Drive(desk::adopt::Command),
    /// Process data of a device
    #[command(subcommand)]
    Pdo(desk::pdo::Command),
    /// Start, stop and reset devices by network management
    Nmt(desk::nmt::Arguments),
    /// List the errors that devices have stored, in words
    Emcy(desk::emcy::Arguments),
    /// Say in which state a device is; take a drive out of Fault, or a device on EtherCAT to another state
    State(desk::state::Arguments),
    /// Node ids for devices that have none, or the wrong one
    #[command(subcommand)]
    Lss(desk::lss::Command),
    /// Show the distributed clocks of devices on EtherCAT
    Dc(desk::dc::Arguments),
    /// Show what the ports of devices on EtherCAT have counted, and what to look at
    Errors(desk::errors::Arguments),
    /// What devices on EtherCAT keep in their memory chips
    #[command(subcommand)]
    Sii(desk::sii::Command),
    /// Show the alias of a device on EtherCAT, or give it one
    Alias(desk::alias::Arguments),
    /// Registers of a device on EtherCAT
    #[command(subcommand)]
    Reg(desk::reg::Command),
    /// Print what is on a bus, frame by frame, in words; nothing is sent
    Monitor(desk::monitor::Arguments),
    /// List the faults that can be injected, what each does and what follows
    Faults(faults::Arguments),
    /// Say what a fault, an error code, an SDO abort code or a statusword means
    Explain(explain::Arguments),
    /// Run the paper's experiments and draw its figures
    Reproduce(reproduce::Arguments),
    /// Run a recording's cycles again and compare, bit by bit
    Replay(replay::Arguments),
    /// Draw a recording
    Plot(plot::Arguments),
    /// Show a recording on a page in the browser: play it, jump to faults and impacts, lay another one over it
    View(page::Arguments),
    /// Push the tool of a simulated rig with the mouse, on a page in the browser: a wall that yields beside a spring
    Play(page::PlayArguments),
    /// Put runs and recordings side by side: measures, curves, and what differs in their configurations
    Compare(compare::Arguments),
    /// Look into recordings and mend them
    #[command(subcommand)]
    Record(record::Command),
    /// Draw rigs, hands and faults from seeds, run them and judge every cycle
    Soak(soak::Arguments),
    /// Tables and charts of speed, accuracy and stability
    Study(study::Arguments),
    /// A table and a chart of one's own: a rig in every combination of values that are set over its own
    Sweep(sweep::Arguments),
    /// What the bus of a rig can carry
    #[command(subcommand)]
    Bus(bus::Command),
    /// Numbers of a fixture and gains of a rig that stay stable with a reserve
    #[command(subcommand)]
    Tune(tune::Command),
    /// Put what a bug report needs into one zip, without names of users and computers
    Report(full::Report),
    /// Check, show and describe configuration files
    #[command(subcommand)]
    Config(config::Command),
    /// Print what a shell needs to complete the commands: `source <(yieldwall completions bash)`
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

/// The commit that the program was built from, as it says itself.
static COMMIT: OnceLock<&'static str> = OnceLock::new();

fn commit() -> &'static str {
    COMMIT.get().copied().unwrap_or_default()
}

/// Runs the program with these arguments, the first of which is its name; `commit` is what it was built from, empty where that is
/// not known.
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
