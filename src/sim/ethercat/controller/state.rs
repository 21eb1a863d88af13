//! The state machine of a device: guards, codes, process data, watchdog.

use super::super::application::EthercatApplication;
use super::super::process_data::Flow;
use super::clock::SyncSignals;
use super::{Controller, INPUTS, MAILBOX_IN, OUTPUTS, RAM_END};
use std::time::Duration;
use yieldwall_fieldbus::ethercat::registers as register;
use yieldwall_fieldbus::ethercat::{AlControl, AlState, AlStatus, AlStatusCode, BufferMode, Direction};
use yieldwall_fieldbus::objects::Address;
use yieldwall_fieldbus::time::Time;

/// How long a device waits on the way to OP for what it needs there: outputs, SYNC0.
const OP_PATIENCE: Duration = Duration::from_millis(200);
/// Type of synchronisation in 1C32h:01 with which outputs act when they arrive.
const ON_ARRIVAL: u64 = 1;
/// Tick of the watchdog divider.
const WATCHDOG_TICK_NS: u64 = 40;

/// Where the state machine is.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    pub(super) al: AlState,
    has_error: bool,
    /// Waits for what it needs in OP, up to this moment.
    op_by: Option<Time>,
    /// Inputs and outputs are exchanged at SYNC0.
    pub(super) is_synchronous: bool,
    /// Outputs have come since SAFE-OP.
    has_outputs: bool,
    /// SYNC0 has come since SAFE-OP.
    has_sync: bool,
    /// Outputs have come since the last SYNC0.
    are_outputs_new: bool,
    missed_syncs: u16,
    /// When the watchdog runs out; only in OP.
    pub(super) watchdog: Time,
}

impl State {
    pub(super) const fn new() -> Self {
        State {
            al: AlState::Init,
            has_error: false,
            op_by: None,
            is_synchronous: false,
            has_outputs: false,
            has_sync: false,
            are_outputs_new: false,
            missed_syncs: 0,
            watchdog: Time::NEVER,
        }
    }

    /// When something is due.
    pub(super) fn next_deadline(&self) -> Time {
        self.op_by.unwrap_or(Time::NEVER).min(self.watchdog)
    }

    fn exchanges(&self) -> bool {
        matches!(self.al, AlState::SafeOperational | AlState::Operational)
    }
}

impl<D: EthercatApplication> Controller<D> {
    /// The master has written AL control.
    pub(super) fn request_state(&mut self, now: Time, control: AlControl) {
        if self.state.has_error && !control.acknowledges() {
            // An error that was not acknowledged keeps the device where it is.
            return;
        }
        if control.acknowledges() {
            self.state.has_error = false;
            self.show_status(AlStatusCode::NONE);
            if self.state.exchanges() {
                self.hold(OUTPUTS, false);
            }
        }
        self.state.op_by = None;
        let result = match control.state() {
            None => Err(AlStatusCode::UNKNOWN_STATE),
            Some(AlState::Bootstrap) => Err(if self.state.al.may_become(AlState::Bootstrap) {
                AlStatusCode::NO_BOOTSTRAP
            } else {
                AlStatusCode::INVALID_STATE_CHANGE
            }),
            Some(wanted) if !self.state.al.may_become(wanted) => Err(AlStatusCode::INVALID_STATE_CHANGE),
            Some(wanted) => self.enter(now, wanted),
        };
        match result {
            Ok(()) => self.show_status(AlStatusCode::NONE),
            Err(code) => self.refuse(code),
        }
    }

    fn refuse(&mut self, code: AlStatusCode) {
        self.state.has_error = true;
        self.show_status(code);
    }

    /// Leaves OP or SAFE-OP for SAFE-OP with an error; in another state the error alone is shown. For what the device's own monitoring
    /// finds.
    pub fn fail(&mut self, now: Time, code: AlStatusCode) {
        self.leave_operation(now);
        if self.state.al == AlState::Operational {
            self.state.al = AlState::SafeOperational;
        }
        self.state.op_by = None;
        // Outputs are not taken until the error is acknowledged: the working counter shows it.
        if self.state.exchanges() {
            self.hold(OUTPUTS, true);
        }
        self.refuse(code);
    }

    fn leave_operation(&mut self, now: Time) {
        self.state.watchdog = Time::NEVER;
        if self.state.al == AlState::Operational {
            self.device.set_operational(now, false);
        }
    }

    fn enter(&mut self, now: Time, wanted: AlState) -> Result<(), AlStatusCode> {
        match (self.state.al, wanted) {
            (from, to) if from == to => Ok(()),
            (AlState::Init, AlState::PreOperational) => {
                self.check_memory()?;
                if self.areas[0].len > 0 && !self.has_mailbox() {
                    return Err(AlStatusCode::INVALID_MAILBOX);
                }
                self.start_mailbox();
                self.state.al = wanted;
                Ok(())
            }
            (AlState::PreOperational, AlState::SafeOperational) => {
                self.start_exchange(now)?;
                self.state.al = wanted;
                Ok(())
            }
            (AlState::SafeOperational, AlState::Operational) => {
                if !self.stays_in_safe_op {
                    self.state.op_by = Some(now + OP_PATIENCE);
                    self.poll_state(now);
                }
                Ok(())
            }
            (_, to) => {
                self.leave_operation(now);
                if to != AlState::SafeOperational {
                    self.stop_exchange();
                }
                if to == AlState::Init {
                    self.mailbox.reset();
                }
                self.state.al = to;
                Ok(())
            }
        }
    }

    /// No two sync managers share memory, and each lies in it.
    fn check_memory(&self) -> Result<(), AlStatusCode> {
        let active = || self.managers.iter().filter(|manager| manager.settings.is_enabled && manager.settings.len > 0);
        for (place, manager) in active().enumerate() {
            let taken = manager.taken();
            let is_in = taken.start >= usize::from(register::PROCESS_DATA) && taken.end <= RAM_END;
            let overlaps = active().skip(place + 1).any(|other| {
                let other = other.taken();
                taken.start < other.end && other.start < taken.end
            });
            if !is_in || overlaps {
                return Err(AlStatusCode::INVALID_SYNC_MANAGER);
            }
        }
        Ok(())
    }

    /// Everything that SAFE-OP needs.
    fn start_exchange(&mut self, now: Time) -> Result<(), AlStatusCode> {
        self.check_memory()?;
        if self.areas[0].len > 0 && !self.has_mailbox() {
            return Err(AlStatusCode::INVALID_MAILBOX);
        }
        for (flow, place, direction) in
            [(Flow::Outputs, OUTPUTS, Direction::Write), (Flow::Inputs, INPUTS, Direction::Read)]
        {
            let mapping = if flow == Flow::Outputs { &mut self.outputs } else { &mut self.inputs };
            mapping.load(self.device.od(), flow).map_err(|_| flow.invalid_mapping())?;
            let (len, settings) = (mapping.len(), self.managers[place].settings);
            let is_good = match len {
                0 => !settings.is_enabled || settings.len == 0,
                _ => {
                    settings.is_enabled
                        && usize::from(settings.len) == len
                        && settings.direction() == Some(direction)
                        && settings.mode() == Some(BufferMode::Three)
                }
            };
            if !is_good {
                return Err(flow.invalid_length());
            }
        }
        self.state.is_synchronous = self.check_sync()?;
        (self.state.has_outputs, self.state.has_sync, self.state.are_outputs_new) = (false, false, false);
        self.state.missed_syncs = 0;
        for place in [OUTPUTS, INPUTS] {
            self.managers[place].empty();
            self.hold(place, false);
        }
        self.device.poll(now);
        self.give_inputs();
        Ok(())
    }

    /// Whether the device works with SYNC0, by the registers and by 1C32h:01.
    fn check_sync(&mut self) -> Result<bool, AlStatusCode> {
        let activation = self.byte(register::DC_ACTIVATION);
        let is_active = activation & SyncSignals::UNIT != 0;
        let od = self.device.od();
        let (wanted, shortest) = (od.raw(0x1c32, 1), od.raw(0x1c32, 5));
        if !is_active {
            return if matches!(wanted, 2 | 3) { Err(AlStatusCode::INVALID_DC) } else { Ok(false) };
        }
        if activation & SyncSignals::SYNC0 == 0 || !self.has_dc {
            return Err(AlStatusCode::INVALID_DC);
        }
        if let Some(sync1_ns) = self.device.sync1_ns() {
            if activation & SyncSignals::SYNC1 == 0 {
                return Err(AlStatusCode::INVALID_DC);
            }
            if self.double(register::DC_SYNC1_CYCLE) != sync1_ns {
                return Err(AlStatusCode::INVALID_SYNC1_CYCLE);
            }
        }
        let cycle = self.double(register::DC_SYNC0_CYCLE);
        if cycle == 0 || u64::from(cycle) < shortest {
            return Err(AlStatusCode::INVALID_CYCLE);
        }
        // What the device does now shows in its objects.
        let outputs_type = if wanted == ON_ARRIVAL { 1u16 } else { 2 };
        for (index, shown) in [(0x1c32, outputs_type), (0x1c33, 2)] {
            let _ = self.device.od_mut().set_bytes(Address::new(index, 1), &shown.to_le_bytes());
            let _ = self.device.od_mut().set_bytes(Address::new(index, 2), &cycle.to_le_bytes());
        }
        Ok(true)
    }

    fn stop_exchange(&mut self) {
        self.outputs.clear();
        self.inputs.clear();
        self.state.is_synchronous = false;
        for place in [OUTPUTS, INPUTS] {
            self.hold(place, true);
        }
    }

    /// Does what is due: a waiting OP request, the watchdog.
    pub(super) fn poll_state(&mut self, now: Time) {
        if let Some(by) = self.state.op_by {
            let has_outputs = self.state.has_outputs || self.outputs.len() == 0;
            let has_sync = self.state.has_sync || !self.state.is_synchronous;
            if has_outputs && has_sync {
                self.state.op_by = None;
                self.state.al = AlState::Operational;
                self.content_watchdog(now);
                self.device.set_operational(now, true);
                self.show_status(AlStatusCode::NONE);
            } else if now >= by {
                let missing = if has_sync { AlStatusCode::SYNC_MANAGER_WATCHDOG } else { AlStatusCode::NO_SYNC };
                self.fail(now, missing);
            }
        }
        if now >= self.state.watchdog {
            self.state.watchdog = Time::NEVER;
            self.set_byte(register::WATCHDOG_STATUS, 0);
            let count = self.byte(register::WATCHDOG_COUNTER).saturating_add(1);
            self.set_byte(register::WATCHDOG_COUNTER, count);
            self.fail(now, AlStatusCode::SYNC_MANAGER_WATCHDOG);
        }
    }

    /// Outputs have come: the watchdog runs anew. A time of 0 switches it off, as a sync manager without it does.
    fn content_watchdog(&mut self, now: Time) {
        let tick = (u64::from(self.word(register::WATCHDOG_DIVIDER)) + 2) * WATCHDOG_TICK_NS;
        let time = tick * u64::from(self.word(register::WATCHDOG_SYNC_MANAGER));
        let is_watched = time > 0 && self.outputs.len() > 0 && self.managers[OUTPUTS].settings.has_watchdog();
        self.set_byte(register::WATCHDOG_STATUS, 1);
        self.state.watchdog = if is_watched && self.state.al == AlState::Operational {
            now + Duration::from_nanos(time)
        } else {
            Time::NEVER
        };
    }

    /// The master has written a whole buffer of outputs.
    pub(super) fn outputs_came(&mut self, now: Time) {
        if !self.state.exchanges() {
            return;
        }
        (self.state.has_outputs, self.state.are_outputs_new) = (true, true);
        if self.state.al == AlState::Operational && self.managers[OUTPUTS].settings.has_watchdog() {
            self.content_watchdog(now);
        }
        if !self.state.is_synchronous || self.device.od().raw(0x1c32, 1) == ON_ARRIVAL {
            self.apply_outputs(now);
        }
        if !self.state.is_synchronous {
            self.device.sample(now);
            self.give_inputs();
        }
        self.poll_state(now);
    }

    /// In OP outputs go from the sync manager into the dictionary.
    fn apply_outputs(&mut self, now: Time) {
        if self.state.al != AlState::Operational || self.outputs.len() == 0 {
            return;
        }
        let (range, is_new) = self.managers[OUTPUTS].device_read();
        if is_new {
            let bytes = self.memory.get(range).unwrap_or_default();
            self.outputs.apply(self.device.od_mut(), bytes);
            self.device.outputs_applied(now, 1);
            self.show_manager(OUTPUTS);
        }
    }

    /// Inputs go from the dictionary into the sync manager.
    pub(super) fn give_inputs(&mut self) {
        if self.inputs.len() == 0 {
            return;
        }
        self.device.refresh();
        let range = self.managers[INPUTS].device_write();
        if let Some(to) = self.memory.get_mut(range) {
            self.inputs.gather(self.device.od(), to);
        }
        self.managers[INPUTS].device_done();
        self.show_manager(INPUTS);
    }

    /// SYNC0: outputs act that have not yet, the device measures, inputs are latched.
    pub(super) fn sync0(&mut self, now: Time) {
        if !self.state.exchanges() || !self.state.is_synchronous {
            return;
        }
        self.state.has_sync = true;
        let has_new = std::mem::take(&mut self.state.are_outputs_new);
        self.apply_outputs(now);
        self.device.sample(now);
        self.give_inputs();
        if self.state.al == AlState::Operational && self.outputs.len() > 0 {
            self.watch_sync(now, has_new);
        }
        self.poll_state(now);
    }

    /// Counts SYNC0 without new outputs in 1C32h:0B; 10F1h:02 says how many in a row are an error, 0 none.
    fn watch_sync(&mut self, now: Time, has_new: bool) {
        if has_new {
            self.state.missed_syncs = 0;
            return;
        }
        self.state.missed_syncs = self.state.missed_syncs.saturating_add(1);
        let od = self.device.od_mut();
        let (count, most) = (od.raw(0x1c32, 0x0b) as u16, od.raw(0x10f1, 2));
        let _ = od.set_bytes(Address::new(0x1c32, 0x0b), &count.saturating_add(1).to_le_bytes());
        if most > 0 && u64::from(self.state.missed_syncs) > most {
            self.fail(now, AlStatusCode::SYNC_ERROR);
        }
    }

    /// Whether inputs are brought up to date as frames come: without SYNC0.
    pub(super) fn is_free_running(&self) -> bool {
        self.state.exchanges() && !self.state.is_synchronous
    }

    /// Switches a sync manager off for the bus, or on again.
    fn hold(&mut self, place: usize, is_held: bool) {
        self.managers[place].is_held = is_held;
        self.show_manager(place);
    }

    /// As after power-on: sync managers of process data are off until SAFE-OP.
    pub(super) fn restart_state(&mut self) {
        self.state = State::new();
        self.stop_exchange();
        self.hold(MAILBOX_IN, false);
        self.show_status(AlStatusCode::NONE);
    }

    fn show_status(&mut self, code: AlStatusCode) {
        let status = AlStatus::new(self.state.al, self.state.has_error);
        self.set_word(register::AL_STATUS, status.0 | self.settings.manner.al_status_bits & !0x1f);
        self.set_word(register::AL_STATUS_CODE, code.0);
    }

    /// AL status, as register 0130h shows it.
    pub fn al_status(&self) -> AlStatus {
        AlStatus::new(self.state.al, self.state.has_error)
    }

    pub(super) fn al_state(&self) -> AlState {
        self.state.al
    }
}
