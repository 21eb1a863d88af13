//! Remedies for an unstable virtual mass, tried in the rig's own linear model.

use super::force_age::is_sampled_at_sync;
use super::held::{Held, HeldMasses, held_masses, stiffer};
use crate::RigError;
use yieldwall_config::{self as config, Positive};
use yieldwall_motion::control::Grip;

/// A change that makes a virtual mass stable, by itself, in the linear model of the rig with one hand on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Remedy {
    /// Another virtual mass, kg.
    Mass(f64),
    /// Another cut-off of the force's low pass, Hz; `None`: no low pass.
    LowPass(Option<f64>),
    /// Another rate of the force sensor, Hz.
    SampleRate(f64),
    /// Another control period, us.
    Period(u32),
    /// More damping of the hand, N s/m.
    Damping(f64),
    /// A softer hand, damped to the same degree, N/m.
    Stiffness(f64),
}

impl Remedy {
    /// Returns the rig with this change; unchanged if the change is one of the hand.
    pub fn of_rig(self, rig: &config::Rig) -> config::Rig {
        let mut rig = rig.clone();
        match self {
            Self::Mass(mass_kg) => {
                if let (config::Coupling::Admittance { mass_kg: kept }, Some(mass_kg)) =
                    (&mut rig.fixture.coupling, Positive::new(mass_kg))
                {
                    *kept = mass_kg;
                }
            }
            Self::LowPass(cut_off_hz) => rig.sensor.low_pass_hz = cut_off_hz.and_then(Positive::new),
            Self::SampleRate(rate_hz) => {
                rig.sensor.sample_rate_hz = Positive::new(rate_hz).unwrap_or(rig.sensor.sample_rate_hz);
            }
            Self::Period(period_us) => {
                let share = f64::from(rig.cycle.compute_at_us) / f64::from(rig.cycle.period_us);
                rig.cycle.compute_at_us = (share * f64::from(period_us)).round() as u32;
                rig.cycle.period_us = period_us;
            }
            Self::Damping(_) | Self::Stiffness(_) => {}
        }
        rig
    }

    /// Whether it changes the hand, and not the rig.
    pub fn is_of_hand(self) -> bool {
        matches!(self, Self::Damping(_) | Self::Stiffness(_))
    }

    /// Returns the hand with this change; unchanged if the change is one of the rig.
    pub fn of_hand(self, hand: &Grip) -> Grip {
        match self {
            Self::Damping(damping_n_s_per_m) => Grip { damping_n_s_per_m, ..*hand },
            Self::Stiffness(stiffness_n_per_m) => stiffer(hand, stiffness_n_per_m),
            _ => *hand,
        }
    }
}

/// Returns the remedies that make `mass_kg` stable with this hand if it is not: the least change of each kind, if there is one.
/// Changes of the rig come first.
///
/// # Errors
/// As [`held_masses`].
pub fn remedies(rig: &config::Rig, scene: &config::Scene, hand: &Grip, mass_kg: f64) -> Result<Vec<Remedy>, RigError> {
    let masses = held_masses(rig, scene, std::slice::from_ref(hand), mass_kg)?.and_then(|found| found.first()?.masses);
    let low_pass = rig.sensor.low_pass_hz.map(|cut_off_hz| cut_off_hz.get());
    let own_clock_hz = Some(rig.sensor.sample_rate_hz.get()).filter(|_| !is_sampled_at_sync(rig));
    let period_us = rig.cycle.period_us;
    let kinds: [Vec<Remedy>; 6] = [
        masses.map(|masses| Remedy::Mass(mass_within(&masses))).into_iter().collect(),
        low_pass.map_or_else(Vec::new, |cut_off_hz| {
            let higher = [2.0, 4.0, 8.0].map(|times| Remedy::LowPass(Some(times * cut_off_hz)));
            higher.into_iter().chain([Remedy::LowPass(None)]).collect()
        }),
        own_clock_hz
            .map_or_else(Vec::new, |rate_hz| [2.0, 4.0].map(|times| Remedy::SampleRate(times * rate_hz)).into()),
        [2, 4]
            .into_iter()
            .filter(|parts| period_us.is_multiple_of(*parts))
            .map(|parts| Remedy::Period(period_us / parts))
            .collect(),
        [1.5, 2.0, 3.0, 5.0, 10.0].map(|times| Remedy::Damping(in_two_digits(times * hand.damping_n_s_per_m))).into(),
        [0.8, 0.6, 0.4, 0.3, 0.2, 0.1]
            .map(|part| Remedy::Stiffness(in_two_digits(part * hand.stiffness_n_per_m)))
            .into(),
    ];
    let bears = |remedy: &Remedy| {
        let rig = remedy.of_rig(rig);
        let config::Coupling::Admittance { mass_kg } = rig.fixture.coupling else { return false };
        let is_stable = |held: Held| held.is_stable(&remedy.of_hand(hand), mass_kg.get());
        // What the model cannot be built with is no remedy.
        Held::of(&rig, scene).ok().flatten().is_some_and(|held| is_stable(held).unwrap_or(false))
    };
    Ok(kinds.into_iter().filter_map(|kind| kind.into_iter().find(bears)).collect())
}

/// Returns a mass between the ends of a range: twice the least if there is room.
fn mass_within(masses: &HeldMasses) -> f64 {
    in_two_digits((2.0 * masses.least_kg).min((masses.least_kg * masses.greatest_kg).sqrt()))
}

fn in_two_digits(value: f64) -> f64 {
    format!("{value:.1e}").parse().unwrap_or(value)
}
