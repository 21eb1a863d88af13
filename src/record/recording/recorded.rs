//! Records that a recording can hold: the cycles of a rig, the samples of an impedance device.

use super::about::Machine;
use super::fields::{Visitor, walk_cycle, walk_sample};
use crate::{CycleRecord, DeviceRecord};

/// A record with a list of fields. Schema, bytes, text and comparison follow from the list. Only types of this program implement it.
pub trait Recorded: Copy + Send + 'static {
    /// Name of the message definition.
    const SCHEMA: &'static str;
    /// Topic of its channel.
    const TOPIC: &'static str;
    /// Text at the head of the definition.
    const HEAD: &'static str;

    /// Whether recordings of this machine hold such records.
    fn fits(machine: &Machine) -> bool;

    /// Returns a record to fill in.
    fn blank() -> Self;

    /// Shows `visitor` every field in its order.
    fn walk<V: Visitor>(&mut self, visitor: &mut V);

    /// Returns the number among its kind.
    fn index(&self) -> u64;

    /// Returns the start time, in ns of its own clock.
    fn begun_ns(&self) -> u64;

    /// Returns the time at which its inputs were complete, in ns of its own clock.
    fn complete_ns(&self) -> u64;

    /// Returns the time of the scene in s; minus infinity before.
    fn scene_time_s(&self) -> f64;
}

impl Recorded for CycleRecord {
    const SCHEMA: &'static str = "yieldwall_msgs/msg/Cycle";
    const TOPIC: &'static str = "/cycle";
    const HEAD: &'static str = "# One control cycle: its inputs and its outputs. A value is 0 if its has_ field is false.\n# Numbers of several devices are added.\n";

    fn fits(machine: &Machine) -> bool {
        matches!(machine, Machine::Rig(_))
    }

    fn blank() -> Self {
        use yieldwall_drives::cia402;
        use yieldwall_motion::cycle::{DriveSample, Inputs, LinkEvents, Signals, Timing};
        use yieldwall_motion::guard::{Directive, JointCommand, Request};
        let drive = DriveSample {
            angle_rad: None,
            state: cia402::State::NotReadyToSwitchOn,
            follows_command: false,
            has_voltage: false,
            has_warning: false,
        };
        CycleRecord {
            moment: Default::default(),
            inputs: Inputs {
                drives: [drive; 2],
                sample: None,
                link: LinkEvents::default(),
                timing: Timing::default(),
                request: Request::None,
            },
            command: JointCommand::Torque(Default::default()),
            directive: Directive::IDLE,
            cause: None,
            signals: Signals::default(),
            truth: None,
        }
    }

    fn walk<V: Visitor>(&mut self, visitor: &mut V) {
        walk_cycle(self, visitor);
    }

    fn index(&self) -> u64 {
        self.moment.index
    }

    fn begun_ns(&self) -> u64 {
        self.moment.sync_ns
    }

    fn complete_ns(&self) -> u64 {
        self.moment.compute_ns
    }

    fn scene_time_s(&self) -> f64 {
        self.moment.scene_time_s
    }
}

impl Recorded for DeviceRecord {
    const SCHEMA: &'static str = "yieldwall_msgs/msg/Sample";
    const TOPIC: &'static str = "/sample";
    const HEAD: &'static str =
        "# One sample of an impedance device: what it reported and what its fixture made of that.\n";

    fn fits(machine: &Machine) -> bool {
        matches!(machine, Machine::Device(_))
    }

    fn blank() -> Self {
        Self::default()
    }

    fn walk<V: Visitor>(&mut self, visitor: &mut V) {
        walk_sample(self, visitor);
    }

    fn index(&self) -> u64 {
        self.index
    }

    fn begun_ns(&self) -> u64 {
        self.sample_ns
    }

    fn complete_ns(&self) -> u64 {
        self.sample_ns
    }

    fn scene_time_s(&self) -> f64 {
        self.scene_time_s
    }
}
