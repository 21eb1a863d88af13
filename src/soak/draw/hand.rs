//! A hand and the path that it aims along.

use std::f64::consts::TAU;
use yieldwall_motion::elementary;

use super::{finite, not_negative, positive};
use crate::dice::Dice;
use yieldwall_config::{self as config, PathSegment};

/// Radius in m of the disc in which most of the path lies.
const WITHIN_M: f64 = 0.13;
/// Radius in m up to which a reach towards the edge of the workspace aims: the arm's own margin lies before it.
const TOWARDS_EDGE_M: f64 = 0.30;
/// Greatest mean speed in m/s of the aimed point on a calm leg; the peak of a minimum-jerk leg is 1.875 of it.
const CALM_M_PER_S: f64 = 0.15;
/// Greatest mean speed in m/s of the aimed point on a leg that is to end in an impact.
const FAST_M_PER_S: f64 = 0.5;
/// Least time of a leg in s.
const SHORTEST_S: f64 = 0.05;

/// Time in s for which a hand moves: longer than 60 000 cycles of 4 ms with the boots between them. After it the hand rests.
const MOVES_S: f64 = 600.0;

/// Draws a hand.
pub(super) fn draw(dice: &mut Dice, rig: &config::Rig) -> config::Hand {
    let stiffness = dice.between(100.0, 600.0);
    // The damping ratio of the hand with its own mass on the arm of some 3 kg.
    let mass = dice.between(0.3, 1.5);
    let damping = dice.between(0.15, 0.5) * 2.0 * (stiffness * (mass + 2.0)).sqrt();
    let yield_n = rig.fixture.yield_n.get();
    let limit = if dice.chance(0.5) { dice.between(0.4, 0.9) * yield_n } else { dice.between(1.2, 2.5) * yield_n };
    let start = point_in_disc(dice, 0.6 * WITHIN_M);
    config::Hand {
        mass_kg: not_negative(mass),
        stiffness_n_per_m: positive(stiffness),
        damping_n_s_per_m: not_negative(damping),
        voluntary_force_limit_n: Some(positive(limit.min(60.0))),
        aim_error: None,
        tremor: dice.chance(0.8).then(|| config::Tremor {
            force_rms_n: not_negative(dice.between(0.02, 0.3)),
            low_hz: positive(8.0),
            high_hz: positive(12.0),
        }),
        start_m: start.map(finite).to_vec(),
        path: path(dice, start, yield_n / stiffness),
    }
}

/// Legs until [`MOVES_S`] is over: reaches, rests, arcs, presses below and above the yield force, impacts, and now and
/// then a reach towards the edge of the workspace. `yield_m` is how far the hand has to aim beyond the surface to press
/// with the yield force.
fn path(dice: &mut Dice, start: [f64; 2], yield_m: f64) -> Vec<PathSegment> {
    let mut legs = Vec::new();
    let (mut here, mut time_s) = (start, 0.0);
    while time_s < MOVES_S {
        let leg = match dice.whole(0, 9) {
            0 | 1 => PathSegment::Wait { for_s: positive(dice.between(0.2, 1.5)) },
            2 if elementary::hypot(here[0], here[1]) > 0.01 => {
                let by = dice.between(-1.5, 1.5);
                let way = by.abs() * elementary::hypot(here[0], here[1]);
                let in_s = (way / dice.between(0.04, CALM_M_PER_S)).max(SHORTEST_S);
                let (sine, cosine) = elementary::sin_cos(by);
                let [x, y] = here;
                here = [cosine * x - sine * y, sine * x + cosine * y];
                PathSegment::Arc {
                    center_m: vec![finite(0.0), finite(0.0)],
                    by_rad: finite(by),
                    in_s: positive(in_s),
                    speed: if dice.chance(0.5) { config::ArcSpeed::Smooth } else { config::ArcSpeed::Constant },
                }
            }
            // Pressed on from here, by up to twice the yield force.
            3 | 4 => reach(dice, &mut here, 2.0 * yield_m, CALM_M_PER_S),
            5 => {
                let to = point_in_disc(dice, WITHIN_M);
                go(dice, &mut here, to, FAST_M_PER_S)
            }
            6 if dice.chance(0.3) => {
                let (sine, cosine) = elementary::sin_cos(dice.between(0.0, TAU));
                let to = [TOWARDS_EDGE_M * cosine, TOWARDS_EDGE_M * sine];
                go(dice, &mut here, to, CALM_M_PER_S)
            }
            _ => {
                let to = point_in_disc(dice, WITHIN_M);
                go(dice, &mut here, to, CALM_M_PER_S)
            }
        };
        time_s += leg.duration_s();
        legs.push(leg);
    }
    legs
}

/// Draws a leg from `here` by up to `most_m` in any direction, kept within the workspace.
fn reach(dice: &mut Dice, here: &mut [f64; 2], most_m: f64, speed: f64) -> PathSegment {
    let (sine, cosine) = elementary::sin_cos(dice.between(0.0, TAU));
    let by = dice.between(0.2, 1.0) * most_m;
    let to = [here[0] + by * cosine, here[1] + by * sine];
    let radius = elementary::hypot(to[0], to[1]);
    let scale = if radius > WITHIN_M { WITHIN_M / radius } else { 1.0 };
    go(dice, here, to.map(|value| value * scale), speed)
}

fn go(dice: &mut Dice, here: &mut [f64; 2], to: [f64; 2], speed: f64) -> PathSegment {
    let way = elementary::hypot(to[0] - here[0], to[1] - here[1]);
    let in_s = (way / dice.between(0.2 * speed, speed)).max(SHORTEST_S);
    *here = to;
    PathSegment::To { point_m: to.map(finite).to_vec(), in_s: positive(in_s) }
}

fn point_in_disc(dice: &mut Dice, radius_m: f64) -> [f64; 2] {
    let (sine, cosine) = elementary::sin_cos(dice.between(0.0, TAU));
    // The square root spreads the points evenly over the area.
    let radius = radius_m * dice.share().sqrt();
    [radius * cosine, radius * sine]
}
