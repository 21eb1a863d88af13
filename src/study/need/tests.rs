//! The proposal against brute force, and the lines that make it.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::SeedableRng;
use serde_json::Value;

use super::model::{Model, models};
use super::models::{ALIKE, ROUNDS, measure};
use super::subject::{Lines, Subject};
use super::terms::case;
use crate::drawn::{not_negative, positive};
use crate::machine::{Machine, to_the_end};
use yieldwall_config::{self as config, BusTiming, EncoderModel, ForceSensorModel, Positive, Source, Tracking};
use yieldwall_motion::elementary;
use yieldwall_rig::report::measures::Measures;
use yieldwall_rig::report::{Overrides, RunReport, Watch, run_device, run_rig};
use yieldwall_sim::share_of_one;

const SEEDS: u64 = 10;
/// Time that no run of the plainest model is below in s.
const LEAST_S: f64 = 2.0;
/// Time that everything takes in each round, over that of the others: the computer has slow spells.
const SPELLS: [f64; ROUNDS as usize] = [1.0, 7.0, 0.4, 2.0, 0.9];

struct Dice(SplitMix64);

impl Dice {
    fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * share_of_one(&mut self.0)
    }

    fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[(share_of_one(&mut self.0) * choices.len() as f64) as usize]
    }
}

/// A machine and a scene of two seconds from a seed: the kind in turn, everything else by chance.
fn drawn(seed: u64) -> Subject {
    let dice = &mut Dice(SplitMix64::seed_from_u64(seed));
    let (machine, scene) = [
        ("paper-admittance", "circle-tour"),
        ("paper-admittance-csp", "circle-tour"),
        ("paper-admittance", "circle-tour-elastic"),
        ("play", "push-and-let-go"),
        ("paper-impedance", "cylinder-tour"),
    ][seed as usize % 5];
    let mut subject = Subject::shipped(&case(machine, scene, None)).unwrap();
    let (scene, tolerance) = (&mut subject.scene, &mut subject.tolerance);
    (scene.seed, scene.duration_s) = (seed, positive(dice.between(1.5, 2.5)));
    scene.hand.stiffness_n_per_m = positive(dice.between(200.0, 800.0));
    scene.hand.mass_kg = not_negative(dice.between(0.2, 1.0));
    let factor = elementary::powf(10.0, dice.between(-1.5, 1.0));
    let scaled = |value: Positive| positive(factor * value.get());
    tolerance.distance_mm = scaled(tolerance.distance_mm);
    tolerance.force_n = scaled(tolerance.force_n);
    tolerance.torque_n_m = scaled(tolerance.torque_n_m);
    tolerance.energy_mj = scaled(tolerance.energy_mj);
    let step_us = dice.one_of(&[1000, 500, 200, 100, 50]);
    let (model, device_model) = (&mut scene.model, &mut scene.device_model);
    device_model.iter_mut().for_each(|model| model.plant_step_us = step_us);
    if let Some(model) = model {
        model.plant_step_us = step_us;
        model.encoder = dice.one_of(&[EncoderModel::Exact, EncoderModel::Quantised]);
        model.force_noise_counts = not_negative(dice.one_of(&[0.0, 1.0, 4.0, 8.0]));
    }
    if let Machine::Rig(rig) = &mut subject.machine {
        rig.fixture.yield_n = positive(dice.between(10.0, 30.0));
        rig.fixture.friction_n = not_negative(dice.between(0.0, 3.0));
        rig.drives.iter_mut().for_each(|drive| drive.encoder_counts_per_rev = dice.one_of(&[8_000, 80_000, 800_000]));
        rig.simulation.iter_mut().for_each(|simulation| {
            simulation.arm.tool_kg = not_negative(dice.between(0.5, 1.5));
        });
    }
    subject.models = models(&subject.machine, &subject.scene, false);
    subject
}

/// Time of a model in s: a share for each choice in it, so that each choice costs something and some cost next to nothing.
fn costs(seed: u64, models: &[Model]) -> Vec<f64> {
    let mut dice = Dice(SplitMix64::seed_from_u64(seed ^ 0xc057));
    let mut shares: BTreeMap<String, f64> = BTreeMap::new();
    let mut share = |(place, cell): (usize, Value)| {
        *shares.entry(format!("{place} {cell}")).or_insert_with(|| dice.one_of(&[0.0, 0.004, 0.1, 0.4]))
    };
    let cost = |model: &Model| LEAST_S * (1.0 + model.cells().into_iter().enumerate().map(&mut share).sum::<f64>());
    models.iter().map(cost).collect()
}

/// A run with the choices of a model, set by their words, and the hand of a round.
fn run(subject: &Subject, model: &Model, round: u64) -> Option<RunReport> {
    let [body, step, timing, encoder, force] = model.cells();
    let (step_us, mut scene) = (step.as_u64().unwrap() as u32, subject.scene.clone());
    scene.seed += round;
    match &subject.machine {
        Machine::Rig(rig) => {
            let mut rig = rig.clone();
            let model = scene.model.as_mut().unwrap();
            rig.simulation.as_mut().unwrap().timing = match timing.as_str().unwrap() {
                "ideal" => BusTiming::Ideal,
                _ => BusTiming::Arbitrated,
            };
            model.tracking = if body == "ideal" { Tracking::Ideal } else { Tracking::Rigid };
            model.joint_elasticity = model.joint_elasticity.filter(|_| body == "elastic");
            model.plant_step_us = step_us;
            model.encoder = if encoder == "exact" { EncoderModel::Exact } else { EncoderModel::Quantised };
            model.force_sensor = if force == "noisy" { ForceSensorModel::Noisy } else { ForceSensorModel::Quantised };
            run_rig(&rig, &scene, &Overrides::default(), Watch::default(), to_the_end(|_| {})).ok()
        }
        Machine::Device(device) => {
            scene.device_model.as_mut().unwrap().plant_step_us = step_us;
            run_device(device, &scene, &Overrides::default(), |_| {}, to_the_end(|_| {})).ok()
        }
    }
}

/// Whether the outputs of a run are within the tolerance of those of the dearest model, one after the other.
fn is_within(subject: &Subject, dearest: &RunReport, run: &RunReport) -> bool {
    let t = &subject.tolerance;
    let near = |of: fn(&Measures) -> Option<f64>, tolerance: f64| match (of(&dearest.measures), of(&run.measures)) {
        (Some(was), Some(is)) => (is - was).abs() <= tolerance,
        (was, is) => was == is,
    };
    let depth = |m: &Measures| m.impacts.iter().map(|impact| impact.tool_depth_mm).reduce(f64::max);
    dearest.is_stopped() == run.is_stopped()
        && dearest.cause.map(|cause| cause.fault) == run.cause.map(|cause| cause.fault)
        && dearest.measures.unintended_releases == run.measures.unintended_releases
        && near(|m| Some(m.penetration_mm), *t.distance_mm)
        && near(depth, *t.distance_mm)
        && near(|m| m.tool_rms_on_surface_mm, *t.distance_mm)
        && near(|m| m.tool_max_on_surface_mm, *t.distance_mm)
        && near(|m| m.peak_force_on_surface_n, *t.force_n)
        && near(|m| m.peak_torque_n_m, *t.torque_n_m)
        && near(|m| Some(1e3 * m.energy_given_j), *t.energy_mj)
}

/// `NEED_SEED` in the environment replays one seed.
#[test]
fn no_model_of_the_list_that_stays_within_the_tolerance_is_cheaper_than_the_proposal() {
    let one = std::env::var("NEED_SEED").ok().and_then(|seed| seed.parse().ok());
    let (mut proposals, mut refused) = (Vec::new(), 0);
    for seed in one.map_or(0..SEEDS, |seed| seed..seed + 1) {
        let replay = format!("replay: NEED_SEED={seed} cargo test --package yieldwall-study need::tests");
        let subject = drawn(seed);
        let costs = costs(seed, &subject.models);
        // Calls come in pairs: before and after a run, model after model.
        let ticks = Mutex::new((0, 0.0));
        let clock = || {
            let mut ticks = ticks.lock().unwrap();
            let (place, round) = (ticks.0 / 2 % costs.len(), ticks.0 / 2 / costs.len());
            ticks.1 += if ticks.0 % 2 == 1 { SPELLS[round] * costs[place] } else { 0.0 };
            ticks.0 += 1;
            Duration::from_secs_f64(ticks.1)
        };
        let found = measure(&subject, &clock);
        let needed: Vec<usize> = (0..found.len()).filter(|&place| found[place].is_needed).collect();
        let [needed] = needed[..] else { panic!("{} proposals; {replay}", needed.len()) };
        let most = subject.models.iter().map(|model| model.terms).max().unwrap();
        let dearest: Vec<_> = (0..found.len()).filter(|&place| subject.models[place].terms == most).collect();
        let [dearest] = dearest[..] else { panic!("two models have all terms; {replay}") };
        let mut within = vec![true; found.len()];
        let mut runs = Vec::new();
        for round in 0..ROUNDS {
            runs = subject.models.iter().map(|model| run(&subject, model, round)).collect();
            let dearest = runs[dearest].as_ref().unwrap();
            let is = |run: &Option<RunReport>| run.as_ref().is_some_and(|run| is_within(&subject, dearest, run));
            within.iter_mut().zip(&runs).for_each(|(within, run)| *within &= is(run));
        }
        // A model is enough only if those with more terms are within the tolerance too.
        let rank = |model: &Model| {
            let [body, _, timing, encoder, force] = model.cells();
            let body = ["ideal", "rigid", "elastic"].iter().position(|name| body == *name);
            [
                body.unwrap_or(0),
                usize::from(timing == "arbitrated"),
                usize::from(encoder == "quantised"),
                usize::from(force == "noisy"),
            ]
        };
        let has_more = |more: &Model, less: &Model| {
            more.step_us <= less.step_us && rank(more).iter().zip(rank(less)).all(|(more, less)| *more >= less)
        };
        let within: Vec<bool> = subject
            .models
            .iter()
            .map(|less| (0..within.len()).all(|more| within[more] || !has_more(&subject.models[more], less)))
            .collect();
        assert!(within[needed], "the proposal moves an output by more than its tolerance; {replay}");
        let name = subject.models[needed].name();
        let of_run = |place: usize| runs[place].as_ref().map_or(f64::INFINITY, |run| costs[place] / run.simulated_s());
        for place in (0..runs.len()).filter(|&place| within[place]) {
            let other = subject.models[place].name();
            let cheaper = of_run(place) < (1.0 - ALIKE) * of_run(needed);
            assert!(!cheaper, "{other} is cheaper than {name} and within the tolerance; {replay}");
            let is_plainer = subject.models[place].terms < subject.models[needed].terms;
            assert!(!(is_plainer && of_run(place) <= of_run(needed)), "{other} is plainer than {name}; {replay}");
        }
        refused += within.iter().filter(|is| !**is).count();
        proposals.push(name);
    }
    if one.is_none() {
        proposals.dedup();
        assert!(proposals.len() > 3 && refused > 20, "the seeds are all alike: {proposals:?}, {refused}");
    }
}

/// The files of a shipped rig by name, in memory.
fn files(rig: &str) -> BTreeMap<PathBuf, Arc<str>> {
    let loaded = config::load_rig(config::builtin(rig)).unwrap();
    let scene = loaded.scene().unwrap();
    let all = loaded.files().chain(scene.files());
    all.map(|(name, text)| (name.trim_start_matches("builtin:").into(), text.into())).collect()
}

fn subject(rig: &str, files: &BTreeMap<PathBuf, Arc<str>>) -> Result<Subject, config::Report> {
    Subject::load(Source::among(rig, files.iter().map(|(name, text)| (name.clone(), text.clone()))))
}

/// Does with the files as the lines say.
fn paste(files: &mut BTreeMap<PathBuf, Arc<str>>, Lines { place, yaml }: &Lines) {
    let (place, what) = place.split_once(", in place of ").unwrap();
    let (file, line) = place.split_once(".yaml:").map_or((place.to_owned(), None), |(file, line)| {
        (format!("{file}.yaml"), Some(line.parse::<usize>().unwrap()))
    });
    let text = files.get_mut(&PathBuf::from(&file)).unwrap_or_else(|| panic!("no file {file}"));
    let lines: Vec<&str> = text.lines().collect();
    let first = line.unwrap_or_else(|| {
        let place = lines.iter().position(|line| line.starts_with(&what.replace('`', "")));
        place.unwrap_or_else(|| panic!("{what}")) + 1
    });
    let is_of_another = |line: &&str| !line.starts_with([' ', '#']) && !line.is_empty();
    let rest = lines[first..].iter().position(is_of_another).map_or(lines.len(), |more| first + more);
    *text = [lines[..first - 1].join("\n").as_str(), yaml.trim_end(), &lines[rest..].join("\n")].join("\n").into();
}

#[test]
fn the_lines_pasted_into_the_files_make_the_model() {
    for rig in ["paper-admittance-csp.yaml", "paper-admittance.yaml"] {
        let shipped = files(rig);
        let asked = subject(rig, &shipped).unwrap();
        for place in [0, asked.models.len() / 2, asked.models.len() - 1] {
            let model = asked.models[place];
            let (lines, mut files) = (asked.lines(&model), shipped.clone());
            lines.iter().for_each(|lines| paste(&mut files, lines));
            let pasted = subject(rig, &files).unwrap_or_else(|report| panic!("{lines:?}: {report}"));
            assert_eq!(pasted.scene, asked.with(&model).1, "{lines:?}");
            assert!(pasted.lines(&model).is_empty(), "{lines:?}");
            assert_eq!(lines.is_empty(), place + 1 == asked.models.len(), "the shipped files have all terms");
            if place == 0 {
                let (machine, scene) = (&pasted.machine, &pasted.scene);
                let run = machine.run(scene, &pasted.overrides, |_| {});
                assert_eq!(super::outputs::Outcome::of(&run), asked.run(&model, 0));
            }
        }
    }
}

#[test]
fn a_scene_without_a_tolerance_is_refused_with_one_to_write() {
    let mut files = files("paper-admittance.yaml");
    let scene = PathBuf::from("scenes/circle-tour.yaml");
    let text = files[&scene].to_string();
    let (before, rest) = text.split_once("tolerance: ").unwrap();
    let (_, after) = rest.split_once("\nhand:").unwrap();
    files.insert(scene, format!("{before}hand:{after}").into());
    let report = subject("paper-admittance.yaml", &files).unwrap_err();
    let finding = &report.diagnostics[0];
    assert_eq!(finding.file, "scenes/circle-tour.yaml");
    assert!(finding.help.as_ref().unwrap().contains("tolerance: {distance_mm: 0.05"), "{finding:?}");
}

#[test]
fn an_arbitrated_bus_is_no_choice_where_it_cannot_carry_the_frames() {
    let mut files = files("paper-admittance.yaml");
    let fast = "like: paper-admittance.yaml\nrig: {name: fast}\ncycle: {period_us: 500, compute_at_us: 300}\n\
                simulation: {timing: ideal, scene: scenes/short.yaml}\n";
    let short = files[&PathBuf::from("scenes/circle-tour.yaml")].replace("duration_s: 27.2", "duration_s: 0.2");
    files.insert("fast.yaml".into(), fast.into());
    files.insert("scenes/short.yaml".into(), short.into());
    let subject = subject("fast.yaml", &files).unwrap();
    assert!(subject.models.iter().all(|model| model.cells()[2] == "ideal"), "{:?}", subject.models);
    assert_eq!(subject.models.len(), 4, "steps of 500 and 100 us, noise; in torque mode the bus has counts anyway");
}
