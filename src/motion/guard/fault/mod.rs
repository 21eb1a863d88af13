//! Faults of a running rig, as data: detection, reaction, bound, and the next step for the person.
//!
//! The faults that the cycle can see are in [`Fault`]. Their reactions and times are in [`TABLE`], and [`FaultCounts`] counts how often and
//! where the cycle saw them. `docs/faults.md` is the same table for people.

mod counts;
mod devices;
mod table;
mod words;

pub use counts::{Cause, FaultCounts};
pub use devices::{Device, DeviceSet};
pub use table::TABLE;

use super::State;

/// Reaction of the rig to a fault. Ordered: if there are several at once, the greatest acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Reaction {
    /// R0. Counted; nothing else.
    Count,
    /// R1: the force input is forced to zero and the reference comes to rest; clears automatically.
    Freeze,
    /// R2: the reference stops along a jerk-limited ramp, then the drives quick-stop.
    StopRamp,
    /// R3: quick stop of all drives, at once.
    QuickStop,
    /// R4: voltage off on all drives, at once.
    TorqueOff,
    /// R5: the bus cannot be reached; the drives' own watchdogs act.
    Silence,
}

/// A fault that the cycle can see.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Fault {
    /// A stop asked for by the person; not a defect, but it takes the same way.
    StopRequested,
    /// The force sensor says that its sample is not valid, or the sample is not finite.
    SensorInvalid,
    /// The force sensor reads at or beyond 98 % of its range, or says so.
    SensorSaturated,
    /// All six channels of the force sensor repeat the same counts.
    SensorStuck,
    /// No new force sample for more than two of its declared periods.
    SensorStale,
    /// No new force sample for ten of its declared periods.
    SensorLost,
    /// The force changed more from one sample to the next than a hand can make it.
    ForceStep,
    /// A force beyond the configured limit.
    ForceLimit,
    /// The sensed force does not fit the torques and the motion of the arm.
    ForceImplausible,
    /// The rig gave the hand more energy in one go than it held and its surfaces brought.
    EnergyLimit,
    /// The reference swings to and fro under the hand.
    Chatter,
    /// A drive's process data did not arrive in this cycle, or it did not take its own of the one before.
    PdoMissed,
    /// A process data frame had the wrong length.
    PdoLength,
    /// A process data frame came twice in one cycle.
    PdoDuplicated,
    /// A process data frame came that belongs to an earlier cycle.
    PdoLate,
    /// A node announced its start while it should be running.
    NodeReset,
    /// A node's heartbeat was missing for longer than its consumer time, or it left Operational.
    HeartbeatLost,
    /// Two devices share a node id.
    DuplicateNode,
    /// Another participant sends frames that only this master may send.
    Intruder,
    /// A node sent an emergency message.
    Emergency,
    /// A node sent an emergency message that is a warning.
    EmergencyWarning,
    /// A drive reports Fault or Fault Reaction Active.
    DriveFault,
    /// A drive has no voltage at its power stage, as after an emergency stop.
    DriveVoltageOff,
    /// A drive left Operation Enabled without being asked to.
    DriveLeftOperation,
    /// A drive warns of its temperature or load (status word bit 7).
    DriveWarning,
    /// A drive reports that it does not follow the command value (status word bit 12).
    DriveIgnoresCommand,
    /// The measured angle is too far from the commanded one.
    FollowingError,
    /// The measured angle is twice as far from the commanded one as the limit of a following error.
    Runaway,
    /// The measured angle changed more in one cycle than the arm can move.
    EncoderJump,
    /// The measured angles belong to no posture of the configured linkage.
    Posture,
    /// The reference would pass the margin to a singularity or to the workspace edge; it is held there.
    WorkspaceEdge,
    /// The arm has passed the margin to a singularity or to the workspace edge.
    WorkspaceLeft,
    /// The reference moves faster than the configured limit.
    OverSpeed,
    /// A stage of the cycle produced a value that is not finite.
    NotFinite,
    /// The drives did not reach Operation Enabled in time.
    EnablingTimeout,
    /// SYNC left more than a fifth of a period beside its moment.
    SyncJitter,
    /// The cycle woke up more than half a period late, or took longer than it has.
    Overrun,
    /// No cycle ran for more than three periods.
    Stalled,
    /// The machine was suspended.
    Suspended,
    /// The cycle itself failed; the caller saw it, since nothing of the cycle runs after that.
    CyclePanicked,
    /// The last cycle's frames had not left when the next ones were due.
    TransmitStalled,
    /// The controller is error-passive: nobody acknowledges.
    ErrorPassive,
    /// The controller is bus-off.
    BusOff,
    /// Own frames could not be sent, or the interface is down.
    LinkDown,
    /// A device of an EtherCAT segment left OP.
    DeviceState,
    /// The reference clock of a segment, or the clock of a device, is away from the grid of the cycles.
    ClockLost,
    /// A port of a device of a segment counts errors, or has lost its link.
    PortErrors,
}

impl Fault {
    /// Number of faults.
    pub const COUNT: usize = Fault::PortErrors as usize + 1;

    /// Returns the row of [`TABLE`] that describes this fault.
    ///
    /// Real-time: yes.
    pub fn row(self) -> &'static FaultRow {
        &TABLE[self as usize]
    }

    /// Whether the fault shows on a healthy rig when its computer, or the one that simulates its devices, has stood still. Late frames are
    /// then missing, and devices without a master stop by themselves.
    pub fn may_follow_standstill(self) -> bool {
        #[rustfmt::skip]
        let may = matches!(
            self,
            Fault::SensorStale | Fault::SensorLost | Fault::PdoMissed | Fault::PdoDuplicated | Fault::PdoLate
                | Fault::NodeReset | Fault::HeartbeatLost | Fault::DuplicateNode | Fault::Emergency | Fault::EmergencyWarning
                | Fault::DriveFault | Fault::DriveLeftOperation | Fault::DriveIgnoresCommand | Fault::FollowingError
                | Fault::Runaway | Fault::OverSpeed | Fault::EnablingTimeout | Fault::TransmitStalled | Fault::DeviceState
                | Fault::ClockLost
        );
        may
    }
}

/// The stage of the cycle in which a fault shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stage {
    /// The person at the rig.
    Operator,
    /// The force sensor and what becomes of its samples.
    Sensing,
    /// Frames that arrive.
    Bus,
    /// The state of the drives.
    Drives,
    /// Joint angles and the posture of the arm.
    Arm,
    /// The reference, the control laws and the gate.
    Motion,
    /// This computer's clock and scheduling.
    Host,
    /// This computer's way to the bus.
    Link,
}

/// Number of observations of a fault before a reaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rate {
    /// This often in a row, at least once. In cycles, and for [`Stage::Sensing`] in samples of the sensor.
    InARow(u16),
    /// This often, at least once and at most [`FaultCounts::MAX_WITHIN`] times, within so many cycles.
    Within {
        /// Number of observations.
        count: u16,
        /// Cycles, the present one included.
        cycles: u16,
    },
}

/// The longest time from the first observable sign of a fault to the frame that carries a reaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// Cycles.
    Cycles(u16),
    /// New samples that the force sensor should have sent, in its declared period.
    Samples(u16),
    /// The consumer time of the node's heartbeat, and one cycle.
    HeartbeatTime,
}

/// One step of a fault's escalation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Rate of observations that starts the step.
    pub rate: Rate,
    /// The reaction.
    pub reaction: Reaction,
    /// Longest time to its effect.
    pub bound: Bound,
}

/// Table row of one fault.
#[derive(Clone, Copy, Debug)]
pub struct FaultRow {
    /// The fault.
    pub fault: Fault,
    /// Short name, unique, as it stands in reports.
    pub name: &'static str,
    /// Stage at which it shows.
    pub stage: Stage,
    /// Meaning of the fault.
    pub meaning: &'static str,
    /// The most frequent cause.
    pub cause: &'static str,
    /// Next step for a person.
    pub next: &'static str,
    /// Escalation in rising order.
    pub steps: &'static [Step],
    /// The state in which a quick stop by this fault latches.
    pub latched: State,
}

impl FaultRow {
    /// Returns the state in which the rig ends by `reaction` to this fault, once it is at rest.
    ///
    /// Real-time: yes.
    pub fn final_state(&self, reaction: Reaction) -> State {
        match reaction {
            Reaction::Count => State::Running,
            Reaction::Freeze => State::Holding,
            Reaction::StopRamp => State::Stopped,
            Reaction::QuickStop => self.latched,
            Reaction::TorqueOff => State::Disabled,
            Reaction::Silence => State::Lost,
        }
    }
}
