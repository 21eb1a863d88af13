//! State of one bus as the master sees it.

use super::node::Node;
use crate::setup::MasterSetup;
use yieldwall_drives::watchdog::HEARTBEAT_PERIODS;
use yieldwall_fieldbus::canopen::nmt::HeartbeatConsumer;
use yieldwall_fieldbus::canopen::{BusId, Frame, NodeSet, cob};

/// One bus.
#[derive(Clone)]
pub(super) struct Line {
    /// Identifier of the bus.
    pub(super) bus: BusId,
    /// Whether somebody hears SYNC there.
    pub(super) has_sync: bool,
    /// Whether there are CANopen nodes.
    pub(super) has_nodes: bool,
    /// Heartbeats of its nodes.
    pub(super) watch: HeartbeatConsumer,
    /// Set-points that leave in each cycle.
    set_points: u8,
    /// The last frames of a cycle that were sent and not seen on the bus yet: set-points, or SYNC where there are none.
    pub(super) in_flight: u8,
    /// The nodes that have said something of themselves since the boot began.
    pub(super) heard: NodeSet,
}

impl Line {
    pub(super) fn new(setup: &MasterSetup, bus: BusId, nodes: &[Node]) -> Self {
        let mut watch = HeartbeatConsumer::new();
        for node in nodes.iter().filter(|node| node.bus == bus) {
            watch.watch(node.id, node.heartbeat * HEARTBEAT_PERIODS);
        }
        Self {
            bus,
            has_sync: setup.has_sync(bus),
            has_nodes: setup.has_nodes(bus),
            watch,
            set_points: setup.drives.iter().filter(|drive| drive.bus == bus).count() as u8,
            in_flight: 0,
            heard: NodeSet::default(),
        }
    }

    /// Forgets all that was on its way and what the nodes said.
    pub(super) fn restart(&mut self) {
        self.watch.restart();
        self.in_flight = 0;
        self.heard = NodeSet::default();
    }

    /// SYNC was sent, if it is sent here at all.
    pub(super) fn note_sync(&mut self) {
        if self.has_sync && self.set_points == 0 {
            self.in_flight = 1;
        }
    }

    /// The set-points of a cycle were sent.
    pub(super) fn note_set_points(&mut self) {
        if self.set_points > 0 {
            self.in_flight = self.set_points;
        }
    }

    /// An own frame was seen on this bus.
    pub(super) fn on_echo(&mut self, frame: &Frame, is_set_point: bool) {
        let is_last = is_set_point || (self.set_points == 0 && frame.id() == cob::SYNC);
        self.in_flight = self.in_flight.saturating_sub(u8::from(is_last));
    }
}
