//! The least virtual mass by the crossovers of the phase: a formula for a servo that is known by its continuous answer.

use nalgebra::Complex;
use yieldwall_motion::elementary;

use yieldwall_motion::control::Gains;

/// Frequencies per scan, and the lowest in rad/s.
const FREQUENCIES: u32 = 4000;
const LOWEST_RAD_PER_S: f64 = 0.1;
const BISECTIONS: u32 = 50;

/// A servo `G = (K_d s + K_p)/(J s^2 + K_d s + K_p)` behind an admittance that a hand closes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossover {
    pub(super) gains: Gains,
    /// Inertia `J` of the joint in kg m^2.
    pub(super) inertia_kg_m2: f64,
    pub(super) period_s: f64,
    /// Delay `d` of the force in cycles.
    pub(super) delay_cycles: f64,
    pub(super) hand_n_per_m: f64,
    pub(super) hand_n_s_per_m: f64,
}

impl Crossover {
    /// The greatest `|(K_h + j w B_h) G(j w) e^(-j w (d - 1/2) T)| / ((2/T) sin(w T/2))^2` over the frequencies at which its
    /// phase is zero, in kg; infinity if the hand's damping is not ahead of the lag in slow motion.
    ///
    /// The fixture steps with the force of the same step, which is a cycle ahead, and held set-points are half a cycle late. It
    /// leaves out that the hand loads the servo, and that a servo which holds its torques follows slow motion without lag.
    pub(super) fn least_mass_kg(&self) -> f64 {
        let nyquist = std::f64::consts::PI / self.period_s;
        let at = |i: u32| {
            LOWEST_RAD_PER_S * elementary::powf(nyquist / LOWEST_RAD_PER_S, f64::from(i) / f64::from(FREQUENCIES))
        };
        if self.edge_mass_kg(at(0)).im < 0.0 {
            return f64::INFINITY;
        }
        let mut least: f64 = 0.0;
        for i in 1..=FREQUENCIES {
            let (mut low, mut high) = (at(i - 1), at(i));
            let is_behind = self.edge_mass_kg(high).im < 0.0;
            if (self.edge_mass_kg(low).im < 0.0) == is_behind {
                continue;
            }
            for _ in 0..BISECTIONS {
                let middle = 0.5 * (low + high);
                if (self.edge_mass_kg(middle).im < 0.0) == is_behind { high = middle } else { low = middle }
            }
            least = least.max(self.edge_mass_kg(high).re);
        }
        least
    }

    /// The complex mass that would close the loop at `w` in rad/s.
    fn edge_mass_kg(&self, w: f64) -> Complex<f64> {
        let s = Complex::new(0.0, w);
        let law = s * self.gains.damping + self.gains.stiffness;
        let servo = law / (s * s * self.inertia_kg_m2 + law);
        let (sin, cos) = elementary::sin_cos(-w * (self.delay_cycles - 0.5) * self.period_s);
        let lag = Complex::new(cos, sin);
        let rate = 2.0 / self.period_s * elementary::sin(0.5 * w * self.period_s);
        (s * self.hand_n_s_per_m + self.hand_n_per_m) * servo * lag / (rate * rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers that this formula is known by: a joint of 0.28 kg m^2 with the gains of the study, a hand of 3000 N/m and
    /// 15 N s/m, and no delay, one cycle and three.
    #[test]
    fn masses_for_a_braced_hand_are_those_of_the_formula() {
        for (delay_cycles, expected) in [(0.0, 0.36), (1.0, 0.52), (3.0, 1.035)] {
            let braced = Crossover {
                gains: Gains { stiffness: 4000.0, damping: 45.0, integral: 0.0 },
                inertia_kg_m2: 0.28,
                period_s: 1e-3,
                delay_cycles,
                hand_n_per_m: 3000.0,
                hand_n_s_per_m: 15.0,
            };
            let least = braced.least_mass_kg();
            assert!((least - expected).abs() < 0.005, "{delay_cycles}: {least} kg");
        }
    }

    /// A servo far faster than the loop leaves the lag alone, whose crossover is known: `w B_h = K_h tan(w lag)`.
    #[test]
    fn a_stiff_servo_leaves_the_lag() {
        let slow = Crossover {
            gains: Gains { stiffness: 1e12, damping: 1e7, integral: 0.0 },
            inertia_kg_m2: 0.3,
            period_s: 1e-3,
            delay_cycles: 3.0,
            hand_n_per_m: 3000.0,
            hand_n_s_per_m: 15.0,
        };
        let least = slow.least_mass_kg();
        // By hand: tan(x)/x = B_h/(K_h lag) = 2 at x = 1.16556, so w = x/2.5 ms = 466.2 rad/s.
        let w = 1.165_561 / 2.5e-3;
        let expected =
            elementary::hypot(3000.0_f64, 15.0 * w) / elementary::powi(2000.0 * elementary::sin(0.5e-3 * w), 2);
        assert!((least / expected - 1.0).abs() < 1e-3, "{least} {expected}");
        assert_eq!(Crossover { hand_n_per_m: 10_000.0, ..slow }.least_mass_kg(), f64::INFINITY);
    }
}
