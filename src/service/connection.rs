//! The connection to the devices of one bus.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use thiserror::Error;

use yieldwall_fieldbus::canopen::lss::{LssMaster, LssOutcome, LssRequest};
use yieldwall_fieldbus::canopen::{
    BusId, Emergency, Frame, NmtCommand, NmtState, NodeId, Outbox, SdoClient, SdoClients, SdoOutcome, SdoReply,
    SdoTicket, cob, nmt,
};
use yieldwall_fieldbus::objects::{AbortCode, Address, ObjectRequest};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{Arrival, CanLink, LinkOutbox, OtherTraffic, Received, SendError};

/// Longest wait before the wish to end is looked at.
const LOOK_UP: Duration = Duration::from_millis(50);
/// Time between two requests of many: a queue of ten frames, which is what Linux gives an interface, does not fill.
const BETWEEN_REQUESTS: Duration = Duration::from_millis(1);
/// How long an answer to node guarding may take.
const GUARDING: Duration = Duration::from_millis(60);
/// Frames that are taken before it is looked what is due.
const MOST_AT_ONCE: usize = 1000;
/// Most emergencies that are kept.
const MOST_EMERGENCIES: usize = 1000;

/// Why a device was not asked, or did not answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Error {
    /// It does not answer.
    #[error("no answer")]
    NoAnswer,
    /// It does not answer; what was to be written may have been written.
    #[error("no answer; it may have been written all the same")]
    MayBeWritten,
    /// It refuses.
    #[error("{0}")]
    Refused(AbortCode),
    /// The message of the node is no answer to the request; the transfer was aborted here.
    #[error("what it sends makes no sense ({0}); the transfer was broken off")]
    Senseless(AbortCode),
    /// A frame could not be sent.
    #[error("a frame could not be sent: {0}")]
    Link(#[from] SendError),
    /// More bytes than a transfer takes.
    #[error("{0} bytes are more than a transfer takes")]
    TooLong(usize),
    /// More objects than any device has: it answers whatever it is asked for.
    #[error("it answers for more than {0} objects: it says yes to whatever it is asked for")]
    Boundless(usize),
    /// Somebody wishes to end.
    #[error("interrupted")]
    Interrupted,
}

/// Traffic heard from a node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodeTraffic {
    /// Frames with one of the identifiers that a device of this node id sends by default.
    pub frames: u64,
    /// State in its last heartbeat or answer to node guarding; after its boot-up message a node is in Pre-operational.
    pub state: Option<NmtState>,
    /// Boot-up messages.
    pub boot_ups: u32,
}

/// The connection to the devices of one bus: an SDO client for each node that is asked, and what was heard of all.
///
/// Whoever makes one has seen to it that no other master is on the bus.
#[derive(Debug)]
pub struct Service<L> {
    link: L,
    bus: BusId,
    clients: SdoClients,
    /// How long a node may take to answer a request, and how often it is asked again.
    patience: (Duration, u8),
    asked: [bool; 128],
    heard: Vec<NodeTraffic>,
    others: OtherTraffic,
    emergencies: Vec<(Time, Emergency)>,
    is_over: Arc<AtomicBool>,
}

/// A value as a device sent it.
pub type Bytes = Vec<u8>;

impl<L: CanLink> Service<L> {
    /// Longest time that a node may take to answer a request, unless the caller sets another.
    pub const PATIENCE: Duration = Duration::from_secs(1);

    /// A connection over a link to one of its buses. Waiting ends when `is_over` is set.
    pub fn new(link: L, bus: BusId, is_over: Arc<AtomicBool>) -> Self {
        let mut clients = SdoClients::new();
        clients.set_exchanging(false);
        Self {
            link,
            bus,
            clients,
            patience: (Self::PATIENCE, 1),
            asked: [false; 128],
            heard: vec![NodeTraffic::default(); 128],
            others: OtherTraffic::default(),
            emergencies: Vec::new(),
            is_over,
        }
    }

    /// The bus.
    pub fn bus(&self) -> BusId {
        self.bus
    }

    /// Turns to another bus of the link; what was heard on the one before is forgotten.
    pub fn turn_to(&mut self, bus: BusId) {
        if bus != self.bus {
            self.bus = bus;
            self.heard.fill(NodeTraffic::default());
            self.others = OtherTraffic::default();
            self.emergencies.clear();
        }
    }

    /// Frames of the bus that were heard and are none of CANopen.
    pub fn others(&self) -> OtherTraffic {
        self.others
    }

    /// How long a node may take to answer a request from now on, and how often it is asked again.
    pub fn set_patience(&mut self, timeout: Duration, retries: u8) {
        self.patience = (timeout, retries);
        self.asked.fill(false);
    }

    /// From now on nobody can end what is done: values that were changed have to be put back.
    pub fn finish(&mut self) {
        self.is_over = Arc::new(AtomicBool::new(false));
    }

    /// The link.
    pub fn link(&self) -> &L {
        &self.link
    }

    /// Returns the same connection with its link changed by `change`.
    #[must_use]
    pub fn map_link(self, change: impl FnOnce(L) -> L) -> Self {
        Self { link: change(self.link), ..self }
    }

    /// The time of the link.
    pub fn now(&self) -> Time {
        self.link.now()
    }

    /// Returns the traffic heard from a node.
    pub fn heard(&self, node: NodeId) -> NodeTraffic {
        self.heard.get(usize::from(node.raw())).copied().unwrap_or_default()
    }

    /// The emergency messages that were heard, with the moments.
    pub fn emergencies(&self) -> &[(Time, Emergency)] {
        &self.emergencies
    }

    /// Listens for `time`, and gives everything that comes to `each`, beside what it notes.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub fn listen(&mut self, time: Duration, mut each: impl FnMut(&Arrival)) -> Result<(), Error> {
        let until = self.link.now() + time;
        loop {
            // On a bus that is never quiet there is always something more.
            while self.link.now() <= until
                && let Some(arrival) = self.link.receive()
            {
                self.note(&arrival);
                each(&arrival);
            }
            let now = self.link.now();
            if now >= until {
                return Ok(());
            }
            if self.is_over.load(Ordering::Relaxed) {
                return Err(Error::Interrupted);
            }
            self.link.wait(until.min(now + LOOK_UP));
        }
    }

    /// Sends an NMT command to a node, or to all.
    ///
    /// # Errors
    /// [`Error::Link`].
    pub fn command(&mut self, command: NmtCommand, node: Option<NodeId>) -> Result<(), Error> {
        self.send(&nmt::command(command, node))
    }

    /// Sends one frame on this bus.
    ///
    /// # Errors
    /// [`Error::Link`].
    pub fn send(&mut self, frame: &Frame) -> Result<(), Error> {
        Ok(self.link.send(&frame.on_bus(self.bus))?)
    }

    /// Returns the NMT state of a node: by node guarding, or by its heartbeats if it does not answer; `None` if it reports
    /// neither.
    ///
    /// # Errors
    /// [`Error::Link`], [`Error::Interrupted`].
    pub fn state(&mut self, node: NodeId) -> Result<Option<NmtState>, Error> {
        self.guard(&[node])?;
        Ok(self.heard(node).state)
    }

    /// Asks nodes for their states by node guarding; who answers is then known by [`Service::heard`].
    ///
    /// # Errors
    /// [`Error::Link`], [`Error::Interrupted`].
    pub fn guard(&mut self, nodes: &[NodeId]) -> Result<(), Error> {
        for node in nodes {
            self.send(&Frame::remote(cob::heartbeat(*node), 1))?;
            self.listen(BETWEEN_REQUESTS, |_| {})?;
        }
        self.listen(GUARDING, |_| {})
    }

    /// Asks something of the devices by LSS. A device may take `timeout` to answer.
    ///
    /// # Errors
    /// [`Error::Link`], [`Error::Interrupted`].
    pub fn lss(&mut self, request: LssRequest, timeout: Duration) -> Result<LssOutcome, Error> {
        let mut master = LssMaster::new(timeout);
        let now = self.link.now();
        let mut out = LinkOutbox::new(&mut self.link);
        let started = master.start(now, request, &mut out.on(self.bus));
        failed(&out)?;
        if let Ok(Some(outcome)) = started {
            return Ok(outcome);
        }
        loop {
            if self.is_over.load(Ordering::Relaxed) {
                return Err(Error::Interrupted);
            }
            let now = self.link.now();
            self.link.wait(master.next_deadline().min(now + LOOK_UP));
            while let Some(arrival) = self.link.receive() {
                self.note(&arrival);
                if let (true, Received::Frame(frame)) = (arrival.bus == self.bus, &arrival.what) {
                    let now = self.link.now();
                    let mut out = LinkOutbox::new(&mut self.link);
                    let outcome = master.on_frame(now, frame, &mut out.on(self.bus));
                    failed(&out)?;
                    if let Some(outcome) = outcome {
                        return Ok(outcome);
                    }
                }
            }
            let now = self.link.now();
            let mut out = LinkOutbox::new(&mut self.link);
            let outcome = master.poll(now, &mut out.on(self.bus));
            failed(&out)?;
            if let Some(outcome) = outcome {
                return Ok(outcome);
            }
        }
    }

    /// Reads an object.
    ///
    /// # Errors
    /// Why there is no value.
    pub fn read(&mut self, node: NodeId, at: Address) -> Result<Bytes, Error> {
        self.one(node, ObjectRequest::Read(at))
    }

    /// Writes an object; the bytes are those of its value, the lowest first.
    ///
    /// # Errors
    /// Why it was not written.
    pub fn write(&mut self, node: NodeId, at: Address, value: &[u8]) -> Result<(), Error> {
        self.one(node, ObjectRequest::Write(at, value)).map(|_| ())
    }

    /// Reads objects of many nodes at once; one answer for each request, in their order.
    ///
    /// # Errors
    /// [`Error::Link`], [`Error::Interrupted`]; what a single node answers stands in the list.
    pub fn read_each(&mut self, wanted: &[(NodeId, Address)]) -> Result<Vec<Result<Bytes, Error>>, Error> {
        let mut answers: Vec<Option<Result<Bytes, Error>>> = vec![None; wanted.len()];
        let mut tickets: Vec<(SdoTicket, usize)> = Vec::new();
        let mut take = |replies: Vec<SdoReply>, tickets: &mut Vec<(SdoTicket, usize)>| {
            for reply in replies {
                let Some(at) = tickets.iter().position(|(ticket, _)| *ticket == reply.ticket) else { continue };
                let (_, place) = tickets.swap_remove(at);
                if let Some(answer) = answers.get_mut(place) {
                    *answer = Some(ended(reply));
                }
            }
        };
        for (place, (node, at)) in wanted.iter().enumerate() {
            let ticket = self.request(*node, ObjectRequest::Read(*at))?;
            tickets.push((ticket, place));
            let until = self.link.now() + BETWEEN_REQUESTS;
            while self.link.now() < until {
                let replies = self.turn(until)?;
                take(replies, &mut tickets);
            }
        }
        while !tickets.is_empty() {
            let replies = self.turn(Time::NEVER)?;
            take(replies, &mut tickets);
        }
        Ok(answers.into_iter().map(|answer| answer.unwrap_or(Err(Error::NoAnswer))).collect())
    }

    fn one(&mut self, node: NodeId, request: ObjectRequest<'_>) -> Result<Bytes, Error> {
        let wanted = self.request(node, request)?;
        loop {
            let replies = self.turn(Time::NEVER)?;
            if let Some(reply) = replies.into_iter().find(|reply| reply.ticket == wanted) {
                return ended(reply);
            }
        }
    }

    /// Sends a request.
    fn request(&mut self, node: NodeId, request: ObjectRequest<'_>) -> Result<SdoTicket, Error> {
        if let Some(was_asked) = self.asked.get_mut(usize::from(node.raw()))
            && !std::mem::replace(was_asked, true)
        {
            let (timeout, retries) = self.patience;
            let mut client = SdoClient::new(node, timeout, SdoClient::DEFAULT_CAPACITY);
            client.set_retries(retries);
            self.clients.add(client);
        }
        let now = self.link.now();
        let mut out = LinkOutbox::new(&mut self.link);
        let ticket = self.clients.request(now, node, request, &mut out.on(self.bus));
        let failure = out.failure();
        let len = match request {
            ObjectRequest::Read(_) => 0,
            ObjectRequest::Write(_, value) => value.len(),
        };
        match failure {
            Some((_, error)) => Err(error.into()),
            None => ticket.map_err(|_| Error::TooLong(len)),
        }
    }

    /// Waits until something comes, something is due or `until`; the requests that have ended then.
    fn turn(&mut self, until: Time) -> Result<Vec<SdoReply>, Error> {
        if self.is_over.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        let now = self.link.now();
        self.link.wait(until.min(self.clients.next_deadline()).min(now + LOOK_UP));
        let mut replies = Vec::new();
        for _ in 0..MOST_AT_ONCE {
            let Some(arrival) = self.link.receive() else { break };
            self.note(&arrival);
            if let (true, Received::Frame(frame)) = (arrival.bus == self.bus, &arrival.what) {
                let now = self.link.now();
                let mut out = LinkOutbox::new(&mut self.link);
                replies.extend(self.clients.on_frame(now, frame, &mut out.on(self.bus)));
                failed(&out)?;
            }
        }
        let now = self.link.now();
        let mut out = LinkOutbox::new(&mut self.link);
        while let Some(reply) = self.clients.poll(now, &mut out.on(self.bus)) {
            replies.push(reply);
        }
        failed(&out)?;
        Ok(replies)
    }

    fn note(&mut self, arrival: &Arrival) {
        let frame = match &arrival.what {
            Received::Frame(frame) => frame,
            Received::Other(frame) if arrival.bus == self.bus => return self.others.count(frame),
            _ => return,
        };
        let sender = frame.id() & 0x7f;
        let is_of_device = !frame.is_remote()
            && matches!(frame.id() & 0x780, 0x080 | 0x180 | 0x280 | 0x380 | 0x480 | 0x580 | 0x700)
            && sender != 0;
        let Some(heard) = self.heard.get_mut(usize::from(sender)).filter(|_| is_of_device && arrival.bus == self.bus)
        else {
            return;
        };
        heard.frames += 1;
        // Of an answer to node guarding bit 7 toggles.
        let plain = match (frame.id() & 0x780, frame.data()) {
            (0x700, &[byte]) => Frame::new(frame.id(), &[byte & 0x7f]),
            _ => *frame,
        };
        if let Some((_, state)) = nmt::decode_heartbeat(&plain) {
            let has_booted = state == NmtState::Initialising;
            heard.state = Some(if has_booted { NmtState::PreOperational } else { state });
            heard.boot_ups += u32::from(has_booted);
        }
        if let Some(emergency) = Emergency::decode(frame)
            && self.emergencies.len() < MOST_EMERGENCIES
        {
            self.emergencies.push((arrival.time, emergency));
        }
    }
}

fn failed<L: CanLink>(out: &LinkOutbox<'_, L>) -> Result<(), Error> {
    out.failure().map_or(Ok(()), |(_, error)| Err(error.into()))
}

fn ended(reply: SdoReply) -> Result<Bytes, Error> {
    match reply.outcome {
        SdoOutcome::Uploaded { .. } | SdoOutcome::Downloaded { .. } => Ok(reply.data),
        SdoOutcome::Aborted { code, is_by_device: true, .. } => Err(Error::Refused(code)),
        SdoOutcome::Aborted { code, is_by_device: false, .. } => Err(Error::Senseless(code)),
        SdoOutcome::TimedOut { may_be_written: true, .. } => Err(Error::MayBeWritten),
        SdoOutcome::TimedOut { may_be_written: false, .. } => Err(Error::NoAnswer),
    }
}
