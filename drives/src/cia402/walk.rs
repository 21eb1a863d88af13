//! The master's way through the state machine.

use super::{Command, State, Statusword};

/// Where the master wants a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Goal {
    /// No torque, no voltage asked for.
    #[default]
    SwitchOnDisabled,
    /// One step below switched on.
    ReadyToSwitchOn,
    /// Voltage on, no torque.
    SwitchedOn,
    /// Following set-points.
    OperationEnabled,
    /// Stopped by the drive's own quick stop ramp.
    QuickStop,
}

impl Goal {
    /// Whether a drive in `state` is there. After a quick stop a drive is there in Quick Stop Active and, if its option
    /// code makes it leave that state by itself, in any state without torque.
    pub const fn is_reached_in(self, state: State) -> bool {
        match self {
            Goal::SwitchOnDisabled => matches!(state, State::SwitchOnDisabled),
            Goal::ReadyToSwitchOn => matches!(state, State::ReadyToSwitchOn),
            Goal::SwitchedOn => matches!(state, State::SwitchedOn),
            Goal::OperationEnabled => matches!(state, State::OperationEnabled),
            Goal::QuickStop => matches!(state, State::QuickStopActive | State::SwitchOnDisabled),
        }
    }
}

/// The command that brings a drive in `state` one step nearer to `goal`; at the goal, the one that keeps it there.
///
/// A fault is never reset: the answer in the two fault states is [`Command::DisableVoltage`], whose bit 7 is low, so
/// that a later reset is an edge. From Quick Stop Active the only way on is through Switch On Disabled.
///
/// Real-time: yes.
pub const fn next_command(state: State, goal: Goal) -> Command {
    match (goal, state) {
        (_, State::NotReadyToSwitchOn | State::FaultReactionActive | State::Fault) => Command::DisableVoltage,
        (Goal::SwitchOnDisabled, _) => Command::DisableVoltage,
        (Goal::QuickStop, _) => Command::QuickStop,
        (_, State::QuickStopActive) => Command::DisableVoltage,
        (_, State::SwitchOnDisabled) => Command::Shutdown,
        (Goal::ReadyToSwitchOn, _) => Command::Shutdown,
        (Goal::SwitchedOn, _) => Command::SwitchOn,
        (Goal::OperationEnabled, State::ReadyToSwitchOn) => Command::SwitchOn,
        (Goal::OperationEnabled, State::SwitchedOn | State::OperationEnabled) => Command::EnableOperation,
    }
}

/// What one step of [`StateWalk`] answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Walk {
    /// The controlword to send in this cycle.
    pub controlword: u16,
    /// The state that the drive reports; `None` if the statusword is not a defined pattern.
    pub state: Option<State>,
    /// Whether the drive is at the goal.
    pub reached: bool,
    /// Whether the drive left the goal in this step without being asked (a fault included); the goal has then fallen
    /// back to [`Goal::SwitchOnDisabled`].
    pub lost: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Reset {
    #[default]
    None,
    /// Bit 7 goes out low once, so that the next word has an edge whatever was sent before.
    Low,
    High,
}

/// Walks one drive to its goal, one controlword per cycle.
///
/// It never resets a fault and never enables again by itself: when a drive that was on its way up or at its goal shows
/// a fault, or leaves the goal unasked, the goal falls back to [`Goal::SwitchOnDisabled`] until somebody sets it again.
///
/// Real-time: yes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StateWalk {
    goal: Goal,
    arrived: bool,
    reset: Reset,
}

impl StateWalk {
    /// A walk whose goal is [`Goal::SwitchOnDisabled`].
    pub const fn new() -> Self {
        StateWalk { goal: Goal::SwitchOnDisabled, arrived: false, reset: Reset::None }
    }

    /// The goal, which falls back by itself as described above.
    pub const fn goal(&self) -> Goal {
        self.goal
    }

    /// Sets the goal.
    pub const fn set_goal(&mut self, goal: Goal) {
        self.goal = goal;
        self.arrived = false;
    }

    /// Asks for one fault reset: one controlword with bit 7 low, then one with bit 7 high. Only a drive in Fault gets
    /// it; in any other state the request lapses.
    pub const fn request_fault_reset(&mut self) {
        self.reset = Reset::Low;
    }

    /// One cycle: the statusword that came in, the controlword that goes out.
    ///
    /// From Quick Stop Active the walk goes up only after the drive reports standstill (bit 10), so that no torque is
    /// cut off in the middle of the ramp.
    pub fn step(&mut self, statusword: Statusword) -> Walk {
        let Some(state) = statusword.state() else {
            self.reset = Reset::None;
            let lost = self.leave();
            return Walk { controlword: Command::DisableVoltage.controlword(), state: None, reached: false, lost };
        };
        let reached = self.goal.is_reached_in(state);
        let is_fault = matches!(state, State::Fault | State::FaultReactionActive);
        let lost = (is_fault || (self.arrived && !reached)) && self.leave();
        self.arrived = reached && !lost;
        let controlword = match (self.next_reset(state), state) {
            (Some(word), _) => word,
            (None, State::QuickStopActive)
                if self.goal != Goal::SwitchOnDisabled && !statusword.has(Statusword::TARGET_REACHED) =>
            {
                Command::QuickStop.controlword()
            }
            (None, _) => next_command(state, self.goal).controlword(),
        };
        Walk { controlword, state: Some(state), reached: reached && !lost, lost }
    }

    /// Lets the goal fall back; whether there was one above Switch On Disabled.
    fn leave(&mut self) -> bool {
        let had_goal = self.goal != Goal::SwitchOnDisabled;
        self.goal = Goal::SwitchOnDisabled;
        self.arrived = false;
        had_goal
    }

    fn next_reset(&mut self, state: State) -> Option<u16> {
        let (word, next) = match (self.reset, state) {
            (Reset::None, _) => return None,
            (Reset::Low, State::Fault) => (Command::DisableVoltage, Reset::High),
            (Reset::High, State::Fault) => (Command::FaultReset, Reset::None),
            _ => {
                self.reset = Reset::None;
                return None;
            }
        };
        self.reset = next;
        Some(word.controlword())
    }
}
