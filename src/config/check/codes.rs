//! Checks of a table of error codes against itself.

use yieldwall_drives::codes::{self, ErrorCodes};

use super::Findings;
use crate::suggest::nearest;

/// All rules of a table of error codes.
pub(crate) fn check_error_codes(findings: &mut Findings, table: &ErrorCodes) {
    for (index, code) in table.codes.iter().enumerate() {
        let key = format!("codes[{index}]");
        if let Some(first) = table.codes.iter().take(index).position(|other| other.code == code.code) {
            let message = format!("`{key}.code` is {:04X}h, as that of `codes[{first}]` is", code.code);
            findings
                .error(&format!("{key}.code"), message, "a code has one meaning: leave out one")
                .see(&format!("codes[{first}].code"), "the first one");
        }
        for (part, text) in
            [("name", &code.name), ("meaning", &code.meaning), ("cause", &code.cause), ("next", &code.next)]
        {
            if text.chars().any(char::is_control) {
                let at = format!("{key}.{part}");
                findings.error(&at, format!("`{at}` has a control character"), "write it on one line");
            }
        }
        if !table.error_codes.sources.contains_key(&code.source) {
            let names: Vec<&str> = table.error_codes.sources.keys().map(String::as_str).collect();
            let at = format!("{key}.source");
            let message = format!("`{at}` is `{}`, which is not among `error_codes.sources`", code.source);
            let help = format!("the sources are {}", names.join(", "));
            findings.error(&at, message, help).see("error_codes.sources", "sources");
        }
    }
}

/// Refuses an unknown table of error codes.
pub(crate) fn refuse_error_codes(findings: &mut Findings, key: &str, name: &str) {
    let known = || codes::SHIPPED.iter().map(|(name, _)| *name);
    let help = match nearest(name, known()) {
        Some(meant) => format!("did you mean `{meant}`?"),
        None => format!("the tables are {}; or name a file that ends in .yaml", known().collect::<Vec<_>>().join(", ")),
    };
    findings.error(key, format!("`{key}` is `{name}`, which is not known"), help);
}
