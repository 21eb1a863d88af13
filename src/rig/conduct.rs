//! What a person does with a rig: asks for it to be enabled until it runs, and has it stopped until no drive makes torque.

use std::time::Duration;

use crate::guard::{Request, State};
use yieldwall_drives::cia402;

/// Samples of the force sensor before the rig asks to be enabled, or as many cycles if those are longer: the drives have
/// answered, and the sensor's noise is known.
const SAMPLES_BEFORE_ENABLING: u32 = 10;
/// Cycles after which a person who was refused asks again.
const CYCLES_BETWEEN_ASKING: u32 = 50;
/// Longest time that a stop may take, s.
pub const STOP_LIMIT_S: f64 = 2.0;

/// Cycles before the rig asks to be enabled: so many that the sensor's noise is known.
pub fn settling_cycles(period: Duration, sample_period: Duration) -> u32 {
    let cycles_per_sample = sample_period.as_nanos().div_ceil(period.as_nanos().max(1)).clamp(1, 100_000);
    SAMPLES_BEFORE_ENABLING * cycles_per_sample as u32
}

/// What to do with the next cycle of a rig that is being enabled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Enable {
    /// Run it with this request.
    Ask(Request),
    /// The rig runs.
    Done,
    /// It took too long.
    GivenUp,
}

/// Asks a rig that idles to be enabled, until it runs.
#[derive(Clone, Copy, Debug)]
pub struct Enabling {
    cycle: u32,
    first: u32,
    limit: u32,
}

impl Enabling {
    /// Longest time from asking to running unless told otherwise, s.
    pub const LIMIT_S: f64 = 1.5;

    /// Asks for up to [`Enabling::LIMIT_S`] of cycles of `period_s`.
    pub fn new(period_s: f64) -> Self {
        Self::within(Self::LIMIT_S, period_s)
    }

    pub(super) fn within(limit_s: f64, period_s: f64) -> Self {
        let cycles = (limit_s / period_s) as u32;
        Self { cycle: 0, first: SAMPLES_BEFORE_ENABLING, limit: SAMPLES_BEFORE_ENABLING + cycles }
    }

    /// Asks no earlier than after so many cycles.
    #[must_use]
    pub fn not_before(mut self, cycles: u32) -> Self {
        let later = cycles.saturating_sub(self.first);
        (self.first, self.limit) = (self.first + later, self.limit + later);
        self
    }

    /// What to do next with a rig in this state.
    pub fn next(&mut self, state: State) -> Enable {
        let Some(asking) = self.cycle.checked_sub(self.first) else {
            self.cycle += 1;
            return Enable::Ask(Request::None);
        };
        if self.cycle >= self.limit {
            return Enable::GivenUp;
        }
        if state == State::Running {
            return Enable::Done;
        }
        self.cycle += 1;
        // What was seen within the last seconds keeps the rig from being enabled: a person asks again.
        let asks = state == State::Idle && asking.is_multiple_of(CYCLES_BETWEEN_ASKING);
        Enable::Ask(if asks { Request::Enable } else { Request::None })
    }
}

/// Whether a drive in this state may make torque.
pub fn has_torque(state: cia402::State) -> bool {
    use cia402::State::{FaultReactionActive, OperationEnabled, QuickStopActive};
    matches!(state, OperationEnabled | QuickStopActive | FaultReactionActive)
}
