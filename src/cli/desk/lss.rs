//! `yieldwall lss`: node ids for devices that have none or the wrong one.

use std::time::Duration;

use serde_json::{Value, json};

use super::place::{BusArguments, DeviceSession};
use super::words::wrapped;
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_fieldbus::canopen::lss::{LssAddress, LssOutcome, LssRequest};
use yieldwall_fieldbus::canopen::node_id;
use yieldwall_fieldbus::objects::Address;
use yieldwall_service::{Error, identify};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Find a device without a node id, and print its identity
    Find(Find),
    /// Set a device's node id from its next reset on; --save keeps it at power-off
    SetId(SetId),
}

#[derive(Debug, clap::Args)]
pub(crate) struct Find {
    #[command(flatten)]
    place: BusArguments,
}

#[derive(Debug, clap::Args)]
pub(crate) struct SetId {
    /// Present node id, device name from the rig, or `new` for the device without a node id
    device: String,
    /// New node id, 1 to 127
    #[arg(value_parser = clap::value_parser!(u8).range(1..=127))]
    node_id: u8,
    /// Store the node id in the device, to survive power-off
    #[arg(long)]
    save: bool,
    /// Print what would be sent, and send only the search
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    place: BusArguments,
}

/// Longest time that a device may take to answer. In a search, silence is an answer too: there are 133 silences.
const ANSWER: Duration = Duration::from_millis(200);
const SEARCH: Duration = Duration::from_millis(20);

pub(crate) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    match command {
        Command::Find(arguments) => find(arguments, output),
        Command::SetId(arguments) => set_id(arguments, output),
    }
}

fn ask(desk: &mut DeviceSession, request: LssRequest, timeout: Duration) -> Result<LssOutcome, Failure> {
    desk.service.lss(request, timeout).map_err(|error| desk.bus_failure(error))
}

/// Returns the device without a node id, now in configuration.
fn unconfigured(desk: &mut DeviceSession) -> Result<Option<LssAddress>, Failure> {
    ask(desk, LssRequest::SwitchAll { to_configuration: false }, ANSWER)?;
    match ask(desk, LssRequest::Fastscan, SEARCH)? {
        LssOutcome::Identity(address) => Ok(Some(address)),
        _ => Ok(None),
    }
}

fn find(arguments: &Find, output: &mut Output) -> Result<(), Failure> {
    let mut desk = DeviceSession::open(&arguments.place, output)?;
    let found = unconfigured(&mut desk)?;
    ask(&mut desk, LssRequest::SwitchAll { to_configuration: false }, ANSWER)?;
    if output.is_json() {
        return output.report(json!({ "place": desk.place, "found": found.map(document) }));
    }
    let more = &desk.arguments;
    output.result(&match found {
        Some(address) => {
            let found = wrapped(&format!("a device without a node id: {}", words(address)));
            found + &wrapped(&format!("`yieldwall lss set-id new N{more}` gives it one"))
        }
        None => {
            wrapped(&format!("no device without a node id answers; `yieldwall scan{more}` shows those that have one"))
        }
    })
}

fn set_id(arguments: &SetId, output: &mut Output) -> Result<(), Failure> {
    let mut desk = DeviceSession::open(&arguments.place, output)?;
    let new = node_id(arguments.node_id).map_err(|error| Failure::new(Exit::Usage, error.to_string(), ""))?;
    let more = desk.arguments.clone();
    let no_device = || {
        Failure::new(
            Exit::DeviceMismatch,
            "no device without a node id answers",
            format!("`yieldwall scan{more}` shows those that have one"),
        )
    };
    let (address, who) = if arguments.device == "new" {
        (unconfigured(&mut desk)?.ok_or_else(no_device)?, "the device without a node id".to_owned())
    } else {
        let node = desk.node(&arguments.device)?;
        // A device that refuses to identify itself is there.
        if let Err(error @ Error::NoAnswer) = desk.service.read(node.id, Address::new(0x1000, 0)) {
            let mut failure = desk.failure(&node, "reading its identity", error);
            if let Some(help) = failure.report.diagnostics.first_mut().and_then(|finding| finding.help.as_mut()) {
                help.push_str(&format!("; `yieldwall lss find{more}` finds a device without a node id"));
            }
            return Err(failure);
        }
        let identity = identify(&mut desk.service, &[node.id]).map_err(|error| desk.bus_failure(error))?;
        let (parts, _) = identity.into_iter().next().unwrap_or_default();
        let [Some(vendor_id), Some(product_code), Some(revision), Some(serial)] = parts else {
            let message =
                format!("{} does not report all of its identity (1018h:1 to 4), by which LSS finds it", node.words());
            return Err(Failure::new(
                Exit::DeviceMismatch,
                message,
                "set its node id by its switches or with its maker's tool",
            ));
        };
        (LssAddress { vendor_id, product_code, revision, serial }, node.words())
    };
    if let Some(other) = taken(&mut desk, arguments, new)? {
        return Err(other);
    }
    if arguments.dry_run {
        ask(&mut desk, LssRequest::SwitchAll { to_configuration: false }, ANSWER)?;
        let text = wrapped(&format!("would give {who} ({}) the node id {}", words(address), new.raw()));
        return if output.is_json() {
            output.report(
                json!({ "place": desk.place, "dry_run": true, "device": document(address), "node_id": new.raw() }),
            )
        } else {
            output.result(&text)
        };
    }
    let select = ask(&mut desk, LssRequest::SwitchOne(address), ANSWER)?;
    let configured = match select {
        LssOutcome::Done => ask(&mut desk, LssRequest::ConfigureNodeId(Some(new)), ANSWER)?,
        other => other,
    };
    let stored = match (configured, arguments.save) {
        (LssOutcome::Done, true) => ask(&mut desk, LssRequest::Store, ANSWER)?,
        (other, _) => other,
    };
    ask(&mut desk, LssRequest::SwitchAll { to_configuration: false }, ANSWER)?;
    match stored {
        LssOutcome::Done => {}
        LssOutcome::Refused { error, detail } => {
            let message = format!("{who} refuses (error {error}, detail {detail})");
            return Err(Failure::new(Exit::DeviceMismatch, message, "it may not support LSS for this: see its manual"));
        }
        _ => {
            let message = format!("{who} does not answer LSS");
            return Err(Failure::new(
                Exit::DeviceMismatch,
                message,
                "set its node id by its switches or with its maker's tool",
            ));
        }
    }
    if output.is_json() {
        return output.report(
            json!({ "place": desk.place, "device": document(address), "node_id": new.raw(), "saved": arguments.save }),
        );
    }
    let next = if arguments.device == "new" { "" } else { ", from its next reset on" };
    let lasts = if arguments.save { "" } else { ", until power-off; --save makes it last" };
    let mut text = wrapped(&format!("{who} gets the node id {}{next}{lasts}", new.raw()));
    if arguments.save {
        text.push_str("stored    the device keeps it beyond power-off\n");
    }
    output.result(&text)
}

/// Returns the failure for a node id that another device has.
fn taken(
    desk: &mut DeviceSession,
    arguments: &SetId,
    new: yieldwall_fieldbus::canopen::NodeId,
) -> Result<Option<Failure>, Failure> {
    desk.service.set_patience(Duration::from_millis(300), 0);
    let answer = desk.service.read(new, Address::new(0x1000, 0));
    match answer {
        Err(Error::NoAnswer) => Ok(None),
        Ok(_)
        | Err(
            Error::Refused(_) | Error::Senseless(_) | Error::MayBeWritten | Error::TooLong(_) | Error::Boundless(_),
        ) => {
            let message = format!("a device has the node id {} already; nothing was set", arguments.node_id);
            Ok(Some(Failure::new(
                Exit::Usage,
                message,
                "two devices of one node id disturb each other: choose another",
            )))
        }
        Err(error) => Err(desk.bus_failure(error)),
    }
}

fn words(address: LssAddress) -> String {
    let LssAddress { vendor_id, product_code, revision, serial } = address;
    format!("vendor {vendor_id:08X}h product {product_code:08X}h revision {revision:08X}h serial {serial:08X}h")
}

fn document(address: LssAddress) -> Value {
    let LssAddress { vendor_id, product_code, revision, serial } = address;
    json!({ "vendor_id": vendor_id, "product_code": product_code, "revision": revision, "serial": serial })
}
