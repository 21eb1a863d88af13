//! MuJoCo model of the scene as MJCF, and an external program that runs it.

use nalgebra::Vector2;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};
use yieldwall_motion::elementary;

use super::scene::Scene;

/// How MuJoCo is set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Name of the integrator in MJCF.
    pub integrator: &'static str,
    /// How its constraints, soft by nature, are set.
    pub softness: Softness,
}

/// How soft the constraint that closes the loop and those of dry friction are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Softness {
    /// As MuJoCo has it: the constraints give way with a time constant of 20 ms.
    Default,
    /// As hard as MuJoCo lets them be: time constant of two steps (the least that it accepts), impedance 0.9999 (likewise).
    /// Nothing else about the model is left to choose that makes it faster without making it worse: contacts and
    /// the division into islands are off.
    Tuned,
    /// Harder: the check of the time constant off and one step, and a second pass over dry friction that takes its softness
    /// out (`noslip_iterations`).
    Hardest,
}

impl Settings {
    /// Name of this setting.
    pub fn name(&self) -> String {
        let softness = match self.softness {
            Softness::Default => "default",
            Softness::Tuned => "tuned",
            Softness::Hardest => "tuned, no refsafe, noslip",
        };
        format!("{}, {softness}", self.integrator)
    }
}

/// Result of a scene in MuJoCo.
#[derive(Clone, Debug, PartialEq)]
pub struct MujocoRun {
    /// Version of the library.
    pub version: String,
    /// Time that its thread had a core, for one repeat, in s.
    pub on_core_s: f64,
    /// Tool point at the end of each cycle in m.
    pub tips: Vec<Vector2<f64>>,
    /// The farthest that the ends of the two chains were apart, in m.
    pub loop_gap_m: f64,
}

/// How often a scene is run, and what before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Cycles before, from the same start.
    pub warm: usize,
    /// Repeats of the timed stretch.
    pub repeats: usize,
}

/// Runs a scene in steps of `step_s` by the program.
///
/// # Errors
/// What the program said, or that it cannot be started or understood, in words.
pub fn run(
    program: &Path,
    settings: Settings,
    scene: &Scene,
    step_s: f64,
    effort: Effort,
) -> Result<MujocoRun, String> {
    let said = |error: &dyn std::fmt::Display| format!("{}: {error}", program.display());
    let mut child = Command::new(program)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|error| said(&error))?;
    // It reads all before it writes, so neither waits for the other.
    let given =
        child.stdin.take().map(|mut input| input.write_all(request(settings, scene, step_s, effort).as_bytes()));
    let output = child.wait_with_output().map_err(|error| said(&error))?;
    if !output.status.success() {
        return Err(said(&String::from_utf8_lossy(&output.stderr).trim()));
    }
    given.transpose().map_err(|error| said(&error))?;
    read(&String::from_utf8_lossy(&output.stdout), scene.cycles).ok_or_else(|| said(&"cannot be understood"))
}

/// Joint angles of both chains at the start: driven, passive, driven, passive.
fn start(scene: &Scene) -> [f64; 4] {
    let arm = &scene.arm;
    let driven = scene.start();
    let tip = arm.motion(driven, Vector2::zeros()).tip;
    let passive = |angle: f64, base_m: f64| {
        let elbow =
            Vector2::new(base_m, 0.0) + Vector2::new(elementary::cos(angle), elementary::sin(angle)) * arm.proximal_m;
        let distal = tip - elbow;
        elementary::atan2(distal.y, distal.x) - angle
    };
    [driven.x, passive(driven.x, -arm.half_base_m), driven.y, passive(driven.y, arm.half_base_m)]
}

/// The arm as MJCF: two chains, the tool's mass at the end of the first, their ends joined by an equality constraint.
fn mjcf(settings: Settings, scene: &Scene, step_s: f64) -> String {
    let arm = &scene.arm;
    let (hard, of_friction, flags, iterations) = match settings.softness {
        Softness::Default => (String::new(), String::new(), "", 0),
        Softness::Tuned => constants(2.0 * step_s, " island=\"disable\"", 0),
        Softness::Hardest => constants(step_s, " island=\"disable\" refsafe=\"disable\"", 10),
    };
    let mut text = format!(
        "<mujoco>\n<compiler angle=\"radian\"/>\n\
         <option timestep=\"{step_s}\" integrator=\"{}\" noslip_iterations=\"{iterations}\">\
         <flag contact=\"disable\" gravity=\"disable\"{flags}/></option>\n<worldbody>\n",
        settings.integrator
    );
    for (chain, base_m, tool_kg) in [("a", -arm.half_base_m, arm.tool_kg), ("b", arm.half_base_m, 0.0)] {
        let rod = |kg: f64, length_m: f64| kg * length_m * length_m / 12.0;
        let proximal = body(arm.proximal_kg, 0.5 * arm.proximal_m, rod(arm.proximal_kg, arm.proximal_m));
        // A rod with the tool at its end.
        let (kg, middle_m) = (arm.distal_kg + tool_kg, 0.5 * arm.distal_m);
        let center_m = (arm.distal_kg * middle_m + tool_kg * arm.distal_m) / kg;
        let about_center = rod(arm.distal_kg, arm.distal_m)
            + arm.distal_kg * elementary::powi(center_m - middle_m, 2)
            + tool_kg * elementary::powi(arm.distal_m - center_m, 2);
        let distal = body(kg, center_m, about_center);
        // Writing to a string does not fail.
        let _ = write!(
            text,
            "<body pos=\"{base_m} 0 0\">\n\
             <joint type=\"hinge\" axis=\"0 0 1\" armature=\"{}\" damping=\"{}\" frictionloss=\"{}\"{of_friction}/>\n\
             {proximal}<body pos=\"{} 0 0\">\n<joint type=\"hinge\" axis=\"0 0 1\"/>\n\
             {distal}<site name=\"{chain}\" pos=\"{} 0 0\"/>\n</body>\n</body>\n",
            arm.motor_kg_m2, arm.viscous_n_m_s_per_rad, arm.coulomb_n_m, arm.proximal_m, arm.distal_m
        );
    }
    let [a, b, c, d] = start(scene);
    let _ = write!(
        text,
        "</worldbody>\n<equality><connect site1=\"a\" site2=\"b\"{hard}/></equality>\n\
         <keyframe><key qpos=\"{a} {b} {c} {d}\"/></keyframe>\n</mujoco>\n"
    );
    text
}

/// Constraint parameters for a time constant, of equality and of friction, with flags and iterations.
fn constants(time_s: f64, flags: &'static str, iterations: u32) -> (String, String, &'static str, u32) {
    let of = |suffix: &str| format!(" solref{suffix}=\"{time_s} 1\" solimp{suffix}=\"0.9999 0.9999 0.001\"");
    (of(""), of("friction"), flags, iterations)
}

/// Mass of a body on its x axis. Nothing turns about another axis than z, so the inertia about all may be alike.
fn body(kg: f64, center_m: f64, about_z_kg_m2: f64) -> String {
    format!(
        "<inertial pos=\"{center_m} 0 0\" mass=\"{kg}\" diaginertia=\"{about_z_kg_m2} {about_z_kg_m2} {about_z_kg_m2}\"/>\n"
    )
}

/// Returns the input of the program, in the words of its head.
fn request(settings: Settings, scene: &Scene, step_s: f64, effort: Effort) -> String {
    let Scene { gains, torque_n_m: [left, right], hand, push_n: [x, y], way, cycles, .. } = scene;
    let [center_x, center_y] = way.center_m;
    let mut text = format!(
        "cycles {cycles}\nwarm {}\nrepeats {}\ngains {} {}\ntorque {left} {right}\nhand {} {}\npush {x} {y}\n\
         arc {center_x} {center_y} {}\ntremor {} {}\nswing {} {} {}\nplan {cycles}\n",
        effort.warm.min(*cycles),
        effort.repeats,
        gains.n_m_per_rad,
        gains.n_m_s_per_rad,
        hand.n_per_m,
        hand.n_s_per_m,
        way.radius_m + way.offset_m,
        way.tremor_m,
        way.tremor_hz,
        way.from_rad,
        way.swing_rad,
        way.swing_hz,
    );
    for aim in scene.plan() {
        let _ = writeln!(text, "{} {} {} {}", aim.angles.x, aim.angles.y, aim.rates.x, aim.rates.y);
    }
    let model = mjcf(settings, scene, step_s);
    let _ = write!(text, "model {}\n{model}", model.len());
    text
}

fn read(text: &str, cycles: usize) -> Option<MujocoRun> {
    let mut lines = text.lines();
    let version = lines.next()?.strip_prefix("version ")?.to_owned();
    let on_core_ns: f64 = lines.next()?.strip_prefix("on_core_ns ")?.parse().ok()?;
    let mut tips = Vec::with_capacity(cycles);
    let mut loop_gap_m = 0.0f64;
    for line in lines {
        let mut numbers = line.split(' ').map(str::parse::<f64>);
        let mut next = || numbers.next()?.ok();
        tips.push(Vector2::new(next()?, next()?));
        loop_gap_m = loop_gap_m.max(next()?);
    }
    (tips.len() == cycles).then_some(MujocoRun { version, on_core_s: on_core_ns * 1e-9, tips, loop_gap_m })
}
