//! The drive on EtherCAT: the same device, behind CoE.

use std::sync::Arc;

use yieldwall_drives::cia402::State;
use yieldwall_drives::objects::{self as cia, error_code};
use yieldwall_drives::profiles::{AxisOffset, DeviceProfile, Fieldbus, Pdo};
use yieldwall_drives::watchdog::Clock;

use super::super::DeviceError;
use super::super::device::{identity, mapping};
use super::super::ethercat::{Communication, EthercatApplication, PdoMapping};
use super::axes::Axes;
use super::device::{Device, PROFILE_ERROR};
use super::watches::Watch;
use super::{AxisSettings, AxisView, DriveQuirks, axes, models};
use yieldwall_fieldbus::ethercat::coe::CoeEmergency;
use yieldwall_fieldbus::objects::{AbortCode, Address, ObjectDictionary, Reset, ServedDevice};
use yieldwall_fieldbus::time::Time;

/// Shortest cycle that the drive works with, in ns.
const SHORTEST_CYCLE_NS: u32 = 62_500;
/// Objects that a mapping may hold.
const MAPPING_ENTRIES: u8 = 16;
/// Bit of the error register for communication.
const COMMUNICATION_ERROR: u8 = 1 << 4;
/// Objects of a mapping that can be changed, at power-on.
const OUTPUTS: [cia::Object; 5] =
    [cia::CONTROLWORD, cia::TARGET_POSITION, cia::TARGET_VELOCITY, cia::TARGET_TORQUE, cia::MODE_OF_OPERATION];
const INPUTS: [cia::Object; 6] = [
    cia::STATUSWORD,
    cia::POSITION_ACTUAL,
    cia::VELOCITY_ACTUAL,
    cia::TORQUE_ACTUAL,
    cia::ERROR_CODE,
    cia::MODE_DISPLAY,
];
/// The emergency that says that all errors have gone.
const NO_ERROR: CoeEmergency = CoeEmergency { code: 0, register: 0, vendor: [0; 5] };

/// A simulated servo drive on EtherCAT, to be put behind a [`Controller`](crate::ethercat::Controller).
///
/// State machine, control loops, limits and monitoring are those of [`Drive`](super::Drive). The physical side is
/// [`EthercatDrive::measure`] in and [`EthercatDrive::torque_n_m`] out. Outputs act at SYNC0 if the master switched SYNC0 on,
/// otherwise when they arrive. The watchdog of its sync manager monitors the master. If the device leaves OP while Operation
/// Enabled, the drive reacts as 6007h says and sends an emergency (8250h).
#[derive(Clone, Debug)]
pub struct EthercatDrive {
    axes: Axes,
    /// Whether the device has left OP while Operation Enabled, and has not been there again.
    has_lost_master: bool,
    /// Part of that, or of its end, that is not yet reported.
    untold: Option<CoeEmergency>,
    /// Time from SYNC0 to SYNC1, of a model that works with both alone.
    sync1_ns: Option<u32>,
}

/// Returns the mappings of a direction at power-on: all mappings in the profile of an axis. Among fixed mappings, the device
/// exchanges those of the first mode that has any. Mappings that can change are empty. Without fixed mappings the first mapping
/// of the axis holds `usual` and is exchanged.
fn mappings<'a>(
    profile: &DeviceProfile,
    modes: impl Iterator<Item = &'a Vec<Pdo>>,
    first: u16,
    (first_of_axis, offset, usual): (u16, AxisOffset, &[cia::Object]),
) -> Vec<PdoMapping> {
    let mut all: Vec<PdoMapping> = Vec::new();
    let mut has_fixed = false;
    for pdos in modes {
        let is_shown = !has_fixed;
        for pdo in pdos {
            let (index, is_fixed) = (first + pdo.number().saturating_sub(1), pdo.fixed);
            has_fixed |= is_fixed;
            if !all.iter().any(|known| known.index == index) {
                let entries = if is_fixed { mapping(profile, pdo) } else { Vec::new() };
                all.push(PdoMapping { index, entries, is_fixed, is_assigned: is_fixed && is_shown });
            }
        }
    }
    if !has_fixed {
        let index = first + first_of_axis;
        all.retain(|mapping| mapping.index != index);
        let entries = usual.iter().map(|object| (offset.index(object.index), object.sub, object.bits())).collect();
        all.insert(0, PdoMapping { index, entries, is_fixed: false, is_assigned: true });
    }
    all
}

impl EthercatDrive {
    /// A drive of this model, with this serial number, all axes on joints of this kind.
    ///
    /// # Errors
    /// If the profile is not that of a servo drive, or the gains of the loop are not finite or negative.
    pub fn new(profile: &Arc<DeviceProfile>, serial: u32, axis: &AxisSettings) -> Result<Self, DeviceError> {
        Self::odd(profile, serial, |_| axis, &DriveQuirks::default())
    }

    /// As [`EthercatDrive::new`], each axis on its own joint, of a manner of its own. Times, segments and lengths of SDO answers are those of CAN alone.
    ///
    /// # Errors
    /// As [`EthercatDrive::new`], and if the drive does not have one of these objects.
    pub fn odd<'a>(
        profile: &Arc<DeviceProfile>,
        serial: u32,
        axis: impl Fn(u8) -> &'a AxisSettings,
        manner: &DriveQuirks,
    ) -> Result<Self, DeviceError> {
        let models = models(profile, Fieldbus::Ethercat)?;
        let mut outputs = Vec::new();
        let mut inputs = Vec::new();
        for (number, (model, servo)) in models.iter().map(|model| (&**model, model.servo())).enumerate() {
            let maps = || servo.into_iter().flat_map(|servo| servo.process_data.modes()).filter_map(|mode| mode.3);
            let step =
                servo.and_then(|servo| servo.axes.as_ref()).map_or(0, |axes| axes.pdo_step_on(Fieldbus::Ethercat));
            let (offset, first) = (model.offset(), step * number as u16);
            outputs.extend(mappings(model, maps().map(|map| &map.rpdo), 0x1600, (first, offset, &OUTPUTS)));
            inputs.extend(mappings(model, maps().map(|map| &map.tpdo), 0x1a00, (first, offset, &INPUTS)));
        }
        let communication = Communication {
            identity: &identity(profile, serial),
            outputs,
            inputs,
            mapping_entries: MAPPING_ENTRIES,
            shortest_cycle_ns: SHORTEST_CYCLE_NS,
        };
        let mut axes = axes(&models, axis, communication.objects(), (&manner.objects, manner))?;
        // SYNC and RPDOs are not there; the controller watches in their place.
        axes.each(|axis| (axis.watches.sync, axis.watches.set_points) = (Watch::None, Watch::None));
        let sync1_ns = profile.servo().and_then(|servo| servo.sync1_us).map(|us| us * 1000);
        Ok(EthercatDrive { axes, has_lost_master: false, untold: None, sync1_ns })
    }

    /// Does `act` with another axis in place of the first one.
    pub fn on_axis<R>(&mut self, axis: usize, act: impl FnOnce(&mut Self) -> R) -> R {
        self.axes.exchange(axis);
        let done = act(self);
        self.axes.exchange(axis);
        done
    }

    /// State, torque in N m and closed brake of an axis; as of a drive that is switched off if there is none.
    pub fn axis(&self, axis: usize) -> AxisView {
        self.axes.view(axis).unwrap_or_default()
    }

    /// The joint's motion at this moment, in rad and rad/s; see [`Drive::measure`](super::Drive::measure).
    pub fn measure(&mut self, angle_rad: f64, rate_rad_per_s: f64) {
        self.axes.front_mut().measure(angle_rad, rate_rad_per_s);
    }

    /// Torque on the joint in N m.
    pub fn torque_n_m(&self) -> f64 {
        self.axes.front().torque_n_m()
    }

    /// Whether a brake that the master holds by an output is closed.
    pub fn is_braked(&self) -> bool {
        self.axes.view(0).is_some_and(|front| front.is_braked)
    }

    /// State of the state machine.
    pub fn state(&self) -> State {
        self.axes.front().state()
    }

    /// Puts the drive into fault with an error code (603Fh), as its own monitoring would.
    pub fn raise_fault(&mut self, now: Time, code: u16) {
        self.axes.front_mut().raise_fault(now, code);
    }

    /// Sets the time base that the drive reports in 2011h.
    pub fn set_clock(&mut self, clock: Clock) {
        self.axes.each(|axis| axis.clock = clock);
    }

    /// Sets or clears the warning bit of the statusword.
    pub fn set_warning(&mut self, is_warning: bool) {
        self.axes.front_mut().set_warning(is_warning);
    }

    /// Gives the power stage its voltage or takes it away, as an emergency stop does.
    pub fn set_voltage(&mut self, now: Time, is_present: bool) {
        self.axes.front_mut().set_voltage(now, is_present);
    }

    /// Leaves Operation Enabled without being asked to.
    pub fn leave_operation(&mut self, now: Time) {
        self.axes.front_mut().leave_operation(now);
    }

    /// Makes the drive keep its last target and report so (statusword bit 12), or follow again.
    pub fn set_ignores_targets(&mut self, ignores: bool) {
        self.axes.front_mut().set_ignores_targets(ignores);
    }

    /// Makes the drive accept a torque limit (6072h) and forget it at once, or keep it.
    pub fn set_forgets_torque_limit(&mut self, forgets: bool) {
        self.axes.front_mut().forgets_torque_limit = forgets;
    }

    /// As [`Drive::set_incremental`](super::Drive::set_incremental).
    pub fn set_incremental(&mut self, mark_rad: f64) {
        self.axes.front_mut().set_incremental(mark_rad);
    }

    /// As [`Drive::set_loose_mark`](super::Drive::set_loose_mark).
    pub fn set_loose_mark(&mut self, deviation_rad: f64, seed: u64) {
        self.axes.front_mut().set_loose_mark(deviation_rad, seed);
    }

    /// As [`Drive::set_stored_torque_limit`](super::Drive::set_stored_torque_limit).
    pub fn set_stored_torque_limit(&mut self, per_mille: u16) {
        self.axes.front_mut().set_stored_torque_limit(per_mille);
    }

    /// As [`Drive::refer`](super::Drive::refer).
    pub fn refer(&mut self) {
        self.axes.front_mut().refer();
    }

    /// Makes the state machine ignore the controlword, or follow it again.
    pub fn set_ignores_controlword(&mut self, ignores: bool) {
        self.axes.front_mut().set_ignores_controlword(ignores);
    }

    fn set_error_register(&mut self, bits: u8) {
        // The object is declared with one byte.
        let _ = self.axes.od_mut().set_bytes(Address::new(0x1001, 0), &[bits]);
    }

    /// All errors have gone.
    fn recover(&mut self) {
        self.set_error_register(0);
        self.has_lost_master = false;
        self.untold = Some(NO_ERROR);
    }
}

impl ServedDevice for EthercatDrive {
    fn od(&self) -> &ObjectDictionary {
        self.axes.od()
    }

    fn od_mut(&mut self) -> &mut ObjectDictionary {
        self.axes.od_mut()
    }

    fn before_write(&mut self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        self.axes.before_write(at, data)
    }

    fn after_write(&mut self, at: Address) {
        self.axes.after_write(at);
    }

    fn before_read(&mut self, at: Address) -> Result<(), AbortCode> {
        self.axes.before_read(at)
    }

    fn outputs_applied(&mut self, now: Time, number: u8) {
        // The mode of operation is among the outputs; followed before the controlword, it is in force when that enables.
        self.axes.each(|axis| {
            axis.wake(now);
            axis.follow();
            axis.outputs_applied(now, number);
        });
    }

    fn sample(&mut self, now: Time) {
        self.axes.sample(now);
    }

    fn reset(&mut self, now: Time, reset: Reset) {
        self.set_error_register(0);
        (self.has_lost_master, self.untold) = (false, None);
        // Of a device on EtherCAT that is power-on.
        self.axes.each(Device::power_on);
        self.axes.reset(now, reset);
    }
}

impl EthercatApplication for EthercatDrive {
    fn set_operational(&mut self, now: Time, is_operational: bool) {
        let was_enabled = self.axes.any_is(State::OperationEnabled);
        self.axes.each(|axis| axis.change_operational(now, is_operational, error_code::RPDO_TIMEOUT));
        if !is_operational && was_enabled {
            let register = COMMUNICATION_ERROR | 1;
            self.set_error_register(register);
            self.has_lost_master = true;
            self.untold = Some(CoeEmergency { code: error_code::RPDO_TIMEOUT, register, vendor: [0; 5] });
        } else if is_operational
            && self.has_lost_master
            && !self.axes.any_is(State::Fault)
            && !self.axes.any_is(State::FaultReactionActive)
        {
            self.recover();
        }
    }

    fn poll(&mut self, now: Time) {
        self.axes.each(|axis| axis.poll(now));
    }

    fn next_deadline(&self) -> Time {
        self.axes.next_deadline()
    }

    fn refresh(&mut self) {
        self.axes.each(Device::refresh_if_stale);
    }

    fn sync1_ns(&self) -> Option<u32> {
        self.sync1_ns
    }

    fn take_emergency(&mut self) -> Option<CoeEmergency> {
        if self.axes.take_reset() {
            self.recover();
        }
        if let Some(code) = self.axes.take_emergency() {
            self.set_error_register(PROFILE_ERROR | 1);
            return Some(CoeEmergency { code, register: PROFILE_ERROR | 1, vendor: [0; 5] });
        }
        self.untold.take()
    }
}
