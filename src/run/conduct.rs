//! Sequences that a person starts: enable a rig until it runs, and stop it until no drive makes torque.

use std::time::Duration;

use super::permit::{Ask, Permit};
use yieldwall_bus::Waiting;
use yieldwall_config as config;
use yieldwall_motion::guard::State;

/// Samples of the force sensor before the rig asks to be enabled, or as many cycles if those are longer: the drives have
/// answered, and the sensor's noise is known.
const SAMPLES_BEFORE_ENABLING: u32 = 10;
/// Heartbeat periods of process data before a rig on a real bus is enabled. Two devices with one node id show in fewer.
const SETTLING_HEARTBEATS: u32 = 3;
/// Cycles after which a person who was refused asks again.
const CYCLES_BETWEEN_ASKING: u32 = 50;
/// How long a rig that refuses is asked again, s.
const REFUSED_LIMIT_S: f64 = 1.5;
/// How long a rig that refuses is asked again after a reset, s: by then it has forgotten the events of the last seconds.
const REFUSED_AFTER_RESET_S: f64 = 5.0;
/// Longest time that a stop may take apart from the closing of brakes, s: the ramp, and one second for the joints to come to rest.
pub(crate) const STOP_LIMIT_S: f64 = 2.0;

/// Cycles before the rig asks to be enabled, enough to know the sensor's noise.
pub fn settling_cycles(period: Duration, sample_period: Duration) -> u32 {
    let cycles_per_sample = sample_period.as_nanos().div_ceil(period.as_nanos().max(1)).clamp(1, 100_000);
    SAMPLES_BEFORE_ENABLING * cycles_per_sample as u32
}

/// Returns the cycles to settle for a rig on a real bus, where two devices with one node ID must have time to show.
pub fn settling_on_bus(rig: &config::Rig) -> u32 {
    let [left, right] = &rig.drives;
    let drives_ms = left.address.heartbeat_ms().max(right.address.heartbeat_ms());
    let slowest_ms = drives_ms.max(rig.sensor.protocol.heartbeat_ms()).unwrap_or_default();
    let heartbeats = (u32::from(slowest_ms) * SETTLING_HEARTBEATS * 1000).div_ceil(rig.cycle.period_us);
    let period = Duration::from_micros(rig.cycle.period_us.into());
    let sample_period = Duration::from_secs_f64(rig.sensor.sample_rate_hz.get().recip());
    heartbeats.max(settling_cycles(period, sample_period))
}

/// Steps of a boot, each reported once.
#[derive(Clone, Debug, Default)]
pub struct BootSteps(Vec<&'static str>);

impl BootSteps {
    /// Returns the step that the boot has reached, if no node's step of that name was reported yet. `None` in `waiting` means the
    /// end of the boot, after which all steps are reported anew.
    pub fn new_step(&mut self, waiting: Option<Waiting<'_>>) -> Option<&'static str> {
        let Some(waiting) = waiting else {
            self.0.clear();
            return None;
        };
        let step = waiting.step;
        if self.0.contains(&step) {
            return None;
        }
        self.0.push(step);
        Some(step)
    }
}

/// Next action for a rig that is being enabled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Enable<'a> {
    /// Run it, and ask for this.
    Ask(Ask<'a>),
    /// The rig runs.
    Done,
    /// It took too long.
    GivenUp,
}

/// Asks a rig that idles to be enabled, until it runs. It gives up when the rig goes on refusing, when a fault has stopped it
/// on the way, and when the drives take longer than they may.
#[derive(Clone, Copy, Debug)]
pub struct Enabling {
    period_s: f64,
    cycle: u32,
    first: u32,
    /// Cycles for which the rig may refuse.
    refusals: u32,
    /// Cycles from asking to running.
    limit: u32,
    /// Cycles in which it has refused.
    refused: u32,
}

impl Enabling {
    /// Asks this rig, as long as its drives may take.
    pub fn new(rig: &config::Rig) -> Self {
        let [left, right] = rig.drives.each_ref().map(|drive| f64::from(drive.enabling_ms) * 1e-3);
        let none = Self {
            period_s: f64::from(rig.cycle.period_us) * 1e-6,
            cycle: 0,
            first: 0,
            refusals: 0,
            limit: 0,
            refused: 0,
        };
        let (first, limit) = (SAMPLES_BEFORE_ENABLING, none.cycles_in(left.max(right)));
        Self { first, limit, ..none }.refused_for(REFUSED_LIMIT_S)
    }

    /// Asks after a reset.
    #[must_use]
    pub fn after_reset(self) -> Self {
        self.refused_for(REFUSED_AFTER_RESET_S)
    }

    fn refused_for(self, limit_s: f64) -> Self {
        let refusals = self.cycles_in(limit_s);
        Self { refusals, limit: self.limit - self.refusals + refusals, ..self }
    }

    /// Asks no earlier than after this number of cycles.
    #[must_use]
    pub fn not_before(self, cycles: u32) -> Self {
        Self { first: self.first.max(cycles), ..self }
    }

    /// Returns the next action for a rig in this state.
    pub fn next<'a>(&mut self, state: State, permit: &'a Permit) -> Enable<'a> {
        let Some(asking) = self.cycle.checked_sub(self.first) else {
            self.cycle += 1;
            return Enable::Ask(Ask::Nothing);
        };
        if state == State::Running {
            return Enable::Done;
        }
        let is_over = asking >= self.limit || self.refused >= self.refusals;
        if is_over || (asking > 0 && state.is_latched()) {
            return Enable::GivenUp;
        }
        self.cycle += 1;
        self.refused += u32::from(state == State::Idle);
        // What was seen within the last seconds keeps the rig from being enabled: a person asks again.
        let asks = state == State::Idle && asking.is_multiple_of(CYCLES_BETWEEN_ASKING);
        Enable::Ask(if asks { Ask::Enable(permit) } else { Ask::Nothing })
    }

    /// Returns for how long the rig has been asked, s.
    pub fn waited_s(&self) -> f64 {
        f64::from(self.cycle.saturating_sub(self.first)) * self.period_s
    }

    fn cycles_in(&self, time_s: f64) -> u32 {
        (time_s / self.period_s) as u32
    }
}
