//! Invariants by name, and the report of a violation.

use serde::{Deserialize, Serialize};

/// A property that holds in every cycle, whatever fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Invariant {
    /// No set-point that moves an axis unless both drives are in Operation Enabled.
    MovesEnabled,
    /// Targets change by at most the greatest speed per cycle; a stop keeps its deceleration.
    BoundedMotion,
    /// Force and torques keep within their limits.
    BoundedEffort,
    /// The proxy keeps to its greatest step.
    BoundedProxy,
    /// The rig gives back at most what it holds.
    Passivity,
    /// The fixture yields only at its levels.
    YieldLevels,
    /// Without force it comes to rest and stays there.
    ComesToRest,
    /// Every output is finite.
    Finite,
    /// The first target after enabling is what was measured.
    StartsInPlace,
    /// A latched state ends only by a reset.
    StaysLatched,
    /// A reaction comes within the bound of its row, and is the row's.
    Reaction,
    /// At most one set-point a SYNC, none that is stale.
    FreshSetPoint,
    /// On a segment, a value counts as reported only if it was in the reply to the frame of its cycle.
    FreshInput,
    /// Two runs of one seed give equal results.
    Repeatable,
    /// A counter that wraps changes nothing.
    WrappingCounters,
    /// All axes get the same reaction in the same cycle.
    Together,
    /// No fault reset and no enabling without a person.
    AskedFor,
    /// The frames of a cycle fit into it.
    BusLoad,
    /// Queues keep to their bounds.
    BoundedQueues,
    /// No SYNC makes a drive act on a foreign set-point.
    ForeignSetPoint,
    /// The drives stop by themselves when no master commands them.
    Watchdog,
    /// No fault stops the rig without an injection.
    FalseAlarm,
    /// The simulation itself goes on.
    Simulation,
}

impl Invariant {
    /// All of them.
    pub const ALL: [Self; 23] = [
        Self::MovesEnabled,
        Self::BoundedMotion,
        Self::BoundedEffort,
        Self::BoundedProxy,
        Self::Passivity,
        Self::YieldLevels,
        Self::ComesToRest,
        Self::Finite,
        Self::StartsInPlace,
        Self::StaysLatched,
        Self::Reaction,
        Self::FreshSetPoint,
        Self::FreshInput,
        Self::Repeatable,
        Self::WrappingCounters,
        Self::Together,
        Self::AskedFor,
        Self::BusLoad,
        Self::BoundedQueues,
        Self::ForeignSetPoint,
        Self::Watchdog,
        Self::FalseAlarm,
        Self::Simulation,
    ];

    /// Returns the name for reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::MovesEnabled => "moves-enabled",
            Self::BoundedMotion => "bounded-motion",
            Self::BoundedEffort => "bounded-effort",
            Self::BoundedProxy => "bounded-proxy",
            Self::Passivity => "passivity",
            Self::YieldLevels => "yield-levels",
            Self::ComesToRest => "comes-to-rest",
            Self::Finite => "finite",
            Self::StartsInPlace => "starts-in-place",
            Self::StaysLatched => "stays-latched",
            Self::Reaction => "reaction",
            Self::FreshSetPoint => "fresh-set-point",
            Self::FreshInput => "fresh-input",
            Self::Repeatable => "repeatable",
            Self::WrappingCounters => "wrapping-counters",
            Self::Together => "together",
            Self::AskedFor => "asked-for",
            Self::BusLoad => "bus-load",
            Self::BoundedQueues => "bounded-queues",
            Self::ForeignSetPoint => "foreign-set-point",
            Self::Watchdog => "watchdog",
            Self::FalseAlarm => "false-alarm",
            Self::Simulation => "simulation",
        }
    }

    /// Describes the invariant.
    pub const fn text(self) -> &'static str {
        match self {
            Self::MovesEnabled => "no set-point moves an axis unless both drives are in Operation Enabled",
            Self::BoundedMotion => {
                "targets change by at most the greatest speed per cycle, and a stop keeps its deceleration"
            }
            Self::BoundedEffort => "force and torques keep within their limits",
            Self::BoundedProxy => "the proxy keeps to its greatest step",
            Self::Passivity => "the rig gives the hand at most the energy that it holds",
            Self::YieldLevels => "the fixture yields only at its levels",
            Self::ComesToRest => "without force the rig comes to rest and stays there",
            Self::Finite => "every output is finite",
            Self::StartsInPlace => "the first target after enabling is what was measured",
            Self::StaysLatched => "a latched state ends only by a reset",
            Self::Reaction => "a fault gets the reaction of its row within the row's bound",
            Self::FreshSetPoint => "at most one set-point a SYNC, and none that is stale",
            Self::FreshInput => "a cycle counts a missed input or output of a drive as missed",
            Self::Repeatable => "the same seed gives the same run",
            Self::WrappingCounters => "a counter that wraps changes nothing",
            Self::Together => "all axes get the same reaction in the same cycle",
            Self::AskedFor => "nothing resets a fault or enables without a person",
            Self::BusLoad => "the frames of a cycle fit into it",
            Self::BoundedQueues => "queues keep to their bounds",
            Self::ForeignSetPoint => "no SYNC makes a drive act on a foreign set-point",
            Self::Watchdog => "drives that nobody commands stop by themselves",
            Self::FalseAlarm => "nothing stops the rig that nobody injected",
            Self::Simulation => "the simulation goes on",
        }
    }
}

/// An invariant that did not hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Violation {
    /// The invariant.
    pub invariant: Invariant,
    /// Cycle since the boot.
    pub cycle: u32,
    /// Virtual time in s.
    pub time_s: f64,
    /// Observed values.
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
