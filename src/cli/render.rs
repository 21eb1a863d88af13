//! Findings drawn for a terminal: the line, a caret below the place, and help.

use std::fmt;

use miette::{GraphicalReportHandler, GraphicalTheme, LabeledSpan, NamedSource, SourceCode};

use textwrap::WordSplitter;

use super::fit;
use super::printable::printable;
use yieldwall_config::{Diagnostic, Related, Severity, TextSpan};

/// Farthest line from the place that a snippet still shows.
const SNIPPET_LINES: usize = 6;
/// Greatest width of a message, in columns.
const WIDTH: usize = 110;

/// Draws findings, with or without colour.
#[derive(Debug)]
pub(super) struct Renderer {
    handler: GraphicalReportHandler,
}

impl Renderer {
    /// Returns a renderer as wide as standard error, within bounds.
    pub(super) fn of_terminal(in_color: bool) -> Self {
        let width = fit::columns(std::io::stderr()).unwrap_or(fit::USUAL);
        Self::with_width(in_color, width.clamp(fit::LEAST, WIDTH))
    }

    /// Returns a renderer of the largest width.
    #[cfg(any(test, feature = "full"))]
    pub(super) fn new(in_color: bool) -> Self {
        Self::with_width(in_color, WIDTH)
    }

    fn with_width(in_color: bool, width: usize) -> Self {
        let theme = if in_color { GraphicalTheme::unicode() } else { GraphicalTheme::unicode_nocolor() };
        let handler = GraphicalReportHandler::new_themed(theme).with_width(width).with_context_lines(1);
        // Between words alone: a path or an option that is broken cannot be copied.
        let handler = handler
            .with_break_words(false)
            .with_word_separator(fit::SEPARATOR)
            .with_word_splitter(WordSplitter::NoHyphenation);
        Self { handler: handler.with_links(false).without_syntax_highlighting() }
    }

    /// Returns all findings, one after the other, and their number when there are several.
    pub(super) fn render(&self, findings: &[Diagnostic]) -> String {
        let mut text = String::new();
        for (index, finding) in findings.iter().enumerate() {
            if index > 0 {
                text.push('\n');
            }
            let shown = Shown::new(finding);
            if self.handler.render_report(&mut text, &shown).is_err() {
                text.push_str(&format!("{finding}\n"));
            }
        }
        let errors = findings.iter().filter(|finding| finding.severity == Severity::Error).count();
        let warnings = findings.len() - errors;
        if findings.len() > 1 {
            text.push_str(&format!("\n{}\n", count(errors, warnings)));
        }
        text
    }
}

/// Whether another place fits into the snippet of a finding.
fn is_near(place: TextSpan, other: &Related) -> bool {
    other.file.is_empty() && place.line.abs_diff(other.place.line) <= SNIPPET_LINES
}

fn count(errors: usize, warnings: usize) -> String {
    let plural = |number: usize, word: &str| match number {
        0 => None,
        1 => Some(format!("1 {word}")),
        number => Some(format!("{number} {word}s")),
    };
    [plural(errors, "error"), plural(warnings, "warning")].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// A finding as the renderer wants it.
#[derive(Debug)]
struct Shown {
    finding: Diagnostic,
    source: Option<NamedSource<String>>,
}

impl Shown {
    fn new(finding: &Diagnostic) -> Self {
        let mut finding = finding.clone();
        for text in [&mut finding.message, &mut finding.file].into_iter().chain(&mut finding.help) {
            *text = printable(text).into_owned();
        }
        // The replacement has the same length, so that places stay where they are; an escape is longer.
        let plain = |one: char| match one {
            '\n' | '\r' | '\t' => one,
            _ if one.is_control() && one.len_utf8() == 1 => ' ',
            _ if one.is_control() => '\u{a0}',
            _ => one,
        };
        let text = finding.text.as_ref().map(|text| text.chars().map(plain).collect::<String>());
        let source = text.map(|text| NamedSource::new(&finding.file, text));
        Self { finding, source }
    }
}

impl fmt::Display for Shown {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.finding.message)
    }
}

impl std::error::Error for Shown {}

impl miette::Diagnostic for Shown {
    fn severity(&self) -> Option<miette::Severity> {
        Some(match self.finding.severity {
            Severity::Error => miette::Severity::Error,
            Severity::Warning => miette::Severity::Warning,
        })
    }

    fn help(&self) -> Option<Box<dyn fmt::Display + '_>> {
        let place = self.finding.place;
        let far = self.finding.related.iter().filter(|other| place.is_none_or(|place| !is_near(place, other)));
        let far = far.map(|other| match other.file.as_str() {
            "" => format!("see also line {}: {}", other.place.line, other.label),
            file => format!("see also {file}, line {}: {}", other.place.line, other.label),
        });
        let lines: Vec<String> = self.finding.help.iter().cloned().chain(far).collect();
        (!lines.is_empty()).then(|| Box::new(lines.join("\n")) as Box<dyn fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.source.as_ref().map(|source| source as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let place = self.finding.place?;
        let span = |place: TextSpan| (place.offset, place.length.max(1));
        let primary = LabeledSpan::new_primary_with_span(Some("here".to_owned()), span(place));
        let related = self
            .finding
            .related
            .iter()
            .filter(move |other| is_near(place, other))
            .map(move |other| LabeledSpan::new_with_span(Some(other.label.clone()), span(other.place)));
        Some(Box::new(std::iter::once(primary).chain(related)))
    }
}
