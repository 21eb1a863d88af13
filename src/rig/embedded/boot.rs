//! Switching on, enabling, stopping, and coming back after a stop.

use std::sync::atomic::AtomicBool;

use super::buses::DEVICES;
use super::{EmbeddedRig, RigError};
use crate::line::Line;
use yieldwall_config as config;
use yieldwall_drives::cia402;
use yieldwall_motion::guard::{Request, State};
use yieldwall_motion::quantity::{JointAngles, TipPoint};
use yieldwall_motion::sensing::Wrench;
use yieldwall_record::CycleRecord;
use yieldwall_run::bringup;
use yieldwall_run::{
    Bounds, Enabling, HomePlan, Homed, Jog, Jogged, LoopPlan, LoopTraced, NotProven, Permit, Place, Pulled, Repeated,
    RunError, Runner, Wrenches, settling_cycles,
};
use yieldwall_sim::Drive;

/// Cycles from a reset to the question to be enabled again: the drives have left their fault state.
const CYCLES_AFTER_RESET: u32 = 50;

impl EmbeddedRig {
    /// Switches everything on, boots the network and enables the drives; the hand takes the handle when the rig runs. Drives that
    /// need homing start homed.
    ///
    /// # Errors
    /// [`RigError::Boot`] if a node is missing or is not what it should be, [`RigError::NotEnabled`] if the rig did not
    /// come to run.
    pub fn enable(&mut self) -> Result<(), RigError> {
        self.switch_on();
        self.refer();
        self.start_network()?;
        self.come_to_run(self.enabling)
    }

    /// Resets a rig that was stopped and enables it again; at once done if it runs. The hand lets go of the tool
    /// meanwhile.
    ///
    /// # Errors
    /// [`RigError::NotStopped`] if it does not come to rest, [`RigError::NotEnabled`] if it does not come to run, as
    /// after an injection that killed the process.
    pub fn enable_again(&mut self) -> Result<(), RigError> {
        self.check_alive()?;
        if matches!(self.state(), State::Running | State::Holding) {
            return Ok(());
        }
        self.place_mut().far.world.let_go();
        let waited_s = self.runner.stop_limit_s();
        for _ in 0..(waited_s / self.runner.period().as_secs_f64()) as u32 {
            if self.state().is_latched() || self.state() == State::Idle {
                return self.reset_and_enable();
            }
            self.run_cycle(Request::None)?;
        }
        Err(RigError::NotStopped { waited_s, state: format!("{:?}", self.state()) })
    }

    fn reset_and_enable(&mut self) -> Result<(), RigError> {
        self.run_cycle(Request::Reset)?;
        for _ in 0..CYCLES_AFTER_RESET {
            self.run_cycle(Request::None)?;
        }
        self.come_to_run(self.enabling.after_reset())
    }

    /// Boots the network anew, without switching anything off, and enables the rig. The hand lets go of the tool
    /// meanwhile.
    ///
    /// # Errors
    /// As [`EmbeddedRig::enable`]; also if the process that would have to do it is dead.
    pub fn restart(&mut self) -> Result<(), RigError> {
        self.check_alive()?;
        self.place_mut().far.world.let_go();
        self.start_network()?;
        self.reset_and_enable()
    }

    fn check_alive(&self) -> Result<(), RigError> {
        if !self.place().computer.is_dead() {
            return Ok(());
        }
        let state = "the process is dead: only a new one can run the rig".to_owned();
        Err(RigError::NotEnabled { waited_s: 0.0, state, cause: None })
    }

    pub(super) fn come_to_run(&mut self, enabling: Enabling) -> Result<(), RigError> {
        let enabling = enabling.not_before(settling_cycles(self.runner.period(), self.sample_period));
        let enabled = self.runner.come_to_run(enabling, &self.permit, &AtomicBool::new(false));
        self.go_on()?;
        match enabled {
            Ok(()) => {
                self.take_tool();
                Ok(())
            }
            Err(RunError::NotEnabled { waited_s, cause }) => {
                if self.runner.has_error_watch() {
                    self.runner.hear_errors();
                }
                let name = cause.map_or(String::new(), |cause| format!(", {}", cause.fault.row().name));
                Err(RigError::NotEnabled { waited_s, state: format!("{:?}{name}", self.state()), cause })
            }
            Err(error) => Err(not_run(error)),
        }
    }

    /// Switches everything on, boots the network, lowers the torque limits of the drives, enables them, guides the joints and
    /// stops, as [`bringup::jog`](fn@bringup::jog). No hand takes the tool. `each` receives the record of every cycle in which the
    /// joints are guided.
    ///
    /// # Errors
    /// [`RigError::Boot`] if a node is missing or is not the expected one, and an error if the simulated arm cannot go on. The
    /// result itself names the reason if the joints could not be guided.
    pub fn jog(
        &mut self,
        rig: &config::Rig,
        jog: &Jog<'_>,
        bounds: Bounds,
        is_interrupted: &AtomicBool,
        mut each: impl FnMut(&CycleRecord),
    ) -> Result<Result<Jogged, RunError>, RigError> {
        self.boot()?;
        match self.runner.bring_up_in_virtual_time(rig, bounds) {
            Ok(permit) => self.permit = permit,
            Err(error) => return Ok(Err(error)),
        }
        // Injections count their time from here.
        self.take_tool();
        self.place_mut().far.world.let_go();
        let settling = jog.settling.max(settling_cycles(self.runner.period(), self.sample_period));
        let jogged = bringup::jog(
            &mut self.runner,
            rig,
            &Jog { settling, ..*jog },
            &self.permit,
            is_interrupted,
            |record, _| each(record),
        );
        self.go_on()?;
        Ok(jogged)
    }

    /// Switches everything on, boots the network for homing, lowers the torque limits of the drives, enables them and lets each
    /// find its reference, as [`bringup::home`](fn@bringup::home). No hand takes the tool.
    ///
    /// # Errors
    /// As [`EmbeddedRig::jog`].
    pub fn home(
        &mut self,
        rig: &config::Rig,
        plan: &HomePlan,
        torque_n_m: config::Positive,
        is_interrupted: &AtomicBool,
    ) -> Result<Result<Homed, RunError>, RigError> {
        if let Err(error) = self.runner.prepare_homing(rig) {
            return Ok(Err(error));
        }
        self.boot()?;
        let motion_rad = config::Positive::new(plan.bound_rad()).unwrap_or(torque_n_m);
        match self.runner.bring_up_in_virtual_time(rig, Bounds { motion_rad, torque_n_m }) {
            Ok(permit) => self.permit = permit,
            Err(error) => return Ok(Err(error)),
        }
        // Injections count their time from here.
        self.take_tool();
        self.place_mut().far.world.let_go();
        let homed = bringup::home(&mut self.runner, rig, plan, &self.permit, is_interrupted);
        self.go_on()?;
        Ok(homed)
    }

    /// Switches everything on and homes the joints again and again, as
    /// [`bringup::home_repeatedly`](fn@bringup::home_repeatedly). No hand takes the tool.
    ///
    /// # Errors
    /// As [`EmbeddedRig::jog`].
    pub fn home_repeatedly(
        &mut self,
        rig: &config::Rig,
        (plan, times): (&HomePlan, u32),
        bounds: Bounds,
        is_interrupted: &AtomicBool,
        told: impl FnMut(&Homed),
    ) -> Result<Result<Repeated, NotProven>, RigError> {
        self.boot()?;
        // Injections count their time from here.
        self.take_tool();
        self.place_mut().far.world.let_go();
        // Each homing has a boot of its own, of another master.
        let runner = &mut self.runner;
        runner.leave();
        let repeated = bringup::home_repeatedly(runner, rig, plan, times, bounds, &mut bring_up, is_interrupted, told);
        self.go_on()?;
        Ok(repeated)
    }

    /// Switches everything on, boots the network and listens to the force sensor, as
    /// [`Runner::sense_in_rows`](yieldwall_run::Runner::sense_in_rows). No hand takes the tool.
    ///
    /// # Errors
    /// [`RigError::Boot`] if a node is missing or is not what it should be; that a person asked for the end is inside.
    pub fn sense(
        &mut self,
        rig: &config::Rig,
        times_s: [f64; 2],
        is_interrupted: &AtomicBool,
        told: impl FnMut(f64, Wrenches),
    ) -> Result<Result<Wrenches, RunError>, RigError> {
        self.boot()?;
        let sensed = self.runner.sense_in_rows(rig, times_s, is_interrupted, told);
        self.go_on()?;
        Ok(sensed)
    }

    /// Switches everything on, boots the network and tares the force sensor, as [`Runner::tare`](yieldwall_run::Runner::tare). No hand
    /// takes the tool.
    ///
    /// # Errors
    /// [`RigError::Boot`] if a node is missing or is not what it should be; why there is no zero is inside.
    pub fn tare(
        &mut self,
        rig: &config::Rig,
        most_n: config::Positive,
        is_interrupted: &AtomicBool,
    ) -> Result<Result<Wrench, RunError>, RigError> {
        self.boot()?;
        let tared = self.runner.tare(rig, most_n, is_interrupted);
        self.go_on()?;
        Ok(tared)
    }

    /// Switches everything on and measures forces that a person applies to the tool, as [`bringup::pulls`](fn@bringup::pulls). No
    /// hand takes the tool.
    ///
    /// # Errors
    /// As [`EmbeddedRig::sense`].
    pub fn pulls(
        &mut self,
        rig: &config::Rig,
        force_n: f64,
        is_interrupted: &AtomicBool,
    ) -> Result<Result<Vec<Pulled>, RunError>, RigError> {
        self.settle_in()?;
        let pulls = bringup::pulls(
            &mut self.runner,
            rig,
            force_n,
            &mut |place: &mut dyn Place, task| place.attend(task),
            is_interrupted,
        );
        self.go_on()?;
        Ok(pulls)
    }

    /// Switches everything on and lets a person guide the tool to points, as [`bringup::visit`](fn@bringup::visit). Returns the
    /// angles of the joints at each point. No hand of the scene takes the tool.
    ///
    /// # Errors
    /// As [`EmbeddedRig::sense`], and for a point that the simulated arm does not reach.
    pub fn visit(
        &mut self,
        points: &[TipPoint],
        is_interrupted: &AtomicBool,
    ) -> Result<Result<Vec<JointAngles>, RunError>, RigError> {
        self.settle_in()?;
        let angles = bringup::visit(
            &mut self.runner,
            points,
            &mut |place: &mut dyn Place, task| place.attend(task),
            is_interrupted,
        );
        self.go_on()?;
        Ok(angles)
    }

    /// Switches on a machine whose drives have been homed, with nobody at the handle.
    fn settle_in(&mut self) -> Result<(), RigError> {
        self.switch_on();
        self.refer();
        self.start_network()?;
        self.take_tool();
        self.place_mut().far.world.let_go();
        Ok(())
    }

    /// Marks the drives as homed, if they need homing.
    fn refer(&mut self) {
        self.drives_mut().for_each(Drive::refer);
        self.place_mut().far.line.iter_mut().for_each(Line::refer);
    }

    /// Switches everything on, guides a joint along its course and identifies its loop, as
    /// [`bringup::tune_loop`](fn@bringup::tune_loop). No hand takes the tool.
    ///
    /// # Errors
    /// As [`EmbeddedRig::jog`].
    pub fn tune_loop(
        &mut self,
        rig: &config::Rig,
        plan: &LoopPlan,
        is_interrupted: &AtomicBool,
    ) -> Result<Result<LoopTraced, NotProven>, RigError> {
        self.boot()?;
        // Injections count their time from here.
        self.take_tool();
        self.place_mut().far.world.let_go();
        let traced = bringup::tune_loop(&mut self.runner, rig, plan, &mut bring_up, is_interrupted);
        self.go_on()?;
        Ok(traced)
    }

    /// Stops the rig along its ramp and runs until no drive makes torque; at once done if none does.
    ///
    /// # Errors
    /// [`RigError::NotStopped`] if a drive still makes torque after [`Runner::stop_limit_s`]; else as [`EmbeddedRig::run_cycle`].
    pub fn stop(&mut self) -> Result<(), RigError> {
        let waited_s = self.runner.stop_limit_s();
        for _ in 0..(waited_s / self.runner.period().as_secs_f64()) as u32 {
            if !self.drive_states().into_iter().any(cia402::State::has_torque) {
                return Ok(());
            }
            self.run_cycle(Request::Stop)?;
        }
        let [left, right] = self.drive_states();
        Err(RigError::NotStopped { waited_s, state: format!("left drive {left:?}, right drive {right:?}") })
    }

    pub(super) fn boot(&mut self) -> Result<(), RigError> {
        self.switch_on();
        self.start_network()
    }

    fn switch_on(&mut self) {
        let place = self.place_mut();
        for device in 0..DEVICES.len() {
            place.far.switch_on(device, place.now, &mut place.wires);
        }
    }

    /// Lets the master find and configure the devices, up to the exchange of process data, and proves anew.
    pub(super) fn start_network(&mut self) -> Result<(), RigError> {
        self.place_mut().begin_boot();
        let booted = self.runner.boot();
        if let Some(error) = self.place_mut().failure.take() {
            return Err(error);
        }
        booted.map_err(not_run)?;
        self.permit = Permit::in_virtual_time(&self.runner);
        Ok(())
    }

    /// Makes the hand take the handle when the drives sample next, and begins the scene if it has not begun.
    pub(super) fn take_tool(&mut self) {
        let next_sample = self.place().next_sample(self.next_sync());
        let world = &mut self.place_mut().far.world;
        let is_first = world.hand_from_s == f64::INFINITY;
        world.take_tool(next_sample);
        if is_first {
            self.runner.begin_scene();
        }
    }
}

/// Returns the permit for a small motion with little torque: in virtual time nothing has to be proved.
pub(super) fn bring_up(runner: &mut Runner<dyn Place>, rig: &config::Rig, bounds: Bounds) -> Result<Permit, NotProven> {
    Ok(runner.bring_up_in_virtual_time(rig, bounds)?)
}

fn not_run(error: RunError) -> RigError {
    match error {
        RunError::Assembly(error) => error.into(),
        RunError::Boot(error) => error.into(),
        other => RigError::NotEnabled { waited_s: 0.0, state: other.to_string(), cause: None },
    }
}
