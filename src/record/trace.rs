//! The rows of a run and what is known about the run as a whole.

/// A proxy nearer to the surface than this, in m, lies on it.
pub const ON_SURFACE_M: f64 = 1e-9;

/// Inputs and results of one control cycle.
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
    /// Displacement of the surfaces from their place, in m, base frame.
    pub surface_m: [f64; 3],
    /// Signed distance of the proxy from the reference in m, as the fixture counts it: from all its surfaces, where they
    /// are in this cycle.
    pub signed_distance_m: f64,
    /// Signed distance of the tool from the reference in m, as the fixture counts it.
    pub tool_distance_m: f64,
    /// Unit normal of the reference at the foot of the tool, as the fixture has it: out of the forbidden side.
    pub tool_normal: [f64; 3],
    /// Unit normal of the reference at the foot of the proxy, as the fixture has it.
    pub proxy_normal: [f64; 3],
    /// Whether the fixture holds the proxy on the reference surface.
    pub is_on_surface: bool,
    /// Steps for which the proxy is still held on the surface after an impact (`IsOn` of the paper).
    pub hold_counter: u32,
    /// Whether the proxy met the surface in this cycle.
    pub is_impact: bool,
    /// State of the supervisor, as the number that the supervisor gives it.
    pub supervisor_state: u8,
}

/// Source of the force in [`Row::force_n`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ForceMeaning {
    /// The measured force `h` of the hand on the tool (admittance type): figures draw `-h`.
    #[default]
    HandOnTool,
    /// The actuator force `f` on the tool (impedance type): figures draw `f`.
    ActuatorOnTool,
}

impl ForceMeaning {
    /// Returns the force of the device on the hand in N, base frame: `-h` of an admittance rig, `f` of an impedance rig.
    pub fn on_hand_n(self, row: &Row) -> [f64; 3] {
        match self {
            ForceMeaning::HandOnTool => row.force_n.map(|component| -component),
            ForceMeaning::ActuatorOnTool => row.force_n,
        }
    }
}

/// A surface of the reference `C`, without motion, for drawings along z.
///
/// `is_inside_forbidden` and the order of points say which side a unilateral fixture forbids; a bilateral one forbids none.
#[derive(Clone, Debug, PartialEq)]
pub enum Reference {
    /// Circle in the plane of x and y.
    Circle {
        /// Centre in m.
        center_m: [f64; 2],
        /// Radius in m, above zero.
        radius_m: f64,
        /// Whether the inside is the forbidden side.
        is_inside_forbidden: bool,
    },
    /// Sphere.
    Sphere {
        /// Centre in m.
        center_m: [f64; 3],
        /// Radius in m, above zero.
        radius_m: f64,
        /// Whether the inside is the forbidden side.
        is_inside_forbidden: bool,
    },
    /// Cylinder.
    Cylinder {
        /// A point of the axis in m.
        axis_point_m: [f64; 3],
        /// Direction of the axis, of any length but zero.
        axis_direction: [f64; 3],
        /// Radius in m, above zero.
        radius_m: f64,
        /// Whether the inside is the forbidden side.
        is_inside_forbidden: bool,
    },
    /// Box with edges along the axes.
    Box {
        /// Centre in m.
        center_m: [f64; 3],
        /// Half of the lengths of its edges in m, above zero.
        half_size_m: [f64; 3],
        /// Whether the inside is the forbidden side.
        is_inside_forbidden: bool,
    },
    /// Plane in space, or straight line in the plane of x and y.
    Plane {
        /// Point on the line or plane in m.
        point_m: [f64; 3],
        /// Its normal, of any length but zero, out of the forbidden side.
        normal: [f64; 3],
    },
    /// A point, met by a proxy that passes nearer than its capture radius.
    Point {
        /// Position in m.
        point_m: [f64; 2],
        /// Capture radius in m, zero or above.
        capture_radius_m: f64,
    },
    /// Chain of straight pieces, as it is seen along z.
    Curve {
        /// Corners in m, at least two, in the order in which the forbidden side lies to the right.
        points_m: Vec<[f64; 2]>,
        /// Whether the last corner is joined to the first.
        is_closed: bool,
    },
}

impl Reference {
    /// Whether what is seen of it along z depends on the height at which it is cut.
    pub fn has_height(&self) -> bool {
        match self {
            Reference::Sphere { .. } | Reference::Box { .. } => true,
            Reference::Plane { normal: [_, _, z], .. } => *z != 0.0,
            _ => false,
        }
    }
}

/// A moment at which a fault held or stopped the rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultMark {
    /// When, in s since the run began.
    pub time_s: f64,
    /// Name of the fault in the fault table.
    pub fault: &'static str,
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

/// Shares of `R` from which a push makes a surface give way, and below which it no longer does.
const GIVING_WAY_SHARE: f64 = 0.95;
const RECOVERED_SHARE: f64 = 0.8;

/// Machine and law of a run, for headings. Headings leave out unknown values.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Setup {
    /// Drive of the machine in words, such as `torque mode`; may be empty.
    pub drive: &'static str,
    /// Law of the fixture in words, such as `plastic`; may be empty.
    pub law: String,
    /// Whether the law has no yield force `R`: a spring, damping, or friction alone.
    pub is_unyielding: bool,
    /// Whether each impact gives its own hold, in place of `N_wait`.
    pub is_hold_automatic: bool,
    /// Virtual mass `M` in kg.
    pub mass_kg: Option<f64>,
    /// Control period `T` in s.
    pub period_s: Option<f64>,
}

/// The rows of one run and what is the same for all of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trace {
    /// Name of the run, for headings.
    pub title: String,
    /// The surfaces of the reference `C`, without motion; none: free motion against friction.
    pub references: Vec<Reference>,
    /// Whether drawings count against the normals of the rows, which point to the centre of a round surface.
    pub is_normal_inward: bool,
    /// Friction level `F` in N.
    pub friction_n: f64,
    /// Yield force `R` of the surface in N.
    pub yield_n: f64,
    /// The yield force in N against pushes out of the forbidden side, where it is not `yield_n`.
    pub outward_yield_n: Option<f64>,
    /// Whether the surface resists with `R` only motion against its normal (a wall), and not motion off it on both sides.
    pub is_unilateral: bool,
    /// Steps for which the proxy is held on the surface after an impact, `N_wait` of the paper.
    pub hold_steps: u32,
    /// Machine and law, for headings.
    pub setup: Setup,
    /// Source of the force in the rows.
    pub force_meaning: ForceMeaning,
    /// Stretches of the run marked by letters; may be empty.
    pub phases: Vec<Phase>,
    /// One row per control cycle, in order of time, up to the fault that stopped the rig if one did. Measures take these.
    pub rows: Vec<Row>,
    /// The rows after that fault, which drawings show.
    pub after: Vec<Row>,
    /// Faults that held or stopped the rig, in order of time.
    pub faults: Vec<FaultMark>,
}

impl Trace {
    /// Returns the force of the device on the hand in N, base frame: `-h` of an admittance rig, `f` of an impedance rig.
    ///
    /// # Source
    /// [KTF08, text to Figs 8 and 11].
    pub fn force_on_hand_n(&self, row: &Row) -> [f64; 3] {
        self.force_meaning.on_hand_n(row)
    }

    /// Returns the rows in which the proxy, off the surface in the row before, lies on it or has passed to its other side, in
    /// order of time. It has passed there if its way is as long as both distances; otherwise another surface is nearer.
    pub fn contacts(&self) -> impl Iterator<Item = usize> + '_ {
        let distance = |at: usize| self.rows[at].signed_distance_m;
        (1..self.rows.len()).filter(move |&at| {
            let (before, now) = (distance(at - 1), distance(at));
            let has_passed = || before * now < 0.0 && before.abs() + now.abs() <= self.way_m(at) + ON_SURFACE_M;
            before.abs() > ON_SURFACE_M && (now.abs() <= ON_SURFACE_M || has_passed())
        })
    }

    /// Returns the rows in which the surface begins to give way to a hand that presses with `R`. The proxy leaves a guide on which it lay
    /// in the two rows before, or moves into the forbidden side of a wall. Between two of these rows the push was clearly below `R`.
    pub fn break_outs(&self) -> impl Iterator<Item = usize> + '_ {
        let mut is_giving_way = self.setup.is_unyielding;
        (2..self.rows.len()).filter(move |&at| {
            let (row, before) = (&self.rows[at], &self.rows[at - 1]);
            let push_n = -self.normal_force_at_proxy_n(row);
            let share = push_n.abs() / self.yield_against_n(push_n);
            is_giving_way &= self.setup.is_unyielding || share >= RECOVERED_SHARE;
            let is_moved = match self.is_unilateral {
                true => push_n < 0.0 && row.signed_distance_m < before.signed_distance_m.min(-ON_SURFACE_M),
                false => self.rows[at - 2].is_on_surface && before.is_on_surface && !row.is_on_surface,
            };
            let begins = !is_giving_way && is_moved && share >= GIVING_WAY_SHARE;
            is_giving_way |= begins;
            begins
        })
    }

    /// Returns the way of the proxy to row `at` from the one before, in m, as seen from the surfaces.
    pub fn way_m(&self, at: usize) -> f64 {
        let seen = |row: &Row, axis: usize| row.proxy_m[axis] - row.surface_m[axis];
        let way: [f64; 3] = std::array::from_fn(|axis| seen(&self.rows[at], axis) - seen(&self.rows[at - 1], axis));
        dot(way, way).sqrt()
    }

    /// Returns the component of [`Trace::force_on_hand_n`] along the normal at the tool's foot, in N.
    pub fn normal_force_n(&self, row: &Row) -> f64 {
        dot(self.force_on_hand_n(row), row.tool_normal)
    }

    /// Returns the same as [`Trace::normal_force_n`], at the proxy's foot.
    pub fn normal_force_at_proxy_n(&self, row: &Row) -> f64 {
        dot(self.force_on_hand_n(row), row.proxy_normal)
    }

    /// Returns 1 if drawings count along the rows' normals, -1 if against them.
    pub fn drawn_sign(&self) -> f64 {
        if self.is_normal_inward { -1.0 } else { 1.0 }
    }

    /// Returns the yield force in N against a push of the hand with this component along the normal.
    pub fn yield_against_n(&self, push_n: f64) -> f64 {
        self.outward_yield_n.filter(|_| push_n > 0.0).unwrap_or(self.yield_n)
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forces_count_along_the_normal_of_their_row() {
        let row = Row {
            tool_normal: [0.0, 1.0, 0.0],
            proxy_normal: [1.0, 0.0, 0.0],
            force_n: [3.0, -7.0, 0.0],
            ..Row::default()
        };
        let trace = Trace { yield_n: 20.0, outward_yield_n: Some(8.0), ..Trace::default() };
        assert_eq!((trace.normal_force_n(&row), trace.normal_force_at_proxy_n(&row)), (7.0, -3.0));
        assert_eq!((trace.yield_against_n(1.0), trace.yield_against_n(-1.0)), (8.0, 20.0));
        let impedance = Trace { force_meaning: ForceMeaning::ActuatorOnTool, ..trace };
        assert_eq!(impedance.normal_force_n(&row), -7.0);
    }

    #[test]
    fn a_surface_gives_way_where_the_hand_presses_with_its_yield_force() {
        let row = |push_n: f64, distance_m: f64| Row {
            force_n: [push_n, 0.0, 0.0],
            proxy_normal: [1.0, 0.0, 0.0],
            signed_distance_m: distance_m,
            is_on_surface: distance_m == 0.0,
            ..Row::default()
        };
        let of = |rows: &[Row], is_unilateral, is_unyielding| {
            let setup = Setup { is_unyielding, ..Setup::default() };
            let trace = Trace { yield_n: 20.0, is_unilateral, setup, rows: rows.to_vec(), ..Trace::default() };
            trace.break_outs().collect::<Vec<_>>()
        };
        let on = row(-15.0, 0.0);
        let guide = [on, on, row(-20.0, -1e-4), on, row(-20.0, -1e-4), on, on, row(15.0, 1e-4)];
        assert_eq!(of(&guide, false, false), [2], "one row is a landing in flight, and the last a release below R");
        let wall =
            [on, row(-10.0, -1e-4), row(-10.0, -2e-4), row(-20.0, -3e-4), row(-20.0, -4e-4), on, row(20.0, 1e-4)];
        assert_eq!(of(&wall, true, false), [3], "not in the impact, and not off the free side");
        let again = [wall, wall].concat();
        assert_eq!(of(&again, true, false), [3, 10]);
        assert!(of(&again, true, true).is_empty(), "a spring");
    }

    /// Nearest to a circle from inside, then to a line from its left: the sign changes, and nothing was met.
    #[test]
    fn another_surface_coming_nearer_is_no_contact() {
        let row = |x_m: f64, signed_distance_m: f64, surface_x_m: f64| Row {
            proxy_m: [x_m, 0.0, 0.0],
            surface_m: [surface_x_m, 0.0, 0.0],
            signed_distance_m,
            ..Row::default()
        };
        let contacts =
            |rows: [Row; 3]| Trace { rows: rows.to_vec(), ..Trace::default() }.contacts().collect::<Vec<_>>();
        assert!(contacts([row(0.0, -0.02, 0.0), row(1e-4, 0.02, 0.0), row(2e-4, 0.02, 0.0)]).is_empty());
        assert_eq!(contacts([row(0.0, -1e-4, 0.0), row(1e-4, -5e-5, 0.0), row(2e-4, 5e-5, 0.0)]), [2]);
        // A surface that passes over a proxy at rest is met all the same.
        assert_eq!(contacts([row(0.0, 1e-4, 0.0), row(0.0, 5e-5, 5e-5), row(0.0, -5e-5, 1.5e-4)]), [2]);
    }
}
