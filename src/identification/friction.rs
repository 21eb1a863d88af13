//! Dry and viscous friction of a joint from slow travels to and fro.

use super::{Estimate, NotIdentified};

/// Parts of a way, each compared with itself: what depends on the angle and not on the way falls out.
const PARTS: usize = 6;

/// A joint that was led at one rate, counter-clockwise and clockwise over the same way.
#[derive(Clone, Debug, PartialEq)]
pub struct Steady {
    /// Rate, rad/s, positive.
    pub rate_rad_per_s: f64,
    /// Angle in rad and torque in N m while it turned counter-clockwise.
    pub forward: Vec<[f64; 2]>,
    /// The same clockwise.
    pub backward: Vec<[f64; 2]>,
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

/// Friction by what the torque of both ways differs in, part by part of the way. At least two rates that differ.
///
/// # Errors
/// [`NotIdentified`] if samples are too few or do not tell.
pub fn friction(travels: &[Steady]) -> Result<Friction, NotIdentified> {
    let mut points: Vec<[f64; 2]> = Vec::new();
    let mut offsets: Vec<f64> = Vec::new();
    for travel in travels {
        let all = || travel.forward.iter().chain(&travel.backward);
        if !all().flatten().all(|value| value.is_finite()) {
            return Err(NotIdentified::NotFinite);
        }
        let ends = |samples: &[[f64; 2]]| {
            let angles = samples.iter().map(|[angle, _]| *angle);
            angles.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], angle| [least.min(angle), most.max(angle)])
        };
        let ([one, one_end], [other, other_end]) = (ends(&travel.forward), ends(&travel.backward));
        let (from, to) = (one.max(other), one_end.min(other_end));
        if !(to > from) {
            return Err(NotIdentified::TooFew);
        }
        let means = |samples: &[[f64; 2]]| {
            let mut sums = [(0.0, 0u32); PARTS];
            for [angle, torque] in samples.iter().filter(|[angle, _]| (from..=to).contains(angle)) {
                let part = (((angle - from) / (to - from)) * PARTS as f64) as usize;
                if let Some((sum, count)) = sums.get_mut(part.min(PARTS - 1)) {
                    (*sum, *count) = (*sum + torque, *count + 1);
                }
            }
            sums.map(|(sum, count)| (count > 0).then(|| sum / f64::from(count)))
        };
        for (forward, backward) in means(&travel.forward).into_iter().zip(means(&travel.backward)) {
            let (Some(forward), Some(backward)) = (forward, backward) else { continue };
            points.push([travel.rate_rad_per_s, 0.5 * (forward - backward)]);
            offsets.push(0.5 * (forward + backward));
        }
    }
    if points.len() < 4 {
        return Err(NotIdentified::TooFew);
    }
    let count = points.len() as f64;
    let mean = |of: &dyn Fn(&[f64; 2]) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (rate, torque) = (mean(&|[rate, _]| *rate), mean(&|[_, torque]| *torque));
    let spread: f64 = points.iter().map(|[at, _]| (at - rate) * (at - rate)).sum();
    let together: f64 = points.iter().map(|[at, value]| (at - rate) * (value - torque)).sum();
    if !(spread > 1e-6 * count * rate * rate) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::elementary;
    use proptest::prelude::*;

    fn travel(rate: f64, coulomb: f64, viscous: f64, noise_n_m: f64, seed: f64) -> Steady {
        let of = |sign: f64| {
            let torque = |angle: f64, at: u32| {
                // What depends on the angle alone, and noise without a pattern.
                let noise = elementary::sin(seed * 1e3 + f64::from(at) * f64::from(at) * 12.9898) * noise_n_m;
                1.5 + 20.0 * angle + noise + sign * (coulomb + viscous * rate)
            };
            (0..200).map(|at| [1e-3 * f64::from(at), torque(1e-3 * f64::from(at), at)]).collect()
        };
        Steady { rate_rad_per_s: rate, forward: of(1.0), backward: of(-1.0) }
    }

    proptest! {
        #[test]
        fn planted_friction_is_found_whatever_depends_on_the_angle(
            coulomb in 0.5..20.0f64, viscous in 0.1..5.0f64, seed in 0.0..1.0f64,
        ) {
            let travels: Vec<_> =
                [0.07, 0.2, 0.4].map(|rate| travel(rate, coulomb, viscous, 0.05, seed + rate)).into();
            let found = friction(&travels).unwrap();
            prop_assert!((found.coulomb_n_m.value - coulomb).abs() < 0.03, "{found:?}");
            prop_assert!((found.viscous_n_m_s_per_rad.value - viscous).abs() < 0.1, "{found:?}");
        }
    }

    #[test]
    fn one_rate_tells_no_viscous_friction_and_nothing_is_no_friction() {
        let one = travel(0.1, 10.0, 1.0, 0.0, 0.0);
        assert_eq!(friction(&[one.clone(), one.clone()]), Err(NotIdentified::Indistinct));
        assert_eq!(friction(&[]), Err(NotIdentified::TooFew));
        let mut bad = one;
        bad.forward[3][1] = f64::NAN;
        assert_eq!(friction(&[bad]), Err(NotIdentified::NotFinite));
    }
}
