//! Gains in the file of a rig: the edit replaces only numbers by numbers.

use std::fs;
use std::path::{Path, PathBuf};

use super::Change;
use crate::failure::{Exit, Failure};
use crate::replace::{beside, exchange};
use yieldwall_config::{Loaded, Rig, Severity, Source, load_rig};

/// Place of a rig's gains.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum GainsSource {
    /// In its own file: position and length of each number in bytes.
    Here(Vec<(usize, usize)>),
    /// In the file that it is like.
    Inherited {
        /// Its name.
        from: String,
    },
    /// Somewhere in its own file where they cannot be replaced.
    Unclear {
        /// Key of the gain.
        key: String,
    },
}

/// The file of a rig with other gains.
pub(super) struct Edit {
    path: PathBuf,
    /// The whole text.
    text: String,
    /// Rig after the change.
    wanted: Rig,
    words: String,
}

/// Returns the place of these gains.
pub(super) fn place(rig: &Loaded<Rig>, changes: &[Change]) -> GainsSource {
    let mut spans = Vec::new();
    for (key, old, _) in changes {
        let found = rig.finding(Severity::Warning, key, "", "", &[]);
        if found.file != rig.source.to_string() {
            return GainsSource::Inherited { from: found.file };
        }
        let written = found.place.zip(found.text.as_ref()).and_then(|(place, text)| {
            let word = text.get(place.offset..place.offset + place.length)?;
            // What is no plain number there is an alias or another way to write it.
            (word.parse() == Ok(*old)).then_some((place.offset, place.length))
        });
        match written {
            Some(span) => spans.push(span),
            None => return GainsSource::Unclear { key: key.clone() },
        }
    }
    GainsSource::Here(spans)
}

impl Edit {
    /// Returns the file with these changes, and writes nothing yet.
    pub(super) fn of(
        rig: &Loaded<Rig>,
        wanted: &Rig,
        changes: &[Change],
        place: &GainsSource,
    ) -> Result<Self, Failure> {
        let path = disk_path(rig)?;
        let old = rig.source.read()?;
        let by_hand = || format!("write it yourself:\n{}", lines(changes, "\n"));
        let (text, words) = match place {
            GainsSource::Here(spans) => {
                let mut text = old.to_string();
                let mut edits: Vec<_> = spans.iter().zip(changes).collect();
                // The edits go from the end, so that earlier offsets stay valid.
                edits.sort_by_key(|((offset, _), _)| std::cmp::Reverse(*offset));
                for ((offset, length), (_, _, new)) in edits {
                    text.replace_range(*offset..offset + length, &format!("{new:?}"));
                }
                (text, format!("replace {} numbers", changes.len()))
            }
            GainsSource::Inherited { from } => {
                // If the file has its own group, its author has to change it.
                let has_group = ["control:", "\"control\":", "'control':"]
                    .iter()
                    .any(|key| old.lines().any(|line| line.trim_start_matches('\u{feff}').starts_with(key)));
                if has_group || old.trim_start().starts_with('{') {
                    let message =
                        format!("the gains are in {from}, and {} has a group `control` without gains", rig.source);
                    return Err(Failure::new(Exit::Usage, message, by_hand()));
                }
                let end = if old.contains("\r\n") { "\r\n" } else { "\n" };
                let gap = if old.ends_with('\n') { "" } else { end };
                (
                    format!("{old}{gap}{end}{}", lines(changes, end)),
                    format!("add gains, which replace the gains of {from}"),
                )
            }
            GainsSource::Unclear { key } => {
                let message = format!("`{key}` is not a plain number in {}", rig.source);
                return Err(Failure::new(Exit::Usage, message, by_hand()));
            }
        };
        Ok(Self { path, text, wanted: wanted.clone(), words })
    }

    /// Returns the file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Describes the change.
    pub(super) fn words(&self) -> &str {
        &self.words
    }

    /// Writes the new content beside the file and reads it as a rig. If this rig differs only in its gains, the content replaces
    /// the file.
    pub(super) fn carry_out(self) -> Result<PathBuf, Failure> {
        let refused = |message: String| Failure::about_file(Exit::Usage, &self.path, message, "nothing was written");
        let io = |error: std::io::Error| refused(format!("{}: {error}", self.path.display()));
        exchange(&self.path, &self.text, io, |beside| match load_rig(Source::disk(beside)) {
            Ok(rig) if rig.value == self.wanted => Ok(()),
            Ok(_) => Err(refused(format!(
                "{}: with these gains other values of the rig would change too",
                self.path.display()
            ))),
            Err(report) => Err(Failure::from(report)),
        })?;
        Ok(self.path)
    }
}

/// Refuses a rig whose file cannot take other gains, before a long computation of them.
pub(in crate::tune) fn check_can_write(rig: &Loaded<Rig>) -> Result<(), Failure> {
    let path = disk_path(rig)?;
    let beside = beside(&path);
    let tried = fs::File::create_new(&beside).and_then(|_| fs::remove_file(&beside));
    tried.map_err(|error| {
        let message = format!("{}: {error}", path.display());
        Failure::about_file(
            Exit::Usage,
            &path,
            message,
            "nothing was written; copy it into a folder that can be written",
        )
    })
}

/// Returns the file of a rig.
fn disk_path(rig: &Loaded<Rig>) -> Result<PathBuf, Failure> {
    if rig.source.is_shipped() {
        let message = format!("{} comes with the program, and stays as it is", rig.source);
        let help = format!("keep what `yieldwall config show {}` prints in a file, and name that file", rig.source);
        return Err(Failure::new(Exit::Usage, message, help));
    }
    fs::canonicalize(rig.source.to_string()).map_err(|error| {
        Failure::new(Exit::Usage, format!("{}: {error}", rig.source), "name a file that can be written")
    })
}

/// Returns the group `control` with these gains alone.
fn lines(changes: &[Change], end: &str) -> String {
    let group = changes.first().and_then(|(key, _, _)| key.split('.').nth(2)).unwrap_or_default();
    let mut text = format!("control:{end}  gains:{end}    {group}:{end}");
    for (key, _, new) in changes {
        let key = key.rsplit('.').next().unwrap_or_default();
        text += &format!("      {key}: {new:?}{end}");
    }
    text
}
