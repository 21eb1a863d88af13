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
use crate::replay::{open, read_failure, recording_file};
use yieldwall_config as config;
use yieldwall_record::CycleRecord;
use yieldwall_record::recording::{Backpressure, Feed};
use yieldwall_run::Watch;
use yieldwall_view::{Command, Hello, RING, RecordingFile, Server, Source, StartError, stream};

/// How long `view` takes to see Ctrl-C.
const REST: Duration = Duration::from_millis(50);

/// A page of a rig that runs.
pub(crate) struct Viewing {
    server: Server,
    feed: Feed<()>,
}

impl Viewing {
    /// Serves the page that is asked for, prints its address on standard error, and returns what has to watch the rig for it.
    ///
    /// # Errors
    /// If the address is none of loopback or taken, or the system has no thread.
    pub(crate) fn start(
        argument: &ViewArgument,
        rig: &config::Rig,
        tier: Option<String>,
    ) -> Result<Option<(Self, Watch)>, Failure> {
        let Some(address) = argument.view else { return Ok(None) };
        let (stream, sink) = stream::<CycleRecord>();
        // A page that does not keep up loses records: the cycle waits for nobody.
        let started = Feed::start("view", RING, Backpressure::Drop, sink);
        let no_thread = |error| Failure::new(Exit::Internal, format!("thread of the page: {error}"), "");
        let (mut producer, feed) = started.map_err(no_thread)?;
        let hello = Hello { tier, ..description::of_rig(rig, Command::Run) };
        let server = start(address, hello, Source::Live(stream))?;
        // Nobody can be told that standard error is closed.
        let _ = writeln!(io::stderr(), "view      {}", server.address_line());
        let observer = Box::new(move |record: &CycleRecord| producer.push(record));
        Ok(Some((Self { server, feed }, Watch { observer: Some(observer), ..Watch::default() })))
    }

    /// Sends clients the rest and the end of the run.
    pub(crate) fn end(self, end: &Result<(), Failure>) {
        // Records that the page has lost are counted on it.
        let _ = self.feed.finish();
        let last = end.as_ref().err().and_then(|failure| failure.report.diagnostics.last());
        self.server.end(&last.map_or("the run is over".to_owned(), |finding| finding.message.clone()));
    }
}

fn start(address: SocketAddr, hello: Hello, source: Source) -> Result<Server, Failure> {
    Server::start(address, hello, source).map_err(|error| {
        let help = error.help().unwrap_or_else(|| match &error {
            StartError::Io { .. } => format!("name another port, such as {}:0 for any free one", address.ip()),
            StartError::MixedRecordings => "name recordings of one kind of machine".to_owned(),
            _ => String::new(),
        });
        Failure::new(Exit::Usage, error.to_string(), help)
    })
}

/// Serves recordings until Ctrl-C.
pub(crate) fn view(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let mut files = Vec::new();
    let mut hello = None;
    for path in arguments.recordings.iter().map(|path| recording_file(path)) {
        let recording = open(&path)?;
        if hello.is_none() {
            hello = Some(description::of_recording(recording.about())?);
        }
        files.push(RecordingFile::open(&path).map_err(|error| read_failure(&path, &error))?);
    }
    let Some(hello) = hello else { return Ok(()) };
    let is_interrupted = on_interrupt()?;
    let server = start(arguments.on, hello, Source::Recordings(files))?;
    let address = server.address_line();
    if output.is_json() {
        output.report(json!({ "address": address }))?;
    } else {
        output.result(&format!("{address}\n"))?;
    }
    if !arguments.no_open {
        browser::open(&address, output);
    }
    while !is_interrupted.load(Ordering::Relaxed) {
        std::thread::sleep(REST);
    }
    server.end("the program has ended");
    Ok(())
}
