//! The device model of a drive or sensor, as a rig names it.

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use yieldwall_drives::codes::{self, ErrorCodes};
use yieldwall_drives::profiles::{DeviceProfile, Fieldbus, SHIPPED};

use crate::reader;

/// A device model: the name of a model that comes with the program, or the file of a profile (`.yaml`), relative to this file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct ProfileName {
    written: String,
    profile: Option<Arc<DeviceProfile>>,
    /// Table of error codes that its profile names.
    codes: Option<Arc<ErrorCodes>>,
}

static PROFILES: LazyLock<BTreeMap<&'static str, Arc<DeviceProfile>>> = LazyLock::new(|| {
    let read = |(name, text): &(&'static str, &str)| Some((*name, Arc::new(reader::parse(text).ok()?)));
    SHIPPED.iter().filter_map(read).collect()
});

static CODES: LazyLock<BTreeMap<&'static str, Arc<ErrorCodes>>> = LazyLock::new(|| {
    let read = |(name, text): &(&'static str, &str)| Some((*name, Arc::new(reader::parse(text).ok()?)));
    codes::SHIPPED.iter().filter_map(read).collect()
});

/// Returns a table of error codes that comes with the program.
pub fn shipped_error_codes(name: &str) -> Option<Arc<ErrorCodes>> {
    CODES.get(name).cloned()
}

/// Whether a name is that of a file, not of a model that comes with the program.
pub(crate) fn is_yaml(name: &str) -> bool {
    [".yaml", ".yml"].iter().any(|end| name.ends_with(end))
}

/// Returns a device model that comes with the program.
///
/// # Panics
/// If no model has this name.
pub fn shipped_profile(name: &str) -> Arc<DeviceProfile> {
    PROFILES.get(name).cloned().unwrap_or_else(|| panic!("no profile {name} comes with the program"))
}

/// Kind of the profiles that fit a place of a document.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fitting {
    /// Whether they are drives; if not, they are force sensors.
    is_servo: bool,
    /// Bus of the place, if it has one.
    bus: Option<Fieldbus>,
}

impl Fitting {
    /// A drive of any bus.
    pub(crate) const SERVO: Self = Self { is_servo: true, bus: None };

    /// Creates the kind of a drive, or of a force sensor, on this bus.
    pub(crate) fn on(is_servo: bool, is_on_ethercat: bool) -> Self {
        let bus = if is_on_ethercat { Fieldbus::Ethercat } else { Fieldbus::Canopen };
        Self { is_servo, bus: Some(bus) }
    }

    /// Returns the names of the shipped profiles of this kind.
    pub(crate) fn shipped(self) -> Vec<&'static str> {
        let fits = |profile: &DeviceProfile| {
            profile.servo().is_some() == self.is_servo && self.bus.is_none_or(|bus| profile.is_for(bus))
        };
        ProfileName::shipped().filter(|(_, profile)| fits(profile)).map(|(name, _)| name).collect()
    }
}

impl ProfileName {
    /// The models that come with the program, by name.
    pub fn shipped() -> impl Iterator<Item = (&'static str, &'static Arc<DeviceProfile>)> {
        PROFILES.iter().map(|(name, profile)| (*name, profile))
    }

    /// The name as the rig file has it.
    pub fn as_str(&self) -> &str {
        &self.written
    }

    /// Whether it names a file, not a model that comes with the program.
    pub fn is_file(&self) -> bool {
        is_yaml(&self.written)
    }

    /// The model; `None` if its name is unknown, or its file has not been read.
    pub fn get(&self) -> Option<&Arc<DeviceProfile>> {
        self.profile.as_ref()
    }

    /// Gives its file another name.
    pub(super) fn rename(&mut self, written: String) {
        self.written = written;
    }

    /// Meanings of the device's error codes; `None` if its profile names no table.
    pub fn error_codes(&self) -> Option<&Arc<ErrorCodes>> {
        self.codes.as_ref()
    }

    /// Stores the content of its file, and the table of error codes that the file names.
    pub fn set(&mut self, profile: DeviceProfile, codes: Option<Arc<ErrorCodes>>) {
        self.profile = Some(Arc::new(profile));
        self.codes = codes;
    }
}

impl From<String> for ProfileName {
    fn from(written: String) -> Self {
        let profile = PROFILES.get(written.as_str()).cloned();
        let codes = profile.as_ref().and_then(|profile| shipped_error_codes(profile.profile.error_codes.as_deref()?));
        Self { written, profile, codes }
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
