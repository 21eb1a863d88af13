//! The control loop inside a drive: from a set-point to a torque.

use std::time::Duration;

use super::super::DeviceError;
use yieldwall_fieldbus::time::Time;

/// Share of the interpolation period by which SYNC may be late without a set-point that comes to rest.
const LATE_SYNC: f64 = 0.1;
/// Below this rate a drive that slows down counts as standing.
const STANDSTILL_RAD_PER_S: f64 = 0.01;
/// A drive that is kept from standing still ends its ramp that long after the set-point came to rest.
const STANDSTILL_WAIT: Duration = Duration::from_secs(1);

/// The loop that a drive closes in the position and velocity modes and on its ramps.
///
/// `torque = stiffness e + damping (v - rate) + integral of integral e`, with `e` the position error and `v` the rate of
/// the set-point; the integral stops while the torque is at its limit. In velocity mode the position set-point is the
/// integral of the target velocity, kept within reach of the torque limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionLoop {
    /// Period of the loop in us, at least 1.
    pub period_us: u32,
    /// Proportional gain in N m/rad, positive.
    pub stiffness_n_m_per_rad: f64,
    /// Gain on the rate error in N m s/rad, not negative.
    pub damping_n_m_s_per_rad: f64,
    /// Integral gain in N m/(rad s), not negative.
    pub integral_n_m_per_rad_s: f64,
}

impl PositionLoop {
    pub(super) fn check(&self) -> Result<(), DeviceError> {
        let finite = |setting, value: f64, least: f64, range| {
            if value.is_finite() && value >= least {
                Ok(())
            } else {
                Err(DeviceError::Setting { setting, value, range })
            }
        };
        finite("period_us", f64::from(self.period_us), 1.0, "at least 1")?;
        finite("stiffness_n_m_per_rad", self.stiffness_n_m_per_rad, f64::MIN_POSITIVE, "finite and positive")?;
        finite("damping_n_m_s_per_rad", self.damping_n_m_s_per_rad, 0.0, "finite and not negative")?;
        finite("integral_n_m_per_rad_s", self.integral_n_m_per_rad_s, 0.0, "finite and not negative")
    }
}

/// Position and rate of the joint as the drive sees them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Motion {
    pub(super) angle_rad: f64,
    pub(super) rate_rad_per_s: f64,
}

/// Smallest and largest torque in N m.
#[derive(Clone, Copy, Debug)]
pub(super) struct TorqueRange {
    pub(super) lowest: f64,
    pub(super) highest: f64,
}

/// Task of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Plan {
    /// No torque.
    Off,
    /// The commanded torque, held.
    Torque,
    /// The interpolated target position.
    Position,
    /// The target velocity.
    Velocity,
    /// Homing: the joint moves with its own velocity, reached within the homing acceleration, or holds its position.
    Homing,
    /// Down to standstill with this deceleration in rad/s^2, then held.
    Ramp(f64),
}

impl Plan {
    /// Whether the loop has to run at its period.
    pub(super) fn is_closed_loop(self) -> bool {
        matches!(self, Plan::Position | Plan::Velocity | Plan::Homing | Plan::Ramp(_))
    }

    /// Whether the drive follows the master's set-points.
    pub(super) fn follows_command(self) -> bool {
        matches!(self, Plan::Torque | Plan::Position | Plan::Velocity)
    }

    /// Whether the drive goes on only as long as its master is there.
    pub(super) fn needs_master(self) -> bool {
        self.follows_command() || self == Plan::Homing
    }
}

/// Straight line of the position set-point from one SYNC to the next.
#[derive(Clone, Copy, Debug, Default)]
struct Segment {
    from_rad: f64,
    rate_rad_per_s: f64,
    start: Time,
    seconds: f64,
}

impl Segment {
    /// Set-point and its rate; at rest after the end. The rate stays for a SYNC that is a little late, as one behind a heartbeat.
    fn at(&self, now: Time) -> (f64, f64) {
        let elapsed = now.since(self.start).as_secs_f64();
        let rate = if elapsed < self.seconds * (1.0 + LATE_SYNC) { self.rate_rad_per_s } else { 0.0 };
        (self.from_rad + self.rate_rad_per_s * elapsed.min(self.seconds), rate)
    }
}

/// The loop and its state.
#[derive(Clone, Debug)]
pub(super) struct Servo {
    gains: PositionLoop,
    plan: Plan,
    segment: Segment,
    setpoint_rad: f64,
    setpoint_rate: f64,
    velocity_target: f64,
    velocity_offset: f64,
    /// Acceleration of homing, rad/s^2.
    acceleration: f64,
    torque_target: f64,
    torque_offset: f64,
    integral_n_m: f64,
    torque_n_m: f64,
    is_limited: bool,
    last_tick: Time,
    next_tick: Time,
    at_rest_since: Option<Time>,
}

impl Servo {
    pub(super) fn new(gains: PositionLoop) -> Self {
        Servo {
            gains,
            plan: Plan::Off,
            segment: Segment::default(),
            setpoint_rad: 0.0,
            setpoint_rate: 0.0,
            velocity_target: 0.0,
            velocity_offset: 0.0,
            acceleration: 0.0,
            torque_target: 0.0,
            torque_offset: 0.0,
            integral_n_m: 0.0,
            torque_n_m: 0.0,
            is_limited: false,
            last_tick: Time(0),
            next_tick: Time::NEVER,
            at_rest_since: None,
        }
    }

    pub(super) fn plan(&self) -> Plan {
        self.plan
    }

    pub(super) fn torque_n_m(&self) -> f64 {
        self.torque_n_m
    }

    /// Whether the last torque was cut off at its limit.
    pub(super) fn is_limited(&self) -> bool {
        self.is_limited
    }

    pub(super) fn setpoint_rad(&self) -> f64 {
        self.setpoint_rad
    }

    pub(super) fn next_tick(&self) -> Time {
        self.next_tick
    }

    /// Goes over to another plan. A closed loop that starts from an open one starts where the joint is. A ramp starts with the rate of the
    /// set-point if there is one, else with that of the joint, as it does where the set-point is faster than `fastest_rad_per_s`.
    pub(super) fn change_plan(&mut self, now: Time, plan: Plan, motion: Motion, fastest_rad_per_s: f64) {
        if plan == self.plan {
            return;
        }
        let is_too_fast = matches!(plan, Plan::Ramp(_)) && self.setpoint_rate.abs() > fastest_rad_per_s;
        if !self.plan.is_closed_loop() || is_too_fast {
            (self.setpoint_rad, self.setpoint_rate) = (motion.angle_rad, 0.0);
            self.integral_n_m = 0.0;
            self.last_tick = now;
            if matches!(plan, Plan::Ramp(_)) {
                self.setpoint_rate = motion.rate_rad_per_s;
            }
        }
        self.segment = Segment { from_rad: self.setpoint_rad, ..Segment::default() };
        self.velocity_target = 0.0;
        self.at_rest_since = None;
        self.plan = plan;
        self.next_tick = if plan.is_closed_loop() { now } else { Time::NEVER };
        if plan == Plan::Off {
            (self.torque_n_m, self.is_limited) = (0.0, false);
        }
    }

    /// The next target position, to be reached in `seconds`.
    pub(super) fn aim_at(&mut self, now: Time, target_rad: f64, seconds: f64) {
        let (from_rad, _) = self.segment.at(now);
        let seconds = seconds.max(1e-6);
        self.segment = Segment { from_rad, rate_rad_per_s: (target_rad - from_rad) / seconds, start: now, seconds };
    }

    pub(super) fn set_velocity(&mut self, target_rad_per_s: f64) {
        self.velocity_target = target_rad_per_s;
    }

    /// The velocity of [`Plan::Homing`], which is reached within this acceleration in rad/s^2.
    pub(super) fn set_homing(&mut self, target_rad_per_s: f64, acceleration: f64) {
        (self.velocity_target, self.acceleration) = (target_rad_per_s, acceleration);
    }

    /// Feed-forward of rate and torque.
    pub(super) fn set_offsets(&mut self, velocity_rad_per_s: f64, torque_n_m: f64) {
        (self.velocity_offset, self.torque_offset) = (velocity_rad_per_s, torque_n_m);
    }

    /// The torque of [`Plan::Torque`], in force at once and until the next.
    pub(super) fn set_torque(&mut self, target_n_m: f64, range: TorqueRange) {
        self.torque_target = target_n_m;
        if self.plan == Plan::Torque {
            self.put_out(self.torque_target + self.torque_offset, range);
        }
    }

    /// Runs the loop at `now` and sets the next moment one period later. Twice at one moment is as good as once.
    pub(super) fn tick(&mut self, now: Time, motion: Motion, range: TorqueRange) {
        if !self.plan.is_closed_loop() {
            return;
        }
        let elapsed = now.since(self.last_tick).as_secs_f64();
        (self.last_tick, self.next_tick) = (now, now + Duration::from_micros(u64::from(self.gains.period_us)));
        self.move_setpoint(now, elapsed, motion, range);
        let error = self.setpoint_rad - motion.angle_rad;
        let wanted = self.gains.stiffness_n_m_per_rad * error
            + self.gains.damping_n_m_s_per_rad * (self.setpoint_rate - motion.rate_rad_per_s)
            + self.integral_n_m
            + if self.plan.follows_command() { self.torque_offset } else { 0.0 };
        self.put_out(wanted, range);
        if !self.is_limited {
            let next = self.integral_n_m + self.gains.integral_n_m_per_rad_s * error * elapsed;
            self.integral_n_m = next.clamp(range.lowest, range.highest);
        }
    }

    /// Whether a ramp has ended: the set-point rests, and the joint does too or had time enough.
    pub(super) fn is_at_standstill(&self, now: Time, motion: Motion) -> bool {
        self.at_rest_since.is_some_and(|since| {
            motion.rate_rad_per_s.abs() < STANDSTILL_RAD_PER_S || now.since(since) >= STANDSTILL_WAIT
        })
    }

    fn move_setpoint(&mut self, now: Time, elapsed: f64, motion: Motion, range: TorqueRange) {
        let rate = match self.plan {
            Plan::Position => {
                let (setpoint, rate) = self.segment.at(now);
                (self.setpoint_rad, self.setpoint_rate) = (setpoint, rate + self.velocity_offset);
                return;
            }
            Plan::Velocity => self.velocity_target + self.velocity_offset,
            Plan::Homing => {
                let change = self.acceleration * elapsed;
                self.setpoint_rate + (self.velocity_target - self.setpoint_rate).clamp(-change, change)
            }
            Plan::Ramp(deceleration) => {
                let slower = (self.setpoint_rate.abs() - deceleration * elapsed).max(0.0);
                if slower == 0.0 {
                    self.at_rest_since.get_or_insert(now);
                }
                slower.copysign(self.setpoint_rate)
            }
            Plan::Off | Plan::Torque => 0.0,
        };
        self.setpoint_rate = rate;
        let reach = range.highest.max(-range.lowest) / self.gains.stiffness_n_m_per_rad;
        let ahead = self.setpoint_rad + rate * elapsed - motion.angle_rad;
        self.setpoint_rad = motion.angle_rad + ahead.clamp(-reach, reach);
    }

    fn put_out(&mut self, wanted: f64, range: TorqueRange) {
        self.torque_n_m = wanted.max(range.lowest).min(range.highest);
        self.is_limited = self.torque_n_m != wanted;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAINS: PositionLoop = PositionLoop {
        period_us: 125,
        stiffness_n_m_per_rad: 1000.0,
        damping_n_m_s_per_rad: 10.0,
        integral_n_m_per_rad_s: 0.0,
    };
    const RANGE: TorqueRange = TorqueRange { lowest: -50.0, highest: 50.0 };
    const FASTEST: f64 = 10.0;
    const STANDING: Motion = Motion { angle_rad: 0.0, rate_rad_per_s: 0.0 };

    fn in_plan(plan: Plan) -> Servo {
        let mut servo = Servo::new(GAINS);
        servo.change_plan(Time(0), plan, STANDING, FASTEST);
        servo
    }

    #[test]
    fn the_setpoint_is_a_straight_line_over_the_interpolation_period() {
        let mut servo = in_plan(Plan::Position);
        servo.aim_at(Time(0), 0.02, 2e-3);
        for (us, setpoint, rate) in [
            (0, 0.0, 10.0),
            (500, 0.005, 10.0),
            (1500, 0.015, 10.0),
            (2000, 0.02, 10.0),
            (2190, 0.02, 10.0),
            (2210, 0.02, 0.0),
        ] {
            servo.tick(Time::from_micros(us), STANDING, RANGE);
            assert!((servo.setpoint_rad() - setpoint).abs() < 1e-12, "{us} us");
            // 1000 N m/rad on the error, 10 N m s/rad on the rate.
            let torque: f64 = 1000.0 * setpoint + 10.0 * rate;
            assert!((servo.torque_n_m() - torque.min(50.0)).abs() < 1e-9, "{us} us: {}", servo.torque_n_m());
            assert_eq!(servo.is_limited(), torque > 50.0);
        }
        assert_eq!(servo.next_tick(), Time::from_micros(2335));
    }

    #[test]
    fn a_new_target_in_the_middle_starts_where_the_line_is() {
        let mut servo = in_plan(Plan::Position);
        servo.aim_at(Time(0), 0.02, 2e-3);
        servo.aim_at(Time::from_micros(1000), 0.0, 2e-3);
        servo.tick(Time::from_micros(1000), STANDING, RANGE);
        assert!((servo.setpoint_rad() - 0.01).abs() < 1e-12);
        servo.tick(Time::from_micros(2000), STANDING, RANGE);
        assert!((servo.setpoint_rad() - 0.005).abs() < 1e-12);
    }

    #[test]
    fn a_blocked_axis_does_not_wind_up_its_velocity_setpoint() {
        let mut servo = in_plan(Plan::Velocity);
        servo.set_velocity(1.0);
        for tick in 1..100_000 {
            servo.tick(Time::from_micros(125 * tick), STANDING, RANGE);
        }
        assert!(servo.setpoint_rad() <= 50.0 / 1000.0 + 1e-12, "{}", servo.setpoint_rad());
        assert_eq!(servo.torque_n_m(), 50.0);
    }

    /// The target of another master may lie anywhere: a joint that hardly moves must not be led at full speed for as long as a ramp from
    /// there takes.
    #[test]
    fn a_ramp_from_a_set_point_that_leaps_starts_where_the_joint_is() {
        let slow = Motion { angle_rad: 0.02, rate_rad_per_s: 0.5 };
        for (target_rad, from) in [(1.0, 0.5), (0.02, 5.0)] {
            let mut servo = in_plan(Plan::Position);
            servo.aim_at(Time(0), target_rad, 4e-3);
            servo.tick(Time::from_micros(1000), slow, RANGE);
            servo.change_plan(Time::from_micros(1000), Plan::Ramp(100.0), slow, FASTEST);
            servo.tick(Time::from_micros(1000), slow, RANGE);
            assert_eq!(servo.setpoint_rate, from, "{target_rad} rad");
        }
    }

    #[test]
    fn a_ramp_that_is_kept_moving_ends_after_its_wait() {
        let mut servo = Servo::new(GAINS);
        let pushed = Motion { angle_rad: 0.0, rate_rad_per_s: 1.0 };
        servo.change_plan(Time(0), Plan::Ramp(100.0), pushed, FASTEST);
        let end = (0..20_000u64).map(|tick| Time::from_micros(125 * tick)).find(|&now| {
            servo.tick(now, pushed, RANGE);
            servo.is_at_standstill(now, pushed)
        });
        // 10 ms of ramp, to the tick at which rounding lets it end, and 1 s of waiting.
        let expected = [1_010_000, 1_010_125].map(|us| Some(Time::from_micros(us)));
        assert!(expected.contains(&end), "{end:?}");
    }
}
