//! References of a fixture: surfaces, curves and points.

use garde::Validate;
use nalgebra::SVector;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::number::{Finite, NotNegative, Positive};
use yieldwall_motion::fixture::{
    self, Chain, Circle, Cuboid, Cylinder, FixtureError, Plane, Shape2, Shape3, Sphere, Surface as _,
};

/// Reference of a fixture. `circle`, `line`, `polygon`, `closed_curve`, `open_curve` and `point` lie in the plane of a
/// rig; `cylinder`, `plane`, `sphere`, `box`, `space_curve` and `space_point` in the space of an impedance device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub enum Surface {
    /// Circle in the plane.
    Circle {
        /// Centre, m.
        center_m: [Finite; 2],
        /// Radius, m. Above 0.
        #[garde(dive)]
        radius_m: Positive,
        /// The side that a unilateral fixture forbids; without effect when `side` is bilateral.
        forbidden: Forbidden,
    },
    /// Straight line in the plane.
    Line {
        /// A point of the line, m.
        point_m: [Finite; 2],
        /// Direction across the line, of any length but 0; it points out of the forbidden side.
        normal: [Finite; 2],
    },
    /// Circular cylinder in space, of infinite length.
    Cylinder {
        /// A point of the axis, m.
        axis_point_m: [Finite; 3],
        /// Direction of the axis, of any length but 0.
        axis_direction: [Finite; 3],
        /// Radius, m. Above 0.
        #[garde(dive)]
        radius_m: Positive,
        /// The side that a unilateral fixture forbids; without effect when `side` is bilateral.
        forbidden: Forbidden,
    },
    /// Plane in space.
    Plane {
        /// A point of the plane, m.
        point_m: [Finite; 3],
        /// Direction across the plane, of any length but 0; it points out of the forbidden side.
        normal: [Finite; 3],
    },
    /// Sphere in space.
    Sphere {
        /// Centre, m.
        center_m: [Finite; 3],
        /// Radius, m. Above 0.
        #[garde(dive)]
        radius_m: Positive,
        /// The side that a unilateral fixture forbids; without effect when `side` is bilateral.
        forbidden: Forbidden,
    },
    /// Straight edges between corners, closed: a polygon, convex or not.
    Polygon {
        /// Corners in order, m. 3 to 32768, as far as the file's limit of 20000 values allows; no edges that cross.
        #[garde(length(min = 3, max = 32_768))]
        points_m: Vec<[Finite; 2]>,
        /// The side that a unilateral fixture forbids; without effect when `side` is bilateral.
        forbidden: Forbidden,
    },
    /// Smooth closed curve in the plane: a cubic spline through points.
    ClosedCurve {
        /// Points in order, m. 3 to 512; the curve does not cross itself.
        #[garde(length(min = 3, max = 512))]
        points_m: Vec<[Finite; 2]>,
        /// The side that a unilateral fixture forbids; without effect when `side` is bilateral.
        forbidden: Forbidden,
    },
    /// Smooth open curve in the plane: a cubic spline through points. A unilateral fixture forbids its right side.
    OpenCurve {
        /// Points in order, m. 2 to 512; the curve does not cross itself.
        #[garde(length(min = 2, max = 512))]
        points_m: Vec<[Finite; 2]>,
    },
    /// Point in the plane; `side` is bilateral.
    Point {
        /// Position, m.
        point_m: [Finite; 2],
        /// Distance at which the point captures a passing proxy, m. 0 to 0.1; 0: never. The proxy moves onto the point within one
        /// cycle, so at most half of the distance that `guard.tool_speed_limit_m_per_s` allows in a cycle.
        #[garde(dive)]
        capture_radius_m: NotNegative,
    },
    /// Box in space with its edges along the axes.
    Box {
        /// Centre, m.
        center_m: [Finite; 3],
        /// Distance from the centre to each side, m. Above 0.
        #[garde(dive)]
        half_size_m: [Positive; 3],
        /// The side that a unilateral fixture forbids; without effect when `side` is bilateral.
        forbidden: Forbidden,
    },
    /// Smooth curve in space: a cubic spline through points; `side` is bilateral.
    SpaceCurve {
        /// Points in order, m. 2 to 512, at least 3 when closed.
        #[garde(length(min = 2, max = 512))]
        points_m: Vec<[Finite; 3]>,
        /// Whether the curve joins its last point to the first.
        is_closed: bool,
        /// Distance at which the curve captures a passing proxy, m. 0 to 0.1; 0: never.
        #[garde(dive)]
        capture_radius_m: NotNegative,
    },
    /// Point in space; `side` is bilateral.
    SpacePoint {
        /// Position, m.
        point_m: [Finite; 3],
        /// Distance at which the point captures a passing proxy, m. 0 to 0.1; 0: never.
        #[garde(dive)]
        capture_radius_m: NotNegative,
    },
}

impl Surface {
    /// Dimension of the space in which it lies: 2 or 3.
    pub fn dimension(&self) -> usize {
        match self {
            Self::Circle { .. }
            | Self::Line { .. }
            | Self::Polygon { .. }
            | Self::ClosedCurve { .. }
            | Self::OpenCurve { .. }
            | Self::Point { .. } => 2,
            Self::Cylinder { .. }
            | Self::Plane { .. }
            | Self::Sphere { .. }
            | Self::Box { .. }
            | Self::SpaceCurve { .. }
            | Self::SpacePoint { .. } => 3,
        }
    }

    /// Key that names it in a file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Circle { .. } => "circle",
            Self::Line { .. } => "line",
            Self::Cylinder { .. } => "cylinder",
            Self::Plane { .. } => "plane",
            Self::Sphere { .. } => "sphere",
            Self::Polygon { .. } => "polygon",
            Self::ClosedCurve { .. } => "closed_curve",
            Self::OpenCurve { .. } => "open_curve",
            Self::Point { .. } => "point",
            Self::Box { .. } => "box",
            Self::SpaceCurve { .. } => "space_curve",
            Self::SpacePoint { .. } => "space_point",
        }
    }

    /// Key of the numbers that give its size or shape.
    pub fn size_key(&self) -> &'static str {
        match self {
            Self::Circle { .. } | Self::Cylinder { .. } | Self::Sphere { .. } => "radius_m",
            Self::Line { .. } | Self::Plane { .. } => "normal",
            Self::Polygon { .. } | Self::ClosedCurve { .. } | Self::OpenCurve { .. } | Self::SpaceCurve { .. } => {
                "points_m"
            }
            Self::Point { .. } | Self::SpacePoint { .. } => "capture_radius_m",
            Self::Box { .. } => "half_size_m",
        }
    }

    /// Whether it has sides, so that a fixture can be unilateral.
    pub fn has_sides(&self) -> bool {
        !matches!(self, Self::Point { .. } | Self::SpaceCurve { .. } | Self::SpacePoint { .. })
    }

    /// A few words that describe it.
    pub fn summary(&self) -> String {
        match self {
            Self::Circle { radius_m, .. } | Self::Cylinder { radius_m, .. } | Self::Sphere { radius_m, .. } => {
                format!("{} of {} m", self.name(), **radius_m)
            }
            Self::Polygon { points_m, .. } => format!("polygon of {} corners", points_m.len()),
            Self::ClosedCurve { points_m, .. } => format!("closed curve through {} points", points_m.len()),
            Self::OpenCurve { points_m } => format!("open curve through {} points", points_m.len()),
            Self::SpaceCurve { points_m, .. } => format!("curve in space through {} points", points_m.len()),
            Self::Line { .. } | Self::Plane { .. } | Self::Point { .. } | Self::Box { .. } => self.name().to_owned(),
            Self::SpacePoint { .. } => "point in space".to_owned(),
        }
    }

    /// The shape in the plane; `None` for one in space.
    ///
    /// # Errors
    /// Why the numbers give no shape.
    pub fn planar(&self) -> Result<Option<Shape2>, FixtureError> {
        let all = |points: &[[Finite; 2]]| points.iter().map(vector).collect::<Vec<_>>();
        Ok(Some(match self {
            Self::Circle { center_m, radius_m, forbidden } => {
                Shape2::Circle(Circle::new(vector(center_m), **radius_m, (*forbidden).into())?)
            }
            Self::Line { point_m, normal } => Shape2::Line(Plane::new(vector(point_m), vector(normal))?),
            Self::Polygon { points_m, forbidden } => {
                Shape2::Chain(Chain::polygon(&all(points_m), (*forbidden).into())?)
            }
            Self::ClosedCurve { points_m, forbidden } => {
                Shape2::Chain(Chain::closed_curve(&all(points_m), (*forbidden).into())?)
            }
            Self::OpenCurve { points_m } => Shape2::Chain(Chain::open_curve(&all(points_m))?),
            Self::Point { point_m, capture_radius_m } => {
                Shape2::Chain(Chain::point(vector(point_m), **capture_radius_m)?)
            }
            _ => return Ok(None),
        }))
    }

    /// The shape in space; `None` for one in the plane.
    ///
    /// # Errors
    /// Why the numbers give no shape.
    pub fn spatial(&self) -> Result<Option<Shape3>, FixtureError> {
        Ok(Some(match self {
            Self::Cylinder { axis_point_m, axis_direction, radius_m, forbidden } => Shape3::Cylinder(Cylinder::new(
                vector(axis_point_m),
                vector(axis_direction),
                **radius_m,
                (*forbidden).into(),
            )?),
            Self::Plane { point_m, normal } => Shape3::Plane(Plane::new(vector(point_m), vector(normal))?),
            Self::Sphere { center_m, radius_m, forbidden } => {
                Shape3::Sphere(Sphere::new(vector(center_m), **radius_m, (*forbidden).into())?)
            }
            Self::Box { center_m, half_size_m, forbidden } => {
                let half = SVector::from(half_size_m.map(|value| value.get()));
                Shape3::Cuboid(Cuboid::new(vector(center_m), half, (*forbidden).into())?)
            }
            Self::SpaceCurve { points_m, is_closed, capture_radius_m } => {
                let points: Vec<_> = points_m.iter().map(vector).collect();
                Shape3::Chain(Chain::space_curve(&points, *is_closed, **capture_radius_m)?)
            }
            Self::SpacePoint { point_m, capture_radius_m } => {
                Shape3::Chain(Chain::point(vector(point_m), **capture_radius_m)?)
            }
            _ => return Ok(None),
        }))
    }

    /// Smallest radius of curvature in m; infinite when flat.
    ///
    /// # Errors
    /// Why the numbers give no shape.
    pub fn smallest_radius_m(&self) -> Result<f64, FixtureError> {
        let planar = self.planar()?.map(|shape| shape.smallest_radius_m());
        let spatial = self.spatial()?.map(|shape| shape.smallest_radius_m());
        Ok(planar.or(spatial).unwrap_or(f64::INFINITY))
    }
}

fn vector<const N: usize>(point: &[Finite; N]) -> SVector<f64, N> {
    SVector::from(point.map(|value| value.get()))
}

impl From<Forbidden> for fixture::Forbidden {
    fn from(side: Forbidden) -> Self {
        match side {
            Forbidden::Inside => Self::Inside,
            Forbidden::Outside => Self::Outside,
        }
    }
}

/// Side of a closed surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Forbidden {
    /// The side of the centre.
    Inside,
    /// The far side.
    Outside,
}
