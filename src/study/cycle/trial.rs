//! Trials of a rig of the chart: impacts in many phases of its cycle, a trace along the circle, the least virtual mass, and the
//! computing time of its cycle.

use std::hint::black_box;
use std::ops::ControlFlow;

use super::super::drawn::{finite, positive};
use super::super::nudge::Bench;
use super::super::sweep::Clock;
use super::machine::Machine;
use yieldwall_config::{self as config, ArcSpeed, AutomaticHold, PathSegment};
use yieldwall_motion::control::Grip;
use yieldwall_motion::elementary;
use yieldwall_motion::guard::Request;
use yieldwall_record::Row;
use yieldwall_rig::EmbeddedRig;
use yieldwall_rig::analysis::{hand_of, held_masses};
use yieldwall_rig::report::{Overrides, Watch, run_rig};

/// The circle of the shipped rig, about the origin.
const RADIUS_M: f64 = 0.12;
/// Where the tool starts, on the x axis, and where the hand aims: 14 N beyond the circle, below R.
const START_M: f64 = 0.075;
const AIM_M: f64 = 0.155;
/// Rest, the way to the circle (which the tool meets at some 0.4 m/s), rest, and half of the trace along the circle and back, in s.
const BEFORE_S: f64 = 0.2;
const APPROACH_S: f64 = 0.6;
const REST_S: f64 = 0.4;
const TRACE_S: f64 = 1.5;
const TRACE_RAD: f64 = 0.8;
/// Impacts of a rig, each at another phase of the cycle.
pub(super) const IMPACTS: u32 = 8;
/// A proxy that is farther beyond the circle than this, in m, went through.
const THROUGH_M: f64 = 1e-6;
/// The hold of the trace and of every other impact.
const HOLD_KG: f64 = 1.5;
const HOLD_S: f64 = 0.15;
/// Phases of a sensor's clock at which a nudge is looked at.
const PHASES: u32 = 8;
/// Where the search for the least mass begins if none is printed: kg for each ms of the cycle.
const GUESS_KG_PER_MS: f64 = 0.2;
/// Factors by which the search changes the mass: near a printed mass, and from a guess.
const NEAR: f64 = 1.04;
const FAR: f64 = 1.15;
/// Cycles that are computed again for their time, behind these, and how often.
const SKIPPED: u32 = 700;
const TIMED: u32 = 2000;
const ROUNDS: usize = 9;

/// An impact, and a trace if there was one. Lengths in m.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Found {
    pub(super) proxy_depth_m: f64,
    pub(super) tool_depth_m: f64,
    pub(super) error_rms_m: f64,
    pub(super) error_max_m: f64,
}

impl Found {
    pub(super) fn is_through(&self) -> bool {
        self.proxy_depth_m > THROUGH_M
    }
}

fn beyond_m([x, y, _]: [f64; 3]) -> f64 {
    elementary::hypot(x, y) - RADIUS_M
}

/// An impact that begins so many shares of a cycle late, with a hold or without one, and with a trace behind it or without one.
///
/// # Errors
/// What stopped the rig, or what was refused.
pub(super) fn strike(machine: &Machine, phase: f64, has_hold: bool, traces: bool) -> Result<Found, String> {
    let (mut rig, mut scene) = (machine.rig.clone(), machine.scene.clone());
    if has_hold {
        let hold = AutomaticHold { hand_mass_kg: positive(HOLD_KG), longest_s: positive(HOLD_S) };
        rig.fixture.automatic_hold = Some(hold);
    }
    let period_s = f64::from(rig.cycle.period_us) * 1e-6;
    let before_s = BEFORE_S + phase * period_s;
    let arc = |by_rad: f64| PathSegment::Arc {
        center_m: [0.0, 0.0].map(finite).to_vec(),
        by_rad: finite(by_rad),
        in_s: positive(TRACE_S),
        speed: ArcSpeed::Constant,
    };
    scene.hand.tremor = None;
    scene.hand.aim_error = None;
    scene.hand.start_m = [START_M, 0.0].map(finite).to_vec();
    scene.hand.path = vec![
        PathSegment::Wait { for_s: positive(before_s) },
        PathSegment::To { point_m: [AIM_M, 0.0].map(finite).to_vec(), in_s: positive(APPROACH_S) },
        PathSegment::Wait { for_s: positive(REST_S) },
    ];
    let traced_from_s = before_s + APPROACH_S + REST_S;
    let mut end_s = traced_from_s;
    if traces {
        scene.hand.path.extend([arc(TRACE_RAD), arc(-TRACE_RAD)]);
        end_s += 2.0 * TRACE_S;
    }
    scene.duration_s = positive(end_s);
    let report = run_rig(&rig, &scene, &Overrides::default(), Watch::default(), |_| ControlFlow::Continue(()))
        .map_err(|error| error.to_string())?;
    if let Some(cause) = report.cause.filter(|_| report.state.is_some_and(|state| state.is_latched())) {
        return Err(format!("stopped by {}", cause.fault.row().name));
    }
    let rows = &report.trace.rows;
    let struck = || rows.iter().filter(|row| row.time_s < traced_from_s);
    let traced: Vec<f64> = rows
        .iter()
        .filter(|row| row.time_s >= traced_from_s && row.time_s < end_s)
        .map(|row| beyond_m(row.tool_m).abs())
        .collect();
    let most = |of: fn(&Row) -> [f64; 3]| struck().map(|row| beyond_m(of(row))).fold(0.0, f64::max);
    let square: f64 = traced.iter().map(|error_m| error_m * error_m).sum();
    Ok(Found {
        proxy_depth_m: most(|row| row.proxy_m),
        tool_depth_m: most(|row| row.tool_m),
        error_rms_m: (square / traced.len().max(1) as f64).sqrt(),
        error_max_m: traced.iter().copied().fold(0.0, f64::max),
    })
}

/// Least virtual mass in kg with the hand of the scene: as `tune fixture` prints it, and as runs without dry friction show it.
///
/// # Errors
/// What was refused.
pub(super) fn least_kg(machine: &Machine) -> Result<(Option<f64>, Option<f64>), String> {
    let Machine { rig, scene, .. } = machine;
    let grip: Grip = hand_of(scene);
    let held = held_masses(rig, scene, &[grip], 1.0).map_err(|error| error.to_string())?;
    let printed = held.iter().flatten().find_map(|held| held.masses);
    let guess_kg = GUESS_KG_PER_MS * f64::from(rig.cycle.period_us) * 1e-3;
    let (start_kg, at_m, step) = match printed {
        Some(masses) => (masses.least_kg, masses.least_at_m, NEAR),
        None => (guess_kg, [RADIUS_M, 0.0], FAR),
    };
    let run_kg = Bench::new(rig, scene, &grip, at_m, PHASES).edge_kg(start_kg, step, step)?;
    Ok((printed.map(|masses| masses.least_kg), run_kg))
}

/// Median time in s in which a cycle's control step is computed, from sensing to allowed command.
///
/// # Errors
/// What was refused.
pub(super) fn computing_s(rig: &config::Rig, scene: &config::Scene, clock: Clock<'_>) -> Result<f64, String> {
    let say = |error: yieldwall_rig::RigError| error.to_string();
    let mut machine = EmbeddedRig::new(rig, scene, &rig.fixture, scene.seed).map_err(say)?;
    machine.enable().map_err(say)?;
    for _ in 0..SKIPPED {
        machine.run_cycle(Request::None).map_err(say)?;
    }
    let cycle = machine.master().cycle().clone();
    let mut inputs = Vec::new();
    for _ in 0..TIMED {
        machine.run_cycle(Request::None).map_err(say)?;
        inputs.push(*machine.master().last_inputs());
    }
    let mut rounds = [0.0; ROUNDS];
    for round_s in &mut rounds {
        let mut cycle = cycle.clone();
        let begin = clock();
        for inputs in &inputs {
            black_box(cycle.step(black_box(inputs)));
        }
        *round_s = (clock() - begin).as_secs_f64() / f64::from(TIMED);
    }
    rounds.sort_by(f64::total_cmp);
    Ok(rounds[ROUNDS / 2])
}

#[cfg(test)]
mod tests {
    use super::super::machine::{Mode, Setting, Wire};
    use super::*;

    /// Computed by another program, event by event, at one pose. The worst one asks for more.
    #[test]
    fn velocity_mode_has_its_least_mass() {
        for (wire, period_us, exact_kg) in [
            (Wire::Can, 1000, 0.2224),
            (Wire::Can, 2000, 0.575),
            (Wire::Can, 5000, 1.42),
            (Wire::Can, 10_000, 0.585),
            (Wire::Ethercat, 250, 0.0686),
            (Wire::Ethercat, 1000, 0.2229),
            (Wire::Ethercat, 5000, 0.856),
        ] {
            let Machine { rig, scene, .. } = Setting { wire, mode: Mode::Velocity, period_us }.machine().unwrap();
            let holdings = held_masses(&rig, &scene, &[hand_of(&scene)], 1.0).unwrap().unwrap();
            let printed = holdings[0].masses.unwrap().least_kg;
            assert!((1.0..1.25).contains(&(printed / exact_kg)), "{wire:?}, {period_us} us: {printed}");
        }
    }

    /// A nudge comes to rest above the least mass by so much, and swings below it by so much.
    fn assert_edge(mode: Mode, period_us: u32, [above, below]: [f64; 2]) {
        let setting = Setting { wire: Wire::Ethercat, mode, period_us };
        let Machine { rig, scene, .. } = setting.machine().unwrap();
        let grip = hand_of(&scene);
        let printed = held_masses(&rig, &scene, &[grip], 1.0).unwrap().unwrap()[0].masses.unwrap();
        let mut bench = Bench::new(&rig, &scene, &grip, printed.least_at_m, PHASES);
        assert!(bench.is_stable(above * printed.least_kg).unwrap(), "{setting:?}: {printed:?} is too light");
        assert!(!bench.is_stable(printed.least_kg / below).unwrap(), "{setting:?}: {printed:?} is too heavy");
    }

    #[test]
    fn runs_in_velocity_mode_swing_below_what_is_printed_and_not_above() {
        assert_edge(Mode::Velocity, 1000, [1.02, 1.05]);
    }

    #[test]
    fn counts_and_torque_of_stiff_drives_are_no_swing() {
        assert_edge(Mode::StiffPosition, 250, [1.02, 1.05]);
        assert_edge(Mode::StiffPosition, 10_000, [1.03, 1.05]);
    }
}
