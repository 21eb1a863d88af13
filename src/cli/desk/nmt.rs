//! `yieldwall nmt`: the commands of network management.

use std::time::Duration;

use serde_json::json;

use super::place::{BusArguments, DeviceSession, Node};
use super::words::{nmt_words, wrapped};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_fieldbus::canopen::{NmtCommand, NmtState};
use yieldwall_fieldbus::objects::Address;
use yieldwall_service::Error;

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Node id, device name from the rig, or `all`
    node: String,
    /// NMT command to send
    #[arg(value_enum)]
    command: Command,
    /// Print what would be sent, and send nothing
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    place: BusArguments,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Command {
    /// Go to Operational: process data run. This alone does not move a drive
    Start,
    /// Go to Stopped: the device answers only heartbeats and NMT
    Stop,
    /// Go to Pre-operational: objects can be read and written, process data stop
    Preop,
    /// Reset node: restart the whole device
    Reset,
    /// Reset communication: restart the communication objects
    ResetComm,
}

/// Longest wait for a device that was reset.
const BOOT_UP: Duration = Duration::from_secs(5);
/// Longest time that any other command may take.
const SETTLING: Duration = Duration::from_millis(100);
/// Longest time in which a device has to answer whether it is there.
const ANSWER: Duration = Duration::from_millis(400);

impl Command {
    fn of_nmt(self) -> (NmtCommand, &'static str) {
        match self {
            Self::Start => (NmtCommand::StartRemoteNode, "start"),
            Self::Stop => (NmtCommand::StopRemoteNode, "stop"),
            Self::Preop => (NmtCommand::EnterPreOperational, "enter Pre-operational"),
            Self::Reset => (NmtCommand::ResetNode, "reset node"),
            Self::ResetComm => (NmtCommand::ResetCommunication, "reset communication"),
        }
    }
}

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let mut desk = DeviceSession::open(&arguments.place, output)?;
    let (command, words) = arguments.command.of_nmt();
    let node = if arguments.node == "all" { None } else { Some(desk.node(&arguments.node)?) };
    let who = node.as_ref().map_or("all nodes".to_owned(), |node| node.words());
    if arguments.dry_run {
        if output.is_json() {
            return output.report(json!({ "place": desk.place, "dry_run": true, "node": who, "command": words }));
        }
        return output.result(&format!("would send to {who}: {words}\n"));
    }
    let is_reset = matches!(arguments.command, Command::Reset | Command::ResetComm);
    // In Stopped it may answer nothing: who goes there is asked before.
    let was_there = match &node {
        Some(node) if !is_reset => presence(&mut desk, node)?.is_some(),
        _ => false,
    };
    let buses: Vec<_> = match &node {
        Some(_) => vec![desk.service.bus()],
        None => desk.buses.iter().map(|(bus, _)| *bus).collect(),
    };
    for bus in buses {
        desk.service.turn_to(bus);
        let sent = desk.service.command(command, node.as_ref().map(|node| node.id));
        sent.map_err(|error| desk.bus_failure(error))?;
    }
    let Some(node) = node else {
        desk.service.listen(SETTLING, |_| {}).map_err(|error| desk.bus_failure(error))?;
        if output.is_json() {
            return output.report(json!({ "place": desk.place, "node": who, "command": words }));
        }
        return output.result(&format!("told {who}: {words}\n"));
    };
    let before = desk.service.heard(node.id).boot_ups;
    let until = desk.service.now() + if is_reset { BOOT_UP } else { SETTLING };
    while desk.service.now() < until && !(is_reset && desk.service.heard(node.id).boot_ups > before) {
        desk.service.listen(Duration::from_millis(20), |_| {}).map_err(|error| desk.bus_failure(error))?;
    }
    if is_reset && desk.service.heard(node.id).boot_ups == before {
        let message = format!("{words} was sent to {who}, and no boot-up message came within {} s", BOOT_UP.as_secs());
        return Err(Failure::new(Exit::DeviceMismatch, message, why_absent(&desk, &node)));
    }
    let presence = presence(&mut desk, &node)?;
    if presence.is_none() && !was_there {
        let message = format!("{words} was sent to {who}, which neither reports its state nor answers a request");
        return Err(Failure::new(Exit::DeviceMismatch, message, why_absent(&desk, &node)));
    }
    let state = presence.flatten().map(|state| nmt_words(state).to_owned());
    if output.is_json() {
        return output.report(json!({ "place": desk.place, "node": who, "command": words, "state": state }));
    }
    let state = state.unwrap_or_else(|| "unknown: it answers no node guarding and sends no heartbeat".to_owned());
    output.result(&wrapped(&format!("sent to {who}: {words}; state {state}")))
}

/// Returns whether a device is there, and its state if it reports one: by node guarding, a heartbeat, or an answer to a read of its
/// type.
fn presence(desk: &mut DeviceSession, node: &Node) -> Result<Option<Option<NmtState>>, Failure> {
    let state = desk.service.state(node.id).map_err(|error| desk.failure(node, "asking its state", error))?;
    if state.is_some() {
        return Ok(Some(state));
    }
    desk.service.set_patience(ANSWER, 0);
    match desk.service.read(node.id, Address::new(0x1000, 0)) {
        Err(Error::NoAnswer) => Ok(None),
        Err(error @ (Error::Link(_) | Error::Interrupted)) => Err(desk.bus_failure(error)),
        _ => Ok(Some(None)),
    }
}

fn why_absent(desk: &DeviceSession, node: &Node) -> String {
    format!("{} finds out why; `yieldwall scan{}` shows who answers", desk.command("doctor node", node), desk.arguments)
}
