//! The server of a page, for as long as a command runs.

use std::io::{self, Write};
use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::time::Duration;

use serde_json::json;

use super::{Arguments, ViewArgument, browser, description};
use crate::failure::{Exit, Failure};
use crate::interrupt::on_interrupt;
use crate::output::Output;
use crate::replay::{damage, open, read_failure, recording_file};
use yieldwall_config as config;
use yieldwall_record::CycleRecord;
use yieldwall_record::recording::{Backpressure, Feed, Producer};
use yieldwall_run::Watch;
use yieldwall_view::{Command, Description, Hello, RING, RecordingFile, Server, Source, StartError, faults, stream};

/// Time in which `view` sees Ctrl-C.
const REST: Duration = Duration::from_millis(50);

/// The page of a run, if one is asked for.
#[derive(Default)]
pub(crate) struct Page(Option<Viewing>);

/// A server with the ring that feeds it.
struct Viewing {
    server: Server,
    producer: Option<Producer<CycleRecord>>,
    feed: Feed<()>,
}

impl Page {
    /// Serves the page that is asked for, and prints its address on standard error.
    ///
    /// # Errors
    /// If the address is not a loopback address or is taken, or the system has no thread.
    pub(crate) fn open(&mut self, argument: &ViewArgument, rig: &config::Rig) -> Result<(), Failure> {
        let Some(address) = argument.view else { return Ok(()) };
        let (stream, sink) = stream::<CycleRecord>();
        // A page that does not keep up loses records: the cycle waits for nobody.
        let started = Feed::start("view", RING, Backpressure::Drop, sink);
        let no_thread = |error| Failure::new(Exit::Internal, format!("thread of the page: {error}"), "");
        let (producer, feed) = started.map_err(no_thread)?;
        let server = start(address, hello(Command::Run, description::of_rig(rig)), Source::Live(stream))?;
        // Nobody can be told that standard error is closed.
        let _ = writeln!(io::stderr(), "view      {}", server.address_line());
        self.0 = Some(Viewing { server, producer: Some(producer), feed });
        Ok(())
    }

    /// Whether there is one.
    pub(crate) fn is_open(&self) -> bool {
        self.0.is_some()
    }

    /// Returns the observer that sends each record to the page.
    pub(crate) fn watch(&mut self) -> Watch {
        let producer = self.0.as_mut().and_then(|viewing| viewing.producer.take());
        let observer =
            producer.map(|mut producer| -> yieldwall_run::Observer { Box::new(move |record| producer.push(record)) });
        Watch { observer, ..Watch::default() }
    }

    /// Sends clients the last records and the end of the run.
    pub(crate) fn end(self, end: &Result<(), Failure>) {
        let Some(Viewing { server, feed, .. }) = self.0 else { return };
        // The page counts the records that it has lost.
        let _ = feed.finish();
        let first = end.as_ref().err().and_then(|failure| failure.report.diagnostics.first());
        server.end(&first.map_or("The run is over.".to_owned(), |finding| finding.message.clone()));
    }
}

fn hello(command: Command, machine: Description) -> Hello {
    let program = concat!("yieldwall ", env!("CARGO_PKG_VERSION")).to_owned();
    Hello { program, command, tier: None, machine, faults: faults() }
}

fn start(address: SocketAddr, hello: Hello, source: Source) -> Result<Server, Failure> {
    Server::start(address, hello, source).map_err(|error| {
        let help = error.help().unwrap_or_else(|| match &error {
            StartError::Io { error, .. } if error.kind() == io::ErrorKind::AddrInUse => {
                format!("name another port, or {} for any free one", SocketAddr::new(address.ip(), 0))
            }
            StartError::MixedRecordings => "name two recordings of rigs, or two of impedance devices".to_owned(),
            _ => String::new(),
        });
        Failure::new(Exit::Usage, error.to_string(), help)
    })
}

/// Serves recordings until Ctrl-C.
pub(crate) fn view(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let (mut files, mut first) = (Vec::new(), None);
    for path in arguments.recordings.iter().map(|path| recording_file(path)) {
        let machine = description::of_recording(open(&path)?.about())?;
        let file = RecordingFile::open(&path, machine.clone()).map_err(|error| read_failure(&path, &error))?;
        output.warnings(&damage(file.damage(), &path));
        first.get_or_insert(machine);
        files.push(file);
    }
    let Some(machine) = first else { return Ok(()) };
    let is_interrupted = on_interrupt()?;
    let server = start(arguments.on, hello(Command::View, machine), Source::Recordings(files))?;
    let address = server.address_line();
    if output.is_json() {
        output.report(json!({ "address": address }))?;
    } else {
        output.result(&format!("{address}\n"))?;
    }
    let _opened = (!arguments.no_open).then(|| browser::open(&address, server.address().port(), output));
    while !is_interrupted.load(Ordering::Relaxed) {
        std::thread::sleep(REST);
    }
    server.end("The program has ended.");
    Ok(())
}
