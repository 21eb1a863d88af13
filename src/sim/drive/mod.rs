//! A simulated servo drive: a CANopen device with a CiA 402 state machine, control loop and encoder.

mod application;
mod axes;
mod device;
mod ethercat;
mod homing;
mod objects;
mod servo;
#[cfg(test)]
mod tests;
mod watches;

pub use ethercat::EthercatDrive;
pub use servo::PositionLoop;

use std::sync::Arc;
use std::time::Duration;

use yieldwall_drives::cia402::State;
use yieldwall_drives::profiles::{DeviceProfile, Fieldbus};
use yieldwall_drives::scaling::AxisScaling;
use yieldwall_drives::watchdog::{Clock, Watchdog};

use super::DeviceError;
use axes::Axes;
use device::{Device, PROFILE_ERROR};
use watches::Watch;
use yieldwall_fieldbus::canopen::{EmcyCode, ErrorRegister, Frame, Node, NodeId, Outbox, cob};
use yieldwall_fieldbus::objects::{Address, Object, ObjectDictionary, ServedDevice};
use yieldwall_fieldbus::time::Time;

/// Form in which the drive knows the joint angle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoder {
    /// The angle itself in its own loop; counts only on the bus.
    Exact,
    /// Whole counts everywhere.
    Quantised,
}

/// How a drive sits on its joint, and the loop that it closes there.
#[derive(Clone, Debug)]
pub struct AxisSettings {
    /// Counts and per mille against the joint.
    pub scaling: AxisScaling,
    /// The loop that the drive closes itself.
    pub position_loop: PositionLoop,
    /// Form in which the drive knows the angle.
    pub encoder: Encoder,
}

/// Settings of a simulated drive.
#[derive(Clone, Debug)]
pub struct DriveSettings {
    /// Node id.
    pub node: NodeId,
    /// Device model, which has to be a servo drive.
    pub profile: Arc<DeviceProfile>,
    /// Serial number, 1018h:4.
    pub serial: u32,
    /// Counts and per mille against the joint.
    pub scaling: AxisScaling,
    /// The loop that the drive closes itself.
    pub position_loop: PositionLoop,
    /// Form in which the drive knows the angle.
    pub encoder: Encoder,
    /// Deviations of this drive that no profile describes.
    pub manner: DriveQuirks,
}

/// Deviations of a drive that no profile describes, since a master copes with all of them. By default there are none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DriveQuirks {
    /// It maps no dummy entries (06040041h), so that no bytes of an RPDO can be skipped.
    pub lacks_dummies: bool,
    /// It refuses a mode (08000022h) in a state in which that cannot change, in place of taking it over later.
    pub refuses_mode: bool,
    /// Time from an SDO request to what answers it.
    pub sdo_time: Duration,
    /// Its SDO server sends every value in segments, and has no blocks.
    pub segments_only: bool,
    /// Objects that are sent with so many bytes whatever their type, 1 to 8.
    pub lengths: Vec<(Address, usize)>,
    /// Objects that are otherwise than those of CiA 402.
    pub objects: Vec<OddObject>,
    /// Error code of the Fault in which it is from power-on until a fault reset, whatever resets the node; 0 for none.
    pub fault_code: u16,
    /// Time from a start until its power stage has voltage. It says so by an emergency (3220h), and withdraws it then (0000h).
    pub supply_time: Duration,
}

/// An object of a drive that is otherwise than that of CiA 402. By default it is not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OddObject {
    /// Index.
    pub index: u16,
    /// Sub-index; `None` for all that the index has.
    pub sub: Option<u8>,
    /// Whether the drive does not have it.
    pub is_absent: bool,
    /// Whether a write is refused (06010002h).
    pub is_read_only: bool,
    /// Value at power-on, if it is another one.
    pub holds: Option<i64>,
    /// Bits that are set at power-on, and without which a write is refused (06090030h).
    pub needed_bits: u32,
    /// Time from the request of a write to its answer, on CAN.
    pub write_time: Duration,
}

/// State and torque of an axis of a drive at its joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisView {
    /// State of the state machine.
    pub state: State,
    /// Torque on the joint in N m.
    pub torque_n_m: f64,
    /// Whether a brake that the master holds by an output is closed.
    pub is_braked: bool,
}

impl Default for AxisView {
    /// As of an axis that is not there.
    fn default() -> Self {
        Self { state: State::NotReadyToSwitchOn, torque_n_m: 0.0, is_braked: false }
    }
}

impl AxisView {
    fn of(axis: &Device, od: &ObjectDictionary) -> Self {
        Self { state: axis.state(), torque_n_m: axis.torque_n_m(), is_braked: axis.is_braked(od) }
    }
}

/// The model of each axis of a device on a bus.
fn models(profile: &Arc<DeviceProfile>, bus: Fieldbus) -> Result<Vec<Arc<DeviceProfile>>, DeviceError> {
    let role = || DeviceError::Role { profile: profile.name().to_owned(), wanted: "servo drive" };
    objects::check(profile.servo().ok_or_else(role)?)?;
    Ok((0..profile.axes()).map(|axis| profile.of_axis(axis, axis, bus)).collect())
}

/// The axes of a device with the models of each, behind one dictionary.
fn axes<'a>(
    models: &[Arc<DeviceProfile>],
    axis: impl Fn(u8) -> &'a AxisSettings,
    communication: Vec<Object>,
    (odd, manner): (&[OddObject], &DriveQuirks),
) -> Result<Axes, DeviceError> {
    let servos = || (0..).zip(models).filter_map(|(number, model)| Some((axis(number), model.servo()?)));
    for (settings, _) in servos() {
        settings.position_loop.check()?;
    }
    let od = objects::build(servos().map(|(settings, servo)| (&settings.scaling, servo)), communication, odd)?;
    let mut devices = Vec::new();
    for (settings, servo) in servos() {
        let mut device = Device::new(&od, settings, servo)?;
        device.set_manner(manner);
        let step = servo.axes.as_ref().map_or(0, |axes| axes.pdo_step_on(Fieldbus::Canopen));
        device.first_pdo = u8::try_from(1 + step * devices.len() as u16).unwrap_or(u8::MAX - axes::PDOS);
        devices.push(device);
    }
    let others = devices.split_off(1);
    match devices.pop() {
        Some(front) => Ok(Axes::new(front, others, od)),
        None => Err(DeviceError::Role { profile: String::new(), wanted: "servo drive" }),
    }
}

/// A simulated servo drive on a joint.
///
/// The bus side is that of a device: [`Drive::boot`], [`Drive::on_frame`], [`Drive::poll`], [`Drive::next_deadline`].
/// The physical side is [`Drive::measure`] in and [`Drive::torque_n_m`] out. Pass the joint's motion at each moment
/// before the frame or deadline of that moment, and read the torque afterwards. The torque is constant in between.
///
/// In CST the drive holds the torque of the last SYNC. In CSP the drive runs its own loop and draws a straight line from target
/// to target over the interpolation period (60C2h), so that it is one period behind. In CSV it integrates the target.
/// Without Operation Enabled there is no torque, except on the ramps that the option codes ask for.
#[derive(Clone, Debug)]
pub struct Drive {
    node: Node,
    axes: Axes,
    is_powered: bool,
    ignores_heartbeats: bool,
}

impl Drive {
    /// A drive that is switched off until [`Drive::boot`].
    ///
    /// # Errors
    /// If the profile is not that of a servo drive, or the gains of the loop are not finite or negative.
    pub fn new(settings: DriveSettings) -> Result<Self, DeviceError> {
        let DriveSettings { scaling, position_loop, encoder, .. } = settings.clone();
        let axis = AxisSettings { scaling, position_loop, encoder };
        Self::of_axes(&settings, |_| &axis)
    }

    /// As [`Drive::new`], each axis on its own joint in place of the one in the settings.
    ///
    /// # Errors
    /// As [`Drive::new`].
    pub fn of_axes<'a>(settings: &DriveSettings, axis: impl Fn(u8) -> &'a AxisSettings) -> Result<Self, DeviceError> {
        let manner = &settings.manner;
        let models = models(&settings.profile, Fieldbus::Canopen)?;
        let servos = || models.iter().filter_map(|model| model.servo());
        let mut odd: Vec<OddObject> = servos().flat_map(objects::fixed_mappings).collect();
        odd.extend_from_slice(&manner.objects);
        let communication = objects::communication(settings, &models)?;
        let axes = axes(&models, axis, communication, (&odd, manner))?;
        let mut node = Node::new(settings.node, axes.od())?;
        node.set_sdo_time(manner.sdo_time);
        node.set_sdo_segments_only(manner.segments_only);
        manner.lengths.iter().for_each(|(at, bytes)| node.set_sdo_length(*at, *bytes));
        for odd in manner.objects.iter().filter(|odd| !odd.write_time.is_zero()) {
            node.set_sdo_write_time(Address::new(odd.index, odd.sub.unwrap_or_default()), odd.write_time);
        }
        Ok(Drive { node, axes, is_powered: false, ignores_heartbeats: false })
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
        if self.is_powered {
            self.axes.view(axis).unwrap_or_default()
        } else {
            AxisView { is_braked: self.axes.get(axis).is_some_and(Device::has_brake), ..AxisView::default() }
        }
    }

    /// Switches the drive on: all objects at their power-on values, boot-up message.
    pub fn boot(&mut self, now: Time, out: &mut impl Outbox) {
        self.is_powered = true;
        self.axes.each(Device::power_on);
        self.node.boot(now, &mut self.axes, out);
        self.settle(now, out);
    }

    /// Switches the drive off: it is silent and deaf and has no torque.
    pub fn switch_off(&mut self) {
        self.is_powered = false;
    }

    /// Sets the joint's motion at this moment, in rad and rad/s. A value that is not finite, or too far away to count, causes an
    /// encoder fault (7305h), and the last good value stays.
    pub fn measure(&mut self, angle_rad: f64, rate_rad_per_s: f64) {
        self.axes.front_mut().measure(angle_rad, rate_rad_per_s);
    }

    /// Torque on the joint in N m.
    pub fn torque_n_m(&self) -> f64 {
        if self.is_powered { self.axes.front().torque_n_m() } else { 0.0 }
    }

    /// Whether a brake that the master holds by an output is closed; without supply it is.
    pub fn is_braked(&self) -> bool {
        self.axis(0).is_braked
    }

    /// Takes one frame from the bus.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        if self.is_powered && !(self.ignores_heartbeats && cob::is_heartbeat(frame.id())) {
            let is_its_own = self.node.on_frame(now, frame, &mut self.axes, out);
            // Most frames are those of others.
            if is_its_own || self.axes.is_stale() {
                self.settle(now, out);
            }
        }
    }

    /// Does what is due: timers of the node, the control loop, the watch on SYNC.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        if self.is_powered {
            self.node.poll(now, &mut self.axes, out);
            self.axes.each(|axis| axis.poll(now));
            self.settle(now, out);
        }
    }

    /// When to poll next.
    pub fn next_deadline(&self) -> Time {
        if self.is_powered { self.node.next_deadline().min(self.axes.next_deadline()) } else { Time::NEVER }
    }

    /// Puts the drive into fault with an error code (603Fh), as its own monitoring would.
    pub fn raise_fault(&mut self, now: Time, code: u16, out: &mut impl Outbox) {
        if self.is_powered {
            self.axes.front_mut().raise_fault(now, code);
            self.settle(now, out);
        }
    }

    /// Sets or clears the warning bit of the statusword, as a hot motor would.
    pub fn set_warning(&mut self, is_warning: bool) {
        self.axes.front_mut().set_warning(is_warning);
    }

    /// Gives the power stage its voltage or takes it away, as an emergency stop does; without it there is no torque.
    pub fn set_voltage(&mut self, now: Time, is_present: bool, out: &mut impl Outbox) {
        self.axes.front_mut().set_voltage(now, is_present);
        self.settle(now, out);
    }

    /// Leaves Operation Enabled without being asked to, as by a safety input of its own.
    pub fn leave_operation(&mut self, now: Time, out: &mut impl Outbox) {
        if self.is_powered {
            self.axes.front_mut().leave_operation(now);
            self.settle(now, out);
        }
    }

    /// Disables a watchdog of the drive, as in a model that lacks it or was delivered with it switched off. The drive then goes
    /// on when the frames that the watchdog waits for are missing.
    ///
    /// The drive reports this in 2010h, so that a master in lockstep, where no drill on the bus is possible, can refuse it.
    pub fn ignore(&mut self, watchdog: Watchdog) {
        self.axes.each(|axis| {
            axis.lacks |= watchdog.bit();
            match watchdog {
                Watchdog::Sync => axis.watches.sync = Watch::None,
                Watchdog::SetPoints => axis.watches.set_points = Watch::None,
                // The node's or the controller's.
                Watchdog::Heartbeat | Watchdog::Outputs | Watchdog::Operational => {}
            }
        });
        match watchdog {
            Watchdog::Heartbeat => self.ignores_heartbeats = true,
            Watchdog::Sync | Watchdog::SetPoints | Watchdog::Outputs | Watchdog::Operational => {}
        }
    }

    /// Sets the time from a reset or from switching on to the boot-up message; the drive is deaf meanwhile. By default the
    /// message comes at once.
    pub fn set_reset_time(&mut self, time: Duration) {
        self.node.set_reset_time(time);
    }

    /// Sets how long the drive takes to answer an SDO request, in place of the time of its [`DriveQuirks`].
    pub fn set_sdo_time(&mut self, time: Duration) {
        self.node.set_sdo_time(time);
    }

    /// Sets the clock that the drive's time follows, which the drive reports in 2011h.
    pub fn set_clock(&mut self, clock: Clock) {
        self.axes.each(|axis| axis.clock = clock);
    }

    /// Makes the drive keep its last target and report this (statusword bit 12), or follow its targets again.
    pub fn set_ignores_targets(&mut self, ignores: bool) {
        self.axes.front_mut().set_ignores_targets(ignores);
    }

    /// Makes the drive accept a torque limit (6072h) and forget it at once, or keep it.
    pub fn set_forgets_torque_limit(&mut self, forgets: bool) {
        self.axes.front_mut().forgets_torque_limit = forgets;
    }

    /// Gives the drive an incremental encoder, which has no reference at power-on. Until the drive is homed, it counts from where it was
    /// switched on. The encoder's mark, the index or the edge of a limit switch, lies at the joint angle `mark_rad`.
    pub fn set_incremental(&mut self, mark_rad: f64) {
        self.axes.front_mut().set_incremental(mark_rad);
    }

    /// Sets the standard deviation in rad with which an incremental encoder finds its mark; each homing draws a new error.
    pub fn set_loose_mark(&mut self, deviation_rad: f64, seed: u64) {
        self.axes.front_mut().set_loose_mark(deviation_rad, seed);
    }

    /// Sets the torque limit in the positive direction (60E0h), per mille of rated, that an earlier user has stored in the drive.
    pub fn set_stored_torque_limit(&mut self, per_mille: u16) {
        self.axes.front_mut().set_stored_torque_limit(per_mille);
    }

    /// Marks the drive as homed, if its encoder is incremental.
    pub fn refer(&mut self) {
        self.axes.front_mut().refer();
    }

    /// Makes the state machine ignore the controlword, or follow it again.
    pub fn set_ignores_controlword(&mut self, ignores: bool) {
        self.axes.front_mut().set_ignores_controlword(ignores);
    }

    /// The torque limit that it has (6072h), per mille of rated.
    pub fn torque_limit_per_mille(&self) -> u16 {
        self.axes.front().torque_limit_per_mille()
    }

    /// State of the state machine.
    pub fn state(&self) -> State {
        if self.is_powered { self.axes.front().state() } else { State::NotReadyToSwitchOn }
    }

    /// Sends what the device wished to send: emergencies, and event-driven TPDOs when the statusword has changed.
    fn settle(&mut self, now: Time, out: &mut impl Outbox) {
        if !self.is_powered {
            return;
        }
        self.axes.each(Device::refresh_if_stale);
        if self.axes.take_reset() {
            self.node.clear_all_emergencies(self.axes.od_mut(), out);
        }
        if let Some(code) = self.axes.take_emergency() {
            let bits = ErrorRegister(PROFILE_ERROR);
            self.node.raise_emergency(self.axes.od_mut(), EmcyCode(code), bits, [0; 5], out);
        }
        while let Some(first) = self.axes.take_status_change() {
            for number in first..first + axes::PDOS {
                self.node.trigger_tpdo(now, number, self.axes.od(), out);
            }
        }
    }
}
