//! The loader of configurations.

use yieldwall::config::{self, Document, Report, Severity, Source};

/// Where the text pretends to lie.
const NAME: &str = "arbitrary.yaml";

/// A text is refused with findings that say where and what to do, or is a document: it can be written and read again, and
/// a rig of it can be built.
///
/// # Panics
/// If a law is broken.
pub fn configuration(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    match config::load(Source::memory(NAME, &*text)) {
        Err(report) => check(&report),
        Ok(document) => {
            let written = match &document {
                Document::Rig(rig) => {
                    let rig = &rig.value;
                    yieldwall::assembly::cycle(rig, &rig.fixture).expect("a rig that was accepted can be built");
                    config::to_yaml(rig)
                }
                Document::Device(device) => config::to_yaml(&device.value),
                Document::Scene(scene) => config::to_yaml(&scene.value),
                Document::Figure(figure) => config::to_yaml(&figure.value),
                Document::Profile(profile) => config::to_yaml(&profile.value),
                Document::Simulation(simulation) => config::to_yaml(&simulation.value),
                Document::ErrorCodes(codes) => config::to_yaml(&codes.value),
            };
            let written = written.expect("a document can be written");
            if let Err(report) = config::load(Source::memory(NAME, &*written)) {
                panic!("written as\n{written}\nit is refused: {report}");
            }
        }
    }
}

fn check(report: &Report) {
    assert!(report.diagnostics.iter().any(|finding| finding.severity == Severity::Error), "refused without an error");
    for finding in &report.diagnostics {
        assert!(!finding.message.is_empty(), "{finding:?}");
        let (Some(place), Some(text)) = (finding.place, &finding.text) else { continue };
        // A line ends with LF, CR LF or CR alone.
        let lines = text.replace("\r\n", "\n").split(['\n', '\r']).count();
        assert!((1..=lines).contains(&place.line) && place.column >= 1, "{finding:?}");
        assert!(text.get(place.offset..place.offset + place.length).is_some(), "{finding:?}");
    }
    assert!(!report.to_string().is_empty());
}

pub(super) fn shipped() -> Vec<Vec<u8>> {
    config::builtin_names()
        .map(|name| config::builtin(name).read().expect("a shipped file").as_bytes().to_vec())
        .collect()
}
