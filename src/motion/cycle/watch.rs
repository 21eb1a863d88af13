//! Observations over more than one cycle: chatter, and the balance of torques.

use crate::quantity::{JointTorques, TipVelocity};

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
    greatest: TipVelocity,
    since_s: f64,
    reversals: u8,
}

impl Chatter {
    /// Computes one cycle of the reference; returns whether the reversals have become chatter. Counting then starts again.
    ///
    /// Real-time: yes.
    pub(super) fn step(&mut self, velocity: TipVelocity, period_s: f64) -> bool {
        let [shortest, longest] = HALF_SWING_S;
        self.since_s += period_s;
        if self.since_s > longest {
            self.reversals = 0;
        }
        let (speed, greatest) = (velocity.norm(), self.greatest.norm());
        if speed < SWING_SPEED_M_PER_S {
            return false;
        }
        if velocity.dot(self.greatest) >= REVERSED_COSINE * speed * greatest {
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

/// Torques that hand and motion do not account for: `J^T h + tau - M a`, a running mean.
///
/// The residual contains every torque that is not in the balance, above all the friction of the joints, so the limit lies above it. The
/// torques that act in a cycle are those sent in the cycle before. A reference that is stopped by an impact is ahead of the arm for some
/// cycles. The mean removes this, since the arm catches up.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Balance {
    /// Torques sent in the last cycle.
    acting: Option<JointTorques>,
    mean: JointTorques,
}

impl Balance {
    /// Computes one cycle: joint torques that stand for the sensed force, the ones that the reference's motion needs, and the ones
    /// sent now, all in N m. Anything that is not known starts again from zero.
    ///
    /// Real-time: yes.
    pub(super) fn step(
        &mut self,
        hand: Option<JointTorques>,
        needed: Option<JointTorques>,
        sent: Option<JointTorques>,
    ) {
        match (hand, needed, self.acting) {
            (Some(hand), Some(needed), Some(acting)) => {
                self.mean += (hand + acting - needed - self.mean) / BALANCE_CYCLES;
            }
            _ => self.mean = JointTorques::default(),
        }
        self.acting = sent;
    }

    /// Returns the mean residual of each joint in N m.
    pub(super) fn residual_n_m(&self) -> JointTorques {
        self.mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::elementary;
    use std::f64::consts::TAU;

    const T: f64 = 1e-3;

    /// Returns how often a swing at `frequency_hz` with this speed is chatter in two seconds.
    fn chatters(frequency_hz: f64, speed: f64) -> usize {
        let mut chatter = Chatter::default();
        let at = |step: u32| speed * elementary::cos(TAU * frequency_hz * f64::from(step) * T);
        (0..2000).filter(|step| chatter.step(TipVelocity::new(0.6 * at(*step), 0.8 * at(*step)), T)).count()
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
        let first = (0..1000).find(|step| {
            chatter.step(TipVelocity::new(0.1 * elementary::sin(TAU * 50.0 * f64::from(*step) * T), 0.0), T)
        });
        assert!(first.is_some_and(|step| step <= 80), "{first:?}");
    }

    #[test]
    fn to_and_fro_now_and_then_is_no_chatter() {
        let mut chatter = Chatter::default();
        // Two swings at 25 Hz every 200 ms: blows that bounce.
        let is_found = (0..6000).any(|step| {
            let t = f64::from(step % 200) * T;
            let speed = if t < 0.08 { 0.3 * elementary::sin(TAU * 25.0 * t) } else { 0.0 };
            chatter.step(TipVelocity::new(speed, 0.0), T)
        });
        assert!(!is_found);
    }

    #[test]
    fn the_balance_is_a_mean_of_what_is_missing() {
        let one = |x: f64| Some(JointTorques::new(x, -x));
        let mut balance = Balance::default();
        balance.step(one(3.0), one(5.0), one(2.0));
        assert_eq!(balance.residual_n_m(), JointTorques::default(), "what acts is not known yet");
        for _ in 0..200 {
            balance.step(one(3.0), one(5.0), one(2.0));
        }
        assert_eq!(balance.residual_n_m(), JointTorques::default());
        for _ in 0..20 {
            balance.step(one(13.0), one(5.0), one(2.0));
        }
        let [left, right] = balance.residual_n_m().to_array();
        assert!((6.0..7.0).contains(&left) && right == -left, "10 N m, two thirds after 20 cycles: {left}");
        balance.step(None, one(5.0), one(2.0));
        assert_eq!(balance.residual_n_m(), JointTorques::default());
    }
}
