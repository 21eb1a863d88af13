//! Switching on, enabling, stopping, and coming back after a stop.

use super::{DEVICES, EmbeddedRig, RigError};
use crate::bus::Phase;
use crate::canopen::Time;
use crate::guard::{Request, State};
use crate::rig::conduct::{Enable, Enabling, STOP_LIMIT_S, has_torque, settling_cycles};

/// Cycles from a reset to the question to be enabled again: the drives have left their fault state.
const CYCLES_AFTER_RESET: u32 = 50;

impl EmbeddedRig {
    /// Switches everything on, boots the network and enables the drives; the hand takes the handle when the rig runs.
    ///
    /// # Errors
    /// [`RigError::Boot`] if a node is missing or is not what it should be, [`RigError::NotEnabled`] if the rig did not
    /// come to run.
    pub fn enable(&mut self) -> Result<(), RigError> {
        self.boot()?;
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
        self.far.world.let_go();
        let limit = (STOP_LIMIT_S / self.period.as_secs_f64()) as u32;
        for _ in 0..limit {
            if self.state().is_latched() || self.state() == State::Idle {
                return self.reset_and_enable();
            }
            self.run_cycle(Request::None)?;
        }
        Err(RigError::NotStopped { waited_s: STOP_LIMIT_S, state: format!("{:?}", self.state()) })
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
        self.far.world.let_go();
        self.host.is_asleep = false;
        self.start_network()?;
        self.reset_and_enable()
    }

    fn check_alive(&self) -> Result<(), RigError> {
        if !self.host.is_dead {
            return Ok(());
        }
        let state = "the process is dead: only a new one can run the rig".to_owned();
        Err(RigError::NotEnabled { waited_s: 0.0, state, cause: None })
    }

    fn come_to_run(&mut self, enabling: Enabling) -> Result<(), RigError> {
        let settling = settling_cycles(self.period, self.sample_period);
        let mut enabling = enabling.not_before(settling);
        loop {
            match enabling.next(self.state()) {
                Enable::Ask(request) => self.run_cycle(request)?,
                Enable::Done => {
                    self.far.world.take_tool(self.next_sync);
                    return Ok(());
                }
                Enable::GivenUp => break,
            };
        }
        let cause = self.cause();
        let name = cause.map_or(String::new(), |cause| format!(", {}", cause.fault.row().name));
        let state = format!("{:?}{name}", self.state());
        Err(RigError::NotEnabled { waited_s: enabling.waited_s(), state, cause })
    }

    /// Stops the rig along its ramp and runs until no drive makes torque; at once done if none does.
    ///
    /// # Errors
    /// [`RigError::NotStopped`] if a drive still makes torque after 2 s; else as [`EmbeddedRig::run_cycle`].
    pub fn stop(&mut self) -> Result<(), RigError> {
        let limit = (STOP_LIMIT_S / self.period.as_secs_f64()) as u32;
        for _ in 0..limit {
            if !self.far.drives.iter().any(|drive| has_torque(drive.state())) {
                return Ok(());
            }
            self.run_cycle(Request::Stop)?;
        }
        Err(RigError::NotStopped { waited_s: STOP_LIMIT_S, state: format!("{:?}", self.state()) })
    }

    pub(super) fn boot(&mut self) -> Result<(), RigError> {
        for device in 0..DEVICES.len() {
            self.far.switch_on(device, self.now, &mut self.buses);
        }
        self.start_network()
    }

    /// Has the master find and configure the devices, up to the exchange of process data.
    pub(super) fn start_network(&mut self) -> Result<(), RigError> {
        self.next_sync = Time::NEVER;
        self.master.start(self.now, &mut self.buses.outbox(self.now));
        self.troubles.link_events().for_each(|(bus, event)| self.master.on_link(bus, event));
        loop {
            match self.master.phase() {
                Phase::Operational => {
                    let period = self.period.as_nanos() as u64;
                    self.next_sync = Time((self.now.0 / period + 1) * period);
                    return Ok(());
                }
                Phase::Failed(error) => return Err(error.clone().into()),
                // The master gives every other phase a bound.
                _ => {}
            }
            let next = self.next_event();
            self.pump(next)?;
            self.now = next;
        }
    }
}
