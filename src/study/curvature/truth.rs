//! The nearest point of the admissible set about a circle, sought and not derived: independent of [`yieldwall_motion::fixture`].

use nalgebra::Vector2;
use std::f64::consts::PI;
use yieldwall_motion::elementary;

/// The admissible set of a guide along a circle about the origin, both sides alike; all lengths in one unit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Annulus {
    /// `F/kappa`.
    pub(super) friction: f64,
    /// `R/kappa`.
    pub(super) reach: f64,
    /// Radius of the circle.
    pub(super) radius: f64,
}

/// Directions that a search looks at before it closes in on the best.
const LOOKS: usize = 48;
/// Halvings of the search about the best direction; each leaves 0.62 of the stretch.
const CLOSING: usize = 60;

impl Annulus {
    /// The point of the set about `input` that is nearest to `before`.
    ///
    /// The set is the disc of radius `F/kappa` about the input position and all points that lie in a direction from the centre within
    /// an arc of `F/kappa` from that of the input position (an arc as long at the input position's radius), at a radius from the
    /// input position's to the circle's, by at most `R/kappa`. The nearest radius in one direction is plain; the direction is
    /// sought.
    ///
    /// # Source
    /// \[KTF08, eqs 43 to 47\] without the approximation by the tangent.
    pub(super) fn nearest(&self, input: Vector2<f64>, before: Vector2<f64>) -> Vector2<f64> {
        let off = before - input;
        let in_disc = if off.norm() <= self.friction { before } else { input + off.normalize() * self.friction };
        let in_sector = self.nearest_in_sector(input, before);
        let is_disc = (in_disc - before).norm() <= (in_sector - before).norm();
        if is_disc { in_disc } else { in_sector }
    }

    fn nearest_in_sector(&self, input: Vector2<f64>, before: Vector2<f64>) -> Vector2<f64> {
        let from = input.norm();
        let to = from + (self.radius - from).clamp(-self.reach, self.reach);
        let (least, most) = (from.min(to), from.max(to));
        let half = if from * PI <= self.friction { PI } else { self.friction / from };
        let middle = elementary::atan2(input.y, input.x);
        let point = |turn: f64| {
            let direction = Vector2::new(elementary::cos(middle + turn), elementary::sin(middle + turn));
            direction * direction.dot(&before).clamp(least, most)
        };
        let off = |turn: f64| (point(turn) - before).norm_squared();
        let apart = 2.0 * half / LOOKS as f64;
        let looks = (0..=LOOKS).map(|look| -half + apart * look as f64);
        let best = looks.min_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(0.0);
        let (mut low, mut high) = ((best - apart).max(-half), (best + apart).min(half));
        let golden = 0.5 * (5.0f64.sqrt() - 1.0);
        for _ in 0..CLOSING {
            let (a, b) = (high - golden * (high - low), low + golden * (high - low));
            if off(a) <= off(b) { high = b } else { low = a }
        }
        // The edges themselves are in the set, and a search comes only close to them.
        let found = [low, high, -half, half];
        point(found.into_iter().min_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(best))
    }
}
