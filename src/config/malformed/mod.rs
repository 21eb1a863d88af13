//! Files that must be refused: a table of small changes to shipped files, and files that are no text.
//!
//! Each is refused with a message that has a place, by no panic, and is drawn in the snapshots of `cli`.

mod table;
mod tests;

pub(crate) use table::{CASES, Case};

use super::source::{Source, builtin};

impl Case {
    /// The changed file.
    pub(crate) fn source(&self) -> Source {
        let text = match self.base {
            "" => self.to.to_owned(),
            base => {
                let original = builtin(base).read().unwrap_or_else(|error| panic!("{base}: {error}"));
                assert!(original.contains(self.from), "{}: `{}` is not in {base}", self.name, self.from);
                original.replacen(self.from, self.to, 1)
            }
        };
        let folder = self.base.rsplit_once('/').map(|(folder, _)| format!("{folder}/")).unwrap_or_default();
        Source::memory(format!("{folder}changed.yaml"), text)
    }
}
