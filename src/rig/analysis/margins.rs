//! Margins of a rig's own loop over the poses of its surface.

use nalgebra::Vector2;
use yieldwall_motion::elementary;

use crate::RigError;
use yieldwall_config as config;
use yieldwall_motion::control::{Margins, ServoLoop, principal_inertias, worst_margins};
use yieldwall_motion::fixture::Shape2;
use yieldwall_motion::linkage::MassModel;
use yieldwall_motion::quantity::{JointAngles, JointRates, TipPoint};
use yieldwall_run::assembly::{delay_cycles, gains, linkage, period_s, plant_mass};

/// Margins of the torque loop at its worst pose, with and without the joints' viscous friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// With the viscous friction of the feed-forward's model taken as present in the joints.
    pub with_friction: Margins,
    /// Without any friction.
    pub without_friction: Margins,
}

/// The loop of a rig in torque mode over the poses of its surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseMargins {
    /// Cycles of delay that the margins count with.
    pub delay_cycles: f64,
    /// Least and greatest principal inertia over the poses: kg m^2 per joint, or kg at the tool.
    pub inertia: [f64; 2],
    /// The worst over all poses.
    pub worst: Margin,
    /// Whether the controllers act on the tool's position.
    pub is_cartesian: bool,
}

/// Poses along a surface at which the margins are taken; along each of several, as many as keep to this in all.
const POSES: usize = 48;
/// Poses along each surface, at least.
const LEAST_POSES: usize = 12;

/// Returns the poses of the margins: all along every surface of the fixture.
pub(super) fn poses(rig: &config::Rig) -> Vec<Vector2<f64>> {
    let surfaces = 1 + rig.fixture.also.len();
    let each = (POSES / surfaces).max(LEAST_POSES);
    rig.fixture.surfaces().flat_map(|(_, surface)| poses_along(rig, surface, each)).collect()
}

/// Returns this number of poses along a circle or a line within the working disc, or along corners and edges of an outline.
fn poses_along(rig: &config::Rig, surface: &config::Surface, poses: usize) -> Vec<Vector2<f64>> {
    let working_m = rig.linkage.working_radius_m.get();
    let around = |center: Vector2<f64>, radius_m: f64| {
        let at = move |pose| std::f64::consts::TAU * pose as f64 / poses as f64;
        (0..poses)
            .map(move |pose| center + radius_m * Vector2::new(elementary::cos(at(pose)), elementary::sin(at(pose))))
            .collect()
    };
    match *surface {
        config::Surface::Circle { center_m, radius_m, .. } => around(point2(center_m), radius_m.get()),
        config::Surface::Line { point_m, normal } => {
            let normal = point2(normal).normalize();
            let foot = normal * normal.dot(&point2(point_m));
            let half_m = (working_m * working_m - foot.norm_squared()).max(0.0).sqrt();
            let along = Vector2::new(-normal.y, normal.x) * half_m;
            (0..poses).map(|pose| foot + along * (2.0 * pose as f64 / (poses - 1) as f64 - 1.0)).collect()
        }
        ref other => match other.planar() {
            Ok(Some(Shape2::Chain(chain))) => along(&chain.outline_m(), chain.is_closed(), poses),
            // A rig is planar: others are refused when its cycle is built.
            _ => around(Vector2::zeros(), working_m),
        },
    }
}

/// Returns every corner of an outline and points along its edges, with distances of at most a share of the whole. If an outline has
/// more corners than poses, it returns only some corners, evenly spaced.
fn along(outline_m: &[Vector2<f64>], is_closed: bool, poses: usize) -> Vec<Vector2<f64>> {
    let corners: Vec<_> = outline_m.iter().copied().step_by(outline_m.len().div_ceil(poses).max(1)).collect();
    let ends = corners.iter().skip(1).chain(corners.first().filter(|_| is_closed));
    let edges: Vec<_> = corners.iter().copied().zip(ends.copied()).collect();
    let whole_m: f64 = edges.iter().map(|(from, to)| (to - from).norm()).sum();
    let mut points: Vec<_> = edges
        .iter()
        .flat_map(|&(from, to)| {
            let parts = ((to - from).norm() / whole_m * poses as f64).ceil().max(1.0) as usize;
            (0..parts).map(move |part| from + (to - from) * (part as f64 / parts as f64))
        })
        .collect();
    points.extend(corners.last().filter(|_| !is_closed));
    points
}

/// Returns the loop margins of a rig in torque mode over poses all along its reference surface. `None` in the other modes, in which
/// the drives close the position loop.
///
/// The plant of the margins is the feed-forward's model of the arm where there is one, else the simulated arm.
///
/// # Errors
/// If the arm cannot be built, does not reach a pose or is singular there; or neither feed-forward nor simulation knows it.
pub fn pose_margins(rig: &config::Rig) -> Result<Option<PoseMargins>, RigError> {
    if rig.rig.command_mode != config::CommandMode::Torque {
        return Ok(None);
    }
    let model =
        rig.control.feed_forward.inertia.as_ref().map_or_else(|| plant_mass(rig), |model| Ok(model.mass_model()))?;
    let viscous = rig.control.feed_forward.viscous_n_m_s_per_rad.map(|value| value.get());
    margins_of(rig, &[model], viscous, delay_cycles(rig)?)
}

/// Returns the margins for each of these models of the arm, with this viscous friction of the joints in N m s/rad, and this delay.
pub(super) fn margins_of(
    rig: &config::Rig,
    models: &[MassModel],
    viscous: [f64; 2],
    delay_cycles: f64,
) -> Result<Option<PoseMargins>, RigError> {
    let Some((gains, is_cartesian)) = gains(&rig.control) else { return Ok(None) };
    let linkage = linkage(rig)?;
    let mut inertias = Vec::new();
    let mut viscous_at = f64::INFINITY;
    for (pose, model) in poses(rig).into_iter().flat_map(|pose| models.iter().map(move |model| (pose, model))) {
        let angles: JointAngles = linkage.inverse(TipPoint(pose))?;
        let dynamics = linkage.dynamics(model, angles, JointRates::default())?;
        let (mass, damping) = if is_cartesian {
            let inverse = dynamics.jacobian.try_inverse().ok_or(RigError::Singular)?;
            let damping = inverse.transpose() * nalgebra::Matrix2::from_diagonal(&Vector2::from(viscous)) * inverse;
            let least = damping.symmetric_eigenvalues().min();
            (inverse.transpose() * dynamics.mass * inverse, least)
        } else {
            (dynamics.mass, viscous[0].min(viscous[1]))
        };
        viscous_at = viscous_at.min(damping);
        inertias.extend(principal_inertias(&mass)?);
    }
    let servo = ServoLoop { gains, period_s: period_s(rig), delay_cycles };
    let worst = Margin {
        with_friction: worst_margins(&servo, &inertias, viscous_at)?,
        without_friction: worst_margins(&servo, &inertias, 0.0)?,
    };
    let least = inertias.iter().copied().fold(f64::INFINITY, f64::min);
    let greatest = inertias.iter().copied().fold(0.0, f64::max);
    Ok(Some(PoseMargins { delay_cycles, inertia: [least, greatest], worst, is_cartesian }))
}

fn point2(point: [config::Finite; 2]) -> Vector2<f64> {
    Vector2::from(point.map(|value| value.get()))
}
