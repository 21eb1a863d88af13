//! What the boot sends, told before anything is sent: by the steps and the frames that the boot itself takes.

use super::node::Node;
use super::{CanNetwork, refuse};
use crate::error::BootError;
use crate::network::Network;
use crate::script::{Action, Step, check, little_endian, motor_speed};
use yieldwall_drives::profiles::Identity;
use yieldwall_fieldbus::canopen::{BusId, Frame, NmtCommand, NodeId, Outbox};
use yieldwall_fieldbus::objects::Address;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::Device;

/// All that the boot of a network sends, in its order, beside the heartbeats that follow the first ones. From the end of
/// [`BootPlan::start`] on there are SYNC and set-points as well.
#[derive(Clone, Debug, Default)]
pub struct BootPlan {
    /// The first heartbeat; then the reset of each node, and a heartbeat.
    pub reset: Vec<Frame>,
    /// What each node is asked and told, at the same time as the others.
    pub nodes: Vec<NodePlan>,
    /// The start of each node; then what a sensor on plain CAN is told.
    pub start: Vec<Frame>,
    /// What each node is told when the network is left.
    pub leave: Vec<Frame>,
}

/// What one node is asked and told.
#[derive(Clone, Debug)]
pub struct NodePlan {
    /// Which device of the rig it is.
    pub device: Device,
    /// Its name in the rig.
    pub name: String,
    /// The bus that it is on.
    pub bus: BusId,
    /// Its node id.
    pub id: NodeId,
    steps: Vec<Step>,
    identity: Identity,
}

/// An object that the boot writes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedWrite {
    /// What for.
    pub doing: &'static str,
    /// The object.
    pub at: Address,
    /// Its bytes before, as far as they could be read.
    pub old: Option<Vec<u8>>,
    /// The bytes that are written; `None` where they depend on an object that could not be read.
    pub new: Option<Vec<u8>>,
}

impl CanNetwork {
    /// What the boot will send.
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
        let (name, identity) = (node.name.clone(), identity.clone());
        Self { device: node.device, name, bus: node.bus, id: node.id, steps: steps.to_vec(), identity }
    }

    /// All that is written, in its order, for a node whose objects hold what `read` says; and why the boot would refuse the node, if it
    /// would. What the node refuses itself shows only when it is written to.
    pub fn writes(
        &self,
        mut read: impl FnMut(Address) -> Option<Vec<u8>>,
    ) -> (Vec<PlannedWrite>, Result<(), BootError>) {
        let mut writes: Vec<PlannedWrite> = Vec::new();
        let mut resolution = [None; 2];
        let mut refused = Ok(());
        for step in &self.steps {
            let at = Address::new(step.index, step.sub);
            let new = match step.action {
                Action::Write { value } | Action::WriteAndVerify { value } => Some(value),
                Action::LimitSpeed { counts_per_s } => match resolution {
                    [Some(increments), Some(revolutions)] => match motor_speed(counts_per_s, [increments, revolutions])
                    {
                        Ok(value) => Some(value),
                        Err(failure) => {
                            refused = refused.and(Err(self.refuse(step, failure)));
                            None
                        }
                    },
                    _ => None,
                },
                // It comes to its value when the mode was written.
                Action::Await { .. } | Action::CopyTime => continue,
                Action::Expect { .. } | Action::Product | Action::Revision | Action::Resolution { .. } => {
                    let Some(held) = read(at).map(|bytes| little_endian(&bytes)) else { continue };
                    let checked = check(step, held, &self.identity);
                    refused = refused.and(checked.map_err(|failure| self.refuse(step, failure)));
                    if let Action::Resolution { part } = step.action
                        && let Some(known) = resolution.get_mut(part)
                    {
                        *known = Some(held);
                    }
                    continue;
                }
            };
            let written = writes.iter().rev().find(|write| write.at == at).and_then(|write| write.new.clone());
            let new = new.map(|value| value.to_le_bytes().into_iter().take(step.bytes.into()).collect());
            writes.push(PlannedWrite { doing: step.doing, at, old: written.or_else(|| read(at)), new });
        }
        (writes, refused)
    }

    fn refuse(&self, step: &Step, failure: crate::BootFailure) -> BootError {
        refuse(Some(self.id.raw()), &self.name, step.doing, failure)
    }
}
