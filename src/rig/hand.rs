//! The hand of a scene.

use super::error::RigError;
use yieldwall_config as config;
use yieldwall_sim::hand::{AimError, Hand, HandParameters, Leg, NoiseBand, Path, Speed};

fn fixed<const N: usize>(point: &[config::Finite], what: &str) -> Result<nalgebra::SVector<f64, N>, RigError> {
    if point.len() != N {
        return Err(RigError::Coordinates { point: what.to_owned(), found: point.len(), wanted: N });
    }
    Ok(nalgebra::SVector::from_iterator(point.iter().map(|value| value.get())))
}

/// Returns the hand of a scene.
pub(super) fn hand<const N: usize>(scene: &config::Scene, seed: u64) -> Result<Hand<N>, RigError> {
    let hand = &scene.hand;
    let mut legs = Vec::new();
    for segment in &hand.path {
        legs.push(match segment {
            config::PathSegment::To { point_m, in_s } => {
                Leg::To { point_m: fixed(point_m, "a way-point")?, in_s: in_s.get() }
            }
            config::PathSegment::Arc { center_m, by_rad, in_s, speed } => Leg::Arc {
                center_m: fixed::<2>(center_m.get(..2).unwrap_or(center_m), "the centre of an arc")?.into(),
                by_rad: by_rad.get(),
                in_s: in_s.get(),
                speed: match speed {
                    config::ArcSpeed::Smooth => Speed::Smooth,
                    config::ArcSpeed::Constant => Speed::Constant,
                },
            },
            config::PathSegment::Wait { for_s } => Leg::Wait { for_s: for_s.get() },
            config::PathSegment::LetGo { for_s } => Leg::LetGo { for_s: for_s.get() },
        });
    }
    let path = Path::new(fixed(&hand.start_m, "the start")?, &legs)?;
    let parameters = HandParameters {
        mass_kg: hand.mass_kg.get(),
        stiffness_n_per_m: hand.stiffness_n_per_m.get(),
        damping_n_s_per_m: hand.damping_n_s_per_m.get(),
        voluntary_force_limit_n: hand.voluntary_force_limit_n.map_or(f64::INFINITY, |limit| limit.get()),
        tremor: hand.tremor.as_ref().map(|tremor| NoiseBand {
            rms: tremor.force_rms_n.get(),
            low_hz: tremor.low_hz.get(),
            high_hz: tremor.high_hz.get(),
        }),
        aim_error: hand.aim_error.map(|error| AimError { rms_m: error.rms_m.get(), corner_hz: error.corner_hz.get() }),
    };
    Ok(Hand::new(parameters, path, seed)?)
}
