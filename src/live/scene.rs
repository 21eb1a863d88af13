//! One scene on a rig: enables it, lets it run, stops it.

use std::sync::atomic::{AtomicBool, Ordering};

use super::error::LiveError;
use super::metronome::Metronome;
use super::rig::LiveRig;
use crate::guard::{Cause, Request, State};
use crate::link::CanLink;
use crate::record::{AROUND_FAULT_S, CycleRecord};
use crate::rig::{Enable, STOP_LIMIT_S, has_torque};

/// What is asked of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Play {
    /// Cycles between enabling and stopping.
    pub cycles: u64,
    /// Cycles of process data before the rig is enabled: long enough for two devices with one node id to show.
    pub settling: u32,
}

/// How a scene ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// All cycles were run, and the drives make no torque any more.
    Whole,
    /// A person asked for the end, and the drives make no torque any more.
    Interrupted,
    /// The supervisor stopped the rig.
    Stopped,
    /// A drive still said that it makes torque when the time for a stop was over.
    StillMoving,
    /// The cycle panicked; a quick stop was sent.
    Panicked,
}

/// A scene that is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Played {
    /// How it ended.
    pub ended: Ended,
    /// State of the supervisor before the rig was stopped.
    pub state: State,
    /// The fault that led to it.
    pub cause: Option<Cause>,
    /// Cycles between enabling and stopping.
    pub cycles: u64,
}

impl<L: CanLink, M: Metronome> LiveRig<L, M> {
    /// Enables a booted rig, runs its scene and stops it. `each` gets every record of the scene. A rig that a fault stops
    /// goes on for [`AROUND_FAULT_S`], in which its drives stop, for those who watch.
    ///
    /// # Errors
    /// If the rig does not come to run.
    pub fn play(
        &mut self,
        play: &Play,
        is_interrupted: &AtomicBool,
        mut each: impl FnMut(&CycleRecord),
    ) -> Result<Played, LiveError> {
        self.enable(play.settling, is_interrupted)?;
        self.begin_scene();
        let mut cycles = 0;
        let mut ended = Ended::Whole;
        while cycles < play.cycles {
            if is_interrupted.load(Ordering::Relaxed) {
                ended = Ended::Interrupted;
                break;
            }
            let Some(record) = self.run_cycle(Request::None) else {
                ended = Ended::Panicked;
                break;
            };
            each(&record);
            cycles += 1;
            if self.state().is_latched() {
                ended = Ended::Stopped;
                break;
            }
        }
        let (state, cause) = (self.state(), self.cause());
        match ended {
            Ended::Stopped => {
                for _ in 0..self.cycles_in(AROUND_FAULT_S) {
                    self.run_cycle(Request::None);
                }
            }
            Ended::Whole | Ended::Interrupted if !self.stop() => ended = Ended::StillMoving,
            _ => {}
        }
        Ok(Played { ended, state, cause, cycles })
    }

    pub(super) fn enable(&mut self, settling: u32, is_interrupted: &AtomicBool) -> Result<(), LiveError> {
        let mut enabling = self.enabling.not_before(settling);
        loop {
            if is_interrupted.load(Ordering::Relaxed) {
                self.stop();
                return Err(LiveError::Interrupted);
            }
            match enabling.next(self.state()) {
                Enable::Ask(request) => self.run_cycle(request),
                Enable::Done => return Ok(()),
                Enable::GivenUp => break,
            };
        }
        let cause = self.cause();
        self.stop();
        Err(LiveError::NotEnabled { waited_s: enabling.waited_s(), cause })
    }

    /// Stops the rig along its ramp; whether both drives said in time that they make no torque.
    pub fn stop(&mut self) -> bool {
        for _ in 0..self.cycles_in(STOP_LIMIT_S) {
            if !self.makes_torque() {
                return true;
            }
            if self.run_cycle(Request::Stop).is_none() {
                return false;
            }
        }
        !self.makes_torque()
    }

    pub(super) fn makes_torque(&self) -> bool {
        self.master().last_inputs().drives.iter().any(|drive| has_torque(drive.state))
    }

    fn cycles_in(&self, time_s: f64) -> u32 {
        (time_s / self.period().as_secs_f64()).round() as u32
    }
}
