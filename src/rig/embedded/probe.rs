//! The rig step by step, and what only a simulation knows, for those who judge it.

use super::buses::{DEVICES, MASTER};
use super::{Body, EmbeddedRig};
use crate::RigError;
use yieldwall_motion::quantity::{Force, JointAngles, TipPoint, TipVelocity};
use yieldwall_sim::can::Witness;

/// Ports of the master, of the drives and of the sensor, as a [`Witness`] sees them; any other belongs to a device that is
/// not of the rig.
pub const PORTS: [usize; 4] = [MASTER, DEVICES[0], DEVICES[1], DEVICES[2]];

/// True state of arm and hand, which no device reports.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BodyTruth {
    /// Tool point at the last SYNC.
    pub tool: TipPoint,
    /// Its velocity.
    pub velocity: TipVelocity,
    /// Force of the hand on the tool at the last SYNC.
    pub hand: Force,
    /// Angles of the joints now, on the motors' side.
    pub angles: JointAngles,
}

impl EmbeddedRig {
    /// Passes every frame's passage to `witness` from now on.
    pub fn set_witness(&mut self, witness: Witness) {
        self.place_mut().wires.buses.set_witness(witness);
    }

    /// Switches everything on and boots the network without enabling anything; cycles can be run from then on.
    ///
    /// # Errors
    /// [`RigError::Boot`] if a node is missing or is not what it should be.
    pub fn power_up(&mut self) -> Result<(), RigError> {
        self.boot()
    }

    /// Boots the network anew, without switching anything off and without enabling anything.
    ///
    /// # Errors
    /// As [`EmbeddedRig::power_up`].
    pub fn boot_again(&mut self) -> Result<(), RigError> {
        self.start_network()
    }

    /// Makes the hand take the handle and begin its path at the next SYNC.
    pub fn take_handle(&mut self) {
        self.take_tool();
    }

    /// Whether the process that runs the master has ended for good.
    pub fn is_master_gone(&self) -> bool {
        self.place().computer.is_dead()
    }

    /// Returns the true state of arm and hand.
    pub fn body_truth(&self) -> BodyTruth {
        let truth = &self.place().far.world.truth;
        let angles = match &self.place().far.world.body {
            Body::Arm(arm) => arm.motor_angles(),
            Body::Ideal(ideal) => ideal.angles,
        };
        BodyTruth { tool: truth.tip, velocity: truth.velocity, hand: truth.force, angles }
    }
}
