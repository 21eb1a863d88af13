//! One axis on any bus: the walk through the states of CiA 402, and the conversion between counts and radians.

use yieldwall_drives::cia402::{Command, Goal, OptionCodes, State, StateMachine, StateWalk, Statusword, controlword};
use yieldwall_drives::profiles::Homing;
use yieldwall_drives::scaling::{AxisScaling, CountUnwrapper, wrap};
use yieldwall_motion::cycle::{DriveSample, LinkEvents};
use yieldwall_motion::guard::{Allowed, JointCommand};
use yieldwall_motion::sensing::RawSample;

/// Raw words that a drive has sent since the last cycle, the same over every fieldbus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveWords {
    /// Statusword, if it has come.
    pub statusword: Option<u16>,
    /// Position in counts modulo 2^32, if it has come.
    pub position: Option<i32>,
}

impl DriveWords {
    fn or(self, other: Self) -> Self {
        Self { statusword: self.statusword.or(other.statusword), position: self.position.or(other.position) }
    }
}

/// Words that the master sends to a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveOrders {
    /// Controlword.
    pub controlword: u16,
    /// Target in the unit of the command mode: counts modulo 2^32, counts/s, or per mille of the rated torque.
    pub target: i32,
    /// Whether a brake that the master holds is released.
    pub releases: bool,
}

/// Data that have arrived over the networks since the last cycle.
#[derive(Clone, Copy, Debug, Default)]
pub struct Arrived {
    /// Words of the left and of the right drive.
    pub drives: [DriveWords; 2],
    /// The newest sample of the force sensor, if one has come.
    pub sample: Option<RawSample>,
    /// Events on the networks.
    pub link: LinkEvents,
}

impl Arrived {
    /// This and what has come over another network, on which other devices are.
    pub(super) fn with(self, other: Self) -> Self {
        let [left, right] = self.drives;
        let [other_left, other_right] = other.drives;
        Self {
            drives: [left.or(other_left), right.or(other_right)],
            sample: self.sample.or(other.sample),
            link: self.link | other.link,
        }
    }
}

/// How a master has to take the positions of a drive.
#[derive(Clone, Debug)]
pub struct AxisSetup {
    /// Counts and per mille against the joint.
    pub scaling: AxisScaling,
    /// Angle in rad near which positions are unwrapped: the drive counts modulo 2^32.
    pub expected_rad: f64,
    /// Homing of a drive that needs it, and the angle in rad that the program assumes for its joint before homing.
    pub home: Option<(Homing, f64)>,
}

/// How far a drive is with homing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HomingState {
    /// Whether its position refers to home; always of a drive that needs no homing.
    pub is_referenced: bool,
    /// Whether the drive has found home; it may still come to rest. The drive reports this in homing mode only.
    pub is_found: bool,
    /// Whether the drive has found home and stands still. The drive reports this in homing mode only.
    pub is_over: bool,
    /// Whether the drive has given up. The drive reports this in homing mode only.
    pub has_failed: bool,
    /// Its last position has jumped: it refers to something else than the one before.
    pub has_jumped: bool,
}

/// A drive as the cycle sees it.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    scaling: AxisScaling,
    /// Counts at the angle near which each position is unwrapped.
    expected_counts: i64,
    home: Option<(Homing, f64)>,
    /// Shift of its angles since the first position, rad. A drive that is not homed gets the shift that puts its joint at the
    /// assumed angle.
    shift_rad: Option<f64>,
    /// While the drive homes: a greater change of its angle than this, rad, is one of its reference, and its angle goes on as it was.
    jump_rad: Option<f64>,
    /// Whether the last change of its angle was such a one.
    has_jumped: bool,
    /// The last angle, rad.
    last_rad: f64,
    /// Whether its first position referred to home.
    was_referenced: bool,
    unwrapper: CountUnwrapper,
    walk: StateWalk,
    statusword: Statusword,
    /// Whether the drive is asked to home.
    is_homing: bool,
}

impl Axis {
    /// An axis of which nothing has been heard.
    pub(super) fn new(setup: AxisSetup) -> Self {
        let AxisSetup { scaling, expected_rad, home } = setup;
        let expected_counts = scaling.counts(expected_rad).unwrap_or_default();
        Self {
            scaling,
            expected_counts,
            home,
            shift_rad: None,
            jump_rad: None,
            has_jumped: false,
            last_rad: 0.0,
            was_referenced: false,
            unwrapper: CountUnwrapper::near(expected_counts),
            walk: StateWalk::new(),
            statusword: Statusword::default(),
            is_homing: false,
        }
    }

    /// Forgets all that was heard of the drive.
    pub(super) fn restart(&mut self) {
        self.unwrapper = CountUnwrapper::near(self.expected_counts);
        (self.walk, self.statusword) = (StateWalk::new(), Statusword::default());
        (self.shift_rad, self.jump_rad, self.has_jumped) = (None, None, false);
        (self.was_referenced, self.is_homing) = (false, false);
    }

    /// How far the drive is with homing.
    ///
    /// Real-time: yes.
    pub(super) fn homing(&self) -> HomingState {
        let over = Statusword::HOMING_ATTAINED | Statusword::TARGET_REACHED;
        HomingState {
            is_referenced: self.is_referenced(),
            is_found: self.statusword.has(Statusword::HOMING_ATTAINED),
            is_over: self.statusword.has(over),
            has_failed: self.statusword.has(Statusword::HOMING_ERROR),
            has_jumped: self.has_jumped,
        }
    }

    /// Requests homing from a drive in homing mode while it is in Operation Enabled, or ends the request.
    ///
    /// Real-time: yes.
    pub(super) fn set_homing(&mut self, is_homing: bool) {
        self.is_homing = is_homing;
    }

    fn is_referenced(&self) -> bool {
        self.home.as_ref().is_none_or(|(homing, _)| homing.is_referenced(self.statusword.0))
    }

    /// Converts the words to SI. Without a new statusword it uses the last one.
    ///
    /// Real-time: yes.
    pub(super) fn take(&mut self, words: DriveWords) -> DriveSample {
        if let Some(statusword) = words.statusword {
            self.statusword = Statusword(statusword);
        }
        let angle_rad = words.position.map(|position| self.angle_rad(position));
        self.sample(angle_rad)
    }

    fn angle_rad(&mut self, position: i32) -> f64 {
        let is_referenced = self.is_referenced();
        let Some(shift_rad) = self.shift_rad else {
            // The first one.
            self.was_referenced = is_referenced;
            self.unwrap(position);
            let own_rad = self.scaling.angle_rad(self.unwrapper.counts());
            let taken_rad = self.home.as_ref().filter(|_| !is_referenced).map(|(_, taken_rad)| *taken_rad);
            self.last_rad = taken_rad.unwrap_or(own_rad);
            self.shift_rad = Some(taken_rad.map_or(0.0, |taken_rad| taken_rad - own_rad));
            return self.last_rad;
        };
        self.unwrap(position);
        let own_rad = self.scaling.angle_rad(self.unwrapper.counts());
        let mut angle_rad = own_rad + shift_rad;
        self.has_jumped = self.jump_rad.is_some_and(|jump_rad| (angle_rad - self.last_rad).abs() > jump_rad);
        if self.has_jumped {
            (angle_rad, self.shift_rad) = (self.last_rad, Some(self.last_rad - own_rad));
        }
        self.last_rad = angle_rad;
        angle_rad
    }

    /// Takes a position, without its wrap.
    fn unwrap(&mut self, position: i32) {
        self.unwrapper = match (&self.home, self.shift_rad) {
            // Of a drive that is not homed, or homes, nobody knows the turn: it goes on from the last position.
            (Some(_), None) if !self.was_referenced => CountUnwrapper::near(position.into()),
            (Some(_), Some(_)) if !self.was_referenced || self.jump_rad.is_some() => self.unwrapper,
            // From the expected angle each time: a corrupted report leaves no wrong turn behind.
            _ => CountUnwrapper::near(self.expected_counts),
        };
        self.unwrapper.unwrap(position);
    }

    /// The angle that the last position has by its reference, rad, whatever the joint was taken to be at.
    pub(super) fn referenced_rad(&self) -> f64 {
        let mut near = CountUnwrapper::near(self.expected_counts);
        self.scaling.angle_rad(near.unwrap(wrap(self.unwrapper.counts())))
    }

    /// Its last position, counts.
    ///
    /// Real-time: yes.
    pub(super) fn position_counts(&self) -> i64 {
        self.unwrapper.counts()
    }

    /// While it homes a change of its angle that is greater than this, rad, is one of its reference.
    pub(super) fn set_jump(&mut self, jump_rad: Option<f64>) {
        self.jump_rad = jump_rad;
    }

    /// Whether its positions have referred to home since the boot and do so no more.
    ///
    /// Real-time: yes.
    pub(super) fn has_lost_reference(&self) -> bool {
        self.jump_rad.is_none() && self.home.is_some() && self.was_referenced && !self.is_referenced()
    }

    /// Position that commands a joint angle in rad, counts.
    fn position(&self, angle_rad: f64) -> i32 {
        let counts = self.scaling.counts(angle_rad - self.shift_rad.unwrap_or_default());
        wrap(counts.unwrap_or(self.unwrapper.counts()))
    }

    /// The state of the drive before its first position arrives.
    pub(super) fn unheard(&self) -> DriveSample {
        self.sample(None)
    }

    fn sample(&self, angle_rad: Option<f64>) -> DriveSample {
        DriveSample {
            angle_rad,
            state: self.statusword.state().unwrap_or(State::NotReadyToSwitchOn),
            follows_command: self.statusword.has(Statusword::FOLLOWS_COMMAND),
            has_voltage: self.statusword.has(Statusword::VOLTAGE_ENABLED),
            has_warning: self.statusword.has(Statusword::WARNING),
        }
    }

    /// Asks the drive for one reset if it is in Fault.
    pub(super) fn request_fault_reset(&mut self) {
        self.walk.request_fault_reset();
    }

    /// Drops a reset that could not be sent, because the person who asked for it did not see later faults.
    pub(super) fn cancel_fault_reset(&mut self) {
        self.walk.cancel_fault_reset();
    }

    /// Returns the order for one step towards `goal`.
    fn order(&mut self, goal: Goal, target: i32, releases: bool) -> DriveOrders {
        self.walk.set_goal(goal);
        let mut word = self.walk.step(self.statusword).controlword;
        let is_enabled = self.statusword.state() == Some(State::OperationEnabled);
        let stays_enabled = is_enabled && Command::decode(word) == Command::EnableOperation;
        if self.is_homing && stays_enabled {
            word |= controlword::START_HOMING;
        }
        // Never outside Operation Enabled.
        DriveOrders { controlword: word, target, releases: releases && stays_enabled }
    }
}

/// Controlwords from the end of the boot to Operation Enabled, in their order, each once. The drive must be heard and follow each
/// of them. The first ones keep it waiting, the later ones enable it.
pub fn words_to_enable() -> Vec<u16> {
    let mut drive = StateMachine::new(OptionCodes::default());
    let mut walk = StateWalk::new();
    let mut words = Vec::new();
    drive.initialise();
    // The goals of the supervisor, from idling to running.
    for goal in [Goal::ReadyToSwitchOn, Goal::SwitchedOn, Goal::OperationEnabled] {
        walk.set_goal(goal);
        while !goal.is_reached_in(drive.state()) {
            let word = walk.step(Statusword(drive.statusword())).controlword;
            drive.apply(word);
            words.push(word);
        }
    }
    words.dedup();
    words
}

/// Returns the orders for both drives: each drive goes one step towards `goal`, with its share of `command`. Only a command that
/// the guard has allowed becomes a target. If a value cannot be scaled, the joint keeps its position. The master releases a brake
/// if it should be released and the drive is enabled.
///
/// Real-time: yes.
pub(super) fn orders(
    axes: &mut [Axis; 2],
    goal: Goal,
    command: &Allowed<JointCommand>,
    releases: bool,
) -> [DriveOrders; 2] {
    let [left, right] = axes;
    let mut each = |values: [f64; 2], scale: &dyn Fn(&Axis, f64) -> i32| {
        let [left_value, right_value] = values;
        let targets = [scale(left, left_value), scale(right, right_value)];
        [left.order(goal, targets[0], releases), right.order(goal, targets[1], releases)]
    };
    match command.get() {
        JointCommand::Position(angles) => each(angles.to_array(), &|axis, angle| axis.position(angle)),
        JointCommand::Velocity(rates) => {
            each(rates.to_array(), &|axis, rate| axis.scaling.rate_counts_per_s(rate).map_or(0, |raw| raw.value))
        }
        JointCommand::Torque(torques) => each(torques.to_array(), &|axis, torque| {
            axis.scaling.torque_per_mille(torque).map_or(0, |raw| raw.value.into())
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_drives::scaling::Direction;

    const COUNTS_PER_RAD: f64 = 10_000.0;
    const REFERENCED: u16 = 1 << 15;
    const ENABLED: u16 = 0x0237;

    /// An axis whose joint is taken to be at 2 rad until it is homed.
    fn axis(direction: Direction) -> Axis {
        let scaling = AxisScaling::new(COUNTS_PER_RAD * std::f64::consts::TAU, direction, 0.0, 60.0).unwrap();
        let profile = yieldwall_config::shipped_profile("simulated-servo");
        let homing = profile.servo().unwrap().homing.clone().unwrap();
        Axis::new(AxisSetup { scaling, expected_rad: 2.1, home: Some((homing, 2.0)) })
    }

    fn told(axis: &mut Axis, statusword: u16, position: i32) -> f64 {
        axis.take(DriveWords { statusword: Some(statusword), position: Some(position) }).angle_rad.unwrap()
    }

    #[test]
    fn an_angle_goes_on_when_the_reference_is_found_whichever_of_position_and_bit_comes_first() {
        for (direction, sign) in [(Direction::Same, 1), (Direction::Reversed, -1)] {
            for bit_first in [true, false] {
                let mut axis = axis(direction);
                axis.set_jump(Some(0.01));
                // It was switched on at 700 counts, whatever that is, truly at 2.05 rad, and goes up by 5 mrad a cycle.
                let own = |cycle: i32| 700 + sign * 50 * cycle;
                let by_home = |cycle: i32| sign * (20_500 + 50 * cycle);
                let wanted = |cycle: i32| 2.0 + 0.005 * f64::from(cycle);
                for cycle in 0..40 {
                    let (is_referenced, position) = match cycle {
                        0..10 => (false, own(cycle)),
                        10..20 if bit_first => (true, own(cycle)),
                        10..20 => (false, by_home(cycle)),
                        _ => (true, by_home(cycle)),
                    };
                    let word = ENABLED | if is_referenced { REFERENCED } else { 0 };
                    let angle = told(&mut axis, word, position);
                    let jumps = if bit_first { 20 } else { 10 };
                    assert_eq!(axis.homing().has_jumped, cycle == jumps, "{direction:?} {bit_first} {cycle}");
                    // The jump itself counts for no travel, so that one cycle of it is lost.
                    assert!((angle - wanted(cycle)).abs() < 0.0051, "{direction:?} {bit_first} {cycle}: {angle}");
                }
                assert!((axis.referenced_rad() - (2.05 + 0.005 * 39.0)).abs() < 1e-9, "{}", axis.referenced_rad());
            }
        }
    }

    #[test]
    fn a_reference_that_is_lost_moves_no_angle_and_is_told() {
        let mut axis = axis(Direction::Same);
        assert_eq!(told(&mut axis, ENABLED | REFERENCED, 20_500), 2.05);
        assert!(!axis.has_lost_reference());
        assert_eq!(told(&mut axis, ENABLED, 20_510), 2.051);
        assert!(axis.has_lost_reference());
        // After another boot it is taken to be where a person has put it.
        axis.restart();
        assert_eq!(told(&mut axis, ENABLED, 20_510), 2.0);
        assert!(!axis.has_lost_reference() && !axis.homing().is_referenced);
        assert!((told(&mut axis, ENABLED, 20_610) - 2.01).abs() < 1e-12);
        assert_eq!(axis.position(2.01), 20_610, "targets are told in the drive's own counts");
    }

    #[test]
    fn a_brake_and_a_start_of_homing_need_operation_enabled() {
        let mut axis = axis(Direction::Same);
        axis.set_homing(true);
        for (statusword, stays) in [(0x0250, false), (0x0231, false), (0x0233, false), (ENABLED, true), (0x0208, false)]
        {
            told(&mut axis, statusword, 0);
            let orders = axis.order(Goal::OperationEnabled, 0, true);
            assert_eq!((orders.releases, orders.controlword & 0x10 != 0), (stays, stays), "{statusword:04x}");
        }
        told(&mut axis, ENABLED, 0);
        let orders = axis.order(Goal::QuickStop, 0, true);
        assert_eq!((orders.controlword, orders.releases), (0x02, false));
    }
}
