//! `yieldwall doctor node`: why a node does not answer. Also the check of a bus's devices, for `yieldwall doctor`.

use serde_json::{Value, json};

use super::place::{BusArguments, DeviceSession, Entry, Node};
pub(crate) use super::segment::second_opinion;
use super::segment::second_opinion::Consent;
use super::segment::{self, SegmentSession};
use crate::checkup::{Section, finish};
use crate::failure::{Exit, Failure};
use crate::interrupt::on_interrupt;
use crate::output::Output;
use yieldwall_config::{self as config, Bus, Rig, Source};
use yieldwall_fieldbus::canopen::{NodeId, NodeSet, node_id};
use yieldwall_link::checkup::{Check, Verdict};
use yieldwall_link::{CanLink, InterfaceFacts};
use yieldwall_rig::live::{PlantedLink, Trouble};
use yieldwall_service::doctor::{Around, NodeFacts, examine, judge, read_pattern};
use yieldwall_service::{FoundDevice, scan};

/// Most devices of one bus whose answers are compared.
const MOST_COMPARED: usize = 8;

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Node id, EtherCAT position, or device name from the rig
    node: String,
    /// Send nothing, and diagnose from 1 s of received frames; use this beside a running master
    #[arg(long)]
    listen: bool,
    /// Fault of the simulated node, to see how the command finds it
    #[arg(long, value_enum, conflicts_with = "bus")]
    fault: Option<Fault>,
    #[command(flatten)]
    place: BusArguments,
}

/// A fault of a simulated node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Fault {
    /// The node is switched off
    NodeSilent,
    /// The node has node id 99
    WrongNodeId,
    /// The node is in Stopped
    NodeStopped,
    /// Another device has the same node id
    DuplicateNode,
    /// The node has another bit rate than the bus
    WrongBitRate,
    /// The adapter delivers answers under other identifiers
    WrongIdentifiers,
    /// The interface's controller goes bus-off
    BusOff,
    /// All frames have 29-bit identifiers, from devices that do not speak CANopen
    OtherTraffic,
}

/// The node id that a device has by [`Fault::WrongNodeId`].
const OTHER_NODE_ID: u8 = 99;

impl Fault {
    fn trouble(self, node: NodeId) -> Trouble {
        match self {
            Self::NodeSilent => Trouble::Silent,
            Self::WrongNodeId => Trouble::OtherNodeId(node_id(OTHER_NODE_ID).unwrap_or(node)),
            Self::NodeStopped => Trouble::Stopped,
            Self::DuplicateNode => Trouble::Double,
            Self::WrongBitRate => Trouble::OtherBitRate,
            Self::WrongIdentifiers => Trouble::OtherIdentifiers,
            Self::BusOff => Trouble::BusOff,
            Self::OtherTraffic => Trouble::OtherTraffic,
        }
    }
}

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    if let Some(mut desk) = SegmentSession::open(&arguments.place, output)? {
        if arguments.listen || arguments.fault.is_some() {
            let message = "--listen and --fault are for nodes on CAN, and this place is on EtherCAT";
            return Err(Failure::new(Exit::Usage, message, "leave them out"));
        }
        let sections = segment::doctor::sections(&mut desk, Some(&arguments.node))?;
        return finish(&sections, json!({ "node": arguments.node, "place": desk.place }), output);
    }
    let mut sections = Vec::new();
    let (mut bit_rate, mut interface) = (None, None);
    if let Some(bus) = &arguments.place.bus {
        let name = bus.split_once('=').map_or(bus.as_str(), |(_, name)| name);
        interface = Some(name.to_owned());
        let wanted = of_rig(&arguments.place)?;
        let checks = match InterfaceFacts::read(name, wanted) {
            Err(error) => vec![error.check()],
            Ok(facts) => {
                bit_rate = facts.bit_rate;
                facts.checks(wanted)
            }
        };
        // What is not as it should be; `yieldwall doctor --bus` lists all of it.
        let bad: Vec<Check> = checks.into_iter().filter(|check| check.verdict >= Verdict::Warning).collect();
        if !bad.is_empty() {
            sections.push(Section::new(format!("interface {name}"), Exit::BusUnavailable, bad));
        }
        if sections.iter().any(Section::is_wrong) {
            return finish(&sections, json!({ "node": arguments.node }), output);
        }
    }
    let mut desk = match arguments.listen {
        true => DeviceSession::only_listening(&arguments.place, output)?,
        false => DeviceSession::open(&arguments.place, output)?,
    };
    let node = desk.node(&arguments.node)?;
    if let Some(fault) = arguments.fault {
        let plant = |link| -> Box<dyn CanLink> { Box::new(PlantedLink::new(link, node.id, fault.trouble(node.id))) };
        desk = DeviceSession { service: desk.service.map_link(plant), ..desk };
    }
    let facts = examine(&mut desk.service, node.id, arguments.listen).map_err(|error| desk.bus_failure(error))?;
    // On a simulation the commands are those for a bus as the rig has it.
    let bit_rate = if desk.is_simulated { simulated_bit_rate(&desk)? } else { bit_rate };
    let around = around(&desk, &node, interface, bit_rate, &arguments.place.arguments());
    let checks = judge(&facts, &around);
    let of_bus = ["interface", "bus-off", "acknowledge", "bit rate", "silence"];
    let is_of_bus = checks.iter().any(|check| check.verdict == Verdict::Wrong && of_bus.contains(&check.subject));
    let exit = if is_of_bus { Exit::BusUnavailable } else { Exit::DeviceMismatch };
    sections.push(Section::new(node.words(), exit, checks));
    finish(&sections, document(&desk, &node, &facts), output)
}

fn document(desk: &DeviceSession, node: &Node, facts: &NodeFacts) -> serde_json::Value {
    let raw = |set: NodeSet| set.iter().map(NodeId::raw).collect::<Vec<u8>>();
    json!({
        "place": desk.place,
        "node_id": node.id.raw(),
        "frames_heard": facts.frames,
        "frames_of_node": facts.own_frames,
        "boot_ups": facts.boot_ups,
        "state": facts.state.map(super::words::nmt_words),
        "answers": facts.is_answering(),
        "others": raw(facts.others),
        "others_that_answered": raw(facts.answered),
        "bus_errors": facts.link.bus_errors,
        "extended_frames": facts.link.others.extended,
        "fd_frames": facts.link.others.fd,
    })
}

fn around(
    desk: &DeviceSession,
    node: &Node,
    interface: Option<String>,
    bit_rate: Option<u32>,
    commands: &str,
) -> Around {
    let here = |entry: &&Entry| entry.bus == desk.service.bus();
    Around {
        name: node.words(),
        arguments: commands.to_owned(),
        interface,
        bit_rate,
        rig: desk.entries.iter().filter(here).map(|entry| entry.node).collect(),
    }
}

/// Returns the bit rate of the simulated bus in bit/s.
fn simulated_bit_rate(desk: &DeviceSession) -> Result<Option<u32>, Failure> {
    let Some(rig) = &desk.rig else { return Ok(None) };
    let rig = config::load_rig(Source::named(rig))?.value;
    let name = desk.buses.iter().find(|(bus, _)| *bus == desk.service.bus()).map(|(_, name)| name);
    Ok(name.and_then(|name| rig.buses.get(name)?.canopen()).map(|bus| bus.bit_rate_bit_per_s))
}

/// Returns the bit rate of the rig's bus in bit/s, if there is a rig.
fn of_rig(place: &BusArguments) -> Result<Option<u32>, Failure> {
    let (Some(rig), Some(bus)) = (&place.rig, &place.bus) else { return Ok(None) };
    // Its warnings are printed when the devices are read.
    let rig = config::load_rig(Source::named(rig))?.value;
    let named = bus.split_once('=').and_then(|(name, _)| rig.buses.get(name));
    let bus = named.or_else(|| rig.buses.values().next());
    Ok(bus.and_then(Bus::canopen).map(|bus| bus.bit_rate_bit_per_s))
}

/// Checks the devices of a segment, by its interface, and the interface itself. If a person consents, a second opinion of another
/// master follows, as a document beside the sections.
pub(crate) fn on_segment(
    interface: &str,
    argument: &str,
    rig: Option<&str>,
    consent: Option<&Consent>,
    output: &mut Output,
) -> Result<(Vec<Section>, Option<Value>), Failure> {
    let place = BusArguments { bus: Some(argument.to_owned()), rig: rig.map(str::to_owned) };
    let examined = SegmentSession::only(&place, output)
        .and_then(|mut desk| segment::doctor::sections(&mut desk, None).map(|sections| (desk, sections)));
    let (mut desk, mut sections) = match examined {
        Ok(examined) => examined,
        Err(failure) => return Ok((refused(format!("segment on {interface}"), failure), None)),
    };
    let Some(consent) = consent else { return Ok((sections, None)) };
    match segment::second_opinion::sections(&mut desk, interface, consent, output) {
        Ok((more, document)) => {
            sections.extend(more);
            Ok((sections, Some(document)))
        }
        Err(failure) if failure.exit == Exit::Interrupted => Err(failure),
        Err(failure) => {
            sections.extend(refused(format!("second opinion on {interface}"), failure));
            Ok((sections, None))
        }
    }
}

/// Returns a section on the reason for a missing check; none if the reason was printed before.
fn refused(about: String, failure: Failure) -> Vec<Section> {
    let finding = failure.report.diagnostics.into_iter().next();
    let check =
        finding.map(|finding| Check::wrong("segment", finding.message).follows(finding.help.unwrap_or_default()));
    check.into_iter().map(|check| Section::new(about.clone(), failure.exit, vec![check])).collect()
}

/// Checks the devices of an interface that can be used: which ones answer, and whether identifiers and node ids are right.
/// `commands` holds the arguments with which commands reach them.
pub(crate) fn devices(argument: &str, rig: Option<&Rig>, commands: &str) -> Result<Vec<Check>, Failure> {
    let mut desk = match DeviceSession::on_bus(argument, rig, on_interrupt()?) {
        Ok(desk) => desk,
        // A master that is present is no fault, and the command sends nothing beside it.
        Err(failure) => {
            let why = failure.report.diagnostics.first().map(|finding| finding.message.clone()).unwrap_or_default();
            return Ok(vec![
                Check::unknown("devices", why)
                    .follows("who is heard beside a master is listed by this")
                    .fix(format!("yieldwall scan --listen{commands}")),
            ]);
        }
    };
    let found = scan(&mut desk.service).map_err(|error| desk.bus_failure(error))?;
    let mut checks = vec![of_found(&desk, &found, commands)];
    checks.extend(missing(&desk, &found, commands));
    if !found.is_empty() {
        checks.extend(compared(&mut desk, &found, commands)?);
    }
    Ok(checks)
}

/// Whether a device answers, as every device does except in Stopped.
fn is_answering(found: &FoundDevice) -> bool {
    found.device_type.is_some() || found.identity != [None; 4]
}

fn of_found(desk: &DeviceSession, found: &[FoundDevice], commands: &str) -> Check {
    let nodes: NodeSet = found.iter().map(|found| found.node).collect();
    if nodes.is_empty() {
        let entry = desk.entries.iter().find(|entry| entry.bus == desk.service.bus());
        let first = entry.map_or(1, |entry| entry.node.raw());
        let others = desk.service.others();
        let found = match others.is_none() {
            true => "no device answers or is heard".to_owned(),
            false => format!("no CANopen device answers or is heard; {others} came, so that the bit rate is right"),
        };
        return Check::wrong("devices", found)
            .follows("this looks for the reason")
            .fix(format!("yieldwall doctor node {first}{commands}"));
    }
    Check::ok("devices", format!("{nodes} {} heard", if nodes.len() == 1 { "is" } else { "are" }))
}

/// Returns the devices that do not answer, including missing devices of the rig.
fn missing(desk: &DeviceSession, found: &[FoundDevice], commands: &str) -> Vec<Check> {
    let answering: NodeSet = found.iter().filter(|found| is_answering(found)).map(|found| found.node).collect();
    let of_rig = desk.entries.iter().filter(|entry| entry.bus == desk.service.bus()).map(|entry| entry.node);
    let all: NodeSet = found.iter().map(|found| found.node).chain(of_rig).collect();
    let silent = all.without(answering).iter();
    let told = silent.map(|node| {
        let name = desk.entry(node).map_or(String::new(), |entry| format!(" ({})", entry.name));
        let others = if answering.is_empty() { "nobody".to_owned() } else { answering.to_string() };
        let is_heard = found.iter().any(|found| found.node == node);
        let how = if is_heard { "is heard and does not answer" } else { "is silent" };
        Check::wrong("node", format!("node {}{name} {how}; {others} answered", node.raw()))
            .follows("this looks for the reason")
            .fix(format!("yieldwall doctor node {}{commands}", node.raw()))
    });
    told.collect()
}

/// Returns the findings that a pattern of reads gives on the devices that answer.
fn compared(desk: &mut DeviceSession, found: &[FoundDevice], commands: &str) -> Result<Vec<Check>, Failure> {
    let mut wrong = Vec::new();
    let mut compared = NodeSet::default();
    for found in found.iter().filter(|found| is_answering(found)).take(MOST_COMPARED) {
        let facts = read_pattern(&mut desk.service, found.node).map_err(|error| desk.bus_failure(error))?;
        let node = Node::of(found.node, desk.entry(found.node).cloned());
        let interface = commands.strip_prefix(" --bus ").and_then(|rest| rest.split(' ').next());
        let interface = interface.map(|name| name.split_once('=').map_or(name, |(_, name)| name).to_owned());
        let around = around(desk, &node, interface, None, commands);
        let trouble = judge(&facts, &around).into_iter().find(|check| check.verdict == Verdict::Wrong);
        wrong.extend(trouble);
        compared.insert(found.node);
    }
    if wrong.is_empty() && !compared.is_empty() {
        let found = format!("all answers of {compared} came once, under the identifiers that were asked");
        wrong.push(Check::ok("identifiers", found));
    }
    Ok(wrong)
}
