//! The device model of a drive or sensor, as a rig names it.

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use yieldwall_drives::profiles::{DeviceProfile, SHIPPED};

use crate::config::yaml;

/// A device model: the name of one that comes with the program, or a profile's file (`.yaml`), relative to this file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct ProfileName {
    written: String,
    profile: Option<Arc<DeviceProfile>>,
}

static PROFILES: LazyLock<BTreeMap<&'static str, Arc<DeviceProfile>>> = LazyLock::new(|| {
    let read = |(name, text): &(&'static str, &str)| Some((*name, Arc::new(yaml::parse(text).ok()?)));
    SHIPPED.iter().filter_map(read).collect()
});

/// A device model that comes with the program.
///
/// # Panics
/// If there is none of this name.
pub fn shipped_profile(name: &str) -> Arc<DeviceProfile> {
    PROFILES.get(name).cloned().unwrap_or_else(|| panic!("no profile {name} comes with the program"))
}

impl ProfileName {
    /// The models that come with the program, by name.
    pub fn shipped() -> impl Iterator<Item = (&'static str, &'static Arc<DeviceProfile>)> {
        PROFILES.iter().map(|(name, profile)| (*name, profile))
    }

    /// What the rig says.
    pub fn as_str(&self) -> &str {
        &self.written
    }

    /// Whether it means a file and not one that comes with the program.
    pub fn is_file(&self) -> bool {
        [".yaml", ".yml"].iter().any(|end| self.written.ends_with(end))
    }

    /// The model; `None` if its name is unknown, or its file has not been read.
    pub fn get(&self) -> Option<&Arc<DeviceProfile>> {
        self.profile.as_ref()
    }

    /// Gives its file another name.
    #[cfg(all(feature = "sim", feature = "recording"))]
    pub(super) fn rename(&mut self, written: String) {
        self.written = written;
    }

    /// Takes what its file says.
    pub(in crate::config) fn set(&mut self, profile: DeviceProfile) {
        self.profile = Some(Arc::new(profile));
    }
}

impl From<String> for ProfileName {
    fn from(written: String) -> Self {
        let profile = PROFILES.get(written.as_str()).cloned();
        Self { written, profile }
    }
}

impl From<ProfileName> for String {
    fn from(name: ProfileName) -> Self {
        name.written
    }
}

impl PartialEq for ProfileName {
    fn eq(&self, other: &Self) -> bool {
        self.written == other.written && self.profile == other.profile
    }
}

impl JsonSchema for ProfileName {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "ProfileName".into()
    }

    fn json_schema(_generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "description": "A device model: the name of one that comes with the program, or a profile's file (`.yaml`), relative \
                            to this file.",
            "type": "string",
            "minLength": 1
        })
    }
}
