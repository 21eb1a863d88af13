//! `yieldwall latency`: the timing that this computer can guarantee.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use serde_json::{Value, json};

use super::clock::now_unix_s;
use super::events::{Event, Events, Stream};
use super::failure::{Exit, Failure};
use super::fit;
use super::interrupt::{on_interrupt, unless};
use super::keep::state_folder;
use super::on_bus::{link_failure, other_master, warn};
use super::output::Output;
use yieldwall_bus::{LISTENING, Signs};
use yieldwall_link::{CobFilter, InterfaceFacts, Role, SocketCan, SocketCanSettings, Stamps};
use yieldwall_record::trusted;
use yieldwall_run::host::system::{Load, Readiness, Refusal, SystemMetronome, computer, lock_memory, run_first};
use yieldwall_run::host::{
    Histogram, Latency, Measured, PROBE, PROVING_CYCLES, REDUCED_FORCE_N, REDUCED_SPEED_M_PER_S, STOCK_CYCLES, Stored,
    Tier, measure_latency,
};
use yieldwall_service::listen;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Also send a frame (7FFh) in every cycle, and measure its round trip on this interface's bus
    #[arg(long, value_name = "INTERFACE")]
    bus: Option<String>,
    /// Seconds to measure; the highest tier needs 100 000 at a cycle of 1 ms
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = super::usage::seconds)]
    duration: f64,
    /// Cycle time in us, 100 to 100 000
    #[arg(long, value_name = "US", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(100..=100_000))]
    period_us: u32,
    /// Load every processor, the memory and the disk, until the measurement ends or Ctrl-C
    #[arg(long)]
    load: bool,
    #[command(flatten)]
    pub(super) stream: Stream,
}

/// Interval between updates of a running measurement.
const REFRESH: Duration = Duration::from_millis(50);

/// Current state of a measurement, for another thread.
#[derive(Debug, Default)]
struct SoFar {
    cycles: AtomicU64,
    worst_ns: AtomicU64,
    missed: AtomicU64,
    lost: AtomicU64,
}

impl SoFar {
    /// Real-time: yes.
    fn take(&self, latency: &Latency) {
        self.cycles.store(latency.wake.count(), Ordering::Relaxed);
        self.worst_ns.store(latency.wake.max().as_nanos() as u64, Ordering::Relaxed);
        self.missed.store(latency.missed, Ordering::Relaxed);
        self.lost.store(latency.lost, Ordering::Relaxed);
    }

    /// Reports on the measurement until it is over: its state on a terminal; otherwise each wake-up that was later than all before
    /// it.
    fn watch(&self, arguments: &Arguments, events: &Events, mut is_over: impl FnMut() -> bool) {
        let period_s = f64::from(arguments.period_us) * 1e-6;
        let text = format!("cycle {} us, for {} s", arguments.period_us, arguments.duration);
        events.tell(&Event::new("begun", Some(0.0), text));
        let mut told_ns = 0;
        loop {
            let is_last = is_over();
            let of = |number: &AtomicU64| number.load(Ordering::Relaxed);
            let (cycles, worst_ns, missed, lost) =
                (of(&self.cycles), of(&self.worst_ns), of(&self.missed), of(&self.lost));
            let (time_s, worst_us) = (cycles as f64 * period_s, worst_ns as f64 * 1e-3);
            let frames = if arguments.bus.is_some() { format!("  frames lost {lost}") } else { String::new() };
            events.show(&format!(
                "{time_s:>8.1} of {} s  worst wake-up {worst_us:.0} us late  missed {missed}{frames}",
                arguments.duration
            ));
            if worst_ns > told_ns {
                told_ns = worst_ns;
                let event = Event::new("late", Some(time_s), format!("new worst wake-up: {worst_us:.0} us late"));
                events.tell(&event.with("worst_us", worst_us).with("cycles", cycles).with("missed", missed));
            }
            if is_last {
                return;
            }
            thread::sleep(REFRESH);
        }
    }
}

/// Details of a measurement, besides the times.
struct LatencyDetails {
    record: Option<Stored>,
    /// The load under which it was measured.
    load: Option<String>,
    /// Facts on the computer, a line each.
    computer: Vec<String>,
    /// Facts on the interface, and the source of its timestamps.
    interface: Option<(InterfaceFacts, Stamps)>,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let events = Events::of(output);
    let end = measure(arguments, &events, output);
    events.end(&end);
    end
}

fn measure(arguments: &Arguments, events: &Events, output: &mut Output) -> Result<(), Failure> {
    let duration = arguments.duration;
    if !(duration > 0.0 && duration <= 1e7) {
        let message = format!("--duration {duration}: write more than 0 and at most 10 000 000 seconds");
        return Err(Failure::new(Exit::Usage, message, "write, for example, --duration 60"));
    }
    // The results need a folder before the measurement begins, since it may take a day.
    let folder = state_folder("latency").ok_or_else(no_home)?;
    trusted::make_folder(&folder).map_err(|error| cannot_keep(&folder, &error))?;
    let period = Duration::from_micros(arguments.period_us.into());
    let cycles = (duration / period.as_secs_f64()).ceil() as u64;
    let is_interrupted = on_interrupt()?;
    let memory = lock_memory();
    let mut link = match &arguments.bus {
        Some(bus) => Some(open(bus, &is_interrupted)?),
        None => None,
    };
    let facts = link.as_ref().map(|link| link.facts().clone());
    if let Some(facts) = &facts {
        facts.advice().into_iter().for_each(|advice| warn(output, advice));
        if let Some((why, help)) = facts.attachment.too_slow_for(arguments.period_us) {
            warn(output, format!("`{}` {why}: {help}", facts.name));
        }
    }
    let load = match arguments.load {
        true => Some(Load::start(&folder).map_err(|error| cannot_load(&error))?),
        false => None,
    };
    let loaded = load.as_ref().map(Load::told);
    if let Some(load) = &loaded {
        output.news(&format!("load      started: {load}"))?;
    }
    let so_far = Arc::new(SoFar::default());
    let measuring = {
        let (is_interrupted, so_far) = (Arc::clone(&is_interrupted), Arc::clone(&so_far));
        move || {
            let priority = run_first();
            let now = || SystemMetronome.now();
            let each = |latency: &Latency| {
                so_far.take(latency);
                unless(&is_interrupted)
            };
            let latency = measure_latency(&mut SystemMetronome, now, link.as_mut(), period, cycles, each);
            (priority, latency, link.map(|link| link.stamps()))
        }
    };
    let thread = thread::Builder::new().name("cycle".to_owned()).spawn(measuring);
    let thread = thread.map_err(|error| Failure::new(Exit::Internal, format!("thread of the cycle: {error}"), ""))?;
    so_far.watch(arguments, events, || thread.is_finished());
    events.clear();
    let measured = thread.join();
    drop(load);
    if loaded.is_some() {
        output.news("load      stopped")?;
    }
    let (priority, latency, stamps) =
        measured.map_err(|_| Failure::new(Exit::Internal, "the thread of the cycle has panicked", ""))?;
    // Without a wake-up there is nothing to keep.
    let kept = match latency.wake.count() {
        0 => Ok(None),
        _ => keep(arguments, &latency, [&priority, &memory].map(Result::is_ok), loaded.clone(), &folder).map(Some),
    };
    let told = LatencyDetails {
        record: kept.as_ref().ok().cloned().flatten(),
        load: loaded,
        computer: Readiness::read(Path::new("/"), arguments.bus.as_deref()).told(period, arguments.bus.as_deref()),
        interface: facts.zip(stamps),
    };
    let end = kept.map(|_| ());
    events.end(&end);
    let refused: Vec<_> = [&priority, &memory].into_iter().filter_map(|granted| granted.as_ref().err()).collect();
    if !output.is_json() {
        output.result(&text(arguments, &latency, &refused, &told))?;
        return end;
    }
    output.end(document(arguments, &latency, &refused, &told), end)
}

/// Saves the measurement for `run --bus`, and returns its path.
fn keep(
    arguments: &Arguments,
    latency: &Latency,
    granted: [bool; 2],
    load: Option<String>,
    folder: &Path,
) -> Result<Stored, Failure> {
    let [has_priority, has_locked_memory] = granted;
    let computer = computer(has_priority, has_locked_memory);
    let measured = Measured::new(computer, arguments.period_us, latency.lateness(), now_unix_s()).under(load);
    measured.store(folder).map_err(|error| cannot_keep(folder, &error))
}

/// Returns the failure that the measurement cannot be saved.
fn cannot_keep(folder: &Path, error: &std::io::Error) -> Failure {
    Failure::new(Exit::Usage, format!("{}: {error}", folder.display()), "make this folder writable")
}

/// Returns the failure that the load cannot be started.
fn cannot_load(error: &std::io::Error) -> Failure {
    Failure::new(
        Exit::Usage,
        format!("the load cannot be started: {error}"),
        "allow this user more threads, or omit --load",
    )
}

/// Returns the failure that there is no place for measurements.
pub(super) fn no_home() -> Failure {
    let message = "there is no folder for the record of a measurement: neither XDG_STATE_HOME nor HOME is set";
    Failure::new(Exit::Usage, message, "set XDG_STATE_HOME to a folder that is kept")
}

/// Returns the link for the probes, on a bus that has no master.
fn open(bus: &str, is_over: &AtomicBool) -> Result<SocketCan, Failure> {
    let failed = |error| link_failure(&error);
    let link = SocketCan::open(&SocketCanSettings {
        interface: bus.to_owned(),
        process: vec![CobFilter::only(PROBE)],
        services: Vec::new(),
        bit_rate: None,
        receive_buffer: 1 << 20,
        roles: vec![Role::Master],
        hears_others: false,
    })
    .map_err(failed)?;
    let mut ear = SocketCan::open(&SocketCanSettings::everything(bus)).map_err(failed)?;
    let signs = Signs::of_any_master();
    match listen(&mut ear, LISTENING, is_over, |frame| signs.find(frame)) {
        Some(heard) => {
            Err(other_master(format!("a master is on this bus; nothing was sent. Heard: {heard}, on `{bus}`"), &heard))
        }
        None => Ok(link),
    }
}

/// Explains the tier for this program.
fn verdict(latency: &Latency, period_us: u32) -> String {
    let lateness = latency.lateness();
    let (tier, proven, cycles) = (lateness.tier(period_us), lateness.proven(period_us), lateness.cycles);
    match tier {
        _ if tier != proven && proven == Tier::C => {
            format!("{tier} so far: {cycles} of {STOCK_CYCLES} cycles that prove it; until then tier C")
        }
        Tier::A if proven == Tier::A => "A, real-time: every command mode and limit".to_owned(),
        Tier::A => {
            format!("A, real-time, so far: {cycles} of {PROVING_CYCLES} cycles that prove it; until then tier B")
        }
        Tier::B => format!(
            "B, stock kernel, no bound on lateness; limits: tool speed {REDUCED_SPEED_M_PER_S} m/s, force {REDUCED_FORCE_N} N, torque mode only \
             if the drill shows that the drives stop within 10 ms"
        ),
        Tier::C => "C: simulation only (lockstep or virtual time); try a slower cycle".to_owned(),
    }
}

fn text(arguments: &Arguments, latency: &Latency, refused: &[&Refusal], told: &LatencyDetails) -> String {
    let verdict = format!("tier {}", verdict(latency, arguments.period_us));
    let mut lines = vec![fit::filled("verdict   ", "          ", &verdict, fit::USUAL)];
    match refused {
        [] => lines.push("realtime  SCHED_FIFO and locked memory".to_owned()),
        refused => lines.extend(refused.iter().map(|refusal| format!("realtime  {refusal}"))),
    }
    lines.extend(told.computer.iter().cloned());
    if let Some((facts, stamps)) = &told.interface {
        lines.push(format!("adapter   {}", facts.told()));
        let Stamps { hardware, kernel, none } = stamps;
        lines.push(format!("stamps    frames stamped by controller {hardware}, kernel {kernel}, program {none}"));
    }
    lines.push(match &told.load {
        Some(load) => format!("load      {load}"),
        None => "load      none (--load measures a busy computer)".to_owned(),
    });
    let cycles = latency.wake.count();
    lines.push(format!("cycles    {cycles} of {} us, {} missed", arguments.period_us, latency.missed));
    lines.push(format!("wake-up   lateness: {}", shares(&latency.wake)));
    if let Some(bus) = &arguments.bus {
        lines.push(format!("frame     round trip on {bus}: {}", shares(&latency.round_trip)));
        lines.push(format!("          {} lost", latency.lost));
    }
    lines.extend(bars(&latency.wake));
    lines.extend(told.record.as_ref().map(|Stored { path, is_earlier }| {
        let earlier = if *is_earlier { " (an earlier, longer measurement, which still counts)" } else { "" };
        format!("record    {}{earlier}", path.display())
    }));
    lines.join("\n") + "\n"
}

fn shares(times: &Histogram) -> String {
    let us = |share| 1e6 * times.quantile(share).as_secs_f64();
    format!(
        "p50 {:.0}, p99 {:.0}, p99.9 {:.0}, p99.99 {:.0}, max {:.0} us",
        us(0.5),
        us(0.99),
        us(0.999),
        us(0.9999),
        us(1.0)
    )
}

/// Returns the histogram in doublings, a bar each; bars are logarithmic, so that one late wake-up among millions shows.
fn bars(times: &Histogram) -> Vec<String> {
    let mut doublings: Vec<(u64, u64)> = Vec::new();
    for (time, count) in times.classes() {
        let us = (time.as_micros() as u64 + 1).next_power_of_two();
        match doublings.last_mut() {
            Some((last, sum)) if *last == us => *sum += count,
            _ => doublings.push((us, count)),
        }
    }
    let bar = |count: u64| "#".repeat(4 * (count.ilog10() as usize + 1));
    doublings.into_iter().map(|(us, count)| format!("  < {us:>7} us {count:>10}  {}", bar(count))).collect()
}

fn document(arguments: &Arguments, latency: &Latency, refused: &[&Refusal], told: &LatencyDetails) -> Value {
    let lateness = latency.lateness();
    let times = |times: &Histogram| {
        let us = |share| 1e6 * times.quantile(share).as_secs_f64();
        let classes = times.classes().map(|(time, count)| json!([1e6 * time.as_secs_f64(), count]));
        json!({
            "count": times.count(),
            "p50_us": us(0.5),
            "p99_us": us(0.99),
            "p999_us": us(0.999),
            "p9999_us": us(0.9999),
            "max_us": us(1.0),
            "histogram": classes.collect::<Vec<_>>(),
        })
    };
    json!({
        "period_us": arguments.period_us,
        "wake_up": times(&latency.wake),
        "missed": latency.missed,
        "bus": arguments.bus,
        "round_trip": arguments.bus.as_ref().map(|_| times(&latency.round_trip)),
        "lost": latency.lost,
        "realtime_refused": refused.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "tier": lateness.tier(arguments.period_us),
        "proven_tier": lateness.proven(arguments.period_us),
        "verdict": verdict(latency, arguments.period_us),
        "record": told.record.as_ref().map(|stored| &stored.path),
        "record_is_earlier": told.record.as_ref().map(|stored| stored.is_earlier),
        "load": told.load,
        "computer": told.computer,
        "adapter": told.interface.as_ref().map(|(facts, _)| facts.told()),
        "stamps": told.interface.as_ref().map(|(_, Stamps { hardware, kernel, none })| {
            json!({ "controller": hardware, "kernel": kernel, "program": none })
        }),
    })
}
