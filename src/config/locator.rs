//! Places of the keys of a document, in one file or in several.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::diagnostic::{Diagnostic, Related, Severity, TextSpan};
use super::outline::Outline;

/// A file that has been read.
#[derive(Clone, Debug)]
pub(super) struct File {
    pub(super) name: String,
    pub(super) text: Arc<str>,
}

/// A place in a file, by its number.
pub(super) type Spot = (usize, TextSpan);

/// Places in the files for the values of a composed text, by their place in the text. Empty for the text of one file.
pub(super) type Origins = BTreeMap<usize, Spot>;

impl File {
    /// An error at a place of this file.
    pub(super) fn finding(&self, place: TextSpan, key: &str, message: String, help: String) -> Diagnostic {
        Diagnostic {
            severity: Severity::Error,
            file: self.name.clone(),
            place: Some(place),
            key: key.to_owned(),
            message,
            help: Some(help),
            related: Vec::new(),
            text: Some(self.text.clone()),
        }
    }
}

/// Places of the keys of one document.
#[derive(Debug)]
pub(super) struct Locator {
    /// Files that the document is composed from; the first file names it.
    pub(super) files: Vec<File>,
    /// The text that was read: the text of one file, or of all files together.
    pub(super) text: Arc<str>,
    pub(super) outline: Outline,
    /// Places in the files for the values of the text; empty if there is one file.
    pub(super) origins: Origins,
}

impl Locator {
    /// A document of one file.
    pub(super) fn of_file(file: File, outline: Outline) -> Self {
        Self { text: file.text.clone(), files: vec![file], outline, origins: Origins::new() }
    }

    /// Returns the file that a place of the text is from, and its place there.
    fn origin(&self, place: TextSpan) -> Option<(&File, TextSpan)> {
        let nearest = self.origins.range(..=place.offset).next_back();
        let (file, place) = nearest.map_or((0, place), |(_, origin)| *origin);
        Some((self.files.get(file)?, place))
    }

    /// A finding at a place of the text.
    pub(super) fn finding_at(
        &self,
        severity: Severity,
        place: Option<TextSpan>,
        key: String,
        message: String,
        help: String,
    ) -> Diagnostic {
        let origin = place.and_then(|place| self.origin(place));
        Diagnostic {
            severity,
            file: origin.map(|(file, _)| file).or(self.files.first()).map(|file| file.name.clone()).unwrap_or_default(),
            place: origin.map(|(_, place)| place),
            key,
            message,
            help: Some(help).filter(|help| !help.is_empty()),
            related: Vec::new(),
            text: origin.map(|(file, _)| file.text.clone()),
        }
    }

    /// A finding at a key.
    pub(super) fn finding(&self, severity: Severity, at: &str, message: String, help: String) -> Diagnostic {
        let place = self.outline.nearest(at).map(|node| node.place());
        self.finding_at(severity, place, at.to_owned(), message, help)
    }

    /// Points a finding at another key as well, if that stands in the document.
    pub(super) fn relate(&self, finding: &mut Diagnostic, at: &str, label: &str) {
        let place = self.outline.find(at).map(|node| node.place());
        place.into_iter().for_each(|place| self.relate_at(finding, place, label));
    }

    /// Points a finding at another place of the text as well.
    pub(super) fn relate_at(&self, finding: &mut Diagnostic, place: TextSpan, label: &str) {
        let Some((file, place)) = self.origin(place) else { return };
        let name = if file.name == finding.file { String::new() } else { file.name.clone() };
        finding.related.push(Related { file: name, place, label: label.to_owned() });
    }
}
