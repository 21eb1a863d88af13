//! In which times a bound is counted, and what a hand or an earlier injection explains.

use super::super::draw::Machine;
use super::super::excuse::Excuse;
use super::super::session::Event;
use super::super::tolerance;
use yieldwall_config::injection::Injection;
use yieldwall_motion::guard::fault::{Bound, Rate};
use yieldwall_motion::guard::{Fault, Reaction};

/// Faults that a hand alone brings about now and then, whatever else is broken: it is free to hit and to shake the tool.
pub(super) const HAND_FAULTS: [Fault; 6] =
    [Fault::SensorSaturated, Fault::ForceStep, Fault::ForceLimit, Fault::OverSpeed, Fault::EnergyLimit, Fault::Chatter];
/// Faults of an arm far outside of its working disc, to which a hand has pushed it while nobody held it.
const FAR_FAULTS: [Fault; 6] = [
    Fault::FollowingError,
    Fault::Runaway,
    Fault::WorkspaceLeft,
    Fault::Posture,
    Fault::EncoderJump,
    Fault::ForceImplausible,
];
/// Faults that a hand brings about where the drives give all they may. The balance behind the third takes the reference's motion
/// for the arm's; near the edge of the workspace the hand pushes the arm past it.
const OVERPOWERED_FAULTS: [Fault; 4] =
    [Fault::FollowingError, Fault::Runaway, Fault::ForceImplausible, Fault::WorkspaceLeft];

/// Times of a rig that a bound is counted in.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    pub(super) period_s: f64,
    sample_s: f64,
    /// Consumer time of the longest heartbeat in s.
    pub(super) heartbeat_s: f64,
    pub(super) scene_from_ns: u64,
    /// Whether the force sensor has noise, as every real one. Without it a hand at rest looks like a converter that hangs.
    is_noisy: bool,
    /// Largest turn of a joint in a cycle, rad.
    pub(super) turn_rad: f64,
}

impl Clock {
    pub(super) fn of(machine: &Machine, scene_from_ns: u64) -> Self {
        let rig = &machine.rig;
        let heartbeats = rig
            .drives
            .iter()
            .filter_map(|drive| drive.address.heartbeat_ms())
            .chain(rig.sensor.protocol.heartbeat_ms());
        // A heartbeat is missed after two of its periods.
        let heartbeat_s = 2e-3 * f64::from(heartbeats.max().unwrap_or_default());
        let period_s = machine.period_s();
        let is_noisy = machine.scene.model.is_some_and(|model| model.force_noise_counts.get() > 0.0);
        let turn_rad = rig.guard.joint_speed_limit_rad_per_s.get() * period_s;
        Self {
            period_s,
            sample_s: 1.0 / rig.sensor.sample_rate_hz.get(),
            heartbeat_s,
            scene_from_ns,
            is_noisy,
            turn_rad,
        }
    }

    /// Returns the time of an event in s since the scene began.
    pub(super) fn time_s(&self, event: &Event) -> f64 {
        (event.sync_ns as f64 - self.scene_from_ns as f64) * 1e-9
    }

    /// Converts a moment in s since switching on to s since the scene began.
    pub(super) fn scene_s(&self, time_s: f64) -> f64 {
        time_s - self.scene_from_ns as f64 * 1e-9
    }

    /// Returns how a hand, or the place to which it has pushed the arm, explains the fault without an injection.
    pub(super) fn nature_of(&self, event: &Event, fault: Fault) -> Option<Excuse> {
        let shows_for = if fault == Fault::ForceImplausible { tolerance::BALANCE_CYCLES } else { 0 };
        let was_at_limit = event.since_torque_limit.is_some_and(|cycles| cycles <= shows_for);
        match fault {
            _ if HAND_FAULTS.contains(&fault) => Some(Excuse::Hand),
            _ if FAR_FAULTS.contains(&fault) && event.radius_m > tolerance::FAR_M => Some(Excuse::Far),
            _ if FAR_FAULTS.contains(&fault) && event.is_carried => Some(Excuse::Carried),
            _ if OVERPOWERED_FAULTS.contains(&fault) && was_at_limit => Some(Excuse::TorqueLimit),
            Fault::SensorStuck if !self.is_noisy => Some(Excuse::Noiseless),
            _ => None,
        }
    }

    /// Whether one of the injections before has filled the window of cycles over which the fault counts.
    pub(super) fn has_been_filled(
        &self,
        event: &Event,
        fault: Fault,
        reaction: Reaction,
        earlier: &[Injection],
    ) -> bool {
        let window = fault.row().steps.iter().find_map(|step| match step.rate {
            Rate::Within { cycles, .. } if step.reaction == reaction => Some(f64::from(cycles) * self.period_s),
            _ => None,
        });
        let is_recent = |injection: &Injection| window.is_some_and(|s| injection.end_s() + s > self.time_s(event));
        earlier.iter().any(|known| known.kind.row().brings(fault) && is_recent(known))
    }

    /// Returns a bound in cycles. Samples and heartbeats have their own clocks, at any phase to SYNC, so one cycle is added.
    pub(super) fn cycles(&self, bound: Bound) -> u32 {
        match bound {
            Bound::Cycles(cycles) => u32::from(cycles),
            // At 1000 Hz the sensor samples with SYNC.
            Bound::Samples(samples) if self.sample_s <= 1e-3 && self.period_s >= 1e-3 => u32::from(samples),
            Bound::Samples(samples) => (f64::from(samples) * self.sample_s / self.period_s).ceil() as u32 + 1,
            Bound::HeartbeatTime => (self.heartbeat_s / self.period_s).ceil() as u32 + 1,
        }
    }
}
