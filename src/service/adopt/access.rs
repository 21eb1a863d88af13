//! Devices that are tried out, on CAN and on EtherCAT.

use std::time::Duration;

use yieldwall_drives::profiles::Fieldbus;

use super::Refusal;
use crate::connection::Error;
use crate::object_access::{NodeObjects, ObjectAccess};
use crate::segment::DeviceObjects;
use yieldwall_fieldbus::canopen::{NmtCommand, NmtState};
use yieldwall_fieldbus::ethercat::AlState;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{CanLink, EthernetLink};

/// A device that is tried out.
pub trait TrialAccess: ObjectAccess {
    /// The bus that it is on.
    fn bus(&self) -> Fieldbus;

    /// Its node id; 0 on EtherCAT.
    fn node_id(&self) -> u8;

    /// Whether process data run; nothing is sent to change that.
    ///
    /// # Errors
    /// If they do, or the device does not say so.
    fn check_rest(&mut self) -> Result<(), Refusal>;

    /// Brings a device that reports no state to a state in which process data rest.
    ///
    /// # Errors
    /// As the bus has them.
    fn bring_to_rest(&mut self) -> Result<(), Error>;

    /// The time of its bus.
    fn now(&self) -> Time;

    /// Lets time pass.
    ///
    /// # Errors
    /// As the bus has them.
    fn wait(&mut self, time: Duration) -> Result<(), Error>;

    /// From now on nobody can end what is done: values that were changed have to be put back.
    fn finish(&mut self);
}

impl<L: CanLink> TrialAccess for NodeObjects<'_, L> {
    fn bus(&self) -> Fieldbus {
        Fieldbus::Canopen
    }

    fn node_id(&self) -> u8 {
        self.node.raw()
    }

    fn check_rest(&mut self) -> Result<(), Refusal> {
        match self.service.state(self.node)? {
            Some(NmtState::PreOperational) | None => Ok(()),
            Some(other) => Err(Refusal::Nmt(other)),
        }
    }

    fn bring_to_rest(&mut self) -> Result<(), Error> {
        match self.service.heard(self.node).state {
            Some(_) => Ok(()),
            None => self.service.command(NmtCommand::EnterPreOperational, Some(self.node)),
        }
    }

    fn now(&self) -> Time {
        self.service.now()
    }

    fn wait(&mut self, time: Duration) -> Result<(), Error> {
        self.service.listen(time, |_| {})
    }

    fn finish(&mut self) {
        self.service.finish();
    }
}

impl<L: EthernetLink> TrialAccess for DeviceObjects<'_, L> {
    fn bus(&self) -> Fieldbus {
        Fieldbus::Ethercat
    }

    fn node_id(&self) -> u8 {
        0
    }

    fn check_rest(&mut self) -> Result<(), Refusal> {
        match self.state()? {
            AlState::PreOperational => Ok(()),
            other => Err(Refusal::Al(other)),
        }
    }

    /// It has objects in PRE-OP at the earliest.
    fn bring_to_rest(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn now(&self) -> Time {
        self.time()
    }

    fn wait(&mut self, time: Duration) -> Result<(), Error> {
        self.pass(time)
    }

    fn finish(&mut self) {
        self.end_later();
    }
}
