//! Response of a force sensor to known forces in a plane.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::NotIdentified;
use crate::elementary;

/// Pulls at least, rest among them.
const LEAST: usize = 4;

/// A force that pulled, N, and what was felt of it, N, both along the sensor's axes.
pub type Pull = ([f64; 2], [f64; 2]);

/// `felt = matrix * true + zero`, along the sensor's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceMap {
    /// Sensed force along x and y for 1 N along x (first column) and along y.
    pub matrix: [[f64; 2]; 2],
    /// Sensed force without a load, N.
    pub zero_n: [f64; 2],
    /// Root mean square of the map's residual, N.
    pub residual_n: f64,
}

impl ForceMap {
    /// Returns the sensed force for 1 N along each axis, in whatever direction.
    pub fn gains(&self) -> [f64; 2] {
        let [[xx, xy], [yx, yy]] = self.matrix;
        [elementary::hypot(xx, yx), elementary::hypot(xy, yy)]
    }

    /// Returns the common rotation of both axes, counter-clockwise, rad: the rotation that is nearest to the map.
    pub fn turn_rad(&self) -> f64 {
        let [[xx, xy], [yx, yy]] = self.matrix;
        elementary::atan2(yx - xy, xx + yy)
    }

    /// Returns the greatest share of a force that is felt along the other axis, once both are turned back.
    pub fn cross_talk(&self) -> f64 {
        let (sin, cos) = elementary::sin_cos(-self.turn_rad());
        let straight = Matrix2::new(cos, -sin, sin, cos) * self.as_matrix();
        let [gain_x, gain_y] = self.gains();
        (straight[(1, 0)] / gain_x).abs().max((straight[(0, 1)] / gain_y).abs())
    }

    /// Whether one axis is felt with the wrong sign, or both are taken for one another.
    pub fn is_mirrored(&self) -> bool {
        self.as_matrix().determinant() < 0.0
    }

    /// Returns the map from what is felt, less the zero, to the true force; none if it has no inverse.
    pub fn inverse(&self) -> Option<[[f64; 2]; 2]> {
        let inverse = self.as_matrix().try_inverse()?;
        Some([[inverse[(0, 0)], inverse[(0, 1)]], [inverse[(1, 0)], inverse[(1, 1)]]])
    }

    fn as_matrix(&self) -> Matrix2<f64> {
        let [[xx, xy], [yx, yy]] = self.matrix;
        Matrix2::new(xx, xy, yx, yy)
    }
}

/// Fits the map to pulls, of which rest is one, by least squares.
///
/// # Errors
/// [`NotIdentified::TooFew`] for less than four pulls, [`NotIdentified::NotFinite`], and [`NotIdentified::Apart`] where they do not pull in two
/// directions.
pub fn force_map(pulls: &[Pull]) -> Result<ForceMap, NotIdentified> {
    if pulls.len() < LEAST {
        return Err(NotIdentified::TooFew);
    }
    if !pulls.iter().all(|(pulled, felt)| pulled.iter().chain(felt).all(|force| force.is_finite())) {
        return Err(NotIdentified::NotFinite);
    }
    let row = |[x, y]: [f64; 2]| Vector3::new(x, y, 1.0);
    let normal: Matrix3<f64> = pulls.iter().map(|(pulled, _)| row(*pulled) * row(*pulled).transpose()).sum();
    let solver = normal.cholesky().ok_or(NotIdentified::Apart)?;
    let fit = |axis: usize| solver.solve(&pulls.iter().map(|(pulled, felt)| row(*pulled) * felt[axis]).sum());
    let (x, y): (Vector3<f64>, Vector3<f64>) = (fit(0), fit(1));
    let left = |(pulled, felt): &Pull| {
        (Vector2::new(x.dot(&row(*pulled)), y.dot(&row(*pulled))) - Vector2::from(*felt)).norm_squared()
    };
    let residual_n = (pulls.iter().map(left).sum::<f64>() / pulls.len() as f64).sqrt();
    Ok(ForceMap { matrix: [[x.x, x.y], [y.x, y.y]], zero_n: [x.z, y.z], residual_n })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PULLED: [[f64; 2]; 5] = [[0.0, 0.0], [8.0, 0.0], [-8.0, 0.0], [0.0, 8.0], [0.0, -8.0]];

    proptest! {
        #[test]
        fn gains_turn_cross_talk_and_zero_are_found(
            gains in prop::array::uniform2(0.7..1.3f64), turn in -0.6..0.6f64, talk in -0.1..0.1f64,
            zero in prop::array::uniform2(-3.0..3.0f64),
        ) {
            let (sin, cos) = elementary::sin_cos(turn);
            let made = Matrix2::new(cos, -sin, sin, cos) * Matrix2::new(gains[0], talk, talk, gains[1]);
            let pulls = PULLED.map(|pulled| {
                let felt = made * Vector2::from(pulled) + Vector2::from(zero);
                (pulled, [felt.x, felt.y])
            });
            let map = force_map(&pulls).unwrap();
            prop_assert!((map.turn_rad() - turn).abs() < 1e-9, "{map:?}");
            prop_assert!(map.residual_n < 1e-9 && !map.is_mirrored());
            prop_assert!((0..2).all(|axis| (map.zero_n[axis] - zero[axis]).abs() < 1e-9));
            prop_assert!(map.cross_talk() <= talk.abs() / 0.69 + 1e-9, "{map:?}");
            let [[a, b], [c, d]] = map.inverse().unwrap();
            let back = Matrix2::new(a, b, c, d) * made;
            prop_assert!((back - Matrix2::identity()).norm() < 1e-9);
        }
    }

    #[test]
    fn swapped_axes_are_mirrored_and_pulls_along_one_axis_tell_nothing() {
        let swapped = PULLED.map(|[x, y]| ([x, y], [y, x]));
        assert!(force_map(&swapped).unwrap().is_mirrored());
        let along_x = [0.0, 8.0, -8.0, 4.0].map(|x| ([x, 0.0], [x, 0.0]));
        assert_eq!(force_map(&along_x), Err(NotIdentified::Apart));
        assert_eq!(force_map(&along_x[..2]), Err(NotIdentified::TooFew));
    }
}
