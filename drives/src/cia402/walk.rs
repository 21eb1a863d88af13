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

/// Result of one step of [`StateWalk`].
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
/// The walk never resets a fault and never enables again by itself. A drive on its way up or at its goal may show a fault, or
/// leave the goal without a command. The goal then falls back to [`Goal::SwitchOnDisabled`] until the owner sets it again.
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

    /// Drops a fault reset that was asked for and has not gone out.
    pub const fn cancel_fault_reset(&mut self) {
        self.reset = Reset::None;
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

#[cfg(test)]
mod tests {
    use super::super::{OptionCodes, StateMachine};
    use super::*;
    use proptest::prelude::*;

    const GOALS: [Goal; 5] =
        [Goal::SwitchOnDisabled, Goal::ReadyToSwitchOn, Goal::SwitchedOn, Goal::OperationEnabled, Goal::QuickStop];

    /// One cycle: the device shows its statusword, the master answers, the device takes it.
    fn cycle(walk: &mut StateWalk, device: &mut StateMachine) -> Walk {
        let step = walk.step(Statusword(device.statusword()));
        device.apply(step.controlword);
        step
    }

    fn ready_device() -> StateMachine {
        let mut device = StateMachine::new(OptionCodes::default());
        device.initialise();
        device
    }

    fn enabled_pair() -> (StateWalk, StateMachine) {
        let (mut walk, mut device) = (StateWalk::new(), ready_device());
        walk.set_goal(Goal::OperationEnabled);
        for _ in 0..4 {
            cycle(&mut walk, &mut device);
        }
        assert_eq!(device.state(), State::OperationEnabled);
        (walk, device)
    }

    #[test]
    fn the_walk_up_sends_the_three_commands_in_order() {
        let (mut walk, mut device) = (StateWalk::new(), ready_device());
        assert_eq!(cycle(&mut walk, &mut device).controlword, 0x00);
        walk.set_goal(Goal::OperationEnabled);
        let words: Vec<u16> = (0..4).map(|_| cycle(&mut walk, &mut device).controlword).collect();
        assert_eq!(words, [0x06, 0x07, 0x0f, 0x0f]);
        assert!(cycle(&mut walk, &mut device).reached);
    }

    #[test]
    fn no_state_and_goal_ever_give_a_fault_reset() {
        for state in State::ALL {
            for goal in GOALS {
                let command = next_command(state, goal);
                assert_ne!(command, Command::FaultReset);
                assert_eq!(command.controlword() & 0x80, 0);
            }
        }
    }

    #[test]
    fn a_fault_lowers_the_goal_and_a_reset_does_not_enable_again() {
        let (mut walk, mut device) = enabled_pair();
        device.fault();
        device.standstill();
        let step = cycle(&mut walk, &mut device);
        assert!(step.lost && !step.reached);
        assert_eq!(walk.goal(), Goal::SwitchOnDisabled);
        walk.request_fault_reset();
        let words: Vec<u16> = (0..6).map(|_| cycle(&mut walk, &mut device).controlword).collect();
        assert_eq!(words, [0x00, 0x80, 0x00, 0x00, 0x00, 0x00]);
        assert_eq!(device.state(), State::SwitchOnDisabled);
    }

    #[test]
    fn one_request_gives_one_edge_even_if_the_fault_stays() {
        let mut walk = StateWalk::new();
        let fault = Statusword(State::Fault.bits());
        walk.request_fault_reset();
        let words: Vec<u16> = (0..8).map(|_| walk.step(fault).controlword).collect();
        assert_eq!(words, [0x00, 0x80, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00]);
    }

    #[test]
    fn a_reset_request_lapses_outside_fault() {
        let (mut walk, mut device) = enabled_pair();
        walk.request_fault_reset();
        assert_eq!(cycle(&mut walk, &mut device).controlword, 0x0f);
        device.fault();
        device.standstill();
        for _ in 0..4 {
            assert_eq!(cycle(&mut walk, &mut device).controlword, 0x00);
        }
    }

    #[test]
    fn a_drive_that_drops_out_is_not_enabled_again() {
        let (mut walk, mut device) = enabled_pair();
        assert!(cycle(&mut walk, &mut device).reached);
        device.apply(Command::DisableVoltage.controlword());
        let step = cycle(&mut walk, &mut device);
        assert!(step.lost);
        for _ in 0..10 {
            assert_eq!(cycle(&mut walk, &mut device).controlword, 0x00);
        }
        assert_eq!(device.state(), State::SwitchOnDisabled);
    }

    #[test]
    fn a_quick_stop_is_waited_out_before_the_walk_goes_up_again() {
        let mut device = StateMachine::new(OptionCodes { quick_stop: 6, ..OptionCodes::default() });
        device.initialise();
        let mut walk = StateWalk::new();
        walk.set_goal(Goal::OperationEnabled);
        for _ in 0..4 {
            cycle(&mut walk, &mut device);
        }
        walk.set_goal(Goal::QuickStop);
        cycle(&mut walk, &mut device);
        assert!(cycle(&mut walk, &mut device).reached);
        walk.set_goal(Goal::OperationEnabled);
        assert_eq!(cycle(&mut walk, &mut device).controlword, 0x02);
        device.standstill();
        let words: Vec<u16> = (0..4).map(|_| cycle(&mut walk, &mut device).controlword).collect();
        assert_eq!(words, [0x00, 0x06, 0x07, 0x0f]);
        assert_eq!(device.state(), State::OperationEnabled);
    }

    #[test]
    fn an_undefined_statusword_takes_the_torque_away() {
        let mut walk = StateWalk::new();
        walk.set_goal(Goal::OperationEnabled);
        let step = walk.step(Statusword(0x0003));
        assert_eq!((step.controlword, step.state, step.lost), (0x00, None, true));
        assert_eq!(walk.goal(), Goal::SwitchOnDisabled);
    }

    proptest! {
        #[test]
        fn every_goal_is_reached_from_every_state_without_fault(
            path in prop::collection::vec(0u16..16, 0..20),
            goal in prop::sample::select(GOALS.to_vec()),
        ) {
            let mut device = ready_device();
            for controlword in path {
                device.apply(controlword);
            }
            let mut walk = StateWalk::new();
            walk.set_goal(goal);
            let mut reached = false;
            for _ in 0..8 {
                reached |= cycle(&mut walk, &mut device).reached;
                device.standstill();
            }
            prop_assert!(reached, "{goal:?} not reached, {:?}", device.state());
        }

        #[test]
        fn a_reset_bit_needs_a_request(words in prop::collection::vec(any::<u16>(), 1..50), goal in prop::sample::select(GOALS.to_vec())) {
            let mut walk = StateWalk::new();
            for word in words {
                walk.set_goal(goal);
                prop_assert_eq!(walk.step(Statusword(word)).controlword & 0x80, 0);
            }
        }
    }
}
