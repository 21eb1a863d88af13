//! NMT commands and error control: boot-up and heartbeat, and the consumer that watches them.

use std::time::Duration;

use super::{Frame, NmtCommand, NmtState, NodeId, cob};
use crate::time::Time;

/// Returns the command frame to one node, or to all nodes for `None`.
///
/// Real-time: yes.
pub fn command(command: NmtCommand, node: Option<NodeId>) -> Frame {
    Frame::new(cob::NMT, &canopen_rs::nmt::encode_command(command, node.unwrap_or(NodeId::BROADCAST)))
}

/// Returns the command in a frame, and its addressee, `None` for all nodes; `None` if the frame is not an NMT command.
///
/// Real-time: yes.
pub fn decode_command(frame: &Frame) -> Option<(NmtCommand, Option<NodeId>)> {
    if frame.id() != cob::NMT {
        return None;
    }
    let data = <&[u8; 2]>::try_from(frame.data()).ok()?;
    let (command, node) = canopen_rs::nmt::decode_command(data).ok()?;
    Some((command, (node != NodeId::BROADCAST).then_some(node)))
}

/// Returns the heartbeat of a node; with [`NmtState::Initialising`] the boot-up message.
///
/// Real-time: yes.
pub fn heartbeat(node: NodeId, state: NmtState) -> Frame {
    Frame::new(cob::heartbeat(node), &canopen_rs::nmt::encode_heartbeat(state))
}

/// Returns the sender and state of a heartbeat ([`NmtState::Initialising`]: boot-up); `None` for any other frame.
///
/// Real-time: yes.
pub fn decode_heartbeat(frame: &Frame) -> Option<(NodeId, NmtState)> {
    let raw = frame.id().checked_sub(0x700).filter(|raw| (1..=127).contains(raw))?;
    let data = <&[u8; 1]>::try_from(frame.data()).ok()?;
    Some((NodeId::new(raw as u8).ok()?, canopen_rs::nmt::decode_heartbeat(data).ok()?))
}

/// Change of a watched node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeartbeatChange {
    /// Boot-up message: the node was switched on or reset. Its next heartbeat starts the watch anew.
    BootUp,
    /// First heartbeat, or the first one after it was lost.
    Present(NmtState),
    /// The state in the heartbeat changed.
    State(NmtState),
    /// No heartbeat within the time allowed.
    Lost,
}

/// An event of a watched node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeartbeatEvent {
    /// The node.
    pub node: NodeId,
    /// Its change.
    pub change: HeartbeatChange,
}

/// Most nodes that one consumer watches.
pub const MAX_WATCHED: usize = 16;

/// No slot in the table of nodes.
const NO_SLOT: u8 = u8::MAX;

#[derive(Clone, Copy, Debug)]
struct Watched {
    node: NodeId,
    timeout: Duration,
    /// `NEVER` while the watch has not started or the node is lost.
    deadline: Time,
    state: Option<NmtState>,
}

/// Watches the heartbeats of up to [`MAX_WATCHED`] nodes; used by the master and by devices (1016h).
///
/// The watch of a node starts with its first heartbeat, or at once with [`HeartbeatConsumer::start`].
#[derive(Clone, Debug)]
pub struct HeartbeatConsumer {
    slots: [u8; 128],
    watched: Vec<Watched>,
    /// Not later than the earliest deadline.
    next: Time,
}

impl Default for HeartbeatConsumer {
    fn default() -> Self {
        Self::new()
    }
}

impl HeartbeatConsumer {
    /// Watches nobody.
    pub fn new() -> Self {
        HeartbeatConsumer { slots: [NO_SLOT; 128], watched: Vec::with_capacity(MAX_WATCHED), next: Time::NEVER }
    }

    /// Watches `node`, whose heartbeat must come at least every `timeout`; a node already watched starts anew. Returns
    /// whether there was room; a zero `timeout` watches nothing and returns false.
    pub fn watch(&mut self, node: NodeId, timeout: Duration) -> bool {
        let fresh = Watched { node, timeout, deadline: Time::NEVER, state: None };
        if timeout.is_zero() {
            return false;
        }
        if let Some(watched) = self.slot(node) {
            *watched = fresh;
            return true;
        }
        let place = self.watched.len();
        let Some(slot) = self.slots.get_mut(usize::from(node.raw())).filter(|_| place < MAX_WATCHED) else {
            return false;
        };
        *slot = place as u8;
        self.watched.push(fresh);
        true
    }

    /// Watches nobody any more.
    pub fn clear(&mut self) {
        self.slots = [NO_SLOT; 128];
        self.watched.clear();
        self.next = Time::NEVER;
    }

    /// Starts the watch of `node` now, without waiting for its first heartbeat.
    pub fn start(&mut self, now: Time, node: NodeId) {
        if let Some(watched) = self.slot(node) {
            let deadline = now + watched.timeout;
            watched.deadline = deadline;
            self.next = self.next.min(deadline);
        }
    }

    /// Forgets what was heard of every node, as if the watch had just been set up.
    pub fn restart(&mut self) {
        for watched in &mut self.watched {
            (watched.deadline, watched.state) = (Time::NEVER, None);
        }
        self.next = Time::NEVER;
    }

    /// Returns the last state heard from `node`; `None` if it is not watched, was never heard or is lost.
    pub fn state(&self, node: NodeId) -> Option<NmtState> {
        let place = *self.slots.get(usize::from(node.raw()))?;
        self.watched.get(usize::from(place))?.state
    }

    /// Takes a frame from the bus; other frames than heartbeats of watched nodes do nothing.
    ///
    /// Real-time: yes.
    pub fn on_frame(&mut self, now: Time, frame: &Frame) -> Option<HeartbeatEvent> {
        let (node, state) = decode_heartbeat(frame)?;
        let watched = self.slot(node)?;
        let before = watched.state;
        if state == NmtState::Initialising {
            (watched.state, watched.deadline) = (None, Time::NEVER);
            return Some(HeartbeatEvent { node, change: HeartbeatChange::BootUp });
        }
        let deadline = now + watched.timeout;
        (watched.state, watched.deadline) = (Some(state), deadline);
        self.next = self.next.min(deadline);
        let change = match before {
            None => HeartbeatChange::Present(state),
            Some(before) if before != state => HeartbeatChange::State(state),
            Some(_) => return None,
        };
        Some(HeartbeatEvent { node, change })
    }

    /// Returns the next node whose time is up; call until `None`.
    ///
    /// Real-time: yes.
    pub fn poll(&mut self, now: Time) -> Option<HeartbeatEvent> {
        if now < self.next {
            return None;
        }
        if let Some(lost) = self.watched.iter_mut().find(|watched| watched.deadline <= now) {
            (lost.deadline, lost.state) = (Time::NEVER, None);
            return Some(HeartbeatEvent { node: lost.node, change: HeartbeatChange::Lost });
        }
        self.next = self.watched.iter().map(|watched| watched.deadline).min().unwrap_or(Time::NEVER);
        None
    }

    /// Returns the latest time of the next poll; it may be earlier than the earliest deadline, never later.
    pub fn next_deadline(&self) -> Time {
        self.next
    }

    fn slot(&mut self, node: NodeId) -> Option<&mut Watched> {
        let place = *self.slots.get(usize::from(node.raw()))?;
        self.watched.get_mut(usize::from(place))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use HeartbeatChange::*;
    use NmtState::*;

    const MS: u64 = 1_000_000;

    fn node(raw: u8) -> NodeId {
        cob::node_id(raw).unwrap()
    }

    fn beat(consumer: &mut HeartbeatConsumer, ms: u64, raw: u8, state: NmtState) -> Option<HeartbeatChange> {
        consumer.on_frame(Time(ms * MS), &heartbeat(node(raw), state)).map(|event| event.change)
    }

    #[test]
    fn command_bytes() {
        let pairs = [
            (NmtCommand::StartRemoteNode, [0x01, 5]),
            (NmtCommand::StopRemoteNode, [0x02, 5]),
            (NmtCommand::EnterPreOperational, [0x80, 5]),
            (NmtCommand::ResetNode, [0x81, 5]),
            (NmtCommand::ResetCommunication, [0x82, 5]),
        ];
        for (given, bytes) in pairs {
            assert_eq!(command(given, Some(node(5))), Frame::new(0x000, &bytes));
            assert_eq!(decode_command(&Frame::new(0, &bytes)), Some((given, Some(node(5)))));
        }
        assert_eq!(command(NmtCommand::ResetNode, None), Frame::new(0x000, &[0x81, 0]));
        assert_eq!(decode_command(&Frame::new(0, &[0x01, 0])), Some((NmtCommand::StartRemoteNode, None)));
    }

    #[test]
    fn malformed_commands_and_heartbeats_are_nothing() {
        for bytes in [&[][..], &[1], &[1, 5, 0], &[3, 5], &[1, 128]] {
            assert_eq!(decode_command(&Frame::new(0, bytes)), None);
        }
        assert_eq!(decode_command(&Frame::new(0x080, &[1, 5])), None);
        for frame in [
            Frame::new(0x700, &[5]),
            Frame::new(0x780, &[5]),
            Frame::new(0x705, &[]),
            Frame::new(0x705, &[5, 0]),
            Frame::new(0x705, &[6]),
        ] {
            assert_eq!(decode_heartbeat(&frame), None);
        }
    }

    #[test]
    fn heartbeat_bytes() {
        for (state, byte) in [(Initialising, 0x00), (Stopped, 0x04), (Operational, 0x05), (PreOperational, 0x7f)] {
            assert_eq!(heartbeat(node(5), state), Frame::new(0x705, &[byte]));
            assert_eq!(decode_heartbeat(&Frame::new(0x705, &[byte])), Some((node(5), state)));
        }
    }

    #[test]
    fn watch_starts_with_the_first_heartbeat_and_ends_with_silence() {
        let mut consumer = HeartbeatConsumer::new();
        assert!(consumer.watch(node(5), Duration::from_millis(50)));
        assert_eq!((consumer.poll(Time(1000 * MS)), consumer.next_deadline()), (None, Time::NEVER));
        assert_eq!(beat(&mut consumer, 1000, 5, PreOperational), Some(Present(PreOperational)));
        assert_eq!(beat(&mut consumer, 1020, 5, PreOperational), None);
        assert_eq!(beat(&mut consumer, 1040, 5, Operational), Some(State(Operational)));
        assert_eq!(consumer.poll(Time(1090 * MS - 1)), None);
        assert_eq!(consumer.next_deadline(), Time(1090 * MS));
        let lost = HeartbeatEvent { node: node(5), change: Lost };
        assert_eq!(consumer.poll(Time(1090 * MS)), Some(lost));
        assert_eq!((consumer.poll(Time(1090 * MS)), consumer.state(node(5))), (None, None));
        assert_eq!(beat(&mut consumer, 1200, 5, Operational), Some(Present(Operational)));
        assert_eq!(consumer.state(node(5)), Some(Operational));
    }

    #[test]
    fn boot_up_is_an_event_and_stops_the_watch() {
        let mut consumer = HeartbeatConsumer::new();
        consumer.watch(node(5), Duration::from_millis(50));
        beat(&mut consumer, 0, 5, Operational);
        assert_eq!(beat(&mut consumer, 10, 5, Initialising), Some(BootUp));
        assert_eq!(consumer.poll(Time(500 * MS)), None);
        assert_eq!(beat(&mut consumer, 600, 5, PreOperational), Some(Present(PreOperational)));
    }

    #[test]
    fn a_node_that_is_never_heard_is_lost_once_the_watch_was_started() {
        let mut consumer = HeartbeatConsumer::new();
        consumer.watch(node(5), Duration::from_millis(50));
        consumer.start(Time(0), node(5));
        assert_eq!(consumer.next_deadline(), Time(50 * MS));
        assert_eq!(consumer.poll(Time(50 * MS)).map(|event| event.change), Some(Lost));
    }

    #[test]
    fn each_node_has_its_own_time_and_strangers_do_not_count() {
        let mut consumer = HeartbeatConsumer::new();
        consumer.watch(node(5), Duration::from_millis(50));
        consumer.watch(node(6), Duration::from_millis(100));
        assert!(!consumer.watch(node(7), Duration::ZERO));
        beat(&mut consumer, 0, 5, Operational);
        beat(&mut consumer, 0, 6, Operational);
        assert_eq!(beat(&mut consumer, 0, 7, Operational), None);
        assert_eq!(consumer.poll(Time(60 * MS)).map(|event| event.node), Some(node(5)));
        assert_eq!((consumer.poll(Time(60 * MS)), consumer.next_deadline()), (None, Time(100 * MS)));
        assert_eq!(consumer.poll(Time(100 * MS)).map(|event| event.node), Some(node(6)));
    }

    #[test]
    fn there_is_room_for_a_bounded_number() {
        let mut consumer = HeartbeatConsumer::new();
        for raw in 1..=MAX_WATCHED as u8 {
            assert!(consumer.watch(node(raw), Duration::from_millis(1)));
        }
        assert!(!consumer.watch(node(100), Duration::from_millis(1)));
        assert!(consumer.watch(node(1), Duration::from_millis(2)));
    }
}
