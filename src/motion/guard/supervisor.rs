//! The supervisor: whether the rig rests, runs, holds or stops, decided once a cycle for all axes together.
//!
//! ```text
//! Idle --enable--> Enabling --all drives enabled--> Running <--clear--> Holding
//!   ^                 |                               |                    |
//!   |                 +---------- fault --------------+--------------------+
//!   |                                                 v
//!   +------- reset ------ Stopped*, Disabled*, Lost* <-- Stopping (ramp)
//! ```
//! States with `*` latch: only [`Request::Reset`] leaves them, and nothing enables the drives automatically.

use yieldwall_drives::cia402;

use super::fault::{Cause, Reaction};

/// Cycles without any fault after which Holding ends (hysteresis against flicker at a threshold).
const CLEAR_CYCLES: u16 = 50;

/// The state of the rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[repr(u8)]
pub enum State {
    /// Drives are not enabled; nothing moves. The start.
    #[default]
    Idle,
    /// The drives walk to Operation Enabled together.
    Enabling,
    /// The fixture moves the reference.
    Running,
    /// The reference is at rest or comes to rest; clears automatically when the fault has gone.
    Holding,
    /// The reference comes to rest along a ramp; a quick stop follows.
    Stopping,
    /// Latched: quick stop was commanded. Drives that still make torque once the joints rest get Disable Voltage.
    Stopped,
    /// Latched: voltage off was commanded.
    Disabled,
    /// Latched: the bus cannot be reached, the drives' watchdogs act.
    Lost,
}

impl State {
    /// Whether only a reset by a person leaves this state.
    pub fn is_latched(self) -> bool {
        matches!(self, State::Stopped | State::Disabled | State::Lost)
    }

    /// Returns how far from running a latched state is: 1 Stopped, 2 Disabled, 3 Lost; 0 for what does not latch.
    ///
    /// Real-time: yes.
    pub fn severity(self) -> u8 {
        match self {
            State::Stopped => 1,
            State::Disabled => 2,
            State::Lost => 3,
            _ => 0,
        }
    }
}

/// Request of a person in this cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Request {
    /// Nothing.
    #[default]
    None,
    /// Enable the drives and run; only from Idle.
    Enable,
    /// Stop along the ramp.
    Stop,
    /// Leave a latched state for Idle; sends one fault reset to drives in Fault.
    Reset,
}

/// Motion of the reference in this cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// There is no reference: the command is the one that moves nothing.
    Rest,
    /// The fixture moves it.
    Run,
    /// It comes to rest along the ramp and stays.
    Halt,
}

/// Decision of the supervisor in one cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Directive {
    /// The state from now on.
    pub state: State,
    /// Motion of the reference.
    pub motion: Motion,
    /// Goal of the drives, the same for both.
    pub goal: cia402::Goal,
    /// Whether drives in Fault get one reset edge.
    pub fault_reset: bool,
    /// Whether nothing is sent any more: the bus cannot be reached, and what the drives still heard would keep their
    /// watchdogs from acting.
    pub is_silent: bool,
}

impl Directive {
    /// Nothing moves and nothing is enabled.
    pub const IDLE: Self = Self {
        state: State::Idle,
        motion: Motion::Rest,
        goal: cia402::Goal::ReadyToSwitchOn,
        fault_reset: false,
        is_silent: false,
    };
    /// Quick stop of both drives, latched in [`State::Disabled`]: for a caller that has lost its supervisor.
    pub const QUICK_STOP: Self = Self {
        state: State::Disabled,
        motion: Motion::Rest,
        goal: cia402::Goal::QuickStop,
        fault_reset: false,
        is_silent: false,
    };
}

/// Inputs of the supervisor.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// The drives' states as known in this cycle.
    pub drives: [cia402::State; 2],
    /// The strongest reaction that the faults ask for, with its cause.
    pub worst: Option<(Cause, Reaction)>,
    /// Whether both angles were measured in this cycle, and not predicted.
    pub is_measured: bool,
    /// Whether the reference is at rest; in a latched state whether torque may go, as [`JointRest`](super::JointRest) has it.
    pub at_rest: bool,
    /// Request of the person.
    pub request: Request,
}

/// The supervisor's memory.
#[derive(Clone, Debug, Default)]
pub struct Supervisor {
    state: State,
    cause: Option<Cause>,
    /// The reaction by which a latched state was entered.
    reaction: Option<Reaction>,
    clear_cycles: u16,
    resetting: bool,
    /// Drives that were stopped still made torque once it could go, and get Disable Voltage.
    takes_torque_off: bool,
}

impl Supervisor {
    /// In Idle, without a cause.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the state after the last step.
    pub fn state(&self) -> State {
        self.state
    }

    /// Returns the fault that led to the present state, if one did.
    pub fn cause(&self) -> Option<Cause> {
        self.cause
    }

    /// Computes one cycle.
    ///
    /// Real-time: yes.
    pub fn step(&mut self, view: &View) -> Directive {
        self.resetting = false;
        self.state = self.next(view);
        self.directive(are_switched_on(&view.drives))
    }

    fn next(&mut self, view: &View) -> State {
        let all_enabled = view.drives.iter().all(|drive| *drive == cia402::State::OperationEnabled);
        let worst = view.worst;
        match self.state {
            State::Idle => match (view.request, worst) {
                (Request::Enable, Some((cause, reaction))) if reaction > Reaction::Count => {
                    self.cause = Some(cause);
                    State::Idle
                }
                (Request::Enable, _) => {
                    self.cause = None;
                    State::Enabling
                }
                _ => State::Idle,
            },
            State::Enabling => match worst {
                Some((cause, reaction)) if reaction > Reaction::Freeze => self.stop_now(cause, reaction),
                // The first target is the measured position, not a predicted one.
                _ if all_enabled && view.is_measured => self.react(worst, State::Running),
                _ => State::Enabling,
            },
            State::Running => self.react(worst, State::Running),
            State::Holding => {
                let quiet = worst.is_none_or(|(_, reaction)| reaction == Reaction::Count);
                self.clear_cycles = if quiet { self.clear_cycles.saturating_add(1) } else { 0 };
                if self.clear_cycles >= CLEAR_CYCLES && view.at_rest {
                    self.cause = None;
                    State::Running
                } else {
                    self.react(worst, State::Holding)
                }
            }
            State::Stopping => match worst {
                Some((cause, reaction)) if reaction > Reaction::StopRamp => self.stop_now(cause, reaction),
                _ if view.at_rest => {
                    self.reaction = Some(Reaction::QuickStop);
                    State::Stopped
                }
                _ => State::Stopping,
            },
            latched => self.stay(latched, worst, view),
        }
    }

    fn react(&mut self, worst: Option<(Cause, Reaction)>, unmoved: State) -> State {
        match worst {
            None | Some((_, Reaction::Count)) => unmoved,
            Some((cause, Reaction::Freeze)) => {
                self.cause = Some(cause);
                if unmoved != State::Holding {
                    self.clear_cycles = 0;
                }
                State::Holding
            }
            Some((cause, Reaction::StopRamp)) => {
                self.cause = Some(cause);
                State::Stopping
            }
            Some((cause, reaction)) => self.stop_now(cause, reaction),
        }
    }

    /// Stops all drives at once in the cycle that has just been decided: not even the ramp can be followed.
    ///
    /// Real-time: yes.
    pub fn stop_at_once(&mut self, cause: Cause) -> Directive {
        self.state = self.stop_now(cause, Reaction::QuickStop);
        self.directive(false)
    }

    fn stop_now(&mut self, cause: Cause, reaction: Reaction) -> State {
        let reaction = reaction.max(Reaction::QuickStop);
        self.cause = Some(cause);
        self.reaction = Some(reaction);
        cause.fault.row().final_state(reaction)
    }

    /// A latched state grows only more severe, and ends only by a reset. A fault that is still there then keeps the rig
    /// from being enabled.
    fn stay(&mut self, latched: State, worst: Option<(Cause, Reaction)>, view: &View) -> State {
        if view.request == Request::Reset {
            self.resetting = true;
            self.cause = None;
            self.reaction = None;
            self.takes_torque_off = false;
            return State::Idle;
        }
        self.takes_torque_off |= view.at_rest && view.drives.iter().any(|drive| drive.has_torque());
        match worst {
            Some((cause, reaction))
                if Some(reaction) > self.reaction.max(Some(Reaction::StopRamp))
                    && cause.fault.row().final_state(reaction).severity() >= latched.severity() =>
            {
                self.stop_now(cause, reaction)
            }
            _ => latched,
        }
    }

    fn directive(&self, are_switched_on: bool) -> Directive {
        let (motion, goal) = match self.state {
            State::Idle => (Motion::Rest, cia402::Goal::ReadyToSwitchOn),
            // The last step together: one axis that holds and one that is free move the tool where nobody knows.
            State::Enabling if !are_switched_on => (Motion::Rest, cia402::Goal::SwitchedOn),
            State::Enabling => (Motion::Rest, cia402::Goal::OperationEnabled),
            State::Running => (Motion::Run, cia402::Goal::OperationEnabled),
            State::Holding | State::Stopping => (Motion::Halt, cia402::Goal::OperationEnabled),
            State::Stopped | State::Disabled | State::Lost => match self.reaction {
                Some(Reaction::TorqueOff | Reaction::Silence) => (Motion::Rest, cia402::Goal::SwitchOnDisabled),
                _ if self.takes_torque_off => (Motion::Rest, cia402::Goal::SwitchOnDisabled),
                _ => (Motion::Rest, cia402::Goal::QuickStop),
            },
        };
        let is_silent = self.reaction == Some(Reaction::Silence);
        Directive { state: self.state, motion, goal, fault_reset: self.resetting, is_silent }
    }
}

/// Whether every drive is one step from Operation Enabled, or in it.
fn are_switched_on(drives: &[cia402::State; 2]) -> bool {
    drives.iter().all(|drive| matches!(drive, cia402::State::SwitchedOn | cia402::State::OperationEnabled))
}

#[cfg(test)]
mod exploration;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::guard::fault::{Fault, FaultCounts};
    use cia402::{Goal, State as Drive};

    struct Rig {
        supervisor: Supervisor,
        faults: FaultCounts,
        drives: [Drive; 2],
        at_rest: bool,
    }

    impl Rig {
        fn new(drive: Drive) -> Self {
            Self { supervisor: Supervisor::new(), faults: FaultCounts::default(), drives: [drive; 2], at_rest: true }
        }

        fn running() -> Self {
            let mut rig = Rig::new(Drive::OperationEnabled);
            rig.step(Request::Enable);
            assert_eq!(rig.step(Request::None).state, State::Running);
            rig
        }

        fn step(&mut self, request: Request) -> Directive {
            let worst = self.faults.worst();
            let view = View { drives: self.drives, worst, is_measured: true, at_rest: self.at_rest, request };
            self.supervisor.step(&view)
        }
    }

    #[test]
    fn it_runs_only_when_every_drive_is_enabled() {
        let mut rig = Rig::new(Drive::SwitchedOn);
        assert_eq!(rig.step(Request::None).state, State::Idle);
        assert_eq!(rig.step(Request::Enable).goal, Goal::OperationEnabled);
        rig.drives[0] = Drive::OperationEnabled;
        assert_eq!(rig.step(Request::None).motion, Motion::Rest);
        rig.drives[1] = Drive::OperationEnabled;
        assert_eq!(rig.step(Request::None).motion, Motion::Run);
    }

    #[test]
    fn no_drive_is_enabled_before_all_can_be() {
        let mut rig = Rig::new(Drive::SwitchedOn);
        rig.drives[0] = Drive::QuickStopActive;
        assert_eq!(rig.step(Request::Enable).goal, Goal::SwitchedOn);
        rig.drives[0] = Drive::SwitchedOn;
        assert_eq!(rig.step(Request::None).goal, Goal::OperationEnabled);
        // One that drops out takes the other with it.
        rig.drives = [Drive::OperationEnabled, Drive::ReadyToSwitchOn];
        assert_eq!(rig.step(Request::None).goal, Goal::SwitchedOn);
    }

    #[test]
    fn a_freeze_clears_by_itself_but_not_at_once() {
        let mut rig = Rig::running();
        rig.faults.observe(Fault::SensorSaturated, true);
        assert_eq!(rig.step(Request::None).state, State::Holding);
        rig.faults.observe(Fault::SensorSaturated, false);
        for _ in 0..CLEAR_CYCLES - 1 {
            assert_eq!(rig.step(Request::None).state, State::Holding);
        }
        assert_eq!(rig.step(Request::None).state, State::Running);
    }

    #[test]
    fn a_freeze_of_one_cycle_takes_its_time_to_clear_again() {
        let mut rig = Rig::running();
        for _ in 0..2 {
            rig.faults.observe(Fault::SensorSaturated, true);
            assert_eq!(rig.step(Request::None).state, State::Holding);
            rig.faults.observe(Fault::SensorSaturated, false);
            for _ in 0..CLEAR_CYCLES - 1 {
                assert_eq!(rig.step(Request::None).state, State::Holding);
            }
            assert_eq!(rig.step(Request::None).state, State::Running);
            assert_eq!(rig.supervisor.state(), State::Running);
        }
    }

    #[test]
    fn latched_states_rank_by_what_they_take_to_leave() {
        use State::{Disabled, Enabling, Holding, Idle, Lost, Running, Stopped, Stopping};
        assert_eq!([Stopped, Disabled, Lost].map(State::severity), [1, 2, 3]);
        assert_eq!([Idle, Enabling, Running, Holding, Stopping].map(State::severity), [0; 5]);
    }

    #[test]
    fn what_is_only_counted_keeps_nobody_from_enabling() {
        let mut rig = Rig::new(Drive::SwitchedOn);
        rig.faults.observe(Fault::WorkspaceEdge, true);
        assert_eq!(rig.faults.worst().map(|(_, reaction)| reaction), Some(Reaction::Count));
        assert_eq!(rig.step(Request::Enable).state, State::Enabling);
        // Nor does a freeze end it: nothing moves yet.
        rig.faults.observe(Fault::SensorSaturated, true);
        assert_eq!(rig.step(Request::None).state, State::Enabling);
        let mut refused = Rig::new(Drive::SwitchedOn);
        refused.faults.observe(Fault::SensorSaturated, true);
        assert_eq!(refused.step(Request::Enable).state, State::Idle);
    }

    #[test]
    fn a_latched_rig_takes_a_stronger_reaction_and_keeps_its_cause_under_an_equal_one() {
        let mut rig = Rig::running();
        let cause = |rig: &Rig| rig.supervisor.cause().map(|cause| cause.fault);
        rig.faults.observe(Fault::NodeReset, true);
        assert_eq!(rig.step(Request::None).state, State::Stopped);
        rig.faults.observe(Fault::NodeReset, false);
        rig.faults.observe(Fault::Emergency, true);
        assert_eq!((rig.step(Request::None).state, cause(&rig)), (State::Stopped, Some(Fault::NodeReset)));
        rig.faults.observe(Fault::BusOff, true);
        let directive = rig.step(Request::None);
        assert_eq!((directive.state, directive.is_silent), (State::Lost, true));
        assert_eq!(cause(&rig), Some(Fault::BusOff));
    }

    #[test]
    fn a_stop_request_ramps_and_latches() {
        let mut rig = Rig::running();
        rig.faults.observe(Fault::StopRequested, true);
        rig.at_rest = false;
        assert_eq!(rig.step(Request::None).state, State::Stopping);
        assert_eq!(rig.step(Request::None).motion, Motion::Halt);
        rig.at_rest = true;
        assert_eq!(rig.step(Request::None).goal, Goal::QuickStop);
        rig.faults.observe(Fault::StopRequested, false);
        for request in [Request::None, Request::Enable, Request::Stop] {
            assert_eq!(rig.step(request).state, State::Stopped);
        }
        let reset = rig.step(Request::Reset);
        assert_eq!((reset.state, reset.motion, reset.fault_reset), (State::Idle, Motion::Rest, true));
        assert!(!rig.step(Request::None).fault_reset, "a fault reset is sent once");
        assert_eq!(rig.step(Request::None).state, State::Idle, "nothing enables by itself");
    }

    #[test]
    fn a_drive_fault_quick_stops_all_axes_in_the_same_cycle() {
        let mut rig = Rig::running();
        rig.faults.observe(Fault::DriveFault, true);
        let directive = rig.step(Request::None);
        assert_eq!(
            (directive.state, directive.motion, directive.goal),
            (State::Disabled, Motion::Rest, Goal::QuickStop)
        );
        assert_eq!(rig.supervisor.cause().map(|cause| cause.fault), Some(Fault::DriveFault));
    }
}
