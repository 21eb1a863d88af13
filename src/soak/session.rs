//! One run: the rig of a seed, its script of faults, its person, and the checker that watches.

#[cfg(test)]
mod tests;

use std::sync::{Arc, Mutex};
use yieldwall_motion::elementary;

use serde::{Deserialize, Serialize};

use super::checker::{Checker, Limits, Peaks};
use super::draw::Machine;
use super::excuse::{Excuse, Excused};
use super::invariant::{Invariant, Violation};
use super::nature;
use super::observation::{Falsified, Observation, Reported, Sender, Sighting, Truth};
use super::operator::{Act, Operator};
use super::segment::{OnCable, OnCableAt, Segment};
use super::tolerance;
use yieldwall_config::injection::Injection;
use yieldwall_link::Packet;
use yieldwall_motion::guard::fault::TABLE;
use yieldwall_motion::guard::{Device, Fault, Request, State};
use yieldwall_record::CycleRecord;
use yieldwall_rig::{EmbeddedRig, PORTS, RigError};
use yieldwall_sim::can::BusCounters;

/// Violations that are kept of one run: the first of each invariant, and not more than this.
const MOST_VIOLATIONS: usize = 5;

/// Parameters of a run.
#[derive(Clone, Copy, Debug)]
pub struct Course<'a> {
    /// The machine.
    pub machine: &'a Machine,
    /// Injections with their times.
    pub script: &'a [Injection],
    /// The seed of noise, tremor and the person.
    pub seed: u64,
    /// Cycles after the boot.
    pub cycles: u32,
}

/// A change of the supervisor's state, or of its cause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// Cycle since the boot.
    pub cycle: u32,
    /// Moment of its SYNC in ns since switching on.
    pub sync_ns: u64,
    /// State before.
    pub from: State,
    /// State after.
    pub to: State,
    /// Fault that caused it.
    pub cause: Option<Fault>,
    /// Fault that had caused the state before.
    pub cause_before: Option<Fault>,
    /// Distance of the tool from the task's origin, m.
    pub radius_m: f64,
    /// Cycles since a drive gave all the torque that it may: a hand then moves the arm whatever the loop wants. `None` if
    /// none ever did.
    pub since_torque_limit: Option<u32>,
    /// Whether the drives were enabled, or being enabled, a moment ago on an arm that moved outside of where the rig promises
    /// to work.
    pub is_carried: bool,
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum End {
    /// All cycles were run.
    Complete,
    /// The network did not boot.
    NotBooted,
    /// The process that ran the master ended.
    MasterGone,
    /// The simulated arm could not go on.
    Broken,
}

/// Result of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Play {
    /// How it ended.
    pub end: End,
    /// Cycles that were run.
    pub cycles: u32,
    /// Virtual time in s.
    pub simulated_s: f64,
    /// A mark of everything that was seen: equal for equal runs.
    pub hash: u64,
    /// Changes of state, in order.
    pub events: Vec<Event>,
    /// How often each fault began to show, in the order of the table.
    pub shown: [u32; Fault::COUNT],
    /// Moment in ns since switching on at which the scene began.
    pub scene_from_ns: Option<u64>,
    /// Moment of SYNC of each cycle in ns since switching on. The cycles follow the reference clock of a segment, which is not the host's.
    pub(super) syncs_ns: Vec<u64>,
    /// Violations.
    pub violations: Vec<Violation>,
    /// The greatest values.
    pub peaks: Peaks,
    /// Excused deviations.
    pub(super) excused: Excused,
    /// Times that the network was booted anew.
    pub restarts: u32,
}

impl Play {
    /// Returns the result of a run in which nothing happened.
    pub(super) fn nothing() -> Self {
        Self {
            end: End::Broken,
            cycles: 0,
            simulated_s: 0.0,
            hash: 0,
            events: Vec::new(),
            shown: [0; Fault::COUNT],
            scene_from_ns: None,
            syncs_ns: Vec::new(),
            violations: Vec::new(),
            peaks: Peaks::default(),
            excused: Excused::default(),
            restarts: 0,
        }
    }
}

/// Mixes words into a mark. The mark is not safe against manipulation.
#[derive(Clone, Copy, Debug)]
struct Mark(u64);

impl Mark {
    fn word(&mut self, word: u64) {
        self.0 = (self.0 ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 ^= self.0 >> 29;
    }

    fn pair(&mut self, pair: [f64; 2]) {
        pair.into_iter().for_each(|value| self.word(value.to_bits()));
    }

    fn observation(&mut self, seen: &Observation) {
        self.word(seen.sync_ns);
        self.word(seen.state as u64 | (seen.request as u64) << 8 | seen.cause.map_or(255, |fault| fault as u64) << 16);
        for sighting in &seen.frames {
            self.word(sighting.time_ns);
            self.word(sighting.frame.bits());
            self.word(u64::from(sighting.frame.id()) | u64::from(sighting.sender.is_some()) << 16);
        }
        for passed in &seen.on_cable {
            self.word(passed.time_ns);
            match passed.what {
                OnCable::Open => self.word(0),
                OnCable::Outputs(told) => told.into_iter().flatten().for_each(|told| {
                    self.word(u64::from(told.controlword) << 32 | u64::from(told.target as u32));
                }),
                OnCable::Inputs(told) => told.into_iter().flatten().for_each(|told| {
                    self.word(u64::from(told.statusword) << 32 | u64::from(told.position as u32));
                }),
                OnCable::Taken(taken) => self.word(1 + taken.map(u64::from).into_iter().sum::<u64>()),
            }
        }
        let Reported { force_n, proxy_m, target_rad, measured_rad, .. } = seen.reported;
        for pair in [force_n, proxy_m, target_rad, measured_rad, seen.truth.tool_m, seen.truth.torques_n_m] {
            self.pair(pair);
        }
    }
}

/// Runs a course from switching on.
pub fn play(course: &Course<'_>) -> Play {
    play_watched(course, |_| {})
}

/// Plays the course; `watch` receives the observation of every cycle.
pub fn play_watched(course: &Course<'_>, watch: impl FnMut(&Observation)) -> Play {
    let mut run = Run::new(course);
    let end = match run.all(watch) {
        Ok(end) => end,
        Err(error) => {
            match run.excuse_of(&error) {
                Some(excuse) => run.excused.note(Invariant::Simulation, excuse),
                None => run.kept.push(run.violation(Invariant::Simulation, error.to_string())),
            }
            End::Broken
        }
    };
    run.excused.join(run.checker.excused());
    Play {
        end,
        cycles: run.seen.cycle,
        simulated_s: run.seen.sync_ns as f64 * 1e-9,
        hash: run.mark.0,
        events: run.events,
        shown: run.shown,
        scene_from_ns: run.scene_from_ns,
        syncs_ns: run.syncs_ns,
        violations: run.kept,
        peaks: *run.checker.peaks(),
        excused: run.excused,
        restarts: run.restarts,
    }
}

struct Run<'a> {
    course: &'a Course<'a>,
    sightings: Arc<Mutex<Vec<Sighting>>>,
    on_cable: Arc<Mutex<Vec<OnCableAt>>>,
    record: Arc<Mutex<Option<CycleRecord>>>,
    seen: Observation,
    checker: Checker,
    found: Vec<Violation>,
    kept: Vec<Violation>,
    mark: Mark,
    events: Vec<Event>,
    shown: [u32; Fault::COUNT],
    scene_from_ns: Option<u64>,
    syncs_ns: Vec<u64>,
    restarts: u32,
    excused: Excused,
    /// Cycle in which a drive last gave all the torque that it may.
    torque_limit_cycle: Option<u32>,
    /// Whether a drive was enabled in the last cycle.
    was_held: bool,
    /// Until when an arm that the drives took over in motion may still be on its way, ns.
    carried_until_ns: u64,
}

impl<'a> Run<'a> {
    fn new(course: &'a Course<'a>) -> Self {
        let limits = Limits::of(&course.machine.rig);
        let zero = [0.0; 2];
        Self {
            course,
            sightings: Arc::default(),
            on_cable: Arc::default(),
            record: Arc::default(),
            seen: Observation {
                cycle: 0,
                sync_ns: 0,
                request: Request::None,
                state: State::Idle,
                cause: None,
                frames: Vec::with_capacity(64),
                on_cable: Vec::with_capacity(8),
                reported: Reported::default(),
                truth: Truth {
                    angles_rad: zero,
                    tool_m: zero,
                    velocity_m_per_s: zero,
                    hand_n: zero,
                    torques_n_m: zero,
                    drives: [yieldwall_drives::cia402::State::NotReadyToSwitchOn; 2],
                },
                falsified: Falsified::default(),
                queue_high_water: 0,
                queue_lost: 0,
                ran: false,
            },
            checker: Checker::new(limits, State::Idle),
            found: Vec::new(),
            kept: Vec::new(),
            mark: Mark(course.seed),
            events: Vec::new(),
            shown: [0; Fault::COUNT],
            scene_from_ns: None,
            syncs_ns: Vec::new(),
            restarts: 0,
            excused: Excused::default(),
            torque_limit_cycle: None,
            was_held: false,
            carried_until_ns: 0,
        }
    }

    /// Returns the reason why an arm that cannot go on is no violation.
    fn excuse_of(&self, error: &RigError) -> Option<Excuse> {
        let falsified = self.falsified();
        let is_held = matches!(self.seen.state, State::Running | State::Holding | State::Stopping);
        match error {
            RigError::Arm(_) if !is_held => Some(Excuse::Unheld),
            // An arm that is led by an angle that is not its own goes anywhere.
            RigError::Arm(_) if falsified.angles || falsified.drives => Some(Excuse::Falsified),
            // Pushed there by a hand while nobody held it, and enabled not far from there.
            RigError::Arm(_) if self.tool_radius_m() >= tolerance::FAR_M => Some(Excuse::Far),
            _ => None,
        }
    }

    /// Returns the distance of the tool from the task's origin in m.
    fn tool_radius_m(&self) -> f64 {
        let [x, y] = self.seen.truth.tool_m;
        elementary::hypot(x, y)
    }

    /// Notes when drives take over an arm that moves outside of where the rig promises to work.
    fn note_takeover(&mut self) {
        use yieldwall_drives::cia402::State as Drive;
        let is_held = self.seen.truth.drives.contains(&Drive::OperationEnabled);
        let [x, y] = self.seen.truth.velocity_m_per_s;
        let is_outside = self.tool_radius_m() > self.course.machine.rig.linkage.working_radius_m.get();
        let is_moving = elementary::hypot(x, y) > tolerance::CARRIED_M_PER_S;
        let is_takeover = self.seen.state == State::Enabling || (is_held && !self.was_held);
        if is_takeover && is_outside && is_moving {
            self.carried_until_ns = self.seen.sync_ns + (tolerance::QUICK_STOP_S * 1e9) as u64;
        }
        self.was_held = is_held;
    }

    fn violation(&self, invariant: Invariant, seen: String) -> Violation {
        Violation { invariant, cycle: self.seen.cycle, time_s: self.seen.sync_ns as f64 * 1e-9, seen }
    }

    fn all(&mut self, mut watch: impl FnMut(&Observation)) -> Result<End, RigError> {
        let Machine { rig, scene, .. } = self.course.machine;
        let mut machine = EmbeddedRig::new(rig, scene, &rig.fixture, self.course.seed)?;
        machine.set_injections(self.course.script)?;
        self.watch(&mut machine);
        match machine.power_up() {
            Ok(()) => {}
            Err(RigError::Boot(_)) => return Ok(End::NotBooted),
            Err(error) => return Err(error),
        }
        self.clear_frames();
        let mut person = Operator::new(self.course.seed, self.course.machine.period_s());
        for _ in 0..self.course.cycles {
            let request = match person.act(self.seen.state) {
                Act::Ask(request) => request,
                // Somebody who looks for the reason first: while something is broken, booting would only fail.
                Act::Restart if self.is_something_broken() => Request::None,
                Act::Restart => {
                    if !self.restart(&mut machine)? {
                        return Ok(End::NotBooted);
                    }
                    Request::None
                }
            };
            self.cycle(&mut machine, request)?;
            watch(&self.seen);
            if machine.is_master_gone() {
                self.watch_drives_stop(&mut machine)?;
                return Ok(End::MasterGone);
            }
            if self.kept.len() >= MOST_VIOLATIONS {
                break;
            }
        }
        Ok(End::Complete)
    }

    /// Makes the person boot the network anew, and returns whether all nodes were found.
    fn restart(&mut self, machine: &mut EmbeddedRig) -> Result<bool, RigError> {
        self.restarts += 1;
        match machine.boot_again() {
            Ok(()) => {}
            Err(RigError::Boot(_) | RigError::NotEnabled { .. }) => return Ok(false),
            Err(error) => return Err(error),
        }
        self.clear_frames();
        self.checker.network_restarted();
        Ok(true)
    }

    /// Whether an injection acts now.
    fn is_something_broken(&self) -> bool {
        let Some(time_s) = self.scene_time_s() else { return false };
        let lasts = |injection: &Injection| (injection.start_s..=injection.end_s()).contains(&time_s);
        self.course.script.iter().any(lasts)
    }

    /// Returns the time in s since the scene began; `None` before.
    fn scene_time_s(&self) -> Option<f64> {
        self.scene_from_ns.map(|from| (self.seen.sync_ns as f64 - from as f64) * 1e-9)
    }

    /// Watches the drives stop without a master: both have to leave Operation Enabled, and to end without torque.
    fn watch_drives_stop(&mut self, machine: &mut EmbeddedRig) -> Result<(), RigError> {
        use yieldwall_drives::cia402::State as Drive;
        let period_s = self.course.machine.period_s();
        let bound = tolerance::WATCHDOG_CYCLES;
        let rest = bound + (tolerance::QUICK_STOP_S / period_s).ceil() as u32;
        for cycle in 1..=rest {
            // Time goes on without a cycle.
            machine.run_cycle(Request::None)?;
            let enabled = machine.drive_states().into_iter().filter(|state| *state == Drive::OperationEnabled).count();
            let torque = machine.drive_torques_n_m().into_iter().any(|torque_n_m| torque_n_m != 0.0);
            let seen = match cycle {
                // A held interface lets set-points go late, and a drive without its watchdog goes on for good.
                _ if cycle == bound && enabled > 0 && (self.seen.falsified.link || self.seen.falsified.watchdog) => {
                    self.excused.note(Invariant::Watchdog, Excuse::Falsified);
                    continue;
                }
                _ if cycle == bound && enabled > 0 => {
                    format!("{enabled} drives are still in Operation Enabled {bound} cycles after the last set-point")
                }
                _ if cycle == rest && enabled > 0 && self.seen.falsified.watchdog => {
                    self.excused.note(Invariant::Watchdog, Excuse::Falsified);
                    continue;
                }
                _ if cycle == rest && torque => {
                    format!("a drive still makes torque {rest} cycles after the last set-point")
                }
                _ => continue,
            };
            let found = self.violation(Invariant::Watchdog, seen);
            self.kept.push(found);
        }
        Ok(())
    }

    fn watch(&self, machine: &mut EmbeddedRig) {
        let sightings = Arc::clone(&self.sightings);
        machine.set_witness(Box::new(move |passage| {
            let sender = match PORTS.iter().position(|port| *port == passage.from) {
                Some(0) => Sender::Master,
                Some(joint @ (1 | 2)) => Sender::Drive(joint - 1),
                Some(_) => Sender::Sensor,
                None => Sender::Stranger,
            };
            if let Ok(mut sightings) = sightings.lock() {
                sightings.push(Sighting { time_ns: passage.time.0, sender: Some(sender), frame: passage.sent });
            }
        }));
        let (arrivals, on_cable) = (Arc::clone(&self.sightings), Arc::clone(&self.on_cable));
        let mut segment = Segment::default();
        machine.set_tap(Box::new(move |time, packet| match packet {
            Packet::Can(frame) => {
                if let Ok(mut sightings) = arrivals.lock() {
                    sightings.push(Sighting { time_ns: time.0, sender: None, frame: *frame });
                }
            }
            Packet::Ethernet { bytes, .. } => {
                if let (Some(what), Ok(mut on_cable)) = (segment.see(bytes), on_cable.lock()) {
                    on_cable.push(OnCableAt { time_ns: time.0, what });
                }
            }
        }));
        let record = Arc::clone(&self.record);
        machine.set_observer(Box::new(move |new| {
            if let Ok(mut record) = record.lock() {
                *record = Some(*new);
            }
        }));
    }

    fn clear_frames(&self) {
        if let Ok(mut sightings) = self.sightings.lock() {
            sightings.clear();
        }
        if let Ok(mut on_cable) = self.on_cable.lock() {
            on_cable.clear();
        }
    }

    /// Runs one cycle and judges it.
    fn cycle(&mut self, machine: &mut EmbeddedRig, request: Request) -> Result<(), RigError> {
        self.seen.cycle += 1;
        let before = self.seen.state;
        let cause_before = self.seen.cause;
        let grid_ns = machine.next_sync().0;
        machine.run_cycle(request)?;
        self.look(machine, request, grid_ns);
        self.syncs_ns.push(grid_ns);
        self.seen.falsified = self.falsified();
        self.note_takeover();
        if self.scene_from_ns.is_none() && self.seen.state == State::Running {
            machine.take_handle();
            self.scene_from_ns = Some(machine.next_sync().0);
        }
        let most = (1.0 - tolerance::ROUNDING) * self.course.machine.rig.guard.torque_limit_n_m.get();
        let seen = &self.seen;
        if seen.truth.torques_n_m.iter().any(|torque| torque.abs() >= most) {
            self.torque_limit_cycle = Some(seen.cycle);
        }
        // A process that was killed says nothing; one that panicked has said it.
        let says = seen.ran || seen.cause == Some(Fault::CyclePanicked);
        if says && (seen.state != before || seen.cause != cause_before) {
            self.events.push(Event {
                cycle: seen.cycle,
                sync_ns: seen.sync_ns,
                from: before,
                to: seen.state,
                cause: seen.cause,
                cause_before,
                radius_m: self.tool_radius_m(),
                since_torque_limit: self.torque_limit_cycle.map(|cycle| seen.cycle.saturating_sub(cycle)),
                is_carried: seen.sync_ns <= self.carried_until_ns,
            });
        }
        if seen.ran {
            let faults = machine.master().cycle().faults();
            for (row, shown) in TABLE.iter().zip(&mut self.shown) {
                *shown += u32::from(faults.count(row.fault) == 1);
            }
        }
        self.checker.check(seen, &mut self.found);
        self.mark.observation(seen);
        for found in self.found.drain(..) {
            if self.kept.len() < MOST_VIOLATIONS && self.kept.iter().all(|kept| kept.invariant != found.invariant) {
                self.kept.push(found);
            }
        }
        Ok(())
    }

    /// Returns the values that the present injections falsify.
    fn falsified(&self) -> Falsified {
        let mut all = Falsified::default();
        // Before the scene only what is there from switching on acts.
        let time_s = self.scene_time_s().unwrap_or(-1.0);
        for injection in self.course.script {
            let starts_s = if nature::is_from_boot(injection.kind) { f64::NEG_INFINITY } else { injection.start_s };
            // The frames of one cycle are seen with the next.
            if (starts_s - self.course.machine.period_s()..=nature::settled_s(injection)).contains(&time_s) {
                all.join(nature::falsifies(injection.kind));
            }
        }
        all
    }

    /// Takes what is to be seen of the cycle that was to begin at `grid_ns` and has just run.
    fn look(&mut self, machine: &EmbeddedRig, request: Request, grid_ns: u64) {
        let seen = &mut self.seen;
        seen.frames.clear();
        if let Ok(mut sightings) = self.sightings.lock() {
            std::mem::swap(&mut seen.frames, &mut sightings);
        }
        seen.on_cable.clear();
        if let Ok(mut on_cable) = self.on_cable.lock() {
            std::mem::swap(&mut seen.on_cable, &mut on_cable);
        }
        let record = self.record.lock().ok().and_then(|mut record| record.take());
        seen.ran = record.is_some();
        seen.sync_ns = grid_ns;
        if let Some(record) = record {
            let signals = &record.signals;
            seen.reported = Reported {
                force_n: signals.force.to_array(),
                proxy_m: signals.proxy.to_array(),
                target_rad: signals.target_angles.to_array(),
                measured_rad: signals.measured_angles.to_array(),
                distance_m: signals.signed_distance_m,
                is_on_surface: signals.is_on_surface,
                hold_counter: signals.hold_counter,
                is_impact: signals.is_impact,
                is_saturated: signals.is_saturated,
                has_inputs: record.inputs.drives.map(|drive| drive.angle_rad.is_some()),
                outputs_missed: [Device::LeftDrive, Device::RightDrive]
                    .map(|drive| record.inputs.link.outputs_missed.contains(drive.set())),
            };
        }
        let truth = machine.body_truth();
        seen.truth = Truth {
            angles_rad: truth.angles.to_array(),
            tool_m: truth.tool.to_array(),
            velocity_m_per_s: truth.velocity.to_array(),
            hand_n: truth.hand.to_array(),
            torques_n_m: machine.drive_torques_n_m(),
            drives: machine.drive_states(),
        };
        let counters: BusCounters = machine.bus_counters().sum();
        seen.queue_high_water = counters.queue_high_water;
        seen.queue_lost = counters.overflowed;
        seen.request = request;
        seen.state = machine.state();
        seen.cause = machine.cause().map(|cause| cause.fault);
    }
}
