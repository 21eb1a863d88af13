//! A device whose objects are asked, on whatever bus it is.

use std::time::Duration;

use serde_json::Value as Json;
use yieldwall_drives::profiles::{AxisOffset, DeviceProfile};
use yieldwall_drives::scaling::AxisScaling;

use super::keeping::Named;
use super::place::{BusArguments, DeviceSession, Node, placed};
use super::segment::{Device, SegmentSession};
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_fieldbus::objects::Address;
use yieldwall_run::explanation::Explanation;
use yieldwall_service::adopt::TrialAccess;
use yieldwall_service::{Bytes, Error, ObjectAccess, number};

/// The device, and the desk at which it is.
pub(super) enum DeviceHandle {
    Node(Box<DeviceSession>, Node),
    /// Its mailbox is open.
    Device(Box<SegmentSession>, Device),
}

/// Distances of the objects of an axis of a device that the rig names by these profiles, if it names it.
fn offset_of<'a>(mut profiles: impl Iterator<Item = Option<&'a DeviceProfile>>, axis: u8) -> AxisOffset {
    let axes = profiles.find_map(|profile| profile?.servo()?.axes.as_ref());
    axes.map_or(AxisOffset::standard(axis), |axes| axes.offset(axis))
}

impl DeviceHandle {
    pub(super) fn open(place: &BusArguments, word: &str, output: &mut Output) -> Result<Self, Failure> {
        match SegmentSession::open(place, output)? {
            Some(desk) => Self::on_segment(desk, word, output),
            None => {
                let mut desk = DeviceSession::open(place, output)?;
                let node = desk.node(word)?;
                Ok(Self::Node(Box::new(desk), node))
            }
        }
    }

    /// Returns a device on EtherCAT.
    pub(super) fn on_segment(mut desk: SegmentSession, word: &str, output: &Output) -> Result<Self, Failure> {
        let device = desk.device(word)?;
        desk.reach(&device, output)?;
        Ok(Self::Device(Box::new(desk), device))
    }

    pub(super) fn is_on_can(&self) -> bool {
        matches!(self, Self::Node(..))
    }

    /// Selects another device at the same place.
    pub(super) fn turn_to(&mut self, word: &str, output: &Output) -> Result<(), Failure> {
        match self {
            Self::Node(desk, node) => *node = desk.node(word)?,
            Self::Device(desk, device) => {
                *device = desk.device(word)?;
                desk.reach(device, output)?;
            }
        }
        Ok(())
    }

    /// Listens at the device for this time.
    pub(super) fn pause(&mut self, time: Duration) -> Result<(), Failure> {
        match self {
            Self::Node(desk, _) => desk.service.listen(time, |_| {}).map_err(|error| desk.bus_failure(error)),
            Self::Device(desk, device) => {
                let listened = desk.objects(device)?.listen(time);
                listened.map_err(|error| desk.segment_failure(error))
            }
        }
    }

    /// Returns its objects.
    pub(super) fn objects(&mut self) -> Result<Box<dyn ObjectAccess + '_>, Failure> {
        match self {
            Self::Node(desk, node) => Ok(Box::new(desk.service.objects(node.id))),
            Self::Device(desk, device) => Ok(Box::new(desk.objects(device)?)),
        }
    }

    /// Returns the access for tests of the device.
    pub(super) fn tried(&mut self) -> Result<Box<dyn TrialAccess + '_>, Failure> {
        match self {
            Self::Node(desk, node) => Ok(Box::new(desk.service.objects(node.id))),
            Self::Device(desk, device) => Ok(Box::new(desk.objects(device)?)),
        }
    }

    pub(super) fn read(&mut self, at: Address) -> Result<Bytes, Error> {
        match self.objects() {
            Ok(mut objects) => objects.read(at),
            Err(_) => Err(Error::NoAnswer),
        }
    }

    /// Returns an object as a number; `None` if the device has none.
    pub(super) fn number_of(&mut self, at: Address, doing: &str) -> Result<Option<u32>, Failure> {
        match self.read(at) {
            Ok(bytes) => Ok(Some(number(&bytes))),
            Err(Error::Refused(_)) => Ok(None),
            Err(error) => Err(self.failure(doing, error)),
        }
    }

    /// Selects an axis of the device: that of the rig's drive, or else that at the objects of a profile of the device, or else that
    /// of CiA 402.
    pub(super) fn turn_to_axis(&mut self, axis: u8) {
        match self {
            Self::Node(desk, node) => {
                let bus = desk.service.bus();
                let own = |entry: &&super::place::Entry| (entry.bus, entry.node, entry.axis()) == (bus, node.id, axis);
                *node = match desk.entries.iter().find(own) {
                    Some(entry) => Node::of(node.id, Some(entry.clone())),
                    None => {
                        let same = desk.entries.iter().filter(|entry| (entry.bus, entry.node) == (bus, node.id));
                        let axis = offset_of(same.map(|entry| entry.profile.as_deref()), axis);
                        Node { id: node.id, entry: None, axis }
                    }
                };
            }
            Self::Device(desk, device) => {
                let position = device.position;
                let own = |entry: &&super::segment::Entry| (entry.position, entry.axis()) == (position, axis);
                *device = match desk.entries.iter().find(own) {
                    Some(entry) => Device::of(position, Some(entry.clone())),
                    None => {
                        let same = desk.entries.iter().filter(|entry| entry.position == position);
                        let axis = offset_of(same.map(|entry| entry.profile.as_deref()), axis);
                        Device { position, entry: None, axis }
                    }
                };
            }
        }
    }

    /// Maps an object of the first axis to the selected axis.
    pub(super) fn at(&self, at: Address) -> Address {
        let axis = match self {
            Self::Node(_, node) => node.axis,
            Self::Device(_, device) => device.axis,
        };
        Address::new(axis.index(at.index), at.sub)
    }

    pub(super) fn words(&self) -> String {
        match self {
            Self::Node(_, node) => node.words(),
            Self::Device(_, device) => device.words(),
        }
    }

    /// Returns its name in the rig.
    pub(super) fn name(&self) -> Option<&str> {
        match self {
            Self::Node(_, node) => node.entry.as_ref().map(|entry| entry.name.as_str()),
            Self::Device(_, device) => device.entry.as_ref().map(|entry| entry.name.as_str()),
        }
    }

    /// Returns the name of the device in commands.
    pub(super) fn named(&self) -> Named {
        match self {
            Self::Node(_, node) => Named::Node(node.id),
            Self::Device(_, device) => Named::Position(device.position),
        }
    }

    pub(super) fn number(&self) -> u16 {
        self.named().number()
    }

    pub(super) fn scaling(&self) -> Option<&AxisScaling> {
        match self {
            Self::Node(_, node) => node.scaling(),
            Self::Device(_, device) => device.entry.as_ref()?.scaling.as_ref(),
        }
    }

    pub(super) fn is_simulated(&self) -> bool {
        match self {
            Self::Node(desk, _) => desk.is_simulated,
            Self::Device(desk, _) => desk.is_simulated,
        }
    }

    /// Returns the arguments with which another command reaches the same devices, after a space.
    pub(super) fn arguments(&self) -> &str {
        match self {
            Self::Node(desk, _) => &desk.arguments,
            Self::Device(desk, _) => &desk.arguments,
        }
    }

    pub(super) fn place(&self) -> &str {
        match self {
            Self::Node(desk, _) => &desk.place,
            Self::Device(desk, _) => &desk.place,
        }
    }

    /// Returns a document with the place and the device in it.
    pub(super) fn document(&self, mut document: Json) -> Json {
        if let Json::Object(keys) = &mut document {
            keys.insert("place".to_owned(), self.place().into());
            keys.insert(self.named().key().to_owned(), self.number().into());
        }
        document
    }

    /// Explains one of the device's error codes, with advice for this place.
    pub(super) fn explained(&self, code: u16) -> Explanation {
        match self {
            Self::Node(desk, node) => desk.explained(node, code),
            Self::Device(desk, device) => desk.explained(device, code),
        }
    }

    /// Returns an explanation of something that it shows, with advice for this place.
    pub(super) fn placed(&self, explanation: Explanation) -> Explanation {
        match self {
            Self::Node(desk, node) => desk.placed(node, explanation),
            Self::Device(desk, device) => placed(explanation, device.position, &desk.arguments, None),
        }
    }

    /// Returns the failure of a request to the device.
    pub(super) fn failure(&self, doing: &str, error: Error) -> Failure {
        match self {
            Self::Node(desk, node) => desk.failure(node, doing, error),
            Self::Device(desk, device) => desk.object_failure(device, doing, error),
        }
    }

    /// Returns a command about it, in back quotes.
    pub(super) fn command(&self, words: &str) -> String {
        format!("`yieldwall {words} {}{}`", self.number(), self.arguments())
    }
}
