//! The person at the rig.

use super::dice::{Dice, Purpose};
use yieldwall_motion::guard::{Request, State};

/// Share of cycles in which the person presses a button that has no meaning then.
const IDLE_TOUCH: f64 = 2e-4;
/// Shortest and longest time in s before a latched state is reset.
const RESET_AFTER_S: [f64; 2] = [0.05, 0.25];
/// Shortest and longest time in s before the rig is enabled.
const ENABLE_AFTER_S: [f64; 2] = [0.01, 0.1];
/// Times that enabling may fail before the network is booted anew.
const TRIES: u32 = 4;

/// Action of the person in a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Act {
    /// A request with the next cycle, or none.
    Ask(Request),
    /// The network is booted anew.
    Restart,
}

/// A person who looks at the state and waits a while before every act.
#[derive(Clone, Debug)]
pub(super) struct Operator {
    dice: Dice,
    period_s: f64,
    state: State,
    /// Cycles until the next act.
    wait: u32,
    /// Times that enabling failed since the rig ran last.
    failures: u32,
}

impl Operator {
    /// Creates the person of a seed.
    pub(super) fn new(seed: u64, period_s: f64) -> Self {
        let dice = Dice::new(seed, Purpose::Operator);
        Self { dice, period_s, state: State::Lost, wait: 0, failures: 0 }
    }

    /// Returns the person's action in this `state`.
    pub(super) fn act(&mut self, state: State) -> Act {
        if state != self.state {
            self.failures = match state {
                State::Running => 0,
                _ if self.state == State::Enabling => self.failures + 1,
                _ => self.failures,
            };
            self.state = state;
            self.wait_again();
        }
        if self.wait > 0 {
            self.wait -= 1;
            return Act::Ask(self.touch());
        }
        self.wait_again();
        match state {
            State::Idle if self.failures >= TRIES => {
                self.failures = 0;
                Act::Restart
            }
            State::Idle => {
                // Enabling that is refused leaves the rig idle.
                self.failures += 1;
                Act::Ask(Request::Enable)
            }
            state if state.is_latched() => Act::Ask(Request::Reset),
            _ => Act::Ask(self.touch()),
        }
    }

    fn wait_again(&mut self) {
        let [least, most] = if self.state == State::Idle { ENABLE_AFTER_S } else { RESET_AFTER_S };
        self.wait = (self.dice.between(least, most) / self.period_s).ceil() as u32;
    }

    /// Returns a request without effect now: to enable a rig that runs or is latched, or to reset when nothing is latched.
    fn touch(&mut self) -> Request {
        if !self.dice.chance(IDLE_TOUCH) {
            return Request::None;
        }
        match self.state {
            State::Idle | State::Enabling => Request::Reset,
            State::Running | State::Holding | State::Stopping if self.dice.chance(0.5) => Request::Reset,
            _ => Request::Enable,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asks(operator: &mut Operator, state: State, cycles: u32) -> Vec<Act> {
        (0..cycles).map(|_| operator.act(state)).filter(|act| *act != Act::Ask(Request::None)).collect()
    }

    #[test]
    fn a_latched_rig_is_reset_and_enabled_after_a_while() {
        let mut operator = Operator::new(5, 1e-3);
        assert_eq!(asks(&mut operator, State::Stopped, 49), []);
        let first = asks(&mut operator, State::Stopped, 202);
        assert!(first.contains(&Act::Ask(Request::Reset)), "{first:?}");
        assert!(asks(&mut operator, State::Idle, 101).contains(&Act::Ask(Request::Enable)));
    }

    #[test]
    fn a_rig_that_cannot_be_enabled_is_booted_anew() {
        let mut operator = Operator::new(5, 1e-3);
        assert!(asks(&mut operator, State::Idle, 400).contains(&Act::Restart));
    }

    #[test]
    fn a_rig_that_runs_is_left_alone() {
        let mut operator = Operator::new(5, 1e-3);
        for act in asks(&mut operator, State::Running, 20_000) {
            assert!(matches!(act, Act::Ask(Request::Enable | Request::Reset)), "{act:?}");
        }
    }
}
