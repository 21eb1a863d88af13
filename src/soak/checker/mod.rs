//! Judges every cycle by what was seen of it.
//!
//! The checker knows the configured limits and the literal layout of frames. It computes everything else itself: nothing of
//! the guard, the cycle, the master or the fixture is asked whether it was right.

mod energy;
mod frames;
mod motion;

#[cfg(test)]
mod tests;

use super::excuse::{Excuse, Excused};
use super::invariant::{Invariant, Violation};
use super::observation::{Observation, Sighting};
use super::tolerance;
use energy::Energy;
use frames::{Frames, SYNC};
use motion::Motion;
use yieldwall_config as config;
use yieldwall_motion::guard::State;

/// Properties of a rig that a checker needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Cycle time in s.
    pub period_s: f64,
    /// Kind of the set-points.
    pub mode: config::CommandMode,
    /// Whether the drives are on an EtherCAT segment.
    pub is_on_segment: bool,
    /// COB-IDs of the drives' set-points; on a segment those of no node.
    pub set_point_ids: [u16; 2],
    /// COB-IDs of the drives' reports; on a segment those of no node.
    pub status_ids: [u16; 2],
    /// Counts per rad.
    pub counts_per_rad: [f64; 2],
    /// Greatest rate of a joint in rad/s.
    pub joint_speed_rad_per_s: f64,
    /// Greatest speed of the proxy in m/s.
    pub tool_speed_m_per_s: f64,
    /// Deceleration of a stop in m/s^2.
    pub stop_m_per_s2: f64,
    /// Greatest torque in per mille of the rated one.
    pub torque_per_mille: [f64; 2],
    /// Greatest torque in N m.
    pub torque_n_m: f64,
    /// Greatest sensed force that may move the proxy, N.
    pub force_n: f64,
    /// Greatest energy that the guard lets the rig give the hand in one go, J.
    pub energy_j: f64,
    /// Mass of the proxy in kg.
    pub mass_kg: f64,
    /// Friction level F in N.
    pub friction_n: f64,
    /// Yield level R in N.
    pub yield_n: f64,
    /// Whether the surface resists on its forbidden side alone.
    pub is_unilateral: bool,
    /// Whether the surface holds what hits it for some steps, whatever the force.
    pub has_hold: bool,
    /// Centre and radius of a round surface in m; `None` for a straight one.
    pub round: Option<([f64; 2], f64)>,
    /// Across a straight surface, of any length.
    pub normal: [f64; 2],
    /// Bit rate of the bus in bit/s; infinite without bit timing.
    pub bit_rate: f64,
}

impl Limits {
    /// Returns the limits of a rig.
    pub fn of(rig: &config::Rig) -> Self {
        let [left, right] = &rig.drives;
        let guard = &rig.guard;
        let torque_n_m = guard.torque_limit_n_m.get();
        let bus = rig.own_node();
        Self {
            period_s: f64::from(rig.cycle.period_us) * 1e-6,
            mode: rig.rig.command_mode,
            is_on_segment: rig.has_drives_on_ethercat(),
            set_point_ids: [
                0x200 + u16::from(left.address.node_id().unwrap_or_default()),
                0x200 + u16::from(right.address.node_id().unwrap_or_default()),
            ],
            status_ids: [
                0x180 + u16::from(left.address.node_id().unwrap_or_default()),
                0x180 + u16::from(right.address.node_id().unwrap_or_default()),
            ],
            counts_per_rad: [left, right].map(|drive| f64::from(drive.encoder_counts_per_rev) / std::f64::consts::TAU),
            joint_speed_rad_per_s: guard.joint_speed_limit_rad_per_s.get(),
            tool_speed_m_per_s: guard.tool_speed_limit_m_per_s.get(),
            stop_m_per_s2: guard.stop_deceleration_m_per_s2.get(),
            torque_per_mille: [left, right].map(|drive| 1000.0 * torque_n_m / drive.rated_torque_n_m.get()),
            torque_n_m,
            force_n: guard.force_limit_n.get(),
            energy_j: guard.energy_limit_j.get(),
            mass_kg: match rig.fixture.coupling {
                config::Coupling::Admittance { mass_kg } => mass_kg.get(),
                config::Coupling::Impedance { .. } => 0.0,
            },
            friction_n: rig.fixture.friction_n.get(),
            yield_n: rig.fixture.yield_n.get(),
            is_unilateral: rig.fixture.side == config::Side::Unilateral,
            has_hold: rig.fixture.hold_steps > 0,
            round: match rig.fixture.surface {
                config::Surface::Circle { center_m, radius_m, .. } => {
                    Some((center_m.map(|value| value.get()), radius_m.get()))
                }
                _ => None,
            },
            normal: match rig.fixture.surface {
                config::Surface::Line { normal, .. } => normal.map(|value| value.get()),
                _ => [0.0; 2],
            },
            bit_rate: match (bus, rig.simulated().map(|simulation| simulation.timing)) {
                (Some(bus), Ok(config::BusTiming::Arbitrated)) => f64::from(bus.bit_rate_bit_per_s),
                _ => f64::INFINITY,
            },
        }
    }
}

/// Largest values of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Peaks {
    /// Torque of a drive, N m.
    pub torque_n_m: f64,
    /// Speed of the tool, m/s.
    pub speed_m_per_s: f64,
    /// Speed of the proxy, m/s.
    pub proxy_m_per_s: f64,
    /// Sensed force, N.
    pub force_n: f64,
    /// Energy given to the hand in one go beyond what the proxy held, J.
    pub returned_j: f64,
    /// Share of a cycle that the rig's own frames took.
    pub bus_share: f64,
    /// Frames that waited in one port.
    pub queue: usize,
    /// Times that a position counter wrapped.
    pub wraps: u32,
}

impl Peaks {
    /// Joins two results: the greater of both peaks, and the sum of the counts.
    pub fn join(&mut self, other: &Self) {
        for (mine, theirs) in [
            (&mut self.torque_n_m, other.torque_n_m),
            (&mut self.speed_m_per_s, other.speed_m_per_s),
            (&mut self.proxy_m_per_s, other.proxy_m_per_s),
            (&mut self.force_n, other.force_n),
            (&mut self.returned_j, other.returned_j),
            (&mut self.bus_share, other.bus_share),
        ] {
            *mine = mine.max(theirs);
        }
        self.queue = self.queue.max(other.queue);
        self.wraps += other.wraps;
    }
}

/// Collects what did not hold in one cycle.
pub(super) struct Findings<'a> {
    observation: &'a Observation,
    found: &'a mut Vec<Violation>,
    excused: &'a mut Excused,
}

impl Findings<'_> {
    /// Notes that `invariant` did not hold, unless `holds`; `seen` is asked only then.
    pub(super) fn expect(&mut self, invariant: Invariant, holds: bool, seen: impl FnOnce() -> String) {
        if !holds {
            self.found.push(Violation {
                invariant,
                cycle: self.observation.cycle,
                time_s: self.observation.sync_ns as f64 * 1e-9,
                seen: seen(),
            });
        }
    }

    /// Checks as `expect`, but counts an excused deviation instead of noting it.
    pub(super) fn expect_unless(
        &mut self,
        invariant: Invariant,
        holds: bool,
        excuse: Option<Excuse>,
        seen: impl FnOnce() -> String,
    ) {
        match excuse.filter(|_| !holds) {
            Some(excuse) => self.excused.note(invariant, excuse),
            None => self.expect(invariant, holds, seen),
        }
    }
}

/// Judges the cycles of one run, in their order.
#[derive(Clone, Debug)]
pub struct Checker {
    limits: Limits,
    frames: Frames,
    motion: Motion,
    energy: Energy,
    state: State,
    peaks: Peaks,
    queue_lost: u64,
    /// SYNCs in one cycle, at most.
    syncs: usize,
    excused: Excused,
}

impl Checker {
    /// Creates a checker for a rig that is in `state` and has not moved yet.
    pub fn new(limits: Limits, state: State) -> Self {
        Self {
            limits,
            frames: Frames::default(),
            motion: Motion::default(),
            energy: Energy::default(),
            state,
            peaks: Peaks::default(),
            queue_lost: 0,
            syncs: 0,
            excused: Excused::default(),
        }
    }

    /// Returns how often deviations were excused.
    pub(super) fn excused(&self) -> &Excused {
        &self.excused
    }

    /// Returns the greatest values so far.
    pub fn peaks(&self) -> &Peaks {
        &self.peaks
    }

    /// Notes that the network was booted anew, so that earlier reports of the drives do not describe the present.
    pub fn network_restarted(&mut self) {
        self.frames = Frames::default();
        self.motion = Motion::default();
        self.energy = Energy::default();
    }

    /// Judges one cycle; adds what did not hold to `found`.
    pub fn check(&mut self, seen: &Observation, found: &mut Vec<Violation>) {
        let limits = self.limits;
        let mut excused = std::mem::take(&mut self.excused);
        self.judge(&limits, seen, &mut Findings { observation: seen, found, excused: &mut excused });
        self.excused = excused;
    }

    fn judge(&mut self, limits: &Limits, seen: &Observation, findings: &mut Findings<'_>) {
        let is_sync = |frame: &&Sighting| frame.sender.is_some() && frame.frame.id() == SYNC;
        self.syncs = self.syncs.max(seen.frames.iter().filter(is_sync).count());
        if !seen.ran {
            self.frames.watch(limits, seen, &mut self.peaks, findings);
            return self.energy = Energy::default();
        }
        self.check_state(seen, findings);
        self.frames.check(limits, seen, &mut self.peaks, findings);
        self.motion.check(limits, seen, &mut self.peaks, findings);
        self.energy.check(limits, seen, &mut self.peaks, findings);
        self.check_queues(seen, findings);
        self.state = seen.state;
    }

    /// Checks stays-latched.
    fn check_state(&mut self, seen: &Observation, findings: &mut Findings<'_>) {
        use yieldwall_motion::guard::Request;
        let (before, after) = (self.state, seen.state);
        let severity = |state| match state {
            State::Stopped => 1,
            State::Disabled => 2,
            State::Lost => 3,
            _ => 0,
        };
        let is_latched = severity(before) > 0;
        let is_reset = seen.request == Request::Reset && after == State::Idle;
        let holds = !is_latched || is_reset || severity(after) >= severity(before);
        findings.expect(Invariant::StaysLatched, holds, || {
            format!("{before:?} became {after:?} with the request {:?}", seen.request)
        });
    }

    /// Checks bounded-queues, in the cycle in which a queue was longer than ever.
    fn check_queues(&mut self, seen: &Observation, findings: &mut Findings<'_>) {
        let longest = self.peaks.queue;
        self.peaks.queue = longest.max(seen.queue_high_water);
        let lost = seen.queue_lost - self.queue_lost.min(seen.queue_lost);
        self.queue_lost = seen.queue_lost;
        let is_overloaded = seen.falsified.timing && self.syncs > tolerance::SYNCS;
        let excuse = (seen.falsified.link || is_overloaded).then_some(Excuse::Falsified);
        let most = tolerance::QUEUED_FRAMES.max(longest);
        findings
            .expect_unless(Invariant::BoundedQueues, lost == 0, excuse, || format!("{lost} frames found a full queue"));
        findings.expect_unless(Invariant::BoundedQueues, seen.queue_high_water <= most, excuse, || {
            format!("{} frames waited in one port, at most {most} may", seen.queue_high_water)
        });
    }
}
