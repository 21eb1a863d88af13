//! Checks that types cannot express: ranges that garde reports, and relations between keys.

mod axes;
mod bus;
mod codes;
mod figure;
mod fixture;
mod guards;
mod limits;
mod machine;
mod models;
mod most;
mod profile;
mod reach;
mod rig;
mod scene;
mod segment;
mod sensor;
mod sensor_bus;
mod words;

use std::sync::Arc;

pub use bus::HEARTBEAT_CYCLES;
pub(super) use codes::{check_error_codes, refuse_error_codes};
pub(super) use figure::{check_figure, check_override};
pub(super) use fixture::check_device;
pub(super) use models::{check_drive_model, refuse_profile};
pub(super) use profile::check_profile;
pub(super) use rig::check_rig;
pub use scene::MAX_DURATION_S;
pub(super) use scene::{Machine, check_scene, check_scene_for};
pub(super) use segment::segment_key;

use super::diagnostic::{Diagnostic, Severity, TextSpan};
use super::explain::{name_of, with_description};
use super::locator::Locator;
use super::schema::Guide;

/// Findings in one document, and the data to place them.
pub(super) struct Findings {
    locator: Arc<Locator>,
    guide: Guide,
    found: Vec<Diagnostic>,
    /// Places of values out of range: relations with them mean nothing.
    out_of_range: Vec<(String, TextSpan)>,
}

impl Findings {
    pub(super) fn new(locator: Locator, guide: Guide) -> Self {
        Self { locator: Arc::new(locator), guide, found: Vec::new(), out_of_range: Vec::new() }
    }

    /// Returns the place for findings that are made later.
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

    /// Adds the findings of garde, and returns whether there are none.
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

    /// Returns all findings in the order of the files and of their lines, without those that follow from a value out of range.
    pub(super) fn into_sorted(mut self) -> Vec<Diagnostic> {
        // The findings about ranges come first; each has one of these places as its own.
        let ranges = self.out_of_range.len();
        let out_of_range = std::mem::take(&mut self.out_of_range);
        let mut index = 0;
        self.found.retain(|finding| {
            index += 1;
            let related = finding.related.iter().map(|other| (&other.file, other.place));
            let mut places = finding.place.map(|place| (&finding.file, place)).into_iter().chain(related);
            let is_out = |(file, place): (&String, TextSpan)| {
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
