//! What a person is asked before something is done.

use std::io::{self, BufRead, Write};

use super::fit;
use super::printable::printable;

/// Whether a person answers yes.
pub(super) fn agreed(what: &str) -> bool {
    let columns = fit::columns(io::stderr()).unwrap_or(fit::USUAL);
    let question = fit::fitted(&printable(&format!("{what}. Go on? [yes/no]")), columns);
    matches!(answer(&mut io::stdin().lock(), &mut io::stderr(), &question).as_deref(), Some("y" | "yes"))
}

/// What a person answers to a question, without the spaces around it; `None` where nobody answers.
pub(super) fn answer(from: &mut dyn BufRead, to: &mut dyn Write, question: &str) -> Option<String> {
    let mut line = String::new();
    let asked = write!(to, "{question} ").and_then(|()| to.flush());
    match asked.and_then(|()| from.read_line(&mut line)) {
        Ok(read) if read > 0 => Some(line.trim().to_owned()),
        // The next line is none of an answer.
        _ => writeln!(to).ok().and(None),
    }
}
