//! Requests to several nodes at once, one transfer per node at a time.

use std::collections::VecDeque;
use std::time::Duration;

use super::super::{CanopenError, Frame, NodeId, Outbox};
use super::{SdoClient, SdoOutcome};
use crate::objects::{Address, ObjectRequest};
use crate::time::Time;

/// Number that identifies the reply to a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SdoTicket(u64);

/// Result of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SdoReply {
    /// The request.
    pub ticket: SdoTicket,
    /// The node.
    pub node: NodeId,
    /// Result of its transfer.
    pub outcome: SdoOutcome,
    /// The bytes that were read or written.
    pub data: Vec<u8>,
}

#[derive(Clone, Debug)]
struct Lane {
    client: SdoClient,
    running: Option<SdoTicket>,
    waiting: VecDeque<(SdoTicket, Address, Option<Vec<u8>>)>,
}

/// Values from so many bytes on are transferred in blocks where the device can do that.
const BLOCKS_FROM: usize = 64;

/// A queue of requests for each node; the nodes are served side by side.
#[derive(Clone, Debug, Default)]
pub struct SdoClients {
    lanes: Vec<Lane>,
    issued: u64,
    /// Whether the owner of the loop has said that no process data run.
    is_quiet: bool,
}

impl SdoClients {
    /// Creates clients without nodes.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a node through its client, which may have been set up before; one of the same node is replaced with all its
    /// requests.
    pub fn add(&mut self, mut client: SdoClient) {
        if self.is_quiet {
            client.set_exchanging(false);
        }
        self.lanes.retain(|lane| lane.client.node() != client.node());
        self.lanes.push(Lane { client, running: None, waiting: VecDeque::new() });
    }

    /// Adds a node with a waiting time for answers and the default capacity.
    pub fn add_node(&mut self, node: NodeId, timeout: Duration) {
        self.add(SdoClient::new(node, timeout, SdoClient::DEFAULT_CAPACITY));
    }

    /// Sets for all nodes whether process data run, as [`SdoClient::set_exchanging`].
    pub fn set_exchanging(&mut self, is_exchanging: bool) {
        self.is_quiet = !is_exchanging;
        self.lanes.iter_mut().for_each(|lane| lane.client.set_exchanging(is_exchanging));
    }

    /// Queues a request behind the others of its node, and starts it if there are none. Long values are written in
    /// blocks, if the device can do that.
    ///
    /// # Errors
    /// [`CanopenError::NodeId`] for a node that was not added, [`CanopenError::SdoBuffer`] for too many bytes.
    pub fn request(
        &mut self,
        now: Time,
        node: NodeId,
        request: ObjectRequest<'_>,
        out: &mut impl Outbox,
    ) -> Result<SdoTicket, CanopenError> {
        let lane = self.lanes.iter_mut().find(|lane| lane.client.node() == node);
        let lane = lane.ok_or(CanopenError::NodeId(node.raw()))?;
        let (at, data) = match request {
            ObjectRequest::Read(at) => (at, None),
            ObjectRequest::Write(at, data) => {
                lane.client.check_len(data.len())?;
                (at, Some(data.to_vec()))
            }
        };
        self.issued += 1;
        let ticket = SdoTicket(self.issued);
        lane.waiting.push_back((ticket, at, data));
        lane.start_next(now, out);
        Ok(ticket)
    }

    /// Takes a frame from the bus; the reply if it ended a request. The next one of that node starts at once.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) -> Option<SdoReply> {
        self.lanes.iter_mut().find_map(|lane| {
            let outcome = lane.client.on_frame(now, frame, out)?;
            lane.reply(now, outcome, out)
        })
    }

    /// Does what is due; call until there is no reply.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) -> Option<SdoReply> {
        self.lanes.iter_mut().find_map(|lane| {
            let outcome = lane.client.poll(now, out)?;
            lane.reply(now, outcome, out)
        })
    }

    /// Returns the time of the next poll.
    pub fn next_deadline(&self) -> Time {
        self.lanes.iter().map(|lane| lane.client.next_deadline()).fold(Time::NEVER, Time::min)
    }
}

impl Lane {
    fn reply(&mut self, now: Time, outcome: SdoOutcome, out: &mut impl Outbox) -> Option<SdoReply> {
        let ticket = self.running.take()?;
        let data = self.client.data().to_vec();
        self.start_next(now, out);
        Some(SdoReply { ticket, node: self.client.node(), outcome, data })
    }

    fn start_next(&mut self, now: Time, out: &mut impl Outbox) {
        if self.running.is_some() {
            return;
        }
        let Some((ticket, at, data)) = self.waiting.pop_front() else { return };
        let started = match data {
            None => self.client.start_upload(now, at.index, at.sub, out),
            Some(data) if data.len() >= BLOCKS_FROM => {
                self.client.start_block_download(now, at.index, at.sub, &data, out)
            }
            Some(data) => self.client.start_download(now, at.index, at.sub, &data, out),
        };
        self.running = started.is_ok().then_some(ticket);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::canopen::node_id;
    use crate::objects::{AbortCode, Address};

    const NOW: Time = Time(0);

    fn node(raw: u8) -> NodeId {
        node_id(raw).unwrap()
    }

    fn read(index: u16) -> ObjectRequest<'static> {
        ObjectRequest::Read(Address::new(index, 0))
    }

    fn two_nodes() -> SdoClients {
        let mut clients = SdoClients::new();
        for raw in [1, 2] {
            clients.add_node(node(raw), Duration::from_millis(100));
        }
        clients
    }

    #[test]
    fn nodes_are_served_side_by_side_and_each_in_order() {
        let mut clients = two_nodes();
        let mut out = Vec::new();
        let write = ObjectRequest::Write(Address::new(0x6040, 0), &[6, 0]);
        let first = clients.request(NOW, node(1), read(0x6041), &mut out).unwrap();
        let second = clients.request(NOW, node(1), write, &mut out).unwrap();
        let other = clients.request(NOW, node(2), read(0x1000), &mut out).unwrap();
        let expected = [
            Frame::new(0x601, &[0x40, 0x41, 0x60, 0, 0, 0, 0, 0]),
            Frame::new(0x602, &[0x40, 0x00, 0x10, 0, 0, 0, 0, 0]),
        ];
        assert_eq!(out, expected);
        out.clear();
        // The second node answers first.
        let answer = Frame::new(0x582, &[0x43, 0x00, 0x10, 0, 0x92, 1, 2, 0]);
        let reply = clients.on_frame(NOW, &answer, &mut out).unwrap();
        assert_eq!((reply.ticket, reply.node, &reply.data[..]), (other, node(2), &[0x92, 1, 2, 0][..]));
        let reply = clients.on_frame(NOW, &Frame::new(0x581, &[0x4b, 0x41, 0x60, 0, 7, 0, 0, 0]), &mut out).unwrap();
        assert_eq!((reply.ticket, &reply.data[..]), (first, &[7, 0][..]));
        assert_eq!(out, [Frame::new(0x601, &[0x2b, 0x40, 0x60, 0, 6, 0, 0, 0])]);
        let reply = clients.on_frame(NOW, &Frame::new(0x581, &[0x60, 0x40, 0x60, 0, 0, 0, 0, 0]), &mut out).unwrap();
        let done = SdoOutcome::Downloaded { at: Address::new(0x6040, 0) };
        assert_eq!((reply.ticket, reply.outcome), (second, done));
        assert_eq!(clients.next_deadline(), Time::NEVER);
    }

    #[test]
    fn a_failed_request_does_not_hold_up_the_next_one() {
        let mut clients = two_nodes();
        let mut out = Vec::new();
        let write = |value: &'static [u8]| ObjectRequest::Write(Address::new(0x6060, 0), value);
        clients.request(NOW, node(1), write(&[8]), &mut out).unwrap();
        clients.request(NOW, node(1), write(&[9]), &mut out).unwrap();
        out.clear();
        let late = NOW + Duration::from_millis(100);
        let reply = clients.poll(late, &mut out).unwrap();
        assert!(matches!(reply.outcome, SdoOutcome::TimedOut { may_be_written: true, .. }));
        assert_eq!(out.last(), Some(&Frame::new(0x601, &[0x2f, 0x60, 0x60, 0, 9, 0, 0, 0])));
        assert_eq!(clients.poll(late, &mut out), None);
        let refused = Frame::new(0x581, &[0x80, 0x60, 0x60, 0, 0x30, 0, 0x09, 0x06]);
        let reply = clients.on_frame(late, &refused, &mut out).unwrap();
        let at = Address::new(0x6060, 0);
        assert_eq!(reply.outcome, SdoOutcome::Aborted { at, code: AbortCode::VALUE, is_by_device: true });
    }

    #[test]
    fn long_values_go_in_blocks_and_impossible_requests_are_refused() {
        let mut clients = two_nodes();
        let mut out = Vec::new();
        let long = ObjectRequest::Write(Address::new(0x1f50, 1), &[0; 64]);
        clients.request(NOW, node(1), long, &mut out).unwrap();
        assert_eq!(out, [Frame::new(0x601, &[0xc6, 0x50, 0x1f, 1, 64, 0, 0, 0])]);
        assert_eq!(clients.request(NOW, node(3), read(0x1000), &mut out), Err(CanopenError::NodeId(3)));
        let capacity = SdoClient::DEFAULT_CAPACITY;
        let data = vec![0; capacity + 1];
        let huge = ObjectRequest::Write(Address::new(0x1f50, 1), &data);
        let refused = clients.request(NOW, node(2), huge, &mut out);
        assert_eq!(refused, Err(CanopenError::SdoBuffer { len: capacity + 1, capacity }));
    }
}
