//! `yieldwall explain`: what a fault, an error code, an SDO abort code or a statusword means, in the words of every other command.

use std::sync::Arc;

use serde_json::{Map, Value, json};
use textwrap::{Options, WordSeparator, WordSplitter};
use yieldwall_drives::codes::ErrorCodes;

use super::failure::{Exit, Failure};
use super::faults;
use super::output::Output;
use crate::config::{self, ProfileName, Rig, SensorProtocol, Source};
use crate::ethercat::AlStatusCode;
use crate::explanation::{self, Explanation};
use crate::guard::fault::TABLE;
use crate::injection::{CATALOGUE, Kind};
use crate::objects::AbortCode;

/// Greatest code of two bytes: an error code or a statusword. Above it is an abort code.
const TWO_BYTES: u32 = 0xffff;
/// Columns of a terminal.
const COLUMNS: usize = 80;
/// Columns before what is said of a meaning.
const KEY: usize = 9;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Faults by name, such as node-reset; codes in hexadecimal as they are printed, such as 8130h, 0x8130 or 06090011
    #[arg(value_name = "FAULT|CODE", required = true)]
    words: Vec<String>,
    /// The device profile by whose table of error codes the codes are meant: its name, or its file (.yaml)
    #[arg(long, value_name = "PROFILE", conflicts_with = "rig")]
    profile: Option<String>,
    /// The rig whose device has shown the codes; --node says which
    #[arg(long, value_name = "RIG.yaml", requires = "node")]
    rig: Option<String>,
    /// The device in the rig: its name or its node id
    #[arg(long, requires = "rig")]
    node: Option<String>,
}

/// One meaning of a word, and what it has beside the explanation.
struct Meaning {
    explanation: Explanation,
    more: Vec<(&'static str, String)>,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let codes = codes(arguments, output)?;
    let mut explained = Vec::new();
    for word in &arguments.words {
        explained.push((word, meanings(word, codes.as_deref())?));
    }
    if output.is_json() {
        let document = |(word, meanings): &(&String, Vec<Meaning>)| {
            let each = meanings.iter().map(|Meaning { explanation, more }| {
                let mut keys = document(explanation);
                keys.extend(more.iter().map(|(key, text)| ((*key).to_owned(), Value::from(text.as_str()))));
                Value::Object(keys)
            });
            json!({ "word": word, "meanings": each.collect::<Vec<_>>() })
        };
        return output.report(json!({ "explained": explained.iter().map(document).collect::<Vec<_>>() }));
    }
    let mut text = String::new();
    for (word, meanings) in &explained {
        for Meaning { explanation, more } in meanings {
            text.push_str(&format!("{word}: {}\n", explanation.what));
            text.push_str(&line(4, "name", &explanation.name));
            more.iter().for_each(|(key, says)| text.push_str(&line(4, key, says)));
            text.push_str(&line(4, "meaning", &explanation.meaning));
            text.push_str(&lines(4, explanation));
        }
    }
    output.result(&text)
}

/// Cause, what to do next and source, a paragraph each, `indent` columns from the left.
pub(super) fn lines(indent: usize, explanation: &Explanation) -> String {
    let mut text = line(indent, "cause", &explanation.cause) + &line(indent, "next", &explanation.next);
    if let Some(source) = &explanation.source {
        text.push_str(&line(indent, "source", source));
    }
    text
}

/// A key and what is said of it, in 80 columns.
fn line(indent: usize, key: &str, text: &str) -> String {
    if text.is_empty() {
        return String::new();
    }
    let (first, rest) = (format!("{:indent$}{key:KEY$}", ""), " ".repeat(indent + KEY));
    let options = Options::new(COLUMNS)
        .initial_indent(&first)
        .subsequent_indent(&rest)
        .word_separator(WordSeparator::AsciiSpace)
        .word_splitter(WordSplitter::NoHyphenation);
    textwrap::fill(text, options) + "\n"
}

/// An explanation as data: `what`, `code`, `name`, `meaning`, `cause`, `next`, `source`.
pub(super) fn document(explanation: &Explanation) -> Map<String, Value> {
    let Explanation { what, code, name, meaning, cause, next, source } = explanation;
    let keys = [
        ("what", json!(what)),
        ("code", json!(code)),
        ("name", json!(name)),
        ("meaning", json!(meaning)),
        ("cause", json!(cause)),
        ("next", json!(next)),
        ("source", json!(source)),
    ];
    keys.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

/// The table of the device that is meant; the standards alone without one.
fn codes(arguments: &Arguments, output: &mut Output) -> Result<Option<Arc<ErrorCodes>>, Failure> {
    if let Some(name) = &arguments.profile {
        return Ok(config::load_named_profile(name)?.error_codes().cloned());
    }
    let (Some(rig), Some(node)) = (&arguments.rig, &arguments.node) else { return Ok(None) };
    let rig = config::load_rig(Source::named(rig))?;
    output.names_of(&rig.warnings)?;
    let devices = devices(&rig.value);
    if let Some((.., profile)) = devices.iter().find(|(name, id, _)| name == node || id.to_string() == *node) {
        return Ok(profile.error_codes().cloned());
    }
    let names: Vec<&str> = devices.iter().map(|(name, ..)| *name).collect();
    let message = format!("{node} is no CANopen device of the rig {}", rig.value.rig.name);
    Err(Failure::new(Exit::Usage, message, format!("its devices are {}", names.join(", "))))
}

/// The CANopen devices of a rig: name, node id and model.
fn devices(rig: &Rig) -> Vec<(&str, u8, &ProfileName)> {
    let drives = rig.drives.iter();
    let drives = drives.filter_map(|drive| Some((drive.name.as_str(), drive.address.node_id()?, &drive.profile)));
    let mut devices: Vec<_> = drives.collect();
    if let SensorProtocol::Canopen { node_id, profile, .. } = &rig.sensor.protocol {
        devices.push((&rig.sensor.name, *node_id, profile));
    }
    devices
}

/// All that a word may stand for.
fn meanings(word: &str, codes: Option<&ErrorCodes>) -> Result<Vec<Meaning>, Failure> {
    let fault = TABLE.iter().find(|row| row.name == word).map(|row| Meaning {
        explanation: explanation::fault(row.fault),
        more: vec![("stage", format!("{:?}", row.stage).to_lowercase())],
    });
    let injection = Kind::named(word).map(|kind| Meaning {
        explanation: explanation::injection(kind),
        more: vec![("then", faults::consequence(kind.row()))],
    });
    let named: Vec<Meaning> = fault.into_iter().chain(injection).collect();
    if !named.is_empty() {
        return Ok(named);
    }
    let plain = |explanation| Meaning { explanation, more: Vec::new() };
    match code(word) {
        None => Err(unknown(word)),
        Some(code) if code > TWO_BYTES => Ok(vec![plain(explanation::abort(AbortCode(code)))]),
        Some(code) => {
            let code = code as u16;
            let of_error = explanation::error_code(code, codes);
            // Whoever names the device means its error codes.
            if of_error.source.is_some() {
                return Ok(vec![plain(of_error)]);
            }
            let of_ethercat = explanation::al_status(AlStatusCode(code)).filter(|_| code != 0);
            let of_error = Some(of_error).filter(|_| of_ethercat.is_none());
            let all = of_ethercat.into_iter().chain(of_error).chain([explanation::statusword(code)]);
            Ok(all.map(plain).collect())
        }
    }
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
mod tests;
