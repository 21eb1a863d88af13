//! The state machine that a drive runs.

use super::{Command, State, Statusword, controlword};

/// A transition of the state machine, numbered 0 to 16 as in CiA 402-2.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Transition(pub u8);

/// Option codes of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OptionCodes {
    /// Value of 605Ah. Values 0 to 4 end in Switch On Disabled: 0 torque off, 1 slow ramp, 2 quick ramp, 3 current limit, 4 voltage
    /// limit. Values 5 to 8 are the four ramps again, and stay in Quick Stop Active.
    pub quick_stop: i16,
    /// 605Bh: 0 torque off, 1 slow ramp first (transition 8).
    pub shutdown: i16,
    /// 605Ch: 0 torque off, 1 slow ramp first (transition 5).
    pub disable_operation: i16,
    /// 605Dh: 1 slow ramp, 2 quick ramp, 3 current limit, 4 voltage limit.
    pub halt: i16,
    /// 605Eh: 0 torque off, 1 slow ramp, 2 quick ramp, 3 current limit, 4 voltage limit, then Fault.
    pub fault_reaction: i16,
    /// 6007h: 0 nothing, 1 fault, 2 disable voltage, 3 quick stop.
    pub abort_connection: i16,
}

impl Default for OptionCodes {
    /// The defaults of the standard, except that loss of connection is a quick stop instead of nothing.
    fn default() -> Self {
        OptionCodes {
            quick_stop: 2,
            shutdown: 0,
            disable_operation: 1,
            halt: 1,
            fault_reaction: 2,
            abort_connection: 3,
        }
    }
}

/// Action of the power stage at this moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Reaction {
    /// No torque.
    Off,
    /// Follow the set-points.
    Follow,
    /// Slow down on the slow-down ramp (6084h).
    SlowRamp,
    /// Slow down on the quick stop ramp (6085h).
    QuickRamp,
    /// Slow down at the limit of current or voltage, as fast as the drive can.
    Limit,
}

/// The ramp of option codes that share the numbering 1 to 4.
const fn ramp(code: i16) -> Reaction {
    match code {
        1 => Reaction::SlowRamp,
        2 => Reaction::QuickRamp,
        3 | 4 => Reaction::Limit,
        _ => Reaction::Off,
    }
}

/// The CiA 402 state machine of a device: all transitions, with the ramps that the option codes ask for.
///
/// Ramps end when the owner calls [`StateMachine::standstill`]. A drive asked to shut down or to disable operation with
/// a ramp stays in Operation Enabled until then; disable voltage, quick stop and faults cut in at any time.
///
/// Real-time: yes.
///
/// # Source
/// CiA 402-2, state machine of the power drive system, objects 6007h and 605Ah to 605Eh. Transitions 3 and 4 are not
/// taken together: Enable Operation in Ready To Switch On is ignored.
#[derive(Clone, Copy, Debug)]
pub struct StateMachine {
    state: State,
    options: OptionCodes,
    controlword: u16,
    /// Transition at the end of a slow-down in Operation Enabled.
    pending: Option<Transition>,
    has_quick_stopped: bool,
}

impl StateMachine {
    /// A machine in Not Ready To Switch On.
    pub const fn new(options: OptionCodes) -> Self {
        StateMachine {
            state: State::NotReadyToSwitchOn,
            options,
            controlword: 0,
            pending: None,
            has_quick_stopped: false,
        }
    }

    /// The state.
    pub const fn state(&self) -> State {
        self.state
    }

    /// Replaces the option codes; they take effect with the next transition or ramp.
    pub const fn set_options(&mut self, options: OptionCodes) {
        self.options = options;
    }

    /// The state bits of the statusword, and bit 10 when a quick stop has come to standstill.
    pub const fn statusword(&self) -> u16 {
        let stopped = if self.has_quick_stopped { Statusword::TARGET_REACHED } else { 0 };
        self.state.bits() | stopped
    }

    /// Transitions 0 and 1: the self-test is over.
    pub const fn initialise(&mut self) {
        if matches!(self.state, State::NotReadyToSwitchOn) {
            self.enter(State::SwitchOnDisabled);
        }
    }

    /// Takes a controlword each time one arrives, and returns the transition that it caused at once, if any. One controlword
    /// causes at most one transition, except Enable Operation in Ready To Switch On, which causes 3 and 4. A fault reset is the
    /// rising edge of bit 7 against the controlword before.
    pub fn apply(&mut self, controlword: u16) -> Option<Transition> {
        let rising = controlword & !self.controlword & controlword::FAULT_RESET != 0;
        self.controlword = controlword;
        let command = Command::decode(controlword);
        match (self.state, command) {
            (State::Fault, Command::FaultReset) if rising => self.take(15, State::SwitchOnDisabled),
            (State::SwitchOnDisabled, Command::Shutdown) => self.take(2, State::ReadyToSwitchOn),
            (State::ReadyToSwitchOn, Command::SwitchOn) => self.take(3, State::SwitchedOn),
            // From Ready To Switch On by way of Switched On, at once.
            (State::ReadyToSwitchOn | State::SwitchedOn, Command::EnableOperation) => {
                self.take(4, State::OperationEnabled)
            }
            (State::OperationEnabled, Command::SwitchOn) => self.slow_down(5, self.options.disable_operation),
            (State::SwitchedOn, Command::Shutdown) => self.take(6, State::ReadyToSwitchOn),
            (State::ReadyToSwitchOn, Command::QuickStop | Command::DisableVoltage) => {
                self.take(7, State::SwitchOnDisabled)
            }
            (State::OperationEnabled, Command::Shutdown) => self.slow_down(8, self.options.shutdown),
            (State::OperationEnabled, Command::DisableVoltage) => self.take(9, State::SwitchOnDisabled),
            (State::SwitchedOn, Command::QuickStop | Command::DisableVoltage) => self.take(10, State::SwitchOnDisabled),
            (State::OperationEnabled, Command::QuickStop) => Some(self.quick_stop()),
            (State::OperationEnabled, Command::EnableOperation) => {
                self.pending = None;
                None
            }
            (State::QuickStopActive, Command::DisableVoltage) => self.take(12, State::SwitchOnDisabled),
            (State::QuickStopActive, Command::EnableOperation) if (5..=8).contains(&self.options.quick_stop) => {
                self.take(16, State::OperationEnabled)
            }
            _ => None,
        }
    }

    /// Transition 13 and, if nothing has to be slowed down, 14. Without effect when a fault is already there.
    pub fn fault(&mut self) -> Option<Transition> {
        if matches!(self.state, State::Fault | State::FaultReactionActive) {
            return None;
        }
        let moves = matches!(self.state, State::OperationEnabled | State::QuickStopActive);
        if moves && ramp(self.options.fault_reaction) != Reaction::Off {
            self.take(13, State::FaultReactionActive)
        } else {
            self.take(14, State::Fault)
        }
    }

    /// Loss of communication (heartbeat, node guarding, bus-off), by option code 6007h.
    pub fn lose_connection(&mut self) -> Option<Transition> {
        match (self.options.abort_connection, self.state) {
            (1, _) => self.fault(),
            (2, _) => self.lose_voltage(),
            (3, State::OperationEnabled) => Some(self.quick_stop()),
            (3, State::ReadyToSwitchOn | State::SwitchedOn) => self.apply_once(Command::QuickStop),
            _ => None,
        }
    }

    /// The power stage lost its voltage (emergency stop, safe torque off): torque off at once.
    pub fn lose_voltage(&mut self) -> Option<Transition> {
        self.apply_once(Command::DisableVoltage)
    }

    /// The motion that [`StateMachine::reaction`] slows down has come to standstill; the transition that follows.
    pub fn standstill(&mut self) -> Option<Transition> {
        match self.state {
            State::FaultReactionActive => self.take(14, State::Fault),
            State::QuickStopActive if (5..=8).contains(&self.options.quick_stop) => {
                self.has_quick_stopped = true;
                None
            }
            State::QuickStopActive => self.take(12, State::SwitchOnDisabled),
            State::OperationEnabled => match self.pending {
                Some(Transition(8)) => self.take(8, State::ReadyToSwitchOn),
                Some(Transition(number)) => self.take(number, State::SwitchedOn),
                None => None,
            },
            _ => None,
        }
    }

    /// Returns the present action of the power stage.
    pub const fn reaction(&self) -> Reaction {
        match self.state {
            State::OperationEnabled if self.pending.is_some() => Reaction::SlowRamp,
            State::OperationEnabled if self.controlword & controlword::HALT != 0 => match ramp(self.options.halt) {
                Reaction::Off => Reaction::SlowRamp,
                slowing => slowing,
            },
            State::OperationEnabled => Reaction::Follow,
            State::QuickStopActive if self.options.quick_stop >= 5 => ramp(self.options.quick_stop - 4),
            State::QuickStopActive => ramp(self.options.quick_stop),
            State::FaultReactionActive => ramp(self.options.fault_reaction),
            _ => Reaction::Off,
        }
    }

    /// A command that does not come from the bus and therefore leaves the stored controlword alone.
    fn apply_once(&mut self, command: Command) -> Option<Transition> {
        let stored = self.controlword;
        let transition = self.apply(command.controlword());
        self.controlword = stored;
        transition
    }

    fn quick_stop(&mut self) -> Transition {
        self.enter(State::QuickStopActive);
        if self.reaction() == Reaction::Off {
            self.enter(State::SwitchOnDisabled);
            return Transition(12);
        }
        Transition(11)
    }

    fn slow_down(&mut self, number: u8, option: i16) -> Option<Transition> {
        if option == 1 {
            self.pending = Some(Transition(number));
            None
        } else {
            self.take(number, if number == 8 { State::ReadyToSwitchOn } else { State::SwitchedOn })
        }
    }

    fn take(&mut self, number: u8, state: State) -> Option<Transition> {
        self.enter(state);
        Some(Transition(number))
    }

    const fn enter(&mut self, state: State) {
        self.state = state;
        self.pending = None;
        self.has_quick_stopped = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn machine(options: OptionCodes) -> StateMachine {
        let mut machine = StateMachine::new(options);
        machine.initialise();
        machine
    }

    fn enabled(options: OptionCodes) -> StateMachine {
        let mut machine = machine(options);
        for (word, number) in [(0x06, 2), (0x07, 3), (0x0f, 4)] {
            assert_eq!(machine.apply(word), Some(Transition(number)));
        }
        machine
    }

    fn switched_on() -> StateMachine {
        let mut machine = machine(OptionCodes::default());
        machine.apply(0x06);
        machine.apply(0x07);
        machine
    }

    #[test]
    fn transitions_without_motion() {
        let mut fresh = StateMachine::new(OptionCodes::default());
        assert_eq!(fresh.state(), State::NotReadyToSwitchOn);
        assert_eq!(fresh.apply(0x06), None);
        fresh.initialise();
        assert_eq!(fresh.state(), State::SwitchOnDisabled);
        assert_eq!(fresh.apply(0x07), None);
        assert_eq!(fresh.apply(0x06), Some(Transition(2)));
        assert_eq!(fresh.clone().apply(0x0f), Some(Transition(4)), "3 and 4 are taken together");
        assert_eq!(fresh.apply(0x02), Some(Transition(7)));
        assert_eq!(switched_on().apply(0x06), Some(Transition(6)));
        assert_eq!(switched_on().apply(0x00), Some(Transition(10)));
        assert_eq!(switched_on().apply(0x02), Some(Transition(10)));
        assert_eq!(enabled(OptionCodes::default()).apply(0x00), Some(Transition(9)));
    }

    #[test]
    fn shutdown_and_disable_operation_slow_down_if_asked() {
        let ramps = OptionCodes { shutdown: 1, disable_operation: 1, ..OptionCodes::default() };
        for (word, number, end) in [(0x06, 8, State::ReadyToSwitchOn), (0x07, 5, State::SwitchedOn)] {
            let mut slow = enabled(ramps);
            assert_eq!(slow.apply(word), None);
            assert_eq!((slow.state(), slow.reaction()), (State::OperationEnabled, Reaction::SlowRamp));
            assert_eq!(slow.standstill(), Some(Transition(number)));
            assert_eq!((slow.state(), slow.reaction()), (end, Reaction::Off));
            let at_once = OptionCodes { shutdown: 0, disable_operation: 0, ..ramps };
            let mut fast = enabled(at_once);
            assert_eq!(fast.apply(word), Some(Transition(number)));
            assert_eq!(fast.state(), end);
        }
    }

    #[test]
    fn quick_stop_options() {
        let with = |quick_stop| enabled(OptionCodes { quick_stop, ..OptionCodes::default() });
        let mut off = with(0);
        assert_eq!(off.apply(0x02), Some(Transition(12)));
        assert_eq!(off.state(), State::SwitchOnDisabled);
        let ramps = [Reaction::SlowRamp, Reaction::QuickRamp, Reaction::Limit, Reaction::Limit];
        for (code, expected) in (1..).zip(ramps) {
            let mut leaving = with(code);
            assert_eq!(leaving.apply(0x02), Some(Transition(11)));
            assert_eq!((leaving.state(), leaving.reaction()), (State::QuickStopActive, expected));
            assert_eq!(leaving.apply(0x0f), None, "16 only with option codes 5 to 8");
            assert_eq!(leaving.standstill(), Some(Transition(12)));
            let mut staying = with(code + 4);
            staying.apply(0x02);
            assert_eq!(staying.reaction(), expected);
            assert_eq!(staying.standstill(), None);
            assert_eq!(staying.statusword(), 0x0407);
            assert_eq!(staying.apply(0x0f), Some(Transition(16)));
            assert_eq!(staying.statusword(), 0x0027);
        }
    }

    #[test]
    fn fault_reaction_options_and_the_reset_edge() {
        let mut standing = switched_on();
        assert_eq!(standing.fault(), Some(Transition(14)));
        assert_eq!(standing.state(), State::Fault);
        let mut off = enabled(OptionCodes { fault_reaction: 0, ..OptionCodes::default() });
        assert_eq!(off.fault(), Some(Transition(14)));
        let mut moving = enabled(OptionCodes::default());
        assert_eq!(moving.fault(), Some(Transition(13)));
        assert_eq!((moving.state(), moving.reaction()), (State::FaultReactionActive, Reaction::QuickRamp));
        assert_eq!(moving.apply(0x80), None, "no reset before the reaction has ended");
        assert_eq!(moving.standstill(), Some(Transition(14)));
        assert_eq!(moving.apply(0x80), None, "bit 7 was already high: no edge");
        assert_eq!(moving.apply(0x0f), None);
        assert_eq!(moving.apply(0x8f), Some(Transition(15)));
        assert_eq!(moving.state(), State::SwitchOnDisabled);
        assert_eq!(moving.fault(), Some(Transition(14)));
        assert_eq!(moving.fault(), None);
    }

    #[test]
    fn halt_slows_down_and_stays_enabled() {
        let mut machine = enabled(OptionCodes { halt: 2, ..OptionCodes::default() });
        machine.apply(0x10f);
        assert_eq!((machine.state(), machine.reaction()), (State::OperationEnabled, Reaction::QuickRamp));
        assert_eq!(machine.standstill(), None);
        machine.apply(0x0f);
        assert_eq!(machine.reaction(), Reaction::Follow);
    }

    #[test]
    fn loss_of_connection_by_option_code() {
        let lost = |abort_connection| {
            let mut machine = enabled(OptionCodes { abort_connection, ..OptionCodes::default() });
            let transition = machine.lose_connection();
            (transition, machine.state())
        };
        assert_eq!(lost(0), (None, State::OperationEnabled));
        assert_eq!(lost(1), (Some(Transition(13)), State::FaultReactionActive));
        assert_eq!(lost(2), (Some(Transition(9)), State::SwitchOnDisabled));
        assert_eq!(lost(3), (Some(Transition(11)), State::QuickStopActive));
    }

    proptest! {
        #[test]
        fn torque_needs_a_commanded_state(words in prop::collection::vec(any::<u16>(), 0..100), faults in prop::collection::vec(any::<bool>(), 100)) {
            let mut machine = machine(OptionCodes::default());
            for (word, fault) in words.into_iter().zip(faults) {
                let before = machine.state();
                machine.apply(word);
                if fault {
                    machine.fault();
                }
                let may_have_torque = matches!(
                    machine.state(),
                    State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive
                );
                prop_assert_eq!(machine.reaction() != Reaction::Off, may_have_torque);
                if before == State::Fault && machine.state() != State::Fault {
                    prop_assert!(word & 0x80 != 0);
                }
                prop_assert_eq!(State::decode(machine.statusword()), Some(machine.state()));
            }
        }
    }
}
