//! `yieldwall emcy`: the errors that devices have stored, in words.

use serde_json::{Value, json};

use super::keeping::back_up;
use super::place::{BusArguments, DeviceSession, Node};
use super::reached::DeviceHandle;
use super::segment::{self, SegmentSession};
use crate::explain;
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_fieldbus::canopen::{BusId, PastError};
use yieldwall_fieldbus::objects::Address;
use yieldwall_run::explanation::Explanation;
use yieldwall_service::{Bytes, Error, number, scan};

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Node id, EtherCAT position, or device name from the rig; default: all that answer
    node: Option<String>,
    /// Save the device's stored errors to a file, then clear them
    #[arg(long, requires = "node")]
    clear: bool,
    /// Print what would be written, and write nothing
    #[arg(long, requires = "clear")]
    dry_run: bool,
    #[command(flatten)]
    place: BusArguments,
}

/// Number of stored errors.
const HISTORY: Address = Address::new(0x1003, 0);
/// Largest number of stored errors that are read.
const MOST: u8 = 32;

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    if let (true, Some(word)) = (arguments.clear, &arguments.node) {
        return forget(word, arguments, output);
    }
    if let Some(desk) = SegmentSession::open(&arguments.place, output)? {
        return segment::emcy::run(arguments.node.as_deref(), desk, output);
    }
    let mut desk = DeviceSession::open(&arguments.place, output)?;
    let nodes: Vec<(BusId, Node)> = match &arguments.node {
        Some(word) => {
            let node = desk.node(word)?;
            vec![(desk.service.bus(), node)]
        }
        None => {
            let mut nodes = Vec::new();
            for (bus, _) in desk.buses.clone() {
                desk.service.turn_to(bus);
                let found = scan(&mut desk.service).map_err(|error| desk.bus_failure(error))?;
                let answering = found.iter().filter(|found| found.device_type.is_some());
                nodes.extend(answering.map(|found| (bus, Node::of(found.node, desk.entry(found.node).cloned()))));
            }
            nodes
        }
    };
    let mut lines = String::new();
    let mut documents = Vec::new();
    for (bus, node) in &nodes {
        desk.service.turn_to(*bus);
        let errors = history(&mut |at| desk.service.read(node.id, at))
            .map_err(|error| desk.failure(node, "reading its stored errors", error))?;
        lines.push_str(&text(&node.words(), errors.as_deref(), |code| desk.explained(node, code)));
        documents.push(document(&desk, node, errors.as_deref()));
    }
    if output.is_json() {
        return output.report(json!({ "place": desk.place, "nodes": documents }));
    }
    output.result(&lines)
}

/// Returns the text on a device's stored errors.
pub(super) fn text(words: &str, errors: Option<&[PastError]>, explained: impl Fn(u16) -> Explanation) -> String {
    let said = match errors {
        None => "keeps no errors (it has no 1003h)".to_owned(),
        Some([]) => "no errors stored".to_owned(),
        Some(errors) => format!("{} stored, the latest first", errors.len()),
    };
    let mut lines = format!("{words}: {said}\n");
    let mut known = Vec::new();
    for error in errors.into_iter().flatten() {
        let explained = explained(error.code.0);
        lines.push_str(&format!(
            "  {:04X}h {}, information {:04X}h\n",
            error.code.0, explained.meaning, error.information
        ));
        // What it means is said once of each.
        if !known.contains(&error.code) {
            lines.push_str(&explain::lines(8, &explained));
            known.push(error.code);
        }
    }
    lines
}

/// Returns the errors that a device has stored, the latest first; `None` if it stores none.
pub(super) fn history(read: &mut dyn FnMut(Address) -> Result<Bytes, Error>) -> Result<Option<Vec<PastError>>, Error> {
    let count = match read(HISTORY) {
        Ok(bytes) => number(&bytes) as u8,
        Err(Error::Refused(_)) => return Ok(None),
        Err(error) => return Err(error),
    };
    let mut errors = Vec::new();
    for sub in 1..=count.min(MOST) {
        match read(Address::new(HISTORY.index, sub)) {
            Ok(bytes) => errors.push(PastError::from_entry(number(&bytes))),
            Err(Error::Refused(_)) => break,
            Err(error) => return Err(error),
        }
    }
    Ok(Some(errors))
}

/// Returns the stored errors as data.
pub(super) fn stored(errors: Option<&[PastError]>, explained: impl Fn(u16) -> Explanation) -> Value {
    let each = |error: &PastError| {
        let mut keys = explain::document(&explained(error.code.0));
        keys.insert("information".to_owned(), error.information.into());
        Value::Object(keys)
    };
    errors.map_or(Value::Null, |errors| errors.iter().map(each).collect())
}

fn document(desk: &DeviceSession, node: &Node, errors: Option<&[PastError]>) -> Value {
    json!({
        "node_id": node.id.raw(),
        "name": node.entry.as_ref().map(|entry| entry.name.clone()),
        "errors": stored(errors, |code| desk.explained(node, code)),
    })
}

/// Clears a device's stored errors, if there are any, after they were saved to a file.
fn forget(word: &str, arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let mut reached = DeviceHandle::open(&arguments.place, word, output)?;
    let errors = history(&mut |at| reached.read(at));
    let errors = errors.map_err(|error| reached.failure("reading its stored errors", error))?;
    let explained = |code| reached.explained(code);
    let told = text(&reached.words(), errors.as_deref(), explained);
    let (key, list) = (reached.named().key(), if reached.is_on_can() { "nodes" } else { "devices" });
    let mut device = json!({ "name": reached.name(), "errors": stored(errors.as_deref(), explained) });
    device[key] = reached.number().into();
    let mut document = json!({ "place": reached.place(), "dry_run": arguments.dry_run });
    document[list] = json!([device]);
    let errors = errors.unwrap_or_default();
    if !errors.is_empty() {
        clear(&mut reached, &errors, arguments.dry_run, output)?;
    }
    if output.is_json() { output.report(document) } else { output.result(&told) }
}

fn clear(reached: &mut DeviceHandle, errors: &[PastError], is_dry: bool, output: &mut Output) -> Result<(), Failure> {
    if is_dry {
        return output.news("would write 1003h:0 error-history 00h");
    }
    let entry =
        |error: &PastError| (u32::from(error.information) << 16 | u32::from(error.code.0)).to_le_bytes().to_vec();
    let values: Vec<_> =
        (1..).zip(errors).map(|(sub, error)| (Address::new(HISTORY.index, sub), entry(error))).collect();
    if let Some(path) = back_up(reached.is_simulated(), reached.named(), &values, None)? {
        output.news(&format!("kept      {}", path.display()))?;
    }
    let cleared = reached.objects()?.write(HISTORY, &[0]);
    cleared.map_err(|error| reached.failure("clearing its stored errors", error))?;
    output.news(&format!("cleared   {}", reached.words()))
}
