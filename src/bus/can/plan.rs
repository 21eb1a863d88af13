//! Plan of the boot: the steps and frames that the boot itself will use, listed before anything is sent.

use super::node::Node;
use super::{CanNetwork, refuse};
use crate::error::BootError;
use crate::network::Network;
use crate::script::{PlannedWrite, ScriptPlan};
use yieldwall_fieldbus::canopen::{BusId, Frame, NmtCommand, NodeId, Outbox};
use yieldwall_fieldbus::objects::Address;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::DeviceSet;

/// All that the boot of a network sends, in its order, beside the heartbeats that follow the first ones. From the end of
/// [`BootPlan::start`] on there are SYNC and set-points as well.
#[derive(Clone, Debug, Default)]
pub struct BootPlan {
    /// The first heartbeat; then the reset of each node, and a heartbeat.
    pub reset: Vec<Frame>,
    /// Requests and commands to each node; all nodes run at the same time.
    pub nodes: Vec<NodePlan>,
    /// The start of each node, then the commands to a sensor on plain CAN.
    pub start: Vec<Frame>,
    /// Commands to each node when the master leaves the network.
    pub leave: Vec<Frame>,
}

/// Requests and commands to one node.
#[derive(Clone, Debug)]
pub struct NodePlan {
    /// Devices of the rig that it is: one, or drives that are axes of one device.
    pub devices: DeviceSet,
    /// Its name in the rig.
    pub name: String,
    /// The bus that it is on.
    pub bus: BusId,
    /// Its node id.
    pub id: NodeId,
    script: ScriptPlan,
}

impl CanNetwork {
    /// Returns the plan of the boot.
    pub(super) fn boot_plan(&self) -> BootPlan {
        let mut network = self.clone();
        let now = Time::default();
        let mut reset = Vec::new();
        network.announce(now, &mut reset);
        network.start(now, &mut reset);
        let mut start = Vec::new();
        network.command(NmtCommand::StartRemoteNode, &mut start);
        let bus = network.sensor_bus;
        if let Some(client) = network.image.plain_mut() {
            client.start(now, &mut start.on(bus));
        }
        let mut leave = Vec::new();
        network.leave(&mut leave);
        BootPlan { reset, nodes: self.nodes.iter().map(NodePlan::of).collect(), start, leave }
    }
}

impl NodePlan {
    fn of(node: &Node) -> Self {
        let (steps, identity) = node.boot.steps();
        let (name, script) = (node.name.clone(), ScriptPlan::new(steps, identity));
        Self { devices: node.devices, name, bus: node.bus, id: node.id, script }
    }

    /// All that is written or stands already, in its order, for a node whose objects hold what `read` says; and why the boot would refuse the
    /// node, if it would. A refusal by the node itself shows only when it is written to.
    pub fn writes(&self, read: impl FnMut(Address) -> Option<Vec<u8>>) -> (Vec<PlannedWrite>, Result<(), BootError>) {
        let (writes, refused) = self.script.writes(read);
        (writes, refused.map_err(|(step, failure)| refuse(Some(self.id.raw()), &self.name, step, failure)))
    }
}
