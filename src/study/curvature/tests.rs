use super::*;
use yieldwall_motion::elementary;

/// Figures of the step in the literature's form, measured before with other means: error over `F/kappa` by ratio.
const MEASURED: [(f64, f64); 5] = [(100.0, 0.010), (33.0, 0.032), (10.0, 0.113), (5.0, 0.25), (2.0, 0.97)];

/// A search for the least of a smooth function cannot see closer than the root of rounding.
const CLOSE: f64 = 1e-7;

#[test]
fn the_exact_step_finds_the_nearest_point_and_the_tangent_errs_by_the_radius() {
    let mut before = 0.0;
    for (ratio, measured) in MEASURED {
        let [tangent, exact] = errors(ratio);
        assert!(exact < CLOSE, "{ratio}: {exact}");
        assert!((tangent / measured - 1.0).abs() < 0.1, "{ratio}: {tangent}, {measured}");
        assert!(tangent > before);
        before = tangent;
    }
}

#[test]
fn the_truth_is_in_the_set_and_nothing_nearer_is() {
    let set = Annulus { friction: 0.2, reach: 1.2, radius: 3.0 };
    // By hand: straight above the input position, the arc's edge, the disc.
    let input = Vector2::new(2.0, 0.0);
    let near = |x: f64, y: f64| set.nearest(input, Vector2::new(x, y));
    assert!((near(2.6, 0.0) - Vector2::new(2.6, 0.0)).norm() < CLOSE);
    assert!((near(5.0, 0.0) - Vector2::new(3.0, 0.0)).norm() < CLOSE);
    let edge = Vector2::new(elementary::cos(0.1), elementary::sin(0.1));
    let beside = edge * 2.5 + Vector2::new(-edge.y, edge.x) * 0.3;
    assert!((set.nearest(input, beside) - edge * 2.5).norm() < CLOSE);
    assert!((near(1.0, 0.0) - Vector2::new(1.8, 0.0)).norm() < CLOSE);
}
