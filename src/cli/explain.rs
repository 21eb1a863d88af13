//! `yieldwall explain`: the meaning of a fault, an error code, an SDO abort code, a statusword, an object or a value, in the words
//! of every other command.

use std::sync::Arc;

use serde_json::{Map, Value, json};
use textwrap::{Options, WordSeparator, WordSplitter};
use yieldwall_drives::cia402::{State, Statusword};
use yieldwall_drives::codes::ErrorCodes;

use self::values::{object, readings};
use super::desk::address;
use super::failure::{Exit, Failure, both};
use super::faults;
use super::output::Output;
use yieldwall_config::injection::{CATALOGUE, DEFECTS, DefectKind, DefectSize, Kind};
use yieldwall_config::{self as config, ProfileName, Rig, SensorProtocol, Source};
use yieldwall_fieldbus::canopen::EmcyCode;
use yieldwall_fieldbus::ethercat::AlStatusCode;
use yieldwall_fieldbus::objects::{AbortCode, Address};
use yieldwall_motion::guard::fault::TABLE;
use yieldwall_run::explanation::{self, Explanation};
use yieldwall_service::{known, named, names};

/// Greatest code of two bytes: an error code or a statusword. Above it is an abort code.
const TWO_BYTES: u32 = 0xffff;
/// Columns of a terminal.
const COLUMNS: usize = 80;
/// Columns before the text of a meaning.
const KEY: usize = 9;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Faults, defects, codes and objects by name, or codes in hexadecimal
    ///
    /// Names are such as node-reset, backlash, no-sub-index or statusword. Codes and values are hexadecimal, as printed: 8130h, 0x8130 or
    /// 06090011. Objects may have an address, such as 1018h:2. Symbols such as R, keys such as fixture.yield_n, exit codes such as exit-7,
    /// commands and their steps are explained too.
    #[arg(value_name = "NAME|CODE", required = true)]
    words: Vec<String>,
    /// Device profile, by name or .yaml file, whose error-code table applies
    #[arg(long, value_name = "PROFILE", conflicts_with = "rig")]
    profile: Option<String>,
    /// Rig whose device reported the codes; --node names the device
    #[arg(long, value_name = "RIG.yaml", requires = "node")]
    rig: Option<String>,
    /// Device in the rig, by name or node id
    #[arg(long, requires = "rig")]
    node: Option<String>,
}

/// A meaning of a word, and its data besides the explanation.
struct Meaning {
    explanation: Explanation,
    more: Vec<(&'static str, String)>,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let codes = codes(arguments, output)?;
    let mut explained = Vec::new();
    let words = match program::is_command(&arguments.words) {
        true => vec![arguments.words.join(" ")],
        false => arguments.words.clone(),
    };
    let mut end = Ok(());
    for word in &words {
        match meanings(word, codes.as_deref()) {
            Ok(meanings) => explained.push((word, meanings)),
            Err(failure) => end = both(end, Err(failure)),
        }
    }
    if output.is_json() {
        let document = |(word, meanings): &(&String, Vec<Meaning>)| {
            let each = meanings.iter().map(|Meaning { explanation, more }| {
                let mut keys = document(explanation);
                keys.extend(more.iter().map(|(key, text)| ((*key).to_owned(), Value::from(text.replace('\n', "; ")))));
                Value::Object(keys)
            });
            json!({ "word": word, "meanings": each.collect::<Vec<_>>() })
        };
        return output.end(json!({ "explained": explained.iter().map(document).collect::<Vec<_>>() }), end);
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
    output.result(&text)?;
    end
}

/// Returns cause, next step and source, a paragraph each, `indent` columns from the left.
pub(super) fn lines(indent: usize, explanation: &Explanation) -> String {
    let mut text = line(indent, "cause", &explanation.cause) + &line(indent, "next", &explanation.next);
    if let Some(source) = &explanation.source {
        text.push_str(&line(indent, "source", source));
    }
    text
}

/// Returns a key and its text, in 80 columns.
pub(super) fn line(indent: usize, key: &str, text: &str) -> String {
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

/// Returns an explanation as data: `what`, `code`, `name`, `meaning`, `cause`, `next`, `source`.
pub(super) fn document(explanation: &Explanation) -> Map<String, Value> {
    let Explanation { what, code, name, meaning, cause, next, source } = explanation;
    let keys = [
        ("what", json!(what)),
        ("code", json!(code)),
        ("name", json!(name)),
        ("meaning", json!(meaning.replace('\n', "; "))),
        ("cause", json!(cause)),
        ("next", json!(next.replace('\n', "; "))),
        ("source", json!(source)),
    ];
    keys.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

/// Returns the table of the selected device; without a device, the standards alone.
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

/// Returns the CANopen devices of a rig: name, node id and model.
fn devices(rig: &Rig) -> Vec<(&str, u8, &ProfileName)> {
    let drives = rig.drives.iter();
    let drives = drives.filter_map(|drive| Some((drive.name.as_str(), drive.address.node_id()?, &drive.profile)));
    let mut devices: Vec<_> = drives.collect();
    if let SensorProtocol::Canopen { node_id, profile, .. } = &rig.sensor.protocol {
        devices.push((&rig.sensor.name, *node_id, profile));
    }
    devices
}

/// Returns all meanings of a word.
fn meanings(word: &str, codes: Option<&ErrorCodes>) -> Result<Vec<Meaning>, Failure> {
    let fault = TABLE.iter().find(|row| row.name == word).map(|row| Meaning {
        explanation: explanation::fault(row.fault),
        more: vec![("stage", format!("{:?}", row.stage).to_lowercase())],
    });
    let injection = Kind::named(word).map(|kind| Meaning {
        explanation: explanation::injection(kind),
        more: vec![("then", faults::consequence(kind.row()))],
    });
    let plain = |explanation| Meaning { explanation, more: Vec::new() };
    let defect = DefectKind::named(word).map(|kind| Meaning {
        explanation: explanation::defect(kind),
        more: kind.row().size.map(|size| ("size", size_words(&size))).into_iter().collect(),
    });
    let abort = AbortCode::ALL.iter().find(|code| code.name() == word).map(|code| explanation::abort(*code));
    let of_vendor = codes.and_then(|table| table.codes.iter().find(|code| code.name == word)).map(|code| code.code);
    let error = of_vendor.or_else(|| EmcyCode::listed().find(|code| code.name() == word).map(|code| code.0));
    let error = error.map(|code| explanation::error_code(code, codes));
    // A short hexadecimal number is no name.
    let objects = if code(word).is_none() { named(word, None) } else { Vec::new() };
    let own = program::explained(word).into_iter().map(plain);
    let named = own.chain(fault).chain(injection).chain(defect);
    let named = named.chain(abort.into_iter().chain(error).chain(objects.into_iter().map(object)).map(plain));
    let named: Vec<Meaning> = named.collect();
    if !named.is_empty() {
        return Ok(named);
    }
    let explained = match (code(word), address(word)) {
        (Some(code), _) if code > TWO_BYTES => readings(code),
        (Some(code), _) => of_two_bytes(code as u16, codes),
        (None, Some(at)) => vec![object(at)],
        (None, None) => return Err(unknown(word, codes)),
    };
    Ok(explained.into_iter().map(plain).collect())
}

fn size_words(size: &DefectSize) -> String {
    format!("{}, {} unless it is given, from {} to {}", size.what, size.usual, size.least, size.most)
}

/// Returns the possible readings of a word of two bytes, the most likely first: an error code, an AL status code, an object, a
/// statusword. An unlikely reading appears only if there is no other one.
fn of_two_bytes(code: u16, codes: Option<&ErrorCodes>) -> Vec<Explanation> {
    let of_error = explanation::error_code(code, codes);
    // A person who names the device means its error codes.
    if of_error.source.is_some() {
        return vec![of_error];
    }
    let of_ethercat = explanation::al_status(AlStatusCode(code)).filter(|_| code != 0);
    let has_class = EmcyCode(code).name() != EmcyCode(UNKNOWN_CODE).name();
    let is_listed = EmcyCode::listed().any(|listed| listed.0 == code);
    let (listed, of_class) = match is_listed {
        true => (Some(of_error.clone()), None),
        false => (None, Some(of_error.clone()).filter(|_| has_class && of_ethercat.is_none())),
    };
    let objects = named_objects(code).into_iter().map(object);
    // A drive passes through Not Ready to Switch On in no time.
    let state = Statusword(code).state().filter(|state| *state != State::NotReadyToSwitchOn);
    let of_status = explanation::statusword(code);
    let likely: Vec<Explanation> = listed
        .into_iter()
        .chain(of_ethercat)
        .chain(objects)
        .chain(of_class)
        .chain(state.map(|_| of_status.clone()))
        .collect();
    if likely.is_empty() { vec![of_error, of_status] } else { likely }
}

/// A code of no class of CiA 301.
const UNKNOWN_CODE: u16 = 0x0200;

/// Returns the objects of the standards at an index, the first of them.
fn named_objects(index: u16) -> Vec<Address> {
    let first = [0, 1].into_iter().map(|sub| Address::new(index, sub)).find(|at| known(*at, None).is_some());
    first.filter(|_| index >= 0x1000).into_iter().collect()
}

/// Returns a code as the program prints one, or as others do: in hexadecimal.
fn code(word: &str) -> Option<u32> {
    let lower = word.to_ascii_lowercase();
    let digits = lower.strip_prefix("0x").unwrap_or_else(|| lower.strip_suffix('h').unwrap_or(&lower));
    // A bare digit or letter is rather a slip in a symbol.
    let least = if digits.len() == lower.len() { 2 } else { 1 };
    let is_code = (least..=8).contains(&digits.len()) && digits.bytes().all(|one| one.is_ascii_hexdigit());
    is_code.then(|| u32::from_str_radix(digits, 16).ok()).flatten()
}

fn unknown(word: &str, codes: Option<&ErrorCodes>) -> Failure {
    let objects = names(None);
    let of_vendor = codes.into_iter().flat_map(|table| &table.codes).map(|code| code.name.as_str());
    let mut names: Vec<&str> = objects.iter().map(String::as_str).chain(of_vendor).collect();
    names.extend(TABLE.iter().map(|row| row.name));
    names.extend(CATALOGUE.iter().map(|row| row.name));
    names.extend(DEFECTS.iter().map(|row| row.name));
    names.extend(AbortCode::ALL.iter().map(|code| code.name()));
    names.extend(EmcyCode::listed().map(|code| code.name()));
    let meant = config::nearest_word(word, names).map(|meant| format!("did you mean {meant}?"));
    let help = match meant.or_else(|| program::similar(word)) {
        Some(help) => help,
        None => {
            "docs/faults.md lists the faults; write codes as 8130h, objects as 1018h:2, keys as fixture.yield_n, and exit codes as exit-7"
                .to_owned()
        }
    };
    Failure::new(
        Exit::Usage,
        format!(
            "nothing is known of {word}: it is no code, symbol, key, command or step, and no fault, defect or object"
        ),
        help,
    )
}

mod program;
#[cfg(test)]
mod tests;
mod values;
