//! What the master has to know of the network.

use std::time::Duration;

use crate::plain_can;
use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::profiles::DeviceProfile;
use yieldwall_drives::scaling::AxisScaling;

/// Which quantity the drives take as set-point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandMode {
    /// Cyclic synchronous position.
    Position,
    /// Cyclic synchronous velocity.
    Velocity,
    /// Cyclic synchronous torque.
    Torque,
}

impl CommandMode {
    /// The drives' mode of operation.
    pub const fn operation_mode(self) -> OperationMode {
        match self {
            CommandMode::Position => OperationMode::CyclicPosition,
            CommandMode::Velocity => OperationMode::CyclicVelocity,
            CommandMode::Torque => OperationMode::CyclicTorque,
        }
    }
}

/// One drive.
#[derive(Clone, Debug)]
pub struct DriveSetup {
    /// Name for messages.
    pub name: String,
    /// Node id, 1 to 127.
    pub node_id: u8,
    /// Device model.
    pub profile: &'static DeviceProfile,
    /// Scaling between raw values and SI.
    pub scaling: AxisScaling,
    /// Angle of the joint in rad near which the first position is unwrapped.
    pub expected_angle_rad: f64,
    /// Period of the node's heartbeat.
    pub heartbeat: Duration,
    /// Torque limit that the drive is given, in per mille of its rated torque.
    pub torque_limit_per_mille: u16,
    /// Following error window that the drive is given, in counts.
    pub following_error_counts: u32,
}

/// The force sensor.
#[derive(Clone, Debug)]
pub struct SensorSetup {
    /// Name for messages.
    pub name: String,
    /// What it speaks.
    pub link: SensorLink,
    /// Time from one sample to the next.
    pub sample_period: Duration,
}

/// What a force sensor speaks.
#[derive(Clone, Debug)]
pub enum SensorLink {
    /// CANopen.
    Canopen(SensorNode),
    /// Plain CAN.
    PlainCan(plain_can::Link),
}

/// A force sensor that is a CANopen node.
#[derive(Clone, Debug)]
pub struct SensorNode {
    /// Node id, 1 to 127.
    pub node_id: u8,
    /// Device model.
    pub profile: &'static DeviceProfile,
    /// Period of the node's heartbeat.
    pub heartbeat: Duration,
}

/// The whole network of one rig.
#[derive(Clone, Debug)]
pub struct MasterSetup {
    /// Node id of the master, 1 to 127; the drives watch its heartbeat.
    pub node_id: u8,
    /// Period of the master's heartbeat.
    pub heartbeat: Duration,
    /// Cycle time.
    pub period: Duration,
    /// Command mode of the rig.
    pub mode: CommandMode,
    /// The drives of the left and of the right joint.
    pub drives: [DriveSetup; 2],
    /// The force sensor.
    pub sensor: SensorSetup,
}
