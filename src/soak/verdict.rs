//! Attribution of faults: the changes of state of a run against the required reactions to its injections.

use serde::{Deserialize, Serialize};

mod clock;
#[cfg(test)]
mod tests;

use super::draw::Machine;
use super::excuse::{Excuse, Excused};
use super::invariant::{Invariant, Violation};
use super::nature;
use super::script::Script;
use super::session::{End, Event, Play};
use super::tolerance;
use clock::{Clock, HAND_FAULTS};
use yieldwall_config::injection::{Ending, Injection, Kind, Medium, Target};
use yieldwall_motion::guard::fault::Stage;
use yieldwall_motion::guard::{Fault, Reaction, State};

/// Slack of moments in s, far below a cycle.
const SLACK_S: f64 = 1e-9;
/// Cycles per reaction to a hand alone, on average over a run, below which it is a false alarm that comes all the time.
const LEAST_CYCLES_BETWEEN: usize = 200;

/// One injection and what followed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Followed {
    /// Name of the kind.
    pub name: String,
    /// Whether the rig ran when it began, or was booted with it.
    pub met_running: bool,
    /// Whether what had to follow did; `None` among several at once, or with another duration or size than usual.
    pub as_expected: Option<bool>,
}

/// A fault that was the cause of a change of state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObservedFault {
    /// Name of the fault's row.
    pub name: String,
    /// Reaction.
    pub reaction: String,
    /// Cycles from the first observable sign to the reaction, where the injection says when that was.
    pub cycles: Option<u32>,
    /// The row's bound in cycles of this rig, likewise.
    pub bound: Option<u32>,
}

/// All that followed in a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Verdict {
    pub(super) injections: Vec<Followed>,
    pub(super) faults: Vec<ObservedFault>,
    pub(super) violations: Vec<Violation>,
    pub(super) excused: Excused,
}

impl Verdict {
    /// Notes what did not hold, or counts it if it has an excuse.
    fn found(&mut self, invariant: Invariant, event: &Event, excuse: Option<Excuse>, seen: impl FnOnce() -> String) {
        match excuse {
            Some(excuse) => self.excused.note(invariant, excuse),
            None => self.violations.push(violation(invariant, event, seen())),
        }
    }
}

/// Judges the changes of state of a run.
pub(super) fn judge(machine: &Machine, script: &Script, play: &Play) -> Verdict {
    let mut verdict = Verdict::default();
    let clock = Clock::of(machine, play.scene_from_ns.unwrap_or(u64::MAX));
    for (at, event) in play.events.iter().enumerate() {
        if let Some(fault) = event.cause {
            let reaction = reaction_of(event);
            check_row(event, fault, reaction, &mut verdict);
            let is_new = at == 0 || play.events[at - 1].cause != event.cause || event.to != event.from;
            if is_new && reaction.is_some() {
                verdict.faults.push(ObservedFault {
                    name: fault.row().name.to_owned(),
                    reaction: format!("{:?}", reaction.unwrap_or(Reaction::Count)),
                    cycles: None,
                    bound: None,
                });
            }
        }
    }
    let refusals: Vec<ObservedFault> = play.events.iter().filter_map(refusal).collect();
    if script.is_tangle {
        verdict.faults.extend(refusals);
        let met = |injection: &Injection| state_at(play, &clock, injection.start_s) == Some(State::Running);
        script.injections.iter().for_each(|_| verdict.excused.note(Invariant::Reaction, Excuse::SeveralAtOnce));
        verdict.injections.extend(script.injections.iter().map(|injection| Followed {
            name: injection.kind.row().name.to_owned(),
            met_running: met(injection),
            as_expected: None,
        }));
        return verdict;
    }
    verdict.faults = refusals;
    attribute(machine, &clock, script, play, &mut verdict);
    verdict
}

/// Returns the reaction to which a change of state belongs.
fn reaction_of(event: &Event) -> Option<Reaction> {
    match (event.from, event.to) {
        (from, to) if from == to && !to.is_latched() => None,
        (_, State::Holding) => Some(Reaction::Freeze),
        (_, State::Stopping) => Some(Reaction::StopRamp),
        // The end of a ramp is no reaction of its own.
        (State::Stopping, State::Stopped) if event.cause == event.cause_before => None,
        (_, State::Stopped | State::Disabled) => Some(Reaction::QuickStop),
        (_, State::Lost) => Some(Reaction::Silence),
        _ => None,
    }
}

/// Returns the fault for which a rig at rest was not enabled.
fn refusal(event: &Event) -> Option<ObservedFault> {
    let fault = event.cause.filter(|_| (event.from, event.to) == (State::Idle, State::Idle))?;
    Some(ObservedFault { name: fault.row().name.to_owned(), reaction: "Refused".to_owned(), cycles: None, bound: None })
}

/// Checks reaction: the reaction is one of the fault's row, and the state is the row's.
fn check_row(event: &Event, fault: Fault, reaction: Option<Reaction>, verdict: &mut Verdict) {
    let Some(reaction) = reaction else { return };
    let row = fault.row();
    let holds = match reaction {
        Reaction::Freeze | Reaction::StopRamp => row.steps.iter().any(|step| step.reaction == reaction),
        // A quick stop ends in the row's own state, which may be Lost; what is milder leads there in Enabling.
        _ => row.steps.iter().any(|step| {
            let stops = step.reaction.max(Reaction::QuickStop);
            // A ramp that cannot be followed ends in a quick stop, and so does whatever shows while enabling.
            let is_ramp = step.reaction == Reaction::StopRamp && row.stage == Stage::Motion;
            let is_milder = event.from == State::Enabling || is_ramp;
            row.final_state(stops) == event.to && (step.reaction >= Reaction::QuickStop || is_milder)
        }),
    };
    if !holds {
        let (from, to) = (event.from, event.to);
        let seen = format!("{} led from {from:?} to {to:?}, which is not in its row", row.name);
        verdict.violations.push(violation(Invariant::Reaction, event, seen));
    }
}

fn violation(invariant: Invariant, event: &Event, seen: String) -> Violation {
    Violation { invariant, cycle: event.cycle, time_s: event.sync_ns as f64 * 1e-9, seen }
}

/// Returns the state in which the rig was at `time_s` since the scene began; `None` if the scene never began.
fn state_at(play: &Play, clock: &Clock, time_s: f64) -> Option<State> {
    play.scene_from_ns?;
    // The cycle in which an injection begins already shows it.
    let before = play.events.iter().take_while(|event| clock.time_s(event) < time_s - 0.5 * clock.period_s);
    before.last().map(|event| event.to)
}

fn attribute(machine: &Machine, clock: &Clock, script: &Script, play: &Play, verdict: &mut Verdict) {
    if let [injection] = script.injections.as_slice()
        && nature::is_from_boot(injection.kind)
    {
        return judge_boot(injection, play, verdict);
    }
    let starts: Vec<f64> = script.injections.iter().map(|injection| injection.start_s).collect();
    let first = starts.first().copied().unwrap_or(f64::INFINITY);
    let early = play.events.iter().take_while(|event| clock.time_s(event) < first - 0.5 * clock.period_s);
    for event in early {
        check_alone(clock, event, verdict);
    }
    // An injection that had not begun when the run ended brought nothing about.
    let end_s = clock.scene_s(play.simulated_s);
    let end_s = if play.end == End::Broken { end_s - clock.heartbeat_s } else { end_s };
    for (at, injection) in
        script.injections.iter().enumerate().filter(|(_, known)| known.start_s < end_s + 0.5 * clock.period_s)
    {
        let until = starts.get(at + 1).copied().unwrap_or(f64::INFINITY) - 0.5 * clock.period_s;
        let from = injection.start_s - 0.5 * clock.period_s;
        let window: Vec<&Event> =
            play.events.iter().filter(|event| (from..until).contains(&clock.time_s(event))).collect();
        let wanted = Wanted::of(machine, injection);
        judge_window((clock, &wanted), injection, &script.injections[..at], &window, play, verdict);
    }
    let alone = verdict.faults.iter().filter(|seen| HAND_FAULTS.iter().any(|fault| fault.row().name == seen.name));
    let alone = alone.count();
    if alone * LEAST_CYCLES_BETWEEN > play.cycles as usize
        && let Some(event) = play.events.last()
    {
        let excuse = (alone < tolerance::LEAST_REACTIONS).then_some(Excuse::TooFew);
        verdict.found(Invariant::FalseAlarm, event, excuse, || "the hand is held all the time".to_owned());
    }
}

/// Judges an event without an injection that could have caused it.
fn check_alone(clock: &Clock, event: &Event, verdict: &mut Verdict) {
    if let Some(fault) = event.cause
        && let Some(reaction) = reaction_of(event)
    {
        verdict.faults.push(seen(fault, reaction, None));
        verdict.found(Invariant::FalseAlarm, event, clock.nature_of(event, fault), || {
            format!("{} led to {:?}, and nothing was injected", fault.row().name, event.to)
        });
    }
}

fn seen(fault: Fault, reaction: Reaction, measured: Option<(u32, u32)>) -> ObservedFault {
    ObservedFault {
        name: fault.row().name.to_owned(),
        reaction: format!("{reaction:?}"),
        cycles: measured.map(|(cycles, _)| cycles),
        bound: measured.map(|(_, bound)| bound),
    }
}

/// Required consequence of an injection on a machine; on buses of both kinds, the consequence on one of them.
struct Wanted {
    faults: Vec<Fault>,
    endings: Vec<Ending>,
    medium: Medium,
}

impl Wanted {
    fn of(machine: &Machine, injection: &Injection) -> Self {
        let row = injection.kind.row();
        let each = machine.rig.media(injection).map(|medium| row.expected_on(medium));
        let (mut faults, mut endings) = (Vec::new(), Vec::new());
        for expected in each {
            faults.extend_from_slice(expected.faults);
            endings.push(expected.ending);
        }
        Self { faults, endings, medium: machine.rig.medium(injection) }
    }
}

fn judge_window(
    (clock, wanted): (&Clock, &Wanted),
    injection: &Injection,
    earlier: &[Injection],
    window: &[&Event],
    play: &Play,
    verdict: &mut Verdict,
) {
    let row = injection.kind.row();
    let met_running = state_at(play, clock, injection.start_s) == Some(State::Running);
    let usual = nature::usual(injection.kind, injection.start_s, clock.period_s).on(injection.target);
    let usual = if nature::is_alike_at_any_size(injection.kind) { usual.sized(injection.size) } else { usual };
    let is_usual = usual == *injection;
    let mut latched = None;
    let mut has_expected = wanted.faults.is_empty();
    let at_once = nature::shows_at_once(injection.kind, wanted.medium);
    for event in window {
        let (Some(fault), Some(reaction)) = (event.cause, reaction_of(event)) else {
            if event.to.is_latched() && latched.is_none() {
                latched = Some(event.to);
            }
            continue;
        };
        if event.to.is_latched() && latched.is_none() {
            latched = Some(event.to);
        }
        // The same error, twice as large.
        let is_worse = fault == Fault::Runaway && wanted.faults.contains(&Fault::FollowingError);
        // A hand that is out of bounds may load the arm beyond what its torques explain.
        let is_forced = fault == Fault::ForceImplausible && injection.target == Target::Hand;
        let is_expected = wanted.faults.contains(&fault) || is_worse || is_forced;
        has_expected |= is_expected;
        if met_running && is_usual && !is_expected {
            let is_filled = clock.has_been_filled(event, fault, reaction, earlier);
            let excuse = clock.nature_of(event, fault).or(is_filled.then_some(Excuse::EarlierInjection));
            verdict.found(Invariant::FalseAlarm, event, excuse, || {
                let name = fault.row().name;
                format!("{name} led to {:?} under {}, which is not known to bring it", event.to, row.name)
            });
        }
        let is_first = window.iter().position(|other| other.cause == event.cause && other.to == event.to)
            == window.iter().position(|other| std::ptr::eq(*other, *event));
        let mut measured = (met_running && is_first && at_once.contains(&fault))
            .then(|| measure((clock, wanted, play), injection, event, fault, reaction))
            .flatten();
        if let Some((cycles, bound)) = measured
            && cycles > bound
        {
            // A jump that is no more than motion may show when it ends, or not at all.
            let is_small =
                injection.kind == Kind::EncoderJump && injection.size.abs() <= tolerance::JUMP_CYCLES * clock.turn_rad;
            measured = measured.filter(|_| !is_small);
            verdict.found(Invariant::Reaction, event, is_small.then_some(Excuse::SmallJump), || {
                let name = fault.row().name;
                format!("{name} under {} led to {:?} after {cycles} cycles, at most {bound}", row.name, event.to)
            });
        }
        verdict.faults.push(seen(fault, reaction, measured));
    }
    let ends = wanted.endings.iter().any(|ending| match ending {
        Ending::GoesOn => latched.is_none(),
        Ending::Latched(states) => latched.is_some_and(|state| states.contains(&state)),
        Ending::NotEnabled => true,
        Ending::DrivesStop => play.end == End::MasterGone,
    });
    let goes_on = wanted.endings == [Ending::GoesOn];
    let has_time =
        play.end == End::MasterGone || clock.scene_s(play.simulated_s) >= shows_by_s(clock, injection, wanted);
    let as_expected = (met_running && is_usual && has_time).then_some(ends && (has_expected || goes_on));
    let fails = as_expected == Some(false) && nature::is_certain(injection.kind);
    let pre_empted = pre_empted(clock, injection, wanted, window).filter(|_| fails);
    if let Some(excuse) = pre_empted {
        verdict.excused.note(Invariant::Reaction, excuse);
    }
    let as_expected = as_expected.filter(|_| pre_empted.is_none());
    if fails && pre_empted.is_none() {
        let message = format!(
            "{} on {} at {:.3} s had to end in {:?} by {:?}, and the rig went {:?}",
            row.name,
            injection.target.name(),
            injection.start_s,
            wanted.endings,
            wanted.faults.iter().map(|fault| fault.row().name).collect::<Vec<_>>(),
            window.iter().map(|event| (event.to, event.cause.map(|fault| fault.row().name))).collect::<Vec<_>>(),
        );
        let cycle = ((injection.start_s + clock.scene_from_ns as f64 * 1e-9) / clock.period_s) as u32;
        let time_s = injection.start_s + clock.scene_from_ns as f64 * 1e-9;
        let cycle = window.first().map_or(cycle, |event| event.cycle);
        verdict.violations.push(Violation { invariant: Invariant::Reaction, cycle, time_s, seen: message });
    }
    verdict.injections.push(Followed { name: row.name.to_owned(), met_running, as_expected });
}

/// Returns the latest moment of the reaction to an injection, in s since the scene began.
fn shows_by_s(clock: &Clock, injection: &Injection, wanted: &Wanted) -> f64 {
    let bounds = wanted.faults.iter().flat_map(|fault| fault.row().steps).map(|step| clock.cycles(step.bound));
    let over_s = nature::over_s(injection);
    let from_s = if over_s.is_finite() { over_s } else { injection.start_s };
    from_s + f64::from(bounds.max().unwrap_or_default() + 2) * clock.period_s
}

/// Returns the natural reason why another fault stopped the rig before the injection had to show, if one did. The rig then ends
/// in that fault's state.
fn pre_empted(clock: &Clock, injection: &Injection, wanted: &Wanted, window: &[&Event]) -> Option<Excuse> {
    let faults = &wanted.faults;
    let bounds = faults.iter().flat_map(|fault| fault.row().steps).map(|step| clock.cycles(step.bound));
    let shows_s = injection.start_s + nature::shows_within_s(injection);
    let due_s = shows_s + f64::from(bounds.max()?) * clock.period_s;
    let first = window.iter().find(|event| event.from == State::Running && event.cause.is_some())?;
    let cause = first.cause.filter(|cause| !faults.contains(cause))?;
    clock.nature_of(first, cause).filter(|_| clock.time_s(first) <= due_s)
}

/// Cycles from the first cycle at or after the injection's start to the event, and the bound of the row's step.
fn measure(
    (clock, wanted, play): (&Clock, &Wanted, &Play),
    injection: &Injection,
    event: &Event,
    fault: Fault,
    reaction: Reaction,
) -> Option<(u32, u32)> {
    let step = fault.row().steps.iter().find(|step| {
        step.reaction == reaction
            || (reaction >= Reaction::QuickStop && fault.row().final_state(step.reaction) == event.to)
    })?;
    // The cycle that begins with the injection is the first.
    let start_ns = clock.scene_from_ns as f64 + (injection.start_s - SLACK_S) * 1e9;
    let first_ns = play.syncs_ns.iter().map(|sync_ns| *sync_ns as f64).find(|sync_ns| *sync_ns >= start_ns)?;
    // Cycles that did not run count too. A cycle on a segment may be longer than its period, but not by a half.
    let since = (event.sync_ns as f64 - first_ns) * 1e-9 / clock.period_s;
    let cycles = since.round().max(0.0) as u32 + 1;
    // What a cycle reads of a device on a segment was taken before the cycle began.
    let before = u32::from(wanted.medium == Medium::Ethercat);
    let within = (nature::shows_within_s(injection) / clock.period_s).ceil() as u32;
    Some((cycles, clock.cycles(step.bound) + before + within))
}

fn judge_boot(injection: &Injection, play: &Play, verdict: &mut Verdict) {
    let row = injection.kind.row();
    let ran = play.events.iter().any(|event| event.to == State::Running);
    let refused = play.end == End::NotBooted || !ran;
    if !refused
        && nature::is_certain(injection.kind)
        && let Some(event) = play.events.iter().find(|event| event.to == State::Running)
    {
        let message = format!("the rig ran in spite of {} on {}", row.name, injection.target.name());
        verdict.violations.push(violation(Invariant::Reaction, event, message));
    }
    for event in &play.events {
        if let (Some(fault), Some(reaction)) = (event.cause, reaction_of(event)) {
            verdict.faults.push(seen(fault, reaction, None));
        }
    }
    verdict.injections.push(Followed { name: row.name.to_owned(), met_running: true, as_expected: Some(refused) });
}
