//! Scan of the devices on a bus.

use std::time::Duration;

use yieldwall_drives::eds::Value;
use yieldwall_drives::profiles::AxisOffset;

use super::axes::{MOST_AXES, supported_modes};
use super::connection::{Error, NodeTraffic, Service};
use yieldwall_fieldbus::canopen::{NodeId, node_id};
use yieldwall_fieldbus::objects::Address;
use yieldwall_link::CanLink;

/// Object that every device has: its type.
const DEVICE_TYPE: Address = Address::new(0x1000, 0);
/// How long a node may take to answer while all of them are asked, and how often it is asked again.
const PATIENCE: (Duration, u8) = (Duration::from_millis(400), 1);

/// A device that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundDevice {
    /// Its node id.
    pub node: NodeId,
    /// Traffic heard from it.
    pub heard: NodeTraffic,
    /// 1000h, if it answers: without an answer it was heard alone, as in Stopped.
    pub device_type: Option<u32>,
    /// Vendor, product, revision and serial number (1018h), as far as it has them.
    pub identity: [Option<u32>; 4],
    /// Its name (1008h), if it has one.
    pub name: Option<String>,
    /// Axes of a drive that was asked for them; 0 if it does not answer.
    pub axes: Option<u8>,
}

/// Reads the type of all nodes from 1 to 127, and the identity of those that answer, in the order of the node ids.
///
/// # Errors
/// [`Error::Link`], [`Error::Interrupted`].
pub fn scan<L: CanLink>(service: &mut Service<L>) -> Result<Vec<FoundDevice>, Error> {
    let nodes: Vec<NodeId> = (1..=127).filter_map(|raw| node_id(raw).ok()).collect();
    service.set_patience(PATIENCE.0, PATIENCE.1);
    let asked: Vec<(NodeId, Address)> = nodes.iter().map(|node| (*node, DEVICE_TYPE)).collect();
    let types = service.read_each(&asked)?;
    service.set_patience(Service::<L>::PATIENCE, 1);
    let mut there = Vec::new();
    for (node, answer) in nodes.into_iter().zip(types) {
        let has_answered = !matches!(answer, Err(Error::NoAnswer));
        if has_answered || service.heard(node).frames > 0 {
            there.push((node, has_answered, answer.ok().as_deref().map(number)));
        }
    }
    let stateless: Vec<NodeId> =
        there.iter().map(|(node, ..)| *node).filter(|node| service.heard(*node).state.is_none()).collect();
    if !stateless.is_empty() {
        service.guard(&stateless)?;
    }
    let answering: Vec<NodeId> = there.iter().filter(|(_, answers, _)| *answers).map(|(node, ..)| *node).collect();
    let mut identities = identify(service, &answering)?.into_iter();
    let drives = there.iter().filter(|(.., device_type)| device_type.is_some_and(is_drive)).map(|(node, ..)| *node);
    let axes = axes_of(service, drives.collect())?;
    let found = there.into_iter().map(|(node, answers, device_type)| {
        let (identity, name) = if answers { identities.next().unwrap_or_default() } else { Default::default() };
        let count = || axes.iter().filter(|drive| **drive == node).count() as u8;
        let axes = device_type.is_some_and(is_drive).then(count);
        FoundDevice { node, heard: service.heard(node), device_type, identity, name, axes }
    });
    Ok(found.collect())
}

/// Whether a device of this type (1000h) is one of CiA 402.
fn is_drive(device_type: u32) -> bool {
    device_type & 0xffff == 402
}

/// Each drive as often as it has axes, as [`count_axes`](crate::count_axes) counts them.
fn axes_of<L: CanLink>(service: &mut Service<L>, mut drives: Vec<NodeId>) -> Result<Vec<NodeId>, Error> {
    let mut axes = Vec::new();
    for axis in 0..MOST_AXES {
        let asked: Vec<(NodeId, Address)> =
            drives.iter().map(|drive| (*drive, supported_modes(AxisOffset::standard(axis)))).collect();
        let mut answers = service.read_each(&asked)?.into_iter();
        drives.retain(|_| answers.next().is_some_and(|answer| answer.is_ok()));
        axes.extend_from_slice(&drives);
    }
    Ok(axes)
}

/// Vendor, product, revision and serial number of a device, and its name.
pub type Identity = ([Option<u32>; 4], Option<String>);

/// Reads the identity of nodes.
///
/// # Errors
/// [`Error::Link`], [`Error::Interrupted`].
pub fn identify<L: CanLink>(service: &mut Service<L>, nodes: &[NodeId]) -> Result<Vec<Identity>, Error> {
    let objects = [1, 2, 3, 4].map(|sub| Address::new(0x1018, sub));
    let each = nodes.iter().flat_map(|node| {
        let objects = objects.into_iter().chain([Address::new(0x1008, 0)]);
        objects.map(|at| (*node, at))
    });
    let asked: Vec<(NodeId, Address)> = each.collect();
    let answers = service.read_each(&asked)?;
    let of_each = answers.chunks_exact(objects.len() + 1).map(|answers| {
        let value = |at: usize| answers.get(at).and_then(|answer| answer.as_deref().ok());
        let name = value(4).map(|bytes| String::from_utf8_lossy(bytes).trim_end_matches('\0').trim().to_owned());
        ([0, 1, 2, 3].map(|at| value(at).map(number)), name.filter(|name| !name.is_empty()))
    });
    Ok(of_each.collect())
}

/// An identifier that counts from the node id of the device that has it, as that; any other value as it is.
///
/// # Source
/// CiA 301, the predefined connection set: 1014h, and sub-index 1 of the PDO communication parameters.
pub fn of_node(at: Address, value: Value, node_id: u8) -> Value {
    let is_identifier =
        matches!((at.index, at.sub), (0x1014, 0) | (0x1200, 1 | 2) | (0x1400..0x1600 | 0x1800..0x1a00, 1));
    match value {
        Value::Integer(number) if is_identifier && node_id > 0 && number & 0x7f == i128::from(node_id) => {
            Value::OfNode(number - i128::from(node_id))
        }
        value => value,
    }
}

/// Up to four bytes as a number, the lowest first.
pub fn number(bytes: &[u8]) -> u32 {
    bytes.iter().take(4).rev().fold(0, |value, byte| value << 8 | u32::from(*byte))
}
