//! What can go wrong while the rig runs, as data: detection, reaction, and what to tell the person.

/// How the rig answers a fault. Ordered: of several at once the greatest acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Reaction {
    /// Counted; nothing else.
    Count,
    /// R1: the force input is forced to zero and the reference comes to rest; clears by itself.
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
    /// The force sensor reads at or beyond 98 % of its range, or says so.
    SensorSaturated,
    /// No new force sample for more than two of its declared periods.
    SensorStale,
    /// No new force sample for ten of its declared periods.
    SensorLost,
    /// A force beyond the configured limit.
    ForceLimit,
    /// A drive's process data did not arrive in this cycle.
    PdoMissed,
    /// A process data frame had the wrong length.
    PdoLength,
    /// A node announced its start while it should be running.
    NodeReset,
    /// A node's heartbeat stayed away longer than its consumer time, or it left Operational.
    HeartbeatLost,
    /// A node sent an emergency message.
    Emergency,
    /// A drive reports Fault or Fault Reaction Active.
    DriveFault,
    /// A drive left Operation Enabled without being asked to.
    DriveLeftOperation,
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
    /// Own frames could not be sent.
    LinkDown,
}

impl Fault {
    /// Number of faults.
    pub const COUNT: usize = Fault::LinkDown as usize + 1;

    /// The row of [`TABLE`] that describes this fault.
    ///
    /// Real-time: yes.
    pub fn row(self) -> &'static Row {
        &TABLE[self as usize]
    }

    /// The reaction after `consecutive` observations in a row, and whether there is one.
    ///
    /// Real-time: yes.
    pub fn reaction(self, consecutive: u16) -> Option<Reaction> {
        self.row().steps.iter().rev().find(|step| consecutive >= step.after).map(|step| step.reaction)
    }
}

/// One step of a fault's escalation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Observations in a row from which the reaction holds; at least 1.
    pub after: u16,
    /// The reaction.
    pub reaction: Reaction,
}

/// One fault with all that is known of it.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// The fault.
    pub fault: Fault,
    /// Short name, unique, as it stands in reports.
    pub name: &'static str,
    /// What the fault means.
    pub meaning: &'static str,
    /// The most frequent cause.
    pub cause: &'static str,
    /// What to do next.
    pub next: &'static str,
    /// Escalation in rising order of `after`.
    pub steps: &'static [Step],
}

const fn after(after: u16, reaction: Reaction) -> Step {
    Step { after, reaction }
}

macro_rules! row {
    ($fault:ident, $name:literal, [$($step:expr),+], $meaning:literal, $cause:literal, $next:literal) => {
        Row { fault: Fault::$fault, name: $name, meaning: $meaning, cause: $cause, next: $next, steps: &[$($step),+] }
    };
}

use Reaction::{Freeze, QuickStop, Silence, StopRamp, TorqueOff};

/// All faults, in the order of [`Fault`].
pub const TABLE: [Row; Fault::COUNT] = [
    row!(
        StopRequested,
        "stop-requested",
        [after(1, StopRamp)],
        "a stop was asked for",
        "the person or the end of the run",
        "reset, then enable again when ready"
    ),
    row!(
        SensorSaturated,
        "sensor-saturated",
        [after(1, Freeze), after(5, StopRamp)],
        "the force sensor is at the end of its range",
        "a hard impact or a wrong calibration range",
        "push less; if it stays, tare the sensor unloaded and compare range_counts with its data sheet"
    ),
    row!(
        SensorStale,
        "sensor-stale",
        [after(1, Freeze)],
        "no new force sample for more than two of the sensor's declared periods",
        "a loose cable, or sample_rate_hz above the sensor's",
        "check the sensor's cable and compare sample_rate_hz with its setting"
    ),
    row!(
        SensorLost,
        "sensor-lost",
        [after(1, StopRamp)],
        "no new force sample for ten of the sensor's declared periods",
        "the sensor lost its supply or its cable",
        "check the sensor's supply and cable, then reset"
    ),
    row!(
        ForceLimit,
        "force-limit",
        [after(1, Freeze), after(20, StopRamp)],
        "the force is beyond force_limit_n",
        "a collision, or a sensor that was not tared",
        "free the tool and tare the sensor"
    ),
    row!(
        PdoMissed,
        "pdo-missed",
        [after(2, Freeze), after(5, QuickStop)],
        "a drive's process data did not arrive",
        "bus load too high for the cycle, or a loose cable",
        "compare the bus load with the cycle; check cable and termination"
    ),
    row!(
        PdoLength,
        "pdo-length",
        [after(2, QuickStop)],
        "a process data frame had the wrong length",
        "another node uses the same COB-ID, or the mapping was changed",
        "look for a duplicate node id; restart to write the mapping again"
    ),
    row!(
        NodeReset,
        "node-reset",
        [after(1, QuickStop)],
        "a node restarted while the rig was running",
        "its supply dipped, or its watchdog acted",
        "check the node's supply, then restart"
    ),
    row!(
        HeartbeatLost,
        "heartbeat-lost",
        [after(1, QuickStop)],
        "a node's heartbeat stayed away, or it left Operational",
        "the node stopped, or its cable is loose",
        "check the node's supply and cable, then restart"
    ),
    row!(
        Emergency,
        "emergency",
        [after(1, QuickStop)],
        "a node sent an emergency message",
        "see the emergency code",
        "mend what the code names, then reset"
    ),
    row!(
        DriveFault,
        "drive-fault",
        [after(1, TorqueOff)],
        "a drive is in its fault state",
        "see object 603Fh and the emergency code",
        "mend what the code names, then reset"
    ),
    row!(
        DriveLeftOperation,
        "drive-left-operation",
        [after(1, QuickStop)],
        "a drive left Operation Enabled unasked",
        "its own limit or safety input acted",
        "read the drive's 603Fh; check the safe-torque-off wiring"
    ),
    row!(
        DriveIgnoresCommand,
        "drive-ignores-command",
        [after(3, QuickStop)],
        "a drive does not follow its command value",
        "an internal limit, or the wrong mode of operation",
        "read 6061h and the drive's limits"
    ),
    row!(
        FollowingError,
        "following-error",
        [after(1, StopRamp)],
        "the arm is too far from its command",
        "the arm is blocked, or gains or torque limit are too low",
        "free the arm; raise following_error_limit_rad only with a reason"
    ),
    row!(
        Runaway,
        "runaway",
        [after(1, QuickStop)],
        "the arm is twice the following error limit away from its command",
        "wrong direction or counts, or a broken encoder",
        "check direction and encoder_counts_per_rev at low force"
    ),
    row!(
        EncoderJump,
        "encoder-jump",
        [after(1, QuickStop)],
        "an angle jumped further than the arm can move in a cycle",
        "a broken encoder signal, or wrong counts per revolution",
        "check the encoder's cable and encoder_counts_per_rev"
    ),
    row!(
        Posture,
        "posture",
        [after(1, QuickStop)],
        "the measured angles fit no posture of the linkage",
        "wrong zero_offset_rad, direction or link lengths",
        "home the arm and check the linkage section"
    ),
    row!(
        WorkspaceEdge,
        "workspace-edge",
        [after(1, Reaction::Count)],
        "the reference is held at the margin to a singularity or to the workspace edge",
        "the hand went there",
        "move back"
    ),
    row!(
        WorkspaceLeft,
        "workspace-left",
        [after(1, StopRamp)],
        "the arm is beyond the margin to a singularity or to the workspace edge",
        "overshoot at the edge, or a margin too small for the speed",
        "move the arm back by hand, then reset and enable again"
    ),
    row!(
        OverSpeed,
        "over-speed",
        [after(1, StopRamp)],
        "the reference is faster than its limit",
        "a push stronger than the fixture was set for",
        "reset, then enable again"
    ),
    row!(
        NotFinite,
        "not-finite",
        [after(1, QuickStop)],
        "a computed value was not finite",
        "a defect of this program or a corrupt input",
        "report it with the recording"
    ),
    row!(
        LinkDown,
        "link-down",
        [after(1, Silence)],
        "frames cannot be sent",
        "the interface is down, or no other node acknowledges",
        "check interface, cable and termination"
    ),
];

/// Observations in a row of every fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaultCounts([u16; Fault::COUNT]);

impl Default for FaultCounts {
    fn default() -> Self {
        Self([0; Fault::COUNT])
    }
}

impl FaultCounts {
    /// Counts one more observation of `fault` if it is `present`, and starts again from zero if not.
    ///
    /// Real-time: yes.
    pub fn observe(&mut self, fault: Fault, present: bool) {
        let count = &mut self.0[fault as usize];
        *count = if present { count.saturating_add(1) } else { 0 };
    }

    /// Observations of `fault` in a row.
    pub fn count(&self, fault: Fault) -> u16 {
        self.0[fault as usize]
    }

    /// The strongest reaction that the counts ask for, with its fault; the first of the table among equals.
    ///
    /// Real-time: yes.
    pub fn worst(&self) -> Option<(Fault, Reaction)> {
        let mut worst: Option<(Fault, Reaction)> = None;
        for row in &TABLE {
            let count = self.count(row.fault);
            if count == 0 {
                continue;
            }
            if let Some(reaction) = row.fault.reaction(count)
                && worst.is_none_or(|(_, known)| reaction > known)
            {
                worst = Some((row.fault, reaction));
            }
        }
        worst
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_in_the_order_of_the_enum_and_escalates() {
        for (index, row) in TABLE.iter().enumerate() {
            assert_eq!(row.fault as usize, index, "{}", row.name);
            assert!(!row.steps.is_empty());
            for pair in row.steps.windows(2) {
                assert!(pair[0].after < pair[1].after && pair[0].reaction < pair[1].reaction, "{}", row.name);
            }
            assert!(row.steps[0].after >= 1);
            assert_eq!(TABLE.iter().filter(|other| other.name == row.name).count(), 1);
        }
    }

    #[test]
    fn misses_escalate_and_a_good_cycle_starts_again() {
        let mut counts = FaultCounts::default();
        counts.observe(Fault::PdoMissed, true);
        assert_eq!(counts.worst(), None);
        counts.observe(Fault::PdoMissed, true);
        assert_eq!(counts.worst(), Some((Fault::PdoMissed, Reaction::Freeze)));
        for _ in 0..3 {
            counts.observe(Fault::PdoMissed, true);
        }
        assert_eq!(counts.worst(), Some((Fault::PdoMissed, Reaction::QuickStop)));
        counts.observe(Fault::PdoMissed, false);
        assert_eq!(counts.worst(), None);
    }

    #[test]
    fn the_strongest_reaction_wins() {
        let mut counts = FaultCounts::default();
        counts.observe(Fault::SensorSaturated, true);
        counts.observe(Fault::DriveFault, true);
        assert_eq!(counts.worst(), Some((Fault::DriveFault, Reaction::TorqueOff)));
    }
}
