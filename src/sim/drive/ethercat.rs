//! The drive on EtherCAT: the same device, behind CoE.

use std::sync::Arc;

use yieldwall_drives::cia402::State;
use yieldwall_drives::objects::{self as cia, error_code};
use yieldwall_drives::profiles::{DeviceProfile, Pdo};
use yieldwall_drives::watchdog::Clock;

use super::super::DeviceError;
use super::super::device::{identity, mapping};
use super::super::ethercat::{Communication, EthercatApplication, PdoMapping};
use super::device::{Device, PROFILE_ERROR};
use super::watches::Watch;
use super::{AxisSettings, DriveQuirks, objects};
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
/// [`EthercatDrive::measure`] in and [`EthercatDrive::torque_n_m`] out. What the drive is given acts at SYNC0 where the master switched
/// that on, otherwise when it comes. It is watched by the watchdog of its sync manager: when the device leaves OP while Operation Enabled, it
/// does what 6007h says, and tells it by an emergency (8250h).
#[derive(Clone, Debug)]
pub struct EthercatDrive {
    device: Device,
    /// Whether the device has left OP while Operation Enabled, and has not been there again.
    has_lost_master: bool,
    /// What of that and of its end is not told yet.
    untold: Option<CoeEmergency>,
    /// Time from SYNC0 to SYNC1, of a model that works with both alone.
    sync1_ns: Option<u32>,
}

/// Mappings of a direction at power-on: those that the profile calls fixed, of which the ones of its first mode are exchanged; without any of
/// them, one that can be changed and holds `usual`.
fn mappings<'a>(
    profile: &DeviceProfile,
    modes: impl Iterator<Item = &'a Vec<Pdo>>,
    first: u16,
    usual: &[cia::Object],
) -> Vec<PdoMapping> {
    let mut all: Vec<PdoMapping> = Vec::new();
    for (mode, pdos) in modes.enumerate() {
        for pdo in pdos.iter().filter(|pdo| pdo.fixed) {
            let index = first + pdo.number().saturating_sub(1);
            if !all.iter().any(|known| known.index == index) {
                let entries = mapping(profile, pdo);
                all.push(PdoMapping { index, entries, is_fixed: true, is_assigned: mode == 0 });
            }
        }
    }
    if all.is_empty() {
        let entries = usual.iter().map(|object| (object.index, object.sub, object.bits())).collect();
        all.push(PdoMapping { index: first, entries, is_fixed: false, is_assigned: true });
    }
    all
}

impl EthercatDrive {
    /// A drive of this model, with this serial number.
    ///
    /// # Errors
    /// If the profile is not that of a servo drive, or the gains of the loop are not finite or negative.
    pub fn new(profile: &Arc<DeviceProfile>, serial: u32, axis: &AxisSettings) -> Result<Self, DeviceError> {
        Self::odd(profile, serial, axis, &DriveQuirks::default())
    }

    /// As [`EthercatDrive::new`], of a manner of its own. Times, segments and lengths of SDO answers are those of CAN alone.
    ///
    /// # Errors
    /// As [`EthercatDrive::new`], and if the drive does not have one of these objects.
    pub fn odd(
        profile: &Arc<DeviceProfile>,
        serial: u32,
        axis: &AxisSettings,
        manner: &DriveQuirks,
    ) -> Result<Self, DeviceError> {
        let role = || DeviceError::Role { profile: profile.name().to_owned(), wanted: "servo drive" };
        let servo = profile.servo().ok_or_else(role)?;
        axis.position_loop.check()?;
        objects::check(servo)?;
        let maps = || servo.process_data.modes().into_iter().filter_map(|mode| mode.3);
        let communication = Communication {
            identity: &identity(profile, serial),
            outputs: mappings(profile, maps().map(|map| &map.rpdo), 0x1600, &OUTPUTS),
            inputs: mappings(profile, maps().map(|map| &map.tpdo), 0x1a00, &INPUTS),
            mapping_entries: MAPPING_ENTRIES,
            shortest_cycle_ns: SHORTEST_CYCLE_NS,
        };
        let od = objects::build(&axis.scaling, servo, communication.objects(), &manner.objects)?;
        let mut device = Device::new(od, axis, servo)?;
        device.set_manner(manner);
        // SYNC and RPDOs are not there; the controller watches in their place.
        (device.watches.sync, device.watches.set_points) = (Watch::None, Watch::None);
        let sync1_ns = servo.sync1_us.map(|us| us * 1000);
        Ok(EthercatDrive { device, has_lost_master: false, untold: None, sync1_ns })
    }

    /// The joint's motion at this moment, in rad and rad/s; see [`Drive::measure`](super::Drive::measure).
    pub fn measure(&mut self, angle_rad: f64, rate_rad_per_s: f64) {
        self.device.measure(angle_rad, rate_rad_per_s);
    }

    /// Torque on the joint in N m.
    pub fn torque_n_m(&self) -> f64 {
        self.device.torque_n_m()
    }

    /// Whether a brake that the master holds by an output is closed.
    pub fn is_braked(&self) -> bool {
        self.device.is_braked()
    }

    /// State of the state machine.
    pub fn state(&self) -> State {
        self.device.state()
    }

    /// Puts the drive into fault with an error code (603Fh), as its own monitoring would.
    pub fn raise_fault(&mut self, now: Time, code: u16) {
        self.device.raise_fault(now, code);
    }

    /// Has the drive say in 2011h what its time follows.
    pub fn set_clock(&mut self, clock: Clock) {
        self.device.clock = clock;
    }

    /// Sets or clears the warning bit of the statusword.
    pub fn set_warning(&mut self, is_warning: bool) {
        self.device.set_warning(is_warning);
    }

    /// Gives the power stage its voltage or takes it away, as an emergency stop does.
    pub fn set_voltage(&mut self, now: Time, is_present: bool) {
        self.device.set_voltage(now, is_present);
    }

    /// Leaves Operation Enabled without being asked to.
    pub fn leave_operation(&mut self, now: Time) {
        self.device.leave_operation(now);
    }

    /// Has the drive keep its last target and say so (statusword bit 12), or follow again.
    pub fn set_ignores_targets(&mut self, ignores: bool) {
        self.device.set_ignores_targets(ignores);
    }

    /// Has the drive take a torque limit (6072h) and forget it at once, or keep it.
    pub fn set_forgets_torque_limit(&mut self, forgets: bool) {
        self.device.forgets_torque_limit = forgets;
    }

    /// As [`Drive::set_incremental`](super::Drive::set_incremental).
    pub fn set_incremental(&mut self, mark_rad: f64) {
        self.device.set_incremental(mark_rad);
    }

    /// As [`Drive::set_loose_mark`](super::Drive::set_loose_mark).
    pub fn set_loose_mark(&mut self, deviation_rad: f64, seed: u64) {
        self.device.set_loose_mark(deviation_rad, seed);
    }

    /// As [`Drive::set_stored_torque_limit`](super::Drive::set_stored_torque_limit).
    pub fn set_stored_torque_limit(&mut self, per_mille: u16) {
        self.device.set_stored_torque_limit(per_mille);
    }

    /// As [`Drive::refer`](super::Drive::refer).
    pub fn refer(&mut self) {
        self.device.refer();
    }

    /// Has the state machine ignore the controlword, or follow it again.
    pub fn set_ignores_controlword(&mut self, ignores: bool) {
        self.device.set_ignores_controlword(ignores);
    }

    fn set_error_register(&mut self, bits: u8) {
        // The object is declared with one byte.
        let _ = self.device.od_mut().set_bytes(Address::new(0x1001, 0), &[bits]);
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
        self.device.od()
    }

    fn od_mut(&mut self) -> &mut ObjectDictionary {
        self.device.od_mut()
    }

    fn before_write(&mut self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        self.device.before_write(at, data)
    }

    fn after_write(&mut self, at: Address) {
        self.device.after_write(at);
    }

    fn before_read(&mut self, at: Address) -> Result<(), AbortCode> {
        self.device.before_read(at)
    }

    fn outputs_applied(&mut self, now: Time, number: u8) {
        // The mode of operation is among the outputs; followed before the controlword, it is in force when that enables.
        self.device.wake(now);
        self.device.follow();
        self.device.outputs_applied(now, number);
    }

    fn sample(&mut self, now: Time) {
        self.device.sample(now);
    }

    fn reset(&mut self, now: Time, reset: Reset) {
        self.set_error_register(0);
        (self.has_lost_master, self.untold) = (false, None);
        // Of a device on EtherCAT that is power-on.
        self.device.power_on();
        self.device.reset(now, reset);
    }
}

impl EthercatApplication for EthercatDrive {
    fn set_operational(&mut self, now: Time, is_operational: bool) {
        let was_enabled = self.state() == State::OperationEnabled;
        self.device.change_operational(now, is_operational, error_code::RPDO_TIMEOUT);
        if !is_operational && was_enabled {
            let register = COMMUNICATION_ERROR | 1;
            self.set_error_register(register);
            self.has_lost_master = true;
            self.untold = Some(CoeEmergency { code: error_code::RPDO_TIMEOUT, register, vendor: [0; 5] });
        } else if is_operational
            && self.has_lost_master
            && !matches!(self.state(), State::Fault | State::FaultReactionActive)
        {
            self.recover();
        }
    }

    fn poll(&mut self, now: Time) {
        self.device.poll(now);
    }

    fn next_deadline(&self) -> Time {
        self.device.next_deadline()
    }

    fn refresh(&mut self) {
        self.device.refresh_if_stale();
    }

    fn sync1_ns(&self) -> Option<u32> {
        self.sync1_ns
    }

    fn take_emergency(&mut self) -> Option<CoeEmergency> {
        if self.device.take_reset() {
            self.recover();
        }
        if let Some(code) = self.device.take_emergency() {
            self.set_error_register(PROFILE_ERROR | 1);
            return Some(CoeEmergency { code, register: PROFILE_ERROR | 1, vendor: [0; 5] });
        }
        self.untold.take()
    }
}
