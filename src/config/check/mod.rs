//! What the types cannot say: ranges that garde reports, and relations between keys.

mod bus;
mod figure;
mod fixture;
mod limits;
mod models;
mod profile;
mod reach;
mod rig;
mod scene;
mod sensor;
mod sensor_bus;
mod words;

use std::sync::Arc;

pub(super) use figure::{check_figure, check_override};
pub(super) use fixture::check_device;
pub(super) use models::refuse_profile;
pub(super) use profile::check_profile;
pub(super) use rig::check_rig;
pub use scene::MAX_DURATION_S;
pub(super) use scene::{Machine, check_scene, check_scene_for};

use super::compose::{File, Origins};
use super::diagnostic::{Diagnostic, Place, Related, Severity};
use super::explain::{name_of, with_description};
use super::outline::Outline;
use super::schema::Guide;

/// Where the keys of one document stand.
#[derive(Debug)]
pub(super) struct Locator {
    /// The files that the document is put together from; the first names it.
    pub(super) files: Vec<File>,
    /// What is read: the text of the one file, or of all together.
    pub(super) text: Arc<str>,
    pub(super) outline: Outline,
    /// Where the values of the text stand in the files; empty where there is one file.
    pub(super) origins: Origins,
}

impl Locator {
    /// A document of one file.
    pub(super) fn of_file(file: File, outline: Outline) -> Self {
        Self { text: file.text.clone(), files: vec![file], outline, origins: Origins::new() }
    }

    /// The file that a place of the text is from, and its place there.
    fn origin(&self, place: Place) -> Option<(&File, Place)> {
        let nearest = self.origins.range(..=place.offset).next_back();
        let (file, place) = nearest.map_or((0, place), |(_, origin)| *origin);
        Some((self.files.get(file)?, place))
    }

    /// A finding at a place of the text.
    pub(super) fn finding_at(
        &self,
        severity: Severity,
        place: Option<Place>,
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
    pub(super) fn relate_at(&self, finding: &mut Diagnostic, place: Place, label: &str) {
        let Some((file, place)) = self.origin(place) else { return };
        let name = if file.name == finding.file { String::new() } else { file.name.clone() };
        finding.related.push(Related { file: name, place, label: label.to_owned() });
    }
}

/// The findings in one document, and what is needed to place them.
pub(super) struct Findings {
    locator: Arc<Locator>,
    guide: Guide,
    found: Vec<Diagnostic>,
    /// Where values are out of range: relations with them mean nothing.
    out_of_range: Vec<(String, Place)>,
}

impl Findings {
    pub(super) fn new(locator: Locator, guide: Guide) -> Self {
        Self { locator: Arc::new(locator), guide, found: Vec::new(), out_of_range: Vec::new() }
    }

    /// Where findings go that are made later.
    pub(super) fn locator(&self) -> Arc<Locator> {
        self.locator.clone()
    }

    /// An error at a key.
    pub(super) fn error(&mut self, at: &str, message: impl Into<String>, help: impl Into<String>) -> &mut Self {
        self.add(Severity::Error, at, message.into(), help.into())
    }

    /// A warning at a key.
    fn warning(&mut self, at: &str, message: impl Into<String>, help: impl Into<String>) -> &mut Self {
        self.add(Severity::Warning, at, message.into(), help.into())
    }

    fn add(&mut self, severity: Severity, at: &str, message: String, help: String) -> &mut Self {
        self.found.push(self.locator.finding(severity, at, message, help));
        self
    }

    /// Points the last finding at another key as well.
    fn see(&mut self, at: &str, label: &str) -> &mut Self {
        if let Some(last) = self.found.last_mut() {
            self.locator.relate(last, at, label);
        }
        self
    }

    /// Adds what garde found. Whether it found nothing.
    pub(super) fn check_ranges<T: garde::Validate<Context = ()>>(&mut self, value: &T) -> bool {
        let Err(report) = value.validate() else { return true };
        for (path, error) in report.iter() {
            let path = path.to_string();
            let found = self.locator.outline.find(&path).map(|node| node.describe()).unwrap_or_default();
            let name = name_of(&path);
            let message = match error.message() {
                "length is lower than 1" => format!("{name} is empty"),
                text if text.starts_with("length") => format!("{name} is {found}, its {text}"),
                text if text.starts_with("lower") || text.starts_with("greater") => {
                    format!("{name} is {found}, {text}")
                }
                text => format!("{name} is {found}: it {text}"),
            };
            let help = match self.guide.expectation(&path) {
                Some(expected) => format!("write {expected}"),
                None => String::new(),
            };
            let help = with_description(help, &self.guide, &path);
            self.error(&path, message, help);
            self.out_of_range
                .extend(self.found.last().and_then(|finding| Some((finding.file.clone(), finding.place?))));
        }
        false
    }

    /// All findings in the order of the files and of their lines, without those that follow from a value out of range.
    pub(super) fn into_sorted(mut self) -> Vec<Diagnostic> {
        // The findings about ranges come first; each has one of these places as its own.
        let ranges = self.out_of_range.len();
        let out_of_range = std::mem::take(&mut self.out_of_range);
        let mut index = 0;
        self.found.retain(|finding| {
            index += 1;
            let related = finding.related.iter().map(|other| (&other.file, other.place));
            let mut places = finding.place.map(|place| (&finding.file, place)).into_iter().chain(related);
            let is_out = |(file, place): (&String, Place)| {
                let file = if file.is_empty() { &finding.file } else { file };
                out_of_range.iter().any(|(of, at)| (of, *at) == (file, place))
            };
            index <= ranges || !places.any(is_out)
        });
        let files = &self.locator.files;
        self.found.sort_by_key(|finding| {
            let file = files.iter().position(|file| file.name == finding.file);
            (file, finding.place.map(|place| (place.line, place.column)))
        });
        self.found
    }
}
