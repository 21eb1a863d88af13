//! Files that must be refused: a table of small changes to files that are right, and files that are no text.
//!
//! Each is refused with a message that has a place, by no panic, and is drawn in the snapshots of `cli`. The files that
//! are changed lie beside this one and belong to these tests alone, so that a shipped file can change at will.

mod table;

use std::path::PathBuf;
use std::sync::Arc;

pub(crate) use table::CASES;
use table::Case;

use super::Source;

macro_rules! bases {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!($name))),*]
    };
}

/// Files that are right, by name; they refer to each other.
const BASES: &[(&str, &str)] =
    bases!["device.yaml", "figure.yaml", "rig.yaml", "scene.yaml", "simulation.yaml", "space.yaml", "variant.yaml"];

/// The text of a file that is right.
pub(crate) fn base_text(name: &str) -> &'static str {
    BASES.iter().find(|(base, _)| *base == name).unwrap_or_else(|| panic!("no base {name}")).1
}

/// A file that is right, with others that it names beside it.
pub(crate) fn base(name: &str) -> Source {
    with(name, name, base_text(name))
}

/// The file `load` among the files that are right, where `name` has another text.
pub(crate) fn with(load: &str, name: &str, text: &str) -> Source {
    let others = BASES.iter().filter(|(base, _)| *base != name).copied();
    Source::among(load, others.chain([(name, text)]).map(|(name, text)| (PathBuf::from(name), Arc::from(text))))
}

impl Case {
    /// Source that is loaded: the changed file, or a file that names it.
    pub(crate) fn source(&self) -> Source {
        if self.base.is_empty() {
            return Source::memory("changed.yaml", self.to);
        }
        let original = base_text(self.base);
        assert!(original.contains(self.from), "{}: `{}` is not in {}", self.name, self.from, self.base);
        with(self.load, self.base, &original.replacen(self.from, self.to, 1))
    }
}
