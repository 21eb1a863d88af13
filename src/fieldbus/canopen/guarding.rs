//! Node guarding: the older error control, in which the master asks by remote frame and devices watch being asked.
//!
//! # Source
//! CiA 301, node guarding protocol and objects 100Ch and 100Dh.

use std::time::Duration;

use super::{Frame, NmtState, NodeId, Outbox, cob};
use crate::time::Time;

/// The device's side: answers with a toggle bit, and notices when nobody asks any more.
#[derive(Clone, Debug)]
pub(super) struct LifeGuard {
    toggle: bool,
    life_time: Duration,
    /// `NEVER` until the first request and after the loss.
    deadline: Time,
    is_lost: bool,
}

impl LifeGuard {
    pub(super) const fn new() -> Self {
        LifeGuard { toggle: false, life_time: Duration::ZERO, deadline: Time::NEVER, is_lost: false }
    }

    /// Starts anew with a guard time and a life time factor; either being zero switches the watch off.
    pub(super) fn configure(&mut self, guard_time: Duration, factor: u8) {
        *self = LifeGuard { life_time: guard_time * u32::from(factor), ..LifeGuard::new() };
    }

    pub(super) const fn deadline(&self) -> Time {
        self.deadline
    }

    /// The answer to a request, and whether the master had been lost.
    pub(super) fn answer(&mut self, now: Time, node: NodeId, state: NmtState) -> (Frame, bool) {
        let frame = Frame::new(cob::heartbeat(node), &[canopen_rs::nmt::encode_node_guard(state, self.toggle)]);
        self.toggle = !self.toggle;
        if !self.life_time.is_zero() {
            self.deadline = now + self.life_time;
        }
        (frame, std::mem::take(&mut self.is_lost))
    }

    /// Whether the life time ran out, once each time.
    pub(super) fn is_late(&mut self, now: Time) -> bool {
        let is_late = now >= self.deadline;
        if is_late {
            (self.deadline, self.is_lost) = (Time::NEVER, true);
        }
        is_late
    }
}

/// What a guarded node did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GuardEvent {
    /// First answer, or the first one after the node was lost.
    Present(NmtState),
    /// The state in the answer changed.
    State(NmtState),
    /// The toggle bit did not alternate: the answer is not from the node that was asked, or one is missing. It does not
    /// count.
    Toggle,
    /// As many requests in a row as the life time factor says were not answered.
    Lost,
}

/// The master's side of node guarding, for one node.
///
/// Heartbeat is the better choice where a device has it: it costs one frame less, and no remote frames.
#[derive(Clone, Debug)]
pub struct NodeGuard {
    node: NodeId,
    guard_time: Duration,
    factor: u8,
    ask_at: Time,
    is_open: bool,
    unanswered: u8,
    expected_toggle: Option<bool>,
    state: Option<NmtState>,
    is_lost: bool,
}

impl NodeGuard {
    /// Asks `node` every `guard_time` (100Ch) from [`NodeGuard::start`] on; `factor` (100Dh, at least 1) requests without
    /// answer are a loss.
    pub fn new(node: NodeId, guard_time: Duration, factor: u8) -> Self {
        NodeGuard {
            node,
            guard_time: guard_time.max(Duration::from_millis(1)),
            factor: factor.max(1),
            ask_at: Time::NEVER,
            is_open: false,
            unanswered: 0,
            expected_toggle: None,
            state: None,
            is_lost: false,
        }
    }

    /// Starts asking.
    pub fn start(&mut self, now: Time) {
        *self = NodeGuard { ask_at: now, ..NodeGuard::new(self.node, self.guard_time, self.factor) };
    }

    /// State of the node in its last answer; `None` before the first one and while it is lost.
    pub const fn state(&self) -> Option<NmtState> {
        self.state
    }

    /// Takes a frame from the bus. A boot-up message makes the toggle bit begin anew.
    pub fn on_frame(&mut self, frame: &Frame) -> Option<GuardEvent> {
        let &[byte] = frame.data() else { return None };
        if frame.id() != cob::heartbeat(self.node) {
            return None;
        }
        let (toggle, state) = canopen_rs::nmt::decode_node_guard(byte).ok()?;
        if state == NmtState::Initialising {
            self.expected_toggle = Some(false);
            return None;
        }
        if self.expected_toggle.is_some_and(|expected| expected != toggle) {
            return Some(GuardEvent::Toggle);
        }
        (self.expected_toggle, self.is_open, self.unanswered, self.is_lost) = (Some(!toggle), false, 0, false);
        match self.state.replace(state) {
            None => Some(GuardEvent::Present(state)),
            Some(before) if before != state => Some(GuardEvent::State(state)),
            Some(_) => None,
        }
    }

    /// Asks when it is time.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) -> Option<GuardEvent> {
        if now < self.ask_at {
            return None;
        }
        let on_grid = self.ask_at + self.guard_time;
        self.ask_at = if on_grid > now { on_grid } else { now + self.guard_time };
        self.unanswered = self.unanswered.saturating_add(u8::from(self.is_open));
        self.is_open = true;
        out.push(Frame::remote(cob::heartbeat(self.node), 1));
        if self.unanswered < self.factor || self.is_lost {
            return None;
        }
        (self.is_lost, self.state, self.expected_toggle) = (true, None, None);
        Some(GuardEvent::Lost)
    }

    /// When to poll next.
    pub const fn next_deadline(&self) -> Time {
        self.ask_at
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use NmtState::*;

    const MS: u64 = 1_000_000;

    fn guard() -> NodeGuard {
        let mut guard = NodeGuard::new(cob::node_id(5).unwrap(), Duration::from_millis(100), 3);
        guard.start(Time(0));
        guard
    }

    fn ask(guard: &mut NodeGuard, ms: u64) -> (Option<GuardEvent>, Vec<Frame>) {
        let mut out = Vec::new();
        (guard.poll(Time(ms * MS), &mut out), out)
    }

    fn hear(guard: &mut NodeGuard, byte: u8) -> Option<GuardEvent> {
        guard.on_frame(&Frame::new(0x705, &[byte]))
    }

    #[test]
    fn asks_by_remote_frame_and_checks_the_toggle_bit() {
        let mut guard = guard();
        let request = vec![Frame::remote(0x705, 1)];
        assert_eq!(ask(&mut guard, 0), (None, request.clone()));
        assert_eq!(hear(&mut guard, 0x7f), Some(GuardEvent::Present(PreOperational)));
        assert_eq!((ask(&mut guard, 99), guard.next_deadline()), ((None, vec![]), Time(100 * MS)));
        assert_eq!(ask(&mut guard, 100), (None, request));
        assert_eq!(hear(&mut guard, 0x7f), Some(GuardEvent::Toggle));
        assert_eq!(hear(&mut guard, 0x85), Some(GuardEvent::State(Operational)));
        assert_eq!(guard.on_frame(&Frame::new(0x706, &[0x05])), None);
        assert_eq!(guard.on_frame(&Frame::remote(0x705, 1)), None);
    }

    #[test]
    fn as_many_unanswered_requests_as_the_factor_are_a_loss() {
        let mut guard = guard();
        ask(&mut guard, 0);
        hear(&mut guard, 0x05);
        let events: Vec<_> = (1..=7).map(|n| ask(&mut guard, 100 * n).0).collect();
        assert_eq!(events, [None, None, None, Some(GuardEvent::Lost), None, None, None]);
        assert_eq!(guard.state(), None);
        // Back with either toggle bit.
        assert_eq!(hear(&mut guard, 0x05), Some(GuardEvent::Present(Operational)));
    }

    #[test]
    fn boot_up_makes_the_toggle_begin_anew() {
        let mut guard = guard();
        hear(&mut guard, 0x05);
        assert_eq!(hear(&mut guard, 0x00), None);
        assert_eq!(hear(&mut guard, 0x7f), Some(GuardEvent::State(PreOperational)));
    }
}
