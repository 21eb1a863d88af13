//! Output of a command: text or JSON, verbose or quiet.

use std::io::{self, IsTerminal, Write};

use serde::Serialize;
use serde_json::{Value, json};

use super::failure::{Exit, Failure};
use super::fit;
use super::printable::printable;
use super::render::Renderer;
use yieldwall_config::{Diagnostic, Report, Rig};

/// Standard output and standard error under `--quiet` and `--json`.
#[derive(Debug)]
pub struct Output {
    is_quiet: bool,
    is_json: bool,
    /// Whether the document is the last line of a stream.
    is_stream: bool,
    denies_warnings: bool,
    /// Warnings of the configuration until now.
    warned: Vec<Diagnostic>,
    renderer: Renderer,
    /// Widths of standard output and standard error in columns; `None` if a width is not known.
    columns: [Option<usize>; 2],
}

/// Whether standard error is a terminal with colour, and `NO_COLOR` is unset or empty.
pub(super) fn has_color() -> bool {
    let no_color = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    let is_dumb = std::env::var_os("TERM").is_some_and(|value| value == "dumb");
    io::stderr().is_terminal() && !no_color && !is_dumb
}

impl Output {
    /// Creates the output, in colour if [`has_color`] returns true.
    pub(super) fn new(is_quiet: bool, is_json: bool, denies_warnings: bool) -> Self {
        let renderer = Renderer::of_terminal(has_color());
        let columns = [fit::columns(io::stdout()), fit::columns(io::stderr())];
        Self { is_quiet, is_json, is_stream: false, denies_warnings, warned: Vec::new(), renderer, columns }
    }

    /// Puts the document on one line, after lines of events.
    pub(super) fn streaming(self) -> Self {
        Self { is_json: true, is_stream: true, ..self }
    }

    /// Whether events are printed as objects, one a line.
    pub(super) fn is_stream(&self) -> bool {
        self.is_stream
    }

    /// Whether one JSON document is requested.
    pub fn is_json(&self) -> bool {
        self.is_json
    }

    /// Whether only warnings and failures are printed.
    pub fn is_quiet(&self) -> bool {
        self.is_quiet
    }

    /// Prints the result of a command, also when quiet: for a person, in lines that fit the terminal.
    ///
    /// # Errors
    /// When standard output cannot be written; a reader that has gone away is no error.
    pub fn result(&mut self, text: &str) -> Result<(), Failure> {
        match self.columns {
            [Some(columns), _] => self.verbatim(&fit::fitted(text, columns)),
            [None, _] => self.verbatim(text),
        }
    }

    /// Prints the result of a command unchanged, also when quiet: for a program to read.
    ///
    /// # Errors
    /// When standard output cannot be written; a reader that has gone away is no error.
    pub(super) fn verbatim(&mut self, text: &str) -> Result<(), Failure> {
        let mut stdout = io::stdout().lock();
        match stdout.write_all(printable(text).as_bytes()).and_then(|()| stdout.flush()) {
            Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
                Err(Failure::new(Exit::Internal, format!("standard output: {error}"), ""))
            }
            _ => Ok(()),
        }
    }

    /// Prints the one JSON document of a command that went well: like every other an object with an exit code and diagnostics.
    ///
    /// # Errors
    /// As [`Output::verbatim`].
    pub(super) fn report(&mut self, mut document: Value) -> Result<(), Failure> {
        if let Value::Object(keys) = &mut document {
            keys.entry("exit_code").or_insert(json!(Exit::Ok.code()));
            keys.entry("diagnostics").or_insert(json!([]));
        }
        self.json(&document)
    }

    /// Prints a value as it is as the one JSON document.
    ///
    /// # Errors
    /// When standard output cannot be written; a reader that has gone away is no error.
    pub fn json(&mut self, value: &impl Serialize) -> Result<(), Failure> {
        let text = if self.is_stream { serde_json::to_string(value) } else { serde_json::to_string_pretty(value) };
        match text {
            Ok(text) => self.verbatim(&format!("{text}\n")),
            Err(error) => Err(Failure::new(Exit::Internal, format!("JSON: {error}"), "")),
        }
    }

    /// Ends a command with this JSON document. The document gets the warnings of the configuration and, after a failure, the exit
    /// code and the diagnosis, beside the measurements.
    ///
    /// # Errors
    /// The failure, of which nothing is left to print; as [`Output::result`].
    pub(super) fn end(&mut self, mut document: Value, end: Result<(), Failure>) -> Result<(), Failure> {
        document["warnings"] = json!(self.warned);
        let Err(Failure { exit, report }) = end else { return self.report(document) };
        document["exit_code"] = json!(exit.code());
        document["diagnostics"] = json!(report);
        self.json(&document)?;
        Err(Failure { exit, report: Report { diagnostics: Vec::new() } })
    }

    /// Prints a line of news, unless quiet or JSON.
    ///
    /// # Errors
    /// As [`Output::result`].
    pub fn news(&mut self, line: &str) -> Result<(), Failure> {
        if self.is_quiet || self.is_json { Ok(()) } else { self.result(&format!("{line}\n")) }
    }

    /// Prints a line beside the results, on standard error, unless quiet or JSON.
    pub(super) fn aside(&self, line: &str) {
        if !self.is_quiet && !self.is_json {
            let [_, columns] = self.columns;
            let line = columns.map_or_else(|| line.to_owned(), |columns| fit::fitted(line, columns));
            // If standard error is closed, no message can reach anybody.
            let _ = io::stderr().lock().write_all(format!("{}\n", printable(&line)).as_bytes());
        }
    }

    /// Names the simulated part of a rig that a command uses, and the option for the real one.
    pub(super) fn simulated(&self, part: &str, rig: &Rig, condition: &str) {
        self.aside(&format!("simulated {part} of {}, {condition} (real: --bus INTERFACE)", rig.rig.name));
    }

    /// Whether a configuration with warnings is refused.
    pub(super) fn denies_warnings(&self) -> bool {
        self.denies_warnings
    }

    /// Prints warnings of a configuration. With JSON they go to standard error too: not every document has them.
    ///
    /// # Errors
    /// The warnings, where they are denied.
    pub(super) fn configuration(&mut self, warnings: &[Diagnostic]) -> Result<(), Failure> {
        self.names_of(warnings)?;
        self.warned.extend_from_slice(warnings);
        self.print(warnings);
        Ok(())
    }

    /// Takes a configuration of which only the names are used, so that its warnings do not concern the action.
    ///
    /// # Errors
    /// The warnings, where they are denied.
    pub(super) fn names_of(&self, warnings: &[Diagnostic]) -> Result<(), Failure> {
        if self.denies_warnings && !warnings.is_empty() {
            return Err(Report { diagnostics: warnings.to_vec() }.into());
        }
        Ok(())
    }

    /// Prints findings that do not end the command, unless they stand in the JSON document.
    pub fn warnings(&mut self, findings: &[Diagnostic]) {
        if !self.is_json {
            self.print(findings);
        }
    }

    /// Prints why the command failed.
    pub(super) fn failure(&mut self, failure: &Failure) {
        if failure.report.diagnostics.is_empty() {
            return;
        }
        if self.is_json {
            // If this print fails, no other output is possible.
            let _ = self.json(&json!({ "exit_code": failure.exit.code(), "diagnostics": failure.report }));
        } else {
            self.print(&failure.report.diagnostics);
        }
    }

    fn print(&self, findings: &[Diagnostic]) {
        // If standard error is closed, no message can reach anybody.
        let _ = io::stderr().lock().write_all(self.renderer.render(findings).as_bytes());
    }
}
