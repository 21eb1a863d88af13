//! One scene on one machine, from switching on to the trace and its measures.

use std::time::Duration;

use super::measures::{Context, Measures, measure};
use crate::config;
use crate::fixture::Shape2;
use crate::guard::{Cause, Request, State};
use crate::injection::Injection;
use crate::record::{AROUND_FAULT_S, ForceMeaning, Reference, Row, SideYield, Trace};
use crate::rig::{EmbeddedRig, ImpedanceRig, Observer, RigError, Tap};
use crate::sim::can::BusCounters;

/// Rows of the moving average over the tool velocity in the power.
///
/// # Source
/// [KTF08], text to Fig. 11.
const POWER_AVERAGE_ROWS: usize = 5;

/// What a caller may want to know while a scene runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stage {
    /// Simulated time in s.
    pub time_s: f64,
    /// Simulated time at the end in s.
    pub end_s: f64,
}

/// A finished run.
#[derive(Clone, Debug)]
pub struct RunReport {
    /// The rows.
    pub trace: Trace,
    /// What was measured on them.
    pub measures: Measures,
    /// State of the supervisor at the end of the scene, before the rig was stopped.
    pub state: Option<State>,
    /// The fault that stopped the rig or that held it at the end, if one did.
    pub cause: Option<Cause>,
    /// What went over all buses from switching on to the end.
    pub bus: Option<BusCounters>,
    /// Share of the scene's time in which bits were on each bus, at its bit rate, with the bus's name.
    pub bus_loads: Vec<(String, f64)>,
    /// Virtual time since switching on at which the scene began, in s.
    pub started_at_s: Option<f64>,
    /// Time in s in which a fault held the reference at rest and cleared by itself.
    pub held_s: f64,
    /// Cycle time in s.
    pub period_s: f64,
}

/// What may stand in place of what the files say.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// A fixture in place of the machine's.
    pub fixture: Option<config::Fixture>,
    /// A duration in place of the scene's, in s.
    pub duration_s: Option<f64>,
    /// A seed in place of the scene's.
    pub seed: Option<u64>,
    /// What is broken on the way, beside what the scene says.
    pub faults: Vec<Injection>,
}

/// Who looks on while a rig runs, from switching on to the end.
#[derive(Default)]
pub struct Watch {
    /// Gets every frame on the bus.
    pub tap: Option<Tap>,
    /// Gets the record of every cycle.
    pub observer: Option<Observer>,
}

/// Runs a scene on an admittance rig: boots and enables it, plays the scene, stops the rig.
///
/// A rig that a fault stops ends its run early; the report says which. It goes on for [`AROUND_FAULT_S`], in which its
/// drives stop, for those who watch; rows and measures end with the cycle that the fault stopped.
///
/// # Errors
/// If the rig cannot be built, booted or enabled, or if the simulated arm cannot go on.
pub fn run_rig(
    rig: &config::Rig,
    scene: &config::Scene,
    overrides: &Overrides,
    watch: Watch,
    mut progress: impl FnMut(Stage),
) -> Result<RunReport, RigError> {
    let fixture = overrides.fixture.as_ref().unwrap_or(&rig.fixture);
    let mut machine = EmbeddedRig::new(rig, scene, fixture, overrides.seed.unwrap_or(scene.seed))?;
    if let Some(tap) = watch.tap {
        machine.set_tap(tap);
    }
    if let Some(observer) = watch.observer {
        machine.set_observer(observer);
    }
    overrides.faults.iter().try_for_each(|fault| machine.inject(*fault))?;
    machine.enable()?;
    let started_at = machine.next_sync();
    let before: Vec<BusCounters> = machine.bus_counters().copied().collect();
    let period_s = f64::from(rig.cycle.period_us) * 1e-6;
    let end_s = overrides.duration_s.unwrap_or(scene.duration_s.get());
    let cycles = ((end_s / period_s).round() as usize).max(1);
    let mut rows = Vec::with_capacity(cycles);
    let mut state = machine.state();
    for _ in 0..cycles {
        let row = machine.run_cycle(Request::None)?;
        rows.push(row);
        progress(Stage { time_s: row.time_s, end_s });
        state = machine.state();
        if state.is_latched() {
            break;
        }
    }
    let cause = machine.cause();
    // A scene has one cycle at least.
    let elapsed = Duration::from_secs_f64(rows.len() as f64 * period_s);
    let counted = rig.buses.iter().zip(machine.bus_counters().zip(&before));
    let bus_loads = counted.map(|((name, bus), (counters, before))| {
        (name.clone(), counters.load_since(before, elapsed, bus.bit_rate_bit_per_s))
    });
    let bus_loads = bus_loads.collect();
    let held_s = rows.iter().filter(|row| row.supervisor_state == State::Holding as u8).count() as f64 * period_s;
    if state.is_latched() {
        for _ in 0..(AROUND_FAULT_S / period_s).round() as usize {
            machine.run_cycle(Request::None)?;
        }
    } else {
        machine.stop()?;
    }
    let (trace, measures) = measured(rig, fixture, rows);
    Ok(RunReport {
        trace,
        measures,
        state: Some(state),
        cause,
        bus: Some(machine.bus_counters().sum()),
        bus_loads,
        started_at_s: Some(started_at.as_secs_f64()),
        held_s,
        period_s,
    })
}

/// What the rows of a rig with this fixture show.
pub fn measured(rig: &config::Rig, fixture: &config::Fixture, rows: Vec<Row>) -> (Trace, Measures) {
    let trace = trace(rig.rig.name.clone(), fixture, ForceMeaning::HandOnTool, rows);
    let is_torque = rig.rig.command_mode == config::CommandMode::Torque;
    let context = Context {
        period_s: f64::from(rig.cycle.period_us) * 1e-6,
        mass_kg: mass_kg(fixture),
        normal_sign: normal_sign(&fixture.surface),
        torque_limit_n_m: is_torque.then(|| rig.guard.torque_limit_n_m.get()),
        has_hold: fixture.hold_steps > 0 || fixture.automatic_hold.is_some(),
        stiffness_n_per_m: 0.0,
        force_resolution_n: rig.sensor.calibration[0][0].get().abs().max(rig.sensor.calibration[1][1].get().abs()),
    };
    let measures = measure(&trace, &context);
    (trace, measures)
}

/// Runs a scene on an impedance device.
///
/// # Errors
/// If the device cannot be built or cannot go on.
pub fn run_device(
    device: &config::ImpedanceDevice,
    scene: &config::Scene,
    overrides: &Overrides,
    mut progress: impl FnMut(Stage),
) -> Result<RunReport, RigError> {
    let fixture = overrides.fixture.as_ref().unwrap_or(&device.fixture);
    let mut machine = ImpedanceRig::new(device, scene, fixture, overrides.seed.unwrap_or(scene.seed))?;
    let period_s = f64::from(device.cycle.period_us) * 1e-6;
    let end_s = overrides.duration_s.unwrap_or(scene.duration_s.get());
    let cycles = (end_s / period_s).round() as usize;
    let mut rows = Vec::with_capacity(cycles);
    for _ in 0..cycles {
        let row = machine.run_cycle()?;
        progress(Stage { time_s: row.time_s, end_s });
        rows.push(row);
    }
    let trace = trace(device.device.name.clone(), fixture, ForceMeaning::ActuatorOnTool, rows);
    let context = Context {
        period_s,
        mass_kg: None,
        normal_sign: normal_sign(&fixture.surface),
        torque_limit_n_m: None,
        has_hold: fixture.hold_steps > 0,
        stiffness_n_per_m: match fixture.coupling {
            config::Coupling::Impedance { stiffness_n_per_m, .. } => stiffness_n_per_m.get(),
            config::Coupling::Admittance { .. } => 0.0,
        },
        force_resolution_n: 0.0,
    };
    let measures = measure(&trace, &context);
    Ok(RunReport {
        trace,
        measures,
        state: None,
        cause: None,
        bus: None,
        bus_loads: Vec::new(),
        started_at_s: None,
        held_s: 0.0,
        period_s,
    })
}

/// The fixture's normal points out of the forbidden side, that of the trace's reference away from the centre.
fn normal_sign(surface: &config::Surface) -> f64 {
    match *surface {
        config::Surface::Circle { forbidden: config::Forbidden::Outside, .. }
        | config::Surface::Cylinder { forbidden: config::Forbidden::Outside, .. }
        | config::Surface::Sphere { forbidden: config::Forbidden::Outside, .. } => -1.0,
        _ => 1.0,
    }
}

/// A yield force of its own against pushes out of the forbidden side.
fn side_yield(fixture: &config::Fixture) -> Option<SideYield> {
    match fixture.law {
        Some(config::FixtureLaw::Tube { outward_yield_n }) if fixture.side == config::Side::Bilateral => {
            Some(SideYield { normal_sign: normal_sign(&fixture.surface), yield_n: outward_yield_n.get() })
        }
        _ => None,
    }
}

/// Mass of the proxy where the laws of impacts and energy hold: not with a spring, and not on a surface that moves.
fn mass_kg(fixture: &config::Fixture) -> Option<f64> {
    if fixture.motion.is_some() || fixture.law.is_some_and(|law| law.guidance().is_some()) {
        return None;
    }
    match fixture.coupling {
        config::Coupling::Admittance { mass_kg } => Some(mass_kg.get()),
        config::Coupling::Impedance { .. } => None,
    }
}

pub(super) fn trace(title: String, fixture: &config::Fixture, force_meaning: ForceMeaning, rows: Vec<Row>) -> Trace {
    let mut trace = Trace {
        title,
        reference: reference(&fixture.surface),
        friction_n: fixture.friction_n.get(),
        yield_n: fixture.yield_n.get(),
        side_yield: side_yield(fixture),
        is_unilateral: fixture.side == config::Side::Unilateral,
        hold_steps: fixture.hold_steps,
        force_meaning,
        phases: Vec::new(),
        rows,
    };
    set_power(&mut trace);
    trace
}

fn reference(surface: &config::Surface) -> Reference {
    let two = |[x, y]: [config::Finite; 2]| [x.get(), y.get()];
    let three = |point: [config::Finite; 3]| point.map(|value| value.get());
    let flat = |point: [config::Finite; 2]| {
        let [x, y] = two(point);
        [x, y, 0.0]
    };
    match *surface {
        config::Surface::Circle { center_m, radius_m, .. } => {
            Reference::Circle { center_m: two(center_m), radius_m: radius_m.get() }
        }
        config::Surface::Line { point_m, normal } => Reference::Plane { point_m: flat(point_m), normal: flat(normal) },
        config::Surface::Cylinder { axis_point_m, axis_direction, radius_m, .. } => Reference::Cylinder {
            axis_point_m: three(axis_point_m),
            axis_direction: three(axis_direction),
            radius_m: radius_m.get(),
        },
        config::Surface::Plane { point_m, normal } => {
            Reference::Plane { point_m: three(point_m), normal: three(normal) }
        }
        // A planar figure of a sphere is its great circle.
        config::Surface::Sphere { center_m, radius_m, .. } => {
            let [x, y, _] = three(center_m);
            Reference::Circle { center_m: [x, y], radius_m: radius_m.get() }
        }
        // The outline of a wall runs so that its left is allowed. A point has no line, and what lies in space no
        // section that a planar figure could show.
        ref other => match other.planar() {
            Ok(Some(Shape2::Chain(chain))) if other.has_sides() => Reference::Curve {
                points_m: chain.outline_m().iter().map(|point| [point.x, point.y]).collect(),
                is_closed: chain.is_closed(),
            },
            _ => Reference::None,
        },
    }
}

/// Power of the device on the hand: force times the tool velocity after a centred moving average.
fn set_power(trace: &mut Trace) {
    let half = POWER_AVERAGE_ROWS / 2;
    let power: Vec<f64> = (0..trace.rows.len())
        .map(|at| {
            let window = &trace.rows[at.saturating_sub(half)..(at + half + 1).min(trace.rows.len())];
            let force = trace.force_on_hand_n(&trace.rows[at]);
            let mean = |axis: usize| {
                window.iter().map(|row| row.tool_velocity_m_per_s[axis]).sum::<f64>() / window.len() as f64
            };
            (0..3).map(|axis| force[axis] * mean(axis)).sum()
        })
        .collect();
    for (row, power) in trace.rows.iter_mut().zip(power) {
        row.power_w = power;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(file: &str) -> RunReport {
        let source = config::builtin(file);
        let rig = config::load_rig(source.clone()).unwrap().value;
        let scene = config::load_scene(source.relative(&rig.scene)).unwrap().value;
        run_rig(&rig, &scene, &Overrides::default(), Watch::default(), |_| {}).unwrap()
    }

    /// The scenes go round a corner that forbids its inside, and off a guide to the side on which it yields sooner: neither is
    /// a release below the yield force. The torque limit is reached where an impact stops the arm, and nowhere else.
    #[test]
    fn walls_and_guides_of_the_shipped_rigs_let_go_of_nothing_that_is_pressed_on_them() {
        for file in ["room.yaml", "curve-guide.yaml"] {
            let measures = run(file).measures;
            assert_eq!(measures.unintended_releases, 0, "{file}");
            assert_eq!(measures.on_surface_fraction_when_pressed, Some(1.0), "{file}");
            assert!(measures.torque_limit_s.is_some_and(|limit_s| limit_s > 0.0), "{file}: no hard impact");
            assert_eq!(measures.torque_limit_apart_s, Some(0.0), "{file}");
            assert!(measures.impacts.iter().all(|impact| impact.predicted_depth_mm.is_none()), "{file} holds");
        }
    }
}
