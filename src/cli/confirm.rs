//! What a person is asked before something is done.

use std::io::{BufRead, Write};

/// Whether a person answers yes.
pub(super) fn agreed(what: &str) -> bool {
    let mut line = String::new();
    // Who cannot be asked has not agreed.
    let asked = write!(std::io::stderr(), "{}. Go on? [yes/no] ", super::printable::printable(what));
    asked.is_ok() && std::io::stdin().lock().read_line(&mut line).is_ok() && matches!(line.trim(), "y" | "yes")
}
