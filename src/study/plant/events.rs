//! The reference: the arm of the study, integrated by a fourth-order Runge-Kutta method from event to event, with the
//! joints that stick held explicitly.
//!
//! It shares no code with the simulation. The equations of motion are those of [`super::machine`], and the holding torque decides
//! which joints stick. It looks for events at the end of each trial step only, so it misses a joint that stops and turns back, or
//! almost breaks away, within one.

use nalgebra::{Matrix2, Vector2};

use super::machine::{StudyArm, inverse};
use super::scene::Plant;
use yieldwall_sim::arm::ArmError;
use yieldwall_sim::hand::HandLoad;

/// Motion of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Mode {
    Stick,
    /// Slips in the direction of this sign.
    Slip(f64),
}

const MODES: [Mode; 3] = [Mode::Stick, Mode::Slip(1.0), Mode::Slip(-1.0)];

/// The study arm, its state and what pulls at its tool, given time in s and tool point in m.
#[derive(Clone, Debug)]
pub struct Events<F> {
    arm: StudyArm,
    load: F,
    time_s: f64,
    angles: Vector2<f64>,
    rates: Vector2<f64>,
    torque: Vector2<f64>,
    mode: [Mode; 2],
    events: u32,
}

type State = (Vector2<f64>, Vector2<f64>);

impl<F: Fn(f64, Vector2<f64>) -> HandLoad<2>> Plant for Events<F> {
    /// Trial steps are no longer than `step_s`.
    fn run_to(&mut self, end_s: f64, step_s: f64, torque_n_m: Vector2<f64>) -> Result<(), ArmError> {
        let start_s = self.time_s;
        self.torque = torque_n_m;
        self.choose_modes([false; 2]);
        while end_s - self.time_s > 1e-15 {
            let step = step_s.min(end_s - self.time_s);
            let state = self.trial(step);
            if !state.0.iter().chain(state.1.iter()).all(|value| value.is_finite()) {
                return Err(ArmError::NotFinite { time_s: start_s });
            }
            match (0..2).find(|&joint| self.has_event(joint, step, &state)) {
                None => self.accept(step, state),
                Some(_) => self.run_to_event(step),
            }
        }
        self.time_s = end_s;
        Ok(())
    }

    fn angles(&self) -> Vector2<f64> {
        self.angles
    }

    fn rates(&self) -> Vector2<f64> {
        self.rates
    }
}

impl<F: Fn(f64, Vector2<f64>) -> HandLoad<2>> Events<F> {
    /// At rest at these joint angles in rad at time zero.
    pub fn new(arm: StudyArm, start: Vector2<f64>, load: F) -> Self {
        let (rates, torque) = (Vector2::zeros(), Vector2::zeros());
        Self { arm, load, time_s: 0.0, angles: start, rates, torque, mode: [Mode::Stick; 2], events: 0 }
    }

    /// How often a joint has stopped, turned or broken away.
    pub fn count(&self) -> u32 {
        self.events
    }

    fn run_to_event(&mut self, step: f64) {
        let (mut before, mut after) = (0.0, step);
        while after - before > 1e-16 {
            let middle = 0.5 * (before + after);
            if middle <= before || middle >= after {
                break;
            }
            let state = self.trial(middle);
            if (0..2).any(|joint| self.has_event(joint, middle, &state)) {
                after = middle;
            } else {
                before = middle;
            }
        }
        let state = self.trial(after);
        let hit = [0, 1].map(|joint| self.has_event(joint, after, &state));
        let broke_away = [0, 1].map(|joint| hit[joint] && self.mode[joint] == Mode::Stick);
        let was = self.mode;
        self.accept(after, state);
        for joint in 0..2 {
            if hit[joint] {
                self.rates[joint] = 0.0;
                if let Mode::Slip(_) = was[joint] {
                    self.mode[joint] = Mode::Stick;
                }
            }
        }
        self.events += 1;
        self.choose_modes(broke_away);
    }

    fn accept(&mut self, step: f64, (angles, rates): State) {
        self.time_s += step;
        self.angles = angles;
        self.rates = rates;
    }

    /// A slipping joint has turned round, or a sticking one needs more torque than friction gives.
    fn has_event(&self, joint: usize, step: f64, state: &State) -> bool {
        match self.mode[joint] {
            Mode::Slip(sign) => state.1[joint] * sign < 0.0,
            Mode::Stick => self.holding(self.time_s + step, state, self.mode)[joint].abs() > self.arm.coulomb_n_m,
        }
    }

    /// For joints at rest: the consistent one of all combinations of holding and breaking away. `breaking` joints do
    /// not hold.
    fn choose_modes(&mut self, breaking: [bool; 2]) {
        let state = (self.angles, self.rates);
        let is_choice = |joint: usize, mode: Mode| match mode {
            Mode::Stick => self.rates[joint] == 0.0 && !breaking[joint],
            Mode::Slip(sign) => self.rates[joint] == 0.0 || self.rates[joint].signum() == sign,
        };
        // By how much a combination is in contradiction to itself; zero for the right one but for rounding.
        let contradiction = |mode: [Mode; 2]| -> f64 {
            let acceleration = self.acceleration(self.time_s, &state, mode);
            let holding = self.holding(self.time_s, &state, mode);
            let of = |joint: usize| match mode[joint] {
                Mode::Stick => (holding[joint].abs() - self.arm.coulomb_n_m).max(0.0),
                Mode::Slip(sign) if self.rates[joint] == 0.0 => (-sign * acceleration[joint]).max(0.0),
                Mode::Slip(_) => 0.0,
            };
            of(0) + of(1)
        };
        let mut least = f64::INFINITY;
        let mut best = self.mode;
        for first in MODES {
            for second in MODES {
                if is_choice(0, first) && is_choice(1, second) {
                    let size = contradiction([first, second]);
                    if size < least {
                        (least, best) = (size, [first, second]);
                    }
                }
            }
        }
        self.mode = best;
    }

    /// Torque that friction would have to give to hold the joints that stick; zero for the others.
    fn holding(&self, time: f64, state: &State, mode: [Mode; 2]) -> Vector2<f64> {
        let acceleration = self.acceleration(time, state, mode);
        let (mass, pull) = self.pull(time, state, mode);
        let rest = pull - mass * acceleration;
        Vector2::from_fn(|joint, _| if mode[joint] == Mode::Stick { rest[joint] } else { 0.0 })
    }

    fn pull(&self, time: f64, &(angles, rates): &State, mode: [Mode; 2]) -> (Matrix2<f64>, Vector2<f64>) {
        let motion = self.arm.motion(angles, rates);
        let load = (self.load)(time, motion.tip);
        let force = load.force_n - motion.jacobian * rates * load.damping_n_s_per_m;
        let mut pull =
            self.torque - motion.bias - rates * self.arm.viscous_n_m_s_per_rad + motion.jacobian.transpose() * force;
        for joint in 0..2 {
            if let Mode::Slip(sign) = mode[joint] {
                pull[joint] -= sign * self.arm.coulomb_n_m;
            }
        }
        (motion.mass, pull)
    }

    fn acceleration(&self, time: f64, state: &State, mode: [Mode; 2]) -> Vector2<f64> {
        let (mass, pull) = self.pull(time, state, mode);
        match mode {
            [Mode::Stick, Mode::Stick] => Vector2::zeros(),
            [Mode::Stick, Mode::Slip(_)] => Vector2::new(0.0, pull.y / mass.m22),
            [Mode::Slip(_), Mode::Stick] => Vector2::new(pull.x / mass.m11, 0.0),
            [Mode::Slip(_), Mode::Slip(_)] => inverse(&mass) * pull,
        }
    }

    /// Classic fourth-order step in the present modes.
    fn trial(&self, step: f64) -> State {
        let derivative =
            |after: f64, state: State| (state.1, self.acceleration(self.time_s + after, &state, self.mode));
        let from = (self.angles, self.rates);
        let moved = |by: State, time: f64| (from.0 + by.0 * time, from.1 + by.1 * time);
        let first = derivative(0.0, from);
        let second = derivative(0.5 * step, moved(first, 0.5 * step));
        let third = derivative(0.5 * step, moved(second, 0.5 * step));
        let fourth = derivative(step, moved(third, step));
        let mean = |a: Vector2<f64>, b: Vector2<f64>, c: Vector2<f64>, d: Vector2<f64>| (a + (b + c) * 2.0 + d) / 6.0;
        moved((mean(first.0, second.0, third.0, fourth.0), mean(first.1, second.1, third.1, fourth.1)), step)
    }
}
