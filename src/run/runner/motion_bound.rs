//! A rig that was enabled for less than all that its file allows.

use yieldwall_motion::guard::State;
use yieldwall_motion::quantity::JointAngles;

/// How far the joints of a rig may be guided from where it came to run.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionBound {
    bound_rad: f64,
    /// Commanded angles of the joints when the rig came to run.
    from: Option<JointAngles>,
    is_left: bool,
}

impl MotionBound {
    pub(super) fn new(bound_rad: f64) -> Self {
        Self { bound_rad, from: None, is_left: false }
    }

    /// Looks at what is asked of the joints in a state.
    pub(super) fn look(&mut self, state: State, targets: JointAngles) {
        if state == State::Running {
            let [left, right] = self.from.get_or_insert(targets).to_array();
            let [left_now, right_now] = targets.to_array();
            self.is_left |= (left_now - left).abs().max((right_now - right).abs()) > self.bound_rad;
        }
    }

    /// Whether a joint was guided farther.
    pub(super) fn is_left(self) -> bool {
        self.is_left
    }
}
