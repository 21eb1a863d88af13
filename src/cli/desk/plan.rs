//! `run --dry-run` and `drill --dry-run`: what boot and start would send to each device, in its order, old -> new. Objects are read; nothing
//! else is sent, and nothing at all on a bus with a master. A device on EtherCAT that is in INIT is brought to PRE-OP and back.

mod segment;

use serde_json::{Value as Json, json};
use yieldwall_drives::eds::Value;
use yieldwall_drives::scaling::AxisScaling;

use super::place::{DeviceSession, Node};
use super::segment::SegmentSession;
use super::words::{self, nmt_words};
use crate::ending::rig_failure;
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_bus::{BootPlan, NodePlan, PlannedWrite, words_to_enable};
use yieldwall_config::{Bus, Loaded, Rig};
use yieldwall_fieldbus::canopen::{BusId, Frame, NmtCommand, nmt};
use yieldwall_fieldbus::objects::Address;
use yieldwall_motion::guard::DeviceSet;
use yieldwall_run::assembly::master;
use yieldwall_run::{ANNOUNCED, DRILL_LIMIT, END_OF_WATCH, REST_RAD, settling_on_bus, watchdogs};
use yieldwall_service::{Error, known, type_by_length};

/// Columns of a terminal.
const COLUMNS: usize = 80;
/// The part in which nodes are configured.
const CONFIGURE: &str = "configure";

/// Who would send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sender {
    /// `run`.
    Run,
    /// `drill`.
    Drill,
}

/// One thing that would be sent.
#[derive(Clone, Debug)]
struct Line {
    part: &'static str,
    bus: BusId,
    /// The device that it is for; `None` for all.
    owner: Option<Owner>,
    what: What,
}

/// A device by its place on its bus.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Owner {
    place: Place,
    name: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Node(u8),
    Position(u16),
}

impl Owner {
    fn node(id: u8, name: &str) -> Self {
        Self { place: Place::Node(id), name: name.to_owned() }
    }

    /// `node 1 (left)`, `left (position 0)`.
    fn words(&self) -> String {
        match self.place {
            Place::Node(id) => format!("node {id} ({})", self.name),
            Place::Position(position) => format!("{} (position {position})", self.name),
        }
    }
}

#[derive(Clone, Debug)]
enum What {
    /// An NMT command.
    Command(NmtCommand),
    /// A frame, and what it is.
    Frame(Frame, String),
    /// What is set of a device on EtherCAT beside its objects.
    Set(String),
    /// An object.
    Write(PlannedWrite),
    /// A controlword.
    Controlword { old: Option<u16>, new: u16 },
}

/// Says what a rig's boot and start would send: to its devices on these buses, `NAME=INTERFACE` each, or to the simulated ones.
pub(crate) fn run(rig: &Loaded<Rig>, buses: &[String], sender: Sender, output: &mut Output) -> Result<(), Failure> {
    let plan = master(&rig.value, &rig.value.fixture).map_err(|error| rig_failure(&error.into()))?;
    let plan = plan.networks().plan();
    let (of_segment, of_can): (Vec<&String>, Vec<&String>) =
        buses.iter().partition(|bus| segment::is_one(&rig.value, bus));
    // Listens on each before anything is read on any.
    let mut segment = match rig.value.is_on_ethercat() {
        true => Some(SegmentSession::of_rig(rig, of_segment.first().map(|bus| bus.as_str()))?),
        false => None,
    };
    let mut desks = match (of_can.as_slice(), &plan) {
        (_, None) => Vec::new(),
        ([], Some(_)) => vec![DeviceSession::of_rig(rig, None)?],
        (several, Some(_)) => {
            several.iter().map(|bus| DeviceSession::of_rig(rig, Some(bus))).collect::<Result<_, _>>()?
        }
    };
    let (mut lines, mut end) = lines(&rig.value, &plan.unwrap_or_default(), &mut desks)?;
    if let Some(desk) = &mut segment {
        let (of_segment, refused) = segment::lines(&rig.value, desk)?;
        end = refused.and(end);
        lines = segment::joined(of_segment, lines);
    }
    let places = segment.iter().map(|desk| desk.place.as_str()).chain(desks.iter().map(|desk| desk.place.as_str()));
    let place = places.collect::<Vec<_>>().join(", ");
    let is_simulated = buses.is_empty();
    let scalings = scalings(&segment, &desks);
    let watchdogs = watchdogs(&rig.value);
    let rounds = if sender == Sender::Drill { watchdogs.len() } else { 1 };
    if output.is_json() {
        let document = json!({
            "dry_run": true, "place": place, "times": rounds,
            "sends": lines.iter().map(|line| line.to_json(&rig.value, &scalings)).collect::<Vec<_>>(),
            "motion": motion_json(&rig.value, sender),
        });
        return output.end(document, end);
    }
    let asked = if is_simulated { format!("simulated devices of {}", rig.value.rig.name) } else { place };
    let other = if is_simulated { ". With --bus INTERFACE those of a bus are read" } else { "" };
    // Only CAN is reset.
    let unless = if desks.is_empty() { "" } else { ", unless the reset changes it" };
    let mut text = words::wrapped(&format!(
        "Nothing was written. Old values were read from the {asked}{other}. An object that stands already is not written{unless}."
    ));
    let (mut part, mut of) = ("", None);
    for (number, line) in lines.iter().enumerate() {
        let begins = line.part != part || (part == CONFIGURE && line.owner != of);
        if begins {
            text.push_str(&heading(line, &rig.value, sender));
        }
        (part, of) = (line.part, line.owner.clone());
        text.push_str(&format!("{:4}  {}\n", number + 1, line.words(&rig.value, &scalings)));
    }
    text.push_str(&motion_text(&rig.value, sender));
    if rounds > 1 {
        let each: Vec<&str> = watchdogs.iter().map(|watchdog| watchdog.name()).collect();
        let each = each.join(", ");
        text.push_str(&words::wrapped(&format!(
            "\nAll of it {rounds} times: while the rig rests, the drives go without one of {each} each time, until both have stopped, {} s at most.",
            DRILL_LIMIT.as_secs()
        )));
    }
    output.result(&text)?;
    end
}

/// All that would be sent; and why the boot would not come to its end, if it would not.
fn lines(rig: &Rig, plan: &BootPlan, desks: &mut [DeviceSession]) -> Result<(Vec<Line>, Result<(), Failure>), Failure> {
    let mut lines = Vec::new();
    let named = |id: u8, bus: BusId| {
        let node = plan.nodes.iter().find(|node| node.bus == bus && node.id.raw() == id);
        node.map(|node| Owner::node(id, &node.name))
    };
    let of_frames = |part: &'static str, frames: &[Frame], lines: &mut Vec<Line>| {
        for frame in frames {
            let (owner, what) = match (nmt::decode_command(frame), nmt::decode_heartbeat(frame)) {
                (Some((command, node)), _) => {
                    (node.and_then(|node| named(node.raw(), frame.bus())), What::Command(command))
                }
                (_, Some((node, state))) => {
                    let what = format!("heartbeat of node {} (this program): {}", node.raw(), nmt_words(state));
                    (None, What::Frame(*frame, what))
                }
                _ => (None, What::Frame(*frame, format!("order to {}", rig.sensor.name))),
            };
            lines.push(Line { part, bus: frame.bus(), owner, what });
        }
    };
    of_frames("boot", &plan.reset, &mut lines);
    let mut end = Ok(());
    for node in &plan.nodes {
        let (writes, refused) = ask(node, rig, desks)?;
        end = end.and(refused);
        let owner = Some(Owner::node(node.id.raw(), &node.name));
        lines.extend(writes.into_iter().map(|write| Line {
            part: CONFIGURE,
            bus: node.bus,
            owner: owner.clone(),
            what: What::Write(write),
        }));
    }
    of_frames("start", &plan.start, &mut lines);
    let drives: Vec<&NodePlan> =
        plan.nodes.iter().filter(|node| !(node.devices & DeviceSet::DRIVES).is_empty()).collect();
    let mut old = None;
    for new in words_to_enable() {
        for node in &drives {
            let owner = Some(Owner::node(node.id.raw(), &node.name));
            lines.push(Line { part: "enable", bus: node.bus, owner, what: What::Controlword { old, new } });
        }
        old = Some(new);
    }
    of_frames("leave", &plan.leave, &mut lines);
    let (at, never) = END_OF_WATCH;
    for node in drives {
        let owner = Owner::node(node.id.raw(), &node.name);
        let told = lines.iter().rev().find_map(|line| match &line.what {
            What::Write(write) if line.owner.as_ref() == Some(&owner) && line.bus == node.bus => {
                (write.at == at).then(|| write.new.clone()).flatten()
            }
            _ => None,
        });
        let write = PlannedWrite {
            doing: "end the watch",
            at,
            old: told,
            new: Some(never.to_le_bytes().to_vec()),
            stands: false,
        };
        lines.push(Line { part: "leave", bus: node.bus, owner: Some(owner), what: What::Write(write) });
    }
    Ok((lines, end))
}

/// What would be written to one node; and that it does not answer, or would be refused.
fn ask(
    plan: &NodePlan,
    rig: &Rig,
    desks: &mut [DeviceSession],
) -> Result<(Vec<PlannedWrite>, Result<(), Failure>), Failure> {
    let (desk, entry) =
        desk_of(plan.bus, rig, desks).ok_or_else(|| Failure::new(Exit::Internal, "a bus is missing", ""))?;
    desk.service.turn_to(entry);
    let node = Node::of(plan.id, desk.entry(plan.id).cloned());
    let mut broken: Option<(Address, Error)> = None;
    let (writes, refused) = plan.writes(|at| {
        // A device that does not answer once is not asked again.
        if broken.is_some() {
            return None;
        }
        match desk.service.read(plan.id, at) {
            Ok(bytes) => Some(bytes),
            Err(Error::Refused(_)) => None,
            Err(error) => {
                broken = Some((at, error));
                None
            }
        }
    });
    match broken {
        Some((_, error @ (Error::Interrupted | Error::Link(_)))) => Err(desk.bus_failure(error)),
        Some((at, error)) => Ok((writes, Err(desk.failure(&node, &format!("reading {at}"), error)))),
        None => Ok((writes, refused.map_err(|error| rig_failure(&error.into())))),
    }
}

/// The desk at which a bus of the rig is, and what the bus is called there: one interface is one bus to its link.
fn desk_of<'a>(bus: BusId, rig: &Rig, desks: &'a mut [DeviceSession]) -> Option<(&'a mut DeviceSession, BusId)> {
    if desks.first()?.is_simulated {
        return Some((desks.first_mut()?, bus));
    }
    // Desks are those of the buses on CAN, in their order.
    let before = rig.buses.values().take(bus.index()).filter(|bus| !matches!(bus, Bus::Ethercat(_))).count();
    Some((desks.get_mut(before)?, BusId::FIRST))
}

fn heading(line: &Line, rig: &Rig, sender: Sender) -> String {
    let period_ms = f64::from(rig.cycle.period_us) * 1e-3;
    match (line.part, &line.owner) {
        (segment::PART, _) => segment::HEADING.to_owned(),
        ("boot", _) => words::wrapped(&format!(
            "\nReset, if no other master is heard before or within {} ms after the first heartbeat; more heartbeats follow every {} ms",
            ANNOUNCED.as_millis(),
            rig.own_node().map_or(0, |own| own.heartbeat_ms)
        )),
        (CONFIGURE, Some(owner @ Owner { place: Place::Position(_), .. })) => {
            words::wrapped(&format!("\nThe objects of {} by CoE in PRE-OP; old values are those of now", owner.words()))
        }
        (CONFIGURE, Some(Owner { place: Place::Node(id), name })) => {
            let bus = rig.buses.keys().nth(line.bus.index()).filter(|_| rig.buses.len() > 1);
            let bus = bus.map_or(String::new(), |bus| format!(" on {bus}"));
            words::wrapped(&format!(
                "\nNode {id} ({name}){bus} by SDO, at the same time as the others; old values are those before the reset"
            ))
        }
        ("start", Some(Owner { place: Place::Position(_), .. })) => {
            "\nClocks and process data, then SAFE-OP and OP\n".to_owned()
        }
        ("start", _) => "\nStart\n".to_owned(),
        ("enable", _) => {
            let proof = if sender == Sender::Run { ", with a watchdog drill on record" } else { "" };
            let with = if rig.has_drives_on_ethercat() { "process data" } else { "SYNC" };
            let behind = if rig.has_drives_on_ethercat() { "in them" } else { "and behind it" };
            words::wrapped(&format!(
                "\nEnable: from here on {with} every {period_ms} ms, {behind} set-points with these controlwords; past 0006h on a bus \
                 after {} cycles{proof}, and each when the drive has followed the one before",
                settling_on_bus(rig)
            ))
        }
        _ => "\nAfter the stop\n".to_owned(),
    }
}

impl Line {
    /// The scaling of the drive that it is for.
    fn scaling<'a>(&self, scalings: &'a Scalings) -> Option<&'a AxisScaling> {
        let name = &self.owner.as_ref()?.name;
        scalings.iter().find(|(known, _)| known == name).map(|(_, scaling)| scaling)
    }

    fn words(&self, rig: &Rig, scalings: &Scalings) -> String {
        // Where there is one bus, its name says nothing.
        let bus = match rig.buses.keys().nth(self.bus.index()).filter(|_| rig.buses.len() > 1) {
            Some(name) => format!("{name}: "),
            None => String::new(),
        };
        let who = self.owner.as_ref().map_or("all".to_owned(), Owner::words);
        match &self.what {
            What::Command(command) => format!("{bus}NMT, {who}: {}", command_words(*command)),
            What::Frame(frame, what) => format!("{bus}{:03X}h {}  {what}", frame.id(), hexadecimal(frame.data())),
            What::Set(what) => format!("{bus}{who}: {what}"),
            What::Controlword { old, new } => {
                let old = old.map_or("-".to_owned(), |old| format!("{old:04X}h"));
                format!("{bus}{who}: controlword {old} -> {new:04X}h")
            }
            What::Write(write) => {
                let name = words::name(write.at, None);
                let name = if name.is_empty() { write.doing.to_owned() } else { name };
                let (old, new) = (short(write.at, write.old.as_deref()), short(write.at, write.new.as_deref()));
                let before = if self.part == CONFIGURE { String::new() } else { format!("{bus}{who}: ") };
                // Behind the name of a node less is left of the line.
                let wide = if before.is_empty() { 28 } else { 20 };
                let change = if write.stands { format!("{new} stands") } else { format!("{old} -> {new}") };
                let line = format!("{before}{:8}  {name:wide$}  {change}", write.at.to_string());
                let scaling = self.scaling(scalings);
                let means = write
                    .new
                    .as_ref()
                    .and_then(|new| words::value(write.at, data_type(write.at, new), new, scaling).means);
                match means.filter(|means| 6 + line.chars().count() + means.chars().count() + 3 <= COLUMNS) {
                    Some(means) => format!("{line} ({means})"),
                    None => line,
                }
            }
        }
    }

    fn to_json(&self, rig: &Rig, scalings: &Scalings) -> Json {
        let place = self.owner.as_ref().map(|owner| owner.place);
        let mut document = json!({
            "part": self.part,
            "bus": rig.buses.keys().nth(self.bus.index()),
            "node_id": match place { Some(Place::Node(id)) => Some(id), _ => None },
            "device": self.owner.as_ref().map(|owner| &owner.name),
        });
        if let (Json::Object(all), Some(Place::Position(position))) = (&mut document, place) {
            all.insert("position".to_owned(), position.into());
        }
        let more = match &self.what {
            What::Command(command) => json!({ "nmt": command_words(*command) }),
            What::Frame(frame, what) => {
                json!({ "frame": format!("{:03X}#{}", frame.id(), hexadecimal(frame.data())), "what": what })
            }
            What::Set(what) => json!({ "set": what }),
            What::Controlword { old, new } => json!({ "controlword": { "old": old, "new": new } }),
            What::Write(write) => {
                let scaling = self.scaling(scalings);
                let shown = |bytes: &Option<Vec<u8>>| {
                    bytes.as_ref().map(|bytes| {
                        let shown = words::value(write.at, data_type(write.at, bytes), bytes, scaling);
                        words::document(write.at, "", bytes, &shown)
                    })
                };
                let part = |shown: Option<Json>| {
                    shown.map(
                        |shown| json!({ "bytes": shown["bytes"], "value": shown["value"], "means": shown["means"] }),
                    )
                };
                json!({
                    "object": write.at.to_string(), "name": words::name(write.at, None), "doing": write.doing,
                    "old": part(shown(&write.old)), "new": part(shown(&write.new)), "stands": write.stands,
                })
            }
        };
        if let (Json::Object(all), Json::Object(more)) = (&mut document, more) {
            all.extend(more);
        }
        document
    }
}

/// Scalings of drives, by their names.
type Scalings = Vec<(String, AxisScaling)>;

fn scalings(segment: &Option<SegmentSession>, desks: &[DeviceSession]) -> Scalings {
    let of_segment = segment.iter().flat_map(|desk| &desk.entries);
    let of_segment = of_segment.map(|entry| (&entry.name, &entry.scaling));
    let of_can = desks.iter().flat_map(|desk| &desk.entries).map(|entry| (&entry.name, &entry.scaling));
    of_segment.chain(of_can).filter_map(|(name, scaling)| Some((name.clone(), (*scaling)?))).collect()
}

fn data_type(at: Address, bytes: &[u8]) -> Option<u16> {
    known(at, None).map(|known| known.data_type).or_else(|| type_by_length(bytes.len()))
}

/// Objects that hold the indices of other objects.
const ASSIGNMENTS: std::ops::Range<u16> = 0x1c10..0x1c30;

/// A value in few letters: identifiers, mappings and watched nodes as 32 bits in hexadecimal, all else as a number.
fn short(at: Address, bytes: Option<&[u8]>) -> String {
    let Some(bytes) = bytes else { return "?".to_owned() };
    match data_type(at, bytes).map(|data_type| Value::from_bytes(data_type, bytes)) {
        Some(Value::Integer(_)) if at.index < 0x2000 && bytes.len() == 4 => {
            format!("{:08X}h", yieldwall_service::number(bytes))
        }
        Some(Value::Integer(value)) if ASSIGNMENTS.contains(&at.index) && bytes.len() == 2 => format!("{value:04X}h"),
        Some(Value::Integer(value)) => value.to_string(),
        _ => hexadecimal(bytes),
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().take(8).map(|byte| format!("{byte:02X}")).collect()
}

fn command_words(command: NmtCommand) -> &'static str {
    match command {
        NmtCommand::StartRemoteNode => "start",
        NmtCommand::StopRemoteNode => "stop",
        NmtCommand::EnterPreOperational => "enter Pre-operational",
        NmtCommand::ResetNode => "reset node",
        NmtCommand::ResetCommunication => "reset communication",
    }
}

fn motion_text(rig: &Rig, sender: Sender) -> String {
    let guard = &rig.guard;
    let limits = format!(
        "torque {} N m and rate {} rad/s of a joint, speed {} m/s of the tool",
        guard.torque_limit_n_m.get(),
        guard.joint_speed_limit_rad_per_s.get(),
        guard.tool_speed_limit_m_per_s.get()
    );
    let motion = match sender {
        Sender::Drill => format!("the rig rests; a joint led farther than {REST_RAD} rad from there stops it"),
        Sender::Run => format!(
            "as far as the hand leads the tool, which keeps {} m from the edge of the workspace and from singular poses",
            guard.singularity_margin_m.get()
        ),
    };
    words::wrapped(&format!("\nMotion: it begins at the measured pose. Bound: {motion}. Limits: {limits}."))
}

fn motion_json(rig: &Rig, sender: Sender) -> Json {
    let guard = &rig.guard;
    json!({
        "joint_bound_rad": (sender == Sender::Drill).then_some(REST_RAD),
        "singularity_margin_m": guard.singularity_margin_m,
        "torque_limit_n_m": guard.torque_limit_n_m,
        "joint_speed_limit_rad_per_s": guard.joint_speed_limit_rad_per_s,
        "tool_speed_limit_m_per_s": guard.tool_speed_limit_m_per_s,
    })
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex, atomic::AtomicBool};

    use super::*;
    use yieldwall_config::{Source, load_rig};
    use yieldwall_fieldbus::Packet;
    use yieldwall_fieldbus::canopen::cob;
    use yieldwall_fieldbus::ethercat::frame::{Command, DatagramHeader, Datagrams};
    use yieldwall_fieldbus::time::Time;
    use yieldwall_link::{Arrival, CanLink, SendError};
    use yieldwall_rig::EmbeddedRig;
    use yieldwall_rig::live::VirtualLink;
    use yieldwall_service::Service;

    /// A link that refuses to send anything that does more than read an object.
    struct Reading(VirtualLink);

    impl CanLink for Reading {
        fn now(&self) -> Time {
            self.0.now()
        }

        fn receive(&mut self) -> Option<Arrival> {
            self.0.receive()
        }

        fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
            let command = frame.data().first().map(|byte| byte >> 5);
            assert!(frame.id() & 0x780 == 0x600 && matches!(command, Some(2 | 3)), "{frame:?} is no upload");
            self.0.send(frame)
        }

        fn wait(&mut self, until: Time) -> bool {
            self.0.wait(until)
        }
    }

    /// What a shipped rig would be told, by reading alone.
    fn planned(rig: &Loaded<Rig>) -> Vec<Line> {
        let plan = master(&rig.value, &rig.value.fixture).unwrap().networks().plan().unwrap();
        let scene = rig.scene().unwrap().value;
        let link: Box<dyn CanLink> = Box::new(Reading(VirtualLink::new(&rig.value, &scene, 1).unwrap()));
        let mut desk = DeviceSession::of_rig(rig, None).unwrap();
        desk.service = Service::new(link, BusId::FIRST, Arc::new(AtomicBool::new(false)));
        let (lines, end) = lines(&rig.value, &plan, &mut [desk]).unwrap();
        assert!(end.is_ok());
        lines
    }

    fn node_of(line: &Line) -> Option<u8> {
        match line.owner.as_ref()?.place {
            Place::Node(id) => Some(id),
            Place::Position(_) => None,
        }
    }

    /// The frames of the master of a rig that is booted, enabled, stopped and left on the embedded simulation.
    fn sent(rig: &Loaded<Rig>) -> Vec<Frame> {
        let frames = Arc::new(Mutex::new(Vec::new()));
        let scene = rig.scene().unwrap().value;
        let mut machine = EmbeddedRig::new(&rig.value, &scene, &rig.value.fixture, 1).unwrap();
        let taken = Arc::clone(&frames);
        machine.set_tap(Box::new(move |_, packet| taken.lock().unwrap().extend(packet.can())));
        machine.enable().unwrap();
        drop(machine);
        Arc::try_unwrap(frames).unwrap().into_inner().unwrap()
    }

    /// An expedited SDO download, as object and bytes.
    fn download(frame: &Frame) -> Option<(Address, Vec<u8>)> {
        let &[command, low, high, sub, ref data @ ..] = frame.data() else { return None };
        let bytes = 4 - usize::from(command >> 2 & 3);
        (command >> 5 == 1).then(|| (Address::new(u16::from_le_bytes([low, high]), sub), data[..bytes].to_vec()))
    }

    #[test]
    fn what_is_told_is_what_the_boot_sends_and_nothing_is_written_to_tell_it() {
        for name in ["", "-csp", "-csv", "-two-buses", "-polled", "-streaming"] {
            let rig = load_rig(Source::named(&format!("builtin:paper-admittance{name}.yaml"))).unwrap();
            let (planned, sent) = (planned(&rig), sent(&rig));
            let of_boot: Vec<&Line> = planned.iter().filter(|line| line.part != "leave").collect();
            let commands = |frame: &Frame| {
                let (command, node) = nmt::decode_command(frame)?;
                Some((frame.bus(), command, node.map(|node| node.raw())))
            };
            let told: Vec<_> = of_boot
                .iter()
                .filter_map(|line| match line.what {
                    What::Command(command) => Some((line.bus, command, node_of(line))),
                    _ => None,
                })
                .collect();
            // Each bus has an order of its own.
            let by_bus = |mut all: Vec<(BusId, NmtCommand, Option<u8>)>| {
                all.sort_by_key(|(bus, ..)| *bus);
                all
            };
            let sent_commands = by_bus(sent.iter().filter_map(commands).collect());
            assert_eq!(by_bus(told), sent_commands, "{name}: network management");
            let mut nodes: Vec<(BusId, u8)> =
                of_boot.iter().filter_map(|line| Some((line.bus, node_of(line)?))).collect();
            nodes.sort();
            nodes.dedup();
            assert!(nodes.len() >= 2);
            for (bus, id) in nodes {
                let is_of = |line: &&&Line| line.bus == bus && node_of(line) == Some(id);
                let told: Vec<_> = of_boot
                    .iter()
                    .filter(is_of)
                    .filter_map(|line| match &line.what {
                        What::Write(write) => {
                            assert!(write.old.is_some(), "{name} {id} {}", write.at);
                            (!write.stands).then(|| (write.at, write.new.clone().unwrap()))
                        }
                        _ => None,
                    })
                    .collect();
                let node = yieldwall_fieldbus::canopen::node_id(id).unwrap();
                let of_node = |cob: u16| sent.iter().filter(move |frame| frame.bus() == bus && frame.id() == cob);
                let written: Vec<_> = of_node(cob::sdo_request(node)).filter_map(download).collect();
                assert_eq!(told, written, "{name}: node {id}");
                let words: Vec<u16> = of_boot
                    .iter()
                    .filter(is_of)
                    .filter_map(|line| match line.what {
                        What::Controlword { new, .. } => Some(new),
                        _ => None,
                    })
                    .collect();
                let mut controlwords: Vec<u16> = of_node(cob::rpdo(1, node).unwrap())
                    .filter_map(|frame| frame.data().get(..2).map(|word| u16::from_le_bytes([word[0], word[1]])))
                    .collect();
                controlwords.dedup();
                assert_eq!(words, controlwords, "{name}: controlwords of node {id}");
            }
            // A sensor on plain CAN is told by frames of its own.
            let told: Vec<Frame> = of_boot
                .iter()
                .filter(|line| line.part == "start")
                .filter_map(|line| match &line.what {
                    What::Frame(frame, _) => Some(*frame),
                    _ => None,
                })
                .collect();
            let same = |frame: &Frame| (frame.bus(), frame.id(), frame.data().to_vec());
            let mut rest = sent.iter().map(same);
            assert!(told.iter().all(|frame| rest.any(|sent| sent == same(frame))), "{name}: {told:?}");
        }
    }

    /// The expedited SDO downloads in a frame of a segment: station address, object and bytes.
    fn coe_downloads(bytes: &[u8]) -> Vec<(u16, Address, Vec<u8>)> {
        let Ok(datagrams) = Datagrams::of(bytes) else { return Vec::new() };
        let of_mailbox = datagrams.filter_map(Result::ok).filter(|datagram| {
            let DatagramHeader { command, address, .. } = datagram.header;
            // The simulated devices have their mailboxes there.
            command == Command::Fpwr as u8 && address >> 16 == 0x1000 && datagram.data.len() >= 16
        });
        let told = of_mailbox.filter_map(|datagram| {
            let data = datagram.data;
            // CoE, the service of a request, and an expedited download.
            let is_download = data[5] & 0x0f == 3 && data[7] >> 4 == 2 && data[8] & 0xe2 == 0x22;
            let at = Address::new(u16::from_le_bytes([data[9], data[10]]), data[11]);
            let len = 4 - usize::from(data[8] >> 2 & 3);
            is_download.then(|| (datagram.header.address as u16, at, data[12..12 + len].to_vec()))
        });
        told.collect()
    }

    #[test]
    fn of_a_segment_too_what_is_told_is_what_the_boot_sends() {
        for name in
            ["paper-ethercat", "paper-ethercat-can-sensor", "vendors/ethercat-fixed-assignment", "vendors/float-sensor"]
        {
            let rig = load_rig(Source::named(&format!("builtin:{name}.yaml"))).unwrap();
            let mut desk = SegmentSession::of_rig(&rig, None).unwrap();
            let (lines, end) = segment::lines(&rig.value, &mut desk).unwrap();
            assert!(end.is_ok(), "{name}");
            let told = lines.iter().filter_map(|line| match (&line.what, line.owner.as_ref()?.place) {
                (What::Write(write), Place::Position(position)) => {
                    assert!(write.old.is_some(), "{name} {position} {}", write.at);
                    (!write.stands).then(|| (0x1000 + position, write.at, write.new.clone().unwrap()))
                }
                _ => None,
            });
            let mut told: Vec<_> = told.collect();
            let frames = Arc::new(Mutex::new(Vec::new()));
            let scene = rig.scene().unwrap().value;
            let mut machine = EmbeddedRig::new(&rig.value, &scene, &rig.value.fixture, 1).unwrap();
            let taken = Arc::clone(&frames);
            machine.set_tap(Box::new(move |_, packet| {
                if let Packet::Ethernet { bytes, .. } = packet {
                    taken.lock().unwrap().push(bytes.to_vec());
                }
            }));
            machine.enable().unwrap();
            drop(machine);
            let frames = Arc::try_unwrap(frames).unwrap().into_inner().unwrap();
            let mut sent: Vec<_> = frames.iter().flat_map(|bytes| coe_downloads(bytes)).collect();
            // A frame passes the tap on its way out and back.
            sent.dedup();
            // Devices are told at the same time; each has an order of its own.
            told.sort_by_key(|(station, ..)| *station);
            sent.sort_by_key(|(station, ..)| *station);
            sent.dedup();
            assert_eq!(told, sent, "{name}");
            assert!(told.len() > 10 || name.contains("fixed"), "{name}: {told:?}");
        }
    }

    #[test]
    fn a_device_that_the_boot_refuses_is_told_after_the_list() {
        let text = "like: builtin:paper-admittance.yaml\ndrives: [{name: left}, {name: right, profile: maxon-epos4, encoder: multi_turn}]\n";
        let other = load_rig(Source::memory("rig.yaml", text)).unwrap();
        let shipped = load_rig(Source::named("builtin:paper-admittance.yaml")).unwrap();
        let plan = master(&other.value, &other.value.fixture).unwrap().networks().plan().unwrap();
        let (lines, end) = lines(&shipped.value, &plan, &mut [DeviceSession::of_rig(&shipped, None).unwrap()]).unwrap();
        assert!(lines.len() > 50);
        let failure = end.unwrap_err();
        assert_eq!(failure.exit, Exit::DeviceMismatch);
        assert!(failure.report.diagnostics[0].message.contains("check the vendor"), "{failure:?}");
    }
}
