//! One scene on a rig: enables it, lets it run, stops it.

use std::sync::atomic::{AtomicBool, Ordering};

use super::conduct::{Enable, Enabling, STOP_LIMIT_S, settling_on_bus};
use super::error::RunError;
use super::orders::Orders;
use super::permit::{Ask, Permit};
use super::place::Place;
use super::runner::Runner;
use yieldwall_config as config;
use yieldwall_motion::guard::{Cause, Device, State};
use yieldwall_record::{AROUND_FAULT_S, CycleRecord};

/// How long the runner asks drives that did not come to run for their errors, s.
const ERRORS_LIMIT_S: f64 = 0.5;
/// How long a stopped rig waits for drives that do not answer, s.
const UNHEARD_S: f64 = 0.1;

/// Parameters of a scene's run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Play {
    /// Cycles between enabling and stopping.
    pub cycles: u64,
    /// Cycles of process data before the rig is enabled: long enough for two devices with one node id to show.
    pub settling: u32,
}

impl Play {
    /// Returns a scene of this length, in s, for a rig on a real bus: one cycle at least.
    pub fn on_bus(rig: &config::Rig, duration_s: f64) -> Self {
        let period_s = f64::from(rig.cycle.period_us) * 1e-6;
        Self { cycles: (duration_s / period_s).round().max(1.0) as u64, settling: settling_on_bus(rig) }
    }
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
    /// A drive still reported torque when the time for a stop was over, whatever had stopped the rig.
    StillMoving,
    /// The cycle panicked; a quick stop was sent, and torque off after it.
    Panicked,
}

/// Result of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Played {
    /// How it ended.
    pub ended: Ended,
    /// State of the supervisor before the rig was stopped.
    pub state: State,
    /// Fault that caused it.
    pub cause: Option<Cause>,
    /// Cycles between enabling and stopping, without those in which a fault had stopped the rig.
    pub cycles: u64,
    /// How often a person has reset and enabled it again.
    pub came_back: u32,
}

impl<P: Place + ?Sized> Runner<P> {
    /// Enables a booted rig, runs its scene and stops it. `each` receives every record of the scene. If a fault stops the rig, the
    /// cycles go on for [`AROUND_FAULT_S`], in which its drives stop, so that records show it.
    ///
    /// # Errors
    /// If the rig does not come to run.
    pub fn play(
        &mut self,
        play: &Play,
        permit: &Permit,
        is_interrupted: &AtomicBool,
        each: impl FnMut(&CycleRecord),
    ) -> Result<Played, RunError> {
        self.play_attended(play, permit, is_interrupted, None, each)
    }

    /// Plays a scene with a person at it. After a fault has stopped the rig, its cycles go on at rest until that person gives both
    /// orders or asks for the end. After a reset the rig is enabled only by a separate order, with a permit of the same boot. A
    /// node that has restarted prevents that. The scene goes on with the cycles that are left.
    ///
    /// # Errors
    /// As [`Runner::play`].
    pub fn play_attended(
        &mut self,
        play: &Play,
        permit: &Permit,
        is_interrupted: &AtomicBool,
        orders: Option<&Orders>,
        mut each: impl FnMut(&CycleRecord),
    ) -> Result<Played, RunError> {
        self.enable(play.settling, permit, is_interrupted)?;
        self.begin_scene();
        let (mut cycles, mut came_back) = (0, 0);
        let mut ended = Ended::Whole;
        // By what, also where a person has reset it and not enabled it again.
        let mut stopped = None;
        while cycles < play.cycles {
            if is_interrupted.load(Ordering::Relaxed) {
                ended = Ended::Interrupted;
                break;
            }
            let record = self.run_cycle(Ask::Nothing);
            if self.has_panicked() {
                ended = Ended::Panicked;
                break;
            }
            record.iter().for_each(&mut each);
            cycles += 1;
            if self.state().is_latched() {
                stopped = Some((self.state(), self.cause()));
                if let Some(orders) = orders
                    && self.come_back(play, permit, is_interrupted, orders)
                {
                    (came_back, stopped) = (came_back + 1, None);
                    continue;
                }
                ended = Ended::Stopped;
                break;
            }
        }
        let (state, cause) = stopped.unwrap_or((self.state(), self.cause()));
        if ended == Ended::Stopped && self.has_panicked() {
            ended = Ended::Panicked;
        }
        // With orders a person has seen the drives' errors.
        let ended = if orders.is_some() { self.end_stopped(ended) } else { self.end(ended) };
        Ok(Played { ended, state, cause, cycles, came_back })
    }

    /// Ends a scene: asks the drives for their errors if a fault has stopped the rig, stops it, and returns how the scene ended.
    pub(super) fn end(&mut self, ended: Ended) -> Ended {
        if ended == Ended::Stopped && self.state().is_latched() {
            for _ in 0..self.cycles_in(AROUND_FAULT_S) {
                self.ask_for_errors();
                self.run_cycle(Ask::Nothing);
            }
        }
        self.end_stopped(ended)
    }

    fn end_stopped(&mut self, ended: Ended) -> Ended {
        let is_off = self.stop();
        match ended {
            Ended::Panicked => ended,
            // Drives that are not heard are left to their watchdogs.
            Ended::Stopped if !self.is_torque_told() => ended,
            _ if is_off => ended,
            _ => Ended::StillMoving,
        }
    }

    /// Enables a booted rig after this number of cycles of process data; a rig that does not come to run is stopped.
    ///
    /// # Errors
    /// If the permit is of another boot, the rig does not come to run, or a person asks for the end.
    pub fn enable(&mut self, settling: u32, permit: &Permit, is_interrupted: &AtomicBool) -> Result<(), RunError> {
        let enabling = self.enabling.not_before(settling);
        let enabled = self.come_to_run(enabling, permit, is_interrupted);
        if let Err(error) = &enabled {
            self.stop();
            if matches!(error, RunError::NotEnabled { .. }) {
                self.hear_errors();
            }
        }
        enabled
    }

    /// Tares the force sensor if the rig file asks for it, and asks a booted rig to be enabled until it runs, if the permit is of
    /// this boot.
    ///
    /// # Errors
    /// As [`Runner::enable`], except that the caller has to stop the rig.
    pub fn come_to_run(
        &mut self,
        mut enabling: Enabling,
        permit: &Permit,
        is_interrupted: &AtomicBool,
    ) -> Result<(), RunError> {
        self.check_permit(permit)?;
        // While joints are led a known force may pull at the tool, and none moves them.
        if let Some(tared) = self.tared.filter(|_| !self.leads) {
            self.tare_by(tared, is_interrupted)?;
        }
        loop {
            if is_interrupted.load(Ordering::Relaxed) {
                return Err(RunError::Interrupted);
            }
            match enabling.next(self.state(), permit) {
                Enable::Ask(ask) => {
                    if ask != Ask::Nothing && permit.motion_bound_rad().is_none() {
                        self.check_homed()?;
                    }
                    self.run_cycle(ask)
                }
                Enable::Done => return Ok(()),
                Enable::GivenUp => break,
            };
            if self.has_panicked() {
                break;
            }
        }
        Err(RunError::NotEnabled { waited_s: enabling.waited_s(), cause: self.cause() })
    }

    /// Checks that the positions of both drives refer to home, if they have to be homed.
    pub(super) fn check_homed(&self) -> Result<(), RunError> {
        let homing = Device::DRIVES.into_iter().zip(self.master().homing());
        let lacking = homing.into_iter().find(|(_, homing)| !homing.is_referenced);
        lacking.map_or(Ok(()), |(device, _)| Err(RunError::NotHomed { which: self.which(device) }))
    }

    /// Continues the cycles of a rig that a fault has stopped until a person has reset and enabled it. Returns whether it runs
    /// again.
    fn come_back(&mut self, play: &Play, permit: &Permit, is_interrupted: &AtomicBool, orders: &Orders) -> bool {
        self.forget_errors();
        // What was asked for before it was stopped is of no account.
        orders.take();
        loop {
            if is_interrupted.load(Ordering::Relaxed) || self.has_panicked() {
                return false;
            }
            let [resets, enables] = orders.take();
            match self.state() {
                State::Idle if enables => {
                    let enabling = self.enabling.after_reset().not_before(play.settling);
                    match self.come_to_run(enabling, permit, is_interrupted) {
                        Ok(()) => return true,
                        Err(_) => {
                            self.stop();
                            self.forget_errors();
                        }
                    }
                }
                state if state.is_latched() && resets && !self.makes_torque() => {
                    self.run_cycle(Ask::Reset);
                    self.forget_errors();
                }
                state => {
                    if state.is_latched() {
                        self.ask_for_errors();
                    }
                    self.run_cycle(Ask::Nothing);
                }
            }
        }
    }

    /// Runs cycles until both drives have reported their faults, for half a second at most.
    pub fn hear_errors(&mut self) {
        self.forget_errors();
        for _ in 0..self.cycles_in(ERRORS_LIMIT_S) {
            self.ask_for_errors();
            if self.errors().count() == 2 {
                return;
            }
            self.run_cycle(Ask::Nothing);
        }
    }

    /// Stops the rig along its ramp, and returns whether both drives reported in time that they make no torque. It does not wait
    /// for drives of a rig in a latched state that have not answered for 0.1 s.
    pub fn stop(&mut self) -> bool {
        // Drives that were told to go on, and have not yet, do so after the last look at them.
        let mut is_coming_up = self.state() == State::Enabling;
        let (mut unheard, most_unheard) = (0, self.cycles_in(UNHEARD_S).max(2));
        for _ in 0..self.cycles_in(self.stop_limit_s()) {
            if !self.makes_torque() && !std::mem::take(&mut is_coming_up) {
                return true;
            }
            unheard = if self.state().is_latched() && !self.is_torque_told() { unheard + 1 } else { 0 };
            if unheard > most_unheard {
                return false;
            }
            self.run_cycle(Ask::Stop);
        }
        !self.makes_torque()
    }

    /// Whether a drive reported torque in the last cycle.
    fn is_torque_told(&self) -> bool {
        let drives = &self.master().last_inputs().drives;
        drives.iter().any(|drive| drive.state.has_torque() && drive.angle_rad.is_some())
    }

    /// Returns the longest time that a stop may take, s. Brakes close twice at most: on the ramp, and after a quick stop.
    pub fn stop_limit_s(&self) -> f64 {
        STOP_LIMIT_S + 2.0 * self.master().cycle().settings().brake_s
    }

    pub(super) fn makes_torque(&self) -> bool {
        self.master().last_inputs().drives.iter().any(|drive| drive.state.has_torque())
    }

    pub(super) fn cycles_in(&self, time_s: f64) -> u32 {
        (time_s / self.period().as_secs_f64()).round() as u32
    }
}
