//! Ground truth for tests: the study arm, integrated by a fourth-order Runge-Kutta method from event to event, with
//! the joints that stick held explicitly.
//!
//! It shares no code with the arm under test: the equations of motion are the closed form for equal links, and what
//! sticks is told from the torque that holding takes. It looks for events at the end of each trial step only, so it
//! misses a joint that stops and turns back, or almost breaks away, within one.

use nalgebra::{Matrix2, Vector2};

/// Symmetric five-bar of uniform rods, elbows outward, tool at the wrist.
#[derive(Clone, Copy, Debug)]
pub(super) struct StudyArm {
    pub(super) half_base_m: f64,
    pub(super) proximal_m: f64,
    pub(super) distal_m: f64,
    pub(super) motor_kg_m2: f64,
    pub(super) proximal_kg: f64,
    pub(super) distal_kg: f64,
    pub(super) tool_kg: f64,
    pub(super) coulomb_n_m: f64,
    pub(super) viscous_n_m_s_per_rad: f64,
}

/// The arm of the study.
pub(super) const STUDY_ARM: StudyArm = StudyArm {
    half_base_m: 0.05,
    proximal_m: 0.25,
    distal_m: 0.30,
    motor_kg_m2: 0.2,
    proximal_kg: 0.8,
    distal_kg: 0.5,
    tool_kg: 0.5,
    coulomb_n_m: 10.0,
    viscous_n_m_s_per_rad: 1.0,
};

pub(super) struct Motion {
    pub(super) tip: Vector2<f64>,
    pub(super) jacobian: Matrix2<f64>,
    pub(super) mass: Matrix2<f64>,
    pub(super) bias: Vector2<f64>,
}

impl StudyArm {
    pub(super) fn motion(&self, angles: Vector2<f64>, rates: Vector2<f64>) -> Motion {
        let unit = angles.map(|angle| Vector2::new(angle.cos(), angle.sin()));
        let across = |v: Vector2<f64>| Vector2::new(-v.y, v.x);
        let base = [Vector2::new(-self.half_base_m, 0.0), Vector2::new(self.half_base_m, 0.0)];
        let elbow = [base[0] + unit[0] * self.proximal_m, base[1] + unit[1] * self.proximal_m];
        let apart = elbow[1] - elbow[0];
        let height = (self.distal_m * self.distal_m / apart.norm_squared() - 0.25).sqrt();
        let tip = (elbow[0] + elbow[1]) * 0.5 + across(apart) * height;
        let distal = [tip - elbow[0], tip - elbow[1]];
        let elbow_column = [across(unit[0]) * self.proximal_m, across(unit[1]) * self.proximal_m];
        let rows = Matrix2::new(distal[0].x, distal[0].y, distal[1].x, distal[1].y).try_inverse().unwrap();
        let jacobian = rows * Matrix2::new(distal[0].dot(&elbow_column[0]), 0.0, 0.0, distal[1].dot(&elbow_column[1]));

        let tip_velocity = jacobian * rates;
        let elbow_bias = [0, 1].map(|i| -unit[i] * (self.proximal_m * rates[i] * rates[i]));
        let along =
            |i: usize| distal[i].dot(&elbow_bias[i]) - (tip_velocity - elbow_column[i] * rates[i]).norm_squared();
        let tip_bias = rows * Vector2::new(along(0), along(1));

        let turning = self.motor_kg_m2 + (self.proximal_kg + self.distal_kg) * self.proximal_m * self.proximal_m / 3.0;
        let at_tip = self.tool_kg + 2.0 * self.distal_kg / 3.0;
        let sixth = self.distal_kg / 6.0;
        let mut mass = Matrix2::from_diagonal_element(turning) + jacobian.transpose() * jacobian * at_tip;
        let mut bias = jacobian.transpose() * (tip_bias * at_tip + (elbow_bias[0] + elbow_bias[1]) * sixth);
        for (joint, elbow) in elbow_column.iter().enumerate() {
            let mut column = Matrix2::zeros();
            column.set_column(joint, elbow);
            mass += (column.transpose() * jacobian + jacobian.transpose() * column) * sixth;
            bias += column.transpose() * tip_bias * sixth;
        }
        Motion { tip, jacobian, mass, bias }
    }

    /// Joint angles that hold the tool at `tip`, elbows outward.
    pub(super) fn inverse(&self, tip: Vector2<f64>) -> Vector2<f64> {
        let angle = |base_x: f64, side: f64| {
            let reach = tip - Vector2::new(base_x, 0.0);
            let (l1, l2) = (self.proximal_m, self.distal_m);
            let cos = (reach.norm_squared() + l1 * l1 - l2 * l2) / (2.0 * l1 * reach.norm());
            reach.y.atan2(reach.x) + side * cos.acos()
        };
        Vector2::new(angle(-self.half_base_m, 1.0), angle(self.half_base_m, -1.0))
    }
}

/// What a joint does.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Mode {
    Stick,
    /// Slips in the direction of this sign.
    Slip(f64),
}

/// The study arm with its state. `load(time, tip, tip velocity)` is the force on the tool.
pub(super) struct Oracle<F> {
    arm: StudyArm,
    load: F,
    pub(super) time_s: f64,
    pub(super) angles: Vector2<f64>,
    pub(super) rates: Vector2<f64>,
    torque: Vector2<f64>,
    mode: [Mode; 2],
    /// Times that a joint stopped, turned or broke away.
    pub(super) events: u32,
}

type State = (Vector2<f64>, Vector2<f64>);

impl<F: Fn(f64, Vector2<f64>, Vector2<f64>) -> Vector2<f64>> Oracle<F> {
    /// At rest.
    pub(super) fn new(arm: StudyArm, start: Vector2<f64>, load: F) -> Self {
        let (rates, torque) = (Vector2::zeros(), Vector2::zeros());
        Self { arm, load, time_s: 0.0, angles: start, rates, torque, mode: [Mode::Stick; 2], events: 0 }
    }

    /// Runs to `end_s` in trial steps no longer than `longest_s`, under a held torque.
    pub(super) fn run_to(&mut self, end_s: f64, longest_s: f64, torque: Vector2<f64>) {
        self.torque = torque;
        self.choose_modes([false; 2]);
        while end_s - self.time_s > 1e-15 {
            let step = longest_s.min(end_s - self.time_s);
            let state = self.trial(step);
            match (0..2).find(|&joint| self.has_event(joint, step, &state)) {
                None => self.accept(step, state),
                Some(_) => self.run_to_event(step),
            }
        }
        self.time_s = end_s;
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
        let choices = |joint: usize| -> Vec<Mode> {
            if self.rates[joint] != 0.0 {
                return vec![Mode::Slip(self.rates[joint].signum())];
            }
            let mut modes = vec![Mode::Slip(1.0), Mode::Slip(-1.0)];
            if !breaking[joint] {
                modes.insert(0, Mode::Stick);
            }
            modes
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
        let (first, second) = (choices(0), choices(1));
        let all = first.iter().flat_map(|&a| second.iter().map(move |&b| [a, b]));
        let best = all.min_by(|&a, &b| contradiction(a).total_cmp(&contradiction(b)));
        self.mode = best.unwrap_or(self.mode);
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
        let force = (self.load)(time, motion.tip, motion.jacobian * rates);
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
            [Mode::Slip(_), Mode::Slip(_)] => mass.try_inverse().unwrap() * pull,
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
