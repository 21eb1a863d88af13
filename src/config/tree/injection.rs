//! Faults and defects that a scene injects on purpose.

use std::borrow::Cow;

use garde::Validate;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::injection::{CATALOGUE, DEFECTS, Defect, DefectError, DefectKind, Injection, InjectionError, Kind, Target};
use crate::number::{Finite, NotNegative, Positive};

/// One injection of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct SceneFault {
    /// Name of the injected fault; `yieldwall faults` lists all names and their effects.
    pub inject: FaultName,
    /// Time at which it begins, s since the start of the scene. 0 or above; ignored for faults that are present from power-on.
    #[garde(dive)]
    pub at_s: NotNegative,
    /// Duration, s. Above 0. Left out: the usual duration of this fault.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub for_s: Option<Positive>,
    /// Place at which it acts. Left out: the usual place of this fault.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<FaultTarget>,
    /// Strength, in the unit of this fault. Left out: the usual strength.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<Finite>,
}

impl SceneFault {
    /// Returns the injection that the entry describes.
    ///
    /// # Errors
    /// If target, times or size are not possible for the kind. Whether the kind means something on the buses of a rig is not
    /// checked.
    pub fn injection(&self) -> Result<Injection, InjectionError> {
        let mut injection = Injection::new(self.inject.0, self.at_s.get());
        if let Some(duration) = self.for_s {
            injection = injection.lasting(Some(duration.get()));
        }
        if let Some(FaultTarget(target)) = self.target {
            injection = injection.on(target);
        }
        if let Some(size) = self.size {
            injection = injection.sized(size.get());
        }
        injection.check().map(|()| injection)
    }
}

/// A defect that the machine of a scene has from the beginning.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct SceneDefect {
    /// Name of the defect; `yieldwall commission --defect list` lists all names.
    pub defect: DefectName,
    /// Drive that has the defect. Left out: the left drive. Not for a defect of the sensor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drive: Option<DriveSide>,
    /// Size, in the unit of this defect. Left out: the usual size.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<Finite>,
}

/// One of the two drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DriveSide {
    /// The left drive.
    Left,
    /// The right drive.
    Right,
}

impl SceneDefect {
    /// Returns the defect that the entry describes.
    ///
    /// # Errors
    /// If place or size are not possible for it.
    pub fn defect(&self) -> Result<Defect, DefectError> {
        let DefectName(kind) = self.defect;
        let row = kind.row();
        if let Some(side) = self.drive.filter(|_| !row.is_of_drive) {
            let place = format!("{side:?}").to_lowercase();
            return Err(DefectError::TextSpan { name: row.name, place, is_of_drive: false });
        }
        let defect = Defect::new(kind).at(usize::from(self.drive == Some(DriveSide::Right)));
        self.size.map_or(Ok(defect), |size| defect.sized(size.get()))
    }
}

impl From<Defect> for SceneDefect {
    fn from(defect: Defect) -> Self {
        let row = defect.kind.row();
        let side = if defect.drive == 0 { DriveSide::Left } else { DriveSide::Right };
        Self {
            defect: DefectName(defect.kind),
            drive: Some(side).filter(|_| row.is_of_drive),
            size: row.size.and_then(|_| Finite::new(defect.size)),
        }
    }
}

const DEFECT_NAMES: [&str; DEFECTS.len()] = {
    let mut names = [""; DEFECTS.len()];
    let mut at = 0;
    while at < names.len() {
        names[at] = DEFECTS[at].name;
        at += 1;
    }
    names
};

const NAMES: [&str; Kind::COUNT] = {
    let mut names = [""; Kind::COUNT];
    let mut at = 0;
    while at < names.len() {
        names[at] = CATALOGUE[at].name;
        at += 1;
    }
    names
};

const TARGETS: [&str; Target::NAMES.len()] = {
    let mut names = [""; Target::NAMES.len()];
    let mut at = 0;
    while at < names.len() {
        names[at] = Target::NAMES[at].1;
        at += 1;
    }
    names
};

macro_rules! word {
    ($(#[$doc:meta])* $name:ident, $of:ty, $names:ident, $to:expr) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct $name(pub $of);

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                let to: fn($of) -> &'static str = $to;
                serializer.serialize_str(to(self.0))
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let word = Cow::<str>::deserialize(deserializer)?;
                <$of>::named(&word).map(Self).ok_or_else(|| de::Error::unknown_variant(&word, &$names))
            }
        }

        impl JsonSchema for $name {
            fn inline_schema() -> bool {
                true
            }

            fn schema_name() -> Cow<'static, str> {
                stringify!($name).into()
            }

            fn json_schema(_: &mut SchemaGenerator) -> Schema {
                json_schema!({ "type": "string", "enum": $names.as_slice() })
            }
        }
    };
}

word!(
    /// The name of an injection.
    FaultName,
    Kind,
    NAMES,
    |kind| kind.row().name
);
word!(
    /// Where an injection acts.
    FaultTarget,
    Target,
    TARGETS,
    Target::name
);
word!(
    /// The name of a defect.
    DefectName,
    DefectKind,
    DEFECT_NAMES,
    |kind| kind.row().name
);
