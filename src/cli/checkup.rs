//! Checks as `doctor` prints them.

use serde_json::{Value, json};
use textwrap::{Options, WordSeparator, WordSplitter};

use super::failure::{Exit, Failure};
use super::fit;
use super::output::Output;
use yieldwall_link::checkup::{Check, Verdict};

/// Columns of a line.
const WIDTH: usize = 80;
/// Columns before the finding, for the verdict and the subject.
const INDENT: usize = 24;
/// Columns before a command.
const COMMAND_INDENT: usize = 4;

/// Checks of one place.
#[derive(Debug)]
pub(super) struct Section {
    /// The place, such as the name of an interface.
    pub(super) about: String,
    /// Exit code if a check fails.
    pub(super) exit: Exit,
    pub(super) checks: Vec<Check>,
}

impl Section {
    pub(super) fn new(about: impl Into<String>, exit: Exit, checks: Vec<Check>) -> Self {
        Self { about: about.into(), exit, checks }
    }

    fn wrong(&self) -> impl Iterator<Item = &Check> {
        self.checks.iter().filter(|check| check.verdict == Verdict::Wrong)
    }

    /// Whether one of its checks failed.
    pub(super) fn is_wrong(&self) -> bool {
        self.wrong().next().is_some()
    }

    pub(super) fn text(&self) -> String {
        let mut text = format!("{}\n", self.about);
        for check in &self.checks {
            let head = format!("  {:8} {:12} ", check.verdict.word(), check.subject);
            text.push_str(&wrapped(&check.found, &head));
            if !check.follows.is_empty() {
                text.push_str(&wrapped(&check.follows, &" ".repeat(INDENT)));
            }
            if let Some(command) = &check.fix {
                command_lines(command).for_each(|line| text.push_str(&format!("{:COMMAND_INDENT$}{line}\n", "")));
            }
        }
        text
    }

    fn documents(&self) -> impl Iterator<Item = Value> {
        self.checks.iter().map(|check| {
            json!({
                "about": self.about,
                "subject": check.subject,
                "verdict": check.verdict.word(),
                "found": check.found,
                "follows": check.follows,
                "fix": check.fix,
            })
        })
    }
}

/// Wraps a text for lines after a first one that begins with `head`.
fn wrapped(text: &str, head: &str) -> String {
    let rest = " ".repeat(INDENT);
    // Between words alone: a path or an option that is broken cannot be copied.
    let options = Options::new(WIDTH)
        .initial_indent(head)
        .subsequent_indent(&rest)
        .break_words(false)
        .word_separator(WordSeparator::AsciiSpace)
        .word_splitter(WordSplitter::NoHyphenation);
    textwrap::wrap(text, options).iter().map(|line| format!("{line}\n")).collect()
}

/// Returns a command in lines that a shell takes as they are: it continues after `&&`, and after `;` it is complete.
fn command_lines(command: &str) -> impl Iterator<Item = String> {
    let mut lines: Vec<String> = Vec::new();
    let is_short = command.len() + COMMAND_INDENT <= WIDTH;
    let parts = if is_short {
        vec![command]
    } else {
        command.split_inclusive("&& ").flat_map(|part| part.split_inclusive("; ")).collect()
    };
    for part in parts {
        match lines.last_mut().filter(|line| line.len() + part.trim_end().len() + COMMAND_INDENT <= WIDTH) {
            Some(line) => line.push_str(part),
            None => lines.push(part.to_owned()),
        }
    }
    lines.into_iter().map(|line| line.trim_end().to_owned())
}

/// Prints all sections, and fails if a check fails; the JSON document also holds `document`.
pub(super) fn finish(sections: &[Section], mut document: Value, output: &mut Output) -> Result<(), Failure> {
    let end = match sections.iter().find(|section| section.is_wrong()) {
        None => Ok(()),
        Some(first) => Err(failure(sections, first.exit)),
    };
    if output.is_json() {
        document["checks"] = sections.iter().flat_map(Section::documents).collect();
        return output.end(document, end);
    }
    let text: Vec<String> = sections.iter().map(Section::text).collect();
    output.result(&format!("{}\n\n{}", verdict(sections, &end), text.join("\n")))?;
    end
}

/// Returns the first line: the failed checks, or the number of checks that passed.
fn verdict(sections: &[Section], end: &Result<(), Failure>) -> String {
    let count = |verdict: Verdict| {
        sections.iter().flat_map(|section| &section.checks).filter(|check| check.verdict == verdict).count()
    };
    let line = match end {
        Ok(()) => {
            let [ok, warnings, unknown] = [Verdict::Ok, Verdict::Warning, Verdict::Unknown].map(count);
            let plural = if warnings == 1 { "" } else { "s" };
            format!("ok: no check failed ({ok} ok, {warnings} warning{plural}, {unknown} unknown)")
        }
        Err(failure) => {
            let failed: Vec<&str> = sections.iter().flat_map(Section::wrong).map(|check| check.subject).collect();
            format!("NOT OK (exit code {}): failed checks: {}", failure.exit.code(), failed.join(", "))
        }
    };
    fit::filled("verdict   ", "          ", &line, WIDTH)
}

fn failure(sections: &[Section], exit: Exit) -> Failure {
    let wrong: Vec<&Check> = sections.iter().flat_map(Section::wrong).collect();
    let subjects: Vec<&str> = wrong.iter().map(|check| check.subject).collect();
    let message = match wrong.as_slice() {
        [only] => format!("{}: {}", only.subject, only.found),
        several => format!("{} checks failed: {}", several.len(), subjects.join(", ")),
    };
    let help = match (wrong.len(), wrong.iter().filter(|check| check.fix.is_some()).count()) {
        (_, 0) => String::new(),
        (1, _) => match wrong.iter().find_map(|check| check.fix.as_ref()) {
            Some(command) if command_lines(command).count() == 1 => format!("`{command}`"),
            // What is drawn around a message would be copied with it.
            _ => "run the command above".to_owned(),
        },
        _ => "resolve each failed check above, in this order: where a command stands under it, run the command; then check again".to_owned(),
    };
    Failure::new(exit, message, help)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_failures_are_resolved_in_their_order() {
        let help = |checks| {
            let failure = failure(&[Section::new("can0", Exit::Ok, checks)], Exit::BusUnavailable);
            failure.report.diagnostics[0].help.clone().unwrap_or_default()
        };
        let with_command = || Check::wrong("bus state", "down").fix("ip link set can0 up");
        assert_eq!(help(vec![with_command()]), "`ip link set can0 up`");
        let several = help(vec![with_command(), Check::wrong("supply", "off")]);
        assert!(several.starts_with("resolve each failed check above, in this order"), "{several}");
    }

    #[test]
    fn nothing_is_wider_than_a_terminal_and_commands_can_be_copied() {
        let rates = "for rate in 1000000 500000; do sudo ip link set can0 down; sudo ip link set can0 up type can bitrate $rate \
                     listen-only on; done; sudo ip link set can0 down; sudo ip link set can0 up";
        let long = "sudo ip link set can0 down && sudo ip link set can0 up type can bitrate 1000000 sample-point 0.875";
        let checks = vec![
            Check::wrong("identifiers", "word ".repeat(40)).follows("more words ".repeat(20)).fix(long),
            Check::warning("bit rate", "short").fix(rates),
        ];
        let text = Section::new("can0", Exit::Ok, checks).text();
        assert!(text.lines().all(|line| line.len() <= WIDTH), "{text}");
        // The shell reads the lines of a command as the command in one line.
        let lines: Vec<&str> =
            text.lines().filter(|line| line.starts_with("    ") && !line.starts_with("     ")).collect();
        let joined = lines.iter().map(|line| line.trim()).collect::<Vec<_>>().join(" ");
        assert_eq!(joined, format!("{long} {rates}"));
        assert!(lines.iter().all(|line| line.ends_with("&&")
            || line.ends_with(';')
            || long.ends_with(line.trim())
            || rates.ends_with(line.trim())));
    }
}
