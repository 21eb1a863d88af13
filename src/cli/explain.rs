//! `yieldwall explain`: what a fault, an error code, an SDO abort code or a statusword means, in the words of every other command.

use serde_json::{Value, json};
use yieldwall_drives::cia402::Statusword;

use super::failure::{Exit, Failure};
use super::faults;
use super::output::Output;
use crate::canopen::EmcyCode;
use crate::config;
use crate::guard::fault::{Row, TABLE};
use crate::injection::{CATALOGUE, Kind};
use crate::objects::AbortCode;

/// Greatest code of two bytes: an error code or a statusword. Above it is an abort code.
const TWO_BYTES: u32 = 0xffff;
/// Bits of a statusword that say something beside its state, with what they say.
const BITS: [(u16, &str); 7] = [
    (Statusword::VOLTAGE_ENABLED, "the power stage has voltage"),
    (Statusword::WARNING, "warning"),
    (Statusword::REMOTE, "the controlword is processed"),
    (Statusword::TARGET_REACHED, "target reached"),
    (Statusword::INTERNAL_LIMIT, "an internal limit is active"),
    (Statusword::FOLLOWS_COMMAND, "cyclic synchronous modes: the drive follows the set-point"),
    (Statusword::FOLLOWING_ERROR, "cyclic synchronous position: following error"),
];

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Faults by name, such as node-reset; codes in hexadecimal as they are printed, such as 8130h, 0x8130 or 06090011
    #[arg(value_name = "FAULT|CODE", required = true)]
    words: Vec<String>,
}

/// One meaning of a word.
struct Meaning {
    what: &'static str,
    lines: Vec<(&'static str, String)>,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let mut explained = Vec::new();
    for word in &arguments.words {
        explained.push((word, meanings(word)?));
    }
    if output.is_json() {
        let document = |(word, meanings): &(&String, Vec<Meaning>)| {
            let each = meanings.iter().map(|meaning| {
                let lines = meaning.lines.iter().map(|(key, text)| ((*key).to_owned(), Value::from(text.as_str())));
                let mut keys: serde_json::Map<String, Value> = lines.collect();
                keys.insert("what".to_owned(), meaning.what.into());
                Value::Object(keys)
            });
            json!({ "word": word, "meanings": each.collect::<Vec<_>>() })
        };
        return output.report(json!({ "explained": explained.iter().map(document).collect::<Vec<_>>() }));
    }
    let mut text = String::new();
    for (word, meanings) in &explained {
        for Meaning { what, lines } in meanings {
            text.push_str(&format!("{word}: {what}\n"));
            lines.iter().for_each(|(key, line)| text.push_str(&format!("    {key:8} {line}\n")));
        }
    }
    output.result(&text)
}

/// All that a word may stand for.
fn meanings(word: &str) -> Result<Vec<Meaning>, Failure> {
    let fault = TABLE.iter().find(|row| row.name == word).map(of_fault);
    let injection = Kind::named(word).map(|kind| Meaning {
        what: "a fault to inject, `yieldwall run RIG.yaml --fault`",
        lines: vec![("meaning", kind.row().meaning.to_owned()), ("then", faults::consequence(kind.row()))],
    });
    let named: Vec<Meaning> = fault.into_iter().chain(injection).collect();
    if !named.is_empty() {
        return Ok(named);
    }
    let Some(code) = code(word) else { return Err(unknown(word)) };
    if code > TWO_BYTES {
        let abort = AbortCode(code);
        let lines = vec![
            ("code", format!("{code:08X}h {}", abort.name())),
            ("meaning", abort.meaning().to_owned()),
            ("cause", abort.likely_cause().to_owned()),
        ];
        return Ok(vec![Meaning { what: "an SDO abort code", lines }]);
    }
    let error = EmcyCode(code as u16);
    let lines = vec![("code", format!("{code:04X}h")), ("meaning", error.meaning().to_owned())];
    let of_error = Meaning { what: "an error code, of an emergency message or in 603Fh", lines };
    let of_status = Statusword(code as u16);
    let state = of_status.state().map_or("no state of CiA 402".to_owned(), |state| format!("{state:?}"));
    let bits: Vec<&str> = BITS.iter().filter(|(bit, _)| of_status.has(*bit)).map(|(_, says)| *says).collect();
    let bits = if bits.is_empty() { "none of those beside the state".to_owned() } else { bits.join("; ") };
    let of_status = Meaning { what: "a statusword (6041h)", lines: vec![("state", state), ("bits", bits)] };
    Ok(vec![of_error, of_status])
}

fn of_fault(row: &Row) -> Meaning {
    let lines = vec![
        ("stage", format!("{:?}", row.stage).to_lowercase()),
        ("meaning", row.meaning.to_owned()),
        ("cause", row.cause.to_owned()),
        ("next", row.next.to_owned()),
    ];
    Meaning { what: "a fault of the rig", lines }
}

/// A code as the program prints one, or as others do: in hexadecimal.
fn code(word: &str) -> Option<u32> {
    let lower = word.to_ascii_lowercase();
    let digits = lower.strip_prefix("0x").unwrap_or_else(|| lower.strip_suffix('h').unwrap_or(&lower));
    let is_code = (1..=8).contains(&digits.len()) && digits.bytes().all(|one| one.is_ascii_hexdigit());
    is_code.then(|| u32::from_str_radix(digits, 16).ok()).flatten()
}

fn unknown(word: &str) -> Failure {
    let names = TABLE.iter().map(|row| row.name).chain(CATALOGUE.iter().map(|row| row.name));
    let help = match config::nearest_word(word, names) {
        Some(meant) => format!("did you mean {meant}?"),
        None => {
            "`yieldwall faults` lists those that can be injected, docs/faults.md all; codes are hexadecimal".to_owned()
        }
    };
    Failure::new(Exit::Usage, format!("{word} is neither the name of a fault nor a code"), help)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(word: &str) -> String {
        let found = meanings(word).unwrap_or_else(|failure| panic!("{word}: {failure:?}"));
        found.iter().flat_map(|meaning| &meaning.lines).map(|(key, text)| format!("{key}: {text}\n")).collect()
    }

    /// Every fault of the table and every injection, in the words that `run` says of them.
    #[test]
    fn faults_and_injections_are_explained_in_the_words_of_run() {
        for row in &TABLE {
            let text = text(row.name);
            assert!([row.meaning, row.cause, row.next].iter().all(|words| text.contains(words)), "{text}");
        }
        for row in CATALOGUE {
            assert!(text(row.name).contains(row.meaning), "{}", row.name);
        }
    }

    #[test]
    fn codes_are_explained_however_they_are_written() {
        for word in ["8130h", "0x8130", "8130", "0X8130", "8130H"] {
            assert!(text(word).contains("meaning: heartbeat or life guarding lost"), "{word}");
        }
        for code in AbortCode::ALL {
            let text = text(&format!("{:08X}h", code.0));
            assert!(text.contains(code.meaning()) && text.contains(code.likely_cause()), "{text}");
        }
        assert!(text("0x0637").contains("state: OperationEnabled"), "{}", text("0x0637"));
        assert!(text("1208h").contains("state: Fault"), "{}", text("1208h"));
        for word in ["node-rest", "xyzzy", "", "123456789", "-1", "8130x"] {
            assert!(meanings(word).is_err(), "{word}");
        }
    }
}
