//! A device that a journal names, reached on its interface.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use thiserror::Error;
use yieldwall_drives::cia402::{State, Statusword};

use crate::connect::{AnySegmentService, AnyService, Connect, ConnectError};
use crate::segment::SegmentError;
use crate::{Bytes, Error as ObjectError, MOST_AXES, ObjectAccess, number, statusword_of};
use yieldwall_bus::ethercat::SegmentFailure;
use yieldwall_fieldbus::canopen::{NmtCommand, NodeId, node_id};
use yieldwall_fieldbus::ethercat::{AlState, AlStatus};
use yieldwall_fieldbus::objects::Address;

/// Vendor, product and serial number, which distinguish a device from all others.
const IDENTITY: [Address; 3] = [Address::new(0x1018, 1), Address::new(0x1018, 2), Address::new(0x1018, 4)];

/// Place of a device on the interfaces of a computer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DevicePlace {
    /// Name of the interface.
    pub interface: String,
    /// The interface has an EtherCAT segment, and not a CAN bus.
    pub is_on_ethercat: bool,
    /// Node id, or position on the segment.
    pub number: u16,
}

impl fmt::Display for DevicePlace {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.is_on_ethercat {
            true => write!(out, "the device at position {}", self.number),
            false => write!(out, "node {}", self.number),
        }
    }
}

/// Reason why a device was not reached, not read or not written.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// Its interface was not connected.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// Its segment does not answer.
    #[error(transparent)]
    Segment(SegmentError),
    /// Too few devices answer on its segment, or its number is no node id.
    #[error("{place}: {why}")]
    Missing {
        /// Place where the device should be.
        place: DevicePlace,
        /// Reason.
        why: String,
    },
    /// The device did not come to PRE-OP.
    #[error("{place}: {doing}: {error}")]
    State {
        /// Place of the device.
        place: DevicePlace,
        /// Request that failed.
        doing: &'static str,
        /// Reason.
        error: SegmentError,
    },
    /// The device has no mailbox that can be used.
    #[error("{place}: reaching its objects: {error}")]
    NoObjects {
        /// Place of the device.
        place: DevicePlace,
        /// Reason.
        error: SegmentError,
    },
    /// The device did not do what was asked of an object.
    #[error("{place}: {doing}: {error}")]
    Object {
        /// Place of the device.
        place: DevicePlace,
        /// Request that failed.
        doing: String,
        /// Reason.
        error: ObjectError,
    },
    /// The power stage of the drive is on. Nothing was written.
    #[error("the power stage of {place} is on (statusword {:04X}h): nothing is written", statusword.0)]
    Powered {
        /// Place of the drive.
        place: DevicePlace,
        /// Its axis; 0 of a device of one drive.
        axis: u8,
        /// Its statusword.
        statusword: Statusword,
    },
    /// Vendor, product or serial number differ from those in the journal. Nothing was written.
    #[error("another device answers now")]
    OtherDevice,
}

/// A drive with this statusword has its power stage on, or is about to take it off: nobody may write to it then.
pub fn is_powered(statusword: Statusword) -> bool {
    matches!(
        statusword.state(),
        Some(State::OperationEnabled | State::SwitchedOn | State::QuickStopActive | State::FaultReactionActive)
    )
}

/// The connection to the devices of one interface.
enum Connection {
    Can(AnyService),
    Segment(AnySegmentService),
}

/// Reaches one device after another. The connection to an interface stays open until a device of another one is asked for.
pub(super) struct Devices<'a, C: ?Sized> {
    connect: &'a mut C,
    is_over: &'a Arc<AtomicBool>,
    open: Option<(String, Connection)>,
}

/// A device that was reached.
pub(super) struct Device<'a> {
    connection: &'a mut Connection,
    place: DevicePlace,
}

impl<'a, C: Connect + ?Sized> Devices<'a, C> {
    pub(super) fn new(connect: &'a mut C, is_over: &'a Arc<AtomicBool>) -> Self {
        Self { connect, is_over, open: None }
    }

    /// Closes the connection that is open.
    pub(super) fn close(&mut self) {
        self.open = None;
    }

    /// Reaches a device. On EtherCAT the device is brought to PRE-OP, also from an error that a broken-off boot has left.
    pub(super) fn reach(&mut self, place: &DevicePlace) -> Result<Device<'_>, DeviceError> {
        let open = self.open.take().filter(|(interface, _)| *interface == place.interface);
        let connection = match open {
            Some((_, connection)) => connection,
            None if place.is_on_ethercat => Connection::Segment(self.connect.segment(&place.interface, self.is_over)?),
            None => Connection::Can(self.connect.can(&place.interface, self.is_over)?),
        };
        let (_, connection) = self.open.insert((place.interface.clone(), connection));
        let place = place.clone();
        match connection {
            Connection::Segment(service) => to_pre_operational(service, &place)?,
            Connection::Can(_) => drop(node(&place)?),
        }
        Ok(Device { connection, place })
    }
}

fn to_pre_operational(service: &mut AnySegmentService, place: &DevicePlace) -> Result<(), DeviceError> {
    let (position, failed) =
        (place.number, |doing| move |error| DeviceError::State { place: place.clone(), doing, error });
    let found = service.devices().map_err(DeviceError::Segment)?;
    if position >= found {
        let why = SegmentFailure::Missing { found, position }.to_string();
        return Err(DeviceError::Missing { place: place.clone(), why });
    }
    let (status, _) = service.state(position).map_err(failed("reading its state"))?;
    if status != AlStatus::new(AlState::PreOperational, false) {
        service.change_state(position, AlState::PreOperational).map_err(failed("asking for PRE-OP"))?;
    }
    let objects = service.objects(position).map(drop);
    objects.map_err(|error| DeviceError::NoObjects { place: place.clone(), error })
}

fn node(place: &DevicePlace) -> Result<NodeId, DeviceError> {
    let missing = || DeviceError::Missing { place: place.clone(), why: "no node id".to_owned() };
    u8::try_from(place.number).ok().and_then(|raw| node_id(raw).ok()).ok_or_else(missing)
}

impl Device<'_> {
    /// Node id; 0 on EtherCAT.
    pub(super) fn node_id(&self) -> u8 {
        if self.place.is_on_ethercat { 0 } else { self.place.number as u8 }
    }

    pub(super) fn objects(&mut self) -> Result<Box<dyn ObjectAccess + '_>, DeviceError> {
        match &mut self.connection {
            Connection::Can(service) => Ok(Box::new(service.objects(node(&self.place)?))),
            Connection::Segment(service) => match service.objects(self.place.number) {
                Ok(objects) => Ok(Box::new(objects)),
                Err(error) => Err(DeviceError::NoObjects { place: self.place.clone(), error }),
            },
        }
    }

    /// The error that an object is which was not read or not written.
    pub(super) fn failed(&self, doing: impl Into<String>, error: ObjectError) -> DeviceError {
        DeviceError::Object { place: self.place.clone(), doing: doing.into(), error }
    }

    /// Reads an object; `None` if the device refuses.
    pub(super) fn read(&mut self, at: Address, doing: &str) -> Result<Option<Bytes>, DeviceError> {
        let read = self.objects()?.read(at);
        match read {
            Ok(bytes) => Ok(Some(bytes)),
            Err(ObjectError::Refused(_)) => Ok(None),
            Err(error) => Err(self.failed(doing, error)),
        }
    }

    /// Vendor, product and serial number, as far as the device has them.
    pub(super) fn identity(&mut self) -> Result<[Option<u32>; 3], DeviceError> {
        let mut identity = [None; 3];
        for (at, found) in IDENTITY.into_iter().zip(&mut identity) {
            *found = self.read(at, "reading what it is")?.as_deref().map(number);
        }
        Ok(identity)
    }

    /// Refuses a drive whose power stage is on.
    pub(super) fn refuse_powered(&mut self) -> Result<(), DeviceError> {
        for axis in 0..MOST_AXES {
            // Without the first statusword it is no drive; axes may lie farther apart than by CiA 402.
            let at = statusword_of(axis);
            let Some(word) = self.read(at, "reading its statusword")? else {
                if axis == 0 {
                    return Ok(());
                }
                continue;
            };
            let statusword = Statusword(number(&word) as u16);
            if is_powered(statusword) {
                return Err(DeviceError::Powered { place: self.place.clone(), axis, statusword });
            }
        }
        Ok(())
    }

    /// Ends the exchange of process data, which may not change meanwhile. On EtherCAT the device was reached so.
    pub(super) fn rest(&mut self) -> Result<(), DeviceError> {
        let Connection::Can(service) = &mut self.connection else { return Ok(()) };
        let sent = service.command(NmtCommand::EnterPreOperational, Some(node(&self.place)?));
        sent.map_err(|error| self.failed("asking for Pre-operational", error))
    }
}
