//! The arm on which the maps of the loop are made.

use nalgebra::Vector2;

use crate::control::Gains;
use crate::linkage::{Chain, FiveBar, Geometry, GeometryError, MassModel, Side, Tool, WristSide};
use crate::sim::arm::ArmParameters;

/// Where the tool starts: on the axis of symmetry, where the directions x and y do not couple.
pub const STUDY_START_M: Vector2<f64> = Vector2::new(0.0, 0.36);

/// Length of its distal links in m.
pub const STUDY_DISTAL_M: f64 = 0.30;

/// PD gains of its joints: N m/rad, N m s/rad.
pub const STUDY_GAINS: Gains = Gains { stiffness: 4000.0, damping: 45.0, integral: 0.0 };

/// A planar arm of plausible size with links that have mass: at [`STUDY_START_M`] it weighs 5.5 kg along x and 3.9 kg
/// along y. `coulomb_n_m` is the dry friction of each joint; there is no viscous friction. `distal_m` is the length of both
/// distal links, 0.3 m in the maps: with 0.25 m they can come to lie on one line.
///
/// # Errors
/// A length that does not close the loop.
pub fn study_arm(coulomb_n_m: f64, distal_m: f64) -> Result<ArmParameters, GeometryError> {
    let linkage = FiveBar::new(Geometry {
        base_m: [[-0.05, 0.0], [0.05, 0.0]],
        proximal_m: [0.25; 2],
        distal_m: [distal_m; 2],
        elbows: [Side::Left, Side::Right],
        wrist: WristSide::Forward,
        tool: Tool { fixed_to: Chain::Right, along_m: 0.0, across_m: 0.0 },
    })?;
    Ok(ArmParameters {
        linkage,
        mass: MassModel { motor_kg_m2: [0.2; 2], proximal_kg: [0.8; 2], distal_kg: [0.5; 2], tool_kg: 0.5 },
        handle_kg: 0.0,
        coulomb_n_m: [coulomb_n_m; 2],
        viscous_n_m_s_per_rad: [0.0; 2],
        joint_elasticity: None,
    })
}
