//! The server of a page, for as long as a command runs.

use std::io::{self, Write};
use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use serde_json::json;

use super::browser::{self, LeadingFile};
use super::{Arguments, Pace, PageOf, ViewArgument, description};
use crate::bus::{Plan, plans};
use crate::doctor::proven_tier;
use crate::failure::{Exit, Failure};
use crate::interrupt::on_interrupt;
use crate::output::Output;
use crate::replay::{damage, open, read_failure, recording_file};
use yieldwall_config as config;
use yieldwall_fieldbus::time::Time;
use yieldwall_record::CycleRecord;
use yieldwall_record::recording::{Backpressure, Feed, Producer};
use yieldwall_run::{Observer, Watch};
use yieldwall_view::{
    BusLoad, Description, Hello, RING, RecordingFile, Server, Source, StartError, Stream, faults, stream,
};

/// Time in which `view` sees Ctrl-C.
const REST: Duration = Duration::from_millis(50);

/// Tier of real time that the page shows for virtual time.
pub(super) const VIRTUAL_TIME: &str = "not needed: virtual time";

/// The page of a run, if one is requested.
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
    pub(crate) fn open(&mut self, argument: &ViewArgument, rig: &config::Rig, of: PageOf) -> Result<(), Failure> {
        let Some(address) = argument.view else { return Ok(()) };
        let tier = match of.pace {
            Pace::Virtual => Some(VIRTUAL_TIME.to_owned()),
            Pace::Lockstep => Some("not needed: lockstep".to_owned()),
            Pace::Free => proven_tier(rig),
        };
        let (stream, producer, feed) = fed(RING)?;
        let server = start(address, hello(of.command, tier, description::of_rig(rig)), Source::Live(stream))?;
        server.set_buses(loads(rig));
        // If standard error is closed, no message can reach anybody.
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
        let observer = producer.map(|mut producer| -> Observer { Box::new(move |record| producer.push(record)) });
        Watch { observer, ..Watch::default() }
    }

    /// Returns the observer for virtual time: it also holds the simulation back to the wall clock.
    pub(crate) fn watch_by_the_clock(&mut self) -> Watch {
        let observer = self.watch().observer.map(|mut observer| -> Observer {
            let mut from: Option<(Instant, u64)> = None;
            Box::new(move |record| {
                observer(record);
                let (started, first_ns) = *from.get_or_insert((Instant::now(), record.moment.sync_ns));
                let elapsed = Duration::from_nanos(record.moment.sync_ns.saturating_sub(first_ns));
                std::thread::sleep(elapsed.saturating_sub(started.elapsed()));
            })
        });
        Watch { observer, ..Watch::default() }
    }

    /// Returns the closure that shows simulated devices of a rig at most once a period: it takes their time and a function that makes
    /// their record.
    pub(crate) fn show_devices(
        &mut self,
        rig: &config::Rig,
    ) -> impl FnMut(Time, &mut dyn FnMut() -> CycleRecord) + use<> {
        let period = Duration::from_micros(rig.cycle.period_us.into());
        let mut producer = self.0.as_mut().and_then(|viewing| viewing.producer.take());
        let (mut index, mut due) = (0, Time::default());
        move |now, record| {
            let Some(producer) = producer.as_mut().filter(|_| now >= due) else { return };
            let mut record = record();
            record.moment.index = index;
            producer.push(&record);
            (index, due) = (index + 1, now + period);
        }
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

pub(super) fn hello(command: &'static str, tier: Option<String>, machine: Description) -> Hello {
    let program = concat!("yieldwall ", env!("CARGO_PKG_VERSION")).to_owned();
    Hello { program, command, tier, machine, faults: faults(), play: None }
}

/// Creates the stream of a page, fed by a ring of this many records. A page that does not keep up loses records: the cycle waits
/// for nobody.
pub(super) fn fed(ring: usize) -> Result<(Stream, Producer<CycleRecord>, Feed<()>), Failure> {
    let (stream, sink) = stream::<CycleRecord>();
    let started = Feed::start("view", ring, Backpressure::Drop, sink);
    let (producer, feed) =
        started.map_err(|error| Failure::new(Exit::Internal, format!("thread of the page: {error}"), ""))?;
    Ok((stream, producer, feed))
}

/// Prints the address of a page, and opens a browser unless `no_open`. The file that redirects to the page is deleted on drop.
pub(super) fn announce(server: &Server, no_open: bool, output: &mut Output) -> Result<Option<LeadingFile>, Failure> {
    let address = server.address_line();
    if output.is_json() {
        output.report(json!({ "address": address }))?;
    } else {
        output.result(&format!("{address}\n"))?;
    }
    if no_open {
        output.aside("open this address in a browser; Ctrl-C ends the program");
        return Ok(None);
    }
    Ok(browser::open(&address, server.address().port(), output))
}

/// Returns the greatest load of each bus of a rig.
pub(super) fn loads(rig: &config::Rig) -> Vec<BusLoad> {
    // A rig that is refused later has no budget.
    let plans = plans(rig).unwrap_or_default();
    let load = |plan: &Plan<'_>| {
        let (name, share) = plan.load();
        BusLoad { name: name.to_owned(), load_percent: 100.0 * share }
    };
    plans.iter().map(load).collect()
}

pub(super) fn start(address: SocketAddr, hello: Hello, source: Source) -> Result<Server, Failure> {
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
    let server = start(arguments.on, hello("view", None, machine), Source::Recordings(files))?;
    let _opened = announce(&server, arguments.no_open, output)?;
    while !is_interrupted.load(Ordering::Relaxed) {
        std::thread::sleep(REST);
    }
    server.end("The program has ended.");
    Ok(())
}
