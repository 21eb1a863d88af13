//! The rows of a run and what is known about the run as a whole.

/// A proxy nearer to the surface than this, in m, lies on it.
pub const ON_SURFACE_M: f64 = 1e-9;

/// What one control cycle saw and did.
///
/// Real-time: yes, `Copy` and free of heap memory: a cycle may write it into memory set aside before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Row {
    /// Time since the run began, in s.
    pub time_s: f64,
    /// Tool position in m, base frame.
    pub tool_m: [f64; 3],
    /// Proxy position in m, base frame.
    pub proxy_m: [f64; 3],
    /// Tool velocity in m/s, base frame.
    pub tool_velocity_m_per_s: [f64; 3],
    /// Force in N, base frame; whose force on whom is said by [`Trace::force_meaning`].
    pub force_n: [f64; 3],
    /// Age of the sample that the force comes from, in s, from its arrival; 0 without a sensor.
    pub force_age_s: f64,
    /// Power that the device delivers to the hand, in W.
    pub power_w: f64,
    /// Torques commanded at the two joints, in N m.
    pub torques_n_m: [f64; 2],
    /// Angles that the two joints were asked for, in rad.
    pub target_angles_rad: [f64; 2],
    /// Angles measured at the two joints, in rad.
    pub measured_angles_rad: [f64; 2],
    /// Signed distance of the proxy from the reference surface in m, as the fixture counts it.
    pub signed_distance_m: f64,
    /// Whether the fixture holds the proxy on the reference surface.
    pub is_on_surface: bool,
    /// Steps for which the proxy is still held on the surface after an impact (`IsOn` of the paper).
    pub hold_counter: u32,
    /// Whether the proxy met the surface in this cycle.
    pub is_impact: bool,
    /// State of the supervisor, as the number that the supervisor gives it.
    pub supervisor_state: u8,
}

/// Whose force [`Row::force_n`] is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ForceMeaning {
    /// The measured force `h` of the hand on the tool (admittance type): figures draw `-h`.
    #[default]
    HandOnTool,
    /// The actuator force `f` on the tool (impedance type): figures draw `f`.
    ActuatorOnTool,
}

/// The reference surface `C` of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Reference {
    /// No surface: free motion against friction.
    #[default]
    None,
    /// Circle in the plane of x and y; its normal points outward.
    Circle {
        /// Centre in m.
        center_m: [f64; 2],
        /// Radius in m, above zero.
        radius_m: f64,
    },
    /// Cylinder; its normal points away from the axis.
    Cylinder {
        /// A point of the axis in m.
        axis_point_m: [f64; 3],
        /// Direction of the axis, of any length but zero.
        axis_direction: [f64; 3],
        /// Radius in m, above zero.
        radius_m: f64,
    },
    /// Plane in space, or straight line in the plane of x and y.
    Plane {
        /// A point of it in m.
        point_m: [f64; 3],
        /// Its normal, of any length but zero.
        normal: [f64; 3],
    },
    /// Chain of straight pieces in the plane of x and y; its normal points to the left of the way along the points.
    Curve {
        /// Corners in m, at least two.
        points_m: Vec<[f64; 2]>,
        /// Whether the last corner is joined to the first.
        is_closed: bool,
    },
}

impl Reference {
    /// Unit normal of the surface at its point nearest to `point_m`. `None` without a surface, and where no normal
    /// is defined: at a circle's centre, on a cylinder's axis, for a direction of zero length.
    pub fn normal_at(&self, point_m: [f64; 3]) -> Option<[f64; 3]> {
        self.nearest(point_m).map(|(normal, _)| normal)
    }

    /// Signed distance of `point_m` from the surface in m, positive on the side to which the normal points. `None`
    /// where [`Reference::normal_at`] is `None`.
    pub fn signed_distance_m(&self, point_m: [f64; 3]) -> Option<f64> {
        self.nearest(point_m).map(|(_, distance)| distance)
    }

    fn nearest(&self, point: [f64; 3]) -> Option<([f64; 3], f64)> {
        match self {
            Self::None => None,
            Self::Circle { center_m: [x, y], radius_m } => {
                let (normal, length) = unit([point[0] - x, point[1] - y, 0.0])?;
                Some((normal, length - radius_m))
            }
            Self::Cylinder { axis_point_m, axis_direction, radius_m } => {
                let (axis, _) = unit(*axis_direction)?;
                let offset = subtract(point, *axis_point_m);
                let along = dot(offset, axis);
                let (normal, length) = unit(subtract(offset, axis.map(|component| component * along)))?;
                Some((normal, length - radius_m))
            }
            Self::Plane { point_m, normal } => {
                let (normal, _) = unit(*normal)?;
                Some((normal, dot(subtract(point, *point_m), normal)))
            }
            Self::Curve { points_m, is_closed } => nearest_on_curve(points_m, *is_closed, [point[0], point[1]]),
        }
    }
}

/// Normal and signed distance at the nearest point of a chain; the sign is that of the side of its piece. The normal at a
/// corner points from it to the point, or from the point to it on the other side.
fn nearest_on_curve(corners: &[[f64; 2]], is_closed: bool, point: [f64; 2]) -> Option<([f64; 3], f64)> {
    let pieces = corners.windows(2).map(|pair| (pair[0], pair[1]));
    let closing = match corners {
        [first, .., last] if is_closed => Some((*last, *first)),
        _ => None,
    };
    let mut best: Option<([f64; 3], f64)> = None;
    let mut height = 0.0;
    for (start, end) in pieces.chain(closing) {
        let Some((direction, length)) = unit([end[0] - start[0], end[1] - start[1], 0.0]) else { continue };
        let offset = [point[0] - start[0], point[1] - start[1], 0.0];
        let along = dot(offset, direction).clamp(0.0, length);
        let gap = subtract(offset, direction.map(|component| component * along));
        let own = [-direction[1], direction[0], 0.0];
        let its_height = dot(gap, own);
        let distance = dot(gap, gap).sqrt().copysign(its_height);
        // Two pieces that meet in the nearest corner are equally far: the side is that of the one seen more steeply.
        let is_nearer = best.is_none_or(|(_, least)| match distance.abs() - least.abs() {
            less if less.abs() <= ON_SURFACE_M => its_height.abs() > height,
            less => less < 0.0,
        });
        if !is_nearer {
            continue;
        }
        let is_beyond_end = along == 0.0 || along == length;
        let normal = match is_beyond_end && distance.abs() > ON_SURFACE_M {
            true => gap.map(|component| component / distance),
            false => own,
        };
        (best, height) = (Some((normal, distance)), its_height.abs());
    }
    best
}

/// A stretch of a run that the text around a figure speaks of by a letter.
#[derive(Clone, Debug, PartialEq)]
pub struct Phase {
    /// The letter, or another very short mark.
    pub letter: String,
    /// Begin in s.
    pub from_s: f64,
    /// End in s, after the begin.
    pub to_s: f64,
}

/// Yield force of a surface against pushes to one side of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SideYield {
    /// 1 for a push along the normal of the trace's reference, -1 for one against it.
    pub normal_sign: f64,
    /// The force in N.
    pub yield_n: f64,
}

/// The rows of one run and what is the same for all of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trace {
    /// Name of the run, for headings.
    pub title: String,
    /// The reference surface `C`.
    pub reference: Reference,
    /// Friction level `F` in N.
    pub friction_n: f64,
    /// Yield force `R` of the surface in N.
    pub yield_n: f64,
    /// The yield force against a push to one side, where it is not `yield_n`.
    pub side_yield: Option<SideYield>,
    /// Whether the surface resists with `R` only motion against its normal (a wall), and not motion off it on both sides.
    pub is_unilateral: bool,
    /// Steps for which the proxy is held on the surface after an impact, `N_wait` of the paper.
    pub hold_steps: u32,
    /// Whose force the rows hold.
    pub force_meaning: ForceMeaning,
    /// Stretches of the run marked by letters; may be empty.
    pub phases: Vec<Phase>,
    /// One row per control cycle, in order of time.
    pub rows: Vec<Row>,
}

impl Trace {
    /// Force of the device on the hand in N, base frame: `-h` of an admittance rig, `f` of an impedance rig.
    ///
    /// # Source
    /// [KTF08, text to Figs 8 and 11].
    pub fn force_on_hand_n(&self, row: &Row) -> [f64; 3] {
        match self.force_meaning {
            ForceMeaning::HandOnTool => row.force_n.map(|component| -component),
            ForceMeaning::ActuatorOnTool => row.force_n,
        }
    }

    /// The rows in which the proxy, off the surface in the row before, lies on it or has passed to its other side, in
    /// order of time.
    pub fn contacts(&self) -> impl Iterator<Item = usize> + '_ {
        let distance = |at: usize| self.rows[at].signed_distance_m;
        (1..self.rows.len()).filter(move |&at| {
            let (before, now) = (distance(at - 1), distance(at));
            before.abs() > ON_SURFACE_M && (now.abs() <= ON_SURFACE_M || before * now < 0.0)
        })
    }

    /// Component of [`Trace::force_on_hand_n`] along the surface's normal at the tool, in N; zero where the surface
    /// has no normal.
    pub fn normal_force_n(&self, row: &Row) -> f64 {
        self.normal_force_at_n(row, row.tool_m)
    }

    /// As [`Trace::normal_force_n`], along the normal at `point_m`.
    pub fn normal_force_at_n(&self, row: &Row, point_m: [f64; 3]) -> f64 {
        self.reference.normal_at(point_m).map_or(0.0, |normal| dot(self.force_on_hand_n(row), normal))
    }

    /// Yield force in N against a push of the hand with this component along the normal of the reference.
    pub fn yield_against_n(&self, push_n: f64) -> f64 {
        let on_side = self.side_yield.filter(|side| side.normal_sign * push_n > 0.0);
        on_side.map_or(self.yield_n, |side| side.yield_n)
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn subtract(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Direction and length; `None` for length zero and for lengths that are not finite.
fn unit(vector: [f64; 3]) -> Option<([f64; 3], f64)> {
    let length = dot(vector, vector).sqrt();
    (length > 0.0 && length.is_finite()).then(|| (vector.map(|component| component / length), length))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn circle_counts_outward_distance_and_radial_force() {
        let trace = Trace { reference: Reference::Circle { center_m: [0.1, 0.0], radius_m: 0.12 }, ..Trace::default() };
        let row = Row { tool_m: [0.1, 0.15, 0.0], force_n: [3.0, -7.0, 0.0], ..Row::default() };
        assert!((trace.reference.signed_distance_m(row.tool_m).unwrap() - 0.03).abs() < 1e-15);
        assert_eq!(trace.normal_force_n(&row), 7.0);
        let impedance = Trace { force_meaning: ForceMeaning::ActuatorOnTool, ..trace };
        assert_eq!(impedance.normal_force_n(&row), -7.0);
        assert_eq!(impedance.normal_force_n(&Row { tool_m: [0.1, 0.0, 0.0], ..row }), 0.0);
    }

    #[test]
    fn cylinder_does_not_count_the_way_along_its_axis() {
        let cylinder = Reference::Cylinder { axis_point_m: [0.0; 3], axis_direction: [0.0, 0.0, 5.0], radius_m: 0.04 };
        let distance = cylinder.signed_distance_m([0.03, 0.04, 0.7]).unwrap();
        assert!((distance - 0.01).abs() < 1e-15);
    }

    #[test]
    fn plane_normalises_its_normal() {
        let plane = Reference::Plane { point_m: [0.02, 9.0, 0.0], normal: [-4.0, 0.0, 0.0] };
        assert_eq!(plane.normal_at([0.0; 3]), Some([-1.0, 0.0, 0.0]));
        assert_eq!(plane.signed_distance_m([0.0; 3]), Some(0.02));
        assert_eq!(Reference::Plane { point_m: [0.0; 3], normal: [0.0; 3] }.normal_at([0.0; 3]), None);
    }

    #[test]
    fn curve_takes_the_nearest_piece_and_its_left_side() {
        let points_m = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
        let open = Reference::Curve { points_m: points_m.clone(), is_closed: false };
        assert_eq!(open.signed_distance_m([0.5, 0.1, 0.0]), Some(0.1));
        assert_eq!(open.signed_distance_m([1.25, 0.5, 0.0]), Some(-0.25));
        assert_eq!(open.signed_distance_m([0.25, 0.75, 0.0]), Some(0.75));
        let closed = Reference::Curve { points_m, is_closed: true };
        let distance = closed.signed_distance_m([0.25, 0.75, 0.0]).unwrap();
        assert!((distance + 0.5f64.sqrt() / 2.0).abs() < 1e-12, "{distance}");
        // Round the corner at (1, 0), outside of the bend and within its acute neighbour, where only one piece tells.
        let open = Reference::Curve { points_m: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 0.5]], is_closed: false };
        for (x, y) in [(1.3, -0.4), (1.4, 0.3), (1.1, 0.2)] {
            let (normal, distance) =
                (open.normal_at([x, y, 0.0]).unwrap(), open.signed_distance_m([x, y, 0.0]).unwrap());
            let length = (x - 1.0_f64).hypot(y);
            assert!((distance + length).abs() < 1e-12, "{x} {y}: {distance}");
            assert!((normal[0] + (x - 1.0) / length).abs() + (normal[1] + y / length).abs() < 1e-12, "{normal:?}");
        }
        assert_eq!(Reference::Curve { points_m: vec![[1.0, 2.0]], is_closed: true }.normal_at([0.0; 3]), None);
    }
}
