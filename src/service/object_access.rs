//! The objects of one device, on whatever bus it is.

use super::connection::{Bytes, Error, Service};
use yieldwall_fieldbus::canopen::NodeId;
use yieldwall_fieldbus::objects::Address;
use yieldwall_link::CanLink;

/// Reads and writes the objects of one device.
pub trait ObjectAccess {
    /// Reads an object.
    ///
    /// # Errors
    /// Why there is no value.
    fn read(&mut self, at: Address) -> Result<Bytes, Error>;

    /// Writes an object; the bytes are those of its value, the lowest first.
    ///
    /// # Errors
    /// Why it was not written.
    fn write(&mut self, at: Address, value: &[u8]) -> Result<(), Error>;

    /// The indices of all objects, where the device has a list of them.
    ///
    /// # Errors
    /// Why there is no answer; a device that refuses has no list.
    fn indices(&mut self) -> Result<Option<Vec<u16>>, Error> {
        Ok(None)
    }
}

/// The objects of a node on a CAN bus.
#[derive(Debug)]
pub struct NodeObjects<'a, L> {
    pub(crate) service: &'a mut Service<L>,
    pub(crate) node: NodeId,
}

impl<L: CanLink> Service<L> {
    /// The objects of a node.
    pub fn objects(&mut self, node: NodeId) -> NodeObjects<'_, L> {
        NodeObjects { service: self, node }
    }
}

impl<L: CanLink> ObjectAccess for NodeObjects<'_, L> {
    fn read(&mut self, at: Address) -> Result<Bytes, Error> {
        self.service.read(self.node, at)
    }

    fn write(&mut self, at: Address, value: &[u8]) -> Result<(), Error> {
        self.service.write(self.node, at, value)
    }
}
