//! Place of the devices, and the selection among them.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::codes::ErrorCodes;
use yieldwall_drives::profiles::{AxisOffset, DeviceProfile};
use yieldwall_drives::scaling::AxisScaling;

use crate::ending::rig_failure;
use crate::failure::{Exit, Failure};
use crate::interrupt::on_interrupt;
use crate::output::Output;
use yieldwall_config::{self as config, Bus, Loaded, Rig, SensorProtocol, Source};
use yieldwall_fieldbus::canopen::{BusId, NodeId, node_id};
use yieldwall_rig::live::VirtualLink;
use yieldwall_run::assembly::{AssemblyError, bus_id, scaling};
use yieldwall_run::explanation::{self, Explanation};
use yieldwall_service::{AnyService, Error, Service};

/// The rig of the simulation unless another one is named.
const USUAL_RIG: &str = "builtin:paper-admittance.yaml";

/// Bus and rig of the devices.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct BusArguments {
    /// Interface of the bus; without it the command uses the rig's simulation and saves nothing
    #[arg(long, value_name = "INTERFACE")]
    pub(super) bus: Option<String>,
    /// Rig for names, device profiles and units; for one of its buses, give --bus as NAME=INTERFACE
    #[arg(long, value_name = "RIG.yaml")]
    pub(super) rig: Option<String>,
}

impl BusArguments {
    /// Returns the arguments with which another command reaches the same devices, after a space.
    pub(super) fn arguments(&self) -> String {
        arguments(self.bus.as_deref(), self.rig.as_deref())
    }
}

fn arguments(bus: Option<&str>, rig: Option<&str>) -> String {
    let option = |name: &str, value: Option<&str>| value.map_or(String::new(), |value| format!(" --{name} {value}"));
    option("bus", bus) + &option("rig", rig)
}

/// A rig's entry for a node.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub(super) name: String,
    pub(super) bus: BusId,
    pub(super) node: NodeId,
    pub(super) profile: Option<Arc<DeviceProfile>>,
    /// Meanings of its vendor's error codes.
    pub(super) codes: Option<Arc<ErrorCodes>>,
    /// Mode in which the rig commands the drive; only of a drive.
    pub(super) mode: Option<OperationMode>,
    /// Scaling of the axis; only of a drive.
    pub(super) scaling: Option<AxisScaling>,
}

/// The selected node, and the rig's entry for it.
#[derive(Clone, Debug)]
pub(super) struct Node {
    pub(super) id: NodeId,
    pub(super) entry: Option<Entry>,
    /// Offset of the objects of the selected axis.
    pub(super) axis: AxisOffset,
}

/// The devices of a bus, or of a simulation, and the rig that they may belong to.
pub(super) struct DeviceSession {
    pub(super) service: AnyService,
    pub(super) entries: Vec<Entry>,
    /// The buses that can be turned to, with their names in the rig.
    pub(super) buses: Vec<(BusId, String)>,
    /// Place of the device, as text.
    pub(super) place: String,
    /// Arguments with which another command reaches the same devices, after a space: ` --bus can0`.
    pub(super) arguments: String,
    /// The file of the rig, if there is one.
    pub(super) rig: Option<String>,
    pub(super) is_simulated: bool,
}

impl Entry {
    /// Returns its axis of the device; 0 on a device with one axis.
    pub(super) fn axis(&self) -> u8 {
        self.profile.as_ref().and_then(|profile| profile.axis()).unwrap_or_default()
    }
}

impl Node {
    /// Returns a node, for the axis of its entry.
    pub(super) fn of(id: NodeId, entry: Option<Entry>) -> Self {
        let axis = entry.as_ref().and_then(|entry| Some(entry.profile.as_ref()?.offset())).unwrap_or_default();
        Self { id, entry, axis }
    }

    /// Returns the name in messages: `node 1 (left)`.
    pub(super) fn words(&self) -> String {
        match &self.entry {
            Some(entry) => format!("node {} ({})", self.id.raw(), entry.name),
            None => format!("node {}", self.id.raw()),
        }
    }

    pub(super) fn scaling(&self) -> Option<&AxisScaling> {
        self.entry.as_ref()?.scaling.as_ref()
    }
}

impl DeviceSession {
    /// Opens a bus without a master, or the simulation, for a command that sends.
    pub(super) fn open(place: &BusArguments, output: &mut Output) -> Result<Self, Failure> {
        Self::of(place, false, output)
    }

    /// Opens a bus for a command that sends nothing.
    pub(super) fn only_listening(place: &BusArguments, output: &mut Output) -> Result<Self, Failure> {
        Self::of(place, true, output)
    }

    /// Opens the devices of an interface for a command that sends, with the rig that they may belong to.
    pub(super) fn on_bus(argument: &str, rig: Option<&Rig>, is_over: Arc<AtomicBool>) -> Result<Self, Failure> {
        let entries = rig.map_or(Ok(Vec::new()), entries)?;
        let desk = Self::on_interface(argument, rig, entries, false, is_over)?;
        Ok(Self { arguments: arguments(Some(argument), None), ..desk })
    }

    fn of(place: &BusArguments, is_silent: bool, output: &mut Output) -> Result<Self, Failure> {
        let rig = match (&place.rig, &place.bus) {
            (None, Some(_)) => None,
            (named, _) => {
                let rig = config::load_rig(Source::named(named.as_deref().unwrap_or(USUAL_RIG)))?.on_can()?;
                output.names_of(&rig.warnings)?;
                Some(rig)
            }
        };
        let entries = rig.as_ref().map_or(Ok(Vec::new()), |rig| entries(&rig.value))?;
        let desk = Self::at(rig.as_ref(), place.bus.as_deref(), entries, is_silent)?;
        output.aside(&desk.place);
        Ok(Self { arguments: place.arguments(), ..desk })
    }

    /// Opens the devices of a rig on one of its buses without a master, or those of its simulation.
    pub(super) fn of_rig(rig: &Loaded<Rig>, bus: Option<&str>) -> Result<Self, Failure> {
        Self::at(Some(rig), bus, entries(&rig.value)?, false)
    }

    fn at(rig: Option<&Loaded<Rig>>, bus: Option<&str>, entries: Vec<Entry>, is_silent: bool) -> Result<Self, Failure> {
        let is_over = on_interrupt()?;
        let desk = match (bus, rig) {
            (None, Some(rig)) => Self::simulated(rig, entries, is_over),
            (Some(bus), rig) => Self::on_interface(bus, rig.map(|rig| &rig.value), entries, is_silent, is_over),
            (None, None) => Err(Failure::new(Exit::Internal, "neither a bus nor a rig", "")),
        }?;
        let rig = rig.map(|rig| rig.source.to_string());
        Ok(Self { arguments: arguments(bus, rig.as_deref()), rig, ..desk })
    }

    fn simulated(rig: &Loaded<Rig>, entries: Vec<Entry>, is_over: Arc<AtomicBool>) -> Result<Self, Failure> {
        let scene = rig.scene()?.value;
        let link = VirtualLink::new(&rig.value, &scene, scene.seed).map_err(|error| rig_failure(&error))?;
        let buses: Vec<(BusId, String)> = BusId::all().zip(rig.value.buses.keys().cloned()).collect();
        Ok(Self {
            service: Service::new(Box::new(link), BusId::FIRST, is_over),
            entries,
            buses,
            place: format!("simulated devices of {}; those of a bus with --bus INTERFACE", rig.value.rig.name),
            arguments: String::new(),
            rig: None,
            is_simulated: true,
        })
    }

    #[cfg(target_os = "linux")]
    fn on_interface(
        argument: &str,
        rig: Option<&Rig>,
        mut entries: Vec<Entry>,
        is_silent: bool,
        is_over: Arc<AtomicBool>,
    ) -> Result<Self, Failure> {
        use super::journal::connect_failure;

        let (named, interface) = argument.split_once('=').map_or((None, argument), |(name, rest)| (Some(name), rest));
        let bus = match (rig, named) {
            (None, None) => BusId::FIRST,
            (Some(rig), None) if rig.buses.len() == 1 => BusId::FIRST,
            (Some(rig), Some(name)) if rig.buses.contains_key(name) => {
                bus_id(rig, name).map_err(|error| rig_failure(&error.into()))?
            }
            (Some(rig), _) => {
                let names: Vec<&str> = rig.buses.keys().map(String::as_str).collect();
                let message = format!("--bus {argument} does not say which of the rig's buses it is");
                return Err(Failure::new(
                    Exit::Usage,
                    message,
                    format!("write {}={interface}", names.join(&format!("={interface} or "))),
                ));
            }
            (None, Some(name)) => {
                let message = format!("--bus {argument} names the bus {name} of a rig, and no rig is given");
                return Err(Failure::new(
                    Exit::Usage,
                    message,
                    format!("write --bus {interface}, or name the rig with --rig"),
                ));
            }
        };
        let name = rig.and_then(|rig| rig.buses.keys().nth(bus.index()).cloned()).unwrap_or_default();
        let bit_rate =
            rig.and_then(|rig| rig.buses.get(&name)).and_then(Bus::canopen).map(|bus| bus.bit_rate_bit_per_s);
        let service = match is_silent {
            true => AnyService::listening_on(interface, bit_rate, &is_over),
            false => AnyService::on_interface(interface, bit_rate, &is_over),
        };
        let service = service.map_err(|error| connect_failure(&error))?;
        // An interface is a single bus to its link.
        entries.retain(|entry| entry.bus == bus);
        entries.iter_mut().for_each(|entry| entry.bus = BusId::FIRST);
        Ok(Self {
            service,
            entries,
            buses: vec![(BusId::FIRST, name)],
            place: format!("devices on {interface}"),
            arguments: String::new(),
            rig: None,
            is_simulated: false,
        })
    }

    #[cfg(not(target_os = "linux"))]
    fn on_interface(_: &str, _: Option<&Rig>, _: Vec<Entry>, _: bool, _: Arc<AtomicBool>) -> Result<Self, Failure> {
        Err(Failure::new(Exit::Usage, "this system has no CAN interfaces", "leave out --bus"))
    }

    /// Returns the node for a word: a node id, or the name of a device in the rig. Selects its bus.
    pub(super) fn node(&mut self, word: &str) -> Result<Node, Failure> {
        let by_name = self.entries.iter().find(|entry| entry.name == word);
        let number = word.parse::<u8>().ok().and_then(|raw| node_id(raw).ok());
        let node = match (by_name, number) {
            (Some(entry), _) => Node::of(entry.node, Some(entry.clone())),
            (None, Some(id)) => Node::of(id, self.entries.iter().find(|entry| entry.node == id).cloned()),
            (None, None) => {
                let names: Vec<&str> = self.entries.iter().map(|entry| entry.name.as_str()).collect();
                let first = word.split([',', ' ']).find(|part| !part.is_empty()).unwrap_or("1");
                let help = match config::nearest_word(word, names.iter().copied()) {
                    Some(meant) => format!("did you mean {meant}?"),
                    None if word.contains([',', ' ']) => {
                        format!("one device is asked at a time: write for example {first}")
                    }
                    None if names.is_empty() => {
                        "write a node id from 1 to 127; names are those of a rig, with --rig".to_owned()
                    }
                    None => format!("write a node id from 1 to 127, or one of {}", names.join(", ")),
                };
                return Err(Failure::new(
                    Exit::Usage,
                    format!("{word} is neither a node id nor a device of the rig"),
                    help,
                ));
            }
        };
        if let Some(entry) = &node.entry {
            self.service.turn_to(entry.bus);
        }
        Ok(node)
    }

    /// Returns the rig's entry for a node on the selected bus.
    pub(super) fn entry(&self, node: NodeId) -> Option<&Entry> {
        let bus = self.service.bus();
        self.entries.iter().find(|entry| (entry.bus, entry.node) == (bus, node))
    }

    /// Names of the rig for a node on the bus that is turned to: of all drives that are its axes.
    pub(super) fn names(&self, node: NodeId) -> Option<String> {
        let bus = self.service.bus();
        let own = self.entries.iter().filter(|entry| (entry.bus, entry.node) == (bus, node));
        let names: Vec<&str> = own.map(|entry| entry.name.as_str()).collect();
        (!names.is_empty()).then(|| names.join(" and "))
    }

    /// Returns the failure of a request to a device.
    pub(super) fn failure(&self, node: &Node, doing: &str, error: Error) -> Failure {
        node_failure(format!("{}: {doing}: {error}", node.words()), error, &self.command("doctor node", node))
    }

    /// Returns a command about a node of this place, in back quotes: `yieldwall doctor node 5 --bus can0`.
    pub(super) fn command(&self, words: &str, node: &Node) -> String {
        format!("`yieldwall {words} {}{}`", node.id.raw(), self.arguments)
    }

    /// Explains an error code of a node, with advice for this place.
    pub(super) fn explained(&self, node: &Node, code: u16) -> Explanation {
        let codes = node.entry.as_ref().and_then(|entry| entry.codes.as_deref());
        self.placed(node, explanation::error_code(code, codes))
    }

    /// Returns an explanation of something that a node shows, with advice for this place.
    pub(super) fn placed(&self, node: &Node, explanation: Explanation) -> Explanation {
        placed(explanation, node.id.raw().into(), &self.arguments, self.rig.as_deref())
    }

    /// Returns the failure for an error that no single device caused.
    pub(super) fn bus_failure(&self, error: Error) -> Failure {
        match error {
            Error::Interrupted => Failure::new(Exit::Interrupted, error.to_string(), ""),
            error => link_down(error.to_string()),
        }
    }
}

/// Returns the failure of a request to a node; `doctor` is the command that finds the cause.
pub(super) fn node_failure(message: String, error: Error, doctor: &str) -> Failure {
    match error {
        Error::Link(_) => link_down(message),
        error => object_failure(message, error, format!("{doctor} finds out why")),
    }
}

/// Returns the failure of a request on an object; `silent` is the advice if the device does not answer.
pub(super) fn object_failure(message: String, error: Error, silent: String) -> Failure {
    match error {
        Error::NoAnswer | Error::MayBeWritten => Failure::new(Exit::DeviceMismatch, message, silent),
        Error::Refused(_) => Failure::new(Exit::DeviceMismatch, message, ""),
        Error::Senseless(_) => {
            Failure::new(Exit::DeviceMismatch, message, "the device breaks the protocol: report it to its maker")
        }
        Error::Boundless(_) => Failure::new(
            Exit::DeviceMismatch,
            message,
            "give its data sheet with --eds: only what is in it is asked for",
        ),
        Error::TooLong(_) => Failure::new(Exit::Usage, message, ""),
        Error::Link(_) => Failure::new(Exit::BusUnavailable, message, ""),
        Error::Interrupted => Failure::new(Exit::Interrupted, message, ""),
    }
}

/// Adapts the commands in an explanation's advice to this device: `yieldwall emcy NODE` becomes `yieldwall emcy 1 --bus can0`.
pub(super) fn placed(explanation: Explanation, device: u16, arguments: &str, rig: Option<&str>) -> Explanation {
    let next = placed_text(&explanation.next, device, arguments, rig).into();
    Explanation { next, ..explanation }
}

/// Advice with the place of the device.
pub(crate) fn placed_text(advice: &str, device: u16, arguments: &str, rig: Option<&str>) -> String {
    let parts = advice.split('`').enumerate().map(|(at, part)| match part.strip_prefix("yieldwall ") {
        Some(command) if at % 2 == 1 => format!("yieldwall {}", filled(command, device, arguments, rig)),
        _ => part.to_owned(),
    });
    parts.collect::<Vec<_>>().join("`")
}

fn filled(command: &str, device: u16, arguments: &str, rig: Option<&str>) -> String {
    let is_named = |word: &str| command.split(' ').any(|one| one == word);
    let bus = arguments.strip_prefix(" --bus ").and_then(|rest| rest.split(' ').next());
    let more = match (command.split(' ').next(), bus) {
        // These name the rig, and may take a bus.
        (Some("run" | "drill"), Some(bus)) if is_named("RIG.yaml") => format!(" --bus {bus}"),
        _ if is_named("RIG.yaml") => String::new(),
        _ if is_named("NODE") || matches!(command, "scan" | "monitor") => arguments.to_owned(),
        _ => String::new(),
    };
    let words = command.split(' ').map(|word| match word {
        "NODE" => device.to_string(),
        "RIG.yaml" => rig.unwrap_or(word).to_owned(),
        _ => word.to_owned(),
    });
    words.collect::<Vec<_>>().join(" ") + &more
}

fn link_down(message: String) -> Failure {
    let help =
        "nobody acknowledges: look whether a device is switched on, at the cable, its termination and the bit rate";
    Failure::new(Exit::BusUnavailable, message, help)
}

/// Returns the CANopen devices of a rig.
fn entries(rig: &Rig) -> Result<Vec<Entry>, Failure> {
    let mut entries = Vec::new();
    let place = |bus: &str, raw: u8| {
        let bus = bus_id(rig, bus).map_err(|error| rig_failure(&error.into()))?;
        let node = node_id(raw).map_err(|error| Failure::new(Exit::ConfigInvalid, error.to_string(), ""))?;
        Ok::<_, Failure>((bus, node))
    };
    if rig.own_node().is_none() {
        return Err(rig_failure(&AssemblyError::OnEthercat.into()));
    }
    for drive in &rig.drives {
        let Some(raw) = drive.address.node_id() else { continue };
        let (bus, node) = place(&drive.bus, raw)?;
        let scaling = scaling(drive).map_err(|error| rig_failure(&error.into()))?;
        let profile = rig.model(drive);
        let mode = Some(rig.rig.command_mode.operation_mode());
        let codes = drive.profile.error_codes().cloned();
        entries.push(Entry { name: drive.name.clone(), bus, node, profile, codes, mode, scaling: Some(scaling) });
    }
    if let SensorProtocol::Canopen { node_id: raw, profile, .. } = &rig.sensor.protocol {
        let (bus, node) = place(&rig.sensor.bus, *raw)?;
        entries.push(Entry {
            name: rig.sensor.name.clone(),
            bus,
            node,
            profile: profile.get().cloned(),
            codes: profile.error_codes().cloned(),
            mode: None,
            scaling: None,
        });
    }
    Ok(entries)
}
