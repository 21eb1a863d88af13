//! Laws that several bodies assert.

use yieldwall::canopen::{Frame, NodeId, cob};
use yieldwall::cycle::Outputs;
use yieldwall::guard::{JointCommand, Motion, Request, State};
use yieldwall::time::Time;

/// Most moments before the last one at which [`live`] polls.
const MOST_MOMENTS: usize = 40;
/// Most polls at one moment: what is done first may make something else due at once.
const MOST_AT_ONCE: usize = 4;

/// Lets `engine` live until `until`: polls it at what it waits for, not more often than it is worth, and at the end late.
/// `next` says what it waits for; `poll` does what is due.
///
/// # Panics
/// If something stays due.
pub(super) fn live<E>(engine: &mut E, until: Time, next: impl Fn(&E) -> Time, mut poll: impl FnMut(&mut E, Time)) {
    let mut settle = |engine: &mut E, now: Time| {
        let is_settled = (0..MOST_AT_ONCE).any(|_| {
            poll(engine, now);
            next(engine) > now
        });
        assert!(is_settled, "polled at {now:?}, and waits for {:?}", next(engine));
    };
    for _ in 0..MOST_MOMENTS {
        let due = next(engine);
        if due >= until {
            break;
        }
        settle(engine, due);
    }
    settle(engine, until);
}

/// What every frame of a device keeps to.
///
/// # Panics
/// If `frame` is not one that `node` may send, whatever it was configured to.
pub(super) fn assert_is_of_device(node: NodeId, frame: &Frame) {
    let id = frame.id();
    let is_good = if id == cob::heartbeat(node) {
        matches!(frame.data(), [0x00 | 0x04 | 0x05 | 0x7f])
    } else if id == cob::sdo_response(node) {
        // A segment of a block may begin with any byte.
        frame.len() == 8
    } else {
        // A PDO or an emergency.
        !cob::is_restricted(id.into()) && !frame.is_empty()
    };
    assert!(is_good, "node {} sent {frame:x?}", node.raw());
}

/// What a rig promises in every cycle, seen from outside.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Witness {
    state: State,
}

impl Witness {
    /// A witness of a rig in `state`.
    pub(super) fn of(state: State) -> Self {
        Self { state }
    }

    /// Looks at one cycle in which every drive was in Operation Enabled or not.
    ///
    /// # Panics
    /// If a promise is broken.
    pub(super) fn look(&mut self, are_enabled: bool, request: Request, torque_limit_n_m: f64, outputs: &Outputs) {
        let (directive, before) = (&outputs.directive, self.state);
        assert_is_finite(outputs);
        // Nothing moves unless every drive follows.
        let values = values(outputs.command.get());
        let is_at_rest = directive.motion == Motion::Rest;
        assert!(is_at_rest || are_enabled, "moves without the drives: {outputs:?}");
        match outputs.command.get() {
            JointCommand::Position(angles) => {
                assert!(!is_at_rest || *angles == outputs.signals.measured_angles, "a target at rest: {outputs:?}");
            }
            JointCommand::Velocity(_) => assert!(!is_at_rest || values == [0.0; 2], "a rate at rest: {outputs:?}"),
            JointCommand::Torque(_) => {
                assert!(!is_at_rest || values == [0.0; 2], "a torque at rest: {outputs:?}");
                assert!(values.iter().all(|torque| torque.abs() <= torque_limit_n_m), "beyond the limit: {outputs:?}");
            }
        }
        // Only a person enables, and only a person resets.
        let after = directive.state;
        assert!(!directive.fault_reset || request == Request::Reset, "a fault reset by itself: {outputs:?}");
        if before.is_latched() && !after.is_latched() {
            assert_eq!((request, after), (Request::Reset, State::Idle), "left {before:?} by itself");
        }
        match (before, after) {
            (State::Idle, State::Idle) => {}
            (State::Idle, _) => assert_eq!((request, after), (Request::Enable, State::Enabling), "woke up by itself"),
            (State::Stopping, _) => assert!(after == State::Stopping || after.is_latched(), "{before:?} to {after:?}"),
            (_, State::Idle) => assert!(before.is_latched(), "{before:?} to {after:?}"),
            (_, State::Enabling) => assert_eq!(before, State::Enabling, "enabled again"),
            _ => {}
        }
        self.state = after;
    }
}

fn values(command: &JointCommand) -> [f64; 2] {
    match command {
        JointCommand::Position(angles) => angles.to_array(),
        JointCommand::Velocity(rates) => rates.to_array(),
        JointCommand::Torque(torques) => torques.to_array(),
    }
}

fn assert_is_finite(outputs: &Outputs) {
    let signals = &outputs.signals;
    let pairs = [
        values(outputs.command.get()),
        signals.force.to_array(),
        signals.tool.to_array(),
        signals.proxy.to_array(),
        signals.target_angles.to_array(),
        signals.measured_angles.to_array(),
    ];
    let is_finite = pairs.as_flattened().iter().chain([&signals.signed_distance_m]).all(|value| value.is_finite());
    assert!(is_finite, "not finite: {outputs:?}");
}
