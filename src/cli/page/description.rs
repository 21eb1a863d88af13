//! The machine and its fixture as the page gets them.

use crate::failure::Failure;
use yieldwall_config as config;
use yieldwall_figures::{SurfaceLine, surface_lines};
use yieldwall_motion::elementary;
use yieldwall_motion::linkage::{Chain, Geometry, WristSide};
use yieldwall_record::recording::{About, Machine};
use yieldwall_record::{Reference, Trace};
use yieldwall_rig::report::{RunLog, measured, measured_device, replay};
use yieldwall_view::{Arm, Description, Fixture, Forbidden, Surface, Tool};

/// Part of the plane around an impedance device, m.
const DEVICE_WINDOW_M: [f64; 4] = [-0.15, -0.15, 0.15, 0.15];
/// Room left free at each edge, m.
const MARGIN_M: f64 = 0.03;
/// Share of the length of a stretched arm that is shown.
const REACHED: f64 = 0.95;

/// Returns the machine of a recording.
///
/// # Errors
/// If its document is not one of this version.
pub(super) fn of_recording(about: &About) -> Result<Description, Failure> {
    Ok(match &about.machine {
        Machine::Rig(_) => of_rig(&replay::rig(about)?),
        Machine::Device(_) => of_device(&replay::device(about)?),
    })
}

/// Returns the machine of a rig.
pub(super) fn of_rig(rig: &config::Rig) -> Description {
    let (trace, _) = measured(rig, &rig.fixture, RunLog::default());
    let geometry = rig.linkage.geometry();
    let tool = Tool {
        fixed_to: if geometry.tool.fixed_to == Chain::Left { "left" } else { "right" },
        along_m: geometry.tool.along_m,
        across_m: geometry.tool.across_m,
    };
    let arm = Arm {
        bases_m: geometry.base_m,
        proximal_m: geometry.proximal_m,
        distal_m: geometry.distal_m,
        singularity_margin_m: Some(rig.guard.singularity_margin_m.get()),
        tool,
    };
    let window_m = arm_window_m(&geometry);
    let surfaces = surface_lines(&trace.references, window_m);
    let machine = machine(&rig.rig.name, rig.cycle.period_us, &rig.fixture, &trace, surfaces);
    Description { arm: Some(arm), view_m: window_m, ..machine }
}

fn of_device(device: &config::ImpedanceDevice) -> Description {
    let (trace, _) = measured_device(device, &device.fixture, Vec::new());
    let surfaces = surface_lines(&trace.references, DEVICE_WINDOW_M);
    let mut view_m = DEVICE_WINDOW_M;
    let [min_x, min_y, max_x, max_y] = &mut view_m;
    for [x, y] in surfaces.iter().filter(|surface| surface.is_closed).flat_map(|surface| &surface.points_m) {
        (*min_x, *max_x) = (min_x.min(x - MARGIN_M), max_x.max(x + MARGIN_M));
        (*min_y, *max_y) = (min_y.min(y - MARGIN_M), max_y.max(y + MARGIN_M));
    }
    let machine = machine(&device.device.name, device.cycle.period_us, &device.fixture, &trace, surfaces);
    Description { view_m, ..machine }
}

fn machine(
    name: &str,
    period_us: u32,
    fixture: &config::Fixture,
    trace: &Trace,
    surfaces: Vec<SurfaceLine>,
) -> Description {
    let surface = |SurfaceLine { points_m, is_closed, has_sides }: SurfaceLine| Surface {
        points_m,
        is_closed,
        forbidden: if trace.is_unilateral && has_sides { Forbidden::Right } else { Forbidden::None },
    };
    Description {
        name: name.to_owned(),
        period_s: f64::from(period_us) * 1e-6,
        arm: None,
        surfaces: surfaces.into_iter().map(surface).collect(),
        view_m: DEVICE_WINDOW_M,
        fixture: of_fixture(fixture, trace),
    }
}

fn of_fixture(fixture: &config::Fixture, trace: &Trace) -> Fixture {
    let row = |name: &str, value: String| (name.to_owned(), value);
    let mut rows = vec![
        row("yield force R", format!("{} N", trace.yield_n)),
        row("friction F", format!("{} N", trace.friction_n)),
    ];
    match fixture.coupling {
        config::Coupling::Admittance { mass_kg } => rows.push(row("virtual mass M", format!("{} kg", *mass_kg))),
        config::Coupling::Impedance { stiffness_n_per_m, damping_n_s_per_m } => {
            rows.push(row("stiffness K", format!("{} N/m", *stiffness_n_per_m)));
            rows.push(row("damping B", format!("{} N s/m", *damping_n_s_per_m)));
        }
    }
    rows.push(row(
        "hold N_wait",
        match fixture.automatic_hold {
            Some(hold) => format!("automatic, at most {} s", *hold.longest_s),
            None => format!("{} cycles", fixture.hold_steps),
        },
    ));
    rows.push(row("side", if trace.is_unilateral { "unilateral" } else { "bilateral" }.to_owned()));
    // The parameters of a law as its file names them.
    let document = serde_json::to_value(fixture).unwrap_or_default();
    for key in ["law", "motion", "passivity"] {
        let group = &document[key];
        let group = fixture.law.as_ref().filter(|_| key == "law").map_or(group, |law| &group[law.name()]);
        let parameters = group.as_object().into_iter().flatten();
        rows.extend(parameters.map(|(name, value)| row(&format!("{key}: {name}"), value.to_string())));
    }
    if trace.references.iter().any(Reference::has_height) {
        rows.push(row("surfaces", "as cut at z = 0".to_owned()));
    }
    let law = fixture.law.as_ref();
    let has_one_level = law.is_none_or(|law| law.guidance().is_none()) && trace.outward_yield_n.is_none();
    Fixture {
        law: law.map_or("plastic", config::FixtureLaw::name).to_owned(),
        yield_force_n: has_one_level.then_some(trace.yield_n),
        rows,
    }
}

/// Returns the part of the plane in which an arm works, m: smallest x, smallest y, largest x, largest y. It reaches sideways to the
/// elbows, and to the side of the wrist almost as far as a stretched arm.
fn arm_window_m(geometry: &Geometry) -> [f64; 4] {
    let [left, right] = geometry.base_m;
    let [dx, dy] = [right[0] - left[0], right[1] - left[1]];
    let distance_m = elementary::hypot(dx, dy);
    let along = if distance_m > 0.0 { [dx / distance_m, dy / distance_m] } else { [1.0, 0.0] };
    let turn = if geometry.wrist == WristSide::Forward { 1.0 } else { -1.0 };
    let across = [-turn * along[1], turn * along[0]];
    let [left_m, right_m] = geometry.proximal_m;
    let reach_m = geometry.proximal_m.iter().zip(&geometry.distal_m).map(|(near, far)| near + far).fold(0.0, f64::max);
    let from =
        |base: [f64; 2], direction: [f64; 2], way_m: f64| [0, 1].map(|axis| base[axis] + way_m * direction[axis]);
    let corners = [
        from(left, along, -left_m),
        from(right, along, right_m),
        from(left, across, REACHED * reach_m),
        from(right, across, REACHED * reach_m),
        from(left, across, -MARGIN_M),
    ];
    let least = |axis: usize| corners.iter().map(|corner| corner[axis]).fold(f64::INFINITY, f64::min) - MARGIN_M;
    let greatest = |axis: usize| corners.iter().map(|corner| corner[axis]).fold(f64::NEG_INFINITY, f64::max) + MARGIN_M;
    [least(0), least(1), greatest(0), greatest(1)]
}
