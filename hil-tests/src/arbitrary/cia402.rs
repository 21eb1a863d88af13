//! The state machine of a drive from both sides, and its scaling.

use yieldwall_drives::cia402::{
    Command, Goal, OptionCodes, Reaction, State, StateMachine, StateWalk, Statusword, Transition,
};
use yieldwall_drives::scaling::{AxisScaling, COUNTS_MAX, CountUnwrapper, Direction, wrap};

use super::bytes::{Bytes, Script};

const GOALS: [Goal; 5] =
    [Goal::SwitchOnDisabled, Goal::ReadyToSwitchOn, Goal::SwitchedOn, Goal::OperationEnabled, Goal::QuickStop];

/// Where each transition of CiA 402-2 leads from and to.
fn is_transition(Transition(number): Transition, from: State, to: State) -> bool {
    use State::*;
    match number {
        2 => (from, to) == (SwitchOnDisabled, ReadyToSwitchOn),
        3 => (from, to) == (ReadyToSwitchOn, SwitchedOn),
        4 => matches!(from, ReadyToSwitchOn | SwitchedOn) && to == OperationEnabled,
        5 => (from, to) == (OperationEnabled, SwitchedOn),
        6 => (from, to) == (SwitchedOn, ReadyToSwitchOn),
        7 => (from, to) == (ReadyToSwitchOn, SwitchOnDisabled),
        8 => (from, to) == (OperationEnabled, ReadyToSwitchOn),
        9 => (from, to) == (OperationEnabled, SwitchOnDisabled),
        10 => (from, to) == (SwitchedOn, SwitchOnDisabled),
        11 => (from, to) == (OperationEnabled, QuickStopActive),
        12 => matches!(from, QuickStopActive | OperationEnabled) && to == SwitchOnDisabled,
        13 => matches!(from, OperationEnabled | QuickStopActive) && to == FaultReactionActive,
        14 => from != Fault && to == Fault,
        15 => (from, to) == (Fault, SwitchOnDisabled),
        16 => (from, to) == (QuickStopActive, OperationEnabled),
        _ => false,
    }
}

/// A walk that is shown any statusword, and a state machine that is told anything, with any option codes: one step at a
/// time, no reset unasked, and torque only in the states that have it.
///
/// # Panics
/// If a law is broken.
pub fn cia402(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let (mut walk, mut machine) = (StateWalk::new(), StateMachine::new(OptionCodes::default()));
    let mut is_reset_asked = false;
    machine.initialise();
    while !bytes.is_empty() {
        let before = machine.state();
        let taken = match bytes.u8() % 16 {
            0 => {
                walk.set_goal(bytes.pick(&GOALS));
                None
            }
            1 => {
                walk.request_fault_reset();
                is_reset_asked = true;
                None
            }
            2 => {
                let [quick_stop, shutdown, disable_operation, halt, fault_reaction, abort_connection] =
                    [0; 6].map(|_| bytes.u16() as i16 % 16);
                machine.set_options(OptionCodes {
                    quick_stop,
                    shutdown,
                    disable_operation,
                    halt,
                    fault_reaction,
                    abort_connection,
                });
                None
            }
            3 => machine.fault(),
            4 => machine.lose_connection(),
            5 => machine.lose_voltage(),
            6 => machine.standstill(),
            7 => machine.apply(bytes.u16()),
            8 => {
                // A statusword that no drive has shown.
                step(&mut walk, Statusword(bytes.u16()), &mut is_reset_asked);
                None
            }
            _ => {
                let word = Statusword(machine.statusword());
                machine.apply(step(&mut walk, word, &mut is_reset_asked))
            }
        };
        let (after, reaction) = (machine.state(), machine.reaction());
        match taken {
            Some(transition) => {
                assert!(is_transition(transition, before, after), "{before:?} {transition:?} {after:?}")
            }
            None => assert_eq!(before, after),
        }
        assert_eq!(State::decode(machine.statusword()), Some(after));
        assert!(reaction == Reaction::Off || after.has_torque(), "{reaction:?} in {after:?}");
        assert!(reaction != Reaction::Follow || after == State::OperationEnabled);
    }
}

/// One step of the walk; the controlword.
fn step(walk: &mut StateWalk, word: Statusword, is_reset_asked: &mut bool) -> u16 {
    let goal = walk.goal();
    let taken = walk.step(word);
    let command = Command::decode(taken.controlword);
    assert_eq!((taken.state, command.controlword()), (word.state(), taken.controlword));
    if command == Command::FaultReset {
        assert!(std::mem::take(is_reset_asked) && taken.state == Some(State::Fault), "a reset by itself");
    }
    if command == Command::EnableOperation {
        assert_eq!(goal, Goal::OperationEnabled);
        assert!(matches!(taken.state, Some(State::SwitchedOn | State::OperationEnabled)), "{taken:?}");
    }
    assert!(!taken.reached || walk.goal().is_reached_in(taken.state.expect("a state that is reached")));
    assert!(!taken.lost || walk.goal() == Goal::SwitchOnDisabled);
    taken.controlword
}

pub(super) fn walks() -> Vec<Vec<u8>> {
    // Up, a fault in operation, its reaction, a reset, up again; a quick stop that is left by transition 16.
    let fault = Script::new().raw(&[0, 3, 9, 9, 9, 9, 9, 3, 9, 6, 9, 1, 9, 9, 9, 0, 3, 9, 9, 9, 9]);
    let quick_stop = Script::new()
        .raw(&[2, 6, 0, 1, 0, 1, 0, 1, 0, 2, 0, 3, 0])
        .raw(&[0, 3, 9, 9, 9, 9, 0, 4, 9, 6, 7, 0x0f, 0, 4, 5]);
    vec![fault.finish(), quick_stop.finish()]
}

/// Counts and SI: what is scaled is finite and comes back, and unwrapping follows every report.
///
/// # Panics
/// If a law is broken.
pub fn scaling(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let (counts_per_rev, zero_offset_rad, rated_torque_n_m) = (bytes.f64(), bytes.f64(), bytes.f64());
    let direction = bytes.pick(&[Direction::Same, Direction::Reversed]);
    let Ok(axis) = AxisScaling::new(counts_per_rev, direction, zero_offset_rad, rated_torque_n_m) else {
        let is_good = |value: f64| value.is_finite() && value > 0.0;
        return assert!(!(is_good(counts_per_rev) && is_good(rated_torque_n_m) && zero_offset_rad.is_finite()));
    };
    let mut unwrapper = CountUnwrapper::near(bytes.u64() as i64);
    while !bytes.is_empty() {
        let value = bytes.f64();
        if let Ok(counts) = axis.counts(value) {
            assert!(counts.abs() <= COUNTS_MAX);
        }
        for is_refused in [axis.rate_counts_per_s(value).is_err(), axis.torque_per_mille(value).is_err()] {
            assert_eq!(is_refused, !value.is_finite());
        }
        // A drive has whole counts: below one a turn angles need not be finite.
        let (reported, before) = (bytes.u32() as i32, unwrapper.counts());
        let counts = unwrapper.unwrap(reported);
        assert_eq!((wrap(counts), unwrapper.counts()), (reported, counts));
        assert!(counts.wrapping_sub(before).unsigned_abs() <= 1 << 31);
        if counts_per_rev >= 1.0 {
            assert!(axis.angle_rad(counts).is_finite() && axis.rate_rad_per_s(reported).is_finite());
        }
        if rated_torque_n_m < 1e300 {
            assert!(axis.torque_n_m(reported as i16).is_finite());
        }
    }
}

pub(super) fn positions() -> Vec<Vec<u8>> {
    let script = Script::new().number(2000.0).number(0.25).number(60.0).raw(&[1]).raw(&[0; 8]);
    vec![script.number(1.5).raw(&[0, 0, 0, 0x80]).number(-3.0).raw(&[0xff, 0xff, 0xff, 0x7f]).finish()]
}
