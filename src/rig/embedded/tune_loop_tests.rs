//! Joints whose loops are identified on the embedded simulation.

use std::sync::atomic::AtomicBool;

use super::*;
use crate::analysis::{PROPOSED_MARGINS, has_margins, identified_margins, pose_margins, proposed_gains};
use crate::sample::share;
use crate::simulated_arm;
use yieldwall_config::injection::{Kind, Target};
use yieldwall_motion::guard::Fault;
use yieldwall_motion::identification::NotIdentified;
use yieldwall_motion::linkage::MassModel;
use yieldwall_motion::quantity::JointRates;
use yieldwall_run::assembly::{delay_cycles, linkage};
use yieldwall_run::{Ended, JointLoop, LOOP_BOUND_RAD, LoopPlan, LoopTraced};

pub(super) fn rig(text: &str) -> config::Loaded<config::Rig> {
    config::load_rig(config::Source::memory("rig.yaml", text.to_owned())).unwrap()
}

/// Returns the outcome of an identification with an injection, and with a check in every cycle.
fn traced(
    loaded: &config::Loaded<config::Rig>,
    joint: usize,
    injections: &[Injection],
    mut look: impl FnMut(&CycleRecord) + Send + 'static,
) -> (LoopTraced, [cia402::State; 2]) {
    let (rig, mut scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    // A period is a multiple of the steps in which the arm is integrated.
    let step_us = &mut scene.model.as_mut().unwrap().plant_step_us;
    *step_us = if rig.cycle.period_us.is_multiple_of(*step_us) { *step_us } else { 50 };
    let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
    machine.set_injections(injections).unwrap();
    machine.set_observer(Box::new(move |record| look(record)));
    let plan = LoopPlan { joint, torque_n_m: None };
    let traced = machine.tune_loop(&rig, &plan, &AtomicBool::new(false)).unwrap().unwrap();
    (traced, machine.drive_states())
}

/// Inertia that a joint of the simulated arm really feels at a pose, kg m^2.
fn planted_inertia(loaded: &config::Loaded<config::Rig>, found: &JointLoop) -> f64 {
    let scene = loaded.scene().unwrap().value;
    let arm = simulated_arm(&loaded.value, &scene).unwrap();
    let mass = MassModel { tool_kg: arm.mass.tool_kg + arm.handle_kg, ..arm.mass };
    let dynamics = linkage(&loaded.value).unwrap().dynamics(&mass, found.pose, JointRates::default()).unwrap();
    dynamics.mass[(found.joint, found.joint)]
}

pub(super) const AT_1_KHZ: &str = "like: builtin:paper-admittance.yaml\nrig: {name: usual}\n";
const AT_250_HZ: &str = "like: builtin:paper-admittance.yaml\nrig: {name: slow}\ncycle: {period_us: 4000, compute_at_us: 2400}\n\
    sensor: {sample_rate_hz: 200}\n\
    control: {gains: {joint: {stiffness_n_m_per_rad: 600.0, damping_n_m_s_per_rad: 24.0, integral_n_m_per_rad_s: 2000.0}}}\n";
/// The shipped rig on EtherCAT with another segment and another cycle.
pub(super) fn on_ethercat(name: &str, bus: &str, cycle: &str) -> String {
    let shipped = config::builtin("paper-ethercat.yaml").read().unwrap();
    let text = shipped.replace("like: ", "like: builtin:").replace("name: paper-ethercat", &format!("name: {name}"));
    format!("{}\ncycle: {cycle}\n", text.replace("ethercat: {}", &format!("ethercat: {bus}")))
}

pub(super) fn at_4_khz() -> config::Loaded<config::Rig> {
    let mut loaded = rig(&on_ethercat("fast", "{}", "{period_us: 1000, compute_at_us: 480}"));
    (loaded.value.cycle.period_us, loaded.value.cycle.compute_at_us) = (250, 120);
    loaded
}

/// The rigs on which all has to be identified.
fn rigs() -> [config::Loaded<config::Rig>; 4] {
    let on_arrival = on_ethercat("arrival", "{outputs: on_arrival}", "{period_us: 1000, compute_at_us: 100}");
    [rig(AT_1_KHZ), rig(AT_250_HZ), at_4_khz(), rig(&on_arrival)]
}

#[test]
fn what_was_planted_is_identified_at_each_cycle_time_and_on_each_bus() {
    for loaded in share(rigs(), 2) {
        let text = &loaded.value.rig.name;
        for joint in [0, 1] {
            let (end, states) = traced(&loaded, joint, &[], |_| ());
            assert_eq!((end.ended, end.cause), (Ended::Whole, None), "{text} {joint}: {:?}", end.state);
            assert!(!states.contains(&cia402::State::OperationEnabled), "{states:?}");
            let found =
                end.found.unwrap_or_else(|| panic!("{text} {joint}: cut {} at {} N m", end.is_cut, end.torque_n_m));
            let arm = &loaded.value.simulation.as_ref().unwrap().arm;
            let inertia = planted_inertia(&loaded, &found);
            let planned_s = delay_cycles(&loaded.value).unwrap() * f64::from(loaded.value.cycle.period_us) * 1e-6;
            // Where outputs act on arrival the plan has 40 us for the computation, which takes none in virtual time.
            let delay_s = if loaded.value.rig.name == "arrival" { planned_s - 40e-6 } else { planned_s };
            let (friction, dynamics) = (found.friction.unwrap(), found.dynamics.unwrap());
            eprintln!(
                "{} {joint}: {} N m, J {:.2} % +- {:.2} % of {inertia:.4}, delay {:.1} us +- {:.1} us of {:.0}, Coulomb {:.2} % +- {:.2} %, viscous {:.3} +- {:.3} \
                 ({:.3} +- {:.3}), misfit {:.4}, lag {:?}, overshoot {:?} rise {:?}",
                loaded.value.rig.name,
                found.torque_n_m,
                100.0 * (dynamics.inertia_kg_m2.value / inertia - 1.0),
                100.0 * dynamics.inertia_kg_m2.half_width() / inertia,
                1e6 * (dynamics.delay_s.value - delay_s),
                1e6 * dynamics.delay_s.half_width(),
                1e6 * delay_s,
                100.0 * (friction.coulomb_n_m.value / arm.coulomb_n_m[joint].get() - 1.0),
                100.0 * friction.coulomb_n_m.half_width() / arm.coulomb_n_m[joint].get(),
                friction.viscous_n_m_s_per_rad.value,
                friction.viscous_n_m_s_per_rad.half_width(),
                dynamics.viscous_n_m_s_per_rad.value,
                dynamics.viscous_n_m_s_per_rad.half_width(),
                dynamics.misfit,
                found.lag_s,
                found.step.as_ref().map(|step| step.overshoot),
                found.step.as_ref().map(|step| step.rise_s),
            );
            let within = |value: f64, planted: f64| (value / planted - 1.0).abs() < 0.05;
            assert!(within(dynamics.inertia_kg_m2.value, inertia), "{text} {joint}: {dynamics:?}");
            assert!((dynamics.delay_s.value - delay_s).abs() < 50e-6, "{text} {joint}: {:?}", dynamics.delay_s);
            assert!(within(friction.coulomb_n_m.value, arm.coulomb_n_m[joint].get()), "{text} {joint}: {friction:?}");
            let viscous = arm.viscous_n_m_s_per_rad[joint].get();
            assert!(within(friction.viscous_n_m_s_per_rad.value, viscous), "{text} {joint}: {friction:?}");
        }
    }
}

/// Numbers by chance from a seed, between a least and a greatest one.
fn drawn_from(seed: u64) -> impl FnMut(f64, f64) -> f64 {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) + 77;
    let mut drawn = move |low: f64, high: f64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        low + (high - low) * (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    // Near seeds begin alike.
    for _ in 0..8 {
        drawn(0.0, 1.0);
    }
    drawn
}

/// Joints with other friction and other motors, on both buses: the delay is known, and so is how well.
#[test]
fn intervals_of_the_delay_hold_what_was_planted_nearly_as_often_as_they_say() {
    let mut off_us = Vec::new();
    let mut held = 0;
    let seeds = share(0..20_u64, 8);
    let count = seeds.len() as u32;
    for seed in seeds {
        let mut drawn = drawn_from(seed);
        let file = ["paper-admittance.yaml", "paper-ethercat.yaml"][(seed % 2) as usize];
        let loaded = config::load_rig(config::builtin(file)).unwrap();
        let (mut rig, mut scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
        let arm = &mut rig.simulation.as_mut().unwrap().arm;
        arm.coulomb_n_m = [config::NotNegative::new(drawn(1.0, 12.0)).unwrap(); 2];
        arm.viscous_n_m_s_per_rad = [config::NotNegative::new(drawn(0.1, 2.0)).unwrap(); 2];
        arm.motor_kg_m2 = [config::Positive::new(drawn(0.15, 0.6)).unwrap(); 2];
        scene.seed = seed + 1;
        let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
        let plan = LoopPlan { joint: (seed / 2 % 2) as usize, torque_n_m: None };
        let traced = machine.tune_loop(&rig, &plan, &AtomicBool::new(false)).unwrap().unwrap();
        let delay_s = traced.found.unwrap().dynamics.unwrap().delay_s;
        let planted_s = delay_cycles(&rig).unwrap() * f64::from(rig.cycle.period_us) * 1e-6;
        held += u32::from(delay_s.contains(planted_s));
        off_us.push(1e6 * (delay_s.value - planted_s));
    }
    assert!(off_us.iter().all(|off| off.abs() < 50.0), "{off_us:?}");
    assert!(held + count.div_ceil(10) >= count, "{held} of {count}: {off_us:?}");
}

/// A joint by chance. Modes, laws, buses and joints alternate.
fn drawn_joint(seed: u64) -> (config::Rig, config::Scene, usize) {
    let mut drawn = drawn_from(1000 + seed);
    let is_on_can = (seed / 4).is_multiple_of(2);
    let file = if is_on_can { "paper-admittance.yaml" } else { "paper-ethercat.yaml" };
    let loaded = config::load_rig(config::builtin(file)).unwrap();
    let (mut rig, mut scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    let periods_us: &[u32] = if is_on_can { &[1000, 2000, 4000] } else { &[250, 500, 1000, 2000, 4000] };
    let period_us = periods_us[drawn(0.0, periods_us.len() as f64) as usize];
    rig.cycle.period_us = period_us;
    rig.cycle.compute_at_us = if is_on_can { 620 * period_us / 1000 } else { 12 * period_us / 25 };
    if is_on_can {
        rig.sensor.sample_rate_hz = config::Positive::new([1000.0, 500.0, 200.0][period_us as usize / 2000]).unwrap();
    }
    if seed / 8 % 2 == 1 {
        rig.control.law = config::ControlLaw::Pid;
    }
    // Gains of the file are for 1 ms: with all times in cycles they stay the same.
    let slower = (f64::from(period_us) / 1000.0).max(1.0);
    match (seed % 4, &mut rig.control.gains) {
        (
            0 | 2,
            config::ControlGains::Joint { stiffness_n_m_per_rad, damping_n_m_s_per_rad, integral_n_m_per_rad_s },
        ) => {
            let [stiffness, damping] = [stiffness_n_m_per_rad.get(), damping_n_m_s_per_rad.get()];
            *stiffness_n_m_per_rad = config::Positive::new(stiffness / (slower * slower)).unwrap();
            *damping_n_m_s_per_rad = config::NotNegative::new(damping / slower).unwrap();
            let integral = integral_n_m_per_rad_s.get() / (slower * slower * slower);
            *integral_n_m_per_rad_s = config::NotNegative::new(integral).unwrap();
        }
        (1, gains) => {
            rig.rig.command_mode = config::CommandMode::Velocity;
            *gains = config::ControlGains::Rate { gain_per_s: config::Positive::new(60.0 / slower).unwrap() };
        }
        _ => rig.rig.command_mode = config::CommandMode::Position,
    }
    let arm = &mut rig.simulation.as_mut().unwrap().arm;
    let mut value = |low: f64, high: f64| config::NotNegative::new(drawn(low, high)).unwrap();
    arm.motor_kg_m2 = [value(0.12, 0.7), value(0.12, 0.7)].map(|motor| config::Positive::new(motor.get()).unwrap());
    (arm.proximal_kg, arm.distal_kg, arm.tool_kg) = ([value(0.0, 1.0); 2], [value(0.0, 0.5); 2], value(0.5, 2.0));
    (arm.coulomb_n_m, arm.viscous_n_m_s_per_rad) = ([value(0.5, 12.0); 2], [value(0.05, 3.0); 2]);
    (scene.hand.mass_kg, scene.seed) = (value(0.0, 1.0), seed + 1);
    let step_us = &mut scene.model.as_mut().unwrap().plant_step_us;
    *step_us = if period_us.is_multiple_of(*step_us) { *step_us } else { 50 };
    (rig, scene, (seed / 16 % 2) as usize)
}

/// Drives that close the loop report a torque of one moment in a cycle: its errors are those of a pattern, not of chance.
#[test]
fn intervals_of_friction_hold_what_was_planted_if_the_drive_closes_the_loop() {
    let seeds = share((0..60_u64).filter(|seed| seed % 2 == 1), 12);
    let most_missed = seeds.len().div_ceil(10);
    let mut missed: [Vec<String>; 2] = Default::default();
    for seed in seeds {
        let (rig, scene, joint) = drawn_joint(seed);
        let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
        let plan = LoopPlan { joint, torque_n_m: None };
        let traced = machine.tune_loop(&rig, &plan, &AtomicBool::new(false)).unwrap().unwrap();
        let Some(found) = traced.found else {
            // Its dry friction is more than the torque that is tried.
            assert!(traced.is_cut, "{seed}: {:?}", traced.cause);
            continue;
        };
        let friction = found.friction.unwrap();
        let arm = &rig.simulation.as_ref().unwrap().arm;
        let planted = [arm.coulomb_n_m, arm.viscous_n_m_s_per_rad].map(|both| both[joint].get());
        let found = [friction.coulomb_n_m, friction.viscous_n_m_s_per_rad];
        for ((missed, found), planted) in missed.iter_mut().zip(found).zip(planted) {
            if !found.contains(planted) {
                missed.push(format!("{seed}: {planted} {found:?}"));
            }
        }
    }
    assert!(missed.iter().all(|missed| missed.len() <= most_missed), "{missed:#?}");
}

#[test]
fn where_the_drive_closes_the_loop_its_told_torque_shows_friction_and_the_lag_is_seen() {
    for (mode, slowest, fastest) in [("csp", 1e-3, 4e-3), ("csv", -1e-3, 4e-3)] {
        let loaded = config::load_rig(config::builtin(format!("paper-admittance-{mode}.yaml"))).unwrap();
        for joint in [0, 1] {
            let (end, _) = traced(&loaded, joint, &[], |_| ());
            assert_eq!((end.ended, end.cause), (Ended::Whole, None), "{mode} {joint}: {:?}", end.state);
            let found = end.found.unwrap();
            let friction = found.friction.unwrap();
            eprintln!(
                "{mode} {joint}: {friction:?}, lag {:?} us {:?}",
                found.lag_s.map(|lag| 1e6 * lag),
                found.step.as_ref().map(|step| (step.overshoot, step.rise_s)),
            );
            assert!(found.is_told && found.dynamics == Err(NotIdentified::InDrive), "{:?}", found.dynamics);
            assert!((friction.coulomb_n_m.value / 10.0 - 1.0).abs() < 0.05, "{friction:?}");
            assert!(found.lag_s.is_some_and(|lag| lag > slowest && lag < fastest), "{mode}: {:?}", found.lag_s);
        }
    }
}

/// The rig with gains by what was identified of both joints.
fn tuned(loaded: &config::Loaded<config::Rig>) -> config::Loaded<config::Rig> {
    let found = [0, 1].map(|joint| traced(loaded, joint, &[], |_| ()).0.found.and_then(|found| found.found()).unwrap());
    let before = identified_margins(&loaded.value, &found).unwrap().unwrap();
    let gains = proposed_gains(&loaded.value, &before).unwrap().gains;
    let mut tuned = loaded.clone();
    let config::ControlGains::Joint { stiffness_n_m_per_rad, damping_n_m_s_per_rad, integral_n_m_per_rad_s } =
        &mut tuned.value.control.gains
    else {
        panic!("gains of joints");
    };
    *stiffness_n_m_per_rad = config::Positive::new(gains.stiffness).unwrap();
    *damping_n_m_s_per_rad = config::NotNegative::new(gains.damping).unwrap();
    *integral_n_m_per_rad_s = config::NotNegative::new(gains.integral).unwrap();
    tuned
}

#[test]
fn gains_by_what_was_identified_have_their_margins_on_the_simulated_arm_and_lead_it() {
    for (mut loaded, law) in share(rigs().into_iter().zip(["psmc", "pid", "psmc"]), 1) {
        let text = loaded.value.rig.name.clone();
        loaded.value.control.law = if law == "pid" { config::ControlLaw::Pid } else { config::ControlLaw::Psmc };
        let tuned = tuned(&loaded);
        // The simulated arm with the hand's mass on its tool, in place of the file's model of it.
        let mut real = tuned.value.clone();
        let tool_kg = real.simulation.as_ref().unwrap().arm.mass_model().tool_kg
            + loaded.scene().unwrap().value.hand.mass_kg.get();
        real.control.feed_forward.inertia.as_mut().unwrap().tool_kg = config::NotNegative::new(tool_kg).unwrap();
        let margins = pose_margins(&real).unwrap().unwrap();
        let worst = margins.worst.without_friction;
        eprintln!(
            "{}: {:?}: {:.2} dB, {:.2} dB down, {:.1} deg at {:.1} Hz",
            loaded.value.rig.name,
            tuned.value.control.gains,
            worst.gain_db,
            worst.gain_reduction_db,
            worst.phase_deg,
            worst.crossover_hz
        );
        assert!(has_margins(&worst, PROPOSED_MARGINS), "{text}: {worst:?}");
        // It is led with them too, and is still the same joint.
        let again = traced(&tuned, 0, &[], |_| ()).0;
        let found =
            again.found.unwrap_or_else(|| panic!("{text}: {:?} {:?} cut {}", again.ended, again.cause, again.is_cut));
        let inertia = planted_inertia(&tuned, &found);
        let dynamics = found.dynamics.unwrap();
        assert!((dynamics.inertia_kg_m2.value / inertia - 1.0).abs() < 0.05, "{text}: {dynamics:?}");
    }
}

#[test]
fn more_friction_and_a_heavier_tool_are_seen() {
    let text = "like: builtin:paper-admittance.yaml\nrig: {name: other}\n\
        simulation: {arm: {motor_kg_m2: [0.35, 0.15], proximal_kg: [0.2, 0.2], distal_kg: [0.3, 0.3], tool_kg: 1.6, coulomb_n_m: [5.0, 13.0], \
        viscous_n_m_s_per_rad: [2.0, 1.0]}, timing: arbitrated, drive_position_loop: {period_us: 125, stiffness_n_m_per_rad: 20000.0, \
        damping_n_m_s_per_rad: 150.0, integral_n_m_per_rad_s: 200000.0}, scene: builtin:scenes/circle-tour.yaml}\n\
        control: {feed_forward: {coulomb_n_m: [0.0, 0.0]}}\n";
    let loaded = rig(text);
    for (joint, coulomb, viscous) in [(0, 5.0, 2.0), (1, 13.0, 1.0)] {
        let (end, _) = traced(&loaded, joint, &[], |_| ());
        let found = end.found.unwrap_or_else(|| panic!("{joint}: {:?} {:?}", end.ended, end.cause));
        let inertia = planted_inertia(&loaded, &found);
        let (friction, dynamics) = (found.friction.unwrap(), found.dynamics.unwrap());
        eprintln!(
            "{joint}: J {:.2} % {dynamics:?} {friction:?}",
            100.0 * (dynamics.inertia_kg_m2.value / inertia - 1.0)
        );
        let within = |value: f64, planted: f64| (value / planted - 1.0).abs() < 0.05;
        assert!(within(dynamics.inertia_kg_m2.value, inertia), "{joint}: {:?}", dynamics.inertia_kg_m2);
        assert!(within(friction.coulomb_n_m.value, coulomb), "{joint}: {friction:?}");
        assert!(within(friction.viscous_n_m_s_per_rad.value, viscous), "{joint}: {friction:?}");
    }
}

#[test]
fn a_fault_at_either_drive_takes_the_torque_off_both_and_nothing_is_identified() {
    let loaded = rig(AT_1_KHZ);
    for target in [Target::LeftDrive, Target::RightDrive] {
        let broken = Injection::new(Kind::DriveFault, 3.0).on(target);
        let (end, states) = traced(&loaded, 0, &[broken], |_| ());
        assert_eq!((end.ended, end.found), (Ended::Stopped, None), "{target:?}");
        assert!(end.cause.is_some_and(|cause| cause.fault != Fault::FollowingError), "{:?}", end.cause);
        assert!(!states.iter().any(|state| state.has_torque()), "{states:?}");
    }
}

#[test]
fn no_joint_is_led_beyond_its_bound_or_with_more_torque_than_its_limit() {
    let seen = std::sync::Arc::new(std::sync::Mutex::new([0.0_f64; 2]));
    let kept = std::sync::Arc::clone(&seen);
    let mut from = None;
    let loaded = rig(AT_1_KHZ);
    let (end, _) = traced(&loaded, 1, &[], move |record| {
        if record.directive.state != State::Running {
            from = None;
            return;
        }
        let now = record.signals.target_angles;
        let way = (now - *from.get_or_insert(now)).to_array();
        let torques = match record.command {
            yieldwall_motion::guard::JointCommand::Torque(torques) => torques.to_array(),
            _ => [0.0; 2],
        };
        let mut seen = seen.lock().unwrap();
        way.iter().for_each(|way| seen[0] = seen[0].max(way.abs()));
        torques.iter().for_each(|torque| seen[1] = seen[1].max(torque.abs()));
    });
    let [way, torque] = *kept.lock().unwrap();
    assert!(way > 0.1 && way < LOOP_BOUND_RAD, "{way}");
    assert!(torque > 5.0 && torque <= end.torque_n_m + 1e-9, "{torque} of {}", end.torque_n_m);
}

/// By the truth of the tool. The first travel ends after 0.7 s; a joint just short of its target is near enough to be no following error.
#[test]
fn an_encoder_that_stands_still_at_any_moment_leads_no_joint_away() {
    let ends_travel = (0..12).map(|at| 0.7 + 0.012 * f64::from(at));
    let moments_s: Vec<f64> = ends_travel.chain((0..8).map(|at| 1.2 + 1.6 * f64::from(at))).collect();
    for file in ["paper-admittance.yaml", "paper-admittance-csp.yaml"] {
        let loaded = config::load_rig(config::builtin(file)).unwrap();
        let linkage = linkage(&loaded.value).unwrap();
        for (joint, target) in [Target::LeftDrive, Target::RightDrive].into_iter().enumerate() {
            for at_s in share(moments_s.iter().copied(), 5) {
                let stuck = Injection::new(Kind::EncoderStuck, at_s).on(target).lasting(Some(0.6));
                let farthest = std::sync::Arc::new(std::sync::Mutex::new(0.0_f64));
                let (seen, mut from) = (std::sync::Arc::clone(&farthest), None);
                traced(&loaded, joint, &[stuck], move |record| {
                    let Some(angles) = record.truth.and_then(|truth| linkage.inverse(truth.tool).ok()) else { return };
                    // From where it was last enabled: it is tried again with more torque.
                    let is_on = record.inputs.drives.iter().any(|drive| drive.state == cia402::State::OperationEnabled);
                    let (start, was_on) = from.unwrap_or((angles, false));
                    let start = if is_on && !was_on { angles } else { start };
                    from = Some((start, is_on));
                    let mut seen = seen.lock().unwrap();
                    *seen = seen.max((angles - start).max_abs());
                });
                let farthest = *farthest.lock().unwrap();
                assert!(farthest < LOOP_BOUND_RAD, "{} {target:?} at {at_s}: {farthest}", loaded.value.rig.name);
            }
        }
    }
}

#[test]
fn a_joint_that_runs_the_wrong_way_is_told_so_and_gets_no_more_torque() {
    use yieldwall_config::injection::{Defect, DefectKind};
    let loaded = rig(AT_1_KHZ);
    let (rig, mut scene) = (loaded.value.clone(), loaded.scene().unwrap().value);
    for joint in [0, 1] {
        for defective in [0, 1] {
            scene.defects = vec![Defect::new(DefectKind::EncoderPolarity).at(defective).into()];
            let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, scene.seed).unwrap();
            let plan = LoopPlan { joint, torque_n_m: None };
            let end = machine.tune_loop(&rig, &plan, &AtomicBool::new(false)).unwrap().unwrap();
            assert_eq!(end.ran_away, joint == defective, "{joint} {defective}: {:?}", end.cause);
            // One that is held in dry friction does not run away.
            let least = 0.25 * rig.drives[0].rated_torque_n_m.get();
            let is_stopped = end.ended == Ended::Stopped && end.torque_n_m == least;
            assert!(is_stopped || joint != defective, "{:?} {}", end.ended, end.torque_n_m);
            assert!(!machine.drive_states().contains(&cia402::State::OperationEnabled));
        }
    }
}
