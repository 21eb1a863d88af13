//! A rig on the interfaces of this computer, from locking memory to leaving the network: `run --bus` and `drill`, in one call each.

mod bench;
mod journal;
mod news;
mod open;

use std::io;
use std::marker::PhantomData;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

use thiserror::Error;

use super::system::{Refusal, SystemMetronome, computer, lock_memory, run_first};
use super::timing::{ProvenTiming, Untimely};
use crate::assembly::{bus_plan, segment};
use crate::bringup;
use crate::commission::{Begin, Commissioned, StepReport};
use crate::{
    Bounds, Drilled, DriveError, DriveIdentity, ErrorWatch, Finding, HomePlan, Homed, Jog, Jogged, LinkCounts,
    LoopPlan, LoopTraced, NotProven, Observer, OnLink, Orders, Pace, Place, Play, Played, Proof, Pulled, Repeated,
    RunError, Runner, Tap, Task, Unproven, Watch, Wrenches, settling_on_bus,
};
use bench::OnTheBench;
pub use bench::Person;
pub use journal::BringUp;
use journal::Kept;
pub use news::News;
use news::boot_watch;
pub use open::{OpenError, open_buses};
use yieldwall_bus::budget::Budget;
use yieldwall_bus::{EmergencyReport, ethercat};
use yieldwall_config as config;
use yieldwall_link::{InterfaceFacts, Interfaces, Role, SocketCan};
use yieldwall_motion::guard::Fault;
use yieldwall_motion::quantity::{JointAngles, TipPoint};
use yieldwall_motion::sensing::Wrench;
use yieldwall_record::{CycleRecord, Standstill};
use yieldwall_service::journal::{Journals, Restored};

/// A rig on the interfaces of this computer that has sent nothing yet.
///
/// The program supplies what a run needs:
/// - locked memory, and a thread with real-time priority for the loop;
/// - on each interface a lock as the only master, and process data apart from other frames;
/// - a check for another master before anything is sent;
/// - a check of this computer's timing, and of the drives' proof that they stop by themselves;
/// - enough cycles before enabling for two devices with one node ID to show;
/// - a stop along the ramp at the end, after which it leaves the network, whatever happened.
///
/// A rig whose buses cannot keep its cycle is refused.
///
/// A rig that was opened for [`BringUp`] is for guiding its joints one by one, or for measuring its force sensor. A journal stores
/// the devices' values on disk before anything is written, and the devices get them back at the end, whatever happened. While the
/// journal of a killed program is open, no rig opens on the same interfaces.
///
/// ```no_run
/// use std::sync::{Arc, atomic::AtomicBool};
/// use yieldwall_config as config;
/// use yieldwall_run::{Pace, host::{Evidence, RigOnBus, Terms}};
/// use yieldwall_service::journal::Journals;
///
/// # fn run(now_unix_s: u64) -> Result<(), Box<dyn std::error::Error>> {
/// let rig = config::load_rig(config::Source::named("rig.yaml"))?.value;
/// let journals = Journals { folder: Some("journals".into()), command: "run".into(), now_unix_s };
/// let on_bus = RigOnBus::open(&rig, &["can0".to_owned()], Pace::Free, &journals)?;
/// let evidence = Evidence::OnRecord { drills: "drills".into(), latency: "latency".into(), now_unix_s };
/// let terms = Terms { evidence, needs_realtime: true, ignores_latency: false, ignores_bus_budget: false };
/// let is_interrupted = Arc::new(AtomicBool::new(false));
/// let outcome = on_bus.run(&terms, 10.0, &is_interrupted, |_| (), |news| println!("{news:?}"))?;
/// println!("{:?}", outcome.played?);
/// # Ok(())
/// # }
/// ```
pub struct RigOnBus<For = Operation> {
    purpose: PhantomData<For>,
    rig: config::Rig,
    runner: OnInterfaces,
    memory: Result<(), Refusal>,
    orders: Option<Arc<Orders>>,
    /// The buses that cannot keep the cycle.
    overfull: Vec<String>,
    kept: Kept,
}

/// A rig on a bus that runs or is drilled: its devices stay as the boot writes them.
#[derive(Clone, Copy, Debug)]
pub enum Operation {}

/// Evidence that a rig may be enabled.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// For lockstep, in which nothing has a deadline and no drill is possible: the result of a drill of the same simulated drives
    /// in virtual time.
    InVirtualTime(Drilled),
    /// By the wall clock: records on disk.
    OnRecord {
        /// The folder with the records of drills on a bus.
        drills: PathBuf,
        /// The folder with the measurements of this computer.
        latency: PathBuf,
        /// The present moment in s since 1970, for the age of a measurement in messages.
        now_unix_s: u64,
    },
}

/// Conditions for enabling a rig.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Terms {
    /// Evidence for drives and computer.
    pub evidence: Evidence,
    /// Whether nothing is sent unless this computer grants real-time priority and locked memory.
    pub needs_realtime: bool,
    /// Whether the rig runs even if this computer has not proved the required timing. A recording has to note it.
    pub ignores_latency: bool,
    /// Whether the rig runs even if a bus with arbitration cannot keep its cycle.
    pub ignores_bus_budget: bool,
}

/// Why a rig did not come to run.
#[derive(Debug, Error)]
pub enum NotRun {
    /// The loop could not go on.
    #[error(transparent)]
    Run(#[from] RunError),
    /// There is no proof that the drives stop by themselves. Nothing was enabled.
    #[error(transparent)]
    Unproven(#[from] Unproven),
    /// This computer has not proved its timing. Nothing was sent.
    #[error(transparent)]
    Untimely(#[from] Untimely),
    /// A bus cannot keep the cycle in the worst case. Nothing was sent.
    #[error("the bus `{bus}` cannot keep the cycle")]
    Overfull {
        /// Its name.
        bus: String,
    },
    /// Priority or locked memory was demanded and not granted ([`HostedRun::priority`], [`HostedRun::memory`]). Nothing was sent.
    #[error("this computer does not grant what the loop needs to be in time")]
    NotGranted,
}

impl From<NotProven> for NotRun {
    fn from(error: NotProven) -> Self {
        match error {
            NotProven::Run(error) => Self::Run(error),
            NotProven::Unproven(error) => Self::Unproven(error),
        }
    }
}

/// Failure of the thread of the cycle.
#[derive(Debug, Error)]
pub enum ThreadError {
    /// The thread could not be started. Nothing was sent.
    #[error("thread of the cycle: {0}")]
    NotStarted(io::Error),
    /// The thread has panicked outside of the cycle; panics of the cycle stop the rig.
    #[error("the thread of the cycle has panicked")]
    Panicked,
}

/// Result of a run, or of a jog.
#[derive(Debug)]
pub struct HostedRun<T = Played> {
    /// How it ended.
    pub played: Result<T, NotRun>,
    /// Timing that this computer has proved; `None` if nothing has a deadline.
    pub timing: Option<Result<ProvenTiming, Untimely>>,
    /// Whether the loop had real-time priority.
    pub priority: Result<(), Refusal>,
    /// Whether memory was locked.
    pub memory: Result<(), Refusal>,
    /// Counters of the links.
    pub counts: LinkCounts,
    /// Emergency messages of the devices, the latest last.
    pub emergencies: Vec<EmergencyReport>,
    /// Reports of the drives on the fault that stopped the rig or kept it from running.
    pub errors: Vec<DriveError>,
    /// Faults that held nothing, each with the number of cycles in which it was seen.
    pub counted: Vec<(Fault, u32)>,
    /// SDO downloads of foreign nodes to the rig's nodes.
    pub foreign_downloads: u32,
    /// Faults of the devices of an EtherCAT segment, a line each.
    pub segment: Vec<String>,
    /// Standstill of this computer in the seconds before the fault, or before a boot or a read failed.
    pub standstill: Option<Standstill>,
    /// Objects that the devices got back after a bring-up.
    pub restored: Restored,
}

/// The findings of a drill. [`Subject::store`](crate::Subject::store) keeps it for the runs with these drives.
#[derive(Debug)]
pub struct DrillOutcome {
    /// Identities of the drives, and the reactions of their watchdogs.
    pub drilled: Result<([DriveIdentity; 2], Drilled), RunError>,
    /// Emergency messages of the devices, the latest last.
    pub emergencies: Vec<EmergencyReport>,
    /// Reports of the drives on the fault that kept them from being drilled.
    pub errors: Vec<DriveError>,
}

impl RigOnBus {
    /// Opens a rig that runs or is drilled. Nothing is sent.
    ///
    /// # Errors
    /// If a journal is open on an interface, an interface cannot be used or has a master in another process, or parts of the configuration
    /// do not fit together.
    pub fn open(rig: &config::Rig, interfaces: &[String], pace: Pace, journals: &Journals) -> Result<Self, OpenError> {
        journals.refuse_left(interfaces)?;
        Self::opened(rig, interfaces, pace, Kept::default())
    }
}

impl<For> RigOnBus<For> {
    /// Locks the memory of this process, if the system permits it. Opens the interfaces as their only master, one for each of the
    /// rig's buses in the order of the bus names.
    fn opened(rig: &config::Rig, interfaces: &[String], pace: Pace, kept: Kept) -> Result<Self, OpenError> {
        let memory = lock_memory();
        let plan = if rig.is_on_can() { Some(bus_plan(rig).map_err(RunError::from)?) } else { None };
        let mut overfull = Vec::new();
        if rig.is_on_ethercat() && rig.frames_take_time() {
            let setup = segment(rig).map_err(RunError::from)?;
            if !ethercat::Budget::new(&setup).is_schedulable() {
                overfull.extend(rig.buses.keys().nth(setup.bus.index()).cloned());
            }
        }
        for (setup, conditions) in plan.iter().flat_map(|(setup, all)| all.iter().map(move |one| (setup, *one))) {
            let budget = Budget::new(setup, conditions).map_err(RunError::from)?;
            if rig.frames_take_time() && !budget.is_schedulable() {
                overfull.extend(rig.buses.keys().nth(conditions.bus.index()).cloned());
            }
        }
        let wanted = |bus| plan.as_ref().map(|(setup, _)| open::filters(setup, bus)).unwrap_or_default();
        let link = open_buses(rig, interfaces, |_| vec![Role::Master], wanted)?;
        let runner = Runner::on_link(rig, link, SystemMetronome, pace)?;
        Ok(Self { purpose: PhantomData, rig: rig.clone(), runner, memory, orders: None, overfull, kept })
    }

    /// Whether memory is locked.
    pub fn memory(&self) -> &Result<(), Refusal> {
        &self.memory
    }

    /// Returns the system's facts about each CAN interface.
    pub fn facts(&self) -> impl Iterator<Item = &InterfaceFacts> {
        self.runner.place().link.can().map(SocketCan::facts)
    }

    /// Returns the interface of the segment, if nothing is plugged in there or the other end is down.
    pub fn unplugged(&self) -> Option<&str> {
        let segment = self.runner.place().link.segment()?;
        (!segment.has_carrier()).then(|| segment.interface())
    }

    /// Passes every frame to `tap`; own frames when they were seen on the bus.
    pub fn set_tap(&mut self, tap: Tap) {
        self.runner.set_tap(tap);
    }

    /// Passes the record of every cycle to `observer`.
    pub fn set_observer(&mut self, observer: Observer) {
        self.runner.set_observer(observer);
    }

    /// Adds a tap, an observer and a watch of errors. A watch of the boot has no effect, since the boot is reported as news.
    pub fn set_watch(&mut self, watch: Watch) {
        let Watch { tap, observer, errors, .. } = watch;
        tap.into_iter().for_each(|tap| self.set_tap(tap));
        observer.into_iter().for_each(|observer| self.set_observer(observer));
        errors.into_iter().for_each(|errors| self.set_error_watch(errors));
    }

    /// Lets a person attend the run by these orders, as [`Runner::play_attended`].
    pub fn set_orders(&mut self, orders: Arc<Orders>) {
        self.orders = Some(orders);
    }

    /// Passes to `watch` each drive's report on a fault that has stopped the rig.
    pub fn set_error_watch(&mut self, watch: ErrorWatch) {
        self.runner.set_error_watch(watch);
    }
}

impl RigOnBus {
    /// Boots, proves, enables, runs a scene of `duration_s`, stops and leaves, on a thread of its own. `each` receives every record
    /// of the scene on that thread, `tell` receives the news on the calling thread.
    ///
    /// # Errors
    /// If the thread cannot be started; the outcome names the reason if the rig could not run.
    pub fn run(
        self,
        terms: &Terms,
        duration_s: f64,
        is_interrupted: &Arc<AtomicBool>,
        each: impl FnMut(&CycleRecord) + Send,
        tell: impl FnMut(News),
    ) -> Result<HostedRun, ThreadError> {
        let orders = self.orders.clone();
        self.under(terms, is_interrupted, tell, |runner, rig, news| {
            let play = Play::on_bus(rig, duration_s);
            runner.boot()?;
            let permit = runner.prove(rig, &terms.proof())?;
            // Nobody listens if the thread that waits has died.
            let _ = news.send(News::Proved);
            Ok(runner.play_attended(&play, &permit, is_interrupted, orders.as_deref(), each)?)
        })
    }
}

impl RigOnBus<BringUp> {
    /// Accepts limits as [`Runner::accept_drive_limits`].
    pub fn accept_drive_limits(&mut self) {
        self.runner.accept_drive_limits();
    }

    /// Boots, proves, lowers the torque limits of the drives, enables them, guides the joints and stops, on a thread of its own.
    /// Nobody may hold the handle.
    ///
    /// # Errors
    /// If the thread cannot be started; the outcome names the reason if the joints could not be guided.
    pub fn jog(
        self,
        terms: &Terms,
        jog: &Jog<'_>,
        bounds: Bounds,
        is_interrupted: &Arc<AtomicBool>,
        tell: impl FnMut(News),
    ) -> Result<HostedRun<Jogged>, ThreadError> {
        self.under(terms, is_interrupted, tell, |runner, rig, news| {
            runner.boot()?;
            let permit = runner.prove_for_bring_up(rig, &terms.proof(), bounds)?;
            let _ = news.send(News::Proved);
            Ok(bringup::jog(runner, rig, jog, &permit, is_interrupted, |_, _| ())?)
        })
    }

    /// Boots for homing, proves, lowers the torque limits of the drives, enables them and lets each find its reference, on a thread
    /// of its own. It repeats this as often as asked, as [`bringup::home_repeatedly`](fn@bringup::home_repeatedly), and reports
    /// each homing ([`News::Homed`]). Nobody may hold the handle.
    ///
    /// # Errors
    /// If the thread cannot be started; the outcome names the reason if the drives could not be homed.
    pub fn home(
        self,
        terms: &Terms,
        (plan, times): (&HomePlan, u32),
        bounds: Bounds,
        is_interrupted: &Arc<AtomicBool>,
        tell: impl FnMut(News),
    ) -> Result<HostedRun<Repeated>, ThreadError> {
        self.under(terms, is_interrupted, tell, |runner, rig, news| {
            let mut prove = |runner: &mut Runner<dyn Place>, rig: &config::Rig, bounds: Bounds| {
                runner.prove_for_bring_up(rig, &terms.proof(), bounds)
            };
            let told = |homed: &Homed| drop(news.send(News::Homed(*homed)));
            Ok(bringup::home_repeatedly(runner, rig, plan, times, bounds, &mut prove, is_interrupted, told)?)
        })
    }

    /// Boots, proves, lowers the torque limits of the drives, and guides one joint after the other along its course, as
    /// [`bringup::tune_loop`](fn@bringup::tune_loop). It runs on a thread of its own, up to the first joint that does not complete
    /// its course. Nobody may hold the handle.
    ///
    /// # Errors
    /// If the thread cannot be started; the outcome names the reason if the joints could not be guided.
    pub fn tune_loop(
        self,
        terms: &Terms,
        plans: &[LoopPlan],
        is_interrupted: &Arc<AtomicBool>,
        tell: impl FnMut(News),
    ) -> Result<HostedRun<Vec<LoopTraced>>, ThreadError> {
        self.under(terms, is_interrupted, tell, |runner, rig, _| {
            let proof = terms.proof();
            let mut prove = |runner: &mut Runner<dyn Place>, rig: &config::Rig, bounds: Bounds| {
                runner.prove_for_bring_up(rig, &proof, bounds)
            };
            let mut traced: Vec<LoopTraced> = Vec::with_capacity(plans.len());
            for plan in plans {
                traced.push(bringup::tune_loop(runner, rig, plan, &mut prove, is_interrupted)?);
                if traced.last().is_none_or(|last| last.found.is_none()) {
                    break;
                }
            }
            Ok(traced)
        })
    }

    /// Takes the steps of a commissioning, as [`bringup::commission`](fn@bringup::commission), on a thread of its own. It passes
    /// reports on as they come ([`News::Stepped`]).
    ///
    /// # Errors
    /// If the thread cannot be started; the outcome names the reason if the rig could not be commissioned.
    pub fn commission(
        self,
        terms: &Terms,
        begin: Begin,
        person: &mut (dyn Person + Send),
        is_interrupted: &Arc<AtomicBool>,
        tell: impl FnMut(News),
    ) -> Result<HostedRun<Commissioned>, ThreadError> {
        self.under(terms, is_interrupted, tell, |runner, rig, news| {
            let mut attendant = OnTheBench { person, proof: terms.proof() };
            // Somebody listens for as long as this thread lives.
            let told = |report: &StepReport| drop(news.send(News::Stepped(Box::new(report.clone()))));
            Ok(bringup::commission(runner, rig, begin, &mut attendant, is_interrupted, told))
        })
    }

    /// Boots and listens to the force sensor, as [`Runner::sense`], on a thread of its own; nothing is enabled. It reports the
    /// readings every `row_s` ([`News::Sensed`]).
    ///
    /// # Errors
    /// If the thread cannot be started; the outcome names the reason if the rig could not be booted.
    pub fn sense(
        self,
        terms: &Terms,
        [time_s, row_s]: [f64; 2],
        is_interrupted: &Arc<AtomicBool>,
        tell: impl FnMut(News),
    ) -> Result<HostedRun<Wrenches>, ThreadError> {
        self.under(terms, is_interrupted, tell, |runner, rig, news| {
            runner.boot()?;
            let told = |from_s, wrenches| drop(news.send(News::Sensed(from_s, Box::new(wrenches))));
            Ok(runner.sense_in_rows(rig, [time_s, row_s], is_interrupted, told)?)
        })
    }

    /// Boots and tares the force sensor, as [`Runner::tare`], on a thread of its own; nothing is enabled.
    ///
    /// # Errors
    /// If there is no such thread; why there is no zero is in the outcome.
    pub fn tare(
        self,
        terms: &Terms,
        most_n: config::Positive,
        is_interrupted: &Arc<AtomicBool>,
        tell: impl FnMut(News),
    ) -> Result<HostedRun<Wrench>, ThreadError> {
        self.under(terms, is_interrupted, tell, |runner, rig, _| {
            runner.boot()?;
            Ok(runner.tare(rig, most_n, is_interrupted)?)
        })
    }

    /// Measures forces that a person applies to the tool, as [`bringup::pulls`](fn@bringup::pulls), on a thread of its own; nothing
    /// is enabled.
    ///
    /// # Errors
    /// If there is no such thread; what kept the sensor from being measured is in the outcome.
    pub fn pulls(
        self,
        terms: &Terms,
        force_n: f64,
        help: &mut (dyn FnMut(Task) -> bool + Send),
        is_interrupted: &Arc<AtomicBool>,
        tell: impl FnMut(News),
    ) -> Result<HostedRun<Vec<Pulled>>, ThreadError> {
        self.under(terms, is_interrupted, tell, |runner, rig, _| {
            Ok(bringup::pulls(runner, rig, force_n, &mut |_, task| help(task), is_interrupted)?)
        })
    }

    /// Lets a person guide the tool to points, as [`bringup::visit`](fn@bringup::visit), on a thread of its own; nothing is
    /// enabled. Returns the angles of the joints at each point.
    ///
    /// # Errors
    /// If the thread cannot be started; the outcome names the reason if the points could not be visited.
    pub fn visit(
        self,
        terms: &Terms,
        points: &[TipPoint],
        help: &mut (dyn FnMut(Task) -> bool + Send),
        is_interrupted: &Arc<AtomicBool>,
        tell: impl FnMut(News),
    ) -> Result<HostedRun<Vec<JointAngles>>, ThreadError> {
        self.under(terms, is_interrupted, tell, |runner, _, _| {
            Ok(bringup::visit(runner, points, &mut |_, task| help(task), is_interrupted)?)
        })
    }
}

impl<For> RigOnBus<For> {
    /// Does something with the rig under the terms, on a thread of its own, and leaves the network.
    fn under<T: Send>(
        self,
        terms: &Terms,
        is_interrupted: &Arc<AtomicBool>,
        tell: impl FnMut(News),
        act: impl FnOnce(&mut OnInterfaces, &config::Rig, &Sender<News>) -> Result<T, NotRun> + Send,
    ) -> Result<HostedRun<T>, ThreadError> {
        let (news, told) = channel();
        let Self { rig, mut runner, memory, overfull, kept, .. } = self;
        let mut kept = kept.written();
        let steps = news.clone();
        runner.set_boot_watch(boot_watch(news.clone(), Arc::clone(is_interrupted)));
        let outcome = on_thread_of_the_cycle(news, &told, tell, move |priority| {
            let timing = terms.timing(&rig, runner.pace(), [&priority, &memory].map(Result::is_ok));
            let overfull = overfull.join("`, `");
            let is_granted = priority.is_ok() && memory.is_ok();
            let played = match &timing {
                _ if terms.needs_realtime && !is_granted => Err(NotRun::NotGranted),
                _ if !terms.ignores_bus_budget && !overfull.is_empty() => Err(NotRun::Overfull { bus: overfull }),
                Some(Err(error)) if !terms.ignores_latency => Err(error.clone().into()),
                _ => {
                    let played = act(&mut runner, &rig, &steps);
                    runner.leave();
                    played
                }
            };
            let master = runner.master();
            let standstill = if played.is_ok() { runner.standstill_before_fault() } else { runner.standstill() };
            HostedRun {
                played,
                timing,
                priority,
                memory,
                counts: runner.counts(),
                emergencies: runner.master().networks().told(),
                errors: runner.errors().collect(),
                counted: master.cycle().faults().counted().collect(),
                foreign_downloads: master.networks().foreign_downloads(),
                segment: master.networks().findings(),
                standstill,
                restored: Restored::default(),
            }
        });
        // The interfaces are closed, also after a panic.
        let restored = kept.restore();
        outcome.map(|outcome| HostedRun { restored, ..outcome })
    }
}

impl RigOnBus {
    /// Boots, drills all watchdogs of the drives at rest, and leaves, on a thread of its own. Nobody may hold the handle.
    ///
    /// # Errors
    /// If the thread cannot be started; the outcome names the reason if the drives could not be drilled.
    pub fn drill(self, is_interrupted: &Arc<AtomicBool>, tell: impl FnMut(News)) -> Result<DrillOutcome, ThreadError> {
        let (news, told) = channel();
        let Self { rig, mut runner, .. } = self;
        runner.set_boot_watch(boot_watch(news.clone(), Arc::clone(is_interrupted)));
        // A drill on a computer that grants nothing is coarser, and says so by its resolution.
        let findings = news.clone();
        on_thread_of_the_cycle(news, &told, tell, move |_| {
            let drilled = drill(&mut runner, &rig, is_interrupted, &findings);
            runner.leave();
            let master = runner.master();
            DrillOutcome { drilled, emergencies: master.networks().told(), errors: runner.errors().collect() }
        })
    }
}

impl Terms {
    /// Returns the timing that this computer has proved; `None` if nothing has a deadline.
    fn timing(
        &self,
        rig: &config::Rig,
        pace: Pace,
        [has_priority, has_locked_memory]: [bool; 2],
    ) -> Option<Result<ProvenTiming, Untimely>> {
        match &self.evidence {
            Evidence::OnRecord { latency, now_unix_s, .. } if pace == Pace::Free => {
                Some(computer(has_priority, has_locked_memory).check(rig, latency, *now_unix_s))
            }
            // By the wall clock this is no proof, which the drives are asked for.
            _ => None,
        }
    }

    fn proof(&self) -> Proof {
        match &self.evidence {
            Evidence::InVirtualTime(drilled) => Proof::InVirtualTime(drilled.clone()),
            Evidence::OnRecord { drills, .. } => Proof::OnRecord(drills.clone()),
        }
    }
}

type OnInterfaces = Runner<OnLink<Interfaces, SystemMetronome>>;

fn drill(
    runner: &mut OnInterfaces,
    rig: &config::Rig,
    is_interrupted: &AtomicBool,
    news: &Sender<News>,
) -> Result<([DriveIdentity; 2], Drilled), RunError> {
    runner.boot()?;
    runner.check_simulation()?;
    let identities = runner.identities()?;
    // Somebody listens for as long as this thread lives.
    let found = |finding: &Finding| drop(news.send(News::Found(*finding)));
    Ok((identities, bringup::drill(runner, settling_on_bus(rig), is_interrupted, found)?))
}

/// Does the work on a thread of its own, with real-time priority if that is granted, and returns its result.
fn on_thread_of_the_cycle<R: Send>(
    news: Sender<News>,
    told: &Receiver<News>,
    tell: impl FnMut(News),
    work: impl FnOnce(Result<(), Refusal>) -> R + Send,
) -> Result<R, ThreadError> {
    thread::scope(|scope| {
        let thread = thread::Builder::new().name("cycle".to_owned()).spawn_scoped(scope, move || {
            let priority = run_first();
            // Somebody listens for as long as this thread lives.
            let _ = priority.as_ref().map_err(|refusal| news.send(News::Refused(refusal.to_string())));
            work(priority)
        });
        let thread = thread.map_err(ThreadError::NotStarted)?;
        told.iter().for_each(tell);
        thread.join().map_err(|_| ThreadError::Panicked)
    })
}
