//! What the types cannot say: ranges that garde reports, and relations between keys.

mod figure;
mod fixture;
mod rig;
mod scene;

use std::sync::Arc;

pub(super) use figure::{check_figure, check_override};
pub(super) use fixture::check_device;
pub(super) use rig::check_rig;
pub(super) use scene::{Machine, check_scene, check_scene_for};

use super::diagnostic::{Diagnostic, Severity};
use super::explain::{name_of, with_description};
use super::outline::Outline;
use super::schema::Guide;

/// The findings in one document, and what is needed to place them.
pub(super) struct Findings {
    file: String,
    text: Arc<str>,
    outline: Outline,
    guide: Guide,
    found: Vec<Diagnostic>,
}

impl Findings {
    pub(super) fn new(file: String, text: Arc<str>, outline: Outline, guide: Guide) -> Self {
        Self { file, text, outline, guide, found: Vec::new() }
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
        let place = self.outline.nearest(at).map(|node| node.place());
        self.found.push(Diagnostic {
            severity,
            file: self.file.clone(),
            place,
            key: at.to_owned(),
            message,
            help: Some(help).filter(|help| !help.is_empty()),
            related: Vec::new(),
            text: place.map(|_| self.text.clone()),
        });
        self
    }

    /// Points the last finding at another key as well.
    fn see(&mut self, at: &str, label: &str) -> &mut Self {
        if let (Some(node), Some(last)) = (self.outline.find(at), self.found.last_mut()) {
            last.related.push((node.place(), label.to_owned()));
        }
        self
    }

    /// Adds what garde found. Whether it found nothing.
    pub(super) fn check_ranges<T: garde::Validate<Context = ()>>(&mut self, value: &T) -> bool {
        let Err(report) = value.validate() else { return true };
        for (path, error) in report.iter() {
            let path = path.to_string();
            let found = self.outline.find(&path).map(|node| node.describe()).unwrap_or_default();
            let name = name_of(&path);
            let message = match error.message() {
                text if text.starts_with("length is lower") => format!("{name} is too short: {found}"),
                text if text.starts_with("length is greater") => format!("{name} is too long: {found}"),
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
        }
        false
    }

    /// All findings in the order of the lines.
    pub(super) fn into_sorted(mut self) -> Vec<Diagnostic> {
        self.found.sort_by_key(|finding| finding.place.map(|place| (place.line, place.column)));
        self.found
    }
}
