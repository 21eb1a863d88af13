//! A rig on real buses that is moved for the first time: where it is, and on which terms.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::desk::journal::{Journal, refuse_open};
use super::ending::rig_failure;
use super::events::Events;
use super::failure::{Exit, Failure, both};
use super::interfaces::Interfaces;
use super::interrupt::on_interrupt;
use super::live::{evidence, not_run};
use super::on_bus::{different, open_failure, thread_failure, warn, warn_of};
use super::output::Output;
use super::pace::PaceArgument;
use yieldwall_bus::{Master, Written};
use yieldwall_config::{Loaded, Rig};
use yieldwall_run::assembly::{AssemblyError, master};
use yieldwall_run::host::{News, Outcome, RigOnBus, Terms, ThreadError};

#[derive(Debug, clap::Args)]
pub(super) struct OnBus {
    /// Take the real rig on this interface instead of a simulated one; for a rig with several buses once for each, as NAME=INTERFACE
    #[arg(long, value_name = "INTERFACE")]
    bus: Vec<String>,
    /// What a cycle waits for: the wall clock, or (simulated devices in lockstep alone) the process data
    #[arg(long, value_enum, default_value_t = PaceArgument::Free, requires = "bus")]
    pace: PaceArgument,
    /// Move also if this computer has not proved the timing that the rig asks for
    #[arg(long, requires = "bus")]
    ignore_latency: bool,
}

/// A rig that has sent nothing yet.
pub(super) struct Opened {
    pub(super) on_bus: RigOnBus,
    pub(super) terms: Terms,
    pub(super) interfaces: Interfaces,
    pub(super) is_interrupted: Arc<AtomicBool>,
    /// What the devices held before; none in lockstep, whose devices are simulated.
    pub(super) journal: Option<Journal>,
}

impl OnBus {
    /// Whether the rig is a real one.
    pub(super) fn is_asked(&self) -> bool {
        !self.bus.is_empty()
    }

    /// Whether its cycles follow the wall clock.
    pub(super) fn is_by_the_clock(&self) -> bool {
        self.pace == PaceArgument::Free
    }

    /// Its interfaces.
    pub(super) fn interfaces(&self, rig: &Rig) -> Result<Interfaces, Failure> {
        Interfaces::of(rig, &self.bus)
    }

    /// Keeps what its devices hold, and opens its interfaces. Objects are read, on EtherCAT in PRE-OP, and nothing else is sent.
    pub(super) fn open(
        &self,
        command: &str,
        file: &str,
        rig: &Loaded<Rig>,
        output: &mut Output,
    ) -> Result<Opened, Failure> {
        let boots = |rig: &Rig| Ok(vec![master(rig, &rig.fixture)?]);
        self.open_for(command, file, rig, boots, output)
    }

    /// The same of a rig that these masters boot, one after the other.
    pub(super) fn open_for(
        &self,
        command: &str,
        file: &str,
        rig: &Loaded<Rig>,
        boots: impl Fn(&Rig) -> Result<Vec<Master>, AssemblyError>,
        output: &mut Output,
    ) -> Result<Opened, Failure> {
        let scene = match (&rig.value.simulation, self.pace) {
            (None, _) | (_, PaceArgument::Free) => None,
            _ => Some(rig.scene()?.value),
        };
        let rig = &rig.value;
        let terms = Terms {
            evidence: evidence(self.pace, rig, scene.as_ref())?,
            needs_realtime: false,
            ignores_latency: self.ignore_latency,
            ignores_bus_budget: false,
        };
        let interfaces = self.interfaces(rig)?;
        // First: nobody who asks for the end while devices are read is overheard.
        let is_interrupted = on_interrupt()?;
        let journal = match self.pace {
            PaceArgument::Free => {
                let written = written(&boots(rig).map_err(|error| rig_failure(&error.into()))?);
                Some(Journal::begin(command, (rig, file), &written, &interfaces)?)
            }
            PaceArgument::Lockstep => {
                refuse_open(rig, file, &interfaces)?;
                None
            }
        };
        let on_bus = match RigOnBus::open(rig, interfaces.names(), self.pace.pace()) {
            Ok(on_bus) => on_bus,
            Err(error) => {
                journal.iter().for_each(Journal::discard);
                return Err(open_failure(&error));
            }
        };
        warn_of(output, on_bus.memory());
        Ok(Opened { on_bus, terms, interfaces, is_interrupted, journal })
    }
}

/// The objects that the boots of these masters write, each once.
fn written(masters: &[Master]) -> Vec<Written> {
    let mut all: Vec<Written> = Vec::new();
    for one in masters.iter().flat_map(|master| master.networks().written()) {
        match all.iter_mut().find(|known| (known.bus, known.number) == (one.bus, one.number)) {
            Some(known) => one.objects.into_iter().for_each(|object| {
                if !known.objects.contains(&object) {
                    known.objects.push(object);
                }
            }),
            None => all.push(one),
        }
    }
    all
}

/// Gives the devices back what they held before, if anything was kept; what the act came to, with each emergency once, and whether they
/// got it back.
pub(super) fn concluded<T>(
    events: &Events,
    journal: Option<Journal>,
    outcome: Result<Outcome<T>, ThreadError>,
    output: &mut Output,
) -> Result<(Outcome<T>, Result<(), Failure>), Failure> {
    events.clear();
    let given_back = journal.map_or(Ok(()), |journal| journal.give_back(output));
    let mut outcome = outcome.map_err(|error| thread_failure(&error))?;
    outcome.emergencies = different(outcome.emergencies.into_iter());
    Ok((outcome, given_back))
}

/// Tells what does not concern a command, beside its results.
pub(super) type Tell<'a> = &'a dyn Fn(&mut Output, News);

/// Has something done with a rig on a bus of which nothing is enabled; the devices are given back what they held.
pub(super) fn at_rest<T>(
    arguments: &OnBus,
    (command, file): (&str, &str),
    rig: &Loaded<Rig>,
    output: &mut Output,
    act: impl FnOnce(RigOnBus, &Terms, &Arc<AtomicBool>, &mut Output, Tell<'_>) -> Result<Outcome<T>, ThreadError>,
) -> Result<T, Failure> {
    let events = Events::of(output);
    let Opened { on_bus, terms, interfaces, is_interrupted, journal } = arguments.open(command, file, rig, output)?;
    // Nothing is enabled that would have to be in time.
    let terms = Terms { ignores_latency: true, ..terms };
    let tell = |output: &mut Output, news: News| match news {
        News::Refused(refusal) => warn(output, refusal),
        News::Step(_) => {}
        news => events.news(news),
    };
    let outcome = act(on_bus, &terms, &is_interrupted, output, &tell);
    let (outcome, given_back) = concluded(&events, journal, outcome, output)?;
    let end = match &outcome.played {
        Ok(_) => Ok(()),
        Err(error) => Err(not_run(error, &outcome, &interfaces, &rig.value, file)),
    };
    both(end, given_back)?;
    outcome.played.map_err(|error| Failure::new(Exit::Internal, error.to_string(), ""))
}
