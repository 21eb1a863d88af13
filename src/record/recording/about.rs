//! Description of a run in its recording.

use std::collections::BTreeMap;

use mcap::write::Metadata;

/// Name of the metadata record.
pub(super) const ABOUT: &str = "yieldwall";
const RIG: &str = "rig.yaml";
/// The sum of all other entries.
const SUM: &str = "crc32";
const DEVICE: &str = "device.yaml";
/// Prefix of a device profile's name.
const PROFILE: &str = "profile:";

/// The machine of a run, as a document that includes the fixture and has `scene.yaml` as its scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Machine {
    /// An admittance rig.
    Rig(String),
    /// An impedance device.
    Device(String),
}

impl Machine {
    /// Its document.
    pub fn document(&self) -> &str {
        let (Machine::Rig(document) | Machine::Device(document)) = self;
        document
    }

    /// Returns the name of its document in a recording.
    pub fn name(&self) -> &'static str {
        match self {
            Machine::Rig(_) => RIG,
            Machine::Device(_) => DEVICE,
        }
    }
}

impl Default for Machine {
    fn default() -> Self {
        Machine::Rig(String::new())
    }
}

/// Description of a run besides its cycles: enough to repeat the run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct About {
    /// Version of the program that made the recording.
    pub version: String,
    /// Commit that the program was built from, with `-dirty` if the tree was changed; empty if not known.
    pub commit: String,
    /// Build target, as the compiler names it: processor, system and C library; empty if not known.
    pub target: String,
    /// The machine of the run.
    pub machine: Machine,
    /// The scene as a document.
    pub scene: String,
    /// Device profiles that the machine names by a file: name and document.
    pub profiles: BTreeMap<String, String>,
    /// Seed of the run.
    pub seed: u64,
    /// Settings that replaced those of the documents, as on the command line; may be empty.
    pub overrides: String,
    /// Whether the description differs from the one written: then the cycles may be another machine's.
    pub is_damaged: bool,
}

impl About {
    pub(super) fn metadata(&self) -> Metadata {
        let entry = |key: &str, value: &str| (key.to_owned(), value.to_owned());
        let mut metadata = BTreeMap::from([
            entry("version", &self.version),
            entry("commit", &self.commit),
            entry("target", &self.target),
            entry(self.machine.name(), self.machine.document()),
            entry("scene.yaml", &self.scene),
            entry("seed", &self.seed.to_string()),
            entry("overrides", &self.overrides),
        ]);
        metadata.extend(self.profiles.iter().map(|(name, text)| entry(&format!("{PROFILE}{name}"), text)));
        // A copy of what is damaged stays damaged.
        let sum = if self.is_damaged { "damaged".to_owned() } else { sum(&metadata) };
        metadata.insert(SUM.to_owned(), sum);
        Metadata { name: ABOUT.to_owned(), metadata }
    }

    /// Reads the description; `None` if something is missing.
    pub(super) fn of(mut metadata: BTreeMap<String, String>) -> Option<Self> {
        // Earlier versions wrote none.
        let is_damaged = metadata.remove(SUM).is_some_and(|said| said != sum(&metadata));
        let profiles =
            metadata.iter().filter_map(|(key, text)| Some((key.strip_prefix(PROFILE)?.to_owned(), text.clone())));
        let profiles = profiles.collect();
        let mut take = |key| metadata.remove(key);
        Some(Self {
            version: take("version")?,
            commit: take("commit").unwrap_or_default(),
            target: take("target").unwrap_or_default(),
            machine: match take(RIG) {
                Some(rig) => Machine::Rig(rig),
                None => Machine::Device(take(DEVICE)?),
            },
            scene: take("scene.yaml")?,
            profiles,
            seed: take("seed")?.parse().ok()?,
            overrides: take("overrides")?,
            is_damaged,
        })
    }
}

/// Returns the sum of all names and values, each with its length before it.
fn sum(metadata: &BTreeMap<String, String>) -> String {
    let mut sum = crc32fast::Hasher::new();
    for text in metadata.iter().flat_map(|(key, value)| [key, value]) {
        sum.update(&(text.len() as u64).to_le_bytes());
        sum.update(text.as_bytes());
    }
    format!("{:08x}", sum.finalize())
}
