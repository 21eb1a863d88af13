//! The arm of the study, with equations of motion of its own: the closed form for equal distal links.
//!
//! It shares no code with [`yieldwall_motion::linkage`], so that the reference is independent of what it judges.

use nalgebra::{Matrix2, Vector2};
use yieldwall_motion::elementary;

use yieldwall_motion::linkage::{Chain, FiveBar, Geometry, GeometryError, MassModel, Side, Tool, WristSide};
use yieldwall_sim::arm::ArmParameters;

/// Symmetric five-bar of uniform rods, elbows outward, tool at the wrist, in a horizontal plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StudyArm {
    /// Half of the distance between the base joints, which lie on the x axis about the origin, in m.
    pub half_base_m: f64,
    /// Length of each proximal link in m.
    pub proximal_m: f64,
    /// Length of each distal link in m.
    pub distal_m: f64,
    /// Inertia of each motor with its gear, reflected to the joint.
    pub motor_kg_m2: f64,
    /// Mass of each proximal link.
    pub proximal_kg: f64,
    /// Mass of each distal link.
    pub distal_kg: f64,
    /// Mass at the tool.
    pub tool_kg: f64,
    /// Dry friction of each driven joint in N m.
    pub coulomb_n_m: f64,
    /// Viscous friction of each driven joint in N m s/rad.
    pub viscous_n_m_s_per_rad: f64,
}

/// Friction, order of inertia and parallel links of an arm with harmonic drives as in \[KTF08\]. Lengths and masses are chosen: a
/// desk-top arm of aluminium whose distal links never come in line within its reach.
pub const STUDY_ARM: StudyArm = StudyArm {
    half_base_m: 0.05,
    proximal_m: 0.25,
    distal_m: 0.30,
    motor_kg_m2: 0.2,
    proximal_kg: 0.8,
    distal_kg: 0.5,
    tool_kg: 0.5,
    coulomb_n_m: 10.0,
    viscous_n_m_s_per_rad: 1.0,
};

/// Kinematics and equation of motion at one state: `mass * joint acceleration + bias = joint torques`.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Tool point in m.
    pub tip: Vector2<f64>,
    /// Tool velocity per joint rate in m/rad.
    pub jacobian: Matrix2<f64>,
    /// Mass matrix in kg m^2.
    pub mass: Matrix2<f64>,
    /// Coriolis and centrifugal torques in N m.
    pub bias: Vector2<f64>,
}

impl StudyArm {
    /// Kinematics and equation of motion; NaN where the distal links lie on one line or cannot meet.
    ///
    /// # Source
    /// Derived here. The tool lies on the perpendicular bisector of the elbows. A uniform rod between points with
    /// velocities a and b has the kinetic energy `m / 6 (a.a + a.b + b.b)`.
    pub fn motion(&self, angles: Vector2<f64>, rates: Vector2<f64>) -> Motion {
        let unit = angles.map(|angle| Vector2::new(elementary::cos(angle), elementary::sin(angle)));
        let across = |v: Vector2<f64>| Vector2::new(-v.y, v.x);
        let base = [Vector2::new(-self.half_base_m, 0.0), Vector2::new(self.half_base_m, 0.0)];
        let elbow = [base[0] + unit[0] * self.proximal_m, base[1] + unit[1] * self.proximal_m];
        let apart = elbow[1] - elbow[0];
        let height = (self.distal_m * self.distal_m / apart.norm_squared() - 0.25).sqrt();
        let tip = (elbow[0] + elbow[1]) * 0.5 + across(apart) * height;
        let distal = [tip - elbow[0], tip - elbow[1]];
        let elbow_column = [across(unit[0]) * self.proximal_m, across(unit[1]) * self.proximal_m];
        let rows = inverse(&Matrix2::new(distal[0].x, distal[0].y, distal[1].x, distal[1].y));
        let jacobian = rows * Matrix2::new(distal[0].dot(&elbow_column[0]), 0.0, 0.0, distal[1].dot(&elbow_column[1]));

        let tip_velocity = jacobian * rates;
        let elbow_bias = [0, 1].map(|i| -unit[i] * (self.proximal_m * rates[i] * rates[i]));
        let along =
            |i: usize| distal[i].dot(&elbow_bias[i]) - (tip_velocity - elbow_column[i] * rates[i]).norm_squared();
        let tip_bias = rows * Vector2::new(along(0), along(1));

        let turning = self.motor_kg_m2 + (self.proximal_kg + self.distal_kg) * self.proximal_m * self.proximal_m / 3.0;
        let at_tip = self.tool_kg + 2.0 * self.distal_kg / 3.0;
        let sixth = self.distal_kg / 6.0;
        let mut mass = Matrix2::from_diagonal_element(turning) + jacobian.transpose() * jacobian * at_tip;
        let mut bias = jacobian.transpose() * (tip_bias * at_tip + (elbow_bias[0] + elbow_bias[1]) * sixth);
        for (joint, elbow) in elbow_column.iter().enumerate() {
            let mut column = Matrix2::zeros();
            column.set_column(joint, elbow);
            mass += (column.transpose() * jacobian + jacobian.transpose() * column) * sixth;
            bias += column.transpose() * tip_bias * sixth;
        }
        Motion { tip, jacobian, mass, bias }
    }

    /// Joint angles that hold the tool at `tip`, elbows outward; NaN out of reach.
    pub fn inverse(&self, tip: Vector2<f64>) -> Vector2<f64> {
        let angle = |base_x: f64, side: f64| {
            let reach = tip - Vector2::new(base_x, 0.0);
            let (l1, l2) = (self.proximal_m, self.distal_m);
            let cos = (reach.norm_squared() + l1 * l1 - l2 * l2) / (2.0 * l1 * reach.norm());
            elementary::atan2(reach.y, reach.x) + side * elementary::acos(cos)
        };
        Vector2::new(angle(-self.half_base_m, 1.0), angle(self.half_base_m, -1.0))
    }

    /// Returns the arm with the parameters of the simulation.
    ///
    /// # Errors
    /// For lengths that are no linkage.
    pub fn parameters(&self) -> Result<ArmParameters, GeometryError> {
        let linkage = FiveBar::new(Geometry {
            base_m: [[-self.half_base_m, 0.0], [self.half_base_m, 0.0]],
            proximal_m: [self.proximal_m; 2],
            distal_m: [self.distal_m; 2],
            elbows: [Side::Left, Side::Right],
            wrist: WristSide::Forward,
            tool: Tool { fixed_to: Chain::Right, along_m: 0.0, across_m: 0.0 },
        })?;
        Ok(ArmParameters {
            linkage,
            mass: MassModel {
                motor_kg_m2: [self.motor_kg_m2; 2],
                proximal_kg: [self.proximal_kg; 2],
                distal_kg: [self.distal_kg; 2],
                tool_kg: self.tool_kg,
            },
            handle_kg: 0.0,
            coulomb_n_m: [self.coulomb_n_m; 2],
            viscous_n_m_s_per_rad: [self.viscous_n_m_s_per_rad; 2],
            joint_elasticity: None,
        })
    }
}

/// Inverse of a matrix; not finite if there is none.
pub(super) fn inverse(matrix: &Matrix2<f64>) -> Matrix2<f64> {
    Matrix2::new(matrix.m22, -matrix.m12, -matrix.m21, matrix.m11) / matrix.determinant()
}
