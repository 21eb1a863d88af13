//! Verdicts on changes of state, from invented events.

use super::super::draw::{Machine, Shipped};
use super::super::excuse::Excuse;
use super::super::invariant::Invariant;
use super::super::nature::usual;
use super::super::script::Script;
use super::super::session::{End, Event, Play};
use super::{Verdict, judge};
use yieldwall_config::injection::{Injection, Kind};
use yieldwall_motion::guard::{Fault, State};

/// The rig at 4 ms.
fn machine() -> Machine {
    Machine::draw(&Shipped::load().unwrap(), 5)
}

/// A change of state at `time_s` since the scene began.
fn event(time_s: f64, [from, to]: [State; 2], cause: Option<Fault>) -> Event {
    Event {
        cycle: (time_s / 4e-3) as u32,
        sync_ns: (time_s * 1e9) as u64,
        from,
        to,
        cause,
        cause_before: None,
        radius_m: 0.1,
        since_torque_limit: None,
        is_carried: false,
    }
}

fn stopping(time_s: f64, fault: Fault) -> Event {
    event(time_s, [State::Running, State::Stopping], Some(fault))
}

/// Returns the verdict on a rig that runs from the begin of the scene on.
fn verdict(injections: &[Injection], events: Vec<Event>) -> Verdict {
    verdict_on(&machine(), injections, events)
}

fn verdict_on(machine: &Machine, injections: &[Injection], events: Vec<Event>) -> Verdict {
    let cycles = events.last().map_or(0, |event| event.cycle + 1);
    let events = [vec![event(0.0, [State::Enabling, State::Running], None)], events].concat();
    // The run goes on for long after the last of them.
    let syncs_ns: Vec<u64> = (0..u64::from(cycles) + 5000).map(|cycle| 4_000_000 * cycle).collect();
    judged(machine, injections, Play { cycles, ..played(syncs_ns, events) })
}

/// A run with cycles at these moments.
fn played(syncs_ns: Vec<u64>, events: Vec<Event>) -> Play {
    let simulated_s = syncs_ns.last().map_or(0.0, |last_ns| *last_ns as f64 * 1e-9);
    let cycles = syncs_ns.len() as u32;
    Play { end: End::Complete, cycles, simulated_s, scene_from_ns: Some(0), syncs_ns, events, ..Play::nothing() }
}

fn judged(machine: &Machine, injections: &[Injection], play: Play) -> Verdict {
    judge(machine, &Script { injections: injections.to_vec(), is_tangle: false }, &play)
}

#[track_caller]
fn expect_excused(verdict: &Verdict, invariant: Invariant, excuse: Excuse) {
    let counts = verdict.excused.by_name();
    assert_eq!(verdict.violations, [], "{counts:?}");
    let name = format!("{} {}", invariant.name(), excuse.name());
    assert_eq!(counts.get(&name), Some(&1), "{counts:?}");
}

#[track_caller]
fn expect_found(verdict: &Verdict, invariant: Invariant) {
    assert!(verdict.violations.iter().any(|found| found.invariant == invariant), "{:?}", verdict.violations);
}

#[test]
fn a_window_that_an_earlier_injection_has_filled() {
    let overrun = usual(Kind::CycleOverrun, 0.5, 4e-3);
    // Overruns count over 1000 cycles, here 4 s.
    for (start_s, is_filled) in [(2.0, true), (6.0, false)] {
        let stopped = usual(Kind::MasterStopped, start_s, 4e-3);
        let found = verdict(&[overrun, stopped], vec![stopping(start_s, Fault::Overrun)]);
        if is_filled {
            expect_excused(&found, Invariant::FalseAlarm, Excuse::EarlierInjection);
        } else {
            expect_found(&found, Invariant::FalseAlarm);
        }
    }
}

/// At 6 rad/s a joint turns 24 mrad in a cycle of 4 ms, and the guard takes twice that for a jump.
#[test]
fn a_jump_that_could_be_motion_has_no_bound() {
    for (size, is_small) in [(0.04, true), (0.072, true), (0.073, false)] {
        let jump = usual(Kind::EncoderJump, 1.0, 4e-3).sized(size);
        let late = event(1.0 + 91.0 * 4e-3, [State::Running, State::Disabled], Some(Fault::EncoderJump));
        let found = verdict(&[jump], vec![late]);
        let cycles: Vec<_> = found.faults.iter().map(|seen| seen.cycles).collect();
        if is_small {
            expect_excused(&found, Invariant::Reaction, Excuse::SmallJump);
            assert_eq!(cycles, [None]);
        } else {
            expect_found(&found, Invariant::Reaction);
            assert_eq!(cycles, [Some(92)]);
        }
    }
}

/// Heartbeats are missed after tens of milliseconds, and an emergency that waits for a request comes within its 3 s. A hand that
/// stops the rig before that decides where it ends.
#[test]
fn a_hand_that_stops_the_rig_before_the_injection_shows() {
    let silent = (machine(), Kind::HeartbeatSilent);
    let emergency = (on_ethercat(), Kind::EmergencyInSdo);
    for ((machine, kind), after_s, is_early) in
        [(&silent, 0.02, true), (&silent, 0.4, false), (&emergency, 2.9, true), (&emergency, 3.1, false)]
    {
        let injection = usual(*kind, 1.0, machine.period_s());
        let found = verdict_on(machine, &[injection], vec![stopping(1.0 + after_s, Fault::OverSpeed)]);
        if is_early {
            assert_eq!(found.excused.by_name().get("reaction hand"), Some(&1));
            assert_eq!(found.injections[0].as_expected, None);
        } else {
            expect_found(&found, Invariant::Reaction);
        }
    }
}

#[test]
fn few_reactions_to_a_hand_are_no_rate() {
    let holding = |time_s: f64| event(time_s, [State::Running, State::Holding], Some(Fault::ForceStep));
    let few = verdict(&[], (1..4).map(|at| holding(0.3 * f64::from(at))).collect());
    assert_eq!(few.violations, []);
    assert_eq!(few.excused.by_name().get("false-alarm too-few"), Some(&1));
    let all_the_time = verdict(&[], (1..40).map(|at| holding(0.3 * f64::from(at))).collect());
    expect_found(&all_the_time, Invariant::FalseAlarm);
}

#[test]
fn an_arm_that_a_hand_carried_out_or_overpowers() {
    let edge = stopping(1.0, Fault::WorkspaceLeft);
    expect_found(&verdict(&[], vec![edge]), Invariant::FalseAlarm);
    let carried = verdict(&[], vec![Event { is_carried: true, ..edge }]);
    expect_excused(&carried, Invariant::FalseAlarm, Excuse::Carried);
    let pushed = verdict(&[], vec![Event { since_torque_limit: Some(0), ..edge }]);
    expect_excused(&pushed, Invariant::FalseAlarm, Excuse::TorqueLimit);
    let force = stopping(1.0, Fault::ForceImplausible);
    expect_found(&verdict(&[], vec![force]), Invariant::FalseAlarm);
    for cycles in [0, 20] {
        let overpowered = verdict(&[], vec![Event { since_torque_limit: Some(cycles), ..force }]);
        expect_excused(&overpowered, Invariant::FalseAlarm, Excuse::TorqueLimit);
    }
    // The mean of the guard's balance is forgotten then, and the place of the arm does not lag at all.
    for late in [Event { since_torque_limit: Some(21), ..force }, Event { since_torque_limit: Some(1), ..edge }] {
        expect_found(&verdict(&[], vec![late]), Invariant::FalseAlarm);
    }
}

/// The rig at 2 ms on EtherCAT, whose force sensor takes 8000 samples a second.
fn on_ethercat() -> Machine {
    let machine = Machine::draw(&Shipped::load().unwrap(), 31_000_786);
    assert_eq!((machine.title().as_str(), machine.period_s()), ("paper-admittance-2ms.yaml on EtherCAT", 2e-3));
    machine
}

/// The verdict on a rig that holds and stops by invalid samples in these cycles, which begin at these moments.
fn stopped_in(syncs_ns: &[u64], start_s: f64, [hold, stop]: [usize; 2]) -> Verdict {
    use State::{Holding, Running, Stopped, Stopping};
    let changed = |at: usize, states: [State; 2]| Event {
        sync_ns: syncs_ns[at],
        cycle: at as u32,
        ..event(0.0, states, Some(Fault::SensorInvalid))
    };
    let events = vec![
        event(0.0, [State::Enabling, Running], None),
        changed(hold, [Running, Holding]),
        changed(stop, [Holding, Stopping]),
        Event { cause_before: Some(Fault::SensorInvalid), ..changed(stop + 3, [Stopping, Stopped]) },
    ];
    let invalid = usual(Kind::SensorInvalid, start_s, 2e-3);
    judged(&on_ethercat(), &[invalid], played(syncs_ns.to_vec(), events))
}

/// The reference clock is slow by 989 parts per million. The injection begins 7 us after the begin of a cycle, so that after the fourth
/// one more than four periods of the host have passed.
#[test]
fn the_cycles_of_a_bound_are_counted_where_they_follow_the_clock_of_a_device() {
    let syncs_ns: Vec<u64> = (0..1000).map(|cycle| 2_001_978 * cycle).collect();
    let start_s = (syncs_ns[100] + 7000) as f64 * 1e-9;
    let cycles = |verdict: &Verdict| verdict.faults.iter().map(|seen| seen.cycles).collect::<Vec<_>>();
    let found = stopped_in(&syncs_ns, start_s, [102, 104]);
    assert_eq!((&found.violations[..], cycles(&found)), (&[][..], vec![Some(2), Some(4)]));
    let late = stopped_in(&syncs_ns, start_s, [102, 105]);
    expect_found(&late, Invariant::Reaction);
    assert_eq!(cycles(&late), [Some(2), Some(5)]);
    // A cycle that was left out has passed all the same.
    let gap = [&syncs_ns[..103], &syncs_ns[104..]].concat();
    let skipped = stopped_in(&gap, start_s, [102, 104]);
    expect_found(&skipped, Invariant::Reaction);
    assert_eq!(cycles(&skipped), [Some(2), Some(5)]);
}

#[test]
fn an_injection_that_a_run_does_not_reach_or_is_too_short_for_brings_nothing_about() {
    let invalid = usual(Kind::SensorInvalid, 1.0, 2e-3);
    let ended = |cycles: u64| {
        let events = vec![event(0.0, [State::Enabling, State::Running], None)];
        judged(&on_ethercat(), &[invalid], played((0..cycles).map(|cycle| 2_000_000 * cycle).collect(), events))
    };
    let short = ended(450);
    assert_eq!((short.violations, short.injections), (Vec::new(), Vec::new()));
    let cut_off = ended(502);
    assert_eq!((cut_off.violations, cut_off.injections[0].as_expected), (Vec::new(), None));
    let whole = ended(1000);
    expect_found(&whole, Invariant::Reaction);
    assert_eq!(whole.injections[0].as_expected, Some(false));
}

/// A register that is written unseen is read back within a second, and 500 cycles are one here.
#[test]
fn a_hidden_write_is_found_within_a_second() {
    let syncs_ns: Vec<u64> = (0..2000).map(|cycle| 2_000_000 * cycle).collect();
    let found_in = |cycle: usize| {
        let stopped = Event {
            sync_ns: syncs_ns[cycle],
            cycle: cycle as u32,
            ..event(0.0, [State::Running, State::Stopped], Some(Fault::Intruder))
        };
        let events = vec![event(0.0, [State::Enabling, State::Running], None), stopped];
        let hidden = usual(Kind::HiddenRegisterWrite, 0.2, 2e-3).sized(2.0);
        judged(&on_ethercat(), &[hidden], played(syncs_ns.clone(), events))
    };
    let early = found_in(601);
    assert_eq!((early.violations.as_slice(), early.injections[0].as_expected), (&[][..], Some(true)));
    expect_found(&found_in(602), Invariant::Reaction);
}
