//! `run --dry-run` and `drill --dry-run`: the frames that boot and start would send to each device, in order, old -> new. The
//! commands only read objects, and send nothing on a bus with a master. They bring a device on EtherCAT from INIT to PRE-OP and
//! back.

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

/// The sender of the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sender {
    /// `run`.
    Run,
    /// `drill`.
    Drill,
}

/// One frame or setting that would be sent.
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

    /// Returns the name in messages: `node 1 (left)`, `left (position 0)`.
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
    /// A frame, and its description.
    Frame(Frame, String),
    /// A setting of a device on EtherCAT that is no object.
    Set(String),
    /// An object.
    Write(PlannedWrite),
    /// A controlword.
    Controlword { old: Option<u16>, new: u16 },
}

/// Prints the frames of a rig's boot and start: to its devices on these buses, `NAME=INTERFACE` each, or to the simulated ones.
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
    let other = if is_simulated { " (--bus INTERFACE reads a real bus)" } else { "" };
    // Only CAN is reset.
    let again = if desks.is_empty() { "" } else { " `x -> x`: written again, because the reset may change it." };
    let mut text = words::wrapped(&format!(
        "Dry run: nothing written. Old values: read from the {asked}{other}. `unchanged`: not written.{again}"
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
            "\nThe drill runs this {rounds} times, with the rig at rest. Each time it stops one signal ({each}) until both drives have stopped (limit {} s).",
            DRILL_LIMIT.as_secs()
        )));
    }
    output.result(&text)?;
    end
}

/// Returns all lines, and the obstacle if the boot would not complete.
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

/// Returns the values that would be written to one node, and whether it does not answer or would be refused.
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

/// Returns the device session for a bus of the rig, and the name of the bus there: an interface is a single bus to its link.
fn desk_of<'a>(bus: BusId, rig: &Rig, desks: &'a mut [DeviceSession]) -> Option<(&'a mut DeviceSession, BusId)> {
    if desks.first()?.is_simulated {
        return Some((desks.first_mut()?, bus));
    }
    // The sessions are those of the buses on CAN, in order.
    let before = rig.buses.values().take(bus.index()).filter(|bus| !matches!(bus, Bus::Ethercat(_))).count();
    Some((desks.get_mut(before)?, BusId::FIRST))
}

fn heading(line: &Line, rig: &Rig, sender: Sender) -> String {
    let period_ms = f64::from(rig.cycle.period_us) * 1e-3;
    match (line.part, &line.owner) {
        (segment::PART, _) => segment::HEADING.to_owned(),
        ("boot", _) => words::wrapped(&format!(
            "\nReset, if no other master is heard before, nor within {} ms after, the first heartbeat; further heartbeats every {} ms",
            ANNOUNCED.as_millis(),
            rig.own_node().map_or(0, |own| own.heartbeat_ms)
        )),
        (CONFIGURE, Some(owner @ Owner { place: Place::Position(_), .. })) => {
            words::wrapped(&format!("\nObjects of {} by CoE in PRE-OP; old values: present ones", owner.words()))
        }
        (CONFIGURE, Some(Owner { place: Place::Node(id), name })) => {
            let bus = rig.buses.keys().nth(line.bus.index()).filter(|_| rig.buses.len() > 1);
            let bus = bus.map_or(String::new(), |bus| format!(" on {bus}"));
            words::wrapped(&format!(
                "\nNode {id} ({name}){bus} by SDO, in parallel with the other nodes; old values: before the reset"
            ))
        }
        ("start", Some(Owner { place: Place::Position(_), .. })) => {
            "\nClocks and process data, then SAFE-OP and OP\n".to_owned()
        }
        ("start", _) => "\nStart\n".to_owned(),
        ("enable", _) => {
            let proof = if sender == Sender::Run { ", with a watchdog drill on record" } else { "" };
            let with = if rig.has_drives_on_ethercat() { "process data" } else { "SYNC" };
            let behind = if rig.has_drives_on_ethercat() { "in them" } else { "and after it" };
            words::wrapped(&format!(
                "\nEnable: from here on {with} every {period_ms} ms, {behind} set-points with these controlwords. On a bus 0006h lasts \
                 {} cycles{proof}; each further controlword follows the reaction of the drive",
                settling_on_bus(rig)
            ))
        }
        _ => "\nAfter the stop\n".to_owned(),
    }
}

impl Line {
    /// Returns the scaling of the drive that it is for.
    fn scaling<'a>(&self, scalings: &'a Scalings) -> Option<&'a AxisScaling> {
        let name = &self.owner.as_ref()?.name;
        scalings.iter().find(|(known, _)| known == name).map(|(_, scaling)| scaling)
    }

    fn words(&self, rig: &Rig, scalings: &Scalings) -> String {
        // The name of a single bus adds no information.
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
                let is_unknown = name.is_empty();
                let name = match write.doing.strip_prefix("set the ").filter(|_| is_unknown) {
                    Some(of_profile) => of_profile.replace(' ', "-"),
                    None if is_unknown => write.doing.to_owned(),
                    None => name,
                };
                let (old, new) = (short(write.at, write.old.as_deref()), short(write.at, write.new.as_deref()));
                let before = if self.part == CONFIGURE { String::new() } else { format!("{bus}{who}: ") };
                // Behind the name of a node less is left of the line.
                let wide = if before.is_empty() { 28 } else { 20 };
                let change = if write.stands { format!("{new} unchanged") } else { format!("{old} -> {new}") };
                let line = format!("{before}{:8}  {name:wide$}  {change}", write.at.to_string());
                let scaling = self.scaling(scalings);
                let means = write
                    .new
                    .as_ref()
                    .and_then(|new| words::value(write.at, data_type(write.at, new), new, scaling).means);
                let means =
                    means.or_else(|| torque_words(rig, scaling.filter(|_| is_unknown && name == TORQUE_LIMIT)?));
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

/// Name of an object of a profile that limits the torque in a unit of its own.
const TORQUE_LIMIT: &str = "torque-limit";

/// Describes the torque at the joint to which the rig limits a drive, as 6072h has it.
fn torque_words(rig: &Rig, scaling: &AxisScaling) -> Option<String> {
    let raw = scaling.torque_per_mille(rig.guard.torque_limit_n_m.get()).ok()?.value.unsigned_abs().to_le_bytes();
    let at = Address::new(0x6072, 0);
    words::value(at, data_type(at, &raw), &raw, Some(scaling)).means
}

/// Objects that hold the indices of other objects.
const ASSIGNMENTS: std::ops::Range<u16> = 0x1c10..0x1c30;

/// Formats a value briefly: identifiers, mappings and monitored nodes as 32 bits in hexadecimal, all else as a number.
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
        Sender::Drill => format!("the rig rests; it stops if a joint moves by more than {REST_RAD} rad"),
        Sender::Run => format!(
            "as far as the hand moves the tool, which keeps {} m from the edge of the workspace and from singular poses",
            guard.singularity_margin_m.get()
        ),
    };
    words::wrapped(&format!("\nMotion: begins at the measured pose; {motion}. Limits: {limits}."))
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
mod tests;
