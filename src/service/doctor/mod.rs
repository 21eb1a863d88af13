//! Why a node does not answer: what is heard of it and of others, what it answers to harmless requests, and what follows.
//!
//! ```text
//! examine: listen -> ask its state -> read a pattern of objects -> ask the others    -> NodeFacts -> judge -> checks
//! ```
//! Requests are reads of objects of at most four bytes, and remote frames for the state: they change nothing in any device, whoever
//! hears them. A device answers each read once, under one identifier, and says in the answer which object it is of. An answer that
//! comes twice is therefore of two devices, and one that comes under another identifier was delivered wrongly. Own frames come back
//! from the interface and have to have the identifiers under which they were sent.

mod judge;
#[cfg(test)]
mod tests;

use std::time::Duration;

use super::connection::{Error, Service};
use yieldwall_fieldbus::canopen::{BusId, Frame, NmtState, NodeId, NodeSet, cob, nmt};
use yieldwall_fieldbus::objects::Address;
use yieldwall_link::{Arrival, CanLink, OtherTraffic, Received, SendError};

pub use judge::{Around, judge};

/// How long is listened: as long as for a master, in which most devices send a heartbeat.
const LISTENING: Duration = Duration::from_secs(1);
/// How long an answer may take.
const PATIENCE: Duration = Duration::from_millis(400);
/// How long a second answer is waited for after the first.
const SECOND: Duration = Duration::from_millis(20);
/// Requests without an answer after which nothing more is asked.
const MOST_UNANSWERED: usize = 2;
/// How often an answer is looked for.
const LOOK: Duration = Duration::from_millis(1);
/// Longest wait for an answer to node guarding.
const GUARDING: Duration = Duration::from_millis(60);
/// Most frames of one request that are kept.
const MOST_FRAMES: usize = 64;

/// Objects of CiA 301 that have at most four bytes. A device that lacks one refuses it, which is an answer too.
const PATTERN: [(u16, u8); 16] = [
    (0x1000, 0),
    (0x1001, 0),
    (0x1018, 0),
    (0x1018, 1),
    (0x1018, 2),
    (0x1018, 3),
    (0x1018, 4),
    (0x1003, 0),
    (0x1005, 0),
    (0x1006, 0),
    (0x1014, 0),
    (0x1017, 0),
    (0x1016, 0),
    (0x1200, 0),
    (0x1400, 0),
    (0x1800, 0),
];

/// Observations on the bus around one node, and its answers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeFacts {
    /// The node.
    pub node: NodeId,
    /// State of the interface meanwhile.
    pub link: LinkFacts,
    /// Frames of other nodes, before the first request.
    pub frames: u64,
    /// Nodes other than this one that were heard or answered.
    pub others: NodeSet,
    /// Nodes other than this one that answered an SDO request.
    pub answered: NodeSet,
    /// Frames that the node sent by itself.
    pub own_frames: u64,
    /// Its NMT state, from heartbeats or node guarding.
    pub state: Option<NmtState>,
    /// Its boot-up messages.
    pub boot_ups: u32,
    /// Requests of somebody else to its SDO server.
    pub foreign_requests: u64,
    /// Frames under the identifier of its SDO answers, before anything was asked.
    pub unasked: u64,
    /// Readings of the node, one after the other; empty if nothing was requested.
    pub asked: Vec<Probe>,
    /// Identifiers under which something was sent here.
    pub sent: Vec<u16>,
    bus: BusId,
}

/// State that the interface reported.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkFacts {
    /// Whether its controller has left the bus.
    pub is_bus_off: bool,
    /// Whether no node acknowledges its frames.
    pub is_unheard: bool,
    /// Frames that were destroyed on the wire.
    pub bus_errors: u32,
    /// Why a frame could not be sent.
    pub refused: Option<SendError>,
    /// The identifier of an own frame that came back, under which none was sent.
    pub altered: Option<u16>,
    /// Frames that are none of CANopen.
    pub others: OtherTraffic,
}

/// One read, and what came in answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Probe {
    /// The object.
    pub at: Address,
    /// Identifier and bytes of each frame that says that it answers for this object.
    pub answers: Vec<(u16, [u8; 8])>,
}

/// Finds out what there is to know of a node: about 2 s if it answers, 4 s if not. With `is_silent` nothing is sent.
///
/// # Errors
/// [`Error::Interrupted`]. A frame that cannot be sent is one of the facts.
pub fn examine<L: CanLink>(service: &mut Service<L>, node: NodeId, is_silent: bool) -> Result<NodeFacts, Error> {
    let mut facts = NodeFacts::new(node, service.bus());
    service.listen(LISTENING, |arrival| facts.hear(arrival))?;
    if !is_silent {
        ask(service, &mut facts)?;
        if !facts.is_answering() && facts.link.refused.is_none() {
            ask_others(service, &mut facts)?;
        }
    }
    Ok(facts)
}

/// Reads the pattern of objects of a node that is there, and nothing else: about 0.4 s.
///
/// # Errors
/// [`Error::Interrupted`].
pub fn read_pattern<L: CanLink>(service: &mut Service<L>, node: NodeId) -> Result<NodeFacts, Error> {
    let mut facts = NodeFacts::new(node, service.bus());
    ask(service, &mut facts)?;
    Ok(facts)
}

/// Asks the node for its state, and reads the pattern until it does not answer.
fn ask<L: CanLink>(service: &mut Service<L>, facts: &mut NodeFacts) -> Result<(), Error> {
    let node = facts.node;
    if !facts.send(service, Frame::remote(cob::heartbeat(node), 1)) {
        return Ok(());
    }
    service.listen(GUARDING, |arrival| facts.note(arrival))?;
    for (index, sub) in PATTERN {
        let at = Address::new(index, sub);
        let [low, high] = index.to_le_bytes();
        if !facts.send(service, Frame::new(cob::sdo_request(node), &[0x40, low, high, sub, 0, 0, 0, 0])) {
            return Ok(());
        }
        let mut asked = Probe { at, answers: Vec::new() };
        let mut until = service.now() + PATIENCE;
        let mut has_answer = false;
        while service.now() < until {
            service.listen(LOOK, |arrival| {
                facts.note(arrival);
                if arrival.bus == facts.bus {
                    asked.hear(arrival);
                }
            })?;
            if !has_answer && !asked.answers.is_empty() {
                has_answer = true;
                until = service.now() + SECOND;
            }
        }
        facts.asked.push(asked);
        let unanswered = facts.asked.iter().filter(|asked| asked.answers.is_empty()).count();
        if unanswered >= MOST_UNANSWERED {
            break;
        }
    }
    Ok(())
}

/// Asks all other nodes for their type, so that it is known who does answer.
fn ask_others<L: CanLink>(service: &mut Service<L>, facts: &mut NodeFacts) -> Result<(), Error> {
    for raw in 1..=127 {
        let Ok(node) = cob::node_id(raw) else { continue };
        let is_sent = node == facts.node
            || facts.send(service, Frame::new(cob::sdo_request(node), &[0x40, 0, 0x10, 0, 0, 0, 0, 0]));
        if !is_sent {
            return Ok(());
        }
        service.listen(LOOK, |arrival| facts.note(arrival))?;
    }
    service.listen(PATIENCE, |arrival| facts.note(arrival))
}

impl NodeFacts {
    /// Creates the facts of a node of which nothing is known yet.
    pub fn new(node: NodeId, bus: BusId) -> Self {
        Self {
            node,
            bus,
            link: LinkFacts::default(),
            frames: 0,
            others: NodeSet::default(),
            answered: NodeSet::default(),
            own_frames: 0,
            state: None,
            boot_ups: 0,
            foreign_requests: 0,
            unasked: 0,
            asked: Vec::new(),
            sent: Vec::new(),
        }
    }

    /// Whether the node answers a read, under the identifier that it should have.
    pub fn is_answering(&self) -> bool {
        let id = cob::sdo_response(self.node);
        self.asked.iter().any(|asked| asked.answers.iter().any(|(answered, _)| *answered == id))
    }

    /// Takes what came before anything was asked.
    fn hear(&mut self, arrival: &Arrival) {
        if let (Received::Frame(frame), true) = (&arrival.what, arrival.bus == self.bus) {
            self.frames += 1;
            self.foreign_requests += u64::from(frame.id() == cob::sdo_request(self.node));
            self.unasked += u64::from(frame.id() == cob::sdo_response(self.node));
        }
        self.note(arrival);
    }

    /// Takes what came at any time.
    fn note(&mut self, arrival: &Arrival) {
        if arrival.bus != self.bus {
            return;
        }
        match &arrival.what {
            Received::Frame(frame) => self.note_frame(frame),
            Received::Other(frame) => self.link.others.count(frame),
            Received::Error(error) => {
                self.link.is_bus_off |= error.is_bus_off;
                self.link.is_unheard |= error.is_unacknowledged || error.is_error_passive;
                // A frame that nobody acknowledges is an error of the protocol as well.
                self.link.bus_errors += u32::from(error.is_bus_error && !error.is_unacknowledged);
            }
            Received::Down => self.link.refused = Some(SendError::Down),
            Received::Gone => self.link.refused = Some(SendError::Gone),
            Received::Echo(frame) if !self.sent.contains(&frame.id()) => self.link.altered = Some(frame.id()),
            Received::Echo(_) | Received::Overflow { .. } => {}
        }
    }

    fn note_frame(&mut self, frame: &Frame) {
        let Some(sender) = sender(frame) else { return };
        if sender != self.node {
            if frame.id() == cob::sdo_response(sender) {
                self.answered.insert(sender);
            }
            return self.others.insert(sender);
        }
        self.own_frames += 1;
        let [byte, ..] = *frame.bytes();
        // Of an answer to node guarding bit 7 toggles.
        let plain = Frame::new(frame.id(), &[byte & 0x7f]);
        let is_state = frame.id() == cob::heartbeat(self.node) && frame.len() == 1;
        if let Some((_, state)) = nmt::decode_heartbeat(&plain).filter(|_| is_state) {
            let has_booted = state == NmtState::Initialising;
            self.boot_ups += u32::from(has_booted);
            self.state = Some(if has_booted { NmtState::PreOperational } else { state });
        }
    }

    /// Sends a frame; whether it could be sent.
    fn send<L: CanLink>(&mut self, service: &mut Service<L>, frame: Frame) -> bool {
        self.sent.push(frame.id());
        match service.send(&frame) {
            Ok(()) => true,
            Err(Error::Link(error)) => {
                self.link.refused = Some(error);
                false
            }
            Err(_) => false,
        }
    }
}

impl Probe {
    /// Takes a frame that says that it answers for this object: the answer to a read of up to four bytes, or a refusal.
    fn hear(&mut self, arrival: &Arrival) {
        let Received::Frame(frame) = &arrival.what else { return };
        let [command, low, high, sub, ..] = *frame.bytes();
        let is_answer = matches!(command, 0x41 | 0x42 | 0x43 | 0x47 | 0x4b | 0x4f | 0x80);
        let is_of_object = Address::new(u16::from_le_bytes([low, high]), sub) == self.at;
        // What somebody else asks looks like a refusal at most.
        let is_request = matches!(frame.id(), 0x601..=0x67f);
        if is_answer && is_of_object && frame.len() == 8 && !is_request && self.answers.len() < MOST_FRAMES {
            self.answers.push((frame.id(), *frame.bytes()));
        }
    }
}

/// The node that sends frames of this identifier by default.
fn sender(frame: &Frame) -> Option<NodeId> {
    let is_of_device = matches!(frame.id() & 0x780, 0x080 | 0x180 | 0x280 | 0x380 | 0x480 | 0x580 | 0x700);
    let raw = (frame.id() & 0x7f) as u8;
    if is_of_device && !frame.is_remote() { cob::node_id(raw).ok() } else { None }
}
