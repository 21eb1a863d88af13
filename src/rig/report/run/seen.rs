//! The trace of a run from its rows and the surfaces of its fixture.

use nalgebra::SVector;

use yieldwall_config as config;
use yieldwall_motion::fixture::{Shape2, Shape3, Surface};
use yieldwall_motion::guard::{Cause, State};
use yieldwall_record::{FaultMark, ForceMeaning, Reference, Row, Setup, Trace, fault_severity};

/// Rows of the moving average over the tool velocity in the power.
///
/// # Source
/// [KTF08], text to Fig. 11.
const POWER_AVERAGE_ROWS: usize = 5;

/// Faults that are kept for drawings.
const MOST_FAULTS: usize = 64;

/// The rows of a run as they come, and when faults held or stopped it.
#[derive(Clone, Debug)]
pub struct RunLog {
    rows: Vec<Row>,
    after: Vec<Row>,
    faults: Vec<FaultMark>,
    severity: u8,
    is_latched: bool,
    most_rows: usize,
}

impl RunLog {
    /// Creates a log with room for this many rows, allocated at once; later rows are left out.
    pub fn with_room(rows: usize) -> Self {
        Self { rows: Vec::with_capacity(rows), most_rows: rows, ..Self::default() }
    }

    /// Takes the next row, with what the supervisor made of its cycle.
    ///
    /// Real-time: yes, up to the fault that stops the rig.
    pub fn take(&mut self, row: Row, state: State, cause: Option<Cause>) {
        let severity = fault_severity(state, cause);
        if let Some(cause) = cause
            && severity > self.severity
            && self.faults.len() < MOST_FAULTS
        {
            self.faults.push(FaultMark { time_s: row.time_s, fault: cause.fault.row().name });
        }
        self.severity = severity;
        if self.rows.len() + self.after.len() < self.most_rows {
            if self.is_latched { self.after.push(row) } else { self.rows.push(row) }
        }
        self.is_latched |= state.is_latched();
    }

    /// Returns the rows up to the fault that stopped the rig, if one did.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Whether a fault stopped the rig.
    pub fn is_stopped(&self) -> bool {
        self.is_latched
    }
}

impl Default for RunLog {
    /// Creates a log without a limit.
    fn default() -> Self {
        Self {
            rows: Vec::new(),
            after: Vec::new(),
            faults: Vec::with_capacity(MOST_FAULTS),
            severity: 0,
            is_latched: false,
            most_rows: usize::MAX,
        }
    }
}

impl From<Vec<Row>> for RunLog {
    /// Creates the log of a machine without faults.
    fn from(rows: Vec<Row>) -> Self {
        Self { rows, ..Self::default() }
    }
}

/// Returns the trace of a run of this fixture.
pub(in crate::report) fn trace(
    title: String,
    fixture: &config::Fixture,
    (drive, period_us): (&'static str, u32),
    force_meaning: ForceMeaning,
    seen: impl Into<RunLog>,
) -> Trace {
    let RunLog { rows, after, faults, .. } = seen.into();
    let mut trace = Trace {
        title,
        references: fixture.surfaces().map(|(_, surface)| reference(surface)).collect(),
        is_normal_inward: is_normal_inward(fixture),
        friction_n: fixture.friction_n.get(),
        yield_n: fixture.yield_n.get(),
        outward_yield_n: outward_yield_n(fixture),
        is_unilateral: fixture.side == config::Side::Unilateral,
        hold_steps: fixture.hold_steps,
        setup: Setup {
            drive,
            law: law(fixture),
            is_unyielding: is_unyielding(fixture),
            is_hold_automatic: fixture.automatic_hold.is_some(),
            mass_kg: match fixture.coupling {
                config::Coupling::Admittance { mass_kg } => Some(mass_kg.get()),
                config::Coupling::Impedance { .. } => None,
            },
            period_s: Some(1e-6 * f64::from(period_us)),
        },
        force_meaning,
        phases: Vec::new(),
        rows,
        after,
        faults,
    };
    for rows in [&mut trace.rows, &mut trace.after] {
        set_power(rows, force_meaning);
    }
    // A fixture that is run has its surfaces in the plane or in space.
    if let Ok(Some(shape)) = fixture.planar() {
        set_feet::<Shape2, 2>(&shape, trace.rows.iter_mut().chain(&mut trace.after));
    } else if let Ok(Some(shape)) = fixture.spatial() {
        set_feet::<Shape3, 3>(&shape, trace.rows.iter_mut().chain(&mut trace.after));
    }
    trace
}

/// Returns the law of a fixture in words.
fn law(fixture: &config::Fixture) -> String {
    use config::FixtureLaw as Law;
    match fixture.law {
        None | Some(Law::Tube { .. }) => "plastic".to_owned(),
        Some(Law::Ellipse {}) => "plastic, ellipse".to_owned(),
        Some(Law::Elastic { stiffness_n_per_m, is_saturated, .. }) => {
            let spring = if is_saturated { "saturated spring" } else { "spring" };
            format!("{spring} of {} N/m", stiffness_n_per_m.get())
        }
        Some(Law::Viscous { .. }) => "viscous".to_owned(),
        Some(Law::Free {}) => "friction alone".to_owned(),
    }
}

/// Whether no force makes the law of a fixture give way.
fn is_unyielding(fixture: &config::Fixture) -> bool {
    use config::FixtureLaw as Law;
    match fixture.law {
        None | Some(Law::Tube { .. } | Law::Ellipse {} | Law::Elastic { is_saturated: true, .. }) => false,
        Some(Law::Elastic { .. } | Law::Viscous { .. } | Law::Free {}) => true,
    }
}

/// Where tool and proxy are as seen from the surfaces of the fixture, all of them, where they are in each row.
fn set_feet<'a, S: Surface<N>, const N: usize>(surface: &S, rows: impl Iterator<Item = &'a mut Row>) {
    let (mut tool, mut proxy) = (surface.own_foot(), surface.own_foot());
    for row in rows {
        let seen = |point: [f64; 3]| SVector::<f64, N>::from_fn(|axis, _| point[axis] - row.surface_m[axis]);
        (tool, proxy) = (surface.foot(&seen(row.tool_m), &tool), surface.foot(&seen(row.proxy_m), &proxy));
        let padded = |vector: SVector<f64, N>| std::array::from_fn(|axis| vector.get(axis).copied().unwrap_or(0.0));
        row.tool_distance_m = tool.signed_distance_m;
        (row.tool_normal, row.proxy_normal) = (padded(tool.normal), padded(proxy.normal));
    }
}

/// Returns a surface for drawings.
fn reference(surface: &config::Surface) -> Reference {
    use config::Surface as Of;
    let two = |[x, y]: [config::Finite; 2]| [x.get(), y.get()];
    let three = |point: [config::Finite; 3]| point.map(|value| value.get());
    let above = |point: [config::Finite; 3]| {
        let [x, y, _] = three(point);
        [x, y]
    };
    let flat = |point: [config::Finite; 2]| {
        let [x, y] = two(point);
        [x, y, 0.0]
    };
    let is_inside = |side: config::Forbidden| side == config::Forbidden::Inside;
    match *surface {
        Of::Circle { center_m, radius_m, forbidden } => Reference::Circle {
            center_m: two(center_m),
            radius_m: radius_m.get(),
            is_inside_forbidden: is_inside(forbidden),
        },
        Of::Sphere { center_m, radius_m, forbidden } => Reference::Sphere {
            center_m: three(center_m),
            radius_m: radius_m.get(),
            is_inside_forbidden: is_inside(forbidden),
        },
        Of::Line { point_m, normal } => Reference::Plane { point_m: flat(point_m), normal: flat(normal) },
        Of::Plane { point_m, normal } => Reference::Plane { point_m: three(point_m), normal: three(normal) },
        Of::Cylinder { axis_point_m, axis_direction, radius_m, forbidden } => Reference::Cylinder {
            axis_point_m: three(axis_point_m),
            axis_direction: three(axis_direction),
            radius_m: radius_m.get(),
            is_inside_forbidden: is_inside(forbidden),
        },
        Of::Point { point_m, capture_radius_m } => {
            Reference::Point { point_m: two(point_m), capture_radius_m: capture_radius_m.get() }
        }
        Of::SpacePoint { point_m, capture_radius_m } => {
            Reference::Point { point_m: above(point_m), capture_radius_m: capture_radius_m.get() }
        }
        Of::Box { center_m, half_size_m, forbidden } => Reference::Box {
            center_m: three(center_m),
            half_size_m: half_size_m.map(|half| half.get()),
            is_inside_forbidden: is_inside(forbidden),
        },
        Of::Polygon { .. } | Of::ClosedCurve { .. } | Of::OpenCurve { .. } | Of::SpaceCurve { .. } => outline(surface),
    }
}

/// Returns the line of a chain of pieces.
fn outline(surface: &config::Surface) -> Reference {
    let (points_m, is_closed) = match (surface.planar(), surface.spatial()) {
        (Ok(Some(Shape2::Chain(chain))), _) => {
            (chain.outline_m().iter().map(|point| [point.x, point.y]).collect(), chain.is_closed())
        }
        (_, Ok(Some(Shape3::Chain(chain)))) => {
            (chain.outline_m().iter().map(|point| [point.x, point.y]).collect(), chain.is_closed())
        }
        _ => (Vec::new(), false),
    };
    Reference::Curve { points_m, is_closed }
}

/// Power of the device on the hand: force times the tool velocity after a centred moving average.
fn set_power(rows: &mut [Row], force_meaning: ForceMeaning) {
    let half = POWER_AVERAGE_ROWS / 2;
    let power: Vec<f64> = (0..rows.len())
        .map(|at| {
            let window = &rows[at.saturating_sub(half)..(at + half + 1).min(rows.len())];
            let force = force_meaning.on_hand_n(&rows[at]);
            let mean = |axis: usize| {
                window.iter().map(|row| row.tool_velocity_m_per_s[axis]).sum::<f64>() / window.len() as f64
            };
            (0..3).map(|axis| force[axis] * mean(axis)).sum()
        })
        .collect();
    for (row, power) in rows.iter_mut().zip(power) {
        row.power_w = power;
    }
}

/// Whether the normal of the only surface, out of the forbidden side, points to its centre.
fn is_normal_inward(fixture: &config::Fixture) -> bool {
    let is_outside_forbidden = matches!(
        fixture.surface,
        config::Surface::Circle { forbidden: config::Forbidden::Outside, .. }
            | config::Surface::Cylinder { forbidden: config::Forbidden::Outside, .. }
            | config::Surface::Sphere { forbidden: config::Forbidden::Outside, .. }
    );
    is_outside_forbidden && fixture.also.is_empty()
}

/// Returns the separate yield force against pushes out of the forbidden side.
fn outward_yield_n(fixture: &config::Fixture) -> Option<f64> {
    match fixture.law {
        Some(config::FixtureLaw::Tube { outward_yield_n }) if fixture.side == config::Side::Bilateral => {
            Some(outward_yield_n.get())
        }
        _ => None,
    }
}
