//! Setup of the network for the master.

use std::sync::Arc;
use std::time::Duration;

use yieldwall_drives::cia402::CommandMode;
use yieldwall_drives::profiles::{DeviceProfile, MappedPdo, Servo};
use yieldwall_fieldbus::canopen::BusId;
use yieldwall_fieldbus::plain_can;

/// How long a device is waited for while the network is booted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waits {
    /// From the reset to the boot-up message.
    pub boot_up: Duration,
    /// For the answer to one SDO request.
    pub sdo: Duration,
    /// From the start command to the first heartbeat in Operational, or to the first sample of a sensor on plain CAN.
    pub start: Duration,
}

/// Homing order to a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HomingOrder {
    /// Method (6098h).
    pub method: i8,
    /// Speed of the search for a switch, and of that for zero, counts/s.
    pub speed_counts_per_s: u32,
    /// Acceleration, counts/s^2.
    pub acceleration_counts_per_s2: u32,
    /// Position at home, counts.
    pub position_at_home: i32,
}

/// The digital outputs of a drive whose brake the master holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BrakeWords {
    /// With the brake closed.
    pub closed: u32,
    /// With the brake released.
    pub released: u32,
}

impl BrakeWords {
    /// Returns the brake words of a drive; `None` if the master does not hold its brake.
    pub fn of(servo: &Servo) -> Option<Self> {
        servo.brake.of_master().map(|output| Self { closed: output.word(false), released: output.word(true) })
    }

    /// Returns the word that releases or closes the brake.
    ///
    /// Real-time: yes.
    pub(super) fn word(self, is_released: bool) -> u32 {
        if is_released { self.released } else { self.closed }
    }
}

/// One drive.
#[derive(Clone, Debug)]
pub struct DriveSetup {
    /// Name for messages.
    pub name: String,
    /// Bus of the drive.
    pub bus: BusId,
    /// Node id, 1 to 127.
    pub node_id: u8,
    /// Device model.
    pub profile: Arc<DeviceProfile>,
    /// Period of the node's heartbeat.
    pub heartbeat: Duration,
    /// How long it is waited for.
    pub waits: Waits,
    /// Torque limit that the drive is given, in per mille of its rated torque.
    pub torque_limit_per_mille: u16,
    /// Speed limit that the drive is given where it heeds one, in counts/s.
    pub speed_limit_counts_per_s: u32,
    /// Following error window that the drive is given, in counts.
    pub following_error_counts: u32,
    /// How it homes, if it is brought up for that; in the command mode of the rig otherwise.
    pub homing: Option<HomingOrder>,
}

impl DriveSetup {
    /// Whether another drive is another axis of the same device.
    pub(super) fn shares_device(&self, other: &Self) -> bool {
        let are_axes = self.profile.axis().zip(other.profile.axis()).is_some_and(|(own, other)| own != other);
        are_axes && (self.bus, self.node_id) == (other.bus, other.node_id)
    }
}

/// The force sensor.
#[derive(Clone, Debug)]
pub struct SensorSetup {
    /// Name for messages.
    pub name: String,
    /// Bus of the sensor.
    pub bus: BusId,
    /// Protocol of the sensor.
    pub link: SensorLink,
    /// How long it is waited for.
    pub waits: Waits,
    /// Time from one sample to the next.
    pub sample_period: Duration,
}

/// Protocol of a force sensor.
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
    pub profile: Arc<DeviceProfile>,
    /// Period of the node's heartbeat.
    pub heartbeat: Duration,
    /// Steps of the boot besides its process data.
    pub start: SensorStart,
}

/// Steps of the boot for a force sensor besides its process data.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensorStart {
    /// Whether the sensor is commanded to zero itself, by the objects of its profile.
    pub zeroes: bool,
    /// Counts per N and per N m by the rig's calibration, with which those that the sensor reports are compared.
    pub counts_per_unit: [f64; 2],
}

/// The devices of one rig on CAN, on as many buses as they name.
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
    /// The drives of the left and of the right joint; none where both are on an EtherCAT segment.
    pub drives: Vec<DriveSetup>,
    /// The force sensor.
    pub sensor: SensorSetup,
}

impl MasterSetup {
    /// The buses: all that a device is on.
    pub(super) fn buses(&self) -> impl Iterator<Item = BusId> + use<> {
        let used: Vec<BusId> = self.drives.iter().map(|drive| drive.bus).chain([self.sensor.bus]).collect();
        BusId::all().filter(move |bus| used.contains(bus))
    }

    /// Whether a device on a bus uses SYNC: a drive, or a force sensor with synchronous process data.
    pub(super) fn has_sync(&self, bus: BusId) -> bool {
        let is_synchronous = |node: &SensorNode| {
            node.profile.mapped(None).is_some_and(|[_, tpdo]| tpdo.iter().any(MappedPdo::is_synchronous))
        };
        self.drives.iter().any(|drive| drive.bus == bus)
            || (self.sensor.bus == bus && self.sensor.node().is_some_and(is_synchronous))
    }

    /// Whether there are CANopen nodes on a bus.
    pub(super) fn has_nodes(&self, bus: BusId) -> bool {
        self.drives.iter().any(|drive| drive.bus == bus) || (self.sensor.bus == bus && self.sensor.node().is_some())
    }
}

impl SensorSetup {
    /// The sensor as a CANopen node, if it is one.
    fn node(&self) -> Option<&SensorNode> {
        match &self.link {
            SensorLink::Canopen(node) => Some(node),
            SensorLink::PlainCan(_) => None,
        }
    }
}
