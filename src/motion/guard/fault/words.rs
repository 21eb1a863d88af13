//! Rates, reactions and bounds in the words of `docs/faults.md`.

use std::fmt;

use super::{Bound, FaultRow, Rate, Reaction, Stage, Step};

/// Class and name, such as `R2 stop ramp`.
impl fmt::Display for Reaction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Reaction::Count => "R0 count",
            Reaction::Freeze => "R1 freeze",
            Reaction::StopRamp => "R2 stop ramp",
            Reaction::QuickStop => "R3 quick stop",
            Reaction::TorqueOff => "R4 torque off",
            Reaction::Silence => "R5 silence",
        })
    }
}

/// Number and unit, such as `3 samples`.
impl fmt::Display for Bound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Bound::Cycles(1) => f.write_str("1 cycle"),
            Bound::Cycles(cycles) => write!(f, "{cycles} cycles"),
            Bound::Samples(1) => f.write_str("1 sample"),
            Bound::Samples(samples) => write!(f, "{samples} samples"),
            Bound::HeartbeatTime => f.write_str("heartbeat time and 1 cycle"),
        }
    }
}

impl FaultRow {
    /// Returns how often this fault has to be seen before `step`, such as `3 samples in a row`.
    pub fn rate_in_words(&self, step: &Step) -> String {
        let unit = if self.stage == Stage::Sensing { "sample" } else { "cycle" };
        match step.rate {
            Rate::InARow(1) => "at once".to_owned(),
            Rate::InARow(times) => format!("{times} {unit}s in a row"),
            Rate::Within { count, cycles } => format!("{count} times in {cycles} cycles"),
        }
    }
}
