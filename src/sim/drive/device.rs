//! State machine, control loop and monitoring of a drive.

use std::time::Duration;
use yieldwall_motion::elementary;

use yieldwall_drives::cia402::{
    OperationMode, OptionCodes, Reaction, State, StateMachine, Statusword, Transition, controlword,
};
use yieldwall_drives::objects::error_code;
use yieldwall_drives::profiles::{AxisOffset, BrakeOutput, CurrentLimit, Homing, Reaction as Missed, Servo as Model};
use yieldwall_drives::scaling::{AxisScaling, CountUnwrapper, wrap};

use super::super::device::Unsigned;
use super::homing::{Home, Speed};
use super::objects::{Objects, needed_bits};
use super::servo::{Motion, Plan, Servo, TorqueRange};
use super::watches::Watches;
use super::{AxisSettings, DriveQuirks, Encoder};
use yieldwall_drives::watchdog::Clock;
use yieldwall_fieldbus::objects::{Address, DictionaryError, ObjectDictionary};
use yieldwall_fieldbus::time::Time;

/// Bit of the error register 1001h for errors of the device profile.
pub(super) const PROFILE_ERROR: u8 = 1 << 5;

/// Deceleration of a drive at the limit of its current: the torque limit decides.
const UNLIMITED_RAD_PER_S2: f64 = 1e9;

/// Objects that change less often than every cycle.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Parameters {
    slow_rad_per_s2: f64,
    quick_rad_per_s2: f64,
    pub(super) period_s: f64,
    /// Following error window in counts; `None` for no watch.
    window: Option<f64>,
    window_time: Duration,
}

#[derive(Clone, Debug)]
pub(super) struct Device {
    /// Object dictionary of the axis; that of the whole device while the axis acts.
    pub(super) od: ObjectDictionary,
    /// Where its objects are.
    pub(super) offset: AxisOffset,
    /// Number of its first PDO on CANopen.
    pub(super) first_pdo: u8,
    pub(super) objects: Objects,
    scaling: AxisScaling,
    encoder: Encoder,
    pub(super) supported_modes: u32,
    /// States in which the mode may change, a bit each.
    mode_changes_in: u16,
    pub(super) lacks_dummies: bool,
    /// Bits without which an object is not written.
    pub(super) needed_bits: Vec<(Address, u32)>,
    pub(super) refuses_mode: bool,
    pub(super) forgets_torque_limit: bool,
    pub(super) watches: Watches,
    current: Option<CurrentObjects>,
    pub(super) machine: StateMachine,
    pub(super) servo: Servo,
    mode: Option<OperationMode>,
    /// The output by which its master holds a brake.
    brake: Option<BrakeOutput>,
    /// How it homes, if its model does.
    homing: Option<Homing>,
    /// The reference of an incremental encoder.
    home: Option<Home>,
    pub(super) parameters: Parameters,
    counts: i64,
    motion: Motion,
    now: Time,
    /// Target of the present straight line, to recognise a new one.
    aimed_at: Option<i32>,
    outside_since: Option<Time>,
    pub(super) sync_deadline: Time,
    pub(super) set_point_deadline: Time,
    pub(super) is_operational: bool,
    has_voltage: bool,
    is_warning: bool,
    ignores_targets: bool,
    ignores_controlword: bool,
    /// Watchdogs that it lacks, a bit each ([`Watchdog::bit`](yieldwall_drives::watchdog::Watchdog::bit)).
    pub(super) lacks: u8,
    pub(super) clock: Clock,
    status: u16,
    has_status_changed: bool,
    pub(super) emergency: Option<u16>,
    pub(super) encoder_failed: bool,
    was_reset: bool,
    /// Error code of the Fault at power-on, and error code of the Fault that was not reset since; 0 for none.
    fault_code: u16,
    lasting_fault: u16,
    /// Time from a start until the power stage has voltage, and when that is.
    supply_time: Duration,
    supplied_at: Time,
    /// Whether something has run since the shown objects were brought up to date.
    pub(super) is_stale: bool,
}

/// The objects of a drive that limits its torque by its current.
#[derive(Clone, Copy, Debug)]
pub(super) struct CurrentObjects {
    limit: Unsigned,
    rated: Unsigned,
}

impl CurrentObjects {
    fn of(od: &ObjectDictionary, model: &Model) -> Result<Option<Self>, DictionaryError> {
        let Some(current) = &model.limits.current else { return Ok(None) };
        Ok(Some(Self { limit: Unsigned::of(od, &current.limit)?, rated: Unsigned::of(od, &current.rated)? }))
    }

    fn per_mille(self, od: &ObjectDictionary) -> u16 {
        CurrentLimit::per_mille(self.limit.get(od), self.rated.get(od)).try_into().unwrap_or(u16::MAX)
    }
}

impl Device {
    /// An axis with objects in a dictionary, which is with another one.
    pub(super) fn new(od: &ObjectDictionary, settings: &AxisSettings, model: &Model) -> Result<Self, DictionaryError> {
        Ok(Device {
            offset: model.offset(),
            first_pdo: 1,
            objects: Objects::of(od, model.offset())?,
            scaling: settings.scaling,
            encoder: settings.encoder,
            supported_modes: model.supported_modes(),
            mode_changes_in: model.mode_changes_in.iter().fold(0, |bits, state| bits | 1 << *state as u16),
            lacks_dummies: false,
            needed_bits: Vec::new(),
            refuses_mode: false,
            forgets_torque_limit: false,
            watches: Watches::new(od, model)?,
            current: CurrentObjects::of(od, model)?,
            machine: StateMachine::new(OptionCodes::default()),
            servo: Servo::new(settings.position_loop),
            mode: None,
            brake: model.brake.of_master().cloned(),
            homing: model.homing.clone(),
            home: None,
            parameters: Parameters::default(),
            counts: 0,
            motion: Motion::default(),
            now: Time(0),
            aimed_at: None,
            outside_since: None,
            sync_deadline: Time::NEVER,
            set_point_deadline: Time::NEVER,
            is_operational: false,
            has_voltage: true,
            is_warning: false,
            ignores_targets: false,
            ignores_controlword: false,
            lacks: 0,
            clock: Clock::Elsewhere,
            status: 0,
            has_status_changed: false,
            emergency: None,
            encoder_failed: false,
            was_reset: false,
            fault_code: error_code::NONE,
            lasting_fault: error_code::NONE,
            supply_time: Duration::ZERO,
            supplied_at: Time::NEVER,
            is_stale: true,
            od: ObjectDictionary::builder().build()?,
        })
    }

    /// Sets the quirks of the drive.
    pub(super) fn set_manner(&mut self, manner: &DriveQuirks) {
        (self.lacks_dummies, self.refuses_mode) = (manner.lacks_dummies, manner.refuses_mode);
        self.needed_bits = needed_bits(&manner.objects);
        (self.fault_code, self.supply_time) = (manner.fault_code, manner.supply_time);
    }

    pub(super) fn measure(&mut self, angle_rad: f64, rate_rad_per_s: f64) {
        match self.scaling.counts(angle_rad) {
            Ok(counts) if rate_rad_per_s.is_finite() => {
                self.counts = counts;
                self.home.iter_mut().for_each(|home| home.measure(counts));
                let angle_rad = match self.encoder {
                    Encoder::Exact => angle_rad,
                    Encoder::Quantised => self.scaling.angle_rad(counts),
                };
                self.motion = Motion { angle_rad, rate_rad_per_s };
                self.encoder_failed = false;
            }
            _ => self.encoder_failed = true,
        }
    }

    /// Gives the joint an encoder that knows nothing at power-on, with its mark at this angle of the joint.
    pub(super) fn set_incremental(&mut self, mark_rad: f64) {
        self.home = self.scaling.counts(mark_rad).ok().map(Home::new);
    }

    /// Gives the mark a random error with this standard deviation, rad, drawn for each homing.
    pub(super) fn set_loose_mark(&mut self, deviation_rad: f64, seed: u64) {
        let counts = deviation_rad * self.scaling.counts_per_rad().abs();
        self.home.iter_mut().for_each(|home| home.loosen(counts, seed));
    }

    /// The drive has been homed: its position refers to the machine.
    pub(super) fn refer(&mut self) {
        self.home.iter_mut().for_each(|home| home.refer_to_machine());
        self.is_stale = true;
    }

    /// Somebody has stored another torque limit in the positive direction.
    pub(super) fn set_stored_torque_limit(&mut self, per_mille: u16) {
        self.od.set(self.objects.positive_torque_limit, per_mille);
        self.od.store_parameters();
    }

    /// An incremental encoder forgets all.
    pub(super) fn power_on(&mut self) {
        self.home.iter_mut().for_each(Home::power_on);
        self.lasting_fault = self.fault_code;
    }

    /// Troubles that the drive finds at a start: a power stage without voltage, and a Fault that no reset of the node ends.
    pub(super) fn find_errors(&mut self, now: Time) {
        (self.emergency, self.supplied_at) = (None, Time::NEVER);
        if !self.supply_time.is_zero() {
            (self.emergency, self.supplied_at) = (Some(error_code::UNDER_VOLTAGE), now + self.supply_time);
        }
        if self.lasting_fault != error_code::NONE {
            self.raise_fault(now, self.lasting_fault);
        }
    }

    /// Whether a brake that the master holds is closed.
    pub(super) fn is_braked(&self, od: &ObjectDictionary) -> bool {
        self.brake.as_ref().is_some_and(|output| {
            let value = od.get(self.objects.digital_outputs);
            output.is_closed(value, od.get(self.objects.digital_output_mask))
        })
    }

    /// Whether there is such a brake.
    pub(super) fn has_brake(&self) -> bool {
        self.brake.is_some()
    }

    /// Where the drive counts from, in counts of the machine.
    fn origin(&self) -> i64 {
        self.home.as_ref().map_or(0, Home::origin)
    }

    /// The position at home that the home offset asks for, counts.
    fn at_home(&self) -> i64 {
        let offset = self.od.get(self.objects.home_offset);
        self.homing.as_ref().map_or(0, |homing| i64::from(homing.offset_for(offset)))
    }

    pub(super) fn torque_n_m(&self) -> f64 {
        self.servo.torque_n_m()
    }

    fn mode_can_change(&self) -> bool {
        self.mode_changes_in & (1 << self.machine.state() as u16) != 0
    }

    /// Whether the drive refuses any mode now.
    pub(super) fn refuses_modes(&self) -> bool {
        self.refuses_mode && !self.mode_can_change()
    }

    pub(super) fn state(&self) -> State {
        self.machine.state()
    }

    pub(super) fn set_warning(&mut self, is_warning: bool) {
        self.is_warning = is_warning;
        self.is_stale = true;
    }

    pub(super) fn set_ignores_targets(&mut self, ignores: bool) {
        self.ignores_targets = ignores;
        self.is_stale = true;
    }

    pub(super) fn torque_limit_per_mille(&self) -> u16 {
        let of_current = self.current.map_or(u16::MAX, |current| current.per_mille(&self.od));
        self.od.get(self.objects.max_torque).min(of_current)
    }

    pub(super) fn set_ignores_controlword(&mut self, ignores: bool) {
        self.ignores_controlword = ignores;
    }

    pub(super) fn leave_operation(&mut self, now: Time) {
        self.wake(now);
        // As Disable Voltage does (transition 9).
        self.machine.apply(0x0000);
        self.follow();
    }

    pub(super) fn set_voltage(&mut self, now: Time, is_present: bool) {
        self.wake(now);
        self.has_voltage = is_present;
        self.follow();
    }

    pub(super) fn next_deadline(&self) -> Time {
        self.servo.next_tick().min(self.sync_deadline).min(self.set_point_deadline).min(self.supplied_at)
    }

    pub(super) fn take_status_change(&mut self) -> bool {
        std::mem::take(&mut self.has_status_changed)
    }

    pub(super) fn take_emergency(&mut self) -> Option<u16> {
        self.emergency.take()
    }

    pub(super) fn take_reset(&mut self) -> bool {
        std::mem::take(&mut self.was_reset)
    }

    /// The control loop and the watch on SYNC.
    pub(super) fn poll(&mut self, now: Time) {
        if self.next_deadline() > now {
            return;
        }
        self.wake(now);
        if self.sync_deadline <= now {
            self.sync_deadline = Time::NEVER;
            self.miss(now, self.watches.sync.reaction(), error_code::SYNC_LOST);
        }
        if self.set_point_deadline <= now {
            self.set_point_deadline = Time::NEVER;
            self.miss(now, self.watches.set_points.reaction(), error_code::RPDO_TIMEOUT);
        }
        if self.supplied_at <= now {
            self.supplied_at = Time::NEVER;
            self.was_reset |= self.machine.state() != State::Fault;
        }
        if self.servo.next_tick() <= now {
            self.tick();
        }
    }

    /// Reacts to a monitored message that stays away.
    fn miss(&mut self, now: Time, reaction: Missed, code: u16) {
        match reaction {
            Missed::Nothing | Missed::Unknown => {}
            Missed::AbortConnection => {
                self.lose_connection(code);
                self.emergency = Some(code);
            }
            Missed::Fault => self.raise_fault(now, code),
        }
    }

    pub(super) fn raise_fault(&mut self, now: Time, code: u16) {
        self.wake(now);
        if self.fault(code) {
            self.emergency = Some(code);
        }
    }

    pub(super) fn wake(&mut self, now: Time) {
        self.now = now;
        self.is_stale = true;
    }

    /// [`Device::refresh`], if anything has run since.
    pub(super) fn refresh_if_stale(&mut self) {
        if self.is_stale {
            self.refresh();
        }
    }

    /// Brings the objects that show something up to date.
    pub(super) fn refresh(&mut self) {
        self.is_stale = false;
        let objects = self.objects;
        let status = self.statusword();
        self.has_status_changed |= status != self.status;
        self.status = status;
        self.od.set(objects.statusword, status);
        self.od.set(objects.mode_display, self.mode.map_or(0, OperationMode::code));
        self.od.set(objects.position, wrap(self.counts - self.origin()));
        // Rate and torque are finite, so that scaling them cannot fail.
        let rate = self.scaling.rate_counts_per_s(self.motion.rate_rad_per_s).map_or(0, |scaled| scaled.value);
        self.od.set(objects.velocity, rate);
        let torque = self.scaling.torque_per_mille(self.servo.torque_n_m()).map_or(0, |scaled| scaled.value);
        self.od.set(objects.torque, torque);
        self.od.set(objects.following_error, self.following_error_counts() as i32);
    }

    fn statusword(&self) -> u16 {
        let plan = self.servo.plan();
        let bit = |is_set: bool, mask: u16| if is_set { mask } else { 0 };
        let homing = self.home.as_ref().filter(|_| plan == Plan::Homing);
        let referenced =
            self.homing.as_ref().and_then(|homing| homing.referenced_bit).map_or(0, |bit| 1 << bit.min(15));
        self.machine.statusword()
            | bit(self.home.as_ref().is_some_and(Home::is_referenced), referenced)
            | bit(homing.is_some_and(Home::is_done), Statusword::HOMING_ATTAINED)
            | bit(plan == Plan::Homing && homing.is_none_or(Home::has_failed), Statusword::HOMING_ERROR)
            | bit(plan == Plan::Homing && homing.is_none_or(|home| !home.is_seeking()), Statusword::TARGET_REACHED)
            | Statusword::REMOTE
            | bit(self.has_voltage, Statusword::VOLTAGE_ENABLED)
            | bit(self.is_warning, Statusword::WARNING)
            | bit(self.servo.is_limited(), Statusword::INTERNAL_LIMIT)
            | bit(plan.follows_command() && !self.ignores_targets, Statusword::FOLLOWS_COMMAND)
            | bit(plan == Plan::Position && self.outside_since.is_some(), Statusword::FOLLOWING_ERROR)
    }

    fn following_error_counts(&self) -> f64 {
        if self.servo.plan() == Plan::Position {
            (self.servo.setpoint_rad() - self.motion.angle_rad) * self.scaling.counts_per_rad()
        } else {
            0.0
        }
    }

    /// Enters the fault state; whether the drive was not in it before.
    pub(super) fn fault(&mut self, code: u16) -> bool {
        let is_new = self.machine.fault().is_some();
        if is_new {
            self.od.set(self.objects.error_code, code);
            self.follow();
        }
        is_new
    }

    /// Notes that the master begins to send set-points, or ends. When the master ends, the drive reacts as 6007h says, with this
    /// error code.
    pub(super) fn change_operational(&mut self, now: Time, is_operational: bool, code: u16) {
        self.wake(now);
        let was_operational = std::mem::replace(&mut self.is_operational, is_operational);
        if !is_operational {
            self.set_point_deadline = Time::NEVER;
            if was_operational {
                self.lose_connection(code);
            }
        }
    }

    pub(super) fn lose_connection(&mut self, code: u16) {
        // One that is in Fault already keeps the code of its first error.
        let has_reacted = self.machine.lose_connection().is_some();
        if has_reacted && matches!(self.machine.state(), State::Fault | State::FaultReactionActive) {
            self.od.set(self.objects.error_code, code);
        }
        self.follow();
    }

    pub(super) fn apply_controlword(&mut self) {
        if self.ignores_controlword {
            return;
        }
        if self.machine.apply(self.od.get(self.objects.controlword)) == Some(Transition(15)) {
            self.od.set(self.objects.error_code, error_code::NONE);
            (self.was_reset, self.lasting_fault) = (true, error_code::NONE);
        }
        self.follow();
        if self.servo.plan() == Plan::Homing {
            let is_asked = self.od.get(self.objects.controlword) & controlword::START_HOMING != 0;
            let (method, counts, at_home) = (self.od.get(self.objects.homing_method), self.counts, self.at_home());
            let has = self.homing.as_ref().is_some_and(|homing| homing.methods.contains(&method));
            // A method that the drive lacks is none.
            let method = if has { method } else { 0 };
            self.home.iter_mut().for_each(|home| home.ask(is_asked, method, counts, at_home));
        }
    }

    /// Moves the joint as homing requires.
    fn seek(&mut self) {
        let (counts, at_home, per_rad) = (self.counts, self.at_home(), self.scaling.counts_per_rad());
        let Some(home) = &mut self.home else { return };
        let (way, speed) = match home.seek(counts, at_home) {
            Speed::Switch(way) => (way, self.od.get(self.objects.homing_switch_speed)),
            Speed::Zero(way) => (way, self.od.get(self.objects.homing_zero_speed)),
            Speed::None => (0, 0),
        };
        let counts_per_s = i32::try_from(speed).unwrap_or(i32::MAX) * i32::from(way);
        let acceleration = f64::from(self.od.get(self.objects.homing_acceleration)) / per_rad;
        self.servo.set_homing(self.scaling.rate_rad_per_s(counts_per_s), acceleration);
    }

    /// Makes mode and control loop follow the state machine.
    pub(super) fn follow(&mut self) {
        let is_moving = matches!(self.machine.state(), State::OperationEnabled | State::QuickStopActive);
        if self.encoder_failed && is_moving && self.machine.fault().is_some() {
            self.od.set(self.objects.error_code, error_code::ENCODER);
            self.emergency = Some(error_code::ENCODER);
        }
        let is_helpless = !self.has_voltage || self.encoder_failed;
        if !self.has_voltage {
            self.machine.lose_voltage();
        }
        let is_stopping = matches!(self.machine.state(), State::QuickStopActive | State::FaultReactionActive);
        if is_stopping && (is_helpless || self.machine.reaction() == Reaction::Off) {
            self.machine.standstill();
        }
        if self.mode_can_change() {
            let wanted = OperationMode::from_code(self.od.get(self.objects.mode));
            self.mode = wanted.filter(|mode| mode.is_in(self.supported_modes));
        }
        let plan = match (self.machine.reaction(), self.mode) {
            (Reaction::Off, _) => Plan::Off,
            _ if is_helpless => Plan::Off,
            (Reaction::SlowRamp, _) => Plan::Ramp(self.parameters.slow_rad_per_s2),
            (Reaction::QuickRamp, _) => Plan::Ramp(self.parameters.quick_rad_per_s2),
            (Reaction::Limit, _) => Plan::Ramp(UNLIMITED_RAD_PER_S2),
            (Reaction::Follow, Some(OperationMode::CyclicPosition)) => Plan::Position,
            (Reaction::Follow, Some(OperationMode::CyclicVelocity)) => Plan::Velocity,
            (Reaction::Follow, Some(OperationMode::CyclicTorque)) => Plan::Torque,
            (Reaction::Follow, Some(OperationMode::Homing)) => Plan::Homing,
            (Reaction::Follow, _) => Plan::Off,
        };
        if plan != self.servo.plan() {
            self.servo.change_plan(self.now, plan, self.motion, self.fastest_rad_per_s());
            self.aimed_at = None;
            self.outside_since = None;
            if plan != Plan::Homing {
                self.home.iter_mut().for_each(Home::rest);
            }
            if !plan.needs_master() {
                self.sync_deadline = Time::NEVER;
            }
        }
    }

    /// Hands the targets to the control loop.
    pub(super) fn take_targets(&mut self) {
        if self.ignores_targets {
            return;
        }
        let (objects, scaling) = (self.objects, self.scaling);
        let velocity_offset = scaling.rate_rad_per_s(self.od.get(objects.velocity_offset));
        self.servo.set_offsets(velocity_offset, scaling.torque_n_m(self.od.get(objects.torque_offset)));
        match self.servo.plan() {
            Plan::Torque => {
                let torque = scaling.torque_n_m(self.od.get(objects.target_torque));
                self.servo.set_torque(torque, self.torque_range());
            }
            Plan::Velocity => self.servo.set_velocity(scaling.rate_rad_per_s(self.od.get(objects.target_velocity))),
            Plan::Position => {
                let target = self.od.get(objects.target_position).wrapping_add(self.od.get(objects.position_offset));
                if self.aimed_at != Some(target) {
                    self.aimed_at = Some(target);
                    let origin = self.origin();
                    let counts = origin + CountUnwrapper::near(self.counts - origin).unwrap(target);
                    self.servo.aim_at(self.now, scaling.angle_rad(counts), self.parameters.period_s);
                }
            }
            Plan::Off | Plan::Homing | Plan::Ramp(_) => {}
        }
    }

    /// Returns the smallest of the torque limits 6072h, the current limit, 60E0h and 60E1h in each direction of the joint. In a
    /// direction in which it turns faster than 6080h allows there is no torque. The motor is the joint.
    fn torque_range(&self) -> TorqueRange {
        let most = self.torque_limit_per_mille();
        let limit = |other: u16| most.min(other).min(i16::MAX as u16) as i16;
        let positive = self.scaling.torque_n_m(limit(self.od.get(self.objects.positive_torque_limit)));
        let negative = self.scaling.torque_n_m(-limit(self.od.get(self.objects.negative_torque_limit)));
        let rate = self.motion.rate_rad_per_s;
        let fastest = self.fastest_rad_per_s();
        TorqueRange {
            lowest: if rate < -fastest { 0.0 } else { positive.min(negative) },
            highest: if rate > fastest { 0.0 } else { positive.max(negative) },
        }
    }

    /// The speed limit 6080h of the joint.
    fn fastest_rad_per_s(&self) -> f64 {
        f64::from(self.od.get(self.objects.max_speed)) * (std::f64::consts::TAU / 60.0)
    }

    pub(super) fn tick(&mut self) {
        if self.encoder_failed {
            self.follow();
        }
        if self.servo.plan() == Plan::Homing {
            self.seek();
        }
        self.servo.tick(self.now, self.motion, self.torque_range());
        if self.servo.is_at_standstill(self.now, self.motion) && self.machine.standstill().is_some() {
            self.follow();
        }
        self.watch_following_error();
    }

    fn watch_following_error(&mut self) {
        let Some(window) = self.parameters.window.filter(|_| self.servo.plan() == Plan::Position) else { return };
        if self.following_error_counts().abs() <= window {
            self.outside_since = None;
            return;
        }
        let since = *self.outside_since.get_or_insert(self.now);
        if self.now.since(since) >= self.parameters.window_time {
            self.raise_fault(self.now, error_code::FOLLOWING_ERROR);
        }
    }

    /// Reads option codes and parameters again.
    pub(super) fn reload(&mut self) {
        let objects = self.objects;
        self.machine.set_options(OptionCodes {
            quick_stop: self.od.get(objects.quick_stop),
            shutdown: self.od.get(objects.shutdown),
            disable_operation: self.od.get(objects.disable_operation),
            halt: self.od.get(objects.halt),
            fault_reaction: self.od.get(objects.fault_reaction),
            abort_connection: self.od.get(objects.abort_connection),
        });
        let per_rad = self.scaling.counts_per_rad();
        let window = self.od.get(objects.following_window);
        let exponent = i32::from(self.od.get(objects.interpolation_exponent));
        self.parameters = Parameters {
            slow_rad_per_s2: f64::from(self.od.get(objects.deceleration)) / per_rad,
            quick_rad_per_s2: f64::from(self.od.get(objects.quick_deceleration)) / per_rad,
            period_s: f64::from(self.od.get(objects.interpolation_time)) * elementary::powi(10.0, exponent),
            window: (window != u32::MAX).then_some(f64::from(window)),
            window_time: Duration::from_millis(self.od.get(objects.following_timeout).into()),
        };
    }
}
