//! The table of faults.

use super::Bound::{Cycles, HeartbeatTime, Samples};
use super::Rate::{InARow, Within};
use super::Reaction::{self, Count, Freeze, QuickStop, Silence, StopRamp};
use super::{Fault, Row, Stage, Step};
use crate::guard::State;

const fn in_a_row(times: u16, reaction: Reaction) -> Step {
    Step { rate: InARow(times), reaction, bound: Cycles(times) }
}

const fn once(reaction: Reaction) -> Step {
    in_a_row(1, reaction)
}

const fn sample(times: u16, reaction: Reaction) -> Step {
    Step { rate: InARow(times), reaction, bound: Samples(times) }
}

/// The bound counts from the observation that makes the number full.
const fn within(count: u16, cycles: u16, reaction: Reaction) -> Step {
    Step { rate: Within { count, cycles }, reaction, bound: Cycles(1) }
}

macro_rules! row {
    ($fault:ident, $name:literal, $stage:ident, [$($step:expr),+], $latched:ident, $meaning:literal, $cause:literal,
        $next:literal) => {
        Row {
            fault: Fault::$fault,
            name: $name,
            stage: Stage::$stage,
            meaning: $meaning,
            cause: $cause,
            next: $next,
            steps: &[$($step),+],
            latched: State::$latched,
        }
    };
}

/// All faults, in the order of [`Fault`].
pub const TABLE: [Row; Fault::COUNT] = [
    row!(
        StopRequested,
        "stop-requested",
        Operator,
        [once(StopRamp)],
        Stopped,
        "a stop was asked for",
        "the person or the end of the run",
        "start the run again when ready"
    ),
    row!(
        SensorInvalid,
        "sensor-invalid",
        Sensing,
        [sample(1, Freeze), sample(3, StopRamp)],
        Stopped,
        "the force sensor's sample is not valid",
        "the sensor reports a defect, or a number that is none",
        "`yieldwall info SENSOR` shows its error register; replace its cable, then the sensor"
    ),
    row!(
        SensorSaturated,
        "sensor-saturated",
        Sensing,
        [sample(1, Freeze), sample(5, StopRamp)],
        Stopped,
        "the force sensor is at the end of its range",
        "a hard impact or a wrong calibration range",
        "push less; if it stays, compare range_counts and the sensor's zero with its data sheet"
    ),
    row!(
        SensorStuck,
        "sensor-stuck",
        Sensing,
        [
            Step { rate: InARow(1), reaction: Freeze, bound: Samples(51) },
            Step { rate: InARow(151), reaction: StopRamp, bound: Samples(201) }
        ],
        Stopped,
        "all channels of the force sensor repeat the same counts, though its noise had shown before",
        "the sensor's converter hangs",
        "switch the sensor off and on, then restart"
    ),
    row!(
        SensorStale,
        "sensor-stale",
        Sensing,
        [Step { rate: InARow(1), reaction: Freeze, bound: Samples(3) }],
        Stopped,
        "no new force sample for more than two of the sensor's declared periods",
        "a loose cable, or sample_rate_hz above the sensor's",
        "check the sensor's cable and compare sample_rate_hz with its setting"
    ),
    row!(
        SensorLost,
        "sensor-lost",
        Sensing,
        [Step { rate: InARow(1), reaction: StopRamp, bound: Samples(11) }],
        Stopped,
        "no new force sample for ten of the sensor's declared periods",
        "the sensor lost its supply or its cable",
        "check the sensor's supply and cable, then start the run again"
    ),
    row!(
        ForceStep,
        "force-step",
        Sensing,
        [sample(1, Freeze)],
        Stopped,
        "the force changed more between two samples than force_step_limit_n",
        "a blow on the tool, or a disturbed sensor signal",
        "let go and run again; if it comes back without a blow, check shield and supply of the sensor"
    ),
    row!(
        ForceLimit,
        "force-limit",
        Sensing,
        [sample(1, Freeze), sample(20, StopRamp)],
        Stopped,
        "the force is beyond force_limit_n",
        "a collision, or a sensor that was not tared",
        "free the tool and zero the sensor as its data sheet says"
    ),
    row!(
        ForceImplausible,
        "force-implausible",
        Arm,
        [Step { rate: InARow(20), reaction: StopRamp, bound: Cycles(21) }],
        Stopped,
        "the sensed force does not fit the torques and the motion of the arm",
        "the sensor's zero has drifted, or the tool is held by something beside the hand",
        "free the tool and zero the sensor as its data sheet says; compare control.feed_forward with the arm"
    ),
    row!(
        EnergyLimit,
        "energy-limit",
        Motion,
        [once(Freeze)],
        Stopped,
        "the rig gave the hand more than it held and its surfaces brought, by more than energy_limit_j in one go",
        "the loop of hand, fixture and arm feeds the hand: the tool lags behind the proxy while the force swings",
        "raise fixture.coupling's mass_kg, or look at the loop's margins with `yieldwall config check`"
    ),
    row!(
        Chatter,
        "chatter",
        Motion,
        [once(Freeze), Step { rate: Within { count: 3, cycles: 2000 }, reaction: StopRamp, bound: Cycles(50) }],
        Stopped,
        "the reference swings to and fro under the hand",
        "a hand stiffer than the fixture's mass allows",
        "raise fixture.coupling's mass_kg, or hold the tool more loosely"
    ),
    row!(
        PdoMissed,
        "pdo-missed",
        Bus,
        [in_a_row(2, Freeze), in_a_row(5, QuickStop)],
        Stopped,
        "a drive's process data did not arrive, or (EtherCAT) it did not take those sent to it",
        "bus load too high for the cycle, or a loose cable",
        "compare the bus load with the cycle; check the cable, on CAN its termination"
    ),
    row!(
        PdoLength,
        "pdo-length",
        Bus,
        [in_a_row(2, QuickStop)],
        Stopped,
        "a process data frame had the wrong length",
        "another node uses the same COB-ID, or the mapping was changed",
        "look for a duplicate node id; restart to write the mapping again"
    ),
    row!(
        PdoDuplicated,
        "pdo-duplicated",
        Bus,
        [once(Count), within(10, 1000, StopRamp)],
        Stopped,
        "a process data frame came twice in one cycle",
        "another node uses the same COB-ID, or a gateway repeats frames; CAN itself doubles one now and then",
        "look for a duplicate node id"
    ),
    row!(
        PdoLate,
        "pdo-late",
        Bus,
        [once(Count), within(10, 1000, StopRamp)],
        Stopped,
        "a process data frame came after the cycle it belongs to",
        "bus load too high for the cycle, or compute_at_us too early",
        "compare the bus load with the cycle; raise compute_at_us"
    ),
    row!(
        NodeReset,
        "node-reset",
        Bus,
        [once(QuickStop)],
        Stopped,
        "a node restarted while the rig was running",
        "its supply dipped, its watchdog acted, or a second node has its id",
        "check the node's supply, look for a duplicate node id, then restart"
    ),
    row!(
        HeartbeatLost,
        "heartbeat-lost",
        Bus,
        [Step { rate: InARow(1), reaction: QuickStop, bound: HeartbeatTime }],
        Lost,
        "a node's heartbeat stayed away, or it left Operational",
        "the node stopped, or its cable is loose",
        "check the node's supply and cable, then restart"
    ),
    row!(
        DuplicateNode,
        "duplicate-node",
        Bus,
        [once(QuickStop)],
        Stopped,
        "two devices answer to one node id",
        "a device was added or replaced and kept its factory node id",
        "take the devices from the bus one by one, give each its own node id"
    ),
    row!(
        Intruder,
        "intruder",
        Bus,
        [once(QuickStop)],
        Stopped,
        "somebody else sends NMT commands, SYNC, set-points or SDO downloads to our nodes, or writes to devices of the segment",
        "a second master or a service tool is connected",
        "disconnect the other master"
    ),
    row!(
        Emergency,
        "emergency",
        Bus,
        [once(QuickStop)],
        Stopped,
        "a node sent an emergency message",
        "see the emergency code",
        "mend what the code names, then start the run again"
    ),
    row!(
        EmergencyWarning,
        "emergency-warning",
        Bus,
        [once(Count)],
        Stopped,
        "a node sent an emergency message that is a warning",
        "see the emergency code",
        "look at what the code names before it becomes a fault"
    ),
    row!(
        DriveFault,
        "drive-fault",
        Drives,
        [once(QuickStop)],
        Disabled,
        "a drive is in its fault state",
        "see object 603Fh and the emergency code",
        "mend what the code names, then start the run again"
    ),
    row!(
        DriveVoltageOff,
        "drive-voltage-off",
        Drives,
        [once(QuickStop)],
        Disabled,
        "a drive has no voltage at its power stage",
        "the emergency stop or safe torque off acted",
        "release the emergency stop, then start the run again"
    ),
    row!(
        DriveLeftOperation,
        "drive-left-operation",
        Drives,
        [once(QuickStop)],
        Stopped,
        "a drive left Operation Enabled unasked",
        "its own limit or safety input acted",
        "`yieldwall state DRIVE` says its error; check the safe-torque-off wiring"
    ),
    row!(
        DriveWarning,
        "drive-warning",
        Drives,
        [once(Count), in_a_row(2000, StopRamp)],
        Stopped,
        "a drive warns of its temperature or load",
        "the motor is hot, or it was loaded above its rated torque for long",
        "let it cool down; lower torque_limit_n_m or the fixture's yield force"
    ),
    row!(
        DriveIgnoresCommand,
        "drive-ignores-command",
        Drives,
        [in_a_row(3, QuickStop)],
        Stopped,
        "a drive does not follow its command value",
        "an internal limit, or the wrong mode of operation",
        "`yieldwall info DRIVE` shows its mode and limits"
    ),
    row!(
        FollowingError,
        "following-error",
        Arm,
        [once(StopRamp)],
        Stopped,
        "the arm is too far from its command",
        "the arm is blocked, or gains or torque limit are too low",
        "free the arm; raise following_error_limit_rad only with a reason"
    ),
    row!(
        Runaway,
        "runaway",
        Arm,
        [once(QuickStop)],
        Stopped,
        "the arm is twice the following error limit away from its command",
        "wrong direction or counts, or a broken encoder",
        "check direction and encoder_counts_per_rev at low force"
    ),
    row!(
        EncoderJump,
        "encoder-jump",
        Arm,
        [once(QuickStop)],
        Disabled,
        "an angle jumped further than the arm can move in a cycle",
        "a broken encoder signal, or wrong counts per revolution",
        "check the encoder's cable and encoder_counts_per_rev"
    ),
    row!(
        Posture,
        "posture",
        Arm,
        [once(QuickStop)],
        Stopped,
        "the measured angles fit no posture of the linkage",
        "wrong zero_offset_rad, direction or link lengths",
        "compare zero_offset_rad, direction and the linkage section with the arm"
    ),
    row!(
        WorkspaceEdge,
        "workspace-edge",
        Motion,
        [once(Count)],
        Stopped,
        "the reference is held at the margin to a singularity or to the workspace edge",
        "the hand went there",
        "move back"
    ),
    row!(
        WorkspaceLeft,
        "workspace-left",
        Arm,
        [once(StopRamp)],
        Stopped,
        "the arm is beyond the margin to a singularity or to the workspace edge",
        "overshoot at the edge, or a margin too small for the speed",
        "move the arm back by hand, then start the run again"
    ),
    row!(
        OverSpeed,
        "over-speed",
        Motion,
        [once(StopRamp)],
        Stopped,
        "the reference is faster than its limit",
        "a push stronger than the fixture was set for, or with nobody at the handle a zero of the force sensor that is off",
        "look at the zero with `yieldwall sensor monitor` if nobody pushed, then start the run again"
    ),
    row!(
        NotFinite,
        "not-finite",
        Motion,
        [once(QuickStop)],
        Stopped,
        "a computed value was not finite",
        "a defect of this program or a corrupt input",
        "report it with the recording"
    ),
    row!(
        EnablingTimeout,
        "enabling-timeout",
        Drives,
        [once(QuickStop)],
        Stopped,
        "the drives did not come to Operation Enabled in time",
        "a drive has no voltage, or its enable input is open",
        "`yieldwall state DRIVE` says what each lacks; check supply and enable inputs, then run again"
    ),
    row!(
        SyncJitter,
        "sync-jitter",
        Host,
        [once(Count), within(10, 100, StopRamp)],
        Stopped,
        "SYNC left more than a fifth of a period beside its moment",
        "this computer is overloaded or not set up for real time",
        "give the loop real-time priority and a core of its own"
    ),
    row!(
        Overrun,
        "overrun",
        Host,
        [once(Count), within(3, 100, Freeze), within(10, 1000, StopRamp)],
        Stopped,
        "the cycle began more than half a period late, or took longer than it has",
        "this computer is overloaded or not set up for real time",
        "give the loop real-time priority and a core of its own, or lengthen period_us"
    ),
    row!(
        Stalled,
        "stalled",
        Host,
        [once(QuickStop)],
        Stopped,
        "no cycle ran for more than three periods",
        "the process was stopped, or the computer stood still",
        "find what stopped the process, then start the run again"
    ),
    row!(
        Suspended,
        "suspended",
        Host,
        [once(StopRamp)],
        Stopped,
        "the computer was suspended",
        "power management",
        "switch suspend off while the rig is in use, then start the run again"
    ),
    row!(
        CyclePanicked,
        "cycle-panicked",
        Host,
        [once(QuickStop)],
        Disabled,
        "the control cycle failed and does not run any more",
        "a defect of this program",
        "report it with the recording, then start the program anew"
    ),
    row!(
        TransmitStalled,
        "transmit-stalled",
        Link,
        [once(Count), in_a_row(2, Silence)],
        Stopped,
        "the last cycle's frames had not left when the next ones were due",
        "nobody acknowledges, or another node fills the bus",
        "check cable and termination; look for a node that sends without end"
    ),
    row!(
        ErrorPassive,
        "error-passive",
        Link,
        [once(Count), in_a_row(5, Silence)],
        Stopped,
        "the interface is error-passive: nobody acknowledges its frames",
        "the cable is out, or the bit rates differ",
        "check cable, termination and bit rate"
    ),
    row!(
        BusOff,
        "bus-off",
        Link,
        [once(Silence)],
        Stopped,
        "the interface is bus-off",
        "a short circuit on the bus, or another bit rate",
        "mend the bus, bring the interface up again by hand, then restart"
    ),
    row!(
        LinkDown,
        "link-down",
        Link,
        [once(Silence)],
        Stopped,
        "frames cannot be sent",
        "the interface is down or was unplugged",
        "check interface and cable, then restart"
    ),
    row!(
        DeviceState,
        "device-state",
        Bus,
        [once(QuickStop)],
        Lost,
        "a device of the segment left OP",
        "outputs or SYNC0 did not reach it in time, or an error of its own; its AL status code says which",
        "mend what its AL status code names (`yieldwall explain CODE`), then restart"
    ),
    row!(
        ClockLost,
        "clock-lost",
        Bus,
        [Step { rate: InARow(1), reaction: QuickStop, bound: Cycles(3) }],
        Lost,
        "the reference clock of the segment, or a device's clock, is more than 5 % of a period beside the cycles",
        "a device restarted or its clock jumped, or this computer stood still for long",
        "look at the device's supply and at the other faults of this computer, then restart"
    ),
    // A lost link is seen in every cycle, a counter in the one in which it was read.
    row!(
        PortErrors,
        "port-errors",
        Bus,
        [once(Count), within(10, 1000, StopRamp), in_a_row(2, QuickStop)],
        Lost,
        "a port of a device counts damaged frames, or (2 cycles in a row) has lost its link",
        "a loose, damaged or pulled cable, or a device that is off",
        "look at the cable at the port that is named, then restart"
    ),
];

#[cfg(test)]
mod tests {
    use super::super::{FaultCounts, Rate};
    use super::*;

    #[test]
    fn the_table_is_in_the_order_of_the_enum_and_escalates() {
        for (index, row) in TABLE.iter().enumerate() {
            assert_eq!(row.fault as usize, index, "{}", row.name);
            assert!(!row.steps.is_empty() && row.latched.is_latched(), "{}", row.name);
            for pair in row.steps.windows(2) {
                assert!(pair[0].reaction < pair[1].reaction, "{}", row.name);
            }
            for step in row.steps {
                let (Rate::InARow(count) | Rate::Within { count, .. }) = step.rate;
                assert!(count >= 1, "{}", row.name);
                assert!(!matches!(step.rate, Rate::Within { count, .. } if count > FaultCounts::MAX_WITHIN));
            }
            assert_eq!(TABLE.iter().filter(|other| other.name == row.name).count(), 1);
        }
    }
}

#[cfg(test)]
mod page;
