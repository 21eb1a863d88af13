//! The process that runs ethercrab, so that a panic or a hang of ethercrab does not reach this program.
//!
//! Only one process sends at a time. The parent process keeps its role as the master of the interface and waits. The child process
//! sends in its place: it starts only if its parent has the role, and the kernel ends it with its parent.

use std::fmt;
use std::io::{self, Read};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use rustix::process::{Signal, getppid, set_parent_process_death_signal};

use super::ethercrab::{self, Answer};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_link::{EthernetError, PacketSocket, Role};

/// Time after which ethercrab has hung. It takes some 20 ms a device.
const LIMIT: Duration = Duration::from_secs(60);
/// Time between two looks at the process.
const LOOK_UP: Duration = Duration::from_millis(10);
/// Limit of the stored output in bytes: an answer has about 500 per device.
const LONGEST: u64 = 1 << 20;

/// Arguments of the process: the interface on which its parent holds the role of the master.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    interface: String,
}

/// Reason for a missing answer.
#[derive(Debug)]
pub(super) enum NoAnswer {
    NotStarted(io::Error),
    Panicked(String),
    Ended { status: ExitStatus, said: String },
    Hung(Duration),
    Interrupted,
}

impl fmt::Display for NoAnswer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotStarted(error) => write!(f, "its process could not be started: {error}"),
            Self::Panicked(said) => write!(f, "it panicked: {said}"),
            Self::Ended { status, said } => write!(f, "its process ended with {status} and without an answer: {said}"),
            Self::Hung(limit) => write!(f, "it did not end within {} s, and its process was ended", limit.as_secs()),
            Self::Interrupted => write!(f, "interrupted"),
        }
    }
}

/// The other process: reads the devices by ethercrab, and prints the answer as JSON.
pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    // This comes before the check of the parent, so that a later end of the parent ends this process as well.
    let is_bound = set_parent_process_death_signal(Some(Signal::KILL)).is_ok();
    let interface = &arguments.interface;
    let parent = getppid().map(|parent| parent.as_raw_nonzero().get());
    match PacketSocket::open(interface, Role::Master) {
        Err(EthernetError::Held { holder: Some(holder), .. }) if is_bound && parent == Some(holder.pid) => {}
        Err(
            error @ (EthernetError::NotPermitted { .. } | EthernetError::Missing { .. } | EthernetError::Down { .. }),
        ) => {
            return Err(Failure::new(Exit::BusUnavailable, error.to_string(), ""));
        }
        _ => {
            let message = format!("no process that has `{interface}` has started this one");
            let help = format!("ask for `yieldwall doctor --bus {interface} --second-opinion`");
            return Err(Failure::new(Exit::Usage, message, help));
        }
    }
    let link = PacketSocket::listening(interface);
    let mut link = link.map_err(|error| Failure::new(Exit::BusUnavailable, error.to_string(), ""))?;
    output.json(&ethercrab::read(&mut link))
}

/// Asks ethercrab in another process, and waits for it.
pub(super) fn ask(interface: &str, is_over: &AtomicBool) -> Result<Answer, NoAnswer> {
    // This very program, even if its file was replaced since.
    let mut command = Command::new("/proc/self/exe");
    command.arg0("yieldwall").args(["doctor", "ethercrab", "--", interface]);
    // A panic is one line.
    command.env_remove("RUST_BACKTRACE");
    converse(command, LIMIT, is_over)
}

/// Starts a process, and waits for its printed answer for a limited time.
pub(super) fn converse(mut command: Command, limit: Duration, is_over: &AtomicBool) -> Result<Answer, NoAnswer> {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(NoAnswer::NotStarted)?;
    let readers = [reader(child.stdout.take()), reader(child.stderr.take())];
    let status = wait(&mut child, limit, is_over);
    if status.is_err() {
        // It may have ended meanwhile.
        let _ = child.kill();
        let _ = child.wait();
    }
    let [printed, said] = readers.map(|reader| reader.join().unwrap_or_default());
    let status = status?;
    match serde_json::from_str(&printed) {
        Ok(answer) if status.success() => Ok(answer),
        _ => Err(ended(status, &said)),
    }
}

fn wait(child: &mut Child, limit: Duration, is_over: &AtomicBool) -> Result<ExitStatus, NoAnswer> {
    let begun = Instant::now();
    loop {
        if let Some(status) = child.try_wait().map_err(NoAnswer::NotStarted)? {
            // Ctrl-C reaches both.
            let is_interrupted = is_over.load(Ordering::Relaxed) && status.signal().is_some();
            return if is_interrupted { Err(NoAnswer::Interrupted) } else { Ok(status) };
        }
        if is_over.load(Ordering::Relaxed) {
            return Err(NoAnswer::Interrupted);
        }
        if begun.elapsed() >= limit {
            return Err(NoAnswer::Hung(limit));
        }
        thread::sleep(LOOK_UP);
    }
}

fn reader(from: Option<impl Read + Send + 'static>) -> thread::JoinHandle<String> {
    thread::spawn(move || {
        let mut bytes = Vec::new();
        // The bytes up to a read error are all that there is.
        let _ = from.map(|from| from.take(LONGEST).read_to_end(&mut bytes));
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

/// Returns the reason why a process ended without an answer, from its standard error.
fn ended(status: ExitStatus, said: &str) -> NoAnswer {
    let said = said.trim();
    match said.split_once("panicked at ") {
        Some((_, panic)) => {
            let lines = panic.lines().filter(|line| !line.starts_with("note: ")).map(str::trim);
            NoAnswer::Panicked(lines.filter(|line| !line.is_empty()).collect::<Vec<_>>().join(" "))
        }
        None => NoAnswer::Ended { status, said: said.split_whitespace().collect::<Vec<_>>().join(" ") },
    }
}
