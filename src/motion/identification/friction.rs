//! Dry and viscous friction of a joint from slow travels to and fro.

use super::{Estimate, NotIdentified};
use crate::elementary;

/// Parts of a way, which overlap by half, each compared with itself: what depends on the angle and not on the way falls out.
const PARTS: usize = 5;

/// Least variance of the rates, as a share of the square of their mean.
const LEAST_SPREAD: f64 = 0.01;

/// A joint that was led at one rate, counter-clockwise and clockwise over the same way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Steady {
    /// Time in s, angle in rad and torque in N m while it turned counter-clockwise.
    pub forward: Vec<[f64; 3]>,
    /// The same clockwise.
    pub backward: Vec<[f64; 3]>,
}

/// Friction of a joint: `coulomb sign(rate) + viscous rate`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction {
    /// Dry friction, N m.
    pub coulomb_n_m: Estimate,
    /// Viscous friction, N m s/rad.
    pub viscous_n_m_s_per_rad: Estimate,
    /// Mean torque of both ways, N m: gravity, a cable, an offset of the drive.
    pub offset_n_m: f64,
}

/// Friction by what the torque of both ways differs in, part by part of the way. At least two rates that differ. What is left of an
/// acceleration in a part is taken out by `inertia_kg_m2`; zero where that is not known.
///
/// # Errors
/// [`NotIdentified`] if samples are too few or do not tell.
pub fn friction(travels: &[Steady], inertia_kg_m2: f64) -> Result<Friction, NotIdentified> {
    let mut points: Vec<[f64; 2]> = Vec::new();
    let mut offsets: Vec<f64> = Vec::new();
    for travel in travels {
        if !travel.forward.iter().chain(&travel.backward).flatten().all(|value| value.is_finite()) {
            return Err(NotIdentified::NotFinite);
        }
        let (Some(forward), Some(backward)) = (Line::through(&travel.forward), Line::through(&travel.backward)) else {
            return Err(NotIdentified::TooFew);
        };
        let (from, to) = (forward.least().max(backward.least()), forward.most().min(backward.most()));
        if to.is_nan() || to <= from {
            return Err(NotIdentified::TooFew);
        }
        for part in 0..PARTS {
            // Each reaches over two of as many steps as there are parts, and one more.
            let at = |step: usize| from + (to - from) * step as f64 / (PARTS + 1) as f64;
            let (low, high) = (at(part), at(part + 2));
            let both = (mean(&travel.forward, &forward, low, high), mean(&travel.backward, &backward, low, high));
            let (Some(forward), Some(backward)) = both else { continue };
            let [one, other] = [&forward, &backward].map(|mean| mean.torque - inertia_kg_m2 * mean.acceleration);
            points.push([0.5 * (forward.rate - backward.rate), 0.5 * (one - other)]);
            offsets.push(0.5 * (one + other));
        }
    }
    if points.len() < 4 {
        return Err(NotIdentified::TooFew);
    }
    let count = points.len() as f64;
    let rate = points.iter().map(|[rate, _]| rate).sum::<f64>() / count;
    let torque = points.iter().map(|[_, torque]| torque).sum::<f64>() / count;
    let spread: f64 = points.iter().map(|[at, _]| (at - rate) * (at - rate)).sum();
    let together: f64 = points.iter().map(|[at, value]| (at - rate) * (value - torque)).sum();
    if spread.is_nan() || spread <= LEAST_SPREAD * count * rate * rate {
        return Err(NotIdentified::Indistinct);
    }
    let viscous = together / spread;
    let coulomb = torque - viscous * rate;
    let degrees = points.len() - 2;
    let rest: f64 = points.iter().map(|[at, value]| value - coulomb - viscous * at).map(|rest| rest * rest).sum();
    let variance = rest / degrees as f64;
    Ok(Friction {
        coulomb_n_m: Estimate::new(coulomb, (variance * (1.0 / count + rate * rate / spread)).sqrt(), degrees),
        viscous_n_m_s_per_rad: Estimate::new(viscous, (variance / spread).sqrt(), degrees),
        offset_n_m: offsets.iter().sum::<f64>() / count,
    })
}

/// Where a joint is on a steady travel. Parts are told apart by it: the error of a measured angle goes into the torque that answers it, and
/// would choose which samples are in a part.
struct Line {
    begin: [f64; 2],
    end: [f64; 2],
}

impl Line {
    fn through(samples: &[[f64; 3]]) -> Option<Self> {
        let (first, last) = samples.first().zip(samples.last())?;
        let [begin, end] = [first, last].map(|[time, angle, _]| [*time, *angle]);
        (end[0] > begin[0]).then_some(Self { begin, end })
    }

    fn at(&self, time_s: f64) -> f64 {
        let share = (time_s - self.begin[0]) / (self.end[0] - self.begin[0]);
        self.begin[1] + share * (self.end[1] - self.begin[1])
    }

    fn least(&self) -> f64 {
        self.begin[1].min(self.end[1])
    }

    fn most(&self) -> f64 {
        self.begin[1].max(self.end[1])
    }
}

/// Mean torque, rate and acceleration of a part of a travel.
struct Mean {
    torque: f64,
    rate: f64,
    acceleration: f64,
}

/// Means over a part of a travel, with a window that begins and ends softly: where a joint trembles, its rate at the very ends of a part
/// would count. `None` of too few samples.
fn mean(samples: &[[f64; 3]], line: &Line, low: f64, high: f64) -> Option<Mean> {
    const LEAST: u32 = 5;
    let (mut sums, mut whole, mut count) = ([0.0; 3], 0.0, 0);
    for three in samples.windows(3) {
        let [[before_s, before, _], [now_s, now, torque], [next_s, next, _]] = three else { continue };
        let share = (line.at(*now_s) - low) / (high - low);
        let is_in_order = next_s > now_s && now_s > before_s;
        if !((0.0..=1.0).contains(&share) && is_in_order) {
            continue;
        }
        let weight = elementary::powi(elementary::sin(std::f64::consts::PI * share), 2);
        let [came, goes] = [(now - before) / (now_s - before_s), (next - now) / (next_s - now_s)];
        let acceleration = 2.0 * (goes - came) / (next_s - before_s);
        let values = [*torque, (next - before) / (next_s - before_s), acceleration];
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
        whole += weight;
        count += 1;
    }
    let [torque, rate, acceleration] = sums.map(|sum| sum / whole);
    (count >= LEAST).then_some(Mean { torque, rate, acceleration })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const INERTIA: f64 = 0.4;

    /// A travel at a rate that is still settling; its torque has noise without a pattern.
    fn travel(rate: f64, coulomb: f64, viscous: f64, noise_n_m: f64, seed: f64) -> Steady {
        let of = |sign: f64| {
            let (mut angle, period_s) = (0.1 - 0.1 * sign, 0.2 / rate / 300.0);
            let sample = |at: u32| {
                let time = period_s * f64::from(at);
                let settling = 0.1 * rate * elementary::exp(-time / 0.05);
                let rate = sign * (rate - settling);
                angle += rate * period_s;
                // What depends on the angle alone falls out.
                let noise = elementary::sin(seed * 1e3 + f64::from(at) * f64::from(at) * 12.9898) * noise_n_m;
                let accelerates = INERTIA * sign * settling / 0.05;
                [time, angle, 1.5 + 20.0 * angle + noise + accelerates + sign * coulomb + viscous * rate]
            };
            (0..300).map(sample).collect()
        };
        Steady { forward: of(1.0), backward: of(-1.0) }
    }

    proptest! {
        #[test]
        fn planted_friction_is_found_whatever_depends_on_the_angle(
            coulomb in 0.5..20.0f64, viscous in 0.2..5.0f64, seed in 0.0..1.0f64,
        ) {
            let travels: Vec<_> =
                [0.07, 0.2, 0.4].map(|rate| travel(rate, coulomb, viscous, 0.05, seed + rate)).into();
            let found = friction(&travels, INERTIA).unwrap();
            prop_assert!((found.coulomb_n_m.value - coulomb).abs() < 0.03, "{found:?}");
            prop_assert!((found.viscous_n_m_s_per_rad.value - viscous).abs() < 0.1, "{found:?}");
        }
    }

    #[test]
    fn intervals_hold_planted_friction() {
        let held = (0..100)
            .filter(|seed| {
                let travels: Vec<_> =
                    [0.07, 0.2, 0.4].map(|rate| travel(rate, 10.0, 0.5, 0.3, f64::from(*seed) + rate)).into();
                let found = friction(&travels, INERTIA).unwrap();
                found.coulomb_n_m.contains(10.0) && found.viscous_n_m_s_per_rad.contains(0.5)
            })
            .count();
        assert!(held >= 85, "{held} of 100");
    }

    #[test]
    fn one_rate_tells_no_viscous_friction_and_nothing_is_no_friction() {
        let one = travel(0.1, 10.0, 1.0, 0.0, 0.0);
        assert!(friction(&[one.clone(), one.clone()], 0.0).is_err());
        assert_eq!(friction(&[], 0.0), Err(NotIdentified::TooFew));
        let mut bad = one;
        bad.forward[3][1] = f64::NAN;
        assert_eq!(friction(&[bad], 0.0), Err(NotIdentified::NotFinite));
    }
}
