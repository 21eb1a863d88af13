//! The kinds of document; the program recognises them by their keys.

use std::fmt;

use super::tree::ProfileName;

/// The key that names the file which a variant is like.
pub(super) const LIKE: &str = "like";

/// Kind of a document.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// An admittance rig.
    Rig,
    /// An impedance device.
    Device,
    /// A scene.
    Scene,
    /// A figure.
    Figure,
    /// A device profile.
    Profile,
    /// Machine model of the simulation of a rig.
    Simulation,
    /// Meanings of a vendor's error codes.
    ErrorCodes,
}

impl Kind {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Rig, Self::Device, Self::Scene, Self::Figure, Self::Profile, Self::Simulation, Self::ErrorCodes];

    /// The key that only this kind has at the top.
    pub fn mark(self) -> &'static str {
        match self {
            Self::Rig => "rig",
            Self::Device => "device",
            Self::Scene => "hand",
            Self::Figure => "title",
            Self::Profile => "profile",
            Self::Simulation => "arm",
            Self::ErrorCodes => "error_codes",
        }
    }

    /// Its name with the indefinite article.
    pub(super) fn with_article(self) -> String {
        format!("{} {self}", if self == Self::Device { "an" } else { "a" })
    }

    /// Whether documents of this kind may be variants of another one.
    pub(super) fn has_variants(self) -> bool {
        matches!(self, Self::Rig | Self::Device | Self::Scene)
    }

    /// Whether what stands at a key is the path of a file, which starts from the folder of the file in which it stands.
    pub(super) fn names_file(self, key: &str, value: &str) -> bool {
        match (self, key) {
            (Self::Rig, "simulation.scene") | (Self::Device | Self::Simulation, "scene") => true,
            (Self::Rig | Self::Simulation, _) => {
                key.ends_with(".profile") && ProfileName::from(value.to_owned()).is_file()
            }
            _ => false,
        }
    }

    /// The kind of a document with these keys at the top; `None` when no mark is among them.
    pub(super) fn detect<'a>(keys: impl Iterator<Item = &'a str>) -> Option<Self> {
        let keys: Vec<&str> = keys.collect();
        // A profile and a figure have a key `device` too, so their marks are asked for first.
        [Self::Profile, Self::Figure, Self::Rig, Self::Device, Self::Scene, Self::Simulation, Self::ErrorCodes]
            .into_iter()
            .find(|kind| keys.contains(&kind.mark()))
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Rig => "rig",
            Self::Device => "impedance device",
            Self::Scene => "scene",
            Self::Figure => "figure",
            Self::Profile => "device profile",
            Self::Simulation => "simulation",
            Self::ErrorCodes => "table of error codes",
        })
    }
}
