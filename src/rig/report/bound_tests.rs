//! The bound by which `run` judges the energy of a run: passive hands keep within it, and loops that swing pass it or are stopped.

use std::f64::consts::TAU;
use std::ops::ControlFlow;

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::SeedableRng;
use serde_json::{Value, json};

use super::{Overrides, RunReport, Watch, run_rig};
use crate::analysis::{hand_of, held_masses};
use crate::sample::share;
use yieldwall_config as config;
use yieldwall_motion::elementary;
use yieldwall_sim::share_of_one;

/// Peak over mean speed of a way by minimum jerk.
const PEAK: f64 = 1.875;
/// Cases of passive hands: every rig and errand, with friction and without.
const CLEAN: u64 = 210;
/// A tool that in the last second of a run is faster on average, m/s, long after the hand's aim came to rest, swings.
const SWINGS_M_PER_S: f64 = 0.01;
/// Seed of all cases.
const SEED: u64 = 0xe4e5;
/// Rigs of the clean runs, by their cycle: 0.5 ms is the first one at twice its rate, on a bus that costs no time.
const CYCLES: [(&str, Option<u32>); 7] = [
    ("paper-admittance.yaml", Some(500)),
    ("paper-admittance.yaml", None),
    ("paper-admittance-csp.yaml", None),
    ("paper-admittance-2ms.yaml", None),
    ("paper-admittance-4ms.yaml", None),
    ("paper-admittance-5ms.yaml", None),
    ("paper-admittance-10ms.yaml", None),
];
/// Errands of a passive hand.
const ERRANDS: [&str; 3] = ["free", "impact", "trace"];
/// Radius in m of the circle of the shipped rigs.
const CIRCLE_M: f64 = 0.12;
/// A passive hand on a mass so many times the least one with it, or more, does not go on swinging.
const RESERVE: f64 = 1.5;
/// Force limit of a hand that swings, N: the swing grows until it is there.
const SWING_LIMIT_N: f64 = 3.0;
/// Speed limit of the rigs that swing, m/s.
const SWING_SPEED_LIMIT_M_PER_S: f64 = 1.5;
/// Cycle in s at which a hand that swings has the stiffness that is drawn; at longer ones it is softer by as much.
const SWING_CYCLE_S: f64 = 1e-3;

/// A rig with a scene.
struct Trial {
    rig: config::Rig,
    scene: config::Scene,
}

/// Puts a value at a place of a document.
fn put<T: serde::Serialize + serde::de::DeserializeOwned>(of: &T, places: &[(&str, Value)]) -> Result<T, String> {
    let mut document = serde_json::to_value(of).map_err(|error| error.to_string())?;
    for (place, value) in places {
        *document.pointer_mut(place).ok_or_else(|| format!("no {place}"))? = value.clone();
    }
    serde_json::from_value(document).map_err(|error| error.to_string())
}

fn of_cycle((file, period_us): (&str, Option<u32>)) -> Result<(config::Rig, config::Scene), String> {
    let (rig, scene) = shipped(file)?;
    let rig = match period_us {
        Some(period_us) => put(
            &rig,
            &[
                ("/cycle/period_us", json!(period_us)),
                ("/cycle/compute_at_us", json!(period_us / 2)),
                ("/simulation/timing", json!("ideal")),
            ],
        )?,
        None => rig,
    };
    Ok((rig, scene))
}

fn without_friction(rig: &config::Rig) -> Result<config::Rig, String> {
    let mut places = vec![("/fixture/friction_n", json!(0.0)), ("/simulation/arm/coulomb_n_m", json!([0.0, 0.0]))];
    if rig.rig.command_mode == config::CommandMode::Torque {
        places.push(("/control/feed_forward/coulomb_n_m", json!([0.0, 0.0])));
    }
    put(rig, &places)
}

/// Least virtual mass in kg of the rig with the hand of the scene; `None` if none is stable.
fn least_kg(rig: &config::Rig, scene: &config::Scene) -> Result<Option<f64>, String> {
    let found = held_masses(rig, scene, &[hand_of(scene)], 1.0).map_err(|error| error.to_string())?;
    Ok(found.iter().flatten().filter_map(|held| held.masses).map(|masses| masses.least_kg).next())
}

fn with_mass(rig: &config::Rig, virtual_kg: f64) -> Result<config::Rig, String> {
    put(rig, &[("/fixture/coupling", json!({ "admittance": { "mass_kg": virtual_kg } }))])
}

impl Trial {
    /// A passive hand without tremor on a rig with the mass of its file, or a heavier one where the hand asks for that.
    fn clean(case: u64) -> Result<Self, String> {
        let mut draws = Dice::new(SEED ^ case);
        let (rig, scene) = of_cycle(CYCLES[(case % CYCLES.len() as u64) as usize])?;
        let is_frictionless = (case / CYCLES.len() as u64) % 2 == 1;
        let rig = if is_frictionless { without_friction(&rig)? } else { rig };
        let errand = ERRANDS[(case / (2 * CYCLES.len() as u64)) as usize % ERRANDS.len()];
        // Within a guide R resists every way off it.
        let wall = [("/fixture/side", json!("unilateral")), ("/fixture/surface/circle/forbidden", json!("outside"))];
        let rig = if errand == "free" { put(&rig, &wall)? } else { rig };
        let (mass_kg, stiffness) = (draws.between(0.3, 1.5), draws.between(100.0, 600.0));
        let damping = draws.between(0.15, 0.5) * 2.0 * (stiffness * (mass_kg + 2.0)).sqrt();
        let yield_n = rig.fixture.yield_n.get();
        // A hand aims at most at a third of the rig's speed limit, since the tool overshoots.
        let least_s = |way_m: f64| PEAK * way_m / (rig.guard.tool_speed_limit_m_per_s.get() / 3.0);
        let angle = draws.between(0.0, TAU);
        let at = |radius: f64, angle: f64| json!([radius * elementary::cos(angle), radius * elementary::sin(angle)]);
        let to = |point: Value, in_s: f64| json!({ "to": { "point_m": point, "in_s": in_s } });
        let wait = |for_s: f64| json!({ "wait": { "for_s": for_s } });
        let mut path = vec![wait(0.2)];
        let start = match errand {
            // To and fro within the circle.
            "free" => {
                for leg in 0..4 {
                    let turn = draws.between(0.7, 1.3) * TAU / 2.0;
                    let aim = at(draws.between(0.02, 0.06), angle + f64::from(leg + 1) * turn);
                    let in_s = draws.between(0.25, 1.0).max(least_s(0.12));
                    path.extend([to(aim, in_s), wait(draws.between(0.0, 0.4) + 0.01)]);
                }
                at(0.05, angle)
            }
            // Against the circle from within, below and above R, and back.
            "impact" => {
                for _ in 0..3 {
                    let beyond = draws.between(0.2, 1.3) * yield_n / stiffness;
                    let [there_s, back_s] = [0.25, 0.4].map(|least| draws.between(least, 0.8).max(least_s(0.08)));
                    path.extend([to(at(CIRCLE_M + beyond.min(0.04), angle), there_s), wait(0.3)]);
                    path.push(to(at(0.08, angle), back_s));
                }
                at(0.08, angle)
            }
            _ => {
                let beyond = draws.between(0.3, 0.8) * yield_n / stiffness;
                path.extend([to(at(CIRCLE_M + beyond.min(0.05), angle), least_s(0.07).max(0.8)), wait(0.2)]);
                for _ in 0..2 {
                    let by_rad = draws.between(-1.0, 1.0);
                    let arc = json!({ "center_m": [0.0, 0.0], "by_rad": by_rad, "in_s": draws.between(0.8, 1.6).max(least_s(CIRCLE_M)), "speed": "smooth" });
                    path.push(json!({ "arc": arc }));
                }
                at(0.10, angle)
            }
        };
        let hand = json!({
            "mass_kg": mass_kg, "stiffness_n_per_m": stiffness, "damping_n_s_per_m": damping,
            "voluntary_force_limit_n": null, "tremor": null, "start_m": start, "path": path,
        });
        let scene = put(&scene, &[("/hand", hand), ("/duration_s", json!(4.0)), ("/seed", json!(case + 1))])?;
        let least_kg = least_kg(&rig, &scene)?.ok_or("no mass is stable with this hand")?;
        let shipped_kg = match &rig.fixture.coupling {
            config::Coupling::Admittance { mass_kg } => mass_kg.get(),
            config::Coupling::Impedance { .. } => return Err("not of the admittance type".to_owned()),
        };
        let virtual_kg = shipped_kg.max(RESERVE * least_kg);
        Ok(Self { rig: with_mass(&rig, virtual_kg)?, scene })
    }

    /// A stiff hand on a rig without friction whose mass is a share of the least one that `tune fixture` gives.
    fn swinging(case: u64) -> Result<Self, String> {
        let mut draws = Dice::new(SEED ^ (case + 1_000_000));
        let (rig, scene) = of_cycle(CYCLES[1 + (case % (CYCLES.len() as u64 - 1)) as usize])?;
        let rig = without_friction(&rig)?;
        let softer = SWING_CYCLE_S / (f64::from(rig.cycle.period_us) * 1e-6);
        let (mass_kg, stiffness) = (draws.between(0.3, 1.0), draws.between(1000.0, 5000.0) * softer);
        let damping = draws.between(0.1, 0.25) * 2.0 * (stiffness * (mass_kg + 1.0)).sqrt();
        let angle = draws.between(0.0, TAU);
        let point = [0.005 * elementary::cos(angle), 0.005 * elementary::sin(angle)];
        let hand = json!({
            "mass_kg": mass_kg, "stiffness_n_per_m": stiffness, "damping_n_s_per_m": damping,
            "voluntary_force_limit_n": SWING_LIMIT_N, "tremor": null, "start_m": [0.0, 0.0],
            "path": [{ "wait": { "for_s": 0.2 } }, { "to": { "point_m": point, "in_s": 0.2 } }, { "wait": { "for_s": 1.0 } }],
        });
        let scene = put(&scene, &[("/hand", hand), ("/duration_s", json!(4.0)), ("/seed", json!(case + 1))])?;
        let least_kg = least_kg(&rig, &scene)?.ok_or("no mass is stable with this hand")?;
        let virtual_kg = least_kg * draws.between(0.5, 0.9);
        // The bound is to be tried, not the guard.
        let rig = put(&rig, &[("/guard/tool_speed_limit_m_per_s", json!(SWING_SPEED_LIMIT_M_PER_S))])?;
        Ok(Self { rig: with_mass(&rig, virtual_kg)?, scene })
    }

    /// Runs it.
    fn run(&self) -> Result<RunReport, String> {
        run_rig(&self.rig, &self.scene, &Overrides::default(), Watch::default(), |_| ControlFlow::Continue(()))
            .map_err(|error| error.to_string())
    }
}

/// A stream of random numbers.
struct Dice(SplitMix64);

impl Dice {
    fn new(seed: u64) -> Self {
        Self(SplitMix64::seed_from_u64(seed))
    }

    fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * share_of_one(&mut self.0)
    }
}

fn shipped(name: &str) -> Result<(config::Rig, config::Scene), String> {
    let rig = config::load_rig(config::builtin(name)).map_err(|report| report.to_string())?;
    let scene = rig.scene().map_err(|report| report.to_string())?.value;
    Ok((rig.value, scene))
}

/// Root of the mean square of the tool's speed in the last second.
fn last_m_per_s(report: &RunReport) -> f64 {
    let cycles = (1.0 / report.period_s) as usize;
    let rows = &report.trace.rows[report.trace.rows.len().saturating_sub(cycles)..];
    let square = |[x, y, z]: [f64; 3]| x * x + y * y + z * z;
    let sum: f64 = rows.iter().map(|row| square(row.tool_velocity_m_per_s)).sum();
    (sum / rows.len().max(1) as f64).sqrt()
}

fn is_stopped(report: &RunReport) -> bool {
    report.state.is_some_and(|state| state.is_latched())
}

#[test]
fn passive_hands_keep_within_the_bound() {
    for case in share((0..CLEAN).step_by(5), 10) {
        let report = Trial::clean(case).and_then(|trial| trial.run()).unwrap();
        let is_within = report.measures.is_within_bound();
        assert!(is_within && !is_stopped(&report), "{case}: {:?}", report.cause);
    }
}

#[test]
fn the_bound_or_the_guard_finds_loops_that_swing() {
    // 1 ms by torque and by position, 2 ms.
    let runs =
        (0..18).filter(|case| case % 6 < 3).map(|case| Trial::swinging(case).and_then(|trial| trial.run()).unwrap());
    let swinging: Vec<RunReport> = runs.filter(|report| last_m_per_s(report) > SWINGS_M_PER_S).collect();
    let is_above = |report: &&RunReport| !is_stopped(report) && !report.measures.is_within_bound();
    assert!(swinging.iter().filter(is_above).count() >= 6, "few of {} loops pass the bound", swinging.len());
    assert!(swinging.iter().all(|report| is_stopped(report) || !report.measures.is_within_bound()));
}
