//! What the drive does with its objects.

use yieldwall_drives::cia402::{OperationMode, OptionCodes, StateMachine};
use yieldwall_drives::objects::{self as cia, error_code};
use yieldwall_drives::profiles::Reaction;

use super::device::Device;
use crate::canopen::{
    AbortCode, Address, Application, HeartbeatChange, HeartbeatEvent, NmtState, ObjectDictionary, Reset, Time,
};

impl Application for Device {
    fn before_write(&mut self, _od: &mut ObjectDictionary, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        let &[code] = data else { return Ok(()) };
        if at.index != cia::MODE_OF_OPERATION.index || code == 0 {
            return Ok(());
        }
        match OperationMode::from_code(code as i8) {
            Some(mode) if mode.is_in(self.supported_modes) => Ok(()),
            _ => Err(AbortCode::VALUE),
        }
    }

    fn after_write(&mut self, od: &mut ObjectDictionary, at: Address) {
        self.is_stale = true;
        self.reload(od);
        if at.index == cia::CONTROLWORD.index {
            self.apply_controlword(od);
        } else {
            self.follow(od);
        }
        self.take_targets(od);
    }

    fn before_read(&mut self, od: &mut ObjectDictionary, _at: Address) -> Result<(), AbortCode> {
        self.refresh(od);
        od.set(self.objects.lacks, self.lacks);
        od.set(self.objects.clock, self.clock.code());
        Ok(())
    }

    fn on_sync(&mut self, now: Time, od: &mut ObjectDictionary) {
        self.wake(now);
        if self.encoder_failed {
            self.follow(od);
        }
        let plan = self.servo.plan();
        if plan.follows_command()
            && let Some(wait) = self.watches.sync.wait(od, self.parameters.period_s)
        {
            self.sync_deadline = now + wait;
        }
        if plan.is_closed_loop() {
            self.tick(od);
        }
        self.refresh(od);
    }

    fn on_rpdo(&mut self, now: Time, od: &mut ObjectDictionary, _number: u8) {
        self.wake(now);
        self.apply_controlword(od);
        self.take_targets(od);
        let wait = self.watches.set_points.wait(od, self.parameters.period_s);
        self.set_point_deadline = wait.map_or(Time::NEVER, |wait| now + wait);
    }

    fn on_nmt(&mut self, now: Time, od: &mut ObjectDictionary, state: NmtState) {
        self.wake(now);
        let was_operational = std::mem::replace(&mut self.is_operational, state == NmtState::Operational);
        if !self.is_operational {
            self.set_point_deadline = Time::NEVER;
        }
        if was_operational && !self.is_operational {
            self.lose_connection(od, error_code::HEARTBEAT);
        }
    }

    fn on_reset(&mut self, now: Time, od: &mut ObjectDictionary, reset: Reset) {
        self.wake(now);
        self.is_operational = false;
        self.set_point_deadline = Time::NEVER;
        self.reload(od);
        match reset {
            Reset::Communication => self.lose_connection(od, error_code::HEARTBEAT),
            Reset::Node => {
                self.machine = StateMachine::new(OptionCodes::default());
                self.reload(od);
                self.machine.initialise();
                self.emergency = None;
                self.follow(od);
            }
        }
    }

    fn on_heartbeat_event(&mut self, now: Time, od: &mut ObjectDictionary, event: HeartbeatEvent) {
        self.wake(now);
        if event.change == HeartbeatChange::Lost {
            self.lose_connection(od, error_code::HEARTBEAT);
        }
    }

    fn on_life_guarding(&mut self, now: Time, od: &mut ObjectDictionary, is_lost: bool) {
        self.wake(now);
        if is_lost {
            self.lose_connection(od, error_code::HEARTBEAT);
        }
    }

    fn on_rpdo_timeout(&mut self, now: Time, od: &mut ObjectDictionary, _number: u8) {
        self.wake(now);
        // The node tells of it by an emergency of its own.
        match self.watches.set_points.reaction() {
            Reaction::Nothing | Reaction::Unknown => {}
            Reaction::AbortConnection => self.lose_connection(od, error_code::RPDO_TIMEOUT),
            Reaction::Fault => {
                self.fault(od, error_code::RPDO_TIMEOUT);
            }
        }
    }
}
