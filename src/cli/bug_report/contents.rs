//! Contents of a report.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::strip::Stripper;
use crate::config::Checked;
use crate::render::Renderer;
use yieldwall_config::{self as config, Document, Loaded, Report, Rig, Source};
use yieldwall_record::CycleRecord;
use yieldwall_record::recording::{BlackBox, Machine, Reader, Writer};

/// Cycles of a black box that are taken, its last ones.
const MOST_CYCLES: usize = 20_000;
/// Records of drills and of latency that are taken, the newest ones, and the largest, bytes.
const MOST_RECORDS: usize = 5;
const LARGEST_RECORD: u64 = 1 << 18;

/// A file of the report.
pub(super) struct Entry {
    pub(super) name: String,
    pub(super) content: Content,
}

/// Content of one file of the report.
pub(super) enum Content {
    Text(String),
    /// A recording of a rig.
    Recording(PathBuf),
}

/// Folders in which the program leaves its files.
pub(super) struct Folders {
    pub(super) black_boxes: PathBuf,
    pub(super) drills: PathBuf,
    pub(super) latency: PathBuf,
}

impl Content {
    /// Returns its bytes without names.
    pub(super) fn bytes(&self, stripper: &Stripper) -> Result<Vec<u8>, String> {
        match self {
            Content::Text(text) => Ok(stripper.text(text).into_bytes()),
            Content::Recording(path) => recording(path, stripper),
        }
    }
}

/// Returns the full contents of a report on this computer.
pub(super) fn contents(rig: Option<&str>, messages: Option<String>, folders: &Folders) -> Vec<Entry> {
    let text = |name: &str, text: String| Entry { name: name.to_owned(), content: Content::Text(text) };
    let mut entries = vec![text("version.txt", version())];
    entries.extend(messages.map(|messages| text("messages.txt", messages)));
    let source = rig.map(Source::named);
    let checked = source.map(|source| (Checked::of(source.clone()), source));
    #[cfg(target_os = "linux")]
    {
        let rig = checked.as_ref().and_then(|(checked, _)| match &checked.result {
            Ok(Document::Rig(rig)) => Some(&rig.value),
            _ => None,
        });
        entries.push(text("doctor.txt", crate::doctor::text(rig)));
    }
    if let Some((checked, source)) = checked {
        let mut said = Renderer::new(false).render(&checked.findings);
        for line in checked.lines() {
            said += &format!("{line}\n");
        }
        entries.push(text("config-check.txt", said));
        let files = match &checked.result {
            Ok(Document::Rig(rig)) => {
                if let Ok(shown) = config::to_yaml(&rig.value) {
                    entries.push(text("config-show.yaml", shown));
                }
                entries.extend(black_box(&rig.value, &folders.black_boxes));
                files_of(rig)
            }
            Ok(_) => file(&source),
            Err(report) => named_in(&source, report),
        };
        for (number, (name, content)) in files.into_iter().enumerate() {
            let name = Path::new(&name).file_name().map_or(name.clone(), |name| name.to_string_lossy().into_owned());
            // Files of several folders may have one name.
            entries.push(text(&format!("config/{}-{name}", number + 1), content));
        }
    }
    for (kind, folder) in [("drills", &folders.drills), ("latency", &folders.latency)] {
        for path in newest(folder, ".json").into_iter().take(MOST_RECORDS) {
            let is_small = fs::metadata(&path).is_ok_and(|facts| facts.len() <= LARGEST_RECORD);
            if let (true, Ok(content), Some(name)) = (is_small, fs::read_to_string(&path), path.file_name()) {
                entries.push(text(&format!("{kind}/{}", name.to_string_lossy()), content));
            }
        }
    }
    entries
}

/// Returns the description of the program.
fn version() -> String {
    let known = |word: &'static str| if word.is_empty() { "unknown" } else { word };
    format!(
        "version {}\ncommit  {}\ntarget  {}\nsystem  {} {}\n",
        env!("CARGO_PKG_VERSION"),
        known(crate::commit()),
        known(yieldwall_run::built::TARGET),
        std::env::consts::OS,
        std::env::consts::ARCH
    )
}

fn file(source: &Source) -> Vec<(String, String)> {
    source.read().map(|text| vec![(source.to_string(), text.to_string())]).unwrap_or_default()
}

/// Returns the files of which a rig consists: its own file, its base, simulation, scene, profiles.
fn files_of(rig: &Loaded<Rig>) -> Vec<(String, String)> {
    let mut files: Vec<(String, String)> = rig.files().map(|(name, text)| (name.to_owned(), text.to_owned())).collect();
    let scene = rig.value.simulation.as_ref().map(|simulation| rig.source.relative(&simulation.scene));
    let profiles = rig.value.profile_files().map(|path| rig.source.relative(path)).collect::<Vec<_>>();
    for source in scene.into_iter().chain(profiles) {
        for (name, text) in file(&source) {
            if !files.iter().any(|(known, _)| *known == name) {
                files.push((name, text));
            }
        }
    }
    files
}

/// Returns the files in which a refused rig has an error, and the rig itself.
fn named_in(source: &Source, report: &Report) -> Vec<(String, String)> {
    let mut files = file(source);
    for finding in &report.diagnostics {
        if let Some(text) = finding.text.as_ref().filter(|_| !files.iter().any(|(known, _)| *known == finding.file)) {
            files.push((finding.file.clone(), text.to_string()));
        }
    }
    files
}

/// Files in a folder with this ending, the newest first.
fn newest(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<(SystemTime, PathBuf)> = entries
        .filter(|entry| entry.file_name().to_string_lossy().ends_with(ending))
        .filter_map(|entry| {
            let facts = entry.metadata().ok().filter(fs::Metadata::is_file)?;
            Some((facts.modified().ok()?, entry.path()))
        })
        .collect();
    files.sort();
    files.into_iter().rev().map(|(_, path)| path).collect()
}

/// Returns the last black box of a rig.
fn black_box(rig: &Rig, folder: &Path) -> Option<Entry> {
    let found = BlackBox::files_of(folder, &rig.rig.name).into_iter().next()?;
    Some(Entry { name: "black-box.mcap".to_owned(), content: Content::Recording(found) })
}

/// Returns a recording of a rig: its last cycles, with a description without names.
fn recording(path: &Path, stripper: &Stripper) -> Result<Vec<u8>, String> {
    let mut reader: Reader<_, CycleRecord> = Reader::open(path).map_err(|error| error.to_string())?;
    let mut about = reader.about().clone();
    about.scene = stripper.text(&about.scene);
    about.overrides = stripper.text(&about.overrides);
    about.commit = stripper.text(&about.commit);
    about.machine = match &about.machine {
        Machine::Rig(document) => Machine::Rig(stripper.text(document)),
        Machine::Device(document) => Machine::Device(stripper.text(document)),
    };
    about.profiles = about.profiles.iter().map(|(name, text)| (stripper.name(name), stripper.text(text))).collect();
    let mut last = std::collections::VecDeque::new();
    while let Some(record) = reader.next_record().map_err(|error| error.to_string())? {
        if last.len() == MOST_CYCLES {
            last.pop_front();
        }
        last.push_back(record);
    }
    let mut bytes = std::io::Cursor::new(Vec::new());
    let mut writer = Writer::new(&mut bytes, &about).map_err(|error| error.to_string())?;
    for record in &last {
        writer.write(record).map_err(|error| error.to_string())?;
    }
    writer.finish().map_err(|error| error.to_string())?;
    drop(writer);
    Ok(bytes.into_inner())
}
