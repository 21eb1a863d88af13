//! A fixture in a loop of your own, on a device that takes forces: position in, force out, in three dimensions.
//!
//! ```sh
//! cargo run -p yieldwall --no-default-features --example fixture_in_own_loop
//! ```

use std::error::Error;

use nalgebra::Vector3;
use yieldwall::fixture::prediction::stored_energy_limit_j;
use yieldwall::fixture::{
    Coupling, Curvature, EnergyObserver, Fixture, Impedance, Limits, Parameters, Plane, Rearm, Side,
};

const PERIOD_S: f64 = 0.001;
const YIELD_N: f64 = 20.0;
const STIFFNESS_N_PER_M: f64 = 2000.0;

/// Stands for your device. Put calls of its driver into both functions.
struct Device {
    position_m: Vector3<f64>,
    velocity_m_per_s: Vector3<f64>,
    hand_force_n: Vector3<f64>,
}

impl Device {
    const MASS_KG: f64 = 0.5;

    fn read_position_m(&self) -> Vector3<f64> {
        self.position_m
    }

    fn apply_force_n(&mut self, force_n: &Vector3<f64>) {
        self.velocity_m_per_s += (force_n + self.hand_force_n) / Self::MASS_KG * PERIOD_S;
        self.position_m += self.velocity_m_per_s * PERIOD_S;
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    // The wall is the plane z = 0, and the forbidden side is below.
    let wall = Plane::new(Vector3::zeros(), Vector3::z())?;
    let mut fixture = Fixture::new(
        wall,
        Parameters {
            coupling: Coupling::Impedance(Impedance { stiffness_n_per_m: STIFFNESS_N_PER_M, damping_n_s_per_m: 40.0 }),
            limits: Limits { friction_n: 2.0, yield_n: YIELD_N },
            side: Side::Unilateral,
            hold_steps: 0,
            rearm: Rearm::default(),
            curvature: Curvature::default(),
            period_s: PERIOD_S,
        },
    )?;
    let mut device =
        Device { position_m: Vector3::zeros(), velocity_m_per_s: Vector3::zeros(), hand_force_n: Vector3::zeros() };
    let mut energy = EnergyObserver::new(PERIOD_S, 0.0);

    // Start where the tool is, so that the first force is zero.
    fixture.reset(&device.read_position_m())?;
    let mut proxy_m = Vec::new();
    for (what, hand_force_n, time_s) in [("presses", 15.0, 0.5), ("breaks through", 25.0, 0.1), ("lets go", 0.0, 0.5)] {
        device.hand_force_n = Vector3::new(0.0, 0.0, -hand_force_n);
        // A loop on hardware sleeps until the next period here.
        for _ in 0..(time_s / PERIOD_S).round() as u32 {
            let tool_m = device.read_position_m();
            let step = fixture.step_impedance(&tool_m);
            // A position that is no number is refused, and the force is zero then.
            assert_eq!(step.refused, None);
            device.apply_force_n(&step.force_n);
            energy.observe(&tool_m, &step.force_n, &step);
            assert!(step.force_n.norm() <= YIELD_N * (1.0 + 1e-9), "no more than the yield force");
        }
        let [tool_mm, now_mm] = [device.read_position_m().z, fixture.proxy().z].map(|z_m| 1e3 * z_m);
        println!("{what:>14} with {hand_force_n:4.1} N: tool at z = {tool_mm:7.2} mm, proxy at z = {now_mm:7.2} mm");
        proxy_m.push(fixture.proxy().z);
    }

    let energy = energy.energy();
    let limit_j = stored_energy_limit_j(YIELD_N, STIFFNESS_N_PER_M);
    let (taken_j, returned_j) = (energy.taken_j, energy.largest_return_j);
    println!("the hand gave {taken_j:.3} J and got {returned_j:.3} J back, {limit_j:.3} J at most");
    assert_eq!(proxy_m[0], 0.0, "below the yield force the proxy stays on the wall");
    assert!(proxy_m[1] < -0.02, "above it the wall gives way");
    assert!(proxy_m[2] <= proxy_m[1], "and it stays where it was pushed to, or beyond");
    assert!(returned_j <= limit_j, "only what the coupling's spring held comes back");
    assert!(returned_j < 0.2 * taken_j, "most of the work of the hand is gone");
    Ok(())
}

#[test]
fn what_the_example_says_is_so() -> Result<(), Box<dyn Error>> {
    main()
}
