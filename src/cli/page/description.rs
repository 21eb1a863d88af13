//! The machine and its fixture as the page gets them.

use crate::failure::Failure;
use yieldwall_config as config;
use yieldwall_figures::surface_lines;
use yieldwall_motion::linkage::{Geometry, WristSide};
use yieldwall_record::Trace;
use yieldwall_record::recording::{About, Machine};
use yieldwall_rig::report::{RunLog, measured, measured_device, replay};
use yieldwall_view::{Arm, Command, Fixture, Forbidden, Hello, Surface, faults};

/// Part of the plane around an impedance device, m.
const DEVICE_WINDOW_M: [f64; 4] = [-0.15, -0.15, 0.15, 0.15];
/// Room left free at each edge, m.
const MARGIN_M: f64 = 0.03;
/// Share of the length of a stretched arm that is shown.
const REACHED: f64 = 0.95;

/// The machine of a recording.
///
/// # Errors
/// If its document is not one of this version.
pub(super) fn of_recording(about: &About) -> Result<Hello, Failure> {
    Ok(match &about.machine {
        Machine::Rig(_) => of_rig(&replay::rig(about)?, Command::View),
        Machine::Device(_) => of_device(&replay::device(about)?),
    })
}

/// A rig.
pub(super) fn of_rig(rig: &config::Rig, command: Command) -> Hello {
    let (trace, _) = measured(rig, &rig.fixture, RunLog::default());
    let geometry = rig.linkage.geometry();
    let arm = Arm {
        bases_m: geometry.base_m,
        proximal_m: geometry.proximal_m,
        distal_m: geometry.distal_m,
        singularity_margin_m: Some(rig.guard.singularity_margin_m.get()),
    };
    let period_s = f64::from(rig.cycle.period_us) * 1e-6;
    let window_m = arm_window_m(&geometry);
    Hello { arm: Some(arm), ..hello(&rig.rig.name, command, period_s, &rig.fixture, &trace, window_m) }
}

fn of_device(device: &config::ImpedanceDevice) -> Hello {
    let (trace, _) = measured_device(device, &device.fixture, Vec::new());
    let period_s = f64::from(device.cycle.period_us) * 1e-6;
    hello(&device.device.name, Command::View, period_s, &device.fixture, &trace, DEVICE_WINDOW_M)
}

fn hello(
    name: &str,
    command: Command,
    period_s: f64,
    fixture: &config::Fixture,
    trace: &Trace,
    window_m: [f64; 4],
) -> Hello {
    let forbidden = if trace.is_unilateral { Forbidden::Right } else { Forbidden::None };
    let surface = |mut points_m: Vec<[f64; 2]>| {
        let is_closed = points_m.len() > 2 && points_m.first() == points_m.last();
        if is_closed {
            points_m.pop();
        }
        Surface { points_m, is_closed, forbidden }
    };
    Hello {
        program: concat!("yieldwall ", env!("CARGO_PKG_VERSION")).to_owned(),
        command,
        name: name.to_owned(),
        period_s,
        tier: None,
        arm: None,
        surfaces: surface_lines(&trace.references, window_m).into_iter().map(surface).collect(),
        view_m: window_m,
        fixture: of_fixture(fixture, trace),
        faults: faults(),
    }
}

fn of_fixture(fixture: &config::Fixture, trace: &Trace) -> Fixture {
    let mut rows = vec![
        ("yield force R".to_owned(), format!("{} N", trace.yield_n)),
        ("friction F".to_owned(), format!("{} N", trace.friction_n)),
    ];
    rows.extend(match fixture.coupling {
        config::Coupling::Admittance { mass_kg } => vec![("virtual mass M".to_owned(), format!("{} kg", *mass_kg))],
        config::Coupling::Impedance { stiffness_n_per_m, damping_n_s_per_m } => vec![
            ("stiffness K".to_owned(), format!("{} N/m", *stiffness_n_per_m)),
            ("damping B".to_owned(), format!("{} N s/m", *damping_n_s_per_m)),
        ],
    });
    rows.push(("hold N_wait".to_owned(), format!("{} cycles", fixture.hold_steps)));
    rows.push(("side".to_owned(), if trace.is_unilateral { "unilateral" } else { "bilateral" }.to_owned()));
    let law = fixture.law.as_ref();
    Fixture {
        law: law.map_or("plastic", config::FixtureLaw::name).to_owned(),
        yield_force_n: law.is_none_or(|law| law.guidance().is_none()).then_some(trace.yield_n),
        rows,
    }
}

/// Part of the plane in which an arm works, m: least x, least y, greatest x, greatest y. It reaches sideways as far as the elbows, and to the
/// side of the wrist nearly as far as a stretched arm.
fn arm_window_m(geometry: &Geometry) -> [f64; 4] {
    let [left, right] = geometry.base_m;
    let [dx, dy] = [right[0] - left[0], right[1] - left[1]];
    let distance_m = dx.hypot(dy);
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
