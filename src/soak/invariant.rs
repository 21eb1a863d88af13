//! What always holds, by number and name, and what is told when it does not.

use serde::{Deserialize, Serialize};

/// A property that holds in every cycle, whatever fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Invariant {
    /// No set-point that moves an axis unless both drives are in Operation Enabled.
    I1,
    /// Targets change by at most the greatest speed per cycle; a stop keeps its deceleration.
    I2,
    /// Force and torques keep within their limits.
    I3,
    /// The proxy keeps to its greatest step.
    I4,
    /// The rig gives back at most what it holds.
    I5,
    /// The fixture yields only at its levels.
    I6,
    /// Without force it comes to rest and stays there.
    I7,
    /// Every output is finite.
    I8,
    /// The first target after enabling is what was measured.
    I9,
    /// A latched state ends only by a reset.
    I10,
    /// A reaction comes within the bound of its row, and is the row's.
    I11,
    /// At most one set-point a SYNC, none that is stale.
    I12,
    /// The same seed twice gives the same.
    I15,
    /// A counter that wraps changes nothing.
    I16,
    /// All axes get the same reaction in the same cycle.
    I17,
    /// No fault reset and no enabling without a person.
    I18,
    /// The frames of a cycle fit into it.
    I19,
    /// Queues keep to their bounds.
    I20,
    /// No SYNC makes a drive act on the set-point of a stranger.
    I21,
    /// The drives stop by themselves when nobody commands them.
    Watchdog,
    /// Nothing stops the rig that nobody injected.
    FalseAlarm,
    /// The simulation itself goes on.
    Simulation,
}

impl Invariant {
    /// All of them.
    pub const ALL: [Self; 22] = [
        Self::I1,
        Self::I2,
        Self::I3,
        Self::I4,
        Self::I5,
        Self::I6,
        Self::I7,
        Self::I8,
        Self::I9,
        Self::I10,
        Self::I11,
        Self::I12,
        Self::I15,
        Self::I16,
        Self::I17,
        Self::I18,
        Self::I19,
        Self::I20,
        Self::I21,
        Self::Watchdog,
        Self::FalseAlarm,
        Self::Simulation,
    ];

    /// Its number or name, as it stands in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::I1 => "I1",
            Self::I2 => "I2",
            Self::I3 => "I3",
            Self::I4 => "I4",
            Self::I5 => "I5",
            Self::I6 => "I6",
            Self::I7 => "I7",
            Self::I8 => "I8",
            Self::I9 => "I9",
            Self::I10 => "I10",
            Self::I11 => "I11",
            Self::I12 => "I12",
            Self::I15 => "I15",
            Self::I16 => "I16",
            Self::I17 => "I17",
            Self::I18 => "I18",
            Self::I19 => "I19",
            Self::I20 => "I20",
            Self::I21 => "I21",
            Self::Watchdog => "watchdog",
            Self::FalseAlarm => "false-alarm",
            Self::Simulation => "simulation",
        }
    }

    /// What it says.
    pub const fn text(self) -> &'static str {
        match self {
            Self::I1 => "no set-point moves an axis unless both drives are in Operation Enabled",
            Self::I2 => "targets change by at most the greatest speed per cycle, and a stop keeps its deceleration",
            Self::I3 => "force and torques keep within their limits",
            Self::I4 => "the proxy keeps to its greatest step",
            Self::I5 => "the rig gives the hand at most the energy that it holds",
            Self::I6 => "the fixture yields only at its levels",
            Self::I7 => "without force the rig comes to rest and stays there",
            Self::I8 => "every output is finite",
            Self::I9 => "the first target after enabling is what was measured",
            Self::I10 => "a latched state ends only by a reset",
            Self::I11 => "a fault gets the reaction of its row within the row's bound",
            Self::I12 => "at most one set-point a SYNC, and none that is stale",
            Self::I15 => "the same seed gives the same run",
            Self::I16 => "a counter that wraps changes nothing",
            Self::I17 => "all axes get the same reaction in the same cycle",
            Self::I18 => "nothing resets a fault or enables without a person",
            Self::I19 => "the frames of a cycle fit into it",
            Self::I20 => "queues keep to their bounds",
            Self::I21 => "no SYNC makes a drive act on a stranger's set-point",
            Self::Watchdog => "drives that nobody commands stop by themselves",
            Self::FalseAlarm => "nothing stops the rig that nobody injected",
            Self::Simulation => "the simulation goes on",
        }
    }
}

/// An invariant that did not hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Violation {
    /// Which one.
    pub invariant: Invariant,
    /// Cycle since the boot.
    pub cycle: u32,
    /// Virtual time in s.
    pub time_s: f64,
    /// What was seen.
    pub seen: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_are_listed_once() {
        for (at, invariant) in Invariant::ALL.iter().enumerate() {
            assert_eq!(*invariant as usize, at);
        }
        assert_eq!(Invariant::Simulation as usize + 1, Invariant::ALL.len());
    }
}
