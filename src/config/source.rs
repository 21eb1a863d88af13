//! Source of a document: a file on disk, or the copy of a shipped file inside the program.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use super::diagnostic::{Diagnostic, Report};
use super::kind::LIKE;
use super::suggest::nearest_file;
use yieldwall_drives::{codes, profiles};

/// Largest file that is read, bytes. The shipped rigs have 5 kB.
pub const MAX_FILE_BYTES: usize = 1 << 20;

/// Folders of the shipped device profiles and tables of error codes among the shipped files.
const OF_DRIVES: [(&str, &[(&str, &str)]); 2] = [("profiles", profiles::SHIPPED), ("codes", codes::SHIPPED)];

/// Name of the text with values that override those of a file.
pub(super) const SET: &str = "--set";

/// Prefix of the name of a shipped file.
const BUILTIN_PREFIX: &str = "builtin:";

macro_rules! shipped {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../config/", $name)))),*]
    };
}

/// The files of `config/`, by their path in it.
const SHIPPED: &[(&str, &str)] = shipped![
    "circle-elastic.yaml",
    "curve-guide.yaml",
    "figures/fig11.yaml",
    "figures/fig12.yaml",
    "figures/fig14.yaml",
    "figures/fig15.yaml",
    "figures/fig16.yaml",
    "figures/fig8.yaml",
    "figures/fig9.yaml",
    "moving-walls.yaml",
    "paper-admittance-10ms.yaml",
    "paper-admittance-2ms.yaml",
    "paper-admittance-4ms.yaml",
    "paper-admittance-5ms.yaml",
    "paper-admittance-cartesian.yaml",
    "paper-admittance-csp.yaml",
    "paper-admittance-csv.yaml",
    "paper-admittance-polled.yaml",
    "paper-admittance-streaming.yaml",
    "paper-admittance-two-buses.yaml",
    "paper-admittance.yaml",
    "paper-ethercat-can-sensor.yaml",
    "paper-ethercat.yaml",
    "paper-impedance.yaml",
    "paper-incremental.yaml",
    "play-spring.yaml",
    "play.yaml",
    "room.yaml",
    "scenes/circle-hold.yaml",
    "scenes/circle-tour-elastic.yaml",
    "scenes/circle-tour.yaml",
    "scenes/circle-wall.yaml",
    "scenes/curve-tour.yaml",
    "scenes/cylinder-tour.yaml",
    "scenes/cylinder-wall.yaml",
    "scenes/line-push.yaml",
    "scenes/moving-walls.yaml",
    "scenes/plane-push.yaml",
    "scenes/push-and-let-go.yaml",
    "scenes/room-walk.yaml",
    "simulations/paper-arm.yaml",
    "sphere.yaml",
    "vendors/ethercat-fixed-assignment.yaml",
    "vendors/ethercat-fixed-mapping.yaml",
    "vendors/ethercat-own-synchronisation.yaml",
    "vendors/ethercat-three-axes.yaml",
    "vendors/fixed-exponent.yaml",
    "vendors/fixed-standard-mapping.yaml",
    "vendors/float-sensor.yaml",
    "vendors/four-entries.yaml",
    "vendors/mode-below-enabled.yaml",
    "vendors/no-remote-frames.yaml",
    "vendors/no-rpdo-timer.yaml",
    "vendors/profiles/ethercat-fixed-assignment.yaml",
    "vendors/profiles/fixed-standard-mapping.yaml",
    "vendors/profiles/float-sensor.yaml",
    "vendors/profiles/four-entries.yaml",
    "vendors/profiles/mode-below-enabled.yaml",
    "vendors/profiles/no-rpdo-timer.yaml",
    "vendors/profiles/slow-segments.yaml",
    "vendors/profiles/three-axes.yaml",
    "vendors/profiles/wrong-lengths.yaml",
    "vendors/sensor-without-counter.yaml",
    "vendors/slow-memory.yaml",
    "vendors/slow-segments.yaml",
    "vendors/three-axes.yaml",
    "vendors/untidy-segment.yaml",
    "vendors/wrong-lengths.yaml",
];

/// A document that can be read, and from which relative paths start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    path: PathBuf,
    origin: Origin,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Origin {
    Disk,
    Builtin,
    /// Texts by name.
    Memory(Arc<BTreeMap<PathBuf, Arc<str>>>),
    /// Values that override those of a document of another origin.
    Over(Arc<Values>, Box<Origin>),
}

/// Texts of values that override those of a machine and of its scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Values {
    /// Path of the document.
    pub(super) file: PathBuf,
    /// The variant of the machine.
    pub(super) machine: String,
    /// Keys of the scene; empty if it stays as it is.
    pub(super) scene: String,
}

/// Returns the copy of a shipped file inside the program, by its path in `config/`, such as `figures/fig11.yaml`. Only a read
/// shows whether it exists.
pub fn builtin(path: impl AsRef<Path>) -> Source {
    Source { path: normalise(path.as_ref()), origin: Origin::Builtin }
}

/// The text of a shipped file: one of `config/`, a device profile as `profiles/NAME.yaml`, or a table of error codes as `codes/NAME.yaml`.
fn shipped(path: &Path) -> Option<&'static str> {
    let of_config = SHIPPED.iter().find(|(name, _)| Path::new(name) == path).map(|(_, text)| *text);
    let of_drives = OF_DRIVES.iter().find_map(|(folder, files)| {
        let name = path.strip_prefix(folder).ok()?.to_str()?.strip_suffix(".yaml")?;
        files.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
    });
    of_config.or(of_drives)
}

/// The paths of all shipped files in `config/`, in alphabetical order.
pub fn builtin_names() -> impl Iterator<Item = &'static str> {
    SHIPPED.iter().map(|(name, _)| *name)
}

/// The text of a variant of the document `name`.
pub(super) fn like(name: &str, keys: &str) -> String {
    // A name in double quotes is the same in JSON and in YAML.
    format!("{LIKE}: {}\n{keys}", serde_json::Value::from(name))
}

impl Source {
    /// A file on disk.
    pub fn disk(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), origin: Origin::Disk }
    }

    /// A text under a name; relative paths in it mean shipped files, as if it lay in `config/` by that name.
    pub fn memory(name: impl Into<PathBuf>, text: impl Into<Arc<str>>) -> Self {
        let path = name.into();
        Self::among(path.clone(), [(path, text.into())])
    }

    /// The text called `name` among several; relative paths in it mean the others, or else shipped files as with
    /// [`Source::memory`].
    pub fn among(name: impl Into<PathBuf>, texts: impl IntoIterator<Item = (PathBuf, Arc<str>)>) -> Self {
        Self { path: name.into(), origin: Origin::Memory(Arc::new(texts.into_iter().collect())) }
    }

    /// Parses the output of [`Display`](fmt::Display): a path on disk, or with the prefix `builtin:` a shipped file.
    pub fn named(name: &str) -> Self {
        match name.strip_prefix(BUILTIN_PREFIX) {
            Some(path) => builtin(path),
            None => Self::disk(name),
        }
    }

    /// Path of the file.
    pub(super) fn path(&self) -> PathBuf {
        self.path.clone()
    }

    /// Name of the file in its folder.
    pub(super) fn file_name(&self) -> Option<&str> {
        self.path.file_name()?.to_str()
    }

    /// Adds values that override those of this document. Paths in them have the same meaning as in the document.
    pub(super) fn beneath(self, values: Values) -> Self {
        let path = self.path.with_file_name(SET);
        Self { path, origin: Origin::Over(Arc::new(values), Box::new(self.origin)) }
    }

    /// Returns the scene that `path` means in this document, with the values that override it.
    pub(super) fn scene(&self, path: &str) -> Self {
        let scene = self.relative(path);
        match (&self.origin, scene.file_name()) {
            (Origin::Over(values, _), Some(name)) if !values.scene.is_empty() => {
                let (file, machine) = (scene.path.clone(), like(name, &values.scene));
                scene.beneath(Values { file, machine, scene: String::new() })
            }
            _ => scene,
        }
    }

    /// Returns the name of the file, also if values override some of its own.
    pub(super) fn document(&self) -> String {
        match &self.origin {
            Origin::Over(values, origin) => Self { path: values.file.clone(), origin: *origin.clone() }.to_string(),
            _ => self.to_string(),
        }
    }

    /// Whether it is a file that comes with the program.
    pub fn is_shipped(&self) -> bool {
        self.origin == Origin::Builtin
    }

    /// Returns the document that `path` means in this document: a file by its path from the folder of this document, or with the
    /// prefix `builtin:` a shipped file.
    pub fn relative(&self, path: &str) -> Self {
        if let Some(shipped) = path.strip_prefix(BUILTIN_PREFIX) {
            return builtin(shipped);
        }
        let joined = self.path.parent().unwrap_or(Path::new("")).join(path);
        match &self.origin {
            Origin::Over(_, origin) => Self { path: self.path.clone(), origin: *origin.clone() }.relative(path),
            Origin::Disk => Self::disk(joined),
            Origin::Memory(texts) if texts.contains_key(&normalise(&joined)) => {
                Self { path: normalise(&joined), origin: self.origin.clone() }
            }
            Origin::Builtin | Origin::Memory(_) => builtin(joined),
        }
    }

    /// The whole text.
    ///
    /// # Errors
    /// No such file; not a regular file; above [`MAX_FILE_BYTES`]; binary; not UTF-8.
    pub fn read(&self) -> Result<Arc<str>, Report> {
        match &self.origin {
            Origin::Over(values, _) => Ok(values.machine.as_str().into()),
            Origin::Disk => self.read_disk(),
            Origin::Builtin => match shipped(&self.path) {
                Some(text) => Ok(Arc::from(text)),
                None => {
                    let help = self.meant_builtin().unwrap_or_else(|| {
                        format!("the shipped files are {}", builtin_names().collect::<Vec<_>>().join(", "))
                    });
                    Err(self.refuse("is not among the files that come with the program", help))
                }
            },
            Origin::Memory(texts) => match texts.get(&self.path) {
                Some(text) if text.len() > MAX_FILE_BYTES => Err(self.refuse_size()),
                Some(text) => Ok(text.clone()),
                None => Err(self.refuse("is not among the texts in memory", "check its name")),
            },
        }
    }

    fn read_disk(&self) -> Result<Arc<str>, Report> {
        let bytes = self.read_bytes()?;
        if let Some(encoding) = wide_encoding(&bytes) {
            let path = self.path.display();
            let help = format!("save it in UTF-8, for example: iconv -f {encoding} -t UTF-8 {path} > utf8.yaml");
            return Err(self.refuse(&format!("is text in {encoding}"), help));
        }
        if bytes.contains(&0) {
            return Err(self.refuse("is a binary file", "a configuration is YAML text in UTF-8"));
        }
        match String::from_utf8(bytes) {
            Ok(text) => Ok(Arc::from(text)),
            Err(error) => {
                let at = error.utf8_error().valid_up_to();
                let line = 1 + error.as_bytes().iter().take(at).filter(|byte| **byte == b'\n').count();
                Err(self.refuse(&format!("is not UTF-8: line {line}, byte {at}"), "save the file in UTF-8"))
            }
        }
    }

    fn read_bytes(&self) -> Result<Vec<u8>, Report> {
        let metadata = match std::fs::metadata(&self.path) {
            Ok(metadata) => metadata,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(self.refuse("does not exist", self.nearby()));
            }
            Err(error) => return Err(self.refuse(&format!("cannot be read: {error}"), "check the path")),
        };
        if metadata.is_dir() {
            if self.path.join("cycles.mcap").is_file() {
                let help = "use `yieldwall plot`, `replay`, `view` or `compare`, or name the rig that was recorded";
                return Err(self.refuse("is a recording, not a rig", help));
            }
            return Err(self.refuse("is a directory", "name a file in it"));
        }
        // A pipe or a device could block for ever.
        if !metadata.is_file() {
            return Err(self.refuse("is not a regular file", "save the configuration to a file first"));
        }
        let mut bytes = Vec::new();
        let limit = MAX_FILE_BYTES as u64 + 1;
        match File::open(&self.path).and_then(|file| file.take(limit).read_to_end(&mut bytes)) {
            Err(error) => Err(self.refuse(&format!("cannot be read: {error}"), "check its permissions")),
            Ok(_) if bytes.len() > MAX_FILE_BYTES => Err(self.refuse_size()),
            Ok(_) => Ok(bytes),
        }
    }

    /// Returns help for a path similar to that of a file inside the program.
    fn meant_builtin(&self) -> Option<String> {
        let meant = nearest_file(&self.path.to_string_lossy(), builtin_names())?;
        Some(format!("did you mean `{BUILTIN_PREFIX}{meant}`?"))
    }

    /// Returns help for a path that does not exist. The help names the YAML file in the same folder with the nearest name, the file
    /// inside the program, or all YAML files of the folder.
    fn nearby(&self) -> String {
        let parent = match self.path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let mut names: Vec<String> = std::fs::read_dir(parent)
            .into_iter()
            .flatten()
            .flatten()
            .filter_map(|entry| entry.file_name().into_string().ok())
            .filter(|name| name.ends_with(".yaml") || name.ends_with(".yml"))
            .collect();
        names.sort();
        let asked = self.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if let Some(meant) = nearest_file(&asked, names.iter().map(String::as_str)) {
            return format!("did you mean `{}`?", self.path.with_file_name(meant).display());
        }
        if let Some(help) = self.meant_builtin() {
            return help;
        }
        names.truncate(10);
        match names.is_empty() {
            true => "check the path; there is no YAML file in that folder".to_owned(),
            false => format!("check the path; in that folder there are {}", names.join(", ")),
        }
    }

    fn refuse_size(&self) -> Report {
        self.refuse(
            &format!("is larger than {MAX_FILE_BYTES} bytes"),
            "a configuration is a small file written by hand; is this the right one?",
        )
    }

    fn refuse(&self, message: &str, help: impl Into<String>) -> Report {
        Diagnostic::about_file(self.to_string(), format!("{self} {message}"), help).into()
    }
}

impl From<&Path> for Source {
    fn from(path: &Path) -> Self {
        Self::disk(path)
    }
}

impl From<PathBuf> for Source {
    fn from(path: PathBuf) -> Self {
        Self::disk(path)
    }
}

impl From<&str> for Source {
    fn from(path: &str) -> Self {
        Self::disk(path)
    }
}

impl From<&Source> for Source {
    fn from(source: &Source) -> Self {
        source.clone()
    }
}

/// The path; a shipped file has `builtin:` before it.
impl fmt::Display for Source {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if matches!(self.origin, Origin::Over(..)) {
            return out.write_str(SET);
        }
        let prefix = if self.origin == Origin::Builtin { BUILTIN_PREFIX } else { "" };
        write!(out, "{prefix}{}", self.path.display())
    }
}

/// Returns the path that a document writes for a file, if it names another document by `other` and that document calls the file
/// `path`.
pub(super) fn rebase(other: &str, path: &str) -> String {
    if path.starts_with(BUILTIN_PREFIX) {
        return path.to_owned();
    }
    let joined = |other: &str| Path::new(other).parent().unwrap_or(Path::new("")).join(path);
    match other.strip_prefix(BUILTIN_PREFIX) {
        Some(shipped) => format!("{BUILTIN_PREFIX}{}", normalise(&joined(shipped)).display()),
        None => plain(&joined(other)).display().to_string(),
    }
}

/// A path without `.` and without a folder that is left at once, by the letter.
fn plain(path: &Path) -> PathBuf {
    path.components().fold(PathBuf::new(), |mut plain, component| {
        match (component, plain.components().next_back()) {
            (Component::CurDir, _) => {}
            (Component::ParentDir, Some(Component::Normal(_))) => {
                plain.pop();
            }
            _ => plain.push(component),
        }
        plain
    })
}

/// Removes `.` and `..` by the letter of the path: the shipped files have no links.
fn normalise(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for component in path.components() {
        match component {
            Component::CurDir => {}
            Component::ParentDir => {
                plain.pop();
            }
            other => plain.push(other),
        }
    }
    plain
}

/// The encoding of text with more than one byte for a letter, by its mark or by the zeros of its first two letters.
fn wide_encoding(bytes: &[u8]) -> Option<&'static str> {
    match bytes {
        [0xff, 0xfe, 0, 0, ..] | [0, 0, 0xfe, 0xff, ..] => Some("UTF-32"),
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => Some("UTF-16"),
        [0, 0, 0, last, ..] if *last != 0 => Some("UTF-32BE"),
        [first, 0, 0, 0, ..] if *first != 0 => Some("UTF-32LE"),
        [first, 0, third, 0, ..] if *first != 0 && *third != 0 => Some("UTF-16LE"),
        [0, second, 0, fourth, ..] if *second != 0 && *fourth != 0 => Some("UTF-16BE"),
        _ => None,
    }
}
