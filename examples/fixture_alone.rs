//! A fixture alone: a wall that stands below its yield force, gives way above it, and does not push back.
//!
//! ```sh
//! cargo run -p yieldwall --no-default-features --example fixture_alone
//! ```

use std::error::Error;

use nalgebra::Vector2;
use yieldwall::fixture::{Admittance, Coupling, Curvature, Fixture, Limits, Line, Parameters, Rearm, Side};

const PERIOD_S: f64 = 0.001;
const MASS_KG: f64 = 2.0;
const FRICTION_N: f64 = 3.0;
const YIELD_N: f64 = 20.0;

fn main() -> Result<(), Box<dyn Error>> {
    // The wall is the x axis. Its normal points out of the forbidden side, which is below.
    let wall = Line::new(Vector2::zeros(), Vector2::y())?;
    let mut fixture = Fixture::new(
        wall,
        Parameters {
            coupling: Coupling::Admittance(Admittance { mass_kg: MASS_KG }),
            limits: Limits { friction_n: FRICTION_N, yield_n: YIELD_N },
            side: Side::Unilateral,
            hold_steps: 0,
            rearm: Rearm::default(),
            curvature: Curvature::default(),
            period_s: PERIOD_S,
        },
    )?;
    // The proxy begins at rest on the wall. The tool of a rig follows the proxy.
    fixture.reset(&Vector2::zeros())?;

    let below_m = push(&mut fixture, -15.0, 0.5);
    assert!(below_m.abs() < 1e-9, "15 N is below the yield force, and the wall gave way by {below_m} m");

    let above_m = push(&mut fixture, -25.0, 0.2);
    // The 5 N above the yield force move the mass.
    let expected_m = -0.5 * (25.0 - YIELD_N) / MASS_KG * 0.2 * 0.2;
    assert!((above_m - expected_m).abs() < 0.001, "{above_m} m in place of {expected_m} m");

    let stopped_m = push(&mut fixture, 0.0, 0.5);
    assert!(stopped_m <= above_m, "the wall pushed the tool back");
    let rests_m = push(&mut fixture, 0.0, 0.5);
    assert_eq!(rests_m, stopped_m, "a hand that has let go is not moved");

    let out_m = push(&mut fixture, 10.0, 0.5);
    assert!(out_m > 0.0, "the way out takes no more than the friction");
    Ok(())
}

/// Pushes along the y axis for a while, and says where the proxy is then.
fn push(fixture: &mut Fixture<Line, 2>, force_n: f64, time_s: f64) -> f64 {
    for _ in 0..(time_s / PERIOD_S).round() as u32 {
        fixture.step_admittance(&Vector2::new(0.0, force_n));
    }
    let y_m = fixture.proxy().y;
    println!("{force_n:6.1} N for {time_s} s: the proxy is at y = {:7.2} mm", 1e3 * y_m);
    y_m
}

#[test]
fn what_the_example_says_is_so() -> Result<(), Box<dyn Error>> {
    main()
}
