//! One axis, whatever its bus: the walk through the states of CiA 402, counts to radians and back.

use crate::cycle::{DriveSample, LinkEvents};
use crate::guard::{Allowed, JointCommand};
use crate::sensing::RawSample;
use yieldwall_drives::cia402::{Command, Goal, OptionCodes, State, StateMachine, StateWalk, Statusword, controlword};
use yieldwall_drives::profiles::Homing;
use yieldwall_drives::scaling::{AxisScaling, CountUnwrapper, wrap};

/// What a drive has sent since the last cycle: raw words, as any fieldbus carries them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct DriveWords {
    /// Statusword, if it has come.
    pub(super) statusword: Option<u16>,
    /// Position in counts modulo 2^32, if it has come.
    pub(super) position: Option<i32>,
}

impl DriveWords {
    fn or(self, other: Self) -> Self {
        Self { statusword: self.statusword.or(other.statusword), position: self.position.or(other.position) }
    }
}

/// What a drive is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct DriveOrders {
    /// Controlword.
    pub(super) controlword: u16,
    /// Target in the unit of the command mode: counts modulo 2^32, counts/s, or per mille of the rated torque.
    pub(super) target: i32,
}

/// What has come over the networks since the last cycle.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Arrived {
    /// Words of the left and of the right drive.
    pub(super) drives: [DriveWords; 2],
    /// The newest sample of the force sensor, if one has come.
    pub(super) sample: Option<RawSample>,
    /// What happened on the networks.
    pub(super) link: LinkEvents,
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
    /// Of a drive that has to be homed: its homing, and the angle in rad at which its joint is taken to be until it is.
    pub home: Option<(Homing, f64)>,
}

/// How far a drive is with homing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HomingState {
    /// Whether its position refers to home; always of a drive that needs no homing.
    pub is_referenced: bool,
    /// Home was found, and the drive stands. It tells that in homing mode alone.
    pub is_over: bool,
    /// It has given up. It tells that in homing mode alone.
    pub has_failed: bool,
}

/// A drive as the cycle sees it.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    scaling: AxisScaling,
    /// Counts at the angle near which each position is unwrapped.
    expected_counts: i64,
    home: Option<(Homing, f64)>,
    /// Of a drive that is not homed: what its angles are shifted by, so that its joint was where it is taken to be. Rad.
    shift_rad: Option<f64>,
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
        (self.shift_rad, self.is_homing) = (None, false);
    }

    /// How far the drive is with homing.
    ///
    /// Real-time: yes.
    pub(super) fn homing(&self) -> HomingState {
        let over = Statusword::HOMING_ATTAINED | Statusword::TARGET_REACHED;
        HomingState {
            is_referenced: self.is_referenced(),
            is_over: self.statusword.has(over),
            has_failed: self.statusword.has(Statusword::HOMING_ERROR),
        }
    }

    /// Asks a drive in homing mode to home as long as it is in Operation Enabled, or no more.
    ///
    /// Real-time: yes.
    pub(super) fn set_homing(&mut self, is_homing: bool) {
        self.is_homing = is_homing;
    }

    fn is_referenced(&self) -> bool {
        self.home.as_ref().is_none_or(|(homing, _)| homing.is_referenced(self.statusword.0))
    }

    /// What the words say, in SI. A statusword that has not come is the last one.
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
        match &self.home {
            Some((_, taken_rad)) if !self.is_referenced() => {
                let shift_rad = *self.shift_rad.get_or_insert_with(|| {
                    self.unwrapper = CountUnwrapper::near(position.into());
                    taken_rad - self.scaling.angle_rad(position.into())
                });
                self.scaling.angle_rad(self.unwrapper.unwrap(position)) + shift_rad
            }
            _ => {
                self.shift_rad = None;
                // From the expected angle each time: a corrupted report leaves no wrong turn behind.
                self.unwrapper = CountUnwrapper::near(self.expected_counts);
                self.scaling.angle_rad(self.unwrapper.unwrap(position))
            }
        }
    }

    /// The position at which the drive is told a joint angle in rad, counts.
    fn position(&self, angle_rad: f64) -> i32 {
        let counts = self.scaling.counts(angle_rad - self.shift_rad.unwrap_or_default());
        wrap(counts.unwrap_or(self.unwrapper.counts()))
    }

    /// What is known of the drive while no position has come.
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

    /// Drops a reset that could not be sent: what fails in the meantime was not seen by the person who asked.
    pub(super) fn cancel_fault_reset(&mut self) {
        self.walk.cancel_fault_reset();
    }

    /// One step towards `goal`.
    fn order(&mut self, goal: Goal, target: i32) -> DriveOrders {
        self.walk.set_goal(goal);
        let mut word = self.walk.step(self.statusword).controlword;
        let is_enabled = self.statusword.state() == Some(State::OperationEnabled);
        if self.is_homing && is_enabled && Command::decode(word) == Command::EnableOperation {
            word |= controlword::START_HOMING;
        }
        DriveOrders { controlword: word, target }
    }
}

/// The controlwords that bring a drive that is heard and follows each of them from the end of the boot to Operation Enabled, each once, in their
/// order: what keeps it waiting, and what then enables it.
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

/// What both drives are sent: each one step towards `goal`, with its share of `command`. Only a command that the guard has allowed becomes a
/// target. A value that cannot be scaled keeps the joint where it is.
///
/// Real-time: yes.
pub(super) fn orders(axes: &mut [Axis; 2], goal: Goal, command: &Allowed<JointCommand>) -> [DriveOrders; 2] {
    let [left, right] = axes;
    let mut each = |values: [f64; 2], scale: &dyn Fn(&Axis, f64) -> i32| {
        let [left_value, right_value] = values;
        let targets = [scale(left, left_value), scale(right, right_value)];
        [left.order(goal, targets[0]), right.order(goal, targets[1])]
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
