//! Fixtures, and the impedance device, which has little else.

use super::Findings;
use super::words::{round, shorten_numbers};
use crate::tree::{Coupling, Curvature, Fixture, FixtureLaw, Guard, ImpedanceDevice, Side, Surface};
use yieldwall_motion::fixture::{self, FixtureError};

/// Radius of curvature in units of R / kappa below which the tangent step of the paper has an error of a quarter of the friction
/// level or more. Measured errors: 0.25 F/kappa at 5, 0.97 at 2.
const TANGENT_RADIUS_RATIO: f64 = 5.0;

/// Share of the guard's speed limit that a capture may take; the motion of the proxy itself is added to it.
const CAPTURE_SHARE: f64 = 0.5;

/// Machine on which a fixture works.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Host {
    Rig,
    Device,
}

/// Rules of a fixture alone and with the machine under it. `at` is its key; in a figure it replaces the machine's.
pub(super) fn check_fixture(findings: &mut Findings, at: &str, fixture: &Fixture, host: Host, period_s: f64) {
    check_host(findings, at, fixture, host);
    let key = |name: &str| format!("{at}.{name}");
    if *fixture.yield_n <= *fixture.friction_n {
        let message = format!(
            "`{}` is {} N, not above `{}` of {} N: the surface would yield before free motion does",
            key("yield_n"),
            *fixture.yield_n,
            key("friction_n"),
            *fixture.friction_n
        );
        findings
            .error(&key("yield_n"), message, "raise `yield_n` or lower `friction_n`; the paper has 20 N and 3 N")
            .see(&key("friction_n"), "friction_n");
    }
    for (key, surface) in fixture.surfaces() {
        check_directions(findings, &format!("{at}.{key}"), surface);
    }
    check_sides(findings, at, fixture);
    check_automatic_hold(findings, at, fixture);
    check_passivity(findings, at, fixture);
    check_law(findings, at, fixture);
    check_motion(findings, at, fixture);
    check_hold(findings, at, &fixture.coupling, fixture.hold_steps, &key("hold_steps"));
    if period_s > 0.0 {
        check_stiffness(findings, at, fixture, period_s);
        check_curvature(findings, at, fixture, period_s);
    }
}

/// Refuses a coupling that no fixture can be computed with.
fn check_stiffness(findings: &mut Findings, at: &str, fixture: &Fixture, period_s: f64) {
    let kappa = fixture.coupling.equivalent_stiffness_n_per_m(period_s);
    let [softest, stiffest] = fixture::STIFFNESS_RANGE_N_PER_M;
    if (softest..=stiffest).contains(&kappa) {
        return;
    }
    let key = format!("{at}.coupling");
    let (message, help) = match fixture.coupling {
        Coupling::Admittance { .. } => {
            ("`mass_kg` over the square of the cycle", "write the mass of a tool, such as 2 kg")
        }
        Coupling::Impedance { .. } => {
            ("`stiffness_n_per_m` with damping over the cycle", "write the stiffness of a coupling, such as 1000 N/m")
        }
    };
    let message =
        format!("{message} is {kappa:.3e} N/m, and only {softest:e} to {stiffest:e} N/m can be computed with");
    findings.error(&key, message, help);
}

/// Refuses a hold of a single step with an admittance coupling.
pub(super) fn check_hold(findings: &mut Findings, at: &str, coupling: &Coupling, steps: u32, key: &str) {
    if steps == 1 && matches!(coupling, Coupling::Admittance { .. }) {
        let message = format!(
            "`{key}` is 1, and with an admittance coupling one step does not hold: the input position depends on two \
             past steps"
        );
        findings.error(key, message, "write 0 for no hold, or 2 or more").see(&format!("{at}.coupling"), "coupling");
    }
}

/// Refuses an automatic hold together with a fixed one, a hold without momentum, or a hold out of its range.
fn check_automatic_hold(findings: &mut Findings, at: &str, fixture: &Fixture) {
    let Some(hold) = fixture.automatic_hold else { return };
    let key = format!("{at}.automatic_hold");
    if let Err(error) = fixture::AutomaticHold::from(hold).checked() {
        findings.error(&key, format!("`{key}`: {error}"), "1.5 kg and 0.1 s serve most hands");
    }
    if fixture.hold_steps > 0 {
        findings
            .error(
                &key,
                format!("`{key}` stands beside `hold_steps` of {}", fixture.hold_steps),
                "write `hold_steps: 0`, or leave this group out",
            )
            .see(&format!("{at}.hold_steps"), "hold_steps");
    }
    if matches!(fixture.coupling, Coupling::Impedance { .. }) {
        findings.error(
            &key,
            format!("`{key}` needs the coupling `admittance`: a proxy without mass has no momentum to stop"),
            "leave this group out",
        );
    }
}

/// Refuses a passivity controller without a mass to damp, with a fixture that itself gives energy, or out of its range.
fn check_passivity(findings: &mut Findings, at: &str, fixture: &Fixture) {
    let Some(passivity) = fixture.passivity else { return };
    let key = format!("{at}.passivity");
    if let Err(error) = fixture::Passivity::from(passivity).checked() {
        findings.error(&key, format!("`{key}`: {error}"), "0.05 J is well above what a rig that does not swing gives");
    }
    if matches!(fixture.coupling, Coupling::Impedance { .. }) {
        findings.error(
            &key,
            format!("`{key}` needs the coupling `admittance`: it damps the mass of the proxy"),
            "leave this group out",
        );
    }
    if fixture.motion.is_some() {
        findings
            .error(
                &key,
                format!("`{key}` stands beside `motion`: a surface that moves does work on the hand by itself"),
                "leave one of them out",
            )
            .see(&format!("{at}.motion"), "motion");
    }
    if let Some(law @ FixtureLaw::Elastic { .. }) = fixture.law {
        let law = format!("{at}.law.{}", law.name());
        findings
            .error(
                &key,
                format!("`{key}` stands beside `{law}`: what the spring gives back is taken for a swing of the rig"),
                "leave one of them out",
            )
            .see(&law, "law");
    }
}

/// Refuses a passivity controller at `at` whose bound is above the energy at which the guard holds the rig.
pub(super) fn check_passivity_beside_guard(findings: &mut Findings, at: &str, fixture: &Fixture, guard: &Guard) {
    // A bound that is out of its range has been found already.
    let Some(passivity) = fixture.passivity.filter(|&it| fixture::Passivity::from(it).checked().is_ok()) else {
        return;
    };
    let limit_j = *guard.energy_limit_j;
    if *passivity.bound_j >= limit_j {
        let key = format!("{at}.passivity.bound_j");
        findings
            .error(
                &key,
                format!(
                    "`{key}` is {} J, not below `guard.energy_limit_j` of {limit_j} J: the rig would be held before it damps",
                    *passivity.bound_j
                ),
                "lower it to a tenth of the limit or so, or raise the limit",
            )
            .see("guard.energy_limit_j", "energy_limit_j");
    }
}

/// Refuses a capture radius at `at` over which the proxy would move faster than the guard lets the reference move.
pub(super) fn check_capture_beside_guard(
    findings: &mut Findings,
    at: &str,
    fixture: &Fixture,
    guard: &Guard,
    period_s: f64,
) {
    for (place, surface) in fixture.surfaces() {
        let Surface::Point { capture_radius_m, .. } = surface else { continue };
        let limit = *guard.tool_speed_limit_m_per_s;
        let most_m = CAPTURE_SHARE * limit * period_s;
        if **capture_radius_m > most_m {
            let key = format!("{at}.{place}.point.capture_radius_m");
            let message = format!(
                "`{key}` is {} m: a proxy that passes so far off comes onto the point within one cycle, {} m/s beside its \
                 own speed, and `guard.tool_speed_limit_m_per_s` is {limit} m/s",
                **capture_radius_m,
                round(**capture_radius_m / period_s)
            );
            let help = format!("write at most {} m, which leaves half of the limit to the proxy", round(most_m));
            findings.error(&key, message, help).see("guard.tool_speed_limit_m_per_s", "limit");
        }
    }
}

/// Refuses a law that does not fit the rest of the fixture.
fn check_law(findings: &mut Findings, at: &str, fixture: &Fixture) {
    let Some(law) = fixture.law else { return };
    let key = format!("{at}.law.{}", law.name());
    let mut refuse = |key: &str, message: String, help: &str| {
        findings.error(key, message, help);
    };
    match law {
        FixtureLaw::Tube { outward_yield_n } => {
            let key = format!("{key}.outward_yield_n");
            if *outward_yield_n < *fixture.friction_n {
                let friction_n = *fixture.friction_n;
                let message = format!("`{key}` is {} N, below `friction_n` of {friction_n} N", *outward_yield_n);
                refuse(&key, message, "raise it, or lower `friction_n`");
            }
            if fixture.side == Side::Unilateral {
                let message = format!("`{key}` has no effect: a unilateral fixture lets go off its forbidden side");
                refuse(&key, message, "write `side: bilateral`, or leave `law` out");
            }
        }
        FixtureLaw::Ellipse {} if fixture.curvature == Curvature::Exact => {
            refuse(&key, format!("`{key}` has no exact step about a centre"), "write `curvature: tangent`");
        }
        FixtureLaw::Ellipse {} => {}
        FixtureLaw::Elastic { .. } | FixtureLaw::Viscous { .. } | FixtureLaw::Free {} => {
            if fixture.hold_steps > 0 || fixture.automatic_hold.is_some() {
                refuse(
                    &key,
                    format!("`{key}` keeps nothing on the surface, and a hold has no effect with it"),
                    "write `hold_steps: 0` and no `automatic_hold`",
                );
            }
            if matches!(fixture.coupling, Coupling::Impedance { .. }) {
                refuse(&key, format!("`{key}` needs the coupling `admittance`"), "leave `law` out");
            }
            if let Some(Err(error)) = law.guidance().map(fixture::Guidance::checked) {
                refuse(&key, format!("`{key}`: {error}"), "correct this number");
            }
        }
    }
}

/// Refuses a motion that no proxy could follow, or that has nothing to move.
fn check_motion(findings: &mut Findings, at: &str, fixture: &Fixture) {
    let Some(motion) = fixture.motion else { return };
    let key = format!("{at}.motion");
    if let Err(error) = fixture::Motion::from(motion).checked() {
        let error = shorten_numbers(&error.to_string());
        findings.error(&key, format!("`{key}`: {error}"), "make the way shorter or the swing longer");
    }
    if matches!(fixture.coupling, Coupling::Impedance { .. }) {
        findings.error(&key, format!("`{key}` needs the coupling `admittance`"), "leave this group out");
    }
}

fn check_host(findings: &mut Findings, at: &str, fixture: &Fixture, host: Host) {
    let (machine, coupling, dimension, surfaces) = match host {
        Host::Rig => ("a rig", "admittance", 2, "one of circle, line, polygon, closed_curve, open_curve, point"),
        Host::Device => {
            ("an impedance device", "impedance", 3, "one of cylinder, plane, sphere, box, space_curve, space_point")
        }
    };
    let is_admittance = matches!(fixture.coupling, Coupling::Admittance { .. });
    if is_admittance != (host == Host::Rig) {
        findings.error(
            &format!("{at}.coupling"),
            format!("`{at}.coupling` does not fit: {machine} has the coupling `{coupling}`"),
            match host {
                Host::Rig => "write `admittance: {mass_kg: ..}`; a rig moves its tool by the measured force",
                Host::Device => {
                    "write `impedance: {stiffness_n_per_m: .., damping_n_s_per_m: ..}`; a device has no force sensor"
                }
            },
        );
    }
    for (key, surface) in fixture.surfaces().filter(|(_, surface)| surface.dimension() != dimension) {
        let name = surface.name();
        findings.error(
            &format!("{at}.{key}.{name}"),
            format!("`{at}.{key}` is a {name}, and {machine} moves in {dimension} dimensions"),
            format!("write {surfaces}"),
        );
    }
}

fn check_directions(findings: &mut Findings, at: &str, surface: &Surface) {
    let (key, is_zero) = match surface {
        Surface::Line { normal, .. } => ("line.normal", normal.iter().all(|x| **x == 0.0)),
        Surface::Plane { normal, .. } => ("plane.normal", normal.iter().all(|x| **x == 0.0)),
        Surface::Cylinder { axis_direction, .. } => {
            ("cylinder.axis_direction", axis_direction.iter().all(|x| **x == 0.0))
        }
        _ => return,
    };
    if is_zero {
        let key = format!("{at}.{key}");
        findings.error(
            &key,
            format!("`{key}` has no direction: all its parts are 0"),
            "write a direction, of any length",
        );
    }
}

/// Refuses a wall without a side to forbid.
fn check_sides(findings: &mut Findings, at: &str, fixture: &Fixture) {
    for (place, surface) in fixture.surfaces().filter(|(_, surface)| !surface.has_sides()) {
        let name = surface.name();
        let key = format!("{at}.side");
        if fixture.side == Side::Unilateral {
            findings
                .error(&key, format!("`{key}` is unilateral, and a {name} has no sides"), "write bilateral")
                .see(&format!("{at}.{place}.{name}"), name);
        } else if !fixture.also.is_empty() {
            let key = format!("{at}.{place}.{name}");
            findings.error(
                &key,
                format!(
                    "`{key}` stands beside other surfaces, and a {name} has no sides that could be weighed with theirs"
                ),
                "leave out `also`, or this one",
            );
        }
    }
}

/// Reports which points of a chain prevent a shape.
fn shape_error(at: &str, surface: &Surface, error: FixtureError) -> (String, &'static str) {
    let key = format!("{at}.{}.{}", surface.name(), surface.size_key());
    match error {
        FixtureError::PointsMeet { second, .. } => (format!("{key}[{second}]"), "leave out one of the two points"),
        FixtureError::Crossing { .. } => (key, "order the points along the way, so that no two pieces cross"),
        FixtureError::RadiusBelowReach { .. } => (key, "move the points apart, so that the curve has no cusp"),
        FixtureError::OutOfRange { name: "number of points", .. } => (key, "add points, or write an open curve"),
        _ => (key, "correct this number"),
    }
}

fn check_curvature(findings: &mut Findings, at: &str, fixture: &Fixture, period_s: f64) {
    let name = fixture.surface.name();
    let is_round = matches!(fixture.surface, Surface::Circle { .. } | Surface::Sphere { .. });
    if fixture.curvature == Curvature::Exact && !is_round {
        let key = format!("{at}.curvature");
        findings
            .error(&key, format!("`{key}` cannot be exact on a {name}: it has no single centre"), "write tangent")
            .see(&format!("{at}.surface.{name}"), name);
    }
    for (place, surface) in fixture.surfaces() {
        check_radius(findings, at, &place, surface, fixture, period_s);
    }
}

/// Checks that one surface has a shape, with a curvature that leaves room for the fixture's reach.
fn check_radius(findings: &mut Findings, at: &str, place: &str, surface: &Surface, fixture: &Fixture, period_s: f64) {
    let radius_m = match surface.smallest_radius_m() {
        Ok(radius_m) => radius_m,
        // A direction of no length has been found already.
        Err(FixtureError::OutOfRange { name: "length of the normal" | "length of axis_direction", .. }) => return,
        Err(error) => {
            let (key, help) = shape_error(&format!("{at}.{place}"), surface, error);
            findings.error(&key, format!("`{key}`: {error}"), help);
            return;
        }
    };
    if fixture.law.is_some_and(|law| law.guidance().is_some()) {
        return;
    }
    let name = surface.name();
    let is_round = matches!(surface, Surface::Circle { .. } | Surface::Sphere { .. });
    let reach_m = *fixture.yield_n / fixture.coupling.equivalent_stiffness_n_per_m(period_s);
    let ratio = radius_m / reach_m;
    if !ratio.is_finite() {
        return;
    }
    let key = format!("{at}.{place}.{name}.{}", surface.size_key());
    let of = if key.ends_with("radius_m") { "" } else { " has a radius of curvature that" };
    let reach = format!("R/kappa = {} mm, the way that the proxy can lie off its input", round(reach_m * 1e3));
    let remedy =
        "enlarge the radius, lower `yield_n`, shorten the period, or raise the mass or stiffness of the coupling";
    if ratio < 1.0 {
        findings
            .error(
                &key,
                format!("`{key}`{of} is {} m, below {reach}: the proxy would reach past the centre", round(radius_m)),
                remedy,
            )
            .see(&format!("{at}.yield_n"), "R");
    } else if ratio < TANGENT_RADIUS_RATIO && fixture.curvature == Curvature::Tangent {
        let message = format!(
            "`{key}`{of} is {} m, only {} times {reach}: the tangent step is inexact on so small a radius",
            round(radius_m),
            round(ratio)
        );
        let exact = if is_round { "write `curvature: exact`, or " } else { "" };
        findings.warning(&key, message, format!("{exact}{remedy}")).see(&format!("{at}.curvature"), "curvature");
    }
}

/// Rules of an impedance device. `in_range` says that every single number is in its range.
pub(crate) fn check_device(findings: &mut Findings, device: &ImpedanceDevice, in_range: bool) {
    let period_s = if in_range { f64::from(device.cycle.period_us) * 1e-6 } else { 0.0 };
    check_fixture(findings, "fixture", &device.fixture, Host::Device, period_s);
    if !in_range {
        return;
    }
    // The isolated loop without delay is stable for b + B >= K T / 2.
    if let Coupling::Impedance { stiffness_n_per_m, damping_n_s_per_m } = device.fixture.coupling {
        let needed = *stiffness_n_per_m * period_s / 2.0;
        let present = *damping_n_s_per_m + *device.plant.damping_n_s_per_m;
        if present < needed {
            let message = format!(
                "damping of coupling and device together is {} N s/m, below K T/2 = {} N s/m: the device will oscillate",
                round(present),
                round(needed)
            );
            findings
                .warning(
                    "fixture.coupling.impedance.damping_n_s_per_m",
                    message,
                    "raise this damping, lower the stiffness or shorten the period",
                )
                .see("plant.damping_n_s_per_m", "of the device")
                .see("fixture.coupling.impedance.stiffness_n_per_m", "K")
                .see("cycle.period_us", "T");
        }
    }
}
