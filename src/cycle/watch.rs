//! What the cycle watches over more than one cycle: energy given to the hand, chatter, and the balance of torques.

use nalgebra::Vector2;

use crate::quantity::{Force, TipPoint};

/// Time in which given energy is forgotten, s. Without it the noise of force and position would add up for ever.
const FORGETTING_S: f64 = 1.0;

/// Energy that the rig gave the hand in one go: what went through the tool to the hand, less what came back, never below
/// zero, and forgotten over a second.
///
/// The port is the tool: the sensed force of the hand, and the measured way of the tool. The work of a cycle is exact for
/// a force that changes linearly in it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct GivenEnergy {
    energy_j: f64,
    last: Option<(TipPoint, Force)>,
}

impl GivenEnergy {
    /// One cycle; the energy after it, in J.
    ///
    /// Real-time: yes.
    pub(super) fn step(&mut self, tool: TipPoint, force: Force, period_s: f64) -> f64 {
        if let Some((tool_before, force_before)) = self.last {
            let given = -0.5 * (force_before.0 + force.0).dot(&(tool.0 - tool_before.0));
            let kept = self.energy_j * (1.0 - period_s / FORGETTING_S).max(0.0);
            // `max` leaves out what is not a number.
            self.energy_j = (kept + given).max(0.0);
        }
        self.last = Some((tool, force));
        self.energy_j
    }
}

/// Half a swing of chatter, s: 10 to 100 Hz.
const HALF_SWING_S: [f64; 2] = [0.005, 0.05];
/// Speed of the reference to which a swing of chatter rises at least, m/s: 0.3 mm to and fro at 10 Hz. Under the tremor of
/// a hand the proxy stays below 2 mm/s.
const SWING_SPEED_M_PER_S: f64 = 0.02;
/// Reversals in a row that make chatter: three whole swings.
const REVERSALS: u8 = 6;
/// Cosine of the angle between two half swings, at most: to and fro along one line.
const REVERSED_COSINE: f64 = -0.5;

/// Counts how often the reference turns back on its own line.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Chatter {
    /// The greatest velocity since the last reversal.
    greatest: Vector2<f64>,
    since_s: f64,
    reversals: u8,
}

impl Chatter {
    /// One cycle of the reference; whether the reversals have come to be chatter. Counting then starts again.
    ///
    /// Real-time: yes.
    pub(super) fn step(&mut self, velocity: Vector2<f64>, period_s: f64) -> bool {
        let [shortest, longest] = HALF_SWING_S;
        self.since_s += period_s;
        if self.since_s > longest {
            self.reversals = 0;
        }
        let (speed, greatest) = (velocity.norm(), self.greatest.norm());
        if speed < SWING_SPEED_M_PER_S {
            return false;
        }
        if velocity.dot(&self.greatest) >= REVERSED_COSINE * speed * greatest {
            if speed > greatest {
                self.greatest = velocity;
            }
            return false;
        }
        let is_in_band = (shortest..=longest).contains(&self.since_s);
        self.reversals = if is_in_band { self.reversals + 1 } else { 0 };
        (self.greatest, self.since_s) = (velocity, 0.0);
        if self.reversals < REVERSALS {
            return false;
        }
        self.reversals = 0;
        true
    }
}

/// Cycles over which the balance is averaged.
const BALANCE_CYCLES: f64 = 20.0;

/// What the torques of the joints do not account for: `J^T h + tau - M a`, a running mean.
///
/// What is not in the balance is in the residual: the friction of the joints above all, so the limit lies above it. The
/// torques that act in a cycle are those sent in the cycle before. A reference that is stopped by an impact is ahead of
/// the arm for some cycles; the mean takes that out, since the arm makes up for it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Balance {
    /// Torques sent in the last cycle.
    acting: Option<Vector2<f64>>,
    mean: Vector2<f64>,
}

impl Balance {
    /// One cycle: joint torques that stand for the sensed force, the ones that the reference's motion needs, and the ones
    /// sent now, all in N m. Anything that is not known starts again from zero.
    ///
    /// Real-time: yes.
    pub(super) fn step(
        &mut self,
        hand: Option<Vector2<f64>>,
        needed: Option<Vector2<f64>>,
        sent: Option<Vector2<f64>>,
    ) {
        match (hand, needed, self.acting) {
            (Some(hand), Some(needed), Some(acting)) => {
                self.mean += (hand + acting - needed - self.mean) / BALANCE_CYCLES;
            }
            _ => self.mean = Vector2::zeros(),
        }
        self.acting = sent;
    }

    /// The mean residual of each joint in N m.
    pub(super) fn residual_n_m(&self) -> Vector2<f64> {
        self.mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::elementary;
    use proptest::prelude::*;
    use std::f64::consts::TAU;

    const T: f64 = 1e-3;

    /// The most energy over `seconds` of a tool at `x(t)` under a force `f(t)`, both along x.
    fn most_energy(seconds: f64, x: impl Fn(f64) -> f64, f: impl Fn(f64) -> f64) -> f64 {
        let mut given = GivenEnergy::default();
        let steps = (seconds / T) as u32;
        (0..steps)
            .map(|step| f64::from(step) * T)
            .map(|t| given.step(TipPoint::new(x(t), 0.0), Force::new(f(t), 0.0), T))
            .fold(0.0, f64::max)
    }

    #[test]
    fn a_hand_that_pushes_gets_nothing_and_one_that_is_pushed_gets_the_work() {
        assert_eq!(most_energy(3.0, |t| 0.1 * t, |_| 10.0), 0.0);
        // 10 N over 50 mm in 0.1 s are 0.5 J, less what is forgotten meanwhile: about 5 %.
        let pushed = most_energy(0.1, |t| -0.5 * t, |_| 10.0);
        assert!((0.46..0.5).contains(&pushed), "{pushed}");
    }

    #[test]
    fn a_spring_gives_back_what_it_got_and_a_swing_that_grows_gives_more() {
        // Half of the swing's way back is given in one go, 1/2 k A^2 = 0.05 J, and taken again.
        let swing = |t: f64| 0.01 * elementary::sin(TAU * 5.0 * t);
        let spring = most_energy(4.0, swing, |t| -1000.0 * swing(t));
        assert!((0.045..0.056).contains(&spring), "{spring}");
        // A force that lags feeds the swing: 3 J in four seconds.
        let fed = most_energy(4.0, swing, |t| -10.0 * elementary::cos(TAU * 5.0 * t));
        assert!(fed > 1.0, "{fed}");
    }

    proptest! {
        /// Noise of position and force does not add up: within a hundred times the work of one cycle, however long it lasts.
        #[test]
        fn noise_does_not_drift(noise in proptest::collection::vec((-1.0..1.0f64, -1.0..1.0f64), 20_000)) {
            let mut given = GivenEnergy::default();
            // A micrometre and a newton: work of about a microjoule.
            let most = noise.iter().map(|(x, f)| given.step(TipPoint::new(1e-6 * x, 0.0), Force::new(*f, 0.0), T));
            let most = most.fold(0.0, f64::max);
            prop_assert!(most < 1e-4, "{}", most);
        }
    }

    #[test]
    fn what_is_not_a_number_does_no_harm() {
        let mut given = GivenEnergy::default();
        for force in [1.0, f64::NAN, f64::INFINITY, 1.0, 1.0] {
            let energy = given.step(TipPoint::new(0.0, 0.0), Force::new(force, 0.0), T);
            assert_eq!(energy, 0.0);
        }
    }

    /// How often a swing at `frequency_hz` with this speed is chatter in two seconds.
    fn chatters(frequency_hz: f64, speed: f64) -> usize {
        let mut chatter = Chatter::default();
        let at = |step: u32| speed * elementary::cos(TAU * frequency_hz * f64::from(step) * T);
        (0..2000).filter(|step| chatter.step(Vector2::new(0.6 * at(*step), 0.8 * at(*step)), T)).count()
    }

    #[test]
    fn a_swing_is_chatter_in_its_band_and_from_its_speed_on() {
        for frequency in [12.0, 30.0, 60.0, 90.0] {
            assert!(chatters(frequency, 0.1) >= 3, "{frequency} Hz");
            assert_eq!(chatters(frequency, 0.019), 0, "{frequency} Hz, slow");
        }
        for frequency in [2.0, 8.0, 130.0, 250.0] {
            assert_eq!(chatters(frequency, 0.5), 0, "{frequency} Hz");
        }
        // From standing still to the first finding: four swings.
        let mut chatter = Chatter::default();
        let first = (0..1000)
            .find(|step| chatter.step(Vector2::new(0.1 * elementary::sin(TAU * 50.0 * f64::from(*step) * T), 0.0), T));
        assert!(first.is_some_and(|step| step <= 80), "{first:?}");
    }

    #[test]
    fn to_and_fro_now_and_then_is_no_chatter() {
        let mut chatter = Chatter::default();
        // Two swings at 25 Hz every 200 ms: blows that bounce.
        let is_found = (0..6000).any(|step| {
            let t = f64::from(step % 200) * T;
            let speed = if t < 0.08 { 0.3 * elementary::sin(TAU * 25.0 * t) } else { 0.0 };
            chatter.step(Vector2::new(speed, 0.0), T)
        });
        assert!(!is_found);
    }

    #[test]
    fn the_balance_is_a_mean_of_what_is_missing() {
        let one = |x: f64| Some(Vector2::new(x, -x));
        let mut balance = Balance::default();
        balance.step(one(3.0), one(5.0), one(2.0));
        assert_eq!(balance.residual_n_m(), Vector2::zeros(), "what acts is not known yet");
        for _ in 0..200 {
            balance.step(one(3.0), one(5.0), one(2.0));
        }
        assert_eq!(balance.residual_n_m(), Vector2::zeros());
        for _ in 0..20 {
            balance.step(one(13.0), one(5.0), one(2.0));
        }
        let [left, right] = balance.residual_n_m().into();
        assert!((6.0..7.0).contains(&left) && right == -left, "10 N m, two thirds after 20 cycles: {left}");
        balance.step(None, one(5.0), one(2.0));
        assert_eq!(balance.residual_n_m(), Vector2::zeros());
    }
}
