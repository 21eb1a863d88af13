//! Switching on, enabling, stopping, and coming back after a stop.

use std::time::Duration;

use super::{DRIVES, EmbeddedRig, MASTER, RigError, SENSOR};
use crate::bus::Phase;
use crate::canopen::Time;
use crate::guard::{Request, State};
use crate::sim::Drive;

/// Longest time from switching on to the exchange of process data, virtual.
const BOOT_LIMIT: Duration = Duration::from_secs(5);
/// Samples of the force sensor before the rig asks to be enabled, or as many cycles if those are longer: the drives have
/// answered, and the sensor's noise is known.
const SAMPLES_BEFORE_ENABLING: u128 = 10;
/// Longest time from asking to running, virtual.
const ENABLE_LIMIT_S: f64 = 1.5;
/// Longest time from a reset to running, virtual.
const RETURN_LIMIT_S: f64 = 5.0;
/// Cycles after which a person who was refused asks again.
const CYCLES_BETWEEN_ASKING: u32 = 50;
/// Longest time that a stop may take, virtual.
const STOP_LIMIT_S: f64 = 2.0;
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
        self.come_to_run(ENABLE_LIMIT_S)
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
        self.world.let_go();
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
        self.come_to_run(RETURN_LIMIT_S)
    }

    /// Boots the network anew, without switching anything off, and enables the rig. The hand lets go of the tool
    /// meanwhile.
    ///
    /// # Errors
    /// As [`EmbeddedRig::enable`]; also if the process that would have to do it is dead.
    pub fn restart(&mut self) -> Result<(), RigError> {
        self.check_alive()?;
        self.world.let_go();
        self.host.is_asleep = false;
        self.start_network()?;
        self.reset_and_enable()
    }

    fn check_alive(&self) -> Result<(), RigError> {
        if !self.host.is_dead {
            return Ok(());
        }
        let state = "the process is dead: only a new one can run the rig".to_owned();
        Err(RigError::NotEnabled { waited_s: 0.0, state })
    }

    fn come_to_run(&mut self, limit_s: f64) -> Result<(), RigError> {
        let cycles_per_sample = self.sample_period.as_nanos().div_ceil(self.period.as_nanos()).max(1);
        for _ in 0..SAMPLES_BEFORE_ENABLING * cycles_per_sample {
            self.run_cycle(Request::None)?;
        }
        let limit = (limit_s / self.period.as_secs_f64()) as u32;
        for cycle in 0..limit {
            if self.state() == State::Running {
                self.world.take_tool(self.next_sync);
                return Ok(());
            }
            // What was seen within the last seconds keeps the rig from being enabled: a person asks again.
            let asks = self.state() == State::Idle && cycle % CYCLES_BETWEEN_ASKING == 0;
            self.run_cycle(if asks { Request::Enable } else { Request::None })?;
        }
        let cause = self.cause().map_or(String::new(), |cause| format!(", {}", cause.fault.row().name));
        Err(RigError::NotEnabled { waited_s: limit_s, state: format!("{:?}{cause}", self.state()) })
    }

    /// Stops the rig along its ramp and runs until no drive makes torque; at once done if none does.
    ///
    /// # Errors
    /// [`RigError::NotStopped`] if a drive still makes torque after 2 s; else as [`EmbeddedRig::run_cycle`].
    pub fn stop(&mut self) -> Result<(), RigError> {
        let limit = (STOP_LIMIT_S / self.period.as_secs_f64()) as u32;
        for _ in 0..limit {
            if !self.drives.iter().any(has_torque) {
                return Ok(());
            }
            self.run_cycle(Request::Stop)?;
        }
        Err(RigError::NotStopped { waited_s: STOP_LIMIT_S, state: format!("{:?}", self.state()) })
    }

    pub(super) fn boot(&mut self) -> Result<(), RigError> {
        for (drive, port) in self.drives.iter_mut().zip(DRIVES) {
            drive.boot(self.now, &mut self.bus.outbox(port, self.now));
        }
        self.sensor.boot(self.now, &mut self.bus.outbox(SENSOR, self.now));
        self.start_network()
    }

    /// Has the master find and configure the devices, up to the exchange of process data.
    pub(super) fn start_network(&mut self) -> Result<(), RigError> {
        self.next_sync = Time::NEVER;
        self.master.start(self.now, &mut self.bus.outbox(MASTER, self.now));
        let limit = self.now + BOOT_LIMIT;
        while self.now < limit {
            match self.master.phase() {
                Phase::Operational => {
                    let period = self.period.as_nanos() as u64;
                    self.next_sync = Time((self.now.0 / period + 1) * period);
                    return Ok(());
                }
                Phase::Failed(error) => return Err(error.clone().into()),
                _ => {}
            }
            let next = self.next_event().min(limit);
            self.pump(next)?;
            self.now = next;
        }
        Err(RigError::NotEnabled { waited_s: BOOT_LIMIT.as_secs_f64(), state: format!("{:?}", self.master.phase()) })
    }
}

fn has_torque(drive: &Drive) -> bool {
    use yieldwall_drives::cia402::State::{FaultReactionActive, OperationEnabled, QuickStopActive};
    matches!(drive.state(), OperationEnabled | QuickStopActive | FaultReactionActive)
}
