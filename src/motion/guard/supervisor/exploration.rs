//! Every reachable state of the supervisor, under every input that the cycle can give it.

use std::collections::{HashSet, VecDeque};

use super::*;
use crate::guard::fault::{DeviceSet, Fault, FaultCounts};
use cia402::{Goal, State as Drive};

/// Each reaction, and of the quick stops one for each latched state.
const FAULTS: [Option<(Fault, Reaction)>; 9] = [
    None,
    Some((Fault::WorkspaceEdge, Reaction::Count)),
    Some((Fault::SensorStale, Reaction::Freeze)),
    Some((Fault::SensorLost, Reaction::StopRamp)),
    Some((Fault::NodeReset, Reaction::QuickStop)),
    Some((Fault::EncoderJump, Reaction::QuickStop)),
    Some((Fault::HeartbeatLost, Reaction::QuickStop)),
    Some((Fault::DriveFault, Reaction::TorqueOff)),
    Some((Fault::LinkDown, Reaction::Silence)),
];
const REQUESTS: [Request; 4] = [Request::None, Request::Enable, Request::Stop, Request::Reset];

#[derive(Clone, Copy, Debug)]
struct Input {
    drives: [Drive; 2],
    fault: Option<(Fault, Reaction)>,
    at_rest: bool,
    is_measured: bool,
    request: Request,
}

fn inputs() -> Vec<Input> {
    let mut all = Vec::new();
    for left in Drive::ALL {
        for right in Drive::ALL {
            for fault in FAULTS {
                for request in REQUESTS {
                    for (at_rest, is_measured) in [(false, false), (false, true), (true, false), (true, true)] {
                        all.push(Input { drives: [left, right], fault, at_rest, is_measured, request });
                    }
                }
            }
        }
    }
    all
}

fn is_moving(state: State) -> bool {
    matches!(state, State::Running | State::Holding | State::Stopping)
}

/// Returns the worst that the cycle would have seen: what is injected, and what follows from request and drive states.
fn worst(state: State, input: &Input) -> Option<(Cause, Reaction)> {
    let mut faults = FaultCounts::default();
    faults.observe(Fault::StopRequested, input.request == Request::Stop);
    let is_out = input.drives.iter().any(|drive| *drive != Drive::OperationEnabled);
    faults.observe(Fault::DriveLeftOperation, is_moving(state) && is_out);
    let is_fault = input.drives.iter().any(|drive| matches!(drive, Drive::Fault | Drive::FaultReactionActive));
    faults.observe(Fault::DriveFault, is_fault);
    let injected = input.fault.map(|(fault, reaction)| (Cause { fault, devices: DeviceSet::NONE }, reaction));
    [faults.worst(), injected].into_iter().flatten().max_by_key(|(_, reaction)| *reaction)
}

fn check(before: &Supervisor, input: &Input, after: &Supervisor, directive: &Directive) {
    let (from, to) = (before.state, after.state);
    let case = format!("{from:?} -> {to:?} by {input:?}: {directive:?}");
    let reaction = worst(from, input).map(|(_, reaction)| reaction);
    let all_enabled = input.drives == [Drive::OperationEnabled; 2];
    // No set-point that moves an axis unless every drive is enabled in this cycle.
    assert!(directive.motion == Motion::Rest || all_enabled, "moves-enabled: {case}");
    // A latched state is left by a reset alone, for Idle alone; what happens meanwhile makes it only more severe.
    if from.is_latched() && !to.is_latched() {
        assert!(input.request == Request::Reset && to == State::Idle, "stays-latched: {case}");
    }
    assert!(!to.is_latched() || to.severity() >= from.severity(), "stays-latched: {case}");
    // Enabling begins with a request in Idle and ends in Running without a way round it.
    assert!(to != State::Enabling || from == State::Enabling || enables(from, input), "asked-for: {case}");
    let may_run = matches!(from, State::Enabling | State::Holding | State::Running);
    assert!(to != State::Running || may_run, "asked-for: {case}");
    // One fault reset for one request in a latched state; never by itself.
    assert_eq!(directive.fault_reset, from.is_latched() && input.request == Request::Reset, "asked-for: {case}");
    // The goal is one for all axes, and follows the reaction in the same cycle.
    let is_on = is_moving(from) || from == State::Enabling;
    match reaction {
        Some(Reaction::TorqueOff | Reaction::Silence) if is_on => {
            assert_eq!((directive.motion, directive.goal), (Motion::Rest, Goal::SwitchOnDisabled), "together: {case}");
        }
        Some(Reaction::QuickStop) if is_on => {
            assert_eq!((directive.motion, directive.goal), (Motion::Rest, Goal::QuickStop), "together: {case}");
        }
        Some(Reaction::StopRamp) if matches!(from, State::Running | State::Holding) => {
            assert_eq!((to, directive.motion), (State::Stopping, Motion::Halt), "together: {case}");
        }
        Some(Reaction::Freeze) if matches!(from, State::Running | State::Holding) => {
            assert_eq!((to, directive.motion), (State::Holding, Motion::Halt), "together: {case}");
        }
        _ => {}
    }
    if to != from && (is_moving(to) || to.is_latched()) && reaction > Some(Reaction::Count) {
        assert!(after.cause.is_some(), "{case}");
    }
    let expected = match to {
        State::Idle => Goal::ReadyToSwitchOn,
        // No axis is held before all can be.
        State::Enabling
            if !input.drives.iter().all(|drive| *drive == Drive::SwitchedOn || *drive == Drive::OperationEnabled) =>
        {
            Goal::SwitchedOn
        }
        State::Enabling | State::Running | State::Holding | State::Stopping => Goal::OperationEnabled,
        _ if after.takes_torque_off || after.reaction > Some(Reaction::QuickStop) => Goal::SwitchOnDisabled,
        State::Stopped | State::Disabled | State::Lost => Goal::QuickStop,
    };
    assert_eq!(directive.goal, expected, "{case}");
    // Drives that still make torque once it may go lose it, those of a latched rig alone, and until a reset.
    let may_go = input.at_rest && input.drives.iter().any(|drive| drive.has_torque());
    let is_due = from.is_latched() && to.is_latched() && (before.takes_torque_off || may_go);
    assert_eq!(after.takes_torque_off, is_due, "torque-off: {case}");
    // A latched state remembers how it was entered, and no other state does.
    assert_eq!(after.reaction.is_some(), to.is_latched(), "{case}");
    assert!(after.reaction.is_none_or(|reaction| reaction >= Reaction::QuickStop), "{case}");
    // Only what cannot be reached is left to itself.
    assert_eq!(directive.is_silent, to == State::Lost && after.reaction == Some(Reaction::Silence), "{case}");
    // The first target is a measured one.
    let starts = from == State::Enabling && is_moving(to);
    assert!(!starts || (input.is_measured && all_enabled), "starts-in-place: {case}");
}

fn enables(from: State, input: &Input) -> bool {
    let is_clear = worst(from, input).is_none_or(|(_, reaction)| reaction == Reaction::Count);
    from == State::Idle && input.request == Request::Enable && is_clear
}

#[test]
fn every_reachable_state_keeps_the_invariants_under_every_input() {
    let inputs = inputs();
    let key = |supervisor: &Supervisor| {
        (supervisor.state, supervisor.clear_cycles, supervisor.cause, supervisor.reaction, supervisor.takes_torque_off)
    };
    let mut seen = HashSet::from([key(&Supervisor::new())]);
    let mut waiting = VecDeque::from([Supervisor::new()]);
    let mut states = HashSet::new();
    let mut latched = HashSet::new();
    while let Some(before) = waiting.pop_front() {
        states.insert(before.state);
        latched.extend(before.reaction.map(|reaction| (before.state, reaction)));
        for input in &inputs {
            let mut after = before.clone();
            let directive = after.step(&View {
                drives: input.drives,
                worst: worst(before.state, input),
                is_measured: input.is_measured,
                at_rest: input.at_rest,
                request: input.request,
            });
            check(&before, input, &after, &directive);
            // Waiting for rest counts on for ever; beyond the hysteresis the count makes no difference.
            after.clear_cycles = after.clear_cycles.min(CLEAR_CYCLES + 1);
            if seen.insert(key(&after)) {
                waiting.push_back(after);
            }
        }
    }
    assert_eq!(states.len(), 8, "all states are reachable: {states:?}");
    assert_eq!(latched.len(), 5, "every way into a latched state is reachable: {latched:?}");
    assert!(seen.len() > usize::from(CLEAR_CYCLES), "the hysteresis was walked through: {}", seen.len());
}

#[test]
fn waiting_for_rest_does_not_overflow() {
    let mut supervisor = Supervisor { state: State::Holding, ..Supervisor::default() };
    let drives = [Drive::OperationEnabled; 2];
    let view = View { drives, worst: None, is_measured: true, at_rest: false, request: Request::None };
    for _ in 0..70_000 {
        assert_eq!(supervisor.step(&view).state, State::Holding);
    }
}
