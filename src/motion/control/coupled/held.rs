//! One loop at one pose and one phase of the sensor, followed from event to event.

use crate::elementary;
use nalgebra::{DMatrix, Matrix2, Matrix6, SMatrix, SVector, Schur, Vector2};

use super::super::error::{ControlError, not_negative, positive};
use super::super::{Gains, principal_inertias};
use super::exponential::exponential;
use super::{Compensation, Follower, Gears, Grip, Outer, Pose, Sampling, inverse_jacobian};

/// Most cycles after which sensor and cycle have to be together again.
const MOST_CYCLES: usize = 32;
/// Share by which the sensor's interval may be bent for that: its phase then drifts by a period in a thousand.
const BENT: f64 = 1e-3;
/// Iterations within which the eigenvalues of a small matrix are found.
const SCHUR_ITERATIONS: usize = 10_000;
/// Entries from here on, squared and added, may overflow.
const GREATEST_ENTRY: f64 = 1e150;
/// Events nearer to each other than this are of one moment, s.
const MOMENT_S: f64 = 1e-12;

/// Delay from an event to the first sample that shows its effect, in phases of a cycle.
const BEHIND: f64 = 1e-6;

/// Places of the state, two components each. The first three are moved on together, with elastic gears position and rate of the links too,
/// which follow on the samples.
const POSITION: usize = 0;
const RATE: usize = 2;
const EFFORT: usize = 4;
/// The last reference and the two before.
const LAST: usize = 6;
const EARLIER: usize = 8;
const EARLIEST: usize = 10;
/// Input force of the fixture.
const FORCE: usize = 12;
/// State of a servo of the host: encoders of this SYNC, last error, sum of errors; efforts on their way follow at the end.
const ENCODER: usize = 14;
const ERROR: usize = 16;
const SUM: usize = 18;
/// State of a servo of the drive: ends of its line, and its integral.
const FROM: usize = 14;
const TO: usize = 16;
const INTEGRAL: usize = 18;
/// State of a servo of the drive that follows a rate: encoders of this SYNC, its set-point and its integral. The computed rate and the
/// acting rate are at the end.
const SETPOINT: usize = 16;
/// Samples that were felt, the newest first.
const SAMPLES: usize = 20;

/// Event in a cycle. Events of one moment happen in this order.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
enum Event {
    /// A sample is taken.
    Feel,
    /// Encoders are read, and what was computed is applied.
    Sync,
    /// The fixture steps, with the sample that is this many behind the newest.
    Compute { behind: usize, is_new: bool },
    /// The computed efforts act, for a servo of the host whose efforts do not wait for a SYNC.
    Act,
    /// The drive's loop: so much of the cycle has passed, and so much time since its last sample, s.
    Tick { share: f64, elapsed_s: f64 },
    /// Arm and hand move on, by the propagator of this number.
    Advance(usize),
}

/// Arm with hand under its servo, the way of the force to the reference, and the order of events at one phase of the sensor.
#[derive(Clone, Debug)]
pub struct HeldLoop {
    follower: Follower,
    gains: Gains,
    period_s: f64,
    damping_n_s_per_m: f64,
    handle_kg: f64,
    compensation: Option<Compensation>,
    /// `alpha` of the low pass.
    taken: f64,
    forward_mass: Matrix2<f64>,
    forward_viscous: Matrix2<f64>,
    body: Body,
    events: Vec<Event>,
    samples: usize,
    /// Efforts that are on their way.
    waiting: usize,
    /// Whether efforts act at a moment of their own and not at SYNC.
    acts_between: bool,
    size: usize,
}

/// Motion of arm and hand between two events under a held effort.
#[derive(Clone, Debug)]
enum Body {
    /// Position, rate, effort.
    Rigid(Box<Motion<6>>),
    /// Position, rate, effort, and position and rate of the links.
    Elastic(Box<Motion<10>>),
}

#[derive(Clone, Debug)]
struct Motion<const N: usize> {
    rates: SMatrix<f64, N, N>,
    /// Force that is felt, `J^-1 F`: what the reference takes, in the coordinates of the controllers, in which the hand is the same
    /// everywhere.
    felt: SMatrix<f64, 2, N>,
    /// The state after each of the lengths that there are between events.
    after: Vec<SMatrix<f64, N, N>>,
}

impl<const N: usize> Motion<N> {
    /// Returns the place behind which the sensor is, with its rate next to it.
    fn new(rates: SMatrix<f64, N, N>, grip: &Grip, handle_kg: f64, place: usize) -> Self {
        let mut felt = rates.fixed_view::<2, N>(place + 2, 0) * -(grip.mass_kg + handle_kg);
        for axis in 0..2 {
            felt[(axis, place + axis)] -= grip.stiffness_n_per_m;
            felt[(axis, place + 2 + axis)] -= grip.damping_n_s_per_m;
        }
        Self { rates, felt, after: Vec::new() }
    }

    fn push(&mut self, length_s: f64) {
        self.after.push(exponential(&(self.rates * length_s)));
    }
}

impl Body {
    fn new(pose: &Pose, grip: &Grip, handle_kg: f64) -> Result<Self, ControlError> {
        let not_definite = ControlError::NotPositiveDefinite { least: 0.0, asymmetry: 0.0 };
        let weight = pose.jacobian.tr_mul(&pose.jacobian);
        let [spring, damper, hand] =
            [grip.stiffness_n_per_m, grip.damping_n_s_per_m, grip.mass_kg].map(|size| weight * size);
        let Some(Gears { motor, stiffness, damping }) = pose.gears else {
            let mobility = (pose.mass + hand).try_inverse().ok_or(not_definite)?;
            let mut rates = Matrix6::zeros();
            let mut put =
                |row, column, block: Matrix2<f64>| rates.fixed_view_mut::<2, 2>(row, column).copy_from(&block);
            put(POSITION, RATE, Matrix2::identity());
            put(RATE, POSITION, -mobility * spring);
            put(RATE, RATE, -mobility * (pose.viscous + damper));
            put(RATE, EFFORT, mobility);
            return Ok(Self::Rigid(Box::new(Motion::new(rates, grip, handle_kg, POSITION))));
        };
        principal_inertias(&motor)?;
        principal_inertias(&(pose.mass - motor))?;
        let of_motor = motor.try_inverse().ok_or(not_definite)?;
        let of_link = (pose.mass - motor + hand).try_inverse().ok_or(not_definite)?;
        let mut rates = SMatrix::<f64, 10, 10>::zeros();
        let mut put = |row, column, block: Matrix2<f64>| rates.fixed_view_mut::<2, 2>(row, column).copy_from(&block);
        let (link, link_rate) = (EFFORT + 2, EFFORT + 4);
        put(POSITION, RATE, Matrix2::identity());
        put(RATE, POSITION, -of_motor * stiffness);
        put(RATE, RATE, -of_motor * (pose.viscous + damping));
        put(RATE, EFFORT, of_motor);
        put(RATE, link, of_motor * stiffness);
        put(RATE, link_rate, of_motor * damping);
        put(link, link_rate, Matrix2::identity());
        put(link_rate, POSITION, of_link * stiffness);
        put(link_rate, RATE, of_link * damping);
        put(link_rate, link, -of_link * (stiffness + spring));
        put(link_rate, link_rate, -of_link * (damping + damper));
        Ok(Self::Elastic(Box::new(Motion::new(rates, grip, handle_kg, link))))
    }

    fn push(&mut self, length_s: f64) {
        match self {
            Self::Rigid(motion) => motion.push(length_s),
            Self::Elastic(motion) => motion.push(length_s),
        }
    }

    /// Entries of the state beside the first six.
    fn further(&self) -> usize {
        match self {
            Self::Rigid(_) => 0,
            Self::Elastic(_) => 4,
        }
    }

    /// Moves a state on, whose further entries begin at `link`.
    fn advance(&self, number: usize, link: usize, state: &mut [f64]) {
        match self {
            Self::Rigid(motion) => {
                let after = motion.after[number] * SVector::<f64, 6>::from_column_slice(&state[..6]);
                state[..6].copy_from_slice(after.as_slice());
            }
            Self::Elastic(motion) => {
                let after = motion.after[number] * with_links(link, state);
                state[..6].copy_from_slice(&after.as_slice()[..6]);
                state[link..link + 4].copy_from_slice(&after.as_slice()[6..]);
            }
        }
    }

    fn feel(&self, link: usize, state: &[f64]) -> Vector2<f64> {
        match self {
            Self::Rigid(motion) => motion.felt * SVector::<f64, 6>::from_column_slice(&state[..6]),
            Self::Elastic(motion) => motion.felt * with_links(link, state),
        }
    }
}

fn with_links(link: usize, state: &[f64]) -> SVector<f64, 10> {
    SVector::from_fn(|place, _| state[if place < 6 { place } else { link + place - 6 }])
}

impl HeldLoop {
    /// Builds the loop at `phase`, one of [`Sampling::phases`]. Phase 0 has samples right behind SYNC, the last phase has samples as old as
    /// they may be.
    ///
    /// The loop is exact for joints without dry friction and efforts without limit, with one exception. The interval of a sensor is changed
    /// by up to a thousandth where it fits no small number of cycles.
    ///
    /// # Errors
    /// [`ControlError::OutOfRange`] for a number that is not finite or outside its range; [`ControlError::NotPositiveDefinite`] for a mass
    /// matrix or a Jacobian that is not positive definite.
    pub fn new(follower: &Follower, pose: &Pose, grip: &Grip, outer: &Outer, phase: u32) -> Result<Self, ControlError> {
        let phases = outer.checked()?.sampling.phases;
        Self::at(follower, pose, grip, outer, f64::from(phase % phases) / f64::from(phases - 1).max(1.0))
    }

    /// Returns the loop at any share of the way from the first phase, 0, to the last one, 1; all the same where there is one phase.
    ///
    /// # Errors
    /// As [`HeldLoop::new`].
    pub fn at(follower: &Follower, pose: &Pose, grip: &Grip, outer: &Outer, share: f64) -> Result<Self, ControlError> {
        let gains = follower.checked()?;
        positive("stiffness of the hand", grip.stiffness_n_per_m)?;
        not_negative("damping of the hand", grip.damping_n_s_per_m)?;
        not_negative("mass of the hand", grip.mass_kg)?;
        principal_inertias(&pose.mass)?;
        let outer = outer.checked()?;
        inverse_jacobian(pose)?;
        let mut one = Self {
            follower: *follower,
            gains,
            period_s: outer.period_s,
            damping_n_s_per_m: outer.damping_n_s_per_m,
            handle_kg: outer.handle_kg,
            compensation: outer.compensation,
            taken: 1.0 - outer.remembered(),
            forward_mass: pose.forward_mass,
            forward_viscous: pose.forward_viscous,
            body: Body::new(pose, grip, outer.handle_kg)?,
            events: Vec::new(),
            samples: 1,
            waiting: 0,
            acts_between: false,
            size: 0,
        };
        one.plan(outer.sampling, share)?;
        Ok(one)
    }

    /// Whether this virtual mass, positive, is stable with this hand.
    pub fn is_stable(&self, mass_kg: f64) -> bool {
        self.spectral_radius(mass_kg).is_some_and(|radius| radius < 1.0)
    }

    /// Returns the greatest modulus of an eigenvalue of the map of the state over the common period of cycle and sensor; `None` if they
    /// were not found.
    pub fn spectral_radius(&self, mass_kg: f64) -> Option<f64> {
        let mut map = self.map(mass_kg);
        // Balancing halves and doubles until norms are alike, and never ends with one that is infinite.
        if !map.iter().all(|entry| entry.abs() < GREATEST_ENTRY) {
            return None;
        }
        nalgebra::linalg::balancing::balance_parlett_reinsch(&mut map);
        let poles = Schur::try_new(map, f64::EPSILON, SCHUR_ITERATIONS)?.complex_eigenvalues();
        let radius = poles.iter().map(|pole| elementary::hypot(pole.re, pole.im)).fold(0.0, f64::max);
        radius.is_finite().then_some(radius)
    }

    /// Returns the map over the common period of those parts of the state that it is given and hands on. The others add eigenvalues of
    /// zero.
    fn map(&self, mass_kg: f64) -> DMatrix<f64> {
        let mut map = DMatrix::identity(self.size, self.size);
        for mut state in map.column_iter_mut() {
            self.follow(mass_kg, state.as_mut_slice());
        }
        let mut parts: Vec<usize> = (0..self.size).collect();
        loop {
            let is_given = |&part: &usize| parts.iter().any(|&other| map[(other, part)] != 0.0);
            let hands_on = |&part: &usize| parts.iter().any(|&other| map[(part, other)] != 0.0);
            let left: Vec<usize> = parts.iter().copied().filter(|part| is_given(part) && hands_on(part)).collect();
            if left.len() == parts.len() {
                return map.select_rows(&parts).select_columns(&parts);
            }
            parts = left;
        }
    }

    /// Puts the events of the common period in order.
    fn plan(&mut self, sampling: Sampling, share: f64) -> Result<(), ControlError> {
        let period_s = self.period_s;
        let (cycles, interval_s) = common_period(period_s, sampling.interval_s);
        let end_s = cycles as f64 * period_s;
        // Other phases of the clock come back to the same pattern, begun at another cycle. Two are worse than others: the one that
        // has samples right behind SYNC, where what is applied shakes the hand's mass, and the one whose oldest sample has just
        // missed its cycle.
        let apart_s = interval_s / cycles as f64;
        let age_s = if sampling.phases == 1 {
            sampling.oldest_s
        } else if share >= 1.0 {
            // One that is taken in the moment of SYNC sees what SYNC did.
            sampling.oldest_s - BEHIND * apart_s
        } else {
            let age_s = ((sampling.oldest_s / apart_s + BEHIND).floor() - share - BEHIND) * apart_s;
            if age_s <= sampling.oldest_s - apart_s { age_s + apart_s } else { age_s }
        };
        let least_age_s = sampling.oldest_s - interval_s;
        let felt_at = |sample: i64| sample as f64 * interval_s - age_s;
        // The newest sample that is older than the least age.
        let used_in = |cycle: i64| {
            let waited = (cycle as f64 * period_s + age_s - least_age_s) / interval_s;
            (waited - 1e-9).ceil() as i64 - 1
        };
        let mut acts_s = None;
        if let Follower::Host { delay_cycles, .. } = self.follower {
            if !(0.0..=Follower::MOST_DELAY).contains(&delay_cycles) {
                let requirement = "0 to Follower::MOST_DELAY";
                return Err(ControlError::OutOfRange { name: "delay in cycles", value: delay_cycles, requirement });
            }
            let share = delay_cycles.fract();
            (self.waiting, self.acts_between) = (delay_cycles.ceil() as usize, share > 0.0);
            acts_s = self.acts_between.then_some(share * period_s);
        }
        if let Follower::Rate { gain_per_s, .. } = self.follower {
            positive("rate gain", gain_per_s)?;
            self.waiting = 2;
        }
        let newest_at = |time_s: f64| ((time_s + age_s) / interval_s + 1e-9).floor() as i64;
        let mut events: Vec<(f64, Event)> = Vec::new();
        let mut sample = newest_at(-2.0 * MOMENT_S - 1e-9 * interval_s) + 1;
        while felt_at(sample) < end_s - MOMENT_S {
            events.push((felt_at(sample).max(0.0), Event::Feel));
            sample += 1;
        }
        for cycle in 0..cycles as i64 {
            let sync_s = cycle as f64 * period_s;
            events.push((sync_s, Event::Sync));
            let used = used_in(cycle);
            let compute_s = sync_s.max(felt_at(used));
            let behind = usize::try_from(newest_at(compute_s) - used).unwrap_or(0);
            self.samples = self.samples.max(behind + 1);
            events.push((compute_s, Event::Compute { behind, is_new: used != used_in(cycle - 1) }));
            // What is computed late in a cycle cannot act before.
            events.extend(acts_s.map(|since_s| ((sync_s + since_s).max(compute_s), Event::Act)));
            if let Follower::Drive { period_s: tick_s, .. } | Follower::Rate { period_s: tick_s, .. } = self.follower {
                positive("period of the drives' loop", tick_s)?;
                let ticks = (period_s / tick_s - 1e-9).ceil().max(1.0) as u32;
                let left_s = period_s - f64::from(ticks - 1) * tick_s;
                events.extend((0..ticks).map(|tick| {
                    let since_s = f64::from(tick) * tick_s;
                    let elapsed_s = if tick == 0 { left_s } else { tick_s };
                    (sync_s + since_s, Event::Tick { share: since_s / period_s, elapsed_s })
                }));
            }
        }
        let is_same = |one: f64, other: f64| (one - other).abs() < MOMENT_S;
        events.sort_by(|(one_s, one), (other_s, other)| {
            let by_kind = one.partial_cmp(other).unwrap_or(std::cmp::Ordering::Equal);
            if is_same(*one_s, *other_s) { by_kind } else { one_s.total_cmp(other_s) }
        });
        let mut lengths_s: Vec<f64> = Vec::new();
        let mut now_s = 0.0;
        for (time_s, event) in events.into_iter().map(|(time_s, event)| (time_s, Some(event))).chain([(end_s, None)]) {
            if time_s - now_s > MOMENT_S {
                let length_s = time_s - now_s;
                let number = lengths_s.iter().position(|known| is_same(*known, length_s)).unwrap_or_else(|| {
                    self.body.push(length_s);
                    lengths_s.push(length_s);
                    lengths_s.len() - 1
                });
                self.events.push(Event::Advance(number));
                now_s = time_s;
            }
            self.events.extend(event);
        }
        let compensating = if self.compensation.is_some() { 6 } else { 0 };
        self.size = SAMPLES + 2 * (self.samples + self.waiting) + self.body.further() + compensating;
        Ok(())
    }

    /// Moves a state on by the common period.
    fn follow(&self, mass_kg: f64, state: &mut [f64]) {
        let link = SAMPLES + 2 * self.samples;
        for event in &self.events {
            match *event {
                Event::Advance(number) => self.body.advance(number, link, state),
                Event::Feel => {
                    let felt = self.body.feel(link, state);
                    state.copy_within(SAMPLES..link - 2, SAMPLES + 2);
                    put(state, SAMPLES, felt);
                }
                Event::Sync => self.apply(state),
                Event::Act => put(state, EFFORT, pair(state, self.size - 2)),
                Event::Compute { behind, is_new } => {
                    if is_new {
                        let [last, earlier, earliest] = [LAST, EARLIER, EARLIEST].map(|place| pair(state, place));
                        let acceleration = (last - earlier * 2.0 + earliest) / (self.period_s * self.period_s);
                        let handle = acceleration * self.handle_kg + self.compensated(state);
                        let hand = pair(state, SAMPLES + 2 * behind) + handle;
                        let force = pair(state, FORCE);
                        put(state, FORCE, force + (hand - force) * self.taken);
                    }
                    self.compute(mass_kg, state);
                }
                Event::Tick { share, elapsed_s } => self.tick(share, elapsed_s, state),
            }
        }
        if self.follower.has_no_position() {
            let last = pair(state, LAST);
            for place in [LAST, EARLIER, EARLIEST, ERROR] {
                put(state, place, pair(state, place) - last);
            }
        }
    }

    /// Returns the place of the encoders of the last SYNC, of their filtered rate and of the force of the compensation.
    fn compensation_place(&self) -> usize {
        SAMPLES + 2 * self.samples + self.body.further()
    }

    fn compensated(&self, state: &[f64]) -> Vector2<f64> {
        self.compensation.map_or_else(Vector2::zeros, |_| pair(state, self.compensation_place() + 4))
    }

    fn compensate(&self, state: &mut [f64]) {
        let Some(Compensation { mass_kg, time_constant_s }) = self.compensation else { return };
        let (t, place) = (self.period_s, self.compensation_place());
        let (now, last, filtered) = (pair(state, POSITION), pair(state, place), pair(state, place + 2));
        let change = ((now - last) / t - filtered) * -elementary::exp_m1(-t / time_constant_s);
        put(state, place, now);
        put(state, place + 2, filtered + change);
        put(state, place + 4, change * (mass_kg / t));
    }

    fn apply(&self, state: &mut [f64]) {
        self.compensate(state);
        match self.follower {
            Follower::Host { .. } => {
                put(state, ENCODER, pair(state, POSITION));
                if self.waiting > 0 && !self.acts_between {
                    put(state, EFFORT, pair(state, self.size - 2));
                }
            }
            Follower::Drive { .. } => {
                put(state, FROM, pair(state, TO));
                put(state, TO, pair(state, LAST));
            }
            Follower::Rate { .. } => {
                put(state, ENCODER, pair(state, POSITION));
                put(state, self.size - 2, pair(state, self.size - 4));
            }
        }
    }

    fn compute(&self, mass_kg: f64, state: &mut [f64]) {
        let t = self.period_s;
        let (last, earlier) = (pair(state, LAST), pair(state, EARLIER));
        let inert = mass_kg + self.damping_n_s_per_m * t;
        let next = last + (last - earlier) * (mass_kg / inert) + pair(state, FORCE) * (t * t / inert);
        put(state, EARLIEST, earlier);
        put(state, EARLIER, last);
        put(state, LAST, next);
        match self.follower {
            Follower::Host { .. } => {}
            Follower::Drive { .. } => return,
            Follower::Rate { gain_per_s, .. } => {
                let rate = (next - last) / t + (next - pair(state, ENCODER)) * gain_per_s;
                return put(state, self.size - 4, rate);
            }
        }
        let Gains { stiffness, damping, integral } = self.gains;
        let error = next - pair(state, ENCODER);
        let change = error - pair(state, ERROR);
        put(state, ERROR, error);
        let mut effort = error * stiffness
            + change * (damping / t)
            + self.forward_mass * (next - last * 2.0 + earlier) / (t * t)
            + self.forward_viscous * (next - last) / t;
        if integral > 0.0 {
            let sum = pair(state, SUM) + error * t;
            put(state, SUM, sum);
            effort += sum * integral;
        } else {
            put(state, SUM, Vector2::zeros());
        }
        if self.waiting == 0 {
            return put(state, EFFORT, effort);
        }
        let first = self.size - 2 * self.waiting;
        state.copy_within(first..self.size - 2, first + 2);
        put(state, first, effort);
    }

    fn tick(&self, share: f64, elapsed_s: f64, state: &mut [f64]) {
        let Gains { stiffness, damping, integral } = self.gains;
        let (aim, rate) = if let Follower::Rate { .. } = self.follower {
            let rate = pair(state, self.size - 2);
            let aim = pair(state, SETPOINT) + rate * elapsed_s;
            put(state, SETPOINT, aim);
            (aim, rate)
        } else {
            let way = pair(state, TO) - pair(state, FROM);
            (pair(state, FROM) + way * share, way / self.period_s)
        };
        let error = aim - pair(state, POSITION);
        let sum = pair(state, INTEGRAL);
        put(state, EFFORT, error * stiffness + (rate - pair(state, RATE)) * damping + sum);
        // Without an integral nothing is to remain of it: what stays as it is would be a pole at one.
        let kept = if integral > 0.0 { sum } else { Vector2::zeros() };
        put(state, INTEGRAL, kept + error * (integral * elapsed_s));
    }
}

/// Returns the fewest cycles after which a sensor with this interval is where it was, and the interval that makes it so.
fn common_period(period_s: f64, interval_s: f64) -> (usize, f64) {
    let bent = |cycles: usize| {
        let samples = (cycles as f64 * period_s / interval_s).round().max(1.0);
        let interval = cycles as f64 * period_s / samples;
        ((interval / interval_s - 1.0).abs(), cycles, interval)
    };
    // A sensor may be slower than the longest pattern: then one sample each.
    let most = MOST_CYCLES.max((interval_s / period_s).round() as usize);
    let mut best = bent(1);
    for cycles in 2..=most {
        if best.0 <= BENT {
            break;
        }
        let next = bent(cycles);
        if next.0 < best.0 {
            best = next;
        }
    }
    (best.1, best.2)
}

fn pair(state: &[f64], place: usize) -> Vector2<f64> {
    Vector2::new(state[place], state[place + 1])
}

fn put(state: &mut [f64], place: usize, value: Vector2<f64>) {
    state[place] = value.x;
    state[place + 1] = value.y;
}
