//! `yieldwall config`: check, show, schema.

#[cfg(test)]
mod changes;
mod checked;
#[cfg(test)]
mod newcomer;

use serde_json::{Value, json};

pub(super) use self::checked::Checked;
use super::failure::{Exit, Failure};
use super::output::Output;
use yieldwall_config::{
    self as config, Coupling, Diagnostic, Document, Figure, Fixture, ImpedanceDevice, Report, Rig, Scene, Severity,
    Simulation, Source,
};
use yieldwall_drives::profiles::{DeviceProfile, Tried};

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    /// Check files; print what would run, loop margins, least virtual mass, bus load
    Check {
        /// Rigs, devices, scenes, figures, device profiles or simulations; `builtin:figures/fig11.yaml` is a copy in the program
        #[arg(required = true, value_name = "FILE")]
        files: Vec<String>,
    },
    /// Print the checked configuration in normal form
    Show {
        /// Rig, device, scene, figure, device profile or simulation; `builtin:figures/fig11.yaml` is a copy in the program
        #[arg(value_name = "FILE")]
        file: String,
    },
    /// Print the JSON Schema of all file types, for editors
    Schema,
}

pub(super) fn run(command: Command, output: &mut Output) -> Result<(), Failure> {
    match command {
        Command::Check { files } => check(&files, output),
        Command::Show { file } => show(&file, output),
        Command::Schema => output.json(&config::schema()),
    }
}

/// Checks every file, also after one that is refused.
fn check(files: &[String], output: &mut Output) -> Result<(), Failure> {
    let mut entries: Vec<Value> = Vec::new();
    let mut refused: Vec<Diagnostic> = Vec::new();
    for file in files {
        let mut checked = Checked::of(Source::named(file));
        checked.rehearse();
        let is_refused = |finding: &Diagnostic| finding.severity == Severity::Error || output.denies_warnings();
        let is_ok = !checked.findings.iter().any(is_refused);
        entries.push(checked.to_json(file, is_ok));
        match &checked.result {
            Ok(document) if is_ok => {
                output.warnings(&checked.findings);
                let word = if checked.findings.is_empty() { "ok  " } else { "warn" };
                output.news(&format!("{word} {file}: {}", summary(document, checked.findings.len())))?;
                checked.lines().try_for_each(|line| output.news(&format!("    {line}")))?;
            }
            _ => refused.extend(checked.findings),
        }
    }
    if output.is_json() {
        let end = if refused.is_empty() { Ok(()) } else { Err(Report { diagnostics: refused }.into()) };
        return output.end(json!({ "files": entries }), end);
    }
    if refused.is_empty() { Ok(()) } else { Err(Report { diagnostics: refused }.into()) }
}

fn show(file: &str, output: &mut Output) -> Result<(), Failure> {
    let document = portable(config::load(Source::named(file))?);
    output.configuration(document.warnings())?;
    if output.is_json() {
        return match &document {
            Document::Rig(rig) => output.json(&rig.value),
            Document::Device(device) => output.json(&device.value),
            Document::Scene(scene) => output.json(&scene.value),
            Document::Figure(figure) => output.json(&figure.value),
            Document::Profile(profile) => output.json(&profile.value),
            Document::Simulation(simulation) => output.json(&simulation.value),
            Document::ErrorCodes(codes) => output.json(&codes.value),
        };
    }
    output.verbatim(&normal_form(&document).map_err(|error| Failure::new(Exit::Internal, error, ""))?)
}

fn normal_form(document: &Document) -> Result<String, String> {
    match document {
        Document::Rig(rig) => config::to_yaml(&rig.value),
        Document::Device(device) => config::to_yaml(&device.value),
        Document::Scene(scene) => config::to_yaml(&scene.value),
        Document::Figure(figure) => config::to_yaml(&figure.value),
        Document::Profile(profile) => config::to_yaml(&profile.value),
        Document::Simulation(simulation) => config::to_yaml(&simulation.value),
        Document::ErrorCodes(codes) => config::to_yaml(&codes.value),
    }
}

/// Returns a shipped document that names the files it uses by their names inside the program, so that a copy may be kept anywhere.
fn portable(mut document: Document) -> Document {
    let whole = |source: &Source, path: &mut String| {
        if source.is_shipped() {
            *path = source.relative(path).to_string();
        }
    };
    match &mut document {
        Document::Rig(rig) => {
            rig.value.simulation.iter_mut().for_each(|simulation| whole(&rig.source, &mut simulation.scene));
            if rig.source.is_shipped() {
                rig.value.rename_profile_files(|path| rig.source.relative(path).to_string());
            }
        }
        Document::Device(device) => whole(&device.source, &mut device.value.scene),
        Document::Simulation(simulation) => {
            whole(&simulation.source, &mut simulation.value.scene);
            if simulation.source.is_shipped() {
                simulation.value.rename_profile_files(|path| simulation.source.relative(path).to_string());
            }
        }
        Document::Figure(figure) => {
            let Figure { rigs, device, scene, .. } = &mut figure.value;
            let machines = rigs.values_mut().chain(device);
            machines.chain([scene]).for_each(|path| whole(&figure.source, path));
        }
        Document::Scene(_) | Document::Profile(_) | Document::ErrorCodes(_) => {}
    }
    document
}

/// Summarizes a checked document on one line.
fn summary(document: &Document, warnings: usize) -> String {
    let text = match document {
        Document::Rig(rig) => {
            let like = rig.like.as_ref().map(|like| format!("like {like}, ")).unwrap_or_default();
            format!("{like}{}", rig_summary(&rig.value))
        }
        Document::Device(device) => device_summary(&device.value),
        Document::Scene(scene) => scene_summary(&scene.value),
        Document::Figure(figure) => figure_summary(&figure.value),
        Document::Profile(profile) => profile_summary(&profile.value),
        Document::Simulation(simulation) => simulation_summary(&simulation.value),
        Document::ErrorCodes(codes) => {
            format!("{}: {} codes", codes.value.error_codes.name, codes.value.codes.len())
        }
    };
    match warnings {
        0 => format!("{}, {text}", document.kind()),
        1 => format!("{}, {text}; 1 warning", document.kind()),
        number => format!("{}, {text}; {number} warnings", document.kind()),
    }
}

fn rig_summary(rig: &Rig) -> String {
    let mode = match rig.rig.command_mode {
        config::CommandMode::Torque => "torque",
        config::CommandMode::Velocity => "velocity",
        config::CommandMode::Position => "position",
    };
    let scene = match &rig.simulation {
        Some(simulation) => format!("scene {}", simulation.scene),
        None => "no simulation".to_owned(),
    };
    format!(
        "{} in {mode} mode every {} us, {}, {scene}",
        rig.rig.name,
        rig.cycle.period_us,
        fixture_summary(&rig.fixture),
    )
}

fn device_summary(device: &ImpedanceDevice) -> String {
    format!(
        "{} every {} us, {}, scene {}",
        device.device.name,
        device.cycle.period_us,
        fixture_summary(&device.fixture),
        device.scene
    )
}

fn simulation_summary(simulation: &Simulation) -> String {
    let timing = match simulation.timing {
        config::BusTiming::Arbitrated => "frames take their time",
        config::BusTiming::Ideal => "frames take no time",
    };
    format!(
        "{timing}, drives close their loop every {} us, scene {}",
        simulation.drive_position_loop.period_us, simulation.scene
    )
}

fn scene_summary(scene: &Scene) -> String {
    let place = if scene.hand.start_m.len() == 2 { "in the plane" } else { "in space" };
    format!("{} s {place}, seed {}", *scene.duration_s, scene.seed)
}

fn figure_summary(figure: &Figure) -> String {
    let machines: Vec<&str> = figure.rigs.values().chain(&figure.device).map(String::as_str).collect();
    let runs = machines.len() * figure.hold_steps.len();
    let holds: Vec<String> = figure.hold_steps.iter().map(u32::to_string).collect();
    let plural = if runs == 1 { "" } else { "s" };
    format!(
        "\"{}\": {runs} run{plural} of {}, hold {} steps",
        figure.title,
        machines.join(" and "),
        holds.join(" and ")
    )
}

fn profile_summary(profile: &DeviceProfile) -> String {
    let about = &profile.profile;
    let used = match profile.servo() {
        Some(servo) => {
            let modes = servo.process_data.modes().into_iter().filter(|mode| mode.3.is_some()).map(|mode| mode.1);
            format!("servo drive with {}", modes.collect::<Vec<_>>().join(", "))
        }
        None => "force sensor".to_owned(),
    };
    let tried = match about.tried {
        Tried::Never => "never tried on the device",
        Tried::Simulation => "tried on the simulated device",
        Tried::Bench => "tried on the device",
    };
    format!("{}: {used}, vendor {:08X}h, {tried}", about.name, profile.identity.vendor_id)
}

fn fixture_summary(fixture: &Fixture) -> String {
    let coupling = match fixture.coupling {
        Coupling::Admittance { mass_kg } => format!("M = {} kg", *mass_kg),
        Coupling::Impedance { stiffness_n_per_m, damping_n_s_per_m } => {
            format!("K = {} N/m, B = {} N s/m", *stiffness_n_per_m, *damping_n_s_per_m)
        }
    };
    let side = match fixture.side {
        config::Side::Bilateral => "bilateral",
        config::Side::Unilateral => "unilateral",
    };
    let surface = fixture.surface.summary();
    format!("{side} {surface}, F = {} N, R = {} N, {coupling}", *fixture.friction_n, *fixture.yield_n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_config::builtin_names;

    #[test]
    fn what_is_shown_of_a_shipped_file_can_be_kept_in_another_folder() {
        let profiles = ["profiles/simulated-servo.yaml", "profiles/maxon-epos4.yaml", "codes/maxon-epos4.yaml"];
        for name in builtin_names().chain(profiles) {
            let shipped = config::load(Source::named(&format!("builtin:{name}"))).unwrap();
            let kept = normal_form(&portable(shipped)).unwrap();
            let copy = Source::among("elsewhere/copy.yaml", [("elsewhere/copy.yaml".into(), kept.into())]);
            config::load(copy).unwrap_or_else(|report| panic!("{name}: {report}"));
        }
    }
}
