//! Loading: from a source to a checked document.

use std::sync::Arc;

use garde::Validate;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::check::{
    Findings, Machine, check_device, check_drive_model, check_error_codes, check_figure, check_override, check_profile,
    check_rig, check_scene, check_scene_for, refuse_error_codes, refuse_profile, segment_key,
};
use super::compose::open;
use super::diagnostic::{Diagnostic, Report, Severity};
use super::explain::explain;
use super::kind::{Kind, LIKE};
use super::locator::Locator;
use super::reader;
use super::schema::Guide;
use super::source::Source;
use super::suggest::nearest;
use super::tree::{
    Figure, ImpedanceDevice, NamedProfile, NotSimulated, ProfileName, Rig, Scene, Simulation, is_yaml,
    shipped_error_codes,
};
use super::yaml;
use yieldwall_drives::codes::ErrorCodes;
use yieldwall_drives::profiles::DeviceProfile;

/// A checked document, its source, and warnings for its author.
#[derive(Clone, Debug)]
pub struct Loaded<T> {
    /// The document.
    pub value: T,
    /// Source of the document; relative paths in it start there.
    pub source: Source,
    /// Base file, if the document is a variant. The value contains everything of it.
    pub like: Option<Source>,
    /// Warnings, also about the files that it names: the document can be used, but a person should look at them.
    pub warnings: Vec<Diagnostic>,
    locator: Arc<Locator>,
}

impl<T> Loaded<T> {
    /// Returns a finding at a key of this document, such as `cycle.period_us`, by a check that needs more than the document. The
    /// finding also shows the other keys that explain it, each with its text.
    pub fn finding(
        &self,
        severity: Severity,
        at: &str,
        message: impl Into<String>,
        help: impl Into<String>,
        see: &[(&str, &str)],
    ) -> Diagnostic {
        let mut finding = self.locator.finding(severity, at, message.into(), help.into());
        see.iter().for_each(|(key, label)| self.locator.relate(&mut finding, key, label));
        finding
    }
}

impl<T> Loaded<T> {
    /// Returns the files that the document is composed from, each with its text; the first is the document's own.
    pub fn files(&self) -> impl Iterator<Item = (&str, &str)> {
        self.locator.files.iter().map(|file| (file.name.as_str(), &*file.text))
    }
}

impl Loaded<Rig> {
    /// Reads and checks the scene of the rig's simulation.
    ///
    /// # Errors
    /// As [`load_scene`]; or the rig has no simulation.
    pub fn scene(&self) -> Result<Loaded<Scene>, Report> {
        match self.value.simulated() {
            Ok(simulation) => load_scene(self.source.scene(&simulation.scene)),
            Err(error) => Err(self.not_simulated(error).into()),
        }
    }

    /// Returns the rig, for work that is only possible on CAN.
    ///
    /// # Errors
    /// If the rig is on EtherCAT.
    pub fn on_can(self) -> Result<Self, Report> {
        match segment_key(&self.value) {
            Some(key) => {
                let message = "this is for rigs on CAN, and the rig is on EtherCAT";
                let help = format!("`yieldwall run {}` runs it, with --bus INTERFACE on its segment", self.source);
                Err(self.finding(Severity::Error, &key, message, help, &[]).into())
            }
            None => Ok(self),
        }
    }

    fn not_simulated(&self, error: NotSimulated) -> Diagnostic {
        let help = "name one, such as `simulation: simulations/paper-arm.yaml`, or run the rig on a bus: `run --bus`";
        let file = self.source.document();
        Diagnostic::about_file(file.clone(), format!("{file}: {error}"), help)
    }
}

impl Loaded<ImpedanceDevice> {
    /// Reads and checks the scene of the device.
    ///
    /// # Errors
    /// As [`load_scene`].
    pub fn scene(&self) -> Result<Loaded<Scene>, Report> {
        load_scene(self.source.scene(&self.value.scene))
    }
}

/// A checked document of any kind.
#[derive(Clone, Debug)]
pub enum Document {
    /// An admittance rig.
    Rig(Box<Loaded<Rig>>),
    /// An impedance device.
    Device(Box<Loaded<ImpedanceDevice>>),
    /// A scene.
    Scene(Box<Loaded<Scene>>),
    /// A figure.
    Figure(Box<Loaded<Figure>>),
    /// A device profile.
    Profile(Box<Loaded<DeviceProfile>>),
    /// A simulation of a rig.
    Simulation(Box<Loaded<Simulation>>),
    /// A table of error codes.
    ErrorCodes(Box<Loaded<ErrorCodes>>),
}

impl Document {
    /// The kind of the document.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Rig(_) => Kind::Rig,
            Self::Device(_) => Kind::Device,
            Self::Scene(_) => Kind::Scene,
            Self::Figure(_) => Kind::Figure,
            Self::Profile(_) => Kind::Profile,
            Self::Simulation(_) => Kind::Simulation,
            Self::ErrorCodes(_) => Kind::ErrorCodes,
        }
    }

    /// Returns findings of its checks that do not prevent its use.
    pub fn warnings(&self) -> &[Diagnostic] {
        match self {
            Self::Rig(rig) => &rig.warnings,
            Self::Device(device) => &device.warnings,
            Self::Scene(scene) => &scene.warnings,
            Self::Figure(figure) => &figure.warnings,
            Self::Profile(profile) => &profile.warnings,
            Self::Simulation(simulation) => &simulation.warnings,
            Self::ErrorCodes(codes) => &codes.warnings,
        }
    }
}

/// Reads and checks a document, whatever its kind.
///
/// # Errors
/// As [`load_rig`]; or the document has the mark of no kind.
pub fn load(source: impl Into<Source>) -> Result<Document, Report> {
    load_from(source.into())
}

fn load_from(source: Source) -> Result<Document, Report> {
    let (locator, _) = open(&source)?;
    match Kind::detect(locator.outline.top_keys()) {
        Some(Kind::Rig) => load_rig(source).map(|rig| Document::Rig(Box::new(rig))),
        Some(Kind::Device) => load_device(source).map(|device| Document::Device(Box::new(device))),
        Some(Kind::Scene) => load_scene(source).map(|scene| Document::Scene(Box::new(scene))),
        Some(Kind::Figure) => load_figure(source).map(|figure| Document::Figure(Box::new(figure))),
        Some(Kind::Profile) => load_profile(source).map(|profile| Document::Profile(Box::new(profile))),
        Some(Kind::Simulation) => load_simulation(source).map(|simulation| Document::Simulation(Box::new(simulation))),
        Some(Kind::ErrorCodes) => load_error_codes(source).map(|codes| Document::ErrorCodes(Box::new(codes))),
        None => Err(unknown_kind(&source, "is not a configuration").into()),
    }
}

/// Reads and checks a rig, its device profiles, its simulation and its scene.
///
/// # Errors
/// The file; its first syntax or type error; or all errors of meaning in the rig and in the files that it names.
pub fn load_rig(source: impl Into<Source>) -> Result<Loaded<Rig>, Report> {
    load_rig_from(source.into())
}

fn load_rig_from(source: Source) -> Result<Loaded<Rig>, Report> {
    let Read { value: mut rig, mut findings, like } = read::<Rig>(&source, Kind::Rig)?;
    let in_range = findings.check_ranges(&rig);
    let profiles = linked_profiles(&mut findings, &source, rig.profiles_mut());
    check_rig(&mut findings, &rig, in_range);
    let machine = in_range.then_some(Machine::Rig(&rig));
    let scene = match &rig.simulation {
        Some(simulation) => linked_scene(&mut findings, "simulation.scene", &source, &simulation.scene, machine),
        None => Vec::new(),
    };
    finish(rig, source, like, findings.locator(), [findings.into_sorted(), profiles, scene].concat())
}

/// Reads and checks an impedance device and its scene.
///
/// # Errors
/// As [`load_rig`].
pub fn load_device(source: impl Into<Source>) -> Result<Loaded<ImpedanceDevice>, Report> {
    load_device_from(source.into())
}

fn load_device_from(source: Source) -> Result<Loaded<ImpedanceDevice>, Report> {
    let Read { value: device, mut findings, like } = read::<ImpedanceDevice>(&source, Kind::Device)?;
    let in_range = findings.check_ranges(&device);
    check_device(&mut findings, &device, in_range);
    let machine = in_range.then_some(Machine::Device(&device));
    let scene = linked_scene(&mut findings, "scene", &source, &device.scene, machine);
    finish(device, source, like, findings.locator(), [findings.into_sorted(), scene].concat())
}

/// Reads and checks a scene.
///
/// # Errors
/// As [`load_rig`].
pub fn load_scene(source: impl Into<Source>) -> Result<Loaded<Scene>, Report> {
    load_scene_from(source.into())
}

fn load_scene_from(source: Source) -> Result<Loaded<Scene>, Report> {
    let (scene, findings, like) = checked_scene(&source)?;
    finish(scene, source, like, findings.locator(), findings.into_sorted())
}

/// Reads and checks a device profile.
///
/// # Errors
/// As [`load_rig`].
pub fn load_profile(source: impl Into<Source>) -> Result<Loaded<DeviceProfile>, Report> {
    load_profile_from(source.into())
}

fn load_profile_from(source: Source) -> Result<Loaded<DeviceProfile>, Report> {
    let Profile { profile, findings, of_codes, .. } = checked_profile(&source)?;
    finish(profile, source, None, findings.locator(), [findings.into_sorted(), of_codes].concat())
}

/// Returns a device model by its name, or by the file of its profile, with the meanings of its error codes.
///
/// # Errors
/// As [`load_rig`]; or no model of this name comes with the program.
pub fn load_named_profile(name: &str) -> Result<ProfileName, Report> {
    let mut named = ProfileName::from(name.to_owned());
    if !named.is_file() && named.get().is_none() {
        let known: Vec<&str> = ProfileName::shipped().map(|(name, _)| name).collect();
        let help = match nearest(name, known.iter().copied()) {
            Some(meant) => format!("did you mean {meant}?"),
            None => format!("the profiles are {}; or name a file that ends in .yaml", known.join(", ")),
        };
        return Err(Diagnostic::about_file("", format!("no device profile is called {name}"), help).into());
    }
    if named.is_file() {
        let source = Source::named(name);
        let Profile { profile, codes, findings, of_codes } = checked_profile(&source)?;
        let locator = findings.locator();
        let loaded = finish(profile, source, None, locator, [findings.into_sorted(), of_codes].concat())?;
        named.set(loaded.value, codes);
    }
    Ok(named)
}

/// Reads and checks a table of error codes.
///
/// # Errors
/// As [`load_rig`].
pub fn load_error_codes(source: impl Into<Source>) -> Result<Loaded<ErrorCodes>, Report> {
    load_error_codes_from(source.into())
}

fn load_error_codes_from(source: Source) -> Result<Loaded<ErrorCodes>, Report> {
    let (codes, findings) = checked_error_codes(&source)?;
    finish(codes, source, None, findings.locator(), findings.into_sorted())
}

/// Reads and checks a simulation of a rig and its scene, without the rig.
///
/// # Errors
/// As [`load_rig`].
pub fn load_simulation(source: impl Into<Source>) -> Result<Loaded<Simulation>, Report> {
    load_simulation_from(source.into())
}

fn load_simulation_from(source: Source) -> Result<Loaded<Simulation>, Report> {
    let Read { value: mut simulation, mut findings, like } = read::<Simulation>(&source, Kind::Simulation)?;
    findings.check_ranges(&simulation);
    let profiles = linked_profiles(&mut findings, &source, simulation.profiles_mut());
    check_drive_model(&mut findings, "drive_model.profile", &simulation);
    let scene = linked_scene(&mut findings, "scene", &source, &simulation.scene, None);
    finish(simulation, source, like, findings.locator(), [findings.into_sorted(), profiles, scene].concat())
}

/// Reads and checks a figure and every file that it names.
///
/// # Errors
/// As [`load_rig`].
pub fn load_figure(source: impl Into<Source>) -> Result<Loaded<Figure>, Report> {
    load_figure_from(source.into())
}

fn load_figure_from(source: Source) -> Result<Loaded<Figure>, Report> {
    let Read { value: figure, mut findings, like } = read::<Figure>(&source, Kind::Figure)?;
    findings.check_ranges(&figure);
    check_figure(&mut findings, &figure);
    let mut others = Vec::new();
    let rigs = figure.rigs.iter().map(|(label, path)| (format!("rigs.{label}"), path, Kind::Rig));
    let device = figure.device.iter().map(|path| ("device".to_owned(), path, Kind::Device));
    for (key, path, kind) in rigs.chain(device) {
        let target = source.relative(path);
        let machine = match kind {
            Kind::Rig => load_rig(target).map(|rig| Document::Rig(Box::new(rig))),
            _ => load_device(target).map(|device| Document::Device(Box::new(device))),
        };
        let machine = match machine {
            Ok(machine) => machine,
            Err(report) => {
                others.extend(findings.link(&key, report));
                continue;
            }
        };
        let machine = match &machine {
            Document::Rig(rig) => Machine::Rig(&rig.value),
            Document::Device(device) => Machine::Device(&device.value),
            Document::Scene(_)
            | Document::Figure(_)
            | Document::Profile(_)
            | Document::Simulation(_)
            | Document::ErrorCodes(_) => continue,
        };
        check_override(&mut findings, &figure, machine);
        others.extend(linked_scene(&mut findings, "scene", &source, &figure.scene, Some(machine)));
    }
    let locator = findings.locator();
    let mut all = [findings.into_sorted(), others].concat();
    // Two machines find the same fault of a shared scene or fixture.
    keep_first(&mut all);
    finish(figure, source, like, locator, all)
}

/// Returns the document in normal form: every key, in the order of the tree, in YAML that loads again.
///
/// # Errors
/// When the writer refuses; no checked document makes it do so.
pub fn to_yaml<T: Serialize>(value: &T) -> Result<String, String> {
    yaml::write(value)
}

fn checked_scene(source: &Source) -> Result<(Scene, Findings, Option<Source>), Report> {
    let Read { value: scene, mut findings, like } = read::<Scene>(source, Kind::Scene)?;
    findings.check_ranges(&scene);
    check_scene(&mut findings, &scene);
    Ok((scene, findings, like))
}

/// Keeps each finding once.
fn keep_first(all: &mut Vec<Diagnostic>) {
    let mut seen: Vec<Diagnostic> = Vec::new();
    all.retain(|finding| {
        !seen.contains(finding) && {
            seen.push(finding.clone());
            true
        }
    });
}

/// A profile that has been read, and the table of error codes that it names.
struct Profile {
    profile: DeviceProfile,
    codes: Option<Arc<ErrorCodes>>,
    findings: Findings,
    of_codes: Vec<Diagnostic>,
}

fn checked_profile(source: &Source) -> Result<Profile, Report> {
    let Read { value: profile, mut findings, .. } = read::<DeviceProfile>(source, Kind::Profile)?;
    if findings.check_ranges(&profile) {
        check_profile(&mut findings, &profile);
    }
    let (mut codes, mut of_codes) = (None, Vec::new());
    if let Some(name) = &profile.profile.error_codes {
        const KEY: &str = "profile.error_codes";
        codes = shipped_error_codes(name);
        if codes.is_none() && is_yaml(name) {
            match checked_error_codes(&source.relative(name)) {
                Ok((table, of_table)) => {
                    codes = Some(Arc::new(table));
                    of_codes = of_table.into_sorted();
                }
                Err(report) => of_codes = findings.link(KEY, report),
            }
        } else if codes.is_none() {
            refuse_error_codes(&mut findings, KEY, name);
        }
    }
    Ok(Profile { profile, codes, findings, of_codes })
}

fn checked_error_codes(source: &Source) -> Result<(ErrorCodes, Findings), Report> {
    let Read { value: codes, mut findings, .. } = read::<ErrorCodes>(source, Kind::ErrorCodes)?;
    if findings.check_ranges(&codes) {
        check_error_codes(&mut findings, &codes);
    }
    Ok((codes, findings))
}

/// Reads the profiles that a document names by their files, and returns the findings in them. An unknown name, or a file that is
/// no profile, is a finding at the key that names it.
fn linked_profiles(findings: &mut Findings, source: &Source, named: Vec<NamedProfile<'_>>) -> Vec<Diagnostic> {
    let mut found = Vec::new();
    for (key, name, fits) in named {
        if name.get().is_none() && !name.is_file() {
            refuse_profile(findings, key, name.as_str(), "is no known profile", fits);
        }
        if !name.is_file() {
            continue;
        }
        match checked_profile(&source.relative(name.as_str())) {
            Ok(Profile { profile, codes, findings: of_profile, of_codes }) => {
                found.extend(of_profile.into_sorted());
                found.extend(of_codes);
                name.set(profile, codes);
            }
            Err(report) => found.extend(findings.link(key, report)),
        }
    }
    keep_first(&mut found);
    found
}

/// Returns the findings in a scene that a document names by `path`. If the numbers are in range, it also checks the scene with
/// the machine that runs it. A file that is no scene is a finding at the key that names it.
fn linked_scene(
    findings: &mut Findings,
    key: &str,
    source: &Source,
    path: &str,
    machine: Option<Machine<'_>>,
) -> Vec<Diagnostic> {
    match checked_scene(&source.scene(path)) {
        Ok((scene, mut of_scene, _)) => {
            if let Some(machine) = machine {
                check_scene_for(&mut of_scene, &scene, machine);
            }
            of_scene.into_sorted()
        }
        Err(report) => findings.link(key, report),
    }
}

impl Findings {
    /// Takes over the findings about a linked file. A finding about the whole file goes to the key that names it; the other
    /// findings are returned.
    fn link(&mut self, key: &str, report: Report) -> Vec<Diagnostic> {
        let (whole, inside): (Vec<_>, Vec<_>) =
            report.diagnostics.into_iter().partition(|finding| finding.place.is_none());
        for finding in whole {
            self.error(key, format!("`{key}`: {}", finding.message), finding.help.unwrap_or_default());
        }
        inside
    }
}

fn finish<T>(
    value: T,
    source: Source,
    like: Option<Source>,
    locator: Arc<Locator>,
    findings: Vec<Diagnostic>,
) -> Result<Loaded<T>, Report> {
    if findings.iter().any(|finding| finding.severity == Severity::Error) {
        return Err(Report { diagnostics: findings });
    }
    Ok(Loaded { value, source, like, warnings: findings, locator })
}

/// A document that has been read.
struct Read<T> {
    value: T,
    findings: Findings,
    like: Option<Source>,
}

/// Reads a document of a kind: its tree, and where findings about it go.
fn read<T: DeserializeOwned + Validate<Context = ()>>(source: &Source, kind: Kind) -> Result<Read<T>, Report> {
    let (locator, like) = open(source)?;
    match Kind::detect(locator.outline.top_keys()) {
        Some(found) if found == kind => {}
        Some(found) => {
            let message = format!("is {}, not {}", found.with_article(), kind.with_article());
            return Err(unknown_kind(source, &message).into());
        }
        None => {
            let message = format!("is not {}: the key `{}` is missing", kind.with_article(), kind.mark());
            return Err(unknown_kind(source, &message).into());
        }
    }
    let guide = Guide::new(kind);
    match reader::read(&locator.outline) {
        Ok(value) => Ok(Read { value, findings: Findings::new(locator, guide), like }),
        Err(fault) => Err(explain(fault, &locator, &guide).into()),
    }
}

fn unknown_kind(source: &Source, message: &str) -> Diagnostic {
    let marks = Kind::ALL.map(|kind| format!("{} has `{}`", kind.with_article(), kind.mark()));
    let help = format!("the top-level keys name the kind of a document: {}; a variant has `{LIKE}`", marks.join(", "));
    Diagnostic::about_file(source.to_string(), format!("{source} {message}"), help)
}
