//! One scene on one machine, from switching on to the trace and its measures.

mod seen;

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::time::Duration;

pub use self::seen::RunLog;
use self::seen::trace;
use super::measures::{Context, Measures, measure};
use crate::{EmbeddedRig, ImpedanceRig, RigError};
use yieldwall_bus::EmergencyReport;
use yieldwall_config as config;
use yieldwall_config::injection::Injection;
use yieldwall_motion::guard::{Cause, Fault, Request, State};
use yieldwall_record::{AROUND_FAULT_S, DeviceRecord, ForceMeaning, Row, Trace};
use yieldwall_run::{DriveError, Watch};
use yieldwall_sim::can::BusCounters;

/// Progress of a scene for the caller.
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
    /// Measures of the rows.
    pub measures: Measures,
    /// State of the supervisor at the end of the scene, before the rig was stopped.
    pub state: Option<State>,
    /// The fault that stopped the rig or that held it at the end, if one did.
    pub cause: Option<Cause>,
    /// Counters of all buses from switching on to the end.
    pub bus: Option<BusCounters>,
    /// Share of the scene's time in which bits were on each bus, at its bit rate, with the bus's name.
    pub bus_loads: Vec<(String, f64)>,
    /// Virtual time since switching on at which the scene began, in s.
    pub started_at_s: Option<f64>,
    /// Time in s in which a fault held the reference at rest and cleared by itself.
    pub held_s: f64,
    /// Time in s for each fault that held the reference, in the order of the fault table.
    pub held_by: Vec<(Fault, f64)>,
    /// Faults that hold nothing, each with the number of cycles in which it was seen, from the boot to the end.
    pub counted: Vec<(Fault, u32)>,
    /// SDO downloads of foreign nodes to the rig's nodes.
    pub foreign_downloads: u32,
    /// Faults of the devices of an EtherCAT segment, a line each.
    pub segment: Vec<String>,
    /// Emergency messages of the devices, at most the last eight, the oldest first.
    pub emergencies: Vec<EmergencyReport>,
    /// Reports of the drives on the fault that stopped the rig.
    pub errors: Vec<DriveError>,
    /// Cycle time in s.
    pub period_s: f64,
}

impl RunReport {
    /// Returns the time that the scene ran, in s.
    pub fn simulated_s(&self) -> f64 {
        self.trace.rows.len() as f64 * self.period_s
    }

    /// Whether a fault stopped the rig for good.
    pub fn is_stopped(&self) -> bool {
        self.state.is_some_and(State::is_latched)
    }
}

/// Values that replace those of the files.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// A fixture in place of the machine's.
    pub fixture: Option<config::Fixture>,
    /// A duration in place of the scene's, in s.
    pub duration_s: Option<f64>,
    /// A seed in place of the scene's.
    pub seed: Option<u64>,
    /// Injections in addition to the scene's.
    pub faults: Vec<Injection>,
}

/// Runs a scene on an admittance rig: boots and enables it, plays the scene, stops the rig.
///
/// If a fault stops the rig, its run ends early, and the report names the fault. The cycles go on for [`AROUND_FAULT_S`], in which
/// the drives stop, for observers and drawings; measures end with the cycle that the fault stopped.
///
/// `progress` decides after each cycle whether to go on. At [`ControlFlow::Break`] the rig is stopped, and the report covers the
/// cycles until then.
///
/// # Errors
/// If the rig cannot be built, booted or enabled, or if the simulated arm cannot go on.
pub fn run_rig(
    rig: &config::Rig,
    scene: &config::Scene,
    overrides: &Overrides,
    watch: Watch,
    mut progress: impl FnMut(Stage) -> ControlFlow<()>,
) -> Result<RunReport, RigError> {
    let fixture = overrides.fixture.as_ref().unwrap_or(&rig.fixture);
    let mut machine = EmbeddedRig::new(rig, scene, fixture, overrides.seed.unwrap_or(scene.seed))?;
    machine.set_watch(watch);
    overrides.faults.iter().try_for_each(|fault| machine.inject(*fault))?;
    machine.enable()?;
    let started_at = machine.next_sync();
    let before: Vec<BusCounters> = machine.bus_counters().copied().collect();
    let period_s = f64::from(rig.cycle.period_us) * 1e-6;
    let end_s = overrides.duration_s.unwrap_or(scene.duration_s.get());
    let cycles = ((end_s / period_s).round() as usize).max(1);
    let mut seen = RunLog::default();
    let mut state = machine.state();
    let mut held: BTreeMap<usize, (Fault, f64)> = BTreeMap::new();
    for _ in 0..cycles {
        let row = machine.run_cycle(Request::None)?;
        state = machine.state();
        seen.take(row, state, machine.cause());
        let onward = progress(Stage { time_s: row.time_s, end_s });
        if state.is_latched() || onward.is_break() {
            break;
        }
        if let (State::Holding, Some(cause)) = (state, machine.cause()) {
            held.entry(cause.fault as usize).or_insert((cause.fault, 0.0)).1 += period_s;
        }
    }
    let cause = machine.cause();
    // A scene has one cycle at least.
    let elapsed = Duration::from_secs_f64(seen.rows().len() as f64 * period_s);
    let counted = rig.buses.iter().zip(machine.bus_counters().zip(&before));
    let bus_loads = counted.filter_map(|((name, bus), (counters, before))| {
        Some((name.clone(), counters.load_since(before, elapsed, bus.canopen()?.bit_rate_bit_per_s)))
    });
    let bus_loads = bus_loads.collect();
    let is_held = |row: &&Row| row.supervisor_state == State::Holding as u8;
    let held_s = seen.rows().iter().filter(is_held).count() as f64 * period_s;
    if state.is_latched() {
        for _ in 0..(AROUND_FAULT_S / period_s).round() as usize {
            machine.ask_for_errors();
            let row = machine.run_cycle(Request::None)?;
            seen.take(row, machine.state(), machine.cause());
        }
    } else {
        machine.stop()?;
    }
    let (trace, measures) = measured(rig, fixture, seen);
    Ok(RunReport {
        trace,
        measures,
        state: Some(state),
        cause,
        bus: Some(machine.bus_counters().sum()),
        bus_loads,
        started_at_s: Some(started_at.as_secs_f64()),
        held_s,
        held_by: held.into_values().collect(),
        counted: machine.master().cycle().faults().counted().collect(),
        foreign_downloads: machine.master().networks().foreign_downloads(),
        segment: machine.master().networks().findings(),
        emergencies: machine.master().networks().told(),
        errors: machine.errors().collect(),
        period_s,
    })
}

/// Impedance device, in words.
pub const IMPEDANCE_DEVICE: &str = "impedance device";

/// Returns how a rig's drives are commanded, in words.
pub fn drive(mode: config::CommandMode) -> &'static str {
    match mode {
        config::CommandMode::Torque => "torque mode",
        config::CommandMode::Velocity => "velocity mode",
        config::CommandMode::Position => "position mode",
    }
}

/// Returns the trace of a rig with this fixture, and the measures up to the fault that stopped it, if one did.
pub fn measured(rig: &config::Rig, fixture: &config::Fixture, seen: impl Into<RunLog>) -> (Trace, Measures) {
    let machine = (drive(rig.rig.command_mode), rig.cycle.period_us);
    let trace = trace(rig.rig.name.clone(), fixture, machine, ForceMeaning::HandOnTool, seen);
    let is_torque = rig.rig.command_mode == config::CommandMode::Torque;
    let context = Context {
        period_s: f64::from(rig.cycle.period_us) * 1e-6,
        mass_kg: mass_kg(fixture),
        torque_limit_n_m: is_torque.then(|| rig.guard.torque_limit_n_m.get()),
        has_depth_law: fixture.hold_steps == 0 && fixture.automatic_hold.is_none() && fixture.motion.is_none(),
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
    mut observer: impl FnMut(&DeviceRecord),
    mut progress: impl FnMut(Stage) -> ControlFlow<()>,
) -> Result<RunReport, RigError> {
    let fixture = overrides.fixture.as_ref().unwrap_or(&device.fixture);
    let mut machine = ImpedanceRig::new(device, scene, fixture, overrides.seed.unwrap_or(scene.seed))?;
    let period_s = f64::from(device.cycle.period_us) * 1e-6;
    let end_s = overrides.duration_s.unwrap_or(scene.duration_s.get());
    let cycles = ((end_s / period_s).round() as usize).max(1);
    let mut rows = Vec::with_capacity(cycles);
    for _ in 0..cycles {
        let record = machine.run_cycle()?;
        observer(&record);
        rows.push(record.row());
        if progress(Stage { time_s: record.scene_time_s, end_s }).is_break() {
            break;
        }
    }
    let (trace, measures) = measured_device(device, fixture, rows);
    Ok(RunReport {
        trace,
        measures,
        state: None,
        cause: None,
        bus: None,
        bus_loads: Vec::new(),
        started_at_s: None,
        held_s: 0.0,
        held_by: Vec::new(),
        counted: Vec::new(),
        foreign_downloads: 0,
        segment: Vec::new(),
        emergencies: Vec::new(),
        errors: Vec::new(),
        period_s,
    })
}

/// Returns the trace and the measures of an impedance device with this fixture.
pub fn measured_device(
    device: &config::ImpedanceDevice,
    fixture: &config::Fixture,
    rows: Vec<Row>,
) -> (Trace, Measures) {
    let machine = (IMPEDANCE_DEVICE, device.cycle.period_us);
    let trace = trace(device.device.name.clone(), fixture, machine, ForceMeaning::ActuatorOnTool, rows);
    let context = Context {
        period_s: f64::from(device.cycle.period_us) * 1e-6,
        mass_kg: None,
        torque_limit_n_m: None,
        has_depth_law: false,
        stiffness_n_per_m: match fixture.coupling {
            config::Coupling::Impedance { stiffness_n_per_m, .. } => stiffness_n_per_m.get(),
            config::Coupling::Admittance { .. } => 0.0,
        },
        force_resolution_n: 0.0,
    };
    let measures = measure(&trace, &context);
    (trace, measures)
}

/// Mass of the proxy where the law of energy holds: not with a spring, and not where the proxy is taken onto a point from
/// beside it.
fn mass_kg(fixture: &config::Fixture) -> Option<f64> {
    let is_captured =
        matches!(fixture.surface, config::Surface::Point { capture_radius_m, .. } if *capture_radius_m > 0.0);
    if is_captured || fixture.law.is_some_and(|law| law.guidance().is_some()) {
        return None;
    }
    match fixture.coupling {
        config::Coupling::Admittance { mass_kg } => Some(mass_kg.get()),
        config::Coupling::Impedance { .. } => None,
    }
}

#[cfg(test)]
mod energy_tests;

#[cfg(test)]
mod tests {
    use super::*;

    fn run(file: &str) -> RunReport {
        run_changed(file, |_| ())
    }

    fn run_changed(file: &str, change: impl Fn(&mut config::Fixture)) -> RunReport {
        let source = config::builtin(file);
        let loaded = config::load_rig(source).unwrap();
        let scene = loaded.scene().unwrap().value;
        let mut rig = loaded.value;
        change(&mut rig.fixture);
        run_rig(&rig, &scene, &Overrides::default(), Watch::default(), |_| ControlFlow::Continue(())).unwrap()
    }

    fn surface(yaml_key: &str, values: serde_json::Value) -> config::Surface {
        serde_json::from_value(serde_json::json!({ yaml_key: values })).unwrap()
    }

    /// The hand of this scene presses above R in its legs d and h.
    #[test]
    fn the_hand_of_the_circle_breaks_out_twice() {
        let measures = run("paper-admittance.yaml").measures;
        assert_eq!((measures.break_outs, measures.unintended_releases), (2, 0));
        assert!((11.5..12.5).contains(&measures.on_surface_s), "{} s", measures.on_surface_s);
    }

    /// Which of two walls is named first is nothing that a measure could see, and both are measured where they are.
    #[test]
    fn walls_that_move_are_measured_where_they_are_and_in_any_order() {
        let named = run("moving-walls.yaml");
        let swapped =
            run_changed("moving-walls.yaml", |fixture| std::mem::swap(&mut fixture.surface, &mut fixture.also[0]));
        for report in [&named, &swapped] {
            assert_eq!(report.trace.references.len(), 2);
            let Measures { tool_rms_tracing_mm, tool_max_on_surface_mm, .. } = report.measures;
            assert!(tool_rms_tracing_mm.unwrap() < 0.5, "{:?}", report.measures);
            assert!(tool_max_on_surface_mm.unwrap() < 5.0, "{:?}", report.measures);
            assert!(report.measures.impacts.iter().all(|impact| impact.tool_depth_mm < 5.0), "{:?}", report.measures);
            assert_eq!(report.measures.unintended_releases, 0);
        }
        assert_eq!(named.measures, swapped.measures);
        let farthest = named.trace.rows.iter().map(|row| row.surface_m[0]).fold(0.0, f64::max);
        assert!((farthest - 0.05).abs() < 1e-4, "{farthest}");
    }

    /// The stops on the second guide count, and going over to it is no way through the first.
    #[test]
    fn a_second_guide_is_measured_as_the_first() {
        let line = surface("line", serde_json::json!({ "point_m": [-0.03, 0.0], "normal": [1.0, 0.0] }));
        let report = run_changed("paper-admittance.yaml", |fixture| fixture.also = vec![line.clone()]);
        let measures = &report.measures;
        assert!(measures.is_within_bound(), "{measures:?}");
        assert!(
            measures.impacts.iter().all(|impact| impact.depth_mm < 4.0 && impact.tool_depth_mm < 5.0),
            "{measures:?}"
        );
        let is_on_line = |row: &Row| row.is_on_surface && (row.proxy_m[0] + 0.03).abs() < 1e-9;
        assert!(measures.impacts.iter().any(|impact| is_on_line(&report.trace.rows[impact.row])), "{measures:?}");
        assert!(measures.tool_rms_on_surface_mm.unwrap() < 0.1, "{measures:?}");
    }

    /// Every reference in space, on the shipped device: what is run can be measured and drawn.
    #[test]
    fn references_in_space_are_run_and_drawn() {
        let source = config::builtin("sphere.yaml");
        let device = config::load_device(source.clone()).unwrap().value;
        let scene = config::load_scene(source.relative(&device.scene)).unwrap().value;
        let others = [
            surface(
                "box",
                serde_json::json!({
                    "center_m": [0.0, 0.0, -0.02], "half_size_m": [0.035, 0.03, 0.03], "forbidden": "inside"
                }),
            ),
            surface(
                "space_curve",
                serde_json::json!({
                    "points_m": [[0.04, 0.0, -0.01], [0.0, 0.04, 0.0], [-0.04, 0.0, 0.01]],
                    "is_closed": false, "capture_radius_m": 0.002
                }),
            ),
            surface("space_point", serde_json::json!({ "point_m": [0.0333, 0.0204, 0.0], "capture_radius_m": 0.002 })),
        ];
        for surface in std::iter::once(device.fixture.surface.clone()).chain(others) {
            let curvature = match surface {
                config::Surface::Sphere { .. } => config::Curvature::Exact,
                _ => config::Curvature::Tangent,
            };
            let fixture = config::Fixture { surface, curvature, ..device.fixture.clone() };
            let name = fixture.surface.name();
            let overrides = Overrides { fixture: Some(fixture), ..Overrides::default() };
            let report = run_device(&device, &scene, &overrides, |_| {}, |_| ControlFlow::Continue(())).unwrap();
            let measures = &report.measures;
            assert!(measures.is_within_bound(), "{name}: {measures:?}");
            assert!(measures.tool_max_on_surface_mm.is_some_and(|most| most < 5.0), "{name}: {measures:?}");
            let leaves_plane = report.trace.rows.iter().any(|row| row.tool_m[2].abs() > 1e-4);
            assert!(leaves_plane || name != "sphere", "a sphere beside its great circle pushes along z");
            let svg = yieldwall_figures::run(&report.trace, String::new()).unwrap().svg();
            assert!(svg.contains(">reference surface"), "{name}");
        }
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
