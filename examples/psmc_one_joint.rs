//! Proxy-based sliding mode control (PSMC) of one joint with a torque limit, beside PID with the same gains.
//!
//! ```sh
//! cargo run -p yieldwall --no-default-features --example psmc_one_joint
//! ```

use std::error::Error;

use yieldwall::control::{AxisController, ControlError, EffortRange, Gains, Law};

const PERIOD_S: f64 = 0.001;
const INERTIA_KG_M2: f64 = 0.5;
const TORQUE_LIMIT_N_M: f64 = 10.0;
const TARGET_RAD: f64 = 1.0;
/// `H`, at least 1.3 v/(2 a) for no overshoot: with the peak speed v of 4.5 rad/s and the deceleration a of 20 rad/s^2.
const SLIDING_TIME_S: f64 = 0.15;

/// Result of one move of the joint.
struct Move {
    overshoot_rad: f64,
    greatest_torque_n_m: f64,
    /// Error that remains after two seconds.
    error_rad: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let psmc = move_joint(Law::Psmc)?;
    let pid = move_joint(Law::Pid)?;
    for (name, joint) in [("PSMC", &psmc), ("PID", &pid)] {
        println!(
            "{name:>4}: overshoot {:6.1} mrad, greatest torque {:4.1} N m, error after 2 s {:7.2} mrad",
            1e3 * joint.overshoot_rad,
            joint.greatest_torque_n_m,
            1e3 * joint.error_rad
        );
        assert_eq!(joint.greatest_torque_n_m, TORQUE_LIMIT_N_M, "the step is so large that the limit is reached");
    }
    assert!(psmc.overshoot_rad < 0.001, "PSMC comes back from the limit without overshoot");
    assert!(psmc.error_rad.abs() < 0.001, "and arrives");
    assert!(pid.overshoot_rad > 0.1, "PID with the same gains arrives too fast to stop");
    Ok(())
}

/// Moves a joint at rest to the target for two seconds.
fn move_joint(law: Law) -> Result<Move, ControlError> {
    // In N m/rad, N m s/rad and N m/(rad s).
    let gains = Gains { stiffness: 2000.0, damping: 40.0, integral: 2000.0 };
    let mut controller = law.controller(gains, SLIDING_TIME_S, PERIOD_S)?;
    let (mut angle_rad, mut rate_rad_per_s) = (0.0, 0.0);
    let mut result = Move { overshoot_rad: 0.0, greatest_torque_n_m: 0.0, error_rad: 0.0 };
    for _ in 0..2000 {
        let step = controller.step(TARGET_RAD - angle_rad, EffortRange::symmetric(TORQUE_LIMIT_N_M));
        rate_rad_per_s += step.effort / INERTIA_KG_M2 * PERIOD_S;
        angle_rad += rate_rad_per_s * PERIOD_S;
        result.overshoot_rad = result.overshoot_rad.max(angle_rad - TARGET_RAD);
        result.greatest_torque_n_m = result.greatest_torque_n_m.max(step.effort.abs());
    }
    result.error_rad = TARGET_RAD - angle_rad;
    Ok(result)
}

#[test]
fn what_the_example_says_is_so() -> Result<(), Box<dyn Error>> {
    main()
}
