//! More of the arm is tested beside the arm of the study of plants, which knows another way to move it.

use nalgebra::Vector2;
use yieldwall_motion::elementary;
use yieldwall_motion::linkage::{Chain, Geometry, Side, Tool, WristSide};

use super::*;

/// An attached mass and a force less what that mass takes are the same to the arm, to rounding.
#[test]
fn the_attached_mass_is_felt_through_the_tip_acceleration() {
    let linkage = FiveBar::new(Geometry {
        base_m: [[-0.05, 0.0], [0.05, 0.0]],
        proximal_m: [0.25; 2],
        distal_m: [0.30; 2],
        elbows: [Side::Left, Side::Right],
        wrist: WristSide::Forward,
        tool: Tool { fixed_to: Chain::Right, along_m: 0.0, across_m: 0.0 },
    })
    .unwrap();
    let mass = MassModel { motor_kg_m2: [0.2; 2], proximal_kg: [0.8; 2], distal_kg: [0.5; 2], tool_kg: 0.5 };
    let alone = ArmParameters {
        linkage,
        mass,
        handle_kg: 0.0,
        coulomb_n_m: [10.0; 2],
        viscous_n_m_s_per_rad: [1.0; 2],
        joint_elasticity: None,
    };
    let start = linkage.inverse(TipPoint::new(0.05, 0.34)).unwrap();
    let mut held = Arm::new(&ArmParameters { handle_kg: 0.5, ..alone }, start).unwrap();
    let mut alone = Arm::new(&alone, start).unwrap();
    let mut moved = 0u32;
    for index in 0..3000 {
        let force_n = Vector2::new(
            90.0 * elementary::sin(f64::from(index) * 2e-2),
            70.0 * elementary::cos(f64::from(index) * 3.1e-2),
        );
        let torques = JointTorques::new(3.0, -2.0);
        held.advance(1e-4, torques, |_, _| HandLoad { force_n, ..HandLoad::default() }).unwrap();
        let taken = Vector2::from(held.tip().unwrap().acceleration_m_per_s2) * 0.5;
        let force_n = force_n - taken;
        alone.advance(1e-4, torques, |_, _| HandLoad { force_n, ..HandLoad::default() }).unwrap();
        moved += u32::from(held.rates() != JointRates::default());
        assert!((held.rates() - alone.rates()).norm() < 1e-11);
        // Its state with the masses of `alone`, so that rounding does not add up over the steps.
        alone = Arm { mass: alone.mass, ..held.clone() };
    }
    assert!(moved > 500, "{moved}");
}
