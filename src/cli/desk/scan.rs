//! `yieldwall scan`: who is on a bus.

use std::time::Duration;

use serde_json::{Value, json};
use yieldwall_drives::profiles::{DeviceProfile, Identity as Wanted};

use super::place::{BusArguments, DeviceSession};
use super::segment::{self, SegmentSession};
use super::words::{nmt_words, table};
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_config::ProfileName;
use yieldwall_link::OtherTraffic;
use yieldwall_service::{FoundDevice, scan};

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    place: BusArguments,
    /// Send nothing, and list devices heard within 3 s; use this beside a running master
    #[arg(long)]
    listen: bool,
}

/// Duration of listening.
const LISTENING: Duration = Duration::from_secs(3);

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let segment = match arguments.listen {
        true => SegmentSession::only_listening(&arguments.place, output)?,
        false => SegmentSession::open(&arguments.place, output)?,
    };
    if let Some(desk) = segment {
        return segment::scan::run(arguments.listen, desk, output);
    }
    let mut desk = match arguments.listen {
        true => DeviceSession::only_listening(&arguments.place, output)?,
        false => DeviceSession::open(&arguments.place, output)?,
    };
    let mut rows = Vec::new();
    let (mut documents, mut others) = (Vec::new(), Vec::new());
    for (bus, name) in desk.buses.clone() {
        desk.service.turn_to(bus);
        let found = match arguments.listen {
            true => heard(&mut desk)?,
            false => scan(&mut desk.service).map_err(|error| desk.bus_failure(error))?,
        };
        if desk.buses.len() > 1 {
            rows.push(format!("bus {name}\n"));
        }
        let other = desk.service.others();
        rows.push(text(&desk, &found, other));
        others.push(json!({ "bus": name, "extended_frames": other.extended, "fd_frames": other.fd }));
        documents.extend(found.iter().map(|found| document(&desk, &name, found)));
    }
    if output.is_json() {
        let nodes = json!({
            "place": desk.place,
            "simulated": desk.is_simulated,
            "nodes": documents,
            "other_traffic": others,
        });
        return output.report(nodes);
    }
    output.result(&rows.concat())
}

/// Returns the devices that are heard without a request.
fn heard(desk: &mut DeviceSession) -> Result<Vec<FoundDevice>, Failure> {
    desk.service.listen(LISTENING, |_| {}).map_err(|error| desk.bus_failure(error))?;
    let nodes = (1..=127).filter_map(|raw| yieldwall_fieldbus::canopen::node_id(raw).ok());
    let heard = nodes.map(|node| (node, desk.service.heard(node))).filter(|(_, heard)| heard.frames > 0);
    Ok(heard
        .map(|(node, heard)| FoundDevice {
            node,
            heard,
            device_type: None,
            identity: [None; 4],
            name: None,
            axes: None,
        })
        .collect())
}

fn text(desk: &DeviceSession, found: &[FoundDevice], others: OtherTraffic) -> String {
    if found.is_empty() {
        return none(others);
    }
    let mut rows = vec![["node", "state", "device", "name", "rig"].map(str::to_owned)];
    for found in found {
        let state = state(found);
        let name = found.name.clone().unwrap_or_else(|| "-".to_owned());
        let kind = match found.axes {
            Some(axes @ 2..) => format!("{}, {axes} axes", kind(found.device_type)),
            _ => kind(found.device_type),
        };
        rows.push([found.node.raw().to_string(), state, kind, name, fit(desk, found)]);
    }
    let table = table(&rows);
    // Under each device who it is, so that a line stays within 80 columns.
    let mut text = String::new();
    for (at, line) in table.lines().enumerate() {
        text.push_str(line);
        text.push('\n');
        if let Some(identity) =
            at.checked_sub(1).and_then(|at| found.get(at)).and_then(|found| identity_words(found.identity))
        {
            text.push_str(&format!("      {identity}\n"));
        }
    }
    if !others.is_none() {
        text.push_str(&format!("beside them {others}, which are none of CANopen\n"));
    }
    text
}

/// Reports that no node was found, and the other traffic on the bus.
fn none(others: OtherTraffic) -> String {
    match others.is_none() {
        true => "no node answers or is heard: is anything switched on, is the bit rate right?\n".to_owned(),
        false => format!(
            "no CANopen node answers or is heard, and {others} came:\nthe bit rate is right, and something else than CANopen uses this bus\n"
        ),
    }
}

/// Returns the device's NMT state, if it reports one.
fn state(found: &FoundDevice) -> String {
    found.heard.state.map_or("tells none", nmt_words).to_owned()
}

/// Returns the kind of device for this device type.
pub(super) fn kind(device_type: Option<u32>) -> String {
    match device_type.map(|device_type| (device_type & 0xffff, device_type >> 16 & 0xff)) {
        None => "-".to_owned(),
        Some((402, 0x02)) => "servo drive".to_owned(),
        Some((402, 0x01)) => "inverter".to_owned(),
        Some((402, 0x04)) => "stepper drive".to_owned(),
        Some((402, _)) => "drive".to_owned(),
        Some((401, _)) => "I/O".to_owned(),
        Some((404, _)) => "sensor".to_owned(),
        Some((406, _)) => "encoder".to_owned(),
        Some((405, _)) => "controller".to_owned(),
        Some((profile, _)) => format!("CiA {profile}"),
    }
}

/// Returns the known part of the identity: `vendor FFFF5957h product 00000402h`.
pub(super) fn identity_words(identity: [Option<u32>; 4]) -> Option<String> {
    let names = ["vendor", "product", "revision", "serial"];
    let parts: Vec<String> =
        names.into_iter().zip(identity).filter_map(|(name, value)| Some(format!("{name} {:08X}h", value?))).collect();
    (!parts.is_empty()).then(|| parts.join(" "))
}

/// Returns the rig's entry for a node, and whether the device is one; without an entry the profile that it fits.
pub(super) fn fit(desk: &DeviceSession, found: &FoundDevice) -> String {
    let names = desk.names(found.node).unwrap_or_default();
    let entry = desk.entry(found.node);
    let entry = entry.map(|entry| (names.as_str(), entry.profile.as_deref().map(DeviceKind::of)));
    fit_of(entry, found.identity, found.device_type)
}

/// Kind that a device of a rig has to have, and its name.
#[derive(Clone, Copy, Debug)]
pub(super) struct DeviceKind<'a> {
    pub(super) identity: &'a Wanted,
    pub(super) name: &'a str,
}

impl<'a> DeviceKind<'a> {
    /// Returns the kind of device that the profile describes.
    pub(super) fn of(profile: &'a DeviceProfile) -> Self {
        Self { identity: &profile.identity, name: profile.name() }
    }
}

/// Returns the fit of an entry, given its name and kind.
pub(super) fn fit_of(
    entry: Option<(&str, Option<DeviceKind<'_>>)>,
    identity: [Option<u32>; 4],
    device_type: Option<u32>,
) -> String {
    let is_one = |wanted: &Wanted| is_one(wanted, identity, device_type);
    match entry {
        Some((name, Some(_))) if identity == [None; 4] => format!("{name}, if it is one"),
        Some((name, Some(kind))) if !is_one(kind.identity) => format!("{name} is another device ({})", kind.name),
        Some((name, _)) => name.to_owned(),
        None => match ProfileName::shipped().find(|(_, profile)| is_one(&profile.identity)) {
            Some((name, _)) => format!("none; profile {name}"),
            None => "none".to_owned(),
        },
    }
}

fn is_one(wanted: &Wanted, identity: [Option<u32>; 4], device_type: Option<u32>) -> bool {
    let [vendor, product, revision, _] = identity;
    vendor == Some(wanted.vendor_id)
        && product.is_some_and(|product| wanted.product_codes.contains(&product))
        && wanted.revisions.includes(revision.unwrap_or_default())
        && device_type.zip(wanted.device_type).is_none_or(|(device_type, wanted)| device_type == wanted)
}

fn document(desk: &DeviceSession, bus: &str, found: &FoundDevice) -> Value {
    let [vendor, product, revision, serial] = found.identity;
    json!({
        "bus": bus,
        "node_id": found.node.raw(),
        "state": state(found),
        "device_type": found.device_type,
        "kind": kind(found.device_type),
        "axes": found.axes,
        "name": found.name,
        "vendor_id": vendor,
        "product_code": product,
        "revision": revision,
        "serial": serial,
        "rig_entry": desk.names(found.node),
        "fits": fit(desk, found),
    })
}
