//! Behaviour of the drive's objects.

use yieldwall_drives::cia402::{OperationMode, OptionCodes, StateMachine};
use yieldwall_drives::objects::{self as cia, error_code};
use yieldwall_drives::profiles::Reaction;

use super::device::Device;
use yieldwall_fieldbus::canopen::{Application, HeartbeatChange, HeartbeatEvent, NmtState, is_dummy};
use yieldwall_fieldbus::objects::{AbortCode, Address, ObjectDictionary, Reset, ServedDevice, load_le};
use yieldwall_fieldbus::time::Time;

/// The rated torque, in per mille of itself.
const RATED: u16 = 1000;

impl ServedDevice for Device {
    fn od(&self) -> &ObjectDictionary {
        &self.od
    }

    fn od_mut(&mut self) -> &mut ObjectDictionary {
        &mut self.od
    }

    fn before_write(&mut self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        if let (0x1600..0x1800, 1.., &[.., low, high]) = (at.index, at.sub, data)
            && self.lacks_dummies
            && is_dummy(u16::from_le_bytes([low, high]))
        {
            return Err(AbortCode::NOT_MAPPABLE);
        }
        let needed = self.needed_bits.iter().find(|(odd, _)| *odd == at).map_or(0, |(_, bits)| *bits);
        if needed & !(load_le(data) as u32) != 0 {
            return Err(AbortCode::VALUE);
        }
        let &[code] = data else { return Ok(()) };
        if at.index != self.offset.index(cia::MODE_OF_OPERATION.index) {
            return Ok(());
        }
        match OperationMode::from_code(code as i8) {
            _ if self.refuses_modes() => Err(AbortCode::DEVICE_STATE),
            _ if code == 0 => Ok(()),
            Some(mode) if mode.is_in(self.supported_modes) => Ok(()),
            _ => Err(AbortCode::VALUE),
        }
    }

    fn after_write(&mut self, at: Address) {
        self.is_stale = true;
        if self.forgets_torque_limit && at.index == self.offset.index(cia::MAX_TORQUE.index) {
            self.od.set(self.objects.max_torque, RATED);
        }
        self.reload();
        if at.index == self.offset.index(cia::CONTROLWORD.index) {
            self.apply_controlword();
        } else {
            self.follow();
        }
        self.take_targets();
    }

    fn before_read(&mut self, _at: Address) -> Result<(), AbortCode> {
        self.refresh();
        self.od.set(self.objects.lacks, self.lacks);
        self.od.set(self.objects.clock, self.clock.code());
        Ok(())
    }

    fn outputs_applied(&mut self, now: Time, _number: u8) {
        self.wake(now);
        self.apply_controlword();
        self.take_targets();
        let wait = self.watches.set_points.wait(&self.od, self.parameters.period_s);
        self.set_point_deadline = wait.map_or(Time::NEVER, |wait| now + wait);
    }

    fn outputs_late(&mut self, now: Time, _number: u8) {
        self.wake(now);
        // The node tells of it by an emergency of its own.
        match self.watches.set_points.reaction() {
            Reaction::Nothing | Reaction::Unknown => {}
            Reaction::AbortConnection => self.lose_connection(error_code::RPDO_TIMEOUT),
            Reaction::Fault => {
                self.fault(error_code::RPDO_TIMEOUT);
            }
        }
    }

    fn sample(&mut self, now: Time) {
        self.wake(now);
        if self.encoder_failed {
            self.follow();
        }
        let plan = self.servo.plan();
        if plan.needs_master()
            && let Some(wait) = self.watches.sync.wait(&self.od, self.parameters.period_s)
        {
            self.sync_deadline = now + wait;
        }
        if plan.is_closed_loop() {
            self.tick();
        }
        self.refresh();
    }

    fn reset(&mut self, now: Time, reset: Reset) {
        self.wake(now);
        self.is_operational = false;
        self.set_point_deadline = Time::NEVER;
        self.reload();
        match reset {
            Reset::Communication => self.lose_connection(error_code::HEARTBEAT),
            Reset::Node => {
                self.machine = StateMachine::new(OptionCodes::default());
                self.reload();
                self.machine.initialise();
                self.find_errors(now);
                self.follow();
            }
        }
    }
}

impl Application for Device {
    fn on_nmt(&mut self, now: Time, state: NmtState) {
        self.change_operational(now, state == NmtState::Operational, error_code::HEARTBEAT);
    }

    fn on_heartbeat_event(&mut self, now: Time, event: HeartbeatEvent) {
        self.wake(now);
        if event.change == HeartbeatChange::Lost {
            self.lose_connection(error_code::HEARTBEAT);
        }
    }

    fn on_life_guarding(&mut self, now: Time, is_lost: bool) {
        self.wake(now);
        if is_lost {
            self.lose_connection(error_code::HEARTBEAT);
        }
    }
}
