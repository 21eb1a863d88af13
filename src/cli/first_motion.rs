//! A rig on real buses that is moved for the first time: where it is, and on which terms.

use std::mem;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::desk::journal::{journals, not_opened, restored};
use super::events::Events;
use super::failure::{Exit, Failure, both};
use super::interfaces::Interfaces;
use super::interrupt::on_interrupt;
use super::live::{evidence, not_run};
use super::on_bus::{different, thread_failure, warn, warn_of};
use super::output::Output;
use super::pace::PaceArgument;
use yieldwall_config::{Loaded, Rig};
use yieldwall_run::host::{BringUp, HostedRun, News, RigOnBus, Terms, ThreadError};

#[derive(Debug, clap::Args)]
pub(super) struct OnBus {
    /// Use the real rig on this interface, not a simulated one; for a rig with several buses once for each, as NAME=INTERFACE
    #[arg(long, value_name = "INTERFACE")]
    bus: Vec<String>,
    /// Event that starts a cycle: the wall clock, or the process data (only with simulated devices in lockstep)
    #[arg(long, value_enum, default_value_t = PaceArgument::Free, requires = "bus")]
    pace: PaceArgument,
    /// Move even if this computer has not proved the timing that the rig requires
    #[arg(long, requires = "bus")]
    ignore_latency: bool,
    /// Accept that a drive keeps its own torque limit, although it is above the limit of this motion
    #[arg(long, requires = "bus")]
    accept_drive_limit: bool,
}

/// A rig that has sent nothing yet.
pub(super) struct Opened {
    pub(super) on_bus: RigOnBus<BringUp>,
    pub(super) terms: Terms,
    pub(super) interfaces: Interfaces,
    pub(super) is_interrupted: Arc<AtomicBool>,
}

impl OnBus {
    /// Whether the rig is a real one.
    pub(super) fn is_asked(&self) -> bool {
        !self.bus.is_empty()
    }

    /// Returns the pace of its cycles.
    pub(super) fn pace(&self) -> PaceArgument {
        self.pace
    }

    /// Whether the cycles follow the wall clock.
    pub(super) fn is_by_the_clock(&self) -> bool {
        self.pace == PaceArgument::Free
    }

    /// Returns its interfaces.
    pub(super) fn interfaces(&self, rig: &Rig) -> Result<Interfaces, Failure> {
        Interfaces::of(rig, &self.bus)
    }

    /// Saves its devices' values, and opens its interfaces. Only reads objects, on EtherCAT in PRE-OP.
    pub(super) fn open(
        &self,
        command: &str,
        file: &str,
        rig: &Loaded<Rig>,
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
        let (names, pace) = (interfaces.names(), self.pace.pace());
        let on_bus = RigOnBus::open_for_bring_up(rig, names, pace, &journals(command), &is_interrupted);
        let mut on_bus = on_bus.map_err(|error| not_opened(&error, rig, file, &interfaces))?;
        if self.accept_drive_limit {
            on_bus.accept_drive_limits();
        }
        warn_of(output, on_bus.memory());
        Ok(Opened { on_bus, terms, interfaces, is_interrupted })
    }
}

/// Returns the outcome of the act, with each emergency once, and the outcome of the restoration of the devices.
pub(super) fn concluded<T>(
    events: &Events,
    outcome: Result<HostedRun<T>, ThreadError>,
    output: &mut Output,
) -> Result<(HostedRun<T>, Result<(), Failure>), Failure> {
    events.clear();
    let mut outcome = outcome.map_err(|error| thread_failure(&error))?;
    let given_back = restored(mem::take(&mut outcome.restored), output);
    outcome.emergencies = different(outcome.emergencies.into_iter());
    Ok((outcome, given_back))
}

/// Reports messages that are no result of the command.
pub(super) type Tell<'a> = &'a dyn Fn(&mut Output, News);

/// Runs an action on the bus of a rig with nothing enabled, and restores the devices' values.
pub(super) fn at_rest<T>(
    arguments: &OnBus,
    (command, file): (&str, &str),
    rig: &Loaded<Rig>,
    output: &mut Output,
    act: impl FnOnce(
        RigOnBus<BringUp>,
        &Terms,
        &Arc<AtomicBool>,
        &mut Output,
        Tell<'_>,
    ) -> Result<HostedRun<T>, ThreadError>,
) -> Result<T, Failure> {
    let events = Events::of(output);
    let Opened { on_bus, terms, interfaces, is_interrupted } = arguments.open(command, file, rig, output)?;
    // Nothing that has deadlines is enabled.
    let terms = Terms { ignores_latency: true, ..terms };
    let tell = |output: &mut Output, news: News| match news {
        News::Refused(refusal) => warn(output, refusal),
        News::Step(_) => {}
        news => events.news(news),
    };
    let outcome = act(on_bus, &terms, &is_interrupted, output, &tell);
    let (outcome, given_back) = concluded(&events, outcome, output)?;
    let end = match &outcome.played {
        Ok(_) => Ok(()),
        Err(error) => Err(not_run(error, &outcome, &interfaces, &rig.value, file)),
    };
    both(end, given_back)?;
    outcome.played.map_err(|error| Failure::new(Exit::Internal, error.to_string(), ""))
}
