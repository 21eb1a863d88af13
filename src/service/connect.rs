//! The interfaces of a computer as connections to the devices there.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use thiserror::Error;

use super::connection::Service;
use super::segment::{SegmentError, SegmentService};
use yieldwall_bus::HeardFrame;
use yieldwall_link::{CanLink, EthernetLink};

/// A connection to the nodes of any CAN bus.
pub type AnyService = Service<Box<dyn CanLink>>;

/// A connection to the devices of any EtherCAT segment.
pub type AnySegmentService = SegmentService<Box<dyn EthernetLink>>;

/// Opens connections by the names of interfaces. [`OnInterfaces`] opens those of this computer.
pub trait Connect {
    /// Connects to the nodes of a CAN bus on which no other master was heard. Waiting ends when `is_over` is set.
    ///
    /// # Errors
    /// If the interface cannot be used or has a master.
    fn can(&mut self, interface: &str, is_over: &Arc<AtomicBool>) -> Result<AnyService, ConnectError>;

    /// Connects to the devices of an EtherCAT segment on which no other master was heard. Waiting ends when `is_over` is set.
    ///
    /// # Errors
    /// If the interface cannot be used or has a master.
    fn segment(&mut self, interface: &str, is_over: &Arc<AtomicBool>) -> Result<AnySegmentService, ConnectError>;
}

/// Reason why an interface was not connected. Nothing was sent.
#[derive(Debug, Error)]
pub enum ConnectError {
    /// The interface cannot be used.
    #[error(transparent)]
    Unusable(Box<dyn std::error::Error + Send + Sync>),
    /// The interface is an Ethernet interface, and the devices are on CAN.
    #[error("this is for CAN, and `{interface}` is an Ethernet interface")]
    NotCan {
        /// Name of the interface.
        interface: String,
    },
    /// Another master is on the bus.
    #[error("a master is on this bus; nothing was sent. Heard: {heard}, on `{interface}`")]
    OtherMaster {
        /// Name of the interface.
        interface: String,
        /// Frame that shows the master.
        heard: HeardFrame,
    },
    /// Another master is on the segment, or the wish to end came first.
    #[error(transparent)]
    Segment(#[from] SegmentError),
}

#[cfg(all(feature = "socketcan", target_os = "linux"))]
mod linux {
    use super::*;
    use crate::listen;
    use yieldwall_bus::ethercat::SegmentFailure;
    use yieldwall_bus::{LISTENING, SEGMENT_LISTENING, Signs};
    use yieldwall_fieldbus::canopen::BusId;
    use yieldwall_link::{PacketSocket, Role, SocketCan, SocketCanSettings, is_ethernet};

    /// The interfaces of this computer.
    #[derive(Clone, Copy, Debug, Default)]
    pub struct OnInterfaces;

    impl Connect for OnInterfaces {
        fn can(&mut self, interface: &str, is_over: &Arc<AtomicBool>) -> Result<AnyService, ConnectError> {
            AnyService::on_interface(interface, None, is_over)
        }

        fn segment(&mut self, interface: &str, is_over: &Arc<AtomicBool>) -> Result<AnySegmentService, ConnectError> {
            let link = PacketSocket::open(interface, Role::Master);
            let link = link.map_err(|error| ConnectError::Unusable(Box::new(error)))?;
            let mut service = SegmentService::new(Box::new(link) as Box<dyn EthernetLink>, Arc::clone(is_over));
            match service.listen(SEGMENT_LISTENING)? {
                Some(sign) => Err(SegmentError::from(SegmentFailure::OtherMaster { sign, has_written: false }).into()),
                None => Ok(service),
            }
        }
    }

    impl AnyService {
        /// Opens a CAN interface as its only master, and listens for a master elsewhere before anything is sent. An interface whose bit
        /// rate is not that of `bit_rate_bit_per_s` is refused.
        ///
        /// # Errors
        /// If the interface cannot be used or has a master.
        pub fn on_interface(
            interface: &str,
            bit_rate_bit_per_s: Option<u32>,
            is_over: &Arc<AtomicBool>,
        ) -> Result<Self, ConnectError> {
            let mut link = open(interface, bit_rate_bit_per_s, vec![Role::Master])?;
            let signs = Signs::of_any_master();
            match listen(&mut link, LISTENING, is_over, |frame| signs.find(frame)) {
                Some(heard) => Err(ConnectError::OtherMaster { interface: interface.to_owned(), heard }),
                None => Ok(Self::new(Box::new(link), BusId::FIRST, Arc::clone(is_over))),
            }
        }

        /// Opens a CAN interface next to a running master. Nothing may be sent.
        ///
        /// # Errors
        /// If the interface cannot be used.
        pub fn listening_on(
            interface: &str,
            bit_rate_bit_per_s: Option<u32>,
            is_over: &Arc<AtomicBool>,
        ) -> Result<Self, ConnectError> {
            let link = open(interface, bit_rate_bit_per_s, Vec::new())?;
            Ok(Self::new(Box::new(link), BusId::FIRST, Arc::clone(is_over)))
        }
    }

    fn open(interface: &str, bit_rate: Option<u32>, roles: Vec<Role>) -> Result<SocketCan, ConnectError> {
        if is_ethernet(interface) {
            return Err(ConnectError::NotCan { interface: interface.to_owned() });
        }
        let everything = SocketCanSettings::everything(interface);
        let settings = SocketCanSettings { bit_rate, roles, hears_others: true, ..everything };
        SocketCan::open(&settings).map_err(|error| ConnectError::Unusable(Box::new(error)))
    }
}

#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub use linux::OnInterfaces;
