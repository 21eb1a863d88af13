//! A mass with viscous and dry friction on a sampled spring that knows the position in counts, exact between samples.

use yieldwall_motion::elementary;

/// A mass on the spring of a sampled loop, under a constant push.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coupling {
    /// `m` in kg, positive.
    pub mass_kg: f64,
    /// `b` in N s/m, not negative.
    pub viscous_n_s_per_m: f64,
    /// `f_c` in N, not negative, at rest as in motion.
    pub dry_n: f64,
    /// `K` in N/m.
    pub stiffness_n_per_m: f64,
    /// `T` in s.
    pub period_s: f64,
    /// `Delta` in m; zero for an exact position.
    pub count_m: f64,
    /// Push in N.
    pub push_n: f64,
}

/// Place in m and speed in m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    pub place_m: f64,
    pub speed_m_per_s: f64,
}

impl Coupling {
    /// Whole counts below the place, or the place itself.
    fn read_m(&self, place_m: f64) -> f64 {
        if self.count_m > 0.0 { (place_m / self.count_m).floor() * self.count_m } else { place_m }
    }

    /// Moves on by a period. The force of the spring is that of the place at its beginning. `turned` gets each place at which the mass turns or
    /// comes to rest.
    pub(super) fn step(&self, now: Motion, mut turned: impl FnMut(f64)) -> Motion {
        let force_n = self.push_n - self.stiffness_n_per_m * self.read_m(now.place_m);
        let (mut now, mut left_s) = (now, self.period_s);
        if now.speed_m_per_s != 0.0 {
            let net_n = force_n - self.dry_n * now.speed_m_per_s.signum();
            let stops_s = self.stops_after_s(now.speed_m_per_s, net_n);
            if stops_s >= left_s {
                return self.moved(now, net_n, left_s);
            }
            now = Motion { speed_m_per_s: 0.0, ..self.moved(now, net_n, stops_s) };
            left_s -= stops_s;
            turned(now.place_m);
        }
        // From rest a constant force turns nothing back.
        if force_n.abs() <= self.dry_n {
            return now;
        }
        self.moved(now, force_n - self.dry_n * force_n.signum(), left_s)
    }

    /// Time in which a force brings this speed to zero, s; infinity if it does not.
    fn stops_after_s(&self, speed_m_per_s: f64, net_n: f64) -> f64 {
        if net_n * speed_m_per_s >= 0.0 {
            return if net_n == 0.0 && speed_m_per_s == 0.0 { 0.0 } else { f64::INFINITY };
        }
        let ratio = (speed_m_per_s / net_n).abs();
        if self.viscous_n_s_per_m > 0.0 {
            self.mass_kg / self.viscous_n_s_per_m * elementary::ln(1.0 + self.viscous_n_s_per_m * ratio)
        } else {
            self.mass_kg * ratio
        }
    }

    /// The motion under a constant force and viscous friction alone.
    fn moved(&self, now: Motion, net_n: f64, time_s: f64) -> Motion {
        let Motion { place_m, speed_m_per_s } = now;
        if self.viscous_n_s_per_m == 0.0 {
            let gained = net_n / self.mass_kg * time_s;
            let place_m = place_m + (speed_m_per_s + 0.5 * gained) * time_s;
            return Motion { place_m, speed_m_per_s: speed_m_per_s + gained };
        }
        let rate_per_s = self.viscous_n_s_per_m / self.mass_kg;
        let lost = -elementary::exp_m1(-rate_per_s * time_s);
        let end = net_n / self.viscous_n_s_per_m;
        Motion {
            place_m: place_m + end * time_s + (speed_m_per_s - end) * lost / rate_per_s,
            speed_m_per_s: speed_m_per_s + (end - speed_m_per_s) * lost,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const COUPLING: Coupling = Coupling {
        mass_kg: 0.1,
        viscous_n_s_per_m: 2.0,
        dry_n: 0.3,
        stiffness_n_per_m: 10_000.0,
        period_s: 1e-3,
        count_m: 1e-5,
        push_n: 0.0,
    };

    proptest! {
        /// A period is that of ten thousand small steps of another kind, and the limit without viscous friction is continuous.
        #[test]
        fn a_period_is_exact(place_m in -1e-3_f64..1e-3, speed_m_per_s in -0.2_f64..0.2, push_n in -5.0_f64..5.0) {
            let coupling = Coupling { push_n, ..COUPLING };
            let start = Motion { place_m, speed_m_per_s };
            let found = coupling.step(start, |_| ());
            let force_n = push_n - coupling.stiffness_n_per_m * (place_m / 1e-5).floor() * 1e-5;
            let (mut x, mut v, steps) = (place_m, speed_m_per_s, 10_000);
            let h = coupling.period_s / f64::from(steps);
            for _ in 0..steps {
                // Implicit friction: the speed that is left once dry friction has taken its share.
                let free = (v + h / coupling.mass_kg * force_n) / (1.0 + h * coupling.viscous_n_s_per_m / coupling.mass_kg);
                let most = h * coupling.dry_n / coupling.mass_kg;
                let next = if free.abs() <= most { 0.0 } else { free - most * free.signum() };
                x += 0.5 * h * (v + next);
                v = next;
            }
            prop_assert!((found.place_m - x).abs() < 2e-8 && (found.speed_m_per_s - v).abs() < 1e-4, "{found:?} {x} {v}");
            let [little, none] = [1e-6, 0.0].map(|viscous_n_s_per_m| {
                Coupling { viscous_n_s_per_m, ..coupling }.step(start, |_| ())
            });
            prop_assert!((little.place_m - none.place_m).abs() < 1e-9, "{little:?} {none:?}");
        }
    }

    #[test]
    fn friction_holds_what_it_can_hold_and_no_more() {
        let rest = Motion { place_m: 0.0, speed_m_per_s: 0.0 };
        for (push_n, moves) in [(0.3, false), (-0.3, false), (0.31, true), (-0.31, true)] {
            let found = Coupling { push_n, ..COUPLING }.step(rest, |_| ());
            assert_eq!(found != rest, moves, "{push_n}");
            assert!(found.place_m * push_n >= 0.0);
        }
    }
}
