//! A link with a trouble planted into what comes and goes, so that who looks for it can be tried.

use yieldwall_fieldbus::canopen::{Frame, NmtCommand, NodeId, cob, nmt};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{Arrival, CanLink, ErrorFrame, OtherFrame, Received, SendError};

/// A trouble with one node, or with the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// The node is switched off.
    Silent,
    /// The node has this node id in place of its own.
    OtherNodeId(NodeId),
    /// The node is in Stopped.
    Stopped,
    /// Another device has its node id too.
    Double,
    /// The node has another bit rate: what it sends is an error on the bus, and it understands nothing.
    OtherBitRate,
    /// The adapter delivers answers and heartbeats under other identifiers.
    OtherIdentifiers,
    /// The controller leaves the bus at the first frame that it sends.
    BusOff,
    /// Devices of another kind are on the bus: frames come with 29-bit identifiers alone.
    OtherTraffic,
}

/// Upper bits of an identifier of other traffic.
const PARAMETER_GROUP: u32 = 0x18ff_0000;
/// The bit of an identifier that a bad adapter turns over.
const TURNED: u16 = 0x004;

/// A link with a [`Trouble`].
#[derive(Debug)]
pub struct PlantedLink<L> {
    link: L,
    node: NodeId,
    trouble: Trouble,
    /// Next arrival besides the link's own.
    next: Option<Arrival>,
    is_off: bool,
}

impl<L: CanLink> PlantedLink<L> {
    /// Plants a trouble with `node` on the first bus of a link.
    pub fn new(mut link: L, node: NodeId, trouble: Trouble) -> Self {
        if trouble == Trouble::Stopped {
            // A link that cannot send is trouble enough.
            let _ = link.send(&nmt::command(NmtCommand::StopRemoteNode, Some(node)));
        }
        Self { link, node, trouble, next: None, is_off: false }
    }

    /// Returns the changed form of a frame from another node.
    fn changed(&mut self, arrival: Arrival, frame: Frame) -> Option<Arrival> {
        let is_own = is_of(&frame, self.node);
        let with = |what| Some(Arrival { what, ..arrival });
        match self.trouble {
            Trouble::Silent if is_own => None,
            Trouble::OtherBitRate if is_own => {
                with(Received::Error(ErrorFrame { is_bus_error: true, ..ErrorFrame::default() }))
            }
            Trouble::OtherNodeId(other) if is_own => with(Received::Frame(renumbered(&frame, other))),
            Trouble::OtherTraffic => {
                let (id, length) = (PARAMETER_GROUP | u32::from(frame.id()), frame.len());
                with(Received::Other(OtherFrame { id, is_extended: true, is_fd: false, length }))
            }
            Trouble::OtherIdentifiers if frame.id() > 0x580 => {
                with(Received::Frame(with_id(&frame, frame.id() ^ TURNED)))
            }
            Trouble::Double if is_own => {
                let mut bytes = *frame.bytes();
                // The other one has another serial number.
                if frame.id() == cob::sdo_response(self.node) && bytes.starts_with(&[0x43, 0x18, 0x10, 4]) {
                    bytes[4] ^= 1;
                }
                let twin = Frame::new(frame.id(), bytes.get(..frame.len().into()).unwrap_or_default());
                self.next = with(Received::Frame(twin.on_bus(frame.bus())));
                Some(arrival)
            }
            _ => Some(arrival),
        }
    }
}

impl<L: CanLink> CanLink for PlantedLink<L> {
    fn now(&self) -> Time {
        self.link.now()
    }

    fn receive(&mut self) -> Option<Arrival> {
        if let Some(arrival) = self.next.take() {
            return Some(arrival);
        }
        loop {
            let arrival = self.link.receive()?;
            let Received::Frame(frame) = arrival.what else { return Some(arrival) };
            let changed = self.changed(arrival, frame);
            if changed.is_some() {
                return changed;
            }
        }
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let is_for_node = is_of(frame, self.node) || frame.id() == cob::sdo_request(self.node);
        if self.trouble == Trouble::OtherBitRate {
            // It takes every frame for an error, and says so on the wire.
            let what = Received::Error(ErrorFrame { is_bus_error: true, ..ErrorFrame::default() });
            self.next = Some(Arrival { time: self.link.now(), bus: frame.bus(), what });
        }
        match self.trouble {
            Trouble::BusOff if self.is_off => return Err(SendError::Full),
            Trouble::BusOff => {
                self.is_off = true;
                let what = Received::Error(ErrorFrame { is_bus_off: true, ..ErrorFrame::default() });
                self.next = Some(Arrival { time: self.link.now(), bus: frame.bus(), what });
                return Ok(());
            }
            Trouble::Silent | Trouble::OtherBitRate | Trouble::OtherNodeId(_) if is_for_node => return Ok(()),
            Trouble::OtherNodeId(other) if is_of(frame, other) || frame.id() == cob::sdo_request(other) => {
                return self.link.send(&renumbered(frame, self.node));
            }
            _ => {}
        }
        self.link.send(frame)
    }

    fn wait(&mut self, until: Time) -> bool {
        self.next.is_some() || self.link.wait(until)
    }
}

/// Whether a node sends frames of this identifier by default.
fn is_of(frame: &Frame, node: NodeId) -> bool {
    let is_of_device = matches!(frame.id() & 0x780, 0x080 | 0x180 | 0x280 | 0x380 | 0x480 | 0x580 | 0x700);
    is_of_device && frame.id() & 0x7f == u16::from(node.raw())
}

fn renumbered(frame: &Frame, node: NodeId) -> Frame {
    with_id(frame, frame.id() & 0x780 | u16::from(node.raw()))
}

fn with_id(frame: &Frame, id: u16) -> Frame {
    match frame.is_remote() {
        true => Frame::remote(id, frame.length_code()),
        false => Frame::new(id, frame.data()),
    }
    .on_bus(frame.bus())
}
