//! The watchdog drill: does each drive stop by itself when it no longer hears what it watches, and how soon?

use std::time::Duration;

use super::buses;
use super::embedded::EmbeddedRig;
use super::error::RigError;
use crate::canopen::{Frame, Time, cob};
use crate::config;
use crate::guard::Request;
use crate::sim::Watchdog;
use yieldwall_drives::cia402;

/// Longest time that a drive is waited for.
pub const DRILL_LIMIT: Duration = Duration::from_secs(1);
/// Longest time from the last thing heard to the drive's reaction with which torque may be commanded.
pub const TORQUE_LIMIT: Duration = Duration::from_millis(10);
/// Cycles from enabling to the silence: the arm rests.
pub const CYCLES_BEFORE_SILENCE: u32 = 50;

/// What one watchdog does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Which one.
    pub watchdog: Watchdog,
    /// Time from the last thing heard to leaving Operation Enabled, of the left and of the right drive; `None` if it did not
    /// within [`DRILL_LIMIT`].
    pub stopped_after: [Option<Duration>; 2],
}

/// What a drill has found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drilled {
    /// One finding a watchdog.
    pub findings: Vec<Finding>,
    /// Longest time between two looks at a drive: by so much the true times may be shorter.
    pub resolution: Duration,
}

/// Why a rig with these drives must not be enabled.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unsafe {
    /// A drive goes on.
    #[error("the {side} drive goes on for more than {} s when {} stay away", DRILL_LIMIT.as_secs_f64(), .watchdog.name())]
    GoesOn {
        /// Which drive.
        side: &'static str,
        /// What it does not watch.
        watchdog: Watchdog,
    },
    /// A drive in torque mode is too slow.
    #[error(
        "torque mode needs a drive that stops by itself within {} ms when the master dies; the {side} drive takes {:.1} ms",
        TORQUE_LIMIT.as_millis(),
        1e3 * .takes.as_secs_f64()
    )]
    TooSlow {
        /// Which drive.
        side: &'static str,
        /// How long it takes.
        takes: Duration,
    },
}

impl Drilled {
    /// Whether drives with these watchdogs may be enabled: each of them has to stop each drive, and in torque mode the one that
    /// is fastest when the master dies within [`TORQUE_LIMIT`].
    ///
    /// # Errors
    /// Why not.
    pub fn judge(&self, is_torque: bool) -> Result<(), Unsafe> {
        for (drive, side) in ["left", "right"].into_iter().enumerate() {
            let mut fastest = Duration::MAX;
            for watchdog in Watchdog::ALL {
                let finding = self.findings.iter().find(|finding| finding.watchdog == watchdog);
                match finding.and_then(|finding| finding.stopped_after.get(drive).copied().flatten()) {
                    Some(takes) => fastest = fastest.min(takes),
                    None => return Err(Unsafe::GoesOn { side, watchdog }),
                }
            }
            if is_torque && fastest > TORQUE_LIMIT {
                return Err(Unsafe::TooSlow { side, takes: fastest });
            }
        }
        Ok(())
    }
}

/// What keeps frames of the master from the drives of an embedded rig, and notes when these stop.
#[derive(Debug)]
pub(super) struct Silence {
    watchdog: Watchdog,
    /// Buses and identifiers of the set-points.
    set_points: [(u8, u16); 2],
    /// The set-points that are repeated, as the last cycle sent them.
    repeated: [Option<Frame>; 2],
    is_on: bool,
    last: Time,
    stopped_at: [Option<Time>; 2],
}

impl Silence {
    fn new(watchdog: Watchdog, rig: &config::Rig) -> Result<Self, RigError> {
        let id = |drive: &config::Drive| cob::node_id(drive.node_id).ok().and_then(|node| cob::rpdo(1, node));
        let [left, right] = &rig.drives;
        let [left_bus, right_bus, _] = buses::device_buses(rig)?;
        let set_points = [(left_bus, id(left).unwrap_or_default()), (right_bus, id(right).unwrap_or_default())];
        Ok(Self { watchdog, set_points, repeated: [None; 2], is_on: false, last: Time(0), stopped_at: [None; 2] })
    }

    /// What the devices get of a frame of the master.
    pub(super) fn pass(&mut self, now: Time, frame: Frame) -> Option<Frame> {
        let drive = self.set_points.iter().position(|own| *own == (frame.bus(), frame.id()));
        let is_watched = match self.watchdog {
            Watchdog::Sync => frame.id() == cob::SYNC,
            Watchdog::SetPoints => drive.is_some(),
            Watchdog::Heartbeat => cob::is_heartbeat(frame.id()),
        };
        if self.is_on {
            // A master that notices and stops the drives would hide what they do by themselves.
            let repeated = drive.and_then(|drive| self.repeated.get(drive).copied().flatten());
            return if is_watched { None } else { Some(repeated.unwrap_or(frame)) };
        }
        if let Some(place) = drive.and_then(|drive| self.repeated.get_mut(drive)) {
            *place = Some(frame);
        }
        if is_watched {
            self.last = now;
        }
        Some(frame)
    }

    /// Looks at the drives.
    pub(super) fn look(&mut self, now: Time, states: [cia402::State; 2]) {
        for (stopped_at, state) in self.stopped_at.iter_mut().zip(states) {
            if self.is_on && state != cia402::State::OperationEnabled {
                stopped_at.get_or_insert(now);
            }
        }
    }

    fn finding(&self) -> Finding {
        let stopped_after = self.stopped_at.map(|stopped_at| stopped_at.map(|at| at.since(self.last)));
        Finding { watchdog: self.watchdog, stopped_after }
    }
}

/// Drills the simulated drives of a rig in virtual time; `prepare` may change each rig before it is enabled.
///
/// # Errors
/// If the rig cannot be built or enabled.
pub fn drill(
    rig: &config::Rig,
    scene: &config::Scene,
    mut prepare: impl FnMut(&mut EmbeddedRig),
) -> Result<Drilled, RigError> {
    let mut findings = Vec::new();
    for watchdog in Watchdog::ALL {
        let mut machine = EmbeddedRig::new(rig, scene, &rig.fixture, scene.seed)?;
        machine.clear_injections();
        prepare(&mut machine);
        machine.enable()?;
        machine.silence = Some(Silence::new(watchdog, rig)?);
        for _ in 0..CYCLES_BEFORE_SILENCE {
            machine.run_cycle(Request::None)?;
        }
        if let Some(silence) = &mut machine.silence {
            silence.is_on = true;
        }
        let limit = machine.now() + DRILL_LIMIT;
        while machine.now() < limit && machine.silence.as_ref().is_some_and(|it| it.stopped_at.contains(&None)) {
            machine.run_cycle(Request::None)?;
        }
        findings.extend(machine.silence.as_ref().map(Silence::finding));
    }
    // Every event is looked at.
    Ok(Drilled { findings, resolution: Duration::ZERO })
}
