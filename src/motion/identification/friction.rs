//! Dry and viscous friction of a joint from slow travels to and fro.

use super::{Estimate, NotIdentified};
use crate::elementary;

/// Parts of a way, which overlap by half, each compared with itself.
const PARTS: usize = 5;
/// Least number of rates: two unknowns, and one that shows the scatter.
const LEAST_RATES: usize = 3;

/// Least variance of the rates, as a share of the square of their mean.
const LEAST_SPREAD: f64 = 0.01;

/// A joint that was moved at one rate, counter-clockwise and clockwise over the same way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Steady {
    /// Time in s, angle in rad and torque in N m while it turned counter-clockwise.
    pub forward: Vec<[f64; 3]>,
    /// Time in s, angle in rad and torque in N m while it turned clockwise.
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

/// Computes friction as half of the difference between the mean torques of both ways, a line over at least three rates. A torque that
/// depends on the angle alone cancels out. `inertia_kg_m2` removes the rest of an acceleration; zero if it is not known. Rates with too few
/// samples are left out.
///
/// # Intervals
/// The intervals follow from the scatter of the rates about that line, with Student's t of their number less two. If the scatter of parts
/// of the ways is larger, they follow from that scatter. Parts of one travel depend on one another. A drive that closes the loop reports
/// torques of one moment in its cycle, where the counts of its targets make a pattern. An error that is constant or proportional to the
/// rate leaves no scatter, and the intervals do not contain it.
///
/// # Errors
/// - [`NotIdentified::TooFew`] for fewer than three rates;
/// - [`NotIdentified::NotFinite`];
/// - [`NotIdentified::Indistinct`] for rates that are too near one another.
pub fn friction(travels: &[Steady], inertia_kg_m2: f64) -> Result<Friction, NotIdentified> {
    let samples = || travels.iter().flat_map(|travel| travel.forward.iter().chain(&travel.backward));
    if !samples().flatten().all(|value| value.is_finite()) {
        return Err(NotIdentified::NotFinite);
    }
    let over = |parts: usize| -> Vec<Point> {
        travels
            .iter()
            .flat_map(|travel| (0..parts).filter_map(|part| travel.point([part, parts], inertia_kg_m2)))
            .collect()
    };
    let whole = over(1);
    if whole.len() < LEAST_RATES {
        return Err(NotIdentified::TooFew);
    }
    let [coulomb, viscous] = line(&whole).ok_or(NotIdentified::Indistinct)?;
    let of_parts = line(&over(PARTS)).unwrap_or([coulomb, viscous]);
    let [coulomb_n_m, viscous_n_m_s_per_rad] =
        [(coulomb, of_parts[0]), (viscous, of_parts[1])].map(|(whole, parts)| {
            let half = whole.half_width().max(parts.half_width());
            Estimate { value: whole.value, low: whole.value - half, high: whole.value + half }
        });
    let offset_n_m = whole.iter().map(|point| point.offset).sum::<f64>() / whole.len() as f64;
    Ok(Friction { coulomb_n_m, viscous_n_m_s_per_rad, offset_n_m })
}

/// Common part of both ways at a rate: half of the difference of their torques, and half of the sum.
struct Point {
    rate: f64,
    torque: f64,
    offset: f64,
}

impl Steady {
    /// Means of a part of the way, by its number and how many there are, which overlap by half. `None` of too few samples.
    fn point(&self, [part, parts]: [usize; 2], inertia_kg_m2: f64) -> Option<Point> {
        let (forward, backward) = (Line::through(&self.forward)?, Line::through(&self.backward)?);
        let (from, to) = (forward.least().max(backward.least()), forward.most().min(backward.most()));
        let at = |step: usize| from + (to - from) * step as f64 / (parts + 1) as f64;
        let [low, high] = if parts > 1 { [at(part), at(part + 2)] } else { [from, to] };
        if high.is_nan() || high <= low {
            return None;
        }
        let both = [mean(&self.forward, &forward, low, high)?, mean(&self.backward, &backward, low, high)?];
        let [one, other] = both.each_ref().map(|mean| mean.torque - inertia_kg_m2 * mean.acceleration);
        let [rate, torque] = [0.5 * (both[0].rate - both[1].rate), 0.5 * (one - other)];
        Some(Point { rate, torque, offset: 0.5 * (one + other) })
    }
}

/// Dry and viscous friction by least squares; `None` of fewer than three points, and of rates too near one another.
fn line(points: &[Point]) -> Option<[Estimate; 2]> {
    let degrees = points.len().checked_sub(2).filter(|degrees| *degrees > 0)? as f64;
    let count = points.len() as f64;
    let rate = points.iter().map(|point| point.rate).sum::<f64>() / count;
    let torque = points.iter().map(|point| point.torque).sum::<f64>() / count;
    let spread: f64 = points.iter().map(|point| (point.rate - rate) * (point.rate - rate)).sum();
    let together: f64 = points.iter().map(|point| (point.rate - rate) * (point.torque - torque)).sum();
    if spread.is_nan() || spread <= LEAST_SPREAD * count * rate * rate {
        return None;
    }
    let viscous = together / spread;
    let coulomb = torque - viscous * rate;
    let rests = points.iter().map(|point| point.torque - coulomb - viscous * point.rate);
    let variance = rests.map(|rest| rest * rest).sum::<f64>() / degrees;
    Some([
        Estimate::new(coulomb, (variance * (1.0 / count + rate * rate / spread)).sqrt(), degrees),
        Estimate::new(viscous, (variance / spread).sqrt(), degrees),
    ])
}

/// Line of a joint on a steady travel. The line separates the parts, not the measured angle: the error of a measured angle also enters the
/// torque that answers it, and would choose the samples of a part.
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

    /// Returns a travel at a rate that is still settling; its torque has noise without a pattern.
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

    /// Torques of one travel share an error: many of them do not make it smaller.
    #[test]
    fn intervals_hold_planted_friction_though_torques_of_a_travel_err_alike() {
        let mut state = 1_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let mut held = [0; 2];
        for seed in 0..200 {
            let of = |rate: f64| {
                let shared_n_m = 0.2 * (0..4).map(|_| uniform()).sum::<f64>();
                travel(rate, 10.0 + shared_n_m, 0.5, 0.3, f64::from(seed) + rate)
            };
            let found = friction(&[0.07, 0.11, 0.16, 0.24, 0.35].map(of), INERTIA).unwrap();
            held[0] += u32::from(found.coulomb_n_m.contains(10.0));
            held[1] += u32::from(found.viscous_n_m_s_per_rad.contains(0.5));
        }
        assert!(held.iter().all(|held| *held >= 180), "{held:?} of 200");
    }

    #[test]
    fn one_rate_tells_no_viscous_friction_and_two_tell_no_interval() {
        let one = travel(0.1, 10.0, 1.0, 0.0, 0.0);
        assert_eq!(friction(&[one.clone(), one.clone(), one.clone()], 0.0), Err(NotIdentified::Indistinct));
        assert_eq!(friction(&[one.clone(), travel(0.3, 10.0, 1.0, 0.0, 0.0)], 0.0), Err(NotIdentified::TooFew));
        assert_eq!(friction(&[], 0.0), Err(NotIdentified::TooFew));
        let mut bad = one;
        bad.forward[3][1] = f64::NAN;
        assert_eq!(friction(&[bad], 0.0), Err(NotIdentified::NotFinite));
    }
}
