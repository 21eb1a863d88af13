//! Objects of the nodes, beside the boot.

use super::CanNetwork;
use crate::phase::Phase;
use yieldwall_fieldbus::canopen::Outbox;
use yieldwall_fieldbus::objects::{ObjectAnswer, ObjectError, ObjectRequest};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::Device;

impl CanNetwork {
    /// Begins to read or to write an object of a device.
    ///
    /// # Errors
    /// If the network was not booted, the device has no objects or has not answered the last request, or the value is too long.
    pub(crate) fn ask(
        &mut self,
        now: Time,
        device: Device,
        request: ObjectRequest<'_>,
        out: &mut impl Outbox,
    ) -> Result<(), ObjectError> {
        match self.phase {
            Phase::Configuring => return Err(ObjectError::Busy),
            Phase::Failed(_) => return Err(ObjectError::NotBooted),
            _ if !self.has_sent => return Err(ObjectError::NotBooted),
            _ => {}
        }
        let node = self.nodes.iter_mut().find(|node| node.device == device).ok_or(ObjectError::NoObjects)?;
        node.transfer.ask(now, request, &mut out.on(node.bus))
    }

    /// How what was asked of a device last has ended.
    ///
    /// Real-time: yes.
    pub(crate) fn answer(&self, device: Device) -> ObjectAnswer<'_> {
        match self.nodes.iter().find(|node| node.device == device) {
            Some(node) => node.transfer.answer(),
            None => ObjectAnswer::Failed(ObjectError::NoObjects),
        }
    }

    /// The node id of a device; `None` for a sensor on plain CAN.
    pub(crate) fn node_id(&self, device: Device) -> Option<u8> {
        self.nodes.iter().find(|node| node.device == device).map(|node| node.id.raw())
    }
}
